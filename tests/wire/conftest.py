"""Twins at the other end of the cable, for the drivers and for the unmodified SDK."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from dynamixel_sdk import PacketHandler, PortHandler
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
def sdk(line: Line, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[PortHandler, PacketHandler]]:
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 500)  # [ms], twice; patience on a busy machine
    port = PortHandler(line.port)
    port.setBaudRate(BAUD)
    yield port, PacketHandler(2.0)
    port.closePort()
