"""Residuals of every metric by hand, their derivatives against differences, and intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.objective import METRICS, Objective
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.fitting.value_covariance import Covariance

MEASURED = np.array([2.0, 0.5, 0.03, -0.01])
COSINE = np.array([1.0, 0.8, 0.5, 0.3])
SMALL = 0.02


def of(metric: str, weights: Covariance | None = None) -> Objective:
    return Objective(MEASURED, weights, SMALL, metric=metric, cosine=COSINE)


def test_residuals_by_hand() -> None:
    f = np.array([2.2, 0.4, 0.06, 0.02])
    for metric, expected in {
        "weighted": f - MEASURED,
        "ngan": COSINE * (f - MEASURED),
        "cube-root": np.cbrt(COSINE * f) - np.cbrt(COSINE * MEASURED),
        "relative": (f - MEASURED) / [2.0, 0.5, 2 * SMALL, 2 * SMALL],
        # above e a logarithm, far below it straight
        "log": np.arcsinh(f / (2 * SMALL)) - np.arcsinh(MEASURED / (2 * SMALL)),
    }.items():
        assert of(metric).residual(f) == pytest.approx(expected), metric
    assert of("log").residual(f)[:2] == pytest.approx(np.log(f[:2] / MEASURED[:2]), abs=3e-3)
    whitened = of("weighted", Covariance(np.full(4, 0.1), np.full((4, 1), 0.2), ("reference",))).residual(f)
    dense = np.diag(np.full(4, 0.01)) + 0.04
    assert whitened @ whitened == pytest.approx((f - MEASURED) @ np.linalg.solve(dense, f - MEASURED))


@pytest.mark.parametrize("metric", METRICS)
@pytest.mark.parametrize("stated", [False, True])
def test_derivatives_are_those_of_the_residuals(metric: str, stated: bool) -> None:
    weights = (
        Covariance(np.array([0.1, 0.2, 0.3, 0.4]), np.array([[0.2], [0.1], [0.0], [0.3]]), ("a",)) if stated else None
    )
    goal, f = of(metric, weights), np.array([2.2, 0.4, 0.06, 0.02])
    columns = np.random.default_rng(1).normal(size=(4, 3))
    step = 1e-6
    for k in range(3):
        up, down = (goal.residual(f + sign * step * columns[:, k]) for sign in (1.0, -1.0))
        # the square of the step over that of the smallest value
        assert goal.jacobian(f, columns)[:, k] == pytest.approx((up - down) / (2 * step), rel=1e-6, abs=1e-8)
    some = goal.take(np.array([2, 0]))
    assert some.measured.tolist() == MEASURED[[2, 0]].tolist()
    assert (some.cosine is None, some.weights is None) == (goal.cosine is None, goal.weights is None)


def test_an_interval_agrees_with_a_standard_error_within_a_factor_of_two_on_sides_that_no_bound_ends() -> None:
    def says(low: float, high: float, open_low: bool = False, open_high: bool = False, u: float | None = 0.1) -> bool:
        return Interval("n", low, high, open_low, open_high, 0.95, np.array([1.0]), np.array([0.0])).linear(1.0, u)

    half = 1.959964 * 0.1
    for factor, good in ((0.49, False), (0.51, True), (1.0, True), (1.98, True), (2.02, False)):
        assert says(1.0 - half, 1.0 + factor * half) == good
        assert says(1.0 - factor * half, 1.0 + half) == good
    assert says(0.999, 1.0 + half, open_low=True), "a bound says nothing against it"
    assert not says(0.999, 1.001, True, True), "two bounds say nothing for it"
    assert not any(says(1.0 - half, 1.0 + half, u=u) for u in (None, 0.0, math.nan, math.inf))
