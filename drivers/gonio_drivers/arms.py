"""The axes of a goniometer, turned by Dynamixel servos in Position mode.

Policy. Nothing turns when the rig is opened: every servo's goal is set to where it stands before its torque comes on,
with a profile velocity and acceleration. Every axis arrives from one side, so that backlash lies on one side; none is
sent beyond a limit, on the way either. A move ends when every axis has *landed*: the servo reports no motion, stands
within the tolerance, and has stood still for the settle time. An axis that friction stops short gets a corrected goal.
What does not land stops every axis. The encoder's readback is what is returned, never the goal: the mean of several
readings, since encoders flicker.
"""

from __future__ import annotations

import logging
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import TracebackType
from typing import NoReturn, Self

from gonio.errors import ConfigError, DeviceError, Disturbed
from gonio.rig import Pose, Target, clock, motion_planning
from gonio.rig.description import RigDescription
from gonio_drivers import joints, presence, settings, signals, watchdog
from gonio_drivers.arrival import LARGEST_CORRECTION_DEG, STILL_COUNTS
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint
from gonio_drivers.motion import Motion

log = logging.getLogger("gonio.devices")

AXES = tuple(field.name for field in fields(Pose))
LOOKS, SECOND_LOOKS = 5, 9
"""Readings whose mean tells where an axis stands, and whether it has left the place where it landed."""
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Reading:
    """Positions of the axes and when they were read, in seconds of `time.monotonic`."""

    pose: Pose
    time_s: float
    counts: Mapping[str, float] = field(default_factory=dict)
    spread: Pose = field(default_factory=Pose)
    """Of several readings, the largest less the smallest [rad]."""


class ServoArms:
    """All axes of a rig, as an `ArmsDevice`.

    Parameters
    ----------
    description
        The rig: limits, zero offsets, speeds, the way of approach.
    servos
        Which servo turns which axis.

    Raises
    ------
    ConfigError
        Servos and axes do not belong together, or a limit is beyond a servo's turn.
    """

    def __init__(self, description: RigDescription, servos: settings.Servos) -> None:
        settings.check_axes(servos, description)
        self._servos, self._description = servos, description
        self.bus = Bus(servos.port, servos.baud)
        self.joints = {
            name: joints.joint(self.bus, description, name, servos.axes[name])  # type: ignore[index]
            for name in description.axes()
        }
        if servos.changer is not None:
            self.joints["changer"] = joints.changer_joint(
                self.bus, servos.changer, description.acquisition.approach_deg
            )
        for joint in self.joints.values():
            joint.check_acceleration(servos.acceleration_deg_per_s2)
        park: dict[str, float] = {n: axis.park_deg for n, axis in servos.axes.items() if axis.park_deg is not None}
        motion_planning.require_parking(description, park, "devices.servos.axes.{}.park_deg")
        self._motion = Motion(self.bus, self.joints, servos)
        self.last: Reading | None = None
        self.faulted = False
        """An axis has failed: nothing moves any more until the rig is opened again."""
        self.stopped = False
        """Somebody has called `stop` since the last move."""
        self.partial = False
        """Open those axes whose servos answer and are well; without it, all or none."""
        self.holds = self._servos.on_exit == "hold"
        """The torque stays on when this is left."""
        self.as_found = False
        """Every servo is left with its torque on or off as it was found when this was entered."""
        self.absent: dict[str, DeviceError] = {}
        """Axes that could not be opened (`partial`), and why; they are missing from `joints`."""
        self.every = dict(self.joints)
        """All axes of the rig file, `absent` ones too."""
        self.deaf = False
        """At the last `stop` no servo was heard: nobody knows whether it was."""

    @property
    def allowed(self) -> Callable[[], None]:
        """Called before axes move, and at every look while they do; raises where nothing may move."""
        return self._motion.allowed

    @allowed.setter
    def allowed(self, require: Callable[[], None]) -> None:
        self._motion.allowed = require

    # ---- opening and leaving ----

    def __enter__(self) -> Self:
        self.bus.__enter__()
        try:
            self.joints.clear()
            self.joints.update(self.every)
            self.absent = presence.leave_out(self.bus, self.joints) if self.partial else {}
            for joint in self.joints.values() if not self.partial else ():
                joint.identify()
                presence.require_alone(joint)
            for name, joint in list(self.joints.items()):
                try:
                    joint.prepare(self._servos.acceleration_deg_per_s2)
                except DeviceError as failure:
                    if not self.partial or len(self.joints) == 1:
                        raise
                    self.absent[name] = failure
                    del self.joints[name]
            self._readback()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            failures = self._let_go() if self.as_found or not self.holds else []
        finally:
            self.bus.__exit__(kind, error, trace)
        if failures and error is None and not self.faulted:
            raise failures[0]
        for said in dict.fromkeys(map(str, failures)):  # a port that went away says the same for every axis
            log.error("while leaving: %s", said)

    def _let_go(self) -> list[DeviceError]:
        """Take the torque from every servo that has been prepared (that had none, for `as_found`); what failed."""
        failures = []
        for joint in self.joints.values():
            if joint.profile and not (self.as_found and joint.held):
                try:
                    joint.write("Torque Enable", 0)
                except DeviceError as failure:
                    failures.append(failure)
        return failures

    # ---- ArmsDevice ----

    def move(self, goal: Pose) -> Pose:
        """Drive every axis to `goal`, from its side, wait until all have landed; the encoders' readback [rad].

        Raises
        ------
        ConfigError
            A goal is beyond a limit, or the rig has no such axis; nothing has moved.
        DeviceError
            An axis does not land, or a servo is unwell; every axis has been stopped.
        """
        self._require_all()
        return self._move(self._checked(goal))

    def jog(self, goals: Mapping[str, float]) -> dict[str, float]:
        """Drive some axes [rad], and leave the others where they are; the readback of those [rad]; errors of `move`."""
        return self._jog(goals)

    def _jog(self, goals: Mapping[str, float], *, resting: bool = False) -> dict[str, float]:
        for name in goals:
            if name in self.absent:
                raise DeviceError(f"axis {name} cannot be moved: {self.absent[name]}")
            if name not in AXES or name not in self.joints:
                known = ", ".join(n for n in self.every if n in AXES)
                raise ConfigError(f"the rig has no axis {name}; it has {known}")
        landed = self._move(self._checked(Pose(**goals), tuple(goals)), resting=resting)
        return {name: float(getattr(landed, name)) for name in goals}

    def _require_all(self) -> None:
        """Raise where an axis is absent: what it would be said to read, or to do, would not be true."""
        for name, failure in self.absent.items():
            raise DeviceError(f"axis {name} is missing: {failure}")

    def _move(self, goals: Mapping[str, float], *, resting: bool = False) -> Pose:
        if self.faulted:
            raise DeviceError("the arms have been stopped after a failure; open the rig again")
        self.stopped = False
        try:
            self.allowed()
            self._motion.approach(goals)
            read = self._readback(LOOKS)
            for name, count in read.counts.items():
                self.joints[name].stood_at = count
            for name, goal in goals.items() if not resting else ():
                self.joints[name].warn_of_play(goal)
            return read.pose
        except DeviceError:
            self.stop()
            self.faulted = True
            raise
        except BaseException:
            self.stop()
            raise

    def read(self) -> Pose:
        """The encoders' readback, now [rad]: the mean of several readings; `last` keeps it with its time."""
        self._require_all()
        return self._readback(LOOKS).pose

    def look(self) -> Reading:
        """One reading of every servo, as it is."""
        return self._readback()

    @property
    def spread(self) -> Pose:
        """By how much the readings differ whose mean `move` or `read` gave last: largest less smallest [rad]."""
        return self.last.spread if self.last is not None else Pose()

    def stop(self) -> None:
        """Stop every axis where it is: hold what answers, and take the torque from what does not. Never raises."""
        with signals.undisturbed():
            self._stop()

    def _stop(self) -> None:
        self.stopped = True
        silent = []
        try:
            watchdog.disarm(self.joints.values())
            self._freeze()
        except DeviceError as failure:
            log.error("stopping: %s", failure)
        for joint in self.joints.values():
            joint.landed_at = joint.stood_at = None
            try:
                here = joint.table["Present Position"]
                position = here.decode(self.bus.read(joint.id, here.address, here.size), here.address)
                joint.write("Goal Position", position)
            except DeviceError as failure:
                log.error("stopping %s: %s", joint.name, failure)
                silent.append(joint)
        self.deaf = len(silent) == len(self.joints)
        try:
            for joint in silent:
                torque = joint.table["Torque Enable"]
                self.bus.write_all(torque.address, {joint.id: b"\x00"})
        except DeviceError as failure:
            log.error("stopping: %s", failure)

    def _freeze(self) -> None:
        """Tell all servos that answer at once to stay where they are, before anybody waits for one that does not."""
        groups: dict[tuple[int, int], list[Joint]] = {}
        for joint in self.joints.values():
            item = joint.table["Present Position"]
            groups.setdefault((item.address, item.size), []).append(joint)
        for (address, size), group in groups.items():
            blocks = self.bus.glance([joint.id for joint in group], address, size)
            here = {j.name: j.table["Present Position"].decode(blocks[j.id], address) for j in group if j.id in blocks}
            if here:
                self._motion.send(here)

    def park(self) -> None:
        """Drive every axis that is there to its rest position.

        Raises
        ------
        DeviceError
            As of `move`; or axes are absent, and the others have been parked.
        """
        goals = dict.fromkeys((name for name in self.every if name in AXES), 0.0)
        goals |= {"light": self.every["light"].limits_deg[0], "camera": self.every["camera"].limits_deg[1]}
        goals |= {n: j.servo.park_deg for n, j in self.every.items() if n in AXES and j.servo.park_deg is not None}
        wanted = {name: math.radians(angle) for name, angle in goals.items() if name in self.joints}
        for leg in self._legs(wanted):
            self._jog(leg, resting=True)
        if self.absent:
            parked = ", ".join(name for name in goals if name in self.joints) or "no axis"
            why = "; ".join(f"{name}: {failure}" for name, failure in self.absent.items())
            raise DeviceError(f"parked: {parked}; not parked: {why}")

    def _legs(self, goals: dict[str, float]) -> list[dict[str, float]]:
        """What to move one after the other, so that no bodies touch; all at once where an axis is absent."""
        if not self._description.looks_ahead or self.absent:
            return [goals]
        return motion_planning.legs(self._description, self._readback().pose, goals)

    def change(self, target: Target) -> None:
        """Put sample or white reference into the beam, by the servo of the changer."""
        changer = self._servos.changer
        if changer is None:
            raise ConfigError("devices.servos.changer is missing: the rig has no servo that changes the sample")
        self._move({"changer": changer.sample_deg if target == "sample" else changer.reference_deg})

    def still(self) -> None:
        """Raise where an axis has left the place where it landed, or has let go of its torque.

        Raises
        ------
        Disturbed
            It was moved by a little (pushed, or sagged); another `move` brings it back.
        DeviceError
            It is far from its place, or its servo is unwell; every axis has been stopped.
        """
        reports = joints.reports(self.bus, self.joints.values())
        for name, report in reports.items():
            try:
                self.joints[name].keep_profile(report.profile)
            except DeviceError as failure:
                self._fail(str(failure))
        disturbed = ""
        places: Mapping[str, float] = {name: report.position for name, report in reports.items()}
        if self._strayed(places):  # or is it the encoder that flickers?
            places = self._readback(SECOND_LOOKS).counts
        for name, place in self._strayed(places).items():
            joint = self.joints[name]
            assert joint.stood_at is not None
            disturbed = (
                f"axis {name} has moved by itself, from {joint.to_deg(joint.stood_at):.2f} to "
                f"{joint.to_deg(place):.2f} deg"
            )
            if joint.distance_deg(joint.stood_at, place) > LARGEST_CORRECTION_DEG:
                self._fail(f"{disturbed}; all axes are stopped")
            joint.landed_at = joint.stood_at = None
        try:
            joints.require_torque(self.bus, self.joints.values())
        except DeviceError as failure:
            self._fail(str(failure))
        if disturbed:
            raise Disturbed(disturbed)

    def _strayed(self, places: Mapping[str, float]) -> dict[str, float]:
        """Those of these counts that are elsewhere than where their axes landed."""
        landed = {name: joint.stood_at for name, joint in self.joints.items() if joint.stood_at is not None}
        return {n: place for n, place in places.items() if n in landed and abs(place - landed[n]) > STILL_COUNTS}

    def _fail(self, message: str) -> NoReturn:
        self.stop()
        self.faulted = True
        raise DeviceError(message)

    # ---- moving ----

    def _checked(self, goal: Pose, names: Sequence[str] = AXES) -> dict[str, float]:
        """Goals [deg] by axis, or `ConfigError`."""
        out = {}
        for name in names:
            angle = math.degrees(getattr(goal, name))
            if not math.isfinite(angle):
                raise ConfigError(f"{name} = {angle}: a goal must be a finite angle")
            if name not in self.joints:
                if abs(angle) > ROUNDING:
                    known = ", ".join(self.joints)
                    raise ConfigError(f"{name} = {angle:g} deg: the rig has no such axis; it has {known}")
                continue
            lower, upper = self.joints[name].limits_deg
            if not lower - 1e-6 <= angle <= upper + 1e-6:
                raise ConfigError(f"{name} = {angle:g} deg is outside this axis's limits, {lower:g} to {upper:g} deg")
            out[name] = angle
        return out

    # ---- reading ----

    def _readback(self, looks: int = 1) -> Reading:
        """Where the axes stand: the mean of several readings."""
        before = clock.monotonic()
        seen = [joints.reports(self.bus, self.joints.values()) for _ in range(looks)]
        after = clock.monotonic()
        places = {name: [reports[name].position for reports in seen] for name in seen[0]}
        counts = {name: statistics.fmean(place) for name, place in places.items()}
        axes = {name: math.radians(self.joints[name].to_deg(count)) for name, count in counts.items() if name in AXES}
        spread = {n: math.radians(self.joints[n].distance_deg(max(places[n]), min(places[n]))) for n in axes}
        self.last = Reading(Pose(**axes), (before + after) / 2, counts, Pose(**spread))
        return self.last
