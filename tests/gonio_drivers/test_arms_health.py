"""The servo arms when something is wrong: watchdogs, restarts, interruptions, faults of servos and of the wire."""

import functools
import itertools
import math
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from gonio_drivers import watchdog
from gonio_drivers.arms import ServoArms
from gonio_sim.wire import protocol2 as p2
from gonio_sim.wire.bus import ServoBus
from gonio_sim.wire.peer import SerialPeer, scaled_clock
from gonio_sim.wire.servo import Mechanics, Servo
from gonio_sim.wire.tables import Refused

from gonio.errors import DeviceError
from gonio.lab.rig.description import ArmAxis
from tests.gonio_drivers.conftest import BAUD, Line, deaf_to
from tests.gonio_drivers.servo_arms import COUNT_DEG, TOLERANCE_DEG, at_rest, degrees, describe, lands, pose, servos
from tests.gonio_drivers.virtual import PORT, VirtualClock, servo_bus
from tests.places import ROOT


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
            "from tests.gonio_drivers.servo_arms import ServoArms, describe, pose, servos\n"
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
    for k in (1, 2, 3):
        line.faults.arm(fault, servo=k)
    assert lands(arms, -45, 0, 30)
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
