"""How far long work is, in lines of text: who is told, how often, and how long the rest may take."""

import time
from collections.abc import Callable

QUIET_S = 2.0
"""Work that is done sooner says nothing, and nothing is said again sooner."""

Say = Callable[[str], None]


def silent(text: str) -> None:
    """For those whom nobody listens to."""


class Stage:
    """Told of one stage of longer work: the time that its `Pace` says is left counts what comes after it.

    Parameters
    ----------
    say
        Who is told.
    after_s
        Seconds that the later stages may take.
    """

    def __init__(self, say: Say, after_s: float) -> None:
        self._say, self.after_s = say, after_s

    def __call__(self, text: str) -> None:
        """Pass a line on."""
        self._say(text)


class Pace:
    """Tells how many of about equal steps are done.

    Parameters
    ----------
    what
        As in "drawing figures".
    total
        How many steps there are.
    say
        Called with a line, at most every `QUIET_S`; a `Stage` says what comes after the steps.
    at_most
        There may be fewer steps than `total`.
    """

    def __init__(self, what: str, total: int, say: Say, *, at_most: bool = False) -> None:
        self._what, self._total, self._say, self._at_most = what, total, say, at_most
        self._after_s = say.after_s if isinstance(say, Stage) else 0.0
        self._told = time.monotonic()
        self._first: tuple[float, int] | None = None

    def step(self, done: int) -> None:
        """`done` steps are done."""
        now = time.monotonic()
        if self._first is None and done > 0:
            self._first = now, done  # what is slow at the first step alone (imports, machine code) says nothing
            return
        if self._first is None or now - self._told < QUIET_S or done >= self._total:
            return
        began, before = self._first
        if done <= before:  # it began anew
            return
        self._told = now
        left = duration((now - began) / (done - before) * (self._total - done) + self._after_s)
        most = "at most " if self._at_most else ""
        self._say(f"{self._what}: {done} of {most}{self._total}, {most or 'about '}{left} left")


def duration(seconds: float) -> str:
    """A duration as people say it: 45 s, 12 min, 3 h 20 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"
