"""Serial ports: opened for one owner only, with messages that say what is wrong and what to do."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import termios
from collections.abc import Iterator
from pathlib import Path

import serial

from gonio.errors import DeviceError

FAILURES = (serial.SerialException, OSError, termios.error)
"""What a serial port raises that does not open, or goes away."""


CLOGGED_S = 1.0
"""A line that takes no byte for this long is dead."""
MASTERS = {"/dev/ptmx", "/dev/pts/ptmx"}


def unopened(port: str, error: Exception, key: str) -> DeviceError:
    """What to tell a person whose port did not open; `key` is where the port was written."""
    said = f'{key} = "{port}"'
    number = getattr(error, "errno", None)
    text = str(error)
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or not Path(port).exists():
        there = ", ".join(present()) or "none"
        return DeviceError(f"{said}: there is no such port (is the adapter plugged in?); ports here: {there}")
    if number in (errno.EACCES, errno.EPERM):
        return DeviceError(
            f'{said}: no permission to open it; add yourself to its group ("sudo usermod -aG {_group(port)} $USER", '
            "then log in again) or install the udev rule of docs/lab_setup.md"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return DeviceError(f"{said}: the port is taken{_holder(port)}; end what holds it, then try again")
    if number == errno.EISDIR or isinstance(error, termios.error) or "configure port" in text:
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
    said = os.strerror(error.args[0]) if isinstance(error, termios.error) else error
    return DeviceError(f'{key} = "{port}": the port went away while in use ({said}); check cable and power')


def present() -> list[str]:
    """Serial ports that this machine has now, by their stable names where they have one."""
    from serial.tools import list_ports

    by_id = Path("/dev/serial/by-id")
    stable = {os.path.realpath(link): str(link) for link in by_id.iterdir()} if by_id.is_dir() else {}
    return sorted(stable.get(p.device, p.device) for p in list_ports.comports() if p.hwid != "n/a")


def _group(port: str) -> str:
    import grp

    try:
        return grp.getgrgid(Path(port).stat().st_gid).gr_name
    except (KeyError, OSError):
        return "dialout"


def _holder(port: str) -> str:
    """The other processes that have a port open, as far as they can be seen.

    A process that has the other end of a pseudo-terminal is the device, and no rival for it.
    """
    holders = []
    for process in holders_of(port):
        with contextlib.suppress(OSError):
            holders.append(f"process {process.name} ({(process / 'comm').read_text().strip()})")
    return f" by {' and '.join(holders)}" if holders else ""


def holders_of(port: str) -> Iterator[Path]:
    """The folders in /proc of other processes that have a port open, as far as they can be seen."""
    target = os.path.realpath(port)
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        try:
            opened = {os.readlink(link) for link in (process / "fd").iterdir()}
        except OSError:
            continue  # another user's process, or one that has just ended
        if target in opened and not opened & MASTERS:
            yield process
