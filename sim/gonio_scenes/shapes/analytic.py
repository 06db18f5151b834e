"""Shapes of formulas: plane, disc, sphere, cylinder and box."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gonio.typing import ArrayLike, Floats
from gonio_scenes.shapes import _kernels
from gonio_scenes.shapes.shape import AxisTable, FlatTable, Ints, Length, Placement, Surface, over_rays, rays


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
    has_uv: bool = field(default=True, init=False)

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
