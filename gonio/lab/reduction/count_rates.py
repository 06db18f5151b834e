"""Raw frames to rates: electrons a second from the region of interest, with their variance.

The formulas are explained in docs/radiometry.md, sections 1 to 3.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from numbers import Real
from pathlib import Path

import numpy as np

from gonio.disk import read_file
from gonio.errors import ContradictoryFrame, DamagedFrame, DataError, os_error_as
from gonio.lab.acquisition.exposure import USABLE, contradiction, full_scale_dn
from gonio.lab.acquisition.frame_writer import label_of
from gonio.lab.acquisition.records import FrameRecord, StepRecord
from gonio.lab.acquisition.repeats import FramePixels, repeated, some_rows_sha256
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import merging, stray_light
from gonio.lab.reduction.dark_signal import FEW, PATTERNS, Darks, Patterns, u_black
from gonio.lab.reduction.geometry_errors import GeometryErrors
from gonio.lab.reduction.merging import Region, Shot, pool, pool_pixels
from gonio.lab.reduction.step_rates import Reduced, Rejected
from gonio.lab.rig import Frame, Target, kinematics
from gonio.lab.rig.calibration_files import known_parameters
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.dng import read_raw
from gonio.lab.rig.imaging import Channel, pixel_map
from gonio.lab.rig.light_and_camera import Band, Camera, by_coefficients, linear_dn, read_maps, straightened
from gonio.lab.rig.polariser_axes import throughput
from gonio.lab.rig.regions import Roi, filling, per_weight, roi, straight_through_weight
from gonio.threads import in_threads
from gonio.typing import Array, Bools, DataFrame, Floats

Dark = tuple[float, Array]
"""Exposure [s] and mosaic [DN] of a dark frame."""

FULL = 1e-3
"""Part of a frame's pixels that may be full: with more of them stray light is estimated too low."""
RETAKE = "`gonio measure ... --resume` takes their steps again"


def camera_parameters(description: RigDescription) -> dict[str, str]:
    """What values depend on in the camera beside its noise: numbers of the rig file, and the cause that each is of."""
    camera = description.camera
    out = {f"camera.nonlinearity[{k}]": "s_linearity" for k in range(len(camera.nonlinearity))}
    known = known_parameters(description)
    strays = {"camera.stray_light": camera.stray_light, "camera.stray_halo": camera.stray_halo}
    return out | {name: "s_stray_light" for name, value in strays.items() if value or name in known}


class RunFrames:
    """The frames of a run, and what all of its bands share: what each step looks at, and the dark signal there.

    Parameters
    ----------
    run
        A run, complete or not.
    steps : sequence of StepRecord, optional
        Some of its steps, dark ones among them, in place of all: the run is being measured. Others can be reduced if
        they look where the dark signal is known then (`knows`).
    spare
        Around what these steps look at, the dark signal is kept for so much more of the sensor, as a part of its size.
    """

    def __init__(self, run: Run, steps: Sequence[StepRecord] | None = None, spare: float = 0.0) -> None:
        self.run = run
        self.damaged: dict[str, str] = {}
        """What is wrong with frames that were left out, by their names."""
        self.contradictory: dict[str, str] = {}
        """The same of frames that are whole, and say of themselves what cannot be."""
        self.description: RigDescription = run.description
        self.points: list[int | None] = []
        """What each of `steps` looks at: a point, or None for the reference."""
        self.flags: dict[int, str] = {}
        """By point without frames: its flag."""
        self.lost_visits: list[str] = []
        """The flags of the visits to the reference without frames."""
        self.geometry = GeometryErrors(run.description)
        self._pictures = FramePixels(run.description.camera)
        self._every = run.steps() if steps is None else steps
        darks: list[tuple[StepRecord, FrameRecord]] = []
        for step in self._every:
            if step.kind == "dark":
                darks += [(step, frame) for frame in step.frames]
                continue
            if not step.flag:
                self.points.append(step.point)
            elif step.point is not None:
                self.flags[step.point] = step.flag
            else:
                self.lost_visits.append(step.flag)
        self.usual = self._mean_of_monitor()
        """Mean reading of the lamp's monitor: rates are those of a lamp at which it reads this."""
        camera = self.description.camera
        size = camera.height, camera.width
        self.maps = read_maps(camera.maps, size) if camera.maps is not None else None
        self._parameters = tuple(camera_parameters(self.description))
        self.spreads = any(name.startswith("camera.stray") for name in self._parameters)
        self._channels = tuple(dict.fromkeys(band.channel for band in run.bands))
        self.reference: dict[str, Roi] = {}
        """The region of the first visit, by channel."""
        boxes, regions = self._looked_at()
        self._boxes = {target: _widened(box, spare, size) for target, box in boxes.items()} if spare else boxes
        box = self._boxes.get("sample", (slice(0, 0), slice(0, 0)))
        self._patterns = {channel: Patterns(regions[channel], box) for channel in self._channels}
        for first in self.reference.values():
            box = _around(first, box)
        self._responsivities = {
            channel: Patterns(regions[channel], box, self.reference[channel])
            for channel in self._channels if channel in self.reference
        }  # fmt: skip
        self.clipped = 0.0
        """The part of the used pixels that read 0 DN in the dark frames."""
        self.full = 0.0
        """The largest part of a used frame's pixels that are full, where the light that frames spread is taken out."""
        self._dark_means: dict[str, tuple[float, float]] = {}
        self.darks_taken = self.darks_used = 0
        """How many exposures the dark frames were taken with, and of how many some are left."""
        self.dark_hits = 0
        """Pixels of dark frames that were hit by cosmic radiation; where frames are merged by pixels."""
        self._darks = self._read_darks(darks)

    @cached_property
    def prnu(self) -> float:
        """Relative standard deviation of the pixels' responsivities, after maps where there are any."""
        if self.maps is None:
            return self.description.camera.prnu
        u = np.concatenate([self.maps.u_responsivity[box].ravel() for box in self._boxes.values()])
        return float(np.sqrt(np.mean(u.astype(float) ** 2)))

    @cached_property
    def plan(self) -> DataFrame:
        """`Run.plan`, made once."""
        return self.run.plan

    def _mean_of_monitor(self) -> float:
        if not self.description.lamp.monitor:
            return math.nan
        frames = (frame for step in self._every if step.kind != "dark" and not step.flag for frame in step.frames)
        readings = [frame.monitor for frame in frames if frame.lamp and frame.monitor is not None]
        if not readings:
            raise DataError(
                f"{self.run.path}: lamp.monitor = true, and no frame of the run has a reading of the lamp's monitor"
            )
        return sum(readings) / len(readings)

    def lamp(self, entry: FrameRecord) -> float:
        """The lamp's level in a frame by its monitor, relative to its mean; 1 without a monitor."""
        return entry.monitor / self.usual if self.description.lamp.monitor and entry.monitor else 1.0

    def _looked_at(self) -> tuple[dict[Target, tuple[slice, slice]], dict[Channel, list[Roi]]]:
        """What of the frames the steps look at, by target; and the regions of some points, by channel."""
        boxes: dict[Target, tuple[slice, slice]] = {}
        regions: dict[Channel, list[Roi]] = {channel: [] for channel in self._channels}
        seen = dict.fromkeys(self._channels, 0)
        spacing = -(-len(self.points) // FEW)
        for step in self.steps():
            for channel in self._channels:
                region = self.region(step, channel)
                if region is None:
                    continue
                boxes[region.target] = _around(region.roi, boxes.get(region.target))
                if region.target == "reference":
                    self.reference.setdefault(channel, region.lit)
                    continue
                if seen[channel] % spacing == 0:
                    regions[channel].append(region.roi)
                seen[channel] += 1
        if not boxes:
            raise DataError(f"{self.run.path}: no point was measured in this run; finish it with --resume")
        return boxes, regions

    def steps(self) -> Iterator[StepRecord]:
        """The steps with frames of point or reference, each read when it is asked for: a run may have very many."""
        return (step for step in self._every if step.kind != "dark" and not step.flag)

    def dark_frames(self) -> Iterator[tuple[StepRecord, FrameRecord]]:
        """The dark frames, each with its step."""
        return ((step, frame) for step in self._every if step.kind == "dark" for frame in step.frames)

    def knows(self, step: StepRecord) -> bool:
        """Whether the dark signal is known where a step looks."""
        regions = (self.region(step, channel) for channel in self._channels)
        boxes = ((region.roi, self._boxes.get(region.target)) for region in regions if region is not None)
        return all(box is not None and _around(roi, box) == box for roi, box in boxes)

    def region(self, step: StepRecord, channel: Channel) -> Region | None:
        """The region of a step; None where the source stands below the horizon, or the camera on the
        other side of the sample than it should."""
        target: Target = "reference" if step.kind == "reference" else "sample"
        rig, view = self.description, kinematics.view(self.description, step.pose)
        beam = target == "reference" and rig.reference.how == "beam"
        if not beam and kinematics.left_its_side(rig, step.goal, step.pose):
            return None
        region = roi(rig, view, target, channel)
        if beam:
            weighing = 1.0 / straight_through_weight(rig, view, region, channel)
            if self.maps is not None:  # none of the lamp's light may be left out, that on defects neither
                known = np.where(self.maps.defects, 1.0, self.maps.responsivity)
                weighing = weighing / region.of(known).astype(float)
            return Region(region, target, weighing, region)
        seen = pixel_map(rig, view, region.rows, region.cols)
        if self.maps is not None:
            region = _within(region, ~self.maps.defects[region.rows, region.cols])
        weighing = per_weight(rig, view, seen, region, channel)
        if self.maps is not None:
            weighing = weighing / np.asarray(region.of(self.maps.responsivity), dtype=float)
        lit = _within(region, seen.lit > 0.5) if filling(rig) == "under" else region
        return Region(region, target, weighing, lit) if math.isfinite(weighing.max()) else None

    def _read_darks(self, frames: list[tuple[StepRecord, FrameRecord]]) -> dict[Target, Darks]:
        if not frames:
            raise DataError(f"{self.run.path}: the run has no dark frames; finish it with --resume")
        camera, boxes = self.description.camera, self._boxes
        crops: dict[Target, list[Dark]] = {target: [] for target in boxes}
        means: list[tuple[float, list[float]]] = []

        def look(taken: tuple[StepRecord, FrameRecord]) -> tuple[float, list[Array], list[float]] | None:
            """Exposure [s], crops, and means of the channels of a dark frame, which is not kept."""
            frame = self.read_or_note(*taken)
            if frame is None:
                return None
            values = linear_dn(camera, frame.mosaic)
            of = (stray_light.planes(camera, values, channel) for channel in self._channels if self.spreads)
            own = [values[box].copy() for box in boxes.values()]
            return frame.exposure_s, own, [float(plane.mean(dtype=np.float64)) for plane in of]

        for exposure_s, own, of_channels in filter(None, in_threads(look, frames)):
            for target, crop in zip(boxes, own, strict=True):
                crops[target].append((exposure_s, crop))
            if self.spreads:
                means.append((exposure_s, of_channels))
        if not all(crops.values()):
            raise DataError(f"{self.run.path}: every dark frame is missing or damaged ({self._first()}); {RETAKE}")
        used = {exposure_s for taken in crops.values() for exposure_s, _ in taken}
        self.darks_taken, self.darks_used = len({float(frame.exposure_s) for _, frame in frames}), len(used)
        empty = [float(np.mean(crop == 0)) for taken in crops.values() for _, crop in taken]
        self.clipped = sum(empty) / len(empty)
        dark = {t: [crop.ravel() for taken in crops.values() for at, crop in taken if at == t] for t in sorted(used)}
        self._u_black = list(dark), [u_black(camera, np.concatenate(own)) for own in dark.values()]
        rate = camera.dark_current_e_per_s / camera.electrons_per_dn
        self._dark_means = _lines(means, self._channels, rate)
        if self.description.acquisition.by_pixels:
            crops = {target: self.without_hits(taken) for target, taken in crops.items()}
        return {target: Darks(crops[target], *box, rate) for target, box in boxes.items()}

    def without_hits(self, taken: list[Dark]) -> list[Dark]:
        """Dark frames without hits of cosmic radiation."""
        out: list[Dark] = []
        for exposure_s in dict.fromkeys(t for t, _ in taken):
            group = np.stack([mosaic for t, mosaic in taken if t == exposure_s])
            clean, hits = merging.without_hits(self.description.camera, group, self.description.camera.black_level_dn)
            self.dark_hits += hits
            out += [(exposure_s, mosaic) for mosaic in clean]
        return out

    def read(self, step: StepRecord, entry: FrameRecord) -> Frame:
        """A frame of a step that the journal names, checked."""
        path = Path(self.run.frame_path(entry.file))
        with os_error_as(DamagedFrame, f"{path}: a frame of the run cannot be read"):
            data = read_file(path)
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
        why = contradiction(camera, frame)
        if not why and not _alike(frame.exposure_s, entry.exposure_s):
            why = f"was exposed {frame.exposure_s:g} s, and the journal says exposure_s = {entry.exposure_s!r}"
        if not why and (label := label_of(path, data)) is not None:
            why = label.otherwise(self.run.key, step, entry)
        if why:
            raise ContradictoryFrame(f"{entry.file} {why}")
        self._pictures.add(some_rows_sha256(frame.mosaic), step.step, frame.exposure_s)
        return frame

    def require_no_repeats(self) -> None:
        """Raise `DataError` where frames that were read are the same picture, which noise makes impossible."""
        numbers = self._pictures.suspects
        found = repeated(self.run, (step for step in self._every if step.step in numbers)) if numbers else {}
        if found:
            texts = [text for number in sorted(found) for text in found[number]]
            raise DataError(
                f"{self.run.path}: step{'s' * (len(found) > 1)} {', '.join(map(str, sorted(found)))}: {texts[0]}. "
                f"Look after the camera; then `gonio run repair {self.run.path}` takes these steps out, and {RETAKE}"
            )

    def read_or_note(self, step: StepRecord, entry: FrameRecord) -> Frame | None:
        """A frame that the journal names, or None where it is missing or damaged."""
        try:
            return self.read(step, entry)
        except DamagedFrame as error:
            self.damaged[entry.file] = str(error)
        except ContradictoryFrame as error:
            self.contradictory[entry.file] = str(error)
        return None

    def _first(self) -> str:
        return next(iter((self.damaged | self.contradictory).values()), "")

    def shots(self, step: StepRecord, band: Band) -> tuple[Region, list[Shot]] | None:
        """The frames of a step in a band, each reduced to its region, without those that are damaged; None for a
        region below the horizon.
        """
        region = self.region(step, band.channel)
        if region is None:
            return None
        passes = throughput(self.description, step.pose, region.target, band.polarisation)
        if passes != 1.0:
            region = replace(region, per_weight=region.per_weight / passes)
        read = ((entry, self.read_or_note(step, entry)) for entry in lit_frames(step, band))
        return region, [self._shot(region, frame, entry, band.channel) for entry, frame in read if frame is not None]

    def _shot(self, region: Region, frame: Frame, entry: FrameRecord, channel: Channel) -> Shot:
        camera, darks = self.description.camera, self._darks[region.target]
        values = linear_dn(camera, region.roi.of(frame.mosaic)).astype(float)
        linear, by_camera = self._freed(region, frame, values, channel)
        gain, full = camera.electrons_per_dn, full_scale_dn(camera, frame)
        lamp, hidden = self.lamp(entry), float(np.interp(frame.exposure_s, *self._u_black))
        by_pixels = self.description.acquisition.by_pixels
        return Shot(
            rate=float(np.mean(linear * gain * region.per_weight)) / frame.exposure_s / lamp,
            exposure_s=frame.exposure_s,
            time_s=float(entry.time_s),
            peak=(float(values.max()) - frame.black_level_dn) / full,
            leverage=darks.leverage(frame.exposure_s),
            by_camera=np.mean(by_camera * (gain * region.per_weight), axis=1) / frame.exposure_s / lamp,
            lamp=lamp,
            hidden=hidden * gain * float(np.mean(region.per_weight)) / frame.exposure_s / lamp,
            electrons=linear * gain if by_pixels else None,
            levels=(values - frame.black_level_dn) / full if by_pixels else None,
        )

    def _freed(self, region: Region, frame: Frame, values: Floats, channel: Channel) -> tuple[Floats, Floats]:
        """Used pixels [DN] without dark signal, nonlinearity and spread light; derivatives by `camera_parameters`."""
        camera = self.description.camera
        dark = self._darks[region.target].of(region.roi, frame.exposure_s)
        linear, lit = without_dark(camera, values, dark, frame.black_level_dn)
        by_camera = np.zeros((len(self._parameters), linear.size))
        if camera.nonlinearity:
            by_camera[: len(camera.nonlinearity)] = by_coefficients(camera, lit)
        if self.spreads:
            added, by = self._stray(region, frame, channel)
            linear = linear - added
            strays = [name for name in self._parameters if name.startswith("camera.stray")]
            names = ["camera.stray_light", "camera.stray_halo"]
            by_camera[len(camera.nonlinearity) :] = -by[[names.index(name) for name in strays]]
        return linear, by_camera

    def _stray(self, region: Region, frame: Frame, channel: Channel) -> tuple[Floats, Floats]:
        """What the light that a frame spreads adds to the used pixels [DN], and its derivatives by the fractions."""
        place = region.roi
        rows, cols = np.nonzero(place.mask)
        return self.spread(frame, channel).at(rows + place.rows.start, cols + place.cols.start)

    def spread(self, frame: Frame, channel: Channel) -> stray_light.SpreadLight:
        """The light that a frame spreads."""
        camera = self.description.camera
        level, slope = self._dark_means[channel]
        values, dark = linear_dn(camera, frame.mosaic), level + slope * frame.exposure_s
        full = frame.black_level_dn + full_scale_dn(camera, frame)
        self.full = max(self.full, np.count_nonzero(values >= full) / values.size)
        if camera.nonlinearity:
            black = frame.black_level_dn
            values = straightened(camera, values - black)
            dark = float(straightened(camera, np.array(dark - black)))
        return stray_light.spread(camera, values, dark, channel)

    def _by_pixels(self, region: Region, channel: Channel) -> Floats:
        """`Reduced.by_pixels` of a region."""
        reference = self.reference.get(channel)
        out = np.zeros(1 + PATTERNS)
        if reference is not None and region.target == "sample":
            n, m = region.lit.count, reference.count
            out[0] = (region.lit.shared(reference) / n - 1.0) / math.sqrt(m)
            out[1:] = self._responsivities[channel].of(region.lit) / math.sqrt(n)
        return out

    def reduce(self, step: StepRecord, band: Band) -> Reduced | Rejected:
        """The rate of a step in a band, from its merged frames."""
        found = self.shots(step, band)
        if found is None:
            return Rejected(step.point, "below_horizon")
        region, taken = found
        lit = lit_frames(step, band)
        # a point can be taken again; of a visit to the reference the frames that are left count
        for flag, wrong in (("damaged", self.damaged), ("contradictory", self.contradictory)):
            if (step.kind == "point" or not taken) and any(frame.file in wrong for frame in lit):
                return Rejected(step.point, flag)
        if self.description.lamp.monitor and not all(frame.monitor for frame in lit):
            return Rejected(step.point, "unmonitored")
        if not taken:
            return Rejected(step.point, "not_measured")
        darks, shots = self._darks[region.target], taken
        if self.description.acquisition.by_pixels:
            merged = pool_pixels(self.description, region, shots, darks)
        else:
            shots = [shot for shot in taken if shot.peak < USABLE]
            merged = pool(self.description, region, shots, darks.exposures_s) if shots else None
        if merged is None:
            return Rejected(step.point, "saturated", len(taken))
        of_darks, weights = merged.of_darks, merged.frame_weights
        reference = self.reference.get(band.channel)
        share = self._patterns[band.channel].of(region.roi) if region.target == "sample" else np.zeros(PATTERNS)
        shared = np.outer(of_darks, share)
        variance = merged.variance + max(float(np.sum(of_darks**2) - np.sum(shared**2)), 0.0)
        return Reduced(
            merged=replace(merged, variance=variance),
            dark=shared,
            time_s=float(weights @ [shot.time_s for shot in shots]),
            left_out=len(taken) - merged.frames,
            pixels=region.lit.count,
            by_camera=weights @ np.array([shot.by_camera for shot in shots]),
            hidden=float(weights @ [shot.hidden for shot in shots]),
            shared=region.lit.shared(reference) if reference is not None else 0,
            by_pixels=self._by_pixels(region, band.channel),
            directions=kinematics.directions(self.description, step.pose),
            pose=step.pose,
            point=step.point,
        )


def without_dark(camera: Camera, values: Floats, dark: Floats, black_dn: float) -> tuple[Floats, Floats]:
    """The linear signal of pixels [DN] without their dark signal; and with it, above the black level.

    `values` and `dark` are what `linear_dn` gives.
    """
    if not camera.nonlinearity:
        return values - dark, values - black_dn
    lit = straightened(camera, values - black_dn)
    return lit - straightened(camera, dark - black_dn), lit


def _within(region: Roi, chosen: Bools) -> Roi:
    """A region without the pixels that are not chosen; all of it, where none is."""
    kept = region.mask & chosen
    return replace(region, mask=kept if kept.any() else region.mask)


def _alike(one: float, other: object) -> bool:
    """Whether two records of an exposure agree: files of other makers keep it to a few digits."""
    return isinstance(other, Real) and abs(one - float(other)) <= 1e-3 * one + 1e-6


def lit_frames(step: StepRecord, band: Band) -> list[FrameRecord]:
    """The frames of a step that were taken in a band, with the lamp lit."""
    return [frame for frame in step.frames if frame.band == band.name and frame.lamp]


def _lines(
    means: list[tuple[float, list[float]]], channels: tuple[Channel, ...], rate: float
) -> dict[str, tuple[float, float]]:
    """Level [DN] and slope [DN/s] of whole dark frames, by channel; `rate` is the slope that one exposure leaves."""
    if not means:
        return {}
    times = np.array([exposure_s for exposure_s, _ in means])
    out: dict[str, tuple[float, float]] = {}
    away = times - times.mean()
    spread = float(np.sum(away**2))
    for channel, values in zip(channels, np.array([of for _, of in means]).T, strict=True):
        slope = float(np.sum(away * values)) / spread if spread > 1e-6 * times.mean() ** 2 else rate
        out[channel] = float(values.mean()) - slope * float(times.mean()), slope
    return out


def _around(region: Roi, box: tuple[slice, slice] | None) -> tuple[slice, slice]:
    """The smallest rectangle around a region and a rectangle."""
    rows, cols = (
        slice(min(one.start, other.start), max(one.stop, other.stop))
        for one, other in zip((region.rows, region.cols), box or (region.rows, region.cols), strict=True)
    )
    return rows, cols


def _widened(box: tuple[slice, slice], part: float, size: tuple[int, int]) -> tuple[slice, slice]:
    """A rectangle with a part of its size more on each side, within the sensor."""
    more = [round(part * (side.stop - side.start)) for side in box]
    rows, cols = (
        slice(max(side.start - by, 0), min(side.stop + by, end)) for side, by, end in zip(box, more, size, strict=True)
    )
    return rows, cols
