"""One axis of a goniometer and the Dynamixel servo that turns it: angles and counts, identity, reports, health.

`gonio_drivers.preparation` makes joints from a rig file, and brings their servos into the state that moves rely on.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from gonio.errors import ConfigError, DeviceError
from gonio_drivers import control_table, dynamixel, log, settings
from gonio_drivers.any_arms import AnyJoint

COUNTS = 4096
POSITION_MODE, EXTENDED_MODE, EXTENDED_CURRENT_MODE = 3, 4, 5
REVERSE = 0x01
"""Bit of the Drive Mode."""
VALID_OFFSET = 1024
PROFILE_ONGOING = 0x02
"""Bit of the Moving Status."""
HOT_MARGIN_C = 3
"""Stop this far below the temperature at which the servo would let go by itself."""
REPORTED = frozenset(
    {
        "Goal Position", "Moving", "Moving Status", "Present Current", "Present Load", "Present Position",
        "Present Input Voltage", "Present Temperature",
    }
)  # fmt: skip
"""Items that a report needs; all lie in one block from Profile Acceleration to Present Temperature."""


@dataclass(frozen=True, slots=True)
class Report:
    """One reading of a joint: what its servo says of itself."""

    position: int
    moving: bool
    """Faster than the servo's threshold, 14 deg/s as it comes."""
    under_way: bool
    """Its profile has not ended, however slow it is."""
    goal: int
    profile: bytes
    current: int
    voltage_v: float
    temperature_c: int


@dataclass
class BusServo:
    """A servo on a bus, by the items of its control table."""

    bus: dynamixel.Bus
    id: int
    table: dict[str, control_table.Item]

    def get(self, name: str) -> int:
        """The value of an item of the control table, now."""
        item = self.table[name]
        return item.decode(self.bus.read(self.id, item.address, item.size), item.address)

    def write(self, name: str, value: int) -> None:
        """Change an item."""
        item = self.table[name]
        self.bus.write(self.id, item.address, item.encode(value))

    def undisplaced_count(self) -> int | None:
        """What it reads, less its own offset [counts]; None where it counts the other way round.

        ROBOTIS e-Manual, "Homing Offset(20)": the offset is added to the position; in Position mode one beyond a
        quarter of a turn counts as none.
        """
        if self.get("Drive Mode") & REVERSE:
            return None
        offset, position = self.get("Homing Offset"), self.get("Present Position")
        ignored = self.get("Operating Mode") == POSITION_MODE and abs(offset) > VALID_OFFSET
        return position if ignored else position - offset


@dataclass(kw_only=True)
class Joint(BusServo, AnyJoint):
    """One axis and its servo."""

    servo: settings.ServoAxis
    max_temperature_c: int = 80
    voltage_limits_v: tuple[float, float] = (3.5, 30.0)
    count_limits: tuple[int, int] = (0, COUNTS - 1)
    full_current: int = 0
    profile: bytes = b""
    """Profile Acceleration and Profile Velocity, as they lie in the servo; empty before it is prepared."""
    speed_deg_per_s: float = 0.0
    """Of the axis, with that profile."""
    has_watchdog: bool = True
    held: bool = False
    """It had its torque when it was opened."""
    report: Report | None = None
    """The last one."""
    strained: list[Report] = field(default_factory=list)
    """Reports of the highest current and of the lowest voltage since somebody emptied this list."""
    also: dict[str, int] = field(default_factory=dict)
    """What its preparation sets beside the rest, by item."""
    turns: int = 0
    """Whole turns of the servo between `zero_count` and the count that is 0 deg; of an axis that has been homed."""
    landed_at: float | None = None
    """Goal [counts] that the axis stands at, reached by its approach; None where it may have been moved since."""

    @property
    def key(self) -> str:
        """The table of the rig file that describes it."""
        if self.name.startswith("polariser_"):
            return "devices.servos.polarisers." + self.name.removeprefix("polariser_")
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

    def run_up_deg(self, goal_deg: float) -> float:
        """How long the last part of its way to a goal is, inside its limits [deg]."""
        goal = self.to_count(goal_deg)
        return self.distance_deg(self.approach_start(goal), goal)

    def distance_deg(self, goal: float, position: float) -> float:
        """How far apart two counts of the servo are, as an angle of the axis [deg]."""
        return abs((position - goal) / self.counts_per_deg)

    # ---- the servo ----

    def reported(self, block: bytes) -> Report:
        """What the block of a report says."""
        start = span(self.table)[0]
        value = {name: item.decode(block, start) for name, item in self.table.items() if name in REPORTED}
        return Report(
            position=value["Present Position"], moving=bool(value["Moving"]),
            under_way=bool(value["Moving Status"] & PROFILE_ONGOING), goal=value["Goal Position"],
            profile=block[: len(self.profile)], current=value.get("Present Current", value.get("Present Load", 0)),
            voltage_v=value["Present Input Voltage"] / 10, temperature_c=value["Present Temperature"],
        )  # fmt: skip

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
        if (elsewhere := self.bus.scan()) is not None:
            baud, found = elsewhere
            return f"{said}, but at {baud} baud: {_listed(found)}; set devices.servos.baud to that speed"
        if old := self.bus.old_servos():
            return f"{said}; {old}"
        return f"{said}, nor does any servo at another speed; is the servo power on, and the cable in?"

    def falsified(self) -> dict[str, int]:
        """Settings in the servo that change what it reads, and that its preparation resets, by item."""
        found = {name: self.get(name) for name in ("Homing Offset", "Drive Mode", "Operating Mode")}
        usual = {"Homing Offset": 0, "Drive Mode": found["Drive Mode"] & ~REVERSE, "Operating Mode": self.mode}
        return {name: value for name, value in found.items() if value != usual[name]}

    def shaft_count(self) -> int | None:
        """Where the servo would read that it stands, were it prepared [counts]; None where that is not known."""
        position = self.undisplaced_count()
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
        self.require_profile()

    def send_profile(self) -> None:
        """Give the servo its acceleration and velocity."""
        for name, value in self._profile(self.profile).items():
            self.write(name, value)

    def require_profile(self) -> None:
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

    def check_health(self, report: Report) -> None:
        """Raise what a report says of temperature, voltage and alert bit, if it is more than it may be."""
        if self.id in self.bus.alerts:
            self.complain()
        if report.temperature_c > self.max_temperature_c - HOT_MARGIN_C:
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} is at {report.temperature_c} C, and its limit is "
                f"{self.max_temperature_c} C; let it cool down, and look for what it works against"
            )
        low, high = self.voltage_limits_v
        if report.voltage_v and not low <= report.voltage_v <= high:  # a servo without a supply says nothing at all
            raise DeviceError(
                f"axis {self.name}: servo id {self.id} has {report.voltage_v:.1f} V, needs {low:.1f} to {high:.1f} V"
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

    def write(self, name: str, value: int) -> None:
        """Change an item; a refusal names axis, item and value."""
        try:
            super().write(name, value)
        except dynamixel.Refusal as refusal:
            raise dynamixel.Refusal(f"axis {self.name}, {name} = {value}: {refusal}", refusal.error) from None


def span(table: Mapping[str, control_table.Item]) -> tuple[int, int]:
    """Address and size of the block that a report reads; it is the same in every model of the X series."""
    first, last = table["Profile Acceleration"], table["Present Temperature"]
    return first.address, last.address + last.size - first.address


def reports(bus: dynamixel.Bus, joints: Iterable[Joint]) -> dict[str, Report]:
    """What every servo says now, by the name of its axis, with its health checked; one block a servo.

    Raises
    ------
    DeviceError
        A servo does not answer, or is unwell.
    """
    by_id = {joint.id: joint for joint in joints}
    out = {}
    for identity, block in bus.read_all(by_id, *span(next(iter(by_id.values())).table)).items() if by_id else ():
        joint = by_id[identity]
        report = out[joint.name] = joint.report = joint.reported(block)
        seen = (*joint.strained, report)
        joint.strained[:] = max(seen, key=lambda r: abs(r.current)), min(seen, key=lambda r: r.voltage_v)
        joint.check_health(report)
    return out


def require_torque(bus: dynamixel.Bus, joints: Iterable[Joint]) -> None:
    """Raise `DeviceError` where a servo has an error in its hardware-error byte, or holds nothing any more."""
    by_id = {joint.id: joint for joint in joints}
    table = next(iter(by_id.values())).table  # these items have the same addresses in every model of the X series
    torque, error = table["Torque Enable"], table["Hardware Error Status"]
    blocks = bus.read_all(by_id, torque.address, error.address + error.size - torque.address)
    for identity, joint in by_id.items():
        joint.complain(error.decode(blocks[identity], torque.address))
        if torque.decode(blocks[identity], torque.address) != 1:
            raise DeviceError(f"axis {joint.name}: servo id {identity} has let go of its torque; all axes are stopped")


def _listed(found: Mapping[int, tuple[int, int]]) -> str:
    names = control_table.models()
    return ", ".join(f"id {k} {names.get(number, f'model {number}')}" for k, (number, _) in found.items())
