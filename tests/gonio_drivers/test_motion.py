"""What is decided on a way to a goal: where the approach begins, corrections, durations; no bus, and no waiting."""

from types import SimpleNamespace
from typing import Any, cast

import pytest
from gonio_drivers import joints, motion
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint, Report
from gonio_drivers.motion import Landing
from gonio_drivers.settings import Servos

from gonio.errors import DeviceError
from tests.gonio_drivers.test_joints import joint

PER_DEG = 4096 / 360
TOLERANCE_DEG = 0.3


class Bench(motion.Motion):
    """Records what is sent and where axes are driven; nothing turns."""

    def __init__(self, of: Joint) -> None:
        servos = SimpleNamespace(tolerance_deg=TOLERANCE_DEG, settle_s=0.1, acceleration_deg_per_s2=90.0)
        super().__init__(cast(Bus, None), {of.name: of}, cast(Servos, servos), lambda: None)
        self.sent: list[int] = []
        self.driven: list[tuple[float, bool]] = []

    def send(self, counts: Any) -> None:
        self.sent += counts.values()

    def _land(self, goals: Any, *, exact: bool) -> None:
        self.driven += [(goal, exact) for goal in goals.values()]


def landing(of: Joint, goal: float, stands: int, sent: int | None = None) -> Landing:
    """An axis that stands still somewhere."""
    out = Landing(of, goal, round(goal) if sent is None else sent, 0.3, 0.1, 90.0, since=0.0)
    out.seen = [stands] * 5
    return out


# ---- the approach ----


@pytest.fixture
def stands(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Sets where the axis stands; the watchdog has not run out."""

    def at(of: Joint, position: int, *, run_out: bool = False) -> None:
        rest = {"profile": of.profile, "current": 0, "voltage_v": 12.0, "temperature_c": 40}
        seen = Report(position, moving=False, under_way=False, goal=position, **rest)  # type: ignore[arg-type]
        monkeypatch.setattr(joints, "reports", lambda bus, every: {of.name: seen})
        monkeypatch.setattr(motion, "watchdog", SimpleNamespace(
            arm=lambda moving: None, call_off=lambda moving: moving if run_out else []))  # fmt: skip
        monkeypatch.setattr(Joint, "send_profile", lambda self: None)

    return at


@pytest.mark.parametrize(
    ("approach", "beyond_deg", "both"),
    [
        (2.0, 0.4, True),
        (2.0, 0.2, False),  # within the tolerance of where the last part begins
        (2.0, -5.0, False),
        (-2.0, -0.4, True),
        (-2.0, -0.2, False),
        (-2.0, 5.0, False),
        (0.0, 5.0, False),  # either side is as good
        (0.0, -5.0, False),
    ],
)
@pytest.mark.parametrize("direction", [1, -1])
def test_a_goal_is_come_to_from_its_side(
    approach: float, beyond_deg: float, both: bool, direction: int, stands: Any
) -> None:
    """`beyond_deg`: how far above the beginning of the last part it stands."""
    of = joint({"approach_deg": approach}, direction=direction)
    goal = of.to_count(10.0)
    start = of.approach_start(goal)
    stands(of, round(start + beyond_deg * of.counts_per_deg))
    bench = Bench(of)
    bench.approach({of.name: 10.0})
    assert bench.driven == [*([(start, False)] if both else []), (goal, True)]
    assert of.landed_at == goal


@pytest.mark.parametrize(("off_deg", "moves"), [(0.2, False), (0.4, True)])
def test_an_axis_that_has_landed_there_stays(off_deg: float, moves: bool, stands: Any) -> None:
    of = joint()
    of.landed_at = of.to_count(10.0)
    stands(of, round(of.landed_at - off_deg * PER_DEG))
    bench = Bench(of)
    bench.approach({of.name: 10.0})
    assert bool(bench.driven) is moves


def test_axes_whose_watchdog_ran_out_are_landed_once_more(stands: Any) -> None:
    of = joint()
    stands(of, 0, run_out=True)
    bench = Bench(of)
    bench.approach({of.name: 10.0})
    assert bench.driven == [(of.to_count(10.0), True)] * 2


@pytest.mark.parametrize(("gear", "tolerance_deg"), [(1.0, TOLERANCE_DEG), (0.25, 1.5 * 360 / 4096 / 0.25)])
def test_a_tolerance_is_one_and_a_half_counts_at_least(gear: float, tolerance_deg: float) -> None:
    of = joint(gear_ratio=gear)
    assert Bench(of)._tolerance(of) == pytest.approx(tolerance_deg)


@pytest.mark.parametrize(("exact", "within_deg"), [(True, TOLERANCE_DEG), (False, 1.0)])
def test_the_beginning_of_the_last_part_needs_half_of_its_way(exact: bool, within_deg: float) -> None:
    of = joint()  # an approach of 2 degrees
    assert Bench(of)._landing(of.name, of.to_count(10.0), exact=exact).within_deg == within_deg


def test_a_way_takes_its_time_at_full_speed_and_twice_the_time_to_get_there() -> None:
    of = joint()
    of.speed_deg_per_s = 30.0
    assert Bench(of).duration_s(of.name, 1000.0, 1000.0 + 60.0 * PER_DEG) == pytest.approx(60 / 30 + 2 * 30 / 90)


# ---- corrections ----


@pytest.mark.parametrize("stood", [1990, 1997])
def test_a_correction_makes_up_for_what_is_missing(stood: int) -> None:
    of, bench = joint(), Bench(joint())
    way = landing(of, 2000.0, stood)
    bench._correct(of, way, 7.0, exact=True)
    assert (way.sent, way.corrections, bench.sent) == (2000 + 2000 - stood, 1, [2000 + 2000 - stood])
    assert (way.since, way.seen) == (7.0, [])
    assert bench.driven == []


@pytest.mark.parametrize(
    ("approach", "direction", "stood", "again"),
    [
        (2.0, 1, 2010, True),
        (2.0, 1, 1990, False),
        (-2.0, 1, 1990, True),
        (-2.0, 1, 2010, False),
        (2.0, -1, 1990, True),
        (2.0, -1, 2010, False),
    ],
)
def test_one_that_went_too_far_comes_again(approach: float, direction: int, stood: int, again: bool) -> None:
    of = joint({"approach_deg": approach}, direction=direction)
    bench = Bench(of)
    bench._correct(of, landing(of, 2000.0, stood), 0.0, exact=True)
    assert bench.driven == ([(of.approach_start(4000 - stood), False)] if again else [])
    bench._correct(of, landing(of, 2000.0, stood), 0.0, exact=False)
    assert len(bench.driven) == int(again), "only the last part has a side"


def test_a_correction_goes_twelve_counts_beyond_a_limit_and_no_further() -> None:
    """The upper limit is 50 degrees: count 2568.9."""
    of = joint()
    bench, goal = Bench(of), of.to_count(50.0)
    for stood, sent in ((2563, 2568 + 6), (2550, 2568 + 12)):
        way = landing(of, goal, stood)
        way.sent = 2568
        bench._correct(of, way, 0.0, exact=True)
        assert way.sent == sent
    way = landing(of, goal, 2550)
    way.sent = 2568
    bench._correct(of, way, 0.0, exact=False)
    assert (way.sent, way.done) == (2568, True), "the beginning of the last part needs no more"


@pytest.mark.parametrize(("stood", "done"), [(2560, True), (2550, False)])
def test_at_the_end_of_what_is_allowed_friction_is_put_up_with(stood: int, done: bool) -> None:
    of = joint()
    way = landing(of, of.to_count(50.0), stood, sent=2580)
    bench = Bench(of)
    bench._correct(of, way, 0.0, exact=True)
    assert (way.done, bench.sent) == (done, [])


def test_counts_of_the_servo_are_never_left() -> None:
    of = joint()
    of.count_limits = (0, 2565)
    way = landing(of, 2565.0, 2560)
    Bench(of)._correct(of, way, 0.0, exact=True)
    assert (way.sent, way.done) == (2565, True)


# ---- what ends a way ----


def test_a_servo_that_stops_four_times_and_comes_no_closer_never_arrives() -> None:
    of = joint()
    way = landing(of, 2000.0, 1000)
    way.released = 3
    motion.Motion._require_progress(of, way)
    way.released = 4
    with pytest.raises(DeviceError, match="has stopped 4 times"):
        motion.Motion._require_progress(of, way)


def test_a_goal_is_sent_again_three_times() -> None:
    of, written = joint(), []
    object.__setattr__(of, "write", lambda name, value: written.append((name, value)))
    way = landing(of, 2000.0, 1000)
    for k in range(3):
        Bench(of)._send_again(of, way, float(k))
    assert written == [("Goal Position", 2000)] * 3
    with pytest.raises(DeviceError, match="does not keep its goal"):
        Bench(of)._send_again(of, way, 3.0)
