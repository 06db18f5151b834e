"""Very many tables in one process: `gonio fit --each FOLDER|LIST`."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_analysis.commands.implementations import _of_any_table
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.selection import many_tables

from gonio import measurement
from gonio.errors import ConfigError
from gonio.measurement import Reading
from gonio.models import CookTorrance, Lambert
from tests.command_line import gonio
from tests.gonio_analysis.synthetic import measure

ASKED = FitRequest("oren-nayar")


def tables(folder: Path, count: int = 3) -> Path:
    """A folder of tables."""
    folder.mkdir(exist_ok=True)
    for k in range(count):
        measurement.write(measure(Lambert(0.2 + 0.1 * k), seed=k), folder / f"t{k}.csv")
    return folder


def made(folder: Path, out: Path, asked: FitRequest = ASKED) -> many_tables.TablesOutcome:
    """Fit them."""
    return many_tables.make(str(folder), out, asked, Reading(), count=lambda done, total: None)


def rows(path: Path) -> list[dict[str, str]]:
    """What a table of fits holds."""
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_row_is_what_the_fit_of_its_table_says(tmp_path: Path) -> None:
    folder = tables(tmp_path / "tables")
    gloss = CookTorrance(s=0.4, d=0.6, m=0.3, diffuse_albedo=0.5, ior=1.5)
    measurement.write(measure(gloss, seed=5, reference=0.01, cone_sr=1e-3), folder / "gloss.csv")
    gonio(tmp_path, "fit", "--each", "tables", "--model", "oren-nayar", "--out", "fits.csv", expect=0)
    found = rows(tmp_path / "fits.csv")
    assert [row["table"] for row in found] == [f"tables/{name}.csv" for name in ("gloss", "t0", "t1", "t2")]
    for row in found:
        alone = json.loads(gonio(tmp_path, "fit", row["table"], "--model", "oren-nayar", "--json", expect=0).stdout)
        assert float(row["chi_square"]) == alone["reduced_chi_square"]
        assert int(row["n"]) == alone["n_points"]
        for name in ("albedo", "sigma_deg"):
            u = alone["parameters"][name]["u"]
            assert float(row[name]) == alone["parameters"][name]["value"]
            assert row[f"u_{name}"] == ("" if u is None else repr(u))
    assert found[0]["flag"].startswith("rejected")
    assert float(found[0]["misfit"]) > 0.05
    assert all(float(row["misfit"]) == 0.0 for row in found[1:])


@pytest.mark.slow
def test_what_cannot_be_read_or_fitted_is_a_row(tmp_path: Path) -> None:
    folder = tables(tmp_path / "tables", 1)
    (folder / "junk.csv").write_bytes(b"\xff\x00no table")
    (folder / "empty.csv").write_bytes(b"")
    measurement.write(measure(Lambert(0.3)).head(2), folder / "few.csv")
    (tmp_path / "list.txt").write_text(
        "# tables\ntables/t0.csv\ntables/junk.csv\n\ntables/empty.csv\ntables/few.csv\ntables/none.csv\n"
    )
    ended = gonio(tmp_path, "fit", "--each", "list.txt", "--model", "oren-nayar", "--out", "fits.csv", expect=0)
    assert "fitted 1 of 5" in ended.stdout
    assert "4 could not be fitted" in ended.stdout
    found = {row["table"]: row["flag"] for row in rows(tmp_path / "fits.csv")}
    assert not found["tables/t0.csv"].startswith("not fitted")
    for name in ("junk", "empty", "few", "none"):
        assert found[f"tables/{name}.csv"].startswith("not fitted: "), name
    assert "at least 3 are needed" in found["tables/few.csv"]


def test_a_note_is_told_once_of_tables_that_differ_by_their_names() -> None:
    notes = [f"There is no {name}.meta.json beside the table. The file has no u." for name in ("f", "t0", "no")]
    told = {_of_any_table(note, Path(f"of/{name}.csv")) for note, name in zip(notes, ("f", "t0", "no"), strict=True)}
    assert told == {"There is no NAME.meta.json beside the table. The file has no u."}


def test_rows_that_are_done_are_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, out = tables(tmp_path / "tables"), tmp_path / "fits.csv"
    assert made(folder, out).before == 0
    whole = out.read_bytes()
    fitted: list[str] = []
    once = many_tables._rows

    def noted(job: many_tables._Job) -> tuple[list[many_tables.Row], list[str]]:
        fitted.append(Path(job.table).name)
        return once(job)

    monkeypatch.setattr(many_tables, "_rows", noted)
    assert made(folder, out).before == 3
    assert out.read_bytes() == whole
    assert fitted == []
    measurement.write(measure(Lambert(0.7)), folder / "t1.csv")
    made(folder, out)
    assert fitted == ["t1.csv"]
    made(folder, out, FitRequest("oren-nayar", searches=2))
    assert fitted[1:] == ["t0.csv", "t1.csv", "t2.csv"]


KILLED = """
import os, signal, sys
from pathlib import Path
from gonio.measurement import Reading
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.commands.implementations import _of_any_table
from gonio_analysis.selection import many_tables
def dies(done, total):
    if done == 2:
        os.kill(os.getpid(), signal.SIGKILL)
many_tables.make(sys.argv[1], Path(sys.argv[2]), FitRequest("oren-nayar"), Reading(), count=dies)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kill -9 is of POSIX")
def test_what_was_killed_goes_on_and_is_the_same_to_the_byte(tmp_path: Path) -> None:
    folder, out, whole = tables(tmp_path / "tables"), tmp_path / "fits.csv", tmp_path / "whole.csv"
    made(folder, whole)
    ended = subprocess.run([sys.executable, "-c", KILLED, folder, out], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert not out.exists()
    part = tmp_path / "fits.csv.part"
    with open(part, "ab") as file:
        file.write(f"{folder}{os.sep}t2.csv,synth".encode())  # a line that was torn
    assert made(folder, out).before == 2
    assert out.read_bytes() == whole.read_bytes()
    assert not part.exists()


def both(path: Path, model: str, **options: Any) -> tuple[many_tables.Row, many_tables.Row, list[str]]:
    """The row of a table by the engine and by a search, and why there is none by the engine."""
    job = many_tables._Job(str(path), "", FitRequest(model, **options), Reading(), "", by_engine=True)
    (quick,), why = many_tables._rows(job)
    (plain,), none = many_tables._rows(replace(job, by_engine=False))
    assert none == []
    return quick, plain, why


@pytest.mark.slow
@pytest.mark.parametrize(("model", "flag"), [("cook-torrance", ""), ("ggx", "rejected")])
def test_rows_by_the_engine_of_maps_are_those_of_a_search(model: str, flag: str, tmp_path: Path) -> None:
    gloss = CookTorrance(s=0.4, d=0.6, m=0.3, diffuse_albedo=0.5, ior=1.5)
    measurement.write(measure(gloss, seed=5, reference=0.01), tmp_path / "gloss.csv")
    quick, plain, why = both(tmp_path / "gloss.csv", model)
    assert why == []
    assert quick["flag"] == plain["flag"] == flag
    for name in pose(FitRequest(model)).free:
        u = float(plain[f"u_{name}"])
        # both end where a step is below 1e-4 u; the last step of both starts that near
        assert float(quick[name]) == pytest.approx(float(plain[name]), abs=1e-3 * u)
        assert float(quick[f"u_{name}"]) == pytest.approx(u, rel=1e-3)
    # of a rejected model it is large, and weights scaled to a model that is right to 1e-8 change it by as much
    assert float(quick["chi_square"]) == pytest.approx(float(plain["chi_square"]), rel=1e-7, abs=1e-3)


@pytest.mark.slow
def test_what_the_engine_of_maps_cannot_do_is_searched_for_and_said(tmp_path: Path) -> None:
    white, gloss = Lambert(0.4), CookTorrance(s=0.4, d=0.6, m=0.3, diffuse_albedo=0.5, ior=1.5)
    bare = measure(gloss).assign(u_brdf=np.nan, u_random=np.nan)
    cases: list[tuple[Any, str, dict[str, Any], str]] = [
        (measure(white), "lambert", {}, "a model or parameters that the engine of maps does not have"),
        (measure(gloss, cone_sr=1e-3), "oren-nayar", {}, "cones"),
        (bare, "oren-nayar", {}, "no stated uncertainties"),
        (measure(gloss), "oren-nayar", {"loss": "huber"}, "another metric, loss, bound or prior"),
        (measure(white, seed=2), "cook-torrance", {}, "a parameter at its bound"),
    ]
    for k, (frame, model, options, said) in enumerate(cases):
        measurement.write(frame, tmp_path / f"{k}.csv")
        quick, plain, why = both(tmp_path / f"{k}.csv", model, **options)
        assert why == [said]
        assert quick == plain
    (tmp_path / "many").mkdir()
    for k in range(many_tables.MANY):
        measurement.write(measure(white).head(2), tmp_path / "many" / f"{k}.csv")
    measurement.write(measure(white), tmp_path / "many" / "white.csv")
    ended = gonio(tmp_path, "fit", "--each", "many", "--model", "lambert", "--out", "fits.csv", expect=0)
    assert "1 were searched for one by one, not by the engine of maps: a model or parameters" in ended.stderr


def test_what_does_not_go_together_is_refused(tmp_path: Path) -> None:
    tables(tmp_path / "tables", 1)
    (tmp_path / "nothing").mkdir()
    (tmp_path / "mine.csv").write_text("a,b\n1,2\n")
    command = ("fit", "--model", "oren-nayar")
    cases: dict[tuple[str, ...], str] = {
        (): "name a TABLE",
        ("--each", "tables"): "--out TABLE.csv",
        ("--each", "tables", "--out", "fits.h5"): "ends in .csv",
        ("--each", "tables", "--out", "mine.csv"): "choose another --out",
        ("--each", "nothing", "--out", "fits.csv"): "names no table",
        ("--each", "missing", "--out", "fits.csv"): "a folder, or a text file",
        ("--each", "tables", "--joint", "--out", "fits.csv"): "--joint: has no part",
        ("--each", "tables", "--fix", "m=1", "--out", "fits.csv"): "m",
        ("tables/t0.csv", "--out", "fits.csv"): "is no map",
        ("tables/t0.csv", "--dask", "tcp://127.0.0.1:9"): "--dask: goes with a map",
    }
    for options, message in cases.items():
        assert message in gonio(tmp_path, *command, *options, expect=2).stderr, options
    assert (tmp_path / "mine.csv").read_text() == "a,b\n1,2\n"
    with pytest.raises(ConfigError, match="names no table"):
        many_tables.listed(str(tmp_path / "nothing"))
