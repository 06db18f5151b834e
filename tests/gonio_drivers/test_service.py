"""Who answers on a bus: by what is heard after a ping, whole and damaged; no bus, and no waiting."""

from typing import Any, cast

import pytest
from dynamixel_sdk import INST_PING
from gonio_drivers import service
from gonio_drivers.dynamixel import Bus, BusError
from gonio_drivers.sdk import Packets

from gonio.errors import DeviceError


def status(identity: int, *parameters: int, error: int = 0) -> bytes:
    """A whole status packet of protocol 2.0 (ROBOTIS e-Manual, "Status Packet")."""
    body = [0x55, error, *parameters]
    size = len(body) + 2
    packet = [0xFF, 0xFF, 0xFD, 0x00, identity, size & 0xFF, size >> 8, *body, 0, 0]
    crc = Packets().updateCRC(0, packet, len(packet) - 2)
    packet[-2:] = crc & 0xFF, crc >> 8
    return bytes(packet)


def pong(identity: int, model: int = 1020, firmware: int = 45) -> bytes:
    return status(identity, model & 0xFF, model >> 8, firmware)


class Line:
    """A bus on which bytes are heard, by who is asked for what."""

    port, baud = "none", 57_600

    def __init__(self, everybody: list[bytes], single: dict[int, bytes] | None = None) -> None:
        self.everybody, self.single = everybody, single or {}
        self.asked: list[int] = []

    def overhear(self, identity: int, instruction: int, request: bytes = b"", *, listen_s: float) -> bytes:
        if identity == service.BROADCAST:
            return self.everybody.pop(0)
        if instruction == INST_PING:
            self.asked.append(identity)
            return self.single.get(identity, b"")
        return status(identity, 1, 2, 3)


def at(line: Line) -> list[tuple[int, str, int]]:
    return [(found.id, found.model, found.firmware) for found in service._at(cast(Bus, line))]


def test_two_rounds_hear_what_one_has_lost() -> None:
    line = Line([pong(1), pong(1) + pong(252, firmware=46)])
    assert at(line) == [(1, "xm430-w350", 45), (252, "xm430-w350", 46)]
    assert line.asked == [], "all that was heard was whole"


def test_where_answers_were_damaged_every_id_is_asked() -> None:
    """From 0 to 252; those that were heard whole are known."""
    line = Line([pong(1), pong(1) + b"\x00\xff"], {0: pong(0), 252: pong(252), 7: b"\xff\xfd\x00"})
    assert at(line) == [
        (0, "xm430-w350", 45), (1, "xm430-w350", 45), (7, "not understood", 0), (252, "xm430-w350", 45),
    ]  # fmt: skip
    assert sorted(line.asked) == [k for k in range(253) if k != 1]


def test_where_nobody_answers_nobody_is_asked_again() -> None:
    line = Line([b""])
    assert at(line) == []
    assert line.asked == []


def test_a_model_that_the_library_does_not_know_is_named_by_its_number() -> None:
    assert at(Line([pong(3, model=65_000)] * 2)) == [(3, "model number 65000", 45)]


class Answers:
    """A bus on which one id answers a reading so often, as it is said."""

    def __init__(self, *heard: bytes, ping: bytes = b"") -> None:
        self.heard, self.ping_answer = list(heard), ping

    def overhear(self, identity: int, instruction: int, request: bytes = b"", *, listen_s: float) -> bytes:
        return self.ping_answer if instruction == INST_PING else self.heard.pop(0)


WHOLE = status(5, 1, 2, 3)


@pytest.mark.parametrize(
    ("heard", "ping", "alone"),
    [
        ([WHOLE] * 3, b"", True),
        ([b"", b"", WHOLE], b"", True),  # two answers were lost
        ([WHOLE + status(5, 9, 9, 9)], b"", False),
        ([WHOLE + b"\x01"] * 3, b"", False),  # damaged whenever
        ([WHOLE[:-1]] * 3, b"", False),
        ([status(6, 1, 2, 3)] * 3, b"", False),  # of somebody else
        ([b""] * 3, pong(5), True),  # it answers nothing but pings
        ([b""] * 3, pong(5) + pong(5), False),
        ([b""] * 3, b"", False),
    ],
)
def test_one_servo_is_told_from_two(heard: list[bytes], ping: bytes, alone: bool) -> None:
    assert service._alone(cast(Bus, Answers(*heard, ping=ping)), 5) is alone


@pytest.mark.parametrize(("error", "refused"), [(0, False), (0x80, False), (0x04, True), (0x84, True)])
def test_a_refusal_to_write_is_told_from_an_alert(error: int, refused: bool) -> None:
    """Bit 7 says that something is wrong with the servo, and not with the write."""
    bus: Any = Answers(status(5, error=error))
    bus.port = "none"
    if not refused:
        service._write(bus, 5, 8, 3)
        return
    with pytest.raises(DeviceError, match="refuses 3 at address 8"):
        service._write(bus, 5, 8, 3)


@pytest.mark.parametrize(("lost", "comes_back"), [(3, True), (4, False)])
def test_a_servo_has_three_seconds_to_come_back(lost: int, comes_back: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Looks one second apart; it is asked once more when the time is over."""

    class Restarting(Answers):
        left = 0

        def ping(self, identity: int) -> None:
            self.left -= 1
            if 0 <= self.left < lost:
                raise BusError("no answer")

        def read(self, identity: int, address: int, size: int) -> bytes:
            return b"\x00"

    class Seconds:
        def __init__(self) -> None:
            self.count = 0

        def __call__(self) -> float:
            self.count += 1
            return float(self.count)

    bus: Any = Restarting(b"")
    bus.left = lost + 1  # the first ping, before the restart, is answered
    monkeypatch.setattr(service, "Patience", Seconds)
    if comes_back:
        service._restart(bus, 5)
        return
    with pytest.raises(DeviceError, match="does not come back"):
        service._restart(bus, 5)
