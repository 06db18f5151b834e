"""The scale that a search moves on: values and back, inside the bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import cast

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting import minimum, search
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose

from gonio.models import Phong, build
from gonio.progress import silent
from gonio.typing import Floats
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


GLOSSY = {"s": 0.923, "m": 0.0619, "diffuse_albedo": 0.487, "ior": 1.624}


def glossy(truth: Mapping[str, complex], seed: int, incidences: tuple[float, ...], step_deg: float) -> pd.DataFrame:
    """A narrow lobe on a bright base with noise of 0.1 %: s, diffuse_albedo and n replace each other along a long,
    bent valley.
    """
    views = np.arange(-75.0, 76.0, step_deg)
    model = build("cook-torrance", dict(truth))
    return measure(model, noise=0.001, floor=0.0, seed=seed, incidences=incidences, views=views)


@pytest.mark.parametrize(
    ("truth", "seed", "incidences", "step_deg"),
    [
        (GLOSSY, 1, (21.6, 33.9, 37.8), 3.0),
        ({"s": 0.897, "m": 0.0588, "diffuse_albedo": 0.699, "ior": 2.515}, 36, (17.0, 30.7, 46.7, 55.5), 7.0),
        ({"s": 0.876, "m": 0.0366, "diffuse_albedo": 0.356, "ior": 1.598}, 93, (13.5, 19.1, 28.2, 35.2), 3.0),
    ],
)
def test_a_search_along_a_long_valley_comes_to_its_end(
    truth: dict[str, float], seed: int, incidences: tuple[float, ...], step_deg: float
) -> None:
    """After 60 evaluations chi-square is 34 to 57 above its least."""
    table = glossy(truth, seed, incidences, step_deg)
    found, near = fit(table, "cook-torrance"), fit(table, "cook-torrance", start=[truth])
    # both end where a step changes the sum by 1e-8 of it
    assert known(found.chi_square) == pytest.approx(known(near.chi_square), rel=1e-6)
    assert not any("has not come to its end" in note for note in found.notes)


@pytest.mark.parametrize(
    ("s", "m", "albedo", "ior", "seed", "incidences", "step_deg"),
    [
        (0.48, 0.195, 0.4, 1.77 + 4.83j, 42, (35.0, 39.0, 46.0, 51.0), 5.0),
        (0.81, 0.314, 0.1, 2.18 + 2.79j, 20, (33.0, 57.0, 66.0), 3.0),
    ],
)
def test_n_and_k_that_are_both_unknown_are_sought_in_every_metal(
    s: float, m: float, albedo: float, ior: complex, seed: int, incidences: tuple[float, ...], step_deg: float
) -> None:
    """Other metals describe these to chi-squares that lie 3 and 10 above the least."""
    truth = {"s": s, "m": m, "diffuse_albedo": albedo, "ior": ior}
    table = glossy(truth, seed, incidences, step_deg)
    start = truth | {"ior": ior.real, "k": ior.imag}
    found, near = (fit(table, "cook-torrance", free=("k",), start=begin) for begin in (None, [start]))
    # both end where a step changes the sum by 1e-8 of it
    assert known(found.chi_square) == pytest.approx(known(near.chi_square), rel=1e-6)


def test_a_search_that_runs_out_of_steps_says_it(monkeypatch: pytest.MonkeyPatch) -> None:
    least = search.least
    monkeypatch.setattr(search, "least", lambda *args, limit, **how: least(*args, limit=min(limit, 20), **how))
    assert any(
        "has not come to its end" in note
        for note in fit(glossy(GLOSSY, 1, (21.6, 33.9, 37.8), 3.0), "cook-torrance").notes
    )


@pytest.mark.parametrize(
    ("sigma0_um", "tau_um", "albedo", "ior"),
    [(0.238, 0.592, 0.396, 2.18 + 6.18j), (0.177, 0.675, 0.601, 2.24 + 0j), (0.128, 0.278, 0.102, 2.59 + 3.67j)],
)
def test_waves_on_a_steep_surface_are_found_beside_a_wrong_valley(
    sigma0_um: float, tau_um: float, albedo: float, ior: complex
) -> None:
    """A rougher or a nearly smooth surface describes these to a chi-square of 240 and more."""
    truth = {"sigma0_um": sigma0_um, "tau_um": tau_um, "diffuse_albedo": albedo}
    table = measure(
        build("he-torrance", truth | {"ior": ior}), incidences=(10.0, 30.0, 50.0, 65.0), views=np.arange(-70.0, 71.0, 7)
    )
    found, near = fit(table, "he-torrance", ior=ior), fit(table, "he-torrance", ior=ior, start=[truth])
    # both end where a step changes the sum by 1e-8 of it
    assert known(found.chi_square) == pytest.approx(known(near.chi_square), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("sigma0_um", "tau_um"), [(0.08, 0.1633), (0.21, 0.4667)])
def test_the_lowest_of_several_valleys_is_found_where_the_data_reject_none(
    sigma0_um: float, tau_um: float, seed: int
) -> None:
    """A nearly smooth surface, or a rougher one, describes most of these to within 5 to 25 of chi-square."""
    truth = {"sigma0_um": sigma0_um, "tau_um": tau_um, "diffuse_albedo": 0.3}
    table = measure(
        build("he-torrance", truth | {"ior": 1.5}), noise=0.01, seed=seed, incidences=(10.0, 30.0, 50.0, 65.0),
        views=np.arange(-70.0, 71.0, 7),
    )  # fmt: skip
    found, near = fit(table, "he-torrance", ior=1.5 + 0j), fit(table, "he-torrance", ior=1.5 + 0j, start=[truth])
    # a lower valley than the truth's is as good; both end where a step changes the sum by 1e-8 of it
    assert known(found.chi_square) <= known(near.chi_square) * (1.0 + 1e-6)


# ---- parts of a search ----


def bounded(*levels: str) -> Problem:
    """Of a slope in [0, 1] and an index in [1, 3]; some of them are levels."""
    problem = SimpleNamespace(
        bounds=(np.array([0.0, 1.0]), np.array([1.0, 3.0])),
        free=("m", "ior"),
        known_slopes=lambda vector: dict.fromkeys(levels),
    )
    return cast(Problem, problem)


@pytest.mark.parametrize(
    ("found", "again"),
    [
        ((0.5, 2.0), []),
        ((0.0, 2.0), [(0.2, 2.0), (0.3, 2.0), (0.4, 2.0)]),  # the starts, and the middle between them
        ((1.0, 2.0), [(0.2, 2.0), (0.3, 2.0), (0.4, 2.0)]),
        ((0.5, 3.0), [(0.5, 1.5), (0.5, 1.75), (0.5, 2.0)]),
        ((0.0, 1.0), [(0.2, 1.0), (0.3, 1.0), (0.4, 1.0), (0.0, 1.5), (0.0, 1.75), (0.0, 2.0)]),
    ],
)
def test_a_search_that_ended_on_a_bound_begins_again_inside(
    found: tuple[float, float], again: list[tuple[float, float]]
) -> None:
    starts = [np.array([0.2, 2.0]), np.array([0.4, 1.5]), np.array([0.2, 1.5])]
    out = search._inside(bounded(), np.array(found), starts)
    np.testing.assert_allclose(np.reshape(out, (-1, 2)), np.reshape(again, (-1, 2)), rtol=1e-15)  # means of two starts


def test_a_level_on_its_bound_stays_there() -> None:
    assert search._inside(bounded("m"), np.array([0.0, 2.0]), [np.array([0.2, 2.0])]) == []


def test_starts_on_a_bound_are_no_places_inside() -> None:
    starts = [np.array([0.0, 2.0]), np.array([1.0, 2.0])]
    np.testing.assert_array_equal(search._inside(bounded(), np.array([0.0, 2.0]), starts), [[0.5, 2.0]])


@pytest.fixture
def lobe() -> tuple[Problem, Observations, Floats, Floats]:
    """A lobe, its values, and a point where it is so narrow that no value is in it: there it has no slope to follow."""
    views = np.arange(-77.5, 80.0, 5.0)  # none towards the mirror
    data = observations(measure(Phong(0.2, 0.3, 100.0), views=views, noise=0.002, cone_sr=1e-4))
    problem = pose(FitRequest("phong"))
    right, wrong = (problem.vector({"k_d": 0.2, "k_s": 0.3, "exponent": n}) for n in (100.0, 1e5))
    return problem, data, right, wrong


Lobe = tuple[Problem, Observations, Floats, Floats]


def test_of_ends_that_cones_put_in_another_order_the_least_is_taken(
    lobe: Lobe, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the cones' centres the wrong one is called better."""
    problem, data, right, wrong = lobe

    def exponent(*ends: tuple[Floats, float]) -> float:
        monkeypatch.setattr(minimum, "search", lambda *_: list(ends))
        return problem.values(minimum.minimised(problem, data, None, silent)[2])["exponent"]

    assert exponent((wrong, 1.0)) > 1000.0
    # values within a lobe are known to 0.2 %, and its exponent to about as much
    assert exponent((wrong, 1.0), (right, 2.0)) == pytest.approx(100.0, rel=0.02)


@pytest.mark.parametrize(("factor", "right_one"), [(1.005, True), (1.02, False)])
def test_of_ends_that_are_alike_last_steps_tell(
    factor: float, right_one: bool, lobe: Lobe, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Here the wrong end comes out of the cones first, and the right one above it by a factor."""
    problem, data, right, wrong = lobe
    monkeypatch.setattr(minimum, "search", lambda *_: [(wrong, 1.0), (right, 2.0)])
    monkeypatch.setattr(minimum, "refine", lambda *at, **_: (at[3], 1e4 * (factor if at[3] is right else 1.0)))
    found = problem.values(minimum.minimised(problem, data, None, silent)[2])
    assert (found["exponent"] < 1000.0) == right_one


def test_from_given_starts_a_fit_ends_no_higher_than_any(lobe: Lobe, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the searches from there ended elsewhere, at the cones' centres."""
    problem, data, right, wrong = lobe
    monkeypatch.setattr(minimum, "search_from", lambda *_: [(wrong, 1.0)])
    found = minimum.minimised(problem, data, [problem.values(right)], silent)[2]
    assert problem.values(found)["exponent"] == pytest.approx(100.0, rel=0.02)  # known to 0.2 %
