"""Steps that were taken whole, on their way to disk and journal while the next ones are taken."""

import math
import time
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass

from gonio.lab.acquisition.frame_writer import Store
from gonio.lab.acquisition.progress import Live, Progress
from gonio.lab.acquisition.records import FrameFile, StepRecord
from gonio.lab.acquisition.run import Run

PACE_STEPS = 64
FAST_STEP_S = 0.01
"""The last `PACE_STEPS` steps took less each: then steps are synced together."""
TOGETHER_S = 0.2
"""Longest time between two syncs of a fast run, whose steps are synced together."""


@dataclass(slots=True)
class Taken:
    """A step whose frames are on their way to the disk."""

    record: StepRecord
    """Its frames without what their files are."""
    files: list[Future[FrameFile]]
    live: Live


class Commits:
    """The disk of a session: a step is in the journal once all of its frames are there.

    Parameters
    ----------
    run, progress
        Whose journal it is, and who is told of every step in it.
    """

    def __init__(self, run: Run, progress: Progress) -> None:
        self._run, self._progress = run, progress
        self.store = Store(run.path / "frames")
        self._steps: list[Taken] = []
        """Their frames are being written."""
        self._committing: tuple[Future[None], list[Taken]] | None = None
        """Steps whose frames are on their way to the disk; nothing is waited for before the next ones are."""
        self._committed_s = -math.inf
        """When these were sent there, on the computer's clock."""
        self._begun_s: deque[float] = deque(maxlen=PACE_STEPS)
        """When the last steps were taken, on a clock that stands still while the disk is waited for."""
        self._waited_s = 0.0
        """How long the disk was waited for so far."""

    def add(self, taken: Taken) -> None:
        """Let a step wait for the disk; journal the one before it, whose frames were being written meanwhile."""
        self._steps.append(taken)
        if not self._hurried() or time.monotonic() - self._committed_s > TOGETHER_S:
            self._commit()

    def finish(self) -> None:
        """Journal every step that was added."""
        if self._steps:
            self._commit()
        self._journal()

    def close(self) -> None:
        """End it: what was not finished is not written."""
        self.store.close()

    def _hurried(self) -> bool:
        """Whether steps come so fast that the disk, which syncs them one by one, would be what they wait for."""
        now = time.monotonic() - self.store.waited_s - self._waited_s
        self._begun_s.append(now)
        fast = len(self._begun_s) == PACE_STEPS and now - self._begun_s[0] < PACE_STEPS * FAST_STEP_S
        self.store.at_once = fast
        return fast

    def _commit(self) -> None:
        """Send the frames of the steps taken to the disk, and journal those that were sent before."""
        self._journal()
        self._committed_s = time.monotonic()
        self._committing, self._steps = (self.store.commit(), self._steps), []

    def _journal(self) -> None:
        """Wait for the frames that are on their way to the disk, and journal their steps."""
        if self._committing is None:
            return
        (done, steps), self._committing = self._committing, None
        began = time.monotonic()
        done.result()
        self._run.append_all([taken.record.stored([file.result() for file in taken.files]).text() for taken in steps])
        for taken in steps:
            self._progress.step(taken.live)
        self._waited_s += time.monotonic() - began
