"""Axes of motorised stages, whose controllers plan the motion themselves; drivers are found by their names.

A driver is an entry point of the group `gonio.stages`, ours and others' alike: a callable `(table, key) -> stage`, of
the table of one axis in the rig file, and its name for messages. What it returns speaks for one axis, in degrees of the
stage's own readout; it touches no device before it is entered. docs/writing_a_driver.md shows one.

Policy, for the stages of all drivers. Nothing turns when the rig is opened, unless the rig file lets a stage look for
its home. Every axis arrives from one side, so that backlash lies there, and never beyond a limit. A move ends when
every axis stands still within the tolerance; what does not land stops every axis. The readback is what is returned,
never the goal.
"""

import contextlib
import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, Self

from gonio import plugins
from gonio.errors import ConfigError, DeviceError, Disturbed, GonioError
from gonio.lab.rig import Health, Pose, Reading, Target, clock
from gonio.lab.rig.description import RigDescription
from gonio_drivers import log, settings
from gonio_drivers.any_arms import AllAxes, AnyJoint, ArmsReading, axis_of
from gonio_drivers.patience import Patience

STILL_DEG = 0.01
"""Readings this close, or two steps of the encoder, are the same place."""
FAR_DEG = 2.0
"""An axis that is this far from where it landed was not just pushed a little."""
LOOKS = 5
"""Readings that tell where an axis stands."""
POLL_S = 0.01
RESTING_LOOKS = 3
"""Looks at which a stage must stand at its goal to have landed."""
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


@dataclass(frozen=True, slots=True)
class StageState:
    """What a stage says of itself."""

    position_deg: float
    """Angle in the stage's own readout, counted from its home."""
    moving: bool
    homed: bool
    """Its readout means something: it has found its home since it was switched on."""
    fault: str = ""
    """What it complains of, in words; "" where it is well."""


class Stage(contextlib.AbstractContextManager["Stage", None], Protocol):
    """One motorised axis, as the context in which it is open. Every method raises `DeviceError` where it fails.

    Entering opens the line and sees who is there; nothing turns by it.

    Angles are those of the stage's readout [deg]. A driver may have an attribute `absolute = True`: it needs no home.
    """

    @property
    def axis(self) -> settings.StageAxis:
        """Its table of the rig file."""

    def prepare(self, speed_deg_per_s: float, acceleration_deg_per_s2: float) -> None:
        """Set the motion's profile, and see that the stage has taken it; nothing turns."""

    def state(self) -> StageState:
        """What it says now; an answer to an earlier question is not good enough."""

    def go(self, position_deg: float) -> None:
        """Start a move to a readout, and return at once."""

    def home(self) -> None:
        """Start the search for home, and return at once."""

    def stop(self) -> None:
        """Come to rest at once, whatever it is doing."""


@dataclass(kw_only=True)
class StageJoint(AnyJoint):
    """An axis of the rig and its stage: angles, and what the stage's readout is there."""

    stage: Stage

    @property
    def key(self) -> str:
        """The table of the rig file that describes it."""
        return f"devices.stages.axes.{self.name}"

    @property
    def park_deg(self) -> float | None:
        """Where it rests, if the rig file says so."""
        return self.stage.axis.park_deg

    @property
    def still_deg(self) -> float:
        """Readings this close are the same place."""
        return max(STILL_DEG, 2 * self.axis.encoder_step_deg)

    @property
    def absolute(self) -> bool:
        """Its stage needs no home."""
        return getattr(self.stage, "absolute", False)

    def to_deg(self, readout_deg: float) -> float:
        """Angle of the axis, with the zero offset taken out."""
        return (readout_deg - self.stage.axis.zero_deg) * self.stage.axis.direction - self.offset_deg

    def go(self, angle_deg: float) -> None:
        """Send the stage to an angle of the axis, and return at once."""
        self.stage.go(self.stage.axis.zero_deg + (angle_deg + self.offset_deg) * self.stage.axis.direction)

    def approach_start(self, goal_deg: float) -> float:
        """Where the last part of the way to a goal begins [deg]; a limit is not crossed on the way either."""
        lower, upper = self.limits_deg
        return min(max(goal_deg - self.approach_deg, lower), upper)

    def run_up_deg(self, goal_deg: float) -> float:
        """How long the last part of its way to a goal is, inside its limits [deg]."""
        return abs(goal_deg - self.approach_start(goal_deg))

    def state(self) -> StageState:
        """What the stage says, where it is well; `DeviceError` where it is not."""
        said = self.stage.state()
        if said.fault:
            raise DeviceError(f"axis {self.name}: {self.stage} reports: {said.fault}; remove the cause")
        if not math.isfinite(said.position_deg):
            raise DeviceError(f"axis {self.name}: {self.stage} reads {said.position_deg}")
        return said

    def homed_state(self) -> StageState:
        """The same of a stage whose readout means something."""
        said = self.state()
        if not said.homed and not self.absolute:
            raise DeviceError(
                f"axis {self.name}: {self.stage} has not found its home since it was switched on, so that its readout "
                f'means nothing; clear its whole way and set {self.key}.home = "on-opening", or home it by the program '
                "of its maker"
            )
        return said

    def angle_deg(self) -> float:
        """Where it stands."""
        return self.to_deg(self.homed_state().position_deg)

    def readings(self) -> list[Reading]:
        """What is read of it; an angle only where the readout means one."""
        name, said = self.name, self.stage.state()
        known = said.homed or self.absolute
        angle = [Reading(name, "angle", self.to_deg(said.position_deg), "deg", self.limits_deg)] if known else []
        return [
            *angle,
            Reading(name, "motion", "moves" if said.moving else "still"),
            Reading(name, "home", "home found" if known else "home not found since it was switched on"),
            Reading(name, "error", said.fault or "none"),
        ]


@dataclass(slots=True)
class Travel:
    """How far an axis has come on its way."""

    goal_deg: float
    since_s: float = 0.0
    """When it last moved, or said so."""
    turned_s: float = 0.0
    """When it was last seen at another place."""
    looks: int = 0
    """Times that it was looked at since it last moved or said so."""
    at_deg: float = math.nan
    tries: int = 1


class StageArms(AllAxes[StageJoint]):
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
        settings.check_axes(table, description)
        self._settings = table
        every: dict[str, StageJoint] = {}
        for name in description.axes():
            key = f"devices.stages.axes.{name}"
            stage: Stage = plugins.load("gonio.stages", table.driver)(table.axes[name], key)  # type: ignore[index]
            every[name] = StageJoint(*axis_of(description, name), stage=stage)
        super().__init__(description, every, "devices.stages")
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

    def __exit__(self, *how: Any) -> None:
        self._stack.__exit__(*how)
        self.joints = {}

    def _prepare(self, joint: StageJoint) -> None:
        """See that a stage is well and stands still, give it its speed, and let it find its home where it may."""
        joint.stood_at = None
        said = joint.state()
        if said.moving:
            raise DeviceError(f"axis {joint.name}: {joint.stage} is turning already; end what moves it, then try again")
        if not said.homed and joint.stage.axis.home == "on-opening":
            self._home(joint)
        joint.require_between_stops(joint.angle_deg(), "zero_deg or direction")
        joint.stage.prepare(joint.axis.speed_deg_per_s, self._settings.acceleration_deg_per_s2)

    def _home(self, joint: StageJoint) -> None:
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
        found = [reading for joint in self.joints.values() for reading in joint.readings()]
        return Health(tuple(found), {name: str(failure) for name, failure in self.absent.items()})

    def survey(self) -> Health:
        """The same of stages that nobody has opened, each by itself; nothing turns."""
        found: list[Reading] = []
        silent: dict[str, str] = {}
        for name, joint in self.every.items():
            try:
                with joint.stage:
                    found += joint.readings()
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
                joint.warn_of_backlash(goal)
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
        ways = {name: Travel(goal) for name, goal in goals.items()}
        longest = 0.0
        for name, goal in goals.items():
            joint = self.joints[name]
            longest = max(longest, abs(goal - joint.angle_deg()) / joint.axis.speed_deg_per_s)
            joint.go(goal)
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

    def _landed(self, joint: StageJoint, way: Travel, within_deg: float, now: float) -> bool:
        said = joint.homed_state()
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
        joint.go(way.goal_deg)
        return False

    def _readback(self, looks: int = 1) -> ArmsReading:
        before = clock.monotonic()
        angles = {name: joint.angle_deg() for name, joint in self.joints.items()}
        pose = Pose(**{name: math.radians(angle) for name, angle in angles.items()})
        self.last = ArmsReading(pose, (before + clock.monotonic()) / 2)
        return self.last

    @staticmethod
    def _halt(joint: StageJoint) -> None:
        try:
            joint.stage.stop()
        except GonioError as failure:
            log.error("stopping %s: %s", joint.name, failure)
