"""The steps of a run that are done: where their lines stand in the journal, and what these say.

The journal of a long run is read once, and every line checked; a step is kept no longer than it is asked for.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import overload

from gonio.acquisition.expected_lines import event_of
from gonio.acquisition.journal import Event, Events
from gonio.acquisition.records import StepRecord
from gonio.errors import DataError


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
