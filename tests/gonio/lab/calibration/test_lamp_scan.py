"""`gonio calibrate light` on a simulated bench whose truth nobody who measures there knows."""

import datetime
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gonio.config import numbers_in, to_toml
from gonio.disk import write_whole
from gonio.errors import DataError, DeviceError
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.by_hand.manual_rig import ManualRig
from gonio.lab.calibration import lamp_scan, lamp_stability
from gonio.lab.rig import Frame
from gonio.lab.rig.calibration_files import Calibration, identity, read_calibration, write_calibration
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.regions import Roi
from gonio.samples.description import ParameterUncertainty
from gonio.typing import Floats
from tests.command_line import gonio, some
from tests.gonio.numpy_rig import describe as numpy_rig
from tests.gonio_sim.conftest import describe

TRUTH = {
    "lamp": {
        "noise": 0.003, "drift_per_hour": 0.012, "warm_up_loss": 0.08, "warm_up_time_constant_s": 300.0,
        "monitor": True, "monitor_noise": 0.0005,
        "beam": {"x_per_mm": 0.002, "y_per_mm": -0.001, "xx_per_mm2": -2e-4, "xy_per_mm2": 3e-5, "yy_per_mm2": -1.5e-4},
    }
}  # fmt: skip


def write(folder: Path, truth: dict[str, Any] = TRUTH, **changes: dict[str, Any]) -> None:
    small = {"camera": {"width": 96, "height": 80, "pixel_um": 32.0}, "lamp": {"noise": 0.001, "drift_per_hour": 0.0}}
    values = describe("sim", **(small | changes)).model_dump(mode="python", exclude_none=True)
    values.pop("calibration")
    (folder / "truth.toml").write_text(to_toml(truth))
    (folder / "rig.toml").write_text(to_toml(values | {"truth": "truth.toml"}))


def calibrated(folder: Path, *words: str, kind: str = "light", out: str = "light.toml", rig: str = "rig.toml") -> Any:
    """What `gonio calibrate` does and says; its words in one line."""
    done = gonio(folder, "calibrate", kind, "--rig", rig, "--out", out, *words)
    done.stderr = " ".join(done.stderr.split())
    return done


def found_in(folder: Path, *words: str, out: str = "light.toml") -> tuple[Calibration, dict[str, float], str]:
    """A calibration of the light that is made, its standard uncertainties by name, and what was said."""
    done = calibrated(folder, *words, out=out)
    assert done.returncode == 0, done.stderr
    found = read_calibration(folder / out)
    return found, dict(zip(found.uncertainty.parameters, found.uncertainty.u, strict=True)), done.stderr


def use(folder: Path, *files: str) -> None:
    """Let the rig file take calibrations."""
    rig = tomllib.loads((folder / "rig.toml").read_text())
    (folder / "rig.toml").write_text(to_toml(rig | {"calibration": {"files": list(files)}}))


def series(t: Floats, signal: Floats) -> pd.DataFrame:
    return pd.DataFrame({"time_s": t, "signal_dn_per_s": signal, "u_shot_dn_per_s": 0.1, "exposure_s": 0.01})


def test_what_is_true_of_the_lamp_is_found_and_can_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path)
    found, u, _ = found_in(tmp_path, "--minutes", "25", "--valid-days", "90")
    values, true = numbers_in(found.values), numbers_in(TRUTH)
    for name, value in values.items():
        if name != "lamp.warm_up_s":
            assert abs(value - true[name]) < 4.0 * u[name], name  # ten numbers
    assert values["lamp.warm_up_s"] > 300.0 * np.log(0.07 / 5e-4)
    assert "set lamp.monitor = true" in " ".join(found.notes)
    for name in ("light-series.csv", "light-series.png", "light-flats.csv", "light-flats.png"):
        assert (tmp_path / name).stat().st_size > 1000
    use(tmp_path, "light.toml")
    assert some(find_rig(str(tmp_path / "rig.toml")).description.lamp.beam).x_per_mm == values["lamp.beam.x_per_mm"]
    # the same data again, without the bench
    again, _, _ = found_in(tmp_path, "--series", "light-series.csv", out="again.toml")
    assert again.values["lamp"]["noise"] == pytest.approx(values["lamp.noise"])
    monkeypatch.setattr(lamp_stability, "draw", lambda *given: 1 / 0)
    lost = calibrated(tmp_path, "--series", "light-series.csv", out="lost.toml")
    assert lost.returncode == 1
    assert "the picture lost-series.png" in lost.stderr
    assert read_calibration(tmp_path / "lost.toml").values == again.values
    assert "already" in calibrated(tmp_path).stderr


ZEROS = {"arms": {"light": {"zero_offset_deg": 2.37}, "camera": {"zero_offset_deg": -2.02}}}
BEAM = ("--only", "beam", "--seed", "2")


@pytest.mark.parametrize("theta_i_deg", [0.0, 8.0, 20.0, 45.0])
def test_flats_are_taken_from_both_sides_of_the_light_and_never_through_it(theta_i_deg: float) -> None:
    description = describe("sim", reference={"theta_i_deg": theta_i_deg})
    apart = [round(math.degrees(p.camera - p.light), 6) for p in lamp_scan._poses(description)]
    assert all(p.light == pytest.approx(math.radians(theta_i_deg)) for p in lamp_scan._poses(description))
    reached = [a for a in (12.0, -12.0, 35.0, -35.0, 50.0, -50.0, 62.0, -62.0) if abs(theta_i_deg + a) < 90.0]
    assert apart == pytest.approx(reached)


@pytest.mark.slow
def test_a_zero_that_nobody_has_measured_is_no_beam_that_is_tilted(tmp_path: Path) -> None:
    """The rig file claims zeros to 0.02 deg. The light's is 2 deg off, and no beam is tilted."""
    write(tmp_path, ZEROS, camera={"width": 320, "height": 240, "pixel_um": 10.0}, lamp={"noise": 0.0002})
    found, u_of, said = found_in(tmp_path, *BEAM)
    assert "WARNING: no calibration has measured the zeros of light, camera, tilt" in said
    assert (
        abs(found.values["lamp"]["beam"]["x_per_mm"]) < 1.01 * u_of["lamp.beam.x_per_mm"]
    )  # the truth is 0, and u holds what was found
    # 3 sin(2 deg) / 1000 mm: the nearer side is brighter, by distance and by angle; a fifth of it for what flats tell
    assert found.values["lamp"]["beam"]["x_per_mm"] == pytest.approx(-1.05e-4, rel=0.3)
    assert any("WARNING" in note for note in found.notes)
    # the same flats, with zeros that a calibration has measured, and knows less well than it should
    zeros = ["arms.light.zero_offset_deg", "arms.camera.zero_offset_deg", "holder.tilt_zero_offset_deg"]
    description = find_rig(str(tmp_path / "rig.toml")).description
    for name, u_deg in (("well", 0.02), ("badly", 1.0)):
        values = ZEROS | {"holder": {"tilt_zero_offset_deg": 0.264}}
        known = ParameterUncertainty(parameters=zeros, u=[u_deg] * 3, correlation=np.eye(3).tolist())
        write_calibration(
            Calibration(kind="geometry", rig=description.name, rig_identity=identity(description),
                        made=datetime.date(2026, 1, 2), values=values, uncertainty=known),
            tmp_path / f"{name}.toml",
        )  # fmt: skip
    beams = {}
    for name in ("well", "badly"):
        use(tmp_path, f"{name}.toml")
        found, u_of, said = found_in(tmp_path, *BEAM, out=f"light-{name}.toml")
        assert "WARNING" not in said
        beams[name] = found.values["lamp"]["beam"]["x_per_mm"], u_of["lamp.beam.x_per_mm"]
    assert abs(beams["well"][0]) < 4 * beams["well"][1]
    # 1 deg of the light's zero is 5.2e-5 a mm; noise and the camera's zero add to it
    assert np.sqrt(beams["badly"][1] ** 2 - beams["well"][1] ** 2) == pytest.approx(5.2e-5, rel=0.3)


def test_a_lamp_that_drifts_more_than_the_model_is_refused_and_its_data_kept(tmp_path: Path) -> None:
    write(tmp_path)
    t = np.repeat(np.arange(0.0, 1800.0, 15.0), 2) + np.tile([0.0, 0.1], 120)
    signal = 500.0 * (1.0 + 0.01 * np.sin(t / 150.0) + 0.001 * np.random.default_rng(0).standard_normal(t.size))
    series(t, signal).to_csv(tmp_path / "wild.csv", index=False)
    said = calibrated(tmp_path, "--series", "wild.csv")
    assert said.returncode == 1
    assert "drifts more than warm-up and steady drift allow" in said.stderr
    assert not (tmp_path / "light.toml").exists()
    assert (tmp_path / "light-series.png").exists()


def test_a_series_that_is_cut_short_is_kept(tmp_path: Path) -> None:
    """The camera is unplugged in the middle of it."""
    write(tmp_path)
    bench = ManualRig(find_rig(str(tmp_path / "rig.toml")).open(by_hand=True))
    kept: list[pd.DataFrame] = []
    capture, left = bench.camera.capture, iter(range(60))

    def unplugged(exposure_s: float) -> Frame:
        if next(left, None) is None:
            raise DeviceError("the camera does not answer")
        return capture(exposure_s)

    bench.camera.capture = unplugged  # type: ignore[method-assign]
    with bench, pytest.raises(DeviceError, match="does not answer"):
        lamp_scan.take_series(bench, 3600.0, 15.0, keep=kept.append)
    assert 50 < len(kept[0]) < 60
    assert (kept[0]["signal_dn_per_s"] > 0).all()
    assert not bench.world.lamp_on


def test_what_cannot_be_used_is_refused_in_words(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "few.csv").write_text("time_s,signal_dn_per_s,u_shot_dn_per_s\n0,1,0.1\n")
    for more, words, code in (
        (("--series", "few.csv"), "the column exposure_s is missing", 1),
        (("--series", "none.csv"), "there is no such file", 2),
        (("--lines", "few.csv"), "the column line_nm is missing", 1),
    ):
        said = calibrated(tmp_path, *more)
        assert words in said.stderr
        assert said.returncode == code
        assert not (tmp_path / "light.toml").exists()
    said = calibrated(tmp_path, rig="sim")
    assert said.returncode == 2
    assert "is no rig file" in said.stderr


def test_lines_and_polarisers_are_written_with_their_covariance(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "lines.csv").write_text("line_nm,read_nm,u_nm\n435.8,435.2,0.05\n546.1,545.3,0.05\n650.9,650.0,0.05\n")
    angles = np.arange(0.0, 180.0, 20.0)
    pd.DataFrame(
        {"polariser_deg": angles, "signal": 1 + 0.03 * np.cos(np.radians(2 * angles)), "u_signal": 1e-3}
    ).to_csv(tmp_path / "turned.csv", index=False)
    found, _, _ = found_in(tmp_path, "--lines", "lines.csv", "--lamp-polariser", "turned.csv")
    assert found.values["bands"]["tunable"]["start_nm"] == pytest.approx(400.55, abs=0.1)
    assert found.values["lamp"]["polarisation"]["degree"] == pytest.approx(0.03, abs=1e-6)
    assert found.uncertainty.correlation[0][1] < 0.0


def test_a_beam_is_found_behind_a_camera_that_bends_and_spreads_light_as_far_as_that_is_known(tmp_path: Path) -> None:
    bent = {"nonlinearity": (-0.02,), "stray_light": 0.02, "stray_halo": 0.01, "stray_halo_px": 8.0, "vignetting": 0.2}
    write(tmp_path, TRUTH | {"camera": bent}, camera={"width": 96, "height": 80, "pixel_um": 32.0} | bent)
    found, u, said = found_in(tmp_path, "--only", "beam")
    values, true = numbers_in(found.values), numbers_in(TRUTH)
    for name in (f"lamp.beam.{key}" for key in TRUTH["lamp"]["beam"]):  # type: ignore[attr-defined]
        assert abs(values[name] - true[name]) < 4.0 * u[name], name  # five numbers; without the correction 13 u
    assert "stray light" not in said
    write(tmp_path, TRUTH | {"camera": bent})
    assert (
        "no stray light" in calibrated(tmp_path, "--only", "beam", out="blind.toml").stderr
    )  # nobody knows of it: the note says so


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["camera", "light"])
def test_a_calibration_that_is_out_of_date_does_not_keep_its_successor_from_being_made(
    tmp_path: Path, kind: str
) -> None:
    write(tmp_path)
    description = find_rig(str(tmp_path / "rig.toml")).description
    old = Calibration(
        kind=kind, rig=description.name, rig_identity=identity(description),  # type: ignore[arg-type]
        made=datetime.date(2020, 1, 1), valid_until=datetime.date(2020, 2, 1), values={"lamp": {"noise": 0.5}},
    )  # fmt: skip
    write_calibration(old, tmp_path / "old.toml")
    use(tmp_path, "old.toml")
    assert "is out of date" in gonio(tmp_path, "rig", "check", "--rig", "rig.toml").stderr
    done = calibrated(tmp_path, "--only", "flats" if kind == "camera" else "beam", kind=kind, out="new.toml")
    assert done.returncode == 0, done.stderr


def test_a_file_that_cannot_be_written_is_named_as_its_user_knows_it(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"light\.toml") as caught:
        write_whole(tmp_path / "nowhere" / "light.toml", b"")
    assert ".new" not in str(caught.value)


# ---- of single frames ----


BENCH = numpy_rig(
    camera=Camera(
        width=64, height=48, pixel_um=40.0, exposure_limits_s=(1e-4, 10.0), photon_noise=True, electrons_per_dn=2.0,
        read_noise_e=3.0, full_well_e=20_000.0, dark_current_e_per_s=50.0, black_level_dn=64.0,
    )
)  # fmt: skip
"""A camera of 12 bits that saturates by its converter: 4031 DN above its black level."""


def frame(level_dn: int, exposure_s: float = 0.5, time_s: float = 1.0) -> Frame:
    """Each column is 1 DN darker than the one before: pixels of one level would be taken for full ones."""
    mosaic = np.broadcast_to(level_dn - np.arange(64), (48, 64)).astype(np.uint16)
    return Frame(mosaic, exposure_s, 64.0, 4095.0, time_s=time_s)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (frame(64 + 3950), ""),  # 98 % of 4031 are 3950.4
        (frame(64 + 3951), "saturates"),
        (frame(100, exposure_s=0.0), "its exposure was 0.0 s"),
        (frame(100, exposure_s=math.inf), "its exposure was inf s"),
        (frame(100, time_s=math.nan), "has no time"),
    ],
)
def test_a_frame_that_says_nothing_of_the_lamp_is_refused(made: Frame, said: str) -> None:
    pixels = made.mosaic.astype(float)
    if not said:
        lamp_scan._require(BENCH, made, pixels)
        return
    with pytest.raises(DataError, match=said):
        lamp_scan._require(BENCH, made, pixels)


def test_a_series_is_a_signal_by_its_exposure_with_the_noise_of_its_pixels() -> None:
    """1000 DN of 2 electrons, and 25 of dark current: photons, read noise and rounding, over the pixels of a region."""
    region = Roi(slice(10, 20), slice(10, 30), np.ones((10, 20), dtype=bool))
    taken = lamp_scan._Series(BENCH)
    for k in range(3):
        taken.add(frame(1100, time_s=5.0 + k), region, 5.0, None)
    found = taken.table(80.5)  # columns 10 to 29 lie 19.5 DN lower on average
    assert found["time_s"].tolist() == [0.0, 1.0, 2.0]
    assert found["signal_dn_per_s"].tolist() == [2000.0] * 3
    noise_dn = math.sqrt(2000.0 + 25.0 + 3.0**2 + 2.0**2 / 12.0) / 2.0
    np.testing.assert_allclose(found["u_shot_dn_per_s"], noise_dn / math.sqrt(200) / 0.5, rtol=1e-12)
    assert taken.black_level_dn == 64.0
    with pytest.raises(DataError, match="times must grow"):
        taken.add(frame(1100, time_s=7.0), region, 5.0, None)


def test_monitors_are_kept_beside_the_signal() -> None:
    region = Roi(slice(10, 20), slice(10, 30), np.ones((10, 20), dtype=bool))
    taken = lamp_scan._Series(BENCH)
    taken.add(frame(1100), region, 0.0, 0.98)
    assert taken.table(100.0)["monitor"].tolist() == [0.98]


def test_curve_and_stray_light_are_taken_out_of_a_frame() -> None:
    """Read as x (1 - 0.1 x / white) above the black level; an even share adds so much of the mean to each pixel."""
    bent = BENCH.model_copy(update={"camera": BENCH.camera.model_copy(update={"nonlinearity": (-0.1,)})})
    x = np.array([100.0, 1000.0, 3000.0])
    read = 64.0 + x * (1.0 - 0.1 * x / 4095.0)
    np.testing.assert_allclose(lamp_scan._linear(bent, frame(0), read), 64.0 + x, rtol=1e-10)
    spread = BENCH.model_copy(update={"camera": BENCH.camera.model_copy(update={"stray_light": 0.05})})
    scene = np.random.default_rng(1).uniform(0.0, 2000.0, (48, 64))
    np.testing.assert_allclose(
        lamp_scan._without_stray_light(spread, scene + 0.05 * scene.mean(), "mono"), scene, rtol=1e-10, atol=1e-9
    )
