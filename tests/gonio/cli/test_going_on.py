"""`measure --resume` asks for nothing that the run holds, and `reduce` says what is missing of a run."""

from pathlib import Path

import pytest

from gonio.lab.acquisition.resuming import unfinished
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from tests.command_line import gonio, says
from tests.gonio import numpy_rig

PLAN = """name = "three"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [-40, 10, 55]
"""
SAMPLE = """name = "matte"
model = "lambert"
[parameters]
albedo = 0.37
"""


@pytest.mark.slow
def test_a_cut_run_is_said_to_be_and_goes_on_by_what_it_holds(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    (tmp_path / "sample.toml").write_text(SAMPLE)
    measure = ("measure", "plan.toml", "--rig", "sim", "--out", "run")
    gonio(tmp_path, *measure, "--sample", "sample.toml", "--seed", "11", expect=0)
    done = gonio(tmp_path, "reduce", "run", expect=0)
    assert "not finished" not in done.stderr
    table = (tmp_path / "run" / "brdf.csv").read_bytes()
    journal = tmp_path / "run" / "journal.jsonl"
    journal.write_bytes(b"".join(journal.read_bytes().splitlines(keepends=True)[:4]))  # dark, visit, a point
    says(gonio(tmp_path, "reduce", "run", expect=0).stderr, "the run is not finished: 1 of 3 points are measured")
    (tmp_path / "sample.toml").unlink()
    says(gonio(tmp_path, *measure, "--resume", "--seed", "12", expect=2).stderr, "seed: 11 in the run, 12 now")
    gonio(tmp_path, *measure, "--resume", "--dry-run", expect=0)
    gonio(tmp_path, *measure, "--resume", expect=0)
    assert "not finished" not in gonio(tmp_path, "reduce", "run", expect=0).stderr
    assert (tmp_path / "run" / "brdf.csv").read_bytes() == table
    gonio(tmp_path, "measure", "plan.toml", "--rig", "sim", "--out", "other", "--resume", expect=2)  # holds nothing


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (5, "2 of 5 points are measured;"),
        (9, "5 of 5 points are measured, and 1 measurements of the reference or dark"),
        (10, ""),
    ],
)
def test_what_is_left_of_a_run(tmp_path: Path, lines: int, words: str) -> None:
    run = numpy_rig.measured(numpy_rig.plan_in(tmp_path), tmp_path / "run")
    assert unfinished(run) == ""
    kept = (run.path / "journal.jsonl").read_bytes().splitlines(keepends=True)[:lines]
    (run.path / "journal.jsonl").write_bytes(b"".join(kept))
    cut = Run.open(run.path)
    assert unfinished(cut).startswith("the run is not finished: " * bool(words) + words)
    assert any("not finished" in note for note in brdf.reduce(cut).attrs["notes"]) == bool(words)
