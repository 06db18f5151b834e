"""The frames of a point as a picture of its BRDF: every pixel of the camera merged over its frames.

What a table does with the mean over its region happens here pixel by pixel, with the same functions: dark signal,
linearity, stray light, responsivities, and the geometry that a pixel is known to see. A frame's level of the lamp is
told by the table's own region in that frame. So a picture's mean over that region is the table's rate, whose
uncertainty all pixels of a point share. The formulas are explained in docs/maps.md.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.errors import DataError
from gonio.lab.acquisition.exposure import SATURATED, USABLE, full_scale_dn
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.reduction import merging
from gonio.lab.reduction.count_rates import RunFrames, lit_frames, without_dark
from gonio.lab.reduction.dark_signal import Darks
from gonio.lab.reduction.merging import Region, bound
from gonio.lab.reduction.stray_light import SpreadLight
from gonio.lab.rig import Frame, imaging, light_and_camera
from gonio.lab.rig.imaging import Channel, pixel_map
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.light_and_camera import Band, Camera, linear_dn
from gonio.typing import Bools, Floats, Ints
from gonio_maps.files import FLAGS

OUTSIDE, FULL, HOT, SHADOWED, BLURRED = (1 << k for k in range(len(FLAGS)))
STRIP = 2**17
"""Pixels that are worked on at once."""
BESIDE = 2
"""Rows and columns of neighbours that say how bright it is around a pixel."""
REACH = BESIDE + 1
"""And of those whose merging says how large its noise is."""
RING = 360
PIXEL = np.dtype([("brdf", "f4"), ("u", "f4"), ("flag", "u1")])
"""A pixel of a picture: BRDF [1/sr], its own standard uncertainty, and why it must not be used."""


@dataclass(frozen=True)
class MapPoint:
    """A point and band of a run that has a value in its table."""

    number: int
    """Place among the points of the map."""
    step: StepRecord
    band: Band
    view: View
    rate: float
    """The table's: the mean over its region [e-/s]."""
    level: float
    """The rate per unit BRDF at that time [e- sr/s]."""
    of_lamp: float = 0.0
    """Variance of `rate` by the lamp's noise."""


@dataclass(frozen=True)
class Lattice:
    """Pixels of a colour: every `pitch`-th row and column of the sensor, from the first on."""

    row: int
    col: int
    pitch: int

    def of(self, rows: slice, cols: slice) -> tuple[slice, slice]:
        """The part of a rectangle of the lattice as slices of the sensor."""
        p = self.pitch
        return (
            slice(rows.start * p + self.row, (rows.stop - 1) * p + self.row + 1, p),
            slice(cols.start * p + self.col, (cols.stop - 1) * p + self.col + 1, p),
        )

    def size(self, camera: Camera) -> tuple[int, int]:
        """Rows and columns of the lattice."""
        return -(-(camera.height - self.row) // self.pitch), -(-(camera.width - self.col) // self.pitch)


def lattices(camera: Camera, channel: Channel) -> list[Lattice]:
    """Where the pixels of a channel lie."""
    if channel == "mono" or camera.pattern == "mono":
        return [Lattice(0, 0, 1)]
    return [Lattice(k // 2, k % 2, 2) for k, colour in enumerate(camera.pattern) if colour == channel]


@dataclass(frozen=True)
class Lit:
    """A frame of a point, and what of it all pixels share."""

    frame: Frame
    full_dn: float
    """Full scale above the black level."""
    spread: SpreadLight | None
    effective_s: float
    """Exposure, times the lamp's level against that of the table's rate."""
    u_level: float
    """Relative standard uncertainty of that level by the noise of the region's pixels."""
    weight: float
    """The frame's share of the table's rate."""


class DarkPlane:
    """The dark signal of every pixel of the sensor, kept in a file."""

    def __init__(self, frames: RunFrames, folder: Path) -> None:
        camera = frames.description.camera
        self._gain = camera.electrons_per_dn
        taken = self._spool(frames, folder / "darks.raw")
        shape = (len(taken), camera.height, camera.width)
        spooled = np.memmap(folder / "darks.raw", np.uint16, "r", shape=shape)
        rate = camera.dark_current_e_per_s / camera.electrons_per_dn
        known = merging.noise_is_known(frames.description)
        whole = slice(0, camera.width)
        with open(folder / "dark.raw", "wb") as file:
            for rows in _strips(camera.height, camera.width):
                crops = [(t, linear_dn(camera, np.array(spooled[k, rows]))) for k, t in enumerate(taken)]
                darks = Darks(frames.without_hits(crops) if known else crops, rows, whole, rate)
                level, slope, self._centre = darks.line
                file.write(np.stack([level, slope], axis=1).astype(np.float32).tobytes())
        self.darks = darks
        """Of some rows: what exposures have to do with it is the same for all."""
        del spooled
        (folder / "darks.raw").unlink()
        self._line = np.memmap(folder / "dark.raw", np.float32, "r", shape=(camera.height, 2, camera.width))

    @staticmethod
    def _spool(frames: RunFrames, path: Path) -> list[float]:
        """Write the mosaics of all dark frames one after another; their exposures [s]."""
        out = []
        with open(path, "wb") as file:
            for step, entry in frames.dark_frames():
                frame = frames.read_or_note(step, entry)
                if frame is not None:
                    file.write(np.ascontiguousarray(frame.mosaic, np.uint16).data)
                    out.append(frame.exposure_s)
        if not out:
            raise DataError(f"{frames.run.path}: the run has no dark frame that is whole; finish it with --resume")
        return out

    def of(self, rows: slice, cols: slice, exposure_s: float) -> Floats:
        """Dark signal [DN] of a rectangle."""
        level, slope = (self._line[rows, k, cols].astype(float) for k in range(2))
        return np.asarray(level + slope * (exposure_s - self._centre))

    def rate(self, rows: slice, cols: slice) -> Floats:
        """Dark electrons a second of a rectangle."""
        return np.asarray(self._line[rows, 1, cols].astype(float) * self._gain)

    @cached_property
    def usual_rate(self) -> float:
        """The rate of most pixels [e-/s]: the median of a part of them."""
        every = max(1, math.isqrt(self._line[:, 1].size // STRIP))
        return float(np.median(self._line[::every, 1, ::every])) * self._gain


class Planes:
    """Makes the pictures of the points of a run, and knows where they lie."""

    def __init__(self, frames: RunFrames, folder: Path, radius_mm: float) -> None:
        self.frames, self.folder, self.radius_mm = frames, folder, radius_mm
        self.description = frames.description
        self.camera = frames.description.camera

    @cached_property
    def dark(self) -> DarkPlane:
        """The dark signal."""
        return DarkPlane(self.frames, self.folder)

    def file(self, point: MapPoint, lattice: int) -> Path:
        """Where a picture lies."""
        return self.folder / f"plane-{point.number:06d}-{lattice}.npy"

    def box(self, view: View, lattice: Lattice) -> tuple[slice, slice]:
        """The rectangle of a lattice that holds the sample's disc; empty where the frame holds none of it."""
        turn = np.linspace(0.0, 2.0 * math.pi, RING, endpoint=False)
        edge = self.radius_mm * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
        cols, rows = imaging.project(self.description, view, edge)
        out = []
        for places, first, size in zip(
            (rows, cols), (lattice.row, lattice.col), lattice.size(self.camera), strict=True
        ):
            at = (places - first) / lattice.pitch
            low, high = (float(np.clip(edge, -1.0, size)) for edge in (at.min(), at.max()))
            start = min(max(math.floor(low) - 2, 0), size)
            out.append(slice(start, max(min(math.ceil(high) + 3, size), start)))
        return out[0], out[1]

    def done(self, point: MapPoint) -> bool:
        """Whether the pictures of a point are there."""
        return all(self.file(point, k).is_file() for k, _ in enumerate(lattices(self.camera, point.band.channel)))

    def make(self, point: MapPoint) -> None:
        """Write the pictures of a point, each whole.

        Raises
        ------
        DataError
            None of its frames is whole.
        """
        region = self.frames.region(point.step, point.band.channel)
        if region is None:
            raise DataError(f"{self.frames.run.path}: step {point.step.step}: the source stands below the horizon")
        taken = self._levels(point, region)
        for k, lattice in enumerate(lattices(self.camera, point.band.channel)):
            rows, cols = self.box(point.view, lattice)
            path = self.file(point, k)
            begun = path.with_name(f".{path.name}.new")
            shape = (rows.stop - rows.start, cols.stop - cols.start)
            try:
                with open(begun, "wb") as file:  # not mapped: a disk that is full would end the process
                    np.lib.format.write_array_header_2_0(
                        file, {"descr": np.lib.format.dtype_to_descr(PIXEL), "fortran_order": False, "shape": shape}
                    )
                    for strip in _strips(*shape) if 0 not in shape else ():
                        part = slice(rows.start + strip.start, rows.start + strip.stop)
                        file.write(self._strip(point, taken, lattice, part, cols).tobytes())
            except OSError:
                begun.unlink(missing_ok=True)
                raise
            begun.replace(path)

    def _levels(self, point: MapPoint, region: Region) -> list[Lit]:
        """The frames of a point with the lamp's level in each: by the table's region, whose rate is known."""
        read = [(entry, self.frames.read_or_note(point.step, entry)) for entry in lit_frames(point.step, point.band)]
        whole = [(entry, frame) for entry, frame in read if frame is not None]
        if not whole:
            raise DataError(f"{self.frames.run.path}: no frame of step {point.step.step} is whole")
        spreads = [self.frames.spread(f, point.band.channel) if self.frames.spreads else None for _, f in whole]
        signals, usable, lamps = [], [], []
        fulls = [full_scale_dn(self.camera, frame) for _, frame in whole]
        for (entry, frame), full, spread in zip(whole, fulls, spreads, strict=True):
            electrons, levels = self._signal(frame, full, spread, region.roi.rows, region.roi.cols)
            lamps.append(frame.exposure_s * self.frames.lamp(entry))
            signals.append(electrons[region.roi.mask] * region.per_weight / lamps[-1])
            usable.append(levels[region.roi.mask] < merging.usable(self.camera))
        rates, best = np.array(signals), int(np.argmax([use.sum() for use in usable]))
        level, u_level = np.ones(len(rates)), np.zeros(len(rates))
        exposed = np.array(lamps)
        for k, use in enumerate(usable):
            common = use & usable[best]
            if not common.any():
                continue
            mean = float(rates[best][usable[best]].mean())
            ratio = float(rates[k][common].sum() / rates[best][common].sum()) if k != best else 1.0
            level[k] = max(mean * ratio / point.rate, 1e-6) if point.rate > 0 and mean * ratio > 0 else 1.0
            charge = np.maximum(rates[best][common] / region.per_weight[common], 0.0) * exposed[k]
            noise = light_and_camera.variance(self.camera, charge) * region.per_weight[common] ** 2
            u_level[k] = math.sqrt(float(noise.sum())) / max(float(rates[best][common].sum()) * exposed[k], 1e-300)
        told = np.array([bool((use & usable[best]).any()) for use in usable])
        shares = np.where(told, exposed, 0.0) / max(float(exposed[told].sum()), 1e-300)
        return [
            Lit(frame, fulls[k], spread, float(exposed[k] * level[k]), float(u_level[k]), float(shares[k]))
            for k, ((_, frame), spread) in enumerate(zip(whole, spreads, strict=True))
            if told[k]
        ]

    def _signal(
        self, frame: Frame, full_dn: float, spread: SpreadLight | None, rows: slice, cols: slice
    ) -> tuple[Floats, Floats]:
        """Electrons of the light in a rectangle, and raw levels as fractions of full scale."""
        camera = self.camera
        values = linear_dn(camera, frame.mosaic[rows, cols]).astype(float)
        dark = self.dark.of(rows, cols, frame.exposure_s)
        linear, _ = without_dark(camera, values, dark, frame.black_level_dn)
        if spread is not None:
            at = np.meshgrid(*(np.arange(s.start, s.stop, s.step) for s in (rows, cols)), indexing="ij")
            linear = linear - spread.at(at[0].ravel(), at[1].ravel())[0].reshape(linear.shape)
        levels = (values - frame.black_level_dn) / full_dn
        return linear * camera.electrons_per_dn, levels

    def _strip(self, point: MapPoint, taken: list[Lit], lattice: Lattice, rows: slice, cols: slice) -> npt.NDArray[Any]:
        """Some rows of a picture."""
        height, width = lattice.size(self.camera)
        around = (
            slice(max(rows.start - REACH, 0), min(rows.stop + REACH, height)),
            slice(max(cols.start - REACH, 0), min(cols.stop + REACH, width)),
        )
        inside = tuple(slice(s.start - a.start, s.stop - a.start) for s, a in zip((rows, cols), around, strict=True))
        on_sensor = lattice.of(*around)
        merged = self._merged(taken, on_sensor)
        rate, variance, flag = (each[inside] for each in merged)
        span = lattice.of(rows, cols)
        seen = pixel_map(self.description, point.view, *(slice(s.start, s.stop) for s in span))
        every = (slice(None, None, lattice.pitch),) * 2
        weight = seen.weight[every]
        dim = (seen.lit[every] < 1.0) | (seen.cos_theta_i[every] <= 0.0) | (weight <= 0.0)
        flag = flag | np.where(dim, SHADOWED, 0) | np.where(seen.sees_plane[every], 0, OUTSIDE)
        prnu: float | Floats = self.camera.prnu
        maps = self.frames.maps
        if maps is not None:
            weight = weight * maps.responsivity[span]
            prnu = maps.u_responsivity[span].astype(float)
            flag = flag | np.where(maps.defects[span], HOT, 0)
        out = np.zeros(rate.shape, PIXEL)
        with np.errstate(divide="ignore", invalid="ignore"):
            value = rate / (weight * point.level)
            u = np.sqrt(variance / (weight * point.level) ** 2 + (value * prnu) ** 2)
        bad = (flag != 0) | ~np.isfinite(value)
        out["brdf"], out["u"] = np.where(bad, np.nan, value), np.where(bad, np.nan, u)
        out["flag"] = np.where(bad & (flag == 0), SHADOWED, flag)
        return out

    def _merged(self, taken: list[Lit], span: tuple[slice, slice]) -> tuple[Floats, Floats, Ints]:
        """The rate [e-/s] of every pixel of a rectangle over its frames, its variance, and flags."""
        camera = self.camera
        found = [self._signal(lit.frame, lit.full_dn, lit.spread, *span) for lit in taken]
        electrons, levels = np.stack([f[0] for f in found]), np.stack([f[1] for f in found])
        seconds = np.array([lit.effective_s for lit in taken])[:, None, None]
        exposed = np.array([lit.frame.exposure_s for lit in taken])[:, None, None]
        dark_rate = np.maximum(self.dark.rate(*span), camera.dark_current_e_per_s)
        bright = (_beside(levels) >= merging.usable(camera)) | (levels >= SATURATED)
        used, rates = ~bright, electrons / seconds
        limit = math.log(2.0 * max(used.size, 1) / merging.FALSE_ALARMS)
        for _ in range(2 if merging.noise_is_known(self.description) and len(taken) > 1 else 0):
            hit = _hits(camera, rates, seconds, used, limit)
            if not hit.any():
                break
            used = used & ~hit
        weights, noise = _weights(camera, electrons, seconds, exposed, dark_rate, used)
        total = weights.sum(axis=0)
        shares = weights / np.where(total > 0, total, 1.0)
        rate = (shares * rates).sum(axis=0)
        variance = (shares**2 * noise / seconds**2).sum(axis=0)
        variance += self._common(taken, shares, rate)
        excess = dark_rate - max(self.dark.usual_rate, camera.dark_current_e_per_s)
        longest, of_darks = float(exposed.max()), float(self.dark.darks.exposures_s.max())
        hot = (excess * longest > merging.HOT * camera.saturation_e) | (
            excess * of_darks > USABLE * camera.saturation_e
        )
        flag = np.where(hot, HOT, 0) + np.where(bright.all(axis=0), FULL, 0)
        flag = np.where((total <= 0) & (flag == 0), HOT, flag)
        return rate, variance, flag

    def _common(self, taken: list[Lit], shares: Floats, rate: Floats) -> Floats:
        """Variance of a pixel by what its frames share: the noise of its dark frames, and the levels of the lamp."""
        camera, darks = self.camera, self.dark.darks
        charge = camera.dark_current_e_per_s * darks.exposures_s
        lines = np.array([darks.leverage(lit.frame.exposure_s) / lit.effective_s for lit in taken])
        out = np.zeros(rate.shape)
        for line, noise in zip(lines.T, light_and_camera.variance(camera, charge), strict=True):
            out += np.tensordot(line, shares, 1) ** 2 * noise
        for lit, share in zip(taken, shares, strict=True):
            out += ((share - lit.weight) * lit.u_level * rate) ** 2
        return out


def _strips(rows: int, cols: int) -> Iterator[slice]:
    """Rows that are worked on at once."""
    step = max(1, STRIP // max(cols, 1))
    return (slice(top, min(top + step, rows)) for top in range(0, rows, step))


def _box_mean(values: Floats, side: int) -> Floats:
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(values, (1, side, side), mode="nearest"))


def _beside(levels: Floats) -> Floats:
    """The mean of the neighbours of each pixel in each frame; without itself, whose noise must not choose."""
    count = (2 * BESIDE + 1) ** 2
    return np.asarray((_box_mean(levels, 2 * BESIDE + 1) * count - levels) / (count - 1))


def _weights(
    camera: Camera, electrons: Floats, seconds: Floats, exposed: Floats, dark_rate: Floats, used: Bools
) -> tuple[Floats, Floats]:
    """Inverse variances of the rates of each frame, 0 where it is not used; and the variance of its charge [e-^2].

    The charge that noise comes from is that of all used frames, and of the pixels next to it: what is dark by chance
    gets no larger weight.
    """
    time = np.where(used, seconds, 0.0).sum(axis=0)
    charge = np.where(used, electrons, 0.0).sum(axis=0)
    near = _box_mean(np.stack([charge, time]), 3)
    expected = np.maximum(near[0], 0.0) / np.maximum(near[1], 1e-300)
    noise = light_and_camera.variance(camera, expected * seconds + dark_rate * exposed)
    return np.where(used, seconds**2 / np.maximum(noise, 1e-12), 0.0), noise


def _hits(camera: Camera, rates: Floats, seconds: Floats, used: Bools, limit: float) -> Bools:
    """Pixels that are brighter in a frame than the other frames allow, as cosmic radiation leaves them."""
    time = np.where(used, seconds, 0.0)
    rest = time.sum(axis=0) - time
    safe = np.where(rest > 0.0, rest, 1.0)
    others = ((time * rates).sum(axis=0) - time * rates) / safe
    more = seconds * (rates - others)
    # the bound is larger than sqrt(2 limit variance): only what exceeds that of the photons is looked at
    shot = np.maximum(others, 0.0) * seconds if camera.photon_noise else 0.0
    found = used & (rest > 0.0) & (more > 0.0) & (more**2 > 2.0 * limit * shot)
    if found.any():
        charge, length, part = np.maximum(others[found], 0.0), np.broadcast_to(seconds, found.shape)[found], safe[found]
        variance = light_and_camera.variance(camera, charge * length)
        variance += light_and_camera.variance(camera, charge * part) * (length / part) ** 2
        found[found] = more[found] > bound(variance, limit)
    return np.asarray(found)
