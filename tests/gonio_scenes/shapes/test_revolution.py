"""Surfaces of revolution against bisection in their profile, against cylinder and sphere, and smooth ones."""

from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from gonio.typing import Floats
from tests.gonio_scenes.shapes.solids import (
    along,
    check_against_bisection,
    check_frame,
    meet,
    shades_not_itself,
    shape,
    toward,
    units,
)

CENTER = np.array([5.0, 2.0, -9.0])
VASE: list[list[float]] = [[0, 0], [20, 0], [28, 15], [10, 40], [14, 50], [12, 50], [8, 40], [25, 15], [18, 2], [0, 2]]
PROFILES: dict[str, list[list[float]]] = {
    "cone": [[0, -10], [20, -10], [0, 30]],
    "vase with an inside": VASE,
    "turned over": VASE[::-1],
    "ring": [[20, 0], [30, 5], [22, 12], [20, 0]],
    "nearly flat": [[0, 0], [20, 1e-5], [30, 10], [10, 10 + 1e-8], [0, 10]],
    "barely conical": [[0, 0], [20, 0], [20 + 1e-9, 30], [0, 30]],
    "many": [[0, 0], *([10 + 3 * np.sin(k / 10), k / 10] for k in range(400)), [0, 40]],
}


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("axis", [(0, 0, 1), (1.0, -2.0, 0.5)])
def test_frusta_are_met_where_bisection_in_the_profile_says(profile: str, axis: tuple[float, float, float]) -> None:
    points = PROFILES[profile]
    built = shape("revolution", center_mm=CENTER.tolist(), profile_mm=points, axis=axis)
    outline = Outline([*points, points[0]])

    def inside(point: Floats) -> Any:
        height, off = along(point - CENTER, axis)
        return outline.contains_points(np.stack([off.ravel(), height.ravel()], axis=-1)).reshape(off.shape)

    assert built.closed
    middle = CENTER + 20.0 * np.array(axis) / np.linalg.norm(axis)
    check_against_bisection(built, inside, middle, seed=21, count=150, steps=600)
    points_in_space = middle + np.random.default_rng(22).uniform(-30, 30, (200, 3))
    assert [built.contains(point) for point in points_in_space] == inside(points_in_space).tolist()


def test_a_straight_profile_is_a_cylinder_and_caps_close_it() -> None:
    """Two implementations that share no formula: frusta on a tree, and the stretch within bounds."""
    origin, direction = toward(np.random.default_rng(23), 5000, CENTER, 50.0, 100.0)
    axis = [3, 1, 2]
    for caps in (True, False):
        turned = shape("revolution", center_mm=CENTER.tolist(), profile_mm=[[12, -20], [12, 20]], axis=axis, caps=caps)
        plain = shape("cylinder", center_mm=CENTER.tolist(), radius_mm=12.0, height_mm=40.0, axis=axis, caps=caps)
        assert turned.closed == plain.closed == caps
        assert turned.convex == plain.convex == caps
        a, part_a = turned.intersect(origin, direction, 0.0)
        b, part_b = plain.intersect(origin, direction, 0.0)
        np.testing.assert_array_equal(np.isfinite(a), np.isfinite(b))
        hit = np.isfinite(a)
        np.testing.assert_allclose(a[hit], b[hit], rtol=0, atol=1e-10)
        one = turned.surface(origin[hit], direction[hit], a[hit], part_a[hit])
        other = plain.surface(origin[hit], direction[hit], b[hit], part_b[hit])
        np.testing.assert_allclose(one.normal, other.normal, atol=1e-11)


def test_the_outside_is_away_from_the_axis_whichever_way_the_profile_is_written() -> None:
    for profile in ([[10, -20], [15, 20]], [[15, 20], [10, -20]]):
        built = shape("revolution", profile_mm=profile, axis=[0, 0, 1])
        origin, direction = np.array([[50.0, 0.0, 0.0]]), np.array([[-1.0, 0.0, 0.0]])
        _, distance, _, surface = meet(built, origin, direction)
        assert distance[0] == pytest.approx(50.0 - 12.5, rel=1e-15)
        np.testing.assert_allclose(surface.normal[0], np.array([40.0, 0.0, -5.0]) / np.hypot(40, 5), atol=1e-15)


def test_rays_through_the_joints_find_no_gap() -> None:
    built = shape("revolution", profile_mm=VASE, axis=[0, 0, 1])
    rng = np.random.default_rng(24)
    for r, z in VASE[1:4]:
        phi = rng.random(20000) * 2 * np.pi
        goal = np.stack([r * np.cos(phi), r * np.sin(phi), np.full_like(phi, z)], axis=-1) * (1 - 1e-14)
        direction = units(rng, len(phi))
        distance, _ = built.intersect(goal - 200.0 * direction, direction, 0.0)
        assert np.isfinite(distance).all()
        assert np.all(distance <= 200.0 + 1e-9)


def test_shadow_rays_leave_the_facet_that_they_start_on() -> None:
    """From the outside of a convex one every ray outward is free; the surface does not shade itself by rounding."""
    built = shape("revolution", profile_mm=[[0, 0], [20, 0], [30, 15], [10, 40], [0, 40]], axis=[0, 1, 0])
    assert built.convex
    origin, direction = toward(np.random.default_rng(25), 20000, np.array([0.0, 20.0, 0.0]), 60.0, 1e5)
    shades_not_itself(built, np.random.default_rng(26), origin, direction)


def test_convexity_is_that_of_the_profile() -> None:
    assert not shape("revolution", profile_mm=VASE).convex
    assert not shape("revolution", profile_mm=PROFILES["ring"]).convex
    assert not shape("revolution", profile_mm=[[0, 0], [20, 5], [0, -5]]).convex
    assert shape("revolution", profile_mm=[[0, -5], [20, 0], [0, 5]]).convex


SEMICIRCLE = [[40 * np.sin(a), -40 * np.cos(a)] for a in np.linspace(0.0, np.pi, 33)]
SEMICIRCLE[0][0] = SEMICIRCLE[-1][0] = 0.0


def test_a_smooth_profile_through_points_of_a_circle_is_a_sphere() -> None:
    """The spline through 33 points of the spacing h is off the circle by 5 h^4 R / 384 = 5e-5 mm, and its direction by
    h^3 / 24 = 4e-5; the frusta are off the spline by 1e-6 of the size."""
    smooth = shape("revolution", profile_mm=SEMICIRCLE, smooth=True, axis=[0, 1, 0])
    assert smooth.closed
    assert smooth.convex
    origin, direction = toward(np.random.default_rng(27), 20000, np.zeros(3), 66.0, 500.0)
    _, distance, _, surface = meet(smooth, origin, direction)
    assert np.isfinite(distance).all()
    check_frame(surface)
    radius = np.linalg.norm(surface.position, axis=1)
    assert np.abs(radius - 40.0).max() < 5e-5 + 1e-6 * smooth.size_mm
    out = surface.position / radius[:, np.newaxis]
    assert np.linalg.norm(surface.shading - out, axis=1).max() < 6e-5  # half of it for what is of higher order
    assert np.linalg.norm(surface.normal - out, axis=1).max() > 1e-3, "frusta alone would not be smooth"


def test_a_smooth_profile_goes_through_its_points_and_is_level_at_the_axis() -> None:
    profile = [[0, 0], [22, 4], [28, 15], [10, 40], [14, 50]]
    built = shape("revolution", profile_mm=profile, smooth=True, axis=[0, 0, 1])
    for r, z in profile[1:-1]:
        origin, direction = np.array([[100.0, 0.0, z]]), np.array([[-1.0, 0.0, 0.0]])
        distance, _ = built.intersect(origin, direction, 0.0)
        assert 100.0 - distance[0] == pytest.approx(r, abs=1e-9)
    origin, direction = np.array([[1e-9, 0.0, -50.0]]), np.array([[0.0, 0.0, 1.0]])
    distance, part = built.intersect(origin, direction, 0.0)
    assert distance[0] == pytest.approx(50.0, abs=1e-9)
    np.testing.assert_allclose(built.surface(origin, direction, distance, part).shading[0], [0, 0, -1], atol=1e-8)


def test_v_runs_along_the_profile_by_length() -> None:
    built = shape("revolution", profile_mm=[[10, 0], [10, 30], [20, 30]], axis=[0, 0, 1], x_axis=[1, 0, 0])
    origin = np.array([[0.0, 50.0, 15.0], [-15.0, 0.0, 90.0]])
    direction = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(meet(built, origin, direction)[-1].uv, [[0.25, 15 / 40], [0.5, 35 / 40]], atol=1e-15)
