"""Surface properties that TracePro exports as text: their table of BSDFs (`Table_BSDF_Data`).

A row is temperature [K], wavelength [um], polar angle and azimuth of incidence [degrees], the length of the vector
beta - beta0, its azimuth [degrees], BRDF and BTDF [1/sr]. beta is the direction of scattering projected onto the
surface, a vector of length sin(theta), and beta0 that of the mirror direction: the two columns are polar coordinates of
their difference, about the sample's x axis. Rows whose beta is longer than 1 are no direction, and are left out. A
column of zeros holds nothing.

The file does not say whether AziAngle is where light comes from, as it is taken here, nor whether the property is
applied with a fixed axis, as is taken, or with one that turns with the plane of incidence. A symmetric table (scatter
code 4) depends on the length alone; its rows stand for rings, and are read at the azimuth that is stated.
Sources: TracePro's help pages "Surface Property Import/Export Format" and "Asymmetric Table BSDF"; tried on the one
export in github.com/bazjo/brdf_utils, whose values do not depend on the azimuth.
"""

import re
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, table, wrap_deg
from gonio.formats.text import Text, numbers
from gonio.typing import DataFrame, Floats

_COLUMNS = ("Temperature", "Wavelength", "IncAngle", "AziAngle", "ScatterBeta", "ScatterAzimuth", "BRDF", "BTDF")


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a TracePro surface property; `DataError` says what is wrong, and in which line."""
    text = Text(data, path)
    rows = _rows(text)
    if np.unique(rows[:, 0]).size > 1:
        raise DataError(f"{path}: has {np.unique(rows[:, 0]).size} temperatures; export one of them")
    incidence, azimuth, around = np.deg2rad(rows[:, 2]), np.deg2rad(rows[:, 3]), np.deg2rad(rows[:, 5])
    x = -np.sin(incidence) * np.cos(azimuth) + rows[:, 4] * np.cos(around)
    y = -np.sin(incidence) * np.sin(azimuth) + rows[:, 4] * np.sin(around)
    sine = np.hypot(x, y)
    there = sine <= 1.0
    if not there.any():
        raise DataError(f"{path}: no row of its table is a direction; beta is longer than 1 in each")
    notes = [
        "beta - beta0 is taken about a fixed x axis of the sample, and AziAngle as where light comes from: the file "
        "states neither",
        "the file states no uncertainties and no solid angles",
    ]
    if not there.all():
        notes.append(f"{int((~there).sum())} of {there.size} rows are no direction (beta longer than 1): left out")
    name = next((line.split(None, 1)[1:] for line in text.lines if re.match(r"Name\s", line)), [])
    # rounded far below any instrument's resolution, so that the mirror direction is exactly that
    theta, phi = np.round(np.rad2deg(np.arcsin(sine[there])), 9), np.round(np.rad2deg(np.arctan2(y, x))[there], 9)
    kinds = [(k, side) for k, side in ((6, "reflection"), (7, "transmission")) if rows[there, k].any()] or [
        (6, "reflection")
    ]
    used = {side: theta < 90.0 if side == "transmission" else theta <= 90.0 for _, side in kinds}
    parts = [
        np.column_stack([rows[there, :4], 180.0 - theta if k == 7 else theta, phi, rows[there, k]])[used[side]]
        for k, side in kinds
    ]
    found = np.concatenate(parts)
    return table(
        theta_i_deg=found[:, 2],
        phi_i_deg=wrap_deg(found[:, 3]),
        theta_r_deg=found[:, 4],
        phi_r_deg=wrap_deg(found[:, 5]),
        wavelength_nm=found[:, 1] * 1000.0,
        brdf=found[:, 6],
        side=np.repeat([side for _, side in kinds], [len(part) for part in parts]).astype(object),
        attrs={"source_file": str(path), "sample": name[0].strip() if name else path.stem, "notes": notes},
    )


def _rows(text: Text) -> Floats:
    """The table's rows of eight numbers."""
    starts = [line for line, content in enumerate(text.lines) if content.strip() == "Table_BSDF_Data"]
    if len(starts) != 1:
        raise DataError(
            f"{text.path}: has {len(starts)} tables (Table_BSDF_Data), and one is read; export one property, one side, "
            "with a scatter model of the kind table"
        )
    if text.lines[starts[0] + 1 :][:1] and text.lines[starts[0] + 1].split() != list(_COLUMNS):
        raise DataError(f"{text.where(starts[0] + 1)}: the columns {', '.join(_COLUMNS)} are needed")
    rows = []
    for line in range(starts[0] + 2, len(text.lines)):
        cells = text.lines[line].split()
        if cells and re.match(r"[A-Za-z]", cells[0]):
            break  # SAVE-DATA, or what follows
        if cells:
            if len(cells) != len(_COLUMNS):
                raise DataError(f"{text.where(line)}: {len(cells)} numbers; {len(_COLUMNS)} are needed")
            row = numbers(cells, text.where(line), _COLUMNS)
            if not (0.1 <= row[1] <= 200 and 0 <= row[2] <= 90 and abs(row[3]) <= 360 and row[4] >= 0):
                raise DataError(
                    f"{text.where(line)}: {', '.join(f'{value:g}' for value in row[1:5])} for wavelength [um], angle "
                    "and azimuth of incidence [degrees], and length of beta - beta0"
                )
            rows.append(row)
    if not rows:
        raise DataError(f"{text.where(starts[0])}: no row follows")
    return np.array(rows)


FORMAT = Format(
    name="tracepro",
    title="TracePro surface property",
    endings=(),
    sniff=lambda head: head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"TracePro Surface Property Data"),
    read=read,
)
