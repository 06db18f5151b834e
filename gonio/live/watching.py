"""A run that is being measured, or was: its journal as events of a page, its values so far, its last frame.

Everything here reads, and only while somebody looks. A thread looks at the journal every `POLL_S`. Another one
reduces frames with the lowest priority. All watchers of a run take a tenth of a processor for it at most.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from gonio.acquisition.journal import Event
from gonio.acquisition.records import StepRecord
from gonio.disk import only_file
from gonio.errors import GonioError
from gonio.geometry import IN_PLANE, Directions
from gonio.live.follow import Follower
from gonio.live.server import Content, EventLog, Request
from gonio.live.story import Story, rounded

if TYPE_CHECKING:
    from gonio.acquisition.run import Run
    from gonio.live.left import Left
    from gonio.live.provisional import Provisional, Values

POLL_S = 0.2
"""The journal is looked at so often."""
LOOK_S = 1.0
"""So often it is told how much room the disk has, and whether the process that measures lives."""
PICTURE_S = 1.0
"""A frame is made a picture of at most so often."""
PICTURE_SHARE = 0.02
"""Of a processor: the time that pictures may take."""
TURN_S = 20.0
"""So long a watcher waits for its turn: another one may stand still."""
WAIT_S = 0.05
"""So often it looks whether it is its turn."""
TOLD_S = 0.7
"""Values are handed on so often, while there are more to come."""
LONGEST_S = 2.0
"""It rests no longer for it: the first step reads the dark frames as well."""
PATIENCE_S = 5.0
"""A step that is being reduced at the end is waited for so long at most."""
BUSY = ("running", "silent")
"""States in which somebody measures, and is not to be disturbed."""
GOING = ("running", "suspended", "paused", "silent")
"""States of a run that may go on by itself."""
SHARE = 0.1
"""Of a processor, while the run goes on: the time that reducing may take, that of all watchers of a run together."""


class Watched:
    """A run, followed in a thread while the block lasts.

    Parameters
    ----------
    path
        The folder of the run; it need not exist yet.
    changed
        Called when there are new values, in the thread that made them.
    """

    def __init__(self, path: Path, changed: Callable[[Watched], None] | None = None) -> None:
        self.path = path
        self.log = EventLog()
        self.log.tell("run", {"name": path.absolute().name})
        self.story = Story()
        self.run: Run | None = None
        self.values: list[Values] = []
        self.wanted = False
        """Whether the run is shown although nobody looks at a page."""
        self.problem = ""
        self._follower = Follower(path)
        self._left: Left | None = None
        self._tried = -LOOK_S
        self._changed = changed
        self._news = threading.Condition()
        self._ended = False
        self._life = 0
        """Goes up where all is read anew."""
        self._state = "running"
        """As it was told last."""
        self._first: deque[Event] = deque()
        """What is reduced before all else, in order: darks, visits to the reference, and what was lost."""
        self._points: deque[Event] = deque()
        """Points that are not reduced yet; the newest one is the next."""
        self._picture: tuple[str, bytes] | None = None
        self._pictured = 0.0
        """From when on another one may be made."""
        self._one_picture = threading.Lock()
        self._threads = [
            threading.Thread(target=self._follow, name="follow", daemon=True),
            threading.Thread(target=self._reduce, name="reduce", daemon=True),
        ]

    def __enter__(self) -> Self:
        try:
            for thread in self._threads:
                thread.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Follow no more."""
        with self._news:
            self._ended = True
            self._news.notify_all()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(PATIENCE_S)

    @property
    def behind(self) -> int:
        """How many steps are not reduced yet."""
        return len(self._first) + len(self._points)

    def events_after(self, number: int) -> list[dict[str, Any]]:
        """What a page knows of the journal's events beyond the first `number`."""
        return [json.loads(event.data) for event in self.log.events(number)]

    # --- following ---------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        looked = -LOOK_S
        while not self._ended:
            if not self._is_attended():
                with self._news:
                    self._news.wait_for(lambda: self._ended, POLL_S)
                continue
            new = self.look()
            if new or time.monotonic() - looked >= LOOK_S:
                looked = time.monotonic()
                self.tell()
            with self._news:
                self._news.wait_for(lambda: self._ended, POLL_S)

    def look(self) -> bool:
        """Read what is new in the journal; whether there was something."""
        new = False
        for events in self._follower.poll():
            if self._ended:
                break
            if self._follower.lives != self._life:
                self._begin_anew()
            if self.run is None and events and time.monotonic() - self._tried >= LOOK_S:
                self._tried = time.monotonic()
                self._open()
            out, reduced = [], []
            for event in events:
                out.append(("journal", self.story.take(event)))
                if self._left is not None:
                    self._left.take(event, self.story.took_s)
                if event.get("event") in ("step", "lost"):
                    reduced.append(event)
            if out:
                new = True
                self.log.append(*out)
            if reduced:
                with self._news:
                    for event in reduced:
                        self._wait_for(event)
                    self._news.notify_all()
        return new

    def _wait_for(self, event: Event) -> None:
        if event.get("event") == "lost":
            gone = set(event.get("steps", []))
            self._points = deque(step for step in self._points if step["step"] not in gone)
            self._first = deque(step for step in self._first if step.get("step") not in gone)
        (self._points if event.get("kind") == "point" else self._first).append(event)

    def _begin_anew(self) -> None:
        """Another journal is in the place of the one that was read."""
        with self._news:
            self._life = self._follower.lives
            self.story, self.run, self.values, self._tried, self._left = Story(), None, [], -LOOK_S, None
            self._first.clear()
            self._points.clear()
        self.log.restart()
        self.log.tell("hello", {"journal": self._follower.identity})

    def _open(self) -> None:
        """Read what was asked for, now that the run has begun."""
        from gonio.acquisition.run import Run
        from gonio.live.left import Left

        try:
            run = Run.open(self.path)
            planned = run.planned
        except GonioError as error:
            self.problem = str(error)
            return
        self.problem = ""
        self.story.every = run.description.reference.every
        self.story.angles_deg = planned.angles_deg.tolist()
        left_out: dict[tuple[str, str], int] = {}
        for flag, reason in zip(planned.flags, planned.reasons, strict=True):
            if flag:
                left_out[flag, reason] = left_out.get((flag, reason), 0) + 1
        directions = Directions.from_degrees(*planned.angles_deg.T)
        most = sorted(left_out.items(), key=lambda item: -item[1])[:12]
        self.run, self._left = run, Left(self.path)
        self.log.tell(
            "run",
            {
                "name": self.path.absolute().name,
                "plan": run.settings.run.plan,
                "rig": run.description.name,
                "sample": run.sample.name if run.sample is not None else "",
                "bands": [band.name for band in run.bands],
                "points": len(planned.flags),
                "limits_deg": {name: list(pair) for name, pair in run.description.limits_deg().items()},
                "left_out": [[flag, reason, count] for (flag, reason), count in most],
                "out_of_plane": bool(np.any(np.abs(directions.out_of_plane) > IN_PLANE)),
            },
        )

    def tell(self) -> None:
        """Say how the run stands now."""
        self.log.tell("status", self.status())

    def status(self) -> dict[str, Any]:
        """How the run stands now, in what JSON can hold."""
        story, now = self.story, time.time()
        state, why = story.state(now, None if story.stopped else self._follower.writer_lives())
        self._state = state
        step_s = story.step_s
        going = state in GOING
        left = self._left.now() if going and self._left is not None else None
        out: dict[str, Any] = {
            "state": state,
            "why": "; ".join(text for text in (why, self._follower.damaged, self.problem) if text),
            "done": len(story.done),
            "total": story.total,
            "events": len(self.log),
            "points": sum(kind == "point" for kind in story.done.values()),
            "flagged": story.flagged,
            "step_s": rounded(step_s, 3) if step_s is not None else None,
            "left_s": round(left.seconds) if left is not None else None,
            "left_u_s": rounded(left.u_seconds, 2) if left is not None else None,
            "sittings": [[round(s.began, 3), round(s.last, 3), s.steps] for s in story.sittings],
            "frame": story.latest_frame[0] if story.latest_frame is not None else None,
            "frame_step": story.latest_frame[1] if story.latest_frame is not None else None,
        }
        with contextlib.suppress(OSError):
            room = os.statvfs(self.path)
            out["free_bytes"] = rounded(float(room.f_bavail * room.f_frsize), 3)
            out["needed_bytes"] = rounded(story.bytes_left, 3) if going else None
        return out

    # --- values ------------------------------------------------------------------------------------------------------

    def _reduce(self) -> None:
        give_way()
        with self._news:
            while not (self._ended or self._is_wanted()):
                self._news.wait(1.0)  # nobody tells that a page was opened
        from gonio.live.provisional import Provisional

        made, told_s = -1, -TOLD_S
        provisional: Provisional | None = None
        while True:
            with self._news:
                self._news.wait_for(lambda: self._ended or self._is_wanted(), 1.0)
                if self._ended:
                    return
                if not self._is_wanted():
                    continue
                life, run, event = self._life, self.run, self._first.popleft() if self._first else self._points.pop()
            with self._turn():
                if made != life or provisional is None:
                    assert run is not None, "a step is there after its run was opened"
                    provisional, made = Provisional(run), life
                began = time.thread_time()
                self._reduce_one(provisional, event)
                if not self.behind or time.monotonic() - told_s >= TOLD_S:
                    told_s = time.monotonic()
                    values = provisional.values()
                    with self._news:
                        if life != self._life:
                            continue
                        self.values = values
                    if self._changed is not None:
                        self._changed(self)
                if self._state in BUSY:
                    with self._news:
                        worked = time.thread_time() - began
                        self._news.wait_for(lambda: self._ended, min(worked * (1.0 / SHARE - 1.0), LONGEST_S))

    @contextlib.contextmanager
    def _turn(self) -> Iterator[None]:
        """While a run goes on its watchers work on frames in turns: all together take what one of them may.

        The lock is on `run.toml`, which nobody else locks. Who has waited for `TURN_S` goes on without.
        """
        with contextlib.ExitStack() as held:
            if self._state in BUSY:
                with contextlib.suppress(OSError):  # a file system without locks
                    file = held.enter_context(open(self.path / "run.toml", "rb", opener=only_file))
                    until = time.monotonic() + TURN_S
                    while not self._ended and time.monotonic() < until:
                        try:
                            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                            break
                        except BlockingIOError:
                            time.sleep(WAIT_S)
            yield

    def _is_wanted(self) -> bool:
        return self.behind > 0 and self.run is not None and self._is_attended()

    def _is_attended(self) -> bool:
        """Whether somebody looks: else the journal is not even read."""
        return self.wanted or self.log.listeners > 0

    def _reduce_one(self, provisional: Provisional, event: Event) -> None:
        if event.get("event") == "lost":
            provisional.drop(map(int, event.get("steps", [])))
            return
        try:
            provisional.add(StepRecord.from_json(event))
        except (GonioError, OSError) as error:
            self.log.tell("problem", {"text": f"step {event.get('step')} is not shown: {error}"})

    # --- the last frame ----------------------------------------------------------------------------------------------

    def picture(self, request: Request) -> Content | None:
        """The last frame as a PNG; None where there is none yet."""
        from gonio.live.picture import png
        from gonio.rig.dng import read_raw

        with self._one_picture:
            latest = self.story.last_shown
            if latest is not None and (self._picture is None or self._picture[0] != latest[0]):
                time.sleep(max(0.0, self._pictured - time.monotonic()))
            latest, run = self.story.last_shown, self.run
            if latest is not None and run is not None and (self._picture is None or self._picture[0] != latest[0]):
                (name, step), began = latest, time.thread_time()
                with contextlib.suppress(GonioError, OSError):
                    frame = read_raw(run.frame_path(name))
                    self._picture = name, png(run.description, frame, StepRecord.from_json(step))
                rest = (time.thread_time() - began) / PICTURE_SHARE
                self._pictured = time.monotonic() + min(max(PICTURE_S, rest), LONGEST_S)
            return Content(self._picture[1], "image/png") if self._picture is not None else None


def give_way() -> None:
    """Let every other program go before the thread that calls this."""
    with contextlib.suppress(AttributeError, OSError):
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
