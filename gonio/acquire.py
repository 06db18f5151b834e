"""Running a plan on any rig: the loop of docs/acquisition.md.

The loop knows rigs by their protocols alone. Whatever happens, the rig's context leaves with the lamp dark and the arms
parked; a step is in the journal if, and only if, all of its frames are on the disk.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import re
import shutil
import signal
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Protocol, Self

from gonio import __version__, exposure
from gonio.description import Band
from gonio.errors import DataError, DeviceError, Interrupted
from gonio.frames import write_dng
from gonio.imaging import Roi, roi
from gonio.journal import Event
from gonio.kinematics import View, view
from gonio.plan import ANGLES
from gonio.rig import Frame, Pose, Rig, Step, Target
from gonio.run import Run

AXES = tuple(asdict(Pose()))
WAITING = 8
"""How many frames may wait for the disk before the camera has to."""


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

    def step(self, live: Live) -> None:
        """After every step."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """While the rig may talk to the user."""

    def say(self, text: str) -> None:
        """Something happened."""


class Stop:
    """What SIGINT, SIGTERM and SIGHUP ask for while it is entered: once to finish the step, twice to stop at once.

    Enter it around the rig's own context: later signals wait until the arms are parked and the lamp is dark.
    """

    SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self, progress: Progress) -> None:
        self.requested = 0
        self._progress = progress
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            wanted = list(self.SIGNALS)
            if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:  # under nohup a lost terminal means nothing
                wanted.remove(signal.SIGHUP)
            self._before = {number: signal.signal(number, self._request) for number in wanted}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested += 1
        if self.requested == 1:
            # from a thread: the signal may have come in the middle of a line that is being printed
            text = "finishing this step, then parking; once more stops every axis at once"
            threading.Thread(target=self._progress.say, args=(text,), daemon=True).start()
        elif self.requested == 2:
            raise Interrupted("stopped at once, in the middle of a step")


def measure(rig: Rig, run: Run, steps: list[Step], progress: Progress, stop: Stop) -> None:
    """Take every step of a run that its journal does not hold yet.

    Parameters
    ----------
    rig : Rig
        Entered: its devices are open.
    run : Run
        Created or resumed, so that it can be written.
    steps : list of Step
        The schedule of the run's plan on this rig.
    progress, stop
        Who watches, and who may ask to stop.

    Raises
    ------
    Interrupted
        The user asked to stop; what was finished is in the journal.
    DeviceError
        A device failed; the journal says so.
    DataError
        The disk is full or fails.
    """
    done = {int(event["step"]) for event in run.steps()}
    left = [step for step in steps if step.index not in done]
    if not left:
        progress.say(f"{run.path}: every step is done")
        return
    if done and not rig.repeatable:
        left = _fresh(steps, done) + left
    run.append({"event": "session", "gonio": __version__, "steps": len(steps), "left": len(left)})
    progress.start(len(done) + len(left), len(done))
    with _Session(rig, run, progress) as session, _remarks(run, progress):
        try:
            for step in left:
                if stop.requested:
                    raise Interrupted("stopped")
                session.take(step)
            session.finish()
        except (Interrupted, DeviceError) as error:
            if isinstance(error, DeviceError) or stop.requested > 1:
                rig.arms.stop()
            session.finish()
            kind = "interrupted" if isinstance(error, Interrupted) else "device_error"
            run.append({"event": kind, "message": str(error)})
            if isinstance(error, Interrupted):
                where = f"after {len(run.steps())} of {len(done) + len(left)} steps"
                now = "axes stopped" if stop.requested > 1 else "arms parked"
                raise Interrupted(f"{error} {where}; {now}, lamp dark; go on with --resume") from None
            raise
    run.append({"event": "end", "steps": len(run.steps())})


def _fresh(steps: list[Step], done: set[int]) -> list[Step]:
    """New darks and a new reference visit for a rig on which time went by since the run was left."""
    number = max(len(steps), max(done) + 1)
    again = [step for step in (steps[0], steps[1]) if step.index in done]
    return [Step(number + k, step.kind, pose=step.pose) for k, step in enumerate(again)]


@dataclass(slots=True)
class _Taken:
    """A step whose frames are on their way to the disk."""

    event: Event
    files: list[Future[str]]
    live: Live


class _Session:
    """One sitting at the rig: the state of lamp and target, and the frames that wait for the disk."""

    def __init__(self, rig: Rig, run: Run, progress: Progress) -> None:
        self._rig, self._run, self._progress = rig, run, progress
        self._description = rig.description
        self._lit = False
        self._target: Target | None = None
        self._pending: deque[_Taken] = deque()
        self._store = _Store(run.path / "frames")
        self._names = _slugs(run.bands)
        self._reference = next((e for e in run.steps() if e["kind"] == "reference"), None)
        self._angles = run.plan[list(ANGLES)].to_numpy()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._store.close()

    def take(self, step: Step) -> None:
        """Take a step; journal the one before it, whose frames were being written meanwhile."""
        self._rig.begin(step)
        taken = self._dark(step) if step.kind == "dark" else self._lit_step(step)
        if step.kind == "reference" and self._reference is None:
            self._reference = taken.event
        self._pending.append(taken)
        while len(self._pending) > 1:
            self._write(self._pending.popleft())

    def finish(self) -> None:
        """Journal every step that has been taken whole."""
        while self._pending:
            self._write(self._pending.popleft())

    def _write(self, taken: _Taken) -> None:
        for frame, file in zip(taken.event["frames"], taken.files, strict=True):
            frame["sha256"] = file.result()
        self._store.sync()
        self._run.append(taken.event)
        self._progress.step(taken.live)

    def _dark(self, step: Step) -> _Taken:
        self._darken()
        files = _Files(self._store, step, "dark", "", lamp=False)
        for exposure_s in exposure.dark_exposures_s(self._description):
            for _ in range(self._description.acquisition.dark_frames):
                files.keep(self._rig.camera.capture(exposure_s))
        pose = self._rig.arms.read()
        return self._taken(step, pose, pose, [files], "", {}, 0.0)

    def _lit_step(self, step: Step) -> _Taken:
        target: Target = "reference" if step.kind == "reference" else "sample"
        self._present(target)
        pose = self._rig.arms.move(step.pose)
        seen = view(self._description, pose)
        if seen.camera_mm[2] <= 0.0 or seen.source_mm[2] <= 0.0:
            return self._taken(step, step.pose, pose, [], "below_horizon", {}, 0.0)
        all_files, levels, brightest = [], {}, 0.0
        for band in self._run.bands:
            files, levels[band.name], level = self._band(step, seen, target, band)
            all_files.append(files)
            brightest = max(brightest, level)
        return self._taken(step, step.pose, pose, all_files, "", {"level_per_s": levels}, brightest)

    def _band(self, step: Step, seen: View, target: Target, band: Band) -> tuple[_Files, float, float]:
        """Meter and measure one band: its files, its level for one second, and the level of the last full frame."""
        description, rig = self._description, self._rig
        region: Roi = roi(description, seen, target, band.channel)
        rig.light.select(band)
        if not self._lit:
            rig.light.on()
            self._lit = True
        found = exposure.meter(description, rig.camera.capture, region.of, self._expected(step, band))
        files = _Files(self._store, step, self._names[band.name], band.name, lamp=True)
        level = 0.0
        for _ in range(description.reference.frames if step.kind == "reference" else description.acquisition.frames):
            frame = rig.camera.capture(found.exposure_s)
            level = exposure.level(description.camera, frame, region.of)
            files.keep(frame)
        if step.kind == "point":
            files.keep(rig.camera.capture(exposure.shorter(description, found.exposure_s)))
        return files, found.level_per_s, level

    def _expected(self, step: Step, band: Band) -> float:
        """The level for one second that a white surface gives at this pose, by the first visit to the reference."""
        if self._reference is None:
            return exposure.expected_level_per_s(self._description, step.pose, 1.0)
        at_reference = Pose(**self._reference["goal"])
        ratio = exposure.cosine_of_incidence(step.pose) / exposure.cosine_of_incidence(at_reference)
        return max(float(self._reference["level_per_s"][band.name]), 1e-6) * ratio

    def _taken(
        self, step: Step, goal: Pose, pose: Pose, files: list[_Files], flag: str, more: dict[str, Any], level: float
    ) -> _Taken:
        frames = [frame for each in files for frame in each.frames]
        event = {
            "event": "step",
            "step": step.index,
            "kind": step.kind,
            "point": step.point,
            "time_s": frames[0]["time_s"] if frames else self._rig.time_s(),
            "goal": asdict(goal),
            "pose": asdict(pose),
            "flag": flag,
            **more,
            "frames": frames,
        }
        angles = None if step.point is None else tuple(map(float, self._angles[step.point]))
        exposure_s = max((frame["exposure_s"] for frame in frames), default=0.0)
        live = Live(step, angles, level, exposure_s, flag)  # type: ignore[arg-type]
        return _Taken(event, [file for each in files for file in each.written], live)

    def _present(self, target: Target) -> None:
        if target != self._target:
            with self._progress.paused():
                self._rig.present(target)
            self._target = target

    def _darken(self) -> None:
        self._rig.light.off()
        self._lit = False


class _Store:
    """Writes frames in a thread of its own, in order, so that the disk and the camera work at the same time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="gonio-frames")
        self._room = threading.Semaphore(WAITING)

    def put(self, frame: Frame, name: str) -> Future[str]:
        """Begin to write a frame; the future is the SHA-256 of its file, once that is on the disk."""
        self._room.acquire()
        return self._pool.submit(self._write, frame, self._folder / name)

    def _write(self, frame: Frame, path: Path) -> str:
        try:
            if frame.file is None:
                write_dng(frame, path)
            else:
                _adopt(frame.file, path)
            with path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}") from None
        finally:
            self._room.release()

    def sync(self) -> None:
        """Wait until the names of the frames are on the disk too."""
        handle = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)

    def close(self) -> None:
        self._pool.shutdown(cancel_futures=True)


@dataclass(slots=True)
class _Files:
    """The frames of one step in one band."""

    store: _Store
    step: Step
    slug: str
    band: str
    lamp: bool
    frames: list[dict[str, Any]] = field(default_factory=list)
    written: list[Future[str]] = field(default_factory=list)

    def keep(self, frame: Frame) -> None:
        suffix = ".dng" if frame.file is None else frame.file.suffix.lower()
        name = f"{self.step.index:06d}-{self.slug}-{len(self.frames) + 1:02d}{suffix}"
        self.frames.append(
            {
                "file": name,
                "band": self.band,
                "exposure_s": frame.exposure_s,
                "time_s": frame.time_s,
                "lamp": self.lamp,
            }
        )
        self.written.append(self.store.put(frame, name))


def _adopt(source: Path, path: Path) -> None:
    """Copy a camera's own raw file, whole or not at all."""
    temporary = path.with_name(f".{path.name}.new")
    try:
        shutil.copyfile(source, temporary)
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _slugs(bands: tuple[Band, ...]) -> dict[str, str]:
    """A part of a file name for every band."""
    out: dict[str, str] = {}
    for band in bands:
        slug = re.sub(r"[^A-Za-z0-9_]+", "", band.name) or "band"
        out[band.name] = slug if slug not in out.values() else f"{slug}_{len(out)}"
    return out


class _Remarks(logging.Handler):
    """What a driver says of its device while a run is measured: a repetition, a recovery."""

    def __init__(self, run: Run, progress: Progress) -> None:
        super().__init__(logging.WARNING)
        self._run, self._progress = run, progress

    def emit(self, record: logging.LogRecord) -> None:
        """Write it into the journal, and tell whoever watches."""
        message = record.getMessage()
        self._run.append({"event": "remark", "message": message})
        self._progress.say(message)


@contextlib.contextmanager
def _remarks(run: Run, progress: Progress) -> Iterator[None]:
    """Keep in the journal what drivers log on `gonio.devices`."""
    log, handler = logging.getLogger("gonio.devices"), _Remarks(run, progress)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


@contextlib.contextmanager
def _nothing() -> Iterator[None]:
    yield


class Silent:
    """Nobody watches."""

    def start(self, steps: int, done: int) -> None:
        """Nothing."""

    def step(self, live: Live) -> None:
        """Nothing."""

    def paused(self) -> contextlib.AbstractContextManager[None]:
        """Nothing."""
        return _nothing()

    def say(self, text: str) -> None:
        """Nothing."""
