"""A run of several days: its report says when it was measured, how far each session came, what the reference said."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from gonio_analysis.report import health, make

from gonio.errors import DeviceError, Interrupted
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from gonio.lab.run_facts import run_facts
from gonio.run_facts import RunFacts
from gonio.samples.description import SampleDescription
from tests.command_line import says, some
from tests.gonio.numpy_rig import NumpyRig, Plugin, StopAfter, measured, plan_in

DIMMER = 0.97
DAYS = ("2026-03-02T22:05:00.000Z", "2026-03-03T08:30:00.000Z", "2026-03-05T23:59:00.000Z")


class Dimmer(Plugin):
    """The same rig on another day: its lamp is dimmer."""

    def open(
        self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool
    ) -> NumpyRig:
        less = DIMMER * description.camera.responsivity_e_per_s
        camera = description.camera.model_copy(update={"responsivity_e_per_s": less})
        return super().open(
            description.model_copy(update={"camera": camera}), sample=sample, seed=seed, confirm=confirm
        )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three sessions: Ctrl-C, a camera that fails on the next day, and the rest with a dimmer lamp."""
    here = tmp_path_factory.mktemp("days")
    plan, out = plan_in(here), here / "run"
    with pytest.MonkeyPatch.context() as patch:

        def session(day: str, plugin: Plugin, stop: StopAfter | None = None, *, resume: bool = True) -> Run:
            patch.setattr("gonio.lab.acquisition.journal.now", lambda: day)
            more: dict[str, Any] = {} if stop is None else {"progress": stop}
            return measured(plan, out, plugin, resume=resume, **more)

        with pytest.raises(Interrupted):
            session(DAYS[0], Plugin(), StopAfter(6), resume=False)
        with pytest.raises(DeviceError):
            session(DAYS[1], Plugin(options={"fails_at": 8}))
        run = session(DAYS[2], Dimmer())
    run.write_table(brdf.reduce(run))
    return out


@pytest.fixture(scope="module")
def facts(folder: Path) -> RunFacts:
    return some(run_facts(folder))


def test_sessions_have_their_days_steps_ends_and_levels(folder: Path, facts: RunFacts) -> None:
    steps = len(Run.open(folder).steps())
    assert [one.began for one in facts.sessions] == list(DAYS)
    assert [one.ending for one in facts.sessions] == ["was interrupted", "a device failed", "all was measured"]
    assert sum(one.steps for one in facts.sessions) == steps
    first, last = facts.sessions[0], facts.sessions[-1]
    assert [level.band for level in first.levels] == ["green, 550", "red 650"]
    for level in first.levels:
        assert level.relative == pytest.approx(1.0)
    for level in last.levels:
        # a visit is a mean over some thousand pixels of some ten thousand electrons: 2e-4, and of one or two visits
        assert level.relative == pytest.approx(DIMMER, abs=2e-3)
    visits = sum(level.visits for one in facts.sessions for level in one.levels if level.band == "red 650")
    assert visits == sum(step.kind == "reference" for step in Run.open(folder).steps())


def test_the_page_shows_them(folder: Path, tmp_path: Path) -> None:
    make([str(folder)], tmp_path / "report", models=["lambert"])
    page = (tmp_path / "report" / "index.html").read_text(encoding="utf-8")
    assert "measured in 3 sessions" in page
    says(page, "2026-03-05", "22:05", "a device failed", "0.97")
    kept = json.loads((tmp_path / "report" / "summary.json").read_text(encoding="utf-8"))
    assert len(kept["datasets"][0]["run"]["sessions"]) == 3


def test_a_run_of_one_session_says_nothing_of_it(facts: RunFacts) -> None:
    assert health.sessions_section(replace(facts, sessions=facts.sessions[:1])) == []
    assert health.sessions_section(None) == []


def test_a_session_over_midnight_and_one_that_was_killed(facts: RunFacts) -> None:
    one = replace(facts.sessions[0], ended="2026-03-03T06:10:00.000Z", ending="no word of an end", levels=[])
    said = repr(health.sessions_section(replace(facts, sessions=[one, facts.sessions[2]])))
    says(said, "22:05 – 06:10 (+1 d)", "no word of an end", "not measured")
