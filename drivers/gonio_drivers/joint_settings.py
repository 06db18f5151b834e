"""Joints of a rig file: their servos, checked against what these can do."""

from __future__ import annotations

from gonio.errors import ConfigError
from gonio.rig.description import Axis, RigDescription
from gonio_drivers import control_table, home_mark, settings
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import COUNTS, MOST_TURNS, VELOCITY_UNIT_DEG_S, Joint


def joint(bus: Bus, description: RigDescription, name: str, servo: settings.ServoAxis) -> Joint:
    """The joint of an axis of the rig; `ConfigError` where its limits are beyond a turn of its servo."""
    table = control_table.of_model(servo.model, f"devices.servos.axes.{name}.model")
    axis, limits = description.axes()[name], description.limits_deg()[name]
    approach, stops = description.approach_deg()[name], description.hard_stops_deg()[name]
    return _checked(Joint(bus, name, servo, axis, limits, table, approach, stops))


def changer_joint(bus: Bus, changer: settings.Changer, approach_deg: float) -> Joint:
    """The joint of the sample changer, which is no axis of a pose; errors as of `joint`.

    What it may turn in is the range between its two places, and the way of approach to the outer one.
    """
    ends = (changer.sample_deg, changer.reference_deg)
    limits = min(ends) - max(0.0, approach_deg), max(ends) - min(0.0, approach_deg)
    axis = Axis(speed_deg_per_s=changer.speed_deg_per_s)
    table = control_table.of_model(changer.model, "devices.servos.changer.model")
    return _checked(Joint(bus, "changer", changer, axis, limits, table, approach_deg))


def _checked(joint: Joint) -> Joint:
    _check_current_limit(joint)
    _check_profile(joint)
    if joint.servo.homing is not None:
        home_mark.check(joint, joint.servo.homing)
        joint.count_limits = -MOST_TURNS * COUNTS, MOST_TURNS * COUNTS - 1
    joint.check_reach()
    return joint


def _check_current_limit(joint: Joint) -> None:
    model, homing = joint.servo.model, joint.servo.homing
    if joint.servo.current_limit is not None and "Current Limit" not in joint.table:
        raise ConfigError(
            f"{joint.key}.current_limit = {joint.servo.current_limit}: a {model} has no current limit; leave the key "
            "out"
        )
    highest = control_table.highest_current(model)
    pushes = None if homing is None else homing.current
    for key, value in (("current_limit", joint.servo.current_limit), ("homing.current", pushes)):
        if value is not None and value > highest:
            raise ConfigError(
                f"{joint.key}.{key} = {value}: the Current Limit of a {model} is 1 to {highest}, in units of "
                f"{control_table.current_unit_ma(model):g} mA"
            )


def _check_profile(joint: Joint) -> None:
    """The slowest that a profile can be: less would be rounded up to it."""
    slowest = VELOCITY_UNIT_DEG_S / joint.servo.gear_ratio
    speeds = [("speed_deg_per_s", joint.axis.speed_deg_per_s)]
    if joint.servo.homing is not None:
        speeds.append((f"{joint.key}.homing.speed_deg_per_s", joint.servo.homing.speed_deg_per_s))
    for key, speed in speeds:
        if speed < slowest * (1 - 1e-9):
            raise ConfigError(
                f"axis {joint.name}, {key} = {speed:g}: its servo turns it at {slowest:.4g} deg/s or more "
                f"(Profile Velocity 1, {joint.key}.gear_ratio = {joint.servo.gear_ratio:g})"
            )
