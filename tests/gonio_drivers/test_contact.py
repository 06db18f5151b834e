"""The interlock with a contact that a test opens and closes: what stops, what is kept, what a person may forget."""

import stat
import threading
from pathlib import Path
from typing import Self

import pytest
from gonio_drivers import interlock
from gonio_drivers.interlock import Interlock, Latch, Tripped

from gonio.errors import DeviceError

PATIENCE_S = 120.0
"""An event that does not come within it never does."""


class Door(interlock.Contact):
    """A contact in a test's hands."""

    name, period_s = "door", 0.001

    def __init__(self) -> None:
        self.is_closed, self.fails, self.opened = True, False, 0

    def __enter__(self) -> Self:
        self.opened += 1
        return self

    def closed(self) -> bool:
        if self.fails:
            raise DeviceError("no answer")
        return self.is_closed

    def __exit__(self, *_: object) -> None:
        self.opened -= 1


class Stop:
    """An interlock, and how often it darkened the lamp."""

    def __init__(self, folder: Path) -> None:
        self.contact, self.latch, self.dark = Door(), Latch(folder / "state" / "latch.json"), threading.Semaphore(0)
        self.interlock = Interlock(self.contact, self.dark.release, self.latch)


@pytest.fixture
def stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Stop:
    monkeypatch.setattr(interlock, "AGAIN_S", (0.0, 0.001, 0.002))
    return Stop(tmp_path)


@pytest.mark.parametrize(("fails", "why"), [(False, "is open"), (True, "cannot be read, which counts as open")])
def test_a_contact_that_opens_darkens_again_and_again_and_is_kept(stop: Stop, fails: bool, why: str) -> None:
    with stop.interlock as watched:
        watched.require()
        assert (watched.tripped, stop.latch.why(), stop.contact.opened) == (False, "", 1)
        stop.contact.fails, stop.contact.is_closed = fails, fails
        for _ in interlock.AGAIN_S:
            assert stop.dark.acquire(timeout=PATIENCE_S)
        assert watched.tripped
        stop.contact.fails, stop.contact.is_closed = False, True  # closing it again changes nothing
        with pytest.raises(Tripped, match=f"emergency stop.*{why}"):
            watched.require()
    assert stop.contact.opened == 0
    assert why in stop.latch.why()
    # the next program waits for a person too
    with stop.interlock as next_one, pytest.raises(Tripped, match="not acknowledged yet"):
        next_one.require()
    with pytest.raises(Tripped, match="gonio rig acknowledge"):
        stop.latch.require()
    said = {reading.quantity: reading.value for reading in stop.interlock.survey().readings}
    assert said["contact"] == "contact at door closed"
    assert "not acknowledged" in str(said["error"])
    assert why in stop.interlock.acknowledge()
    stop.latch.require()
    with stop.interlock as free:
        free.require()


def test_an_open_contact_is_not_acknowledged(stop: Stop) -> None:
    stop.latch.set("somebody pressed it")
    stop.contact.is_closed = False
    with pytest.raises(Tripped, match="close it first"):
        stop.interlock.acknowledge()
    assert "somebody pressed it, at 2" in stop.latch.why()
    assert stop.contact.opened == 0
    said = {reading.quantity: reading.value for reading in stop.interlock.survey().readings}
    assert said["contact"] == "contact at door open"
    assert str(said["error"]).startswith("emergency stop: the contact is open; not acknowledged")


def test_a_watch_that_dies_counts_as_open(stop: Stop, monkeypatch: pytest.MonkeyPatch) -> None:
    with stop.interlock as watched:
        monkeypatch.setattr(stop.contact, "closed", lambda: 1 / 0)
        assert stop.dark.acquire(timeout=PATIENCE_S)
        with pytest.raises(Tripped, match="cannot be watched: ZeroDivisionError"):
            watched.require()


def test_a_latch_that_cannot_be_read_or_written_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    latch, other = Latch.of("door"), Latch.of("key")
    assert latch.path != other.path
    assert latch.path.parent == tmp_path / "gonio"
    latch.path.parent.mkdir()
    for damaged in ("", "[]", "{}", '{"why": "x"}'):
        latch.path.write_text(damaged)
        assert "is there, and cannot be read" in latch.why()
    latch.clear()
    latch.clear()
    assert latch.why() == ""
    blocked = Latch(tmp_path / "file" / "latch.json")
    (tmp_path / "file").write_text("")
    assert "cannot be written" in blocked.set("x")
    assert latch.set("x") == ""
    assert stat.S_ISREG(latch.path.stat().st_mode)
