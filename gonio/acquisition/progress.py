"""Who watches a measurement, and what they are told."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from gonio.rig import Step


@dataclass(frozen=True, slots=True)
class Live:
    """What has just been measured, for a person who watches."""

    step: Step
    angles_deg: tuple[float, float, float, float] | None
    """theta_i, phi_i, theta_r, phi_r of a point."""
    level: float
    """Of the brightest used pixel, as a fraction of full scale."""
    exposure_s: float
    flag: str


class Progress(Protocol):
    """Somebody who watches a measurement."""

    def start(self, steps: int, done: int) -> None:
        """Before the first step: how many steps the run has, and how many are done."""

    def more(self, steps: int) -> None:
        """The run has grown by so many steps."""

    def step(self, live: Live) -> None:
        """After every step."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """While the rig may talk to the user."""

    def say(self, text: str) -> None:
        """Something happened."""


@contextlib.contextmanager
def _nothing() -> Iterator[None]:
    yield


class Silent:
    """Nobody watches."""

    def start(self, steps: int, done: int) -> None:
        """Nothing."""

    def more(self, steps: int) -> None:
        """Nothing."""

    def step(self, live: Live) -> None:
        """Nothing."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """Nothing."""
        return _nothing()

    def say(self, text: str) -> None:
        """Nothing."""
