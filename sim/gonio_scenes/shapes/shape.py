"""What a shape is: where rays meet it, and what its surface is there; where it stands, and the keys that all share."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from gonio.config import Strict
from gonio.models.engine import in_parts
from gonio.typing import ArrayLike, Floats, NDArray

Ints = NDArray[np.int64]

LARGEST_MM = 1e9
"""No length in a scene file is longer: a thousand kilometres."""
SPLIT = 16384
"""Rays a thread must have to be worth waking: some 0.3 ms of work against 20 us."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """The surface where rays meet it. All float64; n rays.

    Attributes
    ----------
    position : (n, 3)
        On the surface itself, to the arithmetic [mm].
    normal : (n, 3)
        Unit, geometric, outward.
    shading : (n, 3)
        Unit, the normal that a BRDF sees: `normal`, unless the shape is smoothed.
    tangent : (n, 3)
        Unit, perpendicular to `shading`, along growing u; v grows along shading x tangent.
    uv : (n, 2)
        In [0, 1].
    """

    position: Floats
    normal: Floats
    shading: Floats
    tangent: Floats
    uv: Floats


class Shape(Protocol):
    """A kind of geometry. Rays are two arrays (n, 3): origins [mm], and directions of unit length."""

    @property
    def convex(self) -> bool:
        """Whether no straight line that leaves its outside comes back to it: no shadow of its own falls there."""

    @property
    def closed(self) -> bool:
        """Whether it has an inside."""

    @property
    def size_mm(self) -> float:
        """A length to scale tolerances with."""

    def intersect(self, origin: Floats, direction: Floats, nearest: float) -> tuple[Floats, Ints]:
        """Distance along each ray [mm], inf where none, and the primitive; hits at or below `nearest` do not count."""

    def surface(self, origin: Floats, direction: Floats, distance: Floats, primitive: Ints) -> Surface:
        """The surface at hits that `intersect` found."""

    def contains(self, point: ArrayLike) -> bool:
        """Whether a closed shape has a point (3,) [mm] inside; False where it is not closed."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """Where a shape stands: its own frame has x, y, z along the rows of `axes` and its origin at `center` [mm]."""

    center: Floats
    axes: Floats

    def local(self, point: ArrayLike) -> tuple[float, float, float]:
        """A point in the shape's own frame."""
        x, y, z = self.axes @ (np.asarray(point, np.float64) - self.center)
        return float(x), float(y), float(z)


def rays(origin: Floats, direction: Floats) -> tuple[Floats, Floats]:
    """Origins and directions as the kernels take them: (n, 3), float64, contiguous."""
    return np.ascontiguousarray(origin, np.float64), np.ascontiguousarray(direction, np.float64)


def over_rays(kernel: Callable[..., None], count: int, *arguments: Any) -> None:
    """Run a compiled loop over rays, `kernel(*arguments, start, stop)`, in threads where there are many rays."""
    in_parts(lambda start, stop: kernel(*arguments, start, stop), count, SPLIT)


# --- files and keys of the scene file ----------


BESIDE_SCENE = "; paths count from the folder of the scene file"


def _not_zero(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(vector):
        raise ValueError("is no direction: one component at least must not be 0")
    return vector


Coordinate = Annotated[float, Field(ge=-LARGEST_MM, le=LARGEST_MM)]
Length = Annotated[float, Field(gt=0.0, le=LARGEST_MM)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Axis = Annotated[tuple[Coordinate, Coordinate, Coordinate], AfterValidator(_not_zero)]
"""A direction of any length but 0."""


def unit(vector: ArrayLike) -> Floats:
    """A vector of length 1; of any length but 0 before."""
    array = np.asarray(vector, np.float64)
    array = array / np.max(np.abs(array))
    return np.asarray(array / np.linalg.norm(array))


def placement(center: ArrayLike, axis: ArrayLike, x_axis: ArrayLike | None) -> Placement:
    """A frame whose z is `axis` and whose x is what `x_axis` has perpendicular to it.

    Without `x_axis`, x is (0, 1, 0) x z: a texture stands upright where y is up. Where the axis is y itself, x is
    (1, 0, 0).
    """
    z = unit(axis)
    if x_axis is not None:
        x = unit(x_axis)
        x = x - (x @ z) * z
    else:
        x = np.cross((0.0, 1.0, 0.0), z)
        if np.linalg.norm(x) < PARALLEL:
            x = np.array([1.0, 0.0, 0.0])
            x = x - (x @ z) * z
    x = unit(x)
    x = unit(x - (x @ z) * z)  # once more: the first time left a rounding error that is large beside a short x
    return Placement(np.array(center, np.float64), np.array([x, np.cross(z, x), z]))


PARALLEL = 1e-6
"""Sine of the angle below which two axes of a scene file span no plane."""


def refuse_parallel(name: str, axis: ArrayLike, other: ArrayLike | None, called: str = "x_axis") -> None:
    """Raise ValueError, for pydantic, where a vector, `called` so in the file, is along the axis called `name`."""
    if other is not None and np.linalg.norm(np.cross(unit(axis), unit(other))) < PARALLEL:
        raise ValueError(f"{called} = {np.asarray(other).tolist()} is parallel to {name}: give one that is not")


class ShapeTable(Strict):
    """What the table of every shape has.

    Attributes
    ----------
    material
        The name of a `[material.NAME]` of the scene.
    name
        What messages call the shape; its kind and number otherwise.
    center_mm
        Where the shape's own origin lies.
    x_axis
        Where the shape's own x points, from which azimuths and u count: its part perpendicular to the axis.
    """

    material: str
    name: str | None = None
    center_mm: Point = (0.0, 0.0, 0.0)

    def build(self, folder: Path) -> Shape:
        """The shape; files are looked for in `folder`.

        Raises
        ------
        ConfigError
            A file is missing, or is not what the table says; the message names key, file and remedy.
        """
        raise NotImplementedError


class AxisTable(ShapeTable):
    """A shape about an axis."""

    axis: Axis = (0.0, 0.0, 1.0)
    x_axis: Axis | None = None

    @property
    def place(self) -> Placement:
        """Where the shape stands."""
        return placement(self.center_mm, self.axis, self.x_axis)

    @model_validator(mode="after")
    def _axes_differ(self) -> "AxisTable":
        refuse_parallel("axis", self.axis, self.x_axis)
        return self


class FlatTable(ShapeTable):
    """A shape along a plane."""

    normal: Axis = (0.0, 0.0, 1.0)
    x_axis: Axis | None = None

    @property
    def place(self) -> Placement:
        """Where the shape stands."""
        return placement(self.center_mm, self.normal, self.x_axis)

    @model_validator(mode="after")
    def _axes_differ(self) -> "FlatTable":
        refuse_parallel("normal", self.normal, self.x_axis)
        return self
