"""A run that is being measured, or was: its journal as events of a page, its values so far, its last frame.

Everything here reads, and only while somebody looks. A thread looks at the journal every `POLL_S`, and at what another
process (`gonio_watch.worker`) has worked out for all watchers of the run.

Also here is a run in the terminal, as the page shows it: a panel that is drawn again, or plain lines for a log file.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from gonio import platform
from gonio.errors import GonioError
from gonio.geometry import IN_PLANE, Directions
from gonio.lab.acquisition.run import Run
from gonio.lab.live.event_log import BATCH, EventLog
from gonio.lab.live.server import Content, Request
from gonio.shown import visible, with_u
from gonio.typing import JsonObject
from gonio_watch.follow import Follower
from gonio_watch.run_status import RunStatus, ago, is_one_of_many, plain, rounded, shortened
from gonio_watch.shared import CURVES, FRAME, Now, Shared

if TYPE_CHECKING:
    from rich.console import RenderableType

POLL_S = 0.2
"""Time between two looks at the journal."""
RAPID_S = 0.4
"""Time between two looks while each finds something: steps of a fast run take less work together than one by one."""
LOOK_S = 1.0
"""Time between two looks at the room on the disk, and at whether the process that measures lives."""
PATIENCE_S = 5.0
"""Longest wait for the end of its thread."""
UNREAD = 4_000_000
"""Bytes of a journal: steps that lie farther before its end are told in short."""
NOTHING = b'{"view":null,"maps":[],"visits":[],"says":""}'
"""What the page draws where there are no values."""
GOING = ("running", "suspended", "paused", "silent")
"""States of a run that may go on by itself."""
OVER = ("ended", "interrupted", "failed", "died")
"""States after which nothing comes, unless somebody resumes the run."""


class Watched:
    """A run, followed in a thread while the block lasts.

    Parameters
    ----------
    path
        The folder of the run; it need not exist yet.
    command
        What begins the process that works out its values (`gonio_watch.shared.Shared`).
    """

    def __init__(self, path: Path, command: Sequence[str] = ()) -> None:
        self.path = path
        self.shared = Shared(path, command)
        self.log = EventLog(_shorten)
        self.log.tell("run", {"name": path.absolute().name})
        self.run_status = RunStatus()
        self.run: Run | None = None
        self.values = Now()
        """What has been worked out so far, last time it was looked at."""
        self.wanted = False
        """Whether the run is shown although nobody looks at a page."""
        self.problem = ""
        self._follower = Follower(path)
        self._tried = -LOOK_S
        self._news = threading.Condition()
        self._ended = False
        self._life = 0
        """Goes up where all is read anew."""
        self._lived: tuple[float, bool | None] = -LOOK_S, None
        """When it was looked whether the process that measures lives, and whether it did."""
        self.stands = self.status()
        """How the run stood when that was told last."""
        self._thread = threading.Thread(target=self._follow, name="follow", daemon=True)

    def __enter__(self) -> Self:
        try:
            self._thread.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Follow no more."""
        with self._news:
            self._ended = True
            self._news.notify_all()
        if self._thread.ident is not None:
            self._thread.join(PATIENCE_S)
        self.shared.close()

    def events_after(self, number: int) -> list[JsonObject]:
        """What a page knows of the journal's next `BATCH` events beyond the first `number`."""
        return [json.loads(event.data) for event in self.log.events(number, BATCH)]

    # --- following ---------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        looked = -LOOK_S
        while not self._ended:
            if not self.wanted and not self.log.listeners:  # nobody looks: the journal is not even read
                with self._news:
                    self._news.wait_for(lambda: self._ended, POLL_S)
                continue
            new = self.look()
            if new or time.monotonic() - looked >= LOOK_S:
                looked = time.monotonic()
                self.tell()
            self._take_values()
            with self._news:
                self._news.wait_for(lambda: self._ended, RAPID_S if new else POLL_S)

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
            short = self._follower.unread > UNREAD
            out = [("journal", self.run_status.take(event, short=short)) for event in events]
            if out:
                new = True
                self.log.append(*out)
        return new

    def _begin_anew(self) -> None:
        """Another journal is in the place of the one that was read."""
        self._life = self._follower.lives
        self.run_status, self.run, self.values, self._tried = RunStatus(), None, Now(), -LOOK_S
        self.log.restart()
        self.log.tell("hello", {"journal": self._follower.identity})

    def _open(self) -> None:
        """Read what was asked for, now that the run has begun."""
        try:
            run = Run.open(self.path)
            planned = run.planned
        except GonioError as error:
            self.problem = str(error)
            return
        self.problem = ""
        self.run_status.every = run.description.reference.every
        self.run_status.angles_deg = planned.angles_deg
        left_out: dict[tuple[str, str], int] = {}
        for flag, reason in zip(planned.flags, planned.reasons, strict=True):
            if flag:
                left_out[flag, reason] = left_out.get((flag, reason), 0) + 1
        directions = Directions.from_degrees(*planned.angles_deg.T)
        most = sorted(left_out.items(), key=lambda item: -item[1])[:12]
        self.run = run
        self.log.tell(
            "run",
            {
                "name": self.path.absolute().name,
                "plan": run.settings.run.plan,
                "rig": run.description.name,
                "sample": run.sample.name if run.sample is not None else "",
                "bands": [band.name for band in run.bands],
                "asked": asked(run),
                "points": len(planned.flags),
                "limits_deg": {name: list(pair) for name, pair in run.description.limits_deg().items()},
                "left_out": [[flag, reason, count] for (flag, reason), count in most],
                "out_of_plane": bool(np.any(np.abs(directions.out_of_plane) > IN_PLANE)),
            },
        )

    def tell(self) -> None:
        """Say how the run stands now."""
        self.stands = self.status()
        self.log.tell("status", self.stands)

    def status(self) -> JsonObject:
        """How the run stands now, in what JSON can hold; for the thread that follows it."""
        run_status, now = self.run_status, time.time()
        state, why = run_status.state(now, None if run_status.stopped else self._writer_lives())
        step_s = run_status.step_s
        going = state in GOING
        left = self.values.left if going else None
        out: JsonObject = {
            "state": state,
            "why": "; ".join(text for text in (why, self._follower.damaged, self.problem) if text),
            "done": len(run_status.done),
            "total": run_status.total,
            "events": len(self.log),
            "points": run_status.points,
            "flagged": run_status.flagged,
            "step_s": rounded(step_s, 3) if step_s is not None else None,
            "left_s": left[0] if left is not None else None,
            "left_u_s": left[1] if left is not None else None,
            "sessions": [[round(s.began, 3), round(s.last, 3), s.steps] for s in run_status.sessions],
            "frame": self.values.frame[0] if self.values.frame else None,
            "frame_step": self.values.frame[1] if self.values.frame else None,
        }
        with contextlib.suppress(OSError):
            out["free_bytes"] = rounded(float(platform.free_bytes(self.path)), 3)
            out["needed_bytes"] = rounded(run_status.bytes_left, 3) if going else None
        return out

    def _writer_lives(self) -> bool | None:
        """As its follower says it, of late: the kernel's list of locks is not asked for every step."""
        asked_s, lives = self._lived
        if not lives or time.monotonic() - asked_s >= LOOK_S:
            lives = self._follower.writer_lives()
            self._lived = time.monotonic(), lives
        return lives

    # --- values and the last frame -----------------------------------------------------------------------------------

    def _take_values(self) -> None:
        """Say that somebody looks, and tell what has been worked out since."""
        found = self.shared.look()
        if self.shared.problem:
            self.log.tell("problem", {"text": self.shared.problem})
        if found is None or found.journal != self._follower.identity:
            return
        before, self.values = self.values, found
        if found.version != before.version:
            self.log.tell("curves", {"version": found.version})
        if found.problem != before.problem:
            self.log.tell("problem", {"text": found.problem})
        if found.frame != before.frame or found.left != before.left:
            self.tell()

    def curves(self, request: Request) -> Content:
        """The values so far, as the page draws them."""
        found = self.shared.read(CURVES) if self.values.version else None
        return Content(found or NOTHING, "application/json")

    def picture(self, request: Request) -> Content | None:
        """The last frame as a PNG; None where there is none yet."""
        found = self.shared.read(FRAME) if self.values.frame else None
        return Content(found, "image/png") if found is not None else None


def asked(run: Run) -> str:
    """What a run that grows was asked for, in words; "" for one that does not."""
    adaptive = run.settings.adaptive
    if adaptive is None:
        return ""
    own = [f"{name.replace('_', ' ')} {plain(value)}" for name, value in adaptive.own.items()]
    return "; ".join([f"grows by {adaptive.how} for {adaptive.budget_h:g} h at most", *own])


def _shorten(line: bytes) -> bytes:
    if b'"wall":' not in line:
        return line  # it was short from the beginning
    event = json.loads(line)
    return json.dumps(shortened(event), separators=(",", ":")).encode() if is_one_of_many(event) else line


DRAWN_S = 0.5
LISTED = 6
"""Values, flags and events that are shown."""
LINES = 200
"""Lines of a run in a log file, about."""


def show(watched: Watched) -> None:
    """Show a run until it is over, or a signal ends this."""
    watched.wanted = True
    if sys.stdout.isatty():
        _panel(watched)
    else:
        _lines(watched)


def _panel(watched: Watched) -> None:
    from rich.console import Console
    from rich.live import Live

    with Live(get_renderable=lambda: render(watched), console=Console(), refresh_per_second=1.0 / DRAWN_S):
        while watched.stands["state"] not in OVER:
            threading.Event().wait(DRAWN_S)


def _lines(watched: Watched) -> None:
    told, number, steps = ("", ""), 0, 0
    while True:
        status = watched.stands
        while events := watched.events_after(number):
            for event in events:
                number += 1
                if event["event"] != "step":
                    _say(f"{_clock(event)}  {event_line(event)}")
                    continue
                steps += 1
                part = max(status["total"] // LINES, 1)
                if event.get("flag") or steps % part == 0:
                    _say(f"{_clock(event)}  {step_line(event)}")
            status = watched.stands
        if told != (status["state"], status["why"]):
            told = status["state"], status["why"]
            _say(summary(status))
        if status["state"] in OVER and number == status["events"]:
            return
        threading.Event().wait(DRAWN_S)


def _say(text: str) -> None:
    print(visible(text), flush=True)


def _clock(event: JsonObject) -> str:
    return str(event.get("wall", ""))[11:19]


def summary(status: JsonObject) -> str:
    """How a run stands, in a line."""
    parts = [f"{status['state']}: step {status['done']} of {status['total'] or '?'}"]
    if status["left_s"] is not None:
        unsure = f" ± {ago(status['left_u_s'])}" if is_unsure(status["left_s"], status.get("left_u_s")) else ""
        parts.append(f"about {ago(status['left_s'])}{unsure} left")
    if status["flagged"]:
        parts.append(f"{status['flagged']} flagged")
    if status.get("free_bytes"):
        parts.append(f"{status['free_bytes'] / 1e9:.3g} GB free")
    return ", ".join(parts) + (f" ({status['why']})" if status["why"] else "")


def is_unsure(seconds: float, u_seconds: float | None) -> bool:
    """Whether the uncertainty of a duration is worth saying."""
    return u_seconds is not None and u_seconds >= max(0.02 * seconds, 1.0)


def step_line(event: JsonObject) -> str:
    """A step in a line."""
    what = f"step {event['step']}: {event['kind']}" + (f" {event['point']}" if event["point"] is not None else "")
    if "angles_deg" in event:
        theta_i, phi_i, theta_r, phi_r = event["angles_deg"]
        what += f", theta_i {theta_i:g}, theta_r {theta_r:g}, dphi {(phi_r - phi_i) % 360:g} deg"
    if event["kind"] != "dark" and not event.get("flag") and "level" in event:
        what += f"; {100 * event['level']:.0f} % of full scale in {event['exposure_s']:.3g} s"
    return what + (f"  [{event['flag']}]" if event.get("flag") else "")


def event_line(event: JsonObject) -> str:
    """What happened, and the reasons where there are some."""
    why = "; ".join(event.get("why", []))
    return f"{event['event'].replace('_', ' ')}: {event.get('text', '')}" + (f" ({why})" if why else "")


def values_lines(watched: Watched) -> list[str]:
    """The newest provisional values, the newest last."""
    out = []
    for band in watched.values.bands:
        name = f"{band['name']}: " if len(watched.values.bands) > 1 else ""
        for theta_i, phi_i, theta_r, phi_r, brdf, u in band["values"][-LISTED:]:
            where = f"theta_i {theta_i:g}, theta_r {theta_r:g}, dphi {(phi_r - phi_i) % 360:g} deg"
            out.append(f"{name}{where}: ({with_u(brdf, u)}) 1/sr")
    return out


def drift_line(watched: Watched) -> str:
    """How far the last visit to the reference lies from the first, in each band."""
    visits = ((band["name"], *band["visit"]) for band in watched.values.bands)
    return ", ".join(f"{name} ({with_u(100 * (ratio - 1), 100 * u)}) %" for name, ratio, u in visits)


def render(watched: Watched) -> RenderableType:
    """The panel."""
    from rich.console import Group
    from rich.panel import Panel
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    status, rows = watched.stands, Table.grid(padding=(0, 2))
    rows.add_column(style="dim", no_wrap=True)
    rows.add_column()
    events = watched.events_after(max(0, len(watched.log) - BATCH))
    step = next((event for event in reversed(events) if event["event"] == "step"), None)

    def row(name: str, text: str) -> None:
        rows.add_row(name, Text(visible(text)))  # brackets are no markup

    if step is not None:
        row("now", step_line(step))
        row("axes", "  ".join(f"{name} {value:.2f}°" for name, value in step["pose_deg"].items()))
        told = [f"{d} {q.replace('_', ' ')} {v}{u}" for d, q, v, u in step["health"] if u != "deg" and v is not None]
        if told:
            row("devices", "  ".join(told))
    if watched.values.bands:
        row("reference", f"{drift_line(watched)} since the first measurement of it")
        row("values", "\n".join([*values_lines(watched), "provisional"]))
    flags = [event for event in events if event["event"] == "step" and event.get("flag")]
    if flags:
        row("flagged", "\n".join(step_line(event) for event in flags[-LISTED:]))
    others = [event for event in events if event["event"] != "step"]
    if others:
        told = [f"{_clock(event)} {event_line(event)}" for event in others[-LISTED:]]
        row("events", "\n".join(told))
    if status["sessions"]:
        began, last, _ = status["sessions"][-1]
        row("session", f"{len(status['sessions'])}., {ago(last - began)}")
    bar = Table.grid(expand=True)  # a bar alone does not end its line
    bar.add_row(ProgressBar(total=max(status["total"], 1), completed=status["done"]))
    name = Text(visible(watched.path.absolute().name))
    return Panel(Group(Text(visible(summary(status)), style="bold"), bar, rows), title=name, title_align="left")
