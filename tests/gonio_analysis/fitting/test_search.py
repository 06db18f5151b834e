"""The scale that a search moves on: values and back, inside the bounds."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.problem import FitRequest, pose

from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure


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


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_search_that_ends_on_a_bound_begins_again_inside(seed: int) -> None:
    """Around one mirror direction a low level with a Fresnel factor of 1 looks like a high one with that of glass."""
    truth = {"k_d": 0.0375, "k_s": 1.8773, "c": 0.2605, "ior": 1.7549}
    views = np.arange(-11.0, 51.0, 1.7)
    table = measure(build("blinn", dict(truth)), noise=0.01, seed=seed, incidences=(19.2,), views=views)
    found, near = fit(table, "blinn"), fit(table, "blinn", start=[truth])
    # a tenth of what one parameter may cost
    assert known(found.chi_square) == pytest.approx(known(near.chi_square), abs=0.1)
    assert not found.parameters["ior"].at_bound
