"""A Thorlabs motor controller with one stage, as its maker's "APT Communications Protocol" describes it (Issue 37).

Messages have a header of six bytes: number, two parameters, destination, source. Where the top bit of the destination
is set, the parameters are the length of data that follow. What the stage does ends with a message that nobody asked
for (MOT_MOVE_COMPLETED and its like): it stands before the next answer.
"""

import struct
from collections.abc import Callable

from gonio_sim.wire import motion
from gonio_sim.wire.peer import Clock, Device, Send

HOST, DEVICE = 0x01, 0x50
LONG = 0x80
HW_REQ_INFO, HW_GET_INFO = 0x0005, 0x0006
SET_POSCOUNTER, REQ_POSCOUNTER, GET_POSCOUNTER = 0x0410, 0x0411, 0x0412
SET_VELPARAMS, REQ_VELPARAMS, GET_VELPARAMS = 0x0413, 0x0414, 0x0415
REQ_STATUSBITS, GET_STATUSBITS = 0x0429, 0x042A
SET_GENMOVEPARAMS, REQ_GENMOVEPARAMS, GET_GENMOVEPARAMS = 0x043A, 0x043B, 0x043C
MOVE_HOME, MOVE_HOMED = 0x0443, 0x0444
MOVE_ABSOLUTE, MOVE_COMPLETED = 0x0453, 0x0464
MOVE_STOP, MOVE_STOPPED = 0x0465, 0x0466
ANSWERS = {
    HW_REQ_INFO: HW_GET_INFO, REQ_POSCOUNTER: GET_POSCOUNTER, REQ_VELPARAMS: GET_VELPARAMS,
    REQ_STATUSBITS: GET_STATUSBITS, REQ_GENMOVEPARAMS: GET_GENMOVEPARAMS,
}  # fmt: skip
FORWARD, REVERSE, HOMING, HOMED, ENABLED = 1 << 5, 1 << 4, 1 << 9, 1 << 10, 1 << 31
COUNTS_PER_DEG = 409600 / 3
"""K10CR1: 200 steps of 2048 microsteps, a gear of 120:1."""
VELOCITY_UNIT, ACCELERATION_UNIT = 53.68, 53.68 * 204.94e-6
"""Units of the trinamic controllers (page "Position, velocity and acceleration units"), for counts/s and counts/s^2."""


class KinesisTwin(Device):
    """A K10CR1 rotation stage.

    Parameters
    ----------
    clock
        Its time [s].
    position
        Where it stands when it is switched on [counts from its home].
    homed
        It has found its home already; otherwise its counter begins at 0 wherever it stands.
    """

    def __init__(self, clock: Clock, *, position: float = 0.0, homed: bool = True, serial: int = 55000001) -> None:
        self._clock = clock
        self.serial = serial
        self.model = b"K10CR1"
        self.homed = homed
        self.faults = 0
        """Status bits that it shows beside the others."""
        self.mute = False
        self.damaged = 0
        """Number of next answers that lack their end."""
        self.stalled = False
        """It takes commands, and does not turn."""
        self.leaving: Callable[[], None] = lambda: None
        """Called before it turns to another goal."""
        self.heard: list[int] = []
        """Numbers of the messages that came."""
        self._zero = 0.0 if homed else position
        self._way = motion.rest(clock(), position)
        self._speed, self._acceleration = 10.0 * COUNTS_PER_DEG, 10.0 * COUNTS_PER_DEG
        self._words = int(self._acceleration * ACCELERATION_UNIT), int(self._speed * VELOCITY_UNIT)
        self._backlash = round(COUNTS_PER_DEG)
        self._ending = 0
        """The message that tells of the end of what it does."""
        self._buffer = b""

    def shaft(self) -> float:
        """Where it stands, from its true home [counts]."""
        return self._way.at(self._clock())[0]

    def moves(self) -> bool:
        """Whether it turns."""
        return self._clock() < self._way.end_s

    def push(self, counts: float) -> None:
        """Turn it by hand."""
        self._way = motion.rest(self._clock(), self.shaft() + counts)

    def restart(self) -> None:
        """Its supply was away for a moment: it stands, and has forgotten where."""
        self._way = motion.rest(self._clock(), self.shaft())
        self._zero, self.homed, self._ending = self.shaft(), False, 0

    def receive(self, data: bytes, baud: int, send: Send) -> None:
        """Take bytes from the line."""
        self._buffer += data
        while len(self._buffer) >= 6:
            number, first, second, destination, _ = struct.unpack("<HBBBB", self._buffer[:6])
            length = first | second << 8 if destination & LONG else 0
            if len(self._buffer) < 6 + length:
                return
            body, self._buffer = self._buffer[6 : 6 + length], self._buffer[6 + length :]
            self.heard.append(number)
            if baud == 115_200 and not self.mute and destination & ~LONG == DEVICE:
                self._tell_end(send)
                self._obey(number, body, send)

    # ---- messages ----

    def _tell_end(self, send: Send) -> None:
        if self._ending and not self.moves():
            if self._ending == MOVE_HOMED:
                self._zero, self.homed = 0.0, True
                self._send(send, MOVE_HOMED, short=1)
            else:
                self._send(send, self._ending, struct.pack("<HiiI", 1, self._counter(), 0, self._bits()))
            self._ending = 0

    def _obey(self, number: int, body: bytes, send: Send) -> None:
        if number in ANSWERS:
            self._send(send, ANSWERS[number], self._asked(number))
        elif number == SET_POSCOUNTER:
            self._zero = self.shaft() - struct.unpack("<Hi", body)[1]
        elif number == SET_VELPARAMS:
            self._words = acceleration, speed = struct.unpack("<Hiii", body)[2:]
            self._speed, self._acceleration = speed / VELOCITY_UNIT, acceleration / ACCELERATION_UNIT
        elif number == SET_GENMOVEPARAMS:
            self._backlash = struct.unpack("<Hi", body)[1]
        elif number == MOVE_ABSOLUTE:
            self._turn(struct.unpack("<Hi", body)[1] + self._zero, MOVE_COMPLETED)
        elif number == MOVE_HOME:
            self.homed = False
            self._turn(0.0, MOVE_HOMED)
        elif number == MOVE_STOP:
            self.leaving()
            self._way = motion.rest(self._clock(), self.shaft())
            self._ending = MOVE_STOPPED

    def _asked(self, number: int) -> bytes:
        """The data of the answer to a question."""
        info = struct.pack("<I8sHBBBB", self.serial, self.model, 16, 2, 0, 1, 0)
        return {
            HW_REQ_INFO: info.ljust(78, b"\x00") + struct.pack("<HHH", 1, 0, 1),
            REQ_POSCOUNTER: struct.pack("<Hi", 1, self._counter()),
            REQ_VELPARAMS: struct.pack("<Hiii", 1, 0, *self._words),
            REQ_GENMOVEPARAMS: struct.pack("<Hi", 1, self._backlash),
            REQ_STATUSBITS: struct.pack("<HI", 1, self._bits()),
        }[number]

    def _turn(self, goal: float, ending: int) -> None:
        if self.stalled:
            return
        self.leaving()
        now = self._clock()
        position, velocity = self._way.at(now)
        self._way = motion.to_position(now, position, velocity, goal, self._speed, self._acceleration)
        self._ending = ending

    def _counter(self) -> int:
        return round(self.shaft() - self._zero)

    def _bits(self) -> int:
        bits = ENABLED | self.faults | (HOMED if self.homed else 0)
        if self.moves():
            bits |= FORWARD if self._way.at(self._clock())[1] > 0 else REVERSE
            bits |= HOMING if self._ending == MOVE_HOMED else 0
        return bits

    def _send(self, send: Send, number: int, data: bytes = b"", *, short: int = 0) -> None:
        out = struct.pack("<HHBB", number, len(data) or short, HOST | LONG if data else HOST, DEVICE) + data
        if self.damaged:
            self.damaged -= 1
            out = out[:-3]
        send(out)
