"""The information of visits is that of least squares with the whole covariance, and gains are what it grows by."""

from __future__ import annotations

import numpy as np
import pytest
from gonio_analysis.fitting.value_covariance import Covariance
from gonio_sweeps.fisher import Known, gains

RNG = np.random.default_rng(3)
JACOBIAN = RNG.normal(size=(40, 2))
COMMON = RNG.normal(size=(40, 3))
U = RNG.uniform(0.5, 2.0, 40)
WIDE = np.full(2, 1e6)
"""Ranges of the parameters: so wide that they tell nothing."""


def known() -> Known:
    return Known.nothing(WIDE, 3).with_values(np.concatenate([JACOBIAN, COMMON], axis=1), U)


def test_common_causes_count_as_in_a_fit_with_their_covariance() -> None:
    white = Covariance(U, COMMON, ("a", "b", "c")).whiten(JACOBIAN)
    fitted = np.linalg.inv(white.T @ white)
    # 1e-8: the ranges' own information is 1e-12 of the data's, and double precision loses less
    assert known().covariance[:2, :2] == pytest.approx(fitted, rel=1e-8)


@pytest.mark.parametrize("weights", [None, np.array([1.0, 25.0])])
def test_a_gain_is_what_one_more_value_lowers_the_log_uncertainty_by(weights: np.ndarray | None) -> None:
    design = RNG.normal(size=(5, 5))
    u = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
    before = known()
    found = gains(before.covariance, 2, design, u, weights)
    for k in range(5):
        after = before.with_values(design[k : k + 1], u[k : k + 1])

        def size(state: Known) -> float:
            block = state.covariance[:2, :2]
            if weights is None:
                return 0.25 * float(np.linalg.slogdet(block)[1])  # of two parameters, and of u and not of its square
            return 0.5 * float(np.log(np.diag(block) @ weights))

        # 1e-9: both are sums of a few products in double precision
        assert found[k] == pytest.approx(size(before) - size(after), rel=1e-9, abs=1e-9)


def test_repeats_do_not_beat_a_common_scale() -> None:
    """A level that is known to 1 % stays at 1 %, however often it is measured."""
    level = np.ones((1, 1))
    design = np.concatenate([level, 0.01 * level], axis=1)  # search scale: logarithm of the level
    state = Known.nothing(np.array([1e3]), 1).with_values(design, np.array([0.005]), np.array([1e6]))
    assert state.u[0] == pytest.approx(0.01, rel=1e-3)  # the million values leave 0.0005 %
