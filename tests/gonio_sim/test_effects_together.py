"""Effects of 1 to 14 % that meet in one run: each of them alone is corrected, and so must they be together."""

import copy
import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf, monte_carlo
from gonio.lab.reduction.table import COMPONENTS
from gonio.lab.rig.calibration_files import with_keys
from gonio.lab.rig.calibration_use import Calibrated, CalibrationUse
from gonio.lab.rig.description import RigDescription
from tests.gonio_sim.conftest import describe, measured
from tests.gonio_sim.test_misaligned_rig import ERRORS

TRUE = 0.5 / math.pi
SENSOR = {"camera": {"nonlinearity": [-0.05], "stray_light": 0.02, "stray_halo": 0.02, "stray_halo_px": 20.0}}
PIXELS = {"acquisition": {"merge": "pixels"}}
MONITOR = {"lamp": {"monitor": True, "noise": 0.02, "monitor_noise": 1e-4}}
PROFILE = {"lamp": {"beam": {"x_per_mm": 0.03, "xx_per_mm2": -0.02, "yy_per_mm2": -0.03}}}
NARROW = {"lamp": {"beam_diameter_mm": 0.5}}
LIMITS = {"arms": {arm: {"limits_deg": [-97.0, 97.0]} for arm in ("light", "camera")}}
LAMP = {
    "reference": {"how": "beam", "attenuation": 0.01}, "lamp": {"half_angle_deg": 0.2}, **LIMITS,
    "camera": {"focal_length_mm": 50.0, "pixel_um": 8.0, "lens_half_angle_deg": 0.2},
    "acquisition": {"roi_radius_mm": 2.0},
}  # fmt: skip
ONE, TWO = [550], [450, 650]
ANGLES = [0, 40, 58], [-50, 20, 60]


def together(*parts: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for part in parts:
        for name, keys in part.items():
            out[name] = {**out.get(name, {}), **keys}
    return out


def rig(*parts: dict[str, Any]) -> RigDescription:
    return with_keys(describe("sim-ideal", camera={"width": 128, "height": 96}), together(*parts), "rig")


def as_if(run: Run, description: RigDescription) -> brdf.Reduction:
    """What becomes of a run, had its rig file said something else."""
    run.settings = run.settings.model_copy(update={"rig": description})
    return brdf.reduce_in_parts(run)


def known(kind: Any, u: dict[str, float], correlation: float = 0.0) -> CalibrationUse:
    n = len(u)
    matrix = np.full((n, n), correlation) + (1.0 - correlation) * np.eye(n)
    return CalibrationUse(
        known=(
            Calibrated(
                kind=kind, file="c.toml", sha256="", made=datetime.date(2026, 1, 1), parameters=list(u),
                u=list(u.values()), correlation=matrix.tolist(),
            ),
        )
    )  # fmt: skip


@pytest.mark.parametrize(
    ("parts", "bands", "most"),
    [
        # without noise: the cube of 4 % of spread light, of which point and reference have nearly the same
        ([SENSOR], ONE, 1e-5),
        ([SENSOR, PIXELS], ONE, 1e-5),
        # the monitor is right to 1e-4 in each frame: of two readings four standard deviations
        ([SENSOR, PIXELS, MONITOR, PROFILE], TWO, 6e-4),
        # the pixels at the edge of a spot of 12 pixels across, see gonio/lab/rig/test_beam_size.py
        ([SENSOR, NARROW, PROFILE], ONE, 1.5e-3),
        ([SENSOR, NARROW, PROFILE, PIXELS, MONITOR], TWO, 1.5e-3),
        # the frame of a lamp spreads its light otherwise than that of a sample: the cube of 4 %
        ([SENSOR, LAMP], ONE, 1e-4),
        ([SENSOR, LAMP, PROFILE, PIXELS, MONITOR], TWO, 6e-4),
    ],
)
def test_what_is_known_of_sensor_and_light_costs_nothing(
    tmp_path: Path, parts: list[dict[str, Any]], bands: list[int], most: float
) -> None:
    """A Lambertian sample of albedo 0.5."""
    table = brdf.reduce(measured(tmp_path, rig(*parts), *ANGLES, bands=bands))
    assert (table["flag"] == "").all()
    np.testing.assert_allclose(table["brdf"], TRUE, rtol=most)
    # a lamp that flickers by 2 % leaves what its monitor leaves, 1e-4; photons of 10^4 electrons and 30 to 200 pixels
    assert float((table["u_brdf"] / TRUE).max()) < 3e-3


def test_a_lamp_seen_straight_through_crooked_arms_is_seen_whole(tmp_path: Path) -> None:
    """Elevations of 0.4 and -0.3 degrees show it beside the frame's middle, and offsets of the arms farther away."""
    crooked = copy.deepcopy(ERRORS)
    del crooked["camera"]
    for arm, limits in LIMITS["arms"].items():
        crooked["arms"][arm] |= limits
    table = brdf.reduce(measured(tmp_path, rig(crooked, {k: v for k, v in LAMP.items() if k != "arms"}), *ANGLES))
    np.testing.assert_allclose(table["brdf"], TRUE, rtol=5e-5)


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"lamp": {"beam_diameter_mm": 0.5}}, r"does not fill the lens behind it, which takes 3\.49 mm"),
        ({"camera": {"pointing_deg": [0.45, 0.0]}}, "does not hold it whole"),
    ],
)
def test_a_lamp_that_is_not_seen_whole_is_no_reference(tmp_path: Path, more: dict[str, Any], why: str) -> None:
    with pytest.raises(ConfigError, match=why):
        measured(tmp_path, rig(LAMP, more), *ANGLES)
    assert not (tmp_path / "run").exists()


def test_distances_that_the_absolute_mode_rests_on_are_in_its_budget(tmp_path: Path) -> None:
    """What the columns say is what a rig of other distances gives: 2 (1/d_i - 1/D), and the like of the camera."""
    u = {"geometry.light_distance_mm": 3.0, "geometry.camera_distance_mm": 2.0}
    description = rig(LAMP)
    run = measured(tmp_path, description, *ANGLES)
    first = as_if(run, description).table["brdf"]
    table = as_if(run, description.model_copy(update={"calibration": known("geometry", u)})).table
    expected = np.zeros(len(first))
    for name, by in u.items():
        key = name.split(".")[1]
        moved = as_if(run, with_keys(description, {"geometry": {key: 1000.0 + by}}, "moved")).table["brdf"]
        expected += (moved - first).to_numpy() ** 2
    stated = table.filter(regex="^s_geometry").pow(2).sum(axis=1)
    # 0.3 % and 0.2 %; finite against infinitesimal steps of that size
    np.testing.assert_allclose(np.sqrt(stated), np.sqrt(expected), rtol=0.02)
    assert float((np.sqrt(stated) / TRUE).min()) > 2e-3


def test_a_narrow_beam_has_the_cosine_of_the_camera_in_a_calibrated_geometry_too(tmp_path: Path) -> None:
    """Zeros that are known with a correlation of 1 are one cause: the sum of what the two are by themselves."""
    zeros = {"arms.light.zero_offset_deg": 0.1, "arms.camera.zero_offset_deg": 0.05}
    description = rig(NARROW)
    run = measured(tmp_path, description, *ANGLES)
    apart, one = (
        as_if(run, description.model_copy(update={"calibration": known("geometry", zeros, c)})).table for c in (0, 1)
    )
    expected = apart["s_theta_i_zero"] + apart["s_theta_r_zero"]
    assert float(abs(expected).max()) > 5e-4 * TRUE
    np.testing.assert_allclose(abs(one["s_geometry_1"]), abs(expected), rtol=0.02, atol=2e-6)


@pytest.mark.slow
def test_pixels_that_a_narrow_beam_does_not_light_do_not_average_its_pixels_responsivities(tmp_path: Path) -> None:
    pulls = []
    for seed in range(10):
        (folder := tmp_path / str(seed)).mkdir()
        table = brdf.reduce(measured(folder, rig(NARROW, {"camera": {"prnu": 0.05}}), [58], ANGLES[1], seed=seed))
        pulls.append((table["brdf"] - TRUE) / table["u_brdf"])
    # thirty pulls that share a third of their pixels: the standard deviation is known to 15 to 20 %
    assert 0.6 < math.sqrt(float(np.mean(np.square(pulls)))) < 1.5


def test_all_parts_of_the_budget_add_up_and_draws_agree(tmp_path: Path) -> None:
    """With every cause that a calibration can bring, two bands, a monitor, and frames merged pixel by pixel."""
    geometry = {
        f"arms.{arm}.{key}": 0.05 for arm in ("light", "camera") for key in ("zero_offset_deg", "elevation_deg")
    }
    camera = {"camera.nonlinearity[0]": 0.01, "camera.stray_light": 0.01, "camera.stray_halo": 0.01}
    light = {f"lamp.beam.{key}": 0.004 for key in ("x_per_mm", "y_per_mm", "xx_per_mm2", "yy_per_mm2")}
    light |= {"reference.attenuation": 5e-5}
    use = known("geometry", geometry, 0.3).known + known("camera", camera, 0.2).known + known("light", light).known
    noisy = {"photon_noise": True, "read_noise_e": 6.0, "prnu": 0.01}
    tremble = {"arms": {a: {"encoder_noise_deg": 0.1, "encoder_step_deg": 0.02} for a in ("light", "camera")}}
    description = rig(SENSOR, MONITOR, PROFILE, PIXELS, LAMP, {"camera": noisy})
    description = with_keys(description, tremble, "rig")
    description = description.model_copy(update={"calibration": CalibrationUse(known=use)})
    run = measured(tmp_path, description, *ANGLES, bands=TWO)
    reduction = brdf.reduce_in_parts(run)
    table, parts = reduction.table, reduction.budget
    random = np.sqrt((parts[list(COMPONENTS)] ** 2).sum(axis=1))
    np.testing.assert_allclose(random, table["u_random"], rtol=1e-9)
    every = np.sqrt(random**2 + (parts.filter(regex="^s_") ** 2).sum(axis=1))
    np.testing.assert_allclose(every, table["u_brdf"], rtol=1e-9)
    for name in ("s_geometry_1", "s_beam", "s_linearity", "s_stray_light", "s_reference"):
        assert (table[name] != 0).any(), name
    drawn = monte_carlo.check(run, reduction, 2000, seed=3).values
    # 2000 draws know a standard deviation to 1.6 %; of 18 the farthest is three of these off
    np.testing.assert_allclose(drawn["mc_u"], table["u_brdf"], rtol=0.06)
