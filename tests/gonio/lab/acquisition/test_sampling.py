"""Runs that grow by batches: a choice follows from the run on the disk, so stopping anywhere changes nothing."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio import plugins
from gonio.errors import ConfigError, Interrupted
from gonio.lab.acquisition import repair
from gonio.lab.acquisition.plan import Plan, Point, canonical, load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.sampling import Choice
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from tests.gonio.numpy_rig import Plugin, StopAfter, plan_in
from tests.gonio.numpy_rig import measured as measure

PLAN = """
name = "grows"
wavelength_nm = [550]
[adaptive]
how = "brightest"
budget_h = 1.0
batches = 3
"""


@dataclass
class Brightest:
    """Chooses the brightest point once more, and one beside it, for so many batches."""

    batches: int
    asked: list[int] = field(default_factory=list)
    more: dict[str, Any] = field(default_factory=dict)
    """Further reasons."""

    def first(self, planned: Sequence[Point]) -> Sequence[Point]:
        """Three directions at one incidence."""
        return [canonical(30.0, 0.0, theta_r, 180.0) for theta_r in (10.0, 30.0, 50.0)]

    def next(self, run: Run) -> Choice:
        """By the values as they are reduced so far."""
        done = len(run.batches)
        self.asked.append(len(run.steps()))
        if done == self.batches:
            return Choice((), {"batches": done} | self.more, "enough", met=True)
        table = brdf.reduce(run)
        best = table.iloc[int(table["brdf"].to_numpy().argmax())]
        theta_r = float(best["theta_r_deg"])
        points = (canonical(30.0, 0.0, theta_r, 180.0), canonical(30.0, 0.0, round(theta_r, 2) + 1.0 + done, 180.0))
        return Choice(points, {"brdf": float(best["brdf"])} | self.more, f"batch {done}")


class Chooses:
    """What the entry point names; it collects its samplers."""

    opened: list[Brightest] = []  # noqa: RUF012

    @staticmethod
    def open(plan: Plan, description: RigDescription) -> Brightest:
        """By the one key that it knows."""
        assert plan.adaptive is not None
        own: dict[str, Any] = plan.adaptive.own
        if set(own) != {"batches"}:
            raise ConfigError(f"{plan.source}: adaptive: batches is needed")
        Chooses.opened.append(Brightest(own["batches"]))
        return Chooses.opened[-1]


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    monkeypatch.setattr(Chooses, "opened", [])
    plugins.add("gonio.choosers", "brightest", Chooses)
    return plan_in(tmp_path, PLAN)


def test_a_run_grows_until_its_chooser_has_enough(plan: Plan, tmp_path: Path) -> None:
    run = measure(plan, tmp_path / "run")
    assert [len(batch.points) for batch in run.batches] == [2, 2, 2]
    assert run.enough
    assert (len(run.planned.flags), len(run.plan)) == (3, 9)
    steps = list(run.steps())
    assert [step.step for step in steps] == list(range(len(steps)))
    assert [step.point for step in steps if step.kind == "point"] == list(range(9))
    assert [step.kind for step in steps[-3:]] == ["point", "point", "reference"], "a visit closes the batch"
    table = brdf.reduce(Run.open(tmp_path / "run"))
    assert len(table) == 9
    first = table["theta_r_deg"].round(1)
    assert (first == first[3]).sum() >= 2, "the point that was chosen again has a row of its own"
    seen = next(event for event in run.events() if event["event"] == "chosen")["why"]["brdf"]
    assert seen == pytest.approx(table["brdf"][:3].max(), rel=2e-3), (
        "later measurements of the reference move it by their noise"
    )


@pytest.mark.slow
@pytest.mark.parametrize("stopped_after", [1, 5, 6, 11])
def test_stopping_it_anywhere_changes_nothing(plan: Plan, tmp_path: Path, stopped_after: int) -> None:
    whole = measure(plan, tmp_path / "whole")
    with pytest.raises(Interrupted, match=f"after {stopped_after}|after {stopped_after + 1}"):
        measure(plan, tmp_path / "run", progress=StopAfter(stopped_after))
    resumed = measure(plan, tmp_path / "run", resume=True)
    assert list(resumed.steps()) == list(whole.steps())
    assert resumed.plan.equals(whole.plan)
    assert brdf.reduce(resumed).equals(brdf.reduce(whole))


def test_a_run_that_died_between_choice_and_line_chooses_the_same(plan: Plan, tmp_path: Path) -> None:
    whole = measure(plan, tmp_path / "run")
    journal = tmp_path / "run" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if b'"event":"chosen"' in line)
    steps, plan_before = list(whole.steps()), whole.plan
    journal.write_bytes(b"".join(lines[:at]))
    again = measure(plan, tmp_path / "run", resume=True)
    assert list(again.steps()) == steps
    assert again.plan.equals(plan_before)


def test_a_run_that_has_enough_is_done(plan: Plan, tmp_path: Path) -> None:
    measure(plan, tmp_path / "run")
    asked = Chooses.opened[-1].asked
    measure(plan, tmp_path / "run", resume=True)
    assert len(asked) == 4
    assert not Chooses.opened[-1].asked


def with_reasons(monkeypatch: pytest.MonkeyPatch, **more: Any) -> None:
    real = Chooses.open

    def opened(plan: Plan, description: RigDescription) -> Brightest:
        sampler = real(plan, description)
        sampler.more = more
        return sampler

    monkeypatch.setattr(Chooses, "open", staticmethod(opened))


def test_reasons_in_numpy_s_types_are_kept_as_plain_ones(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    more = {"n": np.int64(3), "u": np.float32(0.5), "met": np.bool_(True), "g": np.array([[1.0, np.nan]])}
    with_reasons(monkeypatch, **more, deep={np.int64(7): (np.float64("inf"), "words", None)})
    run = measure(plan, tmp_path / "run")
    kept = {"n": 3, "u": 0.5, "met": True, "g": [[1.0, None]], "deep": {"7": [None, "words", None]}}
    assert [set(batch.why) - {"brdf"} for batch in run.batches] == [set(kept)] * 3
    for batch in Run.open(tmp_path / "run").batches:
        assert {key: batch.why[key] for key in kept} == kept
    (enough,) = [event for event in run.events() if event["event"] == "enough"]
    assert enough["why"] == {"batches": 3} | kept
    assert json.loads((tmp_path / "run" / "chosen.json").read_text())[0]["why"]["n"] == 3


@pytest.mark.slow
def test_a_reason_that_no_journal_keeps_is_named_and_the_run_goes_on_when_it_is_mended(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        with_reasons(patch, deep={"seen": [1, {2}]})
        with pytest.raises(ConfigError, match=r'"brightest" gives why\[\'deep\'\]\[\'seen\'\]\[1\] = \{2\}, a set'):
            measure(plan, tmp_path / "run")
    assert not Run.open(tmp_path / "run").batches
    whole = measure(plan, tmp_path / "whole")
    assert list(measure(plan, tmp_path / "run", resume=True).steps()) == list(whole.steps())


def test_other_wishes_are_another_run(plan: Plan, tmp_path: Path) -> None:
    measure(plan, tmp_path / "run")
    (tmp_path / "other.toml").write_text(PLAN.replace("batches = 3", "batches = 4"))
    with pytest.raises(ConfigError, match="begun with something else"):
        measure(load_plan(tmp_path / "other.toml"), tmp_path / "run", resume=True)


def test_an_unknown_chooser_is_named_before_anything_moves(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.replace('"brightest"', '"oracle"'))
    with pytest.raises(ConfigError, match=r'plan\.toml: adaptive\.how: there is no sampler named "oracle"'):
        measure(load_plan(tmp_path / "plan.toml"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_lost_journal_is_made_again_with_what_was_chosen(plan: Plan, tmp_path: Path) -> None:
    whole = measure(plan, tmp_path / "run")
    table, steps = brdf.reduce(whole), list(whole.steps())
    journal = tmp_path / "run" / "journal.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(line for line in lines if b'"event":"chosen"' not in line and b'"step":7' not in line))
    repair.repair(tmp_path / "run")
    again = measure(plan, tmp_path / "run", resume=True)
    assert list(again.steps()) == steps
    assert brdf.reduce(again).equals(table)


def test_a_point_that_the_rig_cannot_reach_ends_the_run_before_the_journal_has_it(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Brightest, "next", lambda self, run: Choice((canonical(30.0, 0.0, 120.0, 180.0),)))
    rig = Plugin()
    with pytest.raises(ConfigError, match=r"the sampler named a point .*theta_r_deg = 120.*outside the limits"):
        measure(plan, tmp_path / "run", rig)
    assert rig.opened[0].log[-2:] == ["off", "park"]
    run = Run.open(tmp_path / "run")
    assert not run.batches
    assert [event["event"] for event in run.events()] == ["session"] + 6 * ["step"]
