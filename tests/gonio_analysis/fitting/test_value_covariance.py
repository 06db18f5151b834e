"""Whitening with diag(u^2) + S S^T against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest
from gonio_analysis.fitting.value_covariance import Covariance, independent

from gonio.errors import ArgumentError
from tests.gonio_analysis.synthetic import dense


def some(seed: int, size: int = 30, causes: int = 3, strength: float = 1.0) -> Covariance:
    rng = np.random.default_rng(seed)
    names = tuple(f"cause_{k}" for k in range(causes))
    return Covariance(np.exp(rng.normal(size=size)), strength * rng.normal(size=(size, causes)), names)


@pytest.mark.parametrize("strength", [1e-9, 0.01, 1.0, 1e3])
@pytest.mark.parametrize("causes", [1, 3, 40])  # 40: more causes than values
def test_sum_of_squares_is_the_quadratic_form_of_the_inverse(strength: float, causes: int) -> None:
    c = some(1, causes=causes, strength=strength)
    r = np.random.default_rng(2).normal(size=30)
    white = c.whiten(r)
    # the condition number of C is at most about 1e9 here, and the dense solve loses its digits, not the factored form
    assert white @ white == pytest.approx(r @ np.linalg.solve(dense(c), r), rel=1e-6)
    assert c.chi_square(r) == pytest.approx(white @ white, rel=1e-14)


def test_whitening_is_a_square_root_of_the_inverse() -> None:
    c = some(3)
    w = c.whiten(np.eye(30))
    # C has a condition number near 1e3: 1e-12 is that times the rounding
    np.testing.assert_allclose(w.T @ w, np.linalg.inv(dense(c)), rtol=1e-10, atol=1e-12)


def test_columns_are_whitened_like_vectors() -> None:
    c = some(4)
    m = np.random.default_rng(5).normal(size=(30, 4))
    # rounding of the same sums in another order
    np.testing.assert_allclose(c.whiten(m), np.stack([c.whiten(column) for column in m.T], axis=1), rtol=1e-12)


def test_without_causes_it_is_the_division_by_u() -> None:
    u = np.array([0.5, 2.0, 4.0])
    np.testing.assert_array_equal(independent(u).whiten(np.ones(3)), 1 / u)


def test_whitened_noise_is_white() -> None:
    c = some(6, size=12, causes=2)
    rng = np.random.default_rng(7)
    draws = rng.normal(size=(12, 40_000)) * c.random[:, None] + c.common @ rng.normal(size=(2, 40_000))
    # 4e4 draws: an entry of the sample covariance has a standard deviation of at most sqrt(2/4e4) = 0.007; 5 of them
    np.testing.assert_allclose(np.cov(c.whiten(draws)), np.eye(12), atol=0.035)


def test_a_value_alone_is_compared_with_what_all_others_predict_of_it() -> None:
    """By conditioning a dense normal distribution on the others."""
    c = some(9, size=12, causes=2)
    covariance, r = dense(c), np.random.default_rng(10).normal(size=12)
    for i, z in enumerate(c.alone(r)):
        others = np.delete(np.arange(12), i)
        by = np.linalg.solve(covariance[np.ix_(others, others)], covariance[others, i])
        # the condition number is about 1e3
        assert z == pytest.approx(
            (r[i] - by @ r[others]) / np.sqrt(covariance[i, i] - by @ covariance[others, i]), rel=1e-9
        )
    assert c.log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1])
    assert c.apart(r) == pytest.approx(c.random * np.linalg.solve(covariance, r))


def test_total_scaled_and_take() -> None:
    c = some(8)
    np.testing.assert_allclose(c.total, np.sqrt(np.diag(dense(c))), rtol=1e-14)  # a few roundings
    np.testing.assert_array_equal(c.scaled(np.full(30, 2.0), np.ones(30)).common, 2 * c.common)
    np.testing.assert_array_equal(c.take(np.array([3, 1])).common, c.common[[3, 1]])


@pytest.mark.parametrize(
    ("random", "common", "causes"),
    [
        (np.zeros(2), np.zeros((2, 0)), ()),
        (np.array([1.0, np.nan]), np.zeros((2, 0)), ()),
        (np.ones(2), np.full((2, 1), np.inf), ("a",)),
        (np.ones(2), np.ones((2, 1)), ()),
    ],
)
def test_refuses_what_is_no_covariance(random: np.ndarray, common: np.ndarray, causes: tuple[str, ...]) -> None:
    with pytest.raises(ArgumentError):
        Covariance(random, common, causes)
