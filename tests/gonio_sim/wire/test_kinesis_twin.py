"""The stage's twin against its maker's protocol (APT, Issue 37): bytes by hand, and times of a trapezoid by hand."""

import math
import struct

import numpy as np
import pytest
from gonio_sim.wire import twins
from gonio_sim.wire.kinesis import KinesisTwin

from gonio.lab.rig.description import Axis
from tests.gonio_sim.wire.conftest import HandClock

PER_DEG, SPEED_PER_DEG, ACCELERATION_PER_DEG = 136_533, 7_329_109, 1_502
"""The maker's table for a K10CR1: counts a degree, and its units of velocity and acceleration."""


class Stage:
    """A twin whose clock is set by hand."""

    def __init__(self, **state: float) -> None:
        self.clock = HandClock()
        self.twin = KinesisTwin(self.clock, **state)  # type: ignore[arg-type]

    def say(self, number: int, data: bytes = b"") -> list[bytes]:
        """What it answers to a message, whole."""
        header = struct.pack("<HHBB", number, len(data), 0xD0 if data else 0x50, 0x01)
        out: list[bytes] = []
        self.twin.receive((header + data)[:4], 115_200, out.append)  # a message may come in pieces
        assert not out
        self.twin.receive((header + data)[4:], 115_200, out.append)
        return out

    def bits(self) -> int:
        return int(struct.unpack("<I", self.say(0x0429)[-1][8:])[0])

    def counter(self) -> int:
        return int(struct.unpack("<i", self.say(0x0411)[-1][8:])[0])


def test_it_turns_as_a_trapezoid_and_tells_when_it_has_ended() -> None:
    """90 deg at 20 deg/s with 10 deg/s^2: 2 s and 20 deg at either end, 2.5 s between."""
    stage = Stage()
    stage.say(0x0413, struct.pack("<Hiii", 1, 0, 10 * ACCELERATION_PER_DEG, 20 * SPEED_PER_DEG))
    assert stage.say(0x0453, struct.pack("<Hi", 1, 90 * PER_DEG)) == []
    for after_s, deg in ((1.0, 5.0), (1.0, 20.0), (2.5, 70.0), (1.0, 85.0)):
        stage.clock.now_s += after_s
        assert stage.counter() / PER_DEG == pytest.approx(deg, rel=2e-3)  # the maker's 1502 is rounded
        assert stage.bits() & 0x30 == 0x20  # it moves forward
        assert stage.twin.moves()
    stage.clock.now_s += 1.1
    done, answer = stage.say(0x0411)
    assert struct.unpack("<HHBB", done[:6]) == (0x0464, 14, 0x81, 0x50)
    assert struct.unpack("<Hi", done[6:12]) == (1, 90 * PER_DEG)
    assert struct.unpack("<HHBBHi", answer) == (0x0412, 6, 0x81, 0x50, 1, 90 * PER_DEG)
    assert stage.bits() == 0x8000_0400  # enabled, homed, still
    stage.say(0x0453, struct.pack("<Hi", 1, 0))
    stage.clock.now_s += 1.0
    assert stage.bits() & 0x30 == 0x10
    stage.say(0x0465)
    stood = stage.counter()
    stage.clock.now_s += 10.0
    assert stage.counter() == stood < 90 * PER_DEG


def test_a_home_that_it_does_not_know_is_found() -> None:
    stage = Stage(position=30.0 * PER_DEG, homed=False)
    assert stage.counter() == 0  # wherever it stands
    assert not stage.bits() & 0x400
    stage.say(0x0443)
    stage.clock.now_s += 1.0
    assert stage.bits() & 0x600 == 0x200  # on its way home
    stage.clock.now_s += 60.0
    homed, _ = stage.say(0x0411)
    assert struct.unpack("<HHBB", homed) == (0x0444, 1, 0x01, 0x50)
    assert (stage.counter(), stage.bits() & 0x600) == (0, 0x400)
    assert stage.twin.shaft() == 0.0
    stage.twin.push(1000.0)
    assert stage.counter() == 1000
    stage.say(0x0410, struct.pack("<Hi", 1, 250))
    assert stage.counter() == 250
    stage.twin.restart()
    assert (stage.counter(), stage.bits() & 0x400) == (0, 0)


def test_what_is_not_meant_for_it_is_not_answered() -> None:
    stage, out = Stage(), list[bytes]()
    for destination, baud in ((0x11, 115_200), (0x50, 9_600)):
        stage.twin.receive(struct.pack("<HHBB", 0x0429, 0, destination, 1), baud, out.append)
    assert not out
    stage.twin.stalled = True
    stage.say(0x0453, struct.pack("<Hi", 1, 1000))
    stage.clock.now_s += 10.0
    assert stage.counter() == 0
    stage.twin.damaged = 1
    assert [len(stage.say(0x0411)[0]) for _ in range(2)] == [9, 12]
    info = stage.say(0x0005)[0]
    assert (len(info), struct.unpack("<I8s", info[6:18])) == (90, (55000001, b"K10CR1\0\0"))
    assert struct.unpack("<Hi", stage.say(0x043B)[0][6:]) == (1, PER_DEG)  # a degree of backlash is taken up


@pytest.mark.parametrize(
    ("from_above", "places"),
    [(False, [10.3, 12.0, 12.0, 11.8, 11.8, 12.0]), (True, [9.7, 11.7, 11.7, 11.5, 11.5, 11.7])],
)
def test_an_arm_follows_its_shaft_behind_the_backlash(from_above: bool, places: list[float]) -> None:
    """0.3 deg of backlash: it stands at its shaft where it was pushed from the side that the rig comes from."""
    at = [0.0]
    arm = twins.TwinArm(
        lambda: at[0], math.radians, Axis(backlash_deg=0.3, zero_offset_deg=0.5), math.radians(0.2), from_above
    )
    found = []
    for at[0] in (10.0, 12.0, 11.9, 11.5, 11.7, 12.0):
        found.append(math.degrees(arm.true()) + 0.7)  # both parts of its zero
    np.testing.assert_allclose(found, places, rtol=1e-12)
