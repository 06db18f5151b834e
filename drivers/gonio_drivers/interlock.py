"""An interlock, or an emergency stop: a contact that has to be closed, or the lamp is dark and nothing moves.

A thread looks at the contact. Where it is open, or cannot be read any more, the thread sends the orders that darken the
lamp at once, past whatever the program is waiting for; the program itself stops the axes at its next look, which comes
every 20 ms while they move. From then on nothing lights up or moves until a person has acknowledged that, in this
process or in a later one: a file keeps it. It stands beside a hard-wired interlock of lamp and servos, and replaces
none: a program is no safety device.
"""

import contextlib
import hashlib
import json
import os
import threading
import time
from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import serial

from gonio.disk import write_whole
from gonio.errors import ConfigError, DeviceError, EmergencyStop
from gonio.lab.rig import Health, Reading
from gonio_drivers import ports, settings
from gonio_drivers.joints import Joint

KEY = "devices.interlock"
NAME = "interlock"
"""Name of its readings."""
PERIOD_S = 0.005
"""Time between two looks at a serial line."""
BUS_PERIOD_S = 0.02
"""The same at a servo's port, which the bus has to carry."""
AGAIN_S = (0.0, 0.05, 0.2)
"""When the orders to darken are sent: what the program was just writing may light the lamp after the first one."""
PULL_DOWN = 3
"""External Port Mode: a digital input that reads 0 where nothing is connected (ROBOTIS e-Manual, XM540, "External Port
Mode(56~58)")."""
READS = {"CTS": "cts", "DSR": "dsr", "DCD": "cd", "RI": "ri"}


class Tripped(EmergencyStop):
    """The contact is open, was open, or nobody knows."""


class Contact(contextlib.AbstractContextManager["Contact", None]):
    """Where a contact is read, while it is open as a context; opening it raises `DeviceError` where it cannot be."""

    name: str
    period_s: float

    @abstractmethod
    def closed(self) -> bool:
        """Whether it is closed, now; raises `DeviceError` where it cannot be read."""


class SerialLine(Contact):
    """A modem line of a serial port: asserted while a contact joins it to RTS or DTR, which are asserted here."""

    period_s = PERIOD_S

    def __init__(self, port: str, line: str) -> None:
        self.name = f"{line} of {port}"
        self._port_name, self._line = port, line
        self._port: serial.Serial | None = None

    def __enter__(self) -> Self:
        """Open the port, with RTS and DTR asserted."""
        try:
            self._port = serial.serial_for_url(self._port_name)
        except (*ports.FAILURES, ValueError) as error:
            raise ports.unopened(self._port_name, error, f"{KEY}.port") from None
        try:
            self._port.rts = self._port.dtr = True
            self.closed()
        except (*ports.FAILURES, DeviceError):
            self.__exit__()
            raise DeviceError(
                f'{KEY}.port = "{self._port_name}": this port does not tell its line {self._line}; take an adapter '
                "that has modem lines"
            ) from None
        return self

    def closed(self) -> bool:
        """Whether the line is asserted."""
        if self._port is None:
            raise DeviceError(f"{KEY}: {self._port_name} is not open")
        with ports.in_use(self._port_name, f"{KEY}.port"):
            return bool(getattr(self._port, READS[self._line]))

    def __exit__(self, *_: object) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*ports.FAILURES):
                port.close()


class ServoPort(Contact):
    """An external port of a servo (XM540, XH540 and their like): 1 while a contact joins it to the servo's 3.3 V."""

    period_s = BUS_PERIOD_S

    def __init__(self, joint: Joint, number: int) -> None:
        self.name = f"external port {number} of axis {joint.name} (servo id {joint.id})"
        self._joint, self._number = joint, number
        if f"External Port Data {number}" not in joint.table:
            raise ConfigError(
                f'{KEY}.axis = "{joint.name}": a {joint.servo.model} has no external port; take the axis of an XM540 '
                "or XH540, or a serial line"
            )
        joint.also[f"External Port Mode {number}"] = PULL_DOWN

    def __enter__(self) -> Self:
        """The port must be an input with a pull-down, as `preparation.prepare` makes it."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(self._joint.bus)
            if self._joint.get(f"External Port Mode {self._number}") != PULL_DOWN:
                raise DeviceError(
                    f"{KEY}: {self.name} is no input with a pull-down yet; a command that opens the arms makes it one, "
                    "such as gonio rig check --no-move"
                )
            stack.pop_all()
        return self

    def make_input(self) -> None:
        """Make the port an input where that takes no torque from an axis; `open` says where it is none."""
        mode = f"External Port Mode {self._number}"
        if self._joint.get("Torque Enable") == 0 and self._joint.get(mode) != PULL_DOWN:
            self._joint.write(mode, PULL_DOWN)

    def closed(self) -> bool:
        """Whether the port reads 1."""
        return self._joint.get(f"External Port Data {self._number}") == 1

    def __exit__(self, *_: object) -> None:
        """The bus stays open for the arms, if they are."""
        self._joint.bus.__exit__()


@dataclass(frozen=True, slots=True)
class Latch:
    """A file that keeps, beyond the process, that a contact was open and nobody has acknowledged it."""

    path: Path

    @classmethod
    def of(cls, contact: str) -> "Latch":
        """That of a contact, in the user's folder for the state of programs."""
        state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
        return cls(state / "gonio" / f"interlock-{hashlib.sha256(contact.encode()).hexdigest()[:12]}.json")

    def set(self, why: str) -> str:
        """Keep why; a text for the message where that fails."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, json.dumps({"when": time.strftime("%Y-%m-%d %H:%M:%S"), "why": why}).encode())
        except OSError as error:
            return f" ({self.path} cannot be written, {error.strerror}: the next program will not know of it)"
        return ""

    def why(self) -> str:
        """When and why; "" where nothing is kept."""
        try:
            kept = json.loads(self.path.read_bytes())
            return f"{kept['why']}, at {kept['when']}"
        except FileNotFoundError:
            return ""
        except (OSError, ValueError, KeyError, TypeError):
            return f"{self.path} is there, and cannot be read"

    def require(self) -> None:
        """Raise `Tripped` where something is kept."""
        if kept := self.why():
            raise Tripped(_stopped(f"not acknowledged yet: {kept}"))

    def clear(self) -> None:
        """Forget it."""
        self.path.unlink(missing_ok=True)


class Interlock:
    """A contact that is looked at by a thread while the rig is open.

    Parameters
    ----------
    contact
        Where it is read.
    darken
        Sends what darkens the lamp, without waiting for an answer; called from the thread.
    latch
        Where a stop is kept until somebody acknowledges it.
    """

    def __init__(self, contact: Contact, darken: Callable[[], None], latch: Latch) -> None:
        self.contact, self.latch = contact, latch
        self._darken = darken
        self._why = ""
        self._known = False  # whether it had stopped the rig already when it was entered
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def tripped(self) -> bool:
        """Whether it has stopped the rig."""
        return bool(self._why)

    def require(self) -> None:
        """Raise `Tripped` where the contact is open, was open since the rig was opened, or was never acknowledged."""
        if self._why:
            raise Tripped(_stopped(self._why))

    def look_again(self) -> None:
        """Look once more before the rig is left; raises `Tripped` where the contact has opened since it was entered."""
        if self._thread is not None and not self._why:
            self._look()
        if not self._known:
            self.require()

    def __enter__(self) -> "Interlock":
        self.contact.__enter__()
        kept = self.latch.why()
        self._why = f"not acknowledged yet: {kept}" if kept else ""
        if not kept:
            self._look()
        self._known = self.tripped
        self._ends.clear()
        self._thread = threading.Thread(target=self._watch, name="gonio-interlock", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self.contact.__exit__(None, None, None)

    def acknowledge(self) -> str:
        """A person says that the cause is removed; what is forgotten by it, "" where nothing was kept.

        Raises
        ------
        Tripped
            The contact is open still, or cannot be read.
        """
        with self.contact:
            if not self.contact.closed():
                raise Tripped(f"{KEY}: the contact at {self.contact.name} is open; close it first")
        kept = self.latch.why()
        self.latch.clear()
        return kept

    def survey(self) -> Health:
        """Whether the contact is closed, and whether a stop waits to be acknowledged; nothing is changed by it."""
        try:
            with self.contact:
                closed = self.contact.closed()
        except DeviceError as failure:
            return Health((), {NAME: _unread(self.contact, failure)})
        kept = self.latch.why()
        wrong = [] if closed else ["emergency stop: the contact is open"]
        wrong += [f"not acknowledged: {kept} (gonio rig acknowledge)"] if kept else []
        said = Reading(NAME, "contact", f"contact at {self.contact.name} {'closed' if closed else 'open'}")
        return Health((said, Reading(NAME, "error", "; ".join(wrong) or "none")))

    def _look(self) -> None:
        try:
            why = "" if self.contact.closed() else f"the contact at {self.contact.name} is open"
        except DeviceError as failure:
            why = _unread(self.contact, failure)
        if why:
            self._why = why  # first of all: whoever looks is stopped from now on
            self._why += self.latch.set(why)

    def _watch(self) -> None:
        while not self._why:
            if self._ends.wait(self.contact.period_s):
                return
            try:
                self._look()
            except Exception as error:  # whatever it is: a watch that has died must not look like a closed contact
                self._why = f"the contact at {self.contact.name} cannot be watched: {error!r}"
        begun = time.monotonic()
        for after_s in AGAIN_S:
            if self._ends.wait(max(0.0, begun + after_s - time.monotonic())):
                return
            self._darken()


def _unread(contact: Contact, failure: DeviceError) -> str:
    return f"the contact at {contact.name} cannot be read, which counts as open: {failure}"


def _stopped(why: str) -> str:
    return (
        f"{KEY}: emergency stop: {why}. Nothing lights up or moves until a person has removed the cause, closed the "
        "contact and run gonio rig acknowledge; a measurement goes on with --resume"
    )


def build(wanted: settings.InterlockSettings, joints: Mapping[str, Joint], darken: Callable[[], None]) -> Interlock:
    """The interlock of a rig file; nothing is opened yet."""
    if wanted.axis is None:
        contact: Contact = SerialLine(wanted.port, wanted.line)
    else:
        if wanted.axis not in joints:
            raise ConfigError(f'{KEY}.axis = "{wanted.axis}": the rig has no such axis; it has {", ".join(joints)}')
        contact = ServoPort(joints[wanted.axis], wanted.input)
    where = wanted.port or joints[str(wanted.axis)].bus.port
    return Interlock(contact, darken, Latch.of(f"{where} {contact.name}"))
