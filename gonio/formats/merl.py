"""MERL's binary BRDFs (Matusik et al. 2003): three colours of an isotropic BRDF in half and difference angles.

Three little-endian int32 (90, 90, 180: cells in theta_h, theta_d, phi_d), then the red, green and blue cubes as
float64, to be multiplied by 1/1500, 1.15/1500 and 1.66/1500 for 1/sr. A cell stands for its centre: theta_h is
90 ((i + 1/2)/90)^2 degrees (cells are narrow near the mirror), theta_d and phi_d are even over 90 and 180 degrees.
Cells in which either direction lies below the surface are dropped. MERL writes a negative value where it has no data:
it is flagged "not_measured". Each colour is a sample named "<file> red", "green", "blue"; their bands have no stated
limits.
There are neither uncertainties nor solid angles.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import DataError
from gonio.formats.reader import ANGLES, Format, table, wrap_deg, write_bytes
from gonio.spectra import RGB_NM
from gonio.typing import DataFrame, Floats

if TYPE_CHECKING:
    from gonio.models import Model

_SHAPE = (90, 90, 180)
_HEADER = struct.pack("<3i", *_SHAPE)
_CELLS = math.prod(_SHAPE)
_COLOURS = {"red": 1 / 1500, "green": 1.15 / 1500, "blue": 1.66 / 1500}


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a MERL file; `DataError` says what is wrong with the file, and where."""
    if data[:12] != _HEADER:
        shape = struct.unpack_from("<3i", data) if len(data) >= 12 else "cut"
        raise DataError(f"{path}, byte 0: the cells are {shape}, and a MERL file has {_SHAPE}")
    wanted = 12 + 3 * 8 * _CELLS
    if len(data) != wanted:
        raise DataError(
            f"{path}, byte {min(len(data), wanted)}: the file has {len(data)} bytes, and MERL's have {wanted}"
        )
    cubes = np.frombuffer(data, "<f8", offset=12).reshape(3, _CELLS)
    cell, angles = _directions()
    count = cell.size
    brdf = np.empty(3 * count)
    names = [f"{path.stem} {colour}" for colour in _COLOURS]
    for k, scale in enumerate(_COLOURS.values()):
        part = brdf[k * count : (k + 1) * count]
        np.take(cubes[k], cell, out=part, mode="clip")  # every cell is inside: with "raise" numpy copies the result
        if not np.isfinite(part).all():
            wrong = int(cell[np.flatnonzero(~np.isfinite(part))[0]])
            raise DataError(f"{path}, byte {12 + 8 * (k * _CELLS + wrong)}: the value is not finite")
        part *= scale
    missing = brdf < 0
    flags = np.array(["", "not_measured"], dtype=object)[missing.view(np.int8)]
    notes = ["broad bands without stated limits (red, green, blue); no uncertainties and no solid angles"]
    if missing.any():
        notes.append(f'{missing.sum()} of {missing.size} values are negative: flagged "not_measured"')
    theta_i, theta_r, dphi = (np.concatenate([column] * 3) for column in angles)
    del angles
    return table(
        theta_i_deg=theta_i,
        phi_i_deg=np.zeros(3 * count),
        theta_r_deg=theta_r,
        phi_r_deg=dphi,
        wavelength_nm=math.nan,
        brdf=brdf,
        flag=flags,
        sample=np.repeat(np.array(names, dtype=object), count),
        attrs={"source_file": str(path), "bands": [{"name": colour} for colour in _COLOURS], "notes": notes},
    )


def _directions() -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], tuple[Floats, Floats, Floats]]:
    """The cells whose directions lie above the surface, and theta_i, theta_r, dphi there [degrees].

    One theta_h after the other: all at once would take half a gigabyte.
    """
    theta_d, phi_d = np.pi / 2 * (np.arange(90)[:, np.newaxis] + 0.5) / 90, np.pi * (np.arange(180) + 0.5) / 180
    # Rusinkiewicz 1998: the half vector in the xz plane, the difference vector turned with it
    x, y = (np.sin(theta_d) * np.cos(phi_d)).ravel(), (np.sin(theta_d) * np.sin(phi_d)).ravel()
    z = np.repeat(np.cos(theta_d), 180)
    cells, found = [], []
    for i in range(90):
        theta_h = np.pi / 2 * ((i + 0.5) / 90) ** 2
        c, s = np.cos(theta_h), np.sin(theta_h)
        incident = np.stack([c * x + s * z, y, -s * x + c * z])
        half = np.array([[s], [0.0], [c]])
        outgoing = 2 * (incident * half).sum(axis=0) * half - incident
        above = np.flatnonzero((incident[2] > 1e-9) & (outgoing[2] > 1e-9))
        theta, phi = zip(*(_polar(v[:, above]) for v in (incident, outgoing)), strict=True)
        cells.append(i * z.size + above)
        found.append((theta[0], theta[1], wrap_deg(phi[1] - phi[0])))
    theta_i, theta_r, dphi = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return np.concatenate(cells), (theta_i, theta_r, dphi)


def _polar(v: Floats) -> tuple[Floats, Floats]:
    return np.rad2deg(np.arctan2(np.hypot(v[0], v[1]), v[2])), np.rad2deg(np.arctan2(v[1], v[0]))


def write(frame: DataFrame, path: Path) -> None:
    """A table that holds every cell of the three colours, in this reader's order; -1 where one is flagged."""
    cell, angles = _directions()
    names = frame["sample"].unique().tolist() if "sample" in frame.columns else []
    colours = [str(name).rpartition(" ")[2] for name in names]
    if colours != list(_COLOURS) or len(frame) != 3 * cell.size or (frame["polarisation"] != "unpolarised").any():
        raise DataError(
            f"{path}: a MERL file needs samples named red, green and blue, each with its {cell.size} directions"
        )
    cubes = np.full((3, _CELLS), -1.0)
    for k, (cube, scale) in enumerate(zip(cubes, _COLOURS.values(), strict=True)):
        part = frame.iloc[k * cell.size : (k + 1) * cell.size]
        columns = zip(ANGLES, (angles[0], np.zeros(cell.size), angles[1], angles[2]), strict=True)
        if not all(np.allclose(part[name].to_numpy(np.float64), a, rtol=0, atol=1e-6) for name, a in columns):
            raise DataError(f"{path}: the directions of {names[k]} are not the cells of a MERL file, in their order")
        cube[cell] = np.where(part["flag"].to_numpy() == "", part["brdf"].to_numpy(np.float64) / scale, -1.0)
    write_bytes(path, _HEADER + cubes.astype("<f8").tobytes())


def write_model(model: Model, name: str, path: Path) -> None:
    """The model's values at the centres of the cells, at one wavelength a colour."""
    cell, angles = _directions()
    cubes = np.full((3, _CELLS), -1.0)
    for cube, (colour, scale) in zip(cubes, _COLOURS.items(), strict=True):
        theta_i, theta_r, dphi = map(np.deg2rad, angles)
        cube[cell] = model.brdf(theta_i, 0.0, theta_r, dphi, wavelength_nm=RGB_NM[colour]) / scale
    write_bytes(path, _HEADER + cubes.astype("<f8").tobytes())


FORMAT = Format(
    name="merl",
    title="MERL binary",
    endings=(".binary",),
    sniff=lambda head: head.startswith(_HEADER),
    read=read,
    write=write,
    write_model=write_model,
    carries=frozenset({"flag"}),
)
