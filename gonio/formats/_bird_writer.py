"""Writes BiRD JSON."""

import json
import math
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from gonio import __version__
from gonio.errors import DataError
from gonio.formats.reader import ANGLES, Need, get, laboratory_of, require, write_bytes
from gonio.typing import DataFrame, JsonObject

_SCHEMA = "https://raw.githubusercontent.com/BiRD-project/BiRD_view/master/BRDF_JSON_schema/brdf_json_schema_v1.0.json"
_STATES = {"uu": "unpolarised", "su": "s", "pu": "p"} | {pair: pair for pair in ("ss", "sp", "ps", "pp")}


class _Variable(TypedDict, total=False):
    """One variable of a file; what is read is of any type until it is looked at."""

    description: object
    unit: object
    type: object
    notation: object
    values: object


def write(frame: DataFrame, path: Path) -> None:
    """Everything that the table holds; metadata that the schema demands and nobody knows are "unknown"."""
    for column in ("theta_i_deg", "theta_r_deg"):
        if (frame[column] >= 90).any():
            raise DataError(f"{path}: {column} = 90; BiRD's schema takes polar angles below 90 degrees")
    data: dict[str, _Variable | dict[str, _Variable]] = {
        name.removesuffix("_deg"): {"unit": "deg", "values": frame[name].tolist()} for name in ANGLES
    }
    wavelength = frame["wavelength_nm"]
    if wavelength.notna().all():
        data["wavelength_i"] = {"unit": "nm", "values": wavelength.tolist()}
    elif wavelength.notna().any():
        raise DataError(f"{path}: a BiRD file states a wavelength for every row or for none")
    if (frame["polarisation"] != "unpolarised").any():
        pairs = {state: pair for pair, state in _STATES.items()}
        for side, name in enumerate(("polarization_i", "polarization_r")):
            values = [pairs[state][side] for state in frame["polarisation"]]
            data[name] = {"notation": "sp", "values": values}
    adhoc: dict[str, _Variable] = {}

    def keep(name: str, description: str, kind: str = "number", unit: str = "1/sr") -> None:
        values = [None if isinstance(v, float) and not math.isfinite(v) else v for v in frame[name].tolist()]
        adhoc[name] = {"description": description, "unit": unit, "type": kind, "values": values}

    brdf, u_brdf = frame["brdf"].to_numpy(np.float64), frame["u_brdf"].to_numpy(np.float64)
    data["BRDF"] = {"unit": "1/sr", "values": np.maximum(np.nan_to_num(brdf, nan=0.0, posinf=0.0), 0.0).tolist()}
    if not (brdf >= 0).all():
        keep("brdf", "The estimates with their sign; BRDF holds zero where one is negative or missing.")
    if np.isfinite(u_brdf).any():
        data["uBRDF"] = {"unit": "1/sr", "values": np.nan_to_num(u_brdf).tolist()}
        if not np.isfinite(u_brdf).all():
            keep("u_brdf", "Combined standard uncertainty; null where it is unknown.")
    if frame["u_random"].notna().any():
        keep("u_random", "The part of the standard uncertainty that is independent from row to row.")
    for name in frame.columns:
        if name.startswith("s_"):
            keep(name, f"Change of BRDF for one standard deviation of the common cause {name.removeprefix('s_')}.")
    if (frame["flag"] != "").any():
        keep("flag", "Why a row must not be used; empty where it may be.", "string", "")
    if "sample" in frame.columns:
        keep("sample", "The sample that a row belongs to.", "string", "")
    if adhoc:
        data["adhoc_variables"] = adhoc
    content = {"metadata": _metadata(frame, path), "data": data}
    try:
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise DataError(f"{path}: an attribute of the table cannot be written as JSON: {error}") from None
    write_bytes(path, text.encode() + b"\n")


def _metadata(frame: DataFrame, path: Path) -> JsonObject:
    attrs = frame.attrs
    provenance = attrs.get("provenance") or {}
    attributes = {key: value for key, value in attrs.items() if key not in ("provenance", "source_file")}
    attributes["provenance"] = {key: value for key, value in provenance.items() if key != "bird"}
    given = provenance.get("bird")
    if isinstance(given, dict) and given:
        section = given.get("adhoc_section")
        return given | {"adhoc_section": (section if isinstance(section, dict) else {}) | {"gonio": attributes}}
    values = frame["brdf"].to_numpy(np.float64).tobytes().hex()
    out = {
        "schema": _SCHEMA,
        "id": f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_OID, values)}",
        "type": "BRDF",
        "method": "simulation" if _is_simulated(provenance) else "measurement",
        "software": {"name": "gonio", "version": __version__},
        "adhoc_section": {"gonio": attributes},
    }
    stated = laboratory_of(frame)
    return out | (_unstated(frame) if stated is None else _stated(frame, stated, path))


def _is_simulated(provenance: Mapping[str, Any]) -> bool:
    told = provenance.get("simulated")
    return told if isinstance(told, bool) else str(provenance.get("rig", "")).startswith("sim")


def _unstated(frame: DataFrame) -> JsonObject:
    """What the schema requires, of a table of which nobody has said whose it is."""
    attrs, unknown = frame.attrs, "unknown"
    provenance = attrs.get("provenance") or {}
    return {
        "timestamp": datetime.now(UTC).isoformat(timespec="seconds"),
        "provenance": {
            "organization": str(provenance.get("organization", unknown)),
            "location": dict.fromkeys(("country", "city", "street", "building_nr", "postal_code"), unknown),
            "email": "unknown@unknown.invalid",
            "contact_person": unknown,
        },
        "description": f"BRDF of {attrs.get('sample') or 'a sample'}",
        "instrumentation": "NA",
        "sample": {
            "name": str(attrs.get("sample") or unknown),
            "type": unknown,
            "shape": unknown,
            "dimensions": {},
            "zero_azimuth_location": "the sample's x axis",
        },
        "environment": "NA",
    }


_SIZES = ("diameter_mm", "length_mm", "width_mm", "height_mm", "thickness_mm")
_NEEDED: tuple[Need, ...] = (
    "organisation", "contact", "email",
    "address.country", "address.city", "address.street", "address.building", "address.postal_code",
    "sample.type", "sample.shape", tuple(f"sample.{key}" for key in _SIZES), "sample.zero_azimuth",
)  # fmt: skip
_NEEDED_OF_A_MEASUREMENT: tuple[Need, ...] = (
    "temperature_c",
    "instrument.lamp", "instrument.lamp_type", "instrument.lamp_power_w", "instrument.lamp_range_nm",
    "instrument.beam_diameter_mm", "instrument.camera", "instrument.camera_range_nm",
)  # fmt: skip


def _stated(frame: DataFrame, stated: JsonObject, path: Path) -> JsonObject:
    """The same from `[laboratory]`; `ConfigError` names every key that is missing."""
    attrs = frame.attrs
    simulated = _is_simulated(attrs["provenance"])
    named = attrs.get("sample")
    needed: list[Need] = [
        *_NEEDED,
        *([] if named else ["sample.name"]),
        *([] if simulated else _NEEDED_OF_A_MEASUREMENT),
    ]
    require(stated, needed, "BiRD JSON", path)

    of = partial(get, stated)
    address = _there(
        country=of("address.country"),
        county=of("address.county"),
        city=of("address.city"),
        street=of("address.street"),
        building_nr=of("address.building"),
        room_nr=of("address.room"),
        postal_code=of("address.postal_code"),
    )
    sample = _there(
        name=of("sample.name") or named,
        type=of("sample.type"),
        shape=of("sample.shape"),
        dimensions={key.removesuffix("_mm"): _mm(of(f"sample.{key}")) for key in _SIZES if of(f"sample.{key}")},
        zero_azimuth_location=of("sample.zero_azimuth"),
        manufacturer=of("sample.manufacturer"),
        treatment=of("sample.treatment"),
    )
    if of("sample.material"):
        sample["materials"] = [{"name": of("sample.material")}]
    out = {
        "timestamp": str(of("measured") or datetime.now(UTC).isoformat(timespec="seconds")),
        "provenance": _there(
            organization=of("organisation"),
            location=address,
            website=of("website"),
            email=of("email"),
            contact_person=of("contact"),
        ),
        "description": of("description") or f"BRDF of {sample['name']}",
        "instrumentation": "NA" if simulated else _instrumentation(frame, stated),
        "sample": sample,
        "environment": _environment(stated),
    }
    if of("license") and of("rights_holder"):
        out["license"] = _there(type=of("license"), link=of("license_link"), rights_holder=of("rights_holder"))
    return out


def _there(**values: Any) -> JsonObject:
    """What is stated of some values."""
    return {key: value for key, value in values.items() if value is not None}


def _mm(value: float) -> JsonObject:
    return {"value": value, "unit": "mm"}


def _instrumentation(frame: DataFrame, stated: JsonObject) -> JsonObject:
    attrs, instrument = frame.attrs, stated["instrument"]
    lit, seen = (
        {"min_value": instrument[key][0], "max_value": instrument[key][1], "unit": "nm"}
        for key in ("lamp_range_nm", "camera_range_nm")
    )
    diameter = instrument["beam_diameter_mm"]
    area = {"value": math.pi / 4.0 * diameter**2, "unit": "mm^2"}
    out = {
        "name": str(attrs["provenance"]["rig"]),
        "illumination_system": {
            "name": instrument["lamp"],
            "source": {
                "name": instrument["lamp"],
                "type": instrument["lamp_type"],
                "power": {"value": instrument["lamp_power_w"], "unit": "W"},
                "wl_range": lit,
            },
            "beam": {"shape": "circular", "dimensions": {"diameter": _mm(diameter), "area": area}},
        },
        "detection_system": {
            "name": instrument["camera"],
            "sensors": [{"name": instrument["camera"], "spectral_response_range": seen}],
            "solid_angle": {"value": attrs["receiver_solid_angle_sr"], "unit": "sr"},
        },
    }
    more = {name: instrument.get(name) for name in ("manufacturer", "serial_number")}
    more["operator_name"] = stated.get("operator")
    return out | _there(**more)


def _environment(stated: JsonObject) -> JsonObject | str:
    if "temperature_c" not in stated:
        return "NA"
    u = {"uncertainty": stated.get("u_temperature_c"), "uncertainty_unit": "°C"}
    temperature = {"value": stated["temperature_c"], "unit": "°C"} | (u if "u_temperature_c" in stated else {})
    humidity = {"relative_humidity": {"value": stated.get("relative_humidity_percent"), "unit": "%"}}
    return {"temperature": temperature} | (humidity if "relative_humidity_percent" in stated else {})
