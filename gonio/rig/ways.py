"""Ways between poses on which no two bodies of a rig come too close to each other.

Axes move at their own speeds and are held up by corrections, so nobody knows the pose in the middle of a move. A move
of several axes at once therefore counts as free only where *every* combination of their angles on the way is free, the
parts before the goals from which they approach included. Where that is not so, one arm moves after the other, and
where that is not free either, both go by the rest position.

A box in the space of angles is free if the gap between two bodies in its middle is larger than what they can move from
there to its corners: no more than the sum over the axes of lever times angle. If not, the box is halved. That proves
that a whole way is free; samples along it would not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gonio.errors import ConfigError
from gonio.rig.description import Body, Geometry, RigDescription
from gonio.rig.protocols import Pose
from gonio.typing import Floats

CARRIERS = ("bench", "light", "camera", "tilt", "spin")
Vector = tuple[float, float, float]
Angles = tuple[float, float, float, float, float]
"""light, camera, tilt, spin, azimuth [rad], as in `Pose`."""

NAMES = ("light", "camera", "tilt", "spin", "azimuth")
LANDING = math.radians(0.2)
"""How far beyond the ends of its way an axis may stand, by the tolerance of a landing."""
FINEST_MM = 0.25
"""Gaps smaller than this beyond the clearance are none."""
MOST_BOXES = 20_000
"""A way that is not proved free by then counts as blocked."""
MOST_STRIPS = 8
"""A box is covered by at most so many capsules each way."""
GROUPS = ((0,), (1, 4), (2, 3))
"""The axes of the light arm, of the camera arm and of the holder."""


class Blocked(ConfigError):
    """There is no free way; the message says which bodies would touch, and where."""

    def __init__(self, message: str, bodies: str) -> None:
        super().__init__(message)
        self.bodies = bodies


@dataclass(frozen=True, slots=True)
class Capsule:
    """All that lies within `radius` of a line, in the frame of what carries it [mm]."""

    body: str
    on: str
    ends: tuple[Vector, Vector]
    radius: float

    def levers(self) -> dict[int, float]:
        """How far a point of the line moves at most for one radian of an axis [mm], by the axis's number."""

        def longest(*directions: int) -> float:
            return max(math.hypot(*(end[k] for k in directions)) for end in self.ends)

        whole = longest(0, 1, 2)
        return {
            "bench": {}, "light": {0: longest(0, 2)}, "camera": {1: longest(0, 2), 4: whole},
            "tilt": {2: longest(1, 2)}, "spin": {2: whole, 3: longest(0, 1)},
        }[self.on]  # fmt: skip


@dataclass(frozen=True)
class Space:
    """A rig's bodies, two by two, and the angles of its axes."""

    names: tuple[str, ...]
    """Of the axes that the rig has."""
    rest: Angles
    limits: tuple[tuple[float, float], ...]
    """By axis of `NAMES` [rad]."""
    approach: Angles
    pairs: tuple[tuple[Capsule, Capsule], ...]
    on: np.ndarray
    """What carries either of two, as numbers of `_gaps`, shape (pairs, 2)."""
    lines: Floats
    """Shape (pairs, 2, 2, 3) [mm]."""
    levers: Floats
    """Shape (pairs, 5) [mm]."""
    distances: Floats
    """Between two lines where their bodies are as close as they may come [mm]."""

    def box(self, start: Angles, goal: Angles) -> tuple[Floats, Floats]:
        """The smallest and the largest angle of each axis on the way, its approach included."""
        lows, highs = np.array(start), np.array(start)
        for k, name in enumerate(NAMES):
            if name in self.names and goal[k] != start[k]:
                (lower, upper), before = self.limits[k], goal[k] - self.approach[k]
                before = max(before, min(lower, goal[k])) if self.approach[k] > 0 else min(before, max(upper, goal[k]))
                lows[k] = min(start[k], goal[k], before) - LANDING
                highs[k] = max(start[k], goal[k], before) + LANDING
        return lows, highs

    def said(self, angles: Sequence[float]) -> str:
        """For people."""
        named = zip(NAMES, angles, strict=True)
        return ", ".join(f"{n} {round(math.degrees(v), 1) + 0.0:g}" for n, v in named if n in self.names) + " deg"


def route(description: RigDescription, start: Pose, goal: Pose) -> list[Pose]:
    """The poses to go to, one after the other; the last one is the goal.

    Raises
    ------
    Blocked
        Two bodies would touch on every way that is tried.
    """
    if not description.bodies:
        return [goal]
    space = _space_of(description)
    here, there, rest = _angles(start), _angles(goal), space.rest
    first: Blocked | None = None
    for stations in ((there,), (_with_holder(rest, here), _with_holder(rest, there), there), (rest, there)):
        try:
            out, at = [], here
            for station in stations:
                out += _legs(space, at, station) if station != at else []
                at = station
            return [Pose(*leg) for leg in out] or [goal]
        except Blocked as blocked:
            first = first or blocked
    assert first is not None
    raise first


def legs(description: RigDescription, start: Pose, goals: dict[str, float]) -> list[dict[str, float]]:
    """`route` for some axes, while the others stay where they are: goals [rad] by axis, one move after the other."""
    poses = route(description, start, replace(start, **goals))
    return [{name: getattr(pose, name) for name in goals} for pose in poses]


def require_free(description: RigDescription, pose: Pose) -> None:
    """Raise `Blocked` where there is no free way from the rest position to a pose, or none back.

    So between any two poses that are free in this sense there is a way: by the rest position.
    """
    if description.bodies:
        rest = Pose(*_space_of(description).rest)
        route(description, rest, pose)
        route(description, pose, rest)


def touching(description: RigDescription, pose: Pose) -> list[tuple[str, str]]:
    """The pairs of bodies that are in each other, without any clearance."""
    from gonio.rig import _gaps

    space, angles = _space_of(description), np.array(_angles(pose))
    clearance, ends, out = description.geometry.clearance_mm, np.empty((2, 2, 3)), []
    for pair, (one, other) in enumerate(space.pairs):
        for which in range(2):
            for end in range(2):
                _gaps.placed(space.on[pair, which], space.lines[pair, which, end], angles, ends[which, end])
        if _gaps.between_lines(*ends[0], *ends[1]) < space.distances[pair] - clearance:
            out.append((one.body, other.body))
    return list(dict.fromkeys(out))


def _with_holder(angles: Angles, holder: Angles) -> Angles:
    return angles[0], angles[1], holder[2], holder[3], angles[4]


def _legs(space: Space, start: Angles, goal: Angles) -> list[Angles]:
    """From start to goal, all axes at once, or one group of axes after the other."""
    try:
        _require_box(space, start, goal)
        return [goal]
    except Blocked as blocked:
        first = blocked
    moving = [group for group in GROUPS if any(start[k] != goal[k] for k in group)]
    for order in itertools.permutations(moving) if len(moving) > 1 else ():
        legs = list(_one_by_one(start, goal, order))
        try:
            for before, after in itertools.pairwise([start, *legs]):
                _require_box(space, before, after)
            return legs
        except Blocked:
            continue
    raise first


def _one_by_one(start: Angles, goal: Angles, order: Sequence[Sequence[int]]) -> Iterator[Angles]:
    here = list(start)
    for group in order:
        for k in group:
            here[k] = goal[k]
        yield here[0], here[1], here[2], here[3], here[4]


def _require_box(space: Space, start: Angles, goal: Angles) -> None:
    """Raise `Blocked` unless every combination of angles between start and goal, approach included, is free."""
    from gonio.rig import _gaps

    lows, highs = space.box(start, goal)
    pair, at = _gaps.first_too_close(
        space.on, space.lines, space.levers, space.distances, FINEST_MM, MOST_BOXES, lows, highs
    )
    if pair >= 0:
        one, other = (capsule.body for capsule in space.pairs[pair])
        raise Blocked(
            f"the way from {space.said(start)} to {space.said(goal)} would touch: {one} and {other}, near "
            f"{space.said(at)}",
            f"{one} and {other}",
        )


def _angles(pose: Pose) -> Angles:
    return pose.light, pose.camera, pose.tilt, pose.spin, pose.azimuth


# ---- bodies ----


def _space_of(description: RigDescription) -> Space:
    return _space(
        description.bodies, description.geometry, tuple(description.limits_deg().items()),
        tuple(description.approach_deg().items()),
    )  # fmt: skip


@lru_cache(16)
def _space(
    bodies: tuple[Body, ...],
    geometry: Geometry,
    limits_deg: tuple[tuple[str, tuple[float, float]], ...],
    approach_deg: tuple[tuple[str, float], ...],
) -> Space:
    limits = {name: (math.radians(lower), math.radians(upper)) for name, (lower, upper) in limits_deg}
    rest = {name: min(max(0.0, lower), upper) for name, (lower, upper) in limits.items()}
    rest |= {"light": limits["light"][0], "camera": limits["camera"][1]}  # out of each other's way
    approach = {name: math.radians(value) for name, value in approach_deg}
    pairs = _pairs(bodies, geometry)
    levers = np.zeros((len(pairs), len(NAMES)))
    for k, pair in enumerate(pairs):
        for capsule in pair:
            for axis, lever in capsule.levers().items():
                levers[k, axis] += lever
    return Space(
        names=tuple(limits),
        rest=_angles(Pose(**rest)),
        limits=tuple(limits.get(name, (0.0, 0.0)) for name in NAMES),
        approach=_angles(Pose(**approach)),
        pairs=pairs,
        on=np.array([[CARRIERS.index(capsule.on) for capsule in pair] for pair in pairs]).reshape(-1, 2),
        lines=np.array([[capsule.ends for capsule in pair] for pair in pairs]).reshape(-1, 2, 2, 3),
        levers=levers,
        distances=np.array([one.radius + other.radius + geometry.clearance_mm for one, other in pairs]),
    )


def _pairs(bodies: tuple[Body, ...], geometry: Geometry) -> tuple[tuple[Capsule, Capsule], ...]:
    """Every two capsules that can move against each other."""
    heads = [
        _ball("source head", "light", geometry.light_distance_mm, geometry.light_body_radius_mm),
        _ball("camera head", "camera", geometry.camera_distance_mm, geometry.camera_body_radius_mm),
    ]
    capsules = [head for head in heads if head.radius > 0.0] + [part for body in bodies for part in _parts(body)]
    return tuple((a, b) for a, b in itertools.combinations(capsules, 2) if _carrier(a.on) != _carrier(b.on))


def _carrier(on: str) -> str:
    return "holder" if on in ("tilt", "spin") else on


def _ball(name: str, on: str, distance: float, radius: float) -> Capsule:
    centre = (0.0, 0.0, distance)
    return Capsule(name, on, (centre, centre), radius)


def _parts(body: Body) -> list[Capsule]:
    """The capsules that cover a body; a box is covered by bundles along its longest edge, and a little larger so."""
    if body.from_mm is not None and body.to_mm is not None and body.radius_mm is not None:
        return [Capsule(body.name, body.on, (body.from_mm, body.to_mm), body.radius_mm)]
    assert body.centre_mm is not None
    assert body.size_mm is not None
    size, centre = body.size_mm, body.centre_mm
    order = sorted(range(3), key=lambda k: size[k])
    cell = size[order[0]] / 2
    counts = [min(MOST_STRIPS, math.ceil(size[k] / cell)) for k in order[:2]]
    steps = [size[k] / count for k, count in zip(order, counts, strict=False)]
    out = []
    for places in itertools.product(*(range(count) for count in counts)):
        ends: list[list[float]] = [list(centre), list(centre)]
        for k, place, step in zip(order, places, steps, strict=False):
            for end in ends:
                end[k] += (place + 0.5) * step - size[k] / 2
        ends[0][order[2]] -= size[order[2]] / 2
        ends[1][order[2]] += size[order[2]] / 2
        line = (ends[0][0], ends[0][1], ends[0][2]), (ends[1][0], ends[1][1], ends[1][2])
        out.append(Capsule(body.name, body.on, line, math.hypot(*steps) / 2))
    return out
