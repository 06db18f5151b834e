"""What the joints of an arm report while they move, all in one message."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from gonio.errors import DeviceError
from gonio_drivers.control_table import Item
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import PROFILE_ONGOING, Health, Joint

REPORTED = frozenset(
    {
        "Goal Position", "Moving", "Moving Status", "Present Current", "Present Load", "Present Position",
        "Present Input Voltage", "Present Temperature",
    }
)  # fmt: skip
"""Items that a report needs; all lie in one block from Profile Acceleration to Present Temperature."""


@dataclass(slots=True)
class Report:
    """One reading of a joint."""

    position: int
    moving: bool
    """Faster than the servo's threshold, 14 deg/s as it comes."""
    under_way: bool
    """Its profile has not ended, however slow it is."""
    goal: int
    profile: bytes
    current: int


def span(table: Mapping[str, Item]) -> tuple[int, int]:
    """Address and size of the block that a report reads."""
    first, last = table["Profile Acceleration"], table["Present Temperature"]
    return first.address, last.address + last.size - first.address


def reports(bus: Bus, joints: Iterable[Joint]) -> dict[str, Report]:
    """What every servo says now, by the name of its axis, with its health checked; one block a servo.

    Raises
    ------
    DeviceError
        A servo does not answer, or is unwell.
    """
    by_id = {joint.id: joint for joint in joints}
    groups: dict[tuple[int, int], list[int]] = {}
    for joint in by_id.values():
        groups.setdefault(span(joint.table), []).append(joint.id)
    blocks: dict[int, bytes] = {}
    for (address, size), ids in groups.items():
        blocks |= bus.read_all(ids, address, size)
    out = {}
    for identity, block in blocks.items():
        joint = by_id[identity]
        start = span(joint.table)[0]
        value = {n: joint.table[n].decode(block, start) for n in joint.table if n in REPORTED}
        current = value.get("Present Current", value.get("Present Load", 0))
        joint.health = Health(value["Present Temperature"], value["Present Input Voltage"] / 10, current)
        joint.strained[:] = [
            max((*joint.strained, joint.health), key=lambda h: abs(h.current)),
            min((*joint.strained, joint.health), key=lambda h: h.voltage_v),
        ]
        profile = block[: len(joint.profile)]
        under_way = bool(value["Moving Status"] & PROFILE_ONGOING)
        out[joint.name] = Report(
            value["Present Position"], bool(value["Moving"]), under_way, value["Goal Position"], profile, current
        )
        joint.check_health()
    return out


def require_torque(bus: Bus, joints: Iterable[Joint]) -> None:
    """Raise `DeviceError` where a servo has an error in its hardware-error byte, or holds nothing any more."""
    by_id = {joint.id: joint for joint in joints}
    table = next(iter(by_id.values())).table  # these items have the same addresses in every model of the X series
    torque, error = table["Torque Enable"], table["Hardware Error Status"]
    blocks = bus.read_all(by_id, torque.address, error.address + error.size - torque.address)
    for identity, joint in by_id.items():
        joint.complain(error.decode(blocks[identity], torque.address))
        if torque.decode(blocks[identity], torque.address) != 1:
            raise DeviceError(f"axis {joint.name}: servo id {identity} has let go of its torque; all axes are stopped")
