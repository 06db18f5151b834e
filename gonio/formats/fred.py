"""Blocks of angles and values: tabulated scatter of FRED, and the `!!BSDF Data` files of RPC Photonics (now VIAVI).

FRED's file begins with

    type bsdf_data
    format angles=deg bsdf=value scale=1

and then has blocks: a line of two numbers is the direction of the specular ray (theta, phi), each line of three after
it a scattered direction and its BSDF [1/sr]. `angles=sin` gives sin(phi) sin(theta) and cos(phi) sin(theta) in place of
theta and phi, `bsdf=log` the logarithm to base 10, and values are to be multiplied by `scale`. Scans in the plane have
a signed theta and phi = 0. The specular ray leaves in the file's phi, so light comes from phi + 180. FRED applies one
table to reflection or to transmission, as its user chooses: here values are reflection.

RPC Photonics' files have two lines that begin with `!!`, one block, and degrees; several joined into one file are one
table. They are of diffusers in transmission, about the straight direction: values are given at normal incidence in the
direction of the lamp, too, where a detector in reflection would stand in the beam.

Read as FRED's help page "Tabulated BSDF" and RPC's page "BSDF Data Format" describe them, and tried on the files of
both kinds in github.com/ua-loft/bsdf-tools (FRED's with theta from 0 to 80, and from -80 to 80, degrees alone).
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, fold, one_value_a_direction, table, wrap_deg
from gonio.formats.text import Text, number, numbers
from gonio.typing import DataFrame, Floats

_WORDS = {"angles": ("deg", "sin"), "bsdf": ("value", "log")}
_RPC, _FRED = re.compile(r"!!\s*BSDF\s+Data\b", re.IGNORECASE), re.compile(r"type\s+bsdf_data\s*", re.IGNORECASE)


@dataclass
class _Header:
    """How the numbers of a file are meant."""

    through: bool
    sines: bool = False
    logarithms: bool = False
    scale: float = 1.0


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in blocks of angles and values; `DataError` says what is wrong, and in which line."""
    text = Text(data, path)
    header, notes = _header(text)
    rows, lines = _rows(text)
    specular, scattered = (_angles(rows[:, k : k + 2], header.sines) for k in (0, 2))
    for name, angles in (("specular", specular), ("scattered", scattered)):
        for row in np.flatnonzero(~(np.abs(angles[:, 0]) <= 90))[:1]:
            raise DataError(f"{text.where(lines[row])}: the {name} direction is beyond 90 degrees from the normal")
    with np.errstate(over="ignore"):
        brdf = header.scale * (10.0 ** rows[:, 4] if header.logarithms else rows[:, 4])
    for row in np.flatnonzero(~np.isfinite(brdf))[:1]:
        raise DataError(f"{text.where(lines[row])}: the value is beyond the range of a float")
    theta_i, phi_i = fold(specular[:, 0], specular[:, 1] + 180.0)
    theta_r, phi_r = fold(scattered[:, 0], scattered[:, 1])
    notes.append("the file states no wavelength, no uncertainties and no solid angles")
    frame = table(
        theta_i_deg=theta_i,
        phi_i_deg=wrap_deg(phi_i),
        theta_r_deg=180.0 - theta_r if header.through else theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=math.nan,
        brdf=brdf,
        side="transmission" if header.through else None,
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )
    return one_value_a_direction(frame, np.column_stack([specular, scattered]), path)


def _header(text: Text) -> tuple[_Header, list[str]]:
    """How the numbers are meant, and what was assumed."""
    stated = [line for line in text.lines if line.strip()][:2]
    if any(_RPC.match(line.strip()) for line in stated):
        return _Header(through=True), [
            "the file does not state whether it is reflection: taken as transmission, as RPC Photonics' diffusers are"
        ]
    if not stated or not _FRED.fullmatch(stated[0].strip()):
        raise DataError(f'{text.path}, line 1: "type bsdf_data" of FRED, or "!!BSDF Data", is needed')
    words = stated[-1].split()
    where = text.where(text.lines.index(stated[-1]))
    pairs = dict(word.lower().partition("=")[::2] for word in words[1:])
    if words[0].lower() != "format" or not {"angles", "bsdf"} <= set(pairs):
        raise DataError(f'{where}: a line as "format angles=deg bsdf=value scale=1" is needed after "type bsdf_data"')
    for key, allowed in _WORDS.items():
        if pairs[key] not in allowed:
            raise DataError(f'{where}: {key} is "{pairs[key][:40]}"; read are {" and ".join(allowed)}')
    notes = ["the file does not state whether it is reflection or transmission: taken as reflection"]
    if unused := sorted(set(pairs) & {"exclude", "num"}):
        notes.append(f"{' and '.join(unused)} of the line format are about FRED's interpolation: not applied")
    if unknown := sorted(set(pairs) - {"angles", "bsdf", "scale", "exclude", "num"}):
        raise DataError(f'{where}: "{unknown[0][:40]}" is not known; angles, bsdf, scale, exclude and num are')
    scale = number(pairs.get("scale", "1"), where, "scale")
    if scale <= 0:
        raise DataError(f"{where}: scale = {scale:g}; a factor above zero is needed")
    if scale != 1:
        notes.append(f"values are multiplied by the file's scale, {scale:g}")
    return _Header(through=False, sines=pairs["angles"] == "sin", logarithms=pairs["bsdf"] == "log", scale=scale), notes


def _rows(text: Text) -> tuple[Floats, list[int]]:
    """Specular direction, scattered direction and value of each line of three numbers; and where the lines stand."""
    specular: list[float] = []
    rows, lines = list[list[float]](), list[int]()
    for line, content in enumerate(text.lines):
        cells = content.replace(",", " ").split()
        if not cells or content.startswith("!!") or cells[0].lower() in ("type", "format"):
            continue
        if len(cells) not in (2, 3):
            raise DataError(
                f"{text.where(line)}: {len(cells)} numbers; two are needed for the specular direction, or three for a "
                "scattered direction and its value"
            )
        found = numbers(cells, text.where(line), ("theta", "phi", "bsdf")[: len(cells)])
        if len(cells) == 2:
            specular = found
        elif not specular:
            raise DataError(f"{text.where(line)}: values before a specular direction, which is a line of two numbers")
        else:
            rows.append(specular + found)
            lines.append(line)
    if not rows:
        raise DataError(f"{text.path}: holds no line of a scattered direction and its value")
    return np.array(rows), lines


def _angles(stated: Floats, sines: bool) -> Floats:
    """theta, phi [degrees] of directions, which may be stated as sin(phi) sin(theta), cos(phi) sin(theta)."""
    if not sines:
        return stated
    alpha, beta = stated.T
    with np.errstate(invalid="ignore"):  # beyond the horizon: NaN, which is refused
        theta = np.arcsin(np.hypot(alpha, beta))
    return np.column_stack([np.rad2deg(theta), np.rad2deg(np.arctan2(alpha, beta))])


FORMAT = Format(
    name="fred",
    title="FRED and RPC Photonics blocks of angles and values",
    endings=(),
    sniff=lambda head: (
        b"bsdf" in head.lower()
        and re.search(rb"^(type\s+bsdf_data\s*$|!!\s*BSDF\s+Data\b)", head, re.I | re.MULTILINE) is not None
    ),
    read=read,
)
