"""Triangles: Embree says which one a ray meets, float64 says where."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gonio.errors import ConfigError
from gonio.models.engine import in_parts
from gonio.typing import ArrayLike, Floats, NDArray
from gonio_scenes.shapes import _triangle_kernels as kernels
from gonio_scenes.shapes.shape import Ints, Surface, over_rays, rays

Faces = NDArray[np.int32]

ROUNDS = 8
"""Searches along a ray; one that still meets only what does not count is met with all triangles."""
NO_EMBREE = (
    "meshes and height fields need Embree, which is not installed here: pip install embreex (it has wheels for "
    "x86-64 Linux, Windows and macOS on arm64), or draw the scene with the other shapes"
)


@dataclass(frozen=True, slots=True, eq=False)
class PerCorner:
    """Values at the corners of triangles: rows of `values`, named by `faces` (m, 3)."""

    values: Floats
    faces: Faces


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """A shape of triangles.

    Attributes
    ----------
    vertices : (n, 3)
        Float64 [mm].
    faces : (m, 3)
        Int32, wound counterclockwise seen from outside; none has an area of 0.
    closed
        Whether they enclose a volume.
    normals
        Unit vectors that shade, at the corners; None for facets.
    uv
        Texture coordinates at the corners, repeated outside [0, 1]; None where there are none.

    Raises
    ------
    ConfigError
        Embree is not installed.
    """

    vertices: Floats
    faces: Faces
    closed: bool
    normals: PerCorner | None = None
    uv: PerCorner | None = None
    convex: bool = field(default=False, init=False)
    size_mm: float = field(init=False)
    _center: Floats = field(init=False)
    _radius: float = field(init=False)
    _fan_start: Ints = field(init=False)
    _fan: Faces = field(init=False)
    _embree: tuple[Any, ...] = field(init=False)

    def __post_init__(self) -> None:
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        center = (low + high) / 2.0
        size = float(np.linalg.norm(high - low))
        corners = self.faces.reshape(-1)
        own = {
            "size_mm": size,
            "_center": center,
            # a little more than the sphere around it, for the roundings of float32 where a ray enters
            "_radius": 1.001 * float(np.linalg.norm(self.vertices - center, axis=1).max()),
            "_fan_start": np.concatenate([[0], np.cumsum(np.bincount(corners, minlength=len(self.vertices)))]),
            "_fan": (np.argsort(corners, kind="stable") // 3).astype(np.int32),
        }
        own["_embree"] = _scene((self.vertices - center) / own["_radius"], self.faces)
        for name, value in own.items():
            object.__setattr__(self, name, value)

    @property
    def has_uv(self) -> bool:
        """Whether a texture has its place."""
        return self.uv is not None

    def intersect(self, origin: Floats, direction: Floats, nearest: float) -> tuple[Floats, Ints]:
        """See `Shape`."""
        origin, direction = rays(origin, direction)
        nearest = float(nearest)
        count = len(origin)
        since, distance = np.empty(count), np.full(count, np.inf)
        primitive, state = np.zeros(count, np.int64), np.zeros(count, np.int8)
        over_rays(kernels.begin, count, origin, direction, nearest, self._center, self._radius, since)
        left = np.flatnonzero(since < np.inf)
        for _ in range(ROUNDS):
            if left.size:
                self._once(origin, direction, nearest, left, since, distance, primitive, state)
                left = left[state[left] == kernels.AGAIN]
        unclear = np.flatnonzero(state != kernels.DONE)
        in_parts(
            lambda start, stop: kernels.all_of_them(
                origin, direction, nearest, unclear, self.vertices, self.faces, distance, primitive, start, stop
            ),
            unclear.size,
            1,
        )
        return distance, primitive

    def _once(
        self,
        origin: Floats,
        direction: Floats,
        nearest: float,
        left: Ints,
        since: Floats,
        distance: Floats,
        primitive: Ints,
        state: NDArray[np.int8],
    ) -> None:
        """One search along the rays `left`, each from where `since` says."""
        origin_32, direction_32 = np.empty((2, left.size, 3), np.float32)
        over_rays(
            kernels.single, left.size, origin, direction, left, since, self._center, self._radius, origin_32,
            direction_32,
        )  # fmt: skip
        found = self._embree[0].run(origin_32, direction_32, output=1)
        over_rays(
            kernels.refine, left.size, origin, direction, nearest, left, found["primID"], found["tfar"], since,
            self.vertices, self.faces, self._fan_start, self._fan, self._radius, distance, primitive, state,
        )  # fmt: skip

    def surface(self, origin: Floats, direction: Floats, distance: Floats, primitive: Ints) -> Surface:
        """See `Shape`."""
        origin, direction = rays(origin, direction)
        primitive = np.ascontiguousarray(primitive, np.int64)
        out = (*np.empty((4, len(origin), 3)), np.empty((len(origin), 2)))
        normals = self.normals or PerCorner(np.empty((0, 3)), self.faces)
        coordinates = self.uv or PerCorner(np.empty((0, 2)), self.faces)
        over_rays(
            kernels.describe, len(origin), origin, direction, primitive, self.vertices, self.faces, normals.values,
            normals.faces, coordinates.values, coordinates.faces, *out,
        )  # fmt: skip
        return Surface(*out)

    def contains(self, point: ArrayLike) -> bool:
        """See `Shape`: the solid angles of the triangles, with their signs, add up to 4 pi inside and to 0 outside."""
        if not self.closed:
            return False
        a, b, c = np.moveaxis(self.vertices[self.faces] - np.asarray(point, np.float64), 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        ab, bc, ca = (np.einsum("ij,ij->i", p, q) for p, q in ((a, b), (b, c), (c, a)))
        # Van Oosterom and Strackee 1983, eq. 8
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        solid_angle = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        return bool(np.sum(solid_angle) > 2.0 * np.pi)


def _scene(vertices: Floats, faces: Faces) -> tuple[Any, ...]:
    """Embree's scene and what must live as long: without the mesh object it has no triangles."""
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise ConfigError(NO_EMBREE) from error
    scene = EmbreeScene(robust=True)
    single = np.ascontiguousarray(vertices, np.float32)
    mesh = TriangleMesh(scene, single, np.ascontiguousarray(faces, np.int32))
    return scene, mesh, single
