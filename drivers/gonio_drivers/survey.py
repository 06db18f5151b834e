"""What lamp and camera say of themselves, as `gonio.lab.rig.Health`: open ones, and ones that nobody has opened.

Arms tell it by themselves. And what `gonio rig check` says of all, beyond the checks that every rig goes through.

A survey changes nothing: no torque comes or goes, no lamp is lit or darkened, no frame is taken. (Some lamp controllers
restart when their port is opened, and are dark then.)
"""

import math
import statistics
from dataclasses import replace

from gonio.errors import GonioError
from gonio.lab.rig import Health, Reading, clock
from gonio.lab.rig.kinematics import AXES
from gonio_drivers import joints
from gonio_drivers.arms import ServoArms
from gonio_drivers.cameras import OpenableCamera
from gonio_drivers.light import SerialLight
from gonio_drivers.stages import StageArms

LAMP, CAMERA = "lamp", "frames"
Row = tuple[str, str, bool]
READINGS = 50
LANDINGS = 4
SLOW_MS = 12.0
"""An adapter with the usual latency timer of 16 ms takes longer than this."""
NOISE_DEG = 0.1
STEP_DEG = 3.0


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
        if name in AXES:  # and neither changer nor polarisers
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
