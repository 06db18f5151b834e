"""What hangs at a port that nobody has described yet: which lamp, and which servo turns which axis.

Nothing here lights anything. A lamp is only asked for its name, in each shipped dialect in turn.
"""

import contextlib
import re

import serial

from gonio.errors import DeviceError
from gonio.rig import FoundServo
from gonio_drivers import control_table, ports
from gonio_drivers.dialect import DIALECTS, Dialect, dialect
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import COUNTS, POSITION_MODE, Servo
from gonio_drivers.patience import Patience

WIGGLE_COUNTS = 34
"""3 degrees: enough to see, and too little to hit anything."""
SLOW = 25
"""Profile velocity in 0.229 rpm: 34 degrees a second at most."""
GENTLE = 10
MOVED_S = 2.0
LISTEN_S = 0.3
RELEASE_BAUD = 115_200


def lamp_on(port: str) -> tuple[str, str] | None:
    """Dialect and name of the lamp at a port; None where none of the shipped dialects is spoken.

    Raises
    ------
    DeviceError
        The port cannot be opened.
    """
    for name in DIALECTS:
        spoken = dialect(name)
        with ports.in_use(port, "port"), ports.opened(port, int(spoken.baud), LISTEN_S, "port") as line:
            answer = _name(line, spoken)
        if answer is not None:
            return name, answer
    return None


def _name(line: serial.Serial, spoken: Dialect) -> str | None:
    """What a controller calls itself in a dialect; one that restarts when it is opened says first that it has."""
    heard, looked = "", Patience(LISTEN_S)
    while spoken.banner and (now := looked()) < spoken.banner_s:
        part = str(line.read(256), "ascii", "replace")
        heard += part
        if any(re.fullmatch(spoken.banner, text.strip()) for text in re.split(r"[\r\n]+", heard)):
            break
        if not part and not heard.strip() and now > 4 * LISTEN_S:
            break  # it says nothing: no restart, or no such controller
    for _ in range(2):  # what another dialect left in its buffer may spoil the first
        line.reset_input_buffer()
        line.write((spoken.identify + spoken.send_ending).encode())
        heard, looked = "", Patience(LISTEN_S)
        while looked() < 2 * LISTEN_S:
            heard += str(line.read(line.in_waiting or 1), "ascii", "replace")
            for text in re.split(r"[\r\n]+", heard)[:-1]:
                known = text.strip().removeprefix((spoken.prompt or "").strip()).strip()
                if re.fullmatch(spoken.identity, known) and known != spoken.identify:
                    return known
    return None


def is_release(port: str) -> bool:
    """Whether a release box answers a line that it does not know, and so makes no exposure."""
    with ports.in_use(port, "port"), ports.opened(port, RELEASE_BAUD, LISTEN_S, "port") as line:
        for _ in range(2):
            line.reset_input_buffer()
            line.write(b"\n?\n")
            if b"ERR" in line.read_until(b"\n") + line.read_until(b"\n"):
                return True
    return False


def count_of(servo: FoundServo) -> int:
    """Where a servo stands, as its count within one turn, without an offset of its own.

    Raises
    ------
    DeviceError
        It counts the other way round: what it will read once it does not is not known.
    """
    with Bus(servo.port, servo.baud) as bus:
        count = Servo(bus, servo.id, control_table.of_model(servo.model)).undisplaced_count()
    if count is None:
        raise DeviceError(
            f"servo id {servo.id} is in reverse mode (Drive Mode, bit 0), which no rig uses: reset it with the "
            "Dynamixel Wizard"
        )
    return count % COUNTS


def wiggle(servo: FoundServo) -> None:
    """Turn a servo by 3 degrees toward growing counts and back, slowly; then its torque is as it was before.

    Raises
    ------
    DeviceError
        It does not answer, or does not move; its torque is off then.
    """
    with Bus(servo.port, servo.baud) as bus:
        wiggled = Servo(bus, servo.id, control_table.of_model(servo.model))
        get, put = wiggled.get, wiggled.write
        held = get("Torque Enable")
        if get("Operating Mode") != POSITION_MODE:
            put("Torque Enable", 0)
            put("Operating Mode", POSITION_MODE)
        here = get("Present Position")
        put("Goal Position", here)
        put("Profile Velocity", SLOW)  # after the mode, which resets it
        put("Profile Acceleration", GENTLE)
        try:
            put("Torque Enable", 1)
            put("Goal Position", here)
            for goal in (here + WIGGLE_COUNTS, here):
                put("Goal Position", goal)
                looked = Patience()
                while abs(get("Present Position") - goal) > WIGGLE_COUNTS / 3:
                    if looked() > MOVED_S:
                        raise DeviceError(f"servo id {servo.id} does not turn: is something in its way")
        finally:
            if not held:
                with contextlib.suppress(DeviceError):
                    put("Torque Enable", 0)
