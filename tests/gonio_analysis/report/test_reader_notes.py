"""What the reader of a file has to say of it reaches whoever looks at a result made from it."""

import json
from pathlib import Path

import pandas as pd
import pytest
from gonio_analysis.fitting.observations import observations

from gonio import measurement
from gonio.measurement import of_reader
from gonio.models import build
from tests.command_line import gonio, says
from tests.gonio_analysis.synthetic import measure

MODEL = build("lambert", {"albedo": 0.5})
NOTE = "no blank was given: none is subtracted"
SAID = "No blank was given: none is subtracted."


def noted(folder: Path, name: str, note: str = NOTE, *, waves: tuple[float, ...] = (550.0,), side: str = "") -> Path:
    parts = [measure(MODEL, wavelength_nm=nm, seed=k, name=name) for k, nm in enumerate(waves)]
    frame = pd.concat(parts, ignore_index=True)
    frame.attrs = parts[0].attrs | {"notes": [note]}
    if side:
        frame.insert(5, "side", side)
        frame["theta_r_deg"] = 180.0 - frame["theta_r_deg"]
    path = folder / f"{name}.csv"
    measurement.write(frame, path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        ("fit", "a.csv", "--model", "lambert"),
        ("compare", "a.csv", "--models", "lambert", "--out", "out"),
        ("appearance", "a.csv", "--out", "out"),
        ("compare", "a.csv", "b.csv", "--change", "--out", "out"),
        ("compare", "a.csv", "b.csv", "--models", "lambert", "--out", "out"),
        ("convert", "a.csv", "a.xlsx"),
        ("fit", "a.csv", "--model", "lambert", "--json"),
        ("appearance", "a.csv", "--json"),
        ("fit", "--each", "tables.txt", "--model", "lambert", "--out", "fits.csv"),
    ],
    ids=("fit", "compare", "appearance", "change", "two", "convert", "fit-json", "appearance-json", "each"),
)
def test_a_reader_s_note_is_said_once(tmp_path: Path, command: tuple[str, ...]) -> None:
    noted(tmp_path, "a", waves=(450.0, 550.0, 650.0))
    noted(tmp_path, "b", waves=(450.0, 550.0, 650.0))
    (tmp_path / "tables.txt").write_text("a.csv\nb.csv\n", encoding="utf-8")
    done = gonio(tmp_path, *command, expect=0)
    assert done.stderr.count(SAID) == 1, done.stderr
    if "out" in command:
        page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
        sections = 2 if command[:3] == ("compare", "a.csv", "b.csv") and "--change" not in command else 1
        assert page.count(SAID) == sections


def test_laboratories_notes_are_said(tmp_path: Path) -> None:
    noted(tmp_path, "a")
    noted(tmp_path, "b")
    done = gonio(tmp_path, "compare", "--laboratories", "a.csv", "b.csv", "--out", "out")
    assert done.stderr.count(SAID) == 1, done.stderr


def test_a_note_of_transmission_alone_is_on_its_page(tmp_path: Path) -> None:
    noted(tmp_path, "a", side="transmission")
    assert SAID in gonio(tmp_path, "compare", "a.csv", "--out", "out", expect=0).stderr
    assert (tmp_path / "out" / "index.html").read_text(encoding="utf-8").count(SAID) == 1


def test_notes_of_tables_that_are_fitted_together_keep_their_names(tmp_path: Path) -> None:
    noted(tmp_path, "a")
    noted(tmp_path, "b", "values were percent")
    done = gonio(tmp_path, "fit", "a.csv", "b.csv", "--model", "lambert", "--json", expect=0)
    says(json.loads(done.stdout)["notes"], f"a: {SAID}", "b: Values were percent.")


def test_a_table_that_a_reader_calls_silent_is_not_called_so_again() -> None:
    frame = measure(MODEL)
    frame[["u_brdf", "u_random"]] = float("nan")
    assert any("states no uncertainties" in note for note in observations(frame).notes)
    frame.attrs["notes"] = ["the format states no uncertainties", "the format states no uncertainties"]
    silent = [note for note in observations(frame).notes if "no uncertainties" in note]
    assert silent == ["The format states no uncertainties."]
    frame.attrs["notes"] = "not a list"
    assert of_reader(frame) == []
