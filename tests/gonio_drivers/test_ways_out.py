"""Every way out of a laboratory rig, over the twins: what is said of lamp and arms is what the twins are."""

import math
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from gonio_drivers import lamp_line, signals
from gonio_drivers.lab import LAB
from gonio_sim.wire import motion, tables
from gonio_sim.wire.servo import Servo
from gonio_sim.wire.twins import Twins

from gonio import platform
from gonio.errors import DeviceError, GonioError, Interrupted
from gonio.lab.acquisition.measure import RigChoice
from gonio.lab.acquisition.progress import Silent
from gonio.lab.commands.rigs import checks
from gonio.lab.rig import Pose
from tests.gonio_drivers.conftest import COMMAND, LONGEST_S, angle, by_hand, opened, written
from tests.gonio_drivers.test_lab import crawl, measure

pytestmark = pytest.mark.slow

SAID_DEG = 0.15
"""Rounding of what is said, flicker, and what a released axis gives way."""


def assert_true(said: str, twins: Twins) -> None:
    """What a message says of every axis and of the lamp is so."""
    found = re.findall(r"(light|camera|tilt|spin) (-?[\d.]+) deg, (holds|torque off)(, and moves still)?", said)
    assert [name for name, *_ in found] == list(twins.followers), said
    for name, degrees, held, moves in found:
        assert angle(twins, name) == pytest.approx(float(degrees), abs=SAID_DEG), said
        assert twins.servos[name].torque == (held == "holds"), said
        assert not moves
        assert not twins.servos[name].moves()
    parked = abs(angle(twins, "light") + 88) < 0.5 and abs(angle(twins, "camera") - 88) < 0.5
    assert ("arms parked" in said) <= parked, said
    assert ("lamp dark" in said) <= (not twins.lamp.shine.lit), said


def when_it_sets_out(servo: Servo, act: Callable[[], None], counts: float = 50.0, *, slow: bool = True) -> None:
    """Act once, when a servo makes for a goal that is some way off, which takes it minutes where it is `slow`."""
    follow = servo.leaving
    if slow:
        crawl(servo)

    def leaving() -> None:
        follow()
        if abs(servo.get("Goal Position") - servo.shaft()[0]) > counts:
            servo.leaving = follow
            act()

    servo.leaving = leaving


def struck(twins: Twins, tmp_path: Path, words: list[str], number: signal.Signals) -> subprocess.Popen[str]:
    """A command that gets a signal when the camera's axis sets out."""
    child: list[subprocess.Popen[str]] = []
    when_it_sets_out(twins.servos["camera"], lambda: child[0].send_signal(number))
    command = [*COMMAND, "rig", *words, "--rig", str(written(twins, tmp_path))]
    child.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
    return child[0]


# ---- signals ----


@pytest.mark.usefixtures("real_time")
def test_a_signal_in_mid_move_of_a_measurement_tells_where_the_arms_stand(twins: Twins, tmp_path: Path) -> None:
    number = signal.SIGXCPU
    when_it_sets_out(twins.servos["camera"], lambda: os.kill(os.getpid(), number))
    with pytest.raises(Interrupted) as stopped:
        measure(twins, tmp_path)
    said = str(stopped.value)
    assert said.startswith(f"stopped by {number.name} after 1 of "), said
    assert "axes stopped, lamp dark" in said
    assert said.endswith("go on with --resume")
    assert_true(said, twins)
    assert not twins.lamp.shine.lit


def test_every_signal_that_ends_a_process_is_heard_while_a_rig_is_open() -> None:
    for number in platform.KILLING:
        before = signal.signal(number, signal.SIG_DFL)  # whatever listens in this process already
        try:
            with pytest.raises(Interrupted, match=number.name), signals.heard():
                signal.raise_signal(number)
            assert signal.getsignal(number) is signal.SIG_DFL
        finally:
            signal.signal(number, before)


@pytest.mark.usefixtures("real_time")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_whose_exception_is_lost_still_ends_a_measurement(twins: Twins, tmp_path: Path) -> None:
    class Finalised:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGXCPU)

    class Drops(Silent):
        def step(self, live: Any) -> None:
            Finalised()  # what is raised in there is dropped by Python

    with pytest.raises(Interrupted, match="stopped by SIGXCPU after"):
        measure(twins, tmp_path, Drops())
    assert twins.quiet


@pytest.mark.usefixtures("real_time")
def test_a_signal_between_moves_parks_and_says_so(twins: Twins, tmp_path: Path) -> None:
    expose, exposures = twins.camera._expose, []

    def struck(exposure_s: float) -> Any:
        exposures.append(exposure_s)
        if len(exposures) == 6:
            os.kill(os.getpid(), signal.SIGQUIT)
        return expose(exposure_s)

    twins.camera._expose = struck
    with pytest.raises(Interrupted, match="arms parked, lamp dark") as stopped:
        measure(twins, tmp_path)
    assert_true(str(stopped.value), twins)


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT])
def test_a_signal_in_mid_move_of_a_check_tells_where_the_arms_stand(twins: Twins, number: signal.Signals) -> None:
    when_it_sets_out(twins.servos["light"], lambda: os.kill(os.getpid(), number), 25)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(Interrupted) as stopped:
            checks(RigChoice(LAB, twins.description, "twin"))
    finally:
        signal.signal(signal.SIGINT, before)
    assert "lamp dark" in str(stopped.value)
    assert_true(str(stopped.value), twins)


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("command", [["park"], ["move", "camera=-20"]])
def test_a_signal_in_mid_move_of_a_command_tells_where_the_arms_stand(
    twins: Twins, tmp_path: Path, command: list[str]
) -> None:
    with struck(twins, tmp_path, command, signal.SIGXCPU) as child:
        said = child.communicate()[1]
    assert child.returncode == 130, said
    assert_true(said, twins)


def test_an_error_in_a_measurement_tells_where_the_arms_stand(twins: Twins, tmp_path: Path) -> None:
    twins.inject("overheat", axis="camera", skip=120)
    with pytest.raises(DeviceError) as failed:
        measure(twins, tmp_path)
    assert "lamp dark" in str(failed.value)
    assert_true(str(failed.value), twins)


# ---- standing still ----


@pytest.mark.usefixtures("real_time")
def test_a_park_that_stood_still_for_longer_than_the_watchdog_goes_on_and_parks(twins: Twins, tmp_path: Path) -> None:
    camera = twins.servos["camera"]
    usual = camera._limits
    with struck(twins, tmp_path, ["park"], signal.SIGSTOP) as child:
        end = time.monotonic() + LONGEST_S
        while camera.get("Bus Watchdog") != -1:
            camera.shaft()
            assert time.monotonic() < end
            time.sleep(0.01)
        stood = camera.shaft()
        camera.registers.put("Profile Velocity", 0)  # as firmware does at expiry
        camera.registers.put("Profile Acceleration", 0)
        assert stood[1] == 0
        camera._limits = usual  # type: ignore[method-assign]
        child.send_signal(signal.SIGCONT)
        said = child.communicate()[1]
    assert child.returncode == 0, said
    assert "arms parked" in said
    assert angle(twins, "camera") == pytest.approx(88, abs=SAID_DEG)
    assert twins.quiet


# ---- as they were found ----


@pytest.mark.parametrize("held", [True, False])
def test_a_check_without_moves_leaves_the_arms_as_they_were_found(twins: Twins, held: bool) -> None:
    if held:
        held_up_high(twins)
    goals = {name: servo.get("Goal Position") for name, servo in twins.servos.items()}
    at = {name: servo.shaft()[0] for name, servo in twins.servos.items()}
    rows = checks(RigChoice(LAB, twins.description, "twin"), move=False)
    assert rows[-1] == ("lamp dark", "yes", True)
    assert {"light servo", "bus latency"} <= {what for what, *_ in rows}
    assert "repeatability" not in {what for what, *_ in rows}
    assert {servo.torque for servo in twins.servos.values()} == {held}
    assert {name: servo.shaft()[0] for name, servo in twins.servos.items()} == at
    if held:
        assert {name: servo.get("Goal Position") for name, servo in twins.servos.items()} == goals


def held_up_high(twins: Twins) -> None:
    """The arms are left away from their rest position, and hold."""
    with opened(twins) as rig:
        rig.hold()
        rig.arms.move(Pose(light=math.radians(10), camera=math.radians(40)))


@pytest.mark.parametrize("fails", ["opening", "diagnosis", "measurement"])
def test_a_check_without_moves_or_a_measurement_that_fails_lets_no_arm_fall(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str
) -> None:
    held_up_high(twins)
    description = twins.description
    if fails == "diagnosis":
        monkeypatch.setattr("gonio_drivers.survey._bus", lambda arms: arms.bus.read(77, 0, 1))
        rows = checks(RigChoice(LAB, description, "twin"), move=False)
        assert not rows[-1][2]
        assert_true(rows[-1][1], twins)
    else:
        description.devices["camera"]["folder"] = str(tmp_path / "nothing")
        choice = RigChoice(LAB, description, "twin")
        acts: dict[str, Callable[[], object]] = {
            "opening": lambda: checks(choice, move=False),
            "measurement": lambda: measure(twins, tmp_path, description=description),
        }
        with pytest.raises(GonioError, match=r"devices\.camera\.folder"):
            acts[fails]()
    assert all(servo.torque for servo in twins.servos.values())
    assert angle(twins, "camera") == pytest.approx(40, abs=SAID_DEG)
    assert not twins.lamp.shine.lit


# ---- a lamp that stays lit ----


@pytest.mark.usefixtures("real_time")
def test_a_lamp_that_stays_lit_at_resume_is_told_and_the_run_goes_on_once_it_obeys(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lamp_line, "TRIES", 2)
    usual = twins.servos["camera"]._limits
    when_it_sets_out(twins.servos["camera"], lambda: os.kill(os.getpid(), signal.SIGQUIT))
    with pytest.raises(Interrupted):
        measure(twins, tmp_path)
    before = (tmp_path / "run" / "journal.jsonl").read_bytes()
    twins.servos["camera"]._limits = usual  # type: ignore[method-assign]
    at = [servo.shaft()[0] for servo in twins.servos.values()]
    command = twins.lamp.command
    twins.lamp.shine.lit = True
    twins.lamp.command = lambda line: None if "OUTP" in line and "OFF" in line.upper() else command(line)  # type: ignore[method-assign]
    with pytest.raises(DeviceError, match="the lamp may still be lit: switch it off by hand") as stuck:
        measure(twins, tmp_path, resume=True)
    assert "lamp dark" not in str(stuck.value)
    assert twins.lamp.shine.lit
    assert [servo.shaft()[0] for servo in twins.servos.values()] == at, "no arm moves in the light"
    assert (tmp_path / "run" / "journal.jsonl").read_bytes() == before
    twins.lamp.command = command  # type: ignore[method-assign]
    assert len(measure(twins, tmp_path, resume=True).steps()) >= 4
    assert twins.quiet


@pytest.mark.usefixtures("real_time")
def test_a_lamp_found_lit_is_darkened_though_its_opening_is_interrupted(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    twins.lamp.shine.lit = True
    rig = opened(twins)
    monkeypatch.setattr(rig.light._line, "drain_errors", lambda: os.kill(os.getpid(), signal.SIGQUIT))
    with pytest.raises(Interrupted), rig:
        pass
    assert not twins.lamp.shine.lit
    assert "lamp dark" in rig.left()


# ---- turned by hand ----


@pytest.mark.parametrize("turns", [1, -2])
def test_an_axis_turned_by_hand_past_a_turn_is_opened_where_it_is(twins: Twins, tmp_path: Path, turns: int) -> None:
    tilt = twins.servos["tilt"]
    here = tilt.shaft()[0]
    tilt._path = motion.rest(tilt._clock(), here + turns * tables.COUNTS)
    assert tilt.read(132, 4) == round(here + turns * tables.COUNTS).to_bytes(4, "little", signed=True)
    by_hand(written(twins, tmp_path), "read")
    with opened(twins) as rig:
        assert math.degrees(rig.arms.read().tilt) == pytest.approx(1.0, abs=SAID_DEG)
        assert tilt.shaft()[0] == pytest.approx(here, abs=1)
        rig.arms.move(Pose(light=math.radians(-40), camera=math.radians(40), tilt=math.radians(3)))
    assert twins.quiet
