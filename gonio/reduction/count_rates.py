"""Raw frames to rates: electrons a second from the region of interest, with their variance.

The formulas are explained in docs/radiometry.md, sections 1 to 3.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import numpy.typing as npt

from gonio.acquisition.exposure import full_scale_dn
from gonio.acquisition.records import FrameRecord, StepRecord
from gonio.disk import read_file
from gonio.errors import DamagedFrame, DataError
from gonio.geometry import Directions
from gonio.reduction.dark_signal import FEW, PATTERNS, Darks, Patterns
from gonio.reduction.geometry_errors import GeometryErrors
from gonio.rig import Frame, Pose, Target, kinematics
from gonio.rig.description import Band, Camera, RigDescription
from gonio.rig.dng import read_raw
from gonio.rig.imaging import Channel, Roi, pixel_map, roi
from gonio.typing import Floats

if TYPE_CHECKING:
    from gonio.acquisition.run import Run

In = TypeVar("In")
Out = TypeVar("Out")

USABLE = 0.95
"""A frame whose brightest used pixel lies above this fraction of full scale is not used at all: dropping single pixels,
or frames that are only nearly full, would keep the darker half of the noise."""
THREADS = 2
RETAKE = "`gonio measure ... --resume` takes their steps again"


@dataclass(frozen=True, slots=True)
class Region:
    """What the frames of one step and band are averaged over."""

    roi: Roi
    target: Target
    per_weight: Floats
    """1 / (falloff cos(theta_i) (d0/d)^2) of the used pixels."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame, reduced to its region."""

    rate: float
    """Electrons a second, over the known geometry."""
    exposure_s: float
    time_s: float
    peak: float
    """Brightest used pixel, as a fraction of full scale."""
    leverage: Floats
    """Of the dark frames: `Darks.leverage`."""


@dataclass(frozen=True, slots=True)
class Reduced:
    """The frames of one step and band, merged to a rate."""

    rate: float
    variance: float
    """Of everything that is independent from step to step, the pixels' responsivities left out."""
    dark: Floats
    """Change of the rate for one standard deviation of the noise of the shorter and of the longer dark frames in each
    of the patterns that points share (`dark_signal.Patterns`), shape (2, n); zero for a visit to the reference."""
    time_s: float
    chi_square: float
    """Of the frames around their mean."""
    frames: int
    pixels: int
    shared: int
    """How many of the pixels the first visit to the reference uses too."""
    directions: Directions
    pose: Pose
    point: int | None
    """Row of the plan; None for a visit to the reference."""


@dataclass(frozen=True, slots=True)
class Rejected:
    """A step that gives no rate in a band."""

    point: int | None
    """Row of the plan; None for a visit to the reference."""
    flag: str
    """Why."""


class RunFrames:
    """The frames of a run, and what all of its bands share: what each step looks at, and the dark signal there."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self.damaged: dict[str, str] = {}
        """What is wrong with frames that were left out, by their names."""
        self.description: RigDescription = run.description
        self.points: list[int | None] = []
        """What each of `steps` looks at: a point, or None for the reference."""
        self.flags: dict[int, str] = {}
        """Of points without frames."""
        self.lost_visits: list[str] = []
        """The flags of the visits to the reference without frames."""
        dark: list[FrameRecord] = []
        self.geometry = GeometryErrors(run.description)
        self._every = run.steps()
        for step in self._every:
            if step.kind == "dark":
                dark += step.frames
            elif not step.flag:
                self.points.append(step.point)
            elif step.point is not None:
                self.flags[step.point] = step.flag
            else:
                self.lost_visits.append(step.flag)
        channels = dict.fromkeys(band.channel for band in run.bands)
        boxes: dict[Target, tuple[slice, slice]] = {}
        self.reference: dict[str, Roi] = {}
        regions: dict[Channel, list[Roi]] = {channel: [] for channel in channels}
        seen = dict.fromkeys(channels, 0)
        spacing = -(-len(self.points) // FEW)
        for step in self.steps():
            for channel in channels:
                region = self._region(step, channel)
                if region is not None:
                    boxes[region.target] = _around(region.roi, boxes.get(region.target))
                    if region.target == "reference":
                        self.reference.setdefault(channel, region.roi)
                    else:
                        if seen[channel] % spacing == 0:
                            regions[channel].append(region.roi)
                        seen[channel] += 1
        if not boxes:
            raise DataError(f"{run.path}: no point was measured in this run; finish it with --resume")
        box = boxes.get("sample", (slice(0, 0), slice(0, 0)))
        self._patterns = {channel: Patterns(regions[channel], box) for channel in channels}
        self.clipped = 0.0
        """The part of the used pixels that read 0 DN in the dark frames."""
        self.darks_taken = self.darks_used = 0
        """How many exposures the dark frames were taken with, and of how many some are left."""
        self._darks = self._read_darks(dark, boxes)

    def steps(self) -> Iterator[StepRecord]:
        """The steps with frames of point or reference, each read when it is asked for: a run may have very many."""
        return (step for step in self._every if step.kind != "dark" and not step.flag)

    def _region(self, step: StepRecord, channel: Channel) -> Region | None:
        """The region of a step; None where the source stands below the horizon, or the camera on the
        other side of the sample than it should."""
        target: Target = "reference" if step.kind == "reference" else "sample"
        view = kinematics.view(self.description, step.pose)
        if kinematics.left_its_side(self.description, step.goal, step.pose):
            return None
        region = roi(self.description, view, target, channel)
        seen = pixel_map(self.description, view, region.rows, region.cols)
        weight = seen.weight[region.mask]
        return Region(region, target, 1.0 / weight) if weight.min() > 0 else None

    def _read_darks(self, frames: list[FrameRecord], boxes: dict[Target, tuple[slice, slice]]) -> dict[Target, Darks]:
        if not frames:
            raise DataError(f"{self.run.path}: the run has no dark frames; finish it with --resume")
        camera = self.description.camera
        crops: dict[Target, list[tuple[float, npt.NDArray[np.uint16]]]] = {target: [] for target in boxes}
        for frame in in_threads(self._read_or_note, frames):
            if frame is not None:
                for target, box in boxes.items():
                    crops[target].append((frame.exposure_s, frame.mosaic[box].copy()))
        if not all(crops.values()):
            raise DataError(f"{self.run.path}: every dark frame is missing or damaged ({self._first()}); {RETAKE}")
        used = {exposure_s for taken in crops.values() for exposure_s, _ in taken}
        self.darks_taken, self.darks_used = len({float(frame.exposure_s) for frame in frames}), len(used)
        empty = [float(np.mean(crop == 0)) for taken in crops.values() for _, crop in taken]
        self.clipped = sum(empty) / len(empty)
        rate = camera.dark_current_e_per_s / camera.electrons_per_dn
        return {target: Darks(crops[target], *box, rate) for target, box in boxes.items()}

    def read(self, entry: FrameRecord) -> Frame:
        """A frame that the journal names, checked."""
        path = Path(self.run.frame_path(entry.file))
        try:
            data = read_file(path)
        except OSError as error:
            raise DamagedFrame(f"{path}: a frame of the run cannot be read: {error.strerror or error}") from None
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise DamagedFrame(
                f"{path}: is not the frame that the journal names (its checksum differs): it was changed"
            )
        frame = read_raw(path, data)
        camera = self.description.camera
        if frame.mosaic.shape != (camera.height, camera.width) or frame.pattern != camera.pattern:
            raise DataError(
                f"{path}: holds {frame.mosaic.shape[1]} x {frame.mosaic.shape[0]} pixels ({frame.pattern}); "
                f"the rig file has camera.width = {camera.width}, camera.height = {camera.height}, "
                f"camera.pattern = {camera.pattern}"
            )
        return frame

    def _read_or_note(self, entry: FrameRecord) -> Frame | None:
        """A frame that the journal names, or None where it is missing or damaged."""
        try:
            return self.read(entry)
        except DamagedFrame as error:
            self.damaged[entry.file] = str(error)
            return None

    def _first(self) -> str:
        return next(iter(self.damaged.values()), "")

    def shots(self, step: StepRecord, band: Band) -> tuple[Region, list[Shot]] | None:
        """The frames of a step in a band, each reduced to its region, without those that are damaged; None for a
        region below the horizon.
        """
        region = self._region(step, band.channel)
        if region is None:
            return None
        read = ((entry, self._read_or_note(entry)) for entry in _lit(step, band))
        return region, [self._shot(region, frame, float(entry.time_s)) for entry, frame in read if frame is not None]

    def _shot(self, region: Region, frame: Frame, time_s: float) -> Shot:
        camera, darks = self.description.camera, self._darks[region.target]
        values = region.roi.of(frame.mosaic).astype(float)
        signal = (values - darks.of(region.roi, frame.exposure_s)) * camera.electrons_per_dn
        return Shot(
            rate=float(np.mean(signal * region.per_weight)) / frame.exposure_s,
            exposure_s=frame.exposure_s,
            time_s=time_s,
            peak=(float(values.max()) - frame.black_level_dn) / full_scale_dn(camera, frame),
            leverage=darks.leverage(frame.exposure_s),
        )

    def reduce(self, step: StepRecord, band: Band) -> Reduced | Rejected:
        """The rate of a step in a band, from its merged frames."""
        found = self.shots(step, band)
        if found is None:
            return Rejected(step.point, "below_horizon")
        region, taken = found
        named = [frame.file for frame in _lit(step, band)]
        # a point can be taken again; of a visit to the reference the frames that are left count
        if not self.damaged.keys().isdisjoint(named) and (step.kind == "point" or not taken):
            return Rejected(step.point, "damaged")
        shots = [shot for shot in taken if shot.peak < USABLE]
        if not shots:
            return Rejected(step.point, "saturated" if taken else "not_measured")
        rate, variance, time_s, chi_square, of_darks = pool(
            self.description, region, shots, self._darks[region.target].exposures_s
        )
        reference = self.reference.get(band.channel)
        share = self._patterns[band.channel].of(region.roi) if region.target == "sample" else np.zeros(PATTERNS)
        shared = np.outer(of_darks, share)
        return Reduced(
            rate=rate,
            variance=variance + max(float(np.sum(of_darks**2) - np.sum(shared**2)), 0.0),
            dark=shared,
            time_s=time_s,
            chi_square=chi_square,
            frames=len(shots),
            pixels=region.roi.count,
            shared=region.roi.shared(reference) if reference is not None else 0,
            directions=kinematics.directions(self.description, step.pose),
            pose=step.pose,
            point=step.point,
        )


def _lit(step: StepRecord, band: Band) -> list[FrameRecord]:
    """The frames of a step that were taken in a band, with the lamp lit."""
    return [frame for frame in step.frames if frame.band == band.name and frame.lamp]


def pool(
    description: RigDescription, region: Region, shots: list[Shot], dark_exposures_s: Floats
) -> tuple[float, float, float, float, Floats]:
    """The merged rate of a point's frames [e-/s], and what goes with it.

    That is its variance, the time of the merged frames, and the chi-square of the frames around their mean. Last comes
    the change of the rate for one standard deviation of the mean dark signal of the shorter and of the longer darks.
    Weights come from the pooled rate, not from each frame's own: a frame that is dark by chance gets no larger weight.
    """
    camera, lamp = description.camera, description.lamp
    exposure = np.array([shot.exposure_s for shot in shots])
    rates, times = np.array([shot.rate for shot in shots]), np.array([shot.time_s for shot in shots])
    count = region.per_weight.size
    mean_1, mean_2 = float(np.mean(region.per_weight)), float(np.mean(region.per_weight**2))
    read = camera.read_noise_e**2
    dark = camera.dark_current_e_per_s * exposure if camera.photon_noise else np.zeros(exposure.size)
    pooled = float(np.sum(rates * exposure) / np.sum(exposure))
    for _ in range(3):
        signal = max(pooled, 0.0)
        shot_noise = signal * mean_1 / exposure if camera.photon_noise else 0.0
        rounding = _rounding(camera, signal * exposure / mean_1, count)
        single = (read + dark) * mean_2 / exposure**2 + shot_noise
        variances = single / count + rounding * mean_2 / exposure**2 + (lamp.noise * signal) ** 2
        weights = (1.0 / variances) / np.sum(1.0 / variances)
        pooled = float(np.sum(weights * rates))
    # the dark frames are one and the same for all frames of the point
    charge = camera.dark_current_e_per_s * dark_exposures_s
    of_pixels = (read + (charge if camera.photon_noise else 0.0)) / count + _rounding(camera, charge, count)
    lines = np.array([shot.leverage for shot in shots])
    of_darks = np.zeros(2)
    of_darks[: charge.size] = -((weights / exposure) @ lines) * np.sqrt(of_pixels * mean_2)
    chi_square = float(np.sum((rates - pooled) ** 2 / variances))
    return pooled, float(1.0 / np.sum(1.0 / variances)), float(np.sum(weights * times)), chi_square, of_darks


def _rounding(camera: Camera, electrons: Floats, count: int) -> Floats:
    """Variance [e-^2] of the mean of `count` pixels of about `electrons` each, from rounding to whole DN.

    Pixels round independently where they differ by half a DN or more, from noise or by nature (Widrow's condition: the
    remaining error is below 0.3 % of a DN). Pixels that are all alike round alike.
    """
    spread = camera.read_noise_e**2 + camera.dsnu_e**2 + (camera.prnu * electrons) ** 2
    if camera.photon_noise:
        spread = spread + electrons
    step = camera.electrons_per_dn**2
    return step / 12.0 / np.where(spread >= 0.25 * step, count, 1)


def _around(region: Roi, box: tuple[slice, slice] | None) -> tuple[slice, slice]:
    """The smallest rectangle around a region and a rectangle."""
    if box is None:
        return region.rows, region.cols
    rows, cols = box
    return (
        slice(min(region.rows.start, rows.start), max(region.rows.stop, rows.stop)),
        slice(min(region.cols.start, cols.start), max(region.cols.stop, cols.stop)),
    )


def in_threads(work: Callable[[In], Out], items: Iterable[In]) -> Iterator[Out]:
    """`map` in two threads, in order, a few items ahead: decoding a frame releases the interpreter."""
    with ThreadPoolExecutor(THREADS, thread_name_prefix="gonio-reduce") as pool:
        waiting = []
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > 2 * THREADS:
                    yield waiting.pop(0).result()
            for future in waiting:
                yield future.result()
        finally:
            for future in waiting:
                future.cancel()
