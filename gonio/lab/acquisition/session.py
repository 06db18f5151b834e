"""One session at the rig: the state of lamp and target, and the last frame, which comes while the arms go on.

docs/acquisition.md, "Moves beside a read-out", has the rules.
"""

import contextlib
import logging
import math
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

from gonio.errors import DeviceError, Disturbed, GonioError, Interrupted, PassingFault
from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.commits import Commits, Taken
from gonio.lab.acquisition.frame_writer import Files, slugs
from gonio.lab.acquisition.progress import Live, Progress, Stop
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.shots import Shots
from gonio.lab.acquisition.waits import Cause, Holding, Suspended, Watch, alive, require
from gonio.lab.rig import Arrived, Exposed, Frame, Pose, Reading, Rig, Step, Target
from gonio.lab.rig.kinematics import View, left_its_side, view
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.motion_planning import Blocked, route
from gonio.lab.rig.polariser_axes import opened, settings
from gonio.lab.rig.regions import Roi, roi

log = logging.getLogger("gonio.devices")
ATTEMPTS = 3
"""How often a step is taken whose arms do not stand still."""
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
class _Exposed:
    """A step whose exposures are over; its last frame may be on its way."""

    step: Step
    done: Callable[[bool], Taken]
    """Waits for that frame, and closes the step; told whether the arms have gone on meanwhile."""
    before_s: float
    """`Shots.last_s` before the step."""

    def wait(self) -> None:
        """Wait for the frame now."""
        taken = self.done(False)
        self.done = lambda moved: taken


class _NotCome(Exception):
    """The last frame of the step before has not come: it is taken again, and then this one from its beginning."""

    def __init__(self, before: _Exposed, fault: PassingFault) -> None:
        super().__init__(str(fault))
        self.before, self.fault = before, fault


class _Session:
    """One session at the rig: the state of lamp and target, and the frames that wait for camera and disk."""

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
        self._polarisers = opened(rig)
        self._commits = Commits(run, progress)
        self._holding = Holding(run, progress, stop, rig.time_s, self._darken, lambda: require(rig))
        self._names = slugs(run.bands)
        self._done = run.steps()
        self._last: StepRecord | None = None
        """The last point of this session that has frames."""
        self._reference = next((s for s in self._done if s.kind == "reference" and not s.flag), None)
        self._angles = run.points.angles_deg
        last_s = -math.inf
        if not rig.repeatable and self._done:
            latest = self._done.latest()
            last_s = max((float(frame.time_s) for frame in latest.frames), default=float(latest.time_s))
        self._shots = Shots(rig, last_s)
        self._exposed_step: _Exposed | None = None
        """The step before, while its last frame is on its way."""
        self._failed = 0
        """How often such a frame has not come."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._commits.close()

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
        self._exposed_step = self._undisturbed(step)
        if not self._shots.coming:
            self._settle()

    def _collect(self, *, moved: bool = False) -> None:
        """Wait for the last frame of the step before, and let that step wait for the disk; raises `_NotCome`.

        `moved`: the arms have gone on meanwhile.
        """
        if self._exposed_step is None:
            return
        before, self._exposed_step = self._exposed_step, None
        try:
            self._keep(before.done(moved))
        except PassingFault as fault:
            raise _NotCome(before, fault) from None
        except DeviceError as error:
            if moved:
                error.args = (f"step {before.step.index}, which was read out during the next move: {error}",)
            raise

    def _settle(self) -> None:
        """`_collect` between steps."""
        try:
            self._collect()
        except _NotCome as lost:
            self._take_again(lost)

    def _take_again(self, lost: _NotCome) -> None:
        """Take a step again whose last frame did not come, and wait for that frame this time."""
        step, lit = lost.before.step, self._lit
        self._failed += 1
        if self._failed == ATTEMPTS:
            log.warning("%d frames did not come that were read out during a move: moves wait from here on", ATTEMPTS)
        self.finish()
        self._holding.after(lost.fault, step, 1)
        if self._rig.repeatable:
            self._shots.last_s = lost.before.before_s
        if lit:
            self._after_darkness(step)
        self._keep(self._undisturbed(step, faults=1).done(False))

    def _keep(self, taken: Taken) -> None:
        """Let a step that was taken whole wait for the disk, and be what the next ones start from."""
        record = taken.record
        if record.kind == "reference" and not record.flag:
            self._reference = min(self._reference or record, record, key=lambda record: record.step)
        if record.kind == "point" and record.frames:
            self._last = record
        self._commits.add(taken)

    def _undisturbed(self, step: Step, faults: int = 0) -> _Exposed:
        """A step during which no rule of `[suspend]` was broken; one that was is waited for, and the step taken again.

        What happened to the lamp meanwhile nobody knows: on a laboratory rig a point is preceded by a visit to the
        reference then, unless that would need a person. After `faults` of its camera or lamp its last frame is waited
        for here.
        """
        while True:
            self._shots.step = step.index
            before_s, resumed, lit = self._shots.last_s, self._shots.resumed, self._lit
            if self._rig.repeatable:
                self._shots.forget()
            try:
                alive(self._rig)
                self._rig.begin(step)
                exposed = self._dark(step) if step.kind == "dark" else self._lit_step(step)
                if faults:
                    exposed.wait()
                return exposed
            except _NotCome as lost:
                self._take_again(lost)
                continue
            except Suspended as suspended:
                self._shots.drop()
                self._wait(step, suspended.causes)
                lit = True
            except PassingFault as fault:
                self._shots.drop()
                faults += 1
                self.finish()
                self._holding.after(fault, step, faults)
                lit = lit or self._lit
            if self._rig.repeatable:
                self._shots.last_s, self._shots.resumed = before_s, resumed
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
        self._settle()
        self._commits.finish()

    def leave(self) -> None:
        """The same where the run ends early: a frame is waited for in the dark, and not taken again."""
        if self._exposed_step is not None:
            step = self._exposed_step.step.index
            with contextlib.suppress(GonioError):  # leaving the rig darkens it in any case
                self._darken()
            try:
                self._collect()
            except (_NotCome, DeviceError) as error:
                log.warning("step %d: %s; it is not in this run yet", step, error)
        self._commits.finish()

    def _dark(self, step: Step) -> _Exposed:
        before_s = self._shots.last_s
        self._collect()
        self._darken()
        number = self._description.acquisition.dark_frames
        exposures = [t for t in exposure.dark_exposures_s(self._description) for _ in range(number)]
        files = Files(self._commits.store, step, self._run.key, len(exposures))
        for exposure_s in exposures[:-1]:
            files.keep(self._capture(exposure_s), "dark", "", lamp=False)
        last = self._expose(exposures[-1])
        readback = self._readback()
        health = self._health()

        def done(moved: bool) -> Taken:
            files.keep(last.result(), "dark", "", lamp=False)
            return self._taken(step, readback, "", health, files, moved=moved)

        return _Exposed(step, done, before_s)

    def _lit_step(self, step: Step) -> _Exposed:
        target: Target = "reference" if step.kind == "reference" else "sample"
        self._present(target)
        before_s = self._shots.last_s
        for attempt in range(1, ATTEMPTS + 1):
            try:
                return _Exposed(step, self._exposed(step, target), before_s)
            except Disturbed as disturbed:
                self._shots.drop()
                self._shots.last_s = before_s
                then = "it is taken again" if attempt < ATTEMPTS else 'it is flagged "moved"'
                log.warning("step %d: %s; %s", step.index, disturbed, then)
        return _Exposed(step, self._without_frames(step, self._readback(), "moved"), before_s)

    def _exposed(self, step: Step, target: Target) -> Callable[[bool], Taken]:
        """Move, and take the frames of every band, the last of which may come later: as `_Exposed.done`.

        Raises `Disturbed` where an axis did not stand still meanwhile.
        """
        try:
            pose = self._move(step.pose)
        except Blocked as blocked:
            self._collect()
            log.warning("step %d: blocked: %s", step.index, blocked)
            return self._without_frames(step, self._readback(), "blocked")
        readback = _Readback(pose, self._rig.time_s(), getattr(self._rig.arms, "spread", None))
        self._collect(moved=True)
        seen = view(self._description, pose)
        straight = target == "reference" and self._description.reference.how == "beam"
        if not straight and left_its_side(self._description, step.pose, pose):
            return self._without_frames(step, readback, "below_horizon")
        levels, brightest = {}, 0.0
        planned = self._description.acquisition.u_rel_target is not None  # then each band says how many it has
        count = 0 if planned else len(self._run.bands) * (self._frames(step) + (step.kind == "point"))
        files = Files(self._commits.store, step, self._run.key, count, readback.pose, readback.time_s)
        for band in self._run.bands:
            levels[band.name], last = self._band(step, seen, target, band, files)
            if band is not self._run.bands[-1]:
                brightest = max(brightest, last())
        after = self._readback()
        for name, still_deg in self._still_deg.items():
            way_deg = math.degrees(abs(getattr(after.pose, name) - getattr(pose, name)))
            if way_deg > still_deg:
                raise Disturbed(f"axis {name} has moved by {way_deg:.2f} deg during the exposures")
        flag = "unsteady" if step.kind == "point" and self._unsteady(step, readback.spread) else ""
        health = self._health()

        def done(moved: bool) -> Taken:
            level = max(brightest, last())
            return self._taken(step, readback, flag, health, files, level, after, levels, moved=moved)

        return done

    def _without_frames(self, step: Step, readback: _Readback, flag: str) -> Callable[[bool], Taken]:
        """A step that is flagged, as `_Exposed.done`."""
        taken = self._taken(step, readback, flag, self._health())
        return lambda moved: taken

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
        return self._shots.capture(exposure_s, lit=self._lit)

    def _expose(self, exposure_s: float) -> Exposed:
        """The same of the last frame before the arms go on; the light in the room is looked at while they stand."""
        if self._watch.room_light or self._failed >= ATTEMPTS:
            return Arrived(self._capture(exposure_s))
        return self._shots.expose(exposure_s, lit=self._lit)

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

    def _band(
        self, step: Step, seen: View, target: Target, band: Band, files: Files
    ) -> tuple[float, Callable[[], float]]:
        """Meter and measure one band: its level for one second, and what waits for the last frame.

        That gives the level of the last full frame.
        """
        description, rig = self._description, self._rig
        region: Roi = roi(description, seen, target, band.channel)
        for side, state, azimuth in settings(description, seen, target, band.polarisation):
            self._polarisers[side].select(state, azimuth)
        rig.light.select(band.alone)
        if not self._lit:
            rig.light.on()
            self._lit = True
        found = exposure.meter(description, self._capture, region.of, self._expected(step, band))
        if step.kind == "reference":
            exposure.require_in_scale(description, found)
        slug, level = self._names[band.name], 0.0
        if description.acquisition.u_rel_target is None:
            exposures = [found.exposure_s] * self._frames(step)
            exposures += [exposure.shorter(description, found.exposure_s)] * (step.kind == "point")
        else:
            least = description.reference.frames if step.kind == "reference" else exposure.FEWEST
            exposures = list(exposure.bracket(description, found, region.of, least))
            files.count += len(exposures)

        def keep(frame: Frame, exposure_s: float) -> float:
            files.keep(frame, slug, band.name, lamp=True)
            full = exposure_s >= found.exposure_s
            return exposure.level(description.camera, frame, region.of) if full else level

        for exposure_s in exposures[:-1]:
            level = keep(self._capture(exposure_s), exposure_s)
        final = band is self._run.bands[-1]
        last = self._expose(exposures[-1]) if final else Arrived(self._capture(exposures[-1]))
        return found.level_per_s, lambda: keep(last.result(), exposures[-1])

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
        self, step: Step, readback: _Readback, flag: str, health: tuple[Reading, ...], files: Files | None = None,
        level: float = 0.0, after: _Readback | None = None, levels_per_s: dict[str, float] | None = None,
        *, moved: bool = False,
    ) -> Taken:  # fmt: skip
        frames = tuple(files.frames) if files is not None else ()
        record = StepRecord(
            step=step.index, kind=step.kind, point=step.point, flag=flag, frames=frames,
            goal=readback.pose if step.kind == "dark" else step.pose,
            time_s=frames[0].time_s if frames else self._rig.time_s(),
            pose=readback.pose, pose_time_s=readback.time_s, pose_spread=readback.spread,
            pose_after=after.pose if after is not None else None,
            pose_after_time_s=after.time_s if after is not None else None,
            level_per_s=levels_per_s, health=health, overlapped=moved,
        )  # fmt: skip
        if files is not None:
            files.close(record)
        if step.point is not None and step.point >= len(self._angles):  # chosen since
            self._angles = self._run.points.angles_deg
        angles = None if step.point is None else tuple(map(float, self._angles[step.point]))
        live = Live(step, angles, level, max((frame.exposure_s for frame in frames), default=0.0), flag, record)  # type: ignore[arg-type]
        return Taken(record, files.written if files is not None else [], live)

    def _present(self, target: Target) -> None:
        if target != self._target:
            if self._stop.requested and not self._rig.repeatable:
                raise Interrupted("stopped")  # rather than ask a person to put something there
            if self._description.reference.how in ("swap", "beam"):
                self._collect()  # nobody is asked while a frame may have to be taken again
            with self._progress.paused():
                self._rig.present(target)
            self._target = target

    def _darken(self) -> None:
        self._rig.light.off()
        self._lit = False
