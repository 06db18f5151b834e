"""Parts of the check by drawing: variances and derivatives that formulas give."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from gonio.geometry import Directions
from gonio.lab.reduction import monte_carlo
from gonio.lab.rig import Pose
from gonio.lab.rig.description import Holder
from gonio.typing import Floats
from tests.gonio.numpy_rig import describe

DRAWS = 40_000
SCATTER = 5.0 / math.sqrt(2.0 * DRAWS)
"""Five standard deviations of a standard deviation."""


def inputs(**values: Any) -> monte_carlo._Inputs:
    """Some of the inputs of a band, without a run."""
    out = object.__new__(monte_carlo._Inputs)
    for name, value in values.items():
        setattr(out, name, value)
    return out


@pytest.mark.parametrize("shared", [0.0, 30.0, 100.0])
def test_responsivities_of_shared_pixels_cancel(shared: float) -> None:
    """Two means over n and m pixels, s of which are the same: prnu^2 (1/n + 1/m - 2 s / (n m))."""
    prnu, n, m = 0.01, 100.0, 250
    of = inputs(_prnu=prnu, _pixels=np.array([n]), _shared=np.array([shared]), _visits=[SimpleNamespace(pixels=m)])
    found = of._gains(np.random.default_rng(1), DRAWS)[:, 0]
    expected = prnu * math.sqrt(1.0 / n + 1.0 / m - 2.0 * shared / (n * m))
    assert np.std(found) == pytest.approx(expected, rel=SCATTER)
    assert np.mean(found) == pytest.approx(1.0, abs=5.0 * expected / math.sqrt(DRAWS))


def test_readings_lie_evenly_in_a_step_and_tremble() -> None:
    of = inputs(_steps=np.array([0.1, 0.0]), _trembles=np.array([0.0, 0.0]))
    found = of._readings(np.random.default_rng(2), (DRAWS, 1, 2))[:, 0]
    assert abs(found[:, 0]).max() <= 0.05
    assert np.std(found[:, 0]) == pytest.approx(0.1 / math.sqrt(12.0), rel=SCATTER)
    assert not found[:, 1].any()
    of = inputs(_steps=np.array([0.1, 0.0]), _trembles=np.array([0.04, 0.02]))
    found = of._readings(np.random.default_rng(3), (DRAWS, 1, 2))[:, 0]
    np.testing.assert_allclose(found.std(axis=0), [math.hypot(0.1 / math.sqrt(12.0), 0.04), 0.02], rtol=SCATTER)


class Level:
    """A straight line, as it was fitted."""

    def __init__(self, level: float, slope: float, *, unknown: bool) -> None:
        self.level, self.slope, self.unknown = level, slope, unknown

    def line(self, times: Any) -> Any:
        return self.level + self.slope * np.asarray(times)

    at = line


TIMES = np.array([0.0, 10.0, 30.0])


def visited(level: Level, rel: float, theta: float = 0.0, step: float = 0.0) -> monte_carlo._Inputs:
    """Three visits of one uncertainty; an axis whose angle is that of the light."""
    return inputs(
        _level=level, _visits=[None] * 3, _visit_theta=np.full(3, theta), _visit_turns=np.ones((3, 1)),
        _visit_times=TIMES, _visit_rel=np.full(3, rel), _steps=np.array([step]), _trembles=np.zeros(1),
        _times=np.array([5.0, 60.0]),
    )  # fmt: skip


def test_a_level_scatters_as_a_fitted_line_does() -> None:
    """sigma^2 (1/n + (t - mean)^2 / sum of squares), beyond the visits too."""
    of = visited(Level(100.0, 0.0, unknown=False), 0.01)
    found = of._levels(np.random.default_rng(4), DRAWS, np.zeros((DRAWS, 1)))
    away = TIMES - TIMES.mean()
    expected = [math.sqrt(1.0 / 3.0 + (t - TIMES.mean()) ** 2 / np.sum(away**2)) for t in (5.0, 60.0)]
    np.testing.assert_allclose(found.std(axis=0), expected, rtol=SCATTER)
    np.testing.assert_allclose(found.mean(axis=0), 100.0, rtol=1e-3)


def test_a_level_that_is_taken_as_constant_scatters_as_a_mean() -> None:
    of = visited(Level(100.0, 0.0, unknown=True), 0.01)
    found = of._levels(np.random.default_rng(5), DRAWS, np.zeros((DRAWS, 1)))
    np.testing.assert_allclose(found.std(axis=0), 1.0 / math.sqrt(3.0), rtol=SCATTER)
    assert (found[:, 0] == found[:, 1]).all()


def test_zeros_change_the_light_of_all_visits_alike() -> None:
    """A light that truly stands 0.01 rad further gives less: what was read is the signal over cos(60 deg + 0.01)."""
    of = visited(Level(100.0, 0.0, unknown=False), 0.0, theta=math.radians(60.0), step=1e-9)
    found = of._levels(np.random.default_rng(6), 2, np.array([[0.01], [-0.01]]))
    expected = [100.0 * 0.5 / math.cos(math.radians(60.0) + by) for by in (0.01, -0.01)]
    np.testing.assert_allclose(found, np.repeat(np.array(expected)[:, None], 2, axis=1), rtol=1e-7)


# ---- directions ----


@pytest.mark.parametrize(
    ("axis", "theta_i", "theta_r"), [("light", 1.0, 0.0), ("camera", 0.0, -1.0), ("spin", 0.0, 0.0)]
)
def test_angles_follow_the_axes(axis: str, theta_i: float, theta_r: float) -> None:
    """In plane the arms are the angles themselves; on the mirror side the camera stands at -theta_r."""
    description, pose = describe(holder=Holder(axes=("tilt", "spin"))), Pose(light=0.5, camera=-0.7)

    def both(d: Directions) -> Any:
        return np.array([d.theta_i, d.theta_r], dtype=float)

    np.testing.assert_allclose(monte_carlo._by_axis(description, pose, axis, both), [theta_i, theta_r], atol=1e-9)


def test_at_the_normal_the_light_of_a_visit_does_not_change() -> None:
    description = describe()
    for theta, slope in ((0.0, 0.0), (0.5, 1.0)):
        visit = cast(Any, SimpleNamespace(pose=Pose(light=theta), directions=SimpleNamespace(theta_i=theta)))
        assert monte_carlo._turn_of("theta_i", description, visit, "light") == pytest.approx(slope, abs=1e-9)


@pytest.mark.parametrize("azimuth", [0.0, 0.4, math.pi, 5.0])
def test_planes_of_incidence_are_turned_so_that_the_source_lies_at_pi(azimuth: float) -> None:
    source = np.array([math.cos(azimuth), math.sin(azimuth), 0.3])
    np.testing.assert_allclose(source @ monte_carlo._along_x(azimuth), [-1.0, 0.0, 0.3], atol=1e-12)


def test_curves_go_through_their_points_and_need_four_that_are_apart() -> None:
    goals = Directions.stack([Directions(0.5, 0.0, r, math.pi) for r in (0.3, 0.4, 0.5, 0.6)])
    place = np.array([[r, 0.0, 0.5, 0.0] for r in (0.3, 0.4, 0.5, 0.6)])
    log = np.array([1.0, 2.0, 4.0, 8.0])
    for k, curve in enumerate(monte_carlo._curves(goals, place, log)):
        assert curve is not None
        np.testing.assert_allclose(curve(place[:, 0] - 0.5), log, rtol=1e-12)
        assert k < 4
    assert monte_carlo._curves(goals[:3], place[:3], log[:3]) == [None] * 3
    aside = place.copy()
    aside[1, 1] = 0.2
    assert monte_carlo._curves(goals, aside, log) == [None] * 4, "three are left in the plane"
    near = place.copy()
    near[1, 0] = near[0, 0] + 1e-9
    assert monte_carlo._curves(goals, near, log) == [None] * 4


def lobe(curve: Callable[[Floats], Floats], slope: list[float]) -> monte_carlo._Inputs:
    """Of one point at theta_r = 0.5 and theta_i = 0.3 with a BRDF of 2 sinh(1) and no doubt of its slopes."""
    return inputs(
        _lobes=SimpleNamespace(slope=np.array([slope]), spike=np.zeros(1), u_spike=np.zeros(1)), _curves=[curve],
        _place=np.array([[0.5, 0.0, 0.3, 0.0]]), _size=np.ones(1), _doubts=np.zeros((1, 4, 4)), _small=2.0,
        _log=np.ones(1), _near=np.zeros(1, bool), _under=False,
    )  # fmt: skip


@pytest.mark.parametrize(("dx", "di"), [(0.1, 0.0), (0.1, 0.1), (0.05, -0.1)])
def test_a_lobe_moves_along_its_curve_by_what_the_view_moves_from_the_mirror(dx: float, di: float) -> None:
    """The curve is of theta_r - theta_i; what its slope does not say of theta_i comes on top, linearly."""
    slope = [0.8, 0.0, -0.5, 0.0]  # of the logarithm; a curve of the slope 0.8 would have -0.8
    moved = np.array([[[dx, 0.0, di, 0.0]]])
    change = lobe(lambda x: 3.0 * x**2, slope)._changes(np.random.default_rng(1), moved)[0, 0]
    along = dx - di
    log = 3.0 * ((0.2 + along) ** 2 - 0.2**2) + 0.8 * dx - 0.5 * di - 0.8 * along
    expected = 2.0 * math.sinh(1.0 + log) * math.cos(0.3 + di) / math.cos(0.3) - 2.0 * math.sinh(1.0)
    assert change == pytest.approx(expected, rel=1e-12)  # roundings of the formula itself
