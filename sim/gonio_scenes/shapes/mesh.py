"""A triangle mesh from a file: read, checked, turned and placed.

Also here is a rectangle whose heights a picture gives.
"""

import io
import struct
import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from gonio.disk import content
from gonio.errors import ConfigError, DataError
from gonio.typing import ArrayLike, Floats, NDArray
from gonio_scenes.shapes.shape import (
    BESIDE_SCENE,
    LARGEST_MM,
    Axis,
    Coordinate,
    FlatTable,
    Length,
    ShapeTable,
    unit,
)
from gonio_scenes.shapes.triangles import Faces, PerCorner, Triangles

MAX_BYTES = 250_000_000
"""Text of as many triangles as are taken."""
MAX_TRIANGLES = 1_500_000
"""They take some 0.8 GB of memory while they are read."""
SLIVER = 1e-14
"""Area, in squares of the longest side, below which a triangle is a line that no ray meets."""
NO_AREA = "all of its triangles are points or lines: export it again from the program that made it"

Parts = tuple[Floats, NDArray[np.int64], Floats | None, Floats | None]
"""Vertices, faces, and normals and uv of each vertex."""


class Mesh(ShapeTable):
    """`kind = "mesh"`: triangles from an OBJ, PLY or STL file (longer polygons are cut into triangles).

    Attributes
    ----------
    file
        Path, from the folder of the scene file.
    scale
        Millimetres in a unit of the file.
    rotation_axis, rotation_deg
        The scaled mesh is turned right-handedly about an axis through its origin, then moved to `center_mm`.
    normals
        What shades: the facets themselves, normals that are smooth across them (the facets' at each vertex, weighted
        by angle), or those of the file.
    open
        A sheet, or a mesh with holes, is meant: it has no inside.
    """

    kind: Literal["mesh"]
    file: str = Field(min_length=1)
    scale: Length = 1.0
    rotation_axis: Axis = (0.0, 0.0, 1.0)
    rotation_deg: Coordinate = 0.0
    normals: Literal["facet", "smooth", "file"] = "facet"
    open: bool = False

    def build(self, folder: Path) -> Triangles:
        """The shape.

        Raises
        ------
        ConfigError
            The file is missing, or is no OBJ, PLY or STL file; or Embree is not installed.
        DataError
            The file cannot be read, is too large, holds no triangles or vertices that are no numbers, is open though
            `open` does not say so, or lacks the normals that are asked for.
        """
        path = folder / self.file
        where = f'file = "{self.file}" ({path})' if str(path) != self.file else f'file = "{path}"'
        vertices, faces, file_normals, uv = _checked(_read(path, where), where)
        turn = _rotation(self.rotation_axis, np.radians(self.rotation_deg))
        vertices = (vertices * self.scale) @ turn.T + self.center_mm
        if np.abs(vertices).max() > LARGEST_MM:
            raise DataError(f"{where}: has a vertex beyond {LARGEST_MM:g} mm: give another scale")
        corners = faces
        vertices, faces = _welded(vertices, faces)
        whole = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces, corners = faces[whole], corners[whole]
        if not len(faces):
            raise DataError(f"{where}: {NO_AREA}")
        closed = _is_closed(vertices, faces, where, self.open, self.normals)
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        if closed and np.einsum("ij,ij->", a - a.mean(axis=0), np.cross(b - a, c - a)) < 0.0:
            faces, corners = faces[:, ::-1], corners[:, ::-1]  # it was wound inside out
        area = np.cross(b - a, c - a)
        longest = np.maximum.reduce([np.sum(side**2, axis=1) for side in (b - a, c - b, a - c)])
        solid = np.linalg.norm(area, axis=1) > SLIVER * longest
        if not solid.any():
            raise DataError(f"{where}: {NO_AREA}")
        faces_32, corners_32 = (part[solid].astype(np.int32, order="C") for part in (faces, corners))
        return Triangles(
            vertices,
            faces_32,
            closed,
            normals=self._shading(vertices, faces_32, corners_32, file_normals, turn, where),
            uv=None if uv is None else PerCorner(uv, corners_32),
        )

    def _shading(
        self, vertices: Floats, faces: Faces, corners: Faces, of_file: Floats | None, turn: Floats, where: str
    ) -> PerCorner | None:
        if self.normals == "facet":
            return None
        if self.normals == "smooth":
            return PerCorner(smooth_normals(vertices, faces), faces)
        length = np.zeros(0) if of_file is None else np.linalg.norm(of_file, axis=1)
        if of_file is None or not np.all(np.isfinite(length[corners]) & (length[corners] > 0.0)):
            lacks = "has no normals" if of_file is None else "has normals that are no directions"
            kind = " (an STL file holds those of facets only)" if where.lower().rstrip(')"').endswith(".stl") else ""
            raise DataError(f'{where}: {lacks}{kind}: say normals = "smooth" or "facet"')
        used = np.unique(corners)
        values = np.zeros_like(of_file)
        values[used] = (of_file[used] / length[used, np.newaxis]) @ turn.T
        a, b, c = np.moveaxis(vertices[faces], 1, 0)
        if np.einsum("ij,ij->", values[corners].sum(axis=1), np.cross(b - a, c - a)) < 0.0:
            values = -values  # they were those of the inside
        return PerCorner(values, corners)


def smooth_normals(vertices: Floats, faces: Faces) -> Floats:
    """Unit normals at vertices: those of the facets around each, weighted by their angle there."""
    corner = vertices[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, np.newaxis]
    total = np.zeros_like(vertices)
    for k in range(3):
        one, other = corner[:, (k + 1) % 3] - corner[:, k], corner[:, (k + 2) % 3] - corner[:, k]
        angle = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), np.einsum("ij,ij->i", one, other))
        for axis in range(3):
            total[:, axis] += np.bincount(faces[:, k], angle * normal[:, axis], minlength=len(vertices))
    length = np.linalg.norm(total, axis=1)
    return np.asarray(total / np.where(length > 0.0, length, 1.0)[:, np.newaxis])


def _read(path: Path, where: str) -> Parts:
    kind = path.suffix.lower().lstrip(".")
    if kind not in ("obj", "ply", "stl"):
        raise ConfigError(f"{where}: is not a mesh that is read here: give an OBJ, PLY or STL file")
    size = path.stat().st_size if path.is_file() else 0
    if size > MAX_BYTES:
        raise DataError(f"{where}: has {size / 1e6:.0f} MB, and at most {MAX_BYTES / 1e6:.0f} MB are read: reduce it")
    data = content(path, where, BESIDE_SCENE)
    try:
        return _parsed(kind, data)
    except MemoryError:
        raise
    except Exception as error:  # whatever a damaged file makes of its reader
        # a library that its reader would have guessed an encoding with says nothing of the file
        text = "it is damaged, or cut short" if isinstance(error, ImportError) else " ".join(str(error).split())
        raise DataError(f"{where}: cannot be read as {kind.upper()}: {text or type(error).__name__}") from error


def _parsed(kind: str, data: bytes) -> Parts:
    """All triangles of a file as one mesh."""
    from trimesh.exchange.obj import load_obj
    from trimesh.exchange.ply import load_ply
    from trimesh.exchange.stl import load_stl
    from trimesh.geometry import triangulate_quads

    file = io.BytesIO(data)
    read: dict[str, Any] = (
        load_obj(file, skip_materials=True) if kind == "obj" else load_ply(file) if kind == "ply" else load_stl(file)
    )
    parts = list(read["geometry"].values()) if "geometry" in read else [read]
    parts = [part for part in parts if part.get("faces") is not None and len(part["faces"])]
    if not parts and kind == "stl":  # where its reader can guess an encoding, anything is a text without triangles
        raise ValueError("it is damaged, or cut short, or has no triangles")
    if not parts:
        return np.empty((0, 3)), np.empty((0, 3), np.int64), None, None
    vertices = [np.asarray(part["vertices"], np.float64) for part in parts]
    first = np.cumsum([0, *map(len, vertices)])
    faces = [np.asarray(triangulate_quads(part["faces"]), np.int64).reshape(-1, 3) for part in parts]
    for count, own in zip(map(len, vertices), faces, strict=True):
        if own.min() < 0 or own.max() >= count:
            raise ValueError(f"a triangle names vertex {own.max()} of {count}")
    normals = [part.get("vertex_normals") for part in parts]
    uv = [getattr(part.get("visual"), "uv", None) for part in parts]
    return (
        np.concatenate(vertices),
        np.concatenate([own + start for own, start in zip(faces, first[:-1], strict=True)]),
        _together(normals, vertices),
        _together(uv, vertices),
    )


def _together(values: list[Any], vertices: list[Floats]) -> Floats | None:
    """One array of what all parts have at their vertices; None where one lacks it."""
    if any(value is None or len(value) != len(own) for value, own in zip(values, vertices, strict=True)):
        return None
    return np.concatenate([np.asarray(value, np.float64) for value in values])


def _checked(parts: Parts, where: str) -> Parts:
    vertices, faces, _, uv = parts
    if not len(faces):
        raise DataError(f"{where}: holds no triangles")
    if len(faces) > MAX_TRIANGLES:
        raise DataError(f"{where}: has {len(faces)} triangles, and at most {MAX_TRIANGLES} are taken: reduce it")
    bad = np.flatnonzero(~np.isfinite(vertices[faces]).all(axis=(1, 2)))
    if bad.size:
        raise DataError(
            f"{where}: {bad.size} of its triangles have vertices that are no finite numbers, the first number "
            f"{bad[0] + 1}: repair it in the program that made it"
        )
    if uv is not None and not np.isfinite(uv[faces]).all():
        raise DataError(f"{where}: has texture coordinates that are no finite numbers: repair or remove them")
    return parts


def _welded(vertices: Floats, faces: NDArray[np.int64]) -> tuple[Floats, NDArray[np.int64]]:
    """The mesh with one vertex where several have the same place, and without those that no face names."""
    used, place = np.unique(faces, return_inverse=True)
    points = vertices[used] + 0.0  # no negative zeros
    order = np.lexsort(points.T)
    new = np.concatenate([[True], (np.diff(points[order], axis=0) != 0.0).any(axis=1)])
    number = np.empty(len(points), np.int64)
    number[order] = np.cumsum(new) - 1
    return points[order[new]], number[place.reshape(faces.shape)]


def _is_closed(vertices: Floats, faces: NDArray[np.int64], where: str, open_: bool, normals: str) -> bool:
    """Whether each side of a triangle is that of another which runs the other way."""
    count = len(vertices)
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    runs = np.sort(start * count + end)
    if np.array_equal(runs, np.sort(end * count + start)):
        return True
    sides, uses = np.unique(np.minimum(start, end) * count + np.maximum(start, end), return_counts=True)
    single = sides[uses % 2 == 1]
    if single.size and not open_:
        raise DataError(
            f"{where}: is open: {single.size} edges belong to one triangle only, "
            f"the first {_edge(vertices, single[0])}: close it, or say open = true if a sheet is meant"
        )
    twice = runs[:-1][np.diff(runs) == 0]
    if twice.size and (not open_ or normals == "smooth"):
        remedy = 'say normals = "facet"' if open_ else "say open = true for a sheet, whose sides are alike"
        raise DataError(
            f"{where}: its triangles are wound in different directions, first at the edge {_edge(vertices, twice[0])}: "
            f"orient them in the program that made it, or {remedy}"
        )
    return False


def _edge(vertices: Floats, side: int) -> str:
    one, other = vertices[list(divmod(int(side), len(vertices)))]
    return f"from ({', '.join(f'{x:.4g}' for x in one)}) to ({', '.join(f'{x:.4g}' for x in other)}) mm"


def _rotation(axis: ArrayLike, angle: float) -> Floats:
    """The matrix of a right-handed turn about an axis (Rodrigues)."""
    x, y, z = unit(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + 2.0 * np.sin(angle / 2.0) ** 2 * (cross @ cross))


MAX_NODES = 1_200_000
"""A little more than 1024 x 1024: their triangles take some 0.6 GB of memory."""
PNG = b"\x89PNG\r\n\x1a\n"


class HeightField(FlatTable):
    """`kind = "heightfield"`: heights along `normal`, two triangles between each four values.

    Attributes
    ----------
    file
        A grey PNG of 8 or 16 bits, of which white is 1, or an NPY array (rows, columns) of any finite numbers. The
        first and last rows and columns lie on the rectangle's sides; row 0 is the upper one, at v = 1.
    size_mm
        Width along `x_axis` and height along normal x `x_axis`.
    height_mm
        What the value 1 stands for; may be negative.
    normals
        What shades: the triangles themselves, or normals that are smooth across them (central differences).
    """

    kind: Literal["heightfield"]
    file: str = Field(min_length=1)
    size_mm: tuple[Length, Length]
    height_mm: Coordinate
    normals: Literal["facet", "smooth"] = "facet"

    def build(self, folder: Path) -> Triangles:
        """The shape.

        Raises
        ------
        ConfigError
            The file is missing, or is neither PNG nor NPY; or Embree is not installed.
        DataError
            The file is damaged, in colour, too small or too large, or holds what is not a finite number.
        """
        path = folder / self.file
        heights = self.height_mm * read_heights(path, f'file = "{self.file}" ({path})')
        if np.abs(heights).max() > LARGEST_MM:
            raise DataError(f'file = "{self.file}" ({path}): makes heights beyond {LARGEST_MM:g} mm: lower height_mm')
        rows, columns = heights.shape
        u, v = np.linspace(0.0, 1.0, columns), np.linspace(1.0, 0.0, rows)
        uv = np.stack(np.meshgrid(u, v), axis=-1)
        local = np.concatenate([(uv - 0.5) * self.size_mm, heights[..., np.newaxis]], axis=-1)
        normals = None
        if self.normals == "smooth":
            down, along = np.gradient(heights, self.size_mm[1] / (rows - 1), self.size_mm[0] / (columns - 1))
            normals = np.stack([-along, down, np.ones_like(heights)], axis=-1)
            normals /= np.linalg.norm(normals, axis=-1)[..., np.newaxis]
        place = self.place
        corner = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
        a, b, c, d = (part.reshape(-1) for part in (corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:], corner[:-1, :-1]))
        faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=1).reshape(-1, 3)
        return Triangles(
            local.reshape(-1, 3) @ place.axes + place.center,
            faces,
            closed=False,
            normals=None if normals is None else PerCorner(normals.reshape(-1, 3) @ place.axes, faces),
            uv=PerCorner(uv.reshape(-1, 2), faces),
        )


def read_heights(path: Path, where: str) -> Floats:
    """Values of a grey picture in [0, 1], or those of an array; see `HeightField.build` for the errors."""
    data = content(path, where, BESIDE_SCENE)
    kind = path.suffix.lower()
    if kind not in (".png", ".npy"):
        raise ConfigError(f"{where}: heights are read from a grey PNG of 8 or 16 bits, or from an NPY array")
    values = _of_png(data, where) if kind == ".png" else _of_npy(data, where)
    rows, columns = values.shape
    if rows < 2 or columns < 2:
        raise DataError(f"{where}: has {rows} x {columns} values: at least 2 x 2 make a surface")
    if not np.isfinite(values).all():
        raise DataError(f"{where}: holds values that are not finite numbers: fill them in")
    return values


def _refuse_size(rows: int, columns: int, where: str) -> None:
    if rows * columns > MAX_NODES:
        raise DataError(f"{where}: has {rows} x {columns} values, and at most {MAX_NODES} are taken: make it smaller")


def _of_npy(data: bytes, where: str) -> Floats:
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, kind = read_header(file)
        if len(shape) == 2:
            _refuse_size(*shape, where)
        if len(shape) != 2 or kind.kind not in "fiu":
            raise DataError(f"{where}: is an array {shape} of {kind}: heights are numbers (rows, columns)")
        file.seek(0)
        return np.asarray(np.load(file, allow_pickle=False), np.float64)
    except (ValueError, EOFError) as error:
        raise DataError(f"{where}: cannot be read as NPY: {' '.join(str(error).split())}") from error


def _of_png(data: bytes, where: str) -> Floats:
    import cv2

    if not data.startswith(PNG):
        raise DataError(f"{where}: is not a PNG file")
    at = len(PNG)
    kind = b""
    while kind != b"IEND":  # OpenCV makes a picture of half a file
        head = data[at : at + 8]
        length = struct.unpack(">I", head[:4])[0] if len(head) == 8 else 0
        kind, content = head[4:], data[at + 8 : at + 8 + length]
        if data[at + 8 + length : at + 12 + length] != struct.pack(">I", zlib.crc32(kind + content)):
            raise DataError(f"{where}: is a damaged or cut PNG file")
        if kind == b"IHDR" and length >= 10:
            columns, rows, _bits, colour = struct.unpack(">IIBB", content[:10])
            _refuse_size(rows, columns, where)
            if colour not in (0, 4):
                raise DataError(f"{where}: is a picture in colour: heights need one of grey levels")
        at += 12 + length
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DataError(f"{where}: cannot be read as PNG")
    if image.ndim == 3:
        raise DataError(f"{where}: has an opacity besides its grey levels: save it without")
    return np.asarray(image / np.float64(np.iinfo(image.dtype).max))
