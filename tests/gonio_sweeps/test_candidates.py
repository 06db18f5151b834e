"""Coverings of candidates."""

from __future__ import annotations

import numpy as np
from gonio_sweeps.candidates import fill

from gonio.acquisition.plan import Point, canonical


def curve(theta_i: float, *signed: float) -> list[Point]:
    return [canonical(theta_i, 0.0, float(x), 180.0) for x in signed]


def test_gaps_are_divided_evenly_and_ends_are_taken() -> None:
    places = [*np.arange(-80.0, -33.0), *np.arange(-26.0, 81.0)]  # a cone around retro is missing
    points = curve(30.0, *places)
    measured = {places.index(x) for x in (0.0, 3.0, 40.0)}
    chosen = {places[k] for k in fill(points, measured, 10.0)}
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
