"""A journal is followed while somebody else writes it, without a lock and without a word lost or doubled."""

from pathlib import Path

import pytest
from gonio_watch.follow import Follower

from gonio import platform
from gonio.lab.acquisition import repair
from gonio.lab.acquisition.journal import Event, Journal, encode, read_events
from tests.gonio.lab.live.runs import Played


def events_of(journal: Path) -> list[Event]:
    """As they were appended, without their checksums."""
    return [{key: value for key, value in event.items() if key != "crc"} for event in read_events(journal)]


def new(follower: Follower) -> list[Event]:
    return [event for events in follower.poll() for event in events]


def test_a_run_that_does_not_exist_yet_is_waited_for(tmp_path: Path) -> None:
    follower = Follower(tmp_path / "later")
    assert new(follower) == []
    (tmp_path / "later").mkdir()
    assert new(follower) == []
    with Journal(tmp_path / "later" / "journal.jsonl") as journal:
        assert new(follower) == []
        journal.append({"event": "session"})
        assert [event["event"] for event in new(follower)] == ["session"]
        assert new(follower) == []


def test_each_line_is_read_once_however_it_comes(played: Played) -> None:
    follower, seen = Follower(played.path), list[Event]()
    played.append(b"")
    text = b"".join(played.lines)
    for at in range(0, len(text), 777):  # lines are torn at any place
        played.append(text[at : at + 777])
        seen += new(follower)
    assert seen == events_of(played.path / "journal.jsonl")
    assert not follower.damaged


def test_only_what_is_new_is_read(played: Played, monkeypatch: pytest.MonkeyPatch) -> None:
    played.go_on(10)
    follower = Follower(played.path)
    assert len(new(follower)) == 10
    opened: list[object] = []
    monkeypatch.setattr("builtins.open", lambda *args, **kwargs: opened.append(args))
    for _ in range(5):
        assert new(follower) == []
    assert not opened, "a journal that did not change is not opened"
    monkeypatch.undo()
    played.go_on()
    assert [event["n"] for event in new(follower)] == [10]


def test_a_torn_tail_that_is_cut_off_was_never_there(played: Played) -> None:
    played.go_on(4)
    follower = Follower(played.path)
    assert len(new(follower)) == 4
    played.append(played.lines[4][:50])
    assert new(follower) == []
    with Journal(played.path / "journal.jsonl") as journal:  # as --resume does
        journal.append({"event": "session", "left": 3})
        assert [(event["n"], event["event"]) for event in new(follower)] == [(4, "session")]
    assert follower.lives == 1


def test_a_last_line_with_an_end_and_a_wrong_checksum_is_torn_too(played: Played) -> None:
    played.go_on(2)
    played.append(played.lines[2][:-5] + b"0000\n")
    follower = Follower(played.path)
    assert len(new(follower)) == 2
    assert not follower.damaged


def test_a_damaged_line_ends_the_story_until_it_is_repaired(played: Played) -> None:
    played.go_on(len(played.lines))
    journal = played.path / "journal.jsonl"
    lines = list(played.lines)
    lines[5] = lines[5].replace(b'"step"', b'"stop"', 1)
    journal.write_bytes(b"".join(lines))
    follower = Follower(played.path)
    assert len(new(follower)) == 5
    assert "line 6 of the journal is damaged" in follower.damaged
    repair.repair(played.path)
    again = new(follower)
    assert follower.lives == 2, "another file is in its place"
    assert again == events_of(journal)
    assert not follower.damaged


def test_another_run_in_the_same_folder_is_told_from_the_first(played: Played) -> None:
    played.go_on(3)
    follower = Follower(played.path)
    assert len(new(follower)) == 3
    before = follower.identity
    journal = played.path / "journal.jsonl"
    (played.path / "other").write_bytes(encode({"n": 0, "event": "session"}))
    (played.path / "other").rename(journal)
    assert [event["event"] for event in new(follower)] == ["session"]
    assert (follower.lives, follower.identity != before) == (2, True)


def test_who_measures_is_seen_without_touching_the_lock(tmp_path: Path) -> None:
    follower = Follower(tmp_path)
    assert follower.writer_lives() is None
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.append({"event": "session"})
        new(follower)
        if follower.writer_lives() is None:
            pytest.skip("this machine has no list of locks")
        assert follower.writer_lives()
    assert follower.writer_lives() is False
    with Journal(tmp_path / "journal.jsonl"):  # nobody else holds it
        assert follower.writer_lives()


def test_a_machine_without_a_list_of_locks_tells_by_trying(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "LOCKS", tmp_path / "none")
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.append({"event": "session"})
        follower = Follower(tmp_path)
        new(follower)
        assert follower.writer_lives() is True
    assert follower.writer_lives() is False
