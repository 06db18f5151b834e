"""All shapes of a scene together: what a ray meets first, and whether something stands before a light.

The compiled loops read and write every number once. Rays are shared by threads as the shapes' own loops share them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from gonio.typing import Bools, Floats, NDArray
from gonio_scenes.shapes import Shape
from gonio_scenes.shapes._kernels import compiled
from gonio_scenes.shapes.shape import over_rays

CLOSE = 1e-9
"""A ray that leaves a surface ignores that surface up to this share of its size: rounding of the hit's position."""

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Hits:
    """What rays met first. Arrays are of the rays' length; where `shape` is -1 nothing was met, and the rest is 0."""

    shape: Indices
    distance: Floats
    position: Floats
    normal: Floats
    """Unit normals (n, 3) of the shape, outward, whichever side was met."""
    facing: Floats
    """Unit normals (n, 3) of the surface that light meets, turned toward where the ray came from."""
    tangent: Floats
    """Unit vectors (n, 3) along growing u, across `facing`: the x axis of the material."""
    uv: Floats

    def picked(self, here: Indices) -> "Hits":
        """Some of the hits."""
        return Hits(*(getattr(self, each.name).take(here, axis=0) for each in fields(self)))


class SceneShapes:
    """The shapes of a scene, in the order of its file, for a camera at the point `eye` [mm]."""

    def __init__(self, shapes: Sequence[Shape], eye: Floats) -> None:
        self.shapes = tuple(shapes)
        self.casts_shadows = len(self.shapes) > 1 or any(
            not shape.convex or shape.contains(eye) for shape in self.shapes
        )
        """Whether anything can stand before a light: not where one convex shape is all, looked at from outside."""

    def hit(self, origin: Floats, direction: Floats, leaving: Hits | None = None) -> Hits:
        """The first shape that each ray meets; `leaving` holds the hits that the rays start from, if they do."""
        count = direction.shape[0]
        nearest = np.full(count, np.inf)
        which = np.full(count, -1, dtype=np.int64)
        primitive = np.zeros(count, dtype=np.int64)
        for k, shape in enumerate(self.shapes):
            tried = (
                [(slice(None), 0.0)] if leaving is None else self._tried(k, direction, leaving.shape, leaving.normal)
            )
            for here, start in tried:
                distance, part = shape.intersect(origin[here], direction[here], start)
                nearer = np.flatnonzero(distance < nearest[here])
                place = nearer if isinstance(here, slice) else here[nearer]
                nearest[place] = distance[nearer]
                which[place] = k
                primitive[place] = part[nearer]
        return self._surfaces(origin, direction, nearest, which, primitive)

    def blocked(self, direction: Floats, distance: Floats | float, leaving: Hits, here: Indices) -> Bools:
        """Whether a shape stands between each of the hits `here` and a light.

        Parameters
        ----------
        direction, distance
            Unit vectors toward the light, and how far it is, of all hits `leaving`: (n, 3) and (n,), or one for all.
        leaving, here
            The hits, and the numbers of those that are asked for.
        """
        toward = np.broadcast_to(direction, leaving.position.shape)[here]
        far, leaves = np.broadcast_to(distance, leaving.shape.shape)[here], leaving.shape[here]
        position, normal = (a.take(here, axis=0) for a in (leaving.position, leaving.normal))
        out = np.zeros(here.size, dtype=bool)
        for k in range(len(self.shapes)):
            for part, start in self._tried(k, toward, leaves, normal):
                left = np.flatnonzero(~out) if isinstance(part, slice) else part[~out[part]]
                if left.size:
                    met, _ = self.shapes[k].intersect(position.take(left, axis=0), toward.take(left, axis=0), start)
                    out[left[met < far[left]]] = True
        return out

    def _tried(
        self, k: int, direction: Floats, leaves: Indices, normal: Floats
    ) -> Iterator[tuple[Indices | slice, float]]:
        """The rays that may meet a shape, in groups, with the distance up to which hits do not count.

        `leaves` and `normal` are the shapes that the rays leave, -1 for none, and their normals there. A ray that
        leaves a convex shape on the outside does not come back.
        """
        shape, own = self.shapes[k], leaves == k
        if not own.any():
            yield slice(None), 0.0
            return
        others = np.flatnonzero(~own)
        if others.size:
            yield others, 0.0
        if shape.convex:
            if not shape.closed:
                return
            own &= np.einsum("ij,ij->i", direction, normal) < 0.0
        again = np.flatnonzero(own)
        if again.size:
            yield again, CLOSE * shape.size_mm

    def _surfaces(
        self, origin: Floats, direction: Floats, distance: Floats, which: Indices, primitive: Indices
    ) -> Hits:
        count = direction.shape[0]
        out = (*(np.zeros((count, 3)) for _ in range(4)), np.zeros((count, 2)))
        for k, shape in enumerate(self.shapes):
            here = np.flatnonzero(which == k)
            if here.size == 0:
                continue
            starts, toward = origin.take(here, axis=0), direction.take(here, axis=0)
            met = shape.surface(starts, toward, distance.take(here), primitive.take(here))
            surface = met.position, met.normal, met.shading, met.tangent, met.uv
            over_rays(_settle, here.size, here, direction, surface, out)
        return Hits(which, np.where(which >= 0, distance, 0.0), *out)


# --- compiled loops ---------------------------------------------------------------------------------------------------


@compiled
def _toward_plane(x: Any, y: Any, axes: Any, out: Any, start: int, stop: int) -> None:
    right, down, forward = axes
    for i in range(start, stop):
        a = forward[0] + x[i] * right[0] + y[i] * down[0]
        b = forward[1] + x[i] * right[1] + y[i] * down[1]
        c = forward[2] + x[i] * right[2] + y[i] * down[2]
        f = 1.0 / math.sqrt(a * a + b * b + c * c)
        out[i, 0], out[i, 1], out[i, 2] = a * f, b * f, c * f


def toward_plane(x: Floats, y: Floats, right: Floats, down: Floats, forward: Floats) -> Floats:
    """Unit directions (n, 3) from a hole to points (x, y) of the picture at distance 1 before it."""
    out = np.empty((x.size, 3))
    over_rays(_toward_plane, x.size, x, y, (right, down, forward), out)
    return out


@compiled
def _settle(here: Any, direction: Any, met: Any, out: Any, start: int, stop: int) -> None:
    """Write the surfaces that the rays `here` met into arrays of all rays, turned toward where the rays came from."""
    met_position, met_normal, met_shading, met_tangent, met_uv = met
    position, normal, facing, tangent, uv = out
    for j in range(start, stop):
        i = here[j]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        x, y, z = met_normal[j, 0], met_normal[j, 1], met_normal[j, 2]
        position[i, 0], position[i, 1], position[i, 2] = met_position[j, 0], met_position[j, 1], met_position[j, 2]
        normal[i, 0], normal[i, 1], normal[i, 2] = x, y, z
        uv[i, 0], uv[i, 1] = met_uv[j, 0], met_uv[j, 1]
        behind = x * dx + y * dy + z * dz > 0.0
        sx, sy, sz = met_shading[j, 0], met_shading[j, 1], met_shading[j, 2]
        # where a smoothed normal looks away from the viewer, the facet's own is taken
        if (sx * dx + sy * dy + sz * dz > 0.0) == behind:
            x, y, z = sx, sy, sz
        if behind:
            x, y, z = -x, -y, -z
        facing[i, 0], facing[i, 1], facing[i, 2] = x, y, z
        a, b, c = met_tangent[j, 0], met_tangent[j, 1], met_tangent[j, 2]
        along = a * x + b * y + c * z
        a, b, c = a - along * x, b - along * y, c - along * z
        f = 1.0 / math.sqrt(a * a + b * b + c * c)
        tangent[i, 0], tangent[i, 1], tangent[i, 2] = a * f, b * f, c * f


@compiled
def _local(direction: Any, step: int, sign: float, facing: Any, tangent: Any, out: Any, start: int, stop: int) -> None:
    for i in range(start, stop):
        dx, dy, dz = sign * direction[i * step, 0], sign * direction[i * step, 1], sign * direction[i * step, 2]
        x, y, z = facing[i, 0], facing[i, 1], facing[i, 2]
        a, b, c = tangent[i, 0], tangent[i, 1], tangent[i, 2]
        out[i, 0] = dx * a + dy * b + dz * c
        out[i, 1] = dx * (y * c - z * b) + dy * (z * a - x * c) + dz * (x * b - y * a)
        out[i, 2] = dx * x + dy * y + dz * z


def local(direction: Floats, facing: Floats, tangent: Floats, sign: float = 1.0) -> Floats:
    """Directions (n, 3), or one (3,), times `sign`, in the surface's frame: x its tangent, z its normal `facing`."""
    step = 0 if direction.ndim == 1 else 1
    rows = np.ascontiguousarray(direction).reshape(-1, 3)
    out = np.empty(facing.shape)
    over_rays(_local, len(out), rows, step, sign, facing, tangent, out)
    return out
