"""Speos surface files in text (OPTIS, Ansys): `.anisotropicbsdf` of versions 7 and 8, and `.brdf` of versions 8 and 9.

Each incidence has a table: a line of azimuths, and a line for each polar angle with its values [degrees]. Angles of
scattering are about the surface's normal; azimuth 0 is the direction in which the light travels along the surface, so
that the mirror direction is (theta_i, 0). Transmission has polar angles from 90 to 180, straight through at
180 - theta_i. Anisotropy angles (Phi_i) are taken as the azimuth in which the light travels, from the file's anisotropy
vector, which is our x axis. Files that were seen have azimuths from 0 to 360; one half, 0 to 180, is read as it is.

Values are proportional to the BSDF (type 1), or to BSDF times cos(theta) (type 0). A percentage beside them is the
reflectance or transmittance that they amount to, and so their scale: each table of a `.brdf` has its own; an
`.anisotropicbsdf` has a spectrum of them for one incidence, which scales all its tables at each wavelength. A spectrum
of equal percentages is one broad band. Integrals are over the angles of the table, linear in between. A table of zeros
stays zero.

Written are the BSDF in 1/sr and its own integral, so that the scale is 1; the percentage of a table that does not reach
90 degrees lacks the rest. Sources: Ansys' pages "Structure of Anisotropic BSDF Files", "Structure of BRDF files" and
"Anisotropic BSDF Surface Overview"; tried on the files in github.com/ansys/optical-automation (one anisotropy angle).
"""

import itertools
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import (
    ANGLES,
    NOT_IN_A_LINE,
    Format,
    one_value_a_direction,
    require_held,
    single,
    table,
    wrap_deg,
    write_lines,
)
from gonio.formats.text import Text, integer, numbers
from gonio.typing import DataFrame, Floats

_HEAD = re.compile(r"OPTIS - (Anisotropic BSDF|brdf) surface file v(\d+)\.\d+\s*", re.IGNORECASE)
_VERSIONS = {"anisotropic bsdf": range(7, 9), "brdf": range(8, 10)}
_SIDES = ("reflection", "transmission")
_POLAR = {"reflection": (0.0, 90.0), "transmission": (90.0, 180.0)}
_GRAZING = 1e-8
MOST_VALUES = 5_000_000
"""Most values of a file."""
_BROAD_NM = 350.0, 850.0
"""Ends of the spectrum of a broad band, as in published files."""


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a Speos text file; `DataError` says what is wrong with the file, and in which line."""
    if data.replace(b"\r", b"").split(b"\n")[1:2] == [b"1"]:
        raise DataError(f"{path}, line 2: is a binary Speos file (mode 1); save it as text in Speos' BSDF viewer")
    file = _Lines(Text(data, path))
    kind = file.kind()
    file.description()
    if kind == "anisotropic bsdf":
        file.row("the anisotropy vector", 3)
    sides = [side for side, there in zip(_SIDES, file.row("reflection and transmission", 2), strict=True) if there]
    if not sides:
        raise DataError(f"{file.where}: holds neither reflection nor transmission")
    (is_bsdf,) = file.row("the type of values", 1)
    blocks = list((_anisotropic if kind == "anisotropic bsdf" else _brdf)(file, sides, is_bsdf != 1))
    rows = np.concatenate([rows for *_, rows in blocks])
    wavelength, side = (np.repeat(np.array(one, dtype=object), [len(b[-1]) for b in blocks])
                        for one in ([b[0] for b in blocks], [b[1] for b in blocks]))  # fmt: skip
    notes = ["values are scaled so that each table, or the one of the spectrum, amounts to the percentage of the file"]
    if is_bsdf != 1:
        notes.append("values are of the type intensity, BSDF times cos(theta): the cosine is divided out")
    if len({row[1] for row in rows.tolist()}) > 1:
        notes.append("anisotropy angles are taken as the azimuth in which light travels, from the anisotropy vector")
    notes.append("the file states no uncertainties and no solid angles")
    frame = table(
        theta_i_deg=rows[:, 0],
        phi_i_deg=wrap_deg(rows[:, 1] + 180.0),
        theta_r_deg=rows[:, 2],
        phi_r_deg=wrap_deg(rows[:, 1] + rows[:, 3]),
        wavelength_nm=wavelength.astype(np.float64),
        brdf=rows[:, 4],
        flag=np.where(np.isnan(rows[:, 4]), "grazing", ""),
        side=side,
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )
    return one_value_a_direction(frame, rows[:, :4], path)


def _anisotropic(file: "_Lines", sides: list[str], cosine: bool) -> Iterator[tuple[float, str, Floats]]:
    """Wavelength [nm], side and rows (theta_i, Phi_i, theta, phi, BSDF) of each block of an anisotropic file."""
    incidences = {}
    for side in sides:
        count = file.count(f"the anisotropy angles of {side}")
        incidences[side] = [
            (incidence, phi)
            for phi in file.row("anisotropy angles", count)
            for incidence in file.row("angles of incidence", file.count("the angles of incidence"))
        ]
    spectra = {}
    for side in sides:
        incidence, phi = file.row("the incidence of the spectrum", 2)
        file.take("the description of the spectrum")
        spectra[side] = (
            (incidence, phi),
            [file.row("a wavelength and a percentage", 2) for _ in range(file.count("the wavelengths"))],
        )
    for side in sides:
        at, spectrum = spectra[side]
        tables = {place: file.table(*place, side, cosine) for place in incidences[side]}
        reference = tables.get(at) or next(iter(tables.values()))
        if len({percentage for _, percentage in spectrum}) == 1:
            spectrum = [[spectrum[0][0] if len(spectrum) == 1 else math.nan, spectrum[0][1]]]
        if (count := len(spectrum) * sum(len(rows) for rows, _ in tables.values())) > MOST_VALUES:
            raise DataError(f"{file.where}: {count} values of {side}; at most {MOST_VALUES} a file are read")
        for wavelength, percentage in spectrum:
            scale = percentage / 100.0 / reference[1] if reference[1] > 0 else 1.0
            for rows, _ in tables.values():
                yield wavelength, side, rows * [1.0, 1.0, 1.0, 1.0, scale]


def _brdf(file: "_Lines", sides: list[str], cosine: bool) -> Iterator[tuple[float, str, Floats]]:
    """Wavelength [nm], side and rows of each table of a `.brdf` file."""
    counts = [int(count) for count in file.row("the counts of incidences and wavelengths", 2)]
    incidences, wavelengths = file.row("angles of incidence", counts[0]), file.row("wavelengths", counts[1])
    for side, incidence, wavelength in itertools.product(sides, incidences, wavelengths):
        (percentage,) = file.row("the percentage of a table", 1)
        rows, integral = file.table(incidence, 0.0, side, cosine)
        yield wavelength, side, rows * [1.0, 1.0, 1.0, 1.0, percentage / 100.0 / integral if integral > 0 else 1.0]


class _Lines:
    """The lines of a file, taken one after the other."""

    def __init__(self, text: Text) -> None:
        self.text, self.next, self.values = text, 0, 0

    @property
    def where(self) -> str:
        """Where the line stands that was taken last."""
        return self.text.where(max(self.next - 1, 0))

    def take(self, wanted: str) -> str:
        if self.next >= len(self.text.lines):
            raise DataError(f"{self.where}: the file ends before {wanted}")
        self.next += 1
        return self.text.lines[self.next - 1]

    def kind(self) -> str:
        line = self.take("its first line")
        found = _HEAD.fullmatch(line)
        if not found or int(found[2]) not in _VERSIONS[found[1].lower()]:
            raise DataError(
                f'{self.where}: "{line[:60]}"; read are Anisotropic BSDF surface files v7 and v8, and brdf surface '
                "files v8 and v9: open others in Speos' BSDF viewer and save them again"
            )
        if self.take("its mode").strip() != "0":
            raise DataError(f"{self.where}: the mode is not 0, text; save the file as text in Speos' BSDF viewer")
        self.take("the comment")
        return found[1].lower()

    def description(self) -> None:
        """Pass over the description, which is as many characters as the line before it says."""
        count = self.count("the characters of the description", least=0)
        length = len(self.take("the description"))
        while length < count:
            length += 1 + len(self.take("the end of the description"))

    def count(self, what: str, least: int = 1) -> int:
        return integer(self.take(f"the count of {what}"), self.where, f"the count of {what}", least, 100_000)

    def row(self, what: str, count: int) -> list[float]:
        """A line of so many numbers."""
        cells = self.take(what).split()
        if len(cells) != count:
            raise DataError(f"{self.where}: {len(cells)} numbers; {what} needs {count}")
        return numbers(cells, self.where, [what] * count)

    def table(self, incidence: float, azimuth: float, side: str, cosine: bool) -> tuple[Floats, float]:
        """Rows (theta_i, Phi_i, theta, phi, BSDF in the file's scale) of a table, and its integral times cos(theta)."""
        if not 0 <= incidence <= 90 or abs(azimuth) > 360:
            raise DataError(f"{self.where}: an incidence ({incidence:g}, {azimuth:g}) lies outside its range")
        polar, around = (int(n) for n in self.row("the counts of theta and phi", 2))
        self.values += max(polar, 1) * max(around, 1)
        if min(polar, around) < 1 or self.values > MOST_VALUES:
            raise DataError(
                f"{self.where}: a table of {polar} x {around}; at most {MOST_VALUES} values a file are read"
            )
        phi = np.array(self.row("azimuths of a table", around))
        lines = np.array([self.row("theta and its values", 1 + around) for _ in range(polar)])
        theta, values = lines[:, 0], lines[:, 1:]
        low, high = _POLAR[side]
        for name, angles, least, most in (("theta", theta, low, high), ("phi", phi, 0.0, 360.0)):
            if (np.diff(angles) <= 0).any() or angles[0] < least or angles[-1] > most:
                raise DataError(f"{self.where}: {name} of {side} has to grow within [{least:g}, {most:g}] degrees")
        if (values < 0).any():
            raise DataError(f"{self.where}: the table that ends here has values below zero, which no such file has")
        if cosine:
            across = np.abs(np.cos(np.deg2rad(theta)))
            values = values / np.where(across < _GRAZING, np.nan, across)[:, np.newaxis]
        keep = np.broadcast_to((theta != 90.0)[:, np.newaxis] | (side == "reflection"), values.shape).copy()
        pole = theta % 180.0 == 0
        if (values[pole] == values[pole, :1]).all():
            keep[pole, 1:] = False  # one direction for every azimuth
        grid = np.column_stack([np.repeat(theta, around), np.tile(phi, polar), values.ravel()])[keep.ravel()]
        place = np.broadcast_to([incidence, azimuth], (len(grid), 2))
        return np.column_stack([place, grid]), hemisphere(theta, phi, np.nan_to_num(values))


def hemisphere(theta_deg: Floats, phi_deg: Floats, values: Floats) -> float:
    """The integral of values (thetas, phis) times abs(cos(theta)) over the polar angles given, and a whole turn.

    Values are linear in theta and phi in between. One azimuth stands for all, and half a turn for both halves.
    """
    theta, around = np.deg2rad(theta_deg), values[:, 0] * 2.0 * np.pi
    if phi_deg.size > 1:
        around = np.trapezoid(values, np.deg2rad(phi_deg), axis=1) * 360.0 / (phi_deg[-1] - phi_deg[0])
    # over an interval: sin cos, and theta sin cos
    flat, moment = np.diff(np.sin(theta) ** 2 / 2.0), np.diff(np.sin(2 * theta) / 8.0 - theta * np.cos(2 * theta) / 4.0)
    slope = np.diff(around) / np.diff(theta)
    return abs(float((around[:-1] * flat + slope * (moment - theta[:-1] * flat)).sum()))


_Key = tuple[str, float, float, float]
"""Side, azimuth of travel, polar angle of incidence [degrees], and wavelength [nm], 0 for a broad band."""


def write(frame: DataFrame, path: Path) -> None:
    """A table that has a full grid of polar angles and azimuths for each incidence, as this reader makes it.

    A name that ends with `.brdf` becomes such a file (one azimuth of incidence, wavelengths that differ in shape); any
    other an anisotropic one (one wavelength or band).
    """
    single(frame, path, "a Speos file")
    sample = " ".join(str(frame.attrs.get("sample") or "measured").split())
    require_held(sample, path, "a Speos file", NOT_IN_A_LINE)
    grids = _grids(frame, path)
    sides, travels, incidences, wavelengths = (sorted(set(axis)) for axis in zip(*grids, strict=True))
    keys: list[_Key] = list(itertools.product(sides, travels, incidences, wavelengths))
    if lacking := next((key for key in keys if key not in grids), None):
        raise DataError(
            f"{path}: a Speos file needs each incidence in each azimuth, side and wavelength; {lacking[2]:g} degrees "
            "lacks one"
        )
    tables = {key: _table(grids[key], path) for key in keys}
    there = f"{int(_SIDES[0] in sides)}\t{int(_SIDES[1] in sides)}"
    if path.suffix.lower() == ".brdf":
        if len(travels) > 1 or wavelengths[0] == 0:
            raise DataError(
                f"{path}: a .brdf of Speos has one azimuth of incidence, and a wavelength in each row; name it "
                ".anisotropicbsdf"
            )
        lines = ["OPTIS - brdf surface file v8.0", "0", sample, "0", "", there, "1"]
        lines += [f"{len(incidences)}\t{len(wavelengths)}", _line(incidences), _line(wavelengths)]
        for table_lines, percentage in tables.values():
            lines += [repr(percentage), *table_lines]
        write_lines(path, [*lines, "End of file"])
        return
    if len(wavelengths) > 1:
        raise DataError(
            f"{path}: an .anisotropicbsdf has one shape for all wavelengths, and this table has {len(wavelengths)}; "
            "name it .brdf"
        )
    lines = ["OPTIS - Anisotropic BSDF surface file v8.0", "0", sample, "0", "", "1\t0\t0", there, "1"]
    for _ in sides:
        lines += [str(len(travels)), _line(travels), *[str(len(incidences)), _line(incidences)] * len(travels)]
    for side in sides:
        percentage = tables[side, travels[0], incidences[0], wavelengths[0]][1]
        spectrum = _BROAD_NM if wavelengths[0] == 0 else wavelengths
        lines += [_line([incidences[0], travels[0]]), "", str(len(spectrum))]
        lines += [_line([wavelength, percentage]) for wavelength in spectrum]
    write_lines(path, [*lines, *itertools.chain.from_iterable(lines for lines, _ in tables.values()), "End of file"])


def _line(row: Iterable[float]) -> str:
    return "\t".join(map(repr, row))


def _grids(frame: DataFrame, path: Path) -> dict[_Key, dict[tuple[float, float], float]]:
    """The value of each scattered direction (theta, Phi) of each table to be written; flagged rows are left out."""
    usable = frame[frame["flag"] == ""]
    theta_i, phi_i, theta, phi_r = (usable[name].to_numpy(np.float64) for name in ANGLES)
    side = usable["side"] if "side" in usable.columns else itertools.repeat(_SIDES[0], len(usable))
    travel, phi = (np.round(wrap_deg(angle), 9) % 360.0 for angle in (phi_i + 180.0, phi_r - phi_i + 180.0))
    grids: dict[_Key, dict[tuple[float, float], float]] = {}
    keys = zip(side, travel.tolist(), theta_i.tolist(), usable["wavelength_nm"].fillna(0.0).tolist(), strict=True)
    places = zip(np.round(theta, 9).tolist(), phi.tolist(), strict=True)
    for key, place, value in zip(keys, places, usable["brdf"].tolist(), strict=True):
        if value < 0:
            raise DataError(f"{path}: a Speos file has no values below zero ({value:g}); leave such rows out")
        if grids.setdefault(key, {}).setdefault(place, value) != value:
            raise DataError(f"{path}: a Speos file has one value for a direction; theta_r {place[0]:g} has several")
    if not grids:
        raise DataError(f"{path}: every row of the table is flagged; a Speos file has no room for flags")
    return grids


def _table(grid: dict[tuple[float, float], float], path: Path) -> tuple[list[str], float]:
    """The lines of a table, and the percentage that it amounts to."""
    theta, phi = (np.unique([place[k] for place in grid]) for k in (0, 1))
    values = np.array([[grid.get((t, p), math.nan) for p in phi.tolist()] for t in theta.tolist()])
    for row in np.flatnonzero(theta % 180.0 == 0):  # one direction for every azimuth
        values[row] = np.where(np.isnan(values[row]), np.nanmean(values[row]), values[row])
    if holes := int(np.isnan(values).sum()):
        raise DataError(
            f"{path}: a Speos file needs a full grid of theta and phi for each incidence, and {holes} of {values.size} "
            "values are missing"
        )
    if phi[0] == 0 and phi[-1] > 180.0:  # a whole turn ends where it began
        phi, values = np.append(phi, 360.0), np.column_stack([values, values[:, 0]])
    rows = [_line([t, *row]) for t, row in zip(theta.tolist(), values.tolist(), strict=True)]
    lines = [f"{theta.size}\t{phi.size}", "\t" + _line(phi.tolist()), *rows]
    return lines, 100.0 * hemisphere(theta, phi, values)


def remarks(frame: DataFrame) -> list[str]:
    """What a reader of the file should know: the percentages, and how few incidences there are."""
    said = ["the percentages in the file are the integrals of the written values over the angles that they cover"]
    if frame["theta_i_deg"].nunique() < 2:
        said.append("Speos asks for two incidences at least, and this table has one")
    return said


FORMAT = Format(
    name="speos",
    title="Speos surface file in text (OPTIS)",
    endings=(".anisotropicbsdf",),
    sniff=lambda head: re.match(rb"OPTIS - (Anisotropic BSDF|brdf) surface file", head, re.IGNORECASE) is not None,
    read=read,
    write=write,
    remarks=remarks,
    max_bytes=64 * 2**20,
    carries=frozenset({"transmission"}),
)
