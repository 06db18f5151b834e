"""Serial ports: opened for one owner only, with messages that say what is wrong and what to do."""

from __future__ import annotations

import errno
import os
import select
from pathlib import Path

import serial

from gonio import platform
from gonio.errors import DeviceError

FAILURES = (serial.SerialException, OSError, *platform.TERMINAL_ERRORS)
"""What a serial port raises that does not open, or goes away."""


CLOGGED_S = 1.0
"""A line that takes no byte for this long is dead."""


def unopened(port: str, error: Exception, key: str) -> DeviceError:
    """What to tell a person whose port did not open; `key` is where the port was written."""
    said = f'{key} = "{port}"'
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or not Path(port).exists():
        there = ", ".join(present()) or "none"
        return DeviceError(f"{said}: there is no such port (is the adapter plugged in?); ports here: {there}")
    if number in (errno.EACCES, errno.EPERM):
        group = platform.group_of(port) or "dialout"
        return DeviceError(
            f'{said}: no permission to open it; add yourself to its group ("sudo usermod -aG {group} $USER", '
            "then log in again) or install the udev rule of docs/lab_setup.md"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return DeviceError(f"{said}: the port is taken{_holder(port)}; end what holds it, then try again")
    if number == errno.EISDIR or isinstance(error, platform.TERMINAL_ERRORS) or "configure port" in text:
        return DeviceError(f"{said}: this is no serial port; ports here: {', '.join(present()) or 'none'}")
    return DeviceError(f"{said}: cannot be opened as a serial port: {text}")


def require_free(port: str, key: str) -> None:
    """Raise `DeviceError` where another process has a port open: few programs take or heed a lock."""
    if holder := _holder(port):
        raise DeviceError(f'{key} = "{port}": the port is taken{holder}; end what holds it, then try again')


def opened(port: str, baud: int, timeout_s: float) -> serial.Serial:
    """A port that nobody else may open; a read from it ends after `timeout_s`."""
    return serial.Serial(port, baud, timeout=timeout_s, exclusive=True)


def wait(line: serial.Serial, seconds: float) -> None:
    """Until bytes are there, or so many seconds are over."""
    select.select([line.fileno()], [], [], seconds)


def send(line: serial.Serial, data: bytes) -> None:
    """Write all of `data`; raise `SerialTimeoutException` where the line takes none.

    `Serial.write` raises that too where all was written, but the computer was held up meanwhile.
    """
    while data:
        if not select.select([], [line.fileno()], [], CLOGGED_S)[1]:
            raise serial.SerialTimeoutException("Write timeout")
        try:
            data = data[os.write(line.fileno(), data) :]
        except BlockingIOError:
            continue


def lost(port: str, error: Exception, key: str) -> DeviceError:
    """What to tell a person whose port went away while it was in use."""
    said = os.strerror(error.args[0]) if isinstance(error, platform.TERMINAL_ERRORS) else error
    return DeviceError(f'{key} = "{port}": the port went away while in use ({said}); check cable and power')


def present() -> list[str]:
    """Serial ports that this machine has now, by their stable names where they have one."""
    from serial.tools import list_ports

    by_id = Path("/dev/serial/by-id")
    stable = {os.path.realpath(link): str(link) for link in by_id.iterdir()} if by_id.is_dir() else {}
    return sorted(stable.get(p.device, p.device) for p in list_ports.comports() if p.hwid != "n/a")


def _holder(port: str) -> str:
    """The other processes that have a port open, as far as they can be seen."""
    holders = [f"process {each.number} ({each.name})" for each in platform.holders_of(port)]
    return f" by {' and '.join(holders)}" if holders else ""
