"""OpenMATERIAL 3D (ASAM): the BRDF look-up table of a material, a JSON document `.xompt`.

A row of `brdf.lookupTable` is wavelength [m], polar angles of incidence and of exit, azimuth of exit [radians], and the
BRDF [1/sr]. The azimuth is counted from the direction of incidence, so that pi is the mirror half-plane (issue 436 of
asam-ev/OpenMATERIAL-3D) and dphi is ours; the azimuth of incidence is 0. A value `null` is a hole. Angles of six
decimals are read as the degrees that they stand for.

The quantity is the BRDF, as the schema says: `brdf` of 1/pi is a perfect white. Issue 236 there is about values that
were measured against a white standard, which are reflectance factors unless somebody divided them by pi; no field says
which they are, and a note does. `receiverSolidAngles` (issue 450) is the receiver's solid angle where it is one for all
wavelengths. Reflection coefficients, which are for radar, are not read.

Written are isotropic tables alone, with each row's wavelength. What the schema demands and nobody has stated is
"unknown". Flagged rows are left out; values below zero, which the schema forbids, are refused.
Tried on the schema and the two tables of asphalt in that repository.
"""

import json
import math
import uuid
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import DataError
from gonio.formats import json_text
from gonio.formats.json_text import finite, short
from gonio.formats.reader import (
    Format,
    fold,
    get,
    laboratory_of,
    one_value_a_direction,
    plain_degrees,
    single,
    table,
    whole_turns,
    wrap_deg,
    write_bytes,
)
from gonio.typing import DataFrame, Floats, JsonObject

_SCHEMA = "https://raw.githubusercontent.com/asam-ev/OpenMATERIAL-3D/refs/tags/v1.0.0/schemas/material_brdf_schema.json"
_COLUMNS = ("wavelength [m]", "incident zenith angle", "exit zenith angle", "exit azimuth [radians]", "BRDF [1/sr]")
_MOST = 0.0, math.pi / 2, math.pi / 2, 2 * math.pi
_HORIZON, _TURN = 1.570796, 6.283185
"""The largest angles that the schema allows [radians]: 90 degrees, and 360."""
_SHORT_NM, _LONG_NM = 100.0, 200_000.0


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in an OpenMATERIAL BRDF; `DataError` says what is wrong with the file, and where."""
    content = json_text.load(data, path, "an OpenMATERIAL file")
    section = content.get("brdf")
    if not isinstance(section, dict):
        keys = ", ".join(short(key) for key in list(content)[:6])
        raise DataError(
            f'{path}: has no object "brdf"; of OpenMATERIAL files those with a BRDF are read (keys: {keys})'
        )
    rows = _rows(section.get("lookupTable"), path)
    nm = np.round(rows[:, 0] * 1e9, 9)
    for row in np.flatnonzero(~((nm >= _SHORT_NM) & (nm <= _LONG_NM)))[:1]:
        raise DataError(
            f"{path}: brdf.lookupTable[{row}][0] = {rows[row, 0]:g}, a wavelength in metres is needed, as 5.5e-07"
        )
    stated = np.column_stack([_degrees(rows[:, k]) for k in (1, 2, 3)])
    stated[:, :2] = np.where(rows[:, 1:3] >= _HORIZON, 90.0, stated[:, :2])
    stated[:, 2] = whole_turns(stated[:, 2])
    notes = [
        "values are taken as the BRDF in 1/sr, as the schema says; where they were measured against a white standard "
        "and not divided by pi they are reflectance factors, pi times as large, and the file does not say so",
        "the file states no uncertainties",
    ]
    metadata = given if isinstance(given := content.get("metadata"), dict) else {}
    name = metadata.get("name")
    theta_r, phi_r = fold(stated[:, 1], stated[:, 2], slack_deg=0.001)
    frame = table(
        theta_i_deg=np.minimum(stated[:, 0], 90.0),
        phi_i_deg=0.0,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=nm,
        brdf=rows[:, 4],
        attrs={
            "source_file": str(path),
            "sample": name if isinstance(name, str) else None,
            "receiver_solid_angle_sr": _solid_angle(section, path, notes),
            "provenance": {"openmaterial": metadata},
            "notes": notes,
        },
    )
    return one_value_a_direction(frame, np.column_stack([stated[:, 0], 0.0 * nm, stated[:, 1:]]), path)


def _rows(stated: Any, path: Path) -> Floats:
    """The look-up table, shape (n, 5); NaN for a value that is null."""
    if not isinstance(stated, list) or not stated:
        raise DataError(f"{path}: brdf.lookupTable is {short(stated)}; an array of rows is needed")
    rows = np.empty((len(stated), 5))
    for k, row in enumerate(stated):
        where = f"{path}: brdf.lookupTable[{k}]"
        if not isinstance(row, list) or len(row) != 5:
            found = f"has {len(row)} numbers" if isinstance(row, list) else f"is {short(row)}"
            raise DataError(f"{where} {found}; five are needed: {', '.join(_COLUMNS)}")
        rows[k] = [finite(v, f"{where}[{j}]") for j, v in enumerate(row[:4])] + [
            math.nan if row[4] is None else finite(row[4], f"{where}[4]")
        ]
        for j, most in enumerate(_MOST[1:], start=1):
            if not (-most if j == 2 else 0.0) - 1e-3 <= rows[k, j] <= most + 1e-3:
                raise DataError(f"{where}[{j}] = {rows[k, j]:g}: {_COLUMNS[j]} in radians is at most {most:.6f}")
    return rows


def _degrees(radians: Floats) -> Floats:
    """Angles of a column in degrees; its numbers have as many decimals as the longest of them."""
    unique, inverse = np.unique(radians, return_inverse=True)
    decimals = max(len(np.format_float_positional(angle).partition(".")[2]) for angle in unique)
    return plain_degrees(unique, min(decimals, 16))[inverse.ravel()]


def _solid_angle(section: JsonObject, path: Path, notes: list[str]) -> float | None:
    """The receiver's solid angle [sr], where one is stated for all wavelengths."""
    stated = section.get("receiverSolidAngles") or []
    if not isinstance(stated, list) or not all(isinstance(pair, dict) for pair in stated):
        raise DataError(f"{path}: brdf.receiverSolidAngles is {short(stated)}; an array of objects is needed")
    found = {
        finite(pair.get("solidAngle"), f"{path}: brdf.receiverSolidAngles[{k}].solidAngle")
        for k, pair in enumerate(stated)
    }
    if len(found) == 1 and 0 < next(iter(found)) <= 12.57:
        return found.pop()
    notes.append("the file states no solid angle" if not found else "the receiver's solid angles differ: left out")
    return None


def write(frame: DataFrame, path: Path) -> None:
    """An isotropic table: wavelength, polar angles and relative azimuth of each row that is not flagged."""
    single(frame, path, "an OpenMATERIAL BRDF")
    usable = frame[frame["flag"] == ""]
    nm = usable["wavelength_nm"].to_numpy(np.float64)
    values = usable["brdf"].to_numpy(np.float64)
    if usable.empty or np.isnan(nm).any():
        raise DataError(f"{path}: an OpenMATERIAL BRDF needs rows that are not flagged, and a wavelength in each")
    if usable["phi_i_deg"][usable["theta_i_deg"] > 0].nunique() > 1:
        raise DataError(
            f"{path}: an OpenMATERIAL BRDF has relative azimuths alone, and this table several azimuths of incidence"
        )
    if below := int((values < 0).sum()):
        raise DataError(f"{path}: {below} values are below zero, which the schema forbids; leave those rows out")
    dphi = wrap_deg(usable["phi_r_deg"].to_numpy() - usable["phi_i_deg"].to_numpy())
    polar = [
        np.minimum(np.deg2rad(usable[name].to_numpy(np.float64)), _HORIZON) for name in ("theta_i_deg", "theta_r_deg")
    ]
    rows = np.column_stack([nm * 1e-9, *polar, np.minimum(np.deg2rad(dphi), _TURN), values])
    rows = np.unique(rows, axis=0)  # sorted by its columns, as the schema asks
    if (np.diff(rows[:, :4], axis=0) == 0).all(axis=1).any():
        raise DataError(
            f"{path}: an OpenMATERIAL BRDF has one value for a direction, and this table several; average them"
        )
    section: dict[str, Any] = {"wavelengths": np.unique(rows[:, 0]).tolist()}
    if solid_angle := frame.attrs.get("receiver_solid_angle_sr"):
        section["receiverSolidAngles"] = [
            {"wavelength": metres, "solidAngle": solid_angle} for metres in section["wavelengths"]
        ]
    section["lookupTable"] = rows.tolist()
    content = {"$schema": _SCHEMA, "metadata": _metadata(frame, rows), "brdf": section}
    write_bytes(path, (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode())


def _metadata(frame: DataFrame, rows: Floats) -> JsonObject:
    laboratory = laboratory_of(frame) or {}
    owner = get(laboratory, "rights_holder") or get(laboratory, "organisation") or "unknown"
    return {
        "name": str(frame.attrs.get("sample") or "unknown"),
        "description": str(get(laboratory, "description") or "BRDF measured with a goniometer"),
        "uuid": str(uuid.uuid5(uuid.NAMESPACE_OID, rows.tobytes().hex())),
        "materialVersion": "1.0.0",
        "openMaterial3dVersion": "1.0.0",
        "copyrights": [str(owner)],
        "license": str(get(laboratory, "license") or "unknown"),
        "authors": [str(get(laboratory, "operator") or owner)],
        "sources": "measurement",
    }


def remarks(frame: DataFrame) -> list[str]:
    """What stands as "unknown" in the file, and how to state it."""
    laboratory = laboratory_of(frame) or {}
    lacking = [key for key in ("organisation", "license", "operator") if not get(laboratory, key)]
    return [f'nobody has stated laboratory.{", laboratory.".join(lacking)}: "unknown" in the file'] if lacking else []


FORMAT = Format(
    name="openmaterial",
    title="OpenMATERIAL BRDF",
    endings=(".xompt",),
    sniff=lambda head: head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{" and b'"lookupTable"' in head,
    read=read,
    write=write,
    remarks=remarks,
    max_bytes=64 * 2**20,
    carries=frozenset({"solid angle"}),
)
