"""What the laboratory's devices say of themselves, as `gonio.rig.Health`: open ones, and ones that nobody has opened.

A survey changes nothing: no torque comes or goes, no lamp is lit or darkened, no frame is taken. (Some lamp controllers
restart when their port is opened, and are dark then.)
"""

import math
import statistics

from gonio.errors import GonioError
from gonio.rig import Health, Reading
from gonio_drivers import control_table, dynamixel, home_mark, joints
from gonio_drivers.arms import ServoArms
from gonio_drivers.cameras import OpenableCamera
from gonio_drivers.joints import Joint
from gonio_drivers.light import SerialLight
from gonio_drivers.stages import StageArms

LOOKS = 5
"""Readings that an angle is the mean of: encoders flicker by a count."""
FLICKER_STEPS = 2.5
"""Readings at rest that lie farther apart, in steps of the encoder, do not tell where the axis stands."""
LAMP, CAMERA = "lamp", "frames"


def of_open_arms(arms: ServoArms | StageArms) -> Health:
    """Angles, temperatures, currents and voltages of servos that are open; one reading of the bus.

    Raises
    ------
    DeviceError
        A servo does not answer, or is unwell.
    """
    if isinstance(arms, StageArms):
        return arms.health()
    reports = joints.reports(arms.bus, arms.joints.values())
    found: list[Reading] = []
    for name, report in reports.items():
        joint = arms.joints[name]
        assert joint.health is not None
        found += [
            _angle(joint, report.position),
            Reading(name, "temperature", joint.health.temperature_c, "C", (-math.inf, joint.max_temperature_c)),
            _current(joint, joint.health.current),
            Reading(name, "voltage", joint.health.voltage_v, "V", joint.voltage_limits_v),
        ]
    return Health(tuple(found), {name: str(failure) for name, failure in arms.absent.items()})


def strain(arms: ServoArms | StageArms) -> Health:
    """The highest current and the lowest voltage in all reports of open servos since this was last asked.

    At rest the one is small and the other good: it is on the way that a supply sags.
    """
    found: list[Reading] = []
    if isinstance(arms, StageArms):  # their controllers tell no currents
        return Health(())
    for name, joint in arms.joints.items():
        if joint.strained:
            current, voltage = joint.strained
            most = _current(joint, abs(current.current))
            found += [
                Reading(name, f"{most.quantity}_max", most.value, most.unit),
                Reading(name, "voltage_min", voltage.voltage_v, "V"),
            ]
        joint.strained.clear()
    return Health(tuple(found))


def of_arms(arms: ServoArms | StageArms) -> Health:
    """The same of servos that nobody has opened, each by itself; and whether they hold, and what error they show."""
    if isinstance(arms, StageArms):
        return arms.survey()
    found: list[Reading] = []
    silent: dict[str, str] = {}
    try:
        with arms.bus:
            for name, joint in arms.every.items():  # one that cannot be opened may still say where it stands
                try:
                    found += _asked(joint)
                except dynamixel.BusError as failure:
                    if not found and not silent and not arms.bus.discover(rounds=1):
                        joint.identify()  # nobody is there: the message says what answers instead, if anything does
                    silent[name] = f"{failure}{arms.bus.elsewhere(joint.id)}"
                except GonioError as failure:
                    silent[name] = str(failure)
    except GonioError as failure:
        return Health((), dict.fromkeys(arms.every, str(failure)))
    return Health(tuple(found), silent)


def _asked(joint: Joint) -> list[Reading]:
    joint.identify_model()
    home_mark.recall(joint)
    name, (address, size) = joint.name, joints.span(joint.table)
    value = joints.reported(joint, joint.bus.read(joint.id, address, size))
    highest, lowest = joint.get("Max Voltage Limit") / 10, joint.get("Min Voltage Limit") / 10
    moving = bool(value["Moving"]) or bool(value["Moving Status"] & joints.PROFILE_ONGOING)
    falsified = joint.falsified()
    seen = [joint.shaft_count() for _ in range(LOOKS)]
    places = [place for place in seen if place is not None]
    error = joint.get("Hardware Error Status")
    hottest = joint.get("Temperature Limit") or joint.max_temperature_c
    volts = Reading(name, "voltage", value["Present Input Voltage"] / 10, "V", (lowest, highest) if highest else None)
    apart_deg = joint.distance_deg(max(places), min(places)) if places else 0.0
    most_deg = max(FLICKER_STEPS * joint.axis.encoder_step_deg, FLICKER_STEPS / abs(joint.counts_per_deg))
    unsteady = Reading(name, "angle_spread", apart_deg, "deg", (0.0, most_deg))
    how = "taken out of the angle" if places else "the angle is not known"
    named = ", ".join(f"{item} = {value}" for item, value in falsified.items())
    return [
        *([_angle(joint, statistics.fmean(places))] if places else []),
        *([Reading(name, "settings", f"{named} in the servo: {how}; a move resets it")] if falsified else []),
        *([unsteady] if apart_deg > most_deg and not moving else []),
        Reading(name, "temperature", value["Present Temperature"], "C", (-math.inf, hottest)),
        _current(joint, value.get("Present Current", value.get("Present Load", 0))),
        volts,
        Reading(name, "motion", "moves" if moving else "still"),
        Reading(name, "torque", "holds" if joint.get("Torque Enable") == 1 else "off"),
        Reading(name, "error", dynamixel.hardware_error(error) if error else "none"),
    ]


def _angle(joint: Joint, count: float) -> Reading:
    return Reading(joint.name, "angle", joint.to_deg(count), "deg", joint.limits_deg)


def _current(joint: Joint, value: int) -> Reading:
    if "Present Current" not in joint.table:  # an estimate from the motor's drive, in 0.1 %
        return Reading(joint.name, "load", value / 10, "%", (-100.0, 100.0))
    unit = control_table.current_unit_ma(joint.servo.model)
    most = joint.full_current * unit if joint.full_current else math.inf
    return Reading(joint.name, "current", value * unit, "mA", (-most, most) if math.isfinite(most) else None)


def of_open_light(light: SerialLight) -> Health:
    """Whether the lamp is lit, at which level, and what its monitor reads."""
    lit, level = light.state()
    found = [Reading(LAMP, "state", "lit" if lit else "dark"), Reading(LAMP, "level", level, "", (0.0, 1.0))]
    if (monitor := light.monitor()) is not None:
        found.append(Reading(LAMP, "monitor", monitor))
    if (locked := light.locked()) is not None:
        found.append(Reading(LAMP, "lock", "locked" if locked else "lost"))
    return Health(tuple(found))


def of_light(light: SerialLight) -> Health:
    """The same of a lamp that nobody has opened; it goes on as it is."""
    try:
        with light.looked_at():
            return of_open_light(light)
    except GonioError as failure:
        return Health((), {LAMP: str(failure)})


def of_camera(camera: OpenableCamera, driver: str) -> Health:
    """Whether the camera opens; no frame is taken."""
    try:
        with camera:
            return Health((Reading(CAMERA, "state", f'ready (driver "{driver}")'),))
    except GonioError as failure:
        return Health((), {CAMERA: str(failure)})
