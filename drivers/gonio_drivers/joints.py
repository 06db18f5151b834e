"""One axis of a goniometer and the Dynamixel servo that turns it: angles and counts, identity, preparation, health.

A servo is brought into Position mode with its own offset off, gets a profile velocity and acceleration and, where the
rig file has one, a current limit; its goal is set to where it stands before its torque comes on, so that nothing turns.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gonio.errors import ConfigError, DeviceError
from gonio.rig.description import Axis
from gonio_drivers import control_table, dynamixel, home_mark, settings, watchdog
from gonio_drivers.control_table import Item
from gonio_drivers.dynamixel import Bus

log = logging.getLogger("gonio.devices")

COUNTS = 4096
VELOCITY_UNIT_DEG_S = 0.229 * 6
ACCELERATION_UNIT_DEG_S2 = 214.577 * 360 / 3600
POSITION_MODE, EXTENDED_MODE, EXTENDED_CURRENT_MODE = 3, 4, 5
REVERSE = 0x01
"""Bit of the Drive Mode."""
VALID_OFFSET = 1024
LARGEST_PROFILE = 32_767
"""Of the items Profile Acceleration and Profile Velocity."""
MOST_TURNS = 256
SHADOW, LAST_ID, NO_ID = "Secondary(Shadow) ID", 252, 255
PROFILE_ONGOING = 0x02
"""Bit of the Moving Status."""
HELD_DEG = 2.0
"""A servo that holds stands this close to its goal, corrections for friction included."""
HOT_MARGIN_C = 3
"""Stop this far below the temperature at which the servo would let go by itself."""


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

    bus: Bus
    name: str
    servo: settings.ServoAxis
    axis: Axis
    limits_deg: tuple[float, float]
    table: dict[str, Item]
    approach_deg: float = 1.0
    """From how far below its goal it arrives; negative: from above."""
    hard_stops_deg: tuple[float, float] | None = None
    max_temperature_c: int = 80
    voltage_limits_v: tuple[float, float] = (3.5, 30.0)
    count_limits: tuple[int, int] = (0, COUNTS - 1)
    full_current: int = 0
    profile: bytes = b""
    """Profile Acceleration and Profile Velocity, as they lie in the servo; empty before `prepare`."""
    speed_deg_per_s: float = 0.0
    """Of the axis, with that profile."""
    has_watchdog: bool = True
    held: bool = False
    """It had its torque when it was opened."""
    health: Health | None = None
    strained: list[Health] = field(default_factory=list)
    """The reports of the highest current and of the lowest voltage since somebody emptied this list."""
    stood_at: float | None = None
    """Count that was read where it landed; the mean of several, since encoders flicker."""
    also: dict[str, int] = field(default_factory=dict)
    """What `prepare` sets beside the rest, by item."""
    turns: int = 0
    """Whole turns of the servo between `zero_count` and the count that is 0 deg; of an axis that has been homed."""
    landed_at: float | None = None
    """Goal [counts] that the axis stands at, reached by its approach; None where it may have been moved since."""

    @property
    def id(self) -> int:
        """The servo's id on its bus."""
        return self.servo.id

    @property
    def key(self) -> str:
        """The table of the rig file that describes it."""
        return "devices.servos.changer" if self.name == "changer" else f"devices.servos.axes.{self.name}"

    @property
    def park_deg(self) -> float | None:
        """Where it rests, if the rig file says so."""
        return self.servo.park_deg

    @property
    def counts_per_deg(self) -> float:
        """Counts for one degree of the axis; negative where the servo turns the other way round."""
        return self.servo.direction * self.servo.gear_ratio * COUNTS / 360

    @property
    def zero_count(self) -> int:
        """Count that is called 0 deg, with the turns that homing has found."""
        return self.servo.zero_count + self.turns * COUNTS

    @property
    def mode(self) -> int:
        """The Operating Mode that it needs: a servo that is homed against a stop must push by its current."""
        if self.servo.homing is None:
            return POSITION_MODE
        return EXTENDED_CURRENT_MODE if self.servo.homing.how == "stall" else EXTENDED_MODE

    @property
    def offset_deg(self) -> float:
        """What the encoder reads at the true zero, as far as it is known [degrees]."""
        return self.axis.zero_offset_deg if self.axis.zero_offset_known else 0.0

    def to_count(self, angle_deg: float) -> float:
        """Count of the servo for an angle of the axis."""
        return self.zero_count + (angle_deg + self.offset_deg) * self.counts_per_deg

    def to_deg(self, count: float) -> float:
        """Angle of the axis [deg] for a count of the servo, with the zero offset taken out."""
        return (count - self.zero_count) / self.counts_per_deg - self.offset_deg

    def inside(self, count: float) -> int:
        """The nearest whole count to one that lies within the axis's limits and the servo's own."""
        ends = sorted(map(self.to_count, self.limits_deg))
        lower, upper = max(self.count_limits[0], math.ceil(ends[0] - 1e-6)), math.floor(ends[1] + 1e-6)
        return max(lower, min(upper, self.count_limits[1], round(count)))

    def approach_start(self, goal: float) -> int:
        """Where the last part of the way to a goal begins; never beyond a limit [counts]."""
        return self.inside(goal - self.approach_deg * self.counts_per_deg)

    def warn_of_play(self, goal_deg: float) -> None:
        """Say so where a limit leaves no way that takes up the axis's backlash."""
        way = self.distance_deg(self.approach_start(self.to_count(goal_deg)), self.to_count(goal_deg))
        if way < min(self.axis.backlash_deg, abs(self.approach_deg)) - 0.5 / abs(self.counts_per_deg):
            log.warning(
                "axis %s at %g deg, %.2f deg from its limit: its backlash of %g deg is not taken up there, and it may "
                "stand that far off what it reads", self.name, goal_deg, way, self.axis.backlash_deg,
            )  # fmt: skip

    def distance_deg(self, goal: float, position: float) -> float:
        """How far apart two counts of the servo are, as an angle of the axis [deg]."""
        return abs((position - goal) / self.counts_per_deg)

    # ---- the servo ----

    def identify(self) -> None:
        """Raise `DeviceError` where no servo with this id answers, or one of another model than the file says."""
        try:
            self.identify_model()
        except dynamixel.BusError:
            raise DeviceError(self._who_is_there()) from None

    def identify_model(self) -> None:
        """The same without a search for what answers instead: raises `BusError` where nothing answers."""
        number, _ = self.bus.ping(self.id)
        found = control_table.models().get(number, f"model number {number}")
        if found != self.servo.model.lower():
            raise DeviceError(
                f'{self.key}.model = "{self.servo.model}", but servo id {self.id} on {self.bus.port} is a {found}; '
                "correct the model, or the id"
            )

    def _who_is_there(self) -> str:
        said = f"{self.key}.id = {self.id}: no servo with this id answers on {self.bus.port} at {self.bus.baud} baud"
        here = self.bus.discover()
        if here:
            there = self.bus.elsewhere(self.id) or "; correct the id, or give it to a servo (gonio rig ids --set-id)"
            return f"{said}; found there: {_listed(here)}{there}"
        self.bus.__exit__(None, None, None)
        elsewhere = dynamixel.scan(self.bus.port, without=self.bus.baud)
        self.bus.__enter__()
        if elsewhere is not None:
            baud, found = elsewhere
            return f"{said}, but at {baud} baud: {_listed(found)}; set devices.servos.baud to that speed"
        return f"{said}, nor does any servo at another speed; is the servo power on, and the cable in?"

    def _set_mode(self) -> None:
        """Write what of mode, offset and limits the servo has otherwise, with its torque off."""
        wanted = {"Operating Mode": self.mode, "Drive Mode": 0, "Homing Offset": 0} | self.also
        if self.servo.current_limit is not None:
            wanted["Current Limit"] = self.servo.current_limit
        if self.get(SHADOW) <= LAST_ID:  # it would obey what is meant for another servo
            wanted[SHADOW] = NO_ID
        wrong = {name: value for name, value in wanted.items() if self.get(name) != value}
        if wrong:
            changes = ", ".join(f"{name} = {value}" for name, value in wrong.items())
            log.warning("axis %s: setting %s in the servo", self.name, changes)
            self.write("Torque Enable", 0)
            for name, value in wrong.items():
                self.write(name, value)

    def _set_profile(self, acceleration_deg_per_s2: float) -> None:
        """Speed and acceleration in the servo's units, as near as it allows."""
        gear = self.servo.gear_ratio
        wish = int(self.axis.speed_deg_per_s * gear / VELOCITY_UNIT_DEG_S)
        speed = max(1, min(wish, self.get("Velocity Limit") or wish))
        self.speed_deg_per_s = speed * VELOCITY_UNIT_DEG_S / gear
        acceleration = max(1, int(acceleration_deg_per_s2 * gear / ACCELERATION_UNIT_DEG_S2))
        self.profile = self.table["Profile Acceleration"].encode(acceleration)
        self.profile += self.table["Profile Velocity"].encode(speed)

    def prepare(self, acceleration_deg_per_s2: float, *, homed: bool = True) -> None:
        """Bring the servo into the state that moves rely on; it does not turn meanwhile.

        Raises `DeviceError` for an axis that has to be homed first, unless `homed` is False: it is about to be.
        """
        level = self.table["Status Return Level"]
        self.bus.write_all(level.address, {self.id: b"\x02"})  # before any question: it may answer nothing but pings
        self.held = self.get("Torque Enable") == 1
        self.complain()
        if self.servo.homing is not None and (self.get("Operating Mode") != self.mode or not homed):
            home_mark.wipe(self)
        if homed:
            home_mark.recall(self)
        self._set_mode()
        # a largest value of zero was never set, and the factory's holds
        self.max_temperature_c = self.get("Temperature Limit") or self.max_temperature_c
        if highest_dv := self.get("Max Voltage Limit"):
            self.voltage_limits_v = self.get("Min Voltage Limit") / 10, highest_dv / 10
        if self.servo.homing is None:
            self.count_limits = self.get("Min Position Limit"), self.get("Max Position Limit") or COUNTS - 1
        self.full_current = self.get("Current Limit") if "Current Limit" in self.table else 1000
        if self.mode == EXTENDED_CURRENT_MODE:  # a homing that was cut off leaves little
            self.write("Goal Current", self.full_current)
        self.check_reach()
        self._set_profile(acceleration_deg_per_s2)
        self.send_profile()  # before the watchdog is cleared, and after it, since running out sets the profile to 0
        released = self._clear_watchdog()
        self.send_profile()
        self._require_profile()
        position = self.position_at_torque_on()
        if not self.count_limits[0] <= position <= self.count_limits[1]:
            raise DeviceError(
                f"axis {self.name} stands at count {position}, outside the servo's limits, {self.count_limits[0]} "
                f"to {self.count_limits[1]}; turn it by hand to where it may stand, then try again"
            )
        if homed:
            self._require_between_stops(position)
        if released or not self._holds(position):
            self.write("Goal Position", position)  # goal = present, so that torque moves nothing
        self.write("Torque Enable", 1)
        if self.get("Torque Enable") != 1:
            raise DeviceError(f"axis {self.name}: servo id {self.id} does not take its torque")
        if self.distance_deg(now := self.get("Present Position"), position) > HELD_DEG:
            self.write("Torque Enable", 0)
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} stood at count {position}, and reads {now} with its torque on; "
                "turn it by hand to where it may stand, then try again"
            )

    def position_at_torque_on(self) -> int:
        """Where the servo stands [counts]: without torque it counts turns on, and comes back within one with it.

        ROBOTIS e-Manual, "Present Position(132)": continuous while torque is off, in whatever mode; an absolute
        position within one turn once torque comes on in Position mode.
        """
        position = self.get("Present Position")
        turns_count = self.get("Operating Mode") == POSITION_MODE and self.get("Torque Enable") != 1
        return position % COUNTS if turns_count else position

    def falsified(self) -> dict[str, int]:
        """Settings in the servo that change what it reads, and that `prepare` resets, by item."""
        found = {name: self.get(name) for name in ("Homing Offset", "Drive Mode", "Operating Mode")}
        usual = {"Homing Offset": 0, "Drive Mode": found["Drive Mode"] & ~REVERSE, "Operating Mode": self.mode}
        return {name: value for name, value in found.items() if value != usual[name]}

    def shaft_count(self) -> int | None:
        """Where the servo would read that it stands, were it prepared [counts]; None where that is not known."""
        position = shaft_count(self.get)
        turns_count = self.get("Operating Mode") != POSITION_MODE or self.get("Torque Enable") != 1
        return position % COUNTS if position is not None and turns_count and self.servo.homing is None else position

    def keep_profile(self, seen: bytes) -> None:
        """Give the profile again where it was lost: a watchdog that runs out sets it to 0, and so does a restart.

        Raises
        ------
        DeviceError
            The servo has restarted: it has let go of its torque.
        """
        if seen == self.profile:
            return
        if self.get("Torque Enable") != 1:
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} has lost its settings and its torque: it has restarted by "
                "itself (power dip?); all axes are stopped"
            )
        log.warning("axis %s: servo id %d had lost its profile; given again", self.name, self.id)
        self.send_profile()
        self._require_profile()

    def send_profile(self) -> None:
        """Give the servo its acceleration and velocity."""
        for name, value in self._profile(self.profile).items():
            self.write(name, value)

    def _require_profile(self) -> None:
        """A servo without its profile would turn as fast as it can."""
        kept = self.bus.read(self.id, self.table["Profile Acceleration"].address, len(self.profile))
        if kept != self.profile:
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} does not keep its profile: it has {self._profile(kept)} "
                f"instead of {self._profile(self.profile)}"
            )

    def _profile(self, block: bytes) -> dict[str, int]:
        start = self.table["Profile Acceleration"].address
        return {n: self.table[n].decode(block, start) for n in ("Profile Acceleration", "Profile Velocity")}

    def _holds(self, position: int) -> bool:
        """Whether the servo stands and holds: a load keeps it off its goal, and a new goal there would let it sag."""
        if self.get("Torque Enable") != 1 or self.get("Moving") or self.get("Moving Status") & PROFILE_ONGOING:
            return False
        return self.distance_deg(self.get("Goal Position"), position) <= HELD_DEG

    def _clear_watchdog(self) -> bool:
        """One that has run out bars every goal, and tells of a program that died; old firmware has none.

        True where it had run out.
        """
        found = watchdog.OFF
        try:
            found = self.get(watchdog.ITEM)
            self.write(watchdog.ITEM, watchdog.OFF)
            self.write(watchdog.ITEM, watchdog.UNITS)
            self.has_watchdog = self.get(watchdog.ITEM) in (watchdog.UNITS, watchdog.RUN_OUT)
            self.write(watchdog.ITEM, watchdog.OFF)
        except (dynamixel.Refusal, dynamixel.BusError):  # one that has gone silent altogether shows at the next step
            self.has_watchdog = False
        if not self.has_watchdog:
            log.warning(
                "axis %s: servo id %d has no bus watchdog (its firmware is older than 38): it would finish its way if "
                "this program died in the middle of a move", self.name, self.id,
            )  # fmt: skip
        if found == watchdog.RUN_OUT:
            log.warning(
                "axis %s: servo id %d had stopped by itself, because a program died or its cable was pulled in the "
                "middle of a move; released", self.name, self.id,
            )  # fmt: skip
        return found == watchdog.RUN_OUT

    def _require_between_stops(self, position: float) -> None:
        """An axis cannot stand beyond what stops it: then its zero is wrong, and its limits with it."""
        if self.hard_stops_deg is None:
            return
        at, (lower, upper) = self.to_deg(position), self.hard_stops_deg
        if not lower - HELD_DEG <= at <= upper + HELD_DEG:
            raise DeviceError(
                f"axis {self.name} reads {at:.2f} deg, beyond its hard stops at {lower:g} and {upper:g} deg: its zero "
                f"is wrong (zero_offset_deg of the axis, or {self.key}.zero_count, direction or gear_ratio)"
            )

    def check_acceleration(self, acceleration_deg_per_s2: float) -> None:
        """The servo must have a Profile Acceleration for it."""
        unit = ACCELERATION_UNIT_DEG_S2 / self.servo.gear_ratio
        if not unit * (1 - 1e-9) <= acceleration_deg_per_s2 <= LARGEST_PROFILE * unit:
            raise ConfigError(
                f"devices.servos.acceleration_deg_per_s2 = {acceleration_deg_per_s2:g}: the servo of axis {self.name} "
                f"gives it {unit:.4g} to {LARGEST_PROFILE * unit:.4g} deg/s^2 ({self.key}.gear_ratio = "
                f"{self.servo.gear_ratio:g})"
            )

    def check_reach(self) -> None:
        """The axis's limits must lie within the servo's limits."""
        ends = [self.to_count(end) for end in self.limits_deg]
        if min(ends) < self.count_limits[0] or max(ends) > self.count_limits[1]:
            raise ConfigError(
                f"axis {self.name}: limits {self.limits_deg[0]:g} to {self.limits_deg[1]:g} deg need counts "
                f"{min(ends):.0f} to {max(ends):.0f}, and servo id {self.id} allows {self.count_limits[0]} to "
                f"{self.count_limits[1]}; Position mode has 0 to "
                f"{COUNTS - 1}: narrow the limits, or change {self.key}.zero_count or gear_ratio, or the servo's "
                "position limits"
            )

    def check_health(self) -> None:
        """Raise what the last report says of temperature, voltage and alert bit, if it is more than it may be."""
        if self.id in self.bus.alerts:
            self.complain()
        health = self.health
        assert health is not None
        if health.temperature_c > self.max_temperature_c - HOT_MARGIN_C:
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} is at {health.temperature_c} C, and its limit is "
                f"{self.max_temperature_c} C; let it cool down, and look for what it works against"
            )
        low, high = self.voltage_limits_v
        if health.voltage_v and not low <= health.voltage_v <= high:  # a servo without a supply says nothing at all
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} has {health.voltage_v:.1f} V, needs {low:.1f} to {high:.1f} V"
            )

    def complain(self, byte: int | None = None) -> None:
        """Raise what the hardware-error byte says, if it says something."""
        byte = self.get("Hardware Error Status") if byte is None else byte
        if byte:
            said = dynamixel.hardware_error(byte)
            volts, heat = self.get("Present Input Voltage") / 10, self.get("Present Temperature")
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} reports: {said} ({volts:.1f} V, {heat} C); remove the cause, "
                "then run gonio rig reboot, or switch the servo power off and on"
            )

    def get(self, name: str) -> int:
        """The value of an item of the control table, now."""
        item = self.table[name]
        return item.decode(self.bus.read(self.id, item.address, item.size), item.address)

    def write(self, name: str, value: int) -> None:
        """Change an item; a refusal names axis, item and value."""
        item = self.table[name]
        try:
            self.bus.write(self.id, item.address, item.encode(value))
        except dynamixel.Refusal as refusal:
            raise dynamixel.Refusal(f"axis {self.name}, {name} = {value}: {refusal}", refusal.error) from None


def shaft_count(get: Callable[[str], int]) -> int | None:
    """What a servo reads, less its own offset [counts]; None where it counts the other way round.

    ROBOTIS e-Manual, "Homing Offset(20)": the offset is added to the position; in Position mode one beyond a quarter of
    a turn counts as none.
    """
    if get("Drive Mode") & REVERSE:
        return None
    offset, position = get("Homing Offset"), get("Present Position")
    return position if get("Operating Mode") == POSITION_MODE and abs(offset) > VALID_OFFSET else position - offset


def _listed(found: Mapping[int, tuple[int, int]]) -> str:
    names = control_table.models()
    return ", ".join(f"id {k} {names.get(number, f'model {number}')}" for k, (number, _) in found.items())
