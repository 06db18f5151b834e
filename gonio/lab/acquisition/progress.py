"""Who watches a measurement, and what they are told.

Stopping a measurement by a signal: once finishes the step, twice stops at once. Pausing it, and letting it go on.

Also here is how long the rest of a run takes, by the rig file's durations and by what its steps have really taken.

On a laboratory rig the rig's clock tells travel and frames apart, and each is corrected by itself. A simulated rig's
clock is no watch, and what is computed there takes no time to travel: steps of a kind are timed by the clock on the
wall, and nothing is said before two points were taken.
"""

import contextlib
import math
import os
import signal
import threading
from bisect import bisect_left
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import FrameType, TracebackType
from typing import Any, Protocol, Self

import numpy as np

from gonio import platform
from gonio.errors import Interrupted
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.plan import Point
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.schedule import Schedule
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.inverse_kinematics import Unreachable, reach
from gonio.typing import Floats

REMEMBERED = 400
"""Steps that say how the run goes: the last ones, so that it may change."""
SAMPLED = 256
"""Steps whose time is worked out; they stand for all that are left."""
PRIOR = math.log(1.5)
"""How far a rig file is off before anything is measured: standard deviation of the logarithm of a time's ratio."""
SCATTER, KNOWN = 0.3, 3.0
"""Scatter of the logarithm of a time that is assumed at first, and how many measured steps that assumption weighs."""
UNSEEN = math.log(2.0)
"""How unsure the time of steps is of whose kind none was taken yet, on a simulated rig."""
ALIKE = 10
"""Neighbouring points have like exposures: this many of them tell as much as one step that was picked at random."""
OUTLIER = 4.0
"""Ratios farther from the median than this many standard deviations are moved there: somebody was at the rig."""


@dataclass(frozen=True, slots=True)
class TimeLeft:
    """How long the rest takes [s]."""

    seconds: float
    u_seconds: float
    """Its standard uncertainty (k = 1)."""


@dataclass(frozen=True, slots=True)
class Ratio:
    """By how much times differ from what the rig file says."""

    value: float
    u_log: float
    """Standard uncertainty of its logarithm."""
    scatter: float
    """Standard deviation of the logarithm, from step to step."""


def ratio(expected: Sequence[float], taken: Sequence[float], prior: float = PRIOR) -> Ratio:
    """The ratio of what steps took to what was expected, with the prior that it is 1, as its logarithm is so unsure.

    It is the ratio of the sums, so that long steps count as they do in what is left; but no single step is believed to
    be off by more than `OUTLIER` standard deviations.
    """
    wanted, real = np.asarray(expected, dtype=float), np.asarray(taken, dtype=float)
    moved = wanted > 0.0  # an arm that had not to move tells nothing
    wanted, real = wanted[moved], np.maximum(real[moved], 1e-9)
    if not wanted.size:
        return Ratio(1.0, prior, prior)
    off = np.log(real / wanted)
    middle = float(np.median(off))
    seen = 1.4826 * float(np.median(np.abs(off - middle)))
    scatter = math.sqrt((wanted.size * seen**2 + KNOWN * SCATTER**2) / (wanted.size + KNOWN))
    reach = max(OUTLIER * scatter, math.log(2.0))
    drawn_in = wanted * np.exp(np.clip(off, middle - reach, middle + reach))
    found = math.log(float(drawn_in.sum() / wanted.sum()))
    weight = (1.0 + (wanted.size - 1.0) / ALIKE) / scatter**2
    both = weight + 1.0 / prior**2
    return Ratio(math.exp(found * weight / both), both**-0.5, scatter)


@dataclass(slots=True)
class _Taken:
    """What is known of a step that was taken [s]."""

    before: Pose
    step: Step
    seconds: Mapping[str, float]
    """By part of `gonio.lab.acquisition.duration.TimeParts`; or the whole step, by its kind."""
    expected: Mapping[str, float] | None = None
    """The same as the rig file has it; None until it is worked out."""


class Remaining:
    """The time that is left of a run.

    Parameters
    ----------
    durations
        By the rig file.
    steps
        All steps of the run that are known, in order.
    done
        The numbers of those that were taken.
    simulated
        The rig's clock is no watch.
    """

    def __init__(self, durations: Durations, steps: Sequence[Step], done: Collection[int], *, simulated: bool) -> None:
        self._durations, self._steps, self._simulated = durations, steps, simulated
        numbers = range(len(steps)) if isinstance(steps, Schedule) else [step.index for step in steps]
        every = np.array(numbers, dtype=np.int64)
        self._places = np.flatnonzero(~np.isin(every, list(done)))
        """Of the steps that were left at the beginning, among all."""
        self._left = every[self._places]
        """Their numbers."""
        self._taken: deque[_Taken] = deque(maxlen=REMEMBERED)
        self._begun: set[str] = set()
        """Kinds of steps that were taken. On a simulated rig the first of each says nothing: it loads and compiles what
        the others find there."""
        self._last: StepRecord | None = None
        self._done = 0
        self._more = 0
        self._sampled: tuple[Sequence[int], list[Mapping[str, float]]] = (), []

    @classmethod
    def of_run(cls, run: Run, planned: Sequence[Step] | None = None, *, simulated: bool | None = None) -> "Remaining":
        """That of a run as its folder has it, after the steps that are in its journal.

        On a laboratory rig it has learnt from the last of them already.

        Parameters
        ----------
        run
            The run.
        planned
            The schedule of its plan, where somebody has it.
        simulated
            Whether its rig is a simulated one; by default, whether it names a simulated sample.
        """
        description, points = run.description, run.planned
        steps = planned
        if steps is None:
            rows = [row for row, flag in enumerate(points.flags) if not flag]
            angles = points.angles_deg
            steps = Schedule(description, rows, lambda row: reach(description, Point(*angles[row].tolist()).directions))
        if grown := run.grown_steps():
            steps = [*steps, *grown]
        done = run.steps()
        simulated = run.sample is not None if simulated is None else simulated
        out = cls(Durations(description, run.bands), steps, set(done.numbers), simulated=simulated)
        for record in done[-REMEMBERED:] if not simulated else ():
            out.took(record)
        return out

    def took(self, record: StepRecord, wall_s: float | None = None) -> None:
        """A step was taken.

        Parameters
        ----------
        record
            What the journal says of it.
        wall_s
            For how long, on a watch; without the times for which the run was paused. None: nobody looked.
        """
        last, self._last = self._last, record
        at = int(np.searchsorted(self._left, record.step))
        if at < len(self._left) and self._left[at] == record.step:
            self._done = max(self._done, at + 1)
        else:
            self._more = max(self._more - 1, 0)
        seconds: Mapping[str, float] = {} if self._simulated else _by_rig_clock(record, last)
        if self._simulated and wall_s is not None and record.kind in self._begun:
            seconds = {record.kind: wall_s}
        self._begun.add(record.kind)
        if seconds and record.frames:
            before = last.pose if last is not None else record.pose
            self._taken.append(_Taken(before, Step(record.step, record.kind, record.point, record.goal), seconds))

    def more(self, steps: int) -> None:
        """Add steps whose places are not known yet; they are taken to last as long as those that were measured."""
        self._more += steps

    @property
    def left(self) -> TimeLeft | None:
        """How long the rest takes; None where nothing is known of it."""
        whole = len(self._left) - self._done
        sample = self._sample(whole)
        for taken in self._taken:
            taken.expected = taken.expected or self._expected(taken.before, taken.step)
        if self._more and not sample:
            sample = [taken.expected for taken in self._taken if taken.expected and taken.step.kind != "dark"]
        if (whole + self._more and not sample) or (self._simulated and not self._taken):
            return None
        share = (whole + self._more) / max(len(sample), 1)
        pairs: dict[str, tuple[list[float], list[float]]] = {}
        for taken in self._taken:
            for name, real in taken.seconds.items():
                expected, real_s = pairs.setdefault(name, ([], []))
                expected.append((taken.expected or {})[name])
                real_s.append(real)
        total, variance = 0.0, 0.0
        for name in sorted({name for one in sample for name in one}):
            every: Floats = np.array([one[name] for one in sample if name in one])
            found = self._ratio(name, pairs)
            seconds = share * float(every.sum()) * found.value
            total += seconds
            alike = min(ALIKE, whole + self._more) * share * float((every**2).sum())
            variance += (seconds * found.u_log) ** 2 + alike * (found.value * found.scatter) ** 2
            if share > 1.0 and len(sample) > 1:
                variance += (found.value * share) ** 2 * len(sample) * float(np.var(every))
        return TimeLeft(total, math.sqrt(variance))

    def _ratio(self, name: str, pairs: Mapping[str, tuple[list[float], list[float]]]) -> Ratio:
        if not self._simulated:
            return ratio(*pairs.get(name, ([], [])))
        if name in pairs:
            return ratio(*pairs[name], math.inf)
        expected, taken = ([x for pair in pairs.values() for x in pair[k]] for k in range(2))
        return replace(ratio(expected, taken, math.inf), u_log=UNSEEN)

    def _expected(self, before: Pose, step: Step) -> Mapping[str, float]:
        return {step.kind: 1.0} if self._simulated else asdict(self._durations.step(before, step))

    def _sample(self, whole: int) -> list[Mapping[str, float]]:
        """What steps that stand for those that are left should take."""
        places, expected = self._sampled
        begin = bisect_left(places, self._done)
        if len(places) - begin < min(whole, SAMPLED // 2):
            # spread evenly and at irregular distances, so that no visit every N is hit always
            golden = (math.sqrt(5.0) - 1.0) / 2.0
            shares = [(k * golden) % 1.0 for k in range(SAMPLED)]
            every = range(whole) if whole <= SAMPLED else sorted({int(share * whole) for share in shares})
            places = [self._done + place for place in every]
            expected = [self._expected_at(int(self._places[place])) for place in places]
            self._sampled, begin = (places, expected), 0
        return expected[begin:]

    def _expected_at(self, at: int) -> Mapping[str, float]:
        """What a step takes after the one before it."""
        try:
            step = self._steps[at]
            before = self._steps[at - 1] if at else step
            return self._expected(before.pose if before.kind != "dark" else Pose(), step)
        except Unreachable:  # of a rig file that has changed since
            return {}


def _by_rig_clock(record: StepRecord, last: StepRecord | None) -> Mapping[str, float]:
    """What the times in a record, and in the one before it, say of a step's parts [s]."""
    if record.kind == "dark":
        if len(record.frames) < 2:
            return {}
        end = record.frames[-1]
        return {"dark_s": end.time_s + end.exposure_s - record.frames[0].time_s}
    if record.pose_time_s is None or record.pose_after_time_s is None:
        return {}
    out = {"frames_s" if record.kind == "point" else "reference_s": record.pose_after_time_s - record.pose_time_s}
    if last is not None and last.pose_after_time_s is not None:
        out["travel_s"] = record.pose_time_s - last.pose_after_time_s
    return out


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
        """The run has grown by `steps`."""

    def step(self, live: Live) -> None:
        """After every step."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """While the rig may talk to the user."""

    def waited(self, seconds: float) -> None:
        """The run has stood still for `seconds`, which no step took."""

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
