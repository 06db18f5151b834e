"""Shapes of formulas: plane, disc, sphere, cylinder and box.

Also here is a surface of revolution: exact frusta between the points of its profile, or a smooth curve through them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from gonio.errors import ConfigError
from gonio.typing import ArrayLike, Floats, NDArray
from gonio_scenes.shapes import _kernels
from gonio_scenes.shapes.shape import (
    AxisTable,
    Coordinate,
    FlatTable,
    Ints,
    Length,
    Placement,
    Surface,
    over_rays,
    rays,
)


@dataclass(frozen=True, slots=True, eq=False)
class Analytic:
    """A shape of two compiled loops over rays: one finds hits, the other describes the surface there.

    Attributes
    ----------
    place
        Where it stands.
    hit, describe
        Kernels of `_kernels`.
    constants
        What both take of the shape's own.
    inside
        Whether a point in the shape's own frame is inside; None for a shape that is not closed.
    """

    place: Placement
    hit: Callable[..., None]
    describe: Callable[..., None]
    constants: tuple[Any, ...]
    size_mm: float
    convex: bool
    inside: Callable[[float, float, float], bool] | None = None

    @property
    def closed(self) -> bool:
        """Whether it has an inside."""
        return self.inside is not None

    def intersect(self, origin: Floats, direction: Floats, nearest: float) -> tuple[Floats, Ints]:
        """See `Shape`."""
        hits = np.empty(len(origin)), np.empty(len(origin), np.int64)
        ray, place = rays(origin, direction), (self.place.center, self.place.axes)
        over_rays(self.hit, len(origin), ray, place, *self.constants, float(nearest), hits)
        return hits

    def surface(self, origin: Floats, direction: Floats, distance: Floats, primitive: Ints) -> Surface:
        """See `Shape`."""
        hits = np.ascontiguousarray(distance, np.float64), np.ascontiguousarray(primitive, np.int64)
        out = (*np.empty((4, len(origin), 3)), np.empty((len(origin), 2)))
        ray, place = rays(origin, direction), (self.place.center, self.place.axes)
        over_rays(self.describe, len(origin), ray, place, *self.constants, hits, out)
        return Surface(*out)

    def contains(self, point: ArrayLike) -> bool:
        """See `Shape`."""
        return self.inside is not None and self.inside(*self.place.local(point))


class Plane(FlatTable):
    """`kind = "plane"`: without end, or a rectangle.

    Attributes
    ----------
    size_mm
        Width along `x_axis` and height along normal x `x_axis`; without it the plane has no end.
    tile_mm
        Width and height of one repetition of a texture, the first with its middle at `center_mm`; by default the whole
        rectangle, and 100 mm each on a plane without end.
    """

    kind: Literal["plane"]
    size_mm: tuple[Length, Length] | None = None
    tile_mm: tuple[Length, Length] | None = None

    def build(self, folder: Path) -> Analytic:
        """The shape."""
        tile = self.tile_mm or self.size_mm or (100.0, 100.0)
        half = np.array(self.size_mm) / 2.0 if self.size_mm else np.full(2, math.inf)
        return Analytic(
            place=self.place,
            hit=_kernels.patch_hit,
            describe=_kernels.patch_surface,
            constants=(half, np.array(tile)),
            size_mm=math.hypot(*(self.size_mm or tile)),
            convex=True,
        )


class Disc(FlatTable):
    """`kind = "disc"`."""

    kind: Literal["disc"]
    radius_mm: Length

    def build(self, folder: Path) -> Analytic:
        """The shape."""
        return Analytic(
            place=self.place,
            hit=_kernels.disc_hit,
            describe=_kernels.disc_surface,
            constants=(self.radius_mm,),
            size_mm=2.0 * self.radius_mm,
            convex=True,
        )


class Sphere(AxisTable):
    """`kind = "sphere"`; its `axis` goes through the poles of uv."""

    kind: Literal["sphere"]
    radius_mm: Length

    def build(self, folder: Path) -> Analytic:
        """The shape."""
        radius = self.radius_mm
        return Analytic(
            place=self.place,
            hit=_kernels.sphere_hit,
            describe=_kernels.sphere_surface,
            constants=(radius,),
            size_mm=2.0 * radius,
            convex=True,
            inside=lambda x, y, z: math.hypot(x, y, z) < radius,
        )


class Cylinder(AxisTable):
    """`kind = "cylinder"`: `center_mm` is its middle; without `caps` it is a tube without thickness."""

    kind: Literal["cylinder"]
    radius_mm: Length
    height_mm: Length
    caps: bool = True

    def build(self, folder: Path) -> Analytic:
        """The shape."""
        radius, half = self.radius_mm, self.height_mm / 2.0
        return Analytic(
            place=self.place,
            hit=_kernels.cylinder_hit,
            describe=_kernels.cylinder_surface,
            constants=(radius, half, self.caps),
            size_mm=2.0 * math.hypot(radius, half),
            convex=self.caps,
            inside=(lambda x, y, z: math.hypot(x, y) < radius and abs(z) < half) if self.caps else None,
        )


class Box(AxisTable):
    """`kind = "box"`: `center_mm` is its middle, and `size_mm` its lengths along x_axis, axis x x_axis, and axis."""

    kind: Literal["box"]
    size_mm: tuple[Length, Length, Length]

    def build(self, folder: Path) -> Analytic:
        """The shape."""
        half = np.array(self.size_mm) / 2.0
        return Analytic(
            place=self.place,
            hit=_kernels.box_hit,
            describe=_kernels.box_surface,
            constants=(half,),
            size_mm=math.hypot(*self.size_mm),
            convex=True,
            inside=lambda x, y, z: abs(x) < half[0] and abs(y) < half[1] and abs(z) < half[2],
        )


MAX_POINTS = 10_000
"""Points of a profile in a scene file."""
CHORD_ERROR = 5e-7
"""Part of the shape's size by which the frusta of a smooth surface are off it; half of what is promised."""
MARGIN = 1e-12
"""Part of the shape's size by which neighbouring frusta overlap, so that rounding opens no gap between them."""


class Revolution(AxisTable):
    """`kind = "revolution"`: a profile turned about `axis`, z = 0 at `center_mm`.

    The outside is where the profile, followed so that the volume beside it is positive, has its right: away from the
    axis, where it does not turn back. uv: u is the azimuth, v the share of the profile's length, followed that way.

    Attributes
    ----------
    profile_mm
        Points [r, z] in the order in which they are joined; the last may be the first again (a ring).
    caps
        Whether ends that are not on the axis are closed by discs.
    smooth
        A C2 cubic spline through the points, level where it meets the axis, instead of straight lines. It is cut into
        frusta that are off it by less than 1e-6 of the size, and shaded with its own normals.
    """

    kind: Literal["revolution"]
    profile_mm: list[tuple[Coordinate, Coordinate]] = Field(min_length=2, max_length=MAX_POINTS)
    caps: bool = False
    smooth: bool = False

    @model_validator(mode="after")
    def _is_a_profile(self) -> "Revolution":
        points = np.array(self.profile_mm)
        for k, (r, _) in enumerate(points):
            if r < 0.0:
                raise ValueError(f"profile_mm[{k + 1}] has r = {r:g}: it is a distance from the axis, 0 or more")
        steps = np.hypot(*np.diff(points, axis=0).T)
        same = np.flatnonzero(steps <= MARGIN * np.max(np.ptp(points, axis=0), initial=np.max(np.abs(points))))
        if same.size:
            raise ValueError(f"profile_mm[{same[0] + 1}] and [{same[0] + 2}] are one point: leave one out")
        if not np.any(points[:, 0] > 0.0):
            raise ValueError("profile_mm lies on the axis: some point must have r > 0")
        crossing = _crossing(points)
        if crossing:
            one, other = crossing
            raise ValueError(f"profile_mm crosses itself between [{one}], [{one + 1}] and [{other}], [{other + 1}]")
        return self

    def build(self, folder: Path) -> Analytic:
        """The shape."""
        points = np.array(self.profile_mm)
        loop = bool(np.all(points[0] == points[-1])) and len(points) > 3
        size = float(math.hypot(2.0 * points[:, 0].max(), np.ptp(points[:, 1])))
        if self.smooth:
            points, slopes = _spline(points, loop, size)
        else:
            slopes = np.zeros((len(points) - 1, 2, 3))  # never looked at
        if self.caps and not loop:
            points, slopes = _capped(points, slopes)
        closed = loop or (points[0, 0] == 0.0 and points[-1, 0] == 0.0)
        r, z = points.T
        # the volume beside the profile: the integral of r^2 dz / 2 over straight pieces
        if np.sum((r[:-1] ** 2 + r[:-1] * r[1:] + r[1:] ** 2) * np.diff(z)) < 0.0:
            points = np.ascontiguousarray(points[::-1])
            slopes = _reversed(slopes)
        step = np.diff(points, axis=0)
        length = np.hypot(*step.T)
        before = np.concatenate([[0.0], np.cumsum(length)[:-1]])
        frusta = np.column_stack([step / length[:, np.newaxis], length, before])
        nodes, bounds = _tree(points, MARGIN * size)
        return Analytic(
            place=self.place,
            hit=_kernels.revolution_hit,
            describe=_kernels.revolution_surface,
            constants=(
                points,
                frusta,
                np.ascontiguousarray(slopes) if self.smooth else np.empty((0, 2, 3)),
                nodes,
                bounds,
                MARGIN * size,
            ),
            size_mm=size,
            convex=closed and not loop and _bulges(frusta),
            inside=(lambda x, y, z: _within(points, math.hypot(x, y), z)) if closed else None,
        )


def _crossing(points: Floats) -> tuple[int, int] | None:
    """The numbers, from 1, of two pieces of a profile that cross, not only touch."""

    def side(a: Floats, b: Floats, c: Floats) -> Floats:
        (x, y), (u, v) = (b - a).T, (c - a).T
        return np.asarray(x * v - y * u)

    start, end = points[:-1], points[1:]
    for k in range(len(start) - 2):
        a, b, c, d = start[k], end[k], start[k + 2 :], end[k + 2 :]
        cut = (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)
        if cut.any():
            return k + 1, k + 3 + int(cut.argmax())
    return None


def _spline(points: Floats, loop: bool, size: float) -> tuple[Floats, Floats]:
    """Points on the C2 spline through the profile, and the derivatives between them as quadratics of the share.

    The parameter is the chord length. At the axis the curve is what mirroring it there goes on with: r'' = 0, z' = 0.
    Elsewhere it ends without curvature.
    """
    from scipy.interpolate import CubicSpline

    knots = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    if loop:
        curves = [CubicSpline(knots, points[:, k], bc_type="periodic") for k in (0, 1)]
    else:
        free, level = (2, 0.0), (1, 0.0)
        at_z = tuple(level if points[end, 0] == 0.0 else free for end in (0, -1))
        curves = [
            CubicSpline(knots, points[:, 0], bc_type=(free, free)),
            CubicSpline(knots, points[:, 1], bc_type=at_z),
        ]
    # a chord of the parameter h is off a curve of the second derivative c by at most c h^2 / 8
    curvature = np.max([np.abs(curve(knots, 2)) for curve in curves], axis=0) * math.sqrt(2.0)
    curvature = np.maximum(curvature[:-1], curvature[1:])
    counts = np.ceil(np.diff(knots) * np.sqrt(curvature / (8.0 * CHORD_ERROR * size))).astype(int).clip(1)
    s = np.concatenate(
        [*(np.linspace(a, b, n + 1)[:-1] for a, b, n in zip(knots, knots[1:], counts, strict=False)), knots[-1:]]
    )
    first, step = s[:-1], np.diff(s)
    slopes = np.empty((len(step), 2, 3))
    for k, curve in enumerate(curves):
        slopes[:, k, 2] = curve(first, 1) * step
        slopes[:, k, 1] = curve(first, 2) * step**2
        slopes[:, k, 0] = curve(first + 0.5 * step, 3) * step**3 / 2.0
    through = np.column_stack([curve(s) for curve in curves])
    through[-1] = points[-1]
    if np.any(through[:, 0] < 0.0):
        k = int(np.searchsorted(knots, s[np.argmin(through[:, 0])]))
        raise ConfigError(
            f"profile_mm: the smooth curve crosses the axis near point {k}: give more points there, or smooth = false"
        )
    return through, slopes


def _capped(points: Floats, slopes: Floats) -> tuple[Floats, Floats]:
    """A profile that is closed to the axis at both ends."""
    for end in (0, -1):
        if points[end, 0] > 0.0:
            on_axis = np.array([[0.0, points[end, 1]]])
            flat = np.zeros((1, 2, 3))
            flat[0, 0, 2] = points[end, 0] if end == 0 else -points[end, 0]
            parts = [(on_axis, points), (flat, slopes)] if end == 0 else [(points, on_axis), (slopes, flat)]
            points, slopes = (np.concatenate(part) for part in parts)
    return points, slopes


def _reversed(slopes: Floats) -> Floats:
    """The derivatives along a profile that is followed the other way: the share s becomes 1 - s."""
    a, b, c = np.moveaxis(slopes[::-1], -1, 0)
    return np.stack([-a, 2.0 * a + b, -(a + b + c)], axis=-1)


def _tree(points: Floats, margin: float) -> tuple[NDArray[np.int64], Floats]:
    """Frusta by halves: first, last and the first of two children (0 for none); bounds of r and z."""
    nodes = [[0, len(points) - 1, 0]]
    for node in nodes:  # which grows
        first, last, _ = node
        if last - first > _kernels.LEAF:
            middle = (first + last) // 2
            node[2] = len(nodes)
            nodes += [[first, middle, 0], [middle, last, 0]]
    bounds = []
    for first, last, _ in nodes:
        r, z = points[first : last + 1].T
        bounds.append([max(r.min() - margin, 0.0), r.max() + margin, z.min() - margin, z.max() + margin])
    return np.array(nodes, np.int64), np.array(bounds)


def _bulges(frusta: Floats) -> bool:
    """Whether a profile from the axis to the axis turns one way only."""
    r, z = frusta[:, 0], frusta[:, 1]
    turns = r[:-1] * z[1:] - z[:-1] * r[1:]
    return bool(r[0] > 0.0 and z[0] >= 0.0 and r[-1] < 0.0 and z[-1] >= 0.0 and np.all(turns >= -MARGIN))


def _within(points: Floats, rho: float, height: float) -> bool:
    """Whether a point lies inside: an odd number of frusta lie farther out at its height."""
    (r0, z0), (r1, z1) = points[:-1].T, points[1:].T
    spans = (z0 <= height) != (z1 <= height)
    r = r0[spans] + (height - z0[spans]) / (z1[spans] - z0[spans]) * (r1[spans] - r0[spans])
    return bool(np.count_nonzero(r > rho) % 2)
