"""How long the rest of a run takes, learnt from the lines of its journal."""

import threading
import time
from collections import deque
from itertools import islice
from pathlib import Path

from gonio.acquisition.journal import Event
from gonio.acquisition.records import StepRecord
from gonio.acquisition.remaining import REMEMBERED, Remaining, TimeLeft
from gonio.acquisition.run import Run
from gonio.errors import GonioError

AGAIN_S = 2.0
"""It is worked out at most so often."""


class Left:
    """The time that is left of a run, for who follows its journal."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._one = threading.Lock()
        self._recent: deque[tuple[Event, float | None]] = deque(maxlen=REMEMBERED)
        self._new = 0
        """Steps that came since the estimate was told."""
        self._remaining: Remaining | None = None
        self._found: TimeLeft | None = None
        self._looked_s = -AGAIN_S

    def take(self, event: Event, took_s: float | None) -> None:
        """One more line; of a step also how long it took, by the clock on the wall."""
        with self._one:
            if event.get("event") == "step":
                self._recent.append((event, took_s))
                self._new += 1
            elif event.get("event") in ("session", "chosen", "lost"):
                self._remaining, self._looked_s = None, -AGAIN_S  # other steps are left than those that it knows

    def now(self) -> TimeLeft | None:
        """How long the rest takes; None where nobody knows."""
        with self._one:
            if time.monotonic() - self._looked_s >= AGAIN_S:
                try:
                    if self._remaining is None:
                        self._remaining = self._begin()
                    else:
                        self._tell(self._remaining, min(self._new, REMEMBERED))
                    self._new = 0
                    self._found = self._remaining.left
                except GonioError:  # the run is damaged: `gonio.live.watching` says so
                    self._found = None
                self._looked_s = time.monotonic()
            return self._found

    def _begin(self) -> Remaining:
        run = Run.open(self._path)
        out = Remaining.of_run(run)
        if run.sample is not None:  # of a simulated rig nobody but us has looked at the clock
            self._tell(out, len(self._recent))
        return out

    def _tell(self, remaining: Remaining, newest: int) -> None:
        """Tell the estimate of the newest steps; what it has learnt from older ones it would have forgotten."""
        for event, took_s in islice(self._recent, len(self._recent) - newest, None):
            remaining.took(StepRecord.from_json(event), took_s)
