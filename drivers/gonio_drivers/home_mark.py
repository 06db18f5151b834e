"""How it is known that a servo still counts the turns that it counted when it was homed.

A servo in an Extended Position mode forgets its turns when its power goes, and when its mode changes; nothing that it
reports says so. So homing leaves a mark in its RAM, which goes with the power too: in four Indirect Addresses, which
nobody uses here, and which a start sets back to their defaults (ROBOTIS e-Manual, "Indirect Address"). The mark holds
the turns that were found, and a check of the zero count, gear and direction that they were found with. A servo without
a mark is not homed, and its angle is not known. No file holds the mark, so that none can be out of date.

Firmware can be told to restore its RAM at the start (Startup Configuration, bit 1): a mark means nothing there.
"""

from gonio.errors import ConfigError, DeviceError
from gonio_drivers import dynamixel, settings, watchdog
from gonio_drivers.joints import Joint

FIRST, ENTRIES = 17, 4
"""Indirect Address 17 to 20: the last that every model of the X series has."""
LOWEST = 64
"""Indirect Addresses take addresses from here on."""
DIGIT = 64
SIGN = LOWEST + 37
STARTUP, RESTORES_RAM = 60, 0x02
"""The item Startup Configuration, which the SDK's tables lack."""


def check(joint: Joint, homing: settings.Homing) -> None:
    """Raise `ConfigError` where an axis cannot be homed as its file says."""
    key = f"{joint.key}.homing"
    if homing.how == "stall" and "Goal Current" not in joint.table:
        raise ConfigError(f'{key}.how = "stall": a {joint.servo.model} cannot limit its current; use a switch')
    if at_deg(joint, homing) is None:
        raise ConfigError(f"{key}.at_deg is missing: say where the axis stands at its stop, or give it hard_stops_deg")
    if homing.external_port is not None and f"External Port Data {homing.external_port}" not in joint.table:
        raise ConfigError(f"{key}.external_port = {homing.external_port}: a {joint.servo.model} has none; use `line`")


def at_deg(joint: Joint, homing: settings.Homing) -> float | None:
    """Where an axis stands at its place of homing [deg]."""
    if homing.at_deg is not None or homing.how != "stall" or joint.hard_stops_deg is None:
        return homing.at_deg
    return joint.hard_stops_deg[0 if homing.toward < 0 else 1]


def recall(joint: Joint) -> None:
    """Take over the turns that homing has found; raises `DeviceError` where the axis has to be homed (again)."""
    if joint.servo.homing is None:
        return
    found = _read(joint)
    turns = DIGIT * (found[1] - LOWEST) + found[2] - LOWEST - 256
    # a change of mode, and back, sets the profile to zero; so does a bus watchdog that runs out, which keeps the turns
    reset = joint.get("Profile Velocity") == 0 and joint.get(watchdog.ITEM) != watchdog.RUN_OUT
    if reset or _restores(joint) or found != _mark(joint, turns):
        raise DeviceError(
            f"axis {joint.name} is not homed: servo id {joint.id} has been switched on since, or its mode, zero_count, "
            f"direction or gear_ratio has changed, so that its turns are not known; gonio rig home {joint.name}"
        )
    joint.turns = turns


def leave(joint: Joint, turns: int) -> None:
    """Leave the mark of a homing, and see that it is there."""
    _write(joint, _mark(joint, turns))
    recall(joint)


def wipe(joint: Joint) -> None:
    """Whatever happens now, the turns are not known any more. A start leaves the same."""
    _write(joint, [LOWEST] * ENTRIES)


def _mark(joint: Joint, turns: int) -> list[int]:
    high, low = divmod(turns + 256, DIGIT)
    built = joint.servo.zero_count + round(1000 * joint.servo.gear_ratio) * 7 + (joint.servo.direction + 1) * 3
    return [SIGN, LOWEST + high, LOWEST + low, LOWEST + (built + 5 * high + 3 * low) % 151]


def _restores(joint: Joint) -> bool:
    try:
        return bool(joint.bus.read(joint.id, STARTUP, 1)[0] & RESTORES_RAM)
    except dynamixel.Refusal:  # firmware that is older than this item
        return False


def _address(joint: Joint) -> int:
    return joint.table["Indirect Address 1"].address + 2 * (FIRST - 1)


def _read(joint: Joint) -> list[int]:
    block = joint.bus.read(joint.id, _address(joint), 2 * ENTRIES)
    return [int.from_bytes(block[k : k + 2], "little") for k in range(0, 2 * ENTRIES, 2)]


def _write(joint: Joint, values: list[int]) -> None:
    joint.bus.write(joint.id, _address(joint), b"".join(value.to_bytes(2, "little") for value in values))
