"""From what a pixel reads to what it saw: response curve, nonlinearity, and the maps of single pixels.

Signals are in DN. With none of the keys (`camera.response`, `camera.nonlinearity`, `camera.maps`) nothing is changed.

The noise of a camera's pixels by the linear model of EMVA 1288 (release 4.0, section 2.4).
"""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from gonio.disk import read_file, write_whole
from gonio.errors import ConfigError
from gonio.rig.light_and_camera import Camera
from gonio.typing import Array, ArrayLike, Bools, Floats, NDArray

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


def read_maps(path: str, shape: tuple[int, int]) -> PixelMaps:
    """The maps of a camera of `shape` (height, width).

    Raises
    ------
    ConfigError
        The file is missing, is no such file, or is of a camera of another size.
    """
    try:
        with np.load(BytesIO(read_file(path)), allow_pickle=False) as held:
            if int(held["format"]) != FORMAT:
                raise ConfigError(f"{path}: maps of format {int(held['format'])}; this program reads {FORMAT}")
            maps = PixelMaps(*(np.asarray(held[name]) for name in PixelMaps.__dataclass_fields__))
    except OSError as error:
        raise ConfigError(f"{path}: the maps of camera.maps cannot be read: {error.strerror or error}") from None
    except (ValueError, KeyError, EOFError):
        raise ConfigError(f"{path}: is no file of maps (camera.maps); `gonio calibrate camera` writes one") from None
    for name in PixelMaps.__dataclass_fields__:
        found = getattr(maps, name).shape
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
