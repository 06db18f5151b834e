"""Port and packets of the ROBOTIS SDK, mended where they have to be: locking, waiting, clock, byte stuffing."""

from collections.abc import Iterator

from dynamixel_sdk import PortHandler, Protocol2PacketHandler

from gonio_drivers import ports
from gonio_drivers.patience import Patience

WAIT_S = 0.002
LATE_S = 0.005
"""Most that one gap between two looks counts as waiting: in a longer one this computer or the adapter was held up."""
PATIENCE_MS = 50.0
"""Added to the SDK's timeout of 34 ms: a busy computer or a slow adapter is no fault."""
HEADER = b"\xff\xff\xfd"
STUFFED = HEADER + b"\xfd"
BEFORE = 7
"""Bytes of a packet before its instruction; the length is the last two of them."""


class ExclusivePort(PortHandler):  # type: ignore[misc]
    """The SDK's port, locked for one owner, and sleeping while it waits for bytes."""

    is_open: bool
    packet_timeout: float
    received = 0
    """Bytes since the last request was sent, and what lay there unasked before it."""

    def setupPort(self, cflag_baud: int) -> bool:
        """Open the port (again) at a line speed, with the lock taken again."""
        if self.is_open:
            self.closePort()
        self.ser = ports.opened(self.port_name, cflag_baud, WAIT_S, self._key)
        self.is_open = True
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 1000.0 / cflag_baud * 10.0
        return True

    def __init__(self, port_name: str, key: str) -> None:
        super().__init__(port_name)
        self._key, self._waited = key, Patience(LATE_S)

    def getCurrentTime(self) -> float:
        """Milliseconds of looking: the SDK's own clock jumps with the time of day, and calls being held up silence."""
        return 1e3 * self._waited()

    def setPacketTimeout(self, packet_length: int) -> None:
        """Start to wait for a packet."""
        super().setPacketTimeout(packet_length)
        self.packet_timeout += PATIENCE_MS

    def readPort(self, length: int) -> bytes:
        """Bytes that are there, or come in a short wait."""
        if length <= 0:
            return b""
        data = bytes(self.ser.read(length))
        self.received += len(data)
        return data

    def writePort(self, packet: list[int]) -> int:
        """Send a packet; its length."""
        ports.send(self.ser, bytes(packet))
        return len(packet)

    def clearPort(self) -> None:
        """Drop bytes that answer no question."""
        self.received = self.ser.in_waiting
        super().clearPort()


class Packets(Protocol2PacketHandler):  # type: ignore[misc]
    """The SDK's packets, with FF FF FD inside a packet written as FF FF FD FD, and read back, without loss."""

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Stuff an instruction packet, in place: the SDK stuffs a copy and sends the original."""
        body = bytes(packet[BEFORE:-2]).replace(HEADER, STUFFED)
        packet[:] = [*_head(packet, len(body)), *body, 0, 0]
        return packet

    def whole(self, data: bytes) -> Iterator[bytes]:
        """The whole and undamaged status packets in what was heard."""
        at = data.find(HEADER)
        while at >= 0:
            end = at + 7 + (data[at + 5] | data[at + 6] << 8) if at + 7 <= len(data) else len(data) + 1
            packet = data[at:end]
            good = len(packet) >= 11 and end <= len(data) and packet[7] == 0x55
            good = good and self.updateCRC(0, list(packet), len(packet) - 2) == packet[-2] | packet[-1] << 8
            if good:
                yield packet
            at = data.find(HEADER, end if good else at + 1)

    def removeStuffing(self, packet: list[int]) -> list[int]:
        """A status packet without stuffing, filled up to the length that it had."""
        length = packet[5] | packet[6] << 8
        body = bytes(packet[BEFORE : BEFORE + length - 2]).replace(STUFFED, HEADER)
        out = [*_head(packet, len(body)), *body, *packet[BEFORE + length - 2 : BEFORE + length]]
        return out + [0] * (len(packet) - len(out))


def _head(packet: list[int], size: int) -> list[int]:
    """The bytes before the instruction, for a body of another size."""
    return [*packet[:5], size + 2 & 0xFF, size + 2 >> 8]
