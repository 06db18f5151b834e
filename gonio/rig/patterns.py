"""Patterns and pictures: numbers in [0, 1] over a plane, by which parameters change over a surface."""

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gonio.disk import content
from gonio.errors import DataError
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
    except (ValueError, EOFError, OSError) as error:
        raise DataError(f"{where}: is no NPY array: {error}") from None
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
