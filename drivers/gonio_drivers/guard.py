"""Darkens a lamp whose program cannot: killed (kill -9, a crash in compiled code, lack of memory), or standing still.

The guard is a small process beside the program that lights the lamp. It waits at a pipe: a byte says that the lamp was
left in order, and the end of the pipe without one says that the program is dead. Then it sends the commands that darken
the lamp, unless another program has the port by now: that one darkens it by itself.

A program may stand still (SIGSTOP, a debugger, a device that does not come back), so the guard has a time as well. When
that is over it darkens the lamp over the head of the program, whose port it is still. "allow" sets the time anew, from
now on; 0 lets it wait for ever. "alive" does so unless the time is over: only who knows that the lamp is dark may begin
anew. "?" changes nothing. Another process of the same user may order darkness through a socket in a private folder.

Every line is answered, by its number, and none while it darkens: a program that lights the lamp asks first, so that no
order to darken of an earlier lighting comes after it. The answer says whether the lamp may shine.

A guard that has ended, or that stands still itself, is started anew. Where that fails the lamp is darkened.
"""

import contextlib
import os
import queue
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import serial

from gonio import platform

TIMES = 3
PAUSE_S = 0.1
POLL_S = 0.02
WRITE_S = 3.0
PATIENCE_S = 5.0
"""A port that is locked for longer is another program's."""
ANSWER_S = 10.0
"""Wait for an answer after which a guard counts as stopped by somebody."""
DARKENED_S = 30.0
"""A guard that has been told to darken is done by then."""
LOOK_S = 2.0
"""How often the program looks whether its guard stands still; one that has ended is seen at once."""
STARTS = 3
"""How often a guard is started anew for one question."""
BEAT_S = 1.0
"""Signs of life closer together than this are told as one."""
GOOD, OVER, ORDERED, LOST = b"good", b"over", b"ordered", b"lost"
"""The lamp may shine; its time is over; another process has ordered darkness; there is no guard."""
DOOR = "guard"
"""Name of the socket."""


class Guard:
    """A guard process, from `start` to `release`. Safe to be called from any thread.

    Parameters
    ----------
    port, baud
        Where the lamp is.
    orders
        The commands that darken it, as they go over the line.
    limit_s
        Darken it after so long, whatever the program does; 0 for no limit.
    darken
        Darkens it from any thread, where no guard can be kept alive, or another process has ordered it.
    """

    def __init__(
        self,
        port: str,
        baud: int,
        orders: list[bytes],
        limit_s: float = 0.0,
        darken: Callable[[], None] = lambda: None,
    ) -> None:
        self._port, self._baud, self._orders, self._darken = port, baud, orders, darken
        self._folder = ""
        self._process: subprocess.Popen[bytes] | None = None
        self._answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._asking = threading.Lock()
        self._asked = 0
        self._end = time.monotonic() + limit_s if limit_s > 0 else None
        """When the guard darkens, as far as it has been told."""
        self.by_hand = limit_s > 0
        """The time was set for good, and no sign of life moves it."""
        self._news: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._look, self._released = threading.Event(), threading.Event()

    def start(self) -> None:
        """Begin to watch; the process has a session of its own, so that no Ctrl-C reaches it.

        Raises
        ------
        OSError
            No process can be started.
        """
        if hasattr(socket, "AF_UNIX"):
            with contextlib.suppress(OSError):  # no room for it: nobody else can order darkness then
                self._folder = tempfile.mkdtemp(prefix="gonio-guard-")  # nobody but this user may enter it
        self._launch()
        threading.Thread(target=self._watch, daemon=True).start()

    def allow(self, limit_s: float) -> None:
        """Darken `limit_s` from now, whatever the program does, and not before; 0 for no limit."""
        self.by_hand = limit_s > 0
        self._ask("allow", limit_s)

    def alive(self, limit_s: float) -> None:
        """A sign of life: darken `limit_s` from now, unless the time was set by `allow`, or is over already."""
        told = self._end
        if not self.by_hand and (told is None or abs(time.monotonic() + limit_s - told) >= BEAT_S):
            self._ask("alive", limit_s)

    def rest(self) -> None:
        """The lamp is dark, and the program knows it: no limit, unless it was set by `allow`."""
        if not self.by_hand and self._end is not None:
            self._ask("allow", 0.0)

    def says(self) -> bytes:
        """Whether the lamp may shine; waits until the last order to darken is out."""
        return self._ask("?")

    def news(self) -> list[str]:
        """What has happened to the guard since the last call, for a person."""
        out = []
        while not self._news.empty():
            out.append(self._news.get())
        return out

    def release(self, *, in_order: bool) -> None:
        """End the watch: the lamp is left in order, or the guard darkens it now that its port is closed."""
        with self._asking:
            process, self._process = self._process, None
            self._released.set()
            self._look.set()
        if process is None:
            return
        if not self._ended(process, in_order) and not in_order:  # somebody has ended it, or stopped it
            with contextlib.suppress(OSError):
                again = self._started(0.0)
                assert again.stdout is not None
                _listen(again.stdout, lambda line: None)
                self._ended(again, in_order)
        shutil.rmtree(self._folder or os.devnull, ignore_errors=True)

    def _ended(self, process: subprocess.Popen[bytes], in_order: bool) -> bool:
        """Whether a guard has ended by itself, in the way that it was told to."""
        assert process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.write(b"x" if in_order else b"")
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            return process.wait(ANSWER_S if in_order else DARKENED_S) == 0
        except subprocess.TimeoutExpired:
            _end(process)
            return False

    # ---- inside ----

    def _started(self, limit_s: float) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [
                sys.executable, "-I", __file__, self._port, str(self._baud), str(limit_s), str(os.getpid()),
                self._folder, *(order.hex() for order in self._orders)
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            **platform.detached(),
        )  # fmt: skip

    def _launch(self) -> None:
        left_s = 0.0 if self._end is None else max(self._end - time.monotonic(), POLL_S)
        self._process = process = self._started(left_s)
        answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._answers = answers

        def ended(line: bytes) -> None:
            answers.put(line)
            if not line:
                self._look.set()

        assert process.stdout is not None
        _listen(process.stdout, ended)

    def _watch(self) -> None:
        """See that there is a guard, also while the program waits for something else."""
        before = GOOD
        while not self._released.is_set():
            self._look.wait(LOOK_S)
            self._look.clear()
            said = self._ask("?")
            if said != before and said in (ORDERED, LOST):
                with contextlib.suppress(Exception):  # whoever looks after the lamp sees that it is dark, and says so
                    self._darken()
            before = said
            if said == LOST:
                self._released.wait(LOOK_S)

    def _ask(self, what: str, limit_s: float | None = None) -> bytes:
        """The answer to a line, of this guard or of another one in its place; `GOOD` where it is released."""
        with self._asking:
            if limit_s is not None:
                self._end = time.monotonic() + limit_s if limit_s > 0 else None
            for _ in range(STARTS):
                process = self._process
                if process is None:
                    return GOOD
                try:
                    if answer := self._answer(process, what if limit_s is None else f"{what} {limit_s:.3f}"):
                        return answer
                    why = "was ended by somebody"
                except queue.Empty:
                    why = f"stood still for {ANSWER_S:g} s"
                except (OSError, ValueError):  # its pipe is closed
                    why = "was ended by somebody"
                _end(process)
                self._news.put(f"the lamp's guard (process {process.pid}) {why}; started anew")
                try:
                    self._launch()
                except OSError:
                    break
            return LOST

    def _answer(self, process: subprocess.Popen[bytes], what: str) -> bytes:
        """The answer to a line, b"" where the guard has ended; raises `queue.Empty` where none comes."""
        assert process.stdin is not None
        self._asked += 1
        process.stdin.write(f"{self._asked} {what}\n".encode())
        process.stdin.flush()
        while line := self._answers.get(timeout=ANSWER_S):
            number, _, answer = line.rstrip(b"\n").partition(b" ")
            if int(number) == self._asked:  # and not the answer to a question that was interrupted
                return answer
        return b""


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a guard that stands still, or has ended already, and close its pipe."""
    process.kill()
    process.wait()
    assert process.stdin is not None
    with contextlib.suppress(OSError):  # what was written last did not reach it
        process.stdin.close()


# ---- from other processes ----


def _guards(port: str) -> Iterator[tuple[int, str]]:
    """The program and the private folder of every guard at a port, under whatever name it is known."""
    for words in platform.command_lines():
        if len(words) > 7 and words[1] == "-I" and Path(words[2]).parts[-2:] == Path(__file__).parts[-2:]:
            same_device = "://" not in port and os.path.realpath(port) == os.path.realpath(words[3])
            if port == words[3] or same_device:
                yield int(words[6]), words[7]


def is_darkening(port: str) -> bool:
    """Whether the guard of a program that has died is at work at a port."""
    return any(not platform.is_alive(program) for program, _ in _guards(port))


def order_dark(port: str) -> tuple[int, bool] | None:
    """Have the guard of the living program that holds a port send the orders to darken.

    Returns
    -------
    number of that program's process, and whether the orders are out; None where this user has no such guard. Where the
    guard cannot open the port, its program is told, and darkens the lamp unless it stands still.
    """
    end = time.monotonic() + PATIENCE_S
    while True:
        over = time.monotonic() > end
        there = [(program, folder) for program, folder in _guards(port) if platform.is_alive(program)]
        for program, folder in there:
            with contextlib.suppress(OSError):  # it is just being started, or is another user's
                if folder and platform.is_private(os.stat(folder)) and (said := _knock(folder)):
                    return program, said == b"done"
        if over or not there:
            return None
        time.sleep(POLL_S)


def _knock(folder: str) -> bytes:
    """Order darkness through the socket of a guard; "done" or "failed", or "" where it has ended."""
    with socket.socket(socket.AF_UNIX) as line:
        line.settimeout(DARKENED_S)
        line.connect(os.path.join(folder, DOOR))
        return line.recv(16)


# ---- the process ----


def _listen(pipe: IO[bytes], tell: Callable[[bytes], None]) -> None:
    """Tell the lines of a pipe as they come, and b"" at its end; from a thread: not every system waits for pipes."""

    def read() -> None:
        with contextlib.suppress(OSError, ValueError), pipe:
            for line in pipe:
                tell(line)
        tell(b"")

    threading.Thread(target=read, daemon=True).start()


def _open_door(folder: str, tell: Callable[[socket.socket], None]) -> None:
    """Tell of every process that comes to order darkness, by the socket at which it waits for an answer."""
    path = os.path.join(folder, DOOR)

    def let_in() -> None:
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as door:  # no room, or too long a path
            with contextlib.suppress(OSError):
                os.unlink(path)  # that of a guard that was ended
            door.bind(path)
            door.listen()
            while True:
                tell(door.accept()[0])

    threading.Thread(target=let_in, daemon=True).start()


def _darken(port: str, baud: int, orders: list[bytes], *, alone: bool = True) -> bool:
    """Send the orders as soon as the port is the guard's: it may be closed a good while after the dead program's pipe.

    A server on the network may take a second connection and drop it: then it is tried anew. Whether they went out.
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
            return True
        if over:
            return False
        time.sleep(POLL_S)


def _wait(limit_s: float, darken: Callable[[], bool], folder: str = "") -> bool:
    """Listen at the pipe until it ends, and act when the time is over; whether the lamp was left in order."""
    end = time.monotonic() + limit_s if limit_s > 0 else None
    heard: queue.SimpleQueue[bytes | socket.socket] = queue.SimpleQueue()
    _listen(sys.stdin.buffer, heard.put)
    if folder:
        _open_door(folder, heard.put)
    state, last = GOOD, b""
    while True:
        try:
            line = heard.get(timeout=None if end is None else max(end - time.monotonic(), 0.0))
        except queue.Empty:
            darken()
            end, state = None, OVER
            continue
        if isinstance(line, socket.socket):
            end, state = None, ORDERED
            with contextlib.suppress(OSError), line:
                line.sendall(b"done" if darken() else b"failed")
            continue
        if not line:
            return last == b"x"
        last = line
        if not line.endswith(b"\n"):
            continue
        number, _, what = line.rstrip(b"\n").partition(b" ")
        word, _, seconds = what.partition(b" ")
        if (word == b"alive" and state == GOOD) or (word == b"allow" and state != ORDERED):
            end, state = time.monotonic() + float(seconds) if float(seconds) > 0 else None, GOOD
        with contextlib.suppress(OSError):  # who has asked is dead
            sys.stdout.buffer.write(number + b" " + state + b"\n")
            sys.stdout.buffer.flush()


def _main(port: str, baud: str, limit_s: str, _program: str, folder: str, *orders: str) -> None:
    to_darken = port, int(baud), [bytes.fromhex(order) for order in orders]
    if not _wait(float(limit_s), lambda: _darken(*to_darken, alone=False), folder):
        _darken(*to_darken)
    if folder:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    _main(*sys.argv[1:])
