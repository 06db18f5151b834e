"""Faults by name: what goes wrong on the wire, in a servo, in the lamp, at the camera.

A fault is armed for the next event that it concerns (or the next `times` of them) and is spent by it; `Faults.fired`
tells what has happened.
"""

import threading
from dataclasses import dataclass

from gonio.errors import ConfigError
from gonio_sim.wire.servo import Servo

WIRE = ("silence", "late-reply", "corrupt-crc", "truncated-packet", "noise")
SERVO = ("stall", "overheat", "dropout", "reboot", "voltage-alarm")
LAMP = ("lamp-nak", "lamp-silent", "lamp-reset")
CAMERA = ("file-late", "file-truncated", "wrong-exposure", "file-duplicate", "file-missing")
HEALTH = ("hot", "sag", "estop")
"""Passing faults of a servo: near its temperature limit, near its lowest voltage, the contact at its port open."""
LIGHT = ("unlock", "room-light")
"""The source out of lock, and light in the room, for a while."""
NAMES = WIRE + SERVO + LAMP + CAMERA + HEALTH + LIGHT

LASTS_S = 60.0
"""How long what passes by itself lasts, on the twin's clock."""
LOCK_QUESTIONS = 3
"""Number of questions that are answered "out of lock"."""

LATE_S = 0.100
"""A late reply comes after the SDK has given up (34 ms), and after a patient driver has (84 ms)."""
FILE_LATE_S = 1.5


@dataclass(slots=True)
class Armed:
    """A fault that waits for its event."""

    name: str
    servo: int | None
    times: int
    skip: int


class Faults:
    """The faults that are armed on one set of twins; safe to use from several threads."""

    def __init__(self) -> None:
        self._armed: list[Armed] = []
        self._lock = threading.Lock()
        self.fired: list[str] = []

    def arm(self, name: str, *, servo: int | None = None, times: int = 1, skip: int = 0) -> None:
        """Let a fault happen at its next `times` events, after `skip` others; of one servo, where `servo` gives its id.

        Raises
        ------
        ConfigError
            There is no fault of that name.
        """
        if name not in NAMES:
            raise ConfigError(f'there is no fault "{name}"; known: {", ".join(NAMES)}')
        with self._lock:
            self._armed.append(Armed(name, servo, times, skip))

    def take(self, *names: str, servo: int | None = None) -> str | None:
        """The first armed fault among `names` that concerns this event; it is spent."""
        with self._lock:
            for armed in self._armed:
                if armed.name in names and (armed.servo is None or servo is None or armed.servo == servo):
                    if armed.skip > 0:
                        armed.skip -= 1
                        continue
                    armed.times -= 1
                    if armed.times <= 0:
                        self._armed.remove(armed)
                    self.fired.append(armed.name)
                    return armed.name
        return None

    def on_status(self, servo: Servo, status: bytes) -> list[tuple[float, bytes]]:
        """What a status packet becomes on the wire: delays [s] and bytes."""
        if (passing := self.take(*HEALTH, servo=servo.id)) is not None:
            servo.suffer(passing, LASTS_S)
        fault = self.take(*SERVO, *WIRE, servo=servo.id)
        if fault in SERVO:
            strike(servo, fault)
        spoiled = {
            "late-reply": [(LATE_S, status)],
            "corrupt-crc": [(0.0, status[:-1] + bytes([status[-1] ^ 0x5A]))],
            "truncated-packet": [(0.0, status[: len(status) // 2])],
            "noise": [(0.0, b"\x00\xff\xff\xfd\x13\x37\xff" + status)],
        }
        silent = fault in ("silence", "dropout", "reboot")
        return [] if silent else spoiled.get(fault or "", [(0.0, status)])


def strike(servo: Servo, fault: str) -> None:
    """Let something happen to a servo itself."""
    if fault == "overheat":
        servo.temperature_c = servo.get("Temperature Limit") + 5
    elif fault == "voltage-alarm":
        servo.supply_dv = servo.get("Min Voltage Limit") - 6
    else:
        {"stall": servo.block, "dropout": servo.lose_power, "reboot": servo.restart}[fault]()
