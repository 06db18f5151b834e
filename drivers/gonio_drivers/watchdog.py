"""The servos' own watchdog over the bus: arms whose program has died come to rest before their goal.

An X-series servo whose Bus Watchdog is armed stops at once when it has heard no instruction packet, for whichever
servo, for longer than a period. It then reads -1 and bars every goal until 0 is written (ROBOTIS e-Manual, "Bus
Watchdog(98)"). It is armed for the length of a motion only: an exposure may be longer than the longest period (2.54 s).

A firmware of 2022 that was stopped so made for a wrong goal where it had a homing offset (DynamixelSDK issue 584): the
driver keeps homing offsets at 0, and gives a goal of its own wherever it clears the watchdog.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol, TypeVar

from gonio_drivers.control_table import Item
from gonio_drivers.dynamixel import Bus

UNITS = 25
PERIOD_S = UNITS * 0.020
"""25 times the interval of the polls during a motion."""
RUN_OUT = 0xFF
OFF = 0
ITEM = "Bus Watchdog"


class Servo(Protocol):
    """A servo that may have a watchdog."""

    @property
    def id(self) -> int:
        """On its bus."""

    @property
    def bus(self) -> Bus:
        """What it is reached by."""

    @property
    def table(self) -> Mapping[str, Item]:
        """Its control table."""

    @property
    def has_watchdog(self) -> bool:
        """False with a firmware older than 38."""

    def write(self, name: str, value: int) -> None:
        """Change an item of the table."""


S = TypeVar("S", bound=Servo)


def arm(servos: Iterable[Servo]) -> None:
    """From now on these servos stop where the bus falls silent."""
    watched = [servo for servo in servos if servo.has_watchdog]
    _write(watched, OFF)  # one that has run out takes nothing else
    _write(watched, UNITS)


def call_off(servos: Iterable[S]) -> list[S]:
    """Disarm, and see that it is so; those servos whose watchdog had run out.

    Raises
    ------
    DeviceError
        A servo does not answer.
    """
    watched = [servo for servo in servos if servo.has_watchdog]
    before = _read(watched)
    _write(watched, OFF)
    after = _read(watched)
    for servo in watched:
        if after[servo.id] != OFF:
            servo.write(ITEM, OFF)
    return [servo for servo in watched if before[servo.id] == RUN_OUT]


def disarm(servos: Iterable[Servo]) -> None:
    """Disarm without waiting for anybody, in an emergency; goals can be given after it."""
    _write([servo for servo in servos if servo.has_watchdog], OFF)


def _write(servos: Sequence[Servo], value: int) -> None:
    if servos:
        item = servos[0].table[ITEM]  # at the same address in every model of the X series
        servos[0].bus.write_all(item.address, {servo.id: item.encode(value) for servo in servos})


def _read(servos: Sequence[Servo]) -> dict[int, int]:
    if not servos:
        return {}
    item = servos[0].table[ITEM]
    blocks = servos[0].bus.read_all([servo.id for servo in servos], item.address, item.size)
    return {identity: item.decode(block, item.address) for identity, block in blocks.items()}
