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

from gonio_drivers.dynamixel import Bus, Item

UNITS = 25
PERIOD_S = UNITS * 0.020
"""25 times the interval of the polls during a motion."""
RUN_OUT = 0xFF
OFF = 0
ITEM = "Bus Watchdog"


class Watched(Protocol):
    """A servo on a bus, as far as its watchdog is concerned (`gonio_drivers.joints.Joint`)."""

    has_watchdog: bool

    @property
    def id(self) -> int: ...
    @property
    def bus(self) -> Bus: ...
    @property
    def table(self) -> Mapping[str, Item]: ...
    def write(self, name: str, value: int, /) -> None: ...


J = TypeVar("J", bound=Watched)


def arm(joints: Iterable[Watched]) -> None:
    """From now on the servos of these joints stop where the bus falls silent."""
    watched = [joint for joint in joints if joint.has_watchdog]
    _write(watched, OFF)  # one that has run out takes nothing else
    _write(watched, UNITS)


def call_off(joints: Iterable[J]) -> list[J]:
    """Disarm, and see that it is so; those joints whose watchdog had run out.

    Raises
    ------
    DeviceError
        A servo does not answer.
    """
    watched = [joint for joint in joints if joint.has_watchdog]
    before = _read(watched)
    _write(watched, OFF)
    after = _read(watched)
    for joint in watched:
        if after[joint.id] != OFF:
            joint.write(ITEM, OFF)
    return [joint for joint in watched if before[joint.id] == RUN_OUT]


def disarm(joints: Iterable[Watched]) -> None:
    """Disarm without waiting for anybody, in an emergency; goals can be given after it."""
    _write([joint for joint in joints if joint.has_watchdog], OFF)


def _write(joints: Sequence[Watched], value: int) -> None:
    if joints:
        item = joints[0].table[ITEM]  # at the same address in every model of the X series
        joints[0].bus.write_all(item.address, {joint.id: item.encode(value) for joint in joints})


def _read(joints: Sequence[Watched]) -> dict[int, int]:
    if not joints:
        return {}
    item = joints[0].table[ITEM]
    blocks = joints[0].bus.read_all([joint.id for joint in joints], item.address, item.size)
    return {identity: item.decode(block, item.address) for identity, block in blocks.items()}
