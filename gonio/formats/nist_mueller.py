"""NIST's Mueller-matrix BRDF tables (Germer, sintered PTFE): a CSV with one row a direction and wavelength.

Columns: `lambda` [um], `thetai, phi (or phii), thetar, phir` [degrees], `f_r11` (or `fr11`) [1/sr], and 15 ratios of
the Mueller matrix to its first element in a basis fixed to the sample's x and y. `f_r11` is the BRDF for unpolarised
light. The polar angle of incidence is negative in NIST's files, which puts the source at azimuth phi + 180, so that
phir = 0 is the mirror half-plane. Uncertainties and solid angles are not in the file.

The ratios refer to axes that are carried from the sample's x and y to each ray, and to SCATMECH's Stokes vectors: the
axes are s and p of the plane of propagation turned back by its azimuth psi, so that M_sp = R(psi_r) M_xy R(psi_i) with
R the rotation of (Q, U) by 2 psi; and s, p and the ray are right-handed there, left-handed with us, so that U and V
change their signs. Table columns m01 to m33 have the project's own frame (docs/conventions.md).
"""

from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import MUELLER, Format, fold, one_value_a_direction, table
from gonio.formats.text import column_names, csv_table
from gonio.typing import DataFrame, Floats


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in one of NIST's Mueller CSVs; `DataError` says what is wrong with the file, and where."""
    names = set(column_names(data[:4096]))
    value = "fr11" if "fr11" in names else "f_r11"
    azimuth = "phii" if "phii" in names else "phi"
    cells = csv_table(data, path, ["lambda", "thetai", azimuth, "thetar", "phir", value])
    um = cells.column("lambda")
    for row in np.flatnonzero(~((um > 0) & (um < 1000)))[:1]:
        raise DataError(f"{cells.where(int(row))}: lambda = {um[row]:g}; a wavelength in micrometres is needed")
    in_deg = {"thetai": azimuth, "thetar": "phir"}
    beyond = "; a polar angle in +-90 degrees is needed"
    pairs = [(cells.angles(theta, 90.0, beyond), cells.column(phi)) for theta, phi in in_deg.items()]
    stated = [angle for pair in pairs for angle in pair]
    (theta_i, phi_i), (theta_r, phi_r) = fold(*stated[:2]), fold(*stated[2:])
    mueller, told = None, "the file lacks some of the 15 Mueller ratios: none are read"
    if named := _ratios(names):
        matrices = np.ones((um.size, 4, 4))
        for (i, j), name in named.items():
            matrices[:, i, j] = cells.column(name, estimates=True)
        turned = in_sp(matrices, cells.column(azimuth), cells.column("phir"))
        mueller = {name: turned[:, int(name[1]), int(name[2])] for name in MUELLER}
        told = "the Mueller ratios (m01 to m33) are turned from the file's xy basis to s and p"
    notes = [
        "the file states no uncertainties and no solid angles",
        "the BRDF is f_r11, for unpolarised light",
        told,
        *cells.notes(),
    ]
    frame = table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=np.round(um * 1000.0, 9),
        brdf=cells.column(value, estimates=True),
        mueller=mueller,
        attrs={"source_file": str(path), "sample": path.stem, "notes": notes},
    )
    return one_value_a_direction(frame, np.column_stack(stated), path)


def _ratios(names: set[str]) -> dict[tuple[int, int], str] | None:
    """The names of the 15 ratios in a file, by row and column from 0; None where one is missing."""
    spelt = ("m{}", "fr{}/fr11", "f_r{}/f_r11")  # the last that is there counts
    places = [(i, j) for i in range(4) for j in range(4) if i or j]
    known = {(i, j): [text.format(f"{i + 1}{j + 1}") for text in spelt] for i, j in places}
    found = {place: name for place, several in known.items() for name in several if name in names}
    return found if len(found) == len(places) else None


def in_sp(matrices: Floats, phi_i_deg: Floats, phi_r_deg: Floats) -> Floats:
    """Mueller matrices (n, 4, 4) on the xy bases of NIST's files as they are on s and p of docs/conventions.md.

    The azimuths [degrees] are those in which the light travels.
    """
    sign = np.array([1.0, 1.0, -1.0, -1.0])
    turned = _rotation(np.deg2rad(phi_r_deg)) @ matrices @ _rotation(np.deg2rad(phi_i_deg))
    return np.asarray(sign[:, None] * turned * sign)


def _rotation(psi: Floats) -> Floats:
    """Mueller matrices of a turn of the axes by psi."""
    out = np.zeros((psi.size, 4, 4))
    out[:, 0, 0] = out[:, 3, 3] = 1.0
    out[:, 1, 1] = out[:, 2, 2] = np.cos(2 * psi)
    out[:, 1, 2] = np.sin(2 * psi)
    out[:, 2, 1] = -out[:, 1, 2]
    return out


def _sniff(head: bytes) -> bool:
    names = set(column_names(head))
    return {"lambda", "thetai", "thetar"} <= names and not names.isdisjoint(("f_r11", "fr11"))


FORMAT = Format(name="nist-mueller", title="NIST Mueller-matrix CSV", endings=(".csv",), sniff=_sniff, read=read)
