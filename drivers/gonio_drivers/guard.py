"""Darkens a lamp whose program has died without a chance to do so (kill -9, a crash in compiled code, lack of memory).

The guard is a small process beside the program that lights the lamp. It waits at a pipe: a byte says that the lamp was
left in order, and the end of the pipe without one says that the program is dead. Then it sends the commands that darken
the lamp, unless another program has the port by now: that one darkens it by itself.

It can be given a time as well, for a program that may stand still (SIGSTOP, a debugger, a swapped-out computer): when
that is over it darkens the lamp over the head of the program, whose port it is still. A line with a number of seconds
sets the time anew, from now on; 0 lets it wait for ever.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Callable

TIMES = 3
PAUSE_S = 0.1
POLL_S = 0.02
PATIENCE_S = 5.0
"""A port that is locked for longer is another program's."""


class Guard:
    """A guard process, from `start` to `release`.

    Parameters
    ----------
    port, baud
        Where the lamp is.
    orders
        The commands that darken it, as they go over the line.
    limit_s
        Darken it after so long, whatever the program does; 0 for no limit.
    """

    def __init__(self, port: str, baud: int, orders: list[bytes], limit_s: float = 0.0) -> None:
        self._command = [
            sys.executable, "-I", "-S", __file__, port, str(baud), str(limit_s), *(order.hex() for order in orders)
        ]  # fmt: skip
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Begin to watch; the process has a session of its own, so that no Ctrl-C reaches it."""
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def allow(self, limit_s: float) -> None:
        """Darken so long from now, whatever the program does, and not before; 0 for no limit."""
        process = self._process
        if process is not None and process.stdin is not None:
            with contextlib.suppress(BrokenPipeError, ValueError):  # somebody has ended the guard, or it is released
                os.write(process.stdin.fileno(), f"{limit_s:.3f}\n".encode())

    def release(self, *, in_order: bool) -> None:
        """End the watch: the lamp is left in order, or the guard darkens it now that its port is closed."""
        if self._process is not None:
            with contextlib.suppress(BrokenPipeError):  # somebody has ended the guard
                self._process.communicate(b"x" if in_order else b"")
            self._process = None


def _locked(line: int) -> bool:
    """Whether the port is the guard's; the dead program's pipe may be closed a good while before its port is."""
    end = time.monotonic() + PATIENCE_S
    while True:
        over = time.monotonic() > end  # before the look: this process may be held up after it
        try:
            fcntl.flock(line, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except OSError:
            if over:
                return False
            time.sleep(POLL_S)


def _darken(port: str, baud: int, orders: list[bytes], *, alone: bool = True) -> None:
    line = os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    if alone and not _locked(line):
        return
    tty.setraw(line)
    state = termios.tcgetattr(line)
    state[4] = state[5] = getattr(termios, f"B{baud}", state[4])
    termios.tcsetattr(line, termios.TCSANOW, state)
    for _ in range(TIMES):
        for order in orders:
            os.write(line, order)
            time.sleep(PAUSE_S)
    os.close(line)


def _wait(limit_s: float, at_time: Callable[[], None]) -> bool:
    """Listen at the pipe until it ends, and act when the time is over; whether the lamp was left in order."""
    end = time.monotonic() + limit_s if limit_s > 0 else None
    heard = b""
    while True:
        left = None if end is None else max(end - time.monotonic(), 0.0)
        if not select.select([sys.stdin], [], [], left)[0]:
            at_time()
            end = None
            continue
        some = os.read(sys.stdin.fileno(), 4096)
        heard += some
        *lines, heard = heard.split(b"\n")
        for line in lines:
            end = time.monotonic() + float(line) if float(line) > 0 else None
        if not some:
            return heard == b"x"


if __name__ == "__main__":
    to_darken = sys.argv[1], int(sys.argv[2]), [bytes.fromhex(order) for order in sys.argv[4:]]
    if not _wait(float(sys.argv[3]), lambda: _darken(*to_darken, alone=False)):
        _darken(*to_darken)
