"""`gonio calibrate geometry` on a simulated rig whose geometry is not what the rig file says, and what it refuses."""

import math
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim.rig import SIM, SimulatedRig

from gonio.config import numbers_in, read_toml, to_toml
from gonio.measurement import read
from tests.command_line import gonio, says
from tests.system.conftest import LAMBERT

pytestmark = pytest.mark.slow  # one calibration is made for all

TRUTH: dict[str, Any] = {
    "arms": {
        "light": {
            "zero_offset_deg": 3.1,
            "harmonics_deg": [[1, 0.15, -0.3]],
            "axis_tilt_deg": [0.4, -0.3],
            "elevation_deg": 0.2,
        },
        "camera": {
            "zero_offset_deg": -2.2,
            "harmonics_deg": [[2, 0.1, 0.12]],
            "axis_tilt_deg": [0.0, 0.35],
            "elevation_deg": -0.3,
        },
    },
    "holder": {"tilt_zero_offset_deg": 0.8, "spin_zero_offset_deg": -1.1, "surface_tilt_deg": [0.2, -0.1]},
    "camera": {"pointing_deg": [0.2, -0.1], "roll_deg": 0.4},
}
PLAN = 'name = "p"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = [20]\ntheta_r_deg = [-50, 5, 45]\n'


def tables() -> dict[str, Any]:
    """A rig file with large markers, few pixels and arms that can face each other."""
    out = tomllib.loads(SIM.toml)
    out["camera"] |= {"width": 260, "height": 196, "pixel_um": 12.0, "focal_length_mm": 50.0}
    out["holder"] |= {"fiducials": {"count": 4, "marker_mm": 8.0, "ring_mm": 18.0}, "zero_offset_deg": 0.0}
    for arm in ("light", "camera"):
        out["arms"][arm] |= {"limits_deg": [-120.0, 120.0], "zero_offset_deg": 0.0}
    return out


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a rig, its truth, and what the command makes of them."""
    folder = tmp_path_factory.mktemp("geometry")
    (folder / "truth.toml").write_text(to_toml(TRUTH))
    (folder / "rig.toml").write_text(to_toml({"truth": "truth.toml"} | tables()))
    gonio(
        folder, "calibrate", "geometry", "--rig", "rig.toml", "--out", "geometry.toml", "--quick", "--yes", "--seed",
        "5", expect=0,
    )  # fmt: skip
    return folder


@pytest.mark.slow
def test_the_file_holds_the_truth_within_its_uncertainties(calibrated: Path) -> None:
    file = read_toml(calibrated / "geometry.toml")
    known, values, true = file["uncertainty"], numbers_in(file["values"]), numbers_in(TRUTH)
    u = dict(zip(known["parameters"], known["u"], strict=True))
    compared = [path for path in true if path in u and "harmonics" not in path]
    assert len(compared) == 14
    for path in compared:
        # 14 numbers and a fixed seed: 4 u
        assert values[path] == pytest.approx(true[path], abs=4 * u[path]), path
    for path in ("arms.light.axis_tilt_deg[0]", "arms.light.axis_tilt_deg[1]", "arms.camera.axis_tilt_deg[1]"):
        assert u[path] < 0.03  # 70 poses with steps of 0.088 deg; the whole set comes to half of it


@pytest.mark.slow
def test_kept_sightings_are_fitted_again_and_move_nothing(calibrated: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gonio(
        calibrated, "calibrate", "geometry", "--rig", "rig.toml", "--scans", "geometry-sightings", "--out",
        "again.toml", expect=0,
    )  # fmt: skip
    assert (calibrated / "again.toml").read_bytes() == (calibrated / "geometry.toml").read_bytes()
    assert not (calibrated / "again-sightings").exists()
    monkeypatch.setattr("gonio.lab.calibration.geometry.draw", lambda *given: 1 / 0)
    said = gonio(
        calibrated, "calibrate", "geometry", "--rig", "rig.toml", "--scans", "geometry-sightings", "--out",
        "lost.toml", expect=1,
    ).stderr  # fmt: skip
    assert "the picture lost-residuals.png" in said
    assert (calibrated / "lost.toml").read_bytes() == (calibrated / "geometry.toml").read_bytes()


def test_a_run_with_the_calibration_states_what_it_leaves_open(calibrated: Path) -> None:
    (calibrated / "sample.toml").write_text(LAMBERT)
    (calibrated / "plan.toml").write_text(PLAN)
    tables_then = {"truth": "truth.toml"} | tables() | {"calibration": {"files": ["geometry.toml"]}}
    (calibrated / "then.toml").write_text(to_toml(tables_then))
    for arguments in (
        ("measure", "plan.toml", "--rig", "then.toml", "--sample", "sample.toml", "--out", "run", "--yes"),
        ("reduce", "run"),
    ):
        gonio(calibrated, *arguments, expect=0)
    table = read(calibrated / "run" / "brdf.csv")
    common = table[[name for name in table.columns if name.startswith("s_geometry_")]].to_numpy()
    used = (table["flag"] == "").to_numpy()
    assert used.sum() >= 2
    assert common.shape[1] >= 1
    assert np.all(np.sum(common[used] ** 2, axis=1) > 0.0)
    assert np.all(np.abs(table["brdf"] - 0.5 / math.pi)[used] < 4 * table["u_brdf"][used])
    assert table["theta_i_deg"][used].to_numpy() == pytest.approx(20.0, abs=0.3)  # without it, 3 deg off


def refused(folder: Path, rig: dict[str, Any], *options: str) -> str:
    (folder / "rig.toml").write_text(to_toml(rig))
    done = gonio(folder, "calibrate", "geometry", "--rig", "rig.toml", "--out", "g.toml", "--yes", *options)
    assert done.returncode in (1, 2), done.stdout + done.stderr
    assert not (folder / "g.toml").exists()
    return " ".join((done.stdout + done.stderr).split())


def test_arms_that_cannot_face_each_other_are_told_before_anything_moves(tmp_path: Path) -> None:
    rig = tables()
    for arm in ("light", "camera"):
        rig["arms"][arm]["limits_deg"] = [-80.0, 80.0]
    said = refused(tmp_path, rig, "--holder", "empty")
    says(said, "cannot face each other", "limits_deg")
    assert not (tmp_path / "g-sightings").exists()


def test_sightings_of_another_rig_are_refused(calibrated: Path, tmp_path: Path) -> None:
    rig = tables()
    rig["holder"]["axes"] = ["spin"]
    assert "was made with the axes" in refused(tmp_path, rig, "--scans", str(calibrated / "geometry-sightings"))


@pytest.mark.parametrize(
    ("truth", "holder", "lies", "said"),
    [
        ({"camera": {"responsivity_e_per_s": 1e-3}}, "mirror", "mirror", "all frames are dark: does the lamp shine"),
        ({}, "mirror", "reference", "flat on it; light is seen, so the lamp shines"),
        pytest.param(
            {"lamp": {"half_angle_deg": 2.0}}, "empty", "empty", "does not have the form of the lamp",
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_what_is_missing_is_told_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, truth: dict[str, Any], holder: str, lies: Any, said: str
) -> None:
    def put(self: SimulatedRig, what: str) -> bool:
        self.world.target = lies  # a person who did not do what was asked
        return True

    monkeypatch.setattr(SimulatedRig, "put", put)
    (tmp_path / "truth.toml").write_text(to_toml(truth))
    done = gonio_of(tmp_path, {"truth": "truth.toml"} | tables(), "--quick", "--search", "1", "--holder", holder)
    assert done.returncode == 3, done.stdout + done.stderr
    assert said in " ".join(done.stderr.split())
    assert not (tmp_path / "g.toml").exists()


@pytest.mark.slow
def test_zeros_that_the_rig_file_knows_are_kept_and_said(tmp_path: Path) -> None:
    """The shipped `sim`: arms that cannot face each other, and no markers."""
    out = tomllib.loads(SIM.toml)
    out["camera"] |= {"width": 320, "height": 240, "pixel_um": 10.0}
    done = gonio_of(tmp_path, out, "--quick", "--seed", "2")
    assert done.returncode == 0, done.stderr
    file, said = read_toml(tmp_path / "g.toml"), " ".join(done.stdout.split())
    u = dict(zip(file["uncertainty"]["parameters"], file["uncertainty"]["u"], strict=True))
    assert not [path for path in u if path.startswith("arms") and path.endswith("zero_offset_deg")]
    tilt = "holder.tilt_zero_offset_deg"
    # two weights, of which the other one is far smaller; the file's own may count for less where they disagree
    assert u.get(tilt, 0.02) == pytest.approx(0.02, rel=0.5)
    assert numbers_in(file["values"]).get(tilt, 0.264) == pytest.approx(0.264, abs=0.02)
    for path in ("arms.light.zero_offset_deg", "arms.camera.zero_offset_deg", tilt):
        assert f"WARNING: {path}: measured" in said
    assert "printed markers" in said
    assert "a quick look at the camera" not in said  # which has nothing to say: the rig file is right


def gonio_of(folder: Path, rig: dict[str, Any], *options: str) -> subprocess.CompletedProcess[str]:
    (folder / "rig.toml").write_text(to_toml(rig))
    return gonio(folder, "calibrate", "geometry", "--rig", "rig.toml", "--out", "g.toml", "--yes", *options)
