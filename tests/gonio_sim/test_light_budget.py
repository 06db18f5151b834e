"""Runs of a simulated rig whose light has what a laboratory's has: what the reduction makes of it, and the truth."""

import datetime
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gonio import models
from gonio.config import to_toml
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.acquisition.measure import carry_out, find_rig
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import count_rates
from gonio.lab.reduction.brdf import reduce, reduce_in_parts
from gonio.lab.rig.calibration_files import Calibration, identity, write_calibration
from gonio.samples.description import ParameterUncertainty
from gonio.samples.files import load_sample
from tests.gonio_sim.conftest import describe

SMALL = {"width": 96, "height": 96, "pixel_um": 25.0}
PLAN = {"name": "few", "wavelength_nm": [550], "sweep": [{"theta_i_deg": [0, 30, 60], "theta_r_deg": [-45, 10, 50]}]}
MATTE = {"name": "matte", "model": "lambert", "parameters": {"albedo": 0.5}}
GLASS: dict[str, Any] = {
    "name": "rough glass", "model": "he-torrance",
    "parameters": {"sigma0_um": 0.6, "tau_um": 2.5, "ior": [1.5, 0.0]},
}  # fmt: skip


def run(
    folder: Path,
    base: str = "sim-ideal",
    *,
    sample: dict[str, Any] = MATTE,
    truth: dict[str, Any] | None = None,
    plan: dict[str, Any] = PLAN,
    known: tuple[dict[str, Any], dict[str, float]] | None = None,
    seed: int = 1,
    **changes: dict[str, Any],
) -> Run:
    """Measure with a shipped rig of which some keys are changed, of which some are known by a calibration."""
    changes = {"camera": SMALL} | changes
    values = describe(base, **changes).model_dump(mode="python", exclude_none=True)
    values.pop("calibration")
    if truth is not None:
        (folder / "truth.toml").write_text(to_toml(truth))
        values["truth"] = "truth.toml"
    (folder / "rig.toml").write_text(to_toml(values))
    if known is not None:
        calibration = Calibration(
            kind="light", rig=values["name"], rig_identity=identity(find_rig(str(folder / "rig.toml")).description),
            made=datetime.date(2026, 1, 1), values=known[0],
            uncertainty=ParameterUncertainty(
                parameters=list(known[1]), u=list(known[1].values()), correlation=np.eye(len(known[1])).tolist()
            ),
        )  # fmt: skip
        write_calibration(calibration, folder / "light.toml")
        (folder / "rig.toml").write_text(to_toml(values | {"calibration": {"files": ["light.toml"]}}))
    for name, table in (("plan", plan), ("sample", sample)):
        (folder / f"{name}.toml").write_text(to_toml(table))
    rig = find_rig(str(folder / "rig.toml"))
    described = load_sample(folder / "sample.toml")
    return carry_out(load_plan(folder / "plan.toml"), rig, folder / "run", sample=described, seed=seed, yes=True)


def straight(**reference: Any) -> dict[str, Any]:
    arm = {"limits_deg": [-95.0, 95.0]}
    return {"arms__light": arm, "arms__camera": arm, "reference": {"how": "beam", **reference}}


# ---- the lamp as the reference ----


def test_the_lamp_itself_as_the_reference_gives_the_truth_within_a_thousandth(tmp_path: Path) -> None:
    table = reduce(run(tmp_path, **straight(attenuation=0.01, u_rel=0.0)))
    # the frame holds 16 bits of unrounded levels; lamp and lens of half a degree are small to 1e-4
    np.testing.assert_allclose(table["brdf"], 0.5 / math.pi, rtol=1e-4)


def test_distances_and_apertures_that_differ_change_nothing(tmp_path: Path) -> None:
    """Lamp and lens of other sizes, at other distances: the sum over the lamp's image needs none of the sizes."""
    table = reduce(
        run(
            tmp_path,
            **straight(attenuation=0.1),
            geometry={"light_distance_mm": 700.0, "camera_distance_mm": 900.0},
            lamp={"half_angle_deg": 0.3},
            camera=SMALL | {"lens_half_angle_deg": 0.6},
        )
    )
    np.testing.assert_allclose(table["brdf"], 0.5 / math.pi, rtol=2e-4)  # as above; a lens of 0.6 degrees


def test_the_attenuation_s_uncertainty_is_the_reference_s(tmp_path: Path) -> None:
    known = {"reference": {"attenuation": 0.0101}}, {"reference.attenuation": 0.0001}
    table = reduce(run(tmp_path, "sim", truth={}, known=known, **straight(attenuation=0.01, u_rel=0.0), seed=3))
    np.testing.assert_allclose(table["s_reference"] / table["brdf"], 0.0001 / 0.0101, rtol=1e-9)
    # the filter lets through 1 % less than the calibration says: every value is that much too high
    error = table["brdf"] / (0.5 / math.pi) - 1.0
    assert np.mean(error) == pytest.approx(0.01, abs=0.004)
    assert np.all(abs(error) < 3.0 * table["u_brdf"] / table["brdf"])


def test_arms_that_do_not_reach_are_refused_when_planning(tmp_path: Path) -> None:
    for changes, words in (
        (
            {"reference": {"how": "beam", "attenuation": 0.01}},
            r'"beam" needs arms that stand 180 deg apart.*light -89 to 89 deg',
        ),
        (
            straight(attenuation=0.01) | {"lamp": {"half_angle_deg": 2.0}},
            r"the lamp, seen straight through, fills a disc of .* the frame holds",
        ),
        (straight(), r'how = "beam" and attenuation go together'),
    ):
        with pytest.raises(ConfigError, match=words):
            run(tmp_path, **changes)


# ---- the lamp's level ----


def test_a_monitor_takes_the_lamp_s_noise_and_its_jumps_out(tmp_path: Path) -> None:
    lamp = {"noise": 0.05, "monitor": True, "monitor_noise": 0.0005, "drift_per_hour": 0.2}
    quiet = reduce(run(tmp_path, "sim", truth={}, lamp=lamp))
    error = quiet["brdf"] / (0.5 / math.pi) - 1.0
    assert np.all(abs(error) < 4.0 * quiet["u_brdf"] / quiet["brdf"])
    assert np.std(error) < 0.004  # the lamp alone would make 0.05 / sqrt(2)
    assert np.all(quiet["u_random"] / quiet["brdf"] < 0.004)
    assert not any("scatter" in note for note in quiet.attrs["notes"])


def test_a_point_whose_frames_lack_a_reading_is_flagged(tmp_path: Path) -> None:
    made = run(tmp_path, "sim", truth={}, lamp={"monitor": True})
    steps = list(made.steps())
    assert all(frame.monitor for step in steps for frame in step.frames if frame.lamp)
    assert all(frame.monitor is None for step in steps for frame in step.frames if not frame.lamp)
    k = next(k for k, step in enumerate(steps) if step.kind == "point")
    steps[k] = replace(steps[k], frames=(replace(steps[k].frames[0], monitor=None), *steps[k].frames[1:]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(made, "steps", lambda: steps)
        patch.setattr("gonio.lab.reduction.table.unfinished", lambda run: "")  # asks for more than a list
        # the frame's own record would contradict the journal; files of a camera's own carry none
        patch.setattr(count_rates, "label_of", lambda *of: None)
        table = reduce(made)
    assert list(table["flag"]) == ["unmonitored"] + [""] * (len(table) - 1)
    assert math.isnan(table["brdf"][0])


def test_a_rig_without_the_monitor_that_its_file_promises_is_told(tmp_path: Path) -> None:
    from gonio.errors import DeviceError

    with pytest.raises(DeviceError, match=r"gives no reading of a monitor \(None\)"):
        run(tmp_path, lamp={"monitor": True}, truth={"lamp": {"monitor": False}})


# ---- the beam ----


def test_a_beam_s_profile_that_is_known_is_corrected_and_its_uncertainty_kept(tmp_path: Path) -> None:
    """A reference 13 mm beside the sample gets 3 % less light; the profile is known to a tenth of that."""
    true = {"lamp": {"beam": {"xx_per_mm2": -1.8e-4, "yy_per_mm2": -1.8e-4}}}
    wide: dict[str, Any] = {
        "reference": {"how": "beside", "offset_mm": [0.0, 13.0], "diameter_mm": 12.0, "u_rel": 0.0},
        "holder": {"sample_diameter_mm": 10.0},
        "camera": SMALL | {"pixel_um": 40.0},
    }
    known = {"lamp": {"beam": {"xx_per_mm2": -1.7e-4, "yy_per_mm2": -1.7e-4}}}, {"lamp.beam.yy_per_mm2": 1e-5}
    (tmp_path / "a").mkdir()
    table = reduce(run(tmp_path / "a", truth=true, known=known, **wide))
    # what is left is (1.8 - 1.7) 1e-4 * 13^2 = 1.7e-3: one standard uncertainty
    assert np.mean(table["brdf"] / (0.5 / math.pi) - 1.0) == pytest.approx(1e-5 * 13.0**2, rel=0.05)
    np.testing.assert_allclose(table["s_beam"] / table["brdf"], 1e-5 * 13.0**2, rtol=0.05)
    (tmp_path / "b").mkdir()
    plain = reduce(run(tmp_path / "b", truth=true, **wide))
    assert np.mean(plain["brdf"]) / (0.5 / math.pi) - 1.0 == pytest.approx(math.exp(1.8e-4 * 13.0**2) - 1.0, rel=0.05)
    assert "s_beam" not in plain


# ---- polarisation ----


@pytest.mark.parametrize(
    ("lamp", "camera"), [((0.1, 0.0), (0.05, 0.0)), ((0.1, 90.0), (0.05, 30.0)), ((0.2, None), (0.0, None))]
)
def test_the_budget_covers_what_polarisation_does_to_rough_glass(
    tmp_path: Path, lamp: tuple[float, float | None], camera: tuple[float, float | None]
) -> None:
    """Glass at its Brewster angle is the worst there is: u is what it does over the root of three."""
    keys = [{"polarisation": {"degree": d} | ({} if a is None else {"azimuth_deg": a})} for d, a in (lamp, camera)]
    plan = PLAN | {"sweep": [{"theta_i_deg": [30, 56], "theta_r_deg": [20, 56]}]}
    found = reduce_in_parts(run(tmp_path, sample=GLASS, plan=plan, lamp=keys[0], camera=SMALL | keys[1]))
    table, columns = found.table, found.table.filter(like="s_polarisation_")
    u = np.sqrt((columns**2).sum(axis=1) + found.budget["polarisation"] ** 2) / table["brdf"]
    model = models.build("he-torrance", dict(GLASS["parameters"]))
    at = Directions.from_table(table)
    error = table["brdf"].to_numpy() / np.asarray(model.brdf(*at.angles, wavelength_nm=550.0)) - 1.0
    # beside polarisation: the cones average the lobe, 1 %
    assert np.all(abs(error) < math.sqrt(3.0) * u + 0.01)
    brewster = (table["theta_i_deg"] > 50) & (table["theta_r_deg"] > 50)
    assert np.all(u[brewster] > (lamp[0] * abs(math.cos(2 * math.radians(lamp[1] or 0.0)))) / math.sqrt(3.0) * 0.5)


# ---- bands ----


def test_errors_of_wavelengths_and_widths_are_in_the_budget_of_a_run_of_several_bands(tmp_path: Path) -> None:
    """Copper, whose edge lies at 570 nm. The bands truly lie 1.5 nm higher than the file says; it is known to 1 nm."""
    copper = {"name": "copper", "model": "he-torrance", "parameters": {"sigma0_um": 0.5, "tau_um": 3.0, "ior": "Cu"}}
    plan: dict[str, Any] = {"name": "edge", "wavelength_nm": [550, 560, 570, 580, 590, 600]}
    plan["sweep"] = [{"theta_i_deg": [30], "theta_r_deg": [30]}]
    tunable = {"start_nm": 400.0, "stop_nm": 700.0, "step_nm": 10.0, "fwhm_nm": 10.0}
    truth = {"bands": {"tunable": tunable | {"start_nm": 401.5, "stop_nm": 701.5}}}
    known = {"bands": {"tunable": {"start_nm": 400.0}}}, {"bands.tunable.start_nm": 1.0}
    table = reduce(run(tmp_path, sample=copper | {"integrate_band": True}, plan=plan, truth=truth, known=known))
    (tmp_path / "exact").mkdir()
    exact = reduce(run(tmp_path / "exact", sample=copper, plan=plan))
    error = (table["brdf"] - exact["brdf"]).to_numpy()
    assert np.all(table["s_wavelength"][1:4] > 0.0)  # copper grows brighter there
    assert np.all(abs(error) < 2.5 * np.hypot(table["s_wavelength"], table["s_bandwidth"]) + 1e-3 * table["brdf"])
    assert "s_wavelength" not in exact
    parts = [name for name in table.columns if name.startswith("s_")]
    combined = np.sqrt(table["u_random"] ** 2 + (table[parts] ** 2).sum(axis=1))
    np.testing.assert_allclose(table["u_brdf"], combined, rtol=1e-12)


def test_one_band_alone_says_that_its_wavelength_is_not_in_the_budget(tmp_path: Path) -> None:
    known = {"bands": {"tunable": {"start_nm": 400.0}}}, {"bands.tunable.start_nm": 1.0}
    table = reduce(run(tmp_path, known=known, plan=PLAN | {"sweep": [{"theta_i_deg": [30], "theta_r_deg": [30]}]}))
    assert any("the run has one band" in note for note in table.attrs["notes"])
    assert "s_wavelength" not in table


# ---- a certificate with uncertainty ----


def test_the_uncertainty_of_a_certificate_goes_into_the_reference_s_column(tmp_path: Path) -> None:
    angles = np.arange(0.0, 81.0, 10.0)
    certificate = pd.DataFrame(
        {
            "theta_i_deg": 0.0, "phi_i_deg": 0.0, "theta_r_deg": angles, "phi_r_deg": 180.0, "wavelength_nm": 550.0,
            "polarisation": "unpolarised", "brdf": 0.31 - 1e-3 * angles, "u_brdf": 0.0015, "flag": "",
        }
    )  # fmt: skip
    certificate.to_csv(tmp_path / "white.csv", index=False)
    made = run(
        tmp_path,
        reference={"table": "white.csv", "u_rel": 0.001},
        truth={"reference": {"scale": 1.004, "table": str(tmp_path / "white.csv")}},
    )
    table = reduce(made)
    own = 0.0015 / (0.31 - 0.045)
    np.testing.assert_allclose(table["s_reference"] / table["brdf"], math.hypot(own, 0.001), rtol=1e-6)
    # the white is truly brighter than certified by 0.4 %: values come out as much too low
    np.testing.assert_allclose(table["brdf"], 0.5 / math.pi / 1.004, rtol=1e-4)
