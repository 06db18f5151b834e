"""What a journal says of a run, as it is told: where it stands, how long it takes, what was flagged and why."""

import datetime
import math
import sys
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gonio import shown
from gonio.lab.acquisition.journal import Event
from gonio.typing import Floats, JsonObject

RECENT = 64
"""Steps whose durations tell how long the next ones take."""
PAUSES = ("suspended", "paused")
STOPS = {"end": "ended", "interrupted": "interrupted", "device_error": "failed"}
SILENT_S = 60.0
"""Longest time between two lines of a run that lives; or every `LATE` steps."""
LATE = 10.0
KEPT = 50
"""Of steps that are long ago each 50th is told in full; with them time series have points enough."""
OWN = ("n", "event", "wall", "crc")


@dataclass(slots=True)
class Session:
    """From the start of the program that measures to its last line."""

    began: float
    last: float
    steps: int = 0


@dataclass
class RunStatus:
    """A run, after some of its events.

    Parameters
    ----------
    every
        Points between two visits to the reference (`reference.every`); 0 where there is one visit at the end.
    angles_deg
        theta_i, phi_i, theta_r, phi_r of each point of the plan.
    """

    every: int = 0
    angles_deg: Sequence[Sequence[float]] | Floats = ()
    chosen_deg: list[Sequence[float]] = field(default_factory=list)
    """The same of the points that were chosen as the run grew; they follow those of the plan."""
    done: dict[int, str] = field(default_factory=dict)
    """The steps that count, and what they are."""
    total: int = 0
    """Steps of the run, as far as it is known."""
    points: int = 0
    """How many of the steps that count are points."""
    sessions: list[Session] = field(default_factory=list)
    flagged: int = 0
    last: Event | None = None
    last_shown: tuple[str, Event] | None = None
    """The name of the last frame that shows something, and its step."""
    why: dict[str, str] = field(default_factory=dict)
    """For what the run waits, by rule."""
    visits_s: dict[int, float] = field(default_factory=dict)
    """When each visit to the reference was taken [s, rig's clock], by its step."""
    stopped: str = ""
    """How it came to its end, or ""."""
    took_s: float | None = None
    """How long the last step took [s], by the clock on the wall; None where something else happened meanwhile."""
    _durations: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))
    _waited: bool = True
    _bytes: int = 0

    def take(self, event: Event, *, short: bool = False) -> JsonObject:
        """One more event; what a page has to know of it, or the least of that of a step among very many."""
        self.note(event)
        kind = str(event.get("event", ""))
        if short and is_one_of_many(event):
            return shortened(event)
        out: JsonObject = {"n": event["n"], "event": kind, "wall": event.get("wall", "")}
        if kind == "step":
            out |= self._told(event)
        else:
            out["text"] = said(event)
            if kind in ("chosen", "enough"):
                out["why"] = reasons(event.get("why"))
                out["points_deg"] = event.get("points", [])
        return out

    def note(self, event: Event) -> None:
        """One more event."""
        kind, at = str(event.get("event", "")), seconds(event.get("wall"))
        if self.sessions:
            self.sessions[-1].last = at
        if kind == "step":
            self._step(event, at)
        else:
            self._other(kind, event, at)
        self.last = event

    def _other(self, kind: str, event: Event, at: float) -> None:
        if kind == "session":
            self.sessions.append(Session(at, at))
            self.total, self._waited = len(self.done) + int(event.get("left", 0)), True
            self.stopped, self.why = "", {}
        elif kind == "chosen":
            points = event.get("points", [])
            self.chosen_deg += points
            self.total += len(points) + (math.ceil(len(points) / self.every) if self.every else 1)
        elif kind == "lost":
            for number in event.get("steps", []):
                self._count(int(number), None)
        elif kind in PAUSES:
            self.why[str(event.get("rule", kind))] = str(event.get("message", ""))
            self._waited = True
        elif kind == "continued":
            self.why, self._waited = {}, True
        elif kind in STOPS:
            self.stopped = STOPS[kind]
            self.why = {kind: str(event["message"])} if event.get("message") else {}

    def _step(self, event: Event, at: float) -> None:
        before, self.took_s = self.last, None
        if before is not None and not self._waited:
            self.took_s = at - seconds(before.get("wall"))
            self._durations.append(self.took_s)
        self._waited, self.stopped, self.why = False, "", {}
        number = int(event["step"])
        self._count(number, sys.intern(str(event.get("kind", ""))))
        if event.get("kind") == "reference":
            self.visits_s[number] = rig_s(event)
        self.total = max(self.total, len(self.done))
        if self.sessions:
            self.sessions[-1].steps += 1
        self.flagged += bool(event.get("flag"))
        frames = event.get("frames", [])
        self._bytes += sum(int(frame.get("bytes") or 0) for frame in frames)
        shown = max(_lit(frames) or frames, key=lambda frame: float(frame["exposure_s"]), default=None)
        if shown is not None:
            self.last_shown = str(shown["file"]), event

    def _told(self, event: Event) -> JsonObject:
        point, frames = event.get("point"), event.get("frames", [])
        longest: dict[str, float] = {}
        for frame in _lit(frames):
            longest[frame["band"]] = max(longest.get(frame["band"], 0.0), float(frame["exposure_s"]))
        exposure = max(longest.values(), default=0.0)
        levels = event.get("level_per_s") or {}
        level = max((float(v) * longest.get(band, 0.0) for band, v in levels.items()), default=0.0)
        out: JsonObject = {
            "step": int(event["step"]),
            "time_s": rig_s(event),
            "kind": event.get("kind"),
            "point": point,
            "flag": str(event.get("flag", "")),
            "frames": len(frames),
            "exposure_s": exposure,
            "levels_per_s": {name: rounded(value, 5) for name, value in levels.items()},
            "level": rounded(min(level, 9.99), 4),
            "pose_deg": {name: rounded(math.degrees(a), 7) for name, a in event.get("pose", {}).items()},
            "health": [[*row[:2], rounded(row[2], 5), *row[3:4]] for row in event.get("health", [])],
        }
        angles = self.angles(point)
        return out if angles is None else out | {"angles_deg": angles}

    def _count(self, number: int, kind: str | None) -> None:
        """A step counts as what it is, or no more."""
        before = self.done.pop(number, None)
        if kind is not None:
            self.done[number] = kind
        self.points += (kind == "point") - (before == "point")

    def angles(self, point: Any) -> list[float] | None:
        """The four angles of a point [deg]; None for what is no point of this run."""
        if not isinstance(point, int) or not 0 <= point < len(self.angles_deg) + len(self.chosen_deg):
            return None
        planned = len(self.angles_deg)
        return list(map(float, self.angles_deg[point] if point < planned else self.chosen_deg[point - planned]))

    def every_angle(self) -> Floats:
        """The four angles of every point so far [deg], shape (points, 4)."""
        return np.concatenate([np.asarray(a, dtype=float).reshape(-1, 4) for a in (self.angles_deg, self.chosen_deg)])

    @property
    def step_s(self) -> float | None:
        """How long a step took of late [s], on average."""
        return sum(self._durations) / len(self._durations) if self._durations else None

    @property
    def bytes_left(self) -> float:
        """What the steps that are left need on the disk, as those before them did."""
        return self._bytes / max(len(self.done), 1) * max(self.total - len(self.done), 0)

    def state(self, now_s: float, lives: bool | None) -> tuple[str, str]:
        """Where the run stands in a word, and why in a sentence or "".

        Parameters
        ----------
        now_s
            The time of day [s since 1970].
        lives
            Whether its process holds the journal, where that can be told.
        """
        reasons = "; ".join(text for text in self.why.values() if text)
        if self.last is None:
            return "waiting", "nothing has been measured yet"
        if self.stopped:
            return self.stopped, reasons
        silent = now_s - seconds(self.last.get("wall"))
        if lives is False:
            return "died", f"its process is gone, {ago(silent)} after its last line; --resume goes on"
        if self.why:
            return ("paused" if "paused" in self.why else "suspended"), reasons
        if silent > max(SILENT_S, LATE * (self.step_s or 0.0)):
            if lives is None:
                return "silent", f"nothing was written for {ago(silent)}: it takes long, or its process is gone"
            return "running", f"nothing was written for {ago(silent)}"
        return "running", ""


def is_one_of_many(event: Mapping[str, Any]) -> bool:
    """Whether an old event may be shortened for a page."""
    return event.get("event") == "step" and not event.get("flag") and bool(event["n"] % KEPT)


def shortened(event: Mapping[str, Any]) -> JsonObject:
    """The least that a page has to know of a step."""
    return {key: event.get(key) for key in ("n", "event", "step", "kind", "point")}


def _lit(frames: Sequence[Event]) -> list[Event]:
    return [frame for frame in frames if frame.get("lamp")]


def seconds(wall: Any) -> float:
    """A journal's time of day [s since 1970]; 0 where it is none."""
    try:
        return datetime.datetime.fromisoformat(str(wall)).timestamp()
    except ValueError:
        return 0.0


def rig_s(event: Mapping[str, Any]) -> float:
    """When a step was taken [s, rig's clock], which goes on from session to session; 0 where nothing says it."""
    value = event.get("time_s")
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0


def rounded(value: Any, digits: int) -> Any:
    """A number as JSON can hold it, in a few digits; what is none stays as it is."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return float(f"{value:.{digits}g}") if math.isfinite(value) else None


def ago(seconds: float) -> str:
    """A duration as people say it: 45 s, 12 min, 3 h 20 min, 2 d 4 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 90:
        return f"{minutes} min"
    hours = minutes // 60
    return f"{hours} h {minutes % 60:02d} min" if hours < 48 else f"{hours // 24} d {hours % 24} h"


def said(event: Mapping[str, Any]) -> str:
    """An event in words; of one that nobody knows here, what it holds."""
    kind = event.get("event")
    if kind == "session":
        return f"a session begins: {event.get('left')} steps to take (gonio {event.get('gonio')})"
    if kind == "chosen":
        count = len(event.get("points", []))
        return f"{count} {'point' if count == 1 else 'points'} more, from step {event.get('first_step')} on"
    if kind == "enough":
        verdict = "the target is reached" if event.get("met") else "no more points"
        return ": ".join(filter(None, (verdict, str(event.get("message", "")).removeprefix("enough: "))))
    if kind == "end":
        return "every step is done"
    if kind == "continued":
        return f"going on after {ago(float(event.get('waited_s', 0.0)))}"
    if kind == "lost":
        return f"taken back: steps {plain(event.get('steps'))}"
    message = event.get("message")
    rest = {key: value for key, value in event.items() if key not in (*OWN, "message", "time_s")}
    return str(message) if message else plain(rest)


def _with_u(value: Any, u: Any) -> str:
    known = all(isinstance(x, int | float) and math.isfinite(x) for x in (value, u))
    return shown.value(value, u) if known else plain(value)


REASONS = {
    "spent_s": "rig time so far",
    "batch_s": "rig time of these",
    "values": "values so far",
    "u_rel": "relative uncertainty, at worst",
    "median_u_rel": "relative uncertainty, median",
    "misfit": "scatter over what was expected",
    "cover": "of these, to cover gaps",
    "u": "uncertainty",
    "u_final": "uncertainty with all causes",
}
"""What the samplers' numbers mean; others go by their own names."""


def reasons(why: Any) -> list[str]:
    """Why points were chosen, a line each; what a sampler keeps for itself (rows of numbers) is left out."""
    if not isinstance(why, Mapping):
        return [plain(why)] if why else []
    rest: JsonObject = dict(why)
    out: list[str] = []
    fit, u = rest.get("fit"), rest.get("u")
    if isinstance(fit, Mapping) and isinstance(u, Mapping):
        del rest["fit"], rest["u"]
        out = [f"{name}: {_with_u(value, u.get(name))}" for name, value in fit.items()]
    for key, value in rest.items():
        if isinstance(value, list | tuple) and any(isinstance(row, list | tuple) for row in value):
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if number and key.endswith("_s"):
            told = ago(float(value))
        elif number and key.endswith("u_rel"):
            told = f"{100.0 * value:.2g} %"
        elif isinstance(value, Mapping):
            told = ", ".join(f"{name} {plain(inner)}" for name, inner in value.items())
        else:
            told = plain(value)
        out.append(f"{REASONS.get(key, key.replace('_', ' '))}: {told}")
    return out


def plain(value: Any, most: int = 300) -> str:
    """What JSON holds, in a line without its brackets."""
    if isinstance(value, Mapping):
        text = ", ".join(f"{key.replace('_', ' ')} {plain(inner, most)}" for key, inner in value.items())
    elif isinstance(value, list | tuple):
        text = ", ".join(plain(inner, most) for inner in value[:12]) + (" ..." if len(value) > 12 else "")
    elif isinstance(value, float):
        text = f"{value:.4g}"
    else:
        text = "" if value is None else str(value)
    return text if len(text) <= most else text[: most - 4] + " ..."
