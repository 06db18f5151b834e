"""What the columns of a table made by hand may be: a proposal for `--columns` with reasons, never taken unasked."""

import difflib
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats import own_layouts, own_pairs
from gonio.formats.column_hints import NEEDED, found_in, word_and_unit
from gonio.formats.text import BLANKS, CsvTable, cells_of, header_in, lines_of, table_from
from gonio.typing import Floats

UNKNOWN = "NAME"
"""Stands in a line to try for what nothing tells."""
_LOOKED_AT = 500
"""Rows whose values are looked at."""
_DPHI = re.compile(
    r"d_?phi|dφ|Δφ|δφ|raa|(relative|rel|delta|difference)_(azimuth|phi|az)(_angle)?|(azimuth|phi)_(difference|diff|rel)|"
    r"phi|φ|ϕ|azimuth|azimuth_angle"
)
_SHORT = {"sza": "theta_i", "iza": "theta_i", "saa": "phi_i", "vza": "theta_r", "vaa": "phi_r", "oza": "theta_r"}
_SHORT |= dict.fromkeys(
    ("aoi", "incidence", "angle_of_incidence", "incidence_angle", "incident_angle", "inc_angle"), "theta_i"
)
_SHORT |= dict.fromkeys(
    ("viewing_angle", "view_angle", "observation_angle", "detector_angle", "receiver_angle"), "theta_r"
)
_LETTERS = {"ti": "theta_i", "tr": "theta_r", "pi": "phi_i", "pr": "phi_r"}
"""Angles where both polar ones are called so."""
_ALONE: dict[str, tuple[str, ...]] = {
    "theta_i": ("inc", "incidence", "incident", "incidence_angle", "angle_of_incidence", "aoi", "source", "src"),
    "theta_r": ("theta", "angle", "zenith", "det", "detector", "view"),
    "brdf": (),
}
"""Names of columns that are this one where no other is; any name where there are none."""
_VALUES = {"f_r11", "fr11", "r", "value", "values", "reflectance", "brdf_values", "bsdf_values", "f", "intensity",
           "signal", "brdf_cos", "ccbrdf", "f_cos", "cos_brdf", "brdf_cosine"}  # fmt: skip
_FACTOR = re.compile(r"\b(h?c?d?r?brf|hdrf|(reflectance|radiance)[ _]factor)s?\b", re.IGNORECASE)


@dataclass
class Proposal:
    """Pairs for `--columns`, and why."""

    header: list[str]
    pairs: dict[str, str] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """As `--columns` takes it."""
        return ",".join(f"{key}={own}" for key, own in self.pairs.items())

    @property
    def whole(self) -> bool:
        """Whether nothing is left to fill in."""
        return not any(own.split(":")[0] == UNKNOWN for own in self.pairs.values())

    def line(self, path: Path) -> str:
        """The command to run."""
        files = f"{_word(str(path))} {_word(f'{path.stem}-brdf.csv')}"
        return f"gonio convert {files} --columns {_word(self.text, always=True)}"


def _word(text: str, *, always: bool = False) -> str:
    """A word of a command line, in double quotes where it needs some."""
    if not always and re.fullmatch(r"[\w./+-]+", text):
        return text
    return '"' + re.sub(r'([\\"$`])', r"\\\1", text) + '"'


def proposal(data: bytes, path: Path, given: Mapping[str, str] | None = None) -> Proposal | None:
    """What the columns of a text or a workbook may be; None where it is no table at all.

    `given` are pairs that are known, and stay where the file has such columns.
    """
    try:
        text, _ = own_layouts.as_text(data, path, _fits)
        lines = lines_of(text)
        place = _header(lines)
        if place is None:
            return _without_header(lines, path)
        first, mark = place
        table = table_from(lines[: first + _LOOKED_AT], first, mark, path)
    except DataError:
        return None
    below, units = own_layouts.units_under(lines, first, table.header, mark)
    rows = [row for row, line in zip(table.rows, table.line_numbers, strict=True) if not below or line != below + 1]
    if not rows:
        return None
    return _of(replace(table, rows=rows), units, "".join(lines[:first]), dict(given or {}))


def _fits(cells: list[str]) -> bool:
    """Whether a row of a worksheet may be its header."""
    return _known(cells) > 1 or _of_matrix(cells)


def _of_matrix(cells: list[str]) -> bool:
    return len(cells) > 2 and [*map(_is_number, cells)] == [False, *[True] * (len(cells) - 1)]


def _header(lines: Sequence[str]) -> tuple[int, str] | None:
    """The line that names most columns that are known, or that of a matrix."""
    found, most = None, 0
    for first in range(min(len(lines), 100)):
        place = header_in(lines[first:], partial(_more_than, most), within=1)
        if place is not None:
            found, most = (first, place[1]), _known(cells_of(lines[first], place[1]))
    if found is not None:
        return found
    return header_in(lines, _of_matrix)


def _more_than(most: int, cells: list[str]) -> bool:
    return len(cells) > 1 and _known(cells) > most


def _known(cells: Sequence[str]) -> int:
    return len(_names(cells)) + bool(_wide(cells))


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell.replace(",", ".")))
    except ValueError:
        return False


def _wide(header: Sequence[str]) -> str:
    """The name of the columns that are one a wavelength (100 to 200000 nm), where there are several; else ""."""
    if all(map(_is_number, header)):
        return ""
    for name, pattern in (("*nm", r"[\d.,]+\s*nm"), ("*um", r"[\d.,]+\s*um")):
        if sum(bool(re.fullmatch(pattern, cell.strip(), re.IGNORECASE)) for cell in header) > 1:
            return name
    bare = [float(cell.replace(",", ".")) for cell in header if _is_number(cell)]
    return "*" if sum(100.0 <= value <= 200_000.0 for value in bare) > 1 else ""


def _names(header: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Columns that names tell, by their keys: the file's name, and the unit that it says; "" where it says none."""
    found = {own_pairs.pair_key(name): (own, unit) for name, (own, unit) in found_in(header).items()}
    words = {word_and_unit(name)[0] for name in header}
    for name in header:
        word, unit = word_and_unit(name)
        key = name if name in NEEDED else ""
        if key:
            found[own_pairs.pair_key(key)] = (name, "")
        elif word in _LETTERS and {"ti", "tr"} <= words:
            found.setdefault(_LETTERS[word], (name, unit))
        elif word in _SHORT:
            found.setdefault(_SHORT[word], (name, unit))
        elif _DPHI.fullmatch(word):
            found.setdefault("phi_i" if word in ("phi", "φ", "ϕ") and "phi_r" in found else "dphi", (name, unit))
        elif word in _VALUES or _FACTOR.search(word.replace("_", " ")):
            found.setdefault("brdf", (name, {"%": "percent"}.get(unit, unit)))
    if "phi_r" in found:
        found.pop("dphi", None)
    return found


def _of(table: CsvTable, units: Mapping[str, str], preamble: str, given: dict[str, str]) -> Proposal:
    """The proposal for a table with a header, and with a row of units where `units` has some."""
    header = table.header
    out = Proposal(header)
    names, values = _names(header), {name: _numbers(table, name) for name in header}
    wide = _wide(header)
    if all(map(_is_number, header[1:])) and len(header) > 2:
        return _matrix(out, header, values, given)
    if wide and not ("brdf" in names and wide == "*"):
        names["brdf"] = (wide, "")
        names.pop("wavelength", None)
    left = [n for n in header if n not in {own for own, _ in names.values()} and values[n] is not None]
    in_row = {"-": "factor", "%": "percent"}  # of values
    for key, (own, unit) in names.items():
        if said := units.get(own, ""):
            names[key] = (own, in_row.get(said, said) if key == "brdf" else unit if said == "-" else said)
    alone = set[str]()
    for key, words in _ALONE.items():
        fitting = [n for n in left if word_and_unit(n)[0] in words] if words else left if not wide else []
        if key not in names and len(fitting) == 1:
            names[key] = (fitting[0], "")
            left.remove(fitting[0])
            alone.add(key)
    angles = [values[own] for key, (own, unit) in names.items() if key in _ANGLE_KEYS and not unit]
    thetas = [values[own] for key, (own, unit) in names.items() if key in _ANGLE_KEYS[:2] and not unit]
    radians = _radians(angles, thetas)
    for key in (*_ANGLE_KEYS, "wavelength", "polarisation", "sample", "brdf", "u_brdf", "u_random", "flag"):
        if key not in names:
            continue
        own, unit = names[key]
        why = f"its name says {unit}" if unit else "for no other column may be it" if key in alone else "by its name"
        if key in _ANGLE_KEYS and not unit and radians:
            unit, why = "rad", "by its name; no angle is above 1.6, and they are no whole numbers: radians"
        if key == "wavelength" and not unit and _most(values[own]) < 100:
            unit, why = "um", "by its name; below 100: micrometres"
        if key == "brdf" and unit in ("", "1/sr"):
            unit, why = _unit_of_values(own, unit, preamble, why)
        out.pairs[key] = f"{own}:{unit}" if unit else own
        out.reasons.append(f"{key}: {own!r}, {why}")
    _complete(out, given, {name for name in header if _least(values[name]) < 0})
    return out


_ANGLE_KEYS = ("theta_i", "theta_r", "phi_i", "phi_r", "dphi")


def _complete(out: Proposal, given: dict[str, str], negative: Collection[str]) -> None:
    """What is missing, from pairs that are given, or with a placeholder; signs of columns with negative numbers."""
    for key, own in given.items():
        name, colon, rest = own.partition(":")
        short = own_pairs.pair_key(key)
        for_all = not colon and (_is_number(name) or name in (*own_pairs.WIDE, own_pairs.MATRIX))
        if out.pairs.get(short, "").startswith(f"{own}:"):
            continue  # and its unit and sign
        if own in out.header or name in out.header or for_all:
            out.pairs[short] = own
        elif near := difflib.get_close_matches(name, out.header, n=1):
            out.pairs[short] = near[0] + colon + rest
    if "phi_r" in given and "dphi" not in given:
        out.pairs.pop("dphi", None)
    if "dphi" in given and "phi_r" not in given:
        out.pairs.pop("phi_r", None)
    for key, why in _SIGNED.items():
        own = out.pairs.get(key, "")
        if ":signed" not in own and any(own == name or own.startswith(f"{name}:") for name in negative):
            out.pairs[key] = f"{own}:signed"
            out.reasons.append(f"{key} is negative, {why}")
    signed = ":signed" in out.pairs.get("theta_r", "")
    if "phi_r" not in out.pairs and "dphi" not in out.pairs and not signed:
        out.pairs["phi_r" if "phi_i" in out.pairs else "dphi"] = UNKNOWN
        out.reasons.append("nothing says on which side the detector was: dphi=180 where all is on the mirror side")
    elif "dphi" in out.pairs:
        out.reasons.append(
            "dphi: 180 is taken for the mirror side; where 0 is, write phi_i=180,phi_r=... of that column"
        )
    if "phi_i" not in out.pairs:
        out.pairs["phi_i"] = "0" if "phi_r" not in out.pairs else UNKNOWN
    for key in ("theta_i", "theta_r", "brdf"):
        if key not in out.pairs:
            out.pairs[key] = UNKNOWN
            out.reasons.append(f"{key}: no column is known for it; a number where it was the same in all rows")
    plain = {key: own for key, own in out.pairs.items() if own != own_pairs.table_name(key)} or {"brdf": "brdf"}
    out.pairs = dict(sorted(plain.items(), key=lambda pair: (*_ORDER, pair[0]).index(pair[0])))


_SIGNED = {
    "theta_i": "and there the source is taken for at phi_i + 180",
    "theta_r": "and positive is taken for the mirror side (or :signed-retro)",
}
_ORDER = ("theta_i", "phi_i", "theta_r", "phi_r", "dphi", "wavelength", "polarisation", "sample", "brdf")


def _matrix(
    out: Proposal, header: Sequence[str], values: Mapping[str, Floats | None], given: dict[str, str]
) -> Proposal:
    out.reasons = [
        "the header is numbers but for its first cell: a matrix, theta_i in the header, theta_r in the first column"
    ]
    known = {own_pairs.pair_key(key): own for key, own in given.items()}
    out.pairs = {key: own for key, own in known.items() if _is_number(own) or own.split(":")[0] in _OF_MATRIX}
    least = {"theta_i": min(float(name.replace(",", ".")) for name in header[1:]), "theta_r": _least(values[header[0]])}
    for (key, why), place in zip(_SIGNED.items(), _OF_MATRIX, strict=False):
        own = out.pairs.get(key, place)
        if least[key] < 0 and ":signed" not in own:
            out.pairs[key] = f"{own}:signed"
            out.reasons.append(f"{key} is negative, {why}")
    signed = ":signed" in out.pairs.get("theta_r", "")
    out.pairs = {"phi_i": "0", **({} if signed else {"dphi": UNKNOWN}), "brdf": own_pairs.MATRIX} | out.pairs
    out.pairs = dict(sorted(out.pairs.items(), key=lambda pair: (*_ORDER, pair[0]).index(pair[0])))
    return out


_OF_MATRIX = ("header", "#1", own_pairs.MATRIX)
"""Where a matrix has theta_i, theta_r and brdf."""


def _without_header(lines: Sequence[str], path: Path) -> Proposal | None:
    """Numbers without names, whose columns nothing tells."""
    place = header_in(lines, lambda cells: len(cells) > 3 and all(map(_is_number, cells)))
    if place is None:
        return None if not lines else _no_numbers(lines)
    first, mark = place
    for line in lines[max(0, first - 1) : first]:  # names of another language are names
        names = cells_of(line, mark)
        if len(names) == len(cells_of(lines[first], mark)) and not any(map(_is_number, names)):
            return _unknown(names)
    count = len(lines[first].split()) if mark == BLANKS else lines[first].count(mark) + 1
    out = Proposal([f"#{k}" for k in range(1, count + 1)])
    out.pairs = dict.fromkeys(("theta_i", "phi_i", "theta_r", "phi_r", "brdf"), UNKNOWN)
    out.reasons = [f"the file has {count} columns of numbers without names: they are #1 to #{count}"]
    return out


def _no_numbers(lines: Sequence[str]) -> Proposal | None:
    """The first line that may be a header, where none of its names is known."""
    place = header_in(lines, lambda cells: len(cells) > 1)
    if place is None:
        return None
    return _unknown(cells_of(lines[place[0]], place[1]))


def _unknown(header: list[str]) -> Proposal:
    """A header of which no name is known."""
    out = Proposal(header)
    out.reasons = ["none of its names is known"]
    out.pairs = dict.fromkeys(("theta_i", "phi_i", "theta_r", "phi_r", "brdf"), UNKNOWN)
    return out


def _numbers(table: CsvTable, name: str) -> Floats | None:
    """The numbers of a column; None where it holds something else, or is there twice."""
    if table.header.count(name) != 1:
        return None
    k = table.header.index(name)
    cells = [row[k].strip().replace(",", ".") for row in table.rows if row[k].strip()]
    return np.array([float(cell) for cell in cells]) if cells and all(map(_is_number, cells)) else None


def _least(values: Floats | None) -> float:
    return float(values.min()) if values is not None else math.nan


def _most(values: Floats | None) -> float:
    return float(np.abs(values).max()) if values is not None else math.inf


def _radians(angles: Sequence[Floats | None], thetas: Sequence[Floats | None]) -> bool:
    """Whether angles whose unit nothing says look like radians."""
    known = [values for values in angles if values is not None]
    if not thetas or any(_most(values) > math.pi / 2 + 0.01 for values in thetas):
        return False
    return all(_most(v) < 2 * math.pi + 0.01 for v in known) and any((v != np.round(v)).any() for v in known)


def _unit_of_values(own: str, unit: str, preamble: str, why: str) -> tuple[str, str]:
    word = word_and_unit(own)[0].replace("_", " ")
    if "cos" in word or word == "ccbrdf":
        return "cos", f"{why}: BRDF times cos(theta_r)"
    if _FACTOR.search(word):
        return "factor", "its name is that of a reflectance factor"
    if own.startswith("*"):
        why = "columns named by wavelengths"
    if _FACTOR.search(preamble):
        return "factor", f"{why}; the lines before the header speak of a reflectance factor"
    return unit, why if unit else f"{why}; nothing says its unit, 1/sr is taken (or :factor, :percent, :cos)"
