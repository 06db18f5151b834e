"""A bus of Dynamixel servos at the end of one cable."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.registers import Refused
from gonio_sim.wire.servo import Servo

Send = Callable[[bytes], None]


class ServoBus:
    """Hears every packet, lets each servo that is meant act, and returns their status packets in order.

    Only servos whose line speed is that of the other side hear anything.
    """

    def __init__(self, servos: Iterable[Servo], faults: Faults | None = None) -> None:
        self.servos = list(servos)
        self.faults = faults or Faults()
        self._reader = p2.Reader()

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes from the line."""
        for packet in self._reader.feed(data):
            if packet.instruction != p2.STATUS:
                self._instruct(packet, [s for s in self.servos if s.answers and s.baud == baud], send)

    def opened(self, send: Send) -> None:
        """Servos do not notice."""

    # ---- one instruction ----

    def _instruct(self, packet: p2.Packet, present: list[Servo], send: Send) -> None:
        wall = time.monotonic()
        for servo in present:
            servo.heard(wall)
        if not packet.crc_ok:
            for servo in present:
                if servo.id == packet.id:
                    self._reply(servo, p2.CRC_ERROR, b"", send, level=2)
            return
        several = {
            p2.SYNC_READ: self._sync_read, p2.FAST_SYNC_READ: self._fast_sync_read, p2.SYNC_WRITE: self._sync_write,
            p2.BULK_READ: self._bulk_read, p2.FAST_BULK_READ: self._fast_bulk_read, p2.BULK_WRITE: self._bulk_write,
        }.get(packet.instruction)  # fmt: skip
        if several is not None:
            if packet.id == p2.BROADCAST:
                several(packet.parameters, {s.id: s for s in present}, send)
            return
        for servo in sorted(present, key=lambda s: s.id):
            if packet.id in (servo.id, p2.BROADCAST, servo.get("Secondary(Shadow) ID")):
                self._single(packet, servo, send)

    def _single(self, packet: p2.Packet, servo: Servo, send: Send) -> None:
        broadcast = packet.id != servo.id  # a shadow ID is obeyed, and not answered, as a broadcast is
        data = packet.parameters
        error, answer, level, after = 0, b"", 2, None
        identity = servo.id
        try:
            if packet.instruction == p2.PING:
                answer, level = servo.ping(), 0
            elif packet.instruction == p2.READ:
                level = 1
                if len(data) != 4:
                    raise Refused(p2.LENGTH_ERROR)
                if broadcast:
                    return
                answer = servo.read(_word(data, 0), _word(data, 2))
            elif packet.instruction in (p2.WRITE, p2.REG_WRITE):
                if len(data) < 3:
                    raise Refused(p2.LENGTH_ERROR)
                (servo.write if packet.instruction == p2.WRITE else servo.register)(_word(data, 0), data[2:])
            elif packet.instruction == p2.ACTION:
                servo.action()
            elif packet.instruction == p2.REBOOT:
                after = servo.restart
            elif packet.instruction == p2.FACTORY_RESET:
                if len(data) != 1:
                    raise Refused(p2.LENGTH_ERROR)
                if broadcast and data[0] == 0xFF:  # not activated (X series, firmware 42 and later)
                    return
                servo.reset(data[0])
            elif packet.instruction == p2.CLEAR:
                if data != bytes([0x01, 0x44, 0x58, 0x4C, 0x22]):
                    raise Refused(p2.RANGE_ERROR)
                servo.clear_turns()
            else:
                raise Refused(p2.INSTRUCTION_ERROR)
        except Refused as refusal:
            error = refusal.error
        if not broadcast or (packet.instruction == p2.PING and packet.id == p2.BROADCAST):
            self._reply(servo, error, answer, send, level=level, identity=identity)
        if after is not None:
            after()

    def _reply(
        self, servo: Servo, error: int, data: bytes, send: Send, *, level: int, identity: int | None = None
    ) -> None:
        if servo.get("Status Return Level") < level:
            return
        time.sleep(servo.get("Return Delay Time") * 2e-6)
        status = p2.status(servo.id if identity is None else identity, error | servo.error, data)
        for delay_s, chunk in self.faults.on_status(servo, status):
            if delay_s:
                time.sleep(delay_s)
            send(chunk)

    # ---- several servos ----

    def _sync_read(self, data: bytes, present: dict[int, Servo], send: Send) -> None:
        for identity in data[4:]:
            if not self._read_one(present.get(identity), _word(data, 0), _word(data, 2), send):
                return

    def _bulk_read(self, data: bytes, present: dict[int, Servo], send: Send) -> None:
        for k in range(0, len(data) - 4, 5):
            if not self._read_one(present.get(data[k]), _word(data, k + 1), _word(data, k + 3), send):
                return

    def _read_one(self, servo: Servo | None, address: int, length: int, send: Send) -> bool:
        """One servo's turn; False where it is silent, because the next one waits for it."""
        if servo is None or servo.get("Status Return Level") < 1:
            return False
        try:
            error, answer = 0, servo.read(address, length)
        except Refused as refusal:
            error, answer = refusal.error, b""
        self._reply(servo, error, answer, send, level=1)
        return True

    def _fast_sync_read(self, data: bytes, present: dict[int, Servo], send: Send) -> None:
        self._fast([(identity, _word(data, 0), _word(data, 2)) for identity in data[4:]], present, send)

    def _fast_bulk_read(self, data: bytes, present: dict[int, Servo], send: Send) -> None:
        wanted = [(data[k], _word(data, k + 1), _word(data, k + 3)) for k in range(0, len(data) - 4, 5)]
        self._fast(wanted, present, send)

    def _fast(self, wanted: list[tuple[int, int, int]], present: dict[int, Servo], send: Send) -> None:
        """One status packet that the servos write one after the other, each closing its part with the CRC so far."""
        length = 1 + sum(4 + size for _, _, size in wanted)
        out = p2.HEADER + bytes([0, p2.BROADCAST]) + length.to_bytes(2, "little") + bytes([p2.STATUS])
        last: Servo | None = None
        for identity, address, size in wanted:
            servo = present.get(identity)
            if servo is None or servo.get("Status Return Level") < 1:
                break
            try:
                out += bytes([servo.error, identity]) + servo.read(address, size)
            except Refused as refusal:
                out += bytes([servo.error | refusal.error, identity]) + bytes(size)
            out += p2.crc16(out).to_bytes(2, "little")
            last = servo
        if last is not None:
            time.sleep(last.get("Return Delay Time") * 2e-6)
            for delay_s, chunk in self.faults.on_status(last, out):
                if delay_s:
                    time.sleep(delay_s)
                send(chunk)

    def _sync_write(self, data: bytes, present: dict[int, Servo], send: Send) -> None:
        address, length = _word(data, 0), _word(data, 2)
        for k in range(4, len(data) - length, 1 + length):
            self._write_one(present.get(data[k]), address, data[k + 1 : k + 1 + length])

    def _bulk_write(self, data: bytes, present: dict[int, Servo], send: Send) -> None:
        k = 0
        while k + 5 <= len(data):
            length = _word(data, k + 3)
            self._write_one(present.get(data[k]), _word(data, k + 1), data[k + 5 : k + 5 + length])
            k += 5 + length

    @staticmethod
    def _write_one(servo: Servo | None, address: int, data: bytes) -> None:
        if servo is not None:
            try:
                servo.write(address, data)
            except Refused:
                return  # nobody is told: a write to several servos has no status packet


def _word(data: bytes, at: int) -> int:
    return data[at] | data[at + 1] << 8 if at + 1 < len(data) else -1
