"""The laboratory rig as a whole, over the twins: measurements, faults in the middle of them, checks, messages."""

import functools
import math
import os
import random
import re
import signal
import subprocess
import threading
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_drivers.arms import ServoArms
from gonio_drivers.lab import LAB, THREE_SERVOS
from gonio_sim.wire import faults, motion, tether
from gonio_sim.wire.servo import Servo
from gonio_sim.wire.twins import Twins

from gonio.config import parse
from gonio.errors import ConfigError, DeviceError, Interrupted
from gonio.lab.acquisition.measure import RigChoice, carry_out, find_rig
from gonio.lab.acquisition.progress import Silent
from gonio.lab.acquisition.run import Run
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.commands.rigs import checks
from gonio.lab.reduction import brdf
from gonio.lab.rig import Pose
from gonio.lab.rig.description import RigDescription
from tests.command_line import gonio, says
from tests.gonio.numpy_rig import plan_in
from tests.gonio_drivers.conftest import COMMAND, LONGEST_S, SAMPLE, SCALE, opened, small, written

pytestmark = pytest.mark.slow

ALBEDO = SAMPLE.parameters["albedo"]
PLAN = """
name = "small"
wavelength_nm = [500]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [-50, 10, 50]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [20]
dphi_deg = [90]
"""
SHORT_S = 3.0
"""How long a file that may be missing is awaited."""


def measure(
    twins: Twins, tmp_path: Path, progress: Any = None, *, description: RigDescription | None = None, **how: Any
) -> Run:
    """The small plan into the folder `run`."""
    choice = RigChoice(LAB, description or twins.description, "twin")
    return carry_out(plan_in(tmp_path, PLAN), choice, tmp_path / "run", progress=progress or Silent(), **how)


def assert_true(run: Run, points: int | None = None) -> None:
    """No value in the table is wrong: each lies within 5 of its standard uncertainties of what the sample is."""
    table = brdf.reduce(run)
    good = table[table["flag"] == ""]
    pulls = (good["brdf"] - ALBEDO / math.pi) / good["u_brdf"]
    assert np.abs(pulls).max() < 5  # for tens of values, 5 sigma is beyond chance
    assert (good["u_brdf"] < 0.03 * good["brdf"]).all()
    if points is not None:
        assert len(good) == points


def crawl(servo: Servo) -> None:
    """Let the servo take minutes for more than a small way: whatever happens to it on a busy machine, it is there."""
    usual = servo._limits

    def limits(way: float = 0.0) -> tuple[float, float]:
        return (1.0, 1e6) if abs(way) > 50 else usual(way)  # counts/s

    servo._limits = limits  # type: ignore[method-assign]


def remarks(run: Run) -> list[str]:
    return [line for line in (run.path / "journal.jsonl").read_text().splitlines() if '"remark"' in line]


# ---- measurements ----


def test_wire_lamp_and_camera_faults_are_mended_in_a_measurement_and_told(twins: Twins, tmp_path: Path) -> None:
    twins.world.description.devices["camera"]["timeout_s"] = SHORT_S  # of a missing file
    rng = random.Random(11)
    for fault in faults.WIRE:
        twins.inject(fault, axis=rng.choice(list(twins.servos)), skip=rng.randrange(30, 200))
    for fault in faults.LAMP:
        twins.inject(fault, skip=rng.randrange(20, 80))
    for fault in faults.CAMERA:
        twins.inject(fault, skip=rng.randrange(2, 15))
    run = measure(twins, tmp_path)
    assert set(twins.faults.fired) == {*faults.WIRE, *faults.LAMP, *faults.CAMERA}
    assert_true(run, points=4)
    assert len(remarks(run)) >= len(faults.CAMERA)
    assert twins.quiet


@pytest.mark.parametrize("fault", faults.SERVO)
def test_an_unwell_servo_ends_the_measurement_in_the_dark_and_at_rest(twins: Twins, tmp_path: Path, fault: str) -> None:
    twins.inject(fault, axis="camera", skip=120)
    with pytest.raises(DeviceError):
        measure(twins, tmp_path)
    assert twins.faults.fired == [fault]
    twins.servos["camera"].unblock()
    assert twins.quiet


@pytest.mark.skipif("GONIO_INJECTIONS" not in os.environ, reason="a campaign for a person: GONIO_INJECTIONS=200")
def test_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fault at random moments, again and again; a line for each goes to GONIO_CAMPAIGN_LOG."""
    monkeypatch.setattr("gonio.disk.os.fsync", lambda descriptor: None)
    monkeypatch.setattr(tether, "FILE_LATE_S", 0.5)
    rng = random.Random(2024)
    with open(os.environ.get("GONIO_CAMPAIGN_LOG", os.devnull), "a", encoding="utf-8") as log:
        for k in range(int(os.environ["GONIO_INJECTIONS"])):
            fault = faults.NAMES[k % len(faults.NAMES)]
            folder = tmp_path / str(k)
            folder.mkdir()
            description = small()
            description.devices["camera"]["timeout_s"] = SHORT_S
            with Twins(description, SAMPLE, k, folder=folder / "twin", scale=SCALE) as twins:
                axis = rng.choice(list(twins.servos))
                most = 25 if fault in faults.CAMERA else 100 if fault in faults.LAMP else 150
                twins.inject(fault, axis=axis, skip=rng.randrange(most))
                begun, outcome = time.monotonic(), "recovered"
                try:
                    run: Run | None = measure(twins, folder)
                except DeviceError as error:
                    outcome = f"stopped: {error}"
                    run = Run.open(folder / "run") if (folder / "run" / "run.toml").exists() else None
                took = time.monotonic() - begun
                twins.servos[axis].unblock()
                if not twins.faults.fired:
                    outcome = "not fired"
                said = 0 if run is None else len(remarks(run))
                print(f"{k} {fault} {axis} {took:.1f} s, {said} remarks, {outcome}", file=log, flush=True)
                assert took < LONGEST_S, (k, fault)
                assert twins.quiet, (k, fault)
                if outcome == "recovered" and run is not None:
                    assert_true(run, points=4)


# ---- stopping ----


class Presses(Silent):
    """Somebody who presses Ctrl-C after a step, and again when told to."""

    def __init__(self, times: int) -> None:
        self._times = times
        self._left = times

    def step(self, live: Any) -> None:
        if live.step.kind == "point" and self._left:
            self._left = 0
            for _ in range(self._times):
                os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("presses", [1, 2])
def test_one_ctrl_c_finishes_the_step_and_parks_and_two_stop_at_once(
    twins: Twins, tmp_path: Path, presses: int
) -> None:
    with pytest.raises(Interrupted):
        measure(twins, tmp_path, Presses(presses))
    assert twins.quiet
    at = math.degrees(twins.followers["camera"].true())
    if presses == 1:
        assert at == pytest.approx(88, abs=0.3)  # parked as its file says, within landing and zero errors
    else:
        assert at < 80  # not parked


@pytest.mark.usefixtures("real_time")
def test_a_press_on_the_way_to_the_rest_position_stops_there_and_says_so(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    park, camera = ServoArms.park, twins.servos["camera"]
    follow = camera.leaving

    def leaving() -> None:
        follow()
        camera.leaving = follow
        os.kill(os.getpid(), signal.SIGINT)

    def pressed(arms: ServoArms) -> None:
        crawl(camera)
        camera.leaving = leaving
        park(arms)

    monkeypatch.setattr(ServoArms, "park", pressed)
    with pytest.raises(Interrupted, match="on the way to the rest position; axes stopped, lamp dark"):
        measure(twins, tmp_path, Presses(1))
    assert twins.quiet
    assert math.degrees(twins.followers["camera"].true()) < 80  # not parked


def test_nobody_is_told_that_arms_are_parked_that_are_not(twins: Twins, tmp_path: Path) -> None:
    class Jams(Presses):
        def step(self, live: Any) -> None:
            super().step(live)
            twins.servos["camera"].block()

    with pytest.raises(DeviceError, match=r"axis camera.*(stuck|overloaded)"):
        measure(twins, tmp_path, Jams(1))
    twins.servos["camera"].unblock()
    assert twins.quiet


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("presses", [2, 5])
def test_rapid_ctrl_c_ends_with_130_and_one_message(twins: Twins, tmp_path: Path, presses: int) -> None:
    (tmp_path / "plan.toml").write_text(PLAN)
    command = [*COMMAND, "measure", str(tmp_path / "plan.toml"), "--rig", str(written(twins, tmp_path))]
    command += ["--out", str(tmp_path / "run")]
    under_way = threading.Event()
    for servo in twins.servos.values():
        crawl(servo)  # the step is not over before the last press
        servo.leaving = lambda follow=servo.leaving, servo=servo: sets_out(follow, servo)  # type: ignore[misc]

    def sets_out(follow: Callable[[], None], servo: Servo) -> None:
        follow()
        if abs(servo.get("Goal Position") - servo.shaft()[0]) > 50:
            under_way.set()

    with subprocess.Popen([*command, "--yes"], stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        while not under_way.wait(0.1):
            assert child.poll() is None, child.stderr.read()
        child.send_signal(signal.SIGINT)
        said = ""
        while "finishing this step" not in said:  # two signals that have not been heard yet are one
            line = child.stderr.readline()
            assert line, said
            said += line
        for _ in range(presses - 1):
            child.send_signal(signal.SIGINT)
        while presses == 5 and child.poll() is None:  # somebody who does not stop before it is over
            child.send_signal(signal.SIGINT)
            time.sleep(0.001)
        said += child.stderr.read()
    assert child.returncode == 130, said
    assert "Traceback" not in said
    assert re.search(r"axes stopped, lamp dark; the axes stand now: .*torque off; go on with --resume", said), said
    assert twins.quiet


def test_a_second_ctrl_c_while_leaving_still_darkens_and_frees(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = opened(twins)
    rig.__enter__()
    rig.light.on()
    real, calls = rig.light.off, []

    def interrupted() -> None:
        calls.append(1)
        if len(calls) == 1:
            raise KeyboardInterrupt
        real()

    monkeypatch.setattr(rig.light, "off", interrupted)
    with pytest.raises(KeyboardInterrupt):
        rig.__exit__(None, None, None)
    assert twins.quiet
    assert not any(servo.torque for servo in twins.servos.values())


# ---- guarded frames ----


def test_a_frame_during_which_the_lamp_reset_is_taken_again(twins: Twins, caplog: pytest.LogCaptureFixture) -> None:
    with opened(twins) as rig:
        rig.arms.move(Pose(camera=math.radians(45)))
        rig.light.select(rig.description.bands.all()[10])
        rig.light.on()
        bright = rig.camera.capture(0.02)
        twins.lamp.reset(lambda data: None)
        again = rig.camera.capture(0.02)
    assert np.median(again.mosaic) == pytest.approx(np.median(bright.mosaic), rel=0.05)  # lamp noise is 0.8 %
    assert "the frame is taken again" in caplog.text


def test_an_arm_that_moves_during_an_exposure_is_an_error(twins: Twins) -> None:
    with pytest.raises(DeviceError, match="axis camera has moved by itself"), opened(twins) as rig:  # noqa: PT012
        rig.arms.move(Pose(camera=math.radians(45)))
        twins.servos["camera"].write(116, (2000).to_bytes(4, "little"))
        rig.camera.capture(0.5)
        rig.camera.capture(0.5)


def test_a_push_during_an_exposure_costs_the_step_and_no_more(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, exposures = twins.camera._expose, []

    def pushed(exposure_s: float) -> Any:
        exposures.append(exposure_s)
        if len(exposures) == 14:  # in the first point: 4 dark frames, then 4 of the reference and so on
            camera = twins.servos["camera"]
            camera._path = motion.rest(0.0, camera.shaft()[0] - 7)  # 0.6 deg
        return real(exposure_s)

    monkeypatch.setattr(twins.camera, "_expose", pushed)
    run = measure(twins, tmp_path)
    assert_true(run, points=4)
    (remark,) = [remark for remark in remarks(run) if "moved by itself" in remark]  # a busy machine makes others
    says(remark, "axis camera has moved by itself", "it is taken again")


def test_a_target_is_changed_by_its_servo(twins: Twins) -> None:
    with opened(twins) as rig:
        rig.present("reference")
        assert twins._target() == "reference"
        rig.present("sample")
        assert twins._target() == "sample"


# ---- check ----


def test_rig_check_reports_every_device_with_a_verdict(twins: Twins) -> None:
    rows = {what: (found, good) for what, found, good in checks(RigChoice(LAB, twins.description, "twin"))}
    assert {"light servo", "changer servo", "bus latency", "readback noise", "repeatability", "lamp"} <= set(rows)
    assert "xm430-w350 (1020), firmware 46, 34 C, 12.0 V" in rows["camera servo"][0]
    bad = [what for what, (_, good) in rows.items() if not good]
    assert bad in ([], ["bus latency"])  # a busy machine is slow
    assert twins.quiet


# ---- messages ----


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("servos.port", None, r'rig "laboratory goniometer": the key devices\.servos\.port is missing'),
        ("servos.bauds", 1, r'unknown key devices\.servos\.bauds; did you mean "baud"'),
        ("servos.axes.light.id", 300, r"devices\.servos\.axes\.light\.id = 300"),
        ("servos.axes.camera.id", 1, r"devices\.servos = .*two servos have the same id|two servos have the same id"),
        ("servos.axes.camera.model", "xl320", r'axes\.camera\.model = "xl320" is no servo of the X series'),
        ("light.port", "/dev/serial/by-id/usb-FTDI_USB__-__Serial_Converter-if00-port0", r"are the same port"),
        ("servos.axes.camera.model", "ph54-100-s500", r'axes\.camera\.model = "ph54-100-s500" is no servo of the X'),
        ("servos.changer.model", "xm430-w35", r'changer\.model = "xm430-w35" is not known.*did you mean xm430-w350'),
        ("light.level", 2, r"devices\.light\.level = 2"),
        ("light.dialect", "klingon", r'devices\.light\.dialect = "klingon"'),
        ("camera.driver", "foldr", r'there is no camera named "foldr"; did you mean "folder"'),
        ("camera.timeout", 3, r"\[devices\.camera\]: unknown key timeout"),
        ("servos.changer", None, r"devices\.servos\.changer"),
    ],
)
def test_a_wrong_key_is_named(path: str, value: object, message: str) -> None:
    description = find_rig("lab").description
    devices: Any = parse(RigDescription, description.model_dump(), "copy").devices
    *parents, last = path.split(".")
    table = functools.reduce(dict.__getitem__, parents, devices)
    table[last] = value
    if value is None:
        del table[last]
    with pytest.raises(ConfigError, match=message):
        LAB.open(description.model_copy(update={"devices": devices}), sample=None, seed=0, confirm=False)


def test_a_plan_shown_on_a_rig_file_names_keys_that_no_driver_knows(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(THREE_SERVOS.toml.replace("zero_count", "zero_cuont", 1))
    sweep = "[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [20, 60]\n"
    (tmp_path / "plan.toml").write_text(f'name = "p"\nwavelength_nm = [530]\n{sweep}')
    done = gonio(tmp_path, "plan", "show", "plan.toml", "--rig", "rig.toml", expect=0)
    says(done.stdout, "cannot be opened", "rig.toml", "devices.servos.axes.light.zero_cuont", "zero_count")


def test_missing_ports_end_with_exit_code_3_and_one_message(tmp_path: Path) -> None:
    rig = tmp_path / "lab.toml"
    rig.write_text(LAB.toml)
    done = subprocess.run([*COMMAND, "rig", "park", "--rig", rig], capture_output=True, text=True, check=False)
    assert done.returncode == 3
    says(done.stderr, f"{rig}: devices.light.port", "there is no such port")
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("driver", ["uvc", "sequence", "mine"])
def test_a_bench_for_a_rig_with_another_camera(tmp_path: Path, driver: str) -> None:
    description = small()
    camera = {"driver": driver, "folder": "images"}
    asked = description.model_copy(update={"devices": description.devices | {"camera": camera}})
    twins = Twins(asked, SAMPLE, 3, folder=tmp_path / "twin", scale=SCALE)
    if driver == "sequence":
        assert twins.description.devices["camera"] == {"driver": "sequence", "folder": str(Path("images").absolute())}
        with pytest.raises(ConfigError, match=r'"file-late" needs a tethered camera.*driver = "sequence"'):
            twins.inject("file-late")
        return
    with twins, opened(twins) as rig:
        assert rig.camera.capture(0.01).mosaic.shape == (48, 64)


def test_a_webcam_has_a_stand_in_with_a_gamma(tmp_path: Path) -> None:
    """Its values, made linear by the curve of IEC 61966-2-1, are in proportion to the exposure."""
    tables = tomllib.loads(THREE_SERVOS.toml)
    tables["camera"] |= {"width": 64, "height": 48, "prnu": 0.0, "dsnu_e": 0.0}
    tables["lamp"] |= {"noise": 0.0, "drift_per_hour": 0.0, "warm_up_s": 0.0}
    description = parse(RigDescription, tables, "three-servos.toml")
    with Twins(description, SAMPLE, 3, folder=tmp_path / "twin", scale=SCALE) as twins:
        with pytest.raises(ConfigError, match="a video camera is not linear until"):
            opened(twins)
        plain = twins.description.camera.model_copy(update={"response": tuple(map(float, range(256)))})
        seen = twins.description.model_copy(update={"camera": plain})
        with ManualRig(THREE_SERVOS.open_by_hand(seen, confirm=False), "", ()) as rig:
            (tmp_path / "twin" / "target").write_text("reference")
            rig.move(light=0.0, camera=math.radians(45.0))
            rig.lamp(True)
            frames = [rig.camera.capture(t) for t in (0.01, 0.04)]
    assert [frame.exposure_s for frame in frames] == [0.01, 0.04]
    coded = [float(frame.mosaic[20:28, 28:36].mean()) / 255.0 for frame in frames]
    linear = [((v + 0.055) / 1.055) ** 2.4 for v in coded]
    # a step of 1/255 at 0.26 is 3 % of the linear value, of which a mean of 64 noisy pixels leaves a part
    assert linear[1] / linear[0] == pytest.approx(4.0, rel=0.02)


def test_serve_writes_a_rig_file_that_works(tmp_path: Path) -> None:
    served = ["sim", "serve", "--rig", "lab", "--time-scale", "50", "--out", str(tmp_path / "twin")]
    twin = subprocess.Popen([*COMMAND, *served], stdout=subprocess.PIPE, text=True)
    try:
        assert twin.stdout is not None
        lines = [twin.stdout.readline() for _ in range(3)]
        assert str(tmp_path / "twin" / "rig.toml") in lines[1]
        park = [*COMMAND, "rig", "park", "--rig", str(tmp_path / "twin" / "rig.toml")]
        done = subprocess.run(park, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    finally:
        twin.send_signal(signal.SIGINT)
        assert twin.wait(timeout=600) == 0
        if twin.stdout is not None:
            twin.stdout.close()
    assert not (tmp_path / "twin" / "servos").exists()


def test_a_reference_that_is_swapped_is_put_there_by_who_reads_the_target_file(tmp_path: Path) -> None:
    """A run on twins measured the sample in place of the white, where nobody was asked."""
    tables = tomllib.loads(THREE_SERVOS.toml)
    tables["camera"] |= {"response": [float(v) for v in range(256)]}
    tables["devices"]["holder"] = {"target_file": str(tmp_path / "target")}
    rig = THREE_SERVOS.open(parse(RigDescription, tables, "t"), sample=None, seed=0, confirm=False)
    for target in ("reference", "sample"):
        rig.present(target)
        assert (tmp_path / "target").read_text() == f"{target}\n"
