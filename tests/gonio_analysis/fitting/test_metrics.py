"""Metrics by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.objective import DESCRIPTIONS, meaning, metrics

from tests.gonio_analysis.synthetic import known

MEASURED = np.array([1.0, 8.0])
MODEL = np.array([2.0, 8.0])
COSINE = np.array([1.0, 0.5])
HAND = 1e-14
"""A few roundings."""


def test_values_by_hand() -> None:
    got = metrics(MODEL, MEASURED, COSINE, np.full(2, 0.1), np.array([3.0, 4.0]))
    assert got["weighted"] == pytest.approx(math.sqrt(12.5), rel=HAND)
    assert got["log_ratio"] == pytest.approx(math.log(2) / math.sqrt(2), rel=HAND)
    assert got["log_cosine"] == pytest.approx((math.log(3) - math.log(2)) / math.sqrt(2), rel=HAND)
    assert got["ngan"] == pytest.approx(1 / math.sqrt(2), rel=HAND)
    assert got["cube_root"] == pytest.approx((2 ** (1 / 3) - 1) / math.sqrt(2), rel=HAND)
    assert (got["n_log"], set(got)) == (2, {*DESCRIPTIONS, "n_log"})


def test_logarithms_leave_out_values_below_3_u() -> None:
    got = metrics(MODEL, MEASURED, COSINE, np.array([0.4, 0.1]))
    assert (got["n_log"], got["log_ratio"]) == (1, 0.0)
    assert known(got["ngan"]) > 0  # the others use every value


def test_negative_values_without_uncertainties() -> None:
    got = metrics(np.array([1.0, 1.0]), np.array([-0.1, 1.0]), np.ones(2))
    assert got["n_log"] == 1
    assert got["weighted"] is None
    assert all(v is None or math.isfinite(v) for v in got.values())


def test_nothing_above_the_noise() -> None:
    got = metrics(np.ones(2), np.ones(2), np.ones(2), np.full(2, 1.0))
    assert got["log_ratio"] is None
    assert got["log_cosine"] is None


def test_a_metric_names_the_limit_that_it_had() -> None:
    for name in ("log_ratio", "log_cosine", "relative"):
        assert "values above 3 u" in meaning(name, known=True)
        assert "values above 0" in meaning(name, known=False)
        assert "3 u" not in meaning(name, known=False)
    assert meaning("ngan", known=True) == meaning("ngan", known=False)
