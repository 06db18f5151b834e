"""How long the rest of a run takes, learnt from the lines of its journal."""

from __future__ import annotations

import threading
import time
from collections import deque
from pathlib import Path

from gonio.acquisition.journal import Event
from gonio.acquisition.records import StepRecord
from gonio.acquisition.remaining import REMEMBERED, Remaining, TimeLeft
from gonio.acquisition.run import Run
from gonio.errors import GonioError

AGAIN_S = 1.0
"""It is worked out at most so often."""


class Left:
    """The time that is left of a run, for who follows its journal."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._one = threading.Lock()
        self._recent: deque[tuple[Event, float | None]] = deque(maxlen=REMEMBERED)
        self._remaining: Remaining | None = None
        self._found: TimeLeft | None = None
        self._looked_s = -AGAIN_S

    def take(self, event: Event, took_s: float | None) -> None:
        """One more line; of a step also how long it took, by the clock on the wall."""
        with self._one:
            if event.get("event") == "step":
                self._recent.append((event, took_s))
                if self._remaining is not None:
                    self._remaining.took(StepRecord.from_json(event), took_s)
            elif event.get("event") in ("session", "chosen", "lost"):
                self._remaining, self._looked_s = None, -AGAIN_S  # other steps are left than those that it knows

    def now(self) -> TimeLeft | None:
        """How long the rest takes; None where nobody knows."""
        with self._one:
            if time.monotonic() - self._looked_s >= AGAIN_S:
                try:
                    if self._remaining is None:
                        self._remaining = self._begin()
                    self._found = self._remaining.left
                except GonioError:  # the run is damaged: `gonio.live.watching` says so
                    self._found = None
                self._looked_s = time.monotonic()
            return self._found

    def _begin(self) -> Remaining:
        run = Run.open(self._path)
        out = Remaining.of_run(run)
        if run.sample is not None:  # of a simulated rig nobody but us has looked at the clock
            for event, took_s in self._recent:
                out.took(StepRecord.from_json(event), took_s)
        return out
