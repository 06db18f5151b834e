"""Parameters that change over a sample: tables [texture.NAME] of a sample file, in mm on its surface."""

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import model_validator

from gonio.config import Strict
from gonio.disk import read_file
from gonio.errors import ConfigError
from gonio.rig import patterns
from gonio.rig.ranges import Positive
from gonio.typing import Floats

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
    """Of the file, as it was when the sample file was read."""
    pattern: Literal["checker", "stripes", "bricks", "dots", "speckle", "edge", "gradient", "scratch"] | None = None
    """The first five repeat, as a picture does. "edge": 1 where u >= 0. "gradient": from 0 to 1, along u, over
    size_mm[0] around the origin. "scratch": 1 in a rectangle around the origin, size_mm[0] long and size_mm[1] wide."""
    low: float
    high: float
    size_mm: tuple[Positive, Positive] | None = None
    """Along u and v; all patterns but an edge have one."""
    origin_mm: tuple[float, float] = (0.0, 0.0)
    """In the sample's x and y."""
    azimuth_deg: float = 0.0
    """Of u, from the sample's x toward its y."""

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
        patterns.picture(path, f"{where}.file")
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
            whole, occurring = patterns.PATTERNS[self.pattern]
        else:
            assert self.file is not None
            whole, occurring = patterns.picture(Path(self.file), f"{where}.file")
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
    "edge": (_edge, patterns.TWO),
    "gradient": (_gradient, None),
    "scratch": (_scratch, patterns.TWO),
}
