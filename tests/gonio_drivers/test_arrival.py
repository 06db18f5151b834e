"""What single readings of a joint say of its landing, reading by reading, on a clock of the test's own."""

import math
from types import SimpleNamespace
from typing import Any, cast

import pytest
from gonio_drivers.joints import Joint, Report
from gonio_drivers.motion import Landing, Verdict

PER_DEG = 4096 / 360
"""Counts a degree."""
GOAL = 2000
LOOKS_S = 0.02
SETTLE_S = 0.09
SETS_OUT_S = 0.06 + math.sqrt(2 * 4 / (100 * PER_DEG)) + 4 / (30 * PER_DEG)
"""0.06 s until a servo follows, and four counts by 100 deg/s^2 and at 30 deg/s: an encoder flickers by three."""


def landing(**changes: Any) -> Landing:
    """A joint that shall land within 0.2 degrees of its goal."""
    speed = changes.pop("speed_deg_per_s", 30.0)
    joint = SimpleNamespace(
        counts_per_deg=-PER_DEG,  # the servo turns the other way round
        speed_deg_per_s=speed,
        distance_deg=lambda goal, position: abs(position - goal) / PER_DEG,
    )
    usual = {
        "goal": GOAL, "sent": GOAL, "within_deg": 0.2, "settle_s": SETTLE_S, "acceleration_deg_per_s2": 100.0,
        "since": 0.0,
    }  # fmt: skip
    return Landing(cast(Joint, joint), **{**usual, **changes})


def report(position: int, *, moving: bool = False, under_way: bool = False) -> Report:
    return Report(position, moving, under_way, GOAL, profile=b"", current=0, voltage_v=12.0, temperature_c=40)


def looked(of: Landing, *positions: int, start_s: float = 0.0) -> list[Verdict]:
    """The verdicts on readings that come every 20 ms."""
    return [of.look(report(position), start_s + k * LOOKS_S) for k, position in enumerate(positions)]


def first(verdicts: list[Verdict], wanted: Verdict) -> float:
    """When a verdict came first [s]; what came before was "on its way"."""
    k = verdicts.index(wanted)
    assert set(verdicts[:k]) <= {"on its way"}
    return k * LOOKS_S


def test_it_has_landed_when_it_has_stood_still_for_its_time_to_settle() -> None:
    assert first(looked(landing(), *[GOAL] * 10), "landed") == pytest.approx(0.1)


def test_five_readings_are_needed_however_short_the_time() -> None:
    assert first(looked(landing(settle_s=0.0), *[GOAL] * 10), "landed") == pytest.approx(4 * LOOKS_S)


def test_a_slow_axis_is_given_the_time_of_four_counts() -> None:
    assert first(looked(landing(speed_deg_per_s=1.0), *[GOAL] * 30), "landed") == pytest.approx(
        0.36
    )  # 4 / 11.4 = 0.352


@pytest.mark.parametrize(("away", "verdict"), [(2, "landed"), (3, "short")])
def test_the_tolerance_is_in_degrees(away: int, verdict: Verdict) -> None:
    # 2 counts are 0.18 degrees, 3 are 0.26
    assert first(looked(landing(), *[GOAL - away] * 20), verdict) > 0.0


def test_one_that_stands_beside_its_goal_is_short_when_it_has_had_time_to_set_out() -> None:
    assert 0.15 < SETS_OUT_S < 0.16
    assert first(looked(landing(), *[GOAL - 10] * 20), "short") == pytest.approx(0.16)


@pytest.mark.parametrize(
    ("away", "corrected", "verdict"),
    [(22, 0, "short"), (23, 0, "stuck"), (10, 12, "short"), (10, 13, "stuck"), (10, -12, "short"), (10, -13, "stuck")],
)
def test_corrections_are_asked_for_up_to_two_degrees_in_all(away: int, corrected: int, verdict: Verdict) -> None:
    """22.8 counts: from where it stands to its goal, and from there to what it was told."""
    verdicts = looked(landing(sent=GOAL + corrected), *[GOAL - away] * 40)
    # one that is stuck has been at rest for more than half a second
    assert first(verdicts, verdict) == pytest.approx(0.16 if verdict == "short" else 0.52)


def test_the_fourth_correction_is_the_last() -> None:
    assert "short" in looked(landing(corrections=3), *[GOAL - 10] * 40)
    assert first(looked(landing(corrections=4), *[GOAL - 10] * 40), "stuck") == pytest.approx(0.52)


def test_few_readings_are_not_enough_to_be_stuck() -> None:
    of = landing(corrections=4)
    verdicts = [of.look(report(GOAL - 10), float(k)) for k in range(12)]  # seconds apart
    assert first(verdicts, "stuck") == pytest.approx(10 * LOOKS_S)  # the eleventh


def test_a_motion_begins_everything_anew() -> None:
    of = landing()
    looked(of, *[GOAL] * 4)
    assert of.look(report(GOAL, moving=True), 0.08) == "on its way"
    assert of.seen == [GOAL]
    assert first(looked(of, *[GOAL] * 10, start_s=0.1), "landed") == pytest.approx(0.08)  # 0.09 s after the motion


def test_a_profile_that_goes_on_is_no_rest() -> None:
    of = landing()
    assert {of.look(report(GOAL, under_way=True), k * LOOKS_S) for k in range(20)} == {"on its way"}
    assert first(looked(of, *[GOAL] * 10, start_s=0.4), "landed") == pytest.approx(0.08)  # 0.09 s after 0.38


def test_a_profile_that_goes_on_without_a_motion_is_stuck_in_half_a_second() -> None:
    of = landing(since=1.0)
    verdicts = [of.look(report(GOAL, under_way=True), 1.0 + k * LOOKS_S) for k in range(40)]
    assert first(verdicts, "stuck") == pytest.approx(0.52)


@pytest.mark.parametrize(("step", "lands"), [(3, True), (4, False)])
def test_readings_within_three_counts_are_one_place(step: int, lands: bool) -> None:
    assert ("landed" in looked(landing(), *[GOAL - step, GOAL] * 3)) is lands


def test_an_encoder_that_trembles_lands_by_the_mean_of_its_readings() -> None:
    of = landing()
    # five early readings and five late ones, with 0.09 s in between: 0.08 + 0.1 + 0.08
    assert first(looked(of, *[GOAL - 5, GOAL + 5] * 10), "landed") == pytest.approx(0.26)
    assert of.position == GOAL


def test_a_mean_that_is_not_known_well_enough_waits_for_more_readings() -> None:
    """0.26 degrees beside the goal, with a tolerance of 0.2: 20 readings that scatter by 5 counts have u = 0.098."""
    assert first(looked(landing(), *[GOAL + 3 - 5, GOAL + 3 + 5] * 12), "short") == pytest.approx(19 * LOOKS_S)


def test_a_mean_far_from_the_goal_needs_no_more_readings() -> None:
    verdicts = looked(landing(), *[GOAL + 12 - 5, GOAL + 12 + 5] * 12)  # 1.05 degrees
    assert first(verdicts, "short") == pytest.approx(0.26)


def test_one_that_trembles_far_from_its_goal_is_stuck_in_half_a_second() -> None:
    verdicts = looked(landing(corrections=4), *[GOAL + 12 - 5, GOAL + 12 + 5] * 20, start_s=1.0)
    assert first(verdicts, "stuck") == pytest.approx(0.52)


def test_where_the_means_differ_the_oldest_reading_is_forgotten() -> None:
    of = landing()
    drifting = [GOAL + 5 * (-1) ** k + 2 * k for k in range(40)]
    assert set(looked(of, *drifting)) == {"on its way"}
    assert len(of.calm) < 20


def test_the_place_is_the_mean_of_the_last_five_readings() -> None:
    of = landing()
    looked(of, GOAL - 3, GOAL, GOAL - 1, GOAL - 1, GOAL - 1, GOAL - 2)
    assert of.position == GOAL - 1.0


def test_one_that_stops_by_itself_may_go_on_while_it_comes_closer() -> None:
    of = landing()
    assert of.stopped_at(GOAL - 22, 1.0)  # within two degrees: nothing is lost
    assert of.released == 0
    assert not of.stopped_at(GOAL - 400, 1.0)
    assert (of.released, of.closest, of.since) == (1, 400, 1.0)
    assert not of.stopped_at(GOAL - 397, 2.0)  # no closer than the flicker
    assert (of.released, of.closest) == (2, 397)
    assert not of.stopped_at(GOAL + 300, 3.0)
    assert (of.released, of.closest, of.since) == (1, 300, 3.0)
    assert not of.stopped_at(GOAL + 350, 4.0)
    assert (of.released, of.closest) == (2, 300)
