"""All shapes of a scene together: what a ray meets first, and whether something stands before a light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_scenes._frames import settle
from gonio_scenes.shapes import Shape

CLOSE = 1e-9
"""A ray that leaves a surface ignores that surface up to this share of its size: rounding of the hit's position."""

Indices = npt.NDArray[np.int64]


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

    def picked(self, here: Indices) -> Hits:
        """Some of the hits."""
        return Hits(*(getattr(self, each.name).take(here, axis=0) for each in fields(self)))


class World:
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

    def blocked(
        self, direction: Floats, distance: Floats | float, leaving: Hits, here: Indices
    ) -> npt.NDArray[np.bool_]:
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
        position, normal, facing, tangent = (np.zeros((count, 3)) for _ in range(4))
        uv = np.zeros((count, 2))
        for k, shape in enumerate(self.shapes):
            here = np.flatnonzero(which == k)
            if here.size == 0:
                continue
            starts, toward = origin.take(here, axis=0), direction.take(here, axis=0)
            met = shape.surface(starts, toward, distance.take(here), primitive.take(here))
            settle(here, direction, met, position, normal, facing, tangent, uv)
        return Hits(which, np.where(which >= 0, distance, 0.0), position, normal, facing, tangent, uv)
