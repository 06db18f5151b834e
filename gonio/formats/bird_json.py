"""BiRD universal BRDF data format 1.0: one JSON object with `metadata` and `data` (draft of the EMPIR project BiRD).

Every variable is a column of numbers with its unit: angles in degrees or radians, azimuths in [0, 360) from the
direction that the sample's metadata name, wavelengths in nm or um, `BRDF` and `uBRDF` in 1/sr (the latter also in %).
Polarisation is s, p or u, or a Stokes vector, in the planes of incidence and of reflection: [1, 1, 0, 0] is s. The
receiver's solid angle is taken from the detection system. The format does not say whether an uncertainty is expanded;
it is read as a standard uncertainty. What it has no variable for (flags, `u_random`, `s_` columns, negative estimates)
is written as ad-hoc variables of the same names, which other readers pass over and this one restores.
"""

import math
import re
from pathlib import Path
from typing import Any, cast

import numpy as np

from gonio.errors import DataError
from gonio.formats import json_text
from gonio.formats._bird_writer import _STATES, _Variable, write
from gonio.formats.json_text import finite, short
from gonio.formats.native import checked_attributes
from gonio.formats.reader import Format, fold, get, laboratory_of, one_value_a_direction, table
from gonio.typing import DataFrame, Floats, JsonObject

_STOKES = {(1.0, 1.0, 0.0, 0.0): "s", (1.0, -1.0, 0.0, 0.0): "p", (1.0, 0.0, 0.0, 0.0): "u"}
_OURS = re.compile(r"brdf|u_brdf|u_random|flag|sample|s_\w{1,60}")


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in BiRD JSON; `DataError` says what is wrong with the file, and where."""
    content = json_text.load(data, path, "a BiRD file")
    section = content.get("data")
    if not isinstance(section, dict):
        keys = ", ".join(short(key) for key in list(content)[:6])
        raise DataError(
            f'{path}: is JSON, and not of BiRD, which has an object "data" with a variable "BRDF"; its keys are '
            f"{keys}. Tables of one's own are read as CSV, with --columns"
        )
    file = _Section(section, path)
    brdf = file.numbers("BRDF", {"1/sr": 1.0, "sr^-1": 1.0})
    count = brdf.size
    angles = {name: file.angles(name, count) for name in ("theta_i", "phi_i", "theta_r", "phi_r")}
    theta_i, phi_i = fold(angles["theta_i"], angles["phi_i"], slack_deg=0.001)
    theta_r, phi_r = fold(angles["theta_r"], angles["phi_r"], slack_deg=0.001)
    units = {"nm": 1.0, "μm": 1000.0}
    stated = [file.numbers(name, units, count) for name in ("wavelength_i", "wavelength_r") if name in section]
    if stated and not np.array_equal(stated[0], stated[-1]):
        raise DataError(f"{path}: data.wavelength_r differs from data.wavelength_i; fluorescence is not a BRDF")
    notes = [] if stated else ["the file states no wavelength"]
    u_brdf = _uncertainty(file, brdf)
    notes.append(
        "the file states no uncertainties"
        if np.isnan(u_brdf).all()
        else "uncertainties are taken as standard uncertainties; the format does not state a coverage factor"
    )
    columns, others = file.adhoc(count)
    if others:
        notes.append(f"further variables of the file are not carried: {', '.join(others)}")
    metadata = given if isinstance(given := content.get("metadata"), dict) else {}
    sample = get(metadata, "sample.name")
    frame = table(
        theta_i_deg=theta_i,
        phi_i_deg=phi_i,
        theta_r_deg=theta_r,
        phi_r_deg=phi_r,
        wavelength_nm=stated[0] if stated else math.nan,
        brdf=columns.get("brdf", brdf),
        u_brdf=columns.get("u_brdf", u_brdf),
        u_random=columns.get("u_random", math.nan),
        polarisation=file.polarisation(count),
        flag=columns.get("flag", ""),
        sample=columns.get("sample"),
        attrs={
            "source_file": str(path),
            "sample": sample if isinstance(sample, str) else None,
            "receiver_solid_angle_sr": _solid_angle(metadata),
            "provenance": {"bird": metadata},
            "notes": notes,
        },
    )
    for name in columns:
        if name.startswith("s_"):
            frame.insert(len(frame.columns) - 1, name, columns[name])
    frame = one_value_a_direction(frame, np.column_stack(list(angles.values())), path)
    if isinstance(own := get(metadata, "adhoc_section.gonio"), dict):
        frame.attrs.update(checked_attributes(own | {"source_file": str(path)}, f"{path}: metadata.adhoc_section"))
    return frame


class _Section:
    """The object `data` of a file, whose messages name the variable and the index."""

    def __init__(self, section: JsonObject, path: Path) -> None:
        self.section = section
        self.path = path

    def numbers(self, name: str, units: dict[str, float], count: int | None = None) -> Floats:
        variable = self._variable(name)
        unit = variable.get("unit")
        if not isinstance(unit, str) or unit not in units:
            raise DataError(f"{self.path}: data.{name}.unit is {short(unit)}; one of {', '.join(units)} is needed")
        values = self._values(name, variable, count)
        return units[unit] * np.array(
            [finite(v, f"{self.path}: data.{name}.values[{k}]") for k, v in enumerate(values)]
        )

    def angles(self, name: str, count: int) -> Floats:
        degrees = self.numbers(name, {"deg": 1.0, "°": 1.0, "rad": 180.0 / math.pi}, count)
        limit = 90.001 if name.startswith("theta") else 360.0
        for k in np.flatnonzero((degrees < 0) | (degrees > limit))[:1]:
            allowed = f"[0, {limit:.0f}] degrees"
            raise DataError(f"{self.path}: data.{name}.values[{k}] is {degrees[k]:g} degrees; {allowed} is allowed")
        return degrees

    def polarisation(self, count: int) -> list[str]:
        sides = []
        for name in ("polarization_i", "polarization_r"):
            values = self._values(name, self._variable(name), count) if name in self.section else ["u"] * count
            sides.append([self._state(value, f"{name}.values[{k}]") for k, value in enumerate(values)])
        pairs = [incident + reflected for incident, reflected in zip(*sides, strict=True)]
        for k, pair in enumerate(pairs):
            if pair not in _STATES:
                raise DataError(
                    f"{self.path}: row {k}: unpolarised light seen through a polariser is not in the table's terms"
                )
        return [_STATES[pair] for pair in pairs]

    def adhoc(self, count: int) -> tuple[dict[str, Floats | list[Any]], list[str]]:
        """The columns that we have written there ourselves, and the names of all other ad-hoc variables."""
        variables = self.section.get("adhoc_variables", {})
        if not isinstance(variables, dict):
            raise DataError(f"{self.path}: data.adhoc_variables is {short(variables)}; an object is needed")
        ours: dict[str, Floats | list[Any]] = {}
        for name, variable in variables.items():
            if _OURS.fullmatch(name) and isinstance(variable, dict):
                where = f"adhoc_variables.{name}"
                ours[name] = values = self._values(where, cast(_Variable, variable), count)
                if name not in ("flag", "sample"):
                    where = f"{self.path}: data.{where}.values"
                    ours[name] = np.array(
                        [math.nan if v is None else finite(v, f"{where}[{k}]") for k, v in enumerate(values)]
                    )
        return ours, [name[:40] for name in variables if name not in ours]

    def _state(self, value: Any, where: str) -> str:
        if isinstance(value, str) and value in ("s", "p", "u"):
            return value
        if isinstance(value, list) and len(value) == 4:
            stokes = tuple(finite(v, f"{self.path}: data.{where}") for v in value)
            if stokes in _STOKES:
                return _STOKES[stokes]
        raise DataError(f"{self.path}: data.{where} is {short(value)}; the table knows s, p and unpolarised light")

    def _variable(self, name: str) -> _Variable:
        variable = self.section.get(name)
        if not isinstance(variable, dict):
            raise DataError(f'{self.path}: data has no variable "{name}"')
        return cast(_Variable, variable)

    def _values(self, name: str, variable: _Variable, count: int | None) -> list[Any]:
        values = variable.get("values")
        if not isinstance(values, list) or not values:
            raise DataError(f"{self.path}: data.{name}.values is {short(values)}; an array of values is needed")
        if count is not None and len(values) != count:
            raise DataError(
                f"{self.path}: data.{name}.values has {len(values)} entries, and data.BRDF.values has {count}"
            )
        return values


def _uncertainty(file: _Section, brdf: Floats) -> Floats:
    """Standard uncertainty of each value: `uBRDF`, or else the one number beside `BRDF`, or else NaN."""
    if "uBRDF" in file.section:
        relative = file.section["uBRDF"].get("unit") == "%" if isinstance(file.section["uBRDF"], dict) else False
        u = file.numbers("uBRDF", {"1/sr": 1.0, "sr^-1": 1.0, "%": 0.01}, brdf.size)
        return u * np.abs(brdf) if relative else u
    stated = file.section["BRDF"].get("uncertainty")
    if stated is None:
        return np.full(brdf.size, np.nan)
    if not isinstance(stated, dict) or stated.get("unit") not in ("1/sr", "sr^-1", "%"):
        raise DataError(f"{file.path}: data.BRDF.uncertainty is {short(stated)}; a value and a unit are needed")
    value = finite(stated.get("value"), f"{file.path}: data.BRDF.uncertainty.value")
    return 0.01 * value * np.abs(brdf) if stated["unit"] == "%" else np.full(brdf.size, value)


def _solid_angle(metadata: JsonObject) -> float | None:
    value = get(metadata, "instrumentation.detection_system.solid_angle.value")
    known = isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 12.57
    return float(value) if known and value is not None else None


def remarks(frame: DataFrame) -> list[str]:
    """What stands as "unknown" in the file of a run of ours, and how to state it."""
    provenance = frame.attrs.get("provenance") or {}
    if "reduced_by" not in provenance or "bird" in provenance or laboratory_of(frame) is not None:
        return []
    return [
        'organisation, address, contact and the sample\'s type, shape and size stand as "unknown" in the file: nobody '
        "has stated them; a table [laboratory] in the plan or the rig file does (docs/interchange.md)"
    ]


FORMAT = Format(
    name="bird",
    title="BiRD universal BRDF JSON",
    endings=(".brdf", ".json"),
    sniff=lambda head: (
        head.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"{"
        and (b'"theta_i"' in head or (b'"metadata"' in head and re.search(rb'"data"\s*:\s*\{', head) is not None))
    ),
    read=read,
    write=write,
    remarks=remarks,
    max_bytes=64 * 2**20,
    carries=frozenset({"uncertainty", "flag", "solid angle"}),
)
