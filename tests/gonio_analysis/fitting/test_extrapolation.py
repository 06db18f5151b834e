"""What a wrong model says where nothing was measured, and where its parameters replace each other.

The kind of fault: a number with an uncertainty that holds inside the measured directions alone, or with none that
means anything. Each sample is one that no fitted model has, and its truth is this file's own integral.
"""

import json
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.appearance.of_models import _mean, of_fit
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.report.verdict import reflectances
from gonio_analysis.result_records import Quantity, Reflectance, as_json
from gonio_analysis.selection.compare import examine

from gonio.geometry import Directions
from gonio.typing import Floats

from ..synthetic import known, measure
from .test_misfit import PAINT, facets

Sample = Callable[[Directions], Floats]
NOISE, SCALE = 0.003, 0.002


def two_scales(d: Directions, narrow: float = 0.2, wide: float = 0.42, f0: float = 0.04, rho: float = 0.165) -> Floats:
    """Facets of two widths over a diffuse base [1/sr]."""
    return 0.6 * facets(narrow, f0, 0.0, d) + 0.4 * facets(wide, f0, 0.0, d) + rho / math.pi


def smooth_scatter(d: Directions) -> Floats:
    """An ABC model, of the distance from the mirror direction in direction cosines, over a diffuse base [1/sr]."""
    omega_i, omega_r = d.vectors
    square = np.sum((omega_i + omega_r)[..., :2] ** 2, axis=-1)
    return np.asarray(0.6 / (1.0 + 14.0 * square) ** 1.2 + 0.25 / math.pi)


def table(of: Sample, d: Directions, seed: int, noise: float = NOISE) -> pd.DataFrame:
    """Its measurement, with independent noise and a common scale."""
    rng, true = np.random.default_rng(seed), of(d)
    brdf = true * (1 + SCALE * rng.normal()) * (1 + noise * rng.normal(size=true.size))
    angles = {f"{name}_deg": np.degrees(getattr(d, name)) for name in ("theta_i", "phi_i", "theta_r", "phi_r")}
    found = pd.DataFrame(angles).assign(
        wavelength_nm=550.0, polarisation="unpolarised", brdf=brdf, u_brdf=math.hypot(noise, SCALE) * brdf,
        u_random=noise * brdf, s_reference=SCALE * brdf, flag="",
    )  # fmt: skip
    found.attrs.update(source_solid_angle_sr=0.0, receiver_solid_angle_sr=0.0)
    return found


def scattered(seed: int, count: int = 45) -> Directions:
    rng = np.random.default_rng(1000 + seed)
    return Directions.from_degrees(
        rng.uniform(5, 70, count), np.zeros(count), rng.uniform(5, 72, count), rng.uniform(0, 180, count)
    )


def few() -> Directions:
    """Twelve values at two incidences, in the plane."""
    theta_i, signed = np.array([(t, s) for t in (18.0, 47.0) for s in (-60.0, -30.0, t - 15, t, t + 13, 74.0)]).T
    return Directions.from_degrees(theta_i, 0 * theta_i, np.abs(signed), np.where(signed > 0, 180.0, 0.0))


def few_values() -> pd.DataFrame:
    """Of a smooth scatterer, known to 1e-5 except in the mirror directions."""
    values = table(smooth_scatter, few(), 4, noise=1e-5)
    values.loc[[3, 9], "u_random"] = 0.05 * values.loc[[3, 9], "brdf"]
    return values.assign(u_brdf=np.hypot(values["u_random"], values["s_reference"]))


def beside_the_lobe() -> Directions:
    """Eight values on the retro side: a lobe is hardly seen."""
    theta_i, theta_r = (a.ravel() for a in np.meshgrid([20.0, 50.0], [30.0, 45.0, 60.0, 70.0], indexing="ij"))
    return Directions.from_degrees(theta_i, 0 * theta_i, theta_r, 0 * theta_i)


def shiny(d: Directions) -> Floats:
    return two_scales(d, 0.12, 0.3, 0.3, 0.1)


def true_rho(of: Sample, theta_deg: float) -> float:
    """Its directional-hemispherical reflectance, by midpoints of cells of equal cos(theta) d(omega)."""
    even = (np.arange(300) + 0.5) / 300
    theta_r, phi_r = (a.ravel() for a in np.meshgrid(np.arcsin(np.sqrt(even)), math.pi * even, indexing="ij"))
    return math.pi * float(of(Directions(math.radians(theta_deg), 0.0 * theta_r, theta_r, phi_r)).mean())


@pytest.fixture(scope="module")
def narrow_few() -> FitResult:
    """Blinn's k_s and index replace each other: the values tell their product alone."""
    values = few_values()
    return fit(values, "blinn")


@pytest.mark.parametrize(("of", "seed"), [(two_scales, 4), (two_scales, 5), (smooth_scatter, 6)])
def test_rho_dh_holds_where_a_plan_leaves_the_hemisphere_open(of: Sample, seed: int) -> None:
    result = fit(table(of, scattered(seed), seed), "blinn")
    assert result.rejected
    found = energy.of_model(result)
    off = [(r.rho_dh - true_rho(of, r.theta_i_deg)) / known(r.u) for r in found if r.rho_dh is not None]
    # all incidences of one table lean on the same directions: 2.58, which 1 % of samples exceed
    assert max(map(abs, off)) < 2.58
    assert sum(r.rho_dh is not None and known(r.u) < 0.1 * r.rho_dh for r in found) >= len(found) / 2, "nor is it empty"


def test_predictions_of_a_plan_of_few_points_hold(narrow_few: FitResult) -> None:
    pulls = []
    for result, of in ((narrow_few, smooth_scatter), (fit(table(two_scales, few(), 2), "blinn"), two_scales)):
        at = scattered(9, 200)
        brdf, u = result.predict(at)
        pulls += list((brdf - of(at)) / u)
    assert np.mean(np.abs(pulls) < 1.96) >= 0.92  # 95 % of many; those of one table are alike
    assert np.max(np.abs(pulls)) < 5.0


def test_predictions_of_a_grazing_detector_hold_though_half_vectors_near_by_were_measured() -> None:
    """Facets hide each other there. A distance in half vectors alone held 27 to 91 % of a sample, 60 % of all."""
    rng, n, pulls = np.random.default_rng(3), 200, list[float]()
    at = Directions.from_degrees(
        rng.uniform(5, 40, n), np.zeros(n), rng.uniform(76, 84, n), rng.uniform(0, 180, n)
    )  # half vectors of 18 to 76 degrees
    for of in (two_scales, smooth_scatter, shiny):
        for seed in (4, 5):
            brdf, u = fit(table(of, scattered(seed), seed), "blinn").predict(at)
            pulls += list((brdf - of(at)) / u)
    assert np.mean(np.abs(pulls) < 1.96) >= 0.92  # 95 % of many; those of one sample are alike
    assert np.max(np.abs(pulls)) < 5.0


def test_a_misfit_grows_away_from_the_values_and_not_at_them() -> None:
    correction = known(fit(table(two_scales, scattered(4), 4), "blinn").misfit).correction
    at = correction.directions
    assert np.max(correction._distance(at)[1]) < 1e-6  # at a value it is as far off as that value is
    steep = np.array([60.0, 70.0, 80.0])
    grazing = Directions.from_degrees(steep, np.zeros(3), steep, np.full(3, 180.0))
    grown = correction._distance(grazing)[1]
    tau = correction.process.data.prior.level * 2
    assert np.all(np.diff(grown) > 0)
    assert grown[0] > 10 * tau


def test_a_value_that_says_nothing_is_near_no_direction() -> None:
    result = fit(table(two_scales, scattered(4), 4), "blinn")
    correction = known(result.misfit).correction
    process = correction.process
    far = Directions.from_degrees(80.0, 0.0, np.array([80.0]), 180.0)
    at = Directions.stack([*(correction.directions[k] for k in range(45)), far[0]])
    data = replace(
        process.data, at=type(process.data.at).of(at), z=np.append(process.data.z, 0.0),
        u=np.append(process.data.u, 1e3), causes=np.vstack([process.data.causes, process.data.causes[:1] * 0]),
    )  # fmt: skip
    more = replace(correction, directions=at, process=replace(process, data=data))
    assert more._distance(far)[1] == pytest.approx(correction._distance(far)[1], rel=1e-12)  # the same sum


def test_points_around_a_solution_lie_inside_the_bounds_and_near_the_values(narrow_few: FitResult) -> None:
    lower, upper = narrow_few.problem.bounds
    around = narrow_few.around
    assert np.all((lower <= around) & (around <= upper))
    assert np.max(np.abs(around - narrow_few.vector)) > 0.1, "it is hardly known"
    for point in around:
        ratio = narrow_few.problem.model(point).brdf(*narrow_few.data.directions.angles) / narrow_few.predicted
        # the sum of squares rises by the number of values at most: one value by sqrt(12) tau
        assert np.max(np.abs(np.log(ratio))) < math.sqrt(12) * known(narrow_few.tau).value * 2


def test_parameters_that_replace_each_other_leave_a_number(narrow_few: FitResult) -> None:
    for r in energy.of_model(narrow_few):
        assert r.rho_dh is not None
        assert known(r.u) < 0.3 * r.rho_dh
        assert abs(r.rho_dh - true_rho(smooth_scatter, r.theta_i_deg)) < 2.58 * known(r.u)


def test_a_true_model_keeps_its_uncertainty() -> None:
    result = fit(measure(PAINT, noise=0.005, seed=3), "cook-torrance")
    assert not result.rejected
    assert "around" not in vars(result)
    assert all(r.rho_dh is not None and 0 < known(r.u) < 0.02 * r.rho_dh for r in energy.of_model(result))
    assert "around" not in vars(result), "slopes are enough"


def test_what_the_directions_do_not_determine_has_no_number() -> None:
    found = energy.of_model(fit(table(shiny, beside_the_lobe(), 1), "blinn"))
    assert [(r.rho_dh, r.u, r.why) for r in found] == [(None, None, "not determined by these directions")] * 3
    said = reflectances("blinn", found)  # the fitted model is too bright, and that is said too
    assert said.startswith("rho_dh of blinn at θi = 8°, 20°, 50°: not determined by these directions.")
    assert "By blinn alone" not in said
    assert [(r["rho_dh"], r["u"], r["why"]) for r in json.loads(json.dumps(as_json(found)))] == [
        (None, None, energy.UNDETERMINED)
    ] * 3


@pytest.mark.slow
def test_appearance_has_no_number_that_the_directions_do_not_determine() -> None:
    found = of_fit(fit(table(shiny, beside_the_lobe(), 1), "blinn"), name="shiny")
    for one in (found.gloss_60_gu, found.rho_dh_8):
        assert (one.value, one.u, one.why) == (None, None, energy.UNDETERMINED)
    assert found.radiance_factor_45_0.value is not None, "no lobe is near"


def test_a_model_that_does_not_determine_a_number_has_no_weight_in_it() -> None:
    sure = Reflectance(8.0, 0.3, 0.01, "", with_misfit=0.31, u_with_misfit=0.02)
    open_ = Reflectance(8.0, None, None, energy.UNDETERMINED)
    (found,) = energy.combined([(0.5, [sure]), (1.0, [open_])])
    assert found.rho_dh == pytest.approx(0.31, rel=1e-12)
    assert found.u == pytest.approx(0.02, rel=1e-12)
    (none,) = energy.combined([(1.0, [open_]), (0.2, [open_])])
    assert (none.rho_dh, none.u, none.why) == (None, None, energy.UNDETERMINED)


def test_appearance_over_models_is_that_of_those_that_determine_it() -> None:
    sure, open_ = Quantity(0.3, 0.01, None, "1"), Quantity(None, None, None, "1", why=energy.UNDETERMINED)
    mean = _mean(np.array([0.3, 0.7]), [sure, open_])
    assert (mean.value, mean.u) == (pytest.approx(0.3, rel=1e-12), pytest.approx(0.01, rel=1e-12))
    assert _mean(np.array([0.3, 0.7]), [open_, open_]).why == energy.UNDETERMINED


def test_the_combined_value_of_few_points_is_a_sane_one() -> None:
    values = few_values()
    found = examine(values, ("phong", "blinn"), name="few").rho_dh_combined
    assert found
    for r in found:
        assert r.rho_dh is not None
        assert abs(r.rho_dh - true_rho(smooth_scatter, r.theta_i_deg)) < 2.58 * known(r.u) < 0.3
