"""The servos' own watchdog over the bus: arms whose program has died come to rest before their goal.

An X-series servo whose Bus Watchdog is armed stops at once when it has heard no instruction packet, for whichever
servo, for longer than a period. It then reads -1 and bars every goal until 0 is written (ROBOTIS e-Manual, "Bus
Watchdog(98)"). It is armed for the length of a motion only: an exposure may be longer than the longest period (2.54 s).

A firmware of 2022 that was stopped so made for a wrong goal where it had a homing offset (DynamixelSDK issue 584): the
driver keeps homing offsets at 0, and gives a goal of its own wherever it clears the watchdog.
"""

from collections.abc import Iterable, Sequence

from gonio_drivers import dynamixel, log
from gonio_drivers.joints import Joint

UNITS = 25
PERIOD_S = UNITS * 0.020
"""25 times the interval of the polls during a motion."""
RUN_OUT = 0xFF
OFF = 0
ITEM = "Bus Watchdog"


def arm(joints: Iterable[Joint]) -> None:
    """From now on these servos stop where the bus falls silent."""
    disarm(joints)  # one that has run out takes nothing else
    _write(_watched(joints), UNITS)


def call_off(joints: Iterable[Joint]) -> list[Joint]:
    """Disarm, and see that it is so; those whose watchdog had run out.

    Raises
    ------
    DeviceError
        A servo does not answer.
    """
    watched = _watched(joints)
    before = _read(watched)
    disarm(watched)
    after = _read(watched)
    for joint in watched:
        if after[joint.id] != OFF:
            joint.write(ITEM, OFF)
    return [joint for joint in watched if before[joint.id] == RUN_OUT]


def disarm(joints: Iterable[Joint]) -> None:
    """Disarm without waiting for anybody, in an emergency; goals can be given after it."""
    _write(_watched(joints), OFF)


def send_on(joint: Joint, goal: int) -> bool:
    """Whether the servo had stopped by its watchdog, because this program was held up; it is sent on to its goal."""
    if not joint.has_watchdog or joint.get(ITEM) != RUN_OUT:
        return False
    joint.write(ITEM, OFF)
    joint.send_profile()  # before the goal: running out has set it to 0
    joint.write("Goal Position", goal)
    joint.write(ITEM, UNITS)
    return True


def clear(joint: Joint) -> bool:
    """Whether it had run out: then it bars every goal, and tells of a program that died. Old firmware has none."""
    found = OFF
    try:
        found = joint.get(ITEM)
        joint.write(ITEM, OFF)
        joint.write(ITEM, UNITS)
        joint.has_watchdog = joint.get(ITEM) in (UNITS, RUN_OUT)
        joint.write(ITEM, OFF)
    except (dynamixel.Refusal, dynamixel.BusError):  # one that has gone silent altogether shows at the next step
        joint.has_watchdog = False
    if not joint.has_watchdog:
        log.warning(
            "axis %s: servo id %d has no bus watchdog (its firmware is older than 38): it would finish its way if "
            "this program died in the middle of a move", joint.name, joint.id,
        )  # fmt: skip
    if found == RUN_OUT:
        log.warning(
            "axis %s: servo id %d had stopped by itself, because a program died or its cable was pulled in the "
            "middle of a move; released", joint.name, joint.id,
        )  # fmt: skip
    return found == RUN_OUT


def _watched(joints: Iterable[Joint]) -> list[Joint]:
    return [joint for joint in joints if joint.has_watchdog]


def _write(joints: Sequence[Joint], value: int) -> None:
    if joints:
        item = joints[0].table[ITEM]  # at the same address in every model of the X series
        joints[0].bus.write_all(item.address, {joint.id: item.encode(value) for joint in joints})


def _read(joints: Sequence[Joint]) -> dict[int, int]:
    if not joints:
        return {}
    item = joints[0].table[ITEM]
    blocks = joints[0].bus.read_all([joint.id for joint in joints], item.address, item.size)
    return {identity: item.decode(block, item.address) for identity, block in blocks.items()}
