"""The journal: cut anywhere it loses at most its last line; damaged anywhere it says so."""

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gonio.errors import ConfigError, DataError
from gonio.lab.acquisition.journal import Journal, decode, encode, read_events

EVENTS = [{"event": "step", "step": k, "pose": {"light": 0.1 * k}, "text": 'crc":"\n'} for k in range(4)]


def written(path: Path, events: list[dict[str, object]] = EVENTS) -> bytes:
    with Journal(path) as journal:
        for event in events:
            journal.append(event)
    return path.read_bytes()


def steps(events: Iterable[dict[str, Any]]) -> list[object]:
    return [event["step"] for event in events]


def test_lines_are_json_with_number_time_and_checksum(tmp_path: Path) -> None:
    lines = written(tmp_path / "j").decode().splitlines()
    assert [json.loads(line)["n"] for line in lines] == [0, 1, 2, 3]
    assert all({"wall", "crc", "event"} <= set(json.loads(line)) for line in lines)


@settings(max_examples=50, deadline=None)
@given(st.dictionaries(st.text(), st.floats(allow_nan=False, allow_infinity=False) | st.text() | st.none()))
def test_numbers_and_text_come_back_exactly(values: dict[str, object]) -> None:
    event = {"n": 7, "values": values}
    assert decode(encode(event), 7) == event
    assert decode(encode(event), 6) is None


def test_cut_at_every_byte_it_keeps_the_whole_lines_and_goes_on(tmp_path: Path) -> None:
    whole = written(tmp_path / "whole")
    ends = [at + 1 for at, byte in enumerate(whole) if byte == ord("\n")]
    path = tmp_path / "cut"
    for length in range(len(whole) + 1):
        path.write_bytes(whole[:length])
        kept = sum(end <= length for end in ends)
        assert steps(read_events(path)) == list(range(kept))
        assert path.read_bytes() == whole[:length]  # reading changes nothing
        with Journal(path) as journal:
            assert journal.append({"event": "step", "step": 99})["n"] == kept
        assert steps(read_events(path)) == [*range(kept), 99]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_damage_before_the_last_line_is_an_error_that_names_the_line(tmp_path: Path, data: st.DataObject) -> None:
    path = tmp_path / "j"
    path.unlink(missing_ok=True)
    whole = bytearray(written(path))
    intact = bytes(whole)
    last = whole.rindex(b"\n", 0, len(whole) - 1) + 1
    at = data.draw(st.integers(0, last - 2))
    whole[at] ^= data.draw(st.integers(1, 255))
    path.write_bytes(whole)
    number = intact.count(b"\n", 0, at) + 1
    with pytest.raises(DataError, match=rf"line {number} is damaged"):
        read_events(path)
    with pytest.raises(DataError, match="damaged"):
        Journal(path)
    assert path.read_bytes() == whole


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300))
def test_a_torn_tail_of_any_bytes_is_cut(tmp_path: Path, tail: bytes) -> None:
    path = tmp_path / "j"
    path.unlink(missing_ok=True)
    whole = written(path)
    torn = whole + tail.replace(b"\n", b" ")
    path.write_bytes(torn)
    with Journal(path) as journal:
        assert steps(journal.events) == [0, 1, 2, 3]
        assert path.read_bytes() == torn  # whoever is refused now has changed nothing
        journal.append(EVENTS[0])
    assert path.read_bytes().startswith(whole + b'{"n":4,')
    assert steps(read_events(path)) == [0, 1, 2, 3, 0]


def test_a_lost_or_repeated_line_is_damage(tmp_path: Path) -> None:
    lines = written(tmp_path / "j").splitlines(keepends=True)
    for wrong in ([lines[0], *lines[2:]], [lines[0], *lines]):
        (tmp_path / "j").write_bytes(b"".join(wrong))
        with pytest.raises(DataError, match="line 2"):
            read_events(tmp_path / "j")


def test_one_writer_at_a_time_across_processes(tmp_path: Path) -> None:
    script = (
        "import sys, pathlib; from gonio.lab.acquisition.journal import Journal; from gonio.errors import ConfigError\n"
        "try: Journal(pathlib.Path(sys.argv[1]))\n"
        "except ConfigError as error: print(error)\n"
    )

    def other() -> str:
        return subprocess.run(
            [sys.executable, "-c", script, str(tmp_path / "j")], capture_output=True, text=True, check=True, timeout=600
        ).stdout

    with Journal(tmp_path / "j"):
        assert "another process" in other()
    assert other() == ""


def test_an_absent_journal_has_no_events(tmp_path: Path) -> None:
    assert read_events(tmp_path / "none") == []
    with pytest.raises(ConfigError, match="cannot be written"):
        Journal(tmp_path / "no" / "folder")


def test_events_that_are_written_together_are_lines_like_any_other(tmp_path: Path) -> None:
    texts = [json.dumps({"event": "step", "step": k, "text": "\u00e4" * k}, separators=(",", ":")) for k in range(5)]
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.append({"event": "session"})
        journal.append_all(texts)
        journal.append({"event": "end"})
        told = list(journal.events)
    again = list(read_events(tmp_path / "journal.jsonl"))
    assert again == told
    assert [event["n"] for event in again] == list(range(7))
    for line, text in zip(
        (tmp_path / "journal.jsonl").read_bytes().splitlines(keepends=True)[1:-1], texts, strict=True
    ):
        event = decode(line)
        assert event is not None
        assert encode({key: event[key] for key in ("n", "event", "step", "text", "wall")}) == line
        assert json.loads(text).items() <= event.items()


@pytest.mark.parametrize("together", [False, True])
def test_a_full_disk_takes_no_line_and_no_half_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, together: bool
) -> None:
    path = tmp_path / "j"
    before = written(path)

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    def append(journal: Journal) -> None:
        if together:
            journal.append_all(['{"event":"step","step":4}'] * 3)
        else:
            journal.append({"event": "step", "step": 4})

    with Journal(path) as journal:
        with monkeypatch.context() as patch:
            patch.setattr("os.fsync", full)
            with pytest.raises(DataError, match="No space left"):
                append(journal)
        assert path.read_bytes() == before
        assert len(journal.events) == 4
        append(journal)
    assert [event["n"] for event in read_events(path)] == list(range(7 if together else 5))


@pytest.mark.parametrize("when", ["fsync", "after it"])
def test_a_signal_while_a_line_is_written_leaves_file_and_events_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    sync = os.fsync

    def interrupted(handle: int) -> None:
        if when == "after it":
            sync(handle)
        raise KeyboardInterrupt

    path = tmp_path / "j"
    with Journal(path) as journal:
        journal.append({"event": "step", "step": 0})
        monkeypatch.setattr("os.fsync", interrupted)
        with pytest.raises(KeyboardInterrupt):
            journal.append({"event": "step", "step": 1})
        monkeypatch.undo()
        journal.append({"event": "interrupted", "step": -1})
    assert steps(read_events(path)) == [0, -1]
