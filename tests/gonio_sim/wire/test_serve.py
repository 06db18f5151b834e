"""`gonio sim serve`: what it serves can be measured with, and what cannot is refused with the reason."""

import math
from pathlib import Path
from typing import Any

import pytest
from gonio_sim.wire.serve import _require_measurable, _require_twins
from gonio_sim.wire.twins import Twins, rig_file

from gonio.config import to_toml
from gonio.errors import ConfigError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig.description import RigDescription
from tests.command_line import gonio, says

LAB = find_rig("lab").description


def changed(**tables: dict[str, Any]) -> RigDescription:
    """The shipped laboratory rig with some keys changed."""
    values = LAB.model_dump(mode="json", exclude_none=True)
    for name, keys in tables.items():
        values[name] = values[name] | keys
    return RigDescription.model_validate(values)


@pytest.mark.parametrize("rig", ["sim", "sim-ideal", "sim-metrology", "sim-uncalibrated"])
def test_a_simulated_rig_is_refused_with_the_reason(tmp_path: Path, rig: str) -> None:
    says(gonio(tmp_path, "sim", "serve", "--rig", rig, expect=2).stderr, rig, "no table [devices]")
    assert not (tmp_path / "twin").exists()


def test_what_measure_refuses_is_refused_before_it_is_served(tmp_path: Path) -> None:
    """A rig that simulates by itself, and one whose patch lies beside the reference: two of all that `measure` says."""
    small = changed(reference={"diameter_mm": 1.0}).model_dump(mode="json", exclude_none=True)
    for text, words in (
        (rig_file(LAB).replace('rig = "lab"', 'rig = "sim"', 1), ('rig = "sim"', "drives no device")),
        (to_toml(small), ("roi_radius_mm", "white reference")),
    ):
        (tmp_path / "mine.toml").write_text(text)
        done = gonio(tmp_path, "sim", "serve", "--tcp", "--rig", "mine.toml", expect=2)
        says(done.stderr, "mine.toml: gonio measure would refuse its twins", *words)
        assert done.stdout == ""


def test_a_reference_with_a_certificate_is_served_as_it_was(tmp_path: Path) -> None:
    """The certificate says how bright it is, and the served file does not say it once more."""
    described = changed(reference={"certificate": str(tmp_path / "c.xml"), "albedo": 0.5, "u_rel": 0.01})
    text = rig_file(described)
    assert "c.xml" in text
    assert "albedo" not in text.partition("[reference]")[2].partition("[")[0]
    plain = rig_file(LAB)
    assert "albedo" in plain.partition("[reference]")[2].partition("[")[0]


def test_the_shipped_laboratory_rig_can_be_measured_with(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(rig_file(LAB))
    _require_measurable("lab", tmp_path / "rig.toml", None)


@pytest.mark.parametrize("limits", [[10.0, 80.0], [-80.0, -50.0]])
def test_axes_hang_within_their_limits(tmp_path: Path, limits: list[float]) -> None:
    values = LAB.model_dump(mode="json", exclude_none=True)
    values["arms"]["camera"]["limits_deg"] = limits
    twins = Twins(RigDescription.model_validate(values), None, 0, folder=tmp_path)
    assert limits[0] <= math.degrees(twins.followers["camera"].encoder()) <= limits[1]


def test_what_has_no_twin_is_named() -> None:
    for described, words in (
        (changed(devices={"interlock": {"port": "/dev/ttyS9"}}), r"devices\.interlock\.port: .* no twin"),
        (changed(lamp={"monitor": True}), r"lamp\.monitor = true: .* no monitor"),
    ):
        with pytest.raises(ConfigError, match=words):
            _require_twins(described)
