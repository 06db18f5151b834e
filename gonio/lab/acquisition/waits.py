"""Waits between two steps: a person asks for one, the disk is full, or a fault may pass. The lamp is dark meanwhile.

Also here is the health of a rig at every step. By `[suspend]` in the rig file a run waits for it, and goes on.
"""

import math
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio import platform
from gonio.errors import ConfigError, DataError, DeviceError, Interrupted, PassingFault
from gonio.lab.acquisition.exposure import dark_exposures_s, expected_bracket, expected_exposure_s
from gonio.lab.acquisition.journal import Event
from gonio.lab.acquisition.progress import Progress, Stop
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.schedule import EXPECTED_ALBEDO
from gonio.lab.rig import Frame, Health, Pose, Reading, Rig, Step
from gonio.lab.rig.description import ROOM_LIGHT, RigDescription

RECHECK_S = 2.0
"""Time between two looks while the run waits."""
NAP_S = 0.1
"""Ctrl-C is heard so soon meanwhile."""
LAMP = "lamp"


@dataclass(frozen=True, slots=True)
class Cause:
    """A rule that is broken, and by which reading."""

    rule: str
    reading: Reading
    limit: str

    def __str__(self) -> str:
        r = self.reading
        value = r.value if isinstance(r.value, str) else f"{r.value:.4g} {r.unit}".strip()
        return f"suspend.{self.rule}: {r.device} {r.quantity} is {value}, and {self.limit} pauses the run"


class Suspended(Exception):
    """A step was exposed while a rule was broken: it counts for nothing."""

    def __init__(self, causes: Sequence[Cause]) -> None:
        super().__init__("; ".join(map(str, causes)))
        self.causes = list(causes)


class Watch:
    """Reads the health of a rig, and judges it by the rules of its file.

    Parameters
    ----------
    rig
        Entered. It may offer `health()`; without one nothing is read but the light in the room.

    Raises
    ------
    ConfigError
        A rule is about a quantity that the rig does not read.
    """

    def __init__(self, rig: Rig) -> None:
        self._description = rig.description
        self._rules = rig.description.suspend
        self._ask: Callable[[], Health] | None = getattr(rig, "health", None)
        self._room_s = expected_exposure_s(rig.description, Pose(), 1.0)
        if any(rule.quantity != ROOM_LIGHT for rule in self._rules.values()):
            there = self.readings()
            for name, rule in self._rules.items():
                if rule.quantity != ROOM_LIGHT and not any(map(rule.concerns, there)):
                    known = ", ".join(sorted({f'"{r.device}" {r.quantity}' for r in there})) or "nothing"
                    device = f' of device = "{rule.device}"' if rule.device else ""
                    raise ConfigError(
                        f'suspend.{name}: quantity = "{rule.quantity}"{device} is not read on the rig '
                        f'"{self._description.name}"; read are {known}, "frames" {ROOM_LIGHT}'
                    )

    @property
    def room_light(self) -> bool:
        """Whether a rule asks for frames with the lamp off."""
        return any(rule.quantity == ROOM_LIGHT for rule in self._rules.values())

    def readings(self) -> tuple[Reading, ...]:
        """What a journal keeps: numbers that are finite, and words; no angles, which it has as poses."""
        if self._ask is None:
            return ()
        return tuple(_plain(r) for r in self._ask().readings if r.quantity != "angle")

    def room(self, capture: Callable[[float], Frame]) -> Reading:
        """The light in the room, by a frame that is taken with the lamp off."""
        frame = capture(self._room_s)
        dn = float(np.mean(frame.mosaic)) - frame.black_level_dn
        return Reading("frames", ROOM_LIGHT, dn / frame.exposure_s, "DN/s")

    def broken(self, readings: Sequence[Reading], *, lit: bool, waiting: Sequence[str] = ()) -> list[Cause]:
        """Which rules these readings break, by the worst reading of each.

        Parameters
        ----------
        readings
            What was read.
        lit
            Whether the lamp is meant to shine: a dark one says nothing of how it shines.
        waiting
            Rules that are waited for: their quantities have to come back by the hysteresis.

        Raises
        ------
        DeviceError
            A rule's quantity was not read.
        """
        out = []
        for name, rule in self._rules.items():
            seen = [r for r in readings if rule.concerns(r)]
            if not lit and all(r.device == LAMP for r in seen):
                continue
            if not seen and rule.quantity == ROOM_LIGHT:
                continue
            if not seen:
                raise DeviceError(f'suspend.{name}: the rig says nothing of "{rule.quantity}" any more')
            back = rule.hysteresis if name in waiting else 0.0
            found = [r for r in seen if rule.breaks(r.value, back)]
            if found:
                out.append(Cause(name, max(found, key=rule.badness), rule.words(back)))
        return out

    def require_patience(self, causes: Sequence[Cause], since: Mapping[str, float]) -> None:
        """Raise `DeviceError` where a rule is broken for longer than it allows; `since` when, by rule, on a watch."""
        for cause in causes:
            if time.monotonic() - since[cause.rule] > self.longest_s(cause):
                raise DeviceError(
                    f"{cause}; that has not ended within suspend.{cause.rule}.longest_s = {self.longest_s(cause):g} s; "
                    "remove the cause, then go on with --resume"
                )

    def longest_s(self, cause: Cause) -> float:
        """How long a run waits at most [s]."""
        return self._rules[cause.rule].longest_s

    def in_the_dark(self, causes: Sequence[Cause]) -> bool:
        """Whether the lamp is dark while a run waits."""
        return any(self._rules[cause.rule].dark for cause in causes)


def _plain(r: Reading) -> Reading:
    """A reading as JSON can hold it: a number that is none becomes a word."""
    value = r.value if isinstance(r.value, str) else float(r.value)
    countable = isinstance(value, str) or math.isfinite(value)
    return Reading(r.device, r.quantity, value if countable else str(value), r.unit)


def naps(seconds: float) -> Iterator[None]:
    """Sleep for `seconds` in short naps; after each the caller can look whether to go on."""
    end = time.monotonic() + seconds
    yield
    while (left := end - time.monotonic()) > 0:
        time.sleep(min(NAP_S, left))
        yield


def lasting(seconds: float) -> str:
    """A duration, for a person."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def wait(rig: Rig, seconds: float) -> None:
    """Wait for `seconds` with a rig that is open; raises `EmergencyStop` as soon as its interlock has stopped it."""
    for _ in naps(seconds):
        require(rig)


def require(rig: Rig) -> None:
    """Raise `EmergencyStop` where the interlock of an open rig has stopped it; nothing on a rig without one."""
    allowed = getattr(rig.light, "allowed", None)
    if allowed is not None:
        allowed()


def alive(rig: Rig, busy_s: float = 0.0) -> None:
    """A sign of life for a lamp that goes dark without one; the next one comes in `busy_s` and a little at most."""
    tell = getattr(rig.light, "alive", None)
    if tell is not None:
        tell(busy_s)


LOOK_S = 0.2
"""Time between two looks while a run is held."""
WAITS_S = {"camera": (2.0, 10.0, 60.0), "lamp": (5.0, 30.0, 120.0)}
"""Waits before a step is taken again after a fault that may pass, by its kind: one more attempt after each."""
JITTER = 0.1
"""Relative scatter of the waits, so that two rigs on one line do not ask in step."""
RESERVE = 2_000_000
"""Bytes that are left on the disk for the journal and the end of a run."""
ROOM_UNATTENDED_S, ROOM_ATTENDED_S = 60.0, 1800.0
"""How long a run waits for room on the disk before it ends: without a person at the terminal, and with one."""
LINE, LINE_OF_FRAME, HEAD = 1000, 400, 2500
"""Bytes of a step's line in the journal, of what it says of a frame, and of what stands in a frame's file before its
pixels."""


class Holding:
    """The waits of one session.

    Parameters
    ----------
    run, progress, stop
        Who is told, and who may end a wait.
    time_s
        The rig's clock.
    darken
        Darkens the lamp.
    require
        Raises where an interlock has stopped the rig.
    """

    def __init__(
        self,
        run: Run,
        progress: Progress,
        stop: Stop,
        time_s: Callable[[], float],
        darken: Callable[[], None],
        require: Callable[[], None],
    ) -> None:
        self._run, self._progress, self._stop, self._time_s, self._darken = run, progress, stop, time_s, darken
        self._require = require
        self._room_s = ROOM_ATTENDED_S if stop.pause.attended else ROOM_UNATTENDED_S
        self._frames = run.path / "frames"
        self._bytes = Bytes(run.description, len(run.bands))

    def wanted(self, step: Step) -> bool:
        """Whether there is something to wait for before a step."""
        return self._stop.pause.requested or free_bytes(self._frames) < self._bytes.of(step)

    def before(self, step: Step) -> None:
        """Wait while a person asks for it, and while the disk has no room for a step.

        Raises
        ------
        Interrupted
            The user asked to stop.
        DataError
            There was no room for too long.
        """
        pause, frames, needed = self._stop.pause, self._frames, self._bytes.of(step)
        while self.wanted(step):
            if pause.requested:
                text = f"paused before step {step.index} by {pause.by}"
                event = {"event": "paused", "step": step.index, "why": "asked", "message": text}
                self._hold(step, event, f"{text}; lamp dark; {pause.how}", lambda: not pause.requested)
                continue
            text = f"{frames}: {size(free_bytes(frames))} are free, and step {step.index} needs {size(needed)}"
            event = {"event": "paused", "step": step.index, "why": "disk", "message": text}
            said = f"{text}; waiting, at most {lasting(self._room_s)}, lamp dark: make room; Ctrl-C ends the run"
            end = time.monotonic() + self._room_s

            def room(text: str = text, end: float = end) -> bool:
                if free_bytes(frames) >= needed:
                    return True
                if time.monotonic() > end:
                    raise DataError(f"{text}; make room, then go on with --resume")
                return False

            self._hold(step, event, said, room)

    def after(self, fault: PassingFault, step: Step, attempt: int) -> None:
        """Wait after a fault in a step, so that the step can be taken again; raise the fault where that is all over.

        Parameters
        ----------
        fault, step
            What happened, and in which step.
        attempt
            How often the step has met such a fault, from 1.
        """
        waits = WAITS_S[fault.kind]
        if attempt > len(waits):
            raise PassingFault(f"{fault}; step {step.index} was tried {attempt} times", fault.kind) from None
        turn = zlib.crc32(f"{self._run.asked_key} {step.index} {attempt}".encode()) / 2**32
        wait_s = waits[attempt - 1] * (1.0 + JITTER * (2.0 * turn - 1.0))
        event = {"event": "retry", "step": step.index, "device": fault.kind, "attempt": attempt, "message": str(fault)}
        said = f"step {step.index}: {fault}; lamp dark, taken again in {lasting(wait_s)} ({attempt} of {len(waits)})"
        end = time.monotonic() + wait_s
        self._hold(step, event, said, lambda: time.monotonic() >= end)

    def while_broken(
        self, causes: Sequence[Cause], step: Step, watch: Watch, look: Callable[[], tuple[Sequence[Reading], bool]]
    ) -> None:
        """Wait until no rule of `[suspend]` is broken; the journal has what happened.

        Parameters
        ----------
        causes, step
            What is broken, and the step that is taken again afterwards.
        watch
            Who judges what is read.
        look
            What is read now, and whether the lamp is meant to shine.

        Raises
        ------
        Interrupted
            The user asked to stop.
        DeviceError
            A rule is broken for longer than it allows, or a device fails.
        """
        begun = time.monotonic()
        since: dict[str, float] = {}
        while causes:
            now, before = time.monotonic(), since
            since = {cause.rule: since.get(cause.rule, now) for cause in causes}
            for cause in causes:
                if cause.rule not in before:
                    self._tell({"event": "suspended", "step": step.index, "rule": cause.rule, "message": str(cause)})
                    longest = lasting(watch.longest_s(cause))
                    self._progress.say(f"waiting, at most {longest}: {cause}; Ctrl-C ends the run, to be resumed")
            if watch.in_the_dark(causes):
                self._darken()
            for _ in naps(RECHECK_S):
                if self._stop.requested:
                    raise Interrupted(f"stopped while waiting ({causes[0]}),")
            watch.require_patience(causes, since)
            readings, lit = look()
            causes = watch.broken(readings, lit=lit, waiting=tuple(since))
        self._go_on(step, begun, "going on after {lasted}; step {step} is taken again")

    def _hold(self, step: Step, event: Event, said: str, over: Callable[[], bool]) -> None:
        self._tell(event)
        begun = time.monotonic()
        self._darken()
        self._progress.say(said)
        while not over():
            for _ in naps(LOOK_S):
                if self._stop.requested:
                    raise Interrupted("stopped while paused,")
                self._require()
        self._go_on(step, begun, "going on with step {step} after {lasted}")

    def _go_on(self, step: Step, begun: float, said: str) -> None:
        waited = time.monotonic() - begun
        self._progress.waited(waited)
        self._tell({"event": "continued", "step": step.index, "waited_s": round(waited, 1)})
        self._progress.say(said.format(step=step.index, lasted=lasting(waited)))

    def _tell(self, event: Event) -> None:
        self._run.append(event | {"time_s": float(self._time_s())})


def free_bytes(folder: Path) -> int:
    """What this user may still write into a folder, or the nearest one above it that exists."""
    try:
        return platform.free_bytes(folder)
    except (FileNotFoundError, NotADirectoryError):
        return free_bytes(folder.absolute().parent)


def size(count: float) -> str:
    """Bytes, for a person."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if abs(count) < 1000:
            return f"{count:.3g} {unit}" if unit != "bytes" else f"{count:.0f} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


class Bytes:
    """What the steps of a run need on the disk, with frames as this program writes them.

    Parameters
    ----------
    description
        The rig.
    bands
        How many bands a point is measured in.
    """

    def __init__(self, description: RigDescription, bands: int) -> None:
        camera, acquisition = description.camera, description.acquisition
        pixel = 1.5 if camera.white_level_dn <= 4095 else 2.0
        self.frame = int(pixel * camera.width * camera.height) + HEAD
        """Bytes of a frame's file."""
        each = self.frame + LINE_OF_FRAME
        points = acquisition.frames + 1
        if acquisition.u_rel_target is not None:
            points = len(expected_bracket(description, Pose(), EXPECTED_ALBEDO))
        frames = {
            "dark": len(dark_exposures_s(description)) * acquisition.dark_frames,
            "reference": bands * description.reference.frames,
            "point": bands * points,
        }
        self._of = {kind: LINE + count * each for kind, count in frames.items()}

    def of_run(self, steps: int) -> int:
        """Bytes of a run of `steps` steps; visits to the reference count as points."""
        return self._of["dark"] + max(steps - 1, 0) * self._of["point"] + RESERVE if steps > 0 else 0

    def of(self, step: Step) -> int:
        """Bytes of a step, with those that are left for the end of a run."""
        return self._of[step.kind] + RESERVE
