"""Rays of cameras: where they start, where they point, and that a rig's camera is the one that it has."""

import math

import numpy as np
import pytest
from gonio_scenes import camera as cameras
from gonio_scenes.camera import CameraTable, on_disc, point

from gonio.config import parse
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig import Pose
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.kinematics import view

PINHOLE = {
    "position_mm": [0.0, 0.0, 100.0],
    "look_at_mm": [0.0, 0.0, 0.0],
    "vertical_field_deg": 60.0,
    "width": 4,
    "height": 2,
}


def camera(**changes: object) -> cameras.SceneCamera:
    return cameras.from_table(parse(CameraTable, PINHOLE | changes, "test"), None)


def test_the_field_spans_the_height_and_rows_grow_downward() -> None:
    origin, direction = camera().rays(np.arange(8), 0, None)
    assert (origin == [0.0, 0.0, 100.0]).all()
    at_zero = (direction / -direction[:, 2:] * 100.0)[:, :2]  # where the rays meet the plane z = 0
    half = 100.0 * math.tan(math.radians(30.0))
    rows, columns = (half / 2, -half / 2), (-1.5 * half, -0.5 * half, 0.5 * half, 1.5 * half)
    np.testing.assert_allclose(at_zero, [(x, y) for y in rows for x in columns], rtol=1e-14)


def test_a_point_is_projected_to_the_pixel_whose_ray_meets_it() -> None:
    eye = camera(position_mm=[30.0, -20.0, 80.0], up=[0.1, 1.0, 0.3])
    origin, direction = eye.rays(np.arange(8), 0, None)
    column, row = eye.project(origin + 37.0 * direction)
    np.testing.assert_allclose(column, np.arange(8) % 4 + 0.5, atol=1e-12)
    np.testing.assert_allclose(row, np.arange(8) // 4 + 0.5, atol=1e-12)
    assert np.isnan(eye.project(origin - 37.0 * direction)[0]).all()


def test_rays_of_a_lens_meet_in_the_plane_in_focus_and_start_all_over_the_lens() -> None:
    eye = camera(lens_radius_mm=5.0, focus_mm=70.0, samples=64)
    shift = np.full((1, 4), 0.3)
    rays = [eye.rays(np.array([5]), k, shift) for k in range(512)]
    origin = np.concatenate([o for o, _ in rays])
    direction = np.concatenate([d for _, d in rays])
    met = origin + direction * (70.0 / -direction[:, 2:])
    pixel = 70.0 * math.tan(math.radians(30.0))
    assert np.ptp(met[:, 0]) < pixel  # within the pixel's own width
    assert np.ptp(met[:, 1]) < pixel
    radius = np.hypot(origin[:, 0], origin[:, 1])
    assert radius.max() <= 5.0
    # uniform over the disc: a quarter of the rays within half the radius, to what 512 even points resolve
    assert abs((radius < 2.5).mean() - 0.25) < 0.02


@pytest.mark.parametrize("dimensions", [2, 4])
def test_moved_sequences_are_uniform_and_even(dimensions: int) -> None:
    shift = np.random.default_rng(3).random((200, dimensions))
    points = np.stack([point(k, shift) for k in range(64)])
    assert points.shape == (64, dimensions, 200)
    # each sequence of 64 points has 32 in either half of every axis, to a few; random ones would scatter by 4, and
    # the worst of these 200 by 11 or more
    assert np.abs((points < 0.5).sum(axis=0) - 32).max() <= 6
    # and over all shifts the mean is one half: 200 shifts of 64 even points, sd 0.001
    assert np.abs(points.mean(axis=(0, 2)) - 0.5).max() < 0.005


def test_the_square_is_laid_on_the_disc_in_proportion() -> None:
    a, b = np.random.default_rng(4).random((2, 100_000))
    x, y = on_disc(a, b)
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    assert radius.max() <= 1.0
    # r^2 and the angle are uniform; 1e5 draws: the standard error of a share of 1/4 is 0.0014
    for share in (np.mean(radius**2 < 0.25), np.mean((angle >= 0) & (angle < math.pi / 2))):
        assert abs(share - 0.25) < 0.006


@pytest.mark.parametrize(
    "pose", [Pose(light=0.4, camera=-0.6), Pose(light=-0.9, camera=0.3, tilt=0.4, spin=1.0)], ids=["in plane", "tilted"]
)
def test_a_rigs_camera_sees_the_sample_as_its_own_geometry_says(pose: Pose) -> None:
    rig = find_rig("sim").description
    degrees = {f"{n}_deg": math.degrees(getattr(pose, n)) for n in ("light", "camera", "tilt", "spin")}
    eye = cameras.from_table(parse(CameraTable, {"rig": "sim", "pose": degrees}, "test"), rig)
    seen = pixel_map(rig, view(rig, pose))
    pixel = np.arange(0, eye.pixels, 9973)
    origin, direction = eye.rays(pixel, 0, None)
    spot = origin + direction * (-origin[:, 2:] / direction[:, 2:])
    x, y = seen.x_mm.ravel()[pixel], seen.y_mm.ravel()[pixel]
    np.testing.assert_allclose(spot[:, 0], x, rtol=0, atol=1e-9 * 1000.0)
    np.testing.assert_allclose(spot[:, 1], y, rtol=0, atol=1e-9 * 1000.0)


@pytest.mark.parametrize(("cos4", "vignetting"), [(False, 0.0), (True, 0.0), (False, 0.3), (True, 0.3)])
def test_a_lens_loses_light_by_the_field_angle_and_toward_the_corner(cos4: bool, vignetting: float) -> None:
    """Of a picture of 4 x 2 pixels whose height spans 60 degrees: cos^4 of the angle, and 1 - v (r / corner)^4."""
    sensor = cameras.SensorTable(responsivity_e_per_s=1.0, cos4=cos4, vignetting=vignetting)
    step = math.tan(math.radians(30.0))  # one pixel is half of the height
    found = cameras.falloff(sensor, camera())
    for (row, column), share in np.ndenumerate(found):
        radius = step * math.hypot(column - 1.5, row - 0.5)
        lost = math.cos(math.atan(radius)) ** 4 if cos4 else 1.0
        corner = step * math.hypot(2.0, 1.0)
        assert share == pytest.approx(lost * (1.0 - vignetting * (radius / corner) ** 4), rel=1e-12)
    assert found.shape == (2, 4)
