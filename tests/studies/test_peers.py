"""The study of other people's programs: each runs in a process of its own, and the page says what was found."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from gonio_analysis.result_records import as_json
from gonio_validation.bench import accuracy, evaluators, timing

from gonio.errors import DataError
from tools.studies import peers


def test_the_page_says_which_programs_there_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peers, "PACKAGES", {"nobody": "gonio_nobody"})
    page = peers.make(tmp_path / "peers", quick=True)
    summary = json.loads((page.parent / "summary.json").read_text(encoding="utf-8"))
    assert summary["peers"] == [{"peer": "nobody", "state": "not installed"}]
    assert [family["name"] for family in summary["families"]] == ["cook-torrance"]
    assert summary["families"][0]["ways"][0]["time"]["best_ns"] > 0.0
    assert "No other program is installed here." in page.read_text(encoding="utf-8")


def test_a_peer_is_measured_in_its_own_process(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the peer's process prints is what is measured here; a peer's program never runs in this process."""
    quantity = next(q for q in evaluators.quantities() if q.name == "cook-torrance")
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


def test_a_peer_whose_process_fails_is_named() -> None:
    peer = peers.PeerProgram("nobody", evaluators.quantities()[0].ways[0], {})
    with pytest.raises(DataError, match="nobody: its process failed while it was measured: KeyError"):
        peers.measured(peer, timing.Effort(pairs=1000, repeats=1, budget_s=0.01))


def test_looking_for_peers_brings_none_into_this_process() -> None:
    code = (
        "import sys\nfrom tools.studies import peers\npeers.find()\n"
        "print(sorted({'drjit', 'mitsuba', 'pySCATMECH'} & sys.modules.keys()))"
    )
    made = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert made.stdout.strip() == "[]"
