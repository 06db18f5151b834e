"""The axes of a goniometer, turned by motorised stages whose controllers plan the motion themselves.

Policy, for the stages of all drivers. Nothing turns when the rig is opened, unless the rig file lets a stage look for
its home. Every axis arrives from one side, so that backlash lies there, and never beyond a limit. A move ends when
every axis stands still within the tolerance; what does not land stops every axis. The readback is what is returned,
never the goal.
"""

from __future__ import annotations

import contextlib
import logging
import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from gonio.errors import ConfigError, DeviceError, Disturbed, GonioError
from gonio.rig import Health, Pose, Reading, Target, clock, motion_planning
from gonio.rig.description import RigDescription
from gonio_drivers import settings, stages
from gonio_drivers.any_arms import Arms, ArmsReading
from gonio_drivers.patience import Patience
from gonio_drivers.stages import Joint

log = logging.getLogger("gonio.devices")

STILL_DEG = 0.01
"""Readings this close, or two steps of the encoder, are the same place."""
FAR_DEG = 2.0
"""An axis that is this far from where it landed was not just pushed a little."""
LOOKS = 5
"""Readings that tell where an axis stands."""
POLL_S = 0.01
RESTING_LOOKS = 3
"""A stage that stands at its goal at so many looks has landed."""
IDLE_S = 0.5
"""A stage that has not started by then has not heard."""
STALL_S = 3.0
"""A stage that says that it moves, and does not turn for this long, is stuck."""
TRIES = 3
SLOWEST = 3.0
"""A way may take this many times what the speed of the rig file needs."""
SPARE_S = 10.0
HOMING_S = 180.0
"""A turn at 2 deg/s: stages look for their home at a speed of their own."""


@dataclass(slots=True)
class Way:
    """How far an axis has come on its way."""

    goal_deg: float
    since_s: float = 0.0
    """When it last moved, or said so."""
    turned_s: float = 0.0
    """When it was last seen at another place."""
    looks: int = 0
    """At it, since it last moved or said so."""
    at_deg: float = math.nan
    tries: int = 1


class StageArms(Arms[Joint]):
    """All axes of a rig, as an `ArmsDevice`: a stage holds by its gear and motor, whether its port is open or not.

    Parameters
    ----------
    description
        The rig: limits, zero offsets, speeds, the way of approach.
    table
        Which stage turns which axis.

    Raises
    ------
    ConfigError
        Stages and axes do not belong together, or a key of a stage is wrong.
    """

    unparked = "not parked, and where it stands is not known"

    def __init__(self, description: RigDescription, table: settings.Stages) -> None:
        settings.check_stages(table, description)
        self._settings = table
        limits, approach, stops = description.limits_deg(), description.approach_deg(), description.hard_stops_deg()
        every: dict[str, Joint] = {}
        for name, axis in description.axes().items():
            stage = stages.build(table.driver, table.axes[name], f"devices.stages.axes.{name}")  # type: ignore[index]
            offset = axis.zero_offset_deg if axis.zero_offset_known else 0.0
            still = max(STILL_DEG, 2 * axis.encoder_step_deg)
            every[name] = Joint(
                name, stage, limits[name], axis.speed_deg_per_s, offset, still,
                approach_deg=approach[name], backlash_deg=axis.backlash_deg, hard_stops_deg=stops[name],
            )  # fmt: skip
        super().__init__(description, every)
        park = {n: j.park_deg for n, j in every.items() if j.park_deg is not None}
        motion_planning.require_parking(description, park, "devices.stages.axes.{}.park_deg")
        self._stack = contextlib.ExitStack()

    # ---- opening and leaving ----

    def __enter__(self) -> Self:
        self.faulted = False
        self.absent, self.joints = {}, {}
        with contextlib.ExitStack() as stack:
            for name, joint in self.every.items():
                try:
                    with contextlib.ExitStack() as one:
                        one.enter_context(joint.stage)
                        self._prepare(joint)
                        stack.push(one.pop_all())
                    self.joints[name] = joint
                except DeviceError as failure:
                    if not self.partial:
                        raise
                    self.absent[name] = failure
            if not self.joints:
                raise DeviceError("no stage of the rig file can be used: " + "; ".join(map(str, self.absent.values())))
            self._readback()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)
        self.joints = {}

    def _prepare(self, joint: Joint) -> None:
        """See that a stage is well and stands still, give it its speed, and let it find its home where it may."""
        joint.stood_at = None
        said = joint.state()
        if said.moving:
            raise DeviceError(f"axis {joint.name}: {joint.stage} is turning already; end what moves it, then try again")
        if not said.homed and joint.stage.axis.home == "on-opening":
            self._home(joint)
            said = joint.state()
        joint.require_home(said)
        joint.require_between_stops()
        joint.stage.prepare(joint.speed_deg_per_s, self._settings.acceleration_deg_per_s2)

    def _home(self, joint: Joint) -> None:
        log.warning("axis %s looks for its home", joint.name)
        looked, idle = Patience(), 0.0
        try:
            joint.stage.home()
            while not (said := joint.state()).homed or said.moving:
                now = looked()
                idle = now if said.moving else idle
                if now - idle > STALL_S or now > HOMING_S:
                    raise DeviceError(f"axis {joint.name}: {joint.stage} does not find its home")
                clock.sleep(POLL_S)
        except BaseException:
            self._halt(joint)
            raise

    # ---- ArmsDevice ----

    def read(self) -> Pose:
        """The readback, now [rad]; `last` keeps it with its time."""
        self._require_all()
        return self._readback().pose

    def stop(self) -> None:
        """Stop every axis where it is. Never raises."""
        self.stopped = True
        for joint in self.joints.values():
            joint.stood_at = None
            self._halt(joint)

    def change(self, target: Target) -> None:
        """Refused: no stage changes the sample."""
        raise ConfigError('reference.how = "axis" needs a changer, which devices.stages does not have')

    def still(self) -> None:
        """Raise where an axis has left the place where it landed.

        Raises
        ------
        Disturbed
            It was moved by a little; another `move` brings it back.
        DeviceError
            It is far from its place, or its stage is unwell or was switched off; every axis has been stopped.
        """
        disturbed = ""
        for name, joint in self.joints.items():
            try:
                here = joint.angle_deg()
            except DeviceError as failure:
                self._fail(str(failure))
            if joint.stood_at is None or abs(here - joint.stood_at) <= joint.still_deg:
                continue
            disturbed = f"axis {name} has moved by itself, from {joint.stood_at:.3f} to {here:.3f} deg"
            if abs(here - joint.stood_at) > FAR_DEG:
                self._fail(f"{disturbed}; all axes are stopped")
            joint.stood_at = None
        if disturbed:
            raise Disturbed(disturbed)

    # ---- what they say of themselves ----

    def health(self) -> Health:
        """Angles and states of the axes that are open; `DeviceError` where a stage does not answer."""
        found: list[Reading] = []
        for joint in self.joints.values():
            found += stages.readings(joint, joint.stage.state())
        return Health(tuple(found), {name: str(failure) for name, failure in self.absent.items()})

    def survey(self) -> Health:
        """The same of stages that nobody has opened, each by itself; nothing turns."""
        found: list[Reading] = []
        silent: dict[str, str] = {}
        for name, joint in self.every.items():
            try:
                with joint.stage:
                    found += stages.readings(joint, joint.stage.state())
            except GonioError as failure:
                silent[name] = str(failure)
        return Health(tuple(found), silent)

    # ---- inside ----

    def _drive(self, goals: Mapping[str, float], *, parking: bool) -> Pose:
        starts = {}
        for name, goal in goals.items():
            joint = self.joints[name]
            joint.stood_at = None
            start = joint.approach_start(goal)
            beyond = joint.angle_deg() - start
            if math.copysign(beyond, beyond * joint.approach_deg) > joint.still_deg and joint.approach_deg:
                starts[name] = start
            if not parking:
                joint.warn_of_play(goal)
        tolerance = self._settings.tolerance_deg
        self._arrive(starts, {n: max(tolerance, abs(self.joints[n].approach_deg) / 2) for n in starts})
        self._arrive(goals, dict.fromkeys(goals, tolerance))
        for name in goals:
            joint = self.joints[name]
            joint.stood_at = statistics.fmean(joint.angle_deg() for _ in range(LOOKS))
        return self._readback().pose

    def _arrive(self, goals: Mapping[str, float], within_deg: Mapping[str, float]) -> None:
        """Drive axes to goals [deg], all at once; return when each stands still within its distance of its goal."""
        looked = Patience()
        ways = {name: Way(goal) for name, goal in goals.items()}
        longest = 0.0
        for name, goal in goals.items():
            joint = self.joints[name]
            longest = max(longest, abs(goal - joint.angle_deg()) / joint.speed_deg_per_s)
            joint.stage.go(joint.to_readout(goal))
        while ways:
            self.allowed()
            now = looked()
            for name, way in list(ways.items()):
                if self._landed(self.joints[name], way, within_deg[name], now):
                    del ways[name]
            if ways and now > SLOWEST * longest + SPARE_S:
                raise DeviceError(f"axis {next(iter(ways))} does not come to rest; all axes are stopped")
            if ways:
                clock.sleep(POLL_S)

    def _landed(self, joint: Joint, way: Way, within_deg: float, now: float) -> bool:
        said = joint.state()
        joint.require_home(said)
        here = joint.to_deg(said.position_deg)
        way.looks += 1
        if not abs(here - way.at_deg) <= joint.still_deg:
            way.at_deg, way.turned_s, way.since_s, way.looks = here, now, now, 1
        if said.moving:
            way.since_s, way.looks = now, 0
            if now - way.turned_s > STALL_S:
                raise DeviceError(f"axis {joint.name} is stuck at {here:.2f} deg, on its way to {way.goal_deg:g} deg")
            return False
        if abs(here - way.goal_deg) <= within_deg:
            return now - way.since_s >= self._settings.settle_s and way.looks >= RESTING_LOOKS
        if now - way.since_s < max(IDLE_S, self._settings.settle_s):
            return False
        if way.tries == TRIES:
            raise DeviceError(
                f"axis {joint.name} stands at {here:.2f} deg, {here - way.goal_deg:+.2f} deg from its goal, and does "
                f"not go on ({joint.stage}); is something in its way?"
            )
        way.tries += 1
        way.since_s = way.turned_s = now
        log.warning("axis %s rests %+.2f deg from its goal; it is sent again", joint.name, here - way.goal_deg)
        joint.stage.go(joint.to_readout(way.goal_deg))
        return False

    def _readback(self, looks: int = 1) -> ArmsReading:
        before = clock.monotonic()
        angles = {name: joint.angle_deg() for name, joint in self.joints.items()}
        pose = Pose(**{name: math.radians(angle) for name, angle in angles.items()})
        self.last = ArmsReading(pose, (before + clock.monotonic()) / 2)
        return self.last

    @staticmethod
    def _halt(joint: Joint) -> None:
        try:
            joint.stage.stop()
        except GonioError as failure:
            log.error("stopping %s: %s", joint.name, failure)
