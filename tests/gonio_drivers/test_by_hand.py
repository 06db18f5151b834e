"""Work by hand on a laboratory rig, over the twins: every device missing or mute in turn, and what is left standing."""

import json
import math
import re
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_drivers.arms import ServoArms
from gonio_drivers.lab import LabRig
from gonio_sim.wire.servo import Mechanics
from gonio_sim.wire.twins import Twins

import gonio
from gonio.errors import ConfigError, DeviceError
from gonio.lab.by_hand import scan
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.by_hand.rig_file import write_values
from gonio.lab.rig import Pose
from tests.gonio_drivers.conftest import (
    COMMAND,
    LONGEST_S,
    SAMPLE,
    angle,
    bench,
    by_hand,
    opened,
    patient_dialect,
    read,
    small,
    written,
)  # fmt: skip
from tests.gonio_drivers.test_servo_settings import put
from tests.gonio_drivers.test_ways_out import when_it_sets_out

pytestmark = pytest.mark.slow

LANDED_DEG = 0.15
"""The rig file's tolerance of a landing."""
PARKED = {"light": -88.0, "camera": 88.0, "tilt": 0.0, "spin": 0.0}


def without(twins: Twins, tmp_path: Path, *missing: str) -> Path:
    """The rig file, with the ports of some devices where nothing is plugged in."""
    devices: dict[str, Any] = {name: dict(table) for name, table in twins.description.devices.items()}
    for device in missing:
        if device == "camera":
            devices["camera"]["folder"] = str(tmp_path / "nothing")
        else:
            devices["servos" if device == "arms" else "light"]["port"] = str(tmp_path / f"no-{device}")
    return written(twins, tmp_path, devices=devices)


# ---- any device missing or mute: park, dark and read of the others work ----


@pytest.mark.parametrize("missing", ["arms", "light", "camera"])
def test_a_device_that_is_not_plugged_in_leaves_the_others_usable(twins: Twins, tmp_path: Path, missing: str) -> None:
    rig, no_light = without(twins, tmp_path, missing), missing == "light"
    twins.lamp.shine.lit = not no_light
    silent = {"arms": "light", "light": "lamp", "camera": "frames"}[missing]

    said = read(rig, code=3)
    assert silent in said["silent"]
    assert {"light", "lamp", "frames"} - {silent} <= set(said["devices"])
    assert said["devices"].get("lamp", {}).get("state", {}).get("value") == (None if no_light else "lit")
    assert twins.lamp.shine.lit == (not no_light), "reading darkens nothing"

    by_hand(rig, "dark", code=3 if no_light else 0)
    assert not twins.lamp.shine.lit

    twins.lamp.shine.lit = not no_light
    says = [] if missing == "arms" else ["arms parked"]
    says += ["the lamp could not be darkened", "no-light"] if no_light else []
    done = by_hand(rig, "park", code=0 if missing == "camera" else 3, says=says)
    assert "Traceback" not in done.stderr
    assert not twins.lamp.shine.lit
    if missing != "arms":
        assert angle(twins, "light") == pytest.approx(PARKED["light"], abs=LANDED_DEG)


def test_a_camera_that_is_not_calibrated_yet_stops_nobody_else(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path, devices=dict(twins.description.devices) | {"camera": {"driver": "uvc"}})
    assert "devices.camera.response is missing" in read(rig, code=3)["silent"]["frames"]
    for words in (["dark"], ["move", "tilt=2"], ["park"]):
        by_hand(rig, *words)
    by_hand(rig, "snap", "a.png", "--exposure", "0.01", code=2, says="devices.camera.response is missing")


@pytest.mark.parametrize("mute", ["light", "camera", "changer"])
def test_a_mute_servo_is_named_and_the_others_are_read_moved_and_parked(
    twins: Twins, tmp_path: Path, mute: str
) -> None:
    rig = written(twins, tmp_path)
    twins.servos[mute].lose_power()
    others = [name for name in PARKED if name != mute]

    said = read(rig, code=3)
    assert list(said["silent"]) == [mute]
    assert f"id = {twins.servos[mute].id}" in said["silent"][mute] or "servo id" in said["silent"][mute]
    for name in others:
        assert said["devices"][name]["angle"]["value"] == pytest.approx(angle(twins, name), abs=0.1)

    by_hand(rig, "move", "tilt=5")
    assert angle(twins, "tilt") == pytest.approx(5, abs=LANDED_DEG)
    if mute in PARKED:
        before = angle(twins, mute)
        by_hand(rig, "move", f"{mute}=5", code=3, says=f"axis {mute} cannot be moved")
        assert angle(twins, mute) == before

    by_hand(rig, "park", code=3, says=[mute, "lamp dark"])
    for name in others:
        assert angle(twins, name) == pytest.approx(PARKED[name], abs=LANDED_DEG)


def test_a_servo_in_alarm_is_read_and_named_and_the_others_are_parked(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    twins.servos["camera"].temperature_c = 90
    (line,) = [line for line in by_hand(rig, "read").stdout.splitlines() if line.startswith("camera")]
    assert {word for word in ("90 C", "overheated", "BAD") if word not in line} == set()
    says = ["parked: light, tilt, spin; not parked", "overheated", "not every axis parked"]
    done = by_hand(rig, "park", code=3, says=says)
    assert re.search(r"the axes stand now: .*camera -?[0-9.]+ deg, torque off", done.stderr), done.stderr
    assert angle(twins, "light") == pytest.approx(PARKED["light"], abs=LANDED_DEG)


def test_an_axis_that_is_stuck_stops_all_and_everybodys_place_is_told(twins: Twins, tmp_path: Path) -> None:
    twins.servos["light"].block()
    done = by_hand(written(twins, tmp_path), "move", "light=20", "camera=60", code=3)
    assert re.search("axis light.*(it is stuck|overloaded)", done.stderr)
    (told,) = re.findall(r"the axes stand now: .*camera (-?[0-9.]+) deg, holds", done.stderr)
    assert float(told) == pytest.approx(angle(twins, "camera"), abs=0.1)  # a count, and its rounding


@pytest.mark.usefixtures("quick")
def test_with_the_servos_power_off_the_lamp_is_darkened_and_the_arms_are_said_to_be_missing(
    twins: Twins, tmp_path: Path
) -> None:
    for servo in twins.servos.values():
        servo.lose_power()
    twins.lamp.shine.lit = True
    by_hand(written(twins, tmp_path), "park", code=3, says=["lamp dark; the arms: ", "is the servo power on"])
    assert not twins.lamp.shine.lit


def test_a_mute_lamp_does_not_keep_the_arms_from_parking(twins: Twins, tmp_path: Path) -> None:
    twins.inject("lamp-silent", times=10_000)
    by_hand(written(twins, tmp_path), "park", code=3, says=["arms parked", "the lamp could not be darkened"])
    assert angle(twins, "camera") == pytest.approx(PARKED["camera"], abs=LANDED_DEG)


# ---- arms stay where a person has put them ----


def test_moved_axes_hold_and_are_taken_over_without_a_jerk(twins: Twins, tmp_path: Path) -> None:
    rig, camera = written(twins, tmp_path), angle(twins, "camera")
    by_hand(rig, "move", "light=-20", says="hold with torque on; gonio rig park ends that")
    assert angle(twins, "light") == pytest.approx(-20, abs=LANDED_DEG)
    assert angle(twins, "camera") == camera
    assert all(servo.torque and servo.get("Bus Watchdog") == 0 for servo in twins.servos.values())

    def stand() -> dict[str, tuple[int, float]]:
        return {name: (servo.get("Goal Position"), servo.shaft()[0]) for name, servo in twins.servos.items()}

    stood = stand()
    with bench(twins, "arms") as held:
        assert stand() == stood, "a load would sag by the difference"
        held.hold()
    assert all(servo.torque for servo in twins.servos.values())
    by_hand(rig, "park")
    assert not any(servo.torque for servo in twins.servos.values())


def test_directions_are_reached_and_the_branch_is_told(twins: Twins, tmp_path: Path) -> None:
    prints = ["taken: light 30.00, camera -45.00", "is out of reach: -180.00 deg is outside the limits"]
    by_hand(written(twins, tmp_path), "move", "theta_i=30", "theta_r=45", prints=prints)
    assert angle(twins, "camera") == pytest.approx(-45, abs=LANDED_DEG)


@pytest.mark.parametrize(
    ("goals", "message"),
    [
        (["light=97"], "light = 97 deg is outside this axis's limits, -95 to 95 deg"),
        (["azimuth=1"], "has no axis azimuth; it has light, camera, tilt, spin"),
        (["light"], '"light": write AXIS=DEG'),
        (["light=nan"], "must be a finite angle"),
        (["light=1", "light=2"], "light is given twice"),
        (["theta_i=30"], "theta_r is missing"),
        (["theta_i=30", "theta_r=40", "light=1"], "give either axes or directions"),
        (["theta_i=30", "theta_r=-30"], "block 3.2 deg around retro"),
    ],
)
def test_a_wrong_goal_is_refused_before_anything_is_opened(
    twins: Twins, tmp_path: Path, goals: list[str], message: str
) -> None:
    by_hand(written(twins, tmp_path), "move", *goals, code=2, says=message)
    assert not any(servo.torque for servo in twins.servos.values())


@pytest.mark.parametrize(
    ("words", "moving", "short_of"),
    [
        (["move", "light=40", "camera=80"], ["light", "camera"], {"light": 39.0}),
        (["park"], ["camera"], {"camera": 87.0}),
    ],
)
def test_ctrl_c_stops_every_axis_and_says_where_it_stands(
    tmp_path: Path, words: list[str], moving: list[str], short_of: dict[str, float]
) -> None:
    with Twins(small(), SAMPLE, 3, folder=tmp_path / "twin", scale=1.0) as twins:
        twins.world.description.devices["light"]["dialect"] = str(patient_dialect(tmp_path))
        under_way: set[str] = set()
        for name in moving:
            when_it_sets_out(twins.servos[name], lambda name=name: pressed(name), slow=False)  # type: ignore[misc]

        def pressed(name: str) -> None:
            """In the twin's own thread: from there on the servos' watchdogs stop what nobody looks after."""
            under_way.add(name)
            if len(under_way) == len(moving):
                child.send_signal(signal.SIGINT)

        command = [*COMMAND, "rig", *words, "--rig", str(written(twins, tmp_path))]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
            _, said = child.communicate()
        assert child.returncode == 130, said
        assert not any(servo.moves() for servo in twins.servos.values())
        for name in moving:
            assert twins.servos[name].torque
            (told,) = re.findall(rf"{name} (-?[0-9.]+) deg, holds", said)
            assert float(told) == pytest.approx(angle(twins, name), abs=0.1)  # a count, and its rounding
        for name, goal in short_of.items():
            assert angle(twins, name) < goal


# ---- the lamp ----


def test_the_lamp_shines_for_its_time_and_is_dark_then(twins: Twins, tmp_path: Path) -> None:
    levels = []
    real = twins.lamp.command

    def command(line: str) -> str | None:
        answer = real(line)
        levels.append(twins.lamp.shine.level if twins.lamp.shine.lit else 0.0)
        return answer

    twins.lamp.command = command  # type: ignore[method-assign]
    says = "lamp lit at level 0.25, band 550 nm; dark in 0.05 s"
    by_hand(written(twins, tmp_path), "lamp", "0.25", "--for", "0.05", says=says)
    assert max(levels) == 0.25
    assert not twins.lamp.shine.lit


def goes_dark(twins: Twins) -> None:
    """Wait until the lamp is dark."""
    end = time.monotonic() + LONGEST_S
    while twins.lamp.shine.lit:
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL, signal.SIGSTOP])
def test_the_lamp_is_dark_however_its_command_ends_or_stands_still(
    twins: Twins, tmp_path: Path, number: signal.Signals
) -> None:
    stands_still, killed = number == signal.SIGSTOP, number == signal.SIGKILL
    program = "from gonio.lab.commands import by_hand; by_hand.OVERDUE_S = 2.0; " + COMMAND[-1]
    command = [*COMMAND[:2], program] if stands_still else COMMAND
    command = [*command, "rig", "lamp", "on", "--for", "0.5" if stands_still else "1000"]
    rig = str(written(twins, tmp_path))
    with subprocess.Popen([*command, "--rig", rig], stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        begun = ""
        while "lamp lit" not in (line := child.stderr.readline()):
            assert line, f"it ended: {begun}"
            begun += line
        assert stands_still or twins.lamp.shine.lit
        child.send_signal(number)
        if stands_still:
            goes_dark(twins)
            child.send_signal(signal.SIGCONT)
        said = child.stderr.read()
    goes_dark(twins)
    if not stands_still:
        assert child.returncode == (-signal.SIGKILL if killed else 130), said
    assert killed or ("lamp dark" if stands_still else "interrupted; the lamp is dark") in said


# ---- frames, scans, zeros ----


@pytest.mark.parametrize("name", ["shot.dng", "shot.tif"])
def test_a_frame_needs_the_camera_alone(twins: Twins, tmp_path: Path, name: str) -> None:
    import cv2

    from gonio.lab.rig.dng import read_raw

    rig = without(twins, tmp_path, "arms", "light")
    twins.lamp.shine.lit = True
    says = "no patch of the sample is drawn: the arms do not say where they stand"
    done = by_hand(rig, "snap", name, "--exposure", "0.01", "--json", says=says)
    path = tmp_path / name
    mosaic: Any = read_raw(path).mosaic if name.endswith(".dng") else cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert (mosaic.shape, mosaic.dtype) == ((48, 64), np.uint16)
    assert json.loads(done.stdout)["mean_dn"] == pytest.approx(mosaic.mean())
    assert (tmp_path / "shot-view.png").stat().st_size > 1000
    by_hand(rig, "snap", name, code=2, says="is there already")
    # the picture of another frame is no obstacle, and stays
    other, view = "shot.tif" if name == "shot.dng" else "shot.dng", (tmp_path / "shot-view.png").read_bytes()
    assert "shot-view-2.png" in by_hand(rig, "snap", other, "--exposure", "0.01").stdout
    assert (tmp_path / "shot-view.png").read_bytes() == view


def test_a_scan_is_a_lamberts_cosine_and_ends_dark_and_holding(twins: Twins, tmp_path: Path) -> None:
    arguments = ["--from", "-30", "--to", "30", "--step", "30", "--at", "camera=75", "--frames", "3"]
    by_hand(written(twins, tmp_path), "scan", "light", *arguments)
    table = pd.read_csv(tmp_path / "scan-light.csv")
    assert (tmp_path / "scan-light.png").exists()
    assert list(table["asked_deg"]) == [-30, 0, 30]
    signal_, u = table["signal_dn_per_s"], table["u_signal_dn_per_s"]
    ratio = signal_ / signal_[1] / np.cos(np.radians(table["angle_deg"]))
    # lamp noise of 0.8 % a frame, drift of 0.5 % an hour and backlash: five standard uncertainties of the ratio
    u_ratio = np.hypot(u / signal_, u[1] / signal_[1])
    assert (np.abs(ratio - 1)[[0, 2]] < 5 * np.maximum(u_ratio, 0.005)[[0, 2]]).all()
    assert not twins.lamp.shine.lit
    assert twins.servos["light"].torque


def test_a_scan_that_is_cut_short_keeps_what_it_has(twins: Twins, tmp_path: Path) -> None:
    seen: list[int] = []
    real = twins.camera._expose

    def failing(exposure_s: float) -> Any:
        seen.append(1)
        if len(seen) == 16:
            twins.servos["light"].restart()
        return real(exposure_s)

    twins.camera._expose = failing
    arguments = ["--from", "0", "--to", "20", "--step", "5"]
    says = ["of 5 angles", "the axes stand now: "]
    by_hand(written(twins, tmp_path), "scan", "light", *arguments, code=3, says=says)
    assert (tmp_path / "scan-light.csv").exists()
    assert not twins.lamp.shine.lit


def test_a_zero_is_written_with_comments_and_a_backup(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    text = rig.read_text().replace("[arms.light]", "# the long arm\n[arms.light]")
    rig.write_text(text)
    true = angle(twins, "light")
    by_hand(rig, "set-zero", "light", "--at", f"{true + 0.5:.3f}")
    assert (tmp_path / "my.toml.bak").read_text() == text
    assert "# the long arm\n[arms.light]" in rig.read_text()
    assert read(rig)["devices"]["light"]["angle"]["value"] == pytest.approx(true + 0.5, abs=0.05)  # half a count
    tilt = angle(twins, "tilt")
    by_hand(rig, "set-zero", "tilt", "--at", "3", "--out", tmp_path / "copy.toml")
    said = read(tmp_path / "copy.toml")["devices"]
    assert said["tilt"]["angle"]["value"] == pytest.approx(3, abs=0.05)
    assert said["spin"]["angle"]["value"] == pytest.approx(angle(twins, "spin"), abs=0.1)
    assert tilt == angle(twins, "tilt")
    assert not any(servo.torque for servo in twins.servos.values()), "reading an angle changes nothing"


def test_a_zero_of_the_holder_that_counts_as_known_now_is_told(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    write_values(rig, {("holder", "zero_offset_known"): False})
    by_hand(rig, "set-zero", "tilt", "--at", "3", says="zero_offset_known = true holds for spin too")
    assert by_hand(rig, "set-zero", "spin", "--at", "3").stderr == ""


# ---- servos ----


def test_a_servo_at_another_line_speed_is_said_to_be_there(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    usual, identity = twins.servos["camera"].baud, twins.servos["camera"].id
    put(twins, "camera", Baud_Rate=2)
    remedy = f"gonio rig ids --set-baud {identity} {usual}"
    told = f"answers at 115200 baud, and devices.servos.baud = {usual}: {remedy}"
    assert told in read(rig, code=3)["silent"]["camera"]
    by_hand(rig, "move", "camera=5", code=3, says=told)
    with pytest.raises(DeviceError, match=remedy):
        opened(twins).__enter__()


def test_a_black_frame_is_called_one(twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = written(twins, tmp_path)
    by_hand(rig, "snap", "dark.dng", "--exposure", "0.01", says="the frame is black")
    assert "black" not in by_hand(rig, "snap", "lit.dng", "--lamp", "--exposure", "0.05").stderr
    monkeypatch.setattr(twins, "_shine", lambda shine: None)  # the lens cap is on
    twins.lamp._changed = lambda shine: None
    says = ["the frame is black", "the lamp is lit; is the lens cap on?"]
    done = by_hand(rig, "snap", "cap.dng", "--lamp", "--exposure", "0.05", says=says, code=None)
    done = by_hand(rig, "check", code=3)
    assert "is the lens cap on" in " ".join(re.sub("[^a-z ]", " ", done.stdout).split()), done.stdout


def test_a_servo_restarts_and_one_that_is_mute_is_named(twins: Twins, tmp_path: Path) -> None:
    with bench(twins, "arms") as held:
        held.hold()
    twins.servos["spin"].lose_power()
    told = "tilt: restarted, torque off", "not restarted, or unwell: spin"
    by_hand(written(twins, tmp_path), "reboot", code=3, prints=told[0], says=told[1])
    assert not any(servo.torque for servo in twins.servos.values())


@pytest.mark.usefixtures("real_time")
def test_ctrl_c_does_not_cut_off_what_is_said_of_the_axes(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    held = bench(twins, "arms")
    with held:
        held.hold()
    look = ServoArms.survey

    def pressed(arms: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return look(arms)

    monkeypatch.setattr(ServoArms, "survey", pressed)
    assert re.search(r"tilt -?\d\.\d\d deg, holds", held.left())


def test_an_encoder_that_trembles_is_told_and_gives_no_zero(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    twins.servos["light"].mechanics = Mechanics(noise_counts=4.0)
    rig = written(twins, tmp_path)
    before = rig.read_text()
    by_hand(rig, "set-zero", "light", "--at", "30", code=3, says="its readings at rest lie")
    assert rig.read_text() == before
    by_hand(rig, "read", prints="BAD: angle_spread")
    spread = Pose(light=math.radians(0.6))
    with bench(twins, "arms") as held:
        monkeypatch.setattr(type(held.arms), "spread", property(lambda arms: spread))
        held.move(light=math.radians(10), camera=math.radians(20))
    told = [r.message for r in caplog.records if "at rest lie" in r.message]
    assert told == ["axis light: its readings at rest lie 0.60 deg apart, and what it is said to read is their mean"]


def _powerless_move(twins: Twins, held: ManualRig) -> None:
    for servo in twins.servos.values():
        servo.lose_power()
    held.move(light=math.radians(10))


def test_a_port_that_went_away_is_not_said_to_have_stopped(twins: Twins) -> None:
    held = bench(twins, "arms")
    with pytest.raises(DeviceError, match="no answer"), held:
        _powerless_move(twins, held)
    assert "axes stopped" not in held.left()
    assert "no servo answered when the axes were to stop" in held.left()


# ---- Python ----


def test_the_same_from_python(twins: Twins, tmp_path: Path) -> None:
    with gonio.open_rig(str(written(twins, tmp_path))) as rig:
        assert isinstance(rig.rig, LabRig)
        moved = rig.move(theta_i=math.radians(20), theta_r=math.radians(40))
        assert math.degrees(moved.landed["camera"]) == pytest.approx(-40, abs=LANDED_DEG)
        rig.lamp(0.5, wavelength_nm=500)
        assert twins.lamp.shine.level == 0.5
        assert rig.snap(exposure_s=0.01).patch is not None
        assert rig.read().of("lamp", "state") == "lit"
        with pytest.raises(ConfigError, match="outside this axis's limits"):
            rig.move(camera=2.0)
    assert twins.quiet
    assert angle(twins, "camera") == pytest.approx(PARKED["camera"], abs=LANDED_DEG)


def test_angles_of_a_scan() -> None:
    assert scan.angles_between(0, 1, 0.25) == [0, 0.25, 0.5, 0.75, 1]
    assert scan.angles_between(10, 4, 3) == [10, 7, 4]
    assert scan.angles_between(0, 1, 0.3) == pytest.approx([0, 0.3, 0.6, 0.9])
    with pytest.raises(ConfigError, match="step = 0"):
        scan.angles_between(0, 1, 0)
