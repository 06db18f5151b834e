"""How long a run takes on its rig: travel, frames, visits to the reference, darks.

Everything follows from the rig file: speeds, the side from which axes approach, the sensor's data sheet. What a run has
really taken corrects it (`gonio.acquisition.remaining`).
"""

import contextlib
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass

import numpy as np

from gonio.acquisition import exposure
from gonio.acquisition.schedule import EXPECTED_ALBEDO
from gonio.rig import Pose, Step
from gonio.rig.bands import Band
from gonio.rig.description import RigDescription
from gonio.rig.motion_planning import Blocked, route
from gonio.typing import Floats

SETTLE_S = 0.2
"""From the end of a move until the axes are known to stand still."""
SAME_PLACE = math.radians(1e-6)
"""An axis this close to its goal stays where it is: far below an encoder's step."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What the time of a run goes into [s]."""

    travel_s: float = 0.0
    """Every move, those to the reference and back included."""
    frames_s: float = 0.0
    """Frames of points, with metering and overhead."""
    reference_s: float = 0.0
    """Frames of visits to the white reference."""
    dark_s: float = 0.0
    warm_up_s: float = 0.0
    """Of the lamp, before the first step."""

    @property
    def total_s(self) -> float:
        """Their sum."""
        return math.fsum(astuple(self))

    def __add__(self, other: "Parts") -> "Parts":
        return Parts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


class Durations:
    """How long moves and steps take on a rig, by its rig file.

    Prompts, waits of `[suspend]`, and swapping a reference by hand are not in it.

    Parameters
    ----------
    description
        The rig.
    bands
        Those that every point is measured in.
    """

    def __init__(self, description: RigDescription, bands: Sequence[Band]) -> None:
        self.description, self.bands = description, tuple(bands)
        self.detours = description.looks_ahead
        """Whether a move may have to go by other poses, around bodies or where a cable would be torn."""
        axes, approach, limits = description.axes(), description.approach_deg(), description.limits_deg()
        self._names = tuple(axes)
        self.speed = np.radians([axis.speed_deg_per_s for axis in axes.values()])
        self.approach = np.radians([approach[name] for name in axes])
        self.limits = np.radians([limits[name] for name in axes]).T

    # ---- moves ----

    def move_s(self, start: Pose, goal: Pose) -> float:
        """Duration of a move [s], by the poses that the bodies of the rig file force it to go by.

        Where there is no free way it is that of the direct one: such a step is flagged, and nobody moves.
        """
        stations = [start, goal]
        if self.detours and start != goal:
            with contextlib.suppress(Blocked):
                stations = [start, *route(self.description, start, goal)]
        return self._direct_way_s(stations)

    def way_s(self, stations: Sequence[Pose]) -> float:
        """Duration of the moves from each of some poses to the next [s], as `move_s`."""
        if self.detours:
            return math.fsum(self.move_s(a, b) for a, b in itertools.pairwise(stations))
        return self._direct_way_s(stations)

    def _direct_way_s(self, stations: Sequence[Pose]) -> float:
        angles = self.angles(stations)
        return float(self.direct_s(angles[:-1], angles[1:]).sum())

    def moves_s(self, start: Pose, goals: Sequence[Pose]) -> Floats:
        """Durations [s] of the direct moves from one pose to each of many; ways around bodies are not looked for."""
        return self.direct_s(self.angles([start]), self.angles(goals))

    def angles(self, poses: Iterable[Pose]) -> Floats:
        """The angles of the rig's axes [rad] of poses, shape (poses, axes)."""
        names = self._names
        return np.array([[getattr(pose, name) for name in names] for pose in poses]).reshape(-1, len(names))

    def direct_s(self, starts: Floats, goals: Floats) -> Floats:
        """Durations [s] of direct moves between `angles`, arrays that broadcast.

        All axes move at once, twice: first those that stand beyond the place where their approach begins go there, then
        all go to their goals. An axis that stands at its goal stays.
        """
        begin = approach_starts(goals, self.approach, self.limits)
        moving = np.abs(goals - starts) > SAME_PLACE
        back = moving & ((starts - begin) * np.sign(self.approach) > SAME_PLACE)
        first = np.where(back, np.abs(begin - starts) / self.speed, 0.0).max(axis=-1)
        second = np.where(moving, np.abs(goals - np.where(back, begin, starts)) / self.speed, 0.0).max(axis=-1)
        return np.asarray(first + second + SETTLE_S * moving.any(axis=-1) + SETTLE_S * back.any(axis=-1))

    # ---- frames ----

    def frames_s(self, step: Step, reflectance: float | Mapping[str, float] | None = None) -> float:
        """Duration of the frames of a step in all bands [s], metering and overhead included.

        Parameters
        ----------
        step
            Of any kind.
        reflectance
            Of a point: its reflectance factor, pi times its BRDF, alike in all bands or by a band's name; by default
            `EXPECTED_ALBEDO`.
        """
        acquisition, overhead = self.description.acquisition, self.description.camera.frame_overhead_s
        if step.kind == "dark":
            return sum(acquisition.dark_frames * (t + overhead) for t in exposure.dark_exposures_s(self.description))
        if step.kind == "reference":
            return len(self.bands) * self._band_s(step, 1.0)
        if isinstance(reflectance, Mapping):
            return math.fsum(self._band_s(step, reflectance[band.name]) for band in self.bands)
        return len(self.bands) * self._band_s(step, EXPECTED_ALBEDO if reflectance is None else float(reflectance))

    def _band_s(self, step: Step, reflectance: float) -> float:
        """In one band."""
        description, reference = self.description, self.description.reference
        acquisition, overhead = description.acquisition, description.camera.frame_overhead_s
        reflectance = max(reflectance, 1e-9)
        if acquisition.u_rel_target is not None:
            planned = exposure.expected_bracket(description, step.pose, reflectance)
            metering = 1.25 * exposure.expected_exposure_s(description, step.pose, reflectance)
            return metering + sum(planned) + (len(planned) + 1) * overhead
        one = exposure.expected_exposure_s(description, step.pose, reflectance)
        if step.kind == "point":
            return (acquisition.frames + 1.25) * one + (acquisition.frames + 2) * overhead
        if reference.how == "beam":
            shortest = description.camera.exposure_limits_s[0]
            one = max(acquisition.exposure_target / exposure.expected_straight_level_per_s(description), shortest)
        return (reference.frames + 1) * (one + overhead)

    def frames(self, step: Step) -> int:
        """How many frames of a step are kept, in all bands; metering frames are not."""
        acquisition = self.description.acquisition
        if step.kind == "dark":
            return acquisition.dark_frames * len(exposure.dark_exposures_s(self.description))
        if acquisition.u_rel_target is not None:
            albedo = 1.0 if step.kind == "reference" else EXPECTED_ALBEDO
            return len(self.bands) * len(exposure.expected_bracket(self.description, step.pose, albedo))
        each = self.description.reference.frames if step.kind == "reference" else acquisition.frames + 1
        return len(self.bands) * each

    # ---- steps ----

    def step(self, here: Pose, step: Step, reflectance: float | Mapping[str, float] | None = None) -> Parts:
        """What a step takes, from a pose; parameters as in `frames_s`."""
        frames_s = self.frames_s(step, reflectance)
        if step.kind == "dark":
            return Parts(dark_s=frames_s)
        part = "reference_s" if step.kind == "reference" else "frames_s"
        return Parts(**{"travel_s": self.move_s(here, step.pose), part: frames_s})

    def step_s(self, here: Pose, step: Step, reflectance: float | Mapping[str, float] | None = None) -> float:
        """How long a step takes, from a pose [s]; parameters as in `frames_s`."""
        return self.step(here, step, reflectance).total_s

    def parts(self, steps: Iterable[Step], here: Pose | None = None) -> Parts:
        """What a sequence of steps takes, with the lamp's warm-up before it.

        `here` is where the axes stand before (all at 0).
        """
        stations, seconds = [here or Pose()], {"point": 0.0, "reference": 0.0, "dark": 0.0}
        for step in steps:
            seconds[step.kind] += self.frames_s(step)
            if step.kind != "dark":
                stations.append(step.pose)
        warm_up_s = self.description.lamp.warm_up_s
        return Parts(self.way_s(stations), seconds["point"], seconds["reference"], seconds["dark"], warm_up_s)

    def total_s(self, steps: Iterable[Step], here: Pose | None = None) -> float:
        """How long a sequence of steps takes [s], with the lamp's warm-up before it."""
        return self.parts(steps, here).total_s


def approach_starts(goals: Floats, approach: Floats, limits: Floats) -> Floats:
    """Where the last part of the way to goals begins [rad]: `approach` off them, inside the limits (shape (2, axes)).

    `RigDescription.approach_starts_deg` of many at once.
    """
    off = goals - approach
    below, above = np.maximum(off, np.minimum(limits[0], goals)), np.minimum(off, np.maximum(limits[1], goals))
    return np.asarray(np.where(approach > 0.0, below, above))
