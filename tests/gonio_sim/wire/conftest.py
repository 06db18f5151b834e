"""Servos at one end of a line, the unmodified SDK at the other, and the hands of who stands beside them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, PacketHandler, PortHandler
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.peer import SerialPeer
from gonio_sim.wire.servo import Servo

from tests.gonio_drivers.conftest import BAUD, be_patient


class HandClock:
    """A twin's clock that goes on when it is told to."""

    scale = 1.0

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def at(self, wall_s: float) -> float:
        return self.now_s


@dataclass
class ManualRig:
    """Servos on a line, the SDK at its other end, and the hands of who stands beside it."""

    port: Any
    ph: Any
    peer: SerialPeer
    bus: ServoBus
    clock: HandClock
    servos: dict[int, Servo]

    def get(self, name: str, identity: int = 1) -> int:
        """Read an item by the SDK."""
        item = self.servos[identity].table.items[name]
        data, result, error = self.ph.readTxRx(self.port, identity, item.address, item.size)
        assert (result, error & 0x7F) == (COMM_SUCCESS, 0), (name, result, error)
        return int.from_bytes(bytes(data), "little", signed=item.signed)

    def put(self, name: str, value: int, identity: int = 1) -> int:
        """Write an item by the SDK; the error number of the status packet, with its alert bit."""
        item = self.servos[identity].table.items[name]
        return self.write(item.address, (value % (1 << 8 * item.size)).to_bytes(item.size, "little"), identity)

    def write(self, address: int, data: bytes, identity: int = 1) -> int:
        result, error = self.ph.writeTxRx(self.port, identity, address, len(data), list(data))
        assert result == COMM_SUCCESS
        return int(error)

    def set(self, **values: int) -> None:
        """Write items, named with underscores, that must be taken."""
        for name, value in values.items():
            assert self.put(name.replace("_", " "), value) == 0, name

    def tell(self, instruction: int, parameters: bytes = b"") -> tuple[int, int]:
        """Any instruction: result and error."""
        packet = [0, 0, 0, 0, 1, len(parameters) + 3, 0, instruction, *parameters, 0, 0]
        _, result, error = self.ph.txRxPacket(self.port, packet)
        return result, error

    def heard(self, packet: p2.Packet | bytes) -> list[bytes]:
        """What the bus says to a packet."""
        out: list[bytes] = []
        self.bus.receive(packet if isinstance(packet, bytes) else packet.encode(), BAUD, out.append)
        return out

    def later(self, seconds: float) -> None:
        self.clock.now_s += seconds

    def reboot(self) -> None:
        result, _ = self.ph.reboot(self.port, 1)
        assert result == COMM_SUCCESS
        self.boots()

    def boots(self) -> None:
        """It boots, behind its answer, and is silent until it is done."""
        assert self.ph.ping(self.port, 1)[1] == COMM_RX_TIMEOUT
        self.later(1.0)
        assert self.ph.ping(self.port, 1)[1] == COMM_SUCCESS

    def expire(self) -> None:
        """As if nothing had been said for ten seconds."""
        self.servos[1]._heard_s -= 10.0
        self.servos[1].shaft()


Build = Callable[..., ManualRig]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Build]:
    """Builds a bench of servos of one model, with ids from 1 on, or with those given."""
    with contextlib.ExitStack() as stack:

        def build(model: str = "xm430-w350", *ids: int) -> ManualRig:
            clock = HandClock()
            servos = [Servo(k, clock, model=model, baud=BAUD, position=2000.0) for k in ids or (1,)]  # type: ignore[arg-type]
            for servo in servos:
                servo.registers.put("Return Delay Time", 0)
            faults = Faults()
            bus = ServoBus(servos, faults)
            peer = stack.enter_context(SerialPeer(bus))
            be_patient(peer, faults, monkeypatch)
            port = PortHandler(peer.port)
            port.setBaudRate(BAUD)
            stack.callback(port.closePort)
            return ManualRig(port, PacketHandler(2.0), peer, bus, clock, {s.id: s for s in servos})

        yield build
