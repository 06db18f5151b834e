"""The lamp and the camera of a rig file, with what polarises and how the beam falls off.

Also here are the spectral bands of a rig file, listed or of a tunable filter.

From what a pixel reads to what it saw: response curve, nonlinearity, and the maps of single pixels.

Signals are in DN. With none of the keys (`camera.response`, `camera.nonlinearity`, `camera.maps`) nothing is changed.

Also here is the noise of a camera's pixels by the linear model of EMVA 1288 (release 4.0, section 2.4).
"""

import zipfile
import zlib
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.config import Fraction, NonNegative, Positive, SmallAngle, Strict
from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError
from gonio.polarisation import UNPOLARISED
from gonio.typing import Array, ArrayLike, Bools, Floats, NDArray


class Beam(Strict):
    """Irradiance on the plane that faces the lamp, through the sample's centre, relative to that at the centre.

    It is exp(x_per_mm x + y_per_mm y + xx_per_mm2 x^2 + xy_per_mm2 x y + yy_per_mm2 y^2) [mm], but at most e times the
    centre's. x lies in the plane of the arms and y along the axis that they turn about; x grows as the light arm's
    angle does. A Gaussian beam of standard deviation w has xx = yy = -1/(2 w^2). The pattern is one of directions from
    the lamp: a spot off that plane has the x and y where its ray crosses the plane.
    """

    x_per_mm: float = 0.0
    y_per_mm: float = 0.0
    xx_per_mm2: float = 0.0
    xy_per_mm2: float = 0.0
    yy_per_mm2: float = 0.0

    def terms(self) -> tuple[float, float, float, float, float]:
        """The five numbers, in the order above."""
        return self.x_per_mm, self.y_per_mm, self.xx_per_mm2, self.xy_per_mm2, self.yy_per_mm2


class Polarisation(Strict):
    """Linear polarisation that a lamp has, or that a camera with its lens prefers."""

    degree: Fraction = 0.0
    """(largest - smallest)/(largest + smallest) of what passes an ideal polariser that is turned."""
    azimuth_deg: float | None = None
    """Direction of the largest, from the axis that the arms turn about (for a camera: from `image_y`), in the sense
    that is counterclockwise for who looks from the sample to the lamp, or to the camera. None: nobody knows; the
    budget takes the worst, and a simulated rig 0."""


class Lamp(Strict):
    """The lamp: its size, its radiation pattern, its noise, its drift."""

    half_angle_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    """Half-angle of the disc of the lamp, seen from the sample's centre."""
    radiation: Literal["isotropic", "lambertian"] = "isotropic"
    """Radiant intensity around the direction to the sample's centre: alike in all directions, or with its cosine."""
    noise: NonNegative = 0.0
    """Relative standard deviation of the lamp's output from frame to frame."""
    drift_per_hour: float = 0.0
    """Relative drift of the lamp (simulation); the reduction learns the drift from the reference alone."""
    wander_per_sqrt_hour: NonNegative = 0.0
    """Relative standard deviation of the lamp's random walk after an hour (simulation); after t hours sqrt(t) of it."""
    warm_up_s: NonNegative = 0.0
    beam_diameter_mm: Positive | None = None
    """Diameter of the lit spot on a sample under normal incidence, with a sharp edge: the cone from the lamp's centre
    that has it. None: the light covers all that the camera looks at. See `gonio.lab.rig.regions`."""
    warm_up_loss: Annotated[float, Field(gt=-10, lt=1)] = 0.0
    """How far the lamp is below its later level when it is lit, as a fraction of that; below 0: how far above."""
    warm_up_time_constant_s: Positive = 600.0
    """Time in which what is left of `warm_up_loss` falls to 1/e."""
    monitor: bool = False
    """Every frame carries the reading of a monitor of the lamp, by which the reduction divides it."""
    monitor_noise: NonNegative = 0.0
    """Relative standard deviation of frame over monitor reading that photon noise does not explain."""
    beam: Beam | None = None
    """Profile of the beam over the sample; None: even."""
    polarisation: Polarisation = Polarisation()

    @property
    def frame_noise(self) -> float:
        """Relative standard deviation from frame to frame of what the reduction takes for the lamp's light."""
        return self.monitor_noise if self.monitor else self.noise


class Camera(Strict):
    """The camera in the terms of EMVA 1288, and its lens."""

    width: Annotated[int, Field(ge=32, le=8192)] = 640
    height: Annotated[int, Field(ge=32, le=8192)] = 480
    pixel_um: Positive = 5.0
    focal_length_mm: Positive = 100.0
    lens_half_angle_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    """Half-angle of the lens's entrance pupil, seen from the sample's centre."""
    principal_point_px: tuple[float, float] = (0.0, 0.0)
    """Where the optical axis meets the sensor, from its middle: [columns, rows]."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Brown's polynomial as OpenCV has it: [k1, k2, p1, p2, k3], of image coordinates in image distances."""
    roll_deg: float = 0.0
    """The camera turned about its optical axis: its columns' direction toward its rows'."""
    pointing_deg: tuple[SmallAngle, SmallAngle] = (0.0, 0.0)
    """How far the optical axis points beside the crossing that its arm carries it around: toward growing columns, and
    toward growing rows."""
    cos4: bool = False
    vignetting: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Relative loss of light at the corner of the frame beyond cos^4, growing as the fourth power of the radius."""
    blur_px: Annotated[float, Field(ge=0, le=64)] = 0.0
    """Standard deviation of the lens's blur on the sensor [pixels], a Gaussian."""
    pattern: Literal["mono", "RGGB", "BGGR", "GRBG", "GBRG"] = "mono"
    bits: Literal[8, 10, 12, 14, 16] = 12
    quantised: bool = True
    electrons_per_dn: Positive = 3.0
    black_level_dn: NonNegative = 64.0
    full_well_e: Positive = 11_000.0
    photon_noise: bool = False
    read_noise_e: NonNegative = 0.0
    dark_current_e_per_s: NonNegative = 0.0
    prnu: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Relative standard deviation of the pixels' responsivity."""
    dsnu_e: NonNegative = 0.0
    """Standard deviation of the pixels' dark signal [e-]."""
    nonlinearity: tuple[float, ...] = ()
    """Relative departure of the signal from the light: a linear signal x above the dark level [DN] reads
    x (1 + c[0] s + c[1] s^2 + ...), s = x / (2^bits - 1). The reduction takes it out."""
    response: tuple[float, ...] = ()
    """Linear value [DN] of each of the 2^bits values that a pixel reads, for a camera of 8 bits with a gamma: 256
    numbers that grow from 0 to 255. Levels and noise are those of the linear values."""
    stray_light: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Light that lens and sensor spread evenly over the frame: a fraction of the frame's mean signal, in each pixel."""
    stray_halo: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Fraction of the light of each pixel that falls around it, as a Gaussian of `stray_halo_px`."""
    stray_halo_px: Annotated[float, Field(ge=2, le=4096)] = 64.0
    """Standard deviation of the halo along a row [pixels]."""
    maps: str | None = None
    """Maps of the pixels (.npz), as `gonio calibrate camera` writes them: responsivities and defects. A path beside
    the file that names it."""
    hot_pixels: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    """Simulation: the part of the pixels that have a dark current of their own."""
    hot_pixel_e_per_s: NonNegative = 0.0
    """Simulation: its mean over them [e-/s], exponentially distributed."""
    responsivity_e_per_s: Positive = 40_000.0
    """Electrons a second on the axis from a Lambertian white (brdf = 1/pi) at normal incidence, with a fresh lamp."""
    exposure_limits_s: tuple[Positive, Positive] = (1e-4, 60.0)
    frame_overhead_s: NonNegative = 0.05
    readout_s: NonNegative = 0.0
    """How long a frame is read out and transferred beyond `frame_overhead_s` [s], of a camera whose driver says when an
    exposure is over: the arms move on meanwhile."""
    polarisation: Polarisation = Polarisation()
    """Diattenuation of lens and sensor together."""
    cosmic_per_s: NonNegative = 0.0
    """Simulation: hits of cosmic radiation a second on the whole sensor."""

    @property
    def beside_s(self) -> float:
        """What a frame takes beside its exposure [s]."""
        return self.frame_overhead_s + self.readout_s

    @property
    def saturation_e(self) -> float:
        """Charge [e-] that fills a pixel: its full well, or the range of the converter."""
        return min(self.full_well_e, (self.white_level_dn - self.black_level_dn) * self.electrons_per_dn)

    @model_validator(mode="after")
    def _sound(self) -> "Camera":
        if self.exposure_limits_s[0] >= self.exposure_limits_s[1]:
            raise ValueError("exposure_limits_s must be [shortest, longest] with shortest < longest")
        if self.black_level_dn >= self.white_level_dn:
            raise ValueError(
                f"black_level_dn = {self.black_level_dn:g} must lie below the highest value of {self.bits} bits, "
                f"{self.white_level_dn:g}"
            )
        # its slope, 1 + sum (k + 1) c[k] s^k, stays above a half
        if sum((k + 2) * abs(c) for k, c in enumerate(self.nonlinearity)) > 0.5:
            raise ValueError(f"nonlinearity = {list(self.nonlinearity)}: more than a sensor's; is it in per cent?")
        if self.response:
            if self.bits != 8 or len(self.response) != 256:
                raise ValueError(f"response has {len(self.response)} values; a camera of 8 bits needs 256")
            if any(b <= a for a, b in pairwise(self.response)):
                raise ValueError("response must grow from each value to the next")
            if self.response[0] != 0.0 or abs(self.response[-1] - 255.0) > 1e-6:
                raise ValueError("response must begin with 0 and end with 255")
        return self

    @property
    def white_level_dn(self) -> float:
        """The highest value that a pixel can take [DN]."""
        return float(2**self.bits - 1)

    def require_exposure(self, exposure_s: float) -> None:
        """Raise `ConfigError` for an exposure outside `exposure_limits_s`."""
        shortest, longest = self.exposure_limits_s
        if not shortest * (1 - 1e-9) <= exposure_s <= longest * (1 + 1e-9):
            raise ConfigError(
                f"an exposure of {exposure_s:g} s is outside camera.exposure_limits_s, {shortest:g} to {longest:g} s"
            )


MAX_BANDS = 10_000


class Band(Strict):
    """A spectral band of the rig."""

    name: str
    centre_nm: Positive
    fwhm_nm: Positive
    channel: Literal["mono", "R", "G", "B"] = "mono"

    @property
    def polarisation(self) -> str:
        """The state of light and analyser that it is measured in, a word of `gonio.polarisation`."""
        return UNPOLARISED

    @property
    def alone(self) -> "Band":
        """The band of the rig, whatever state it is measured in."""
        return self


class Tunable(Strict):
    """The range of a source whose wavelength can be chosen."""

    start_nm: Positive
    stop_nm: Positive
    step_nm: Positive
    fwhm_nm: Positive

    @model_validator(mode="after")
    def _sound(self) -> "Tunable":
        if self.stop_nm < self.start_nm:
            raise ValueError("a tunable source needs start_nm <= stop_nm")
        if (self.stop_nm - self.start_nm) / self.step_nm >= MAX_BANDS:
            raise ValueError(f"a tunable source of more than {MAX_BANDS} bands; take a larger step_nm")
        return self


@lru_cache(maxsize=64)
def _all_bands(listed: tuple[Band, ...], tunable: Tunable | None) -> tuple[Band, ...]:
    """Bands by name, and those of a tunable source: some hundred, and a fit asks at every step."""
    if tunable is None:
        return listed
    count = int((tunable.stop_nm - tunable.start_nm) / tunable.step_nm + 1.5)
    centres = [tunable.start_nm + k * tunable.step_nm for k in range(count)]
    made = (
        Band(name=f"{c:g} nm", centre_nm=c, fwhm_nm=tunable.fwhm_nm) for c in centres if c <= tunable.stop_nm + 1e-9
    )
    return (*listed, *made)


class Bands(Strict):
    """Bands by name, or a tunable source that has one every `step_nm`."""

    list: tuple[Band, ...] = ()
    tunable: Tunable | None = None

    @model_validator(mode="after")
    def _some(self) -> "Bands":
        if not self.all():
            raise ValueError("a rig needs at least one band: give `list` or `tunable`")
        names = [band.name for band in self.all()]
        if len(set(names)) < len(names):
            raise ValueError(f'two bands are named "{next(n for n in names if names.count(n) > 1)}"')
        return self

    def all(self) -> tuple[Band, ...]:
        """Every band, in the order of the file."""
        return _all_bands(self.list, self.tunable)

    def containing(self, wavelength_nm: float) -> Band:
        """The band whose full width at half maximum contains a wavelength (the nearest centre, if several do).

        Raises
        ------
        ConfigError
            No band of this rig contains it.
        """
        inside = [b for b in self.all() if abs(b.centre_nm - wavelength_nm) <= b.fwhm_nm / 2 + 1e-9]
        if not inside:
            bands = self.all()
            named = [f"{b.name} ({b.centre_nm - b.fwhm_nm / 2:g} to {b.centre_nm + b.fwhm_nm / 2:g} nm)" for b in bands]
            listed = ", ".join(named) if len(bands) <= 6 else f"{named[0]} ... {named[-1]}"
            raise ConfigError(f"wavelength_nm = {wavelength_nm:g} lies in no band of the rig; it has: {listed}")
        return min(inside, key=lambda b: abs(b.centre_nm - wavelength_nm))


FORMAT = 1
STEPS = 12
"""Newton's steps at most; three or four do for a nonlinearity of some per cent."""


def linear_dn(camera: Camera, values: Array) -> Array:
    """Linear values [DN] of what pixels read, by `camera.response`; the same array where there is none."""
    if not camera.response:
        return values
    return np.asarray(np.asarray(camera.response)[np.minimum(values, len(camera.response) - 1)])


def bent(camera: Camera, signal: Floats) -> Floats:
    """What the linear signal x above the dark level [DN] reads: x (1 + c[0] s + ...), s = x / the highest value."""
    s = np.asarray(signal, dtype=float) / camera.white_level_dn
    return signal * np.polynomial.polynomial.polyval(s, (1.0, *camera.nonlinearity))


def straightened(camera: Camera, signal: Floats) -> Floats:
    """The linear signal [DN] of one that was read above the dark level; the inverse of `bent`."""
    if not camera.nonlinearity:
        return signal
    white = camera.white_level_dn
    read = np.asarray(signal, dtype=float) / white
    curve = np.array([0.0, 1.0, *camera.nonlinearity])
    slope = np.polynomial.polynomial.polyder(curve)
    s = read.copy()
    for _ in range(STEPS):
        step = (np.polynomial.polynomial.polyval(s, curve) - read) / np.polynomial.polynomial.polyval(s, slope)
        s -= step
        if np.max(np.abs(step), initial=0.0) < 1e-12:
            break
    return s * white


def by_coefficients(camera: Camera, linear: Floats) -> Floats:
    """Derivatives [DN] of `straightened` by each of `camera.nonlinearity`, at linear signals: shape (n, ...)."""
    s = np.asarray(linear, dtype=float) / camera.white_level_dn
    slope = np.polynomial.polynomial.polyder(np.array([0.0, 1.0, *camera.nonlinearity]))
    per = -camera.white_level_dn / np.polynomial.polynomial.polyval(s, slope)
    return np.array([per * s ** (k + 2) for k in range(len(camera.nonlinearity))]).reshape(-1, *s.shape)


@dataclass(frozen=True)
class PixelMaps:
    """What is known of single pixels; arrays of shape (height, width)."""

    responsivity: NDArray[np.float32]
    """Relative to the mean of the pixels around; 1 where it was not measured."""
    u_responsivity: NDArray[np.float32]
    """Its standard uncertainty; of a pixel that was not measured, the standard deviation of pixels (PRNU)."""
    defects: Bools
    """Pixels that are not to be used: hot, dead or noisy."""
    dark_offset_e: NDArray[np.float32]
    """Dark signal of each pixel at no exposure, less the mean [e-]. For people: a run has dark frames of its own."""

    def write(self, path: str | Path) -> None:
        """Write the maps as .npz, whole or not at all."""
        packed = BytesIO()
        np.savez_compressed(
            packed, format=FORMAT, responsivity=self.responsivity, u_responsivity=self.u_responsivity,
            defects=self.defects, dark_offset_e=self.dark_offset_e,
        )  # fmt: skip
        write_whole(Path(path), packed.getvalue())


_DAMAGED = (ValueError, TypeError, LookupError, EOFError, MemoryError, NotImplementedError)
"""What numpy and zipfile raise of damaged files, among others."""


def read_maps(path: str, shape: tuple[int, int]) -> PixelMaps:
    """The maps of a camera of `shape` (height, width).

    Raises
    ------
    ConfigError
        The file is missing, is no such file, or is of a camera of another size.
    """
    try:
        data = read_file(path)
        with zipfile.ZipFile(BytesIO(data)) as archive:
            unpacked = sum(part.file_size for part in archive.infolist())
        if unpacked > (most := 64 * shape[0] * shape[1] + 2**16):  # three arrays of at most 16 bytes a pixel
            raise ConfigError(f"{path}: unpacks to {unpacked} bytes; maps of this camera have at most {most}")
        with np.load(BytesIO(data), allow_pickle=False) as held:
            if int(held["format"]) != FORMAT:
                raise ConfigError(f"{path}: maps of format {int(held['format'])}; this program reads {FORMAT}")
            maps = PixelMaps(*(np.asarray(held[name]) for name in PixelMaps.__dataclass_fields__))
    except OSError as error:
        raise ConfigError(f"{path}: the maps of camera.maps cannot be read: {error.strerror or error}") from None
    except (*_DAMAGED, zipfile.BadZipFile, zlib.error):
        raise ConfigError(f"{path}: is no file of maps (camera.maps); `gonio calibrate camera` writes one") from None
    for name in PixelMaps.__dataclass_fields__:
        found = getattr(maps, name).shape
        if (kind := getattr(maps, name).dtype).kind != ("b" if name == "defects" else "f"):
            raise ConfigError(
                f"{path}: {name} holds values of the kind {kind}, which `gonio calibrate camera` never does"
            )
        if found != shape:
            raise ConfigError(
                f"{path}: {name} is of shape {found}; the rig file has camera.height = {shape[0]}, "
                f"camera.width = {shape[1]}"
            )
    return maps


def variance(camera: Camera, charge_e: ArrayLike, *, rounding: bool = True) -> Floats:
    """Variance [e-^2] of pixels from frame to frame: photons, dark electrons, read noise and rounding to whole DN.

    Parameters
    ----------
    charge_e
        Mean charge [e-] of light and dark current together; below 0 counts as 0.
    rounding
        Whether the frame holds whole DN.
    """
    charge = np.asarray(charge_e, dtype=float)
    shot = np.maximum(charge, 0.0) if camera.photon_noise else np.zeros_like(charge)
    steady = camera.read_noise_e**2 + (camera.electrons_per_dn**2 / 12.0 if rounding else 0.0)
    return np.asarray(shot + steady)


def deviation_dn(camera: Camera, charge_e: ArrayLike, *, rounding: bool = True) -> Floats:
    """Standard deviation of the same [DN]."""
    return np.asarray(np.sqrt(variance(camera, charge_e, rounding=rounding)) / camera.electrons_per_dn)


def spread(camera: Camera, charge_e: ArrayLike) -> Floats:
    """Variance [e-^2] among the pixels of one frame before rounding: noise, and what differs by nature."""
    fixed = camera.dsnu_e**2 + (camera.prnu * np.asarray(charge_e, dtype=float)) ** 2
    return np.asarray(variance(camera, charge_e, rounding=False) + fixed)


def rounding_of_mean(camera: Camera, charge_e: ArrayLike, count: int) -> Floats:
    """Variance [e-^2] of the mean of `count` pixels of about the same charge, from rounding to whole DN.

    Pixels round independently where they differ by half a DN or more, from noise or by nature (Widrow's condition: the
    remaining error is below 0.3 % of a DN). Pixels that are all alike round alike.
    """
    step = np.asarray(camera.electrons_per_dn**2)
    if camera.response:  # a step of a curve that is bent
        level = np.asarray(charge_e, dtype=float) / camera.electrons_per_dn + camera.black_level_dn
        step = step * np.interp(level, camera.response, np.gradient(camera.response)) ** 2
    return np.asarray(step / 12.0 / np.where(spread(camera, charge_e) >= 0.25 * step, count, 1))
