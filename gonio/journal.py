"""The append-only record of a run: one checksummed line of JSON an event, synced to the disk before the run goes on.

A line is an object with the event, a sequence number `n`, the wall-clock time `wall` (UTC), and at its end `crc`, the
CRC-32 of all that stands before it. A process that dies while it writes leaves a torn last line: it counts as never
written, and the next writer cuts it off. Damage anywhere else is an error, because the file was changed.
"""

from __future__ import annotations

import contextlib
import datetime
import fcntl
import json
import os
import zlib
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gonio.errors import ConfigError, DataError

Event = dict[str, Any]

MARK = b',"crc":"'


def encode(event: Event) -> bytes:
    """One line of a journal, with its checksum and its end."""
    body = json.dumps(event, separators=(",", ":"), allow_nan=False).encode()[:-1]
    return body + MARK + b'%08x"}\n' % zlib.crc32(body)


def decode(line: bytes, number: int) -> Event | None:
    """The event of one whole line (with its end), or None where it is damaged or out of sequence."""
    body, mark, tail = line.rpartition(MARK)
    if not mark or tail != b'%08x"}\n' % zlib.crc32(body):
        return None
    event: Event = json.loads(body + b"}")
    return event if event.get("n") == number else None


def scan(data: bytes, path: Path) -> tuple[list[Event], int]:
    """The events of a journal's bytes, and the length of the part that they fill; the rest is a torn last line.

    Raises
    ------
    DataError
        A line before the last is damaged; the message names it.
    """
    events: list[Event] = []
    good = 0
    *lines, _ = data.split(b"\n")
    for number, body in enumerate(lines):
        line = body + b"\n"
        event = decode(line, number)
        if event is None:
            if good + len(line) < len(data):
                raise DataError(
                    f"{path}: line {number + 1} is damaged (its checksum or its number is wrong): the file was changed "
                    "after it was written; restore it from a copy, or measure into a new folder"
                )
            break
        events.append(event)
        good += len(line)
    return events, good


def read_events(path: Path) -> list[Event]:
    """The events of a journal, without a torn last line; none where there is no file.

    Raises
    ------
    DataError
        The file cannot be read, or a line before the last is damaged.
    """
    try:
        return scan(path.read_bytes(), path)[0]
    except FileNotFoundError:
        return []
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None


class Journal:
    """The one writer of a journal, held by a lock on the file that ends with the process.

    Opening cuts a torn last line. Nothing is written until the first `append`.

    Raises
    ------
    ConfigError
        The file cannot be opened for writing, or another process holds it.
    DataError
        A line before the last is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = path.open("a+b", buffering=0)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._file.seek(0)
            self.events, good = scan(self._file.read(), path)
            self._file.truncate(good)
        except BlockingIOError:
            self._file.close()
            raise ConfigError(f"{path.parent}: another process is measuring into this folder") from None
        except BaseException:
            self._file.close()
            raise

    def append(self, event: Event) -> Event:
        """Write one event and wait until it is on the disk; the event with its number and time.

        Raises
        ------
        DataError
            The disk is full or fails; a part of a line that was written is cut off.
        """
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        event = {"n": len(self.events), **event, "wall": now}
        line, before = encode(event), os.fstat(self._file.fileno()).st_size
        try:
            if self._file.write(line) != len(line):
                raise OSError(28, "no space left on the device")
            os.fsync(self._file.fileno())
            self.events.append(event)
        except BaseException as error:  # a signal too: file and events must not tell different stories
            del self.events[event["n"] :]
            with contextlib.suppress(OSError):  # the next writer cuts what cannot be cut now
                self._file.truncate(before)
            if isinstance(error, OSError):
                raise DataError(f"{self.path}: cannot be written: {error.strerror}") from None
            raise
        return event

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
