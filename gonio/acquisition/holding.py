"""Waits between two steps: a person asks for one, the disk is full, or a fault may pass. The lamp is dark meanwhile."""

import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

from gonio import platform
from gonio.acquisition import suspending
from gonio.acquisition.exposure import dark_exposures_s, expected_bracket
from gonio.acquisition.journal import Event
from gonio.acquisition.progress import Progress
from gonio.acquisition.run import Run
from gonio.acquisition.schedule import EXPECTED_ALBEDO
from gonio.acquisition.stop import Stop
from gonio.acquisition.suspending import Cause, Watch, lasting, naps
from gonio.errors import DataError, Interrupted, PassingFault
from gonio.rig import Pose, Reading, Step
from gonio.rig.description import RigDescription

LOOK_S = 0.2
"""Between two looks while a run is held."""
WAITS_S = {"camera": (2.0, 10.0, 60.0), "lamp": (5.0, 30.0, 120.0)}
"""Before a step is taken again after a fault that may pass, by its kind: as many attempts more as there are waits."""
JITTER = 0.1
"""Waits differ by so much of themselves, so that two rigs on one line do not ask in step."""
RESERVE = 2_000_000
"""Bytes that are left on the disk for the journal and the end of a run."""
ROOM_UNATTENDED_S, ROOM_ATTENDED_S = 60.0, 1800.0
"""How long a run waits for room on the disk before it ends: nobody frees any where nobody is told."""
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
        turn = zlib.crc32(f"{self._run.key} {step.index} {attempt}".encode()) / 2**32
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
            for _ in naps(suspending.LOOK_S):
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
        """Of a frame's file."""
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
        """Bytes of a run with so many steps; visits to the reference count as points."""
        return self._of["dark"] + max(steps - 1, 0) * self._of["point"] + RESERVE if steps > 0 else 0

    def of(self, step: Step) -> int:
        """Bytes of a step, with those that are left for the end of a run."""
        return self._of[step.kind] + RESERVE
