"""A clock for waits: it counts the time in which this program looked, and not the time in which it was held up.

On a busy computer a second may pass between two looks. Whoever decides by the clock of the wall then decides on nothing
that it has seen. Here a gap between two looks counts as `LATE_S` at most, so that a wait of so many seconds holds so
many looks at least, and ends after a bounded number of them.
"""

from gonio.lab.rig import clock

LATE_S = 0.05
"""The polls of all devices come at least twice as often."""


class Patience:
    """Seconds of looking since it was made; every call is a look.

    Parameters
    ----------
    late_s
        Of a longer gap between two looks no more counts [s].
    """

    def __init__(self, late_s: float = LATE_S) -> None:
        self._late_s = late_s
        self._before_s, self._looked_s = clock.monotonic(), 0.0

    def __call__(self) -> float:
        """The seconds that count, this look included [s]."""
        before_s, self._before_s = self._before_s, clock.monotonic()
        self._looked_s += min(self._before_s - before_s, self._late_s)
        return self._looked_s
