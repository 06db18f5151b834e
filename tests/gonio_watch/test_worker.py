"""Values and pictures are worked out once for all watchers of a run, and disturb nobody."""

import fcntl
import json
import os
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from gonio_watch import worker
from gonio_watch.provisional import ProvisionalValues
from gonio_watch.run_status import RunStatus
from gonio_watch.shared import CURVES, FRAME, LOOKED, NOW, Now, Shared
from gonio_watch.worker import Worker

from gonio.lab.acquisition.journal import encode
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from tests.gonio.lab.live.runs import Played
from tests.gonio_watch.test_watching import until


def draw(run_status: RunStatus, values: Sequence[ProvisionalValues], behind: int) -> bytes:
    return json.dumps([len(v.points) for v in values]).encode()


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """Where it is worked out; somebody looks, for an hour."""
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / LOOKED).touch()
    os.utime(folder / LOOKED, (time.time() + 3600.0,) * 2)
    return folder


@contextmanager
def worked(run: Path, out: Path) -> Iterator[Worker]:
    """A run that is being worked out, in a thread of its own."""
    worker, end = Worker(run, out, draw), threading.Event()
    thread = threading.Thread(target=worker.work, args=[lambda seconds: end.wait(min(seconds, 0.2))])
    thread.start()
    try:
        yield worker
    finally:
        end.set()
        thread.join()


def now(out: Path) -> Now:
    try:
        return Now(**json.loads((out / NOW).read_bytes()))
    except FileNotFoundError:
        return Now()


@contextmanager
def measuring(run: Path) -> Iterator[None]:
    """The journal is held, as by a process that measures."""
    with open(run / "journal.jsonl", "ab") as journal:
        fcntl.flock(journal, fcntl.LOCK_EX)
        yield


def counts(found: Now) -> list[int]:
    return [band["count"] for band in found.bands]


def test_values_come_as_the_run_is_measured_and_all_at_its_end(played: Played, out: Path) -> None:
    played.go_on(8)
    with worked(played.path, out):
        until(lambda: counts(now(out)) == [4, 4])
        played.go_on(100)
        until(lambda: counts(now(out)) == [16, 16] and now(out).behind == 0)
        found = now(out)
        assert json.loads((out / CURVES).read_bytes()) == [16, 16]
        until(lambda: now(out).frame is not None)
        assert (out / FRAME).read_bytes().startswith(b"\x89PNG")
        theta_i, _, theta_r, _, brdf, u = found.bands[0]["values"][-1]
        assert 30 <= theta_i <= 45
        assert -60 <= theta_r <= 60
        assert 0 < u < 0.1 * brdf
    assert not (out / NOW).exists(), "it would be of another time"


def test_nothing_is_worked_out_while_nobody_looks(played: Played, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    played.go_on(100)
    os.utime(out / LOOKED, (0.0, 0.0))
    worker, asked = Worker(played.path, out, draw), 0

    def wait(seconds: float) -> bool:
        nonlocal asked
        asked += 1
        return asked == 5

    monkeypatch.setattr(worker, "_look", lambda: pytest.fail("nobody looks"))
    worker.work(wait)


def test_steps_that_are_taken_back_count_no_more(played: Played, out: Path) -> None:
    played.go_on(8)
    with worked(played.path, out):
        until(lambda: counts(now(out)) == [4, 4])
        lost = [event["step"] for event in map(played.event, (6, 7)) if event["kind"] == "point"]
        played.append(encode({"n": 8, "event": "lost", "steps": lost, "wall": "2026-01-01T00:00:00Z"}))
        played.append(encode({k: v for k, v in played.event(7).items() if k != "crc"} | {"n": 9}))
        until(lambda: counts(now(out)) == [5 - len(lost)] * 2)


def test_another_journal_is_worked_out_anew(played: Played, out: Path) -> None:
    played.go_on(8)
    with worked(played.path, out):
        until(lambda: counts(now(out)) == [4, 4])
        before = now(out).journal
        (played.path / "journal.new").write_bytes(b"".join(played.lines[:6]))
        (played.path / "journal.new").rename(played.path / "journal.jsonl")
        until(lambda: counts(now(out)) == [3, 3] and now(out).journal != before)


def test_users_work_out_a_run_in_turns(played: Played, out: Path) -> None:
    played.go_on(len(played.lines) - 1)  # it has not ended
    with measuring(played.path), open(played.path / "run.toml", "rb") as another:
        fcntl.flock(another, fcntl.LOCK_EX)
        with worked(played.path, out) as worker:
            until(lambda: worker.behind == len(played.lines) - 2)
            assert now(out) == Now(), "it is another one's turn"
            fcntl.flock(another, fcntl.LOCK_UN)
            until(lambda: len(now(out).bands) == 2)


def test_nobody_waits_for_ever_for_another(played: Played, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(worker, "TURN_S", 0.1)
    played.go_on(8)
    with measuring(played.path), open(played.path / "run.toml", "rb") as another:
        fcntl.flock(another, fcntl.LOCK_EX)
        with worked(played.path, out):
            until(lambda: len(now(out).bands) == 2)


def rests(run: Path, out: Path, turns: int) -> list[float]:
    """How long it rests after each of some turns."""
    rested: list[float] = []

    def wait(seconds: float) -> bool:
        rested.append(seconds)
        return len(rested) == turns

    Worker(run, out, draw).work(wait)
    return rested


def test_while_the_run_goes_on_it_rests_most_of_the_time(
    played: Played, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter(range(10_000))
    monkeypatch.setattr("time.process_time", lambda: 0.01 * next(clock))  # each look at it is 10 ms of work
    monkeypatch.setattr(worker, "LONGEST_S", 1e6)
    played.go_on(8)
    with measuring(played.path):
        rested = rests(played.path, out, 4)
    worked_s = 0.01 * next(clock)
    # this clock goes on when it is looked at: what it tells between two turns is no work
    assert sum(rested) >= 0.8 * worked_s / worker.SHARE


def test_a_run_that_died_is_worked_out_at_once(played: Played, out: Path) -> None:
    played.go_on(len(played.lines) - 1)
    with measuring(played.path):
        pass
    assert max(rests(played.path, out, 3)[:2]) <= worker.POLL_S


def test_the_outline_is_that_of_the_frame_and_not_of_a_later_step(
    played: Played, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    def png(description: RigDescription, frame: Frame, step: StepRecord) -> bytes:
        drawn.append(step.step)
        return b"PNG"

    monkeypatch.setattr(worker, "png", png)
    played.go_on(5)
    played.append(encode(played.event(1) | {"n": 5, "step": 99, "frames": []}))  # shows nothing
    rests(played.path, out, 1)
    assert drawn == [played.event(4)["step"]]


# --- who works it out ------------------------------------------------------------------------------------------------

STAND_IN = """
import pathlib, sys
from gonio import platform
folder = pathlib.Path(sys.argv[2])
held = (folder / "lock").open("ab")
if platform.lock(held):
    (folder / "began").open("a").write("x")
    sys.stdin.read()
"""


def test_one_process_works_for_all_watchers_and_another_one_follows_it(played: Played) -> None:
    command = [sys.executable, "-c", STAND_IN]
    with ExitStack() as open_:
        first, second = (Shared(played.path, command) for _ in range(2))
        open_.callback(first.close)
        open_.callback(second.close)
        began = first.folder / "began"
        first.look()
        until(lambda: began.exists() and began.read_text() == "x")
        second.look()
        assert second._child is None
        first.close()
        second._looked_s = -1e9
        second.look()
        until(lambda: began.read_text() == "xx")


def test_a_process_that_fails_is_told_of_and_begun_again_later(played: Played) -> None:
    shared = Shared(played.path, [sys.executable, "-c", "raise SystemExit(3)"])
    shared.look()
    assert shared._child is not None
    shared._child.wait()
    shared._looked_s = -1e9
    shared.look()
    assert shared.problem == "the values cannot be worked out: their process has ended (3)"
    shared._looked_s = -1e9
    shared.look()
    assert shared._child is None
    shared.close()


def test_a_folder_that_others_could_write_is_not_shared(played: Played) -> None:
    folder = Shared(played.path).folder
    folder.chmod(0o777)
    alone = Shared(played.path)
    assert alone.folder != folder
    assert alone.folder.stat().st_mode & 0o077 == 0
    alone.close()
    assert not alone.folder.exists()


def test_what_another_version_has_written_is_not_taken(played: Played) -> None:
    shared = Shared(played.path)
    (shared.folder / NOW).write_text('{"journal": "x", "of": "another version"}')
    assert shared.look() is None
