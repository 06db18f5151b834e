"""ASTM E1392 text, as the Cornell gonioreflectometer wrote it: keyword lines, then one line a direction.

`VARS` names the columns, in any order: `theta_i, phi_i, theta_s, phi_s` (or `theta_r, phi_r`) in radians, and BRDF
[1/sr] at one wavelength a column (`550nm`, `0.55um`), or in one column `BRDF` without a wavelength. phi_s - phi_i = pi
is the mirror half-plane, as in the measurement table. The format has no uncertainties and no solid angles. A value of
exactly zero is what the instrument wrote where the signal fell below its dark level: the row is flagged "clamped", as
a missing value. Small values, and negative ones, are data.
"""

import math
import re
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats import reader
from gonio.formats.reader import (
    NOT_IN_A_LINE,
    Format,
    fold,
    one_value_a_direction,
    plain_degrees,
    require_held,
    spectra,
    wide,
    write_lines,
)
from gonio.formats.text import Text, estimate, integer, numbers
from gonio.typing import DataFrame

_ANGLES = ["theta_i", "phi_i", "theta_s", "phi_s"]
_POLAR = math.pi / 2, "a polar angle in radians is needed, at most pi/2"
_AZIMUTH = 2 * math.pi, "an azimuth in radians is needed, within +-2 pi"
_ALLOWED = ((0, *_POLAR), (2, *_POLAR), (1, *_AZIMUTH), (3, *_AZIMUTH))
_ALIASES = {"theta_r": "theta_s", "phi_r": "phi_s"}
_WAVELENGTH = re.compile(r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)\s*(nm|um|\u00b5m|\u03bcm)", re.IGNORECASE)


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in ASTM E1392 text; `DataError` says what is wrong with the file, and where."""
    text = Text(data, path)
    keywords, first = _header(text)
    where = text.where(first - 1)
    names = _cells(keywords["VARS"])
    plain = [_ALIASES.get(name.lower(), name.lower()) for name in names]
    if any(plain.count(name) != 1 for name in _ANGLES):
        raise DataError(f"{where}: VARS names {', '.join(names)[:80]}; {', '.join(_ANGLES)} are needed, each once")
    angle_columns = [plain.index(name) for name in _ANGLES]
    value_columns = [k for k in range(len(names)) if k not in angle_columns]
    wavelengths = _wavelengths([names[k] for k in value_columns], where)
    rows, decimals, last = _rows(text, first, names, angle_columns, value_columns)
    if "NUM_POINTS" in keywords:
        promised = integer(keywords["NUM_POINTS"], str(path), "NUM_POINTS", 0, 10**9)
        if promised != len(rows):
            raise DataError(f"{text.where(last)}: the file ends after {len(rows)} points, and NUM_POINTS is {promised}")

    values = np.array(rows)
    theta_i, phi_i, theta_r, phi_r = plain_degrees(values[:, :4], decimals).T
    clamped = values[:, 4:].ravel() == 0
    notes = ["the format states no uncertainties", "the format states no solid angles of source and receiver"]
    if math.isnan(wavelengths[0]):
        notes.append("the file states no wavelength")
    if clamped.any():
        notes.insert(0, f'{clamped.sum()} of {clamped.size} values are zero: clamped, and flagged "clamped"')
    frame = spectra(
        (*fold(theta_i, phi_i, slack_deg=0.06), *fold(theta_r, phi_r, slack_deg=0.06)),
        wavelengths,
        values[:, 4:],
        flag=np.where(clamped, "clamped", ""),
        attrs={
            "source_file": str(path),
            "sample": keywords.get("SAMPLE_NAME") or None,
            "provenance": {key: value for key, value in keywords.items() if key not in ("VARS", "NUM_POINTS")},
            "notes": notes,
        },
    )
    return one_value_a_direction(frame, np.column_stack([theta_i, phi_i, theta_r, phi_r]), path)


def _rows(
    text: Text, first: int, names: list[str], angle_columns: list[int], value_columns: list[int]
) -> tuple[list[list[float]], int, int]:
    """Angles [rad] and values of each line from `first` on; the angles' decimals; and the last line that has some."""
    rows, decimals, last = [], 0, first
    for line in range(first, len(text.lines)):
        cells = _cells(text.lines[line])
        if not cells:
            continue
        if len(cells) != len(names):
            raise DataError(f"{text.where(line)}: {len(cells)} values, and VARS names {len(names)}")
        angle_cells = [cells[k] for k in angle_columns]
        angle = numbers(angle_cells, text.where(line), _ANGLES)
        for k, most, allowed in _ALLOWED:
            if abs(angle[k]) > most + 1e-3:
                raise DataError(f"{text.where(line)}: {_ANGLES[k]} = {angle[k]:g}; {allowed}")
        decimals, last = max(decimals, *map(_decimals, angle_cells)), line
        value_names = [names[k] for k in value_columns]
        rows.append(angle + numbers([cells[k] for k in value_columns], text.where(line), value_names, estimate))
    if not rows:
        raise DataError(f"{text.where(first - 1)}: no line of data follows")
    return rows, decimals, last


HEADER = {
    "LAB_NAME": "organisation", "LAB_ADD": "address.street", "LAB_CITY": "address.city",
    "LAB_ZIP": "address.postal_code", "LAB_OPERATOR": "operator", "LAB_COMMENTS": "description",
    "SAMPLE_NAME": "sample.name", "SAMPLE_TYPE": "sample.type", "MEAS_DATE": "measured",
}  # fmt: skip
"""Keywords of the standard's header, and the keys of `[laboratory]` that say it."""
REQUIRED = ("LAB_NAME", "LAB_OPERATOR", "SAMPLE_NAME", "MEAS_DATE")


def _known(frame: DataFrame) -> dict[str, str]:
    """Keywords of the header: those of the file that was read, and what the laboratory has stated."""
    known = {key: value for key, value in frame.attrs.get("provenance", {}).items() if _is_keyword(key, value)}
    laboratory = reader.laboratory_of(frame) or {}
    for keyword, key in HEADER.items():
        if value := reader.get(laboratory, key):
            known.setdefault(keyword, " ".join(str(value).split()))
    if frame.attrs.get("sample"):
        known["SAMPLE_NAME"] = " ".join(str(frame.attrs["sample"]).split())
    return known


def remarks(frame: DataFrame) -> list[str]:
    """For a run: which keywords of the header nobody has stated."""
    if "reduced_by" not in frame.attrs.get("provenance", {}):
        return []
    lacking = [f"{name} (laboratory.{HEADER[name]})" for name in REQUIRED if name not in _known(frame)]
    return [f"the header lacks what nobody has stated: {', '.join(lacking)}"] if lacking else []


def write(frame: DataFrame, path: Path) -> None:
    """Angles in radians and values, all digits; a flagged row becomes a zero, which reads as "clamped"."""
    angles, wavelengths, values = wide(frame, path, "ASTM E1392")
    lines = [f"{key} {value}" for key, value in (_known(frame) | {"MEAS_NAME": "BRDF"}).items()]
    for line in (str(frame.attrs.get("sample") or ""), *lines):
        require_held(line, path, "ASTM E1392", NOT_IN_A_LINE)
    lines += [
        f"NUM_POINTS {len(angles)}",
        "VARS " + ",".join(_ANGLES + [f"{nm!r}nm" for nm in wavelengths.tolist()]),
        "",
    ]
    for direction, row in zip(np.deg2rad(angles).tolist(), np.nan_to_num(values).tolist(), strict=True):
        lines.append(",".join([f"{angle:.16f}" for angle in direction] + [repr(value) for value in row]))
    write_lines(path, lines)


def _cells(line: str) -> list[str]:
    """The cells of a line, which commas separate, or else blanks."""
    return [cell.strip() for cell in line.split(",")] if "," in line else line.split()


def _decimals(cell: str) -> int:
    """How many decimals a number is written with: 4 for 0.1745 and for 1.745e-1."""
    mantissa, _, exponent = cell.lower().partition("e")
    return min(max(len(mantissa.partition(".")[2]) - int(exponent or 0), 0), 17)


def _wavelengths(names: list[str], where: str) -> list[float]:
    """The wavelength of each column of values [nm]; NaN for the one column `BRDF`."""
    if [name.lower() for name in names] == ["brdf"]:
        return [math.nan]
    matches = [_WAVELENGTH.fullmatch(name) for name in names]
    wavelengths = [float(m[1]) * (1.0 if m[2].lower() == "nm" else 1000.0) if m else math.nan for m in matches]
    for name, nm in zip(names, wavelengths, strict=True):
        if not 0 < nm < math.inf:
            raise DataError(f'{where}: VARS names "{name[:40]}"; beside the angles a wavelength is needed, as 550nm')
    if not names:
        raise DataError(f"{where}: VARS names no wavelength")
    return wavelengths


def _header(text: Text) -> tuple[dict[str, str], int]:
    """The keyword lines, and the index of the line after VARS."""
    keywords: dict[str, str] = {}
    key = ""
    for line, content in enumerate(text.lines):
        word, *value = content.split(maxsplit=1)[:2] or [""]
        if re.fullmatch(r"[A-Z][A-Z0-9_]*", word):
            key = word
            keywords[key] = value[0].strip() if value else ""
        elif word and key:  # a long comment goes on
            keywords[key] = f"{keywords[key]} {content.strip()}"[:10_000]
        if word == "VARS":
            return keywords, line + 1
    raise DataError(f"{text.path}: there is no line VARS, which names the columns of an ASTM E1392 file")


def _is_keyword(key: str, value: object) -> bool:
    return isinstance(value, str) and re.fullmatch(r"[A-Z][A-Z0-9_]*", key) is not None and "\n" not in value


FORMAT = Format(
    name="astm",
    title="ASTM E1392 text",
    endings=(".astm",),
    sniff=lambda head: b"VARS" in head and re.search(rb"^VARS\s[^\r\n]*theta_i\b", head, re.MULTILINE) is not None,
    read=read,
    write=write,
    remarks=remarks,
    carries=frozenset({"flag"}),
    only_flag="clamped",
)
