"""Calibration files: values over a rig file's, for one rig and for a time."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SIM
from gonio_sim.world import World

from gonio.errors import ConfigError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig.calibration_files import (
    Calibration,
    covariance_of,
    identity,
    read_calibration,
    uncalibrated,
    write_calibration,
)
from gonio.samples.description import ParameterUncertainty

ZERO = "arms.light.zero_offset_deg"


def _rig(folder: Path, more: str = "") -> Path:
    path = folder / "rig.toml"
    path.write_text(more + SIM.toml)
    return path


def _calibration(folder: Path, **changed: Any) -> Calibration:
    description = find_rig(str(_rig(folder))).description
    given: dict[str, Any] = {
        "kind": "geometry",
        "rig": description.name,
        "rig_identity": identity(description),
        "made": datetime.date(2026, 1, 2),
        "values": {"arms": {"light": {"zero_offset_deg": 1.5}}},
        "uncertainty": ParameterUncertainty(parameters=[ZERO], u=[0.01], correlation=[[1.0]]),
    }
    return Calibration(**(given | changed))


def test_values_of_a_calibration_replace_those_of_the_rig_file(tmp_path: Path) -> None:
    made = _calibration(tmp_path)
    write_calibration(made, tmp_path / "geometry.toml")
    assert read_calibration(tmp_path / "geometry.toml") == made
    found = find_rig(str(_rig(tmp_path, 'calibration.files = ["geometry.toml"]\n'))).description
    assert found.arms.light.zero_offset_deg == 1.5
    known = found.calibration.known[0]
    assert (known.parameters, known.u, known.made) == ([ZERO], [0.01], made.made)
    assert found.calibration.replaced == {"arms": {"light": {"zero_offset_deg": 0.37}}}
    assert uncalibrated(found).arms.light.zero_offset_deg == 0.37


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"valid_until": datetime.date(2026, 2, 1)}, "out of date"),
        ({"rig_identity": "0" * 12}, "another rig"),
        ({"made": datetime.date(9999, 1, 1)}, "still to come"),
    ],
)
def test_an_unfit_calibration_is_refused_or_remarked(tmp_path: Path, changed: dict[str, Any], why: str) -> None:
    write_calibration(_calibration(tmp_path, **changed), tmp_path / "geometry.toml")
    with pytest.raises(ConfigError, match=why):
        find_rig(str(_rig(tmp_path, 'calibration.files = ["geometry.toml"]\n')))
    found = find_rig(
        str(_rig(tmp_path, 'calibration = { files = ["geometry.toml"], when_unfit = "warn" }\n'))
    ).description
    assert found.arms.light.zero_offset_deg == 1.5
    assert why in found.calibration.remarks[0]


def test_a_calibration_that_is_not_there_is_named_with_the_key_that_wants_it(tmp_path: Path) -> None:
    write_calibration(_calibration(tmp_path), tmp_path / "geometry.toml")
    with pytest.raises(ConfigError, match=r'calibration\.files .*geomtry\.toml: .*did you mean "geometry\.toml"'):
        find_rig(str(_rig(tmp_path, 'calibration.files = ["geomtry.toml"]\n')))


def test_what_is_true_of_a_simulated_bench_is_no_calibration_and_not_the_rig_file(tmp_path: Path) -> None:
    write_calibration(_calibration(tmp_path), tmp_path / "geometry.toml")
    (tmp_path / "truth.toml").write_text("[arms.light]\nzero_offset_deg = 2.0\n[lamp]\nnoise = 0.0\n")
    head = 'calibration.files = ["geometry.toml"]\n'
    calibrated = World(find_rig(str(_rig(tmp_path, head))).description, None, 1)
    assert calibrated.description.arms.light.zero_offset_deg == 1.5
    assert calibrated.truth.arms.light.zero_offset_deg == 0.37
    hidden = World(find_rig(str(_rig(tmp_path, head + 'truth = "truth.toml"\n'))).description, None, 1)
    assert hidden.truth.arms.light.zero_offset_deg == 2.0
    assert (hidden.truth.lamp.noise, hidden.description.lamp.noise) == (0.0, 0.008)
    assert not any(hidden.zero_error.values())
    assert hidden.reference_scale == 1.0


def test_a_calibration_names_a_parameter_that_it_has(tmp_path: Path) -> None:
    wrong = ParameterUncertainty(parameters=["lamp.noise"], u=[0.01], correlation=[[1.0]])
    with pytest.raises(ValueError, match=r'there is no number "lamp.noise" in \[values\]'):
        _calibration(tmp_path, uncertainty=wrong)


def test_a_later_value_without_uncertainty_is_not_as_uncertain_as_the_one_it_replaces(tmp_path: Path) -> None:
    """And what it leaves as it was stays as well known as before, with its correlations."""
    names = [ZERO, "arms.camera.zero_offset_deg", "lamp.noise"]
    values = {"arms": {"light": {"zero_offset_deg": 1.5}, "camera": {"zero_offset_deg": -0.5}}, "lamp": {"noise": 0.01}}
    known = ParameterUncertainty(
        parameters=names, u=[0.01, 0.02, 0.003], correlation=[[1.0, 0.1, 0.2], [0.1, 1.0, 0.3], [0.2, 0.3, 1.0]]
    )
    write_calibration(_calibration(tmp_path, values=values, uncertainty=known), tmp_path / "first.toml")
    later = {"arms": {"light": {"zero_offset_deg": 1.6}}, "lamp": {"noise": 0.01}}
    nothing = ParameterUncertainty(parameters=[], u=[], correlation=[])
    write_calibration(_calibration(tmp_path, values=later, uncertainty=nothing), tmp_path / "second.toml")
    found = find_rig(str(_rig(tmp_path, 'calibration.files = ["first.toml", "second.toml"]\n'))).description
    assert found.arms.light.zero_offset_deg == 1.6
    expected = np.diag([0.0, 0.02**2, 0.003**2])
    expected[1, 2] = expected[2, 1] = 0.3 * 0.02 * 0.003
    np.testing.assert_allclose(covariance_of(found, names), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"camera": {"width": 320}}, "make another rig of it"),
        ({"arms": {"light": {"encoder_step_deg": 0.1}}}, "make another rig of it"),
        ({"rig": "lab"}, "values.rig: a calibration gives values for"),
        ({"calibration": {"files": ["other.toml"]}}, "values.calibration: a calibration gives"),
        ({"truth": "truth.toml"}, "values.truth: a calibration gives"),
    ],
)
def test_a_calibration_makes_no_other_rig_of_it(tmp_path: Path, values: dict[str, Any], why: str) -> None:
    none = ParameterUncertainty(parameters=[], u=[], correlation=[])
    write_calibration(_calibration(tmp_path, values=values, uncertainty=none), tmp_path / "geometry.toml")
    with pytest.raises(ConfigError, match=why):
        find_rig(str(_rig(tmp_path, 'calibration.files = ["geometry.toml"]\n')))
