"""A run that is followed: what a page is told, and that nobody is disturbed."""

from __future__ import annotations

import fcntl
import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gonio.acquisition.journal import Journal, decode, encode
from gonio.acquisition.records import StepRecord
from gonio.live.server import Request
from gonio.live.watching import Watched
from gonio.rig import Frame
from gonio.rig.description import RigDescription
from tests.gonio.live.runs import Played


@pytest.fixture
def followed(played: Played) -> Iterator[Watched]:
    with Watched(played.path) as watched, watched.log.listening():
        yield watched


def until(so: Callable[[], bool]) -> None:
    """Threads need a moment; a machine that is busy needs more."""
    patience = time.monotonic() + 120.0
    while not so():
        assert time.monotonic() < patience
        threading.Event().wait(0.01)


def test_every_line_is_an_event_with_its_number(played: Played, followed: Watched) -> None:
    for at in range(0, len(played.lines), 5):
        played.go_on(5)
        until(lambda at=at: len(followed.log) == min(at + 5, len(played.lines)))  # type: ignore[misc]
    events = followed.log.events(0)
    assert [event.id for event in events] == list(range(1, len(played.lines) + 1))
    assert [json.loads(event.data)["n"] for event in events] == list(range(len(played.lines)))
    until(lambda: followed.status()["state"] == "ended")


def test_nothing_is_read_while_nobody_looks(played: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    played.go_on(100)
    with Watched(played.path) as watched:
        looked = threading.Event()
        monkeypatch.setattr(watched, "look", looked.set)
        assert not looked.wait(0.5), "two rounds and a half"
        monkeypatch.undo()
        with watched.log.listening():
            until(lambda: len(watched.log) == len(played.lines) and watched.behind == 0)
            until(lambda: [len(values.points) for values in watched.values] == [16, 16])


def test_the_last_frame_is_a_picture(played: Played, followed: Watched) -> None:
    asked = Request({}, "")
    assert followed.picture(asked) is None
    played.go_on(5)
    until(lambda: len(followed.log) == 5)
    found = followed.picture(asked)
    assert found is not None
    assert found.body.startswith(b"\x89PNG")
    assert followed.picture(asked) == found


def test_who_measures_gets_the_lock_while_others_watch(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    with Watched(tmp_path / "run") as watched, watched.log.listening():
        for n in range(60):
            with Journal(tmp_path / "run" / "journal.jsonl") as journal:  # each time the lock is taken anew
                journal.append({"event": "session", "steps": 1, "left": 1})
                watched.tell()
                until(lambda n=n: len(watched.log) > n or n % 20 != 0)  # type: ignore[misc]


def test_a_run_whose_settings_cannot_be_read_says_so(played: Played, followed: Watched) -> None:
    (played.path / "run.toml").write_text("not = [toml")
    played.go_on(3)
    until(lambda: "run.toml: is damaged" in followed.status()["why"])
    assert followed.status()["done"] == 2


def test_watchers_of_a_run_work_on_its_frames_in_turns(played: Played) -> None:
    played.go_on(len(played.lines) - 1)  # it has not ended
    with open(played.path / "journal.jsonl", "ab") as journal:
        fcntl.flock(journal, fcntl.LOCK_EX)  # nor died
        with open(played.path / "run.toml", "rb") as another:
            fcntl.flock(another, fcntl.LOCK_EX)
            with Watched(played.path) as watched, watched.log.listening():
                until(lambda: len(watched.log) == len(played.lines) - 1)
                assert watched.values == [], "it is another one's turn"
                fcntl.flock(another, fcntl.LOCK_UN)
                until(lambda: len(watched.values) == 2)


def test_a_watcher_does_not_wait_for_ever_for_another(played: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gonio.live.watching.TURN_S", 0.1)
    played.go_on(8)
    with open(played.path / "journal.jsonl", "ab") as journal, open(played.path / "run.toml", "rb") as another:
        fcntl.flock(journal, fcntl.LOCK_EX)
        fcntl.flock(another, fcntl.LOCK_EX)
        with Watched(played.path) as watched, watched.log.listening():
            until(lambda: len(watched.values) == 2)


def test_a_run_that_died_disturbs_nobody_and_is_worked_out_at_once(
    played: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gonio.live.watching.SHARE", 1e-9)
    monkeypatch.setattr("gonio.live.watching.LONGEST_S", 1e6)
    played.go_on(len(played.lines) - 1)
    with Watched(played.path) as watched:
        watched.look()
        watched.tell()
        assert watched.status()["state"] == "died"
        with watched.log.listening():
            until(lambda: watched.behind == 0 and len(watched.values) == 2)


def test_the_outline_is_that_of_the_frame_and_not_of_a_later_step(
    played: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    def png(description: RigDescription, frame: Frame, step: StepRecord) -> bytes:
        drawn.append(step.step)
        return b"PNG"

    monkeypatch.setattr("gonio.live.picture.png", png)
    played.go_on(5)
    dark = decode(played.lines[1])
    assert dark is not None
    with Watched(played.path) as watched:
        watched.look()
        played.append(encode(dark | {"n": 5, "step": 99, "frames": []}))  # shows nothing
        watched.look()
        assert watched.picture(Request({}, "")) is not None
    assert watched.story.latest_frame is not None
    assert drawn == [watched.story.latest_frame[1]]
