"""Planes, discs, spheres, cylinders and boxes: distances, normals and uv against formulas that are not theirs."""

import itertools
from typing import Any

import mpmath
import numpy as np
import pytest
from gonio_scenes.shapes import Shape

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

CENTER = np.array([12.0, -7.0, 31.0])
AXES = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1.0, -2.0, 0.5)]

EVERY: list[tuple[str, dict[str, Any]]] = [
    ("plane", {"normal": [1, 2, 3]}),
    ("plane", {"normal": [1, 2, 3], "size_mm": [30, 50]}),
    ("disc", {"normal": [1, 2, 3], "radius_mm": 30}),
    ("sphere", {"axis": [1, 2, 3], "radius_mm": 30}),
    ("cylinder", {"axis": [1, 2, 3], "radius_mm": 20, "height_mm": 50}),
    ("cylinder", {"axis": [1, 2, 3], "radius_mm": 20, "height_mm": 50, "caps": False}),
    ("box", {"axis": [1, 2, 3], "size_mm": [30, 40, 50]}),
    ("revolution", {"axis": [1, 2, 3], "profile_mm": [[20, -30], [35, 0], [10, 20], [15, 30]]}),
]


def in_sphere(point: Floats, axis: Any) -> Any:
    return np.linalg.norm(point - CENTER, axis=-1) < 12.0


def in_cylinder(point: Floats, axis: Any) -> Any:
    height, off = along(point - CENTER, axis)
    return (off < 12.0) & (np.abs(height) < 17.0)


SOLIDS = [(kind, keys) for kind, keys in EVERY if kind in ("sphere", "cylinder", "box") and keys.get("caps", True)]


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize(
    ("kind", "keys", "inside"), [("sphere", {}, in_sphere), ("cylinder", {"height_mm": 34.0}, in_cylinder)]
)
def test_round_solids_are_met_where_bisection_says(kind: str, keys: Any, inside: Any, axis: Any) -> None:
    built = shape(kind, center_mm=CENTER.tolist(), radius_mm=12.0, axis=axis, **keys)
    check_against_bisection(built, lambda point: inside(point, axis), CENTER, seed=1)


def test_box_is_met_where_bisection_says() -> None:
    x, z = np.array([2.0, 1.0, 0.0]) / np.sqrt(5.0), np.array([1.0, -2.0, 2.0]) / 3.0
    y = np.cross(z, x)
    built = shape("box", center_mm=CENTER.tolist(), size_mm=[10, 20, 30], axis=z.tolist(), x_axis=[2, 1, 0])

    def inside(point: Floats) -> Any:
        return np.all([np.abs((point - CENTER) @ e) < h for e, h in ((x, 5.0), (y, 10.0), (z, 15.0))], axis=0)

    check_against_bisection(built, inside, CENTER, seed=3)


def test_sphere_from_a_kilometre_keeps_nine_digits_of_its_size() -> None:
    """Against the quadratic in 40 digits, for the rays exactly as float64 has them."""
    rng = np.random.default_rng(4)
    built = shape("sphere", center_mm=[3, 4, 5], radius_mm=40.0)
    origin, direction = toward(rng, 200, np.array([3.0, 4.0, 5.0]), 60.0, 1e6)
    distance, primitive = built.intersect(origin, direction, 0.0)
    position = built.surface(origin, direction, distance, primitive).position
    assert np.all(np.isfinite(distance))
    with mpmath.workdps(40):
        for o, d, t, p in zip(origin, direction, distance, position, strict=True):
            oc = [mpmath.mpf(float(a)) - b for a, b in zip(o, (3, 4, 5), strict=True)]
            v = [mpmath.mpf(float(a)) for a in d]
            a, b, c = mpmath.fdot(v, v), mpmath.fdot(oc, v), mpmath.fdot(oc, oc) - 1600
            exact = (-b - mpmath.sqrt(b * b - a * c)) / a
            assert abs(float(exact - t)) < 80e-9  # 1e-9 of the size; a rounding of 1e6 is 1.2e-10
            for k in range(3):
                assert abs(float(oc[k] + exact * v[k] + (3, 4, 5)[k] - mpmath.mpf(float(p[k])))) < 80e-9


@pytest.mark.parametrize(("kind", "keys"), EVERY)
def test_hits_from_a_kilometre_lie_on_the_ray(kind: str, keys: dict[str, Any]) -> None:
    """The position, which is on the shape, is off the ray by less than 1e-9 of the size, in 40 digits."""
    built = shape(kind, center_mm=CENTER.tolist(), **keys)
    origin, direction = toward(np.random.default_rng(12), 150, CENTER, 60.0, 1e6)
    distance, primitive = built.intersect(origin, direction, 0.0)
    hit = np.isfinite(distance)
    assert hit.sum() > 30
    position = built.surface(origin[hit], direction[hit], distance[hit], primitive[hit]).position
    with mpmath.workdps(40):
        for o, d, t, p in zip(origin[hit], direction[hit], distance[hit], position, strict=True):
            v = mpmath.matrix(d.tolist())
            to = mpmath.matrix(p.tolist()) - mpmath.matrix(o.tolist())
            along_ray = (to.T * v)[0] / (v.T * v)[0]
            assert float(mpmath.norm(to - along_ray * v)) < 1e-9 * built.size_mm
            assert abs(float(along_ray - t)) < 1e-9 * 60.0


@pytest.mark.parametrize("off", [1e-3, 1e-6, 1e-9, 1e-12])
def test_grazing_rays_meet_a_sphere_just_inside_its_limb_and_miss_just_outside(off: float) -> None:
    """At r (1 - off) from the centre the ray is inside for r sqrt(2 off - off^2) on either side."""
    built = shape("sphere", radius_mm=10.0)
    origin = np.array([[10.0 * (1 - off), 0.0, 50.0], [10.0 * (1 + off), 0.0, 50.0]])
    distance, _ = built.intersect(origin, np.array([[0.0, 0.0, -1.0]] * 2), 0.0)
    x = mpmath.mpf(float(origin[0, 0]))
    half = float(mpmath.sqrt(100 - x * x))
    # a rounding of x moves the hit by x / half times as much
    assert distance[0] == pytest.approx(50.0 - half, rel=0, abs=4 * 2e-15 * 10.0 / half + 2e-14)
    assert distance[1] == np.inf


@pytest.mark.parametrize(("kind", "keys"), EVERY)
def test_a_ray_finds_all_crossings_in_turn_and_back_again(kind: str, keys: dict[str, Any]) -> None:
    """The same crossings from either end: solids an even number, and `nearest` leaves out those before it."""
    built = shape(kind, center_mm=CENTER.tolist(), **keys)
    origin, direction = toward(np.random.default_rng(5), 500, CENTER, 60.0, 200.0)
    for o, d in zip(origin, direction, strict=True):
        there = crossings(built, o, d)
        back = crossings(built, o + 400.0 * d, -d)
        # 1e-9 mm beside sizes of 60 mm; near the limb a crossing moves more than the ray does
        np.testing.assert_allclose(there, 400.0 - np.array(back[::-1]), rtol=0, atol=1e-6)
        if built.closed:
            assert len(there) % 2 == 0


def crossings(built: Shape, origin: Floats, direction: Floats) -> list[float]:
    """All distances below 400 at which a ray meets a shape."""
    out: list[float] = []
    while True:
        distance, _ = built.intersect(origin[np.newaxis], direction[np.newaxis], out[-1] + 1e-9 if out else 0.0)
        if not distance[0] < 400.0:
            return out
        out.append(float(distance[0]))


@pytest.mark.parametrize(("kind", "keys"), EVERY)
def test_a_hit_at_nearest_does_not_count(kind: str, keys: dict[str, Any]) -> None:
    built = shape(kind, center_mm=CENTER.tolist(), **keys)
    origin, direction = toward(np.random.default_rng(6), 50, CENTER, 30.0, 100.0)
    distance, _ = built.intersect(origin, direction, 0.0)
    for k in np.flatnonzero(np.isfinite(distance)):
        again, _ = built.intersect(origin[k : k + 1], direction[k : k + 1], distance[k])
        assert again[0] > distance[k]
        before, _ = built.intersect(origin[k : k + 1], direction[k : k + 1], np.nextafter(distance[k], 0.0))
        assert before[0] == distance[k]


@pytest.mark.parametrize(("kind", "keys"), SOLIDS)
def test_no_shadow_of_its_own_falls_on_the_outside_of_a_solid(kind: str, keys: dict[str, Any]) -> None:
    built = shape(kind, center_mm=CENTER.tolist(), **keys)
    rng = np.random.default_rng(7)
    shades_not_itself(built, rng, *toward(rng, 20000, CENTER, 60.0, 1e5))


@pytest.mark.parametrize(("kind", "keys"), EVERY)
def test_a_shape_that_is_moved_and_turned_is_the_same_shape(kind: str, keys: dict[str, Any]) -> None:
    rng = np.random.default_rng(8)
    turn, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    turn *= np.linalg.det(turn)
    axis = "normal" if kind in ("plane", "disc") else "axis"
    keys = {**keys, "x_axis": [3.0, -1.0, 0.2]}
    turned = {**keys, axis: (turn @ keys[axis]).tolist(), "x_axis": (turn @ keys["x_axis"]).tolist()}
    one = shape(kind, center_mm=[0, 0, 0], **keys)
    other = shape(kind, center_mm=CENTER.tolist(), **turned)
    origin, direction = toward(rng, 2000, np.zeros(3), 60.0, 150.0)
    a, part_a = one.intersect(origin, direction, 0.0)
    moved, sent = origin @ turn.T + CENTER, direction @ turn.T
    b, part_b = other.intersect(moved, sent, 0.0)
    both = np.isfinite(a) & np.isfinite(b) & (part_a == part_b)
    assert both.sum() >= np.isfinite(a).sum() - 1
    np.testing.assert_allclose(a[both], b[both], rtol=0, atol=1e-7)  # sqrt of a rounding, at a limb
    sa = one.surface(origin[both], direction[both], a[both], part_a[both])
    sb = other.surface(moved[both], sent[both], b[both], part_b[both])
    np.testing.assert_allclose(sa.normal @ turn.T, sb.normal, atol=1e-8)
    np.testing.assert_allclose(sa.tangent @ turn.T, sb.tangent, atol=1e-8)
    np.testing.assert_allclose(sa.uv, sb.uv, atol=1e-8)


@pytest.mark.parametrize(("kind", "keys"), EVERY)
def test_tangents_run_along_u_and_v_follows_from_the_normal(kind: str, keys: dict[str, Any]) -> None:
    """Rays a little beside each other, along the tangent and along normal x tangent: u grows with one, v with other."""
    built = shape(kind, **keys)
    origin, direction = toward(np.random.default_rng(9), 300, np.zeros(3), 60.0, 150.0)
    hit, _, primitive, surface = meet(built, origin, direction)
    check_frame(surface)
    np.testing.assert_array_equal(surface.normal, surface.shading)
    checked = 0
    for side, grows, stays in ((surface.tangent, 0, 1), (np.cross(surface.normal, surface.tangent), 1, 0)):
        lifted = surface.position + 1e-3 * side + surface.normal
        again, part = built.intersect(lifted, -surface.normal, 0.0)
        same = (np.abs(again - 1.0) < 1e-2) & (part == primitive[hit])
        change = built.surface(lifted[same], -surface.normal[same], again[same], part[same]).uv - surface.uv[same]
        inner = np.all(np.abs(change) < 0.1, axis=1)  # not across the seam
        checked += int(inner.sum())
        assert np.all(change[inner, grows] > 0.0)
        # of second order in the step
        assert np.all(np.abs(change[inner, stays]) < 1e-2 * change[inner, grows])
    assert checked > 100


def test_uv_of_a_sphere_are_its_azimuth_and_its_latitude() -> None:
    built = shape("sphere", radius_mm=10.0, axis=[0, 0, 1], x_axis=[1, 0, 0])
    phi, theta = np.meshgrid(np.linspace(0.0, 359.0, 37), np.linspace(1.0, 179.0, 19))
    phi, theta = np.radians(phi.ravel()), np.radians(theta.ravel())
    out = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    surface = meet(built, 30.0 * out, -out)[-1]
    np.testing.assert_allclose(surface.uv[:, 0], phi / (2 * np.pi), atol=1e-14)
    np.testing.assert_allclose(surface.uv[:, 1], 1.0 - theta / np.pi, atol=1e-14)
    np.testing.assert_allclose(surface.tangent, np.stack([-np.sin(phi), np.cos(phi), 0 * phi], axis=-1), atol=1e-14)


def test_textures_stand_upright_where_y_is_up() -> None:
    """Seen by a camera with up = y, u of a wall goes to the right and v up, whichever way the wall faces."""
    for facing in ([0, 0, 1], [1, 0, 0], [0, 0, -1], [-1, 0, 1]):
        normal = np.array(facing) / np.linalg.norm(facing)
        built = shape("plane", normal=facing, size_mm=[10, 10])
        corner = 50.0 * normal + 4.0 * np.cross([0.0, 1.0, 0.0], normal) + 3.0 * np.array([0.0, 1.0, 0.0])
        surface = meet(built, corner[np.newaxis], -normal[np.newaxis])[-1]
        np.testing.assert_allclose(surface.uv, [[0.9, 0.8]], atol=1e-14)


def test_tiles_repeat_on_a_plane() -> None:
    built = shape("plane", tile_mm=[20, 10])
    x, y = np.array([-5.0, 15.0, 35.0, 1e5 + 15.0]), np.array([2.0, 12.0, -8.0, 2.0])
    origin = np.stack([x, y, np.full(4, 7.0)], axis=-1)
    _, distance, _, surface = meet(built, origin, np.tile([0.0, 0.0, -1.0], (4, 1)))
    np.testing.assert_array_equal(distance, 7.0)
    np.testing.assert_allclose(surface.uv, [[0.25, 0.7]] * 4, atol=1e-11)


def test_sides_of_a_box_have_their_own_normals_and_whole_uv() -> None:
    built = shape("box", size_mm=[2, 4, 6])
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        normal = sign * np.eye(3)[axis]
        _, distance, _, surface = meet(built, 10.0 * normal[np.newaxis], -normal[np.newaxis])
        assert distance[0] == 10.0 - (1, 2, 3)[axis]
        np.testing.assert_array_equal(surface.normal[0], normal)
        np.testing.assert_array_equal(surface.uv, [[0.5, 0.5]])
    # through exact edges and corners: never between two sides
    rim = np.array([[1.0, 2.0, 9.0], [1.0, 0.0, 9.0], [1.0, 2.0, 3.0]])
    distance, _ = built.intersect(rim, np.tile([0.0, 0.0, -1.0], (3, 1)), -1.0)
    np.testing.assert_array_equal(distance, [6.0, 6.0, 0.0])


def test_rays_at_the_rim_of_a_cylinder_find_no_gap() -> None:
    """Rays toward points of the rim itself, moved by roundings: a hit on side or cap, or a miss beside both."""
    built = shape("cylinder", radius_mm=10.0, height_mm=20.0, axis=[0, 0, 1])
    rng = np.random.default_rng(10)
    phi = rng.random(20000) * 2 * np.pi
    goal = np.stack([10.0 * np.cos(phi), 10.0 * np.sin(phi), np.full_like(phi, 10.0)], axis=-1) * (1.0 - 1e-14)
    direction = -np.stack([np.cos(phi), np.sin(phi), 0.2 + rng.random(len(phi))], axis=-1)
    direction /= np.linalg.norm(direction, axis=1)[:, np.newaxis]
    distance, _ = built.intersect(goal - 70.0 * direction, direction, 0.0)
    np.testing.assert_allclose(distance, 70.0, rtol=0, atol=1e-12)


def test_a_tube_without_caps_is_seen_through() -> None:
    built = shape("cylinder", radius_mm=10.0, height_mm=20.0, axis=[0, 0, 1], caps=False)
    assert not built.closed
    assert not built.convex
    assert not built.contains([0, 0, 0])
    origin = np.array([[1.0, 2.0, 50.0], [0.0, 0.0, 0.0], [20.0, 0.0, 12.0]])
    distance, _ = built.intersect(origin, np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-0.8, 0.0, -0.6]]), 0.0)
    # the third passes over the near rim, at z = 4.5, and meets the near side: x = 10 at t = 12.5
    np.testing.assert_allclose(distance, [np.inf, 10.0, 12.5], rtol=1e-12)  # of float64, a few roundings


@pytest.mark.parametrize(("kind", "keys"), SOLIDS)
def test_a_point_is_inside_when_a_ray_from_it_leaves_once(kind: str, keys: dict[str, Any]) -> None:
    built = shape(kind, center_mm=CENTER.tolist(), **keys)
    rng = np.random.default_rng(11)
    for point, direction in zip(CENTER + rng.uniform(-35, 35, (300, 3)), units(rng, 300), strict=True):
        assert built.contains(point) == (len(crossings(built, point, direction)) % 2 == 1)


def test_a_light_in_a_plane_meets_it_nowhere() -> None:
    for built in (shape("plane"), shape("disc", radius_mm=5.0)):
        for z in (0.0, 1.0):
            distance, _ = built.intersect(np.array([[0.0, 0.0, z]]), np.array([[1.0, 0.0, 0.0]]), -1.0)
            assert distance[0] == np.inf
