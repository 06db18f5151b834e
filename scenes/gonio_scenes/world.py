"""All shapes of a scene together: what a ray meets first, and whether something stands before a light."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
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

    def at(self, here: Indices) -> Hits:
        """Some of the hits."""
        return Hits(*(getattr(self, name)[here] for name in Hits.__dataclass_fields__))


class World:
    """The shapes of a scene, in the order of its file."""

    def __init__(self, shapes: Sequence[Shape]) -> None:
        self.shapes = tuple(shapes)
        self.casts_shadows = len(self.shapes) > 1 or any(not shape.convex for shape in self.shapes)
        """Whether anything can stand before a light: not where one convex shape is all."""

    def hit(self, origin: Floats, direction: Floats, leaving: Hits | None = None) -> Hits:
        """The first shape that each ray meets; `leaving` holds the hits that the rays start from, if they do."""
        count = direction.shape[0]
        nearest = np.full(count, np.inf)
        which = np.full(count, -1, dtype=np.int64)
        primitive = np.zeros(count, dtype=np.int64)
        for k, shape in enumerate(self.shapes):
            for here, start in self._tried(k, direction, leaving):
                distance, part = shape.intersect(origin[here], direction[here], start)
                nearer = np.flatnonzero(distance < nearest[here])
                place = nearer if isinstance(here, slice) else here[nearer]
                nearest[place] = distance[nearer]
                which[place] = k
                primitive[place] = part[nearer]
        return self._surfaces(origin, direction, nearest, which, primitive)

    def blocked(self, direction: Floats, distance: Floats | float, leaving: Hits) -> npt.NDArray[np.bool_]:
        """Whether a shape stands between each hit and a light in a direction, so far away."""
        out = np.zeros(direction.shape[0], dtype=bool)
        far = np.broadcast_to(distance, out.shape)
        for k, shape in enumerate(self.shapes):
            for part, start in self._tried(k, direction, leaving):
                here = np.flatnonzero(~out) if isinstance(part, slice) else part[~out[part]]
                if here.size:
                    met, _ = shape.intersect(leaving.position[here], direction[here], start)
                    out[here[met < far[here]]] = True
        return out

    def _tried(
        self, k: int, direction: Floats, leaving: Hits | None
    ) -> Iterator[tuple[Indices | slice, float]]:
        """The rays that may meet a shape, in groups, with the distance up to which hits do not count.

        A ray that leaves a convex shape on the outside does not come back.
        """
        if leaving is None:
            yield slice(None), 0.0
            return
        shape, own = self.shapes[k], leaving.shape == k
        if not own.any():
            yield slice(None), 0.0
            return
        others = np.flatnonzero(~own)
        if others.size:
            yield others, 0.0
        if shape.convex:
            if not shape.closed:
                return
            own &= np.einsum("ij,ij->i", direction, leaving.normal) < 0.0
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
            met = shape.surface(origin[here], direction[here], distance[here], primitive[here])
            position[here], normal[here], uv[here] = met.position, met.normal, met.uv
            behind = np.einsum("ij,ij->i", met.normal, direction[here]) > 0.0
            shading = met.shading
            # where a smoothed normal looks away from the viewer, the facet's own is taken
            away = (np.einsum("ij,ij->i", shading, direction[here]) > 0.0) != behind
            shading = np.where(away[:, None], met.normal, shading)
            facing[here] = np.where(behind[:, None], -shading, shading)
            across = met.tangent - np.einsum("ij,ij->i", met.tangent, facing[here])[:, None] * facing[here]
            tangent[here] = across / np.linalg.norm(across, axis=1)[:, None]
        return Hits(which, np.where(which >= 0, distance, 0.0), position, normal, facing, tangent, uv)
