"""The time that is left of a run: learnt from steps whose true times are drawn, and compared with what comes then."""

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import Interrupted
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.progress import PRIOR, Remaining, Silent, TimeLeft, ratio
from gonio.lab.acquisition.records import FrameRecord, StepRecord
from gonio.lab.acquisition.schedule import schedule
from gonio.lab.commands.progress import time_left
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import Reference
from tests.gonio.numpy_rig import BANDS, SAMPLE, Plugin, StopAfter, describe, measured, plan_in

RIG = describe(reference=Reference(every=20, frames=4))
DURATIONS = Durations(RIG, BANDS[:1])
parts_of = functools.cache(DURATIONS.step)


def steps_of(count: int) -> list[Step]:
    rng = np.random.default_rng(7)
    rows = zip(rng.uniform(0, 70, count), rng.uniform(0, 70, count), rng.uniform(60, 300, count), strict=True)
    points = tuple(Point(float(i), 0.0, float(r), float(p)) for i, r, p in rows)
    return schedule(Plan("p", (550.0,), points, 0, "test"), RIG)


def records(
    steps: Sequence[Step], travel: float, frames: float, scatter: float, seed: int
) -> tuple[list[StepRecord], list[float]]:
    """What a bench writes that is slower than its file by two factors, and how long each step took there."""
    rng, now, here = np.random.default_rng(seed), 1000.0, Pose()
    out, took = [], []
    for step in steps:
        parts, noise = parts_of(here, step), np.exp(scatter * rng.standard_normal(2))
        begun = now
        pose_s = now = now + travel * parts.travel_s * float(noise[0])
        shot = FrameRecord("f", "b", 0.0, now, True)
        now += frames * (parts.total_s - parts.travel_s) * float(noise[1])
        record = StepRecord(
            step=step.index, kind=step.kind, point=step.point, time_s=pose_s, goal=step.pose, pose=step.pose,
            pose_time_s=pose_s, flag="", frames=(shot,),
        )  # fmt: skip
        if step.kind == "dark":
            out.append(replace(record, frames=(shot, replace(shot, time_s=now)), pose_time_s=now))
        else:
            out.append(replace(record, pose_after=step.pose, pose_after_time_s=now))
            here = step.pose
        took.append(now - begun)
    return out, took


def learnt(steps: Sequence[Step], taken: Sequence[StepRecord]) -> Remaining:
    """What is left after some of the steps."""
    remaining = Remaining(DURATIONS, steps, (), simulated=False)
    for record in taken:
        remaining.took(record)
    return remaining


def left(remaining: Remaining) -> TimeLeft:
    found = remaining.left
    assert found is not None
    return found


def test_before_anything_is_measured_it_is_the_rig_file_s_time_and_unsure() -> None:
    steps = steps_of(60)
    found = left(Remaining(DURATIONS, steps, (), simulated=False))
    assert found.seconds == pytest.approx(DURATIONS.parts(steps).total_s, rel=1e-9)  # rounding of sums
    assert 0.2 < found.u_seconds / found.seconds < PRIOR + 0.1


def test_travel_and_frames_are_learnt_apart() -> None:
    """By a third of the run the rest is known within 3 %, where one common factor would be off by 20 % and more."""
    steps = steps_of(120)
    taken, took = records(steps, travel=2.0, frames=0.5, scatter=0.1, seed=1)
    remaining = learnt(steps, taken[:40])
    assert left(remaining).seconds == pytest.approx(sum(took[40:]), rel=0.03)
    assert left(remaining).u_seconds < 0.1 * left(remaining).seconds
    for record in taken[40:]:
        remaining.took(record)
    assert left(remaining) == TimeLeft(0.0, 0.0)


def test_its_uncertainty_is_honest() -> None:
    """Of 60 runs whose steps scatter by 30 %, at least two thirds end within one, and all but few within two."""
    steps, off = steps_of(60), []
    for seed in range(60):
        taken, took = records(steps, travel=1.5, frames=1.3, scatter=0.3, seed=seed)
        found = left(learnt(steps, taken[:25]))
        off.append((sum(took[25:]) - found.seconds) / found.u_seconds)
    assert np.mean(np.abs(off) < 1.0) > 0.68
    assert np.mean(np.abs(off) < 2.0) > 0.95


def test_somebody_at_the_rig_for_an_hour_changes_little() -> None:
    steps = steps_of(80)
    taken, took = records(steps, travel=1.0, frames=1.0, scatter=0.05, seed=2)
    late = [
        r
        if k < 15
        else replace(
            r,
            pose_time_s=(r.pose_time_s or 0.0) + 3600.0,
            pose_after_time_s=None if r.pose_after_time_s is None else r.pose_after_time_s + 3600.0,
        )
        for k, r in enumerate(taken)
    ]
    assert left(learnt(steps, late[:40])).seconds == pytest.approx(sum(took[40:]), rel=0.1)


def test_a_few_steps_stand_for_those_of_a_long_run() -> None:
    steps = steps_of(3000)
    found = left(Remaining(DURATIONS, steps, (), simulated=False))
    assert found.seconds == pytest.approx(DURATIONS.parts(steps).total_s, rel=0.1)  # 256 of them, each of 50 % scatter
    nearly = Remaining(DURATIONS, steps, range(len(steps) - 10), simulated=False)
    expected = sum(DURATIONS.step(a.pose, b).total_s for a, b in zip(steps[-11:], steps[-10:], strict=False))
    assert left(nearly).seconds == pytest.approx(expected, rel=1e-9)


def test_on_a_simulated_rig_the_clock_on_the_wall_counts() -> None:
    steps = steps_of(60)
    taken, _ = records(steps, 1.0, 1.0, 0.0, seed=3)
    remaining = Remaining(DURATIONS, steps, (), simulated=True)
    assert remaining.left is None  # how fast the computer is nobody knows
    for record in taken[:30]:
        remaining.took(record, 3.0 if record.kind == "dark" else 0.5 if record.kind == "reference" else 0.2)
    kinds = [step.kind for step in steps[30:]]
    assert left(remaining).seconds == pytest.approx(0.5 * kinds.count("reference") + 0.2 * kinds.count("point"))


def test_on_a_simulated_rig_the_first_step_of_a_kind_says_nothing() -> None:
    """It loads and compiles what the others find there: 24 minutes were told of a run of two."""
    steps = steps_of(60)
    taken, _ = records(steps, 1.0, 1.0, 0.0, seed=3)
    remaining, seen = Remaining(DURATIONS, steps, (), simulated=True), set[str]()
    for record in taken[:30]:
        remaining.took(record, 0.2 if record.kind in seen else 20.0)
        seen.add(record.kind)
        found = remaining.left
        assert (found is None) == (record.step < 3)  # dark, reference, a point
        if found is not None:
            assert found.seconds == pytest.approx(0.2 * (len(steps) - record.step - 1))


def test_steps_that_are_chosen_later_are_taken_for_such_as_were() -> None:
    steps = steps_of(40)
    taken, took = records(steps, travel=1.0, frames=1.0, scatter=0.0, seed=4)
    remaining = learnt(steps, taken)
    remaining.more(10)
    assert left(remaining).seconds == pytest.approx(10 * sum(took[1:]) / len(took[1:]), rel=0.5)  # as mixed as they are


def test_a_ratio_is_that_of_sums_and_not_of_one_wild_step() -> None:
    expected = [1.0, 1.0, 1.0, 10.0] * 50
    assert ratio(expected, [2.0 * x for x in expected]).value == pytest.approx(2.0, rel=0.01)
    wild = [2.0 * x for x in expected]
    wild[8] = 1e5
    assert ratio(expected, wild).value == pytest.approx(2.0, rel=0.02)
    assert ratio([], []).value == 1.0
    assert ratio([0.0, 1.0], [0.3, 1.0]) == ratio([1.0], [1.0])  # a travel of nothing takes its settling


class Watching(Silent):
    """Somebody who asks after every step."""

    def __init__(self) -> None:
        self.said: list[str] = []
        self.remaining: Remaining | None = None

    def expects(self, remaining: Remaining) -> None:
        self.remaining = remaining
        self.said.append(time_left(remaining.left))

    def step(self, live: object) -> None:
        assert self.remaining is not None
        self.remaining.took(live.record, 60.0)  # type: ignore[attr-defined]
        self.said.append(time_left(self.remaining.left))


@pytest.mark.parametrize("repeatable", [True, False])
def test_a_measurement_tells_how_long_it_goes_on(tmp_path: Path, repeatable: bool) -> None:
    watching, plan = Watching(), plan_in(tmp_path)
    rig, sample = Plugin(options={"repeatable": repeatable}), SAMPLE if repeatable else None
    how: dict[str, Any] = {"rig": rig, "sample": sample, "yes": True}
    with pytest.raises(Interrupted):
        measured(plan, tmp_path / "r", **how, progress=StopAfter(4))
    measured(plan, tmp_path / "r", **how, progress=watching, resume=True)
    assert watching.said[-1] == "0 s left"
    assert (watching.said[0] == "") == repeatable
    if repeatable:
        told = [text for text in watching.said[1:] if text]
        assert watching.said[1] == ""  # the first of its kind
        assert told[0].startswith("60 s")  # one step is left, of a minute


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (None, ""),
        (TimeLeft(12000.0, 600.0), "3 h 20 min ± 10 min left"),
        (TimeLeft(12000.0, 20.0), "3 h 20 min left"),
        (TimeLeft(0.4, 0.4), "0 s left"),
    ],
)
def test_time_left_in_words(found: TimeLeft | None, words: str) -> None:
    assert time_left(found) == words
