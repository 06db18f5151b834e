"""The scale that a search moves on: values and back, inside the bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.problem import FitRequest, pose


def test_values_to_the_search_scale_and_back() -> None:
    problem = pose(FitRequest("he-torrance", ior=1.5 + 0j))
    values = {"sigma0_um": 0.2, "tau_um": 1.5, "diffuse_albedo": 0.3}
    vector = problem.vector({**problem.fixed, **values})
    back = problem.values(vector)
    assert {n: back[n] for n in values} == pytest.approx(values, rel=1e-14)  # exp(log x)
    lower, upper = problem.bounds
    assert np.all(lower < vector)
    assert np.all(vector < upper)
    assert vector[problem.free.index("tau_um")] == pytest.approx(math.log(1.5), rel=1e-14)


def test_what_lies_outside_the_bounds_is_brought_inside() -> None:
    problem = pose(FitRequest("lambert"))
    lower, upper = problem.bounds
    assert problem.vector({"albedo": 7.0}) == upper
    assert problem.vector({"albedo": -1.0}) == lower


def test_slopes_are_those_of_the_scale() -> None:
    problem = pose(FitRequest("he-torrance", ior=1.5 + 0j))
    vector = problem.vector({**problem.fixed, "sigma0_um": 0.2, "tau_um": 1.5, "diffuse_albedo": 0.3})
    step = 1e-6
    for k, name in enumerate(problem.free):
        up, down = (problem.values(vector + s * np.eye(vector.size)[k])[name] for s in (step, -step))
        # a central difference: roundings of 1e-16 over 1e-6, and step^2
        assert problem.slope(vector)[k] == pytest.approx((up - down) / (2 * step), rel=1e-8)
