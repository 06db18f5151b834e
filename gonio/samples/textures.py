"""Parameters that change over a sample: tables [texture.NAME] of a sample file, in mm on its surface.

Patterns and pictures: numbers in [0, 1] over a plane, by which parameters change over a surface.
"""

import hashlib
import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import model_validator

from gonio.config import Positive, Strict
from gonio.disk import content, read_file
from gonio.errors import ConfigError, DataError
from gonio.typing import Floats

MAX_TEXELS = 1 << 26
Pattern = Callable[[Floats, Floats], Floats]
"""Places within a tile (n, 2) in [0, 1), (0, 0) its lower left, and the tiles' numbers (n, 2), to values (n,)."""


# --- pictures ----------


def picture(path: Path, where: str) -> tuple[Pattern, Floats]:
    """The nearest texel of a PNG (grey, 8 or 16 bits) or an NPY array (height, width) of values in [0, 1].

    Row 0 is at the tile's upper edge. `where` begins messages. The second array holds the values that occur.

    Raises
    ------
    ConfigError, DataError
        There is no such file, or it cannot be read, or it holds something else.
    """
    texels = _texels(path, where)
    height, width = texels.shape

    def value(uv: Floats, _: Floats) -> Floats:
        column = np.minimum((uv[:, 0] * width).astype(np.int64), width - 1)
        row = np.minimum(((1.0 - uv[:, 1]) * height).astype(np.int64), height - 1)
        return np.asarray(texels[row, column])

    return value, np.unique(texels)


def _texels(path: Path, where: str) -> Floats:
    """The values of a texture's file, (height, width), in [0, 1]."""
    where = f"{where} = {str(path)!r}"
    data = content(path, where)
    texels = _of_npy(data, where) if path.suffix.lower() == ".npy" else _of_png(data, where)
    if texels.ndim != 2 or not 0 < texels.size <= MAX_TEXELS:
        raise DataError(
            f"{where}: has the shape {texels.shape}: a texture is (height, width), grey, of at most {MAX_TEXELS} texels"
        )
    return texels


def _of_npy(data: bytes, where: str) -> Floats:
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except (ValueError, EOFError, OSError, MemoryError):
        raise DataError(f"{where}: is no NPY array of numbers, or is damaged") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiub":
        raise DataError(f"{where}: must hold real numbers")
    array = array.astype(np.float64)
    if not (np.isfinite(array).all() and array.size and array.min() >= 0.0 and array.max() <= 1.0):
        raise DataError(f"{where}: holds values outside [0, 1]; scale them, and use low and high")
    return np.asarray(array)


def _of_png(data: bytes, where: str) -> Floats:
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None:
        raise DataError(f"{where}: is no picture that can be read; PNG and NPY are")
    if image.dtype.kind != "u":
        raise DataError(f"{where}: holds {image.dtype}; a texture's picture holds unsigned whole numbers")
    if image.ndim == 3 and image.shape[2] >= 3 and not (image[..., :1] == image[..., :3]).all():
        raise DataError(f"{where}: is in colour; a texture is grey")
    grey = image[..., 0] if image.ndim == 3 else image
    return np.asarray(grey / float(np.iinfo(grey.dtype).max))


# --- patterns that repeat ----------


def _checker(uv: Floats, tile: Floats) -> Floats:
    return np.asarray(((uv[:, 0] < 0.5) == (uv[:, 1] < 0.5)).astype(np.float64))


def _stripes(uv: Floats, tile: Floats) -> Floats:
    return np.asarray((uv[:, 0] < 0.5).astype(np.float64))


def _dots(uv: Floats, tile: Floats) -> Floats:
    return np.asarray((np.hypot(uv[:, 0] - 0.5, uv[:, 1] - 0.5) < 0.3).astype(np.float64))


def _speckle(uv: Floats, tile: Floats) -> Floats:
    """16 levels, drawn for each of 8 x 8 cells of a tile; all tiles are alike."""
    cell = np.floor(uv * 8.0)
    return _drawn(cell[:, 0], cell[:, 1])


MORTAR = 0.06
"""Width of the mortar of a tile of two courses of bricks, as a share of the tile's height."""


def _bricks(uv: Floats, tile: Floats) -> Floats:
    """Two courses, the upper one half a brick aside; 0 for mortar, 0.5 to 1 for bricks, each its own shade."""
    course = (uv[:, 1] >= 0.5).astype(np.float64)
    along = uv[:, 0] + 0.5 * course
    across = (uv[:, 1] * 2.0) % 1.0
    brick = np.floor(along)
    inside = (np.abs(along - brick - 0.5) < 0.5 - MORTAR / 4.0) & (np.abs(across - 0.5) < 0.5 - MORTAR)
    shade = 0.5 + 0.5 * _drawn(tile[:, 0] + brick, 2.0 * tile[:, 1] + course)
    return np.where(inside, shade, 0.0)


def _drawn(a: Floats, b: Floats) -> Floats:
    """One of 16 levels in [0, 1] for each pair of whole numbers: alike wherever they are, without order."""
    return np.asarray(np.floor(16.0 * ((np.sin(a * 12.9898 + b * 78.233) * 43758.5453) % 1.0)) / 15.0)


TWO = np.array([0.0, 1.0])
SHADES = np.arange(16.0) / 15.0
PATTERNS: dict[str, tuple[Pattern, Floats]] = {
    "checker": (_checker, TWO),
    "stripes": (_stripes, TWO),
    "bricks": (_bricks, np.append(0.0, 0.5 + 0.5 * SHADES)),
    "dots": (_dots, TWO),
    "speckle": (_speckle, SHADES),
}
"""By name, with the values that occur."""


Shares = Callable[[Floats, Floats], Floats]
"""x and y on the sample [mm], of one shape, to the share of `high` there, in [0, 1]."""


@dataclass(frozen=True, slots=True)
class LoadedTexture:
    """A texture, ready to be evaluated."""

    shares: Shares
    occurring: Floats | None
    """The values that it has anywhere, in growing order; None: all between 0 and 1."""


class SampleTexture(Strict):
    """A number of [parameters] that changes over the sample: `low` where the texture is 0, `high` where it is 1.

    (u, v) are x and y from `origin_mm`, on axes that are turned by `azimuth_deg`.
    """

    file: str | None = None
    """A PNG (grey, 8 or 16 bits) or an NPY array (height, width) of values in [0, 1], beside the sample file. It fills
    0 <= u < size_mm[0], 0 <= v < size_mm[1], its first row above, and repeats."""
    sha256: str | None = None
    """SHA-256 of the file, as it was when the sample file was read."""
    pattern: Literal["checker", "stripes", "bricks", "dots", "speckle", "edge", "gradient", "scratch"] | None = None
    """The first five repeat, as a picture does. "edge": 1 where u >= 0. "gradient": from 0 to 1, along u, over
    size_mm[0] around the origin. "scratch": 1 in a rectangle around the origin, size_mm[0] long and size_mm[1] wide."""
    low: float
    high: float
    size_mm: tuple[Positive, Positive] | None = None
    """Along u and v; all patterns but an edge have one."""
    origin_mm: tuple[float, float] = (0.0, 0.0)
    """Place of the origin in the sample's x and y."""
    azimuth_deg: float = 0.0
    """Azimuth of u, from the sample's x toward its y."""

    @model_validator(mode="after")
    def _whole(self) -> "SampleTexture":
        if (self.file is None) == (self.pattern is None):
            raise ValueError("a texture needs either file or pattern")
        if (self.size_mm is None) != (self.pattern == "edge"):
            raise ValueError("size_mm = [along u, along v] goes with every texture but an edge")
        return self

    def beside(self, sample_file: Path, where: str) -> "SampleTexture":
        """The texture with its picture's whole path and SHA-256; raises `ConfigError` where it cannot be read."""
        if self.file is None:
            return self
        path = (sample_file.parent / self.file).absolute()
        picture(path, f"{where}.file")
        digest = hashlib.sha256(read_file(path)).hexdigest()
        return self.model_copy(update={"file": str(path), "sha256": digest})

    def load(self, where: str) -> LoadedTexture:
        """The texture as a function; `where` begins messages.

        Raises
        ------
        ConfigError, DataError
            The picture is not there, is none, or has changed since the sample file was read.
        """
        shape, occurring = _SHAPES.get(self.pattern or "") or self._tiles(where)
        size = np.array(self.size_mm or (1.0, 1.0))
        (x0, y0), turned = self.origin_mm, math.radians(self.azimuth_deg)
        cos, sin = math.cos(turned), math.sin(turned)

        def shares(x: Floats, y: Floats) -> Floats:
            u, v = (x - x0) * cos + (y - y0) * sin, (y - y0) * cos - (x - x0) * sin
            return shape(u / size[0], v / size[1])

        return LoadedTexture(shares, occurring)

    def _tiles(self, where: str) -> tuple[Shares, Floats | None]:
        """What repeats, of lengths in `size_mm`."""
        if self.pattern is not None:
            whole, occurring = PATTERNS[self.pattern]
        else:
            assert self.file is not None
            whole, occurring = picture(Path(self.file), f"{where}.file")
            if self.sha256 not in (None, hashlib.sha256(read_file(self.file)).hexdigest()):
                raise ConfigError(
                    f"{where}.file = {self.file!r}: has changed since the sample file was read; put the picture back "
                    "that the run began with, or begin another run"
                )

        def shares(u: Floats, v: Floats) -> Floats:
            uv = np.stack([np.ravel(u), np.ravel(v)], axis=1)
            tile = np.floor(uv)
            return whole(np.minimum(uv - tile, LAST), tile).reshape(np.shape(u))

        return shares, occurring

    def values(self, x_mm: Floats, y_mm: Floats) -> Floats:
        """The parameter at places on the sample [mm], arrays of one shape; raises as `load`."""
        return self.low + (self.high - self.low) * self.load("texture").shares(x_mm, y_mm)


LAST = float(np.nextafter(1.0, 0.0))


def _edge(u: Floats, v: Floats) -> Floats:
    return np.asarray((u >= 0.0).astype(np.float64))


def _gradient(u: Floats, v: Floats) -> Floats:
    return np.asarray(np.clip(u + 0.5, 0.0, 1.0))


def _scratch(u: Floats, v: Floats) -> Floats:
    return np.asarray(((np.abs(u) < 0.5) & (np.abs(v) < 0.5)).astype(np.float64))


_SHAPES: dict[str, tuple[Shares, Floats | None]] = {
    "edge": (_edge, TWO),
    "gradient": (_gradient, None),
    "scratch": (_scratch, TWO),
}
