"""Who watches a measurement, and what they are told."""

import contextlib
from dataclasses import dataclass
from typing import Protocol

from gonio.acquisition.records import StepRecord
from gonio.acquisition.remaining import Remaining
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
    record: StepRecord | None = None
    """What the journal says of the step."""


class Progress(Protocol):
    """Somebody who watches a measurement."""

    def expects(self, remaining: Remaining) -> None:
        """Before `start`: who can say how long the rest takes, when told what was taken."""

    def start(self, steps: int, done: int) -> None:
        """Before the first step: how many steps the run has, and how many are done."""

    def more(self, steps: int) -> None:
        """The run has grown by so many steps."""

    def step(self, live: Live) -> None:
        """After every step."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """While the rig may talk to the user."""

    def waited(self, seconds: float) -> None:
        """The run has stood still for so long: no step took that time."""

    def say(self, text: str) -> None:
        """Something happened."""


class Silent:
    """Nobody watches."""

    def expects(self, remaining: Remaining) -> None:
        """Nothing."""

    def start(self, steps: int, done: int) -> None:
        """Nothing."""

    def more(self, steps: int) -> None:
        """Nothing."""

    def step(self, live: Live) -> None:
        """Nothing."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """Nothing."""
        return contextlib.nullcontext()

    def waited(self, seconds: float) -> None:
        """Nothing."""

    def say(self, text: str) -> None:
        """Nothing."""
