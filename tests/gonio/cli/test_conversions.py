"""Exports and conversions on the command line, and how options are spelt."""

from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
import typer

from gonio import measurement, plugins
from gonio.cli import application
from tests.command_line import beside, gonio, says
from tests.gonio.cli.test_cli import installed


def one_value(folder: Path) -> None:
    (folder / "one.csv").write_text(
        "theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg,wavelength_nm,brdf\n30,0,10,180,500,0.2\n"
    )


def test_an_export_does_not_hide_a_format(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    one_value(tmp_path)
    point = EntryPoint("astm", "stranger:write", "gonio.exports")
    monkeypatch.setitem(plugins._added, ("gonio.exports", "astm"), point)
    done = gonio(tmp_path, "convert", "one.csv", "one.astm", "--to", "astm", expect=0)
    assert "(stranger:write) is passed over" in " ".join(done.stderr.split())
    assert len(measurement.read(tmp_path / "one.astm")) == 1


EXPORTS = """
from pathlib import Path
def file(run, out):
    out.write_text("half")
    raise ValueError("of the\\nstranger")
def folder(run, out):
    out.unlink(missing_ok=True)
    out.mkdir()
    (out / "a").write_text("half")
    raise ValueError("of the\\nstranger")
def silent(run, out):
    out.write_text("whole")
    return []
def nothing(run, out):
    out.write_text("whole")
def unread(run, out):
    raise OSError(13, "not yours", str(out))
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("file", "ValueError: of the stranger"), ("folder", "ValueError: of the stranger"),
        ("silent", "does not say what it has written"), ("nothing", "TypeError"), ("unread", ""),
    ],
)  # fmt: skip
@pytest.mark.parametrize("before", [False, True])
def test_an_export_that_fails_leaves_the_place_as_it_was(tmp_path: Path, name: str, said: str, before: bool) -> None:
    """What another package writes: a line and an exit code, and nothing half-written."""
    site = installed(tmp_path, "gonio.exports", f"mine = stranger:{name}\n", EXPORTS)
    (tmp_path / "run").mkdir()
    if before:
        (tmp_path / "out").write_text("earlier")
    done = beside(site, tmp_path, "convert", "run", "out", "--to", "mine")
    assert done.returncode == (2 if name == "unread" else 1)
    assert done.stderr.count("\n") == 1
    assert "should not happen" not in done.stderr
    says(done.stderr, said, *(["--to mine", "GONIO_TRACEBACK=1"] if said else []))
    assert sorted(p.name for p in tmp_path.iterdir()) == (["out"] if before else []) + ["run", "site"]
    if before:
        assert (tmp_path / "out").read_text() == "earlier"


@pytest.mark.parametrize("source", ["one.csv", "sample.toml"])
def test_a_format_that_there_is_not_lists_all(tmp_path: Path, source: str) -> None:
    one_value(tmp_path)
    (tmp_path / "sample.toml").write_text('name = "matt"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    done = gonio(tmp_path, "convert", source, "out", "--to", "nope")
    said = " ".join(done.stderr.split())
    assert done.returncode == 2
    says(said, "--to nope", "gonio", "astm", "bird-json", "datacite", "mitsuba", "radiance", "of a whole run bluesky")
    assert "did you mean bluesky?" in gonio(tmp_path, "convert", source, "out", "--to", "bluesk").stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("source", "form"), [("sample.toml", "rgl"), ("one.csv", "astm"), ("one.csv:one", "gonio")])
def test_what_is_converted_is_not_replaced(tmp_path: Path, source: str, form: str) -> None:
    one_value(tmp_path)
    (tmp_path / "sample.toml").write_text('name = "matt"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    target = source.partition(":")[0]
    before = (tmp_path / target).read_bytes()
    done = gonio(tmp_path, "convert", source, target, "--to", form, expect=2)
    says(done.stderr, f"{target}: is the file that is converted, and is not replaced; name another")
    assert (tmp_path / target).read_bytes() == before
    assert "there is no such file" in gonio(tmp_path, "convert", "absent.csv", target, expect=2).stderr


def test_a_model_has_no_datacite_record(tmp_path: Path) -> None:
    (tmp_path / "sample.toml").write_text('name = "matt"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    done = gonio(tmp_path, "convert", "sample.toml", "out.json", "--to", "datacite")
    assert (done.returncode, "is a model; --to datacite takes a run" in done.stderr) == (2, True)


def test_reduce_says_what_the_table_notes(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(
        'name = "p"\nwavelength_nm = [500]\n[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [10, 30]\n'
    )
    (tmp_path / "sample.toml").write_text(
        'name = "aluminium"\nmodel = "he-torrance"\n[parameters]\nsigma0_um = 0.28\ntau_um = 1.77\nior = "Al"\n'
    )
    done = gonio(
        tmp_path, "measure", "plan.toml", "--rig", "sim", "--sample", "sample.toml", "--out", "run", "--yes", expect=0
    )
    done = gonio(tmp_path, "reduce", "run")
    (note,) = measurement.read(tmp_path / "run" / "brdf.csv").attrs["notes"]
    assert "measure points within 10 degrees on both sides of the mirror direction" in note  # that itself is measured
    assert note in " ".join(done.stderr.split())


def _options(command: Any, name: str = "gonio") -> dict[str, set[str]]:
    """Every option of a command and of those below it, and where it is."""
    found: dict[str, set[str]] = {}
    for parameter in command.params:
        for word in parameter.opts if parameter.param_type_name == "option" else ():
            found.setdefault(word, set()).add(name)
    for below in command.list_commands(None) if hasattr(command, "list_commands") else ():
        for word, where in _options(command.get_command(None, below), f"{name} {below}").items():
            found.setdefault(word, set()).update(where)
    return found


def test_an_option_has_one_spelling_in_all_commands() -> None:
    found = _options(typer.main.get_command(application.build()))
    assert {"--wavelength-nm", "--seed"} <= set(found)  # of this shape are what was found
    for word in found:
        for unit in ("nm", "deg", "s", "px", "mm"):
            assert f"{word}-{unit}" not in found, f"{word}: {found[word]}, {found[f'{word}-{unit}']}"
    for former, now in application.FORMER.items():
        assert f"--{former}" not in found
        assert f"--{now}" in found


@pytest.mark.parametrize("word", ["--wavelength", "--wavelength-nm"])
def test_the_former_spelling_of_an_option_stays_good(tmp_path: Path, word: str) -> None:
    for command in (
        ("rig", "snap", "--rig", "sim", "--lamp", "a.dng"),
        ("calibrate", "camera", "--rig", "sim", "--out", "c.toml"),
    ):
        done = gonio(tmp_path, *command, word, "9000", expect=2)
        assert "wavelength_nm = 9000 lies in no band of the rig" in done.stderr
    assert "--lamp" in gonio(tmp_path, "rig", "snap", "--rig", "sim", "a.dng", word, "550", expect=2).stderr
    done = gonio(tmp_path, "fit", "t.csv", "--model", "lambert", word, "many", expect=2)
    assert "--wavelength-nm" in done.stderr
