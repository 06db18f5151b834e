"""Plans of scattered directions on the simulated rig: do values and truth agree within what the tables state?"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import chdtrc

from gonio.lab.acquisition.measure import carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.samples.description import SampleDescription
from tests.gonio.lab.reduction.drawn_runs import chi_square, measured, rig, truth


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 58, 63, 93])
def test_drawn_plans_of_scattered_directions(tmp_path: Path, number: int) -> None:
    """Around mirror directions, few points, over the hemisphere: chi-square over n was 59, 202, 53 and 12."""
    parts, (what, _, _) = measured(tmp_path, 2, number)
    table = parts.table[parts.table["flag"] == ""]
    off = table["brdf"].to_numpy() - truth(table, what)
    # one plan in a thousand is farther off by chance
    assert chdtrc(len(table), chi_square(table, off)) > 1e-3


def test_an_error_of_theta_i_counts_where_every_point_has_its_own_incidence(tmp_path: Path) -> None:
    """Forty directions out of the plane: 0.02 degrees of theta_i are 0.22 % of a value, and its columns held 0.02 %."""
    rng = np.random.default_rng(7)
    theta = np.degrees(np.arcsin(np.sqrt(rng.uniform(0.0, 0.9, (39, 2)))))
    points = [
        Point(round(i, 2), 0.0, round(r, 2), round(p, 1))
        for (i, r), p in zip(theta, rng.uniform(0, 360, 39), strict=True)
    ]
    points.insert(0, Point(33.06, 0.0, 13.25, 236.5))
    what = SampleDescription(
        name="glossy",
        model="cook-torrance",
        parameters={"s": 0.8, "d": 0.2, "slopes": [[0.2, 1.0]], "diffuse_albedo": 0.3, "ior": 1.8},
    )
    plan = Plan("scattered", (500.0,), tuple(points), 0, "test")
    table = brdf.reduce(
        Run.open(carry_out(plan, rig(name="sim-metrology"), tmp_path / "run", sample=what, yes=True).path)
    )
    here = table.iloc[0]
    up, down = (table.iloc[:1].assign(theta_i_deg=here["theta_i_deg"] + by) for by in (0.01, -0.01))
    for one in (up, down):
        one.attrs = table.attrs
    cosine = math.tan(math.radians(here["theta_i_deg"])) * math.radians(0.01) * here["brdf"]
    expected = abs(0.5 * float((truth(up, what) - truth(down, what))[0]) - cosine)
    assert expected > 5e-4 * here["brdf"]
    # forty points on a lobe tell a slope to a fifth, and what is open beside it counts too
    assert abs(here["s_theta_i_zero"]) == pytest.approx(expected, rel=0.3)
    assert "s_spin_zero" in table
    assert not table["s_spin_zero"].to_numpy()[table["flag"] == ""].any()  # an isotropic sample does not notice it


@pytest.mark.slow
def test_the_zero_of_the_spin_counts_on_a_brushed_sample(tmp_path: Path) -> None:
    """Curves at six azimuths, without noise of the camera or the lamp: what errors of the angles do is all there is."""
    chosen = rig(name="sim-metrology")
    quiet = chosen.description.model_copy(
        update={
            "lamp": chosen.description.lamp.model_copy(update={"noise": 0.0, "monitor": False, "drift_per_hour": 0.0}),
            "camera": chosen.description.camera.model_copy(update={"photon_noise": False, "read_noise_e": 0.0}),
        }
    )
    what = SampleDescription(
        name="brushed",
        model="anisotropic",
        parameters={"alpha_along": 0.2, "alpha_across": 0.45, "brushing_deg": 20.0, "s": 0.7, "diffuse_albedo": 0.1},
    )
    points = [
        Point(40.0, float(phi), abs(r), (phi + (180.0 if r >= 0 else 0.0)) % 360.0)
        for phi in range(0, 180, 30)
        for r in np.arange(-75.0, 76.0, 7.5).tolist()
    ]
    plan = Plan("azimuths", (500.0,), tuple(points), 0, "test")
    probabilities, columns = [], []
    for seed in range(3):
        run = carry_out(
            plan,
            replace(chosen, description=quiet),
            tmp_path / str(seed),
            sample=what,
            seed=seed,
            yes=True,
        )
        table = brdf.reduce(run)
        table = table[table["flag"] == ""]
        off = table["brdf"].to_numpy() - truth(table, what)
        probabilities.append(chdtrc(len(table), chi_square(table, off)))
        columns.append(np.max(abs(table["s_spin_zero"] / table["brdf"])))
    assert min(columns) > 1e-4  # 0.01 degrees where ln f changes by more than 0.6 per radian
    # three of three below 1 % by chance: one in a million
    assert max(probabilities) > 0.01
