"""ASTM E1392 text, as the Cornell gonioreflectometer wrote it: keyword lines, then one line a direction.

`VARS` names the columns: `theta_i, phi_i, theta_s, phi_s` in radians, then BRDF [1/sr] at one wavelength a column
(`550nm`). phi_s - phi_i = pi is the mirror half-plane, as in the measurement table. The format has no uncertainties
and no solid angles. A value of exactly zero is what the instrument wrote where the signal fell below its dark level:
the row is flagged "clamped", as a missing value. Small values, and negative ones, are data.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import DataError
from gonio.formats.base import Format, Text, fold, integer, numbers, plain_degrees, table, wide, write_bytes

if TYPE_CHECKING:
    import pandas as pd

_ANGLES = ["theta_i", "phi_i", "theta_s", "phi_s"]
_WAVELENGTH = re.compile(r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)\s*nm")


def read(data: bytes, path: Path) -> pd.DataFrame:
    text = Text(data, path)
    keywords, first = _header(text)
    names = [name.strip() for name in keywords["VARS"].split(",")]
    where = text.where(first - 1)
    if names[:4] != _ANGLES:
        raise DataError(f"{where}: VARS begins with {', '.join(names[:4])}; {', '.join(_ANGLES)} are needed")
    wavelengths = []
    for name in names[4:]:
        match = _WAVELENGTH.fullmatch(name)
        if not match or not 0 < float(match[1]) < math.inf:
            raise DataError(f'{where}: VARS names "{name[:40]}"; after the angles a wavelength is needed, as 550nm')
        wavelengths.append(float(match[1]))
    if not wavelengths:
        raise DataError(f"{where}: VARS names no wavelength")

    rows, decimals, last = [], 0, first
    for line in range(first, len(text.lines)):
        cells = text.lines[line].split(",")
        if cells == [""] or text.lines[line].isspace():
            continue
        if len(cells) != len(names):
            raise DataError(f"{text.where(line)}: {len(cells)} values, and VARS names {len(names)}")
        row = numbers(cells, text.where(line), names)
        for k in (0, 2):
            if abs(row[k]) > math.pi / 2 + 1e-3:
                allowed = "a polar angle in radians is needed, at most pi/2"
                raise DataError(f"{text.where(line)}: {names[k]} = {row[k]:g}; {allowed}")
        for k in (1, 3):
            if abs(row[k]) > 2 * math.pi + 1e-3:
                allowed = "an azimuth in radians is needed, within +-2 pi"
                raise DataError(f"{text.where(line)}: {names[k]} = {row[k]:g}; {allowed}")
        decimals = max(decimals, *(len(cell.partition(".")[2].strip()) for cell in cells[:4]))
        rows.append(row)
        last = line
    if not rows:
        raise DataError(f"{text.where(first - 1)}: no line of data follows")
    if "NUM_POINTS" in keywords:
        promised = integer(keywords["NUM_POINTS"], str(path), "NUM_POINTS", 0, 10**9)
        if promised != len(rows):
            raise DataError(f"{text.where(last)}: the file ends after {len(rows)} points, and NUM_POINTS is {promised}")

    values = np.array(rows)
    angles = plain_degrees(values[:, :4], decimals)
    theta_i, phi_i = fold(angles[:, 0], angles[:, 1], slack_deg=0.06)
    theta_r, phi_r = fold(angles[:, 2], angles[:, 3], slack_deg=0.06)
    count = len(wavelengths)
    brdf = values[:, 4:].ravel()
    clamped = brdf == 0
    notes = ["the format states no uncertainties", "the format states no solid angles of source and receiver"]
    if clamped.any():
        notes.insert(0, f'{clamped.sum()} of {brdf.size} values are zero: clamped, and flagged "clamped"')
    return table(
        theta_i_deg=np.repeat(theta_i, count),
        phi_i_deg=np.repeat(phi_i, count),
        theta_r_deg=np.repeat(theta_r, count),
        phi_r_deg=np.repeat(phi_r, count),
        wavelength_nm=np.tile(wavelengths, len(rows)),
        brdf=brdf,
        flag=np.where(clamped, "clamped", ""),
        attrs={
            "source_file": str(path),
            "sample": keywords.get("SAMPLE_NAME") or None,
            "provenance": {key: value for key, value in keywords.items() if key not in ("VARS", "NUM_POINTS")},
            "notes": notes,
        },
    )


def write(frame: pd.DataFrame, path: Path) -> None:
    """Angles in radians and values, all digits; a flagged row becomes a zero, which reads as "clamped"."""
    angles, wavelengths, values = wide(frame, path, "ASTM E1392")
    known = {key: value for key, value in frame.attrs.get("provenance", {}).items() if _is_keyword(key, value)}
    if frame.attrs.get("sample"):
        known["SAMPLE_NAME"] = " ".join(str(frame.attrs["sample"]).split())
    known["MEAS_NAME"] = "BRDF"
    lines = [f"{key} {value}" for key, value in known.items()]
    lines += [
        f"NUM_POINTS {len(angles)}",
        "VARS " + ",".join(_ANGLES + [f"{nm!r}nm" for nm in wavelengths.tolist()]),
        "",
    ]
    for direction, row in zip(np.deg2rad(angles).tolist(), np.nan_to_num(values).tolist(), strict=True):
        lines.append(",".join([f"{angle:.16f}" for angle in direction] + [repr(value) for value in row]))
    write_bytes(path, ("\n".join(lines) + "\n").encode())


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
    sniff=lambda head: re.search(rb"^VARS\s+theta_i\s*,", head, re.MULTILINE) is not None,
    read=read,
    write=write,
    carries=frozenset({"flag"}),
)
