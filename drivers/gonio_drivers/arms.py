"""The axes of a goniometer, turned by Dynamixel servos in Position mode.

Policy. Nothing turns when the rig is opened: every servo's goal is set to where it stands before its torque comes on,
with a profile velocity and acceleration. Every axis arrives from below, so that backlash lies on one side. A move ends
when every axis has *landed*: the servo reports no motion, stands within the tolerance, and has stood still for the
settle time. An axis that friction stops short gets a corrected goal. What does not land stops every axis. The encoder's
readback is what is returned, never the goal.
"""

from __future__ import annotations

import logging
import math
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import TracebackType
from typing import NoReturn, Self

from gonio.errors import ConfigError, DeviceError, Disturbed
from gonio.rig import Pose, Target
from gonio.rig.description import RigDescription
from gonio_drivers import joints, settings, watchdog
from gonio_drivers.arrival import LARGEST_CORRECTION_DEG, SMALLEST_COUNTS, STILL_COUNTS, Landing
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import Joint, Report

log = logging.getLogger("gonio.devices")

AXES = tuple(field.name for field in fields(Pose))
POLL_S = 0.020
GRACE_S = 3.0
"""A move may take twice its time, and this."""
RELEASES = 3
LOOKS, SECOND_LOOKS = 5, 9
"""Readings that tell where an axis has landed, and whether it has left that place."""
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Reading:
    """Positions of the axes and when they were read, in seconds of `time.monotonic`."""

    pose: Pose
    time_s: float
    counts: Mapping[str, int] = field(default_factory=dict)


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
        self._servos = servos
        self._approach_deg = description.acquisition.approach_deg
        self.bus = Bus(servos.port, servos.baud)
        self.joints = {
            name: joints.joint(self.bus, description, name, servos.axes[name], self._approach_deg)  # type: ignore[index]
            for name in description.axes()
        }
        if servos.changer is not None:
            self.joints["changer"] = joints.changer_joint(self.bus, servos.changer, self._approach_deg)
        self.last: Reading | None = None
        self.faulted = False
        """An axis has failed: nothing moves any more until the rig is opened again."""
        self.stopped = False
        """Somebody has called `stop` since the last move."""

    # ---- opening and leaving ----

    def __enter__(self) -> Self:
        self.bus.__enter__()
        try:
            for joint in self.joints.values():
                joint.identify()
            for joint in self.joints.values():
                joint.prepare(self._servos.acceleration_deg_per_s2, self._approach_deg)
            self.read()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            failures = self._let_go() if self._servos.on_exit == "torque-off" else []
        finally:
            self.bus.__exit__(kind, error, trace)
        if failures and error is None and not self.faulted:
            raise failures[0]
        for said in dict.fromkeys(map(str, failures)):  # a port that went away says the same for every axis
            log.error("while leaving: %s", said)

    def _let_go(self) -> list[DeviceError]:
        """Take the torque from every servo that has been prepared; what failed."""
        failures = []
        for joint in self.joints.values():
            if joint.profile:
                try:
                    joint.write("Torque Enable", 0)
                except DeviceError as failure:
                    failures.append(failure)
        return failures

    # ---- ArmsDevice ----

    def move(self, goal: Pose) -> Pose:
        """Drive every axis to `goal`, from below, wait until all have landed; the encoders' readback [rad].

        Raises
        ------
        ConfigError
            A goal is beyond a limit, or the rig has no such axis; nothing has moved.
        DeviceError
            An axis does not land, or a servo is unwell; every axis has been stopped.
        """
        return self._move(self._checked(goal))

    def _move(self, goals: Mapping[str, float]) -> Pose:
        if self.faulted:
            raise DeviceError("the arms have been stopped after a failure; open the rig again")
        self.stopped = False
        try:
            self._approach(goals)
            for name, count in self._places(LOOKS).items():
                self.joints[name].stood_at = count
            return self._readback().pose
        except DeviceError:
            self.stop()
            self.faulted = True
            raise
        except BaseException:
            self.stop()
            raise

    def read(self) -> Pose:
        """The encoders' readback, now [rad]; `last` keeps it with its time."""
        return self._readback().pose

    def stop(self) -> None:
        """Stop every axis where it is: hold what answers, and take the torque from what does not. Never raises."""
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
                self._send(here)

    def park(self) -> None:
        """Drive to the rest position."""
        goals = {"light": self.joints["light"].limits_deg[0], "camera": self.joints["camera"].limits_deg[1]}
        goals |= {n: j.servo.park_deg for n, j in self.joints.items() if j.servo.park_deg is not None}
        self.move(Pose(**{name: math.radians(angle) for name, angle in goals.items()}))

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
            joint = self.joints[name]
            if report.profile != joint.profile:
                self._fail(f"axis {name}: servo id {joint.id} has restarted by itself; all axes are stopped")
        disturbed = ""
        places: Mapping[str, float] = {name: report.position for name, report in reports.items()}
        if self._strayed(places):  # or is it the encoder that flickers?
            places = self._places(SECOND_LOOKS)
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

    def _places(self, looks: int) -> dict[str, float]:
        """Where the axes stand: the mean of several readings [counts]."""
        seen = [joints.reports(self.bus, self.joints.values()) for _ in range(looks)]
        return {name: statistics.fmean(reports[name].position for reports in seen) for name in seen[0]}

    def _fail(self, message: str) -> NoReturn:
        self.stop()
        self.faulted = True
        raise DeviceError(message)

    # ---- moving ----

    def _checked(self, goal: Pose) -> dict[str, float]:
        """Goals [deg] by axis, or `ConfigError`."""
        out = {}
        for name in AXES:
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

    def _approach(self, goals: Mapping[str, float]) -> None:
        """To a point below each goal, where that is needed, and from there up to the goals."""
        finals = {name: self.joints[name].to_count(angle) for name, angle in goals.items()}
        reports = joints.reports(self.bus, self.joints.values())
        below: dict[str, float] = {}
        ups: dict[str, float] = {}
        for name, final in finals.items():
            joint = self.joints[name]
            position = reports[name].position
            if joint.landed_at == final and joint.distance_deg(final, position) <= self._tolerance(joint):
                continue
            ups[name] = final
            start = joint.to_count(goals[name] - self._approach_deg)
            if joint.to_deg(position) > joint.to_deg(start) + self._tolerance(joint):
                below[name] = start
        for name in ups:
            self.joints[name].landed_at = self.joints[name].stood_at = None
        moving = [self.joints[name] for name in ups]
        watchdog.arm(moving)
        if below:
            self._land(below, exact=False)
        if ups:
            self._land(ups, exact=True)
        if watchdog.call_off(moving):  # at the very end: an axis that is released may give way a little
            self._land(ups, exact=True)
        for name, final in ups.items():
            self.joints[name].landed_at = final

    def _tolerance(self, joint: Joint) -> float:
        """How far from its goal a joint may land [deg]: what the rig file says, but never less than counts allow."""
        return max(self._servos.tolerance_deg, SMALLEST_COUNTS / abs(joint.counts_per_deg))

    def _land(self, goals: Mapping[str, float], *, exact: bool) -> None:
        """Drive to counts, all axes at once, until every one has landed (`exact`) or come to rest close by."""
        start = time.monotonic()
        before = joints.reports(self.bus, self.joints.values())
        landings = {name: self._landing(name, goal, start, exact=exact) for name, goal in goals.items()}
        self._send({name: landing.sent for name, landing in landings.items()})
        allowed = max(self._duration(name, before[name].position, goal) for name, goal in goals.items())
        deadline = start + 2 * allowed + GRACE_S
        now = start
        while not all(landing.done for landing in landings.values()):
            time.sleep(POLL_S)
            reports = joints.reports(self.bus, self.joints.values())
            before_s, now = now, time.monotonic()
            if now - before_s > watchdog.PERIOD_S:  # this program was held up, and the servos may have stopped
                deadline += now - before_s
            for name, landing in landings.items():
                if not landing.done:
                    self._watch(self.joints[name], landing, reports[name], now, exact=exact)
            if now > deadline:
                late = ", ".join(self._state(n, x, reports[n]) for n, x in landings.items() if not x.done)
                raise DeviceError(f"no landing within {deadline - start:.1f} s: {late}; all axes are stopped")
        joints.require_torque(self.bus, [self.joints[name] for name in goals])

    def _landing(self, name: str, goal: float, start: float, *, exact: bool) -> Landing:
        joint, servos = self.joints[name], self._servos
        within_deg = self._tolerance(joint) if exact else self._approach_deg / 2
        return Landing(joint, goal, round(goal), within_deg, servos.settle_s, servos.acceleration_deg_per_s2, start)

    def _watch(self, joint: Joint, landing: Landing, report: Report, now: float, *, exact: bool) -> None:
        """One look at an axis on its way: has it landed, does it need a correction, is it stuck?"""
        changed = report.profile != joint.profile or report.goal != landing.sent
        if changed and self._release(joint, landing, now):
            return
        if report.profile != joint.profile:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} has lost its settings: it has restarted (power dip?); "
                "all axes are stopped"
            )
        if report.goal != landing.sent:
            self._send_again(joint, landing)
            return
        verdict = landing.look(report, now)
        if verdict == "landed":
            landing.done = True
        elif verdict == "short":
            self._correct(joint, landing, now, exact=exact)
        elif verdict == "stuck" and not self._release(joint, landing, now):
            joints.require_torque(self.bus, [joint])
            raise DeviceError(f"{self._state(joint.name, landing, report)}: it is stuck; all axes are stopped")

    def _release(self, joint: Joint, landing: Landing, now: float) -> bool:
        """Whether the servo had stopped by its bus watchdog, because this program was held up; it is sent on."""
        if not joint.has_watchdog or joint.get(watchdog.ITEM) != watchdog.RUN_OUT:
            return False
        landing.released += 1
        if landing.released > RELEASES:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} has stopped {landing.released} times on one way, because "
                f"nothing came over the bus for {watchdog.PERIOD_S:g} s (is this computer overloaded?); all axes are "
                "stopped"
            )
        log.warning(
            "axis %s: nothing came over the bus for %g s, and the servo stopped; sent on", joint.name, watchdog.PERIOD_S
        )
        joint.write(watchdog.ITEM, watchdog.OFF)
        joint.send_profile()
        joint.write("Goal Position", landing.sent)
        joint.write(watchdog.ITEM, watchdog.UNITS)
        landing.begin(now)
        return True

    def _correct(self, joint: Joint, landing: Landing, now: float, *, exact: bool) -> None:
        """A new goal that makes up for what is missing; from below again where the axis went too far."""
        landing.corrections += 1
        miss = round(landing.goal - landing.position)
        short = miss * joint.counts_per_deg > 0
        landing.sent += miss
        lower, upper = joint.count_limits
        landing.sent = max(lower, min(upper, landing.sent))
        log.info("axis %s: %d counts from its goal, correction %d", joint.name, miss, landing.corrections)
        if exact and not short:
            back = landing.sent - round(self._approach_deg * joint.counts_per_deg)
            self._land({joint.name: max(lower, min(upper, back))}, exact=False)
        self._send({joint.name: landing.sent})
        landing.begin(now)

    def _send(self, counts: Mapping[str, int]) -> None:
        """Give goals to several servos at the same moment; reports show whether they arrived."""
        by_address: dict[int, dict[int, bytes]] = {}
        for name, count in counts.items():
            joint = self.joints[name]
            goal = joint.table["Goal Position"]
            by_address.setdefault(goal.address, {})[joint.id] = goal.encode(count)
        for address, data in by_address.items():
            self.bus.write_all(address, data)

    def _send_again(self, joint: Joint, landing: Landing) -> None:
        """A goal did not arrive (a sync write is not answered); this time with an answer."""
        landing.resent += 1
        if landing.resent > 3:
            raise DeviceError(f"axis {joint.name}: servo id {joint.id} does not keep its goal; all axes are stopped")
        log.warning("axis %s: the goal did not arrive; sent again", joint.name)
        joint.write("Goal Position", landing.sent)
        landing.begin(time.monotonic())

    def _duration(self, name: str, position: float, goal: float) -> float:
        """How long a way should take at the axis's speed and acceleration [s]."""
        joint = self.joints[name]
        way = joint.distance_deg(goal, position)
        return way / joint.speed_deg_per_s + 2 * joint.speed_deg_per_s / self._servos.acceleration_deg_per_s2

    def _state(self, name: str, landing: Landing, report: Report) -> str:
        joint = self.joints[name]
        return (
            f"axis {name} (servo id {joint.id}) stands at {joint.to_deg(report.position):.2f} deg instead of "
            f"{joint.to_deg(landing.goal):.2f} deg, current {report.current} of {joint.full_current}"
            f"{', and says that it moves' if report.moving or report.under_way else ''}"
        )

    # ---- reading ----

    def _readback(self) -> Reading:
        before = time.monotonic()
        reports = joints.reports(self.bus, self.joints.values())
        after = time.monotonic()
        counts = {name: report.position for name, report in reports.items()}
        axes = {name: math.radians(self.joints[name].to_deg(count)) for name, count in counts.items() if name in AXES}
        pose = Pose(**axes)
        self.last = Reading(pose, (before + after) / 2, counts)
        return self.last
