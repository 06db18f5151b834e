"""Hands on rigs: simulated ones, and a stranger's whose driver offers nothing beside the protocols."""

import math
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import gonio
from gonio.cli.signals import undisturbed
from gonio.config import to_toml
from gonio.disk import write_whole
from gonio.errors import ConfigError, DataError
from gonio.lab.by_hand import scan
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.by_hand.snapshot import Snapshot
from gonio.lab.rig import Pose, motion_planning
from gonio.lab.rig.description import ArmAxis, Arms
from gonio.samples.description import SampleDescription
from tests.command_line import gonio as run
from tests.gonio.lab.rig.test_motion_planning import RIG, deg
from tests.gonio.numpy_rig import NumpyRig, describe

MATT = SampleDescription(name="matt", model="lambert", parameters={"albedo": 0.5})


def test_directions_in_and_out_of_plane_are_those_of_the_kinematics() -> None:
    from gonio.lab.rig import kinematics

    with gonio.open_rig("sim-ideal", sample=MATT) as rig:
        for asked in (
            {"theta_i": 0.5, "theta_r": 0.7},
            {"theta_i": 0.5, "theta_r": -0.9},
            {"theta_i": 0.5, "phi_i": 0.2, "theta_r": 0.7, "phi_r": 1.5},
        ):
            moved = rig.move(**asked)
            seen = kinematics.directions(rig.description, rig.arms.read())
            phi_i = asked.get("phi_i", 0.0)
            phi_r = asked.get("phi_r", phi_i + (math.pi if asked["theta_r"] > 0 else 0.0))
            assert float(seen.theta_i) == pytest.approx(asked["theta_i"], abs=1e-9)
            assert float(seen.theta_r) == pytest.approx(abs(asked["theta_r"]), abs=1e-9)
            apart = float(seen.phi_r - seen.phi_i) - (phi_r - phi_i)
            assert math.remainder(apart, math.tau) == pytest.approx(0, abs=1e-9)
            assert moved.branch.startswith("taken: light ")


def test_axes_that_are_not_named_stay_where_they_are() -> None:
    with gonio.open_rig("sim", sample=MATT) as rig:
        rig.move(light=0.3, camera=-0.4)
        before = rig.arms.read()
        moved = rig.move(tilt=0.1)
        after = rig.arms.read()
    assert list(moved.landed) == ["tilt"]
    assert (after.light, after.camera, after.spin) == (before.light, before.camera, before.spin)


def test_the_lamps_level_is_seen_by_the_camera() -> None:
    with gonio.open_rig("sim-ideal", sample=MATT) as rig:
        rig.move(theta_i=0.0, theta_r=0.7)
        bright = {}
        for level in (0.0, 0.25, 1.0):
            rig.lamp(level, wavelength_nm=500)
            bright[level] = rig.snap(exposure_s=0.1).numbers()["patch_mean_dn"]
        with pytest.raises(ConfigError, match="a fraction from 0 to 1"):
            rig.lamp(1.5)
    assert bright[1.0] - bright[0.0] == pytest.approx(4 * (bright[0.25] - bright[0.0]), rel=1e-3)  # whole DN


def test_a_scan_over_a_mirror_direction_finds_it() -> None:
    """The peak of an ideal rig lies at the mirror angle, and far from it the signal falls by orders of magnitude."""
    sample = SampleDescription(
        name="alu", model="he-torrance", parameters={"sigma0_um": 0.05, "tau_um": 3, "ior": "Al"}
    )
    heard: list[int] = []
    with gonio.open_rig("sim-ideal", sample=sample) as rig:
        rig.move(light=math.radians(30))
        angles = [math.radians(a) for a in (-36.0, -31.0, -30.0, -29.0)]
        table = rig.scan("camera", angles, frames=1, progress=lambda t, total: heard.append(len(t)))
        assert rig.read().of("lamp", "state") == "dark"
    assert heard == [1, 2, 3, 4]
    assert table["signal_dn_per_s"].idxmax() == 2
    assert table["signal_dn_per_s"][2] > 100 * table["signal_dn_per_s"][0]
    assert table.attrs["others_deg"]["light"] == 30
    assert (table["flag"] == "").all()
    assert np.isfinite(table["u_signal_dn_per_s"]).all()


def test_a_strangers_rig_is_worked_on_by_the_protocols_alone(tmp_path: Path) -> None:
    manual = ManualRig(NumpyRig(describe()), only=["arms"])
    assert manual.description.name == "bench of numpy"
    with manual:
        assert not manual.can_hold
        with pytest.raises(ConfigError, match="has no `hold`"):
            manual.hold()
        assert manual.move(light=0.3).landed == {"light": 0.3}
        assert manual.move(camera=-0.3).landed == {"camera": -0.3}
        assert manual.arms.read() == Pose(light=0.3, camera=-0.3)
        assert manual.read().of("light", "angle") == pytest.approx(math.degrees(0.3))
        with pytest.raises(ConfigError, match="has no levels"):
            manual.lamp(0.5)
        manual.lamp(True)
        assert manual.snap(tmp_path / "a.png", exposure_s=0.01).patch is not None
        manual.lamp(False)


def test_a_way_around_another_body_is_driven_in_legs_of_the_axes_that_move() -> None:
    start, goals = deg(-60.0, -20.0), {"light": math.radians(10.0), "camera": math.radians(50.0)}
    rig = NumpyRig(RIG, pose=start)
    assert motion_planning.route(RIG, start, deg(10.0, 50.0)) == [deg(-60.0, 50.0), deg(10.0, 50.0)]
    assert ManualRig(rig)._legs(goals) == [{"camera": goals["camera"]}, goals]
    assert ManualRig(NumpyRig(describe(), pose=start))._legs(goals) == [goals]


@pytest.mark.parametrize(("apart_deg", "told"), [(0.21, False), (0.23, True)])
def test_readings_at_rest_that_lie_apart_by_some_steps_are_told(
    caplog: pytest.LogCaptureFixture, apart_deg: float, told: bool
) -> None:
    rig = NumpyRig(describe(arms=Arms(light=ArmAxis(limits_deg=(-89.0, 89.0), encoder_step_deg=0.088))))
    rig.spread = Pose(light=math.radians(apart_deg))  # type: ignore[attr-defined]
    ManualRig(rig).move(light=0.3)
    assert [f"{apart_deg} deg apart" in message for message in caplog.messages] == [True] * told


def test_reading_a_simulated_rig_opens_nothing() -> None:
    rig = gonio.open_rig("sim")
    assert rig.read().of("light", "angle") == pytest.approx(-89, abs=0.1)  # an encoder step of 0.088 deg
    assert not rig.world.open


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["read"], 0, "light"),
        (["move", "light=20"], 0, "exists for the length of one command, and starts parked"),
        (["lamp", "0.5", "--for", "0"], 0, "lamp dark"),
        (["lamp", "maybe"], 2, "say on, off, or a level from 0 to 1"),
        (["dark"], 0, "lamp dark"),
        (["park"], 0, "lamp dark, arms parked"),
        (["snap", "a.jpg"], 2, "a frame is written as .dng, .tif, .tiff, .png"),
        (["snap", "no/a.png"], 2, "there is no folder no"),
        (["scan", "light", "--from", "0", "--to", "5", "--step", "0"], 2, "step = 0"),
        (["scan", "light", "--from", "0", "--to", "95", "--step", "5"], 2, "outside this axis's limits"),
        (["scan", "light", "--from", "0", "--to", "5", "--step", "1", "--at", "light=3"], 2, "this axis is scanned"),
        (["set-zero", "light"], 2, "is no rig file to write into"),
        (["ids"], 2, "has no servos"),
        (["reboot"], 2, "has no servos"),
    ],
)
def test_commands_on_a_simulated_rig(tmp_path: Path, words: list[str], code: int, message: str) -> None:
    done = run(tmp_path, "rig", *words, "--rig", "sim")
    assert (done.returncode, message in done.stdout + done.stderr) == (code, True), done.stdout + done.stderr


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="no folder that takes no file from anybody")
@pytest.mark.parametrize(
    "words",
    [
        ("rig", "scan", "light", "--from", "0", "--to", "5", "--step", "1", "--out", "/proc/s.csv"),
        ("rig", "snap", "/proc/a.png"),
        ("rig", "align", "--yes", "--out", "/proc/a.toml"),
        ("calibrate", "light", "--yes", "--out", "/proc/l.toml"),
        ("calibrate", "camera", "--yes", "--out", "/proc/c.toml"),
        ("calibrate", "geometry", "--yes", "--out", "/proc/g.toml"),
    ],
)
def test_nothing_is_measured_that_cannot_be_written(tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "my.toml").write_text(run(tmp_path, "rig", "show", "sim").stdout, encoding="utf-8")
    done = run(tmp_path, *words, "--rig", "my.toml")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert f"{words[-1]}: /proc is not writable; choose another folder" in done.stderr


@pytest.mark.parametrize("at", ["1e6", "nan", "-inf"])
def test_no_axis_stands_at_an_absurd_angle(tmp_path: Path, at: str) -> None:
    (tmp_path / "my.toml").write_text(run(tmp_path, "rig", "show", "sim").stdout, encoding="utf-8")
    before = (tmp_path / "my.toml").read_bytes()
    done = run(tmp_path, "rig", "set-zero", "light", "--rig", "my.toml", "--at", at)
    assert (done.returncode, "an axis stands at an angle from -360 to 360 deg" in done.stderr) == (2, True)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("my.toml", before)]


# ---- what was measured by hand is kept, whatever fails afterwards ----


TABLE = pd.DataFrame(
    {"angle_deg": [0.0, 1.0], "signal_dn_per_s": [1.0, 2.0], "u_signal_dn_per_s": [0.1, 0.1], "flag": ["", ""]}
)
TABLE.attrs |= {"axis": "camera", "rig": "a rig", "band": "550 nm"}


def _no_pictures(path: Any, data: bytes) -> None:
    if Path(path).name.endswith("view.png") or Path(path).name == "s.png":
        raise OSError(28, "No space left on device")
    write_whole(path, data)


def test_a_table_is_on_the_disk_before_its_plot_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*a: object, **k: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Figure, "savefig", broken)
    with pytest.raises(KeyboardInterrupt):
        scan.write(TABLE, tmp_path / "s.csv")
    assert len(pd.read_csv(tmp_path / "s.csv")) == 2


def test_a_full_disk_is_blamed_on_the_file_that_did_not_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gonio.disk.write_whole", _no_pictures)
    with pytest.raises(DataError, match=r"s\.png: cannot be written: No space.*whole, in .*s\.csv"):
        scan.write(TABLE, tmp_path / "s.csv")
    with (
        gonio.open_rig("sim-ideal") as rig,
        pytest.raises(DataError, match=r"a-view\.png: cannot be written: No space.*whole, in .*a\.dng"),
    ):
        rig.snap(tmp_path / "a.dng", exposure_s=0.01)
    assert (tmp_path / "a.dng").exists()


def test_a_picture_that_cannot_be_drawn_is_named_and_the_measurement_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*given: object) -> None:
        raise ZeroDivisionError("late")

    monkeypatch.setattr(scan, "plot", fails)
    monkeypatch.setattr(Snapshot, "draw", fails)
    (tmp_path / "matt.toml").write_text(to_toml(MATT.model_dump(mode="json", exclude_none=True)))
    scanned = run(
        tmp_path, "rig", "scan", "light", "--from", "0", "--to", "2", "--step", "1",
        "--rig", "sim-ideal", "--sample", "matt.toml", "--out",
        "s.csv", expect=1,
    )  # fmt: skip
    snapped = run(tmp_path, "rig", "snap", "a.dng", "--rig", "sim-ideal", "--sample", "matt.toml", expect=1)
    for done, name, picture in ((scanned, "s.csv", "s.png"), (snapped, "a.dng", "a-view.png")):
        assert f"the picture {picture}" in done.stderr
        assert "ZeroDivisionError: late" in done.stderr
        assert (tmp_path / name).is_file()
        assert not (tmp_path / picture).exists()


def test_signals_wait_while_something_is_written() -> None:
    before = signal.getsignal(signal.SIGINT)
    with undisturbed():
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGQUIT)
    assert signal.getsignal(signal.SIGINT) is before
