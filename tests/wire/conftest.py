"""Twins at the other end of the cable, for the drivers and for the unmodified SDK."""

from __future__ import annotations

import select
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest
from dynamixel_sdk import PacketHandler, PortHandler
from gonio_drivers.sdk import ExclusivePort
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.peer import SerialPeer, scaled_clock
from gonio_sim.wire.servo import Servo

SCALE = 50.0
BAUD = 1_000_000


@dataclass
class Line:
    """A bus of servos with ids 1, 2, 3, and what belongs to it."""

    port: str
    servos: dict[int, Servo]
    faults: Faults
    peer: SerialPeer
    bus: ServoBus


def deaf_to(line: Line, part: bytes) -> None:
    """The servos hear nothing of a packet that holds these bytes."""
    receive = line.bus.receive
    line.bus.receive = lambda data, baud, send: None if part in data else receive(data, baud, send)  # type: ignore[method-assign]


@pytest.fixture
def line() -> Iterator[Line]:
    clock = scaled_clock(SCALE)
    servos = {k: Servo(k, clock, model="xm430-w350", baud=BAUD, position=1000.0 + 500 * k) for k in (1, 2, 3)}
    for servo in servos.values():
        servo.write(9, b"\x00")
    faults = Faults()
    bus = ServoBus(servos.values(), faults)
    with SerialPeer(bus) as peer:
        yield Line(peer.port, servos, faults, peer, bus)


@pytest.fixture
def patient(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """On this line silence is what the servos leave unanswered, and never what a busy machine has not come to yet."""
    receive, is_over = line.bus.receive, PortHandler.isPacketTimeout
    sent = heard = 0

    def received(data: bytes, baud: int, send: Callable[[bytes], None]) -> None:
        nonlocal heard
        try:
            receive(data, baud, send)
        finally:
            heard += len(data)

    def counting(write: Callable[[PortHandler, list[int]], int]) -> Callable[[PortHandler, list[int]], int]:
        def written(port: PortHandler, packet: list[int]) -> int:
            nonlocal sent
            sent += len(packet)
            return write(port, packet)

        return written

    def is_silent(port: PortHandler) -> bool:
        return is_over(port) and heard >= sent and not select.select([port.ser.fileno()], [], [], 0)[0]

    monkeypatch.setattr(line.bus, "receive", received)
    monkeypatch.setattr(PortHandler, "isPacketTimeout", is_silent)
    for kind in (PortHandler, ExclusivePort):
        monkeypatch.setattr(kind, "writePort", counting(kind.writePort))


@pytest.fixture
def unwatched(monkeypatch: pytest.MonkeyPatch) -> None:
    """The servos' watchdogs never run out, however long this machine stands still."""
    monkeypatch.setattr(Servo, "_watch", lambda servo, wall_s: None)


@pytest.fixture
def sdk(line: Line, patient: None) -> Iterator[tuple[PortHandler, PacketHandler]]:
    port = PortHandler(line.port)
    port.setBaudRate(BAUD)
    yield port, PacketHandler(2.0)
    port.closePort()
