"""Slopes of a lobe from scattered points: against functions whose slopes are known, with the uncertainty stated."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from gonio.geometry import Directions
from gonio.lab.reduction import lobe_surface
from gonio.lab.reduction.lobe_surface import USUAL, Surface, _Covariance, _of_slopes, coordinates
from gonio.typing import Floats

NOISE = 0.003
Log = Callable[[Floats], Floats]


def anywhere(rng: np.random.Generator, count: int) -> Floats:
    """Places (x, y, theta_i, turn) over the hemisphere, each with its own angle of incidence."""
    theta_i, theta_r = np.arcsin(np.sqrt(rng.uniform(0.0, 0.95, (2, count))))
    phi, turn = rng.uniform(0.0, math.tau, (2, count))
    return np.stack([theta_r * np.cos(phi), theta_r * np.sin(phi), theta_i, turn], axis=1)


def glossy(width: float = 0.25, ground: float = 0.05) -> Log:
    """A lobe of facets, with its 1 / (cos theta_i cos theta_r), on a matte ground."""

    def log(places: Floats) -> Floats:
        theta_h, _, source, detector, _, _ = np.moveaxis(coordinates(places), -1, 0)
        return np.asarray(np.log(ground + np.exp(-((np.tan(theta_h) / width) ** 2)) / (source * detector)))

    return log


def brushed(places: Floats) -> Floats:
    """The same with a width that depends on the azimuth of the half vector on the sample."""
    theta_h, _, source, detector, _, phi = np.moveaxis(coordinates(places), -1, 0)
    slope = np.tan(theta_h) ** 2 * ((np.cos(phi - 0.5) / 0.25) ** 2 + (np.sin(phi - 0.5) / 0.45) ** 2)
    return np.asarray(np.log(0.05 + np.exp(-slope) / (source * detector)))


def true_slopes(log: Log, places: Floats) -> Floats:
    step = 1e-6 * np.eye(4)
    return np.asarray((log(places[:, None] + step) - log(places[:, None] - step)) / 2e-6)


def told(log: Log, places: Floats, rng: np.random.Generator) -> tuple[Surface, Floats, Floats]:
    """The surface of noisy values, its departures from the true slopes, and these over their uncertainties."""
    values = log(places) + NOISE * rng.standard_normal(len(places))
    surface = Surface(places, values, np.full(len(places), NOISE))
    slope, covariance, _ = surface.slopes(places)
    off = slope - true_slopes(log, places)
    u = np.sqrt(np.einsum("nii->ni", covariance))
    return surface, off, off / np.where(u > 0.0, u, np.inf)


@pytest.mark.slow
@pytest.mark.parametrize("count", [25, 50])
def test_scattered_points_tell_the_slopes_of_a_lobe_and_how_uncertain_they_are(count: int) -> None:
    """One point an angle of incidence, all out of the plane: their slopes were 0 with an uncertainty of 0."""
    rng, pulls, left = np.random.default_rng(3), [], []
    for _ in range(8):
        places = anywhere(rng, count)
        _, off, z = told(glossy(float(rng.uniform(0.15, 0.4))), places, rng)
        pulls.append(np.mean(z[:, :3] ** 2))
        left.append(np.mean(off[:, :3] ** 2))
    # slopes of one lobe depart together: eight lobes have eight independent numbers, whose mean is 1 +- 0.35 or so;
    # a kink or a lobe that no point has met makes single ones larger
    assert 0.3 < np.median(pulls) < 2.0
    # root mean square of the slopes themselves is 2 to 6 per radian
    assert np.sqrt(np.median(left)) < (1.0 if count == 25 else 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 5])
def test_with_few_points_slopes_are_as_uncertain_as_lobes_are_steep(count: int) -> None:
    rng, pulls = np.random.default_rng(11), []
    for _ in range(30):
        _, _, z = told(glossy(float(rng.uniform(0.15, 0.4))), anywhere(rng, count), rng)
        pulls.append(np.mean(z[:, :3] ** 2))
    # what is stated before anything is measured must be wide enough for the lobes drawn here, of which many points see
    # the matte ground alone
    assert np.mean(pulls) < 1.5


def test_a_matte_sample_has_no_slope_to_speak_of() -> None:
    rng = np.random.default_rng(2)
    places = anywhere(rng, 40)
    values = math.log(0.3) + NOISE * rng.standard_normal(40)
    slope, covariance, _ = Surface(places, values, np.full(40, NOISE)).slopes(places)
    # 0.02 degrees of any angle do less than a thirtieth of the noise, stated and found
    assert np.all(np.sqrt(slope**2 + np.einsum("nii->ni", covariance)) * math.radians(0.02) < NOISE / 30)


@pytest.mark.slow
def test_many_points_in_blocks_tell_what_all_together_do(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    places = anywhere(rng, 300)
    values = glossy()(places) + NOISE * rng.standard_normal(300)
    in_blocks, covariance, _ = Surface(places, values, np.full(300, NOISE)).slopes(places)
    monkeypatch.setattr(lobe_surface, "EXACT", 300)
    together = Surface(places, values, np.full(300, NOISE)).slopes(places)[0]
    off = (in_blocks - together)[:, :3] / np.sqrt(np.einsum("nii->ni", covariance)[:, :3])
    # a third of the points tell less than all do: they differ by about the uncertainty that is stated, and less
    assert np.sqrt(np.mean(off**2)) < 1.0


@pytest.mark.slow
def test_values_say_whether_the_sample_has_a_direction() -> None:
    rng = np.random.default_rng(8)
    places = anywhere(rng, 100)
    isotropic, _, _ = told(glossy(), places, rng)
    assert not isotropic.directed
    assert not isotropic.slopes(places)[0][:, 3].any()
    surface, off, z = told(brushed, places, rng)
    assert surface.directed
    turning = true_slopes(brushed, places)[:, 3]
    # most of what a turn of the sample changes is told; the rest is within what is stated, but for single points where
    # widths that differ by 1.8 times make the lobe's edge change faster with the azimuth than cos 4 phi
    assert np.sqrt(np.mean(off[:, 3] ** 2)) < 0.5 * np.sqrt(np.mean(turning**2))
    assert np.sqrt(np.mean(z[:, 3] ** 2)) < 3.0


@pytest.mark.parametrize("size", [7, 8])
def test_derivatives_of_the_covariance_against_differences(size: int) -> None:
    rng = np.random.default_rng(1)
    at = coordinates(anywhere(rng, 9))
    one, other = at[:4, None], at[4:]
    logs = (USUAL + 0.3 * rng.standard_normal(8))[:size]
    covariance = _Covariance(one, other)
    covariance.of(logs)
    for k, found in enumerate(covariance.by_logs()):
        step = 1e-6 * np.eye(size)[k]
        expected = (_Covariance(one, other).of(logs + step) - _Covariance(one, other).of(logs - step)) / 2e-6
        # rounding of numbers of 100 over 2e-6
        np.testing.assert_allclose(found, expected, atol=1e-6)
    covariance.of(logs)
    for k, found in enumerate(covariance.by_first()):
        step = 1e-6 * np.eye(6)[k]
        expected = (_Covariance(one + step, other).of(logs) - _Covariance(one - step, other).of(logs)) / 2e-6
        np.testing.assert_allclose(found, expected, atol=1e-6)
    for a in range(6 if size == 8 else 4):
        for b in range(6 if size == 8 else 4):
            expected = np.zeros(len(at))
            for i in (1, -1):
                for j in (1, -1):
                    up, down = at + i * 1e-4 * np.eye(6)[a], at + j * 1e-4 * np.eye(6)[b]
                    expected += i * j * np.diag(_Covariance(up[:, None], down).of(logs)) / 4e-8
            # Matern's covariance of 3/2 has a third derivative of a few hundreds, here times 1e-4
            np.testing.assert_allclose(_of_slopes(at, logs)[:, a, b], expected, atol=0.02)


def test_slopes_are_those_of_the_mean_of_a_gaussian_process() -> None:
    """Rasmussen and Williams 2006, equations 2.25 and 2.26, by a dense inverse and by differences."""
    rng = np.random.default_rng(6)
    places, here = anywhere(rng, 12), anywhere(rng, 3)
    values, u = glossy()(places) + 0.1 * rng.standard_normal(12), np.full(12, 0.05)
    surface, at = Surface(places, values, u), coordinates(places)
    means, covariances, log = [], [], values - values.mean()

    def by_place(function: Callable[[Floats], Floats], step: float) -> Floats:
        moves = step * np.eye(4)
        return np.stack([(function(here + move) - function(here - move)) / (2.0 * step) for move in moves], axis=1)

    turn = by_place(coordinates, 1e-6)
    for logs in surface._sets:
        variance = u**2 + lobe_surface.ROUNDING + np.exp(logs[lobe_surface.SCATTER]) ** 2
        inverse = np.linalg.inv(_Covariance(at[:, None], at).of(logs) + np.diag(variance))

        def between(some: Floats, logs: Floats = logs) -> Floats:
            return _Covariance(coordinates(some)[:, None], at).of(logs)

        rows = by_place(between, 1e-6)
        means.append(rows @ inverse @ log)
        prior = turn @ _of_slopes(coordinates(here), logs) @ np.swapaxes(turn, 1, 2)
        covariances.append(prior - rows @ inverse @ np.swapaxes(rows, 1, 2))
        if len(means) == 1:
            step = lobe_surface.BEND * np.eye(4)[:2, None]
            second = sum(between((here + way * step).reshape(-1, 4)) for way in (1, -1)) @ inverse @ log
            bent = (second.reshape(2, -1) - 2.0 * between(here) @ inverse @ log) / lobe_surface.BEND**2
    slope, covariance, curvature = surface.slopes(here)
    weights, every = surface._weights, np.array(means)
    off = every - np.tensordot(weights, every, 1)
    expected = np.tensordot(weights, np.array(covariances) + off[..., None] * off[..., None, :], 1)
    # differences of STEP = 1e-4 leave some 1e-7 of slopes and curvatures of some tens
    np.testing.assert_allclose(slope, np.tensordot(weights, every, 1), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(curvature, bent.T, rtol=1e-6)  # over BEND^2 = 8e-5: ten digits of rounding are left


@pytest.mark.slow
def test_an_azimuth_that_passes_half_a_turn_makes_no_slope() -> None:
    """The half vector's azimuth jumps there by a whole turn."""
    surface, _, _ = told(brushed, anywhere(np.random.default_rng(4), 60), np.random.default_rng(4))
    source = Directions(0.4, 0.0, 0.9, math.pi)
    here = np.array([[source.theta_r, 0.0, source.theta_i, turn] for turn in (math.pi - 1e-9, math.pi, -math.pi)])
    slopes = surface.slopes(here)[0]
    # one place, three times
    np.testing.assert_allclose(slopes, slopes[:1].repeat(3, axis=0), rtol=1e-5, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 3, 150])
@pytest.mark.parametrize("u", [0.0, 0.3])
def test_values_that_are_all_alike_or_read_twice_have_finite_slopes(count: int, u: float) -> None:
    rng = np.random.default_rng(count)
    places = anywhere(rng, count)
    twice = np.concatenate([places, places[: count // 2 + 1]])
    for log in (np.zeros(len(twice)), 30.0 * rng.standard_normal(len(twice))):
        for found in Surface(twice, log, np.full(len(twice), u)).slopes(twice):
            assert np.isfinite(found).all()
