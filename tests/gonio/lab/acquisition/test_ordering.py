"""Orders that save travel: never worse than the plan's, of the same points, and the one that a run was begun with."""

import itertools
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.errors import ConfigError, Interrupted
from gonio.lab.acquisition import duration
from gonio.lab.acquisition.duration import SAME_PLACE, SETTLE_S, Durations, approach_starts, ordered
from gonio.lab.acquisition.plan import Plan, Point, assess, load_plan
from gonio.lab.acquisition.schedule import Schedule, reference_pose, schedule
from gonio.lab.rig import Pose, _short_path
from gonio.lab.rig.description import Acquisition, Body, Reference, RigDescription
from tests.gonio.numpy_rig import BANDS, StopAfter, describe, measured, plan_in

ROUNDING = 1e-9
"""Of sums of seconds."""
HEAD = 'name = "p"\nwavelength_nm = [550]\norder = "short"\n'


def plan_of(points: list[Point], order: str = "short") -> Plan:
    return Plan("p", (550.0,), tuple(points), 0, "test", order=order)  # type: ignore[arg-type]


def scattered(seed: int, count: int) -> list[Point]:
    rng = np.random.default_rng(seed)
    angles = np.stack([rng.uniform(0, 80, count), rng.uniform(0, 85, count), rng.uniform(0, 360, count)], axis=1)
    return [Point(i, 0.0, r, p) for i, r, p in angles.round(3).tolist()]


def in_order(plan: Plan, description: RigDescription) -> Plan:
    durations, points = Durations(description, BANDS[:1]), assess(plan, description)
    found, seen = ordered(plan, points, durations, reference_pose(description), description.reference.every)
    assert [a.point for a in seen] == list(found.points)
    return found


def total_s(plan: Plan, description: RigDescription) -> float:
    return Durations(description, BANDS[:1]).parts(schedule(plan, description)).total_s


angles = st.lists(st.floats(-1.4, 1.4), min_size=4, max_size=4)


@given(angles, angles, st.sampled_from([1.0, -2.0, 0.0]))
def test_the_compiled_move_takes_as_long_as_the_plain_one(start: list[float], goal: list[float], side: float) -> None:
    durations = Durations(describe(acquisition=Acquisition(approach_deg=side)), BANDS[:1])
    at = np.array([start, goal])
    begin = approach_starts(at, durations.approach, durations.limits)
    found = _short_path.move_s(at, begin, durations.speed, np.sign(durations.approach), SETTLE_S, SAME_PLACE, 0, 1)
    assert found == pytest.approx(durations.move_s(Pose(*start), Pose(*goal)), abs=ROUNDING)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 40), st.sampled_from([0, 1, 7]))
def test_no_order_is_worse_than_the_one_of_the_plan(seed: int, count: int, every: int) -> None:
    description, plan = describe(reference=Reference(every=every, frames=2)), plan_of(scattered(seed, count))
    short = in_order(plan, description)
    assert Counter(short.points) == Counter(plan.points)
    assert total_s(short, description) <= total_s(plan, description) + ROUNDING
    assert in_order(plan, description) == short  # again the same


def test_a_shuffled_scan_is_put_in_order() -> None:
    """From one end to the other costs two long moves and short ones between; shuffled it is a long move each."""
    points = [Point(30.0, 0.0, float(r), 180.0) for r in np.random.default_rng(3).permutation(np.arange(0, 80))]
    description = describe(reference=Reference(every=0))
    short = in_order(plan_of(points), description)
    camera = [math.degrees(s.pose.camera) for s in schedule(short, description) if s.kind == "point"]
    assert sum(1 for a, b, c in zip(camera, camera[1:], camera[2:], strict=False) if (b - a) * (c - b) < 0) <= 2
    durations = Durations(description, BANDS[:1])
    travel_s = [durations.parts(schedule(p, description)).travel_s for p in (short, plan_of(points))]
    assert travel_s[0] < 0.5 * travel_s[1]


def test_points_that_cannot_be_measured_come_last_and_keep_their_reason() -> None:
    points = [Point(30.0, 0.0, 30.0, 0.0), *scattered(5, 12), Point(90.0, 0.0, 10.0, 180.0)]
    description = describe()
    plan = plan_of(points)
    found, seen = ordered(
        plan, assess(plan, description), Durations(description, BANDS[:1]), reference_pose(description), 3
    )
    lost = [a for a in seen if a.pose is None]
    assert lost == list(seen[-len(lost) :])
    assert {a.flag for a in lost} >= {"blocked", "grazing"}
    assert [a.point for a in lost] == [p for p in points if p in {a.point for a in lost}]
    assert Counter(found.points) == Counter(points)


def test_visits_to_one_point_stay_spread_over_the_run(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(
        HEAD + "[[hemisphere]]\ntheta_i_deg = [30]\ncount = 40\ntheta_r_max_deg = 70\nrepeats = 4\n"
    )
    plan, description = load_plan(tmp_path / "plan.toml"), describe()
    short = in_order(plan, description)
    for point in set(short.points):
        rows = [k for k, other in enumerate(short.points) if other == point and k < 4 * 38]
        assert all(later - earlier > 20 for earlier, later in itertools.pairwise(rows))
    assert total_s(short, description) <= total_s(plan, description)


def test_ways_around_bodies_are_what_is_compared() -> None:
    body = Body(name="cover", on="light", from_mm=(0, -150, 250), to_mm=(0, 150, 250), radius_mm=20)
    description = describe(bodies=(body, body.model_copy(update={"name": "lens", "on": "camera"})))
    plan = plan_of(scattered(11, 14))
    assert total_s(in_order(plan, description), description) <= total_s(plan, description) + ROUNDING


def test_without_the_key_the_order_is_the_plan_s() -> None:
    plan = plan_of(scattered(1, 20), "as-written")
    assert in_order(plan, describe()) is plan


def folder(tmp_path: Path) -> Plan:
    rows = "".join(f"{p.theta_i_deg},{p.phi_i_deg},{p.theta_r_deg},{p.phi_r_deg}\n" for p in scattered(8, 9))
    (tmp_path / "points.csv").write_text("theta_i_deg,phi_i_deg,theta_r_deg,phi_r_deg\n" + rows)
    return plan_in(tmp_path, HEAD + 'reference_every = 4\n[[points]]\nfile = "points.csv"\nrepeats = 2\n')


def test_a_resumed_run_goes_on_in_the_order_that_it_was_begun_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = folder(tmp_path)
    whole = measured(plan, tmp_path / "whole")
    with pytest.raises(Interrupted):
        measured(plan, tmp_path / "cut", progress=StopAfter(7))
    before = (tmp_path / "cut" / "plan.csv").read_bytes()

    def another(*arguments: object) -> object:
        raise AssertionError("the order is that of plan.csv")

    monkeypatch.setattr(duration, "ordered", another)
    resumed = measured(plan, tmp_path / "cut", resume=True)
    assert (tmp_path / "cut" / "plan.csv").read_bytes() == before == (tmp_path / "whole" / "plan.csv").read_bytes()
    assert list(resumed.steps()) == list(whole.steps())
    points = [step.point for step in whole.steps() if step.point is not None]
    assert points == sorted(points)  # rows of plan.csv are in the order of measurement


def test_a_resumed_run_refuses_other_points(tmp_path: Path) -> None:
    plan = folder(tmp_path)
    with pytest.raises(Interrupted):
        measured(plan, tmp_path / "cut", progress=StopAfter(3))
    (tmp_path / "points.csv").write_text((tmp_path / "points.csv").read_text() + "1,2,3,4\n")
    with pytest.raises(ConfigError, match="are not those of"):
        measured(load_plan(tmp_path / "plan.toml"), tmp_path / "cut", resume=True)


def test_a_plan_may_say_how_often_the_reference_is_visited(tmp_path: Path) -> None:
    run = measured(folder(tmp_path), tmp_path / "run")
    kinds = [step.kind for step in run.steps()]
    assert run.description.reference.every == 4
    reached = kinds.count("point")
    assert kinds.count("reference") == 1 + -(-reached // 4)
    assert kinds[2:7] == ["point"] * 4 + ["reference"]
    assert len(run.steps()) == len(Schedule(run.description, range(reached), lambda row: Pose()))
    (tmp_path / "plan.toml").write_text((tmp_path / "plan.toml").read_text().replace("= 4", "= 5"))
    with pytest.raises(ConfigError, match=r"rig\.reference\.every: 4 in the run, 5 now"):
        measured(load_plan(tmp_path / "plan.toml"), tmp_path / "run", resume=True)
