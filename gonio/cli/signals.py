"""The signals that end a command: heard, deafened, or held off while what was measured is written."""

import contextlib
import signal
import threading
import time
from collections.abc import Iterator

from gonio import platform

TOGETHER_S = 1.0
"""Signals that follow each other within this time count as one: what they end has the time to be left in order."""


class Ending:
    """What the signals of `platform.ENDING` do in the command line: they interrupt it, whatever it is doing."""

    def __init__(self) -> None:
        self.heard = False
        self._last_s = -TOGETHER_S

    def __call__(self, number: int, frame: object) -> None:
        self.heard = True
        before_s, self._last_s = self._last_s, time.monotonic()
        if self._last_s - before_s > TOGETHER_S:
            raise KeyboardInterrupt

    def listen(self) -> None:
        """From now on; a signal that was set to be ignored (nohup, a shell's background) stays so."""
        for number in platform.ENDING:
            if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL):
                signal.signal(number, self)


def deafen() -> None:
    """From now on no signal of `platform.ENDING` is heard: the process is ending."""
    for number in platform.ENDING:
        signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """What was measured is being written: for this moment no signal of `platform.ENDING` is heard, nor what kills."""
    here = threading.current_thread() is threading.main_thread()
    numbers = {*platform.ENDING, *platform.KILLING} if here else ()
    # not SIG_IGN: Python prints a traceback of its own where a signal comes in the moment that it is told to ignore it
    before = {number: signal.signal(number, lambda number, frame: None) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
