"""Joints of a rig file: checked against what their servos can do, and brought into the state that moves rely on.

A servo is brought into Position mode with its own offset off, gets a profile velocity and acceleration and, where the
rig file has one, a current limit; its goal is set to where it stands before its torque comes on, so that nothing turns.
"""

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig.description import Axis, RigDescription
from gonio_drivers import control_table, home_mark, log, settings, watchdog
from gonio_drivers.any_arms import axis_of
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import COUNTS, EXTENDED_CURRENT_MODE, POSITION_MODE, PROFILE_ONGOING, Joint

VELOCITY_UNIT_DEG_S = 0.229 * 6
ACCELERATION_UNIT_DEG_S2 = 214.577 * 360 / 3600
LARGEST_PROFILE = 32_767
"""Largest value of the items Profile Acceleration and Profile Velocity."""
MOST_TURNS = 256
SHADOW, LAST_ID, NO_ID = "Secondary(Shadow) ID", 252, 255
HELD_DEG = 2.0
"""A servo that holds stands this close to its goal, corrections for friction included."""


def joint_of(bus: Bus, description: RigDescription, name: str, servo: settings.ServoAxis) -> Joint:
    """The joint of an axis of the rig; `ConfigError` where its limits are beyond a turn of its servo."""
    table = control_table.of_model(servo.model, f"devices.servos.axes.{name}.model")
    return _checked(Joint(*axis_of(description, name), bus, servo.id, table, servo=servo))


def changer_joint(bus: Bus, changer: settings.Changer, approach_deg: float) -> Joint:
    """The joint of the sample changer, which is no axis of a pose; errors as of `joint_of`.

    What it may turn in is the range between its two places, and the way of approach to the outer one.
    """
    ends = (changer.sample_deg, changer.reference_deg)
    limits = min(ends) - max(0.0, approach_deg), max(ends) - min(0.0, approach_deg)
    axis = Axis(speed_deg_per_s=changer.speed_deg_per_s)
    table = control_table.of_model(changer.model, "devices.servos.changer.model")
    return _checked(Joint("changer", axis, limits, approach_deg, None, bus, changer.id, table, servo=changer))


def polariser_joint(bus: Bus, side: str, servo: settings.PolariserServo, approach_deg: float) -> Joint:
    """The joint of a polariser, which turns by a quarter of a turn to both sides; errors as of `joint_of`."""
    limits = -90.0 - max(0.0, approach_deg), 90.0 - min(0.0, approach_deg)
    table = control_table.of_model(servo.model, f"devices.servos.polarisers.{side}.model")
    axis = Axis(speed_deg_per_s=servo.speed_deg_per_s)
    return _checked(Joint(f"polariser_{side}", axis, limits, approach_deg, None, bus, servo.id, table, servo=servo))


def _checked(joint: Joint) -> Joint:
    servo, homing, gear = joint.servo, joint.servo.homing, joint.servo.gear_ratio
    if servo.current_limit is not None and "Current Limit" not in joint.table:
        raise ConfigError(
            f"{joint.key}.current_limit = {servo.current_limit}: a {servo.model} has no current limit; leave the key "
            "out"
        )
    highest = control_table.highest_current(servo.model)
    currents = {"current_limit": servo.current_limit, "homing.current": homing.current if homing else None}
    for key, value in currents.items():
        if value is not None and value > highest:
            raise ConfigError(
                f"{joint.key}.{key} = {value}: the Current Limit of a {servo.model} is 1 to {highest}, in units of "
                f"{control_table.current_unit_ma(servo.model):g} mA"
            )
    slowest = VELOCITY_UNIT_DEG_S / gear  # less would be rounded up to it
    speeds = {"speed_deg_per_s": joint.axis.speed_deg_per_s}
    if homing is not None:
        speeds[f"{joint.key}.homing.speed_deg_per_s"] = homing.speed_deg_per_s
    for key, speed in speeds.items():
        if speed < slowest * (1 - 1e-9):
            raise ConfigError(
                f"axis {joint.name}, {key} = {speed:g}: its servo turns it at {slowest:.4g} deg/s or more "
                f"(Profile Velocity 1, {joint.key}.gear_ratio = {gear:g})"
            )
    if homing is not None:
        home_mark.check(joint, homing)
        joint.count_limits = -MOST_TURNS * COUNTS, MOST_TURNS * COUNTS - 1
    joint.check_reach()
    return joint


def check_acceleration(joint: Joint, acceleration_deg_per_s2: float) -> None:
    """The servo must have a Profile Acceleration for it; else `ConfigError`."""
    unit = ACCELERATION_UNIT_DEG_S2 / joint.servo.gear_ratio
    if not unit * (1 - 1e-9) <= acceleration_deg_per_s2 <= LARGEST_PROFILE * unit:
        raise ConfigError(
            f"devices.servos.acceleration_deg_per_s2 = {acceleration_deg_per_s2:g}: the servo of axis {joint.name} "
            f"gives it {unit:.4g} to {LARGEST_PROFILE * unit:.4g} deg/s^2 ({joint.key}.gear_ratio = "
            f"{joint.servo.gear_ratio:g})"
        )


def set_profile(
    joint: Joint, speed_deg_per_s: float, acceleration_deg_per_s2: float, largest: int = LARGEST_PROFILE
) -> None:
    """Speed and acceleration in the servo's units, rounded down; nothing is sent. `largest` is a Profile Velocity."""
    gear = joint.servo.gear_ratio
    speed = max(1, min(int(speed_deg_per_s * gear / VELOCITY_UNIT_DEG_S), largest))
    joint.speed_deg_per_s = speed * VELOCITY_UNIT_DEG_S / gear
    acceleration = max(1, int(acceleration_deg_per_s2 * gear / ACCELERATION_UNIT_DEG_S2))
    items = {"Profile Acceleration": acceleration, "Profile Velocity": speed}
    joint.profile = b"".join(joint.table[name].encode(value) for name, value in items.items())


def prepare(joint: Joint, acceleration_deg_per_s2: float, *, homed: bool = True) -> None:
    """Bring the servo into the state that moves rely on; it does not turn meanwhile.

    Raises `DeviceError` for an axis that has to be homed first, unless `homed` is False: it is about to be.
    """
    level = joint.table["Status Return Level"]
    joint.bus.write_all(level.address, {joint.id: b"\x02"})  # before any question: it may answer nothing but pings
    joint.held = joint.get("Torque Enable") == 1
    joint.complain()
    if joint.servo.homing is not None and (joint.get("Operating Mode") != joint.mode or not homed):
        home_mark.wipe(joint)
    if homed:
        home_mark.recall(joint)
    _set_mode(joint)
    # a largest value of zero was never set, and the factory's holds
    joint.max_temperature_c = joint.get("Temperature Limit") or joint.max_temperature_c
    if highest_dv := joint.get("Max Voltage Limit"):
        joint.voltage_limits_v = joint.get("Min Voltage Limit") / 10, highest_dv / 10
    if joint.servo.homing is None:
        joint.count_limits = joint.get("Min Position Limit"), joint.get("Max Position Limit") or COUNTS - 1
    joint.full_current = joint.get("Current Limit") if "Current Limit" in joint.table else 1000
    if joint.mode == EXTENDED_CURRENT_MODE:  # a homing that was cut off leaves little
        joint.write("Goal Current", joint.full_current)
    joint.check_reach()
    fastest = joint.get("Velocity Limit") or LARGEST_PROFILE
    set_profile(joint, joint.axis.speed_deg_per_s, acceleration_deg_per_s2, fastest)
    joint.send_profile()  # before the watchdog is cleared, and after it, since running out sets the profile to 0
    released = watchdog.clear(joint)
    joint.send_profile()
    joint.require_profile()
    position = _position_at_torque_on(joint)
    if not joint.count_limits[0] <= position <= joint.count_limits[1]:
        raise DeviceError(
            f"axis {joint.name} stands at count {position}, outside the servo's limits, {joint.count_limits[0]} "
            f"to {joint.count_limits[1]}; turn it by hand to where it may stand, then try again"
        )
    if homed:
        joint.require_between_stops(joint.to_deg(position), "zero_count, direction or gear_ratio")
    if released or not _holds(joint, position):
        joint.write("Goal Position", position)  # goal = present, so that torque moves nothing
    joint.write("Torque Enable", 1)
    if joint.get("Torque Enable") != 1:
        raise DeviceError(f"axis {joint.name}: servo id {joint.id} does not take its torque")
    if joint.distance_deg(now := joint.get("Present Position"), position) > HELD_DEG:
        joint.write("Torque Enable", 0)
        raise DeviceError(
            f"axis {joint.name}: servo id {joint.id} stood at count {position}, and reads {now} with its torque on; "
            "turn it by hand to where it may stand, then try again"
        )


def _set_mode(joint: Joint) -> None:
    """Write what of mode, offset and limits the servo has otherwise, with its torque off."""
    wanted = {"Operating Mode": joint.mode, "Drive Mode": 0, "Homing Offset": 0} | joint.also
    if joint.servo.current_limit is not None:
        wanted["Current Limit"] = joint.servo.current_limit
    if joint.get(SHADOW) <= LAST_ID:  # it would obey what is meant for another servo
        wanted[SHADOW] = NO_ID
    wrong = {name: value for name, value in wanted.items() if joint.get(name) != value}
    if wrong:
        changes = ", ".join(f"{name} = {value}" for name, value in wrong.items())
        log.warning("axis %s: setting %s in the servo", joint.name, changes)
        joint.write("Torque Enable", 0)
        for name, value in wrong.items():
            joint.write(name, value)


def _position_at_torque_on(joint: Joint) -> int:
    """Where the servo stands [counts]: without torque it counts turns on, and comes back within one with it.

    ROBOTIS e-Manual, "Present Position(132)": continuous while torque is off, in whatever mode; an absolute position
    within one turn once torque comes on in Position mode.
    """
    position = joint.get("Present Position")
    turns_count = joint.get("Operating Mode") == POSITION_MODE and joint.get("Torque Enable") != 1
    return position % COUNTS if turns_count else position


def _holds(joint: Joint, position: int) -> bool:
    """Whether the servo stands and holds: a load keeps it off its goal, and a new goal there would let it sag."""
    if joint.get("Torque Enable") != 1 or joint.get("Moving") or joint.get("Moving Status") & PROFILE_ONGOING:
        return False
    return joint.distance_deg(joint.get("Goal Position"), position) <= HELD_DEG
