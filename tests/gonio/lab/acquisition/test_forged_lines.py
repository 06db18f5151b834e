"""Lines of a journal that are whole and hold what no version of this program writes: every reader names the line, or
can do with what stands there. A forged line has the right checksum.
"""

import copy
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from gonio_bluesky.event_documents import documents
from gonio_watch.watching import Watched

from gonio.errors import GonioError
from gonio.lab.acquisition import repair
from gonio.lab.acquisition.journal import Event
from gonio.lab.acquisition.progress import Remaining
from gonio.lab.acquisition.run import Run
from gonio.lab.rig.dng import encode_dng, read_raw, read_record

WALL = "2026-11-20T10:00:00.000Z"
OTHERS: list[Event] = [
    {"event": "session", "gonio": "0.1.0", "steps": 9, "left": 2},
    {"event": "remark", "message": "the arm was pushed"},
    {"event": "suspended", "rule": "hot", "step": 3, "message": "too hot", "time_s": 12.5},
    {"event": "paused", "step": 3, "why": "asked", "message": "waits", "time_s": 12.5},
    {"event": "retry", "step": 3, "device": "camera", "attempt": 1, "message": "no frame", "time_s": 12.5},
    {"event": "continued", "step": 3, "waited_s": 60.0, "time_s": 72.5},
    {"event": "chosen", "first_step": 20, "points": [[20.0, 0.0, 30.0, 180.0]], "why": {"u_rel": 0.1, "fit": {"a": 1}}},
    {"event": "enough", "met": True, "message": "enough", "why": {"spent_s": 12.0, "u": {"a": 1.0}, "fit": {"a": 2.0}}},
    {"event": "interrupted", "message": "stopped"},
    {"event": "device_error", "message": "no answer"},
    {"event": "lost", "steps": [3], "frames": ["000003-x-01.dng is missing"]},
    {"event": "repaired", "kept": 4, "rebuilt": [2]},
    {"event": "end", "steps": 9},
    {"event": "of_tomorrow", "list": [1, 2.5, "x"]},
]
GONE = object()
VALUES = [GONE, None, "x", -1, 10**30, 1e308, float("nan"), float("inf"), True, [], {}, [[["deep"]]], {"a": {"b": []}}]


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every key of an object, and of those in it; of lists the first entry."""
    inner = value.items() if isinstance(value, dict) else list(enumerate(value))[:1] if isinstance(value, list) else ()
    for key, part in inner:
        yield (*at, key)
        yield from places(part, (*at, key))


def forged(event: Event) -> Iterator[tuple[str, Event]]:
    """An event with something else at one place; the values in turn, so that the places together see all."""
    for count, at in enumerate(places(event)):
        for value in [VALUES[(5 * count + k) % len(VALUES)] for k in range(2)]:
            out = copy.deepcopy(event)
            inner: Any = out
            for key in at[:-1]:
                inner = inner[key]
            if value is GONE:
                del inner[at[-1]]
            else:
                inner[at[-1]] = value
            yield f"{'.'.join(map(str, at))} = {'gone' if value is GONE else value!r}", out


def sealed(event: Event) -> bytes:
    """A line with a right checksum, of numbers too that JSON does not have."""
    import zlib

    body = json.dumps(event, separators=(",", ":")).encode()[:-1]
    return body + b',"crc":"%08x"}\n' % zlib.crc32(body)


def follow(path: Path) -> None:
    watched = Watched(path)
    try:
        while watched.look():
            pass
        told = watched.status()
        json.dumps(told, allow_nan=False)
        if "cannot be used" in told["why"]:
            raise GonioError(told["why"])
    finally:
        watched.close()


READERS: dict[str, Callable[[Path], object]] = {
    "steps": lambda path: list(Run.open(path).steps()),
    "time left": lambda path: Remaining.of_run(Run.open(path)).left,
    "documents": lambda path: json.dumps(list(documents(Run.open(path))), allow_nan=False),
    "watching": follow,
}


@pytest.mark.parametrize("number", range(-1, len(OTHERS)), ids=["step", *(event["event"] for event in OTHERS)])
def test_every_reader_names_a_forged_line_or_can_do_with_it(measured: Path, tmp_path: Path, number: int) -> None:
    path = tmp_path / "run"
    path.mkdir()
    for name in ("run.toml", "plan.csv", "gonio.sha256"):
        shutil.copy(measured / name, path)
    lines = (measured / "journal.jsonl").read_bytes().splitlines(keepends=True)[: 6 if number < 0 else 4]
    at = 3 if number < 0 else len(lines)
    event = json.loads(lines[3]) if number < 0 else {"n": at, **OTHERS[number], "wall": WALL}
    event.pop("crc", None)
    refused = 0
    for what, line in forged(event):
        (path / "journal.jsonl").write_bytes(b"".join([*lines[:at], sealed(line), *lines[at + 1 :]]))
        for name, read in READERS.items():
            try:
                read(path)
            except GonioError as error:
                if "cannot reach" in str(error):  # a point like any other, which this rig does not take
                    continue
                assert f"line {at + 1} " in str(error) or f"line {at + 1}:" in str(error), (what, name, str(error))  # noqa: PT017
                refused += 1
            except Exception as error:
                raise AssertionError(f"{what}: {name}: {error!r}") from error
    assert refused >= len(READERS), "nothing was forged"


def test_changed_pixels_are_found_where_the_journal_was_changed_with_them(measured: Path, tmp_path: Path) -> None:
    path = tmp_path / "run"
    shutil.copytree(measured, path)
    lines = (path / "journal.jsonl").read_bytes().splitlines(keepends=True)
    at, event = next((k, e) for k, e in enumerate(map(json.loads, lines)) if e.get("kind") == "point")
    entry = event["frames"][-1]
    file = path / "frames" / entry["file"]
    data = file.read_bytes()
    taken = read_raw(file)
    mosaic = taken.mosaic.copy()
    mosaic[1, 1] += 1
    data = encode_dng(replace(taken, mosaic=mosaic), read_record(data))
    file.write_bytes(data)
    entry["sha256"] = hashlib.sha256(data).hexdigest()
    event.pop("crc")
    (path / "journal.jsonl").write_bytes(b"".join([*lines[:at], sealed(event), *lines[at + 1 :]]))
    assert not repair.check(measured).damaged
    wrong = [text for texts in repair.check(path).damaged.values() for text in texts]
    assert wrong == [f"frames/{entry['file']} {repair.CHANGED}"]


def test_a_page_goes_on_after_a_forged_line_and_says_it(measured: Path, tmp_path: Path) -> None:
    path = tmp_path / "run"
    shutil.copytree(measured, path)
    lines = (measured / "journal.jsonl").read_bytes().splitlines(keepends=True)
    event = json.loads(lines[5]) | {"frames": "none"}
    (path / "journal.jsonl").write_bytes(b"".join([*lines[:5], sealed({**event, "crc": ""}), *lines[6:]]))
    with Watched(path) as watched:
        watched.look()
        assert len(watched.log) == 5
        assert "line 6 of the journal" in watched.status()["why"]
        assert repair.repair(path) is not None
        while watched.look():
            pass
        assert len(watched.run_status.done) == 9
        assert "line 6" not in watched.status()["why"]
