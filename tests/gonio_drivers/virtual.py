"""Drivers and twins on one clock that nobody waits for: a line of servos in this process, without a terminal.

Every look takes the time that a test says, so that a computer that is held up is one, and no test hangs on how busy
this one is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from types import SimpleNamespace

import pytest
from gonio_drivers import arms, dynamixel, homing, motion, patience, ports, sdk, stage_arms
from gonio_drivers.sdk import ExclusivePort
from gonio_sim.wire import bus, peer, servo
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.servo import Servo

from gonio.rig import whereabouts

CLOCKED = arms, dynamixel, homing, motion, patience, stage_arms, bus, peer, servo, whereabouts
"""Whatever looks at a clock, or sleeps."""


class Hours:
    """What these modules take for the module `time`; between two looks at a device a computer may be held up."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.held_up: Callable[[], float] = lambda: 0.0
        """How long the computer is held up after each nap of the drivers [s]."""

    def monotonic(self) -> float:
        """Seconds; a look at the clock takes 10 us, so that whoever waits for a time without sleeping comes to it."""
        self.now_s += 1e-5
        return self.now_s

    perf_counter = monotonic

    def sleep(self, seconds: float) -> None:
        """Time passes."""
        self.now_s += seconds

    def nap(self, seconds: float) -> None:
        """The same for a program that shares its computer."""
        self.now_s += seconds + self.held_up()


class Wire:
    """A serial port with the twins right behind it."""

    def __init__(self, hours: Hours, twins: ServoBus) -> None:
        self._hours, self._twins = hours, twins
        self.baud, self.buffer = 0, bytearray()

    @property
    def in_waiting(self) -> int:
        return len(self.buffer)

    def reset_input_buffer(self) -> None:
        self.buffer.clear()

    def close(self) -> None:
        """Nothing to be closed."""

    def write(self, data: bytes) -> None:
        self._twins.receive(data, self.baud, self.buffer.extend)

    def read(self, length: int) -> bytes:
        if not self.buffer:
            self._hours.sleep(sdk.WAIT_S)
        data = bytes(self.buffer[:length])
        del self.buffer[:length]
        return data


def on_virtual_time(monkeypatch: pytest.MonkeyPatch, twins: Callable[[], Iterable[Servo]]) -> tuple[Hours, ServoBus]:
    """From now on every servo bus that a driver opens is this one; `twins` builds its servos, on the clock."""
    hours = Hours()
    for module in CLOCKED:
        sleep = hours.nap if module is motion else hours.sleep
        told = SimpleNamespace(monotonic=hours.monotonic, perf_counter=hours.monotonic, sleep=sleep)
        monkeypatch.setattr(module, "time", told)
    line = ServoBus(twins())
    wire = Wire(hours, line)

    def set_up(port: ExclusivePort, baud: int) -> bool:
        port.ser, port.is_open, port.tx_time_per_byte, wire.baud = wire, True, 1e4 / baud, baud
        return True

    def read(port: ExclusivePort, length: int) -> bytes:
        data = wire.read(length) if length > 0 else b""
        port.received += len(data)
        return data

    def write(port: ExclusivePort, packet: list[int]) -> int:
        wire.write(bytes(packet))
        return len(packet)

    monkeypatch.setattr(ports, "require_free", lambda port, key: None)
    for name, method in (("setupPort", set_up), ("readPort", read), ("writePort", write)):
        monkeypatch.setattr(ExclusivePort, name, method)
    return hours, line
