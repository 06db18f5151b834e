"""A sphere, a cylinder, and a box."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from gonio_scenes.shapes import _kernels
from gonio_scenes.shapes.shape import Analytic, AxisTable, Length


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
