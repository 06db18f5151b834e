"""The parts of an uncertainty: they add up, they are what they are named after, and what is missing is told."""

import json
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from gonio.acquisition.measure import carry_out
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.run import Run
from gonio.cli.application import build
from gonio.errors import ConfigError
from gonio.reduction import brdf, budget
from gonio.reduction.brdf import Reduction, reduce_in_parts
from gonio.reduction.values import MeasuredBand, Values
from gonio.rig.description import ArmAxis, Arms, SampleDescription
from gonio.rig.light_and_camera import Lamp
from tests.gonio.reduction.drawn_runs import pulls, rig
from tests.gonio.reduction.made_run import Maker, describe, in_plane
from tests.gonio.reduction.test_brdf import NOISY, POINTS, flicker, glossy


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
    random = (parts[list(budget.COMPONENTS)] ** 2).sum(axis=1)
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
    relative = parts[list(budget.COMPONENTS)].div(parts["brdf"], axis=0)
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
    told = {row["cause"]: row["why"] for row in budget.left_out(description, known)}
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
    assert parts.loc[3, list(budget.COMPONENTS)].isna().all()
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
    apart = np.sqrt(here["u_brdf"] ** 2 - here["s_reference"] ** 2)
    # the target, k = 2, stated apart from the certificate
    assert (2.0 * apart / here["brdf"] < 0.003).all()
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
