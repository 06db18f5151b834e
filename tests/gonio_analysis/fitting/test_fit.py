"""Fits recover known truths with the coverage that they state, and say what the data cannot tell."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gonio_analysis.fitting.fit import fit

from gonio.errors import ConfigError, DataError
from gonio.models import build
from tests.gonio_analysis.synthetic import joined, known, measure

MATTE = build("lambert", {"albedo": 0.5})
PAINT = build("cook-torrance", {"s": 0.1, "d": 0.9, "slopes": ((0.25, 1.0),), "diffuse_albedo": 0.4, "ior": 1.5})
METAL = build("he-torrance", {"sigma0_um": 0.28, "tau_um": 1.77, "ior": 0.77 + 6.08j})
CONE_SR = math.pi / 1024  # the solid angles of the 1991 paper


def pulls(name: str, result: object, true: dict[str, float]) -> list[float]:
    return [(result.parameters[n].value - t) / result.parameters[n].u for n, t in true.items()]  # type: ignore[attr-defined]


def test_errors_of_a_mean_are_those_of_theory() -> None:
    table = measure(MATTE, noise=0.02, floor=0.0)
    # a weighted mean of n values of equal weight: u / sqrt(n), here of pi f
    assert fit(table, "lambert").parameters["albedo"].u == pytest.approx(0.5 * 0.02 / math.sqrt(len(table)), rel=1e-6)


def test_pulls_with_a_common_cause_have_unit_width() -> None:
    z = []
    chi = []
    for seed in range(60):
        r = fit(measure(MATTE, seed=seed, noise=0.02, reference=0.01), "lambert")
        z += pulls("lambert", r, {"albedo": 0.5})
        chi.append(r.reduced_chi_square)
    # 60 pulls: their standard deviation is known to 1/sqrt(120) = 0.09, their mean to 0.13; 3.3 of these
    assert np.std(z) == pytest.approx(1.0, abs=0.3)
    assert abs(np.mean(z)) < 0.43
    # 60 x 98 degrees of freedom: 1 +- sqrt(2/5880) = 0.018
    assert np.mean([known(c) for c in chi]) == pytest.approx(1.0, abs=0.06)


def test_common_cause_limits_the_error_of_the_scale() -> None:
    e = fit(measure(MATTE, noise=0.001, reference=0.01), "lambert").parameters["albedo"]
    assert e.u == pytest.approx(0.01 * e.value, rel=0.01)  # 1 % of the value: the noise of 99 values adds nothing


def test_common_cause_of_noisy_values_does_not_pull_the_fit_low() -> None:
    """Peelle's puzzle: with columns s = u f of noisy values f the estimate falls by u^2 n noise^2 / noise^2."""
    table = measure(MATTE, views=np.linspace(-80, 80, 700), noise=0.1, reference=0.05, seed=3)
    common = table["s_reference"].mean() / (0.05 / math.pi)  # the scale that this table has, seen through its mean
    # naive columns would give a value lower by a factor 1 + 0.05^2 x 2100 x 1.01 = 6; the mean itself is known to
    # 0.1 / sqrt(2100) = 0.2 %
    assert fit(table, "lambert").parameters["albedo"].value == pytest.approx(common, rel=0.02)


def test_cook_torrance_is_recovered_with_coverage() -> None:
    true = {"s": 0.1, "m": 0.25, "diffuse_albedo": 0.4, "ior": 1.5}
    z = []
    for seed in range(12):
        r = fit(measure(PAINT, seed=seed, noise=0.005, reference=0.003), "cook-torrance")
        z += pulls("cook-torrance", r, true)
        assert r.reduced_chi_square == pytest.approx(1.0, abs=0.5)  # 95 degrees of freedom: +- 0.145; 3.4 of them
    assert np.mean(np.abs(z) < 2) > 0.8  # 48 correlated pulls, 95 % expected
    assert np.max(np.abs(z)) < 4.5


def test_he_torrance_through_the_cones() -> None:
    true = {"sigma0_um": 0.28, "tau_um": 1.77}
    table = measure(METAL, incidences=(10, 45, 75), noise=0.004, reference=0.002, cone_sr=CONE_SR, wavelength_nm=500)
    r = fit(table, "he-torrance", ior=0.77 + 6.08j)
    assert all(abs(z) < 3.5 for z in pulls("he-torrance", r, true))
    assert all(known(r.parameters[n].u) < 0.02 * t for n, t in true.items())
    assert r.reduced_chi_square == pytest.approx(1.0, abs=0.5)  # 96 degrees of freedom: +- 0.144
    assert r.derived["slope_m"].value == pytest.approx(2 * 0.28 / 1.77, rel=0.01)
    assert (
        known(r.derived["slope_m"].u) < known(r.parameters["sigma0_um"].u) * 2 / 1.77
    )  # the ratio is known better than either
    assert r.parameters["k"].fixed
    assert r.parameters["k"].value == 6.08


def test_without_uncertainties_there_is_no_chi_square() -> None:
    table = measure(PAINT, noise=0.01)
    table[["u_brdf", "u_random"]] = np.nan
    r = fit(table, "cook-torrance")
    assert r.chi_square is None
    assert r.reduced_chi_square is None
    assert r.verdict.startswith("no verdict")
    assert r.weighting.startswith("logarithmic")
    assert any("no uncertainties" in note for note in r.notes)
    low, high = known(r.misfit).interval
    assert low < 0.01 < high  # the noise that was drawn is all that there is
    assert r.parameters["m"].value == pytest.approx(0.25, rel=0.04)  # five standard errors
    assert 0 < known(r.parameters["m"].u) < 0.05


def test_fixed_parameters_stay() -> None:
    r = fit(measure(METAL, wavelength_nm=500), "he-torrance", ior=0.77 + 6.08j, fix={"tau_um": 1.77})
    assert r.free == ("sigma0_um", "diffuse_albedo")
    assert r.parameters["tau_um"].fixed
    assert r.parameters["tau_um"].value == 1.77
    assert r.parameters["sigma0_um"].value == pytest.approx(0.28, rel=0.002)  # five standard errors


def test_freed_optical_constants_move_from_where_they_were_given() -> None:
    r = fit(measure(METAL, noise=0.003, wavelength_nm=500), "he-torrance", ior=0.9 + 5.5j, free=["k"])
    assert "k" in r.free
    assert "ior" not in r.free
    assert r.parameters["ior"].value == 0.9


def test_words_reach_the_constructor() -> None:
    table = measure(METAL, wavelength_nm=500)
    r = fit(table, "he-torrance", ior=0.77 + 6.08j, fix={"shadowing": "paper"})
    assert r.model.parameters["shadowing"] == "paper"
    with pytest.raises(ConfigError, match="shadowng"):
        fit(table, "he-torrance", ior=0.77 + 6.08j, fix={"shadowng": "paper"})


def test_two_slopes() -> None:
    copper = build("cook-torrance", {"s": 0.6, "d": 0.4, "slopes": ((0.15, 0.6), (0.45, 0.4)), "ior": 1.6})
    r = fit(measure(copper, noise=0.002), "cook-torrance", slopes=2, ior=1.6)
    assert set(r.free) == {"s", "m_1", "m_2", "w_1", "diffuse_albedo"}
    found = sorted(
        [(r.parameters["m_1"].value, r.parameters["w_1"].value), (r.parameters["m_2"].value, r.derived["w_2"].value)]
    )
    # five standard errors
    np.testing.assert_allclose(found, [(0.15, 0.6), (0.45, 0.4)], rtol=0.006)
    assert known(r.reduced_chi_square) < 1.6


def test_no_optical_constants_is_said() -> None:
    r = fit(measure(METAL, wavelength_nm=500), "he-torrance")
    assert any("k = 0" in note for note in r.notes)
    assert "ior" in r.free


def test_broad_band_needs_a_wavelength_where_the_model_does() -> None:
    table = measure(MATTE, wavelength_nm=float("nan"))
    assert math.isnan(fit(table, "lambert").wavelength_nm)
    with pytest.raises(ConfigError, match="--wavelength-nm"):
        fit(table, "he-torrance", ior=1.5 + 0j)
    r = fit(table, "he-torrance", ior=1.5 + 0j, wavelength_nm=4000)
    assert r.wavelength_nm == 4000
    assert any("evaluated at 4000 nm" in note for note in r.notes)


def test_nearest_wavelength_is_fitted_and_said() -> None:
    parts = [measure(build("lambert", {"albedo": a}), wavelength_nm=w) for a, w in ((0.2, 450), (0.5, 560), (0.8, 650))]
    table = joined(*parts)
    assert fit(table, "lambert").wavelength_nm == 560
    r = fit(table, "lambert", wavelength_nm=630)
    assert r.wavelength_nm == 650
    assert r.parameters["albedo"].value == pytest.approx(0.8, rel=0.005)  # five standard errors
    assert any("650 nm" in note for note in r.notes)


def test_very_rough_metal_tells_only_the_slope_and_says_so() -> None:
    rough = build("he-torrance", {"sigma0_um": 8.0, "tau_um": 40.0, "ior": 0.77 + 6.08j})
    r = fit(measure(rough, noise=0.01), "he-torrance", ior=0.77 + 6.08j)
    assert r.derived["slope_m"].value == pytest.approx(0.4, rel=0.002)  # five standard errors
    notes = " ".join(r.notes)
    assert "sigma0_um and tau_um can hardly be told apart" in notes
    assert "what they determine is sigma0_um/tau_um = 0.2" in notes


def test_json_has_the_agreed_keys_and_is_json() -> None:
    out: Any = fit(measure(PAINT), "cook-torrance").to_json()
    assert set(out) >= {"model", "parameters", "correlation", "reduced_chi_square", "n_points", "wall_s"}
    assert set(out["parameters"]) == {"s", "m", "diffuse_albedo", "ior", "k"}
    assert set(out["parameters"]["m"]) >= {"value", "u", "fixed"}
    assert out["correlation"]["m"]["m"] == pytest.approx(1.0, rel=1e-14)  # u / u
    json.dumps(out, allow_nan=False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"model": "lambret"}, 'did you mean "lambert"'),
        ({"model": "lambert", "fix": {"albdo": 0.5}}, 'did you mean "albedo"'),
        ({"model": "lambert", "fix": {"albedo": 1.5}}, "between 1e-06 and 1"),
        ({"model": "lambert", "fix": {"albedo": 0.5}}, "nothing to fit"),
        ({"model": "cook-torrance", "slopes": 3}, "1 or 2"),
        ({"model": "lambert", "slopes": 2}, "only cook-torrance"),
        ({"model": "he-torrance", "ior": "Al", "free": ["k"]}, "material"),
        ({"model": "cook-torrance", "fix": {"m": 0.2}, "free": ["m"]}, "--fix and to --free"),
        ({"model": "lambert", "bounds": {"albedo": (0.9, 0.1)}}, "ascend"),
        ({"model": "phong", "fix": {"k_d": 0.2}, "bounds": {"k_d": (0.1, 0.3)}}, "not fitted"),
        ({"model": "lambert", "priors": {"albedo": (0.5, 0.0)}}, "standard uncertainty above 0"),
        ({"model": "lambert", "priors": {"k_d": (0.5, 0.1)}}, "it fits albedo"),
        ({"model": "lambert", "loss": "hubert"}, "known: linear"),
        ({"model": "lambert", "searches": 0}, "at least one search"),
    ],
)
def test_wrong_options_are_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        fit(measure(MATTE), **arguments)  # type: ignore[arg-type]


def test_too_few_values() -> None:
    with pytest.raises(DataError, match="cannot determine"):
        fit(measure(MATTE).head(3), "cook-torrance")


def test_a_prior_counts_like_one_more_measurement() -> None:
    table = measure(MATTE, noise=0.02, floor=0.0)
    free = fit(table, "lambert").parameters["albedo"]
    u = known(free.u)
    held = fit(table, "lambert", priors={"albedo": (free.value + 2 * u, u)}).parameters["albedo"]
    # two values of equal weight: their mean, with the error of a mean; linear but for the bound far away
    assert (held.value, held.u) == pytest.approx((free.value + u, u / math.sqrt(2)), rel=1e-6)


def test_bounds_hold_and_are_said() -> None:
    r = fit(measure(PAINT), "cook-torrance", bounds={"m": (0.05, 0.2)})
    assert r.parameters["m"].value == pytest.approx(0.2, rel=1e-9)  # the search keeps 1e-10 of a range off a bound
    assert r.parameters["m"].at_bound == "upper"


@pytest.mark.parametrize("loss", ["soft_l1", "huber", "cauchy", "arctan"])
def test_outliers_pull_a_robust_fit_less(loss: str) -> None:
    table = measure(MATTE, noise=0.01, floor=0.0)
    table.loc[::10, "brdf"] *= 1.3  # a tenth of the values lies 30 standard deviations too high
    pulled, robust = fit(table, "lambert"), fit(table, "lambert", loss=loss)
    # a tenth of ln 1.3: the model is rejected, and its misfit counts factors
    assert pulled.parameters["albedo"].value == pytest.approx(0.5 * 1.3**0.1, rel=0.004)
    # huber and soft_l1 let an outlier pull like 1 standard deviation: 10 of them move the mean by some 0.1 %
    assert robust.parameters["albedo"].value == pytest.approx(0.5, rel=0.004)
    assert loss in robust.weighting


@pytest.mark.parametrize(("loss", "wider"), [("huber", 1.0523), ("soft_l1", 1.0388), ("cauchy", 1.1459),
                                              ("arctan", 1.4336)])  # fmt: skip
def test_errors_of_a_robust_fit_are_those_of_an_m_estimate(loss: str, wider: float) -> None:
    """Of normal residuals: sqrt(E psi^2)/E psi', by quadrature over the normal distribution."""
    table = measure(MATTE, views=np.linspace(-80, 80, 2000), noise=0.02, floor=0.0)
    plain, robust = (known(fit(table, "lambert", loss=one).parameters["albedo"].u) for one in ("linear", loss))
    # 6000 values: means of psi^2 and psi' are known to 1 and 2 % for arctan, the worst; three standard deviations
    assert robust / plain == pytest.approx(wider, rel=0.06 if loss == "arctan" else 0.03)


def test_a_robust_fit_that_is_at_its_end_does_not_say_otherwise() -> None:
    for seed in range(6):
        table = measure(PAINT, seed=seed, noise=0.02)
        table.loc[seed::12, "brdf"] *= 1.2  # a twelfth of the values lies ten standard deviations too high
        assert not [note for note in fit(table, "cook-torrance", loss="huber").notes if "come to its end" in note]


def test_what_is_not_determined_spreads_evenly_between_its_bounds() -> None:
    """As a parameter that stands at a bound, it has the variance of an even distribution, (upper - lower)^2/12."""
    found = fit(measure(PAINT, incidences=(10.0,), views=np.arange(40.0, 71.0, 5)), "cook-torrance", ior=1.5 + 0j)
    spread = np.diag([np.inf, 4.0e4, 1.0e-6])
    bounded = replace(found, spread=spread).bounded_spread
    lower, upper = found.problem.bounds
    assert found.free == ("s", "m", "diffuse_albedo")
    assert np.diag(bounded) == pytest.approx([*((upper - lower)[:2] ** 2 / 12.0), 1.0e-6], rel=1e-12)
    related = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 1.0e-6]])
    assert np.array_equal(replace(found, spread=related).bounded_spread, related)


def test_the_brushing_lies_along_the_smaller_width() -> None:
    """Both widths exchanged and the brushing turned by 90 degrees are the same model: 7 of these 12 were stated so."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        along, turn = rng.uniform(0.08, 0.2), rng.uniform(-80.0, 80.0)
        true = {"alpha_along": along, "alpha_across": 2.0 * along, "brushing_deg": turn}
        parts = []
        for azimuth in (0.0, 45.0, 90.0):
            seen = {**true, "brushing_deg": turn - azimuth, "ior": 1.5, "s": 0.6, "diffuse_albedo": 0.4}
            part = measure(build("anisotropic", seen), incidences=(20.0, 50.0), noise=0.003, seed=seed + int(azimuth))
            for name in ("phi_i_deg", "phi_r_deg"):
                part[name] = (part[name] + azimuth) % 360.0
            parts.append(part)
        found = fit(joined(*parts), "anisotropic", ior=1.5)
        for name, value in true.items():
            estimate = found.parameters[name]
            assert abs(estimate.value - value) < 4.5 * known(estimate.u), (seed, name)  # one of 36: 2e-4 by chance
    # what the user fixes stays
    other = fit(joined(*parts), "anisotropic", ior=1.5, fix={"brushing_deg": turn + 90.0 if turn < 0 else turn - 90.0})
    assert other.parameters["alpha_along"].value > other.parameters["alpha_across"].value


@pytest.mark.parametrize("of_true", [False, True])
def test_a_reference_stated_of_measured_or_of_true_values_pulls_nothing(of_true: bool) -> None:
    """Scaled as if it held noise, a column of true values pulled k_d by n u^2: 99 values and 2 %, 1.8 u."""
    sample, pulls = build("phong", {"k_d": 0.3, "k_s": 0.3, "exponent": 30.0}), []
    true = measure(sample, noise=0.0, floor=1e-12)["brdf"]
    for seed in range(30):
        frame = measure(sample, noise=0.01, floor=1e-12, reference=0.02, seed=seed)
        if of_true:
            frame["s_reference"] = 0.02 * true
        found = fit(frame, "phong").parameters["k_d"]
        pulls.append((found.value - 0.3) / known(found.u))
    assert abs(np.mean(pulls)) < 3.0 / math.sqrt(30)  # three standard errors of the mean
