"""A bus of Dynamixel servos at the end of one cable."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from gonio.lab.rig import clock
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.faults import Faults
from gonio_sim.wire.peer import Device, Send
from gonio_sim.wire.servo import Servo
from gonio_sim.wire.tables import Refused

ById = dict[int, list[Servo]]


@dataclass(frozen=True, slots=True)
class Answer:
    """A status packet that a servo is to send."""

    servo: Servo
    status: bytes
    delay_s: float
    """Time from the end of the instruction packet."""


class ServoBus(Device):
    """Hears every packet, lets each servo that is meant act, and returns their status packets in order.

    Only servos whose line speed is that of the other side hear anything. Status packets take the time that their bytes
    need on the line. Servos with the same id talk at the same time and damage each other's bytes.
    """

    def __init__(self, servos: Iterable[Servo], faults: Faults | None = None) -> None:
        self.servos = list(servos)
        self.faults = faults or Faults()
        self._reader = p2.Reader()

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes from the line."""
        for packet in self._reader.feed(data, clock.monotonic()):
            if packet.instruction != p2.STATUS:
                self._instruct(packet, [s for s in self.servos if s.answers and s.baud == baud], send)

    # ---- one instruction ----

    def _instruct(self, packet: p2.Packet, present: list[Servo], send: Send) -> None:
        wall = clock.monotonic()
        for servo in present:
            servo.heard(wall)
        if not packet.crc_ok:
            self._say([_answer(s, p2.CRC_ERROR) for s in present if s.id == packet.id and _level(s) >= 2], send)
            return
        several = {
            p2.SYNC_READ: self._in_turn, p2.BULK_READ: self._in_turn, p2.FAST_SYNC_READ: self._fast,
            p2.FAST_BULK_READ: self._fast, p2.SYNC_WRITE: self._sync_write, p2.BULK_WRITE: self._bulk_write,
        }.get(packet.instruction)  # fmt: skip
        if several is not None:
            if packet.id == p2.BROADCAST:
                several(packet, _by_id(present), send)
            return
        meant = [s for s in present if packet.id in (s.id, p2.BROADCAST, s.get("Secondary(Shadow) ID"))]
        for servos in _by_id(meant).values():  # in the order of their ids
            done = [self._single(packet, servo) for servo in servos]
            self._say([answer for answer, _ in done if answer is not None], send)
            for _, after in done:
                if after is not None:
                    after()

    def _single(self, packet: p2.Packet, servo: Servo) -> tuple[Answer | None, Callable[[], None] | None]:
        """Let a servo act; what it says, and what it does when that is said."""
        identity, everybody = servo.id, packet.id == p2.BROADCAST
        others = packet.id != identity  # a secondary ID is obeyed, and not answered, as a broadcast is
        error, data, after = 0, b"", None
        try:
            if packet.instruction == p2.PING:
                data = servo.registers.identity()
            elif packet.instruction == p2.READ:
                words = _words(packet.parameters)
                data = b"" if others else servo.read(*words)
            else:
                after = _act(packet, servo, others=others, everybody=everybody)
        except Refused as refusal:
            error = refusal.error
        silent = others and not (everybody and packet.instruction == p2.PING)
        if silent or _level(servo) < {p2.PING: 0, p2.READ: 1}.get(packet.instruction, 2):
            return None, after
        return _answer(servo, error, data, identity), after

    def _say(self, answers: list[Answer], send: Send) -> None:
        """Put the answers of servos with one id on the line."""
        if not answers:
            return
        first = min(answers, key=lambda answer: answer.delay_s)
        status = first.status if len(answers) == 1 else _collided(answers)
        clock.sleep(first.delay_s + len(first.status) * p2.BITS / first.servo.baud)  # as long as it is on the line
        for delay_s, chunk in self.faults.on_status(first.servo, status):
            if delay_s:
                clock.sleep(delay_s)
            send(chunk)

    # ---- several servos ----

    def _in_turn(self, packet: p2.Packet, present: ById, send: Send) -> None:
        """One status packet after the other; where one is silent, the next waits for it for ever."""
        for identity, address, length in _once(_wanted(packet)):
            servos = [servo for servo in present.get(identity, []) if _level(servo) >= 1]
            if not servos:
                return
            self._say([_read(servo, address, length) for servo in servos], send)

    def _fast(self, packet: p2.Packet, present: ById, send: Send) -> None:
        """One status packet that the servos write one after the other, each closing its part with the CRC so far."""
        wanted = _wanted(packet)
        length = 1 + sum(4 + size for _, _, size in wanted)
        out = p2.HEADER + bytes([0, p2.BROADCAST]) + length.to_bytes(2, "little") + bytes([p2.STATUS])
        said: list[Answer] = []
        for identity, address, size in _once(wanted):
            servo = next((s for s in present.get(identity, []) if _level(s) >= 1), None)
            if servo is None:
                break
            try:
                out += bytes([servo.error, identity]) + servo.read(address, size)
            except Refused as refusal:
                out += bytes([servo.error | refusal.error, identity]) + bytes(size)
            out += p2.crc16(out).to_bytes(2, "little")
            said = [Answer(servo, out, _delay_s(servo))]
        self._say(said, send)

    def _sync_write(self, packet: p2.Packet, present: ById, send: Send) -> None:
        data = packet.parameters
        address, length = _word(data, 0), _word(data, 2)
        for k in range(4, len(data) - length, 1 + length):
            _write(present.get(data[k], []), address, data[k + 1 : k + 1 + length])

    def _bulk_write(self, packet: p2.Packet, present: ById, send: Send) -> None:
        data, k, written = packet.parameters, 0, set()
        while k + 5 <= len(data):
            length = _word(data, k + 3)
            if data[k] not in written:
                _write(present.get(data[k], []), _word(data, k + 1), data[k + 5 : k + 5 + length])
            written.add(data[k])
            k += 5 + length


def _act(packet: p2.Packet, servo: Servo, *, others: bool, everybody: bool) -> Callable[[], None] | None:
    """What a servo does for an instruction that has no data to answer; what it does behind its answer."""
    data = packet.parameters
    lengths = {p2.WRITE: range(3, 1 << 16), p2.REG_WRITE: range(3, 1 << 16), p2.FACTORY_RESET: (1,)}
    if packet.instruction in lengths and len(data) not in lengths[packet.instruction]:
        raise Refused(p2.LENGTH_ERROR)
    match packet.instruction:
        case p2.WRITE:
            servo.write(_word(data, 0), data[2:], as_group=others and not everybody)
        case p2.REG_WRITE:
            servo.register(_word(data, 0), data[2:])
        case p2.ACTION:
            servo.action()
        case p2.REBOOT:
            return servo.restart
        case p2.FACTORY_RESET:
            if not (everybody and data[0] == 0xFF):  # that is not carried out (X series, firmware 42 and later)
                servo.reset(data[0])
        case p2.CLEAR:
            _require(data, {b"\x01DXL\x22"})
            servo.clear_turns()
        case p2.BACKUP:
            _require(data, {b"\x01CTRL", b"\x02CTRL"})
            if data[0] == 2:
                servo.restore()
                return servo.restart
            servo.back_up()
        case _:
            raise Refused(p2.INSTRUCTION_ERROR)
    return None


def _level(servo: Servo) -> int:
    return servo.get("Status Return Level")


def _delay_s(servo: Servo) -> float:
    return servo.get("Return Delay Time") * 2e-6


def _answer(servo: Servo, error: int, data: bytes = b"", identity: int | None = None) -> Answer:
    status = p2.status(servo.id if identity is None else identity, error | servo.error, data)
    return Answer(servo, status, _delay_s(servo))


def _read(servo: Servo, address: int, length: int) -> Answer:
    try:
        return _answer(servo, 0, servo.read(address, length))
    except Refused as refusal:
        return _answer(servo, refusal.error)


def _write(servos: list[Servo], address: int, data: bytes) -> None:
    for servo in servos:
        with contextlib.suppress(Refused):  # nobody is told: a write to several servos has no status packet
            servo.write(address, data)


def _by_id(servos: Iterable[Servo]) -> ById:
    out: ById = {}
    for servo in sorted(servos, key=lambda s: s.id):
        out.setdefault(servo.id, []).append(servo)
    return out


def _once(wanted: list[tuple[int, int, int]]) -> Iterator[tuple[int, int, int]]:
    """A servo answers where its id comes first; where it comes again nobody does."""
    seen = set()
    for identity, address, length in wanted:
        if identity in seen:
            return
        seen.add(identity)
        yield identity, address, length


def _wanted(packet: p2.Packet) -> list[tuple[int, int, int]]:
    """Id, address and length of what a packet asks of several servos."""
    data = packet.parameters
    if packet.instruction in (p2.SYNC_READ, p2.FAST_SYNC_READ):
        return [(identity, _word(data, 0), _word(data, 2)) for identity in data[4:]]
    return [(data[k], _word(data, k + 1), _word(data, k + 3)) for k in range(0, len(data) - 4, 5)]


def _words(data: bytes) -> tuple[int, int]:
    if len(data) != 4:
        raise Refused(p2.LENGTH_ERROR)
    return _word(data, 0), _word(data, 2)


def _require(data: bytes, known: set[bytes]) -> None:
    if len(data) != 5:
        raise Refused(p2.LENGTH_ERROR)
    if data not in known:
        raise Refused(p2.RANGE_ERROR)


def _collided(answers: list[Answer]) -> bytes:
    """What the line makes of packets that overlap: low wins, bit by bit; later ones begin some bytes later."""
    start = min(answer.delay_s for answer in answers)
    out = bytearray()
    for answer in answers:
        at = round((answer.delay_s - start) * answer.servo.baud / p2.BITS)
        out += b"\xff" * (at + len(answer.status) - len(out))
        for k, byte in enumerate(answer.status):
            out[at + k] &= byte
    return bytes(out)


def _word(data: bytes, at: int) -> int:
    return data[at] | data[at + 1] << 8 if at + 1 < len(data) else -1
