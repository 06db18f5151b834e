"""Serial ports: opened for one owner only, with messages that say what is wrong and what to do.

A port is what pyserial opens: `COM3`, `/dev/ttyUSB0`, `socket://host:port` (a raw server, such as ser2net or
`gonio sim serve --tcp`), `rfc2217://host:port` (one that knows line speeds too).
"""

import contextlib
import errno
import os
import selectors
from collections.abc import Iterator
from pathlib import Path

import serial

from gonio import platform
from gonio.errors import DeviceError

FAILURES = (serial.SerialException, OSError, *platform.TERMINAL_ERRORS)
"""What a serial port raises that does not open, or goes away."""
WORDED = {"FileNotFoundError": errno.ENOENT, "PermissionError": errno.EBUSY}
"""What Windows says of a port that is missing, and of one that another program has open."""

DEVICES = ("/dev/", "COM")
"""How the names of this computer's own ports begin."""
CLOGGED_S = 3.0
"""A line that takes no byte for this long is dead."""


def unopened(port: str, error: Exception, key: str) -> DeviceError:
    """What to tell a person whose port did not open; `key` is where the port was written."""
    said = f'{key} = "{port}"'
    text = str(error)
    if is_url(port):
        return DeviceError(f"{said}: {text}; is the server running there, and free (one program at a time)?")
    number = getattr(error, "errno", None)
    if number is None:  # where there are no device files pyserial puts the system's error into words
        number = next((n for name, n in WORDED.items() if name in text), None)
    if number in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in text:
        return DeviceError(f"{said}: the port is taken{_holder(port)}; end what holds it, then try again")
    if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO) or not Path(port).exists():
        there = ", ".join(present()) or "none"
        missing = (
            "is the adapter plugged in?"
            if port.startswith(DEVICES)
            else "if it is a twin's: does `gonio sim serve` run?"
        )
        return DeviceError(f"{said}: there is no such port ({missing}); ports here: {there}")
    if number in (errno.EACCES, errno.EPERM):
        group = platform.group_of(port) or "dialout"
        return DeviceError(
            f'{said}: no permission to open it; add yourself to its group ("sudo usermod -aG {group} $USER", '
            "then log in again) or install the udev rule of docs/lab_setup.md"
        )
    if number == errno.EISDIR or isinstance(error, platform.TERMINAL_ERRORS) or "configure port" in text:
        return DeviceError(f"{said}: this is no serial port; ports here: {', '.join(present()) or 'none'}")
    return DeviceError(f"{said}: cannot be opened as a serial port: {text}")


def require_free(port: str, key: str) -> None:
    """Raise `DeviceError` where another process has a port open; a lock does not tell, as few programs take one."""
    if holder := _holder(port):
        raise DeviceError(f'{key} = "{port}": the port is taken{holder}; end what holds it, then try again')


def opened(port: str, baud: int, timeout_s: float, key: str) -> serial.Serial:
    """A port that nobody else may open; a read from it ends after `timeout_s`.

    Raises
    ------
    DeviceError
        It does not open; `key` is where the port was written.
    """
    patience = None if port.startswith("rfc2217:") else CLOGGED_S  # pyserial knows no such time there
    try:
        return serial.serial_for_url(port, baud, timeout=timeout_s, write_timeout=patience, exclusive=True)
    except (*FAILURES, ValueError) as error:
        raise unopened(port, error, key) from None


def send(line: serial.SerialBase, data: bytes) -> None:
    """Write bytes, however long the computer is held up meanwhile; raises `FAILURES` where the line takes no more."""
    try:
        line.write(data)
    except serial.SerialTimeoutException:
        # pyserial says so, too, of what it has written where this program stood still right after it
        if not _takes_more(line):
            raise


def _takes_more(port: serial.SerialBase) -> bool:
    """Whether a port of this computer is not clogged; False of one that is a server's, or no file."""
    if not hasattr(port, "fd"):
        return False
    with selectors.DefaultSelector() as selector:
        selector.register(port.fd, selectors.EVENT_WRITE)
        return bool(selector.select(0))


def is_url(port: str) -> bool:
    """Whether a port is a server's address, and no device of this computer."""
    return "://" in port


def lost(port: str, error: Exception, key: str) -> DeviceError:
    """What to tell a person whose port went away while it was in use."""
    said = os.strerror(error.args[0]) if isinstance(error, platform.TERMINAL_ERRORS) else error
    if is_url(port):
        return DeviceError(
            f'{key} = "{port}": the server has closed the connection ({said}); does another program use it?'
        )
    return DeviceError(f'{key} = "{port}": the port went away while in use ({said}); check cable and power')


@contextlib.contextmanager
def in_use(port: str, key: str) -> Iterator[None]:
    """While a port is used, its failures become `DeviceError`."""
    try:
        yield
    except FAILURES as error:
        raise lost(port, error, key) from None


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
