"""In-plane infrared goniometer tables: reflected band radiance of several samples, as CSV.

Columns: `sample_de`, `sample_en` (one of them is enough), `theta_o_deg` (receiver) and `theta_i_deg` (source), which
lie in one plane on opposite sides of the normal, and the reflected radiance `L_reflected_W_m-2_sr-1` in the band
from 2 to 5.7 um. With the source's radiance L_s in that band and its disc of 5 mm radius at 315 mm distance

    brdf = L / (L_s cos(theta_i) w_s),    L_s = 3463.986 W m^-2 sr^-1,    w_s = pi (5/315)^2 sr

The band is broad, so `wavelength_nm` is NaN and `attrs["bands"]` has its limits. The source's disc broadens what is
narrower than itself (its solid angle is in the attributes); the receiver's is not stated, nor are uncertainties.
"""

import math
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import Format, fold, table
from gonio.formats.text import column_names, csv_table
from gonio.typing import DataFrame

SOURCE_RADIANCE = 3463.986
"""Radiance of the source in its band [W m^-2 sr^-1]."""
SOURCE_SOLID_ANGLE_SR = math.pi * (5.0 / 315.0) ** 2
BAND = {"name": "2-5.7 um", "lower_nm": 2000.0, "upper_nm": 5700.0}
_RADIANCE = "L_reflected_W_m-2_sr-1"


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in an infrared in-plane CSV; `DataError` says what is wrong with the file, and where."""
    cells = csv_table(data, path, ["theta_o_deg", "theta_i_deg", _RADIANCE])
    column = next((name for name in ("sample_en", "sample_de") if name in cells.header), None)
    if column is None:
        raise DataError(f"{path}, line 1: columns missing: sample_en or sample_de")
    names = cells.words(column)
    limits = {"theta_i_deg": 89.999, "theta_o_deg": 90.0}
    theta_i, theta_o = (cells.angles(*one, " lies outside +-90 degrees") for one in limits.items())
    brdf = cells.column(_RADIANCE, estimates=True) / (
        SOURCE_RADIANCE * np.cos(np.deg2rad(theta_i)) * SOURCE_SOLID_ANGLE_SR
    )
    theta_i, phi_i = fold(theta_i, 0.0)
    theta_r, phi_r = fold(theta_o, 180.0)
    several = list(dict.fromkeys(names))
    attrs = {
        "source_file": str(path),
        "source_solid_angle_sr": SOURCE_SOLID_ANGLE_SR,
        "bands": [dict(BAND)],
        "sample": None if len(several) > 1 else several[0],
        "notes": [
            "broad band (2 to 5.7 um): there is no single wavelength",
            "the file states no uncertainties and no solid angle of the receiver",
            "BRDF from radiance with 3463.986 W/m^2/sr for the source and its solid angle of 7.915e-4 sr",
            *cells.notes(),
        ],
    }
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=math.nan,
        brdf=brdf,
        sample=names if len(several) > 1 else None,
        attrs=attrs,
    )


FORMAT = Format(
    name="mwir-inplane",
    title="in-plane infrared radiance CSV",
    endings=(".csv",),
    sniff=lambda head: _RADIANCE in column_names(head),
    read=read,
)
