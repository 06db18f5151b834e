"""Limits of values by drawing: known distributions, and the example of another laboratory's package."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from gonio_validation.verify import dome
from scipy.optimize import brentq
from scipy.special import gammaln, ndtri
from scipy.stats import norm

from gonio.errors import ArgumentError
from gonio.lab.reduction.monte_carlo import drawn
from gonio.typing import Floats


def normal(x: Floats) -> Floats:
    return np.asarray(10.0 + 0.5 * ndtri(x[:, 0]))


def uniform(x: Floats) -> Floats:
    return x[:, 0]


def test_limits_of_a_normal_number() -> None:
    found = drawn([(normal, 1)], draws=1000)
    assert found.first.size == 1024
    assert found.mean == pytest.approx(10.0, abs=2e-3)
    assert found.u == pytest.approx(0.5, rel=0.01)
    for p in (0.025, 0.5, 0.975):
        # 1024 even numbers: an end lies between two that are 0.1 % of probability apart, 0.017 standard deviations here
        assert found.quantile(p) == pytest.approx(norm.ppf(p, 10.0, 0.5), abs=0.02)
        assert found.probability(norm.ppf(p, 10.0, 0.5)) == pytest.approx(p, abs=2e-3)


def test_every_draw_of_a_factor_goes_with_every_draw_of_the_other() -> None:
    """P(x y <= t) = t - t ln t of two uniform numbers."""
    found = drawn([(uniform, 1), (uniform, 1)], draws=2000)
    assert (found.mean, found.u) == pytest.approx((0.25, math.sqrt(7.0) / 12.0), rel=1e-3)
    for p in (0.025, 0.5, 0.975):
        right = brentq(lambda t, p=p: t - t * math.log(t) - p, 1e-9, 1.0)
        # evenly drawn numbers of 2048 have a discrepancy of about 1/2048
        assert found.quantile(p) == pytest.approx(right, abs=1e-3)


def test_negative_values_and_repeats() -> None:
    found = drawn([(lambda x: ndtri(x[:, 0]), 1), (lambda x: 1.0 + x[:, 0], 1)], draws=500, seed=3)
    assert found.quantile(0.025) == pytest.approx(-found.quantile(0.975), rel=0.03)
    again = drawn([(lambda x: ndtri(x[:, 0]), 1), (lambda x: 1.0 + x[:, 0], 1)], draws=500, seed=3)
    np.testing.assert_array_equal(found.first, again.first)


@pytest.mark.parametrize(
    ("factors", "draws", "words"),
    [
        ([(normal, 1)], 99, "fewer than 100"),
        ([(normal, 0)], 1000, "factor 0: inputs = 0"),
        ([], 1000, "name one"),
        ([(lambda x: x, 2)], 1000, "factor 0: must give 128 numbers"),
        ([(normal, 1), (lambda x: x[:, 0] - 0.5, 1)], 1000, "factor 1: must give 128 positive numbers"),
        ([(lambda x: x[:, 0] * np.nan, 1)], 1000, "factor 0: must give"),
    ],
)
def test_what_cannot_be_drawn_is_one_message(factors: list[object], draws: int, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        drawn(factors, draws=draws)  # type: ignore[arg-type]


# --- the example of `pycoupole` 0.2.2, `computeBRDFDeterministic(**sample)` and `computeBRDFDistribution(**sample)` ---

AS_PRINTED = (0.005067172, 0.124882662)
"""ci95_low, ci95_up of its README by 3 10^7 draws, maxBatches = 10, batchSize = 3_000_000, seed = 1."""


def test_the_value_is_theirs() -> None:
    assert float(dome.value(dome.Exact())[0]) == pytest.approx(0.02135405961783158, rel=1e-14)


class Repeated(dome.DrawnErrors):
    """Numbers as the package takes them: a function is handed a copy of the generator's state.

    So each of them begins with the same numbers. Normal numbers are Box and Muller's, counts those of Hoermann's
    rejection or, below 10, of a product of uniform numbers.
    """

    def __init__(self, x: Floats) -> None:
        super().__init__(x)
        self._at = np.zeros(len(x), int)

    def start(self) -> None:
        """Behind the number that gave the exposure."""
        self._at = np.ones(len(self._x), int)

    def _one(self, of: npt.NDArray[np.intp]) -> Floats:
        found = self._x[of, self._at[of]]
        self._at[of] += 1
        return found

    def uniform(self, count: int) -> Floats:
        every = np.arange(len(self._x))
        return np.stack([self._one(every) for _ in range(count)], axis=1)

    def normal(self, count: int) -> Floats:
        u = self.uniform(2 * count)
        return np.sqrt(-2.0 * np.log(u[:, ::2])) * np.cos(2.0 * np.pi * u[:, 1::2])

    def counts(self, mean: Floats) -> Floats:
        return self._rejected(mean) if mean.min() >= 10.0 else self._multiplied(mean)

    def _multiplied(self, mean: Floats) -> Floats:
        out, product, left = np.zeros(mean.size), np.ones(mean.size), np.arange(mean.size)
        while left.size:
            product[left] *= self._one(left)
            left = left[product[left] > np.exp(-mean[left])]
            out[left] += 1.0
        return out

    def _rejected(self, mean: Floats) -> Floats:
        out, left = np.zeros(mean.size), np.arange(mean.size)
        while left.size:
            many = mean[left]
            b = 0.931 + 2.53 * np.sqrt(many)
            a, scale = 0.02483 * b - 0.059, 1.1239 + 1.1328 / (b - 3.4)
            u, v = self._one(left) - 0.5, self._one(left)
            edge = 0.5 - np.abs(u)
            k = np.floor((2.0 * a / edge + b) * u + many + 0.43)
            with np.errstate(invalid="ignore", divide="ignore"):
                likely = np.log(v * scale / (a / edge**2 + b)) <= k * np.log(many) - many - gammaln(k + 1.0)
            bad = (k < 0.0) | ((edge < 0.013) & (v > edge))
            taken = ((edge >= 0.07) & (v <= 0.9277 - 3.6224 / (b - 2.0))) | (~bad & likely)
            out[left[taken]] = k[taken]
            left = left[~taken]
        return out


@pytest.mark.slow
def test_with_numbers_that_repeat_as_theirs_do_limits_are_as_printed() -> None:
    rng = np.random.default_rng(1)
    values = np.concatenate([dome.value(Repeated(rng.random((250_000, 90)))) for _ in range(4)])
    top = 10.0 * float(np.median(values))
    counts, edges = np.histogram(values, 1000, (0.0, top))
    middle, share = 0.5 * (edges[1:] + edges[:-1]), np.cumsum(counts) / counts.sum()
    # a limit of 65 536 plain draws scatters by 1.3 %, of 10^6 by 0.34 %
    assert np.interp((0.025, 0.975), share, middle) == pytest.approx(AS_PRINTED, rel=0.01)


def test_limits_of_65536_draws_of_numbers_that_do_not_repeat() -> None:
    assert [one.passed for one in dome.look(Path())] == [True] * 4
