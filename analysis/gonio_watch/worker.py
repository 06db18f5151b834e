"""Values and the last frame's picture of a run that is watched, worked out by one process for all its watchers.

It follows the journal, has the lowest priority, and takes `SHARE` of a processor while the run goes on. What it finds
lies in a folder (`gonio_watch.shared`) that its user's watchers read. It works while one of them says that somebody
looks.
"""

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

from gonio import platform
from gonio.disk import only_file
from gonio.errors import GonioError
from gonio.lab.acquisition.journal import Event
from gonio.lab.acquisition.progress import REMEMBERED, Remaining, TimeLeft
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.rig.dng import read_raw
from gonio_watch.follow import Follower
from gonio_watch.picture import png
from gonio_watch.provisional import Provisional, ProvisionalValues
from gonio_watch.run_status import RunStatus, rounded
from gonio_watch.shared import CURVES, FRAME, LOCK, LOOKED, LOOKED_S, NOW, Now

SHARE = 0.02
"""Share of a processor that values and pictures may take while the run goes on, for all watchers together."""
ONCE_S = 0.04
"""Processor time of one turn."""
LONGEST_S = 5.0
"""Longest rest after a turn, by which its share of the processor is kept."""
TOLD_S = 1.0
"""Least time between two hand-overs of values. They take a tenth of the time at most: very many values take long."""
PICTURE_S = 2.0
"""Least time between two frames that are made pictures."""
POLL_S = 0.3
"""Time between two looks at the journal."""
TURN_S = 20.0
"""Longest wait for its turn: another user's process may stand still."""
SHOWN = 6
"""Newest values that are told as numbers."""
BUSY = ("running", "silent")
"""States in which somebody measures, and is not to be disturbed."""

LEFT_S = 2.0
"""Least time between two estimates of the time that is left."""

Wait = Callable[[float], bool]
"""Waits for some seconds, and says whether it is time to end."""
Draw = Callable[[RunStatus, Sequence[ProvisionalValues], int], bytes]
"""What the page shows of values, as it reads it; the number is that of steps that are not reduced yet."""


class Left:
    """The time that is left of a run, for who follows its journal."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._recent: deque[tuple[Event, float | None]] = deque(maxlen=REMEMBERED)
        self._new = 0
        """Steps that came since the estimate was told."""
        self._remaining: Remaining | None = None
        self._found: TimeLeft | None = None
        self._looked_s = -LEFT_S

    def take(self, event: Event, took_s: float | None) -> None:
        """One more line; of a step also how long it took, by the clock on the wall."""
        if event.get("event") == "step":
            self._recent.append((event, took_s))
            self._new += 1
        elif event.get("event") in ("session", "chosen", "lost"):
            self._remaining, self._looked_s = None, -LEFT_S  # other steps are left than those that it knows

    def now(self) -> TimeLeft | None:
        """How long the rest takes; None where nobody knows."""
        if time.monotonic() - self._looked_s >= LEFT_S:
            self._looked_s = time.monotonic()
            try:
                self._found = self._worked_out()
            except GonioError:  # the run is damaged: `gonio_watch.watching` says so
                self._found = None
        return self._found

    def _worked_out(self) -> TimeLeft | None:
        newest = min(self._new, REMEMBERED)
        if self._remaining is None:
            run = Run.open(self._path)
            self._remaining = Remaining.of_run(run)
            # of a simulated rig nobody but us has looked at the clock
            newest = len(self._recent) if run.sample is not None else 0
        # what it has learnt from older ones it would have forgotten
        for event, took_s in islice(self._recent, len(self._recent) - newest, None):
            self._remaining.took(StepRecord.from_json(event), took_s)
        self._new = 0
        return self._remaining.left


class Worker:
    """Works out one run.

    Parameters
    ----------
    run
        The folder of the run.
    out
        The folder for what is found.
    draw
        Makes values what the page shows.
    """

    def __init__(self, run: Path, out: Path, draw: Draw) -> None:
        self.path, self.out, self._draw = run, out, draw
        self._follower = Follower(run)
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._life, self._story = self._follower.lives, RunStatus()
        self._provisional: Provisional | None = None
        self._left: Left | None = None
        self._darks: dict[int, int] = {}
        """Where steps that are not reduced yet begin in the journal, by their numbers; darks are needed by all."""
        self._visits: dict[int, int] = {}
        """The same of visits to the reference; the oldest one is the next."""
        self._points: dict[int, int] = {}
        """The same of points; the newest one is the next."""
        self._now = Now()
        self._new = False
        """Whether something was reduced that is not handed on."""
        self._told_s = self._pictured_s = -1e9
        self._values_s = 0.0
        """How long it took to hand values on."""
        for name in (NOW, CURVES, FRAME):
            (self.out / name).unlink(missing_ok=True)

    def work(self, wait: Wait) -> None:
        """Until it is told to end."""
        owed = 0.0
        try:
            over = False
            while not over:
                if not self._is_looked_at():
                    over = wait(POLL_S)
                    continue
                began = time.process_time()
                self._look()
                lives = None if self._story.stopped else self._follower.writer_lives()
                busy = self._story.state(time.time(), lives)[0] in BUSY
                with self._turn(wait) if busy and self._has_work() else contextlib.nullcontext():
                    worked = self._work_once(busy)
                    if not busy:
                        owed, over = 0.0, wait(0.0 if worked else POLL_S)
                        continue
                    owed += (time.process_time() - began) / SHARE
                    rest = min(owed, LONGEST_S)
                    owed -= rest
                    over = wait(rest if worked else max(rest, POLL_S))
        finally:
            for name in (NOW, CURVES, FRAME):
                (self.out / name).unlink(missing_ok=True)

    def _is_looked_at(self) -> bool:
        try:
            return time.time() - (self.out / LOOKED).stat().st_mtime < LOOKED_S
        except OSError:
            return False

    @contextlib.contextmanager
    def _turn(self, wait: Wait) -> Iterator[None]:
        """Those who work out one run, each for another user, do so in turns: together they take what one may.

        The lock is on `run.toml`, which nobody else locks. Who has waited for `TURN_S` goes on without.
        """
        with contextlib.ExitStack() as held:
            with contextlib.suppress(OSError):  # a file system without locks
                file = held.enter_context(open(self.path / "run.toml", "rb", opener=only_file))
                until = time.monotonic() + TURN_S
                while time.monotonic() < until:
                    if platform.lock(file) or wait(0.05):
                        break
            yield

    # --- reading -----------------------------------------------------------------------------------------------------

    def _look(self) -> None:
        """Read what is new in the journal, or a piece of it."""
        for events in islice(self._follower.poll(), 1):
            if self._follower.lives != self._life:
                self._begin_anew()
            if self._provisional is None and events:
                self._open()
            for event, place in zip(events, self._follower.places, strict=True):
                self._story.note(event)
                if self._left is not None:
                    self._left.take(event, self._story.took_s)
                kind = event.get("event")
                if kind == "step":
                    self._forget([int(event["step"])])
                    of_kind = {"dark": self._darks, "reference": self._visits}
                    of_kind.get(str(event.get("kind")), self._points)[int(event["step"])] = place
                elif kind == "lost":
                    self._forget(map(int, event.get("steps", [])))

    @property
    def behind(self) -> int:
        """Steps that are not reduced yet."""
        return len(self._darks) + len(self._visits) + len(self._points)

    def _forget(self, steps: Iterable[int]) -> None:
        for number in steps:
            for waiting in (self._darks, self._visits, self._points):
                waiting.pop(number, None)
            if self._provisional is not None:
                self._provisional.drop([number])

    def _open(self) -> None:
        """Read what was asked for, now that the run has begun."""
        try:
            run = Run.open(self.path)
            self._story.every, self._story.angles_deg = run.description.reference.every, run.planned.angles_deg
        except GonioError:  # `gonio_watch.watching` says so
            return
        self._provisional, self._left = Provisional(run), Left(self.path)

    # --- working -----------------------------------------------------------------------------------------------------

    def _has_work(self) -> bool:
        shown = self._story.last_shown
        return self._new or self.behind > 0 or (
            shown is not None and self._now.frame != [shown[0], int(shown[1]["step"])]
        )  # fmt: skip

    def _work_once(self, busy: bool) -> bool:
        """Some steps, the values where it is time to hand them on, a picture, the time left; whether there is more."""
        if self._provisional is None:
            return False
        began = time.process_time()
        while self.behind and time.process_time() - began < ONCE_S:
            for waiting, next_of in ((self._darks, iter), (self._visits, iter), (self._points, reversed)):
                if waiting and (
                    waiting is self._darks or not self._darks
                ):  # of a long run's visits and points there are some of each from the beginning
                    step = next(next_of(waiting))
                    self._reduce(self._provisional, waiting.pop(step), step)
        now = time.monotonic()
        told = False
        if self._new and (not self.behind or now - self._told_s >= max(TOLD_S, 10.0 * self._values_s)):
            self._hand_on(self._provisional)
            told = True
        if now - self._pictured_s >= PICTURE_S:
            told = self._picture(self._provisional.run) or told
        if busy and self._left is not None and not self._follower.unread:
            found = self._left.now()
            left = None if found is None else [float(round(found.seconds)), rounded(found.u_seconds, 2)]
            told, self._now.left = told or left != self._now.left, left
        if told:
            self._now.journal = self._follower.identity
            write(self.out / NOW, self._now.encode())
        return self._new or self.behind > 0 or self._follower.unread > 0

    def _reduce(self, provisional: Provisional, place: int, step: int) -> None:
        self._new = True
        event: Event | None = self._follower.event_at(place)
        try:
            if event is not None:
                provisional.add(StepRecord.from_json(event))
        except (GonioError, OSError) as error:
            self._now.problem = f"step {step} is not shown: {error}"

    def _hand_on(self, provisional: Provisional) -> None:
        began = time.process_time()
        values = provisional.values()
        write(self.out / CURVES, self._draw(self._story, values, self.behind))
        self._now.version, self._now.behind = time.time_ns() // 1000, self.behind
        self._now.bands = [
            {
                "name": v.band.name,
                "values": [
                    [*map(float, self._story.angles(int(v.points[k])) or ()), float(v.brdf[k]), float(v.u[k])]
                    for k in range(max(0, len(v.points) - SHOWN), len(v.points))
                ],
                "visit": list(v.visits[-1][1:]),
                "count": len(v.points),
            }
            for v in values
        ]
        self._new = False
        self._told_s = time.monotonic()
        self._values_s = time.process_time() - began

    def _picture(self, run: Run) -> bool:
        shown = self._story.last_shown
        if shown is None:
            return False
        (name, event), which = shown, [shown[0], int(shown[1]["step"])]
        if which == self._now.frame:
            return False
        with contextlib.suppress(GonioError, OSError):
            write(self.out / FRAME, png(run.description, read_raw(run.frame_path(name)), StepRecord.from_json(event)))
            self._now.frame = which
        self._pictured_s = time.monotonic()
        return True


def write(path: Path, data: bytes) -> None:
    """A file in the place of an older one, whole for whoever reads it."""
    new = path.with_name(path.name + ".new")
    new.write_bytes(data)
    platform.replace(new, path)


def serve(run: Path, out: Path, draw: Draw, told: int = 0) -> None:
    """Work out a run until the watcher that began this process has gone.

    Parameters
    ----------
    run, out, draw
        As for `Worker`.
    told
        A file descriptor whose other end the watcher holds.
    """
    platform.work_modestly()
    with open(out / LOCK, "ab") as held:
        os.chmod(out / LOCK, 0o600)
        if not platform.lock(held):  # another one has begun meanwhile
            return
        ended = threading.Event()
        threading.Thread(target=_until_end, args=(told, ended), daemon=True).start()
        Worker(run, out, draw).work(ended.wait)


def _until_end(told: int, ended: threading.Event) -> None:
    """Wait at a pipe until it says something, or its other end has gone."""
    with contextlib.suppress(OSError):
        os.read(told, 1)
    ended.set()
