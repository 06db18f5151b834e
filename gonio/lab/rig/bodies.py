"""The bodies of a rig as shapes that move with its axes, and which pairs of them may meet."""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gonio.lab.rig import kinematics
from gonio.lab.rig.description import Arms, Body, Cable, Geometry
from gonio.typing import Bools, Floats

CARRIERS = ("bench", "light", "camera", "tilt", "spin")
FINEST_MM = 0.25
"""Gaps smaller than this beyond the clearance are none."""
PLANNED_MM = FINEST_MM
"""Room beyond the clearance in a run's plan: a way that has it is proved free by any finer look at it, too."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Hull:
    """All that lies within `radius` of the hull of some points, each in the frame of what carries it [mm]."""

    body: str
    on: tuple[str, str]
    """What carries the first point, and what the others: only a cable is carried by two."""
    points: tuple[Vector, ...]
    radius: float
    cable: bool = False

    def levers(self, frames: Floats) -> dict[int, float]:
        """How far it moves at most for one radian of an axis [mm], by the axis's number."""
        out: dict[int, float] = {}
        for place, point in enumerate(self.points):
            for axis, lever in _levers(self.on[min(place, 1)], point, frames).items():
                out[axis] = max(out.get(axis, 0.0), lever)
        return out


def _levers(on: str, point: Vector, frames: Floats) -> dict[int, float]:
    x, y, z = point
    whole, beside = math.hypot(x, y, z), abs(float(frames[3, 1, 3]))
    off_azimuth = math.dist(frames[1, :, 3], frames[2, :, 3])
    return {
        "bench": {}, "light": {0: math.hypot(x, z)}, "camera": {1: math.hypot(x, z), 4: whole + off_azimuth},
        "tilt": {2: math.hypot(y, z) + beside}, "spin": {2: whole + beside, 3: math.hypot(x, y)},
    }[on]  # fmt: skip


@dataclass(frozen=True, slots=True)
class BodyPairs:
    """Bodies two by two, which some axes move against each other; arrays as of `_clearance.first_too_close`."""

    axes: tuple[int, ...]
    shapes: tuple[tuple[Hull, Hull], ...]
    tied: Bools
    on: np.ndarray
    points: Floats
    counts: np.ndarray
    levers: Floats
    distances: Floats
    """Distances that two bodies keep, radii and clearance included; or that a cable's ends may be apart [mm]."""
    planned: Floats
    """The same with `PLANNED_MM` to spare."""

    def spares(self, frames: Floats, poses: Floats) -> Floats:
        """Clearance of each pair beyond the one it must keep, at poses of true angles, shape (poses, pairs) [mm]."""
        from gonio.lab.rig import _clearance

        out = np.empty((len(poses), len(self.shapes)))
        _clearance.spares(self.tied, self.on, self.points, self.counts, self.distances, frames, poses, out)
        return out


def placed(on: Sequence[str], points: Sequence[Vector], angles: Floats, frames: Floats) -> Floats:
    """Points in the lab, shape (n, 3) [mm]; the first is carried by `on[0]`, the others by `on[1]`."""
    from gonio.lab.rig import _clearance

    out = np.empty((len(points), 3))
    carriers = np.array([CARRIERS.index(each) for each in on])
    _clearance.placed(carriers, np.array(points), len(points), angles, frames, out)
    return out


def _together(axes: tuple[int, ...], pairs: list[tuple[bool, Hull, Hull, float]], frames: Floats) -> BodyPairs:
    tied, distances = np.array([tied for tied, *_ in pairs]), np.array([distance for *_, distance in pairs], float)
    points, levers = np.zeros((len(pairs), 2, 8, 3)), np.zeros((len(pairs), len(kinematics.AXES)))
    for number, (_, *shapes, _) in enumerate(pairs):
        for which, shape in enumerate(shapes):
            points[number, which, : len(shape.points)] = shape.points
            for axis, lever in shape.levers(frames).items():
                levers[number, axis] += lever
    return BodyPairs(
        axes=axes,
        shapes=tuple((one, other) for _, one, other, _ in pairs),
        tied=tied,
        on=np.array([[[CARRIERS.index(on) for on in shape.on] for shape in shapes] for _, *shapes, _ in pairs]),
        points=points,
        counts=np.array([[len(shape.points) for shape in shapes] for _, *shapes, _ in pairs]),
        levers=levers,
        distances=distances,
        planned=distances + np.where(tied, -PLANNED_MM, PLANNED_MM),
    )


def _pairs(
    shapes: Sequence[Hull], cables: Sequence[Cable], geometry: Geometry
) -> Iterator[tuple[bool, Hull, Hull, float]]:
    """Every two shapes that can move against each other, and the two ends of each cable.

    Cables may lie on each other, and on what carries their own ends.
    """
    for one, other in itertools.combinations(shapes, 2):
        if not ((one.cable and other.cable) or {*map(_carrier, one.on)} & {*map(_carrier, other.on)}):
            yield False, one, other, one.radius + other.radius + geometry.clearance_mm
    for cable in cables:
        one = Hull(cable.name, (cable.from_on, cable.to_on), (cable.from_mm,), 0.0, cable=True)
        other = Hull(cable.name, (cable.to_on, cable.from_on), (cable.to_mm,), 0.0, cable=True)
        yield True, one, other, cable.length_mm


def _carrier(on: str) -> str:
    return "holder" if on in ("tilt", "spin") else on


def _shapes(bodies: tuple[Body, ...], cables: tuple[Cable, ...], geometry: Geometry, arms: Arms) -> tuple[Hull, ...]:
    """The two heads, the bodies, and the cables that hang."""
    heads = [
        Hull(name, (on, on), (kinematics.head(axis, distance),), radius)
        for name, on, axis, distance, radius in (
            ("source head", "light", arms.light, geometry.light_distance_mm, geometry.light_body_radius_mm),
            ("camera head", "camera", arms.camera, geometry.camera_distance_mm, geometry.camera_body_radius_mm),
        )
        if radius > 0.0
    ]
    hanging = [
        Hull(c.name, (c.from_on, c.to_on), (c.from_mm, c.to_mm), c.radius_mm + c.sag_mm, cable=True)
        for c in cables
        if c.sag_mm is not None
    ]
    return (*heads, *map(_shape, bodies), *hanging)


def _shape(body: Body) -> Hull:
    if body.from_mm is not None and body.to_mm is not None and body.radius_mm is not None:
        points = (body.from_mm,) if body.from_mm == body.to_mm else (body.from_mm, body.to_mm)
        return Hull(body.name, (body.on, body.on), points, body.radius_mm)
    assert body.centre_mm is not None
    assert body.size_mm is not None
    sides = [(c - s / 2, c + s / 2) for c, s in zip(body.centre_mm, body.size_mm, strict=True)]
    corners = tuple((x, y, z) for x in sides[0] for y in sides[1] for z in sides[2])
    return Hull(body.name, (body.on, body.on), corners, 0.0)
