"""LightTools tables of a BSDF (`.bsdf`): a grid of angles about the normal for each incidence.

`ScatterAzimuth` and `ScatterRadial` count and list azimuths and polar angles [degrees]. After `DataBegin` each block
states AOI, POI, Side (Front or Back), Wavelength [nm], ScatterType (BRDF or BTDF) and, where SpectralContent is XYZ,
TristimulusValue (TrisX, TrisY, TrisZ); after TIS and its number come the values, one azimuth after the other [1/sr].
Light of POI 0 comes from the azimuth 90, so that the mirror direction is at 270. A BTDF's polar angles are counted from
the other side's normal. Each side, and each of X, Y and Z, is a sample.

No file was at hand to try: the layout is that which libbsdf's reader (github.com/KimuraRyo/libbsdf) takes. Planes of
incidence beside 0 are taken to turn the light with them, and the back to be seen from its own side.
"""

import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, table, wrap_deg
from gonio.formats.text import Text, integer, number, numbers
from gonio.typing import DataFrame, Floats

_WORDS = {
    "Symmetry": ("PlaneSymmetrical", "Asymmetric", "Asymmetrical"),
    "SpectralContent": ("Monochrome", "XYZ"),
    "Side": ("Front", "Back"),
    "ScatterType": ("BRDF", "BTDF"),
    "TristimulusValue": ("TrisX", "TrisY", "TrisZ"),
}
_NUMBERS = {"AOI": (0.0, 90.0), "POI": (-360.0, 360.0), "Wavelength": (0.0, 200_000.0)}
_AXES = {"ScatterAzimuth": 360.0, "ScatterRadial": 90.0}
MOST_VALUES = 5_000_000
"""Most values of a file."""


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a LightTools file; `DataError` says what is wrong with the file, and where."""
    words = _Words(Text(data, path))
    axes: dict[str, Floats] = {}
    while (word := words.take("DataBegin")) != "DataBegin":
        if word in _AXES:
            axes[word] = words.axis(word)
        elif word in _WORDS:
            words.keyword(word)
    if len(axes) < len(_AXES):
        raise DataError(f"{words.where}: DataBegin without ScatterAzimuth and ScatterRadial before it")
    azimuth, radial = (axes[name] for name in _AXES)
    parts: list[tuple[dict[str, str | float], Floats]] = []
    said: dict[str, str | float] = {}
    while (word := words.take("DataEnd")) != "DataEnd":
        if word == "TIS":
            words.number("TIS", -math.inf, math.inf)
            if (len(parts) + 1) * azimuth.size * radial.size > MOST_VALUES:
                raise DataError(f"{words.where}: more than {MOST_VALUES} values")
            parts.append((said, words.values(azimuth.size * radial.size)))
            said = {}
        elif word in _NUMBERS:
            said[word] = words.number(word, *_NUMBERS[word])
        elif word in _WORDS:
            said[word] = words.keyword(word)
        else:
            raise DataError(f'{words.where}: "{word[:40]}" is not known; {", ".join([*_NUMBERS, *_WORDS])} and TIS are')
    if not parts or any("AOI" not in one for one, _ in parts):
        raise DataError(f"{path}: holds no block, or one without AOI")
    count = azimuth.size * radial.size
    through = np.array([one.get("ScatterType") == "BTDF" for one, _ in parts])
    names = [
        " ".join([path.stem, str(one.get("Side", "Front")).lower(), str(one.get("TristimulusValue", ""))[4:]]).strip()
        for one, _ in parts
    ]
    polar = np.where(through[:, np.newaxis], 180.0 - np.tile(radial, azimuth.size), np.tile(radial, azimuth.size))
    keep = (polar.ravel() != 90.0) | ~np.repeat(through, count)
    column = {name: np.repeat([float(one.get(name, 0.0)) for one, _ in parts], count)[keep] for name in _NUMBERS}
    return table(
        theta_i_deg=column["AOI"],
        phi_i_deg=wrap_deg(90.0 + column["POI"]),
        theta_r_deg=polar.ravel()[keep],
        phi_r_deg=wrap_deg(np.tile(np.repeat(azimuth, radial.size), len(parts))[keep]),
        wavelength_nm=np.where(column["Wavelength"] > 0, column["Wavelength"], math.nan),
        brdf=np.concatenate([values for _, values in parts])[keep],
        side=np.repeat(np.where(through, "transmission", "reflection").astype(object), count)[keep],
        sample=np.repeat(np.array(names, dtype=object), count)[keep] if len(set(names)) > 1 else None,
        attrs={
            "source_file": str(path),
            "sample": path.stem,
            "notes": [
                "the layout was not tried on a published file: light of POI 0 is taken to come from the azimuth 90",
                "the file states no uncertainties and no solid angles",
            ],
        },
    )


class _Words:
    """The words of a file that are no comments, taken one after the other."""

    def __init__(self, text: Text) -> None:
        self.text, self.line = text, 0
        self.left: Iterator[str] = self._each()

    def _each(self) -> Iterator[str]:
        for line, content in enumerate(self.text.lines):
            self.line = line
            if not content.lstrip().startswith("#"):
                yield from content.split()

    @property
    def where(self) -> str:
        """Where the word stands that was taken last."""
        return self.text.where(self.line)

    def take(self, wanted: str) -> str:
        for word in self.left:
            return word
        raise DataError(f"{self.where}: the file ends before {wanted}")

    def number(self, name: str, low: float, high: float) -> float:
        value = number(self.take(name), self.where, name)
        if not low <= value <= high:
            raise DataError(f"{self.where}: {name} = {value:g} lies outside [{low:g}, {high:g}]")
        return value

    def keyword(self, name: str) -> str:
        word = self.take(name)
        if word not in _WORDS[name]:
            raise DataError(f'{self.where}: {name} is "{word[:40]}"; read are {", ".join(_WORDS[name])}')
        return word

    def values(self, count: int) -> Floats:
        cells = [self.take(f"{count} values") for _ in range(count)]
        return np.array(numbers(cells, self.where, ["a value"] * count))

    def axis(self, name: str) -> Floats:
        angles = self.values(integer(self.take(name), self.where, f"the count of {name}", 1, 10_000))
        if angles[0] < 0 or angles[-1] > _AXES[name] or (np.diff(angles) <= 0).any():
            raise DataError(f"{self.where}: {name} has to grow within [0, {_AXES[name]:g}] degrees")
        return angles


FORMAT = Format(
    name="lighttools",
    title="LightTools BSDF",
    endings=(),
    sniff=lambda head: b"ScatterRadial" in head and re.search(rb"^\s*AOI\s", head, re.MULTILINE) is not None,
    read=read,
)
