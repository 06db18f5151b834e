"""A lamp that walks at random between the visits to the white reference, and lamps that do not."""

import math

import numpy as np
import pytest

from gonio.lab.reduction import white_reference
from gonio.lab.reduction.lamp_wander import BLOCK
from gonio.typing import Floats

NOISE = 5e-4
EVERY_S = 300.0


def lamp(rng: np.random.Generator, kind: str, size: float, count: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Times and values of visits, times between them, and the true level there."""
    visits = EVERY_S * np.arange(float(count))
    at = EVERY_S * np.arange(0.5 / 6, count - 1, 1.0 / 6)
    every = np.sort(np.concatenate([visits, at]))
    level = np.asarray(1.0 + size * every / EVERY_S)
    if kind == "walk":
        level = 1.0 + np.cumsum(size * np.sqrt(np.diff(every, prepend=0.0) / EVERY_S) * rng.standard_normal(every.size))
    seen = np.asarray(np.interp(visits, every, level) * (1.0 + NOISE * rng.standard_normal(count)))
    return visits, seen, at, np.interp(at, every, level)


def drawn(kind: str, size: float, visits: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pulls of the level, chi-square over n of its whole covariance, and u over that of the line, each by lamp."""
    rng = np.random.default_rng(seed)
    pulls, chi_squares, wider = [], [], []
    for _ in range(count):
        times, seen, at, true = lamp(rng, kind, size, visits)
        fitted = white_reference.fit(times, seen, (NOISE * seen) ** 2, at)
        found, noise = fitted.wander(at), np.stack([fitted.noise(at), fitted.drift(at)])
        line = np.sqrt(np.sum(noise**2, axis=0))
        u = np.hypot(line, found.u)
        pulls.append((fitted.at(at) - true) / u)
        wider.append(np.median(u / line))
        own = 5e-3  # independent noise of the values, as frames of "sim" have it
        rest = found.u**2 - np.sum(found.shared**2, axis=1)
        assert rest.min() > -1e-12  # shared is a part of it; rounding
        covariance = np.diag(np.maximum(rest, 0.0) + own**2) + found.shared @ found.shared.T + noise.T @ noise
        off = fitted.at(at) - true + own * rng.standard_normal(at.size)
        chi_squares.append(off @ np.linalg.solve(covariance, off) / at.size)
    return np.array(pulls), np.array(chi_squares), np.array(wider)


@pytest.mark.slow
@pytest.mark.parametrize("visits", [3, 5, 12])
def test_a_lamp_that_walks_is_within_its_uncertainty(visits: int) -> None:
    """Before, 95 % intervals held 70 to 87 %, and pulls of the level had a root mean square of up to 5.6.

    40 lamps of each strength: what they hold scatters by 3 %, since the points of an interval go together.
    """
    found = [drawn("walk", size, visits, 40, seed) for seed, size in enumerate((5e-4, 5e-3, 2e-2))]
    held = [float(np.mean(abs(pulls) <= 1.96)) for pulls, *_ in found]
    assert 0.9 < np.mean(held) < 0.99
    assert min(held) > 0.86
    # most of it is the noise of the values, known to 3 %; lamps that happen to look smooth add a tenth
    assert np.mean([chi_squares for _, chi_squares, _ in found[:2]]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize(("visits", "most", "size"), [(4, 1.6, 0.0), (5, 1.45, 2e-3), (8, 1.4, 0.0), (12, 1.4, 2e-3)])
def test_a_lamp_that_drifts_steadily_is_known_nearly_as_well_as_its_line(visits: int, most: float, size: float) -> None:
    pulls, _, wider = drawn("line", size, visits, 30, 5)
    assert np.median(wider) < most
    assert np.mean(abs(pulls) <= 1.96) > 0.95


def test_between_visits_without_noise_u_is_that_of_a_brownian_bridge() -> None:
    """At the fraction x of an interval sqrt(x (1 - x)) of the change between visits, which 30 of them tell to 13 %."""
    rng, sigma = np.random.default_rng(3), 0.004
    times = np.arange(0.0, 300.0 * (BLOCK - 2), 300.0)
    values = 1.0 + np.cumsum(sigma * rng.standard_normal(times.size))
    fitted = white_reference.fit(times, values, np.full(times.size, 1e-12))
    x = np.array([0.1, 0.3, 0.5, 0.8])
    told = float(np.std(np.diff(values)))
    for k in (2, 14, 25):
        over = fitted.wander(times[k] + 300.0 * x).u / (told * np.sqrt(x * (1.0 - x)))
        # more where the cubics depart from the straight lines, which are likeliest
        assert np.all((over > 0.85) & (over < 1.6))


@pytest.mark.slow
@pytest.mark.parametrize("visits", [BLOCK + 1, 70])
def test_many_visits_are_looked_at_in_parts(visits: int) -> None:
    pulls, _, _ = drawn("walk", 2e-3, visits, 10, 7)
    assert 0.92 < np.mean(abs(pulls) <= 1.96) < 0.99  # 300 intervals and more: 1 %
    assert np.all(np.isfinite(pulls))


def test_errors_of_neighbouring_points_go_together() -> None:
    """The part that an interval's points share is most of what the lamp does there."""
    times, seen, at, _ = lamp(np.random.default_rng(2), "walk", 5e-3, 5)
    found = white_reference.fit(times, seen, (NOISE * seen) ** 2, at).wander(at)
    covariance = found.shared @ found.shared.T
    # the fractions 5/12 and 7/12 of an interval: correlation of a bridge 5/7
    assert covariance[2, 3] / math.sqrt(covariance[2, 2] * covariance[3, 3]) == pytest.approx(5 / 7, abs=0.15)
    assert abs(covariance[2, 14]) < 0.3 * covariance[2, 2]
    assert np.sum(np.diag(covariance)) > 0.8 * np.sum(found.u**2)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_visits_say_nothing(count: int) -> None:
    times = np.arange(0.0, 100.0 * count, 100.0)
    found = white_reference.fit(times, np.full(count, 10.0), np.ones(count)).wander(np.array([20.0, 60.0]))
    np.testing.assert_array_equal(found.u, 0.0)
    assert found.shared.shape == (2, 0)
