"""The servo arms through the real SDK against the twin: opening, limits, landing, approach, readback, health."""

import contextlib
import functools
import itertools
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import serial
from gonio_drivers import control_table, joints, settings, watchdog
from gonio_drivers.arms import ServoArms
from gonio_drivers.dynamixel import Bus
from gonio_drivers.joints import COUNTS
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire import tables
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.peer import SerialPeer, scaled_clock
from gonio_sim.wire.servo import Mechanics, Servo
from gonio_sim.wire.tables import Refused

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Pose
from gonio.lab.rig.description import Acquisition, ArmAxis, Arms, Holder, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Band, Bands
from tests.gonio_drivers.conftest import BAUD, Line, be_patient, deaf_to
from tests.gonio_drivers.virtual import PORT, VirtualClock, servo_bus
from tests.places import ROOT

TOLERANCE_DEG = 0.15
COUNT_DEG = 360 / COUNTS


def describe(**axes: Any) -> RigDescription:
    return RigDescription(
        rig="lab",
        name="bench",
        arms=Arms(light=axes.get("light", ArmAxis()), camera=axes.get("camera", ArmAxis())),
        holder=axes.get("holder", Holder(axes=("tilt",))),
        reference=Reference(how="swap"),
        bands=Bands(list=(Band(name="green", centre_nm=550, fwhm_nm=10),)),
        acquisition=Acquisition(approach_deg=1.0),
    )


def servos(port: str, **changes: Any) -> settings.Servos:
    axes = {name: {"id": k, "model": "xm430-w350"} for k, name in enumerate(("light", "camera", "tilt"), 1)}
    for name in tuple(changes):
        if name in axes:
            axes[name] |= changes.pop(name)
    table = {"port": port, "baud": BAUD, "axes": axes, "settle_s": 0.02} | changes
    return settings.Servos.model_validate(table)


def pose(light: float = 0.0, camera: float = 0.0, tilt: float = 0.0) -> Pose:
    return Pose(light=math.radians(light), camera=math.radians(camera), tilt=math.radians(tilt))


def degrees(read: Pose) -> tuple[float, float, float]:
    return math.degrees(read.light), math.degrees(read.camera), math.degrees(read.tilt)


def lands(arms: ServoArms, *goal: float, within_deg: float = TOLERANCE_DEG) -> bool:
    """Whether a move ends where it should, by the readback."""
    return degrees(arms.move(pose(*goal))) == pytest.approx(goal, abs=within_deg)


@pytest.fixture
def arms(line: Line) -> Iterator[ServoArms]:
    with ServoArms(describe(), servos(line.port)) as opened:
        yield opened


BRAKING_S = 1.0
"""A stop at 30 deg/s and 90 deg/s^2 takes 0.33 s, and the 5 deg back to where it was told to stay 0.47 s."""


def at_rest(line: Line) -> bool:
    """Whether every shaft stands, or has at most the way to go that a stop leaves, on the twins' clock."""
    return not any(
        servo.powered and servo.moves() and servo._path.end_s - servo._clock() > BRAKING_S
        for servo in line.servos.values()
    )


# ---- opening ----


def test_opening_turns_nothing_and_sets_a_profile_before_torque(line: Line) -> None:
    line.servos[1].write(116, (3000).to_bytes(4, "little"))  # a goal left over from somebody else
    before = {k: servo.shaft()[0] for k, servo in line.servos.items()}
    with ServoArms(describe(), servos(line.port)):
        for k, servo in line.servos.items():
            assert servo.shaft() == (before[k], 0.0)
            assert servo.torque
            assert servo.get("Goal Position") == before[k]
            assert servo.get("Profile Velocity") == 21  # 30 deg/s in units of 1.374 deg/s, rounded down
            assert servo.get("Profile Acceleration") == 4  # 90 deg/s^2 in units of 21.46 deg/s^2, rounded down


@pytest.mark.parametrize(("on_exit", "torque"), [("torque-off", False), ("hold", True)])
def test_leaving(line: Line, on_exit: str, torque: bool) -> None:
    with ServoArms(describe(), servos(line.port, on_exit=on_exit)):
        pass
    assert {servo.torque for servo in line.servos.values()} == {torque}


def test_wrong_modes_offsets_and_silence_are_put_right(line: Line) -> None:
    line.servos[1].write(11, b"\x01")  # velocity mode
    line.servos[2].write(20, (100).to_bytes(4, "little"))  # homing offset
    line.servos[2].write(12, b"\x01")  # obeys what is meant for servo 1
    line.servos[2].write(68, b"\x00")  # answers nothing but pings
    line.servos[3].write(68, b"\x01")  # answers reads only
    right = {1: {"Operating Mode": 3, "Current Limit": 500}, 3: {"Status Return Level": 2}}
    right[2] = {"Homing Offset": 0, "Status Return Level": 2, "Secondary(Shadow) ID": 255}
    with ServoArms(describe(), servos(line.port, light={"current_limit": 500})):
        for k, items in right.items():
            assert {name: line.servos[k].get(name) for name in items} == items


def test_discovery_by_broadcast_ping_hears_again_what_was_damaged(line: Line) -> None:
    with Bus(line.port, BAUD) as bus:
        line.faults.arm("corrupt-crc", servo=2)
        assert bus.discover() == {k: (1020, 46) for k in (1, 2, 3)}


def test_a_servo_that_keeps_no_profile_is_not_moved(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    put = line.servos[2].registers.put
    monkeypatch.setattr(line.servos[2].registers, "put", lambda n, v: put(n, 0 if n == "Profile Velocity" else v))
    fast = ServoArms(describe(), servos(line.port))
    with pytest.raises(DeviceError, match=r"axis camera: servo id 2 does not keep its profile.*'Profile Velocity': 0"):
        fast.__enter__()
    assert not line.servos[2].torque


def test_a_servo_that_measures_no_voltage_is_not_taken_for_one_without_a_supply(line: Line) -> None:
    put = line.servos[2].registers.put
    line.servos[2].registers.put = lambda name, value: put(name, 0 if name == "Present Input Voltage" else value)  # type: ignore[method-assign]
    with ServoArms(describe(), servos(line.port)) as arms:
        assert arms.joints["camera"].report.voltage_v == 0  # type: ignore[union-attr]


@pytest.mark.slow
def test_wrong_baud_names_the_right_one(wired: Line) -> None:
    wrong = ServoArms(describe(), servos(wired.port, baud=2_000_000))
    with pytest.raises(DeviceError, match=r"at 2000000 baud, but at 1000000 baud: id 1.*devices\.servos\.baud"), wrong:
        pass


def test_a_baud_that_the_sdk_has_not(line: Line) -> None:
    with pytest.raises(ConfigError, match=r"devices\.servos\.baud = 12345"), Bus(line.port, 12_345):
        pass


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tilt": {"id": 7}}, r"axes\.tilt\.id = 7.*found there: id 1 xm430-w350, id 2"),
        (
            {"camera": {"model": "xl430-w250"}},
            r'axes\.camera\.model = "xl430-w250", but servo id 2 .* is a xm430-w350',
        ),
        ({"port": "/dev/there-is-none"}, r'servos\.port = "/dev/there-is-none": there is no such port'),
        ({"port": os.devnull}, "this is no serial port"),
    ],
)
def test_what_is_not_as_the_rig_file_says_is_named(line: Line, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(DeviceError, match=message):
        ServoArms(describe(), servos(**{"port": line.port} | changes)).__enter__()


def test_port_taken_by_this_program_or_another(wired: Line) -> None:
    with (
        ServoArms(describe(), servos(wired.port)),
        pytest.raises(DeviceError, match=r"the port is taken"),
        ServoArms(describe(), servos(wired.port)),
    ):
        pass


def test_the_lock_is_held_after_a_change_of_speed(wired: Line) -> None:
    with Bus(wired.port, BAUD) as bus:
        bus.set_baud(115_200)
        with pytest.raises(serial.SerialException):
            serial.Serial(wired.port, exclusive=True)


def test_a_program_that_takes_no_lock_is_named(wired: Line) -> None:
    rival = subprocess.Popen(["sleep", "60"], stdin=os.open(wired.port, os.O_RDWR | os.O_NOCTTY))
    try:
        with pytest.raises(DeviceError, match=rf"taken by process {rival.pid} \(sleep\)"), Bus(wired.port, BAUD):
            pass
    finally:
        rival.kill()
        rival.wait()


def test_no_permission(wired: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port: [Errno 13] Permission denied")

    monkeypatch.setattr(serial, "Serial", refused)
    with pytest.raises(DeviceError, match=r"no permission.*usermod"), Bus(wired.port, BAUD):
        pass


# ---- mapping ----


def test_direction_gear_zero_and_offset(line: Line) -> None:
    description = describe(
        light=ArmAxis(zero_offset_deg=0.5), camera=ArmAxis(zero_offset_deg=3.0, zero_offset_known=False)
    )
    built = servos(line.port, light={"direction": -1, "zero_count": 2000}, tilt={"gear_ratio": 2.0})
    with ServoArms(description, built) as arms:
        read = degrees(arms.move(pose(10, 20, 30)))
        positions = {k: servo.get("Present Position") for k, servo in line.servos.items()}
    assert positions[1] == round(2000 - 10.5 / COUNT_DEG)
    assert positions[2] == round(2048 + 20 / COUNT_DEG)
    assert positions[3] == round(2048 + 2 * 30 / COUNT_DEG)
    # half a count, of half the size where the gear doubles it
    assert read == pytest.approx((10, 20, 30), abs=COUNT_DEG / 2)


def test_limits_refuse_and_move_nothing(arms: ServoArms, line: Line) -> None:
    before = [servo.shaft()[0] for servo in line.servos.values()]
    with pytest.raises(ConfigError, match=r"camera = 91 deg is outside this axis's limits, -90 to 90 deg"):
        arms.move(pose(camera=91))
    with pytest.raises(ConfigError, match=r"spin = 3 deg: the rig has no such axis"):
        arms.move(Pose(spin=math.radians(3)))
    with pytest.raises(ConfigError, match=r"finite"):
        arms.move(Pose(light=math.nan))
    assert [servo.shaft()[0] for servo in line.servos.values()] == before


@pytest.mark.parametrize(
    ("tilt", "message"),
    [
        (
            {"model": "xl430-w250", "current_limit": 300},
            r"axes\.tilt\.current_limit = 300: a xl430-w250 has no",
        ),
        ({"model": "xm430-w351"}, "xm430-w351"),
        ({"gear_ratio": 3.0}, r"axis tilt.*need counts .* Position mode has 0 to 4095"),
        ({"current_limit": 5000}, r"axes\.tilt\.current_limit = 5000: the Current Limit of a xm430-w350 is 1 to 1193"),
        ({"current_limit": 1194}, r"1 to 1193, in units of 2\.69 mA"),
        ({"model": "xl330-m288", "current_limit": 1751}, r"a xl330-m288 is 1 to 1750, in units of 1 mA"),
        ({"model": "xh430-v210", "current_limit": 690}, r"is 1 to 689"),
        (
            {"homing": {"how": "stall", "current": 2000, "at_deg": 0.0}},
            r"axes\.tilt\.homing\.current = 2000: .*1 to 1193",
        ),
        (
            {"homing": {"how": "stall", "current": 100, "at_deg": 0.0, "speed_deg_per_s": 1.0}},
            r"homing\.speed_deg_per_s = 1: its servo turns it at 1\.374 deg/s or more",
        ),
        ({"gear_ratio": 0.01}, r"axis tilt, speed_deg_per_s = 30: its servo turns it at 137\.4 deg/s or more"),
        ({"gear_ratio": 0.1}, r"acceleration_deg_per_s2 = 90: the servo of axis tilt gives it 214\.6 to"),
    ],
)
def test_what_no_register_of_the_servo_holds_is_refused_with_its_range(tilt: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ServoArms(describe(), servos("/dev/null", tilt=tilt))


def test_the_largest_current_limit_of_every_model_is_taken_by_its_twin() -> None:
    """The drivers' table and the twins' were written apart; ROBOTIS e-Manual, "Current Limit(38)" of each model."""
    for model in control_table.models().values():
        with contextlib.suppress(ConfigError):
            twin = tables.table(model)
            if "Current Limit" in twin.items:
                assert control_table.highest_current(model) == twin.ranges["Current Limit"][1], model


def test_axes_and_servos_must_match() -> None:
    with pytest.raises(ConfigError, match=r"devices\.servos\.axes\.spin is missing"):
        ServoArms(describe(holder=Holder(axes=("tilt", "spin"))), servos("/dev/null"))
    with pytest.raises(ConfigError, match=r"devices\.servos\.axes\.tilt: the rig has no axis tilt"):
        ServoArms(describe(holder=Holder()), servos("/dev/null"))


# ---- landing ----


def test_every_landing_is_within_the_tolerance_and_reached_from_below(
    arms: ServoArms, line: Line, unwatched: None
) -> None:
    goals: dict[int, list[int]] = {k: [] for k in line.servos}
    for servo in line.servos.values():
        servo.mechanics = Mechanics(short_counts=6)  # friction: 0.53 deg, more than the tolerance
    for k, servo in line.servos.items():
        servo.leaving = functools.partial(lambda k, servo: goals[k].append(servo.get("Goal Position")), k, servo)
    for target in [(30, -20, 10), (-30, 40, -5), (-30.5, 40, 15)]:
        for told in goals.values():
            told.clear()
        assert lands(arms, *target)
        for told in goals.values():
            assert told == [] or told[-1] > min(told[:-1], default=-1)  # the last way leads upward
    assert at_rest(line)


def test_before_it_is_opened(line: Line) -> None:
    arms = ServoArms(describe(), servos(line.port))
    arms.stop()  # never raises
    with pytest.raises(DeviceError, match="is not open: enter the rig first"):
        arms.read()


@pytest.mark.parametrize("tells", [True, False])
def test_an_axis_that_creeps_is_not_taken_for_one_that_has_landed(
    tells: bool, unwatched: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not tells:  # a servo that keeps its moving status to itself
        monkeypatch.setattr(joints, "PROFILE_ONGOING", 0)
    clock = scaled_clock(1.0)
    twins = [Servo(k, clock, model="xm430-w350", baud=BAUD, mechanics=Mechanics(short_counts=0.4)) for k in (1, 2, 3)]
    told: list[int] = []
    twins[0].leaving = lambda: told.append(twins[0].get("Goal Position"))
    slow = ArmAxis(speed_deg_per_s=1.4)  # a count in three polls, and below the threshold of the servo's moving flag
    bus = ServoBus(twins)
    with SerialPeer(bus) as peer:
        be_patient(peer, bus.faults, monkeypatch)
        with ServoArms(describe(light=slow), servos(peer.port, settle_s=0.0)) as arms:
            read = degrees(arms.move(pose(0.8, 0, 0)))
            assert not twins[0].moves()
            assert read[0] == pytest.approx(0.8, abs=TOLERANCE_DEG)
            assert told == [2048, 2046, 2057]  # torque, 1 deg below, the goal: no correction


def test_a_repeated_goal_moves_nothing(arms: ServoArms, line: Line) -> None:
    first = arms.move(pose(10, 10, 10))
    told = []
    for servo in line.servos.values():
        servo.leaving = lambda: told.append(1)
    assert arms.move(pose(10, 10, 10)) == first
    assert told == []


def test_the_readback_is_returned_and_not_the_goal(arms: ServoArms, line: Line, hours: VirtualClock) -> None:
    before = hours.monotonic()
    read = arms.move(pose(10.04, 0, 0))
    expected = (line.servos[1].get("Present Position") - 2048) * COUNT_DEG
    assert math.degrees(read.light) == pytest.approx(expected, abs=1e-9)
    assert arms.last is not None
    assert before < arms.last.time_s < hours.monotonic()


def test_park_and_stop(arms: ServoArms, line: Line) -> None:
    arms.park()
    assert degrees(arms.read()) == pytest.approx((-90, 90, 0), abs=TOLERANCE_DEG)
    arms.stop()
    assert at_rest(line)
    assert all(servo.torque for servo in line.servos.values())


def test_an_axis_that_takes_too_long_stops_every_axis(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    arms.move(pose(0, 0, 0))
    monkeypatch.setattr("gonio_drivers.motion.GRACE_S", 0.2)
    monkeypatch.setattr(arms._motion, "duration_s", lambda *_: 0.1)  # this servo creeps
    line.servos[1]._limits = lambda way=0.0: (1.0, 1e6)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match=r"no landing within \d+\.\d s: axis light"):
        arms.move(pose(80, 0, 0))
    assert at_rest(line)


def test_a_servo_with_a_low_velocity_limit_gets_the_time_that_it_needs(line: Line) -> None:
    line.servos[1].write(44, (10).to_bytes(4, "little"))  # 13.7 deg/s where 30 are asked
    with ServoArms(describe(), servos(line.port)) as arms:
        assert line.servos[1].get("Profile Velocity") == 10
        assert arms._motion.duration_s("light", 0, 4096 / 4) == pytest.approx(90 / 13.74, rel=0.1)  # and the ramps


# ---- the bus watchdog ----


def test_a_bus_watchdog_that_has_run_out_is_cleared_and_told_and_costs_no_profile(
    line: Line, caplog: pytest.LogCaptureFixture
) -> None:
    for servo in line.servos.values():
        servo.registers.put("Bus Watchdog", 25)
        run_out(servo)
    with ServoArms(describe(), servos(line.port)) as arms:
        assert "axis camera: servo id 2 had stopped by itself" in caplog.text
        assert {servo.get("Profile Velocity") for servo in line.servos.values()} == {21}
        assert lands(arms, 10, 20, 30)


def test_the_watchdog_is_armed_for_the_length_of_a_motion(arms: ServoArms, line: Line, unwatched: None) -> None:
    seen: set[int] = set()
    line.servos[1].leaving = lambda: seen.add(line.servos[1].get("Bus Watchdog"))
    arms.move(pose(30, 20, 10))
    assert seen == {watchdog.UNITS}
    assert {servo.get("Bus Watchdog") for servo in line.servos.values()} == {0}
    arms.park()
    arms.stop()
    assert {servo.get("Bus Watchdog") for servo in line.servos.values()} == {0}


@pytest.mark.parametrize("forgets", [False, True])
def test_a_program_that_is_held_up_in_mid_move_sends_the_servos_on(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, forgets: bool
) -> None:
    def held_up() -> None:
        for servo in line.servos.values():
            if servo.get("Bus Watchdog") > 0:
                servo._heard_s -= 1.0  # as if it had heard nothing for a second: it stopped before it set out
                servo.shaft()
                if forgets:  # where a stop clears the profile
                    servo.registers.put("Profile Velocity", 0)

    at_look(3, arms, monkeypatch, held_up)  # the first look at the servos on their way
    assert lands(arms, 60, 50, -40)
    assert "the servo stopped; sent on" in caplog.text
    assert {servo.get("Bus Watchdog") for servo in line.servos.values()} == {0}


def test_a_watchdog_that_runs_out_at_the_end_of_a_move_is_no_restart(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    real, calls = watchdog.call_off, itertools.count()

    def late(moving: Any) -> Any:
        for servo in line.servos.values() if next(calls) == 0 else ():
            run_out(servo)
        return real(moving)

    monkeypatch.setattr(watchdog, "call_off", late)
    assert lands(arms, 10, 20, 30)
    assert {servo.get("Profile Velocity") for servo in line.servos.values()} == {21}
    assert lands(arms, 12, 22, 32)
    arms.still()


def run_out(servo: Servo) -> None:
    """The bus watchdog expires: the profile is 0 then (ROBOTIS e-Manual, "Bus Watchdog(98)")."""
    if servo.get("Bus Watchdog") > 0:
        for name, value in (("Bus Watchdog", -1), ("Profile Velocity", 0), ("Profile Acceleration", 0)):
            servo.registers.put(name, value)


def test_a_profile_that_was_lost_is_given_again_before_anything_moves(arms: ServoArms, line: Line) -> None:
    arms.move(pose(10, 20, 30))
    line.servos[2].registers.put("Profile Velocity", 0)
    arms.still()
    assert line.servos[2].get("Profile Velocity") == 21
    line.servos[2].registers.put("Profile Velocity", 0)
    fastest: list[int] = []
    line.servos[2].leaving = lambda: fastest.append(line.servos[2].get("Profile Velocity"))
    arms.move(pose(10, 30, 30))
    assert set(fastest) == {21}


def test_a_servo_that_has_restarted_is_an_error_wherever_that_shows(arms: ServoArms, line: Line) -> None:
    arms.move(pose(10, 20, 30))
    line.servos[2].restart()
    line.servos[2]._back_at = None
    with pytest.raises(DeviceError, match=r"servo id 2 .*has restarted by itself"):
        arms.still()
    assert arms.faulted


def test_a_pose_is_the_mean_of_several_readings_and_their_spread_is_told(arms: ServoArms, line: Line) -> None:
    arms.move(pose(10, 20, 30))
    steady = arms.read()
    assert math.degrees(arms.spread.camera) <= 2 * COUNT_DEG  # quantisation
    put, jitter = line.servos[2].registers.put, itertools.cycle((-5, 0, 5, 3, -3))
    line.servos[2].registers.put = lambda n, v: put(n, v + next(jitter) if n == "Present Position" else v)  # type: ignore[method-assign,assignment]
    assert arms.read().camera == pytest.approx(steady.camera, abs=1e-9)  # the jitter's mean is 0
    assert math.degrees(arms.spread.camera) == pytest.approx(10 * COUNT_DEG)
    assert math.degrees(arms.spread.light) <= COUNT_DEG


def test_a_servo_that_stops_again_and_again_is_an_error_that_says_why(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watchdog, "UNITS", 1)
    monkeypatch.setattr("gonio_drivers.motion.POLL_S", 0.03)  # longer than the period of 0.02 s
    line.servos[1]._limits = lambda way=0.0: (1.0, 1e6)  # type: ignore[method-assign]  # it never arrives
    with pytest.raises(DeviceError, match=r"has stopped 4 times on one way.*overloaded"):
        arms.move(pose(90, 0, 0))
    assert at_rest(line)


@pytest.mark.parametrize("answer", ["a refusal", "nothing is kept", "none"])
def test_old_firmware_without_a_watchdog_moves_and_says_so(
    line: Line, caplog: pytest.LogCaptureFixture, answer: str
) -> None:
    for servo in line.servos.values():
        read, put = servo.read, servo.registers.put
        if answer == "a refusal":
            servo.read = functools.partial(lambda read, a, n: refuse() if a == 98 else read(a, n), read)  # type: ignore[method-assign]
        else:
            servo.registers.put = functools.partial(lambda put, n, v: put(n, 0 if n == "Bus Watchdog" else v), put)  # type: ignore[method-assign]
    if answer == "none":
        deaf_to(line, bytes([p2.READ, 98, 0]))

    def refuse() -> bytes:
        raise Refused(p2.ACCESS_ERROR)

    with ServoArms(describe(), servos(line.port)) as arms:
        assert lands(arms, 10, 20, 30)
    assert "servo id 3 has no bus watchdog" in caplog.text


@pytest.mark.slow
def test_after_kill_9_in_mid_move_the_servos_stop_within_the_period(caplog: pytest.LogCaptureFixture) -> None:
    clock = scaled_clock(1.0)
    servo = {k: Servo(k, clock, model="xm430-w350", baud=BAUD) for k in (1, 2, 3)}
    with SerialPeer(ServoBus(servo.values())) as peer:
        program = (
            "from gonio_drivers import sdk\n"
            "from tests.gonio_drivers.test_arms import ServoArms, describe, pose, servos\n"
            "sdk.PATIENCE_MS = 60_000\n"  # this process may be the one that is held up
            f"with ServoArms(describe(), servos({peer.port!r})) as arms:\n    arms.move(pose(85, 85, 0))\n"
        )
        with subprocess.Popen([sys.executable, "-c", program], cwd=ROOT) as killed:
            while servo[1].shaft()[1] < 300:  # counts/s: at full speed, 30 deg/s
                assert killed.poll() is None
            killed.kill()
        at = [servo[k].shaft()[0] for k in (1, 2)]
        while servo[1].moves() or servo[2].moves():
            pass
        # 29 deg/s for the period, and 20 ms of it had passed since the last poll
        way = [(servo[k].shaft()[0] - before) * COUNT_DEG for k, before in zip((1, 2), at, strict=True)]
        assert max(way) <= 29 * watchdog.PERIOD_S
        assert servo[1].torque
        assert servo[1].shaft()[0] * COUNT_DEG < 180 + 80
        with ServoArms(describe(), servos(peer.port)) as arms:
            assert "servo id 1 had stopped by itself, because a program died" in caplog.text
            here = degrees(arms.read())
            assert degrees(arms.move(pose(here[0] + 2, here[1], 0)))[0] == pytest.approx(here[0] + 2, abs=0.15)


def at_look(number: int, arms: ServoArms, monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> None:
    """Act just before the bus is read for the n-th time."""
    real, calls = arms.bus.read_all, itertools.count(1)

    def looked(*arguments: Any) -> Any:
        if next(calls) == number:
            act()
        return real(*arguments)

    monkeypatch.setattr(arms.bus, "read_all", looked)


def test_an_interruption_in_the_middle_of_a_move_stops_every_axis(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    at_look(4, arms, monkeypatch, interrupted)
    with pytest.raises(KeyboardInterrupt):
        arms.move(pose(80, 80, 40))
    assert at_rest(line)
    assert arms.stopped
    assert not arms.faulted


# ---- health ----


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("overheat", "servo id 2 reports: overheated"),
        ("voltage-alarm", "servo id 2 reports: input voltage out of range"),
        ("reboot", "servo id 2"),
        ("dropout", "servo id 2"),
        ("stall", "stuck|overloaded"),
    ],
)
def test_an_unwell_servo_stops_every_axis(arms: ServoArms, line: Line, fault: str, message: str) -> None:
    arms.move(pose(0, 0, 0))
    line.faults.arm(fault, servo=2)
    with pytest.raises(DeviceError, match=message):
        arms.move(pose(20, 20, 0))
    line.servos[2].unblock()
    assert at_rest(line)
    with pytest.raises(DeviceError, match=r"stopped after a failure"):
        arms.move(pose(0, 0, 0))


def test_heat_is_noticed_before_the_servo_lets_go(arms: ServoArms, line: Line) -> None:
    line.servos[3].temperature_c = line.servos[3].get("Temperature Limit") - 1
    with pytest.raises(DeviceError, match=r"servo id 3 is at 79 C, and its limit is 80 C"):
        arms.read()


def test_a_flicker_of_the_encoder_is_no_motion(arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two counts to one side while it landed, and two to the other side: four apart, and nothing has moved."""
    flicker: Iterator[int] = itertools.repeat(2)
    put = line.servos[1].registers.put
    flickers = lambda name, value: put(name, value + (next(flicker) if name == "Present Position" else 0))  # noqa: E731
    monkeypatch.setattr(line.servos[1].registers, "put", flickers)
    arms.move(pose(10, 0, 0))
    flicker = itertools.cycle([-2, 2])
    for _ in range(4):
        arms.still()


def test_an_axis_that_has_let_go_is_noticed(arms: ServoArms, line: Line) -> None:
    arms.move(pose(0, 0, 0))
    line.servos[3].write(64, b"\x00")
    with pytest.raises(DeviceError, match=r"axis tilt: servo id 3 has let go of its torque"):
        arms.still()
    assert at_rest(line)


def test_an_axis_that_lets_go_on_its_way_is_not_called_stuck(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_look(4, arms, monkeypatch, lambda: line.servos[2].write(64, b"\x00"))
    with pytest.raises(DeviceError, match=r"axis camera: servo id 2 has let go of its torque"):
        arms.move(pose(0, 80, 0))
    assert at_rest(line)


def test_the_hardware_error_byte_is_read_after_every_move_alert_or_not(
    arms: ServoArms, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    arms.move(pose(0, 0, 0))
    monkeypatch.setattr(type(line.servos[1]), "error", 0)  # a firmware that forgets the alert bit
    line.servos[1].registers.put("Hardware Error Status", 0x08)
    with pytest.raises(DeviceError, match=r"axis light: servo id 1 reports: encoder or motor fault"):
        arms.move(pose(5, 0, 0))


# ---- servos of other kinds ----


@pytest.mark.parametrize(
    ("baud", "delay", "level", "mode", "built"),
    [
        (9_600, 0, 0, 3, {"light": (252, "xl330-m288", 1, 1.0), "camera": (0, "xl430-w250", -1, 1.0)}),
        (57_600, 250, 2, 4, {"light": (0, "xm540-w270", -1, 2.0), "camera": (100, "xc430-w150", 1, 0.5)}),
        (115_200, 254, 1, 1, {"light": (7, "xh430-v350", 1, 0.5), "camera": (252, "xc330-t288", -1, 2.0)}),
        (4_000_000, 0, 1, 16, {"light": (42, "xh540-w270", -1, 1.0), "camera": (1, "xm430-w210", 1, 1.0)}),
    ],
)
def test_models_speeds_delays_and_ways_of_mounting(
    baud: int, delay: int, level: int, mode: int, built: dict[str, tuple[int, str, int, float]], hours: VirtualClock
) -> None:
    built = built | {"tilt": (9, "xm430-w350", 1, 1.0)}
    axes = {n: dict(zip(("id", "model", "direction", "gear_ratio"), v, strict=True)) for n, v in built.items()}
    friction = Mechanics(short_counts=8, noise_counts=1.4)
    twins: list[Servo] = []

    def made() -> list[Servo]:
        clock = scaled_clock(1.0)
        twins.extend(Servo(v[0], clock, model=v[1], baud=baud, mechanics=friction) for v in built.values())
        for servo in twins:
            for address, value in ((9, delay), (11, mode), (68, level)):
                servo.write(address, bytes([value]))
        return twins

    servo_bus(made)
    limits = ArmAxis(limits_deg=(-80, 80))
    with ServoArms(describe(light=limits, camera=limits), servos(PORT, baud=baud, **axes)) as arms:
        for target in [(35, -70, 20), (-77, 77, -20)]:  # friction of 8 counts needs room before a limit
            for name, servo, angle, goal in zip(built, twins, degrees(arms.move(pose(*target))), target, strict=True):
                count_deg = COUNT_DEG / axes[name]["gear_ratio"]  # type: ignore[operator]
                shaft_deg = (servo.shaft()[0] - 2048) * count_deg * axes[name]["direction"]  # type: ignore[operator]
                # a reading is whole counts, with 1.4 of flicker
                assert angle == pytest.approx(shaft_deg, abs=2 * count_deg)
                assert shaft_deg == pytest.approx(goal, abs=max(TOLERANCE_DEG, 1.5 * count_deg) + count_deg)


# ---- faults of the wire ----


@pytest.mark.parametrize("fault", ["silence", "late-reply", "corrupt-crc", "truncated-packet", "noise"])
def test_wire_faults_are_mended(arms: ServoArms, line: Line, fault: str) -> None:
    arms.move(pose(0, 0, 0))
    for k in (1, 2, 3):
        line.faults.arm(fault, servo=k)
        assert lands(arms, 5 * k, -5 * k, k)
    assert line.faults.fired == [fault] * 3


def test_answers_in_single_bytes_and_behind_an_echo_are_understood(line: Line) -> None:
    """An adapter without a direction switch returns what was sent; slow ones give a byte at a time."""
    receive = line.bus.receive

    def dribble(data: bytes, baud: int, send: Callable[[bytes], None]) -> None:
        def bytewise(answer: bytes) -> None:
            for byte in answer:
                send(bytes([byte]))

        send(data)
        receive(data, baud, bytewise)

    line.bus.receive = dribble  # type: ignore[method-assign]
    with ServoArms(describe(), servos(line.port)) as arms:
        assert lands(arms, 10, 20, 30)
