"""The sessions of a run: one that is gone on with has several, over hours or days, with the reference as the thread."""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from dataclasses import dataclass, field
from pathlib import Path
from statistics import fmean, stdev
from typing import TYPE_CHECKING

from gonio.documents import JsonObject
from gonio_analysis.result_records import ReferenceLevel, SessionSummary

if TYPE_CHECKING:
    from gonio.acquisition.run import Run

KIND = re.compile(rb'\{"n":\d+,"event":"(\w+)"(?:,"step":\d+,"kind":"(\w+)")?')
"""How the lines of a journal begin."""
ENDINGS = {"end": "all was measured", "interrupted": "was interrupted", "device_error": "a device failed"}
UNKNOWN = "no word of an end"
"""Of a session whose process was killed, or that goes on now."""


@dataclass
class _Session:
    began: str
    ended: str
    steps: int = 0
    ending: str = UNKNOWN
    levels: dict[str, list[float]] = field(default_factory=dict)
    """Signals of the visits to the reference, by band."""


def run_sessions(run: Run) -> list[SessionSummary]:
    """The sessions in which a run took steps, in order; levels of the reference where the run has been reduced."""
    found, visits_s = _sessions(run)
    times_s = [time_s for time_s, _ in visits_s]
    for band in account(run.path):
        for time_s, signal in zip(band["times_s"], band["signals"], strict=True):
            visit = bisect_right(times_s, time_s) - 1  # the visit that had begun last
            if visit >= 0:
                visits_s[visit][1].levels.setdefault(band["band"], []).append(signal)
    first: dict[str, float] = {}
    out = []
    for session in found:
        levels = []
        for name, signals in session.levels.items():
            level = fmean(signals)
            relative = level / first.setdefault(name, level)
            scatter = stdev(signals) / first[name] if len(signals) > 1 else None
            levels.append(ReferenceLevel(name, len(signals), relative, scatter))
        if session.steps:
            out.append(SessionSummary(session.began, session.ended, session.steps, session.ending, levels))
    return out


def _sessions(run: Run) -> tuple[list[_Session], list[tuple[float, _Session]]]:
    """Every session, and the visits to the reference: when each began [s, rig's clock], and in which session."""
    found: list[_Session] = []
    visits: list[tuple[float, _Session]] = []
    last = b""
    events = run.events()
    for line in events.lines(range(len(events))):
        match = KIND.match(line)
        kind = match[1].decode() if match else ""
        if kind == "session":
            if found:
                found[-1].ended = json.loads(last)["wall"]
            wall = json.loads(line)["wall"]
            found.append(_Session(wall, wall))
        elif found and match and kind == "step":
            found[-1].steps += 1
            if match[2] == b"reference":
                visits.append((float(json.loads(line)["time_s"]), found[-1]))
        elif found and kind in ENDINGS:
            found[-1].ending = ENDINGS[kind]
        last = line
    if found:
        found[-1].ended = json.loads(last)["wall"]
    return found, sorted(visits, key=lambda visit: visit[0])


def account(folder: Path) -> list[JsonObject]:
    """What the visits to the reference said, a band each, as the reduction has left it; nothing before it."""
    try:
        meta = json.loads((folder / "brdf.meta.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    visits = (meta.get("provenance") or {}).get("reference") or []
    return [band for band in visits if isinstance(band, dict) and "times_s" in band]
