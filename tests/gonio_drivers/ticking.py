"""A clock of drivers and twins in one thread: it goes on where somebody looks at it or sleeps, and does what is due."""

import heapq
import itertools
from collections.abc import Callable

import pytest

from gonio.lab.rig import clock

LOOK_S = 1e-6
"""A look at the clock takes so long."""


def ticking(monkeypatch: pytest.MonkeyPatch) -> Callable[[float, Callable[[], None]], None]:
    """Put such a clock in place of the real one; what does something after a time [s] on it."""
    now_s, order = 1000.0, itertools.count()
    due: list[tuple[float, int, Callable[[], None]]] = []

    def sleep(seconds: float) -> None:
        nonlocal now_s
        end_s = now_s + max(seconds, 0.0)
        while due and due[0][0] <= end_s:
            at_s, _, what = heapq.heappop(due)
            now_s = max(now_s, at_s)
            what()
        now_s = max(now_s, end_s)

    def monotonic() -> float:
        sleep(LOOK_S)
        return now_s

    def later(seconds: float, what: Callable[[], None]) -> None:
        heapq.heappush(due, (now_s + seconds, next(order), what))

    monkeypatch.setattr(clock, "sleep", sleep)
    monkeypatch.setattr(clock, "monotonic", monotonic)
    return later
