"""The servo arms through the real SDK against the twin: opening, limits, landing, approach, readback."""

import contextlib
import math
import os
import subprocess
from typing import Any

import pytest
import serial
from gonio_drivers import control_table, motion
from gonio_drivers.arms import ServoArms
from gonio_drivers.dynamixel import Bus
from gonio_sim.wire import tables

from gonio.errors import ConfigError, DeviceError
from gonio.lab.acquisition.duration import SETTLE_S, Durations
from gonio.lab.rig import Pose
from gonio.lab.rig.description import Holder
from tests.gonio_drivers.conftest import BAUD, Line
from tests.gonio_drivers.servo_arms import COUNT_DEG, at_rest, describe, pose, servos
from tests.gonio_drivers.virtual import VirtualClock

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


def test_before_it_is_opened(line: Line) -> None:
    arms = ServoArms(describe(), servos(line.port))
    arms.stop()  # never raises
    with pytest.raises(DeviceError, match="is not open: enter the rig first"):
        arms.read()


def test_the_readback_is_returned_and_not_the_goal(arms: ServoArms, line: Line, hours: VirtualClock) -> None:
    before = hours.monotonic()
    read = arms.move(pose(10.04, 0, 0))
    expected = (line.servos[1].get("Present Position") - 2048) * COUNT_DEG
    assert math.degrees(read.light) == pytest.approx(expected, abs=1e-9)
    assert arms.last is not None
    assert before < arms.last.time_s < hours.monotonic()


def test_moves_take_as_long_as_is_estimated(line: Line, hours: VirtualClock) -> None:
    """Starting and stopping was left out: of short moves a third of the time."""
    table = servos(line.port, settle_s=SETTLE_S)
    devices = {"servos": table.model_dump(mode="json")}
    description = describe().model_copy(update={"devices": devices})
    durations, here = Durations(description, description.bands.list), (0.0, 0.0, 0.0)
    with ServoArms(description, table) as arms:
        arms.move(pose(*here))
        for goal in ((30, 0, 0), (30, 10, 0), (0, 10, 0), (0, 15, 0), (0, 0, 25), (-60, 45, 25), (-58, 45, 25)):
            begin_s, estimated_s = hours.now_s, durations.move_s(pose(*here), pose(*goal))
            arms.move(pose(*goal))
            # the servo's unit of speed, 1.374 deg/s, is rounded down; each of two legs is seen to end three looks late
            late_s = 1.374 / 30.0 * estimated_s + 2 * 3 * motion.POLL_S
            assert 0.0 <= hours.now_s - begin_s - estimated_s <= late_s, goal
            here = goal


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
