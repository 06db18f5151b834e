"""`gonio bench models`: its arithmetic, its reference values, the hard cases, and the report."""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from gonio_analysis.report.blocks import plain
from gonio_analysis.result_records import as_json
from gonio_validation.bench import (
    accuracy,
    evaluators,
    hard_cases,
    pareto,
    peers,
    results_page,
    speed_and_error,
    timing,
    which_model,
)
from gonio_validation.bench.quantity import (
    BenchQuantity,
    BenchSample,
    ErrorSummary,
    PeerTime,
    TimeSummary,
    Way,
    WaySummary,
    reference,
)
from typer.testing import CliRunner

from gonio.errors import DataError
from gonio.models import engine
from tools.studies import bench_reference as made

ONES = np.ones(4)


def samples(value: list[float], condition: float = 0.0) -> list[BenchSample]:
    return [BenchSample("grid", {}, (ONES,), np.array(value), np.full(4, condition), ("",) * 4)]


def way(*results: float) -> Way:
    return Way("w", lambda p: lambda x: np.array(results))


def test_errors_by_hand() -> None:
    found = accuracy.summarise(accuracy.errors(way(1.0, 2.0, 3.3, 4.0), samples([1.0, 2.0, 3.0, 4.0], condition=9.0)))
    assert found.max == pytest.approx(0.1, rel=1e-12)  # 3.3 against 3, to some roundings
    assert found.max_scaled == pytest.approx(0.01, rel=1e-12)
    assert found.median == 0.0
    assert not found.warning


def test_what_is_not_a_number_is_no_small_error() -> None:
    found = accuracy.summarise(accuracy.errors(way(1.0, math.nan, math.inf, 4.0), samples([1.0, 2.0, 3.0, 4.0])))
    assert found.max is None
    assert found.not_finite == 2


def test_values_that_vanish_have_no_relative_error() -> None:
    found = accuracy.errors(way(0.0, 1e-300, 1e-3, 1.0), samples([0.0, 0.0, 0.0, 1.0]))
    assert found.plain.tolist() == [0.0, 0.0, 1.0, 0.0]


def test_pareto_front() -> None:
    points = [(3.0, 1e-3), (1.0, 1e-1), (2.0, 1e-3), (4.0, 1e-9), (0.5, None)]
    assert pareto.front(points) == [1, 2, 3]


def test_a_wrong_result_breaks_its_case() -> None:
    case = hard_cases._Case()
    case.add("m", [1.0, math.nan, -1.0, math.inf], [1.0 + 1e-9, 2.0, 3.0, 4.0], 0.0, 13.0)
    found = case.summary("x")
    assert not found["holds"]
    assert (found["nan"], found["infinite"], found["negative"]) == (1, 1, 1)
    right = hard_cases._Case()
    right.add("m", [1.0, math.inf], [1.0, math.inf], 0.0, 16.0)
    assert right.summary("x")["holds"]


@pytest.mark.slow
def test_every_hard_case_holds() -> None:
    found = hard_cases.judged(evaluators.quantities(), huge=200_000)  # two threads begin at 131 072
    assert [c for c in found if not c["holds"]] == []
    assert len({c["case"] for c in found}) == len(found) > 50


def test_reference_values_are_those_of_the_tool() -> None:
    assert made.OUT.samefile(Path(evaluators.__file__).with_name("reference.json"))
    with mp.workdps(60):
        groups = [g for g in reference().he_torrance if g.parameters["sigma0_um"] < 0.2]  # few terms
        assert len(groups) == 5
        for g in groups:
            p, k = g.parameters, len(g.value) // 2
            index = complex(p["n"], p["k"])
            pair = ([*g.omega_i[k]], [*g.omega_r[k]])
            value, _ = made.he_torrance(pair, p["sigma0_um"], p["tau_um"], index, p["wavelength_nm"] / 1000.0)
            assert value == g.value[k]


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two quantities, and no processes to time the start-up of."""
    everything = evaluators.quantities

    def chosen() -> list[BenchQuantity]:
        return [q for q in everything() if q.name in ("cook-torrance", "roughness")]

    monkeypatch.setattr(evaluators, "quantities", chosen)
    case = hard_cases._Case()
    case.add("cook-torrance", 1.0, 1.0, 0.0, 13.0)
    monkeypatch.setattr(hard_cases, "judged", lambda found, huge: [case.summary("normal incidence")])
    monkeypatch.setattr(which_model, "FORMS", [f for f in which_model.FORMS if f.label in ("Lambert", "EON")])
    start = {"model": "CookTorrance", "import_s": 0.1, "first_evaluation_s": 0.5, "together_s": 0.6}
    monkeypatch.setattr(timing, "start_up", lambda repeats: [start])
    monkeypatch.setattr(peers, "PACKAGES", {"nobody": "gonio_nobody"})


@pytest.mark.usefixtures("few")
def test_report(tmp_path: Path) -> None:
    from gonio_validation.commands import bench as app

    out = tmp_path / "bench"
    result = CliRunner().invoke(app, ["models", "--quick", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(out / "index.html")
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    page = (out / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'(src|href)="(?!#)', page)  # nothing is loaded
    assert [f["name"] for f in summary["families"]] == ["cook-torrance", "roughness"]
    for family in summary["families"]:
        assert f"<h3>{family['title']}</h3>" in page
        for w in family["ways"]:
            assert w["way"] in page
            assert w["time"]["best_ns"] > 0
            assert all(e["median"] <= e["p99"] <= e["max"] for e in w["errors"].values())
    assert [r["what"] for r in summary["ratios"]] == ["Cook-Torrance: plain numpy / ours, vectors"]
    assert summary["ratios"][0]["ratio"] > 1.0
    matt, metal = summary["which_model"]
    for sample in (matt, metal):
        assert [c["form"] for c in sample["candidates"]] == ["Lambert", "EON"]
        assert all(c["processor_ns"] > 0.0 for c in sample["candidates"])
        assert any(c["on_front"] and c["off_nearest"] == 0.0 for c in sample["candidates"])
        assert sample["sample"] in page
    flat, rough = matt["candidates"]
    assert rough["misfit"] < flat["misfit"]  # EON is a model of rough matt surfaces, and Lambert's law at sigma = 0
    assert summary["peers"] == [{"peer": "nobody", "state": "not installed"}]
    steps = summary["families"][1]["ways"][2:]
    errors = [w["errors"]["grid"]["max"] for w in steps]
    assert errors == sorted(errors, reverse=True)  # each Newton step is better than the one before
    assert all(t["holds"] for t in summary["tolerances"])
    with open(out / "tables" / "points.csv", encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert {r["way"] for r in rows} == {w["way"] for f in summary["families"] for w in f["ways"]}


def test_which_model_is_said_by_misfit_and_cost() -> None:
    exact = which_model.Candidate("exact", 0.001, 5000.0, 0.0, True)
    close = which_model.Candidate("functional", 0.0051, 50.0, 0.004, True)
    far = which_model.Candidate("Lambert", 0.2, 3.0, 0.2, True)
    said = which_model.Compared("Clay", [far, close, exact]).words
    assert said == "Clay: exact is nearest, 0.10 % off; functional is within 0.40 % of it at 1.0 % of the cost."
    said = which_model.Compared("Clay", [far, exact]).words
    first = "Clay: exact is nearest, 0.10 % off, and nothing cheaper is within 2.0 % of it"
    assert said == f"{first}: Lambert is 20 % off at 0.060 % of the cost."
    assert which_model.Compared("Clay", [exact]).words == f"{first}."


def test_a_tolerance_that_is_missed_is_said() -> None:
    error = ErrorSummary(3, max=1e-11, p99=1e-12, median=1e-13, max_scaled=1e-11, not_finite=0, warning=False)
    time = TimeSummary(best_ns=1.0, median_ns=1.0, processor_ns=1.0, pairs=3, repeats=1)
    missed = WaySummary("w", True, False, "", 1e-12, {"grid": error}, time, True, False)
    assert not speed_and_error.holds(missed, 1e-12)
    assert speed_and_error.holds(missed, 1e-11)
    lost = replace(missed, errors={"grid": replace(error, max_scaled=None)})
    assert not speed_and_error.holds(lost, 1e-11)


def test_a_peer_is_measured_in_its_own_process(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the peer's process prints is what is measured here; a peer's program never runs in this process."""
    quantity = next(q for q in evaluators.quantities() if q.name == peers.QUANTITY)
    one, effort = quantity.ways[0], timing.Effort(pairs=1000, repeats=2, budget_s=0.01)
    monkeypatch.setattr(peers, "_ways", lambda: {"somebody": one})
    peers.report("somebody", effort)
    printed = capsys.readouterr().out
    found = json.loads(printed)
    assert found["errors"] == json.loads(json.dumps(as_json(accuracy.by_set(quantity, one))))
    assert found["time"]["pairs"] == 1000
    assert found["time"]["best_ns"] > 0
    started: list[str] = []

    def process(code: str, environment: dict[str, str], timeout: float) -> subprocess.CompletedProcess[str]:
        started.append(f"{environment} {code}")
        return subprocess.CompletedProcess([], 0, stdout=f"a library speaks\n{printed}", stderr="")

    monkeypatch.setattr(peers, "process", process)
    peer = peers.PeerProgram("somebody", one, {"WITH": "this"})
    assert as_json(peers.measured(peer, effort)) == found
    assert len(started) == 1
    assert "WITH" in started[0]
    assert "pairs=1000" in started[0]


def test_a_peers_threads_are_in_its_row() -> None:
    time = PeerTime(best_ns=1.0, median_ns=1.0, processor_ns=1.0, pairs=3, repeats=1, threads=None)
    row = as_json(WaySummary("w", False, True, "", None, {}, time, False, False))
    assert row["time"] == {**as_json(TimeSummary(1.0, 1.0, 1.0, 3, 1)), "threads": None}


def test_a_peer_whose_process_fails_is_named() -> None:
    peer = peers.PeerProgram("nobody", evaluators.quantities()[0].ways[0], {})
    with pytest.raises(DataError, match="nobody: its process failed while it was measured: KeyError"):
        peers.measured(peer, timing.Effort(pairs=1000, repeats=1, budget_s=0.01))


def test_looking_for_peers_brings_none_into_this_process() -> None:
    code = (
        "import sys\nfrom gonio_validation.bench import peers\npeers.find()\n"
        "print(sorted({'drjit', 'mitsuba', 'pySCATMECH'} & sys.modules.keys()))"
    )
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert made.stdout.strip() == "[]"


@pytest.mark.skipif(engine.threads() < 2, reason="one processor: no call is shared")
def test_the_hand_over_is_what_half_a_call_does_not_explain() -> None:
    found = timing.hand_over(20)
    assert found is not None
    assert found["pairs"] == 2 * engine.SPLIT
    assert found["hand_over_us"] == max(found["shared_us"] - found["half_alone_us"], 0.0)
    assert 0.0 <= found["share"] < 1.0
    assert f"{found['pairs']} pairs" in plain(results_page._hand_over(found).text)
    assert "one processor" in plain(results_page._hand_over(None).text)
