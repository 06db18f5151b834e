"""How long a run takes on its rig: travel, frames, visits to the reference, darks.

Everything follows from the rig file: speeds, the side from which axes approach, the sensor's data sheet. What a run has
really taken corrects it (`gonio.lab.acquisition.progress`).

With `order = "short"` the points of a plan have an order in which the rig travels less. It is that of
plan.csv, so that a run goes on by the order that it was begun with.
"""

import contextlib
import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from typing import Any

import numpy as np

from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.plan import Assessed, Plan, Point
from gonio.lab.acquisition.schedule import EXPECTED_ALBEDO
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.motion_planning import Blocked, route
from gonio.typing import Floats, NDArray

SETTLE_S = 0.2
"""Time from the end of a move until the axes are known to stand still."""
SAME_PLACE = math.radians(1e-6)
"""An axis this close to its goal stays where it is: far below an encoder's step."""


@dataclass(frozen=True, slots=True)
class TimeParts:
    """What the time of a run goes into [s]."""

    travel_s: float = 0.0
    """Every move, those to the reference and back included."""
    frames_s: float = 0.0
    """Frames of points, with metering and overhead."""
    reference_s: float = 0.0
    """Frames of visits to the white reference."""
    dark_s: float = 0.0
    warm_up_s: float = 0.0
    """Time that the lamp warms up, before the first step."""

    @property
    def total_s(self) -> float:
        """Their sum."""
        return math.fsum(astuple(self))

    def __add__(self, other: "TimeParts") -> "TimeParts":
        return TimeParts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


def _acceleration_deg_per_s2(devices: Mapping[str, Any]) -> float:
    """Of every axis, as the table of the devices that turn them states it; infinite where none does."""
    stated = (table.get("acceleration_deg_per_s2") for table in devices.values() if isinstance(table, Mapping))
    return min((float(one) for one in stated if isinstance(one, int | float) and one > 0.0), default=math.inf)


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
        states = len({band.polarisation for band in self.bands})
        self._turns_s = states * description.polarisers.turn_s if states > 1 else 0.0
        self.speed = np.radians([axis.speed_deg_per_s for axis in axes.values()])
        self._ramp_s = self.speed / np.radians(_acceleration_deg_per_s2(description.devices))
        """What a way takes longer for starting and stopping, where full speed is reached."""
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
        return float(self._direct_legs_s(stations).sum())

    def way_s(self, stations: Sequence[Pose]) -> float:
        """Duration of the moves from each of some poses to the next [s], as `move_s`."""
        return float(self._legs_s(stations).sum())

    def _legs_s(self, stations: Sequence[Pose]) -> Floats:
        """Durations of the moves from each of some poses to the next [s]."""
        if self.detours:
            return np.array([self.move_s(a, b) for a, b in itertools.pairwise(stations)])
        return self._direct_legs_s(stations)

    def _direct_legs_s(self, stations: Sequence[Pose]) -> Floats:
        angles = self.angles(stations)
        return self.direct_s(angles[:-1], angles[1:])

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
        first = self._turn_s(np.where(back, begin - starts, 0.0))
        second = self._turn_s(np.where(moving, goals - np.where(back, begin, starts), 0.0))
        return np.asarray(first + second + SETTLE_S * moving.any(axis=-1) + SETTLE_S * back.any(axis=-1))

    def _turn_s(self, ways: Floats) -> Floats:
        """Duration [s] of ways that all axes (the last one of the shape) begin together: at rest, and again at rest."""
        at_full_s = np.abs(ways) / self.speed
        short_s = 2.0 * np.sqrt(at_full_s * self._ramp_s)
        return np.asarray(np.where(at_full_s < self._ramp_s, short_s, at_full_s + self._ramp_s).max(axis=-1))

    def beside_s(self, move_s: float) -> float:
        """How much of a move [s] passes while the last frame before it is read out."""
        return min(move_s, self.description.camera.readout_s)

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
        acquisition, overhead = self.description.acquisition, self.description.camera.beside_s
        if step.kind == "dark":
            return sum(acquisition.dark_frames * (t + overhead) for t in exposure.dark_exposures_s(self.description))
        if step.kind == "reference":
            reflectance = 1.0
        if isinstance(reflectance, Mapping):
            return math.fsum(self._band_s(step, reflectance[band.name]) for band in self.bands)
        reflectance = EXPECTED_ALBEDO if reflectance is None else float(reflectance)
        if not self.description.polarisers.sides():
            return len(self.bands) * self._band_s(step, reflectance)
        shares = (self.description.polarisers.passed(band.polarisation) for band in self.bands)
        return self._turns_s + math.fsum(self._band_s(step, reflectance * share) for share in shares)

    def _band_s(self, step: Step, reflectance: float) -> float:
        """In one band."""
        description, reference = self.description, self.description.reference
        acquisition, overhead = description.acquisition, description.camera.beside_s
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

    def step(self, here: Pose, step: Step, reflectance: float | Mapping[str, float] | None = None) -> TimeParts:
        """What a step takes, from a pose where another one was taken; parameters as in `frames_s`.

        What is left of that one's read-out after the move counts as frames of this step.
        """
        frames_s = self.frames_s(step, reflectance)
        if step.kind == "dark":
            return TimeParts(dark_s=frames_s)
        part = "reference_s" if step.kind == "reference" else "frames_s"
        move_s = self.move_s(here, step.pose)
        return TimeParts(**{"travel_s": move_s, part: frames_s - self.beside_s(move_s)})

    def parts(self, steps: Iterable[Step], here: Pose | None = None) -> TimeParts:
        """What a sequence of steps takes, with the lamp's warm-up before it.

        `here` is where the axes stand before (all at 0).
        """
        stations, seconds, kinds = [here or Pose()], {"point": 0.0, "reference": 0.0, "dark": 0.0}, list[str]()
        for step in steps:
            seconds[step.kind] += self.frames_s(step)
            if step.kind != "dark":
                stations.append(step.pose)
                kinds.append(step.kind)
        legs_s, warm_up_s = self._legs_s(stations), self.description.lamp.warm_up_s
        if self.description.camera.readout_s:
            for kind, leg_s in zip(kinds, legs_s.tolist(), strict=True):
                seconds[kind] -= self.beside_s(leg_s)
        return TimeParts(float(legs_s.sum()), seconds["point"], seconds["reference"], seconds["dark"], warm_up_s)


def approach_starts(goals: Floats, approach: Floats, limits: Floats) -> Floats:
    """Where the last part of the way to goals begins [rad]: `approach` off them, inside the limits (shape (2, axes)).

    `RigDescription.approach_starts_deg` of many at once.
    """
    off = goals - approach
    below, above = np.maximum(off, np.minimum(limits[0], goals)), np.minimum(off, np.maximum(limits[1], goals))
    return np.asarray(np.where(approach > 0.0, below, above))


Ints = NDArray[np.int64]
NEIGHBOURS = 12
"""Poses that a way may go on to from a pose."""
PROMISING = 1.5
"""A way this many times longer than another one is not worth the time to improve it."""
ROUNDS = 100
"""More than any plan was seen to need."""


def ordered(
    plan: Plan, points: Sequence[Assessed], durations: Durations, reference: Pose, every: int
) -> tuple[Plan, list[Assessed]]:
    """A plan in the order that it asks for, and its points as the rig sees them.

    With `order = "short"` points that cannot be measured come last. Repeated points stay spread over the run: only what
    lies between two visits of any point changes places. Where no order is found that is quicker than the one of the
    plan, that stays.

    Parameters
    ----------
    plan, points
        What to measure, and what `assess` made of it.
    durations
        Of moves on the rig.
    reference
        The pose of visits to the white reference, where the way begins and ends.
    every
        Points between two visits; 0 for none between.
    """
    if plan.order == "as-written":
        return plan, list(points)
    reachable = [k for k, a in enumerate(points) if a.pose is not None]
    poses = [a.pose for a in points if a.pose is not None]
    if len(poses) > 2:
        way = shorter(poses, [points[k].point for k in reachable], durations, reference)
        before, after = (
            durations.way_s(list(_stations(each, reference, every))) for each in (poses, [poses[k] for k in way])
        )
        if after < before:
            reachable = [reachable[k] for k in way]
            points = [points[k] for k in [*reachable, *(k for k, a in enumerate(points) if a.pose is None)]]
    return replace(plan, points=tuple(a.point for a in points)), list(points)


def as_begun(plan: Plan, rows: Sequence[Sequence[float]]) -> Plan:
    """A plan in the order of a run that was begun with it; the plan itself where these are other points.

    `rows` are the four angles [deg] of the run's points, in order.
    """
    points = tuple(Point(*row) for row in rows)
    return replace(plan, points=points) if Counter(points) == Counter(plan.points) else plan


def shorter(poses: Sequence[Pose], points: Sequence[Point], durations: Durations, home: Pose) -> list[int]:
    """An order of poses in which the way from home through all of them and back takes less time.

    Between blocks in which no point comes twice nothing is exchanged.
    """
    out: list[int] = []
    for block in _blocks(points):
        way = [block[k] for k in _way([poses[k] for k in block], durations, home)]
        if out and len(way) > 1 and points[way[0]] == points[out[-1]]:
            way[:2] = way[1::-1]  # not twice in a row
        out += way
    return out


def _blocks(points: Sequence[Point]) -> list[list[int]]:
    """Stretches in which no point comes twice."""
    out: list[list[int]] = [[]]
    seen: set[Point] = set()
    for k, point in enumerate(points):
        if point in seen:
            out.append([])
            seen = set()
        out[-1].append(k)
        seen.add(point)
    return out


def _way(poses: Sequence[Pose], durations: Durations, home: Pose) -> list[int]:
    """The shortest way that is found through distinct points."""
    from scipy.spatial import cKDTree

    from gonio.lab.rig import _short_path

    at = np.ascontiguousarray(durations.angles([*poses, home]))
    begin = np.ascontiguousarray(approach_starts(at, durations.approach, durations.limits))
    rig = at, begin, durations.speed, np.sign(durations.approach), SETTLE_S, SAME_PLACE
    seconds = at / durations.speed
    k = min(NEIGHBOURS + 1, len(at))
    _, near = cKDTree(seconds).query(seconds, k=k, p=np.inf)
    near = np.ascontiguousarray(near, dtype=np.int64)
    starts: list[Ints] = [np.arange(len(poses)), _short_path.nearest_first(*rig, near)]
    lengths = [_closed_s(at, way, durations) for way in starts]
    found: list[Ints] = [
        _short_path.improved(*rig, near, way, ROUNDS)
        for way, length in zip(starts, lengths, strict=True)
        if length <= PROMISING * min(lengths)
    ]
    best = min(range(len(found)), key=lambda k: _closed_s(at, found[k], durations))
    return list(map(int, found[best]))


def _closed_s(at: Floats, way: Ints, durations: Durations) -> float:
    """Duration of the way from the last pose through others and back [s]."""
    stations = np.concatenate([at[-1:], at[way], at[-1:]])
    return float(durations.direct_s(stations[:-1], stations[1:]).sum())


def _stations(poses: Sequence[Pose], reference: Pose, every: int) -> Iterator[Pose]:
    """The way from the reference through poses, with visits between, and back."""
    yield reference
    for k, pose in enumerate(poses, 1):
        yield pose
        if (every and k % every == 0) or k == len(poses):
            yield reference
