"""Work by hand on a laboratory rig, over the twins: every device missing or mute in turn, and what is left standing."""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_drivers import dynamixel, service, survey
from gonio_drivers.lab import LAB, LabRig
from gonio_sim.wire.servo import Mechanics, Servo
from gonio_sim.wire.twins import Twins, rig_file

import gonio
from gonio.by_hand import scan
from gonio.by_hand.manual_rig import ManualRig
from gonio.by_hand.rig_file import write_values
from gonio.errors import ConfigError, DeviceError
from gonio.rig import FoundServo, Pose
from tests.command_line import gonio as run
from tests.gonio_drivers.conftest import LONGEST_S, SAMPLE, small

pytestmark = pytest.mark.slow

LANDED_DEG = 0.15
"""The rig file's tolerance of a landing."""
PARKED = {"light": -88.0, "camera": 88.0, "tilt": 0.0, "spin": 0.0}


def written(twins: Twins, tmp_path: Path, **missing: str) -> Path:
    """The rig file, with the ports of some devices where nothing is plugged in."""
    description = twins.description
    devices: dict[str, Any] = {name: dict(table) for name, table in description.devices.items()}
    for device in missing:
        if device == "camera":
            devices["camera"]["folder"] = str(tmp_path / "nothing")
        else:
            devices["servos" if device == "arms" else "light"]["port"] = str(tmp_path / f"no-{device}")
    path = tmp_path / "my.toml"
    path.write_text(rig_file(description.model_copy(update={"devices": devices})))
    return path


def angle(twins: Twins, name: str) -> float:
    """Where a shaft stands, as an angle of its axis [deg]."""
    return math.degrees(twins.followers[name].encoder())


def bench(twins: Twins, *only: Any) -> ManualRig:
    return ManualRig(LAB.open(twins.description, sample=None, seed=0, confirm=False), "", only)


# ---- any device missing or mute: park, dark and read of the others work ----


@pytest.mark.parametrize("missing", ["arms", "light", "camera"])
def test_a_device_that_is_not_plugged_in_leaves_the_others_usable(twins: Twins, tmp_path: Path, missing: str) -> None:
    rig = written(twins, tmp_path, **{missing: ""})
    twins.lamp.shine.lit = missing != "light"
    silent = {"arms": "light", "light": "lamp", "camera": "frames"}[missing]

    done = run(tmp_path, "rig", "read", "--json", "--rig", rig)
    said = json.loads(done.stdout)
    assert done.returncode == 3
    assert silent in said["silent"]
    assert {"light", "lamp", "frames"} - {silent} <= set(said["devices"])
    assert said["devices"].get("lamp", {}).get("state", {}).get("value") == (None if missing == "light" else "lit")
    assert twins.lamp.shine.lit == (missing != "light"), "reading darkens nothing"

    done = run(tmp_path, "rig", "dark", "--rig", rig)
    assert done.returncode == (3 if missing == "light" else 0), done.stderr
    assert not twins.lamp.shine.lit

    twins.lamp.shine.lit = missing != "light"
    done = run(tmp_path, "rig", "park", "--rig", rig)
    assert done.returncode == (0 if missing == "camera" else 3), done.stderr
    assert "Traceback" not in done.stderr
    assert not twins.lamp.shine.lit
    if missing != "arms":
        assert angle(twins, "light") == pytest.approx(PARKED["light"], abs=LANDED_DEG)
        assert "arms parked" in done.stderr
    if missing == "light":
        assert "the lamp could not be darkened" in done.stderr
        assert "no-light" in done.stderr


def test_a_camera_that_is_not_calibrated_yet_stops_nobody_else(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    devices = dict(twins.description.devices) | {"camera": {"driver": "uvc"}}
    rig.write_text(rig_file(twins.description.model_copy(update={"devices": devices})))
    done = run(tmp_path, "rig", "read", "--json", "--rig", rig)
    assert done.returncode == 3
    assert "devices.camera.response is missing" in json.loads(done.stdout)["silent"]["frames"]
    for words in (["dark"], ["move", "tilt=2"], ["park"]):
        assert run(tmp_path, "rig", *words, "--rig", rig).returncode == 0
    done = run(tmp_path, "rig", "snap", "a.png", "--exposure", "0.01", "--rig", rig)
    assert (done.returncode, "devices.camera.response is missing" in done.stderr) == (2, True)


@pytest.mark.parametrize("mute", ["light", "camera", "changer"])
def test_a_mute_servo_is_named_and_the_others_are_read_moved_and_parked(
    twins: Twins, tmp_path: Path, mute: str
) -> None:
    rig = written(twins, tmp_path)
    twins.servos[mute].lose_power()
    others = [name for name in PARKED if name != mute]

    done = run(tmp_path, "rig", "read", "--json", "--rig", rig)
    said = json.loads(done.stdout)
    assert (done.returncode, list(said["silent"])) == (3, [mute])
    assert f"id = {twins.servos[mute].id}" in said["silent"][mute] or "servo id" in said["silent"][mute]
    for name in others:
        assert said["devices"][name]["angle"]["value"] == pytest.approx(angle(twins, name), abs=0.1)

    done = run(tmp_path, "rig", "move", "tilt=5", "--rig", rig)
    assert done.returncode == 0, done.stderr
    assert angle(twins, "tilt") == pytest.approx(5, abs=LANDED_DEG)

    if mute in PARKED:
        before = angle(twins, mute)
        done = run(tmp_path, "rig", "move", f"{mute}=5", "--rig", rig)
        assert done.returncode == 3
        assert f"axis {mute} cannot be moved" in done.stderr
        assert angle(twins, mute) == before

    done = run(tmp_path, "rig", "park", "--rig", rig)
    assert (done.returncode, mute in done.stderr) == (3, True), done.stderr
    assert "lamp dark" in done.stderr
    for name in others:
        assert angle(twins, name) == pytest.approx(PARKED[name], abs=LANDED_DEG)


def test_a_servo_in_alarm_is_read_and_named_and_the_others_are_parked(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    twins.servos["camera"].temperature_c = 90
    done = run(tmp_path, "rig", "read", "--rig", rig)
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("camera")]
    assert "90 C" in line
    assert "overheated" in line
    assert "BAD" in line
    done = run(tmp_path, "rig", "park", "--rig", rig)
    assert done.returncode == 3
    assert "parked: light, tilt, spin; not parked" in done.stderr
    assert "overheated" in done.stderr
    assert "not every axis parked" in done.stderr
    assert re.search(r"the axes stand now: .*camera -?[0-9.]+ deg, torque off", done.stderr), done.stderr
    assert angle(twins, "light") == pytest.approx(PARKED["light"], abs=LANDED_DEG)


def test_an_axis_that_is_stuck_stops_all_and_everybodys_place_is_told(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    twins.servos["light"].block()
    done = run(tmp_path, "rig", "move", "light=20", "camera=60", "--rig", rig)
    assert done.returncode == 3
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
    done = run(tmp_path, "rig", "park", "--rig", written(twins, tmp_path))
    assert done.returncode == 3
    assert "lamp dark; the arms: " in done.stderr
    assert "is the servo power on" in done.stderr
    assert not twins.lamp.shine.lit


def test_a_mute_lamp_does_not_keep_the_arms_from_parking(twins: Twins, tmp_path: Path) -> None:
    twins.inject("lamp-silent", times=10_000)
    done = run(tmp_path, "rig", "park", "--rig", written(twins, tmp_path))
    assert done.returncode == 3
    assert "arms parked" in done.stderr
    assert "the lamp could not be darkened" in done.stderr
    assert angle(twins, "camera") == pytest.approx(PARKED["camera"], abs=LANDED_DEG)


# ---- arms stay where a person has put them ----


def test_moved_axes_hold_and_are_taken_over_without_a_jerk(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    camera = angle(twins, "camera")
    done = run(tmp_path, "rig", "move", "light=-20", "--rig", rig)
    assert done.returncode == 0, done.stderr
    assert "hold with torque on; gonio rig park ends that" in done.stderr
    assert angle(twins, "light") == pytest.approx(-20, abs=LANDED_DEG)
    assert angle(twins, "camera") == camera
    assert all(servo.torque and servo.get("Bus Watchdog") == 0 for servo in twins.servos.values())

    goals = {name: servo.get("Goal Position") for name, servo in twins.servos.items()}
    stood = {name: servo.shaft()[0] for name, servo in twins.servos.items()}
    with bench(twins, "arms") as rig_:
        assert {n: s.get("Goal Position") for n, s in twins.servos.items()} == goals, (
            "a load would sag by the difference"
        )
        assert {n: s.shaft()[0] for n, s in twins.servos.items()} == stood
        rig_.hold()
    assert all(servo.torque for servo in twins.servos.values())

    assert run(tmp_path, "rig", "park", "--rig", rig).returncode == 0
    assert not any(servo.torque for servo in twins.servos.values())


def test_directions_are_reached_and_the_branch_is_told(twins: Twins, tmp_path: Path) -> None:
    done = run(tmp_path, "rig", "move", "theta_i=30", "theta_r=45", "--rig", written(twins, tmp_path))
    assert done.returncode == 0, done.stderr
    assert "taken: light 30.00, camera -45.00" in done.stdout
    assert "is out of reach: -180.00 deg is outside the limits" in done.stdout
    assert angle(twins, "camera") == pytest.approx(-45, abs=LANDED_DEG)


@pytest.mark.usefixtures("real_time")
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
    done = run(tmp_path, "rig", "move", *goals, "--rig", written(twins, tmp_path))
    assert done.returncode == 2
    assert message in done.stderr
    assert not any(servo.torque for servo in twins.servos.values())


COMMAND = [sys.executable, "-c", "from gonio.cli import main; main()"]


def test_ctrl_c_stops_every_axis_and_says_where_it_stands(tmp_path: Path) -> None:
    with Twins(small(), SAMPLE, 3, folder=tmp_path / "twin", scale=1.0) as twins:
        rig = written(twins, tmp_path)
        command = [*COMMAND, "rig", "move", "light=40", "camera=80", "--rig", str(rig)]
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
            while not all(twins.servos[name].moves() for name in ("light", "camera")):
                assert child.poll() is None
                time.sleep(0.005)
            child.send_signal(signal.SIGINT)
            _, said = child.communicate()
        assert child.returncode == 130, said
        assert not any(servo.moves() for servo in twins.servos.values())
        assert all(twins.servos[name].torque for name in ("light", "camera"))
        for name in ("light", "camera"):
            (told,) = re.findall(rf"{name} (-?[0-9.]+) deg, holds", said)
            assert float(told) == pytest.approx(angle(twins, name), abs=0.1)  # a count, and its rounding
        assert angle(twins, "light") < 39


def test_ctrl_c_on_the_way_to_rest_stops_and_holds(tmp_path: Path) -> None:
    with Twins(small(), SAMPLE, 3, folder=tmp_path / "twin", scale=1.0) as twins:
        command = [*COMMAND, "rig", "park", "--rig", str(written(twins, tmp_path))]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as child:
            while not twins.servos["camera"].moves():
                assert child.poll() is None
                time.sleep(0.005)
            child.send_signal(signal.SIGINT)
            _, said = child.communicate()
        assert child.returncode == 130, said
        assert re.search(r"camera [0-9.]+ deg, holds", said)
        assert twins.servos["camera"].torque
        assert angle(twins, "camera") < 87


# ---- the lamp ----


def test_the_lamp_shines_for_its_time_and_is_dark_then(twins: Twins, tmp_path: Path) -> None:
    levels = []
    real = twins.lamp.command

    def command(line: str) -> str | None:
        answer = real(line)
        levels.append(twins.lamp.shine.level if twins.lamp.shine.lit else 0.0)
        return answer

    twins.lamp.command = command  # type: ignore[method-assign]
    done = run(tmp_path, "rig", "lamp", "0.25", "--for", "0.05", "--rig", written(twins, tmp_path))
    assert done.returncode == 0, done.stderr
    assert max(levels) == 0.25
    assert not twins.lamp.shine.lit
    assert "lamp lit at level 0.25, band 550 nm; dark in 0.05 s" in done.stderr


@pytest.mark.usefixtures("real_time")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_the_lamp_is_dark_however_its_command_ends(twins: Twins, tmp_path: Path, number: signal.Signals) -> None:
    command = [*COMMAND, "rig", "lamp", "on", "--for", "1000", "--rig", str(written(twins, tmp_path))]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as child:
        assert child.stderr is not None
        while "lamp lit" not in (line := child.stderr.readline()):
            assert line, "it ended"
        assert twins.lamp.shine.lit
        child.send_signal(number)
        said = child.stderr.read()
    assert child.returncode == (130 if number != signal.SIGKILL else -signal.SIGKILL), said
    end = time.monotonic() + LONGEST_S
    while twins.lamp.shine.lit:
        assert time.monotonic() < end
    if number != signal.SIGKILL:
        assert "interrupted; the lamp is dark" in said


@pytest.mark.usefixtures("real_time")
def test_the_lamp_goes_dark_in_time_though_its_command_stands_still(twins: Twins, tmp_path: Path) -> None:
    program = "from gonio.cli import by_hand, main; by_hand.OVERDUE_S = 2.0; main()"
    command = [sys.executable, "-c", program, "rig", "lamp", "on", "--for", "0.5"]
    with subprocess.Popen(
        [*command, "--rig", str(written(twins, tmp_path))], stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stderr is not None
        while "lamp lit" not in (line := child.stderr.readline()):
            assert line, "it ended"
        child.send_signal(signal.SIGSTOP)
        end = time.monotonic() + LONGEST_S
        while twins.lamp.shine.lit:
            assert time.monotonic() < end
        child.send_signal(signal.SIGCONT)
        said = child.stderr.read()
    assert "lamp dark" in said
    assert not twins.lamp.shine.lit


# ---- frames, scans, zeros ----


@pytest.mark.parametrize("name", ["shot.dng", "shot.tif"])
def test_a_frame_needs_the_camera_alone(twins: Twins, tmp_path: Path, name: str) -> None:
    rig = written(twins, tmp_path, arms="", light="")
    twins.lamp.shine.lit = True
    done = run(tmp_path, "rig", "snap", name, "--exposure", "0.01", "--json", "--rig", rig)
    assert done.returncode == 0, done.stderr
    assert "no patch of the sample is drawn: the arms do not say where they stand" in done.stderr
    numbers = json.loads(done.stdout)
    if name.endswith(".dng"):
        from gonio.rig.dng import read_raw

        mosaic: Any = read_raw(tmp_path / name).mosaic
    else:
        import cv2

        mosaic = cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED)
    assert (mosaic.shape, mosaic.dtype) == ((48, 64), np.uint16)
    assert numbers["mean_dn"] == pytest.approx(mosaic.mean())
    assert (tmp_path / "shot-view.png").stat().st_size > 1000
    again = run(tmp_path, "rig", "snap", name, "--rig", rig)
    assert again.returncode == 2
    assert "is there already" in again.stderr


def test_a_scan_is_a_lamberts_cosine_and_ends_dark_and_holding(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    arguments = ["--from", "-30", "--to", "30", "--step", "30", "--at", "camera=75", "--frames", "3"]
    done = run(tmp_path, "rig", "scan", "light", *arguments, "--rig", rig)
    assert done.returncode == 0, done.stderr
    import pandas as pd

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
    rig = written(twins, tmp_path)
    done = run(tmp_path, "rig", "scan", "light", "--from", "0", "--to", "20", "--step", "5", "--rig", rig)
    assert done.returncode == 3
    assert "of 5 angles" in done.stderr
    assert (tmp_path / "scan-light.csv").exists()
    assert "the axes stand now: " in done.stderr
    assert not twins.lamp.shine.lit


def test_a_zero_is_written_with_comments_and_a_backup(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    text = rig.read_text().replace("[arms.light]", "# the long arm\n[arms.light]")
    rig.write_text(text)
    true = angle(twins, "light")
    done = run(tmp_path, "rig", "set-zero", "light", "--at", f"{true + 0.5:.3f}", "--rig", rig)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "my.toml.bak").read_text() == text
    assert "# the long arm\n[arms.light]" in rig.read_text()
    said = json.loads(run(tmp_path, "rig", "read", "--json", "--rig", rig).stdout)
    assert said["devices"]["light"]["angle"]["value"] == pytest.approx(true + 0.5, abs=0.05)  # half a count
    tilt = angle(twins, "tilt")
    done = run(tmp_path, "rig", "set-zero", "tilt", "--at", "3", "--out", tmp_path / "copy.toml", "--rig", rig)
    assert done.returncode == 0, done.stderr
    said = json.loads(run(tmp_path, "rig", "read", "--json", "--rig", tmp_path / "copy.toml").stdout)
    assert said["devices"]["tilt"]["angle"]["value"] == pytest.approx(3, abs=0.05)
    assert said["devices"]["spin"]["angle"]["value"] == pytest.approx(angle(twins, "spin"), abs=0.1)
    assert tilt == angle(twins, "tilt")
    assert not any(servo.torque for servo in twins.servos.values()), "reading an angle changes nothing"


# ---- servos ----


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The twins answer a broadcast ping at once, where real ones take turns; and two line speeds are enough."""
    monkeypatch.setattr(service, "EVERYBODY_S", 0.3)
    monkeypatch.setattr(dynamixel, "BAUD_RATES", (57_600, 1_000_000))


def add(twins: Twins, identity: int, baud: int = 1_000_000) -> Servo:
    like = twins.servos["light"]
    servo = Servo(identity, like._clock, model="xm430-w350", baud=baud, position=1234.0)
    twins.bus.servos.append(servo)
    return servo


def listed(done: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in done.stdout.splitlines() if line[:1].isdigit()]


def test_a_zero_of_the_holder_that_counts_as_known_now_is_told(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    write_values(rig, {("holder", "zero_offset_known"): False})
    done = run(tmp_path, "rig", "set-zero", "tilt", "--at", "3", "--rig", rig)
    assert done.returncode == 0, done.stderr
    assert "zero_offset_known = true holds for spin too" in done.stderr
    done = run(tmp_path, "rig", "set-zero", "spin", "--at", "3", "--rig", rig)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.usefixtures("quick")
def test_servos_are_found_at_every_speed_and_given_ids_and_speeds(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    new = add(twins, 1, baud=57_600)
    done = run(tmp_path, "rig", "ids", "--rig", rig)
    assert done.returncode == 0, done.stderr
    assert [line.split()[:2] for line in listed(done)] == [
        ["1", "57600"], *([str(k), "1000000"] for k in range(1, 6))
    ]  # fmt: skip
    done = run(tmp_path, "rig", "ids", "--set-id", "1", "9", "--yes", "--rig", rig)
    assert done.returncode == 3
    assert "more than one servo answers to id 1" in done.stderr
    assert new.id == 1
    found = FoundServo(str(twins.description.devices["servos"]["port"]), 57_600, 1, "xm430-w350", 46)
    assert LAB.assign(found, identity=9, baud=1_000_000).id == 9
    assert (new.id, new.baud, new.torque) == (9, 1_000_000, False)
    done = run(tmp_path, "rig", "ids", "--set-id", "9", "10", "--rig", rig)
    assert done.returncode == 2
    assert "no terminal to confirm" in done.stderr
    assert new.id == 9


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(("identity", "new"), [(1, 9), (1, 2)])
def test_a_lost_answer_hides_no_servo_that_is_given_an_id(
    twins: Twins, monkeypatch: pytest.MonkeyPatch, identity: int, new: int
) -> None:
    lost: set[int] = set()
    overhear = dynamixel.Bus.overhear

    def lossy(self: dynamixel.Bus, asked: int, instruction: int, parameters: bytes = b"", *, listen_s: float) -> bytes:
        heard = overhear(self, asked, instruction, parameters, listen_s=listen_s)
        first = asked not in lost
        lost.add(asked)
        return b"" if first else heard

    monkeypatch.setattr(dynamixel.Bus, "overhear", lossy)
    found = FoundServo(str(twins.description.devices["servos"]["port"]), 1_000_000, identity, "xm430-w350", 46)
    if new == 9:
        assert LAB.assign(found, identity=new).id == new
    else:
        with pytest.raises(DeviceError, match="id 2 is taken"):
            LAB.assign(found, identity=new)
        assert sorted(servo.id for servo in twins.servos.values()) == [1, 2, 3, 4, 5]


@pytest.mark.usefixtures("quick")
def test_two_servos_with_one_id_are_told_and_not_touched(twins: Twins, tmp_path: Path) -> None:
    twin = add(twins, 2)
    rig = written(twins, tmp_path)
    done = run(tmp_path, "rig", "ids", "--set-id", "2", "9", "--yes", "--rig", rig)
    assert done.returncode == 3
    assert "two servos with this id" in done.stdout
    assert "more than one servo answers to id 2" in done.stderr
    assert (twin.id, twins.servos["camera"].id) == (2, 2)


def test_two_servos_that_answer_in_turn_to_one_id_are_not_moved(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = dynamixel.Bus.overhear

    def twice(bus: dynamixel.Bus, identity: int, *said: Any, **how: Any) -> bytes:
        return plain(bus, identity, *said, **how) * (2 if identity == 1 else 1)

    monkeypatch.setattr(dynamixel.Bus, "overhear", twice)
    with bench(twins, "arms") as held:
        with pytest.raises(DeviceError, match="two servos answer to this id"):
            held.move(light=math.radians(10))
        held.move(camera=math.radians(10))
        held.hold()
    assert not twins.servos["light"].torque
    rig = LAB.open(twins.description, sample=None, seed=0, confirm=False)
    with pytest.raises(DeviceError, match="two servos answer to this id"):
        rig.__enter__()


@pytest.mark.usefixtures("quick")
def test_a_lost_answer_does_not_hide_that_two_servos_have_one_id(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, asked = dynamixel.Bus.overhear, {1: 0}

    def lossy(bus: dynamixel.Bus, identity: int, *said: Any, **how: Any) -> bytes:
        heard = plain(bus, identity, *said, **how)
        if identity != 1:
            return heard
        asked[1] += 1
        return b"" if asked[1] == 1 else heard * 2

    monkeypatch.setattr(dynamixel.Bus, "overhear", lossy)
    with bench(twins, "arms") as held:
        with pytest.raises(DeviceError, match="two servos answer to this id"):
            held.move(light=math.radians(10))
        held.hold()
    assert asked[1] >= 2
    assert not twins.servos["light"].torque


@pytest.mark.usefixtures("quick")
def test_a_servo_is_not_moved_where_nobody_knows_whether_it_is_alone(
    twins: Twins, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = dynamixel.Bus.overhear

    def mute(bus: dynamixel.Bus, identity: int, *said: Any, **how: Any) -> bytes:
        return b"" if identity == 1 else plain(bus, identity, *said, **how)

    monkeypatch.setattr(dynamixel.Bus, "overhear", mute)
    with bench(twins, "arms") as held:
        with pytest.raises(DeviceError, match="nobody knows whether one servo has this id or two"):
            held.move(light=math.radians(10))
        held.move(camera=math.radians(10))
        held.hold()
    assert not twins.servos["light"].torque
    rig = LAB.open(twins.description, sample=None, seed=0, confirm=False)
    with pytest.raises(DeviceError, match="nobody knows whether one servo has this id or two"):
        rig.__enter__()


def test_a_servo_that_answers_and_cannot_be_used_is_not_called_mute(twins: Twins, tmp_path: Path) -> None:
    twins.servos["tilt"].damage = 0x10
    done = run(tmp_path, "rig", "move", "tilt=10", "--rig", written(twins, tmp_path))
    said = " ".join(done.stderr.split())
    assert done.returncode == 3
    assert "no answer" not in said
    assert re.search(r"tilt -?\d\.\d\d deg, torque off", said)


def test_an_axis_that_was_not_named_and_lets_go_is_not_said_to_hold(twins: Twins) -> None:
    with bench(twins, "arms") as held:
        twins.servos["camera"].write(64, b"\0")
        with pytest.raises(DeviceError, match=r"axis camera: .* let go of its torque"):
            held.move(light=math.radians(10))
    assert twins.servos["camera"].get("Torque Enable") == 0


def put(twins: Twins, axis: str, **items: int) -> None:
    """Settings of a servo, whose torque is off, as another program left them."""
    for name, value in items.items():
        item = twins.servos[axis].table.items[name.replace("_", " ")]
        twins.servos[axis].write(item.address, (value % (1 << 8 * item.size)).to_bytes(item.size, "little"))


@pytest.mark.parametrize(
    ("items", "named", "known"),
    [
        ({"Homing_Offset": 300}, "Homing Offset = 300", True),
        ({"Homing_Offset": -1000}, "Homing Offset = -1000", True),
        ({"Homing_Offset": 2000}, "Homing Offset = 2000", True),  # beyond a quarter of a turn it counts as none
        ({"Operating_Mode": 4, "Homing_Offset": 2000}, "Operating Mode = 4", True),
        ({"Operating_Mode": 1}, "Operating Mode = 1", True),
        ({"Drive_Mode": 1}, "Drive Mode = 1", False),
        ({"Drive_Mode": 1, "Homing_Offset": 300}, "Homing Offset = 300", False),
    ],
)
def test_settings_in_a_servo_that_falsify_its_angle_are_named_and_the_true_angle_is_told(
    twins: Twins, tmp_path: Path, items: dict[str, int], named: str, known: bool
) -> None:
    rig, true = written(twins, tmp_path), angle(twins, "light")
    put(twins, "light", **items)
    done = run(tmp_path, "rig", "read", "--json", "--rig", rig)
    said = json.loads(done.stdout)["devices"]["light"]
    assert done.returncode == 0, done.stderr
    assert named in said["settings"]["value"]
    assert ("angle" in said, "the angle is not known" in said["settings"]["value"]) == (known, not known)
    if known:
        assert said["angle"]["value"] == pytest.approx(true, abs=360 / 4096)  # the shaft stops somewhere in its count
    table = run(tmp_path, "rig", "read", "--rig", rig).stdout
    assert "BAD: settings" in table
    found = FoundServo(twins.description.devices["servos"]["port"], twins.servos["light"].baud, 1, "xm430-w350", 46)
    if known:  # a rig file that is made from where its axes stand now
        count = (twins.servos["light"].travelled() + 0.5) % 4096
        assert LAB.count_of(found) == pytest.approx(count, abs=1.0)
    else:
        with pytest.raises(DeviceError, match="reverse mode"):
            LAB.count_of(found)


def test_the_angle_that_is_read_is_where_a_move_finds_the_axis(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    put(twins, "light", Homing_Offset=300)
    said = json.loads(run(tmp_path, "rig", "read", "--json", "--rig", rig).stdout)["devices"]["light"]["angle"]["value"]
    with bench(twins, "arms") as held:  # opening resets it
        assert math.degrees(held.arms.read().light) == pytest.approx(said, abs=360 / 4096)
    done = run(tmp_path, "rig", "read", "--json", "--rig", rig)
    assert "settings" not in json.loads(done.stdout)["devices"]["light"]


def test_a_servo_at_another_line_speed_is_said_to_be_there(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    usual, identity = twins.servos["camera"].baud, twins.servos["camera"].id
    put(twins, "camera", Baud_Rate=2)
    said = json.loads(run(tmp_path, "rig", "read", "--json", "--rig", rig).stdout)["silent"]["camera"]
    remedy = f"gonio rig ids --set-baud {identity} {usual}"
    told = f"answers at 115200 baud, and devices.servos.baud = {usual}: {remedy}"
    assert told in said
    done = run(tmp_path, "rig", "move", "camera=5", "--rig", rig)
    assert (done.returncode, told in " ".join(done.stderr.split())) == (3, True), done.stderr
    with pytest.raises(DeviceError, match=remedy), opened_whole(twins):
        pass


def opened_whole(twins: Twins) -> LabRig:
    return LAB.open(twins.description, sample=None, seed=0, confirm=False)


def test_a_black_frame_is_called_one(twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = written(twins, tmp_path)
    done = run(tmp_path, "rig", "snap", "dark.dng", "--exposure", "0.01", "--rig", rig)
    assert "the frame is black" in done.stderr
    done = run(tmp_path, "rig", "snap", "lit.dng", "--lamp", "--exposure", "0.05", "--rig", rig)
    assert (done.returncode, "the frame is black" in done.stderr) == (0, False), done.stderr
    monkeypatch.setattr(twins, "_shine", lambda shine: None)  # the lens cap is on
    twins.lamp._changed = lambda shine: None
    done = run(tmp_path, "rig", "snap", "cap.dng", "--lamp", "--exposure", "0.05", "--rig", rig)
    assert "the frame is black" in done.stderr
    assert "the lamp is lit; is the lens cap on?" in " ".join(done.stderr.split())
    done = run(tmp_path, "rig", "check", "--rig", rig)
    assert done.returncode == 3
    assert "is the lens cap on" in " ".join(re.sub("[^a-z ]", " ", done.stdout).split()), done.stdout


def test_a_servo_restarts_and_one_that_is_mute_is_named(twins: Twins, tmp_path: Path) -> None:
    rig = written(twins, tmp_path)
    with bench(twins, "arms") as held:
        held.hold()
    twins.servos["spin"].lose_power()
    done = run(tmp_path, "rig", "reboot", "--rig", rig)
    assert done.returncode == 3
    assert "tilt: restarted, torque off" in done.stdout
    assert "not restarted, or unwell: spin" in done.stderr
    assert not any(servo.torque for servo in twins.servos.values())


@pytest.mark.usefixtures("real_time")
def test_ctrl_c_does_not_cut_off_what_is_said_of_the_axes(twins: Twins, monkeypatch: pytest.MonkeyPatch) -> None:
    held = bench(twins, "arms")
    with held:
        held.hold()
    look = survey.of_arms

    def pressed(arms: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        return look(arms)

    monkeypatch.setattr(survey, "of_arms", pressed)
    assert re.search(r"tilt -?\d\.\d\d deg, holds", held.left())


def test_an_encoder_that_trembles_is_told_and_gives_no_zero(
    twins: Twins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    twins.servos["light"].mechanics = Mechanics(noise_counts=4.0)
    rig = written(twins, tmp_path)
    before = rig.read_text()
    done = run(tmp_path, "rig", "set-zero", "light", "--at", "30", "--rig", rig)
    assert (done.returncode, rig.read_text()) == (3, before)
    assert "its readings at rest lie" in " ".join(done.stderr.split())
    done = run(tmp_path, "rig", "read", "--rig", rig)
    assert "BAD: angle_spread" in done.stdout
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
        assert isinstance(rig._rig, LabRig)
        moved = rig.move(theta_i=math.radians(20), theta_r=math.radians(40))
        assert math.degrees(moved.landed["camera"]) == pytest.approx(-40, abs=LANDED_DEG)
        rig.lamp(0.5, wavelength_nm=500)
        assert twins.lamp.shine.level == 0.5
        shot = rig.snap(exposure_s=0.01)
        assert shot.patch is not None
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
