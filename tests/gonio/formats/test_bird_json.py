"""BiRD universal BRDF JSON: units, polarisation, uncertainties, and files that the project's own schemas accept."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gonio import measurement
from gonio.errors import DataError


def example(**changes: Any) -> dict[str, Any]:
    data = {
        "theta_i": {"unit": "deg", "values": [30, 30, 45.5]},
        "phi_i": {"unit": "°", "values": [0, 0, 350]},
        "theta_r": {"unit": "rad", "values": [math.pi / 6, 0.0, math.pi / 4]},
        "phi_r": {"unit": "rad", "values": [math.pi, 0.0, 0.5]},
        "wavelength_i": {"unit": "μm", "values": [0.55, 0.55, 0.6]},
        "BRDF": {"unit": "sr^-1", "values": [0.3, 0.2, 0.1]},
    }
    data |= changes
    return {"metadata": {}, "data": {key: value for key, value in data.items() if value is not None}}


def parse(content: Any, name: str = "x.brdf") -> pd.DataFrame:
    return measurement.parse(json.dumps(content, ensure_ascii=False).encode(), Path(name))


def test_units_are_those_that_the_file_states() -> None:
    frame = parse(example())
    assert frame["theta_i_deg"].tolist() == [30.0, 30.0, 45.5]
    np.testing.assert_allclose(frame["theta_r_deg"], [30, 0, 45], rtol=1e-15)  # a unit is one multiplication
    np.testing.assert_allclose(frame["phi_r_deg"], [180, 0, np.rad2deg(0.5)], rtol=1e-15)
    np.testing.assert_allclose(frame["wavelength_nm"], [550, 550, 600], rtol=1e-15)
    assert frame["u_brdf"].isna().all()


def constant(value: float, unit: str) -> dict[str, Any]:
    return {"BRDF": {"unit": "1/sr", "values": [0.3, 0.2, 0.1], "uncertainty": {"value": value, "unit": unit}}}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"uBRDF": {"unit": "1/sr", "values": [0.01, 0.02, 0.03]}}, [0.01, 0.02, 0.03]),
        ({"uBRDF": {"unit": "%", "values": [1, 2, 3]}}, [0.003, 0.004, 0.003]),
        (constant(1, "%"), [0.003, 0.002, 0.001]),
        (constant(0.5, "1/sr"), [0.5] * 3),
    ],
)  # fmt: skip
def test_uncertainties_in_each_of_the_formats_ways(given: dict[str, Any], expected: list[float]) -> None:
    # percent are two multiplications
    np.testing.assert_allclose(parse(example(**given))["u_brdf"], expected, rtol=1e-14)


def test_polarisation_as_letters_and_as_stokes_vectors() -> None:
    stokes = {"notation": "inStokes", "values": [[1, 1, 0, 0], [1, -1, 0, 0], [1, 0, 0, 0]]}
    assert parse(example(polarization_i=stokes))["polarisation"].tolist() == ["s", "p", "unpolarised"]
    both = {"notation": "sp", "values": ["s", "s", "p"]}
    assert parse(
        example(polarization_i=both, polarization_r=stokes | {"values": [[1, 1, 0, 0], [1, -1, 0, 0], [1, 1, 0, 0]]})
    )["polarisation"].tolist() == ["ss", "sp", "ps"]
    with pytest.raises(DataError, match=r"polarization_i\.values\[1\]"):
        parse(example(polarization_i={"notation": "inStokes", "values": [[1, 1, 0, 0], [1, 0, 1, 0], [1, 0, 0, 0]]}))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"theta_i": None}, 'no variable "theta_i"'),
        ({"theta_i": {"unit": "grad", "values": [1, 2, 3]}}, "data.theta_i.unit is 'grad'"),
        ({"theta_r": {"unit": "deg", "values": [1, 91, 3]}}, "data.theta_r.values[1] is 91"),
        ({"phi_r": {"unit": "deg", "values": [1, 2]}}, "data.phi_r.values has 2 entries"),
        ({"BRDF": {"unit": "1/sr", "values": [0.1, "x", 0.1]}}, "data.BRDF.values[1] is 'x'"),
        ({"BRDF": {"unit": "1/sr", "values": []}}, "data.BRDF.values is []"),
    ],
)
def test_what_is_wrong_is_named_by_its_path(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(DataError) as caught:
        parse(example(**changes))
    assert f"x.brdf: {told}" in str(caught.value) or f"x.brdf: data has {told}" in str(caught.value)


def test_broken_json_names_line_and_column() -> None:
    with pytest.raises(DataError, match=r"x\.brdf, line 2, column 9"):
        measurement.parse(b'{"metadata": {},\n"data": ]}', Path("x.brdf"))


def full(frame: pd.DataFrame) -> pd.DataFrame:
    """A table with everything that one can hold."""
    frame["u_brdf"] = 0.013
    frame["u_random"] = 0.005
    frame.insert(len(frame.columns) - 1, "s_reference", -0.012)
    frame.loc[4, "brdf"] = -1e-5
    frame.loc[5, "u_brdf"] = np.nan
    frame.attrs["receiver_solid_angle_sr"] = 0.001
    return frame


def test_a_round_trip_keeps_everything(tmp_path: Path, small: pd.DataFrame) -> None:
    frame = full(small)
    assert measurement.write(frame, tmp_path / "a.brdf") == []
    back = measurement.read(tmp_path / "a.brdf")
    pd.testing.assert_frame_equal(back, frame, check_exact=True)
    assert (back.attrs["receiver_solid_angle_sr"], back.attrs["sample"]) == (0.001, "tile 7")


def validator(shared: Callable[[str], Path]) -> Any:
    """Of the project's own schemas."""
    jsonschema = pytest.importorskip("jsonschema")
    from referencing import Registry, Resource

    schemas = [
        json.loads(path.read_text(encoding="utf-8"))
        for path in shared("bird_json").glob("*schema*.json")
        if not path.name.startswith("sample_holder")
    ]  # that one is not JSON, and no other refers to it
    registry = Registry().with_resources((schema["$id"], Resource.from_contents(schema)) for schema in schemas)
    (top,) = (schema for schema in schemas if schema["$id"].endswith("/brdf_json_schema_v1.0.json"))
    return jsonschema.Draft202012Validator(top, registry=registry)


def test_files_fit_the_schemas(tmp_path: Path, small: pd.DataFrame, shared: Callable[[str], Path]) -> None:
    schema = validator(shared)
    polarised = small.copy()
    polarised["polarisation"] = ["ss", "sp", "ps", "pp"] * 3
    own = measurement.read(shared("bird_json/example.brdf"))
    band = small.copy()
    band["wavelength_nm"] = np.nan
    for number, frame in enumerate((small, full(small.copy()), polarised, own, band)):
        path = tmp_path / f"{number}.brdf"
        measurement.write(frame, path)
        assert [error.message for error in schema.iter_errors(json.loads(path.read_text(encoding="utf-8")))] == []
        pd.testing.assert_frame_equal(measurement.read(path), frame, check_exact=True)


def test_the_projects_example(shared: Callable[[str], Path]) -> None:
    frame = measurement.read(shared("bird_json/example.brdf"))
    assert frame["brdf"].tolist() == [0.254, 0.263, 0.267, 0.273, 0.281, 0.295, 0.296, 0.301]
    assert frame["polarisation"].tolist() == ["s", "p"] * 4
    assert frame["wavelength_nm"].tolist() == [550, 550, 650, 650, 750, 750, 850, 850]
    assert (frame.attrs["receiver_solid_angle_sr"], frame.attrs["sample"]) == (0.002194, "SRT1")
    assert any("sample_width" in note for note in frame.attrs["notes"])


def test_grazing_rows_are_refused_because_the_schema_refuses_them(tmp_path: Path, small: pd.DataFrame) -> None:
    small.loc[0, "theta_r_deg"] = 90.0
    with pytest.raises(DataError, match="below 90"):
        measurement.write(small, tmp_path / "a.brdf")
    assert list(tmp_path.iterdir()) == []


def test_damaged_files(small: pd.DataFrame, tmp_path: Path, survives: Callable[..., None]) -> None:
    measurement.write(full(small), tmp_path / "a.brdf")
    survives((tmp_path / "a.brdf").read_bytes(), "a.brdf")
    survives(json.dumps(example(polarization_i={"notation": "sp", "values": ["s", "p", "u"]})).encode(), "b.brdf")
