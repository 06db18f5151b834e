"""The study of calls: its numbers are what they say."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from gonio_analysis.report.blocks import plain

from gonio.models import engine
from tools.studies import calls


def test_the_page_has_every_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = {"model": "CookTorrance", "import_s": 0.1, "first_evaluation_s": 0.5, "together_s": 0.6}
    monkeypatch.setattr(calls, "start_up", lambda repeats: [start])
    page = calls.make(tmp_path / "calls", quick=True)
    summary = json.loads((page.parent / "summary.json").read_text(encoding="utf-8"))
    assert len(summary["single_calls"]) == 14
    assert all(0.0 < row["best_us"] <= row["median_us"] for row in summary["single_calls"])
    assert "first value within 0.60 s" in page.read_text(encoding="utf-8")


@pytest.mark.skipif(engine.threads() < 2, reason="one processor: no call is shared")
def test_the_hand_over_is_what_half_a_call_does_not_explain() -> None:
    found = calls.hand_over(20)
    assert found is not None
    assert found["pairs"] == 2 * engine.SPLIT
    assert found["hand_over_us"] == max(found["shared_us"] - found["half_alone_us"], 0.0)
    assert 0.0 <= found["share"] < 1.0
    assert f"{found['pairs']} pairs" in plain(calls._hand_over(found).text)
    assert "one processor" in plain(calls._hand_over(None).text)
