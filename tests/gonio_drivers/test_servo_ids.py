"""Servos are found, given ids and speeds, and told apart, over the twins."""

import math
import re
from pathlib import Path
from typing import Any

import pytest
from gonio_drivers import dynamixel
from gonio_drivers.lab import LAB
from gonio_sim.wire.servo import Servo
from gonio_sim.wire.twins import Twins

from gonio.errors import DeviceError
from gonio.lab.rig import FoundServo
from tests.gonio_drivers.conftest import (
    bench,
    by_hand,
    opened,
    written,
)  # fmt: skip

pytestmark = pytest.mark.slow


def add(twins: Twins, identity: int, baud: int = 1_000_000) -> Servo:
    servo = Servo(identity, twins.servos["light"]._clock, model="xm430-w350", baud=baud, position=1234.0)
    twins.bus.servos.append(servo)
    return servo


def found(twins: Twins, identity: int, baud: int = 1_000_000) -> FoundServo:
    return FoundServo(str(twins.description.devices["servos"]["port"]), baud, identity, "xm430-w350", 46)


@pytest.mark.usefixtures("quick")
def test_servos_are_found_at_every_speed_and_given_ids_and_speeds(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    new = add(twins, 1, baud=57_600)
    listed = [line.split()[:2] for line in by_hand(rig, "ids").stdout.splitlines() if line[:1].isdigit()]
    assert listed == [["1", "57600"], *([str(k), "1000000"] for k in range(1, 6))]
    by_hand(rig, "ids", "--set-id", "1", "9", "--yes", code=3, says="more than one servo answers to id 1")
    assert new.id == 1
    assert LAB.assign(found(twins, 1, 57_600), identity=9, baud=1_000_000).id == 9
    assert (new.id, new.baud, new.torque) == (9, 1_000_000, False)
    by_hand(rig, "ids", "--set-id", "9", "10", code=2, says="no terminal to confirm")
    assert new.id == 9


def overheard(monkeypatch: pytest.MonkeyPatch, identity: int, times: int, lost: int = 0) -> list[int]:
    """What is heard of a servo's answers comes so many times, after some that are lost; who was asked, in turn."""
    plain, asked = dynamixel.Bus.overhear, list[int]()

    def heard(bus: dynamixel.Bus, to: int, *said: Any, **how: Any) -> bytes:
        asked.append(to)
        answer = plain(bus, to, *said, **how)
        return answer if to != identity else b"" if asked.count(to) <= lost else answer * times

    monkeypatch.setattr(dynamixel.Bus, "overhear", heard)
    return asked


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("lost", [1, 2])
def test_a_lost_answer_hides_no_servo_that_is_given_an_id(
    twins: Twins, monkeypatch: pytest.MonkeyPatch, lost: int
) -> None:
    """Neither the one that is to get it, nor another that has it."""
    overheard(monkeypatch, lost, times=1, lost=1)
    if lost == 2:
        with pytest.raises(DeviceError, match="id 2 is taken"):
            LAB.assign(found(twins, 1), identity=2)
        assert sorted(servo.id for servo in twins.servos.values()) == [1, 2, 3, 4, 5]
    else:
        assert LAB.assign(found(twins, 1), identity=9).id == 9


@pytest.mark.usefixtures("quick")
def test_two_servos_with_one_id_are_told_and_not_touched(twins: Twins, tmp_path: Path) -> None:
    twin = add(twins, 2)
    by_hand(
        written(twins, tmp_path), "ids", "--set-id", "2", "9", "--yes",
        code=3, prints="two servos with this id", says="more than one servo answers to id 2",
    )  # fmt: skip
    assert (twin.id, twins.servos["camera"].id) == (2, 2)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("times", "lost", "message"),
    [
        (2, 0, "two servos answer to this id"),
        (2, 1, "two servos answer to this id"),
        (0, 0, "nobody knows whether one servo has this id or two"),
    ],
)
def test_a_servo_that_may_not_be_alone_is_not_moved(
    twins: Twins, monkeypatch: pytest.MonkeyPatch, times: int, lost: int, message: str
) -> None:
    asked = overheard(monkeypatch, 1, times, lost)
    with bench(twins, "arms") as held:
        with pytest.raises(DeviceError, match=message):
            held.move(light=math.radians(10))
        held.move(camera=math.radians(10))
        held.hold()
    assert asked.count(1) > lost
    assert not twins.servos["light"].torque
    with pytest.raises(DeviceError, match=message):
        opened(twins).__enter__()


def test_a_servo_that_answers_and_cannot_be_used_is_not_called_mute(twins: Twins, tmp_path: Path) -> None:
    twins.servos["tilt"].damage = 0x10
    said = " ".join(by_hand(written(twins, tmp_path), "move", "tilt=10", code=3).stderr.split())
    assert "no answer" not in said
    assert re.search(r"tilt -?\d\.\d\d deg, torque off", said)


def test_an_axis_that_was_not_named_and_lets_go_is_not_said_to_hold(twins: Twins) -> None:
    with bench(twins, "arms") as held:
        twins.servos["camera"].write(64, b"\0")
        with pytest.raises(DeviceError, match=r"axis camera: .* let go of its torque"):
            held.move(light=math.radians(10))
    assert twins.servos["camera"].get("Torque Enable") == 0
