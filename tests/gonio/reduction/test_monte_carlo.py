"""Draws of the inputs against the linear budget, and against what is known without either."""

import io
from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from gonio.acquisition.run import Run
from gonio.reduction import monte_carlo
from gonio.reduction.brdf import Reduction, reduce_in_parts
from gonio.rig.description import ArmAxis, Arms, RigDescription
from tests.gonio.reduction.made_run import MadeRun, Maker, describe, in_plane
from tests.gonio.reduction.test_brdf import glossy

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
    ratio = found.values["mc_u"] / found.values["u_brdf"]
    # of 2000 draws a standard deviation is known to 1.6 %: four of these; and the slopes of a cubic through points 5
    # degrees apart are those of the budget's secants within a few percent
    assert ratio.between(0.91, 1.09).all()
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
