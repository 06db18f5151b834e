"""The append-only record of a run: one checksummed line of JSON an event, synced to the disk before the run goes on.

A line is an object with the event, a sequence number `n`, the wall-clock time `wall` (UTC), and at its end `crc`, the
CRC-32 of all that stands before it. A process that dies while it writes leaves a torn last line: it counts as never
written, and the next writer cuts it off. Damage anywhere else, or a line that is gone, is an error, because the file
was changed.

The order of events is that of their lines. `wall` is for people: a computer's clock may be set while a run is measured.
"""

import contextlib
import datetime
import errno
import json
import os
import threading
import zlib
from array import array
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, BinaryIO, Self, overload

from gonio import platform
from gonio.disk import only_file
from gonio.errors import ConfigError, DataError, os_error_as
from gonio.lab.acquisition.records import StepRecord, compact, event_of
from gonio.typing import JsonObject

Event = JsonObject
"""A line: its `event` says what kind it is. Those of steps are `gonio.lab.acquisition.records.StepRecord`."""

MARK = b',"crc":"'


def encode(event: Event) -> bytes:
    """One line of a journal, with its checksum and its end."""
    return sealed(compact(event).encode()[:-1])


def sealed(body: bytes) -> bytes:
    """The text of an object of JSON, without its brace at the end, as a line with its checksum."""
    return body + MARK + b'%08x"}\n' % zlib.crc32(body)


def decode(line: bytes, number: int | None = None) -> Event | None:
    """The event of one whole line (with its end), or None where it is damaged, or has not the number that is wanted."""
    if not is_whole(line):
        return None
    try:
        event = json.loads(line.rpartition(MARK)[0] + b"}")
    except (ValueError, RecursionError):
        return None
    return event if isinstance(event, dict) and (number is None or event.get("n") == number) else None


def is_whole(line: bytes) -> bool:
    """Whether a line (with its end) has the checksum of what stands in it."""
    body, mark, tail = line.rpartition(MARK)
    return bool(mark) and tail == b'%08x"}\n' % zlib.crc32(body)


def now() -> str:
    """The time of day (UTC), as events hold it."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class Events(Sequence[Event]):
    """The events of a journal, in order. They are read from the file when they are asked for: a long run's are many."""

    def __init__(self, path: Path, starts: "array[int]") -> None:
        self.path, self._starts = path, starts

    def __len__(self) -> int:
        return len(self._starts)

    @overload
    def __getitem__(self, at: int) -> Event: ...
    @overload
    def __getitem__(self, at: slice) -> list[Event]: ...
    def __getitem__(self, at: int | slice) -> Event | list[Event]:
        if isinstance(at, slice):
            return list(map(json.loads, self.lines(range(len(self))[at])))
        event: Event = json.loads(next(self.lines([range(len(self))[at]])))
        return event

    def __iter__(self) -> Iterator[Event]:
        return map(json.loads, self.lines(range(len(self))))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and all(a == b for a, b in zip(self, other))  # noqa: B905

    __hash__ = None  # type: ignore[assignment]

    def lines(self, wanted: Sequence[int]) -> Iterator[bytes]:
        """The lines of some events, as they lie in the file."""
        if not len(wanted):
            return
        with self._open() as file:
            at = -1
            for number in wanted:
                if self._starts[number] != at:
                    file.seek(self._starts[number])
                line = file.readline()
                at = self._starts[number] + len(line)
                yield line

    def _open(self) -> BinaryIO:
        with os_error_as(DataError, f"{self.path}: cannot be read"):
            return open(self.path, "rb", opener=only_file)


def _scan(path: Path) -> "tuple[array[int], int]":
    """Where the lines of a journal start, and the length of the part that they fill; the rest is a torn last line.

    Raises
    ------
    DataError
        A line before the last is damaged (the message names it), or the file is no journal.
    """
    starts, good, number = array("q"), 0, 0
    with open(path, "rb", opener=only_file) as file:
        for line in file:
            whole = is_whole(line)
            if not whole or not (line.startswith(b'{"n":%d,' % number) or decode(line, number)):
                if whole or (line.endswith(b"\n") and file.read(1)):
                    raise DataError(
                        f"{path}: line {number + 1} is {_wrong(line, number)}: the file was changed after it was "
                        f"written; `gonio run repair {path.parent}` keeps what can be read, or restore the file from a "
                        "copy"
                    )
                # what a power cut leaves may be zeros
                if not (good or line.startswith((b'{"', b"{\n")) or line.strip(b"\0") in (b"", b"{")):
                    raise DataError(f"{path}: is not the journal of a run; choose another folder, or move the file")
                break
            starts.append(good)
            good += len(line)
            number += 1
    return starts, good


def _wrong(line: bytes, number: int) -> str:
    """What is wrong with a line that is not the one with this number."""
    found = decode(line)
    there = found.get("n") if found is not None else None
    if isinstance(there, int) and there > number:
        return f"missing ({there - number} of them: line {there + 1} as it was written follows)"
    return "damaged (its checksum or its number is wrong)"


def files_named(path: Path) -> Iterator[dict[str, str]]:
    """What whole lines of a journal say of the files beside the frames, in order: SHA-256 by name.

    Where the first line says nothing of them, none does: an earlier version has begun the run.
    """
    with contextlib.suppress(OSError), open(path, "rb", opener=only_file) as file:
        for number, line in enumerate(file):
            event = decode(line) if number == 0 or b'"files":{' in line else None
            if event is not None and isinstance(event.get("files"), dict):
                yield event["files"]
            elif event is not None and number == 0:
                return


def first_event(path: Path) -> Event:
    """The event of a journal's first line; nothing where that is damaged, or cannot be read."""
    with contextlib.suppress(OSError), open(path, "rb", opener=only_file) as file:
        return decode(file.readline(), 0) or {}
    return {}


def read_events(path: Path) -> Events:
    """The events of a journal, without a torn last line; none where there is no file.

    Raises
    ------
    DataError
        The file cannot be read, or a line before the last is damaged.
    """
    try:
        return Events(path, _scan(path)[0])
    except FileNotFoundError:
        return Events(path, array("q"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


def has_lines(path: Path) -> bool:
    """Whether a journal begins with a whole line, however it goes on; `DataError` where it cannot be read."""
    try:
        with open(path, "rb", opener=only_file) as file:
            return decode(file.readline(), 0) is not None
    except FileNotFoundError:
        return False
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


@contextlib.contextmanager
def locked(path: Path) -> Iterator[BinaryIO]:
    """A journal, made where it is absent, open for appending by nobody else.

    Raises
    ------
    ConfigError
        The file cannot be opened for writing, or another process holds it.
    """
    file = _lock(path)
    try:
        yield file
    finally:
        file.close()


def _lock(path: Path) -> Any:
    with os_error_as(ConfigError, f"{path}: cannot be written"):
        file = open(path, "a+b", buffering=0, opener=only_file)  # noqa: SIM115
    if not platform.lock(file):
        file.close()
        raise ConfigError(f"{path.parent}: another process is measuring into this folder") from None
    return file


class Journal:
    """The one writer of a journal, held by a lock on the file that ends with the process.

    Opening changes nothing; the first `append` cuts a torn last line.

    Raises
    ------
    ConfigError
        The file cannot be opened for writing, or another process holds it.
    DataError
        A line before the last is damaged, or the file is no journal.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = _lock(path)
        self._one_at_a_time = threading.Lock()
        """A driver's thread may have something to remark while a step is written."""
        try:
            self._starts, self._good = _scan(path)
        except BaseException:
            self._file.close()
            raise
        self.events = Events(path, self._starts)

    def append(self, event: Event) -> Event:
        """Write one event and wait until it is on the disk; the event with its number and time.

        Raises
        ------
        DataError
            The disk is full or fails; a part of a line that was written is cut off.
        """
        with self._one_at_a_time:
            event = {"n": len(self._starts), **event, "wall": now()}
            self._write([encode(event)])
        return event

    def append_all(self, events: Sequence[str]) -> None:
        """Write events, each the text of an object of JSON, and wait once until they are on the disk.

        Raises
        ------
        DataError
            The disk is full or fails; none of them is in the journal then.
        """
        with self._one_at_a_time:
            end, first = f',"wall":"{now()}"', len(self._starts)
            self._write([sealed(f'{{"n":{n},{text[1:-1]}{end}'.encode()) for n, text in enumerate(events, first)])

    def _write(self, lines: Sequence[bytes]) -> None:
        number, before = len(self._starts), self._good
        try:
            if os.fstat(self._file.fileno()).st_size > before:
                self._file.truncate(before)
            data = b"".join(lines)
            if self._file.write(data) != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            platform.sync(self._file.fileno())
            self._starts.extend(accumulate(map(len, lines[:-1]), initial=before))
            self._good += len(data)
        except BaseException as error:  # a signal too: file and events must not tell different stories
            del self._starts[number:]
            self._good = before
            with contextlib.suppress(OSError):  # the next writer cuts what cannot be cut now
                self._file.truncate(before)
            if isinstance(error, OSError):
                raise DataError(f"{self.path}: cannot be written: {error.strerror}") from None
            raise

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Index:
    """Which line of a journal holds which step, in a few bytes a step."""

    def __init__(self) -> None:
        self.lines: dict[int, int] = {}
        """Number of a step: number of its line."""
        self.chosen: list[Event] = []
        """The batches that were chosen, in order."""
        self.enough = False
        """Whether the sampler of an adaptive run has said that no more points are needed."""
        self.last_point = -1
        """The largest number of a point that a line of a step names."""
        self._seen = 0

    def go_on(self, events: Events) -> None:
        """Read the events that were not there before; raises `DataError` where one holds what nobody can use."""
        lines = events.lines(range(self._seen, len(events)))
        for at, line in enumerate(lines, self._seen):
            try:
                event = event_of(line)
            except DataError as error:
                raise DataError(
                    f"{events.path}: line {at + 1} is whole, and not what this version writes: {error}; `gonio run "
                    f"repair {events.path.parent}` keeps the other lines, and asks the frames what this one said"
                ) from None
            self._note(at, event)
            self._seen = at + 1

    def _note(self, at: int, event: Event) -> None:
        if event["event"] == "step":
            self.lines[event["step"]] = at
            self.last_point = max(self.last_point, -1 if event["point"] is None else event["point"])
        elif event["event"] == "lost":
            for number in event["steps"]:
                self.lines.pop(number, None)
        elif event["event"] == "chosen":
            self.chosen = sorted([*self.chosen, event], key=lambda batch: int(batch["first_step"]))
        elif event["event"] == "enough":
            self.enough = True


class Steps(Sequence[StepRecord]):
    """The steps that are done, in the order of their numbers; read when they are asked for, as `Events` are."""

    def __init__(self, events: Events, index: Index) -> None:
        self._events = events
        self.numbers = sorted(index.lines)
        self._lines = [index.lines[number] for number in self.numbers]

    def __len__(self) -> int:
        return len(self.numbers)

    @overload
    def __getitem__(self, at: int) -> StepRecord: ...
    @overload
    def __getitem__(self, at: slice) -> list[StepRecord]: ...
    def __getitem__(self, at: int | slice) -> StepRecord | list[StepRecord]:
        if isinstance(at, slice):
            return [self._record(self._events[line]) for line in self._lines[at]]
        return self._record(self._events[self._lines[at]])

    def __iter__(self) -> Iterator[StepRecord]:
        return (self._record(json.loads(line)) for line in self.raw())

    def latest(self) -> StepRecord:
        """The one that was written last."""
        return self._record(self._events[max(self._lines)])

    def _record(self, event: Event) -> StepRecord:
        try:
            return StepRecord.from_json(event)
        except DataError as error:
            raise DataError(f"{self._events.path}: line {event['n'] + 1}: {error}") from None

    def raw(self) -> Iterator[bytes]:
        """Their lines, as they lie in the journal."""
        return self._events.lines(self._lines)
