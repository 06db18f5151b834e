"""One value from several laboratories, against digits of R's metRology and against drawn comparisons."""

import json
from typing import Any

import numpy as np
import pytest
from gonio_analysis.changes.consensus import (
    METHODS,
    consensus,
    consistency,
    equivalence,
    largest_consistent_subset,
)
from scipy.stats import binom

from gonio.errors import ArgumentError
from tests.places import REFERENCE

ROWS = json.loads((REFERENCE / "consensus_public.json").read_text())["rows"]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["name"])
def test_means_are_those_of_metrology_s_package(row: dict[str, Any]) -> None:
    x, u = row["x"], row["u"]
    weighted = consensus(x, u)
    assert weighted.tau == 0.0
    # the same sums in another order: rounding alone
    assert weighted.value == pytest.approx(row["weighted_mean"], rel=1e-12)
    assert weighted.u == pytest.approx(row["u_weighted_mean"], rel=1e-12)
    assert consistency(x, u) == pytest.approx((row["chi2"], row["p"]), rel=1e-9)
    dsl = consensus(x, u, "dersimonian-laird")
    assert (dsl.value, dsl.u) == pytest.approx((row["dsl"]["value"], row["dsl"]["u"]), rel=1e-12)
    reml = consensus(x, u, "reml")
    # the other program stops up to 2e-4 of u before a maximum that lies at tau = 0, and 5e-4 of u itself elsewhere
    assert abs(reml.value - row["reml.loc"]["value"]) < 3e-4 * reml.u
    assert reml.u == pytest.approx(row["reml.loc"]["u"], rel=6e-4)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["name"])
def test_mandel_paule_solves_its_equation(row: dict[str, Any]) -> None:
    x, u = np.array(row["x"]), np.array(row["u"])
    found = consensus(x, u, "mandel-paule")

    def chi_square(tau2: float) -> float:
        w = 1.0 / (u**2 + tau2)
        return float(np.sum(w * (x - np.sum(w * x) / w.sum()) ** 2))

    if chi_square(0.0) <= x.size - 1:
        assert found.tau == 0.0
    else:
        assert chi_square(found.tau**2) == pytest.approx(x.size - 1, rel=1e-9)
    stated = row["mpaule"]["tau2"]
    # metRology ends at a step of 1.2e-4 of tau^2, and at 0 where Newton's step leaves the positive side: those rows
    # do not solve the equation (docs/decisions/analysis.md)
    if stated > 0.0:
        assert found.tau**2 == pytest.approx(stated, rel=1.3e-4)
        assert found.value == pytest.approx(row["mpaule"]["value"], rel=1e-6)
    elif found.tau > 0.0:
        assert chi_square(0.0) > x.size - 1


def test_a_shared_cause_does_not_average_out() -> None:
    u, common = np.full(4, 0.1), 0.5
    v = np.diag(u**2) + common**2
    found = consensus([1.0, 1.1, 0.9, 1.0], v)
    assert found.value == pytest.approx(1.0)
    assert found.u == pytest.approx(np.hypot(0.1 / 2, common))
    own = consistency([1.0, 1.1, 0.9, 1.0], u)
    assert consistency([1.0, 1.1, 0.9, 1.0], v) == pytest.approx(own)  # differences do not know of it
    assert consensus([1.0, 1.4, 0.6, 1.0], v, "reml").tau == pytest.approx(
        consensus([1.0, 1.4, 0.6, 1.0], u, "reml").tau
    )


def test_who_is_off_is_left_out() -> None:
    x, u = np.array([1.0, 1.01, 1.2, 0.99, 1.0]), np.full(5, 0.01)
    found = equivalence(x, u, 0.01)
    assert found.consistent.tolist() == [True, True, False, True, True]
    assert found.method == "weighted"
    assert found.reference.value == pytest.approx(1.0)
    inside, outside = np.sqrt(1e-4 - 1e-4 / 4), np.sqrt(1e-4 + 1e-4 / 4)
    assert found.u == pytest.approx([inside, inside, outside, inside, inside])
    assert found.e_n[2] == pytest.approx(0.2 / (2 * outside))


def test_a_quarrel_of_all_has_a_dark_uncertainty() -> None:
    found = equivalence([1.0, 2.0, 3.0, 4.0], np.full(4, 0.01), 0.01)
    assert not found.consistent.any()
    assert found.method == "mandel-paule"
    assert found.reference.tau == pytest.approx(np.std([1, 2, 3, 4], ddof=1), rel=1e-3)


def test_many_laboratories_are_judged_one_by_one() -> None:
    x = np.random.default_rng(3).normal(1.0, 0.01, 20)
    x[[4, 11]] += (0.2, -0.15)
    assert np.flatnonzero(~largest_consistent_subset(x, np.diag(np.full(20, 1e-4)), 0.01)).tolist() == [4, 11]


def test_what_is_stated_holds_over_200_drawn_comparisons_with_shared_causes() -> None:
    rng = np.random.default_rng(20261124)
    count, level = 200, 0.01
    inside, degrees, accused = 0, 0, 0
    for _ in range(count):
        k = int(rng.integers(3, 9))
        u = rng.uniform(0.002, 0.02, k)
        white = np.where(rng.random(k) < 0.5, 0.01, 0.0)  # these have the same white
        errors = u * rng.normal(size=k) + white * rng.normal()
        found = equivalence(1.0 + errors, np.diag(u**2) + np.outer(white, white), level)
        inside += abs(found.reference.value - 1.0) < 2 * found.reference.u
        # the true degree of equivalence is 0: laboratories are honest; one a comparison, as they are correlated
        one = int(rng.integers(k))
        degrees += abs(found.degrees[one]) < 2 * found.u[one]
        accused += not found.consistent.all()
    low, high = binom.interval(0.99, count, 0.9545)
    assert low <= inside <= high
    assert low <= degrees <= high
    assert accused <= binom.ppf(0.995, count, level)


@pytest.mark.parametrize(
    ("values", "u", "message"),
    [
        ([1.0, 2.0], [0.1], "shape"), ([1.0, 2.0], [0.1, 0.0], "above 0"), ([1.0, np.nan], [0.1, 0.1], "finite"),
        ([1.0, 2.0], [[1.0, 2.0], [2.0, 1.0]], "positive definite"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(values: Any, u: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        consensus(values, u)


def test_an_unknown_method_is_refused_with_those_that_are() -> None:
    with pytest.raises(ArgumentError, match="reml"):
        consensus([1.0, 2.0], [0.1, 0.1], "median")  # type: ignore[arg-type]


def test_one_value_is_its_own_consensus() -> None:
    for method in METHODS:
        assert consensus([2.0], [0.1], method) == pytest.approx((2.0, 0.1, 0.0))
