"""Functions over a sample on grids of nodes: cubics come out exactly, and what is smooth within the tolerance."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from gonio_sim.adaptive_grid import DARK, FLOOR, TOLERANCE, NodeGrid, electrons_per_s, sample_function

from gonio.typing import Floats

REACH = 12.0


def grid_of(function: Callable[[Floats, Floats], Floats], count: int) -> NodeGrid:
    y, x = np.meshgrid(*2 * [np.linspace(-REACH, REACH, count)], indexing="ij")
    return NodeGrid(function(x, y), REACH)


def bicubic(x: Floats, y: Floats) -> Floats:
    """Of degree 3 in either, and not the same in both."""
    s, t = x / REACH, y / REACH
    return np.asarray((1.0 + 2.0 * s - s**2 + 3.0 * s**3) * (2.0 - t + 0.5 * t**2 - 0.25 * t**3))


def places(count: int = 400) -> tuple[Floats, Floats]:
    x, y = np.random.default_rng(3).uniform(-REACH, REACH, (2, count))
    x[:4], y[:4] = [-REACH, REACH, -REACH, REACH], [-REACH, -REACH, REACH, REACH]
    return x, y


@pytest.mark.parametrize("count", [4, 5, 9])
def test_cubics_are_interpolated_exactly_up_to_the_corners(count: int) -> None:
    x, y = places()
    np.testing.assert_allclose(grid_of(bicubic, count).at(x, y), bicubic(x, y), rtol=1e-12, atol=1e-12)


def test_a_disc_is_painted_and_nothing_beside_it() -> None:
    x, y = (n.reshape(20, 20).copy() for n in places())
    x[3, 4] = y[5, 6] = math.nan
    out = np.full(x.shape, -1.0)
    grid_of(bicubic, 9).paint(x, y, (2.0, -3.0), 5.0, out)
    inside = np.hypot(x - 2.0, y + 3.0) <= 5.0
    assert 20 < inside.sum() < 200
    np.testing.assert_allclose(out[inside], bicubic(x, y)[inside], rtol=1e-12, atol=1e-12)
    assert (out[~inside] == -1.0).all()


class Counted:
    """A function that counts at how many places it is asked for."""

    def __init__(self, function: Callable[[Floats, Floats], Floats]) -> None:
        self._function, self.places = function, 0

    def __call__(self, x: Floats, y: Floats) -> Floats:
        self.places += x.size
        return self._function(x, y)


def lobe(width: float) -> Callable[[Floats, Floats], Floats]:
    return lambda x, y: np.exp(-0.5 * ((x - 1.0) ** 2 + (y + 2.0) ** 2) / width**2)


def test_a_cubic_takes_the_two_coarsest_grids_and_no_more() -> None:
    function = Counted(bicubic)
    assert sample_function(function, REACH).values.shape == (9, 9)
    assert function.places == 81


@pytest.mark.parametrize("width", [3.0, 6.0, 20.0])
def test_what_is_smooth_is_followed_within_the_tolerance_and_asked_for_once(width: float) -> None:
    function = Counted(lobe(width))
    grid = sample_function(function, REACH)
    x, y = places()
    true = lobe(width)(x, y)
    assert np.all(np.abs(grid.at(x, y) - true) <= TOLERANCE * (true + FLOOR + DARK))
    assert function.places == grid.values.size
    # half as many nodes would not do
    coarse = NodeGrid(np.ascontiguousarray(grid.values[::2, ::2]), REACH)
    half = NodeGrid(np.ascontiguousarray(coarse.values[::2, ::2]), REACH)
    y, x = np.meshgrid(*2 * [np.linspace(-REACH, REACH, len(coarse.values))], indexing="ij")
    if len(half.values) > 4:
        error = np.abs(half.at(x, y) - coarse.values)
        assert np.any(error > TOLERANCE * (coarse.values + FLOOR * grid.values.max() + DARK))


def test_a_grid_is_no_finer_than_it_needs_to_be() -> None:

    def needle(x: Floats, y: Floats) -> Floats:
        """A cusp, which no cubic predicts."""
        return np.asarray(1.0 + np.sqrt(np.abs(x)))

    assert len(sample_function(needle, REACH).values) == 129
    assert len(sample_function(needle, REACH, finest=6.1).values) == 5  # 4 steps of 6.1 are more than the reach
    assert len(sample_function(needle, REACH, finest=1.6).values) == 9  # 8 steps of 1.6 are, too
    assert len(sample_function(needle, REACH, finest=1.4).values) == 17
    assert len(sample_function(needle, REACH, finest=0.7).values) == 33


def test_electrons_are_a_product_between_nothing_and_the_most() -> None:
    weight, brdf = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.array([[0.5, 0.25, -1.0], [1e9, 0.1, 0.0]])
    out = np.empty((2, 3), dtype=np.float32)
    electrons_per_s(8.0, weight, brdf, 100.0, out)
    np.testing.assert_allclose(out, [[4.0, 4.0, 0.0], [100.0, 4.0, 0.0]])
