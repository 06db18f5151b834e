"""A lamp on a dead man's timer: it is dark unless a person keeps it lit, whatever the program does meanwhile.

Whoever owns the devices darkens the lamp when the time is over. A watch in a thread of its own does it where the owner
does not come to it: in a long exposure, a move, or a camera that has stopped answering. It may talk to the lamp
then by `darken_at_once` alone, where the driver has that; otherwise it calls `off`.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Self

from gonio.errors import DeviceError
from gonio.lab.rig import LightDevice

OWNER_S = 0.5
"""What the owner is given to darken the lamp by itself."""
LOOK_S = 0.1
"""How often the watch looks."""
GUARD_S = 10.0
"""How long after the timer the driver's own guard process darkens the lamp, where the whole program stands still."""


class LampTimeOver(DeviceError):
    """The lamp may not shine: its time is over, or nobody has lit it."""


class DeadMansTimer:
    """When the lamp has to be dark. Safe to be called from any thread.

    Parameters
    ----------
    light
        The lamp. One that checks `allowed` before it lights up by itself (a laboratory's does after a reset) is kept
        from that.
    seconds
        So long the lamp shines after the last sign of life.
    clock
        Seconds, growing.
    """

    def __init__(self, light: LightDevice, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.seconds = seconds
        self._light, self._clock = light, clock
        self._lock = threading.RLock()
        self._end: float | None = None
        self._busy: tuple[float, str] | None = None
        self._before: Callable[[], None] | None = None
        self.why_dark = ""
        """Why the watch, or the owner, has darkened the lamp; "" where a person did."""

    # ---- for the owner of the devices ----

    def light_up(self) -> None:
        """The lamp may shine from now on, for `seconds`; called before it is lit."""
        with self._lock:
            self._end, self.why_dark = self._clock() + self.seconds, ""
        self._tell_guard()

    def dark(self) -> None:
        """The lamp is dark, or is about to be darkened."""
        with self._lock:
            self._end = None

    @contextlib.contextmanager
    def within(self, seconds: float, what: str) -> Iterator[None]:
        """The owner talks to a device, and has to be back within `seconds`; otherwise the watch darkens the lamp."""
        with self._lock:
            self._busy = self._clock() + seconds, what
        try:
            yield
        finally:
            with self._lock:
                self._busy = None

    def require(self) -> None:
        """Raise `LampTimeOver` where the lamp may not shine."""
        with self._lock:
            if self._end is None or self._clock() >= self._end:
                raise LampTimeOver(f"the lamp stays dark: {self.why_dark or 'its time is over'}")

    @property
    def over(self) -> bool:
        """Whether the lamp was lit, and its time is over."""
        with self._lock:
            return self._end is not None and self._clock() >= self._end

    # ---- for the person ----

    def keep(self) -> None:
        """A sign of life: the lamp, where it shines, goes on for `seconds`. It lights nothing."""
        with self._lock:
            if self._end is None or self._clock() >= self._end:
                return
            self._end = self._clock() + self.seconds
        self._tell_guard()

    @property
    def left_s(self) -> float | None:
        """Seconds until dark; None where the lamp is dark."""
        with self._lock:
            return None if self._end is None else max(self._end - self._clock(), 0.0)

    # ---- for the watch ----

    def look(self) -> None:
        """Darken the lamp where its owner should have, and has not."""
        with self._lock:
            now = self._clock()
            if self._end is None:
                return
            stuck = self._busy is not None and now >= self._busy[0]
            if not stuck and now < self._end + OWNER_S:
                return
            self.why_dark = f"{self._busy[1]} does not come back" if stuck and self._busy else "its time is over"
            self._end = None
        at_once = getattr(self._light, "darken_at_once", None)
        with contextlib.suppress(Exception):  # the owner, or leaving the rig, sees that it is dark, and says so
            at_once() if at_once is not None else self._light.off()

    def _tell_guard(self) -> None:
        """Where the program stands still as a whole, watch and all."""
        if hasattr(self._light, "keep"):
            self._light.keep(self.seconds + GUARD_S)

    # ---- a session ----

    def __enter__(self) -> Self:
        """The rig is open; from now on its lamp is watched."""
        if hasattr(self._light, "allowed"):
            before = self._before = self._light.allowed

            def allowed() -> None:
                before()
                self.require()

            self._light.allowed = allowed
        self._ended = threading.Event()
        self._watch = threading.Thread(target=self._run, name="lamp-timer", daemon=True)
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        """The rig is about to be left, which darkens the lamp."""
        self._ended.set()
        self.dark()
        if self._before is not None:
            self._light.allowed = self._before  # type: ignore[attr-defined]

    def _run(self) -> None:
        while not self._ended.wait(LOOK_S):
            self.look()
