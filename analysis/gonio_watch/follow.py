"""A journal that another process writes, read as it grows.

Only what is new is read, and nothing is locked: who measures does not notice. A torn last line is waited for. `gonio
run repair` puts another file in the place of a damaged journal; then all is read anew.
"""

import os
from collections.abc import Iterator
from pathlib import Path

from gonio import platform
from gonio.disk import only_file
from gonio.errors import DataError
from gonio.lab.acquisition.journal import Event, decode, is_whole
from gonio.lab.acquisition.records import event_of

PIECE = 1 << 20
"""Bytes that are read at once."""


class Follower:
    """The events of a run's journal.

    Parameters
    ----------
    run
        The folder; it need not exist yet.
    """

    def __init__(self, run: Path) -> None:
        self.path = run / "journal.jsonl"
        self.damaged = ""
        """What is wrong with a line that others follow; nothing is read beyond it."""
        self.lives = 0
        """How many files were read here: another one tells another run_status."""
        self.places: list[int] = []
        """Where the events that were handed out last begin in the file."""
        self.unread = 0
        """Bytes that followed what was handed out last, when it was looked at."""
        self._file: tuple[int, int] | None = None
        self._seen: tuple[int, int] | None = None
        self._at = self._number = 0

    @property
    def identity(self) -> str:
        """What tells this journal from one that is put in its place; "" where there is none."""
        return "" if self._file is None else f"{self._file[0]:x}-{self._file[1]:x}"

    def poll(self) -> Iterator[list[Event]]:
        """Events that were not there before, in pieces; after a change of `lives` they are all of another journal.

        Whoever takes some of the pieces gets those that follow next time.
        """
        try:
            there = os.stat(self.path)
        except OSError:
            return
        file = there.st_dev, there.st_ino
        if file != self._file or there.st_size < self._at:
            self._file, self._seen, self._at, self._number, self.damaged = file, None, 0, 0, ""
            self.lives += 1
        looks = there.st_size, there.st_mtime_ns
        if looks == self._seen:
            return
        self._seen = None
        try:
            with open(self.path, "rb", opener=only_file) as journal:
                if os.fstat(journal.fileno()).st_ino != file[1]:
                    return  # replaced meanwhile: next time
                journal.seek(self._at)
                rest = b""
                while some := journal.read(PIECE):
                    *lines, rest = (rest + some).split(b"\n")
                    self.unread = there.st_size - journal.tell()
                    yield self._events(lines, more=bool(rest))
                    if self.damaged:
                        break
            self._seen = looks
        except OSError as error:
            self.damaged = f"{self.path}: cannot be read: {error.strerror}"

    def _events(self, lines: list[bytes], *, more: bool) -> list[Event]:
        """The events of whole lines. A bad last line is being written still, or will be cut off."""
        out = []
        self.places = []
        for k, line in enumerate(lines):
            event = decode(line + b"\n", self._number)
            if event is None:
                if more or k + 1 < len(lines) or is_whole(line + b"\n"):
                    self.damaged = f"line {self._number + 1} of the journal is damaged: gonio run repair"
                break
            try:
                event_of(line)
            except DataError as error:
                self.damaged = f"line {self._number + 1} of the journal is whole, and cannot be used: {error}"
                break
            out.append(event)
            self.places.append(self._at)
            self._at += len(line) + 1
            self._number += 1
        return out

    def event_at(self, place: int) -> Event | None:
        """An event that was handed out before, by where it begins; None where that is not so any more."""
        try:
            with open(self.path, "rb", opener=only_file) as journal:
                if os.fstat(journal.fileno()).st_ino != (self._file or (0, 0))[1]:
                    return None
                journal.seek(place)
                return decode(journal.readline())
        except OSError:
            return None

    def writer_lives(self) -> bool | None:
        """Whether a process holds the journal for writing; None where this machine does not tell.

        The lock is only looked for in the kernel's list: to try it would keep a `--resume` from taking it.
        """
        return None if self._file is None else platform.is_locked(self.path)
