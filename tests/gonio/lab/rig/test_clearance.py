"""Distances between bodies beside a least-squares solver that shares nothing with them."""

import numpy as np
import pytest
from scipy.optimize import nnls

from gonio.lab.rig._clearance import between
from gonio.typing import Floats

CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], dtype=float)


def nearest(a: Floats, b: Floats) -> float:
    """Smallest distance of mixtures of two sets of points; weights are not negative and add up to one each."""
    size, heavy = max(abs(a).max(), abs(b).max()), 1e4
    rows = np.zeros((5, len(a) + len(b)))
    rows[:3, : len(a)], rows[:3, len(a) :] = a.T / size, -b.T / size
    rows[3, : len(a)] = rows[4, len(a) :] = heavy
    weights = nnls(rows, np.array([0, 0, 0, heavy, heavy]))[0]
    one, other = weights[: len(a)], weights[len(a) :]
    return float(np.linalg.norm(one / one.sum() @ a - other / other.sum() @ b))


def found(a: Floats, b: Floats) -> float:
    return float(between(a, len(a), b, len(b), 0.0, np.inf))


@pytest.mark.slow
def test_a_plate_and_a_slanted_post_far_apart_do_not_meet() -> None:
    # The four differences that the search came to lay in one plane to 1e-16 of their size, and their tetrahedron was
    # taken to hold the origin. All digits count: with fewer the differences are in a plane no longer.
    plate = np.array([
        [-54.64671684516441, -35.25668094675208, -48.792192449337875],
        [-54.61024441265, -41.95352586474295, -41.36582470285196],
        [-80.24498594687653, 4.980450081076546, -12.382002863925365],
        [-80.20851351436211, -1.7163948369143254, -4.955635117439448],
        [80.15015762233905, 12.295561864243956, -6.573218597810311],
        [80.18663005485347, 5.598716946253084, 0.853149148675606],
        [54.55188852062694, 52.53269289207258, 29.836970987602196],
        [54.588360953141354, 45.83584797408171, 37.263338734088116],
    ])  # fmt: skip
    post = np.array([
        [58.08048172229576, 77.90516783976392, -300.0],
        [-385.1914870677548, -247.91468087693107, 452.44229471926633],
    ])  # fmt: skip
    # 1e-5 mm: digits of the solver
    assert found(plate, post) == pytest.approx(nearest(plate, post), abs=1e-5)


def test_distances_of_boxes_and_lines_are_those_of_a_least_squares_solver() -> None:
    rng = np.random.default_rng(6)
    for number in range(400):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0] if number % 3 else np.eye(3)
        box = CORNERS * rng.uniform(2, 120, 3) @ turn + rng.uniform(-250, 250, 3)
        other = CORNERS * rng.uniform(2, 120, 3) if number % 2 else rng.uniform(-350, 350, (2, 3))
        expected = nearest(box, other)
        for one, two in ((box, other), (other, box)):
            # 1e-4 mm: the solver keeps sums of weights to about that; bodies are stated to 0.1 mm
            assert found(one, two) == pytest.approx(expected, abs=1e-4)
