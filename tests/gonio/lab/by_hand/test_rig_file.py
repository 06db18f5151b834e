"""Values into a rig file: comments, order and line endings stay, and nothing is lost."""

import tomllib
from pathlib import Path

import pytest
from gonio_sim.rig import SIM

from gonio.config import load
from gonio.errors import ConfigError
from gonio.lab.by_hand.rig_file import with_values, write_values, zero_values
from gonio.lab.rig.description import RigDescription


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "my.toml"
    path.write_text(SIM.toml)
    return path


def test_one_line_changes_and_no_other(file: Path) -> None:
    new = with_values(file, {("arms", "light", "zero_offset_deg"): 0.123})
    before, after = SIM.toml.splitlines(), new.splitlines()
    assert len(before) == len(after)
    assert [line for line, old in zip(after, before, strict=True) if line != old] != []
    changed = [line for line, old in zip(after, before, strict=True) if line != old]
    assert len(changed) == 1
    assert changed[0].startswith("zero_offset_deg = 0.123")
    assert tomllib.loads(new)["arms"]["light"]["zero_offset_deg"] == 0.123


def test_windows_line_endings_stay(file: Path) -> None:
    file.write_bytes(SIM.toml.replace("\n", "\r\n").encode())
    write_values(file, {("arms", "light", "zero_offset_deg"): 0.5})
    assert b"\r\n" in file.read_bytes()
    assert file.read_bytes().count(b"\n") == file.read_bytes().count(b"\r\n")


def test_every_earlier_file_is_kept(file: Path) -> None:
    first = write_values(file, {("arms", "light", "zero_offset_deg"): 1.0})
    second = write_values(file, {("arms", "light", "zero_offset_deg"): 2.0})
    assert first is not None
    assert second is not None
    assert (first.name, second.name) == ("my.toml.bak", "my.toml.bak2")
    assert first.read_text() == SIM.toml
    assert load(RigDescription, second).arms.light.zero_offset_deg == 1.0
    copy = file.with_name("copy.toml")
    assert write_values(file, {("arms", "light", "zero_offset_deg"): 3.0}, out=copy) is None
    with pytest.raises(ConfigError, match="is there already"):
        write_values(file, {}, out=copy)
    assert load(RigDescription, copy).arms.light.zero_offset_deg == 3.0


def test_a_copy_into_a_missing_folder_names_what_was_asked_for(file: Path) -> None:
    copy = file.with_name("no") / "copy.toml"
    with pytest.raises(ConfigError, match=r"copy\.toml: there is no folder"):
        write_values(file, {("arms", "light", "zero_offset_deg"): 0.5}, out=copy)


def test_what_would_be_no_rig_file_is_not_written(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"unknown key arms\.light\.zero"):
        write_values(file, {("arms", "light", "zero"): 1.0})
    assert file.read_text() == SIM.toml
    assert list(file.parent.iterdir()) == [file]


def test_the_new_zero_counts_from_what_is_taken_out_already(file: Path) -> None:
    sim = load(RigDescription, file)
    light = sim.arms.light.model_copy(update={"zero_offset_deg": 0.4, "zero_offset_known": True})
    known = sim.model_copy(update={"arms": sim.arms.model_copy(update={"light": light})})
    assert zero_values(known, "light", read_deg=10.0, true_deg=9.0)[1] == pytest.approx(1.4)
    hidden = known.model_copy(
        update={"arms": sim.arms.model_copy(update={"light": light.model_copy(update={"zero_offset_known": False})})}
    )
    values, offset = zero_values(hidden, "light", read_deg=10.0, true_deg=9.0)
    assert offset == pytest.approx(1.0)
    assert values["arms", "light", "zero_offset_known"] is True


def test_tilt_and_spin_have_zeros_of_their_own(file: Path) -> None:
    sim = load(RigDescription, file)
    values, _ = zero_values(sim, "tilt", read_deg=1.0, true_deg=0.0)
    write_values(file, values)
    axes = load(RigDescription, file).axes()
    common = sim.holder.zero_offset_deg
    assert (axes["tilt"].zero_offset_deg, axes["spin"].zero_offset_deg) == (1.0 + common, common)
