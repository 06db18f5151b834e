"""What the laboratory's devices say of themselves, as `gonio.rig.Health`: open ones, and ones that nobody has opened.

And what `gonio rig check` says of them, beyond the checks that every rig goes through (`rows`).

A survey changes nothing: no torque comes or goes, no lamp is lit or darkened, no frame is taken. (Some lamp controllers
restart when their port is opened, and are dark then.)
"""

import math
import statistics
from dataclasses import replace

from gonio.errors import GonioError
from gonio.rig import Health, Reading, clock
from gonio_drivers import control_table, dynamixel, home_mark, joints
from gonio_drivers.any_arms import AXES
from gonio_drivers.arms import ServoArms
from gonio_drivers.cameras import OpenableCamera
from gonio_drivers.light import SerialLight
from gonio_drivers.stages import StageArms

LOOKS = 5
"""Readings that an angle is the mean of: encoders flicker by a count."""
FLICKER_STEPS = 2.5
"""Readings at rest that lie farther apart, in steps of the encoder, do not tell where the axis stands."""
LAMP, CAMERA = "lamp", "frames"
Row = tuple[str, str, bool]
READINGS = 50
LANDINGS = 4
SLOW_MS = 12.0
"""An adapter with the usual latency timer of 16 ms takes longer than this."""
NOISE_DEG = 0.1
STEP_DEG = 3.0


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
        found += [
            _angle(joint, report.position),
            Reading(name, "temperature", report.temperature_c, "C", (-math.inf, joint.max_temperature_c)),
            _current(joint, report.current),
            Reading(name, "voltage", report.voltage_v, "V", joint.voltage_limits_v),
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


def _asked(joint: joints.Joint) -> list[Reading]:
    joint.identify_model()
    home_mark.recall(joint)
    name, report = joint.name, joint.reported(joint.bus.read(joint.id, *joints.span(joint.table)))
    highest, lowest = joint.get("Max Voltage Limit") / 10, joint.get("Min Voltage Limit") / 10
    moving = report.moving or report.under_way
    falsified = joint.falsified()
    places = [place for _ in range(LOOKS) if (place := joint.shaft_count()) is not None]
    error = joint.get("Hardware Error Status")
    hottest = joint.get("Temperature Limit") or joint.max_temperature_c
    apart_deg = joint.distance_deg(max(places), min(places)) if places else 0.0
    most_deg = max(FLICKER_STEPS * joint.axis.encoder_step_deg, FLICKER_STEPS / abs(joint.counts_per_deg))
    unsteady = Reading(name, "angle_spread", apart_deg, "deg", (0.0, most_deg))
    how = "taken out of the angle" if places else "the angle is not known"
    named = ", ".join(f"{item} = {value}" for item, value in falsified.items())
    return [
        *([_angle(joint, statistics.fmean(places))] if places else []),
        *([Reading(name, "settings", f"{named} in the servo: {how}; a move resets it")] if falsified else []),
        *([unsteady] if apart_deg > most_deg and not moving else []),
        Reading(name, "temperature", report.temperature_c, "C", (-math.inf, hottest)),
        _current(joint, report.current),
        Reading(name, "voltage", report.voltage_v, "V", (lowest, highest) if highest else None),
        Reading(name, "motion", "moves" if moving else "still"),
        Reading(name, "torque", "holds" if joint.get("Torque Enable") == 1 else "off"),
        Reading(name, "error", dynamixel.hardware_error(error) if error else "none"),
    ]


def _angle(joint: joints.Joint, count: float) -> Reading:
    return Reading(joint.name, "angle", joint.to_deg(count), "deg", joint.limits_deg)


def _current(joint: joints.Joint, value: int) -> Reading:
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


def rows(arms: ServoArms | StageArms, light: SerialLight, *, move: bool) -> list[Row]:
    """Servos (version, temperature, voltage), bus latency, readback noise, repeatability (where it may move), lamp."""
    if isinstance(arms, StageArms):
        out = [_stage(arms, name) for name in arms.joints]
    else:
        out = [_servo(arms, joint) for joint in arms.joints.values()]
        out += _bus(arms)
    if move:
        out += _repeatability(arms)
    light.check()
    reading = light.monitor()
    monitor = "" if reading is None else f", monitor {reading:g}"
    out.append(("lamp", f"{light}, dark{monitor}", not light.lit))
    return out


def _stage(arms: StageArms, name: str) -> Row:
    joint = arms.joints[name]
    said = joint.stage.state()
    home = "home found" if said.homed else "home not found"
    return f"{name} stage", f"{joint.stage}, {home}, error: {said.fault or 'none'}", not said.fault


def _servo(arms: ServoArms, joint: joints.Joint) -> Row:
    number, firmware = arms.bus.ping(joint.id)
    report = joint.report
    assert report is not None
    low, high = joint.voltage_limits_v
    good = report.temperature_c < joint.max_temperature_c - 10 and low <= report.voltage_v <= high
    return (
        f"{joint.name} servo",
        f"id {joint.id}, {joint.servo.model} ({number}), firmware {firmware}, {report.temperature_c} C, "
        f"{report.voltage_v:.1f} V, current {report.current}",
        good,
    )


def _bus(arms: ServoArms) -> list[Row]:
    """How long a reading of all servos takes, and how much it scatters at rest."""
    before = arms.bus.recovered
    times, counts = [], []
    for _ in range(READINGS):
        start = clock.monotonic()
        reading = arms.look()
        times.append(1e3 * (clock.monotonic() - start))
        counts.append(reading.counts)
    # a slow adapter delays every reading, and a busy computer some
    quickest, typical, worst = min(times), statistics.median(times), max(times)
    lost = arms.bus.recovered - before
    remedy = "" if quickest <= SLOW_MS else "; set the adapter's latency timer to 1 ms (docs/lab_setup.md)"
    noise = max(
        statistics.pstdev([c[name] for c in counts]) / abs(joint.counts_per_deg) for name, joint in arms.joints.items()
    )
    latency = f"{typical:.1f} ms for all servos, at most {worst:.1f} ms, {lost} of {READINGS} repeated{remedy}"
    return [
        ("bus latency", latency, quickest <= SLOW_MS and lost <= 1),
        ("readback noise", f"at most {noise:.3f} deg (standard deviation at rest)", noise <= NOISE_DEG),
    ]


def _repeatability(arms: ServoArms | StageArms) -> list[Row]:
    """Spread of landings on the same goal, away from it toward the middle of each axis's range and back."""
    here = arms.read()
    goals, away = {}, {}
    for name, joint in arms.joints.items():
        if name in AXES:  # and not the changer
            lower, upper = joint.limits_deg
            at = math.degrees(getattr(here, name))
            goals[name] = math.radians(min(max(at, lower), upper))  # a reading may lie a little outside
            away[name] = math.radians(at + STEP_DEG if at < (lower + upper) / 2 else at - STEP_DEG)
    landed = []
    for _ in range(LANDINGS):
        arms.move(replace(here, **away))
        landed.append(arms.move(replace(here, **goals)))
    worst = max(math.degrees(max(at) - min(at)) for at in ([getattr(pose, n) for pose in landed] for n in goals))
    return [("repeatability", f"{LANDINGS} landings within {worst:.3f} deg", worst <= 0.2)]
