"""The health of a run in its report: extremes in words, a figure that keeps them, little weight."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from gonio_analysis.report import health

from gonio.lab import run_facts as record
from gonio.lab.acquisition.journal import Journal
from gonio.lab.acquisition.measure import carry_out, find_rig
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.rig import Pose, Reading
from gonio.lab.run_facts import run_facts
from gonio.run_facts import RunFacts
from gonio.samples.files import load_sample
from tests.command_line import some

STEPS = 10_000
HOT, SAGGED = 4321, 8750
HOURS = 10.0
MOST_BYTES = 60_000
"""Of the figure, which stands once on a page of at most 5 MB."""


def step(k: int) -> StepRecord:
    """A slow warming with noise, one hot step, and one on whose way the supply sagged."""
    noise = math.sin(12.9898 * k) * 0.4
    return StepRecord(
        step=k, kind="point", point=0, time_s=100.0 + 3600 * HOURS * k / STEPS, goal=Pose(), pose=Pose(), flag="",
        frames=(),
        health=(
            Reading("light", "temperature", 66.5 if k == HOT else 30 + 10 * (1 - math.exp(-k / 2000)) + noise, "C"),
            Reading("light", "current_max", 300.0 + 50 * noise, "mA"),
            Reading("light", "voltage_min", 10.1 if k == SAGGED else 12.0, "V"),
            Reading("lamp", "level", 0.5),
            Reading("lamp", "state", "lit"),
        ),
    )  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run's folder, with the journal of a long night in it."""
    folder = tmp_path_factory.mktemp("night")
    (folder / "plan.toml").write_text(
        'name = "p"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [10]\n'
    )
    (folder / "sample.toml").write_text('name = "s"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n')
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gonio.disk.os.fsync", lambda descriptor: None)
        sample = load_sample(folder / "sample.toml")
        carry_out(load_plan(folder / "plan.toml"), find_rig("sim-ideal"), folder / "run", sample=sample)
        (folder / "run" / "journal.jsonl").unlink()
        with Journal(folder / "run" / "journal.jsonl") as journal:
            journal.append({"event": "session"})
            for k in range(STEPS):
                journal.append(step(k).to_json())
            journal.append(
                {"event": "suspended", "step": 9, "rule": "hot", "message": "suspend.hot: light", "time_s": 3700.0}
            )
            journal.append({"event": "continued", "step": 9, "waited_s": 360.0, "time_s": 4060.0})
    return folder / "run"


@pytest.fixture(scope="module")
def facts(run: Path) -> RunFacts:
    return some(run_facts(run))


def test_extremes_are_found_and_drawn_among_ten_thousand_steps(facts: RunFacts) -> None:
    by = {h.quantity: h for h in facts.health}
    assert set(by) == {"temperature", "current_max", "voltage_min"}
    hot, sagged = by["temperature"], by["voltage_min"]
    assert [hot.highest, hot.highest_h] == pytest.approx([66.5, HOURS * HOT / STEPS])
    assert [sagged.lowest, sagged.lowest_h] == pytest.approx([10.1, HOURS * SAGGED / STEPS])
    for h in by.values():
        assert h.steps == STEPS
        assert len(h.value) <= 2 * record.STRETCHES + 2
        assert [min(h.value), max(h.value)] == pytest.approx([h.lowest, h.highest], rel=1e-5)  # six digits are kept
        assert h.time_h == sorted(h.time_h)
    assert facts.pauses[0].waited_s == 360.0
    assert facts.pauses[0].begun_h == pytest.approx(1.0)


def test_the_section_says_the_extremes_and_the_pauses(facts: RunFacts) -> None:
    (drawing,) = health.draw(facts, "s")
    figure = drawing.rendered()
    assert len(figure.svg) < MOST_BYTES
    assert "Of 10000 steps" in drawing.caption
    text = json.dumps([repr(block) for block in health.section(facts, [figure])], ensure_ascii=False)
    for said in ("66.5 °C", "4.32 h after the start", "10.1 V", "8.75 h", "It waited 1 time, 6.0 min", "suspend.hot"):
        assert said in text


def test_a_run_without_health_has_no_section(facts: RunFacts) -> None:
    bare = replace(facts, health=[], pauses=[])
    assert health.draw(bare, "s") == []
    assert health.section(bare, []) == []
    assert health.section(None, []) == []
