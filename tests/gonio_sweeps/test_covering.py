"""Coverings where no model is trusted: even ones, and those by the errors of the curves; gaps that are divided."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from gonio_sweeps.candidates import (
    CandidateCurves,
    cover_by_errors,
    cover_evenly,
    fill,
    from_mirror_deg,
    places,
    signed_deg,
    spread,
)

from gonio.geometry import Directions
from gonio.lab.acquisition.plan import Point, canonical

POINTS = [canonical(30.0, 0.0, float(x), 180.0) for x in range(-80, 81)]
ALL = list(range(len(POINTS)))
NOISE = 0.005


def at(points: list[Point]) -> np.ndarray:
    if not points:
        return np.zeros((0, 3))
    rows = [(p.theta_i_deg, p.phi_i_deg, p.theta_r_deg, p.phi_r_deg) for p in points]
    return places(Directions.from_degrees(*zip(*rows, strict=True)))


def known(f: Callable[[float], float], visited: list[int], seed: int = 0) -> CandidateCurves:
    """Visits to points, with noise."""
    rng = np.random.default_rng(seed)
    true = np.array([f(float(ALL[k] - 80)) for k in visited])
    u = NOISE * true
    brdf = true + u * rng.normal(size=true.size)
    return CandidateCurves.of(
        POINTS, at(POINTS), at([POINTS[k] for k in visited]), brdf, u, np.full(len(POINTS), NOISE)
    )


def fewer_than(most: int) -> Callable[[list[int]], bool]:
    return lambda batch: len(batch) <= most


def test_even_steps_are_half_as_large_about_the_mirror_direction() -> None:
    batch, finer = cover_evenly(known(lambda x: 0.2, []), ALL, fewer_than(30))
    assert 20 < len(batch) <= 30
    assert finer
    signed = np.array(sorted(k - 80 for k in batch))
    steps = np.diff(signed)
    about = np.abs(0.5 * (signed[1:] + signed[:-1]) - 30.0)
    # candidates lie a degree apart
    assert steps[about < 12.0].max() <= 0.5 * steps[about > 20.0].max() + 1.0
    assert {0, 160} <= set(batch), "the ends"


def test_a_resolved_curve_is_visited_again() -> None:
    visited = list(range(0, 161, 5))
    batch = cover_by_errors(
        known(lambda x: 0.2 * math.exp(-((x / 60.0) ** 2)), visited), ALL, np.ones(161), fewer_than(33)
    )
    # noise is what is left; leaving a point out departs by noise too, and may ask for some points between
    assert sum(k in visited for k in batch) > 0.7 * len(batch)
    assert np.bincount(np.searchsorted(visited, [k for k in batch if k in visited]), minlength=33).max() <= 3, "evenly"


def test_gaps_beside_a_narrow_lobe_are_divided() -> None:
    visited = list(range(0, 161, 5))
    batch = cover_by_errors(
        known(lambda x: 0.1 + 2.0 * math.exp(-(((x - 22.0) / 4.0) ** 2)), visited), ALL, np.ones(161), fewer_than(16)
    )
    new = [k - 80 for k in batch if k not in visited]
    assert len(new) >= 8
    assert all(2 < x < 42 for x in new), "where the lobe is"


def test_points_that_are_dear_are_left_to_the_end() -> None:
    cost = np.where(np.arange(161) < 80, 100.0, 1.0)
    assert min(cover_by_errors(known(lambda x: 0.2, list(range(0, 161, 5))), ALL, cost, fewer_than(16))) >= 80


def test_nothing_is_taken_that_does_not_fit_or_is_not_open() -> None:
    one = known(lambda x: 0.2, list(range(0, 161, 5)))
    assert cover_by_errors(one, ALL, np.ones(161), lambda batch: not batch) == []
    assert cover_by_errors(one, [], np.ones(161), fewer_than(16)) == []
    assert set(cover_by_errors(one, ALL[:81], np.ones(161), fewer_than(16))) <= set(ALL[:81])
    assert cover_evenly(one, [], fewer_than(16)) == ([], False)


def test_a_curve_that_is_known_as_well_as_the_reference_is_left_alone() -> None:
    rng = known(lambda x: 0.2, list(itertools.chain.from_iterable([k] * 40 for k in range(0, 161, 5))))
    exact = CandidateCurves(rng.points, rng.visits, np.where(rng.visits > 0, math.log(0.2), 0.0), rng.u)
    assert cover_by_errors(exact, ALL, np.ones(161), fewer_than(16)) == []


def curve(theta_i: float, *signed: float) -> list[Point]:
    return [canonical(theta_i, 0.0, float(x), 180.0) for x in signed]


def test_gaps_are_divided_evenly_and_ends_are_taken() -> None:
    places = [*np.arange(-80.0, -33.0), *np.arange(-26.0, 81.0)]  # a cone around retro is missing
    points = curve(30.0, *places)
    chosen = {places[k] for k in fill(points, {places.index(x) for x in (0.0, 3.0, 40.0)}, 10.0)}
    assert {-80.0, -34.0, -26.0, 80.0} <= chosen
    assert not chosen & {0.0, 3.0, 40.0}, "what is measured is not measured again"
    there = np.array(sorted(chosen | {0.0, 3.0, 40.0}))
    steps = np.diff(there)[there[:-1] != -34.0]
    assert steps.max() <= 10.0
    assert np.count_nonzero(steps < 8.0) <= 1, "but for the two that were there, none is much smaller"
    assert not fill(points, set(range(len(points))), 0.1)


def test_a_finer_step_takes_more_of_every_curve() -> None:
    points = curve(10.0, *range(-85, 86)) + curve(75.0, *range(-60, 86))
    numbers = [
        [len([k for k in fill(points, set(), step) if (k < 171) == own]) for own in (True, False)]
        for step in (30, 10, 3)
    ]
    assert numbers == [[7, 6], [18, 16], [58, 50]]  # ceil(170 / step) + 1, ceil(145 / step) + 1


@pytest.mark.parametrize("turn", [0.0, 80.0, 190.0, 350.0])
def test_the_side_of_the_mirror_direction_does_not_depend_on_where_azimuths_count_from(turn: float) -> None:
    """And one in the plane, but on the light's side, lies beyond the normal; one outside is in no curve with it."""
    sides = {180.0: 1, 100.0: 1, 265.0: 1, 0.0: -1, 80.0: -1, 300.0: -1}
    points = {dphi: Point(30.0, turn, 40.0, (turn + dphi) % 360.0) for dphi in sides}
    assert {dphi: signed_deg(point) / 40.0 for dphi, point in points.items()} == sides
    assert [from_mirror_deg(points[dphi]) for dphi in (180.0, 0.0, 100.0)] == [10.0, 70.0, 180.0]


def test_the_farthest_place_is_next() -> None:
    """Of a line: the other end, the middle, the quarters; a dear one later, and none twice."""
    line = np.stack([np.arange(9.0), np.zeros(9), np.zeros(9)], axis=1)
    assert (spread(line, 5, [0]), spread(line, 3, [], among=line[:1])) == ([0, 8, 4, 2, 6], [8, 4, 2])
    assert spread(line, 2, [0], cost=np.where(np.arange(9) > 6, 4.0, 1.0)) == [0, 6], "49/4 and 64/4 are less than 36"
    assert sorted(spread(np.concatenate([line, line]), 20, [0])) == list(range(9))
