"""Curvature of a spectrum, from which a band's width gets its effect."""

import numpy as np

from gonio.reduction.light_and_lens import _curvatures


def test_the_curvature_of_a_parabola_is_that_of_its_formula() -> None:
    x = np.array([400.0, 450.0, 470.0, 560.0, 600.0])  # uneven bands
    np.testing.assert_allclose(_curvatures(3.0 * x**2 - 5.0 * x + 2.0, x), 6.0, rtol=1e-9)  # rounding of 1e6
    assert _curvatures(x[:2], x[:2]).tolist() == [0.0, 0.0]
