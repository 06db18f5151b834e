"""A simulated rig with errors of alignment that its rig file knows, does not know, or knows with a covariance."""

import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_sim.render import Renderer
from gonio_sim.rig import SIM
from gonio_sim.world import World

from gonio.config import numbers_in, with_numbers
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.reduction.geometry_errors import GeometryErrors
from gonio.lab.rig import Pose
from gonio.lab.rig.calibration_files import with_keys
from gonio.lab.rig.calibration_use import Calibrated, CalibrationUse
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.inverse_kinematics import reach
from gonio.typing import Floats
from tests.gonio.lab.rig import plain_rig
from tests.gonio_sim.conftest import MATTE, describe, measured

SMALL = {"width": 64, "height": 48, "pixel_um": 33.0}
ERRORS: dict[str, Any] = {
    "arms": {
        "light": {
            "zero_offset_deg": 1.2, "harmonics_deg": [[1, 0.1, -0.05], [2, 0.03, 0.02]], "axis_tilt_deg": [0.3, -0.2],
            "axis_offset_mm": [0.8, -0.5], "elevation_deg": 0.4,
        },
        "camera": {
            "zero_offset_deg": -2.1, "harmonics_deg": [[1, -0.07, 0.06]], "axis_tilt_deg": [-0.25, 0.15],
            "axis_offset_mm": [-0.6, 0.4], "elevation_deg": -0.3,
        },
    },
    "holder": {
        "surface_offset_mm": 0.9, "surface_tilt_deg": [0.2, -0.3], "sample_offset_mm": [0.2, -0.1],
        "spin_axis_tilt_deg": 0.2, "tilt_axis_offset_mm": 0.3,
    },
    "camera": {"principal_point_px": [1.5, -1.0], "roll_deg": 0.8, "pointing_deg": [0.03, -0.02],
               "distortion": [0.2, 0.0, 0.001, 0.0, 0.0]},
}  # fmt: skip
UNCERTAIN = {
    "arms.light.zero_offset_deg": 0.05, "arms.camera.zero_offset_deg": 0.05, "arms.light.harmonics_deg[0][1]": 0.03,
    "arms.light.harmonics_deg[1][2]": 0.03, "arms.light.axis_tilt_deg[0]": 0.05, "arms.light.axis_tilt_deg[1]": 0.05,
    "arms.light.axis_offset_mm[0]": 0.5, "arms.light.axis_offset_mm[1]": 0.5, "arms.camera.elevation_deg": 0.05,
    "holder.surface_offset_mm": 0.5, "holder.surface_tilt_deg[0]": 0.05, "holder.surface_tilt_deg[1]": 0.05,
    "camera.principal_point_px[0]": 0.5,
}  # fmt: skip


def known_rig(known: dict[str, Any], **changes: dict[str, Any]) -> RigDescription:
    return with_keys(describe("sim-ideal", camera=SMALL, **changes), known, "known")


def as_if(run: Run, rig: RigDescription) -> pd.DataFrame:
    """The table of a run, had its rig file said something else."""
    run.settings = run.settings.model_copy(update={"rig": rig})
    return brdf.reduce(run)


def lit(truth: RigDescription, pose: Pose) -> float:
    """How strongly the lamp lights what the middle of the sensor sees, by a plain implementation."""
    seen = plain_rig.place(truth, pose)
    middle = (truth.camera.width - 1) / 2, (truth.camera.height - 1) / 2
    near = [plain_rig.imaged(truth, seen, np.array([x, y, 0.0])) for x, y in ((0, 0), (1, 0), (0, 1))]
    slopes = np.array([np.subtract(near[1], near[0]), np.subtract(near[2], near[0])]).T
    spot = np.append(np.linalg.solve(slopes, np.subtract(middle, near[0])), 0.0)  # a plane is imaged nearly linearly
    to_lamp = seen["lamp"] - spot
    return float(to_lamp[2] / np.linalg.norm(to_lamp) ** 3)


def test_errors_that_are_known_cost_nothing_and_unknown_ones_what_the_light_says(tmp_path: Path) -> None:
    known = known_rig(ERRORS)
    run = measured(tmp_path, known, [10, 60], [-30, 5, 45], truth=ERRORS)
    poses = {step.point: step.pose for step in run.steps() if step.kind == "point"}
    visit = next(step.pose for step in run.steps() if step.kind == "reference")
    true = 0.5 / math.pi
    # levels of 16 bits, the darkest some thousand, over some 20 pixels: 1e-4 / sqrt(12 * 20), and half as much again
    # for the reference; the patch of 0.8 mm at 1 m adds 1e-6
    assert as_if(run, known)["brdf"].to_numpy() == pytest.approx(true, rel=5e-5)
    kept = {"arms": {arm: {"zero_offset_deg": ERRORS["arms"][arm]["zero_offset_deg"]} for arm in ("light", "camera")}}
    unaware = known_rig(kept)
    found = as_if(run, unaware)["brdf"].to_numpy() / true
    off = [lit(known, poses[k]) / lit(unaware, poses[k]) * lit(unaware, visit) / lit(known, visit) for k in range(6)]
    assert max(abs(np.array(off) - 1.0)) > 0.01
    assert found == pytest.approx(off, rel=2e-4)  # the plane's image is linear to 1 mm / 1 m of the 1 mm it is off


@pytest.mark.parametrize("holder", ["mirror", "empty"])
def test_the_lamp_is_seen_where_a_plain_camera_sees_it(holder: str) -> None:
    small = {"lens_half_angle_deg": 0.1, "focal_length_mm": 100.0}
    rig = known_rig({**ERRORS, "camera": {**ERRORS["camera"], "distortion": [0.0] * 5}}, lamp={"half_angle_deg": 0.15})
    rig = with_keys(rig, {"camera": small, "arms": {a: {"limits_deg": [-100, 100]} for a in ("light", "camera")}}, "x")
    world = World(rig, None, 0)
    mirror = Directions(math.radians(40), 0.3, math.radians(40), 0.3 + math.pi)
    asked = reach(world.optics, mirror) if holder == "mirror" else Pose(light=math.pi / 2, camera=-math.pi / 2)
    world.target = holder  # type: ignore[assignment]
    seen_before = []
    for off_deg in (-0.1, 0.1):
        world.pose = Pose(asked.light, asked.camera + math.radians(off_deg), asked.tilt, asked.spin)
        rate = Renderer(world).rate(rig.bands.all()[0])
        rows, columns = np.nonzero(rate > 0)
        centre = np.average(columns, weights=rate[rows, columns]), np.average(rows, weights=rate[rows, columns])
        seen = plain_rig.place(world.optics, world.pose)
        lamp = seen["lamp"] * ([1, 1, -1] if holder == "mirror" else 1)
        # a spot of ten pixels across, of which those at the edge are counted whole
        assert centre == pytest.approx(plain_rig.imaged(rig, seen, lamp), abs=0.1)
        seen_before.append(centre)
    assert math.dist(*seen_before) > 2.0


def test_an_encoder_errs_within_its_turn_and_from_landing_to_landing() -> None:
    rig = describe("sim-ideal", arms__light={"zero_offset_deg": 3.0, "harmonics_deg": [[1, 0.4, 0.1], [3, 0.05, 0.0]]})
    still = SIM.open(rig, sample=MATTE, seed=3, confirm=False)
    loose = SIM.open(
        with_keys(rig, {"arms": {"light": {"encoder_noise_deg": 0.05}}}, "x"), sample=MATTE, seed=3, confirm=False
    )
    off: list[list[float]] = [[], []]
    with still, loose:
        for angle in np.linspace(-80, 80, 60):
            for each, found in zip((still, loose), off, strict=True):
                read = math.degrees(each.arms.move(Pose(light=math.radians(angle))).light)
                found.append(math.degrees(each.world.pose.light) - plain_rig.true_deg(rig.arms.light, read))
    assert np.abs(off[0]).max() < 1e-9
    # the standard deviation of 60 normal numbers is known to 10 %
    assert np.std(off[1]) == pytest.approx(0.05, rel=0.3)


def covariance(rng: np.random.Generator, names: list[str]) -> tuple[Calibrated, Floats]:
    """A calibration with correlations drawn at random, and what turns normal numbers into its errors."""
    q, _ = np.linalg.qr(rng.normal(size=(len(names), len(names))))
    matrix = (q * rng.uniform(0.3, 2.0, len(names))) @ q.T
    matrix /= np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    u = np.array([UNCERTAIN[name] for name in names])
    known = Calibrated(
        kind="geometry", file="geometry.toml", sha256="", made=datetime.date(2026, 1, 1), parameters=names,
        u=u.tolist(), correlation=np.clip(0.5 * (matrix + matrix.T), -1.0, 1.0).tolist(),
    )  # fmt: skip
    return known, u[:, None] * np.linalg.cholesky(matrix)


def calibrated(known: Calibrated, **changes: dict[str, Any]) -> RigDescription:
    return known_rig(ERRORS, **changes).model_copy(update={"calibration": CalibrationUse(known=(known,))})


@pytest.mark.slow
def test_errors_within_a_calibrations_covariance_stay_within_u(tmp_path: Path) -> None:
    """Forty rigs, each wrong by what its calibration says it may be. Noise there is none: u is the geometry's alone."""
    known, spread = covariance(np.random.default_rng(21), list(UNCERTAIN))
    rig, pulls = calibrated(known), []
    numbers = numbers_in(ERRORS)
    for k in range(40):
        errors = spread @ np.random.default_rng([22, k]).normal(size=len(UNCERTAIN))
        truth = with_numbers(ERRORS, {n: numbers[n] + e for n, e in zip(UNCERTAIN, errors, strict=True)})
        (folder := tmp_path / str(k)).mkdir()
        # so many points that they tell that the sample is matte
        table = brdf.reduce(measured(folder, rig, [40, 55], [-30, -10, 20], truth=truth))
        pulls.append((table["brdf"] - 0.5 / math.pi) / table["u_brdf"])
        assert list(table.filter(regex="^s_geometry")) == [f"s_geometry_{n}" for n in (1, 2, 3, 4)]
        assert (table[["s_theta_i_zero", "s_theta_r_zero"]] == 0).all(axis=None)  # they are among the geometry's
        parts = table.filter(regex="^(s_|u_random)").to_numpy()
        assert np.sqrt(np.sum(parts**2, axis=1)) == pytest.approx(table["u_brdf"].to_numpy(), rel=1e-9)
    # forty pulls and six points that share their errors: the standard deviation is known to 11 %
    assert 0.8 < math.sqrt(float(np.mean(np.square(pulls)))) < 1.25


def test_zeros_that_are_known_by_themselves_keep_their_columns(tmp_path: Path) -> None:
    """And a zero's uncertainty comes from the calibration, not from the rig file as well."""
    names = ["arms.light.zero_offset_deg", "arms.camera.zero_offset_deg"]
    made = {"kind": "geometry", "file": "geometry.toml", "sha256": "", "made": datetime.date(2026, 1, 1)}
    apart = Calibrated(**made, parameters=names, u=[0.1, 0.05], correlation=[[1, 0], [0, 1]])  # type: ignore[arg-type]
    together = Calibrated(**made, parameters=names, u=[0.1, 0.05], correlation=[[1, 1], [1, 1]])  # type: ignore[arg-type]
    filed = {"zero_u_deg": 7.0}
    rig = known_rig(ERRORS, arms__light=filed, arms__camera=filed)
    run = measured(tmp_path, rig, [50, 60], [-30, 20], truth=ERRORS)

    def table(known: Calibrated) -> pd.DataFrame:
        return as_if(run, rig.model_copy(update={"calibration": CalibrationUse(known=(known,))}))

    first, second = table(apart), table(together)
    assert first.filter(regex="^s_geometry").empty
    # Lambert: f cos(theta_i) alone changes, by tan(theta_i) u; the visit is at the normal. Misalignment: 1 deg of 50
    expected = 0.5 / math.pi * np.tan(np.radians(first["theta_i_deg"])) * math.radians(0.1)
    assert first["s_theta_i_zero"].abs().to_numpy() == pytest.approx(expected.to_numpy(), rel=0.05)
    assert list(second.filter(regex="^s_geometry")) == ["s_geometry_1"]
    assert (second["s_theta_i_zero"] == 0).all()
    one, other = second["s_geometry_1"], first["s_theta_i_zero"] + first["s_theta_r_zero"]
    assert one.abs().to_numpy() == pytest.approx(other.abs().to_numpy(), rel=0.02)


def test_a_calibration_of_a_number_that_the_rig_lacks_is_refused() -> None:
    known, _ = covariance(np.random.default_rng(23), ["arms.light.harmonics_deg[1][2]", "holder.surface_offset_mm"])
    rig = describe("sim-ideal").model_copy(update={"calibration": CalibrationUse(known=(known,))})
    with pytest.raises(ConfigError, match=r"uncertain of arms\.light\.harmonics_deg\[1\]\[2\]"):
        GeometryErrors(rig)
