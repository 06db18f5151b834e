"""NIST's Mueller-matrix BRDF tables (Germer, sintered PTFE): a CSV with one row a direction and wavelength.

Columns: `lambda` [um], `thetai, phi (or phii), thetar, phir` [degrees], `f_r11` (or `fr11`) [1/sr], and 15 ratios of
the Mueller matrix to its first element in a basis fixed to the sample's x and y. `f_r11` is the BRDF for unpolarised
light. The polar angle of incidence is negative in NIST's files, which puts the source at azimuth phi + 180, so that
phir = 0 is the mirror half-plane. The ratios are not carried into the table: its polarised rows are for s and p, and
these ratios refer to x and y. Uncertainties and solid angles are not in the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, fold, table
from gonio.formats.text import column_names, csv_table

if TYPE_CHECKING:
    import pandas as pd


def read(data: bytes, path: Path) -> pd.DataFrame:
    """The measurement table in one of NIST's Mueller CSVs; `DataError` says what is wrong with the file, and where."""
    names = column_names(data[:4096])
    value = "fr11" if "fr11" in names else "f_r11"
    azimuth = "phii" if "phii" in names else "phi"
    cells = csv_table(data, path, ["lambda", "thetai", azimuth, "thetar", "phir", value])
    um = cells.column("lambda")
    for row in np.flatnonzero(~((um > 0) & (um < 1000)))[:1]:
        raise DataError(f"{cells.where(int(row))}: lambda = {um[row]:g}; a wavelength in micrometres is needed")
    theta = {name: cells.column(name) for name in ("thetai", "thetar")}
    for name, angle in theta.items():
        for row in np.flatnonzero(np.abs(angle) > 90)[:1]:
            raise DataError(
                f"{cells.where(int(row))}: {name} = {angle[row]:g}; a polar angle in +-90 degrees is needed"
            )
    theta_i, phi_i = fold(theta["thetai"], cells.column(azimuth))
    theta_r, phi_r = fold(theta["thetar"], cells.column("phir"))
    notes = [
        "the file states no uncertainties and no solid angles",
        "the BRDF is f_r11, for unpolarised light; the Mueller ratios (in the xy basis) are not carried",
    ]
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=np.round(um * 1000.0, 9),
        brdf=cells.column(value, estimates=True),
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )


def _sniff(head: bytes) -> bool:
    names = column_names(head)
    return {"lambda", "thetai", "thetar"} <= names and not names.isdisjoint(("f_r11", "fr11"))


FORMAT = Format(name="nist-mueller", title="NIST Mueller-matrix CSV", endings=(".csv",), sniff=_sniff, read=read)
