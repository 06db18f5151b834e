"""Packets of the Dynamixel Protocol 2.0: CRC, byte stuffing, framing.

Written from the protocol's documentation (ROBOTIS e-Manual, "Protocol 2.0"), from the side of the device.
"""

from collections.abc import Iterator
from dataclasses import dataclass

HEADER = b"\xff\xff\xfd"
STUFFED = HEADER + b"\xfd"
"""What stands for a header's bytes inside a packet."""
BROADCAST = 0xFE
STATUS = 0x55

PING, READ, WRITE, REG_WRITE, ACTION, FACTORY_RESET, REBOOT, CLEAR = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x08, 0x10
BACKUP = 0x20
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ, BULK_WRITE, FAST_BULK_READ = 0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A

RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = range(1, 8)
ALERT = 0x80

LONGEST = 1024
"""Longest packet that a device takes [bytes]; a header that announces more is not a header."""
LONGEST_GAP_S = 0.0015
"""Longest gap between two bytes of an instruction packet; after a longer one a device waits for the next header."""
BITS = 10
"""Bits of a byte on the line: start, eight, stop."""


def _table() -> tuple[int, ...]:
    out = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (0x8005 if crc & 0x8000 else 0)
        out.append(crc & 0xFFFF)
    return tuple(out)


_CRC = _table()


def crc16(data: bytes | bytearray) -> int:
    """CRC-16 with the polynomial 0x8005 (CRC-16/UMTS)."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) ^ _CRC[(crc >> 8) ^ byte]) & 0xFFFF
    return crc


@dataclass(frozen=True, slots=True)
class Packet:
    """A packet without its framing: `parameters` are unstuffed; a status packet's first parameter is its error byte."""

    id: int
    instruction: int
    parameters: bytes = b""
    crc_ok: bool = True

    def encode(self) -> bytes:
        """The bytes on the wire."""
        body = (bytes([self.instruction]) + self.parameters).replace(HEADER, STUFFED)
        packet = HEADER + bytes([0, self.id]) + (len(body) + 2).to_bytes(2, "little") + body
        return packet + crc16(packet).to_bytes(2, "little")


def status(identity: int, error: int, data: bytes = b"") -> bytes:
    """A status packet on the wire."""
    return Packet(identity, STATUS, bytes([error]) + data).encode()


class Reader:
    """Finds packets in a stream of bytes; noise between packets is skipped."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._last_s = 0.0

    def feed(self, data: bytes, now_s: float | None = None) -> Iterator[Packet]:
        """Packets that are complete after `data`; one with a wrong CRC comes with `crc_ok` False.

        With a time `now_s` [s], the beginning of a packet is dropped where the rest is too long in coming.
        """
        if now_s is not None:
            if now_s - self._last_s > LONGEST_GAP_S:
                self._bytes.clear()
            self._last_s = now_s
        self._bytes += data
        while (packet := self._next()) is not None:
            yield packet

    def _next(self) -> Packet | None:
        stream = self._bytes
        while True:
            start = stream.find(HEADER)
            if start < 0:
                del stream[: max(0, len(stream) - 2)]
                return None
            del stream[:start]
            if len(stream) < 8:
                return None
            length = stream[5] | stream[6] << 8
            if stream[3] != 0 or stream[4] in (0xFD, 0xFF) or not 3 <= length <= LONGEST - 7:
                del stream[:3]  # stuffed bytes, or noise that looks like a header
                continue
            again = stream.find(HEADER + b"\0", 7, 7 + length)  # a header inside: the packet before it was cut short
            if again >= 0:
                del stream[:again]
                continue
            if len(stream) < 7 + length:
                return None
            raw = bytes(stream[: 7 + length])
            body = raw[7:-2].replace(STUFFED, HEADER)
            good = crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")
            del stream[: 7 + length if good else 3]
            return Packet(raw[4], body[0], body[1:], good)
