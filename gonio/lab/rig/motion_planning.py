"""Ways between poses on which no two bodies of a rig come too close to each other, and no cable is torn.

Axes move at their own speeds and are held up by corrections, so nobody knows the pose in the middle of a move. A move
of several axes at once therefore counts as free only where *every* combination of their angles on the way is free, the
parts before the goals from which they approach included. Where that is not so, one arm moves after the other, and
where that is not free either, both go by the rest position.

A box in the space of angles is free if the gap between two bodies in its middle is larger than what they can move from
there to its corners: no more than the sum over the axes of lever times angle. If not, the box is halved. That proves
that a whole way is free; samples along it would not.

What is planned has a little more to spare than what is driven (`PLANNED_MM`, `LANDING`): so a way that was found when
a run was planned is found again from where the axes landed.
"""

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from gonio.errors import ConfigError
from gonio.lab.rig import kinematics
from gonio.lab.rig.bodies import (
    CARRIERS,
    FINEST_MM,
    PLANNED_MM,
    BodyPairs,
    Hull,
    _pairs,
    _shapes,
    _together,
    placed,
)
from gonio.lab.rig.description import Arms, Body, Cable, Geometry, Holder, RigDescription, approach_start
from gonio.lab.rig.kinematics import AXES
from gonio.lab.rig.protocols import Pose
from gonio.typing import Floats

Angles = tuple[float, float, float, float, float]
"""light, camera, tilt, spin, azimuth [rad], as in `Pose`."""

LANDING = math.radians(0.2)
"""How far beyond the ends of its way an axis may stand, by the tolerance of a landing."""
SKIN_MM = 0.1
"""Bodies within this distance of the sample's surface count as flush with it, and not as in its light."""
RIM = 12
"""Corners of what stands for the disc of a lamp, of a lens, or of what is measured of the sample."""
MOST_BOXES = 20_000
"""A way that is not proved free by then counts as blocked."""
MOST_KEPT = 200_000
"""Verdicts on boxes that are kept."""
HOLDER = (2, 3)
GROUPS = ((0,), (1, 4), HOLDER)
"""The axes of the light arm, of the camera arm and of the holder."""
SINGLY = ((0,), (1,), (4,), HOLDER)
"""As `GROUPS`, where the camera arm does not turn and go round at once."""


class Blocked(ConfigError):
    """There is no free way; the message says which bodies would touch, and where.

    `what` and `bodies` are the same without the numbers, as in "the way there would touch:" and "lamp and post".
    """

    def __init__(self, message: str, what: str, bodies: str) -> None:
        super().__init__(message)
        self.what, self.bodies = what, bodies


@dataclass(frozen=True)
class Space:
    """A rig's bodies, two by two, and the angles of its axes."""

    names: tuple[str, ...]
    """Names of the axes that the rig has."""
    rest: Angles
    limits: tuple[tuple[float, float], ...]
    """By axis of `AXES` [rad]."""
    approach: Angles
    frames: Floats
    clearance: float
    shapes: tuple[Hull, ...]
    groups: tuple[BodyPairs, ...]
    harmonics: tuple[tuple[tuple[int, float, float], ...], ...]
    """Harmonics of the encoder of each axis of `AXES` [rad]."""
    known: dict[tuple[object, ...], tuple[int, tuple[float, ...]]] = field(default_factory=dict)
    """Verdicts on boxes of angles."""

    def box(self, start: Angles, goal: Angles, around: float) -> tuple[list[float], list[float]]:
        """The smallest and the largest angle of each axis on the way, its approach included.

        An axis that stays where it is may be sent there once more, and then approaches too.
        """
        lows, highs = list(start), list(start)
        for k, name in enumerate(AXES):
            if name in self.names:
                before = approach_start(goal[k], self.approach[k], *self.limits[k])
                lows[k] = self.true(k, min(start[k], goal[k], before) - around, -1.0)
                highs[k] = self.true(k, max(start[k], goal[k], before) + around, 1.0)
        return lows, highs

    def true(self, axis: int, read: float, beyond: float = 0.0) -> float:
        """Where an axis stands when its encoder reads an angle [rad].

        With `beyond` = 1: an upper bound of where it stands while it reads this angle or less; with -1 a lower bound
        while it reads this angle or more.
        """
        rows = self.harmonics[axis]
        if not rows:
            return read
        if beyond and sum(k * math.hypot(c, s) for k, c, s in rows) >= 1.0:  # the two need not grow together
            return read + beyond * sum(math.hypot(c, s) for _, c, s in rows)
        return read - sum(c * math.cos(k * read) + s * math.sin(k * read) for k, c, s in rows)

    def read(self, axis: int, true: float) -> float:
        """About what an encoder reads where its axis stands [rad]: good to a hundredth of the encoder's error."""
        first = 2.0 * true - self.true(axis, true)
        return first + true - self.true(axis, first)

    def true_angles(self, angles: Sequence[float]) -> Floats:
        """`true` of all axes."""
        return np.array([self.true(k, value) for k, value in enumerate(angles)])

    def said(self, angles: Sequence[float]) -> str:
        """For people."""
        named = zip(AXES, angles, strict=True)
        return ", ".join(f"{n} {round(math.degrees(v), 1) + 0.0:g}" for n, v in named if n in self.names) + " deg"


def route(description: RigDescription, start: Pose, goal: Pose) -> list[Pose]:
    """The poses to go to, one after the other; the last one is the goal.

    Raises
    ------
    Blocked
        Two bodies would touch, or a cable be torn, on every way that is tried.
    """
    if not description.looks_ahead:
        return [goal]
    space, here, there = _space_of(description), _angles(start), _angles(goal)
    try:
        legs = _way(space, here, there)
    except Blocked as blocked:
        try:
            legs = _way(space, here, space.rest) + _way(space, space.rest, there)
        except Blocked:
            raise blocked from None
    return [Pose(*leg) for leg in legs] or [goal]


def legs(description: RigDescription, start: Pose, goals: dict[str, float]) -> list[dict[str, float]]:
    """`route` for some axes, while the others stay where they are: goals [rad] by axis, one move after the other."""
    poses = route(description, start, replace(start, **goals))
    return [{name: getattr(pose, name) for name in goals} for pose in poses]


def require_free(description: RigDescription, pose: Pose) -> None:
    """Raise `Blocked` where bodies are too close at a pose, or in the light there, or where there is no free way from
    the rest position to it, or none back.

    So between any two poses that are free in this sense there is a way: by the rest position. That holds too where the
    axes have landed up to `LANDING` beside them.
    """
    if not description.looks_ahead:
        return
    space, here = _space_of(description), _angles(pose)
    _require_apart(space, here)
    _require_lit(description, space, here)
    if here != space.rest:
        _way(space, space.rest, here, planned=True)
        _way(space, here, space.rest, planned=True)


def require_parking(description: RigDescription, park_deg: Mapping[str, float], key: str) -> None:
    """Raise where axes cannot be parked: there is no free way from the rest position to where they park, or none back.

    Parameters
    ----------
    description
        The rig.
    park_deg
        Where axes park [deg]; those that are not named park at the rest position.
    key
        Of the rig file, for the message: where `park_deg` stands, with `{}` for the name of an axis.

    Raises
    ------
    ConfigError
        Bodies would touch there or on the way; the message names the axes, the bodies and the remedy.
    """
    if not description.looks_ahead or not park_deg:
        return
    space = _space_of(description)
    parked = _angles(replace(Pose(*space.rest), **{name: math.radians(at) for name, at in park_deg.items()}))
    try:
        _require_apart(space, parked)
        for way in ((space.rest, parked), (parked, space.rest)):
            _way(space, *way, planned=True)
    except Blocked as blocked:
        keys = ", ".join(f"{key.format(name)} = {at:g}" for name, at in park_deg.items())
        raise ConfigError(
            f"{keys}: the rig cannot park there and come back: {blocked}. Leave the keys out (the arms park at "
            f"{space.said(space.rest)} then), or name angles that are free"
        ) from None


def touching(description: RigDescription, pose: Pose) -> list[tuple[str, str]]:
    """The pairs of bodies that are in each other, without any clearance; of a torn cable its two ends."""
    return [names for names, gap in clearances(description, [pose])[0].items() if gap < 0.0]


def clearances(description: RigDescription, poses: Sequence[Pose]) -> list[dict[tuple[str, str], float]]:
    """How far every two bodies are apart at each pose [mm]; of a cable how much longer it is than its ends are apart.

    Bodies that are in each other have a gap below 0 where one of them has a radius, and -`SKIN_MM` where neither has.
    """
    space = _space_of(description)
    angles = np.array([space.true_angles(_angles(pose)) for pose in poses]).reshape(-1, len(AXES))
    out: list[dict[tuple[str, str], float]] = [{} for _ in poses]
    for group in space.groups:
        for row, values in zip(out, group.spares(space.frames, angles).tolist(), strict=True):
            for (one, other), tied, spare in zip(group.shapes, group.tied.tolist(), values, strict=True):
                names = _ends(one) if tied else (one.body, other.body)
                gap = spare + (0.0 if tied else space.clearance)
                solid = not tied and one.radius + other.radius == 0.0 and gap <= 0.0
                row[names] = min(row.get(names, math.inf), -SKIN_MM if solid else gap)
    return out


def _ends(cable: Hull) -> tuple[str, str]:
    return f"{cable.body}, {cable.on[0]} end", f"{cable.body}, {cable.on[1]} end"


def resting(description: RigDescription) -> Pose:
    """The rest position: light on its lower limit, camera on its upper one, the others at 0."""
    return Pose(*_space_of(description).rest)


# ---- ways ----


def _way(space: Space, start: Angles, goal: Angles, *, planned: bool = False) -> list[Angles]:
    """From start to goal, straight, or with the holder turned while the arms are at rest."""
    first: Blocked | None = None
    for stations in ((goal,), (_turned(space.rest, start, HOLDER), _turned(space.rest, goal, HOLDER), goal)):
        try:
            out, at = [], start
            for station in stations:
                out += _legs(space, at, station, planned) if station != at else []
                at = station
            return out
        except Blocked as blocked:
            first = first or blocked
    assert first is not None
    raise first


def _legs(space: Space, start: Angles, goal: Angles, planned: bool) -> list[Angles]:
    """From start to goal, all axes at once, or one group of axes after the other."""
    met = _met(space, start, goal, planned)
    if met is None:
        return [goal]
    for groups in (GROUPS, SINGLY) if start[4] != goal[4] else (GROUPS,):
        moving = [group for group in groups if any(start[k] != goal[k] for k in group)]
        for order in itertools.permutations(moving) if len(moving) > 1 else ():
            taken = itertools.accumulate(order, lambda turned, group: {*turned, *group}, initial=set[int]())
            legs = [_turned(start, goal, turned) for turned in taken][1:]
            if all(_met(space, a, b, planned) is None for a, b in itertools.pairwise([start, *legs])):
                return legs
    raise _blocked(space, start, goal, *met)


def _turned(start: Angles, goal: Angles, axes: Collection[int]) -> Angles:
    """Start, with some axes where they are at the goal."""
    light, camera, tilt, spin, azimuth = (goal[k] if k in axes else start[k] for k in range(len(AXES)))
    return light, camera, tilt, spin, azimuth


def _met(space: Space, start: Angles, goal: Angles, planned: bool) -> tuple[BodyPairs, int, tuple[float, ...]] | None:
    """None where every combination of angles between start and goal, approach included, is free; else two bodies, and
    angles at which they are too close."""
    from gonio.lab.rig import _clearance

    lows, highs = space.box(start, goal, 2.0 * LANDING if planned else LANDING)
    for number, group in enumerate(space.groups):
        key = (number, planned, *(lows[k] for k in group.axes), *(highs[k] for k in group.axes))
        if key not in space.known:
            if len(space.known) >= MOST_KEPT:
                space.known.clear()
            pair, at = _clearance.first_too_close(
                group.tied, group.on, group.points, group.counts, group.levers,
                group.planned if planned else group.distances, space.frames, FINEST_MM, MOST_BOXES,
                np.array(lows), np.array(highs),
            )  # fmt: skip
            space.known[key] = int(pair), tuple(at.tolist())
        pair, near = space.known[key]
        if pair >= 0:
            return group, pair, near
    return None


def _blocked(space: Space, start: Angles, goal: Angles, group: BodyPairs, pair: int, near: Sequence[float]) -> Blocked:
    """What is in the way from start to goal, by `_met`."""
    one, other = group.shapes[pair]
    torn = group.tied[pair]
    verb, bodies = ("tear the cable", one.body) if torn else ("touch:", f"{one.body} and {other.body}")
    spare = group.spares(space.frames, np.array([near]))[0, pair]
    would = "would" if spare <= FINEST_MM + PLANNED_MM else "may"
    where = ", ".join(
        f"{AXES[k]} {round(math.degrees(space.read(k, near[k])), 1) + 0.0:g}"
        for k in group.axes
        if AXES[k] in space.names
    )
    return Blocked(
        f"the way from {space.said(start)} to {space.said(goal)} {would} {verb} {bodies}"
        + (f", near {where} deg" if where else ""),
        f"the way there {would} {verb}", bodies,
    )  # fmt: skip


def _require_apart(space: Space, at: Angles) -> None:
    """Raise `Blocked` where bodies are closer than the clearance at a pose, or a cable is too short there."""
    angles = space.true_angles(at)[None, :]
    for group in space.groups:  # each of one pair at least
        found = group.spares(space.frames, angles)[0]
        pair = int(np.argmin(found))
        if found[pair] > 0.0:
            continue
        one, other = group.shapes[pair]
        if group.tied[pair]:
            raise Blocked(
                f"at {space.said(at)} the cable {one.body} is {-found[pair]:.1f} mm too short",
                "where the point is measured, too short: the cable", one.body,
            )  # fmt: skip
        gap = found[pair] + space.clearance
        apart = f"are {gap:.1f} mm apart, and geometry.clearance_mm = {space.clearance:g}"
        if gap <= 0.0:
            apart = "are in each other"
        raise Blocked(
            f"at {space.said(at)} {one.body} and {other.body} {apart}",
            "where the point is measured, too close:", f"{one.body} and {other.body}",
        )  # fmt: skip


def _angles(pose: Pose) -> Angles:
    return pose.light, pose.camera, pose.tilt, pose.spin, pose.azimuth


# ---- light ----


def outlines(description: RigDescription, pose: Pose) -> list[tuple[Hull, Floats]]:
    """The two heads, the bodies, and the cables that hang, with their points in the lab, shape (n, 3) [mm]."""
    space = _space_of(description)
    angles = space.true_angles(_angles(pose))
    return [(each, placed(each.on, each.points, angles, space.frames)) for each in space.shapes]


def cable_ends(description: RigDescription, pose: Pose, cable: Cable) -> Floats:
    """Where the two ends of a cable are in the lab, shape (2, 3) [mm]."""
    space = _space_of(description)
    angles = space.true_angles(_angles(pose))
    return placed((cable.from_on, cable.to_on), (cable.from_mm, cable.to_mm), angles, space.frames)


def beams(description: RigDescription, pose: Pose) -> tuple[Floats, Floats]:
    """The light from the lamp to what is measured of the sample, and from there to the lens: hulls of points in the
    lab, each of shape (2 `RIM`, 3) [mm]; the first half lies on the sample."""
    from gonio.lab.rig import _clearance

    space = _space_of(description)
    angles, geometry = space.true_angles(_angles(pose)), description.geometry
    onto, shift = np.empty((3, 3)), np.empty(3)
    _clearance.carried(_clearance.SPIN, angles, space.frames, onto, shift)
    centre, surface = kinematics.patch(description.holder)
    middle, axes = onto @ centre + shift, onto @ surface
    out = []
    for name, axis, distance, half_angle_deg in (
        ("light", description.arms.light, geometry.light_distance_mm, description.lamp.half_angle_deg),
        ("camera", description.arms.camera, geometry.camera_distance_mm, description.camera.lens_half_angle_deg),
    ):
        _clearance.carried(CARRIERS.index(name), angles, space.frames, onto, shift)
        end = onto @ np.array(kinematics.head(axis, distance)) + shift
        toward = (end - middle) / np.linalg.norm(end - middle)
        across = _cross(toward, onto[:, 1])
        across /= np.linalg.norm(across)
        outward = math.copysign(1.0, float(toward @ axes[:, 2])) * axes[:, 2]
        rim = _rim(middle, axes[:, 0], axes[:, 1], description.acquisition.roi_radius_mm)
        disc = _rim(end, across, _cross(toward, across), distance * math.tan(math.radians(half_angle_deg)))
        both = np.concatenate([rim, disc])
        height = (both - middle) @ outward
        out.append(both + np.maximum(SKIN_MM - height, 0.0)[:, None] * outward)  # nothing comes through the surface
    return out[0], out[1]


def _cross(a: Floats, b: Floats) -> Floats:
    """`numpy.cross` of two vectors, ten times as fast."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _rim(centre: Floats, x: Floats, y: Floats, radius: float) -> Floats:
    turn = 2.0 * math.pi * np.arange(RIM) / RIM
    around = np.cos(turn)[:, None] * x + np.sin(turn)[:, None] * y
    return np.asarray(centre + radius / math.cos(math.pi / RIM) * around)


def _require_lit(description: RigDescription, space: Space, at: Angles) -> None:
    """Raise `Blocked` where a body stands between lamp and sample, or between sample and camera.

    What is on an arm does not stand in its own beam. Nor does a body that the sample lies in: a holder, whose opening
    its capsule or box does not have.
    """
    from gonio.lab.rig import _clearance

    hulls = beams(description, Pose(*at))
    angles, middle = space.true_angles(at), np.ascontiguousarray([hulls[0][:RIM].mean(axis=0)])
    for shape in space.shapes:
        room, count = placed(shape.on, shape.points, angles, space.frames), len(shape.points)
        if _clearance.between(room, count, middle, 1, 0.0, np.inf) <= shape.radius:
            continue
        for hull, arm, words in zip(hulls, ("light", "camera"), ("of the light", "of the camera's sight"), strict=True):
            if arm not in shape.on and _clearance.between(room, count, hull, len(hull), 0.0, np.inf) <= shape.radius:
                raise Blocked(
                    f"at {space.said(at)} {shape.body} stands in the way {words}", f"in the way {words}:", shape.body
                )


# ---- bodies ----


def _space_of(description: RigDescription) -> Space:
    return _space(
        description.bodies, description.cables, description.geometry, description.arms, description.holder,
        tuple(description.limits_deg().items()), tuple(description.approach_deg().items()),
    )  # fmt: skip


@lru_cache(16)
def _space(
    bodies: tuple[Body, ...],
    cables: tuple[Cable, ...],
    geometry: Geometry,
    arms: Arms,
    holder: Holder,
    limits_deg: tuple[tuple[str, tuple[float, float]], ...],
    approach_deg: tuple[tuple[str, float], ...],
) -> Space:
    limits = {name: (math.radians(lower), math.radians(upper)) for name, (lower, upper) in limits_deg}
    rest = {name: min(max(0.0, lower), upper) for name, (lower, upper) in limits.items()}
    rest |= {"light": limits["light"][0], "camera": limits["camera"][1]}  # out of each other's way
    approach = {name: math.radians(value) for name, value in approach_deg}
    frames = kinematics.frames(arms, holder)
    shapes = _shapes(bodies, cables, geometry, arms)
    by_axes: dict[tuple[int, ...], list[tuple[bool, Hull, Hull, float]]] = {}
    for tied, one, other, distance in _pairs(shapes, cables, geometry):
        axes = tuple(sorted({*one.levers(frames), *other.levers(frames)}))
        by_axes.setdefault(axes, []).append((tied, one, other, distance))
    axes_of_arms = arms.axes()
    rows = [axes_of_arms[name].harmonics_deg if name in axes_of_arms else () for name in AXES]
    return Space(
        names=tuple(limits),
        rest=_angles(Pose(**rest)),
        limits=tuple(limits.get(name, (0.0, 0.0)) for name in AXES),
        approach=_angles(Pose(**approach)),
        frames=frames,
        clearance=geometry.clearance_mm,
        shapes=shapes,
        groups=tuple(_together(axes, pairs, frames) for axes, pairs in by_axes.items()),
        harmonics=tuple(tuple((k, math.radians(c), math.radians(s)) for k, c, s in each) for each in rows),
    )
