"""Areas of a sample that are of other materials: tables [[region]] and [mask] of a sample file, in mm on it."""

import hashlib
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from gonio.config import Positive, Strict
from gonio.disk import content, read_file
from gonio.errors import ConfigError, DataError
from gonio.samples.textures import MAX_TEXELS, SampleTexture
from gonio.typing import Bools, Floats, Ints, NDArray, TomlTable

if TYPE_CHECKING:
    from gonio.samples.description import SampleDescription

MOST = 100
"""Regions of a sample."""
GREY = 0x010101
"""A grey value times this is its colour 0xRRGGBB."""
Numbers = NDArray[np.int8]
Areas = Callable[[Floats, Floats], Numbers]
"""x and y on the sample [mm], of one shape, to the number of the region there: 0 for none, else from 1."""
Place = tuple[float, float]


class SampleRegion(Strict):
    """An area with a model of its own. Where regions overlap, the last one counts."""

    name: str = ""
    rectangle_mm: tuple[float, float, float, float] | None = None
    """[x, y] of one corner, and [x, y] of the opposite one, along the sample's axes."""
    disc_mm: tuple[float, float, Positive] | None = None
    """[x, y, radius]."""
    polygon_mm: Annotated[tuple[Place, ...], Field(min_length=3)] | None = None
    """Corners [x, y] in order; what an odd number of edges surrounds is inside."""
    mask: Annotated[int, Field(ge=0, lt=1 << 16)] | str | None = None
    """A value of the picture that [mask] names: a grey value, or a colour "#rrggbb"."""
    model: str = ""
    parameters: TomlTable = Field(default_factory=dict)
    texture: dict[str, SampleTexture] = Field(default_factory=dict)
    file: str | None = None
    """Instead of model, parameters and textures: another sample file, beside this one."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        places = [name for name in ("rectangle_mm", "disc_mm", "polygon_mm", "mask") if getattr(self, name) is not None]
        if len(places) != 1:
            said = f"has {' and '.join(places)}" if places else "has none"
            raise ValueError(f"a region lies in one of rectangle_mm, disc_mm, polygon_mm or mask, and this {said}")
        if bool(self.model) == (self.file is not None) or (self.file and (self.parameters or self.texture)):
            raise ValueError("a region needs either model and parameters, or file, which holds both")
        if isinstance(self.mask, str) and not re.fullmatch("#[0-9a-fA-F]{6}", self.mask):
            raise ValueError(
                f'mask = "{self.mask}": a colour is written "#rrggbb", as "#ff8000"; a grey value is a number'
            )
        return self

    def filled(self, other: "SampleDescription") -> Self:
        """The region with what its file says."""
        own = {name: getattr(other, name) for name in ("model", "parameters", "texture")}
        return self.model_copy(update={**own, "name": self.name or other.name, "file": None})

    def covers(self, x: Floats, y: Floats) -> Bools:
        """Whether places lie in the region, where that is no value of the mask."""
        if self.rectangle_mm is not None:
            x0, y0, x1, y1 = self.rectangle_mm
            inside = (x >= min(x0, x1)) & (x < max(x0, x1)) & (y >= min(y0, y1)) & (y < max(y0, y1))
            return np.asarray(inside)
        if self.disc_mm is not None:
            x0, y0, radius = self.disc_mm
            return np.asarray((x - x0) ** 2 + (y - y0) ** 2 <= radius**2)
        assert self.polygon_mm is not None
        odd = np.zeros(np.shape(x), dtype=bool)
        for (xa, ya), (xb, yb) in zip(self.polygon_mm, (*self.polygon_mm[1:], self.polygon_mm[0]), strict=True):
            if ya != yb:
                odd ^= ((y >= ya) != (y >= yb)) & (x < xa + (y - ya) * ((xb - xa) / (yb - ya)))
        return odd


class SampleMask(Strict):
    """A picture whose values say of what region a place is; its first row is above, toward growing y."""

    file: str
    """A PNG, grey (8 or 16 bits) or in colour, beside the sample file. Outside of it lies no region."""
    sha256: str | None = None
    """SHA-256 of the file, as it was when the sample file was read."""
    mm_per_pixel: Positive
    center_mm: Place = (0.0, 0.0)
    """Where the picture's middle lies, in the sample's x and y."""
    azimuth_deg: float = 0.0
    """Azimuth of the picture's rows, from the sample's x toward its y."""

    def beside(self, sample_file: Path, where: str) -> Self:
        """The mask with its picture's whole path and SHA-256; raises `ConfigError` where it cannot be read."""
        path = (sample_file.parent / self.file).absolute()
        _colours(path, f"{where}.file")
        return self.model_copy(update={"file": str(path), "sha256": hashlib.sha256(read_file(path)).hexdigest()})

    def load(self, where: str) -> Callable[[Floats, Floats], Ints]:
        """x and y [mm] to the picture's value there, -1 outside; raises `ConfigError` and `DataError`."""
        colours = _colours(Path(self.file), f"{where}.file")
        if self.sha256 not in (None, hashlib.sha256(read_file(self.file)).hexdigest()):
            raise ConfigError(
                f"{where}.file = {self.file!r}: has changed since the sample file was read; put the picture back "
                "that the run began with, or begin another run"
            )
        (height, width), (x0, y0), turned = colours.shape, self.center_mm, math.radians(self.azimuth_deg)
        cos, sin = math.cos(turned) / self.mm_per_pixel, math.sin(turned) / self.mm_per_pixel

        def value(x: Floats, y: Floats) -> Ints:
            column = np.floor(width / 2 + (x - x0) * cos + (y - y0) * sin)
            row = np.floor(height / 2 + (x - x0) * sin - (y - y0) * cos)
            within = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            place = np.where(within, row * width + column, 0).astype(np.int64)
            return np.where(within, colours.ravel()[place], -1)

        return value


def areas(regions: tuple[SampleRegion, ...], mask: SampleMask | None, where: str) -> Areas:
    """The regions of a sample as a function of place; `where` begins messages.

    Raises
    ------
    ConfigError, DataError
        The mask's picture is not there, is none, or has changed since the sample file was read.
    """
    value = mask.load(f"{where}mask") if mask is not None else None

    def numbers(x: Floats, y: Floats) -> Numbers:
        out = np.zeros(np.shape(x), dtype=np.int8)
        masked = value(x, y) if value is not None else None
        for number, region in enumerate(regions, 1):
            if region.mask is None:
                out[region.covers(x, y)] = number
            else:
                out[masked == _colour(region.mask)] = number
        return out

    return numbers


def check(regions: tuple[SampleRegion, ...], mask: SampleMask | None, where: str) -> None:
    """Raise `ConfigError` where a region names a value that the mask does not have."""
    if mask is None:
        return
    occurring = np.unique(_colours(Path(mask.file), f"{where}mask.file"))
    for number, region in enumerate(regions, 1):
        if region.mask is not None and _colour(region.mask) not in occurring:
            known = ", ".join(_worded(int(value)) for value in occurring[:6]) + (", ..." if occurring.size > 6 else "")
            raise ConfigError(
                f"{where}region[{number}].mask = {region.mask!r}: no pixel of {mask.file} has this value; "
                f"it has {known}"
            )


def _colour(value: int | str) -> int:
    """A value of a region as 0xRRGGBB; grey values of 16 bits follow beyond."""
    if isinstance(value, str):
        return int(value[1:], 16)
    return value * GREY if value < 256 else value << 24


def _worded(colour: int) -> str:
    if colour >= 1 << 24:
        return str(colour >> 24)
    return str(colour // GREY) if colour % GREY == 0 else f'"#{colour:06x}"'


def _colours(path: Path, where: str) -> Ints:
    """The picture's values, (height, width), as `_colour` has them."""
    import cv2

    where = f"{where} = {str(path)!r}"
    data = content(path, where)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None or image.dtype.kind != "u" or image.shape[0] * image.shape[1] > MAX_TEXELS:
        raise DataError(f"{where}: is no picture that can be read, or has more than {MAX_TEXELS} pixels; PNG is read")
    whole = image.astype(np.int64)
    if image.ndim == 2 or image.shape[2] < 3:
        grey = whole if image.ndim == 2 else whole[..., 0]
        return np.asarray(np.where(grey < 256, grey * GREY, grey << 24))
    if image.dtype != np.uint8:
        raise DataError(f"{where}: holds colours of 16 bits; a mask has 8, or is grey")
    return np.asarray(whole[..., 2] << 16 | whole[..., 1] << 8 | whole[..., 0])
