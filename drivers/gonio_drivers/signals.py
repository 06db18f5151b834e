"""Signals while devices are open: what would end the process leaves the rig in order first."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

from gonio import platform
from gonio.errors import Interrupted


def deaf(number: int, frame: FrameType | None) -> None:
    """Do nothing. Where Python is told to ignore a signal that has just come, it prints a traceback of its own."""


class Heard:
    """Which signal has come while a rig is open."""

    def __init__(self) -> None:
        self.number = 0

    def again(self) -> None:
        """Raise `Interrupted` for a signal whose exception was lost: Python drops what is raised in a finaliser."""
        if self.number:
            raise Interrupted(f"stopped by {signal.Signals(self.number).name}")


@contextlib.contextmanager
def heard() -> Iterator[Heard]:
    """While nobody else listens, signals that would end the process leave the rig in order.

    The lamp is darkened, and the arms park; where they are on their way they stop at once instead.
    """
    told = Heard()

    def leave(number: int, frame: FrameType | None) -> None:
        told.number = number
        for other in mine:  # once: a second one must not disturb the parking
            signal.signal(other, deaf)
        raise Interrupted(f"stopped by {signal.Signals(number).name}")

    mine: list[signal.Signals] = []
    if threading.current_thread() is threading.main_thread():
        mine = [n for n in platform.KILLING if signal.getsignal(n) is signal.SIG_DFL]
    for number in mine:
        signal.signal(number, leave)
    try:
        yield told
    finally:
        for number in mine:
            signal.signal(number, signal.SIG_DFL)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """For the moment that it takes to stop, to darken and to close the ports, Ctrl-C and its like are not heard."""
    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {n: signal.signal(n, deaf) for n in (signal.SIGINT, *platform.KILLING)}
    try:
        yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is deaf:  # nobody has changed it since
                signal.signal(number, handler)
