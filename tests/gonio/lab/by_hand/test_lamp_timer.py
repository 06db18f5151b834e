"""The lamp is dark unless somebody keeps it lit; time is the test's own."""

from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from gonio.errors import DeviceError
from gonio.lab.by_hand.lamp_timer import GUARD_S, OWNER_S, DeadMansTimer, LampTimeOver
from gonio.lab.rig.light_and_camera import Band


@dataclass
class Clock:
    now: float = 1000.0

    def __call__(self) -> float:
        return self.now


@dataclass
class Plain:
    """A lamp that has the protocol's methods alone."""

    lit: bool = True
    fails: bool = False

    def select(self, band: Band) -> None: ...

    def on(self) -> None:
        self.lit = True

    def off(self) -> None:
        if self.fails:
            raise DeviceError("the lamp does not answer")
        self.lit = False


@dataclass
class Serial(Plain):
    """A lamp as the laboratory's driver has it."""

    allowed: Callable[[], None] = lambda: None
    told: list[float] = field(default_factory=list)

    def darken_at_once(self) -> None:
        self.lit = False

    def off(self) -> None:
        raise AssertionError("the watch talks to it by darken_at_once alone: its owner may be in the middle of a line")

    def keep(self, seconds: float) -> None:
        self.told.append(seconds)


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_a_sign_of_life_keeps_it_lit_and_lights_nothing(clock: Clock) -> None:
    timer = DeadMansTimer(Plain(), 60.0, clock)
    timer.keep()
    with pytest.raises(LampTimeOver):
        timer.require()
    timer.light_up()
    clock.now += 59.0
    assert timer.left_s == 1.0
    timer.keep()
    assert timer.left_s == 60.0
    timer.require()
    clock.now += 60.0
    assert timer.left_s == 0.0
    timer.keep()  # too late
    assert timer.over
    with pytest.raises(LampTimeOver):
        timer.require()


@pytest.mark.parametrize("kind", [Plain, Serial])
def test_the_watch_darkens_it_where_the_owner_does_not(clock: Clock, kind: type[Plain]) -> None:
    light = kind()
    timer = DeadMansTimer(light, 60.0, clock)
    timer.light_up()
    clock.now += 60.0
    timer.look()
    assert light.lit, "the owner is given a moment"
    clock.now += OWNER_S
    timer.look()
    assert not light.lit
    assert (timer.left_s, timer.why_dark) == (None, "its time is over")


@pytest.mark.parametrize("kind", [Plain, Serial])
def test_a_camera_that_does_not_come_back_darkens_it_before_its_time(clock: Clock, kind: type[Plain]) -> None:
    light = kind()
    timer = DeadMansTimer(light, 600.0, clock)
    timer.light_up()
    with timer.within(5.0, "the camera"):
        clock.now += 4.9
        timer.look()
        assert light.lit
        clock.now += 0.2
        timer.look()
        assert not light.lit
    assert timer.why_dark == "the camera does not come back"
    timer.keep()
    assert timer.left_s is None, "no key press lights it again"


def test_a_camera_that_comes_back_in_time_is_left_alone(clock: Clock) -> None:
    light = Plain()
    timer = DeadMansTimer(light, 600.0, clock)
    timer.light_up()
    with timer.within(5.0, "the camera"):
        clock.now += 4.9
    clock.now += 100.0
    timer.look()
    assert light.lit


def test_a_lamp_that_cannot_be_darkened_leaves_that_to_its_owner(clock: Clock) -> None:
    timer = DeadMansTimer(Plain(fails=True), 60.0, clock)
    timer.light_up()
    clock.now += 61.0
    timer.look()
    assert timer.why_dark == "its time is over"  # by which the owner knows that it has to look


def test_a_driver_may_not_light_it_again_by_itself(clock: Clock) -> None:
    def tripped() -> None:
        raise DeviceError("the interlock is open")

    light = Serial(allowed=tripped)
    before = light.allowed
    timer = DeadMansTimer(light, 60.0, clock)
    with timer, pytest.raises(DeviceError, match="the interlock is open"):
        light.allowed()
    assert light.allowed is before
    light.allowed = before = lambda: None
    with timer:
        with pytest.raises(LampTimeOver):
            light.allowed()
        timer.light_up()
        light.allowed()
        clock.now += 60.0
        with pytest.raises(LampTimeOver):
            light.allowed()
    assert light.allowed is before


def test_the_drivers_guard_is_told_of_every_sign_of_life(clock: Clock) -> None:
    light = Serial()
    timer = DeadMansTimer(light, 60.0, clock)
    timer.light_up()
    clock.now += 10.0
    timer.keep()
    clock.now += 100.0
    timer.keep()
    assert light.told == [60.0 + GUARD_S, 60.0 + GUARD_S]
