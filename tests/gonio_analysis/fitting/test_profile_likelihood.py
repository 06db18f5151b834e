"""Profile intervals against what theory says of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.profile_likelihood import profiles, walked

from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure

MATTE = build("lambert", {"albedo": 0.5})
GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.2, "exponent": 20})


def test_of_a_linear_parameter_it_is_the_standard_error() -> None:
    result = fit(measure(MATTE, noise=0.02, reference=0.01), "lambert")
    interval = profiles(result).intervals["albedo"]
    e = result.parameters["albedo"]
    u = known(e.u)
    # the root of the rise is followed to 0.02 of 1.96
    assert (interval.low, interval.high) == pytest.approx((e.value - 1.96 * u, e.value + 1.96 * u), abs=0.03 * u)
    assert not interval.open_low
    assert not interval.open_high


def test_at_the_ends_chi_square_has_risen_by_what_was_asked() -> None:
    table = measure(GLOSS, noise=0.02)
    result = fit(table, "phong")
    interval = profiles(result, ("exponent",)).intervals["exponent"]
    for end in (interval.low, interval.high):
        held = fit(table, "phong", fix={"exponent": end})
        # 3.84 = 1.96^2, followed to (1.96 + 0.02)^2 - 1.96^2 = 0.08
        assert known(held.chi_square) - known(result.chi_square) == pytest.approx(3.841, abs=0.1)


def test_a_bound_ends_an_interval_and_is_said() -> None:
    """sigma = 0 is a bound of Oren-Nayar: near it f changes with sigma squared, and no standard error can tell."""
    interval = profiles(fit(measure(MATTE, noise=0.01, seed=4), "oren-nayar"), ("sigma_deg",)).intervals["sigma_deg"]
    assert interval.open_low
    assert interval.low == 0.0
    assert 0.5 < interval.high < 10.0


@pytest.mark.parametrize("seed", [1, 2])
def test_without_uncertainties_the_scatter_sets_the_scale(seed: int) -> None:
    table = measure(MATTE, noise=0.02, floor=0.0, seed=seed)
    table[["u_brdf", "u_random"]] = np.nan
    interval = profiles(fit(table, "lambert")).intervals["albedo"]
    # 99 values of 2 %: 1.98 (Student, 98 degrees of freedom) times 0.5 x 0.02 / sqrt(99), the scatter known to 7 %
    assert 0.5 * (interval.high - interval.low) == pytest.approx(1.98 * 0.5 * 0.02 / math.sqrt(99), rel=0.25)


@pytest.mark.parametrize("seed", [3, 4, 10])
def test_an_interval_follows_the_bent_valley_of_n_and_k(seed: int) -> None:
    """From a glass with n = 4.8 to a metal with n = 2.9, k = 3: between them chi-square hardly rises, and k_s falls."""
    truth = {"k_d": 0.43, "k_s": 0.1, "c": 0.085, "ior": 2.9, "k": 3.05}
    model = build("blinn", {"k_d": 0.43, "k_s": 0.1, "c": 0.085, "ior": 2.9 + 3.05j})
    table = measure(model, noise=0.005, seed=seed, incidences=(10.0, 30.0, 50.0, 65.0, 75.0))
    result = fit(table, "blinn", free=("k",), start=[truth])
    interval = profiles(result, ("k",)).intervals["k"]
    for k, ior in ((1.0, 4.5), (2.0, 4.0), (3.05, 2.9)):
        held = fit(table, "blinn", fix={"k": k}, start=[{**truth, "ior": ior}])
        assert known(held.chi_square) - known(result.chi_square) < 3.8  # so that 95 % intervals hold it
        assert interval.holds(k)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_interval_is_walked_out_where_a_standard_error_is_no_measure(seed: int) -> None:
    """Of few values k_s and n are hardly told apart: chi-square is flat for long, and then as steep as a wall."""
    truth = {"k_d": 0.1455, "k_s": 1.0006, "c": 0.1628, "ior": 1.4383}
    table = measure(build("blinn", dict(truth)), noise=0.003, seed=seed, incidences=(30.0,))
    table = table[::3].reset_index(drop=True)
    result = fit(table, "blinn")
    for name, interval in profiles(result, ("k_s", "ior")).intervals.items():
        for value in (truth[name], *(truth[name] * np.array([0.7, 0.9, 1.2, 2.0]))):
            if name == "ior" and value < 1.05:
                continue
            # well inside of 3.84: the ends are followed to 0.08, and the fits stand on their own
            if known(fit(table, "blinn", fix={name: float(value)}).chi_square) - known(result.chi_square) < 3.5:
                assert interval.holds(float(value)), (name, value, interval)


def test_a_lower_valley_that_is_met_on_the_way_is_begun_from() -> None:
    """Around one mirror direction a Fresnel factor of 1 with a low k_s is a valley of its own, at the bound of n."""
    truth = {"k_d": 0.0375, "k_s": 1.8773, "c": 0.2605, "ior": 1.7549}
    views = np.arange(-11.0, 51.0, 1.7)
    table = measure(build("blinn", dict(truth)), noise=0.005, seed=1, incidences=(19.2,), views=views)
    stuck = fit(table, "blinn", start=[{"k_d": 0.035, "k_s": 0.146, "c": 0.265, "ior": 199.0}])
    assert stuck.parameters["ior"].at_bound == "upper"
    result, intervals = walked(stuck, lambda start: fit(table, "blinn", start=start))
    assert known(result.chi_square) < known(stuck.chi_square) - 1.0
    assert not result.parameters["ior"].at_bound
    assert all(intervals[name].holds(value) for name, value in truth.items())
    own = stuck.intervals("ior")  # which know the lower valley, too
    assert set(own) == {"ior"}
    # walked out from starts of their own, each end to 0.02 of 1.96; without that valley it is the bound, 200
    assert own["ior"].high == pytest.approx(intervals["ior"].high, rel=0.02)


def test_values_that_a_model_meets_exactly_leave_a_point_and_no_error() -> None:
    table = measure(MATTE, noise=0.0, floor=0.0)
    table[["u_brdf", "u_random"]] = np.nan
    interval = profiles(fit(table, "lambert")).intervals["albedo"]
    # the residuals' arithmetic is good to 1e-12 of a value
    assert (interval.low, interval.high) == pytest.approx((0.5, 0.5), rel=1e-10)


def test_values_beyond_any_mirror_are_left_out() -> None:
    table = measure(MATTE, noise=0.02)
    table.loc[3, "brdf"] = 1.7e308
    assert fit(table, "lambert").data.omitted["beyond 1e+30 1/sr"].size == 1


@pytest.mark.parametrize("noise", [0.01, 0.001])
def test_a_base_that_is_none_narrows_no_interval(noise: float) -> None:
    """Away from a lobe of purely relative noise, a base of 1e-10 in place of 0 is far more than all uncertainties."""
    table = measure(build("cook-torrance", {"s": 0.43, "slopes": 0.17, "ior": 1.9}), noise=noise, floor=0.0)
    free, held = fit(table, "cook-torrance"), fit(table, "cook-torrance", fix={"diffuse_albedo": 0.0})
    assert free.parameters["diffuse_albedo"].value == 0.0
    for name in ("s", "ior"):
        found, wanted = (one.intervals(name)[name] for one in (free, held))
        # each end of either is found within CLOSE = 0.02 of a root of 1.96: 1 % of its half
        assert found.high - found.low == pytest.approx(wanted.high - wanted.low, rel=0.02), name
