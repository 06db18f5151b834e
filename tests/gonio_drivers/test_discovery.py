"""What hangs at unknown ports, over the twins: nothing lights, and a servo that was wiggled stands where it stood."""

from pathlib import Path

import pytest
from gonio_drivers import dynamixel, service
from gonio_drivers.lab import LAB
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.lamps import LAMPS, Shine
from gonio_sim.wire.peer import Device, Send, SerialPeer
from gonio_sim.wire.twins import Twins

from gonio.errors import DeviceError
from gonio.lab.rig import FoundServo
from tests.gonio_drivers.conftest import small
from tests.gonio_drivers.virtual import VirtualClock


@pytest.mark.slow
@pytest.mark.parametrize("dialect", ["scpi", "mightex", "arduino"])
def test_a_lamps_dialect_is_found_and_nothing_lights(dialect: str, tmp_path: Path, hours: VirtualClock) -> None:
    lit: list[bool] = []

    def shine(state: Shine) -> None:
        lit.append(state.lit)

    lamp = LAMPS[dialect](small().bands.all(), shine, Faults())
    with SerialPeer(lamp, tmp_path / "lamp", tells_opening=lamp.resets_on_open):
        found = service.lamp_on(str(tmp_path / "lamp"))
    assert found is not None
    assert found[0] == dialect
    assert not any(lit)


def test_a_release_box_is_known_without_an_exposure(twins: Twins, tmp_path: Path) -> None:
    assert service.is_release(twins.peers["release"].port)
    assert not service.is_release(twins.peers["lamp"].port)
    assert not list((tmp_path / "twin" / "frames").iterdir())


def test_a_wiggle_comes_back_and_leaves_the_torque_as_it_was(twins: Twins) -> None:
    servo = twins.servos["camera"]
    before, moved = servo.shaft()[0], []
    servo.leaving = lambda: moved.append(servo.shaft()[0])
    service.wiggle(FoundServo(twins.peers["servos"].port, servo.baud, servo.id, "xm430-w350", 46))
    assert abs(servo.shaft()[0] - before) < service.WIGGLE_COUNTS / 3 + 1
    assert max(moved) - before > service.WIGGLE_COUNTS / 2
    assert not servo.torque


def test_the_twins_hold_what_the_rig_asks_for(twins: Twins) -> None:
    rig = LAB.open(twins.description, sample=None, seed=0, confirm=False)
    held = []
    for what in ("mirror", "empty", "sample"):
        assert rig.put(what)
        held.append(twins._target())
    assert held == ["mirror", "empty", "sample"]


def test_without_a_file_for_it_only_a_person_can_put_something(twins: Twins) -> None:
    devices = {name: table for name, table in twins.description.devices.items() if name != "holder"}
    rig = LAB.open(twins.description.model_copy(update={"devices": devices}), sample=None, seed=0, confirm=False)
    assert not rig.put("mirror")


# ---- servos that speak another protocol than ours ----


class Old(Device):
    """Servos of protocol 1 (an AX-12, say): they answer pings of their own, at one line speed, and nothing else."""

    def __init__(self, *ids: int, baud: int = 1_000_000, error: int = 0, echo: bool = False) -> None:
        self._ids, self._baud, self._error, self._echo, self._heard = ids, baud, error, echo, b""

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        if self._echo:
            send(data)
        self._heard = (self._heard + data)[-4096:]
        while (at := self._heard.find(b"\xff\xff")) >= 0 and len(self._heard) >= at + 6:
            packet, self._heard = self._heard[at : at + 6], self._heard[at + 6 :]
            if packet[3:5] != b"\x02\x01" or sum(packet[2:]) & 0xFF != 0xFF:
                self._heard = packet[1:] + self._heard
            elif packet[2] in self._ids and baud == self._baud:
                body = bytes([packet[2], 2, self._error])
                send(b"\xff\xff" + body + bytes([~sum(body) & 0xFF]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "says"),
    [
        (Old(1, 7), "servos id 1, 7 on .* at 1000000 baud answer to Dynamixel protocol 1, .* Protocol Type to 2"),
        (Old(3, baud=57_600), "servo id 3 on .* at 57600 baud answers to Dynamixel protocol 1"),
        (Old(200, error=4), "servo id 200 on"),
    ],
)
def test_servos_of_another_protocol_are_named_and_no_cable_is_blamed(
    old: Old, says: str, tmp_path: Path, hours: VirtualClock
) -> None:
    """Kind: a device that is there, and speaks another language than ours, is no cable that is out."""
    port = str(tmp_path / "bus")
    with SerialPeer(old, tmp_path / "bus"):
        with pytest.raises(DeviceError, match=says):
            LAB.servos(port, lambda text: None)
        description = small()
        servos = description.devices["servos"] | {"port": port, "baud": 1_000_000}
        known = description.model_copy(update={"devices": description.devices | {"servos": servos}})
        rig = LAB.open(known, sample=None, seed=0, confirm=False)
        with pytest.raises(DeviceError, match=says) as failed, rig.arms:
            pass
    assert "cable" not in str(failed.value)


def test_where_nobody_speaks_any_protocol_none_is_named(tmp_path: Path, hours: VirtualClock) -> None:
    with SerialPeer(Old(), tmp_path / "bus"):
        assert LAB.servos(str(tmp_path / "bus"), lambda text: None) == []


def test_a_ping_that_an_adapter_returns_is_no_servo(tmp_path: Path, hours: VirtualClock) -> None:
    """It reads as the answer of a servo that reports error 1; a servo's own comes beside it."""
    for error in (0, 1):
        echoing = Old(200, baud=57_600, error=error, echo=True)
        with SerialPeer(echoing, tmp_path / "bus"), dynamixel.Bus(str(tmp_path / "bus"), 57_600) as bus:
            assert bus.old_ids() == [200]


def test_answers_that_damage_each_other_are_asked_for_one_by_one(
    tmp_path: Path, hours: VirtualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, asked = dynamixel._old_answers, []

    def damaged(heard: bytes) -> list[int]:
        asked.append(heard)
        return [] if len(asked) == 1 else real(heard)

    monkeypatch.setattr(dynamixel, "_old_answers", damaged)
    with SerialPeer(Old(4, 9, baud=57_600), tmp_path / "bus"), dynamixel.Bus(str(tmp_path / "bus"), 57_600) as bus:
        assert bus.old_ids() == [4, 9]
