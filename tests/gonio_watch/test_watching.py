"""A run that is followed: what a page is told, and that nobody is disturbed."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from gonio_watch.shared import CURVES, FRAME, LOOKED, NOW, Now
from gonio_watch.watching import Watched
from gonio_watch.worker import write

from gonio.lab.acquisition.journal import Journal
from gonio.lab.live.server import Request
from tests.gonio.lab.live.runs import Played


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


@pytest.mark.slow
def test_every_line_is_an_event_with_its_number(played: Played, followed: Watched) -> None:
    for at in range(0, len(played.lines), 5):
        played.go_on(5)
        until(lambda at=at: len(followed.log) == min(at + 5, len(played.lines)))  # type: ignore[misc]
    events = followed.log.events(0)
    assert [event.id for event in events] == list(range(1, len(played.lines) + 1))
    assert [json.loads(event.data)["n"] for event in events] == list(range(len(played.lines)))
    until(lambda: followed.stands["state"] == "ended")


def test_nothing_is_read_while_nobody_looks(played: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    played.go_on(100)
    with Watched(played.path) as watched:
        looked = threading.Event()
        monkeypatch.setattr(watched, "look", looked.set)
        assert not looked.wait(0.5), "two rounds and a half"
        assert not (watched.shared.folder / LOOKED).exists()
        monkeypatch.undo()
        with watched.log.listening():
            until(lambda: len(watched.log) == len(played.lines))
            until((watched.shared.folder / LOOKED).exists)


def test_what_has_been_worked_out_is_told(played: Played, followed: Watched) -> None:
    asked = Request({}, "")
    assert followed.picture(asked) is None
    assert json.loads(followed.curves(asked).body)["view"] is None
    played.go_on(5)
    until(lambda: len(followed.log) == 5)
    journal = f"{os.stat(played.path).st_dev:x}-{os.stat(played.path / 'journal.jsonl').st_ino:x}"
    write(followed.shared.folder / CURVES, b"the values")
    write(followed.shared.folder / FRAME, b"PNG")
    write(followed.shared.folder / NOW, Now("of another journal", 1, frame=["x", 1]).encode())
    until(lambda: followed.shared.look() is None)  # it was seen
    assert followed.picture(asked) is None
    write(followed.shared.folder / NOW, Now(journal, 2, frame=["4.dng", 4]).encode())
    until(lambda: followed.stands["frame"] == "4.dng" and followed.stands["frame_step"] == 4)
    assert followed.picture(asked) == (b"PNG", "image/png")
    assert followed.curves(asked).body == b"the values"


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
    until(lambda: "run.toml: is damaged" in followed.stands["why"])
    assert followed.stands["done"] == 2
