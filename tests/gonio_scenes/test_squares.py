"""Means over squares of pixels by their formulas: moments, differences, noise, and quadratics through neighbours."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from gonio_scenes import squares
from gonio_scenes.exposures import Exposure
from gonio_scenes.squares import Squares, WholePicture

from gonio.typing import Floats

HEIGHT, WIDTH, SIZE = 20, 25, 5


def exposure(value: Floats, **changes: Any) -> Exposure:
    """A picture in electrons, of which a radiance of 1 gives 100."""
    usual: dict[str, Any] = {
        "per_radiance": np.full(value.shape, 100.0), "used": np.ones(value.shape, dtype=bool),
        "saturated": np.zeros(value.shape, dtype=bool), "clamped": np.zeros(value.shape, dtype=bool),
        "shot": 0.0, "constant": 0.0, "relative": 0.0,
    }  # fmt: skip
    return Exposure(value=value, **usual | changes)


def pixels(**changes: Any) -> WholePicture:
    usual: dict[str, Any] = {
        "received": np.full((HEIGHT, WIDTH), 2.0), "why": np.zeros((HEIGHT, WIDTH), dtype=np.int8), "piece": None,
        "flat": False, "kinked": False,
    }  # fmt: skip
    return WholePicture(**usual | changes)


def quadratic(column: Any, row: Any) -> Any:
    """BRDF [1/sr] over the picture."""
    x, y = column - 12.0, row - 10.0
    return 1.0 + 0.02 * x - 0.03 * y + 0.004 * x**2 - 0.002 * y**2 + 0.003 * x * y


def picture() -> Floats:
    """The value of pixels at their centres; a radiance is the BRDF times what is received."""
    row, column = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    return np.asarray(quadratic(column, row) * 2.0 * 100.0)


def test_a_quadratic_comes_out_in_the_middle_of_each_square() -> None:
    found = Squares(pixels(), exposure(picture()), SIZE, whole=False)
    row, column = np.mgrid[: HEIGHT // SIZE, : WIDTH // SIZE] * SIZE + 2.5
    np.testing.assert_allclose(found.row, row)
    np.testing.assert_allclose(found.column, column)
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(found.value[inner], quadratic(column, row)[inner], rtol=1e-12)
    # (f_xx + f_yy) / 2 times the second moment of five points, 2
    np.testing.assert_allclose(found.above[inner], 0.5 * (0.008 - 0.004) * 2.0, rtol=1e-9)
    assert np.isnan(found.value[0]).all(), "there a neighbour has none"
    np.testing.assert_allclose(found.per_value[inner], 1.0 / 200.0, rtol=1e-12)


def test_pixels_that_see_their_area_have_its_moment_besides() -> None:
    """A twelfth of a pixel squared along either side."""
    found = Squares(pixels(), exposure(picture()), SIZE, whole=True)
    np.testing.assert_allclose(found.above[1:-1, 1:-1], 0.5 * (0.008 - 0.004) * (2.0 + 1.0 / 12.0), rtol=1e-9)


def test_squares_of_one_channel_lie_at_the_middle_of_its_pixels() -> None:
    used = np.zeros((HEIGHT, WIDTH), dtype=bool)
    used[::2, 1::2] = True
    found = Squares(pixels(), exposure(picture(), used=used), SIZE, whole=False)
    row, column = (np.asarray(places, np.float64) for places in np.mgrid[:HEIGHT, :WIDTH] + 0.5)
    here = used[5:10, 5:10]
    assert found.row[1, 1] == pytest.approx(row[5:10, 5:10][here].mean())
    assert found.column[1, 1] == pytest.approx(column[5:10, 5:10][here].mean())
    assert found.mean[1, 1] == pytest.approx(np.mean(quadratic(column, row)[5:10, 5:10][here]))
    assert found.count[1, 1] == here.sum()


def test_a_square_takes_the_first_reason_of_its_pixels() -> None:
    why = np.zeros((HEIGHT, WIDTH), dtype=np.int8)
    why[7, 7], why[8, 8] = 4, 2
    why[12, 3] = -1
    why[15:, 20:] = -1
    found = Squares(pixels(why=why), exposure(picture()), SIZE, whole=False)
    assert (found.why[1, 1], found.why[2, 0], found.why[0, 0]) == (2, 1, 0), "off the shape is the limb"
    assert np.isnan(found.mean[1, 1])
    assert np.asarray(found.of_shape)[[3, 2], [4, 0]].tolist() == [False, True]


@pytest.mark.parametrize(
    ("changes", "variance"),
    [
        # of a pixel of 200 electrons; 25 of them
        ({"shot": 1.0}, 200.0),
        ({"constant": 30.0}, 30.0),
        ({"relative": 0.01}, 4.0),
        ({"shot": 1.0, "constant": 30.0, "relative": 0.01, "step": 2.0}, 234.0 + 4.0 / 12.0),
        # pixels alike within half a step of 100 electrons round alike: 25 times as much
        ({"constant": 30.0, "step": 100.0}, 30.0 + 25.0 * 1e4 / 12.0),
        ({"constant": 2499.0, "step": 100.0}, 2499.0 + 25.0 * 1e4 / 12.0),
        ({"constant": 2501.0, "step": 100.0}, 2501.0 + 1e4 / 12.0),
    ],
)
def test_the_noise_of_a_mean_is_that_of_its_pixels(changes: dict[str, float], variance: float) -> None:
    found = Squares(pixels(), exposure(np.full((HEIGHT, WIDTH), 200.0), **changes), SIZE, whole=False)
    np.testing.assert_allclose(found.noise[1:-1, 1:-1], math.sqrt(variance / 25.0) / 200.0, rtol=1e-9)
    # a mean less what its neighbours say of the curvature: 1 + 2 m + ..., m the moment over the side squared
    m = 2.0 / SIZE**2
    weights = (1.0 + 2.0 * m) ** 2 + 0.5 * (m**2 + m**2)
    np.testing.assert_allclose(found.random[1:-1, 1:-1], math.sqrt(weights * variance / 25.0) / 200.0, rtol=1e-9)


def test_a_tenth_of_the_correction_for_curvature_is_uncertain() -> None:
    found = Squares(pixels(), exposure(picture()), SIZE, whole=False)
    above, area = 0.5 * (0.008 - 0.004) * 2.0, 0.5 * (0.008 - 0.004) / 12.0
    np.testing.assert_allclose(found.random[1:-1, 1:-1], math.hypot(0.1 * above, area), rtol=1e-9)


def test_around_is_the_mean_of_eight_neighbours() -> None:
    grid = np.random.default_rng(1).uniform(size=(4, 5))
    found = squares._around(grid)
    assert found[1, 2] == pytest.approx((grid[:3, 1:4].sum() - grid[1, 2]) / 8.0)
    assert np.isnan(found[0]).all()


@pytest.mark.parametrize(("down", "right"), [(0, 1), (1, 0), (-1, 0), (0, -1), (1, -1)])
def test_shifted_grids_end_at_their_edge(down: int, right: int) -> None:
    grid = np.arange(12.0).reshape(3, 4)
    for (row, column), value in np.ndenumerate(squares._shifted(grid, down, right)):
        inside = 0 <= row + down < 3 and 0 <= column + right < 4
        assert (value == grid[row + down, column + right]) if inside else math.isnan(value)


def test_most_pixels_name_a_square() -> None:
    piece = np.array([[[3, 3, 7, 7, 7], [-1, -1, -1, -1, 2]], [[-1] * 5, [5, 5, 5, 4, 4]]])
    assert squares._most(piece).tolist() == [[7, 2], [-1, 5]]


def test_tangents_are_unit_vectors_across_the_normal() -> None:
    normal = np.random.default_rng(2).standard_normal((50, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    frame = np.concatenate([squares._tangents(normal), normal[:, :, None]], axis=2)
    np.testing.assert_allclose(np.swapaxes(frame, 1, 2) @ frame, np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


# ---- slopes ----


def slopes_of(size: int) -> tuple[Any, Any]:
    """Squares of a picture whose asinh is a quadratic, and what is used of them."""
    row, column = np.mgrid[:5, :6] * size + 0.5 * size
    log = 2.0 + 0.05 * column - 0.03 * row + 0.002 * column**2 - 0.001 * row**2 + 0.0015 * column * row
    small = 3.0 * 0.01
    values = 2.0 * small * np.sinh(log)
    used = np.zeros((5, 6), dtype=bool)
    used[1:-1, 1:-1] = True
    made = SimpleNamespace(mean=values, value=values, noise=np.full((5, 6), 0.01), size=size, flat=False, piece=None)
    return made, (used, column, row)


def test_slopes_are_those_of_a_quadratic() -> None:
    made, (used, column, row) = slopes_of(4)
    found = squares._slopes(cast(Squares, made), used, np.zeros((12, 3)), np.zeros((12, 3, 2)))
    x, y = column[used], row[used]
    np.testing.assert_allclose(found.gradient[:, 0], 0.05 + 0.004 * x + 0.0015 * y, rtol=1e-9)
    np.testing.assert_allclose(found.gradient[:, 1], -0.03 - 0.002 * y + 0.0015 * x, rtol=1e-9)
    np.testing.assert_allclose(found.hessian, np.tile([0.004, -0.002, 0.0015], (12, 1)), rtol=1e-6)
    step = np.tile([1.5, -2.5], (12, 1))
    x, y = x + 1.5, y - 2.5
    moved = 2.0 + 0.05 * x - 0.03 * y + 0.002 * x**2 - 0.001 * y**2 + 0.0015 * x * y
    np.testing.assert_allclose(found.moved(step), 2.0 * found.small * np.sinh(moved), rtol=1e-8)


def test_slopes_over_facets_are_those_of_a_quadratic_through_the_nearest_normals() -> None:
    """40 facets of a flat bowl, some of several squares."""
    tilt = np.random.default_rng(3).uniform(-0.1, 0.1, (40, 2))
    normal = np.column_stack([tilt, np.ones(40)])  # nearly unit vectors: their third component takes no part
    piece = np.concatenate([np.arange(40), np.arange(0, 40, 3)])
    normal, tilt = normal[piece], tilt[piece]
    a, b = tilt.T
    log = 1.0 + 2.0 * a - 3.0 * b + 0.5 * 8.0 * a**2 - 0.5 * 6.0 * b**2 + 5.0 * a * b
    gradient, hessian = squares._over_facets(piece, normal, log, np.tile(np.eye(3)[:, :2], (len(piece), 1, 1)))
    np.testing.assert_allclose(
        gradient, np.column_stack([2.0 + 8.0 * a + 5.0 * b, -3.0 - 6.0 * b + 5.0 * a]), rtol=1e-6
    )
    np.testing.assert_allclose(hessian, np.tile([8.0, -6.0, 5.0], (len(piece), 1)), rtol=1e-4)
