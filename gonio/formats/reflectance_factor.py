"""Two-dimensional spectral goniometer tables: the reflectance factor, one column a wavelength, as CSV.

Columns: `Incident_angle` and `Measure_angle` [degrees] in one plane, the second signed and positive on the mirror side,
then the reflectance factor at one wavelength a column (`550nm`). The reflectance factor of a perfect diffuser is 1,
so brdf = R / pi. A value of exactly zero is written where the receiver would stand in the beam: it is flagged
"blocked".
"""

import math
import re
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, fold, spectra, wide, write_lines
from gonio.formats.text import column_names, csv_table
from gonio.typing import DataFrame

_WAVELENGTH = re.compile(r"(\d{1,7}(?:\.\d+)?)\s*nm")
_ANGLES = ["Incident_angle", "Measure_angle"]


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a reflectance-factor CSV; `DataError` says what is wrong with the file, and where."""
    cells = csv_table(data, path, _ANGLES)
    columns = [name for name in cells.header if name not in _ANGLES]
    matches = [_WAVELENGTH.fullmatch(name) for name in columns]
    if not columns or not all(match and float(match[1]) > 0 for match in matches):
        unknown = next((name for name, match in zip(columns, matches, strict=True) if not match), "")
        raise DataError(f'{path}, line 1: column "{unknown[:40]}" is no wavelength; columns as 550nm are needed')
    wavelengths = [float(match[1]) for match in matches if match]
    incident, measured = (cells.angles(name, 90.0, " lies outside +-90 degrees") for name in _ANGLES)
    factor = np.column_stack([cells.column(name, estimates=True) for name in columns])
    blocked = factor.ravel() == 0
    notes = [
        "the file holds reflectance factors R; brdf = R / pi",
        "the format states no uncertainties and no solid angles",
        *cells.notes(),
    ]
    if blocked.any():
        notes.append(f'{blocked.sum()} of {factor.size} values are zero: the zone around retro, flagged "blocked"')
    return spectra(
        (*fold(incident, 0.0), *fold(measured, 180.0)),
        wavelengths,
        factor / math.pi,
        flag=np.where(blocked, "blocked", ""),
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )


def write(frame: DataFrame, path: Path) -> None:
    """In-plane tables only; what is flagged is written as zero."""
    angles, wavelengths, values = wide(frame, path, "a reflectance-factor table")
    dphi = np.mod(angles[:, 3] - angles[:, 1], 360.0)
    mirror, retro = np.abs(dphi - 180) < 1e-6, np.minimum(dphi, 360 - dphi) < 1e-6
    for row in np.flatnonzero(~(mirror | retro | ((angles[:, 2] == 0) | (angles[:, 0] == 0))))[:1]:
        raise DataError(
            f"{path}: a reflectance-factor table holds one plane, and phi_r - phi_i = {dphi[row]:g} degrees"
        )
    signed = np.where(retro, -angles[:, 2], angles[:, 2])
    rows = np.column_stack([angles[:, 0], signed, np.nan_to_num(values * math.pi)]).tolist()
    header = ",".join(_ANGLES + [f"{nm!r}nm" for nm in wavelengths.tolist()])
    write_lines(path, [header, *(",".join(map(repr, row)) for row in rows)])


FORMAT = Format(
    name="reflectance-factor",
    title="reflectance-factor table",
    endings=(".csv",),
    sniff=lambda head: set(_ANGLES) <= set(column_names(head)),
    read=read,
    write=write,
    carries=frozenset({"flag"}),
    only_flag="blocked",
)
