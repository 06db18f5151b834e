"""Servos at one end of a line, the unmodified SDK at the other, and the hands of who stands beside them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, PacketHandler, PortHandler
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.servo import Servo

from tests.gonio_drivers.conftest import BAUD


class HandClock:
    """A twin's clock that goes on when it is told to."""

    scale = 1.0

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s

    def at(self, wall_s: float) -> float:
        return self.now_s


class Cable(PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's end of a cable to servos in this process: they have answered when a write returns, or are silent."""

    def __init__(self, bus: ServoBus) -> None:
        super().__init__("cable")
        self.bus, self._unread = bus, bytearray()

    def setupPort(self, cflag_baud: int) -> bool:
        self.tx_time_per_byte = 10_000.0 / cflag_baud
        return True

    def clearPort(self) -> None:
        self._unread.clear()

    def writePort(self, packet: list[int]) -> int:
        self.bus.receive(bytes(packet), self.baudrate, self._unread.extend)
        return len(packet)

    def readPort(self, length: int) -> bytes:
        data = bytes(self._unread[:length])
        del self._unread[:length]
        return data

    def isPacketTimeout(self) -> bool:
        return not self._unread


@dataclass
class ManualRig:
    """Servos on a line, the SDK at its other end, and the hands of who stands beside it."""

    port: Any
    ph: Any
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
def bench() -> Build:
    """Builds a bench of servos of one model, with ids from 1 on, or with those given."""

    def build(model: str = "xm430-w350", *ids: int) -> ManualRig:
        clock = HandClock()
        servos = [Servo(k, clock, model=model, baud=BAUD, position=2000.0) for k in ids or (1,)]  # type: ignore[arg-type]
        for servo in servos:
            servo.registers.put("Return Delay Time", 0)
        bus = ServoBus(servos, Faults())
        port = Cable(bus)
        port.setBaudRate(BAUD)
        return ManualRig(port, PacketHandler(2.0), bus, clock, {s.id: s for s in servos})

    return build
