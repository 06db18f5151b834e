"""A rectangle whose heights a picture gives: two triangles between each four values, met in float64."""

import io
import struct
import zlib
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from gonio.disk import content
from gonio.errors import ConfigError, DataError
from gonio.typing import ArrayLike, Floats, NDArray
from gonio_scenes.shapes import _grid_kernels as kernels
from gonio_scenes.shapes.shape import (
    BESIDE_SCENE,
    LARGEST_MM,
    Coordinate,
    FlatTable,
    Ints,
    Length,
    Placement,
    Surface,
    over_rays,
    rays,
)

MAX_NODES = 1_200_000
"""A little more than 1024 x 1024: their triangles take some 0.6 GB of memory."""
PNG = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class Heights:
    """The shape of a height field.

    Attributes
    ----------
    place, size
        The field's frame, and its width and height [mm].
    heights : (rows, columns)
        Along the frame's z [mm].
    vertices : (n, 3)
        The same in the scene, row by row.
    faces : (m, 3)
        Two triangles a cell, row by row, wound counterclockwise seen from above.
    normals : (n, 3)
        Unit vectors that shade, at the vertices; None for facets.
    uv : (n, 2)
        Texture coordinates at the vertices.
    """

    place: Placement
    size: Floats
    heights: Floats
    vertices: Floats
    faces: NDArray[np.int32]
    normals: Floats | None
    uv: Floats
    convex: bool = field(default=False, init=False)
    closed: bool = field(default=False, init=False)

    @cached_property
    def size_mm(self) -> float:
        """Length of the diagonal of the box around it."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    @cached_property
    def _box(self) -> tuple[Floats, float]:
        """Half widths of the box around all heights, and the height of its middle, in the field's frame [mm]."""
        low, high = float(self.heights.min()), float(self.heights.max())
        return np.array([*self.size, high - low]) / 2.0 + kernels.MARGIN * self.size.max(), (low + high) / 2.0

    def intersect(self, origin: Floats, direction: Floats, nearest: float) -> tuple[Floats, Ints]:
        """See `Shape`."""
        both = rays(origin, direction)
        hits = np.empty(len(both[0])), np.empty(len(both[0]), np.int64)
        half, middle = self._box
        over_rays(
            kernels.meet, len(both[0]), both, (self.place.center, self.place.axes), self.size, self.heights, half,
            middle, float(nearest), self.vertices, self.faces, hits,
        )  # fmt: skip
        return hits

    def surface(self, origin: Floats, direction: Floats, distance: Floats, primitive: Ints) -> Surface:
        """See `Shape`."""
        both = rays(origin, direction)
        out = (*np.empty((4, len(both[0]), 3)), np.empty((len(both[0]), 2)))
        over_rays(
            kernels.describe, len(both[0]), both, np.ascontiguousarray(primitive, np.int64), self.vertices, self.faces,
            np.empty((0, 3)) if self.normals is None else self.normals, self.uv, out,
        )  # fmt: skip
        return Surface(*out)

    def contains(self, point: ArrayLike) -> bool:
        """See `Shape`."""
        return False


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

    def build(self, folder: Path) -> Heights:
        """The shape.

        Raises
        ------
        ConfigError
            The file is missing, or is neither PNG nor NPY.
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
        return Heights(
            place,
            np.array(self.size_mm),
            heights,
            local.reshape(-1, 3) @ place.axes + place.center,
            faces,
            None if normals is None else normals.reshape(-1, 3) @ place.axes,
            uv.reshape(-1, 2),
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
