"""The process behind curves: its coordinates, its derivatives, and its conditioning by the textbook formula."""

import numpy as np
import pytest

from gonio.geometry import Directions
from gonio.models import gaussian_process as gp
from gonio.models.gaussian_process import NAMES, OF_CURVES, Coordinates, PlacePairs, Process, Training


def directions(count: int, seed: int) -> Directions:
    rng = np.random.default_rng(seed)
    theta_i = rng.choice([20.0, 50.0], count)
    return Directions.from_degrees(theta_i, np.zeros(count), rng.uniform(0, 80, count), rng.uniform(0, 360, count))


def test_the_mirror_direction_is_the_middle_of_the_half_vectors() -> None:
    at = Coordinates.of(Directions.from_degrees([40.0, 40.0, 40.0], [10.0] * 3, [40.0, 60.0, 20.0], [190.0] * 3))
    # in the plane the half vector turns half as far as the detector
    assert at.theta_h == pytest.approx(np.radians([0.0, 10.0, 10.0]), abs=1e-12)  # rounding of degrees
    assert at.toward[1:, 0] == pytest.approx([1.0, -1.0]), "away from the light beyond the mirror direction"
    assert at.apart == pytest.approx(np.radians([80.0, 100.0, 60.0]))


def test_a_turned_sample_and_a_turned_table_are_alike() -> None:
    d = directions(20, 1)
    a, b = Coordinates.of(d), Coordinates.of(d.turned(1.0))
    for name in ("theta_h", "toward", "view", "apart"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12)  # rounding


def test_derivatives_of_the_likelihood_are_those_of_differences() -> None:
    rng = np.random.default_rng(0)
    values = Training(
        Coordinates.of(directions(24, 0)), rng.normal(0, 1, 24), np.full(24, 0.05), rng.normal(0, 0.01, (24, 2))
    )
    p = OF_CURVES.centres + rng.normal(0, 0.5, len(NAMES))
    _, slope = gp.objective(p, values, 0.0)
    h = 1e-5
    for k in range(p.size):
        step = h * np.eye(p.size)[k]
        difference = gp.objective(p + step, values, 0.0)[0] - gp.objective(p - step, values, 0.0)[0]
        # a solution of a matrix of condition 1e6 has 1e-10 of its value near 1e2 as rounding, and h is 1e-5
        assert slope[k] == pytest.approx(difference / (2 * h), rel=1e-4, abs=1e-3), NAMES[k]


def test_what_is_known_is_the_conditional_distribution() -> None:
    rng = np.random.default_rng(3)
    at, there = Coordinates.of(directions(12, 4)), Coordinates.of(directions(5, 5))
    z, u, causes = rng.normal(0, 1, 12), rng.uniform(0.01, 0.1, 12), rng.normal(0, 0.05, (12, 1))
    process = Process(Training(at, z, u, causes), OF_CURVES.centres, 0.3)
    mean, covariance = process.mean_at(there), process.covariance_at(there)
    k = PlacePairs(at, at).kernel(OF_CURVES.centres) + np.diag(u**2) + causes @ causes.T
    cross = PlacePairs(there, at).kernel(OF_CURVES.centres)
    # Rasmussen and Williams (2006), eqs. 2.23 and 2.24; the jitter is 1e-10
    np.testing.assert_allclose(mean, 0.3 + cross @ np.linalg.solve(k, z - 0.3), atol=1e-4)
    prior = PlacePairs(there, there).kernel(OF_CURVES.centres)
    np.testing.assert_allclose(covariance, prior - cross @ np.linalg.solve(k, cross.T), atol=1e-5)


def test_variances_are_the_diagonals_of_the_covariances_with_and_without_values() -> None:
    rng = np.random.default_rng(6)
    at, there = Coordinates.of(directions(12, 4)), Coordinates.of(directions(5, 5))
    there = there.seen(rng.uniform(0.2, 1.0, 5), rng.uniform(0.2, 1.0, 5))
    values = Training(at, rng.normal(0, 1, 12), rng.uniform(0.01, 0.1, 12), rng.normal(0, 0.05, (12, 2)))
    process = Process(values, OF_CURVES.centres + rng.normal(0, 0.5, len(NAMES)), 0.3)
    effects = rng.normal(0, 0.1, (5, 2))
    # the smallest is a thousandth of the largest
    prior = np.diag(PlacePairs(there, there, OF_CURVES).kernel(process.p))
    np.testing.assert_allclose(process.prior_variance_at(there), prior, rtol=1e-9)
    for more in (None, effects):
        known = np.diag(process.covariance_at(there, more))
        np.testing.assert_allclose(process.variance_at(there, more), known, rtol=1e-6)
    assert process.mean_at(there) == pytest.approx(0.3 + process.changes_at(there))
    lobe, base = np.array([0.3, -2.0]), np.array([-1.0, 1.5])
    step = 1e-6
    by = [
        (gp.total(lobe + step * a, base + step * b) - gp.total(lobe - step * a, base - step * b)) / (2 * step)
        for a, b in ((1, 0), (0, 1))
    ]
    np.testing.assert_allclose(gp.shares(lobe, base), by, rtol=1e-7)


def test_a_value_left_out_is_predicted_by_the_others() -> None:
    rng = np.random.default_rng(6)
    d = directions(10, 7)
    at, z, u = Coordinates.of(d), rng.normal(0, 1, 10), np.full(10, 0.1)
    left_out = Process(Training(at, z, u, np.zeros((10, 1))), OF_CURVES.centres).left_out
    others = np.arange(10) != 4
    process = Process(Training(Coordinates.of(d[others]), z[others], u[others], np.zeros((9, 1))), OF_CURVES.centres)
    mean, covariance = process.mean_at(Coordinates.of(d[4:5])), process.covariance_at(Coordinates.of(d[4:5]))
    expected = (z[4] - mean[0]) / np.sqrt(covariance[0, 0] + 0.01)
    assert left_out[4] == pytest.approx(expected, rel=1e-5)  # jitter of 1e-10 beside a noise of 1e-2


@pytest.mark.slow
def test_a_search_with_some_values_ends_where_one_with_all_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """A smooth curve with noise of 1 %; the parameters of a third of the values lie elsewhere."""
    rng = np.random.default_rng(8)
    at = Coordinates.of(directions(90, 8))
    z = np.exp(-((at.theta_h / 0.3) ** 2)) + 0.3 * np.cos(at.apart) + 0.01 * rng.normal(size=90)
    data, mean = Training(at, z, np.full(90, 0.01), np.zeros((90, 1))), float(np.median(z))
    whole = gp.objective(gp.learned(data), data, mean)[0]
    monkeypatch.setattr(gp, "ENOUGH", 30)
    # a difference of 0.5 in the logarithm is one standard deviation of a parameter
    found = gp.learned(data)
    assert gp.objective(found, data, mean)[0] < whole + 0.5
    with monkeypatch.context() as patched:
        patched.setattr(gp, "starts", lambda *_: pytest.fail("many values go on from the parameters before"))
        assert gp.objective(gp.learned(data, found), data, mean)[0] < whole + 0.5
    monkeypatch.setattr(gp, "POLISH", 0)
    assert gp.objective(gp.learned(data), data, mean)[0] > whole + 0.5
