"""A Dynamixel bus (Protocol 2.0) over the ROBOTIS SDK, with the SDK's pitfalls handled in one place.

What is handled, and where:

- a late reply is taken as the answer to the next request: after any failure the line is left alone for longer than a
  late reply takes, emptied, and a ping (whose reply has a length of its own) is asked before anything else;
- an exception inside a transaction leaves the port busy for ever: `is_using` is reset whatever happens;
- an error status without data raises IndexError in the SDK's reads: replies are taken as packets and checked here;
- `GroupSyncRead` drops the alert bits, and one silent servo fails the group and reads as 0: replies are collected by
  id, and the missing ones are read one by one;
- byte stuffing is lost on transmit and can lose a byte on reception: `Packets` does both anew, and the length that a
  reply announces must be the length that was asked for;
- values are unsigned: `control_table.Item.decode` extends the sign;
- open errors raise raw exceptions and nothing locks the port: `ExclusivePort` locks it at every (re)opening;
- the SDK spins while it waits: `ExclusivePort` sleeps until bytes arrive;
- it drops bytes that belong to no answer without a word: `ExclusivePort` counts them, and they are told.
"""

import contextlib
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Self, TypeVar

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS, INST_PING, INST_READ, INST_WRITE

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import clock
from gonio_drivers import log, ports
from gonio_drivers.sdk import WAIT_S, ExclusivePort, Packets

Answer = TypeVar("Answer")

ALERT = 0x80
QUIET_S = 0.060
"""How long the line is left alone after a failure, for replies that are still on their way."""
TRIES = 4
ENOUGH = 3
"""Sync reads without any answer, of servos that answer one by one, after which no more are asked."""
LONGEST = 16_384
"""Bytes; the answers of all servos that a bus can have are fewer."""
BABBLE_S = 1.0
"""A line that does not fall silent for this long never does."""
BAUD_RATES = (57_600, 1_000_000, 115_200, 2_000_000, 3_000_000, 4_000_000, 9_600)

ERRORS = {
    1: "failed to carry out the instruction (result fail)",
    2: "does not know the instruction",
    4: "the value is out of the item's range",
    5: "the data are shorter than the item",
    6: "the value is beyond a limit that is set in the servo",
    7: "the address cannot be read or written now (EEPROM is locked while torque is on)",
}
OLD_IDS = range(254)
OLD_ANSWER_S = 0.004
"""A servo of protocol 1 begins to answer within 0.5 ms (ROBOTIS e-Manual, "Return Delay Time")."""
OLD_LISTEN_S = 0.05
"""For an answer that an adapter or a busy computer holds back."""
UNHEARD = {COMM_RX_TIMEOUT: "no answer", COMM_RX_CORRUPT: "a damaged answer"}
HARDWARE_ERRORS = {
    0: "input voltage out of range",
    2: "overheated",
    3: "encoder or motor fault",
    4: "electrical shock or too little power",
    5: "overloaded",
}


class BusError(DeviceError):
    """The bus fails to carry packets: no answer, or a damaged one."""


class Refusal(DeviceError):
    """A servo answers an instruction with an error number."""

    def __init__(self, message: str, error: int) -> None:
        super().__init__(message)
        self.error = error


class Bus:
    """The servos on one port.

    Parameters
    ----------
    port, baud
        Where they are, and their line speed.
    key
        Name of the table that says so, for messages.

    Opening (as a context) takes the port's lock and touches no servo.
    """

    def __init__(self, port: str, baud: int, *, key: str = "devices.servos") -> None:
        self.port = port
        self.baud = baud
        self.key = key
        self.alerts: set[int] = set()
        """Ids whose last status packet had the alert bit."""
        self.recovered = 0
        """Failures that a repetition has mended."""
        self.unheard = 0
        """Sync reads in a row that nobody has answered."""
        self.noisy = 0
        """Answers with bytes beside them that belong to none."""
        self._port = ExclusivePort(port, f"{key}.port")
        self._packets = Packets()
        self._lock = threading.RLock()
        self._users = 0

    def __enter__(self) -> Self:
        """Open the port, unless it is open: it is closed when the last who has entered it leaves."""
        if self._users == 0:
            self.set_baud(self.baud)
        self._users += 1
        return self

    def __exit__(self, *_: object) -> None:
        """Close the port, and free it whatever was going on."""
        self._users -= 1
        if self._users == 0:
            if self._port.is_open:
                self._port.closePort()
            self._port.is_using = False

    def set_baud(self, baud: int) -> None:
        """Open the port at a line speed; the lock is taken anew."""
        ports.require_free(self.port, f"{self.key}.port")
        if not self._port.setBaudRate(baud):
            known = ", ".join(map(str, BAUD_RATES))
            raise ConfigError(f"{self.key}.baud = {baud}: the SDK has no such line speed; it has {known}")

    @contextlib.contextmanager
    def _line(self) -> Iterator[None]:
        """The line belongs to this thread, and is free before and after, whatever was interrupted."""
        with self._lock, ports.in_use(self.port, f"{self.key}.port"):
            if not self._port.is_open:
                raise DeviceError(f"the servo bus on {self.port} is not open: enter the rig first")
            self._port.is_using = False
            try:
                yield
            finally:
                self._port.is_using = False

    # ---- one servo ----

    def ping(self, identity: int) -> tuple[int, int]:
        """Model number and firmware version of a servo."""
        data = self._repeat(identity, INST_PING, b"", 3)
        return int.from_bytes(data[:2], "little"), data[2]

    def read(self, identity: int, address: int, size: int) -> bytes:
        """`size` bytes of a servo's control table."""
        return self._repeat(identity, INST_READ, address.to_bytes(2, "little") + size.to_bytes(2, "little"), size)

    def write(self, identity: int, address: int, data: bytes) -> None:
        """Change a servo's control table."""
        self._repeat(identity, INST_WRITE, address.to_bytes(2, "little") + data, 0)

    def overhear(
        self, identity: int, instruction: int, parameters: bytes = b"", *, listen_s: float, quiet_s: float = 0.0
    ) -> bytes:
        """Everything that comes over the line after one request, whoever sends it, until nothing came for `listen_s`.

        It tells whether two servos answer to one id. What lies on this computer when the
        time is over is heard, however long it was held up meanwhile. A line that never falls silent is listened to
        for `BABBLE_S` more at most. Before the request, replies to an earlier one have `quiet_s` to come, and are
        dropped: a late one would be heard as that of a second servo.
        """
        with self._line():
            self._calm(quiet_s)
            self._packets.txPacket(self._port, _request(identity, instruction, parameters))
            return self._listen(listen_s)

    def _listen(self, listen_s: float) -> bytes:
        """As of `overhear`, on a line that is ours."""
        heard, end = b"", math.inf
        self._port.setPacketTimeoutMillis(1e3 * listen_s)
        while len(heard) <= LONGEST:
            # before the look: what has come by then is heard
            over = self._port.isPacketTimeout() or clock.monotonic() > end
            if more := self._port.readPort(1024):
                end = min(end, clock.monotonic() + listen_s + BABBLE_S)
                heard += more
                self._port.setPacketTimeoutMillis(1e3 * listen_s)
            elif over:
                break
        return heard

    # ---- servos of another protocol ----

    def old_ids(self) -> list[int]:
        """The ids that answer a ping of protocol 1 at this line speed; takes some seconds."""
        with self._line():
            self._calm(0.0)
            for identity in OLD_IDS:
                self._port.writePort(list(_old_ping(identity)))
                clock.sleep(OLD_ANSWER_S + 120 / self._port.getBaudRate())  # 12 bytes of question and answer
            heard = self._listen(OLD_LISTEN_S)
            there = _old_answers(heard)
            if there or not heard:
                return there
            for identity in OLD_IDS:  # answers have damaged each other, or what talks here is something else
                self._port.writePort(list(_old_ping(identity)))
                there += [each for each in _old_answers(self._listen(OLD_LISTEN_S)) if each == identity]
            return there

    def old_servos(self) -> str:
        """A text for messages: which servos answer to protocol 1, at whatever line speed, and what to do; or ""."""
        found = (self.baud, ids) if (ids := self.old_ids()) else self._at_another_speed(self.old_ids)
        if found is None:
            return ""
        baud, ids = found
        one = len(ids) == 1
        return (
            f"servo{'' if one else 's'} id {', '.join(map(str, ids))} on {self.port} at {baud} baud "
            f"answer{'s' if one else ''} to Dynamixel protocol 1, and this driver speaks protocol 2: where the model "
            "has both (X series; MX with the firmware MX(2.0)), set its item Protocol Type to 2 with the Dynamixel "
            "Wizard; AX, RX, EX and DX servos have protocol 1 alone and cannot be used"
        )

    def elsewhere(self, identity: int) -> str:
        """A text for messages: the other line speed at which a servo with this id answers, and what to do; or "".

        Each speed is asked once, which takes a tenth of a second where nobody answers.
        """
        found = self._at_another_speed(lambda: self._transact(identity, INST_PING, b"", 3))
        if found is None:
            return ""
        return (
            f"; one with this id answers at {found[0]} baud, and {self.key}.baud = {self.baud}: gonio rig ids "
            f"--set-baud {identity} {self.baud} gives it that speed"
        )

    def _at_another_speed(self, ask: Callable[[], Answer]) -> tuple[int, Answer] | None:
        """The first other line speed at which anything is answered, and what; the bus has its own again then."""
        with self._lock:
            try:
                for baud in speeds(self.port):
                    if baud != self.baud:
                        self.set_baud(baud)
                        with contextlib.suppress(BusError):
                            if answer := ask():
                                return baud, answer
            finally:
                self.set_baud(self.baud)
        return None

    # ---- several servos ----

    def discover(self, rounds: int = 2) -> dict[int, tuple[int, int]]:
        """Model number and firmware version by id of every servo that answers a broadcast ping at this line speed.

        It is asked `rounds` times, 0.8 s each: what is damaged or lost in one is heard in another.
        """
        found: dict[int, tuple[int, int]] = {}
        for _ in range(rounds):
            with self._line():
                self._calm(0.0)
                heard, _ = self._packets.broadcastPing(self._port)  # empty, or damaged where replies collided
            found |= {identity: (entry[0], entry[1]) for identity, entry in heard.items()}
        return dict(sorted(found.items()))

    def scan(self) -> tuple[int, dict[int, tuple[int, int]]] | None:
        """The first other line speed at which servos answer a broadcast ping, and those servos, as of `discover`.

        Takes about a second a speed; factory settings (57600 baud) come first.
        """
        return self._at_another_speed(lambda: self.discover(rounds=1))

    def read_all(self, ids: Iterable[int], address: int, size: int) -> dict[int, bytes]:
        """The same block of several servos, by one sync read; those that fail in it are read one by one."""
        wanted = list(ids)
        with self._lock:
            if self.unheard >= ENOUGH:
                return {identity: self.read(identity, address, size) for identity in wanted}
            blocks = self._sync_read(wanted, address, size)
            missing = [identity for identity in wanted if identity not in blocks]
            if missing:
                self._calm(QUIET_S)
                for identity in missing:
                    self._confirm(identity)
                    blocks[identity] = self.read(identity, address, size)
                self.recovered += 1
                log.warning("servo bus %s: sync read without an answer of id %s; repeated", self.port, missing)
            self.unheard = self.unheard + 1 if missing == wanted else 0
            if self.unheard == ENOUGH:
                log.warning("servo bus %s: nobody answers a sync read; asking one by one from now on", self.port)
            return blocks

    def glance(self, ids: Iterable[int], address: int, size: int) -> dict[int, bytes]:
        """The same block of those servos that answer at once; nothing is repeated, and silence raises nothing.

        It may follow a request that was interrupted, whose answer must not be taken for this one's.
        """
        with self._line():
            self._calm(0.0)
            return self._sync_read(list(ids), address, size)

    def write_all(self, address: int, data: Mapping[int, bytes]) -> None:
        """Change several servos at once, by one sync write; no servo answers it: read back what matters."""
        if len(sizes := {len(d) for d in data.values()}) != 1:
            raise ValueError("a sync write takes the same number of bytes for every servo")
        parameters = list(b"".join(bytes([identity]) + d for identity, d in data.items()))
        with self._line():
            self._packets.syncWriteTxOnly(self._port, address, *sizes, parameters, len(parameters))

    # ---- transactions ----

    def _repeat(self, identity: int, instruction: int, parameters: bytes, expected: int) -> bytes:
        """Ask until there is a good answer; before a repetition the line falls silent and the servo answers a ping."""
        with self._lock:
            for attempt in range(TRIES):
                try:
                    answer = self._transact(identity, instruction, parameters, expected)
                except BusError as failure:
                    last = failure
                    self._calm(QUIET_S)
                    self._confirm(identity)
                    continue
                if attempt:
                    self.recovered += 1
                    log.warning("servo bus %s: %s; answered at attempt %d", self.port, last, attempt + 1)
                return answer
            raise BusError(f"{last}, over {TRIES} attempts; check its cable and supply")

    def _transact(self, identity: int, instruction: int, parameters: bytes, expected: int) -> bytes:
        """One request and its reply; `expected` is the number of data bytes in a good reply."""
        with self._line():
            reply, result, _ = self._packets.txRxPacket(self._port, _request(identity, instruction, parameters))
        if result != COMM_SUCCESS:
            said = UNHEARD.get(result, f"the SDK reports {result}")
            raise BusError(f"servo id {identity} on {self.port} at {self.baud} baud: {said}")
        self._tell_noise(self._port.received - len(reply))
        return self._data(identity, reply, expected)

    def _data(self, identity: int, reply: list[int], expected: int) -> bytes:
        """The data of a status packet, checked: error number, and the length that was asked for."""
        error = reply[8]
        (self.alerts.add if error & ALERT else self.alerts.discard)(identity)
        number = error & 0x7F
        if number == 3:
            raise BusError(f"servo id {identity} on {self.port}: the request arrived damaged")
        if number:
            what = ERRORS.get(number, f"error number {number}")
            raise Refusal(f"servo id {identity} on {self.port} refuses: {what}", number)
        announced = (reply[5] | reply[6] << 8) - 4
        data = bytes(reply[9 : 9 + announced])
        if announced != expected or len(data) != expected:
            raise BusError(
                f"servo id {identity} on {self.port}: a reply of {announced} bytes to a request for {expected}"
            )
        return data

    def _sync_read(self, ids: list[int], address: int, size: int) -> dict[int, bytes]:
        blocks: dict[int, bytes] = {}
        answered = 0
        with self._line():
            result = self._packets.syncReadTx(self._port, address, size, ids, len(ids), False)
            while result == COMM_SUCCESS and len(blocks) < len(ids):
                reply, result = self._packets.rxPacket(self._port, False)
                answered += len(reply)
                if result == COMM_SUCCESS and reply[4] in ids:
                    if any(ids.index(known) >= ids.index(reply[4]) for known in blocks):
                        self.unheard = 0
                        return {}  # servos answer in turn: one of these is the answer to something older
                    try:
                        blocks[reply[4]] = self._data(reply[4], reply, size)
                    except BusError:
                        return blocks  # the caller reads the rest one by one
        if result == COMM_SUCCESS:
            self._tell_noise(self._port.received - answered)
        return blocks

    def _tell_noise(self, stray: int) -> None:
        """Say that there was noise; of a line that is always noisy at the 1st, 2nd, 4th, 8th ... time."""
        if stray > 0:
            self.noisy += 1
            if self.noisy & (self.noisy - 1) == 0:
                log.warning(
                    "servo bus %s: %d stray bytes beside an answer, passed over (noise, %d so far)",
                    self.port, stray, self.noisy,
                )  # fmt: skip

    def _calm(self, quiet_s: float) -> None:
        """Let late replies come, and drop them."""
        with self._line():
            clock.sleep(quiet_s)
            for _ in range(int(BABBLE_S / WAIT_S)):  # looks, and no clock: this computer may be held up between two
                if not self._port.readPort(1024):
                    break
                clock.sleep(WAIT_S)
            else:
                raise DeviceError(
                    f'{self.key}.port = "{self.port}": something else talks on this line without a pause; is this '
                    f"the servos' port, and {self.baud} their line speed?"
                )
            self._port.clearPort()

    def _confirm(self, identity: int) -> None:
        """A ping whose own reply comes back: nothing older is on its way. Its failure is left to the next attempt."""
        try:
            self._transact(identity, INST_PING, b"", 3)
        except BusError:
            self._calm(QUIET_S)


def _request(identity: int, instruction: int, parameters: bytes) -> list[int]:
    """An instruction packet; the SDK fills in its header and its checksum."""
    length = len(parameters) + 3
    return [0, 0, 0, 0, identity, length & 0xFF, length >> 8, instruction, *parameters, 0, 0]


def _old_ping(identity: int) -> bytes:
    """A ping of protocol 1."""
    return bytes([0xFF, 0xFF, identity, 2, INST_PING, ~(identity + 2 + INST_PING) & 0xFF])


def _old_answers(heard: bytes) -> list[int]:
    """Whose status packets of protocol 1, without data, are in what was heard.

    Some adapters return what was sent. A ping reads as a status packet with error 1: one alone is no answer.
    """
    seen: dict[int, list[bytes]] = {}
    at = heard.find(b"\xff\xff")
    while at >= 0:
        packet = heard[at : at + 6]
        good = len(packet) == 6 and packet[2] in OLD_IDS and packet[3] == 2 and sum(packet[2:]) & 0xFF == 0xFF
        if good:
            seen.setdefault(packet[2], []).append(packet)
        at = heard.find(b"\xff\xff", at + (6 if good else 1))
    return sorted(n for n, packets in seen.items() if len(packets) > 1 or packets[0] != _old_ping(n))


def hardware_error(byte: int) -> str:
    """The bits of a Hardware Error Status in words."""
    return ", ".join(text for bit, text in HARDWARE_ERRORS.items() if byte & 1 << bit) or f"hardware error {byte:#04x}"


def speeds(port: str) -> tuple[int, ...]:
    """The line speeds at which servos may be sought on a port; a raw server has its own, and any stands for that."""
    return BAUD_RATES[:1] if port.startswith("socket:") else BAUD_RATES
