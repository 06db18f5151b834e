"""Who watches a measurement, and what they are told.

Stopping a measurement by a signal: once finishes the step, twice stops at once. Pausing it, and letting it go on.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from types import FrameType, TracebackType
from typing import Any, Protocol, Self

from gonio import platform
from gonio.acquisition.records import StepRecord
from gonio.acquisition.remaining import Remaining
from gonio.errors import Interrupted
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


class Pause:
    """Whether a person wants a run to wait between two steps.

    Ctrl-Z (SIGTSTP) asks for that in place of stopping the process: a process that stands still looks after no rig.
    """

    def __init__(self) -> None:
        self.requested = False
        self.by = ""
        """What has asked."""
        self.attended = False
        """Whether somebody is at the terminal, who has keys for it."""

    def ask(self, by: str) -> None:
        """Wait after this step."""
        self.by, self.requested = by, True

    def go_on(self) -> None:
        """Wait no more."""
        self.requested = False

    @property
    def how(self) -> str:
        """How the run goes on, for a person."""
        keys = "c goes on, q ends the run; or " if self.attended else ""
        return f"{keys}`kill -CONT {os.getpid()}` goes on, Ctrl-C or `kill {os.getpid()}` ends the run"


class Stop:
    """What SIGINT, SIGTERM and SIGHUP ask for while it is entered: once to finish the step, twice to stop at once.

    Enter it around the rig's own context. The second signal raises `Interrupted`, wherever the program is; what comes
    later does nothing.

    Parameters
    ----------
    progress
        Who is told.
    last
        The process ends after this: where it was left by an error no signal is heard any more.
    pause
        Who is told of SIGTSTP, and of SIGCONT.
    """

    def __init__(self, progress: Progress, *, last: bool = False, pause: Pause | None = None) -> None:
        self.requested = 0
        self.pause = pause or Pause()
        self._progress, self._last = progress, last
        self._held = self._raised = False
        self._before: dict[signal.Signals, Any] = {}
        self._between: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            lost = (n for n in platform.HANG_UP if signal.getsignal(n) is signal.SIG_IGN)
            wanted = set(platform.ENDING).difference(lost)  # under nohup a lost terminal means nothing
            self._before = {number: signal.signal(number, self._request) for number in wanted}
            if not any(signal.getsignal(number) is signal.SIG_IGN for number in platform.PAUSE):
                between = (*platform.PAUSE, *platform.GO_ON)
                self._between = {number: signal.signal(number, self._hold) for number in between}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        deaf = dict.fromkeys(self._before if self._last and error is not None else (), signal.SIG_IGN)
        for number, before in (self._before | deaf | self._between).items():
            signal.signal(number, before)

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Meanwhile signals are counted, and raise nothing; whoever holds them looks at `requested` afterwards."""
        self._held = True
        try:
            yield
        finally:
            self._raised = self.requested > 1
            self._held = False

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested += 1
        if self._held:
            return
        if self.requested == 1:
            self._held = True  # a second signal must not tear the start of the thread
            self._say("finishing this step, then parking; once more stops every axis at once")
            self._held = False
        if self.requested > 1 and not self._raised:
            self._raised = True
            raise Interrupted("stopped at once, in the middle of a step")

    def _hold(self, number: int, frame: FrameType | None) -> None:
        if number in platform.GO_ON:
            self.pause.go_on()
        elif not self.pause.requested:
            self.pause.ask("SIGTSTP (Ctrl-Z)")
            self._say("pausing after this step")

    def _say(self, text: str) -> None:
        # from a thread: the signal may have come in the middle of a line that is being printed
        threading.Thread(target=self._progress.say, args=(text,)).start()
