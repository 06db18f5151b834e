"""A plane, and a disc."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Literal

import numpy as np

from gonio_scenes.shapes import _kernels
from gonio_scenes.shapes.shape import Analytic, FlatTable, Length


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
