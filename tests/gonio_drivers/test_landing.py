"""Landings on a computer that is held up: judged by what was seen, on a clock that nobody waits for."""

import random
from collections.abc import Callable, Iterator

import pytest
from gonio_drivers import motion, watchdog
from gonio_drivers.arms import ServoArms
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.peer import scaled_clock
from gonio_sim.wire.servo import Mechanics, Servo

from gonio.errors import DeviceError
from tests.gonio_drivers.conftest import BAUD
from tests.gonio_drivers.servo_arms import COUNT_DEG, TOLERANCE_DEG, degrees, describe, pose, servos
from tests.gonio_drivers.virtual import PORT, VirtualClock, servo_bus

Bench = tuple[VirtualClock, ServoBus]


def built() -> list[Servo]:
    """Three servos with some friction, that answer at once."""
    clock = scaled_clock(1.0)
    out = [Servo(k, clock, model="xm430-w350", baud=BAUD, mechanics=Mechanics(short_counts=4.0)) for k in (1, 2, 3)]
    for servo in out:
        servo.write(9, b"\x00")
    return out


@pytest.fixture
def bench(hours: VirtualClock) -> Bench:
    return hours, servo_bus(built)


@pytest.fixture
def arms(bench: Bench) -> Iterator[ServoArms]:
    with ServoArms(describe(), servos(PORT)) as opened:
        yield opened


def at(line: ServoBus, k: int) -> float:
    """Where a shaft stands [deg]."""
    return (line.servos[k - 1].shaft()[0] - 2048) * COUNT_DEG


def lands(arms: ServoArms, line: ServoBus, goals: list[float]) -> None:
    """The mean of five readings at least lies within the tolerance, and the shaft a count from that mean."""
    arms.move(pose(*goals))
    assert [at(line, k) for k in (1, 2, 3)] == pytest.approx(goals, abs=TOLERANCE_DEG + COUNT_DEG)


# a count of 1.4 is a good encoder's; 6 is 0.5 deg to either side
@pytest.mark.parametrize("flicker_counts", [1.4, 6.0])
@pytest.mark.parametrize("held_up_s", [0.0, 0.2, 0.5])
def test_an_encoder_that_flickers_lands_however_seldom_anybody_looks(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, flicker_counts: float, held_up_s: float
) -> None:
    monkeypatch.setattr(Servo, "_watch", lambda servo, wall_s: None)  # of which there is more below
    hours, line = bench
    hours.held_up = lambda: held_up_s
    draw = random.Random(flicker_counts)
    with ServoArms(describe(), servos(PORT)) as arms:
        for servo in line.servos:
            servo.mechanics = Mechanics(short_counts=4.0, noise_counts=flicker_counts)
        for _ in range(4):
            lands(arms, line, [draw.uniform(-40, 40) for _ in range(3)])


def test_a_way_on_a_computer_that_stands_still_again_and_again_comes_to_its_end(
    arms: ServoArms, bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    """Every look comes after the bus watchdog: the servo stops and is sent on more often than on any good way."""
    hours, line = bench
    arms.move(pose(-80, 0, 0))
    hours.held_up = lambda: 2 * watchdog.PERIOD_S
    assert degrees(arms.move(pose(80, 0, 0)))[0] == pytest.approx(80, abs=TOLERANCE_DEG)
    assert caplog.text.count("the servo stopped; sent on") > 2 * motion.RELEASES
    assert at(line, 1) == pytest.approx(80, abs=TOLERANCE_DEG + COUNT_DEG)


def blocked(line: ServoBus) -> None:
    line.servos[0].block()
    line.servos[0]._pushes = lambda: False  # type: ignore[method-assign]  # it does not complain of an overload


def creeping(line: ServoBus) -> None:
    line.servos[0]._limits = lambda way=0.0: (1.0, 1e6)  # type: ignore[method-assign]


def shut_out(line: ServoBus) -> None:
    """Its watchdog runs out at once, whatever is heard."""
    servo = line.servos[0]
    servo.block()
    heard = servo.heard

    def hears(wall_s: float) -> None:
        heard(wall_s)
        if servo.get("Bus Watchdog") > 0:
            servo._heard_s = wall_s - 1.0

    servo.heard = hears  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("fails", "message"),
    [(blocked, "it is stuck"), (creeping, "no landing within"), (shut_out, "came no closer to its goal")],
)
@pytest.mark.parametrize("held_up_s", [0.0, 0.45])
def test_what_does_not_land_is_told_after_a_bounded_number_of_looks(
    arms: ServoArms,
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    fails: Callable[[ServoBus], None],
    message: str,
    held_up_s: float,
) -> None:
    hours, line = bench
    arms.move(pose(0, 0, 0))
    looks: list[float] = []
    hours.held_up = lambda: looks.append(hours.now_s) or held_up_s  # type: ignore[func-returns-value]
    fails(line)
    with pytest.raises(DeviceError, match=message):
        arms.move(pose(30, 0, 0))
    # the way takes 1.7 s (a second at speed, and two ramps of a third); twice that and the grace in looks of 20 ms
    assert len(looks) <= (2 * 1.7 + motion.GRACE_S) / motion.POLL_S


def test_an_axis_that_trembles_and_was_pushed_is_not_still(arms: ServoArms, bench: Bench) -> None:
    _, line = bench
    arms.move(pose(0, 0, 0))
    arms.still()
    for servo in line.servos:
        servo.mechanics = Mechanics(noise_counts=1.4)
    for _ in range(20):
        arms.still()
    line.servos[0].write(116, (2060).to_bytes(4, "little"))  # 12 counts
    while line.servos[0].moves():
        bench[0].sleep(0.1)
    with pytest.raises(DeviceError, match="axis light has moved by itself"):
        arms.still()
