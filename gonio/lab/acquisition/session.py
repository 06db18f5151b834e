"""One session at the rig: the state of lamp and target, and the frames that wait for the disk."""

import logging
import math
import time
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from numbers import Real
from typing import Self

import numpy as np

from gonio.errors import DeviceError, Disturbed, Interrupted, PassingFault
from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.frame_writer import Files, Store, slugs
from gonio.lab.acquisition.progress import Live, Progress, Stop
from gonio.lab.acquisition.records import FrameFile, StepRecord
from gonio.lab.acquisition.repeats import REPEATED, cannot_be_alike
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.waits import Cause, Holding, Suspended, Watch, alive, require
from gonio.lab.rig import Frame, Pose, Reading, Rig, Step, Target
from gonio.lab.rig.kinematics import View, left_its_side, view
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.motion_planning import Blocked, route
from gonio.lab.rig.polariser_axes import opened, settings
from gonio.lab.rig.protocols import Monitors
from gonio.lab.rig.regions import Roi, require_frame, roi

log = logging.getLogger("gonio.devices")
ATTEMPTS = 3
"""How often a step is taken whose arms do not stand still."""
PACE_STEPS = 64
FAST_STEP_S = 0.01
"""The last `PACE_STEPS` steps took less each: then steps are synced together."""
TOGETHER_S = 0.2
"""Longest time between two syncs of a fast run, whose steps are synced together."""
MOVED_STEPS = 2.5
"""An axis has moved where its readbacks before and after the frames differ by more steps: encoders flicker by one."""
MOVED_DEG = 0.01
"""The same, for an axis whose encoder has no steps."""


class _Numbers:
    """Steps beyond the schedule, numbered after it and after all that was taken or chosen."""

    def __init__(self, steps: Sequence[Step], taken: Sequence[int]) -> None:
        self.reference = steps[1]
        """The first visit to the reference."""
        self.following = max(len(steps), max(taken, default=0) + 1)

    def again(self, step: Step) -> Step:
        """A dark or a visit to the reference once more: on a rig on which time went by meanwhile."""
        self.following += 1
        return Step(self.following - 1, step.kind, pose=step.pose)


@dataclass(frozen=True, slots=True)
class _Readback:
    """What the encoders read, and when [s]."""

    pose: Pose
    time_s: float
    spread: Pose | None = None
    """Of the readings that `pose` is the mean of, where the rig tells [rad]."""


@dataclass(slots=True)
class _Taken:
    """A step whose frames are on their way to the disk."""

    record: StepRecord
    """Its frames without what their files are."""
    files: list[Future[FrameFile]]
    live: Live


class _Session:
    """One session at the rig: the state of lamp and target, and the frames that wait for the disk."""

    def __init__(self, rig: Rig, run: Run, numbers: _Numbers, watch: Watch, progress: Progress, stop: Stop) -> None:
        self._rig, self._run, self._progress = rig, run, progress
        self._numbers, self._watch, self._stop = numbers, watch, stop
        self._description = rig.description
        self._still_deg = {
            name: max(MOVED_STEPS * axis.encoder_step_deg, MOVED_DEG) for name, axis in rig.description.axes().items()
        }
        """Largest angle by which an axis may seem to move that stands still."""
        self._lit = False
        self._target: Target | None = None
        self._taken_steps: list[_Taken] = []
        """Their frames are being written."""
        self._committing: tuple[Future[None], list[_Taken]] | None = None
        """Steps whose frames are on their way to the disk; nothing is waited for before the next ones are."""
        self._committed_s = -math.inf
        """When these were sent there, on the computer's clock."""
        self._begun_s: deque[float] = deque(maxlen=PACE_STEPS)
        """When the last steps were taken, on a clock that stands still while the disk is waited for."""
        self._waited_s = 0.0
        """How long the disk was waited for so far."""
        self._polarisers = opened(rig)
        self._store = Store(run.path / "frames")
        self._holding = Holding(run, progress, stop, rig.time_s, self._darken, lambda: require(rig))
        self._names = slugs(run.bands)
        self._done = run.steps()
        self._last: StepRecord | None = None
        """The last point of this session that has frames."""
        self._reference = next((s for s in self._done if s.kind == "reference" and not s.flag), None)
        self._angles = run.points.angles_deg
        self._last_s = -math.inf
        """When the last frame that counts was taken."""
        if not rig.repeatable and self._done:
            latest = self._done.latest()
            self._last_s = max((float(frame.time_s) for frame in latest.frames), default=float(latest.time_s))
        self._resumed = math.isfinite(self._last_s)
        self._step = -1
        self._picture: tuple[Frame | None, int] = None, -1
        """The last frame that came, and of which step."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._store.close()

    def begin(self, step: Step) -> None:
        """Before the first step: wait where a rule is broken already."""
        if self._description.suspend:
            causes = self._watch.broken(self._watch.readings(), lit=False)
            if causes:
                self._wait(step, causes)

    def take(self, step: Step) -> None:
        """Take a step; journal the one before it, whose frames were being written meanwhile.

        Where a person has asked for a pause, or the disk has no room, it is waited for before that.
        """
        if self._holding.wanted(step):
            self.finish()
            lit = self._lit
            self._holding.before(step)
            if lit:
                self._after_darkness(step)
        taken = self._undisturbed(step)
        if step.kind == "reference" and not taken.record.flag:
            self._reference = min(self._reference or taken.record, taken.record, key=lambda record: record.step)
        if step.kind == "point" and taken.record.frames:
            self._last = taken.record
        self._taken_steps.append(taken)
        if not self._hurried() or time.monotonic() - self._committed_s > TOGETHER_S:
            self._commit()

    def _hurried(self) -> bool:
        """Whether steps come so fast that the disk, which syncs them one by one, would be what they wait for."""
        now = time.monotonic() - self._store.waited_s - self._waited_s
        self._begun_s.append(now)
        fast = len(self._begun_s) == PACE_STEPS and now - self._begun_s[0] < PACE_STEPS * FAST_STEP_S
        self._store.at_once = fast
        return fast

    def _undisturbed(self, step: Step) -> _Taken:
        """A step during which no rule of `[suspend]` was broken; one that was is waited for, and the step taken again.

        What happened to the lamp meanwhile nobody knows: on a laboratory rig a point is preceded by a visit to the
        reference then, unless that would need a person.
        """
        faults, self._step = 0, step.index
        while True:
            before_s, resumed, lit = self._last_s, self._resumed, self._lit
            if self._rig.repeatable:  # a repetition gives the same frame once more, which is no fault of the camera
                self._picture = None, -1
            try:
                alive(self._rig)
                self._rig.begin(step)
                return self._dark(step) if step.kind == "dark" else self._lit_step(step)
            except Suspended as suspended:
                self._wait(step, suspended.causes)
                lit = True
            except PassingFault as fault:
                faults += 1
                self.finish()
                self._holding.after(fault, step, faults)
                lit = lit or self._lit
            if self._rig.repeatable:
                self._last_s, self._resumed = before_s, resumed
            if lit:
                self._after_darkness(step)

    def _after_darkness(self, step: Step) -> None:
        """A visit to the reference before a point, where the lamp was dark: on a laboratory rig it is another lamp now.

        Where a person swaps the reference there is none, because nobody may be there.
        """
        by_hand = self._description.reference.how in ("swap", "beam")
        if step.kind == "point" and not self._rig.repeatable and not by_hand:
            self.take(self._numbers.again(self._numbers.reference))

    def _wait(self, step: Step, causes: Sequence[Cause]) -> None:
        self.finish()
        self._holding.while_broken(causes, step, self._watch, self._look)

    def _look(self) -> tuple[Sequence[Reading], bool]:
        """What is read now, and whether the lamp is meant to shine; room light is looked at with the lamp off."""
        if self._watch.room_light:
            self._darken()
            return (*self._watch.readings(), self._watch.room(self._capture)), self._lit
        return self._watch.readings(), self._lit

    def _health(self) -> tuple[Reading, ...]:
        """What is read at the end of a step; raises `Suspended` where a rule is broken."""
        lit, readings = self._lit, self._watch.readings()
        if self._watch.room_light:  # the readings so far are with the lamp lit
            self._darken()
            readings = (*readings, self._watch.room(self._capture))
        causes = self._watch.broken(readings, lit=lit)
        if causes:
            raise Suspended(causes)
        return readings

    def finish(self) -> None:
        """Journal every step that has been taken whole."""
        if self._taken_steps:
            self._commit()
        self._journal()

    def _commit(self) -> None:
        """Send the frames of the steps taken to the disk, and journal those that were sent before."""
        self._journal()
        self._committed_s = time.monotonic()
        self._committing, self._taken_steps = (self._store.commit(), self._taken_steps), []

    def _journal(self) -> None:
        """Wait for the frames that are on their way to the disk, and journal their steps."""
        if self._committing is None:
            return
        (done, steps), self._committing = self._committing, None
        began = time.monotonic()
        done.result()
        self._run.append_all([taken.record.stored([file.result() for file in taken.files]).text() for taken in steps])
        for taken in steps:
            self._progress.step(taken.live)
        self._waited_s += time.monotonic() - began

    def _dark(self, step: Step) -> _Taken:
        self._darken()
        exposures, number = exposure.dark_exposures_s(self._description), self._description.acquisition.dark_frames
        files = Files(self._store, step, self._run.key, len(exposures) * number)
        for exposure_s in exposures:
            for _ in range(number):
                files.keep(self._capture(exposure_s), "dark", "", lamp=False)
        readback = self._readback()
        return self._taken(step, readback.pose, readback, files=files)

    def _lit_step(self, step: Step) -> _Taken:
        target: Target = "reference" if step.kind == "reference" else "sample"
        self._present(target)
        before_s = self._last_s
        for attempt in range(1, ATTEMPTS + 1):
            try:
                return self._exposed(step, target)
            except Disturbed as disturbed:
                self._last_s = before_s
                then = "it is taken again" if attempt < ATTEMPTS else 'it is flagged "moved"'
                log.warning("step %d: %s; %s", step.index, disturbed, then)
        return self._taken(step, step.pose, self._readback(), "moved")

    def _exposed(self, step: Step, target: Target) -> _Taken:
        """Move, and take the frames of every band; raises `Disturbed` where an axis did not stand still meanwhile."""
        try:
            pose = self._move(step.pose)
        except Blocked as blocked:
            log.warning("step %d: blocked: %s", step.index, blocked)
            return self._taken(step, step.pose, self._readback(), "blocked")
        readback = _Readback(pose, self._rig.time_s(), getattr(self._rig.arms, "spread", None))
        seen = view(self._description, pose)
        straight = target == "reference" and self._description.reference.how == "beam"
        if not straight and left_its_side(self._description, step.pose, pose):
            return self._taken(step, step.pose, readback, "below_horizon")
        levels, brightest = {}, 0.0
        planned = self._description.acquisition.u_rel_target is not None  # then each band says how many it has
        count = 0 if planned else len(self._run.bands) * (self._frames(step) + (step.kind == "point"))
        files = Files(self._store, step, self._run.key, count, readback.pose, readback.time_s)
        for band in self._run.bands:
            levels[band.name], level = self._band(step, seen, target, band, files)
            brightest = max(brightest, level)
        after = self._readback()
        for name, still_deg in self._still_deg.items():
            way_deg = math.degrees(abs(getattr(after.pose, name) - getattr(pose, name)))
            if way_deg > still_deg:
                raise Disturbed(f"axis {name} has moved by {way_deg:.2f} deg during the exposures")
        flag = "unsteady" if step.kind == "point" and self._unsteady(step, readback.spread) else ""
        return self._taken(step, step.pose, readback, flag, files, brightest, after, levels)

    def _readback(self) -> _Readback:
        return _Readback(self._rig.arms.read(), self._rig.time_s())

    def _move(self, goal: Pose) -> Pose:
        """Drive to a goal, by other poses where bodies would touch on the way; where the arms landed."""
        if not self._description.looks_ahead:
            return self._rig.arms.move(goal)
        for leg in route(self._description, self._rig.arms.read(), goal):
            pose = self._rig.arms.move(leg)
        return pose

    def _frames(self, step: Step) -> int:
        """How many equal frames a step has in a band."""
        return self._description.reference.frames if step.kind == "reference" else self._description.acquisition.frames

    def _capture(self, exposure_s: float) -> Frame:
        """A frame, later than the one before it; raises `DeviceError` where its time does not say so."""
        frame, last_s = self._rig.camera.capture(exposure_s), self._last_s
        source = f'the camera of the rig "{self._description.name}"'
        require_frame(self._description.camera, frame, source)
        exposure.require_asked(self._description.camera, frame, exposure_s, source)
        self._require_another_picture(frame)
        sound = isinstance(frame.time_s, Real) and 0.0 <= frame.time_s < math.inf
        if sound and frame.time_s > last_s:
            self._last_s, self._resumed = float(frame.time_s), False
            return self._monitored(frame)
        what = "a frame"
        if not sound:
            why = (
                ": seconds of at least 0 are needed. In the rig's driver, give each Frame the rig's time_s() at the "
                "start of its exposure"
            )
        elif self._resumed:
            what = "its first frame"
            why = (
                f", and this run holds a frame of {last_s!r} s: the rig's clock was set back, or starts anew at every "
                "session. Set the computer's clock right, or let the rig's time_s() go on from session to session; or "
                "measure into a new folder"
            )
        else:
            why = (
                f", and the one before it had {last_s!r} s: the drift of the lamp cannot be told from times that do "
                "not grow. In the rig's driver, give each Frame the rig's time_s() at the start of its exposure, from "
                "a clock that never goes back (time.monotonic)"
            )
        raise DeviceError(f"{source} stamps {what} with time_s = {frame.time_s!r}{why}")

    def _require_another_picture(self, frame: Frame) -> None:
        """Raise `DeviceError` where the camera hands out the picture before this one under a new header."""
        (before, of), self._picture = self._picture, (frame, self._step)
        row = frame.mosaic.shape[0] // 2
        if before is None or not np.array_equal(before.mosaic[row], frame.mosaic[row]):  # nearly always that tells
            return
        if cannot_be_alike(self._description.camera, before, frame):
            raise DeviceError(
                f'step {self._step}: the camera of the rig "{self._description.name}" gives the same picture twice, '
                f"pixel by pixel, which noise makes impossible (the one before is of step {of}): {REPEATED}. Look "
                "after camera and driver, as what its buffer keeps, then go on with --resume"
            )

    def _monitored(self, frame: Frame) -> Frame:
        """A frame with the reading of the lamp's monitor, where frames are divided by it."""
        if not (self._lit and self._description.lamp.monitor and frame.monitor is None):
            return frame
        read = self._rig.light.monitor() if isinstance(self._rig.light, Monitors) else None
        if read is None or not 0.0 < read < math.inf:
            raise DeviceError(
                f'the lamp of the rig "{self._description.name}" gives no reading of a monitor ({read}), and the rig '
                "file says lamp.monitor = true: name the question of its monitor in devices.light, or leave the key out"
            )
        return replace(frame, monitor=float(read))

    def _unsteady(self, step: Step, spread: Pose | None) -> bool:
        """Whether an encoder does not tell where its axis stands: its readings at rest lie too far apart."""
        for name, still_deg in self._still_deg.items() if spread is not None else ():
            apart_deg = math.degrees(getattr(spread, name))
            if apart_deg > still_deg:
                log.warning(
                    'step %d: the readings of axis %s at rest lie %.2f deg apart; it is flagged "unsteady"',
                    step.index, name, apart_deg,
                )  # fmt: skip
                return True
        return False

    def _band(self, step: Step, seen: View, target: Target, band: Band, files: Files) -> tuple[float, float]:
        """Meter and measure one band: its level for one second, and the level of the last full frame."""
        description, rig = self._description, self._rig
        region: Roi = roi(description, seen, target, band.channel)
        for side, state, azimuth in settings(description, seen, target, band.polarisation):
            self._polarisers[side].select(state, azimuth)
        rig.light.select(band.alone)
        if not self._lit:
            rig.light.on()
            self._lit = True
        found = exposure.meter(description, self._capture, region.of, self._expected(step, band))
        slug, level = self._names[band.name], 0.0
        if description.acquisition.u_rel_target is None:
            exposures = [found.exposure_s] * self._frames(step)
            exposures += [exposure.shorter(description, found.exposure_s)] * (step.kind == "point")
        else:
            least = description.reference.frames if step.kind == "reference" else exposure.FEWEST
            exposures = list(exposure.bracket(description, found, region.of, least))
            files.count += len(exposures)
        for exposure_s in exposures:
            frame = self._capture(exposure_s)
            if exposure_s >= found.exposure_s:
                level = exposure.level(description.camera, frame, region.of)
            files.keep(frame, slug, band.name, lamp=True)
        return found.level_per_s, level

    def _before(self, step: Step, band: Band) -> StepRecord | None:
        """The last point before a step in the schedule that has frames of a band."""
        at = bisect_left(self._done.numbers, step.index)
        for k in range(at - 1, -1, -1):
            if self._last is not None and self._last.step > self._done.numbers[k]:
                break
            record = self._done[k]
            if record.kind == "point" and any(frame.band == band.name for frame in record.frames):
                return record
        return self._last

    def _expected(self, step: Step, band: Band) -> float:
        """The level for one second that a step is expected to have; the same however often the run was interrupted.

        That of the point before it in the schedule, by the exposure that it was measured with; where there is none,
        that of a white surface, by the first visit to the reference. A visit after this step is none: a step that is
        taken again starts from what it started from.
        """
        description, name = self._description, band.name
        straight = description.reference.how == "beam"
        before = self._before(step, band) if step.kind == "point" else None
        reference = self._reference if self._reference is not None and self._reference.step < step.index else None
        guide = before or (None if straight and step.kind == "point" else reference)
        levels = (guide.level_per_s if guide is not None else None) or {}
        if before is not None and (description.acquisition.u_rel_target is None or name not in levels):
            exposure_s = max(frame.exposure_s for frame in before.frames if frame.band == name)
            levels = {name: description.acquisition.exposure_target / exposure_s}
        if guide is None or name not in levels:
            if straight and step.kind != "point":
                return exposure.expected_straight_level_per_s(description)
            return exposure.expected_level_per_s(description, step.pose, 1.0)
        ratio = exposure.cosine_of_incidence(step.pose) / exposure.cosine_of_incidence(guide.goal)
        return max(float(levels[name]), 1e-6) * ratio

    def _taken(
        self,
        step: Step,
        goal: Pose,
        readback: _Readback,
        flag: str = "",
        files: Files | None = None,
        level: float = 0.0,
        after: _Readback | None = None,
        levels_per_s: dict[str, float] | None = None,
    ) -> _Taken:
        frames = tuple(files.frames) if files is not None else ()
        record = StepRecord(
            step=step.index, kind=step.kind, point=step.point, goal=goal, flag=flag, frames=frames,
            time_s=frames[0].time_s if frames else self._rig.time_s(),
            pose=readback.pose, pose_time_s=readback.time_s, pose_spread=readback.spread,
            pose_after=after.pose if after is not None else None,
            pose_after_time_s=after.time_s if after is not None else None,
            level_per_s=levels_per_s, health=self._health(),
        )  # fmt: skip
        if files is not None:
            files.close(record)
        if step.point is not None and step.point >= len(self._angles):  # chosen since
            self._angles = self._run.points.angles_deg
        angles = None if step.point is None else tuple(map(float, self._angles[step.point]))
        live = Live(step, angles, level, max((frame.exposure_s for frame in frames), default=0.0), flag, record)  # type: ignore[arg-type]
        return _Taken(record, files.written if files is not None else [], live)

    def _present(self, target: Target) -> None:
        if target != self._target:
            if self._stop.requested and not self._rig.repeatable:
                raise Interrupted("stopped")  # rather than ask a person to put something there
            with self._progress.paused():
                self._rig.present(target)
            self._target = target

    def _darken(self) -> None:
        self._rig.light.off()
        self._lit = False
