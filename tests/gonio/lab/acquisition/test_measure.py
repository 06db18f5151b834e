"""Rigs and samples by the names that a user gives."""

from pathlib import Path

import pytest

from gonio.errors import ConfigError
from gonio.lab.acquisition.measure import find_rig
from gonio.samples.files import load_sample


def test_a_shipped_rig_is_found_by_its_name_and_by_a_file(tmp_path: Path) -> None:
    shipped = find_rig("sim")
    mine = tmp_path / "mine.toml"
    mine.write_text(shipped.plugin.toml, encoding="utf-8")
    assert find_rig(str(mine)).description == shipped.description


def test_a_rig_of_an_unknown_kind_names_file_and_key(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(find_rig("sim").plugin.toml.replace('rig = "sim"', 'rig = "simm"', 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"mine\.toml: rig = 'simm'.*sim"):
        find_rig(str(mine))


def test_a_sample_whose_model_does_not_take_its_parameters_is_refused(tmp_path: Path) -> None:
    sample = tmp_path / "sample.toml"
    sample.write_text('name = "x"\nmodel = "lambert"\n[parameters]\nalbedo = 1.5\n')
    with pytest.raises(ConfigError, match="albedo"):
        load_sample(sample)
