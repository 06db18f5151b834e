"""The white reference: its level over time, and its BRDF from a table."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gonio.geometry import Directions
from gonio.lab.reduction import white_reference
from gonio.lab.reduction.growing import of_rates
from gonio.lab.rig import Pose
from tests.gonio.lab.reduction.made_run import BAND, describe

RNG = np.random.default_rng(7)


def test_a_straight_level_is_recovered_with_its_covariance() -> None:
    """Generalised least squares written out with matrices, in the time since the start instead of the centre."""
    times = np.array([0.0, 100.0, 250.0, 400.0, 900.0])
    variances = np.array([1.0, 4.0, 2.0, 1.0, 3.0])
    values = 500.0 - 0.03 * times + np.array([0.3, -0.5, 0.2, 0.1, -0.4])
    fitted = white_reference.fit(times, values, variances)
    design = np.stack([np.ones(5), times], axis=1)
    covariance = np.linalg.inv(design.T @ np.diag(1 / variances) @ design)
    parameters = covariance @ design.T @ (values / variances)
    at = np.array([-50.0, 333.0, 1000.0])
    rows = np.stack([np.ones(3), at], axis=1)
    assert fitted.straight
    np.testing.assert_allclose(fitted.at(at), rows @ parameters, rtol=1e-12)
    variance = np.einsum("ti,ij,tj->t", rows, covariance, rows)
    np.testing.assert_allclose(fitted.noise(at) ** 2 + fitted.drift(at) ** 2, variance, rtol=1e-10)
    assert fitted.drift(at)[0] < 0 < fitted.drift(at)[2]
    # five visits do not tell that a lamp never wanders; outside of them least
    assert np.all(fitted.wander(at).u[:2] < 1.2 * np.sqrt(variance)[:2])


def test_values_of_a_growing_run_are_rates_over_the_level_of_its_visits() -> None:
    times, rates = np.array([0.0, 300.0, 700.0]), np.array([900.0, 800.0, 850.0])
    at = Directions(*np.radians([0.0, 0.0, 45.0, 180.0]))
    visits = [
        SimpleNamespace(rate=rate, time_s=t, variance=2.0, directions=at, pose=Pose())
        for t, rate in zip(times, rates, strict=True)
    ]
    run: Any = SimpleNamespace(description=describe(reference={"albedo": 0.5, "u_rel": 0.01}), lit_anew_s=[])
    known = 0.5 / math.pi
    fitted = white_reference.fit(times, rates / known, np.full(3, 2.0) / known**2)
    rate, when = np.array([100.0, 200.0]), np.array([100.0, 500.0])
    found = of_rates(run, rate, when, Directions.stack([at, at]), cast(Any, visits), BAND)
    np.testing.assert_allclose(found.brdf, rate / fitted.at(when), rtol=1e-14)
    np.testing.assert_allclose(found.u_visits, rate * fitted.wander(when).u / fitted.at(when) ** 2, rtol=1e-12)
    np.testing.assert_allclose(found.common["s_reference"], 0.01 * found.brdf, rtol=1e-14)


def test_levels_that_are_straight_are_seldom_called_crooked() -> None:
    """1 % of them, by the test's own level: at most 10 of 300 with a chance of 1e-3."""
    times = np.linspace(0.0, 500.0, 6)
    levels = [np.array([100 + float(RNG.normal()) for _ in times], dtype=np.float64) for _ in range(300)]
    assert sum(not white_reference.fit(times, level, np.ones(6)).straight for level in levels) <= 10


def test_a_crooked_level_is_interpolated() -> None:
    """What it may depart by in between: `tests/gonio/lab/reduction/test_lamp_wander.py`."""
    times, values = np.array([0.0, 100.0, 200.0, 300.0]), np.array([100.0, 110.0, 90.0, 100.0])
    fitted = white_reference.fit(times, values, np.full(4, 0.01))
    assert not fitted.straight
    at = np.array([-10.0, 0.0, 150.0, 200.0, 400.0])
    np.testing.assert_allclose(fitted.at(at), [100.0, 100.0, 100.0, 90.0, 100.0], rtol=1e-12)
    # halfway it may be off by 14 from one visit to the next, and more: these are the root mean square of three changes
    assert np.all(fitted.wander(at).u[[1, 3]] < 0.5)
    assert fitted.wander(at).u[2] > 0.5 * 14.0


def test_a_jump_between_two_visits_is_in_the_uncertainty_of_all_points_between_them() -> None:
    """A lamp that falls by 5 % at an unknown time: just where the straight line through all crosses the steps."""
    times = np.arange(0.0, 700.0, 100.0)
    fitted = white_reference.fit(times, np.where(times < 350.0, 100.0, 95.0), np.full(7, 1e-4))
    at = np.array([305.0, 330.0, 350.0, 370.0, 395.0])
    u = np.sqrt(fitted.noise(at) ** 2 + fitted.drift(at) ** 2 + fitted.wander(at).u ** 2)
    for jump in (310.0, 340.0, 360.0, 390.0):
        true = np.where(at < jump, 100.0, 95.0)
        # at the fraction x of the interval the error is x or 1 - x of the jump: at most 2 u where x (1 - x) > 0.16
        assert np.all(abs(fitted.at(at) - true)[1:4] < 2.0 * u[1:4])
    assert np.all(u[1:4] > 0.4 * 5.0)
    assert np.all(fitted.wander(np.array([50.0, 650.0])).u < 0.02)  # far from it nothing is added


def test_a_warm_up_between_visits_is_no_jump() -> None:
    """Ten visits within three time constants of an exponential of 2 %: interpolated to 0.1 %, with u of its size."""
    times = np.linspace(0.0, 1800.0, 10)
    fitted = white_reference.fit(times, 100.0 - 2.0 * np.exp(-times / 600.0), np.full(10, 1e-4))
    assert not fitted.straight
    at = np.linspace(0.0, 1800.0, 200)
    error = abs(fitted.at(at) - (100.0 - 2.0 * np.exp(-at / 600.0)))
    assert np.all(error < 2.0 * np.sqrt(fitted.noise(at) ** 2 + fitted.drift(at) ** 2 + fitted.wander(at).u ** 2))
    assert np.all(fitted.wander(at).u < 0.1)


@pytest.mark.parametrize("count", [1, 2])
def test_few_visits(count: int) -> None:
    times, values = np.array([50.0, 150.0])[:count], np.array([10.0, 12.0])[:count]
    fitted = white_reference.fit(times, values, np.full(count, 0.04))
    assert fitted.straight
    np.testing.assert_allclose(fitted.at(times), values, rtol=1e-12)  # a line through two points: rounding
    at = np.array([250.0])
    expected = 0.2 if count == 1 else math.hypot(0.2 / math.sqrt(2), 0.2 * math.sqrt(2) / 100 * 150)
    assert math.hypot(float(fitted.noise(at)[0]), float(fitted.drift(at)[0])) == pytest.approx(expected, rel=1e-9)


# weights 1 / variance lose a digit on the way back: 1e-13
@pytest.mark.parametrize("seed", range(4))
def test_one_visit_tells_no_drift_whatever_its_numbers(seed: int) -> None:
    """Times since the start of the run and since 1970, levels and noise over many decades."""
    rng = np.random.default_rng(seed)
    for _ in range(500):
        time = rng.choice([0.0, 1.9e9]) + rng.uniform(0, 1e4)
        value, relative = 10 ** rng.uniform(-3, 9), 10 ** rng.uniform(-6, -1)
        fitted = white_reference.fit(np.array([time]), np.array([value]), np.array([(relative * value) ** 2]))
        at = time + np.array([-1e5, 0.0, 60.0, 1e6])
        np.testing.assert_array_equal(fitted.at(at), value)
        np.testing.assert_array_equal(fitted.drift(at), 0.0)
        np.testing.assert_allclose(fitted.noise(at), relative * value, rtol=1e-13)
        assert "one measurement" in fitted.unknown


@pytest.mark.parametrize("start", [0.0, 1.9e9])
@pytest.mark.parametrize("apart", [0.0, 3e-7])
def test_visits_at_one_time_are_averaged_and_tell_no_drift(start: float, apart: float) -> None:
    """Of a rig that stamped none, or all alike; two doubles since 1970 are no closer than 2.4e-7 s."""
    times, values = np.array([start, start + apart, start + 2 * apart]), np.array([10.0, 10.3, 9.9])
    fitted = white_reference.fit(times, values, np.array([0.04, 0.01, 0.04]), np.array([start, start + 600.0]))
    assert (fitted.slope, fitted.u_slope, fitted.straight) == (0.0, 0.0, True)
    assert fitted.level == pytest.approx((10.0 / 0.04 + 10.3 / 0.01 + 9.9 / 0.04) / 150, rel=1e-12)
    assert fitted.u_level == pytest.approx(150**-0.5, rel=1e-12)
    (note,) = white_reference.notes(fitted, 3, [])
    assert note.startswith("the 3 measurements of the white reference have one and the same time")
    assert note.endswith("a drift of the lamp is not in u_brdf")


def test_visits_at_one_time_that_differ_beyond_noise_widen_their_mean() -> None:
    fitted = white_reference.fit(np.zeros(4), np.array([9.0, 11.0, 9.0, 11.0]), np.full(4, 0.01))
    # standard error of the mean of four values that scatter by sqrt(4/3)
    assert fitted.u_level == pytest.approx(math.sqrt(4 / 3 / 4), rel=1e-12)
    # a point's level differs from the mean as those of the visits do, less the noise of a visit
    np.testing.assert_allclose(fitted.wander(np.array([0.0, 60.0])).u, math.sqrt(4 / 3 - 0.01), rtol=1e-12)


def test_two_of_three_visits_at_one_time_are_one_end_of_the_line() -> None:
    times, values = np.array([0.0, 0.0, 100.0]), np.array([10.0, 10.2, 11.1])
    fitted = white_reference.fit(times, values, np.full(3, 0.04))
    assert not fitted.unknown
    np.testing.assert_allclose(fitted.at(np.array([0.0, 100.0])), [10.1, 11.1], rtol=1e-12)  # rounding of a line
    assert fitted.u_slope == pytest.approx(math.sqrt(0.02 + 0.04) / 100, rel=1e-12)


def test_crooked_visits_of_which_two_are_at_one_time() -> None:
    times, values = np.array([0.0, 100.0, 100.0, 200.0]), np.array([100.0, 120.0, 120.02, 100.0])
    fitted = white_reference.fit(times, values, np.full(4, 0.01))
    assert not fitted.straight
    np.testing.assert_allclose(fitted.at(np.array([50.0, 100.0])), [110.005, 120.01], rtol=1e-12)
    assert np.all(np.isfinite(fitted.wander(np.array([0.0, 50.0, 100.0, 300.0])).u))


@pytest.mark.parametrize(
    ("times", "values"),
    [
        ([0.0, 2.0], [1000.0, 1001.0]),  # noise, drawn out to half of the level
        ([0.0, 60.0], [1000.0, 980.0]),  # warming up: the line leads below zero
        ([0.0, 1.0, 2.0], [1000.0, 1030.0, 990.0]),  # crooked
    ],
)
def test_visits_close_together_say_nothing_of_points_far_away(times: list[float], values: list[float]) -> None:
    at = np.array([1.0, 3600.0])
    fitted = white_reference.fit(np.array(times), np.array(values), np.ones(len(times)), at)
    np.testing.assert_allclose(fitted.at(at), np.mean(values), rtol=1e-12)
    np.testing.assert_array_equal(fitted.drift(at), 0.0)
    assert fitted.u_level >= len(times) ** -0.5 * (1 - 1e-12)
    (note,) = white_reference.notes(fitted, len(times), [])
    assert f"lie within {times[-1]:g} s" in note
    assert f"points up to {3600 - times[-1]:.3g} s away" in note


def test_a_line_is_kept_where_it_changes_little_or_the_points_are_near() -> None:
    far = white_reference.fit(np.array([0.0, 60.0]), np.array([1000.0, 1000.5]), np.full(2, 0.01), np.array([600.0]))
    assert far.slope == pytest.approx(0.5 / 60, rel=1e-9)
    noisy = white_reference.fit(np.array([0.0, 60.0]), np.array([1000.0, 1400.0]), np.full(2, 4e4), np.array([110.0]))
    assert noisy.slope == pytest.approx(400 / 60, rel=1e-9)
