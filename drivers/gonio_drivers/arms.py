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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from types import TracebackType
from typing import NoReturn, Self

from gonio.description import Axis, RigDescription
from gonio.errors import ConfigError, DeviceError
from gonio.rig import Pose, Target
from gonio_drivers import dynamixel, settings
from gonio_drivers.dynamixel import Bus, Item

log = logging.getLogger("gonio.devices")

COUNTS = 4096
VELOCITY_UNIT_DEG_S = 0.229 * 6
ACCELERATION_UNIT_DEG_S2 = 214.577 * 360 / 3600
POSITION_MODE = 3
AXES = tuple(field.name for field in fields(Pose))
STILL_COUNTS = 3
"""Readings this close are the same place: encoders flicker by a count."""
AVERAGED = 5
POLL_S = 0.020
STALL_S = 0.5
"""An axis that has neither moved nor landed for this long is stuck."""
STARTING_S = 0.06
"""A servo has begun to follow a new goal by then."""
GRACE_S = 3.0
"""A move may take twice its time, and this."""
CORRECTIONS = 4
LARGEST_CORRECTION_DEG = 2.0
HOT_MARGIN_C = 3
"""Stop this far below the temperature at which the servo would let go by itself."""
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Health:
    """What a servo said of itself in its last report."""

    temperature_c: int
    voltage_v: float
    current: int
    hardware_error: str = ""


@dataclass(slots=True)
class Joint:
    """One axis and its servo."""

    name: str
    servo: settings.ServoAxis
    axis: Axis
    limits_deg: tuple[float, float]
    table: dict[str, Item]
    max_temperature_c: int = 80
    voltage_limits_v: tuple[float, float] = (9.5, 16.0)
    count_limits: tuple[int, int] = (0, COUNTS - 1)
    full_current: int = 0
    profile: bytes = b""
    health: Health | None = None
    stood_at: int | None = None
    """Count that was read where it landed."""
    landed_at: float | None = None
    """Goal [counts] that the axis stands at, reached from below; None where it may have been moved since."""

    @property
    def id(self) -> int:
        return self.servo.id

    @property
    def key(self) -> str:
        """The table of the rig file that describes it."""
        return "devices.servos.changer" if self.name == "changer" else f"devices.servos.axes.{self.name}"

    @property
    def counts_per_deg(self) -> float:
        """Counts for one degree of the axis; negative where the servo turns the other way round."""
        return self.servo.direction * self.servo.gear_ratio * COUNTS / 360

    @property
    def offset_deg(self) -> float:
        return self.axis.zero_offset_deg if self.axis.zero_offset_known else 0.0

    def to_count(self, angle_deg: float) -> float:
        """Count of the servo for an angle of the axis."""
        return self.servo.zero_count + (angle_deg + self.offset_deg) * self.counts_per_deg

    def to_deg(self, count: float) -> float:
        """Angle of the axis [deg] for a count of the servo, with the zero offset taken out."""
        return (count - self.servo.zero_count) / self.counts_per_deg - self.offset_deg


@dataclass(slots=True)
class Report:
    """One reading of a joint."""

    position: int
    moving: bool
    goal: int
    profile: bytes
    current: int


@dataclass(slots=True)
class Landing:
    """How far a joint has come on its way."""

    goal: float
    """Where it shall stand [counts]."""
    sent: int
    """What the servo was told, with the corrections so far."""
    corrections: int = 0
    resent: int = 0
    since: float = 0.0
    """When it was last seen to move."""
    seen: list[int] = field(default_factory=list)
    """Positions since then."""
    done: bool = False


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
            name: _joint(description, name, limits, servos.axes[name], self._approach_deg)  # type: ignore[index]
            for name, limits in settings.axis_limits_deg(description).items()
        }
        if servos.changer is not None:
            self.joints["changer"] = _changer(servos.changer, self._approach_deg)
        self.last: Reading | None = None
        self.faulted = False
        """An axis has failed: nothing moves any more until the rig is opened again."""
        self.stopped = False
        """Somebody has called `stop` since the last move."""
        self._by_id = {joint.id: joint for joint in self.joints.values()}

    # ---- opening and leaving ----

    def __enter__(self) -> Self:
        self.bus.__enter__()
        try:
            for joint in self.joints.values():
                self._identify(joint)
            for joint in self.joints.values():
                self._prepare(joint)
            self.read()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            failures = self._release() if self._servos.on_exit == "torque-off" else []
        finally:
            self.bus.__exit__(kind, error, trace)
        if failures and error is None and not self.faulted:
            raise failures[0]
        for said in dict.fromkeys(map(str, failures)):  # a port that went away says the same for every axis
            log.error("while leaving: %s", said)

    def _release(self) -> list[DeviceError]:
        """Take the torque from every servo that has been prepared; what failed."""
        failures = []
        for joint in self.joints.values():
            if joint.profile:
                try:
                    self._write(joint, "Torque Enable", 0)
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
            reading = self._readback()
            for name, count in reading.counts.items():
                self.joints[name].stood_at = count
            return reading.pose
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
            self._freeze()
        except DeviceError as failure:
            log.error("stopping: %s", failure)
        for joint in self.joints.values():
            joint.landed_at = joint.stood_at = None
            try:
                here = joint.table["Present Position"]
                position = here.decode(self.bus.read(joint.id, here.address, here.size), here.address)
                self._write(joint, "Goal Position", position)
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
        for (address, size), joints in groups.items():
            blocks = self.bus.glance([joint.id for joint in joints], address, size)
            here = {j.name: j.table["Present Position"].decode(blocks[j.id], address) for j in joints if j.id in blocks}
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
        """Raise `DeviceError` where an axis has left the place where it landed, or has let go of its torque."""
        for name, report in self._reports().items():
            joint = self.joints[name]
            if joint.stood_at is not None and abs(report.position - joint.stood_at) > STILL_COUNTS:
                self._fail(
                    f"axis {name} has moved by itself, from {joint.to_deg(joint.stood_at):.2f} to "
                    f"{joint.to_deg(report.position):.2f} deg; all axes are stopped"
                )
            if report.profile != joint.profile:
                self._fail(f"axis {name}: servo id {joint.id} has restarted by itself; all axes are stopped")
        try:
            self._require_torque(self.joints)
        except DeviceError as failure:
            self._fail(str(failure))

    def _fail(self, message: str) -> NoReturn:
        self.stop()
        self.faulted = True
        raise DeviceError(message)

    # ---- setting up ----

    def _identify(self, joint: Joint) -> None:
        """The servo with this id must answer, and be of the model that the file says."""
        where = joint.key
        try:
            number, _ = self.bus.ping(joint.id)
        except dynamixel.BusError:
            raise DeviceError(self._who_is_there(joint, where)) from None
        found = dynamixel.models().get(number, f"model number {number}")
        if found != joint.servo.model.lower():
            raise DeviceError(
                f'{where}.model = "{joint.servo.model}", but servo id {joint.id} on {self.bus.port} is a {found}; '
                "correct the model, or the id"
            )

    def _who_is_there(self, joint: Joint, where: str) -> str:
        said = f"{where}.id = {joint.id}: no servo with this id answers on {self.bus.port} at {self.bus.baud} baud"
        here = self.bus.discover()
        if here:
            return f"{said}; found there: {_listed(here)}; correct the id, or set it with the Dynamixel Wizard"
        self.bus.__exit__(None, None, None)
        elsewhere = dynamixel.scan(self.bus.port, without=self.bus.baud)
        self.bus.__enter__()
        if elsewhere is not None:
            baud, found = elsewhere
            return f"{said}, but at {baud} baud: {_listed(found)}; set devices.servos.baud to that speed"
        return f"{said}, nor does any servo at another speed; is the servo power on, and the cable in?"

    def _prepare(self, joint: Joint) -> None:
        """Bring one servo into the state that moves rely on; it does not turn meanwhile."""
        level = joint.table["Status Return Level"]
        self.bus.write_all(level.address, {joint.id: b"\x02"})  # before any question: it may answer nothing but pings
        self._complain(joint)
        wanted = {"Operating Mode": POSITION_MODE, "Drive Mode": 0, "Homing Offset": 0}
        if joint.servo.current_limit is not None:
            wanted["Current Limit"] = joint.servo.current_limit
        wrong = {name: value for name, value in wanted.items() if self._get(joint, name) != value}
        if wrong:
            changes = ", ".join(f"{name} = {value}" for name, value in wrong.items())
            log.warning("axis %s: setting %s in the servo", joint.name, changes)
            self._write(joint, "Torque Enable", 0)
            for name, value in wrong.items():
                self._write(joint, name, value)
        joint.max_temperature_c = self._get(joint, "Temperature Limit")
        low, high = self._get(joint, "Min Voltage Limit"), self._get(joint, "Max Voltage Limit")
        joint.voltage_limits_v = low / 10, high / 10
        joint.count_limits = self._get(joint, "Min Position Limit"), self._get(joint, "Max Position Limit")
        joint.full_current = self._get(joint, "Current Limit") if "Current Limit" in joint.table else 1000
        self._check_reach(joint)
        speed = max(1, int(joint.axis.speed_deg_per_s * joint.servo.gear_ratio / VELOCITY_UNIT_DEG_S))
        rate = self._servos.acceleration_deg_per_s2 * joint.servo.gear_ratio / ACCELERATION_UNIT_DEG_S2
        acceleration = joint.table["Profile Acceleration"].encode(max(1, int(rate)))
        joint.profile = acceleration + joint.table["Profile Velocity"].encode(
            min(speed, max(1, self._get(joint, "Velocity Limit")))
        )
        self.bus.write(joint.id, joint.table["Profile Acceleration"].address, joint.profile)
        position = self._get(joint, "Present Position")
        if not joint.count_limits[0] <= position <= joint.count_limits[1]:
            raise DeviceError(
                f"axis {joint.name} stands at count {position}, outside the servo's limits, {joint.count_limits[0]} "
                f"to {joint.count_limits[1]}; turn it by hand to where it may stand, then try again"
            )
        self._write(joint, "Goal Position", position)  # goal = present, so that torque moves nothing
        self._write(joint, "Torque Enable", 1)
        if self._get(joint, "Torque Enable") != 1:
            raise DeviceError(f"axis {joint.name}: servo id {joint.id} does not take its torque")

    def _check_reach(self, joint: Joint) -> None:
        """The axis's limits, with the way of approach, must lie within the servo's limits."""
        ends = [joint.to_count(joint.limits_deg[0] - self._approach_deg), joint.to_count(joint.limits_deg[1])]
        if min(ends) < joint.count_limits[0] or max(ends) > joint.count_limits[1]:
            raise ConfigError(
                f"axis {joint.name}: limits {joint.limits_deg[0]:g} to {joint.limits_deg[1]:g} deg, approached from "
                f"{self._approach_deg:g} deg below, need counts {min(ends):.0f} to {max(ends):.0f}, and servo id "
                f"{joint.id} allows {joint.count_limits[0]} to {joint.count_limits[1]}; narrow the limits, or change "
                f"{joint.key}.zero_count or the servo's position limits"
            )

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
        reports = self._reports()
        below: dict[str, float] = {}
        ups: dict[str, float] = {}
        for name, final in finals.items():
            joint = self.joints[name]
            if joint.landed_at == final and self._error_deg(joint, final, reports[name].position) <= self._tolerance:
                continue
            ups[name] = final
            start = joint.to_count(goals[name] - self._approach_deg)
            if joint.to_deg(reports[name].position) > joint.to_deg(start) + self._tolerance:
                below[name] = start
        for name in ups:
            self.joints[name].landed_at = self.joints[name].stood_at = None
        if below:
            self._land(below, exact=False)
        if ups:
            self._land(ups, exact=True)
        for name, final in ups.items():
            self.joints[name].landed_at = final

    @property
    def _tolerance(self) -> float:
        return self._servos.tolerance_deg

    @staticmethod
    def _error_deg(joint: Joint, goal: float, position: float) -> float:
        return abs((position - goal) / joint.counts_per_deg)

    def _land(self, goals: Mapping[str, float], *, exact: bool) -> None:
        """Drive to counts, all axes at once, until every one has landed (`exact`) or come to rest close by."""
        start = time.monotonic()
        before = self._reports()
        landings = {name: Landing(goal, round(goal), since=start) for name, goal in goals.items()}
        self._send({name: landing.sent for name, landing in landings.items()})
        allowed = max(self._duration(name, before[name].position, goal) for name, goal in goals.items())
        deadline = start + 2 * allowed + GRACE_S
        while not all(landing.done for landing in landings.values()):
            time.sleep(POLL_S)
            reports = self._reports()
            now = time.monotonic()
            for name, landing in landings.items():
                if not landing.done:
                    self._watch(self.joints[name], landing, reports[name], now, exact=exact)
            if now > deadline:
                late = ", ".join(self._state(n, x, reports[n]) for n, x in landings.items() if not x.done)
                raise DeviceError(f"no landing within {deadline - start:.1f} s: {late}; all axes are stopped")
        self._require_torque(goals)

    def _watch(self, joint: Joint, landing: Landing, report: Report, now: float, *, exact: bool) -> None:
        """One look at an axis on its way: has it landed, does it need a correction, is it stuck?"""
        if report.profile != joint.profile:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} has lost its settings: it has restarted (power dip?); "
                "all axes are stopped"
            )
        if report.goal != landing.sent:
            self._send_again(joint, landing)
            return
        if not landing.seen or abs(report.position - landing.seen[0]) > STILL_COUNTS or report.moving:
            landing.seen, landing.since = [], now
        landing.seen.append(report.position)
        position = statistics.fmean(landing.seen[-AVERAGED:])
        error = self._error_deg(joint, landing.goal, position)
        still = now - landing.since
        if not report.moving and still >= self._servos.settle_s:
            if error <= self._tolerance if exact else error <= self._approach_deg / 2:
                landing.done = True
                return
            small = error + self._error_deg(joint, landing.goal, landing.sent) <= LARGEST_CORRECTION_DEG
            if small and landing.corrections < CORRECTIONS and still > STARTING_S:  # it has had time to set out
                self._correct(joint, landing, position, now, exact=exact)
                return
        if still > STALL_S:
            raise DeviceError(f"{self._state(joint.name, landing, report)}: it is stuck; all axes are stopped")

    def _correct(self, joint: Joint, landing: Landing, position: float, now: float, *, exact: bool) -> None:
        """A new goal that makes up for what is missing; from below again where the axis went too far."""
        landing.corrections += 1
        miss = round(landing.goal - position)
        short = miss * joint.counts_per_deg > 0
        landing.sent += miss
        lower, upper = joint.count_limits
        landing.sent = max(lower, min(upper, landing.sent))
        log.info("axis %s: %d counts from its goal, correction %d", joint.name, miss, landing.corrections)
        if exact and not short:
            back = landing.sent - round(self._approach_deg * joint.counts_per_deg)
            self._land({joint.name: max(lower, min(upper, back))}, exact=False)
        self._send({joint.name: landing.sent})
        landing.seen, landing.since = [], now

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
        self._write(joint, "Goal Position", landing.sent)
        landing.seen, landing.since = [], time.monotonic()

    def _duration(self, name: str, position: float, goal: float) -> float:
        """How long a way should take at the axis's speed and acceleration [s]."""
        joint = self.joints[name]
        way = self._error_deg(joint, goal, position)
        return way / joint.axis.speed_deg_per_s + 2 * joint.axis.speed_deg_per_s / self._servos.acceleration_deg_per_s2

    def _state(self, name: str, landing: Landing, report: Report) -> str:
        joint = self.joints[name]
        return (
            f"axis {name} (servo id {joint.id}) stands at {joint.to_deg(report.position):.2f} deg instead of "
            f"{joint.to_deg(landing.goal):.2f} deg, current {report.current} of {joint.full_current}"
        )

    # ---- reading ----

    def _reports(self) -> dict[str, Report]:
        """What every servo says now, with its health checked; one block a servo."""
        blocks: dict[int, bytes] = {}
        groups: dict[tuple[int, int], list[int]] = {}
        for joint in self.joints.values():
            groups.setdefault(_span(joint.table), []).append(joint.id)
        for (address, size), ids in groups.items():
            blocks |= self.bus.read_all(ids, address, size)
        out = {}
        for identity, block in blocks.items():
            joint = self._by_id[identity]
            start = _span(joint.table)[0]
            value = {n: joint.table[n].decode(block, start) for n in joint.table if n in REPORTED}
            current = value.get("Present Current", value.get("Present Load", 0))
            joint.health = Health(value["Present Temperature"], value["Present Input Voltage"] / 10, current)
            profile = block[: len(joint.profile)]
            position, moving = value["Present Position"], bool(value["Moving"])
            out[joint.name] = Report(position, moving, value["Goal Position"], profile, current)
            self._watch_health(joint)
        return out

    def _readback(self) -> Reading:
        before = time.monotonic()
        reports = self._reports()
        after = time.monotonic()
        counts = {name: report.position for name, report in reports.items()}
        axes = {name: math.radians(self.joints[name].to_deg(count)) for name, count in counts.items() if name in AXES}
        pose = Pose(**axes)
        self.last = Reading(pose, (before + after) / 2, counts)
        return self.last

    def _watch_health(self, joint: Joint) -> None:
        if joint.id in self.bus.alerts:
            self._complain(joint)
        health = joint.health
        assert health is not None
        if health.temperature_c > joint.max_temperature_c - HOT_MARGIN_C:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} is at {health.temperature_c} C, and its limit is "
                f"{joint.max_temperature_c} C; let it cool down, and look for what it works against"
            )
        low, high = joint.voltage_limits_v
        if not low <= health.voltage_v <= high:
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} has {health.voltage_v:.1f} V, needs {low:.1f} to {high:.1f} V"
            )

    def _complain(self, joint: Joint, byte: int | None = None) -> None:
        """Raise what the hardware-error byte says, if it says something."""
        byte = self._get(joint, "Hardware Error Status") if byte is None else byte
        if byte:
            said = dynamixel.hardware_error(byte)
            volts, heat = self._get(joint, "Present Input Voltage") / 10, self._get(joint, "Present Temperature")
            raise DeviceError(
                f"axis {joint.name}: servo id {joint.id} reports: {said} ({volts:.1f} V, {heat} C); remove the cause, "
                "then switch the servo power off and on"
            )

    def _require_torque(self, names: Iterable[str]) -> None:
        """Raise where a servo has an error in its hardware-error byte, or holds nothing any more."""
        joints = [self.joints[name] for name in names]
        table = joints[0].table  # these items have the same addresses in every model of the X series
        torque, error = table["Torque Enable"], table["Hardware Error Status"]
        blocks = self.bus.read_all([j.id for j in joints], torque.address, error.address + error.size - torque.address)
        for joint in joints:
            self._complain(joint, error.decode(blocks[joint.id], torque.address))
            if torque.decode(blocks[joint.id], torque.address) != 1:
                raise DeviceError(
                    f"axis {joint.name}: servo id {joint.id} has let go of its torque; all axes are stopped"
                )

    def _get(self, joint: Joint, name: str) -> int:
        item = joint.table[name]
        return item.decode(self.bus.read(joint.id, item.address, item.size), item.address)

    def _write(self, joint: Joint, name: str, value: int) -> None:
        item = joint.table[name]
        try:
            self.bus.write(joint.id, item.address, item.encode(value))
        except dynamixel.Refusal as refusal:
            raise dynamixel.Refusal(f"axis {joint.name}, {name} = {value}: {refusal}", refusal.error) from None


REPORTED = frozenset(
    {
        "Goal Position", "Moving", "Present Current", "Present Load", "Present Position", "Present Input Voltage",
        "Present Temperature",
    }
)  # fmt: skip
"""Items that a report needs; all lie in one block from Profile Acceleration to Present Temperature."""


def _span(table: Mapping[str, Item]) -> tuple[int, int]:
    """Address and size of the block that a report reads."""
    first, last = table["Profile Acceleration"], table["Present Temperature"]
    return first.address, last.address + last.size - first.address


def _joint(
    description: RigDescription, name: str, limits: tuple[float, float], servo: settings.ServoAxis, approach_deg: float
) -> Joint:
    axis = description.holder if name in ("tilt", "spin") else getattr(description.arms, name)
    table = dynamixel.control_table(servo.model, f"devices.servos.axes.{name}.model")
    joint = Joint(name, servo, axis, limits, table)
    _check_current_limit(joint)
    ends = sorted((joint.to_count(limits[0] - approach_deg), joint.to_count(limits[1])))
    if ends[0] < 0 or ends[1] > COUNTS - 1:
        raise ConfigError(
            f"axis {name}: limits {limits[0]:g} to {limits[1]:g} deg, approached from {approach_deg:g} deg below, need "
            f"counts {ends[0]:.0f} to {ends[1]:.0f}; a servo in Position mode has 0 to {COUNTS - 1}: narrow the limits "
            f"or change devices.servos.axes.{name}.zero_count or gear_ratio"
        )
    return joint


def _changer(changer: settings.Changer, approach_deg: float) -> Joint:
    """The joint of the sample changer, which is no axis of a pose."""
    ends = sorted((changer.sample_deg, changer.reference_deg))
    axis = Axis(speed_deg_per_s=changer.speed_deg_per_s)
    table = dynamixel.control_table(changer.model, "devices.servos.changer.model")
    joint = Joint("changer", changer, axis, (ends[0], ends[1]), table)
    _check_current_limit(joint)
    counts = sorted((joint.to_count(ends[0] - approach_deg), joint.to_count(ends[1])))
    if counts[0] < 0 or counts[1] > COUNTS - 1:
        raise ConfigError(
            f"devices.servos.changer: its places need counts {counts[0]:.0f} to {counts[1]:.0f}; a servo in Position "
            f"mode has 0 to {COUNTS - 1}"
        )
    return joint


def _check_current_limit(joint: Joint) -> None:
    if joint.servo.current_limit is not None and "Current Limit" not in joint.table:
        raise ConfigError(
            f"{joint.key}.current_limit = {joint.servo.current_limit}: a {joint.servo.model} has no current limit; "
            "leave the key out"
        )


def _listed(found: Mapping[int, tuple[int, int]]) -> str:
    names = dynamixel.models()
    return ", ".join(f"id {k} {names.get(number, f'model {number}')}" for k, (number, _) in found.items())
