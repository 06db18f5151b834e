"""Keys that pause a measurement, heard while it runs; prompts of the rig have the terminal for themselves meanwhile."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import termios
import threading
import tty
from types import TracebackType
from typing import Any, Self

from gonio.acquisition.stop import Pause

PAUSE, GO_ON, END = b"p ", b"c", b"q"


class PauseKeys:
    """p or space asks for a pause, c lets the run go on, q ends it as Ctrl-C does.

    Enter it more than once, if need be: on leaving, the terminal is as it was.
    """

    def __init__(self, pause: Pause) -> None:
        self._pause = pause
        self._thread: threading.Thread | None = None

    @staticmethod
    def possible() -> bool:
        """Whether there is a terminal to press keys on, and this process may read from it."""
        try:
            return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
        except (AttributeError, OSError, ValueError):
            return False

    def __enter__(self) -> Self:
        if self._thread is None and self.possible():
            self._handle = sys.stdin.fileno()
            self._before: list[Any] = termios.tcgetattr(self._handle)
            self._wake, self._waker = os.pipe()
            tty.setcbreak(self._handle, termios.TCSADRAIN)
            self._pause.attended = True
            self._thread = threading.Thread(target=self._listen, name="gonio-keys", daemon=True)
            self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._thread is None:
            return
        thread, self._thread = self._thread, None
        self._pause.attended = False
        os.write(self._waker, b".")
        thread.join()
        for handle in (self._wake, self._waker):
            os.close(handle)
        with contextlib.suppress(termios.error):  # the terminal has gone
            termios.tcsetattr(self._handle, termios.TCSADRAIN, self._before)

    def _listen(self) -> None:
        while True:
            ready, _, _ = select.select([self._handle, self._wake], [], [])
            if self._wake in ready:
                return
            try:
                key = os.read(self._handle, 1).lower()
            except OSError:
                return
            if not key:  # the terminal has gone
                return
            if key in PAUSE:
                self._pause.ask("a key")
            elif key == GO_ON:
                self._pause.go_on()
            elif key == END:
                os.kill(os.getpid(), signal.SIGINT)
