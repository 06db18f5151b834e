"""ALTA text: the plain data files of the ALTA library, with `#` keyword lines and one line a direction.

`#DIM n m` counts the coordinates and the values of a line, `#PARAM_IN` names the coordinates:

    ISOTROPIC_TL_TV_PROJ_DPHI      theta_l, theta_v cos(dphi), theta_v sin(dphi)
    ISOTROPIC_TV_TL_DPHI           theta_v, theta_l, dphi
    SPHERICAL_TL_PL_TV_PV          theta_l, phi_l, theta_v, phi_v

all in radians, l toward the light and v toward the viewer, dphi = phi_v - phi_l (0 is retro). `#PARAM_OUT` names the
quantity: INV_STERADIAN is the BRDF; INV_STERADIAN_COSINE_FACTOR is the BRDF times cos(theta_l), divided out here.
ALTA names no wavelength, no uncertainty and no solid angle; files that we write say theirs in `#WAVELENGTH_NM`.
"""

import math
import re
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import (
    NOT_IN_A_LINE,
    Format,
    fold,
    one_value_a_direction,
    plain_degrees,
    require_held,
    single,
    spectra,
    whole_turns,
    wide,
    write_lines,
)
from gonio.formats.text import Text, estimate, integer, number, numbers
from gonio.typing import DataFrame, Floats

_COORDINATES = {"ISOTROPIC_TL_TV_PROJ_DPHI": 3, "ISOTROPIC_TV_TL_DPHI": 3, "SPHERICAL_TL_PL_TV_PV": 4}
_QUANTITIES = ("INV_STERADIAN", "INV_STERADIAN_COSINE_FACTOR")


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in ALTA text; `DataError` says what is wrong with the file, and where."""
    text = Text(data, path)
    keywords: dict[str, str] = {}
    for content in text.lines:
        if content.startswith("#"):
            word, *rest = content[1:].split(maxsplit=1) or [""]
            keywords[word] = "".join(rest).strip()
    lines = [k for k, content in enumerate(text.lines) if content.strip() and not content.startswith("#")]
    kind, quantity = keywords.get("PARAM_IN", ""), keywords.get("PARAM_OUT", "INV_STERADIAN")
    for key, value, known in (("PARAM_IN", kind, tuple(_COORDINATES)), ("PARAM_OUT", quantity, _QUANTITIES)):
        if value not in known:
            raise DataError(f'{path}: #{key} is "{value[:40]}"; read are {", ".join(known)}')
    if keywords.get("VS", "0").split()[:1] not in ([], ["0"]):
        raise DataError(f"{path}: #VS {keywords['VS'][:20]}: files with confidence intervals are not read")
    coordinates = _COORDINATES[kind]
    dim = keywords.get("DIM", "").split()
    if len(dim) != 2 or integer(dim[0], str(path), "#DIM", 1, 100) != coordinates:
        raise DataError(f"{path}: #DIM {keywords.get('DIM', '')[:20]}: {kind} has {coordinates} coordinates")
    count = integer(dim[1], str(path), "#DIM", 1, 10_000)
    wavelengths = [number(word, str(path), "#WAVELENGTH_NM") for word in keywords.get("WAVELENGTH_NM", "").split()]
    if len(wavelengths) != count:
        if wavelengths or count > 1:
            raise DataError(f"{path}: {count} values a line, and {len(wavelengths)} wavelengths in #WAVELENGTH_NM")
        wavelengths = [math.nan]
    if not lines:
        raise DataError(f"{path}: there is no line of data")
    rows = _rows(text, lines, coordinates, count)
    stated = _stated(kind, rows[:, :coordinates])
    theta_i, phi_i, theta_r, phi_r = (
        angle for theta, phi in (stated[:2], stated[2:]) for angle in fold(theta, phi, slack_deg=0.001)
    )
    for name, theta in (("light", theta_i), ("viewer", theta_r)):
        for row in np.flatnonzero(theta > 90)[:1]:
            raise DataError(
                f"{text.where(lines[int(row)])}: the {name} stands at {theta[row]:g} degrees, below the surface"
            )
    values = rows[:, coordinates:]
    notes = ["the format states no uncertainties and no solid angles"]
    if "PARAM_OUT" not in keywords:
        notes.append("the file has no #PARAM_OUT: values are taken as BRDF in 1/sr (INV_STERADIAN)")
    if quantity == "INV_STERADIAN_COSINE_FACTOR":
        for row in np.flatnonzero(theta_i >= 90)[:1]:
            raise DataError(f"{text.where(lines[int(row)])}: a cosine factor of zero cannot be divided out")
        values = values / np.cos(np.deg2rad(theta_i))[:, np.newaxis]
        notes.append("values were BRDF times cos(theta_i); the cosine is divided out")
    if math.isnan(wavelengths[0]):
        notes.append("the file states no wavelength")
    frame = spectra(
        (theta_i, phi_i, theta_r, phi_r),
        wavelengths,
        values,
        attrs={
            "source_file": str(path),
            "sample": keywords.get("SAMPLE", "").removeprefix('"').removesuffix('"') or None,
            "provenance": {key: keywords[key] for key in ("ORIGIN", "URL") if key in keywords},
            "notes": notes,
        },
    )
    return one_value_a_direction(frame, np.column_stack(stated), path)


def _rows(text: Text, lines: list[int], coordinates: int, count: int) -> Floats:
    """Coordinates and values of each line of data."""
    names = [f"coordinate {k + 1}" for k in range(coordinates)] + [f"value {k + 1}" for k in range(count)]
    rows = np.empty((len(lines), coordinates + count))
    for row, line in enumerate(lines):
        cells = text.lines[line].split()
        if len(cells) != len(names):
            raise DataError(f"{text.where(line)}: {len(cells)} numbers, and #DIM makes it {len(names)}")
        rows[row, :coordinates] = numbers(cells[:coordinates], text.where(line), names[:coordinates])
        rows[row, coordinates:] = numbers(cells[coordinates:], text.where(line), names[coordinates:], estimate)
    return rows


def _stated(kind: str, rows: Floats) -> list[Floats]:
    """The four angles as the coordinates state them [degrees]."""
    first, second, third, *_ = columns = list(rows.T)
    light, viewer = (columns[0], columns[1]), (columns[2], columns[-1])
    if kind == "ISOTROPIC_TL_TV_PROJ_DPHI":
        light, viewer = (first, 0.0 * first), (np.hypot(second, third), np.arctan2(third, second))
    elif kind == "ISOTROPIC_TV_TL_DPHI":
        light, viewer = (second, 0.0 * first), (first, third)
    # the digits of a float stand for 1e-13 degrees here; files round pi/2 up
    return [
        angle
        for theta, phi in (light, viewer)
        for angle in (plain_degrees(theta, 13), whole_turns(plain_degrees(phi, 13)))
    ]


def write(frame: DataFrame, path: Path) -> None:
    """Full directions (SPHERICAL_TL_PL_TV_PV) and the BRDF without a cosine; flagged rows are left out."""
    single(frame, path, "ALTA text")
    usable = frame[frame["flag"] == ""]
    if usable.empty:
        raise DataError(f"{path}: every row of the table is flagged; ALTA text has no room for flags")
    broad = usable["wavelength_nm"].isna().all()
    angles, wavelengths, values = wide(usable.fillna({"wavelength_nm": 0.0}) if broad else usable, path, "ALTA text")
    if np.isnan(values).any():
        raise DataError(f"{path}: ALTA text needs every wavelength in every direction; a direction lacks one")
    sample = re.sub(r"[\r\n]", " ", str(frame.attrs.get("sample") or ""))
    require_held(sample, path, "ALTA text", NOT_IN_A_LINE)
    lines = [f'#SAMPLE "{sample}"', f"#DIM 4 {wavelengths.size}", "#VS 0", "#PARAM_IN SPHERICAL_TL_PL_TV_PV",
             "#PARAM_OUT INV_STERADIAN"]  # fmt: skip
    if not broad:
        lines.append("#WAVELENGTH_NM " + " ".join(repr(nm) for nm in wavelengths.tolist()))
    rows = np.column_stack([np.deg2rad(angles), values]).tolist()
    write_lines(path, [*lines, *(" ".join(map(repr, row)) for row in rows)])


FORMAT = Format(
    name="alta",
    title="ALTA text",
    endings=(".dat", ".alta"),
    sniff=lambda head: b"#PARAM_IN" in head and re.search(rb"^#PARAM_IN\b", head, re.MULTILINE) is not None,
    read=read,
    write=write,
)
