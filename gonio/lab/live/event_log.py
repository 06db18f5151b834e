"""What happened, in order, for any number of clients."""

import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

BATCH = 256
"""Events that a client is sent at once."""
WHOLE = 2000
"""Newest events that are kept whole; older ones are shortened, where their log says how."""


class Event(NamedTuple):
    """One event of a stream."""

    id: int | None
    kind: str
    data: bytes
    """JSON in one line."""

    def encode(self) -> bytes:
        """As it goes over the line."""
        number = b"" if self.id is None else b"id: %d\n" % self.id
        return number + b"event: %s\ndata: %s\n\n" % (self.kind.encode(), self.data)


class EventLog:
    """What happened, in order, for any number of clients.

    Parameters
    ----------
    shorten
        Makes of an event's data what is kept of it once `WHOLE` others have followed; by default all.
    """

    def __init__(self, shorten: Callable[[bytes], bytes] | None = None) -> None:
        self._shorten = shorten
        self._news = threading.Condition()
        self._events: list[tuple[str, bytes]] = []
        self._told: dict[str, tuple[int, bytes]] = {}
        self._versions = 0
        self._closed = False
        self.listeners = 0
        """How many streams are open: what nobody looks at need not be made."""

    def __len__(self) -> int:
        return len(self._events)

    def events(self, number: int, most: int | None = None) -> list[Event]:
        """Events after a number, at most `most` of them."""
        with self._news:
            some = self._events[number:] if most is None else self._events[number : number + most]
            return [Event(k, kind, line) for k, (kind, line) in enumerate(some, number + 1)]

    def append(self, *events: tuple[str, Any]) -> None:
        """Add events (a kind, and what JSON can hold); the first of all has the id 1."""
        lines = [(kind, _json(data)) for kind, data in events]
        with self._news:
            self._events += lines
            if self._shorten is not None:
                old = len(self._events) - WHOLE
                for k in range(max(0, old - len(lines)), max(0, old)):
                    kind, line = self._events[k]
                    self._events[k] = kind, self._shorten(line)
            self._news.notify_all()

    def tell(self, kind: str, data: Any) -> None:
        """Say how something stands now. Of each kind the newest is kept; whoever comes later gets it too."""
        line = _json(data)
        with self._news:
            if kind not in self._told or self._told[kind][1] != line:
                self._versions += 1
                self._told[kind] = (self._versions, line)
                self._news.notify_all()

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """While somebody takes events."""
        with self._news:
            self.listeners += 1
        try:
            yield
        finally:
            with self._news:
                self.listeners -= 1

    def restart(self) -> None:
        """Forget all that was appended: it is not so any more. Clients have to be told, by a new `hello`."""
        with self._news:
            self._events.clear()
            self._news.notify_all()

    def close(self) -> None:
        """Nothing will come any more: streams end."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    @property
    def closed(self) -> bool:
        """Whether nothing will come any more."""
        return self._closed

    def after(self, number: int, version: int, timeout_s: float) -> tuple[list[Event], int, int]:
        """What came after a place in the log, at most `BATCH` of it; waits where there is nothing.

        Returns
        -------
        events, number, version
            Possibly no events, after `timeout_s`; and the place after them.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._closed or self._versions > version or len(self._events) > number, timeout_s
            )
            told = sorted((v, kind, line) for kind, (v, line) in self._told.items() if v > version)
            out = [Event(None, kind, line) for _, kind, line in told]
            some = self._events[number : number + BATCH]
            out += [Event(k, kind, line) for k, (kind, line) in enumerate(some, number + 1)]
            return out, number + len(some), told[-1][0] if told else version


def _json(data: Any) -> bytes:
    return json.dumps(data, separators=(",", ":"), allow_nan=False).encode()
