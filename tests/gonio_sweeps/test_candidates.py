"""Angles along a curve, places that points should lie evenly in, and what is known at a place from those nearby."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_sweeps.candidates import (
    FAR_DEG,
    INCIDENCE_DEG,
    NEAR_MIRROR_DEG,
    from_mirror_deg,
    nearby,
    places,
    signed_deg,
    spread,
)

from gonio.acquisition.plan import Point
from gonio.geometry import Directions

TURNS_DEG = (0.0, 80.0, 100.0, 190.0, 350.0)


def point(theta_r: float, dphi: float, turn: float) -> Point:
    return Point(30.0, turn, theta_r, (turn + dphi) % 360.0)


@pytest.mark.parametrize("turn", TURNS_DEG)
def test_the_side_of_the_mirror_direction_does_not_depend_on_where_azimuths_count_from(turn: float) -> None:
    for dphi, sign in ((180.0, 1.0), (100.0, 1.0), (265.0, 1.0), (0.0, -1.0), (80.0, -1.0), (300.0, -1.0)):
        assert signed_deg(point(40.0, dphi, turn)) == sign * 40.0, dphi
    assert from_mirror_deg(point(40.0, 180.0, turn)) == 10.0
    assert from_mirror_deg(point(40.0, 0.0, turn)) == 70.0, "beyond the normal"
    assert from_mirror_deg(point(40.0, 100.0, turn)) == 180.0, "the curve does not hold it"


@pytest.mark.parametrize("turn", TURNS_DEG)
def test_places_are_dense_about_the_mirror_direction_and_alike_on_both_sides(turn: float) -> None:
    """Of a chord s from the mirror direction they are asinh(s/near) + s/far away, along the plane or across it."""
    near, far = (2 * math.sin(math.radians(a) / 2) for a in (NEAR_MIRROR_DEG, FAR_DEG))
    away = (0.0, 2.0, 5.0, 20.0, -2.0, -5.0, -20.0)
    turned = np.full(len(away), turn)
    at = places(Directions.from_degrees(np.full(len(away), 30.0), turned, 30.0 + np.array(away), turned + 180.0))
    chord = 2 * np.sin(np.radians(away) / 2)
    assert at[:, 0] == pytest.approx(-np.arcsinh(chord / near) - chord / far, abs=1e-6), "grazing ones below 0"
    assert at[:, 1] == pytest.approx(0.0, abs=1e-6)
    assert at[:, 2] == pytest.approx(30.0 / INCIDENCE_DEG)
    # beside the plane of incidence: two azimuths that mirror each other, at the same chord
    two = np.array([turn, turn])
    left, right = places(
        Directions.from_degrees(np.array([30.0, 30.0]), two, np.array([30.0, 30.0]), np.array([175.0, 185.0]) + turn)
    )
    assert left == pytest.approx(right * [1.0, -1.0, 1.0])
    assert abs(left[1]) > 10 * abs(left[0])


def test_the_farthest_place_is_next() -> None:
    """Of a line: the other end, the middle, the quarters; a dear one later, and none twice."""
    line = np.stack([np.arange(9.0), np.zeros(9), np.zeros(9)], axis=1)
    assert spread(line, 5, [0]) == [0, 8, 4, 2, 6]
    assert spread(line, 3, [], among=line[:1]) == [8, 4, 2]
    assert spread(line, 2, [0], cost=np.where(np.arange(9) > 6, 4.0, 1.0)) == [0, 6], "49/4 and 64/4 are less than 36"
    assert sorted(spread(np.concatenate([line, line]), 20, [0])) == list(range(9))


def test_a_value_nearby_is_the_geometric_mean_of_those_about_it_and_their_own_at_theirs() -> None:
    at = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 30.0, 0.0], [50.0, 0.0, 0.0]])
    brdf, u = np.array([0.1, 10.0, 1.0, 7.0]), np.full(4, 1e-3)
    middle, own = nearby(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), at, brdf, u)
    assert middle == pytest.approx(1.0), "alike far from 0.1 and 10"
    assert own == pytest.approx(0.1, rel=1e-5)
    near = nearby(np.array([[0.5, 0.0, 0.0]]), at, brdf, u)[0]
    # squares of distances 1 to 9, the third 3600 times farther than the first
    assert math.log10(near) == pytest.approx((-1 * 9 + 1) / 10, abs=2e-3)
    assert nearby(np.array([[0.0, 0.0, 0.0]]), at, -brdf, u)[0] == pytest.approx(1e-3), "what is below its uncertainty"
