"""The lines of a journal that is made again: which of the old ones can be read, where steps that were made again from
their frames belong among them, and what nothing tells.
"""

import contextlib
import datetime
import json
import math
from collections.abc import Iterable, Sequence

import numpy as np

from gonio.disk import is_own, read_file, read_manifest
from gonio.errors import DataError
from gonio.lab.acquisition.journal import Event, decode, files_named, now
from gonio.lab.acquisition.records import StepRecord, event_of
from gonio.lab.acquisition.run import CHOSEN, Run


def readable(data: bytes) -> tuple[list[Event], bool]:
    """The events whose lines are whole and hold what they should, each once and in the order of their numbers; and
    whether anything else is there.
    """
    lines = data.splitlines(keepends=True)
    events = []
    for line in dict.fromkeys(lines):
        event = decode(line)
        with contextlib.suppress(DataError):
            if event is not None and event_of(line):
                events.append(event)
    whole = len(events) == len(lines) and all(event["n"] == n for n, event in enumerate(events))
    return sorted(events, key=lambda event: int(event["n"])), not whole


def numbered(event: Event, number: int) -> Event:
    """An event with its place in the journal; `wall` stays that of the event, where it is known."""
    content = {key: value for key, value in event.items() if key not in ("n", "wall", "crc")}
    return {"n": number, **content, "wall": event.get("wall", now())}


def taken(events: Iterable[Event]) -> dict[int, StepRecord]:
    """The steps that the journal's lines name as taken, and not as lost."""
    done: dict[int, StepRecord] = {}
    for event in events:
        if event["event"] == "step":
            done[event["step"]] = StepRecord.from_json(event)
        elif event["event"] == "lost":
            for number in event["steps"]:
                done.pop(number, None)
    return done


def with_choices(run: Run, events: list[Event]) -> tuple[list[Event], list[Event]]:
    """Events without choices that were not made, as `CHOSEN` tells, and the choices that stand in none of them."""
    own = read_manifest(run.path).get(CHOSEN)
    if own is None or not is_own(run.path / CHOSEN, own):
        return events, []
    made = {batch["first_step"]: batch for batch in json.loads(read_file(run.path / CHOSEN))}
    kept: list[Event] = []
    for event in events:
        batch = made.get(event["first_step"]) if event["event"] == "chosen" else None
        if event["event"] != "chosen" or (batch is not None and batch["points"] == event["points"]):
            kept.append(event)
            made.pop(event["first_step"] if batch is not None else None, None)
    return kept, list(made.values())


def at_once(steps: Iterable[StepRecord]) -> set[int]:
    """Steps of a laboratory's run that were taken while another one was: one camera does not do that."""
    out: set[int] = set()
    until_s, of = -math.inf, -1
    for step in sorted(steps, key=lambda step: step.time_s):
        if step.time_s <= until_s:
            out |= {of, step.step}
        last_s = max((frame.time_s for frame in step.frames), default=step.time_s)
        if last_s >= until_s:
            until_s, of = last_s, step.step
    return out


def in_time(run: Run, events: Sequence[Event], rebuilt: Sequence[StepRecord]) -> list[Event]:
    """Events, with the steps that were made again where their time puts them: after an earlier line of theirs, and
    before the first event that came later.
    """
    since = {n: at for at, event in enumerate(events) for n in _steps_of(event)}
    times = [_time_s(event, lab=run.sample is None) for event in events]
    latest = np.maximum.accumulate([*times, math.inf])
    places: dict[int, list[StepRecord]] = {}
    for step in sorted(rebuilt, key=lambda step: step.time_s):
        at, first = int(np.searchsorted(latest, step.time_s, "right")), since.get(step.step, -1) + 1
        if at < first:
            at = next((k for k in range(first, len(events)) if times[k] > step.time_s), len(events))
        places.setdefault(at, []).append(step)
    out: list[Event] = []
    for at in range(len(events) + 1):
        out += [step.to_json() for step in places.get(at, ())]
        out += events[at : at + 1]
    return out


def _steps_of(event: Event) -> list[int]:
    """The steps that a line takes, or takes back."""
    return event["steps"] if event["event"] == "lost" else [event["step"]] if event["event"] == "step" else []


def _time_s(event: Event, *, lab: bool) -> float:
    """When a line was written, on the clock that the times of steps are of; no time where that cannot be told."""
    if event["event"] == "step":
        return float(event["time_s"])
    return datetime.datetime.fromisoformat(event["wall"]).timestamp() if lab and "wall" in event else -math.inf


def _out_of_turn(steps: Iterable[StepRecord]) -> list[int]:
    """Points that were taken after one of a higher number, by their times."""
    out, earliest_s = [], math.inf
    for step in sorted((step for step in steps if step.kind == "point"), key=lambda step: -step.step):
        if step.time_s > earliest_s:
            out.append(step.step)
        earliest_s = min(earliest_s, step.time_s)
    return sorted(out)


def untold(run: Run, rebuilt: Sequence[StepRecord], done: dict[int, StepRecord]) -> list[str]:
    """What nothing tells of a run whose steps were made again."""
    out = []
    if rebuilt and run.settings.run.id is None:
        out.append(
            "an earlier version wrote this run, which gave runs no id: frames of other runs of the same plan, seed, "
            "rig and sample cannot be told from its own"
        )
    known = read_manifest(run.path).keys() | {
        name for files in files_named(run.path / "journal.jsonl") for name in files
    }
    if "run.toml" not in known:
        out.append(f"{run.path / 'run.toml'}: no checksum is left of it: nothing tells whether it is as it was written")
    every = done | {step.step: step for step in rebuilt}
    turned = _out_of_turn(every.values()) if rebuilt and run.sample is None else []
    if turned:
        out.append(
            f"by their times steps {', '.join(map(str, turned[:20]))}{' ...' if turned[20:] else ''} were taken after "
            "later ones: they were taken again, or the clock was set, or the frames are of several runs"
        )
    return out
