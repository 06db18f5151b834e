"""The parts of an uncertainty: they add up, they are what they are named after, and what is missing is told."""

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from gonio.cli.application import build
from gonio.errors import ConfigError
from gonio.lab.acquisition.measure import carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf, monte_carlo
from gonio.lab.reduction.brdf import Reduction, reduce_in_parts
from gonio.lab.reduction.table import COMPONENTS, left_out
from gonio.lab.reduction.values import MeasuredBand, Values
from gonio.lab.rig.description import ArmAxis, Arms, RigDescription
from gonio.lab.rig.light_and_camera import Lamp
from gonio.samples.description import SampleDescription
from tests.gonio.lab.reduction.drawn_runs import pulls, rig
from tests.gonio.lab.reduction.made_run import MadeRun, Maker, describe, in_plane
from tests.gonio.lab.reduction.test_brdf import NOISY, POINTS, flicker, glossy


@pytest.fixture(scope="module")
def noisy(tmp_path_factory: pytest.TempPathFactory) -> Reduction:
    rng = np.random.default_rng(4)
    description = describe(
        camera=NOISY | {"prnu": 0.01, "lens_half_angle_deg": 0.5},
        lamp=Lamp(half_angle_deg=0.5, noise=0.003),
        arms=Arms(
            light=ArmAxis(limits_deg=(-89.0, 89.0), encoder_step_deg=0.088, zero_u_deg=0.02),
            camera=ArmAxis(limits_deg=(-89.0, 89.0), encoder_step_deg=0.088, zero_u_deg=0.02),
        ),
        reference={"u_rel": 0.004, "frames": 2},
    )
    maker = Maker(tmp_path_factory.mktemp("noisy"), description, glossy, rng, lambda t: flicker(rng, t))
    return reduce_in_parts(cast(Run, maker.make(POINTS, (0.25, 0.0625))))


def causes(table: pd.DataFrame) -> list[str]:
    return [name for name in table.columns if name.startswith("s_")]


def test_parts_add_up_in_squares_to_u(noisy: Reduction) -> None:
    table, parts = noisy.table, noisy.budget
    random = (parts[list(COMPONENTS)] ** 2).sum(axis=1)
    common = (parts[causes(parts)] ** 2).sum(axis=1)
    assert causes(parts) == causes(table)
    # a sum of 20 doubles: some units in the last place
    np.testing.assert_allclose(np.sqrt(random), table["u_random"], rtol=1e-13)
    np.testing.assert_allclose(np.sqrt(random + common), table["u_brdf"], rtol=1e-13)


def test_a_cause_of_ones_own_is_one_function(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fluorescence(measured: MeasuredBand, values: Values) -> None:
        values.common["s_fluorescence"] = 0.02 * values.brdf
        values.own["fluorescence"] = np.full(len(measured.points), 3e-3)

    before = reduce_in_parts(cast(Run, Maker(tmp_path, describe(), glossy).make(POINTS, (0.25,))))
    monkeypatch.setattr(brdf, "CAUSES", (*brdf.CAUSES, fluorescence))
    after = reduce_in_parts(cast(Run, Maker(tmp_path, describe(), glossy).make(POINTS, (0.25,))))
    f = before.table["brdf"].to_numpy()
    np.testing.assert_array_equal(after.table["s_fluorescence"], 0.02 * f)
    np.testing.assert_array_equal(after.budget["fluorescence"], 3e-3)
    # what the columns of the dark frames hold is chosen in units of u_random: a little moves between them
    np.testing.assert_allclose(after.table["u_random"] ** 2 - before.table["u_random"] ** 2, 3e-3**2, rtol=1e-5)
    expected = before.table["u_brdf"] ** 2 + 3e-3**2 + (0.02 * f) ** 2
    np.testing.assert_allclose(after.table["u_brdf"] ** 2, expected, rtol=1e-12)


def test_parts_are_what_they_are_named_after(noisy: Reduction) -> None:
    parts = noisy.budget
    relative = parts[list(COMPONENTS)].div(parts["brdf"], axis=0)
    # two frames of 0.3 %, and photons; 1 % of some hundred pixels; no spike; the lamp is steady, which few visits of
    # 0.2 % tell no better
    assert relative["noise"].between(0.002, 0.02).all()
    assert relative["prnu"].between(1e-6, 0.002).all()
    assert (relative["encoder"] > 0).all()
    assert (relative["visits"] < 0.002).all()
    np.testing.assert_allclose(parts["s_reference"], 0.004 * parts["brdf"], rtol=1e-12)  # the definition
    assert np.isinf(parts["nu_eff"]).all()
    assert (parts["cone_difference"] >= 0).all()


def test_what_is_not_in_the_budget_is_told_with_the_reason(noisy: Reduction) -> None:
    told = {row["cause"]: row["why"] for row in noisy.table.attrs["provenance"]["not_in_budget"]}
    assert {"stray_light", "linearity", "polarisation", "wavelength", "geometry", "solid_angle"} == set(told)
    assert "gonio calibrate camera" in told["stray_light"]
    known = noisy.table.assign(s_stray_light=0.0, s_geometry_1=0.0)
    known.attrs = noisy.table.attrs
    description = describe(arms=Arms(light=ArmAxis(limits_deg=(-89.0, 89.0), zero_offset_known=False)))
    told = {row["cause"]: row["why"] for row in left_out(description, known)}
    assert "stray_light" not in told
    assert "geometry" not in told
    assert "zero_offset_known = false" in told["zero of the light arm"]


def test_rows_with_a_flag_have_no_parts_and_bands_do_not_mix(tmp_path: Path) -> None:
    run = Maker(tmp_path, describe(), glossy).make(POINTS[:3], (0.25,))
    run.plan.loc[len(run.plan)] = pd.Series(
        [*in_plane(40.0, -40.0), "blocked", "in each other's way"], run.plan.columns
    )
    parts = reduce_in_parts(cast(Run, run)).budget
    assert parts["flag"].tolist() == ["", "", "", "blocked"]
    assert parts.loc[3, list(COMPONENTS)].isna().all()
    assert not parts["coarse"].iloc[3]


def test_a_matte_sample_on_a_calibrated_rig_is_known_to_a_third_of_a_percent(tmp_path: Path) -> None:
    matte = SampleDescription(name="matte", model="oren-nayar", parameters={"albedo": 0.9, "sigma_deg": 20.0})
    points = tuple(Point(75.0, 0.0, float(r), 180.0) for r in (0, 20, 40, 60, 65, 70, 75, 80, 85))
    carry_out(
        Plan("matte", (500.0,), points, 0, "test"),
        rig(name="sim-metrology"),
        tmp_path / "run",
        sample=matte,
        seed=1,
        yes=True,
    )
    found = reduce_in_parts(Run.open(tmp_path / "run"))
    here = found.budget[found.budget["theta_r_deg"] < 76.0]
    # the target, k = 2, stated apart from the certificate
    assert (2.0 * np.sqrt(here["u_brdf"] ** 2 - here["s_reference"] ** 2) / here["brdf"] < 0.003).all()
    # 9 values
    assert np.nanmax(abs(pulls(found.table, matte))) < 4.0


def test_the_command_writes_parts_and_draws_and_takes_old_draws_away(tmp_path: Path) -> None:
    points = tuple(Point(30.0, 0.0, float(r), 180.0) for r in (10, 20, 40, 50))
    matte = SampleDescription(name="matte", model="lambert", parameters={"albedo": 0.5})
    run = tmp_path / "run"
    carry_out(Plan("matte", (500.0,), points, 0, "test"), rig(), run, sample=matte, yes=True)
    first = CliRunner().invoke(build(), ["reduce", str(run), "--monte-carlo", "200", "--seed", "5"])
    assert first.exit_code == 0, first.output
    assert "agrees with 200 draws" in first.output.replace("\n", " ")
    drawn = pd.read_csv(run / "monte_carlo.csv")
    assert drawn["mc_u"].between(0.5 * drawn["u_brdf"], 2.0 * drawn["u_brdf"]).all()
    assert json.loads((run / "brdf.meta.json").read_text())["provenance"]["monte_carlo"]["seed"] == 5
    again = CliRunner().invoke(build(), ["reduce", str(run)])
    assert again.exit_code == 0, again.output
    assert (run / "budget.csv").exists()
    assert not (run / "monte_carlo.csv").exists()
    (run / "budget.csv").write_text("somebody else's")
    assert isinstance(CliRunner().invoke(build(), ["reduce", str(run)]).exception, ConfigError)
    assert (run / "budget.csv").read_text() == "somebody else's"


# ---- draws of the inputs against the linear budget, and against what is known without either ----


CURVE = [in_plane(45.0, float(r)) for r in range(-30, 81, 5)]


def reduced(folder: pytest.TempPathFactory, description: RigDescription) -> tuple[MadeRun, Reduction]:
    rng = np.random.default_rng(1)
    run = Maker(folder.mktemp("run"), description, glossy, rng).make(CURVE, (0.25, 0.25))
    return run, reduce_in_parts(cast(Run, run))


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> tuple[MadeRun, Reduction]:
    """A rig whose zeros and certificate matter most."""
    axis = ArmAxis(limits_deg=(-89.0, 89.0), encoder_step_deg=0.02, zero_u_deg=0.1)
    camera = {"photon_noise": True, "read_noise_e": 4.0}
    return reduced(
        tmp_path_factory,
        describe(arms=Arms(light=axis, camera=axis), reference={"u_rel": 0.003, "frames": 4}, camera=camera),
    )


def test_draws_agree_with_a_linear_budget_where_the_values_are_nearly_linear(
    tilted: tuple[MadeRun, Reduction],
) -> None:
    run, reduction = tilted
    found = monte_carlo.check(cast(Run, run), reduction, 2000, seed=3)
    # of 2000 draws a standard deviation is known to 1.6 %: four of these; and the slopes of a cubic through points 5
    # degrees apart are those of the budget's secants within a few percent
    assert (found.values["mc_u"] / found.values["u_brdf"]).between(0.91, 1.09).all()
    assert (found.values["agrees"] != "no").mean() > 0.8
    assert "agrees with 2000 draws" in found.verdict
    # 4 standard errors of a mean of 2000
    assert (abs(found.values["mc_mean"] - found.values["brdf"]) < 0.1 * found.values["u_brdf"]).all()


def test_draws_do_not_rest_on_the_columns(tilted: tuple[MadeRun, Reduction]) -> None:
    """A budget whose columns of angles and of the certificate are ten times too small is told so."""
    run, reduction = tilted
    table = reduction.table.copy()
    table.attrs = reduction.table.attrs
    for name in ("s_reference", "s_theta_i_zero", "s_theta_r_zero"):
        table[name] *= 0.1
    causes = [name for name in table.columns if name.startswith("s_")]
    table["u_brdf"] = np.sqrt(table["u_random"] ** 2 + (table[causes] ** 2).sum(axis=1))
    found = monte_carlo.check(cast(Run, run), replace(reduction, table=table), 500)
    assert (found.values["agrees"] == "no").sum() > len(CURVE) // 2
    assert "do not agree" in found.verdict


def test_the_certificate_alone_gives_its_normal_distribution(tmp_path_factory: pytest.TempPathFactory) -> None:
    run, reduction = reduced(tmp_path_factory, describe(reference={"u_rel": 0.02, "frames": 4}))
    checked = monte_carlo.check(cast(Run, run), reduction, 4000, seed=1)
    found = checked.values
    with np.load(io.BytesIO(checked.archive())) as kept:
        assert kept["brdf"].shape == (4000, len(found))
        assert np.nanstd(kept["brdf"], axis=0, ddof=1) == pytest.approx(found["mc_u"].to_numpy(), nan_ok=True)
    # 2 % of each value, and rounding to whole DN that is below 0.1 %; 4000 draws know it to 1.1 %: four of these
    np.testing.assert_allclose(found["mc_u"], 0.02 * found["brdf"], rtol=0.05)
    np.testing.assert_allclose(found["mc_high"] - found["mc_low"], 2 * 1.96 * 0.02 * found["brdf"], rtol=0.08)


def test_the_same_seed_gives_the_same_draws_and_causes_of_others_are_drawn_as_columns(
    tilted: tuple[MadeRun, Reduction],
) -> None:
    run, reduction = tilted
    first, again = (monte_carlo.check(cast(Run, run), reduction, 150, seed=7).values for _ in range(2))
    assert first.equals(again)
    table = reduction.table.assign(s_stray_light=0.05 * reduction.table["brdf"])
    table.attrs = reduction.table.attrs
    told: list[tuple[int, int]] = []
    found = monte_carlo.check(
        cast(Run, run), replace(reduction, table=table), 400, progress=lambda done, of: told.append((done, of))
    )
    assert found.as_columns == ["s_stray_light"]
    assert "drawn as linear: s_stray_light" in found.verdict
    assert (found.values["mc_u"] > 0.04 * found.values["brdf"]).all()
    assert told[-1] == (400, 400)


def test_too_few_draws_are_refused(tilted: tuple[MadeRun, Reduction]) -> None:
    with pytest.raises(ValueError, match="at least 100 draws"):
        monte_carlo.check(cast(Run, tilted[0]), tilted[1], 20)
