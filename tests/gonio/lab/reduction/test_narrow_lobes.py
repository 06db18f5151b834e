"""The steepest slope between points: never below the truth of a sum of Gaussians, and near it where steps resolve."""

import math

import numpy as np
import pytest

from gonio.lab.reduction.narrow_lobes import steepest
from gonio.typing import Floats

HALF = math.radians(0.5)


def bound(from_mirror: Floats, values: Floats, u_rel: float = 1e-3, theta_i: float = 0.5) -> Floats:
    return steepest(
        from_mirror,
        values,
        u_rel * values,
        np.full(values.size, theta_i),
        abs(theta_i + from_mirror),
        (HALF, HALF),
        HALF,
    )


def gaussians(x: Floats, *lobes: tuple[float, float]) -> Floats:
    """Height and slope m of each; m = inf is a matte ground."""
    t = 4.0 * np.tan(0.5 * x) ** 2
    return np.asarray(sum(height * np.exp(-t / (4.0 * m**2)) for height, m in lobes))


def slope(x: Floats, *lobes: tuple[float, float]) -> Floats:
    step = 1e-6
    return (gaussians(x + step, *lobes) - gaussians(x - step, *lobes)) / (2.0 * step)


@pytest.mark.parametrize("step_deg", [2.0, 5.0, 12.0])
@pytest.mark.parametrize("start", [0.0, 0.3, 0.5])
@pytest.mark.parametrize(
    "lobes",
    [
        ((5.0, 0.05), (0.05, math.inf)),
        ((20.0, 0.03), (1.0, 0.2), (0.02, math.inf)),
        ((0.3, 0.12), (0.3, math.inf)),
    ],
)
def test_no_sum_of_gaussians_is_steeper_by_what_matters(
    step_deg: float, start: float, lobes: tuple[tuple[float, float], ...]
) -> None:
    x = np.radians((np.arange(-9, 6) + start) * step_deg)
    x = x[abs(x) < 0.9]
    values = gaussians(x, *lobes)
    found = bound(x, values)
    beside = abs(x) > HALF
    # what errors of 0.03 degrees in each arm do more than the bound says: less than half of a noise of 0.5 %
    short = (abs(slope(x, *lobes)) - found) * math.radians(0.03 * math.sqrt(2.0))
    assert np.all(short[beside] < 0.0025 * values[beside])


def test_where_steps_resolve_a_lobe_the_bound_is_near_its_slope() -> None:
    lobes = ((3.0, 0.15), (0.1, math.inf))
    x = np.radians(np.arange(-40.0, 41.0, 2.0))
    found = bound(x, gaussians(x, *lobes), u_rel=1e-5)
    steep = abs(slope(x, *lobes)) > 0.02 * abs(slope(x, *lobes)).max()
    inner = steep & (abs(x) > math.radians(3.0)) & (abs(x) < math.radians(31.0))
    # secants over 2 degrees of a lobe 29 degrees wide; at its top and at its foot there is hardly a slope
    assert np.all(found[inner] < 1.35 * abs(slope(x, *lobes))[inner])


def test_a_matte_sample_has_no_slope_to_speak_of() -> None:
    x = np.radians((np.arange(-8, 5) + 0.5) * 10.0)
    # noise of 0.1 % might be a lobe as narrow as energy allows: errors of 0.03 degrees move that by less than the noise
    assert np.all(bound(x, np.full(x.size, 0.3), u_rel=1e-3) * math.radians(0.03) < 1e-3 * 0.3)


def test_beside_a_peak_between_two_points_energy_is_the_bound() -> None:
    """Nothing nearer to the mirror direction: m such that a Gaussian of this value reflects ten times all light."""
    x = np.radians(np.array([-37.5, -22.5, -7.5, 7.5, 22.5, 37.5]))
    found = bound(x, np.array([0.05, 0.05, 0.5, 0.5, 0.05, 0.05]), u_rel=1e-6)
    t = 4.0 * math.tan(0.5 * x[3]) ** 2
    y = np.linspace(1.0, 20.0, 200_001)
    cosine = min(math.cos(0.5), math.cos(0.5 + x[3]))
    reflected = math.pi * (t / y) * cosine * 0.45 * np.exp(y)  # pi 4 m^2 cos(theta) times the peak
    largest = y[np.searchsorted(reflected, 10.0)]
    # d exp(-t y/t0)/dx = 2 sqrt(t) (1 + t/4) y / t0 of it
    assert found[3] == pytest.approx(0.45 * largest * 2.0 * (1.0 + 0.25 * t) / math.sqrt(t), rel=1e-3)


def test_values_below_the_noise_have_a_bound_too() -> None:
    x = np.radians((np.arange(-8, 5) + 0.5) * 10.0)
    values = np.where(np.arange(x.size) % 2, -1e-4, 2e-4)
    found = steepest(x, values, np.full(x.size, 2e-4), np.full(x.size, 0.5), abs(0.5 + x), (HALF, HALF), HALF)
    assert np.isfinite(found).all()
