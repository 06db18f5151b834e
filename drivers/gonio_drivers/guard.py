"""Darkens a lamp whose program has died without a chance to do so (kill -9, a crash in compiled code, lack of memory).

The guard is a small process beside the program that lights the lamp. It waits at a pipe: a byte says that the lamp was
left in order, and the end of the pipe without one says that the program is dead. Then it sends the commands that darken
the lamp, unless another program has the port by now: that one darkens it by itself.

It can be given a time as well, for a program that may stand still (SIGSTOP, a debugger, a swapped-out computer): when
that is over it darkens the lamp over the head of the program, whose port it is still. A line with a number of seconds
sets the time anew, from now on; 0 lets it wait for ever; "?" changes nothing.

Every line is answered, by its number, and none while it darkens: a program that lights the lamp asks first, so that no
order to darken of an earlier lighting comes after it. The answer says whether the time is over; then the lamp may not
be lit before it is set anew.
"""

import contextlib
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from typing import IO

import serial

from gonio import platform

TIMES = 3
PAUSE_S = 0.1
POLL_S = 0.02
WRITE_S = 3.0
PATIENCE_S = 5.0
"""A port that is locked for longer is another program's."""
ANSWER_S = 30.0
"""Wait for an answer after which a guard counts as stopped by somebody."""
GOOD, OVER = b"good", b"over"
"""Answers: the lamp may shine; its time is over."""


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
            sys.executable, "-I", __file__, port, str(baud), str(limit_s), str(os.getpid()),
            *(order.hex() for order in orders)
        ]  # fmt: skip
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._asking = threading.Lock()
        self._asked = 0

    def start(self) -> None:
        """Begin to watch; the process has a session of its own, so that no Ctrl-C reaches it."""
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            **platform.detached(),
        )
        assert self._process.stdout is not None
        self._answers = _lines_of(self._process.stdout)

    def allow(self, limit_s: float) -> None:
        """Darken `limit_s` from now, whatever the program does, and not before; 0 for no limit. From any thread."""
        self._ask(f"{limit_s:.3f}")

    def over(self) -> bool:
        """Whether the time is over, and the lamp was darkened for it; waits until the last order to darken is out."""
        return self._ask("?") == OVER

    def _ask(self, what: str) -> bytes:
        """The answer to a line; b"" where somebody has ended or stopped the guard, or it is released."""
        with self._asking:
            process = self._process
            if process is None or process.stdin is None:
                return b""
            self._asked += 1
            with contextlib.suppress(OSError, ValueError, queue.Empty):
                process.stdin.write(f"{self._asked} {what}\n".encode())
                process.stdin.flush()
                while line := self._answers.get(timeout=ANSWER_S):
                    number, _, answer = line.rstrip(b"\n").partition(b" ")
                    if int(number) == self._asked:  # and not the answer to a question that was interrupted
                        return answer
            return b""

    def release(self, *, in_order: bool) -> None:
        """End the watch: the lamp is left in order, or the guard darkens it now that its port is closed."""
        with self._asking:
            process, self._process = self._process, None
        if process is not None and process.stdin is not None:
            with contextlib.suppress(OSError):  # somebody has ended the guard
                process.stdin.write(b"x" if in_order else b"")
            with contextlib.suppress(OSError):
                process.stdin.close()
            process.wait()


def is_darkening(port: str) -> bool:
    """Whether the guard of a program that has died is at work at a port."""
    for words in platform.command_lines():
        if words[2:4] == [__file__, port] and not platform.is_alive(int(words[6])):
            return True
    return False


def _lines_of(pipe: IO[bytes]) -> queue.SimpleQueue[bytes]:
    """The lines of a pipe as they come, and b"" at its end; from a thread, since not every system waits for pipes."""
    lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def read() -> None:
        with contextlib.suppress(OSError, ValueError), pipe:
            for line in pipe:
                lines.put(line)
        lines.put(b"")

    threading.Thread(target=read, daemon=True).start()
    return lines


def _darken(port: str, baud: int, orders: list[bytes], *, alone: bool = True) -> None:
    """Send the orders as soon as the port is the guard's: it may be closed a good while after the dead program's pipe.

    A server on the network may take a second connection and drop it: then it is tried anew.
    """
    end = time.monotonic() + PATIENCE_S
    while True:
        over = time.monotonic() > end  # before the try: this process may be held up after it
        with contextlib.suppress(OSError):
            patience = None if port.startswith("rfc2217:") else WRITE_S  # pyserial knows no such time there
            line = serial.serial_for_url(port, baud, timeout=0.0, write_timeout=patience, exclusive=alone or None)
            with line:
                for order in orders * TIMES:
                    line.write(order)
                    time.sleep(PAUSE_S)
                    line.read(4096)  # raises where the line was dropped; the answers themselves say nothing here
            return
        if over:
            return
        time.sleep(POLL_S)


def _wait(limit_s: float, at_time: Callable[[], None]) -> bool:
    """Listen at the pipe until it ends, and act when the time is over; whether the lamp was left in order."""
    end = time.monotonic() + limit_s if limit_s > 0 else None
    heard, answer = _lines_of(sys.stdin.buffer), GOOD
    last = b""
    while True:
        try:
            line = heard.get(timeout=None if end is None else max(end - time.monotonic(), 0.0))
        except queue.Empty:
            at_time()
            end, answer = None, OVER
            continue
        if not line:
            return last == b"x"
        last = line
        if not line.endswith(b"\n"):
            continue
        number, _, what = line.rstrip(b"\n").partition(b" ")
        if what != b"?":
            end, answer = time.monotonic() + float(what) if float(what) > 0 else None, GOOD
        with contextlib.suppress(OSError):  # who has asked is dead
            sys.stdout.buffer.write(number + b" " + answer + b"\n")
            sys.stdout.buffer.flush()


if __name__ == "__main__":
    to_darken = sys.argv[1], int(sys.argv[2]), [bytes.fromhex(order) for order in sys.argv[5:]]
    if not _wait(float(sys.argv[3]), lambda: _darken(*to_darken, alone=False)):
        _darken(*to_darken)
