"""Pixel geometry against rays that are traced one by one in the lab's frame."""

import math

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.lab.rig import Pose
from gonio.lab.rig.description import Acquisition, Geometry, Reference, RigDescription
from gonio.lab.rig.imaging import of_channel, pixel_map
from gonio.lab.rig.kinematics import View, view
from gonio.lab.rig.light_and_camera import Band, Bands, Camera, Lamp
from gonio.lab.rig.regions import always_holds_sample, frame_holds, patch_extent, roi
from tests.gonio.lab.rig.plain_rig import rotation

BANDS = Bands(list=(Band(name="550 nm", centre_nm=550, fwhm_nm=10),))
POSES = [
    Pose(light=0.2, camera=-0.7),
    Pose(light=-1.1, camera=1.3),
    Pose(light=0.5, camera=0.1, tilt=0.6, spin=-1.0),
    Pose(light=-0.3, camera=-0.9, tilt=-0.4, spin=2.5),
    Pose(light=0.3, camera=0.8, azimuth=1.2),
]


def rig(**tables: object) -> RigDescription:
    values: dict[str, object] = {
        "camera": Camera(width=64, height=48, pixel_um=40.0, focal_length_mm=80.0, cos4=True, vignetting=0.3),
        "geometry": Geometry(light_distance_mm=700.0, camera_distance_mm=500.0),
    }
    return RigDescription(rig="sim", name="test", bands=BANDS, **(values | tables))  # type: ignore[arg-type]


def traced(pose: Pose, i: int, j: int) -> dict[str, float]:
    """One ray in the lab's frame, where the camera is simple, met with the tilted sample's plane by its normal."""
    light = 700.0 * np.array([math.sin(pose.light), 0.0, math.cos(pose.light)])
    turn = rotation("z", pose.azimuth) @ rotation("y", pose.camera)
    eye = turn @ np.array([0.0, 0.0, 500.0])
    # image distance of a thin lens of 80 mm focused at 500 mm; rows grow along the lab's y, columns against its x
    image = 80.0 * 500.0 / (500.0 - 80.0)
    u, v = (j - 31.5) * 0.040, (i - 23.5) * 0.040
    ray = turn @ np.array([-u, v, -image])
    to_sample = (rotation("x", -pose.tilt) @ rotation("z", pose.spin)).T
    normal = to_sample.T @ np.array([0.0, 0.0, 1.0])
    spot = eye - ray * (eye @ normal) / (ray @ normal)
    toward_light = light - spot
    distance = np.linalg.norm(toward_light)
    x, y, z = to_sample @ spot
    assert abs(z) < 1e-9  # rounding of 500 mm
    radius = math.hypot(u, v)
    return {
        "x": x,
        "y": y,
        "cos_i": toward_light @ normal / distance,
        "factor": (700.0 / distance) ** 2,
        "falloff": math.cos(math.atan(radius / image)) ** 4 * (1 - 0.3 * (radius / (0.020 * math.hypot(64, 48))) ** 4),
    }


@pytest.mark.parametrize("pose", POSES)
def test_every_quantity_against_single_rays(pose: Pose) -> None:
    description = rig()
    seen = pixel_map(description, view(description, pose))
    for i, j in [(0, 0), (47, 63), (0, 63), (23, 31), (24, 32), (11, 50)]:
        one = traced(pose, i, j)
        # 1e-11: rounding of millimetres over a thousand of them
        assert seen.x_mm[i, j] == pytest.approx(one["x"], rel=1e-11, abs=1e-10)
        assert seen.y_mm[i, j] == pytest.approx(one["y"], rel=1e-11, abs=1e-10)
        assert seen.cos_theta_i[i, j] == pytest.approx(one["cos_i"], rel=1e-11)
        assert seen.distance_factor[i, j] == pytest.approx(one["factor"], rel=1e-11)
        assert seen.falloff[i, j] == pytest.approx(one["falloff"], rel=1e-11)
        assert seen.weight[i, j] == pytest.approx(one["cos_i"] * one["factor"] * one["falloff"], rel=1e-11)
        spot = np.array([one["x"], one["y"], 0.0])
        at = view(description, pose)
        for omega, place in ((seen.omega_i, at.source_mm), (seen.omega_r, at.camera_mm)):
            toward = place - spot
            np.testing.assert_allclose(omega[i, j], toward / np.linalg.norm(toward), rtol=0, atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
def test_a_lambertian_lamp_falls_off_with_the_cosine_at_the_lamp(pose: Pose) -> None:
    """The angle at the lamp between the sample's centre and the spot, by arccos of unit vectors in the lab's frame."""
    alike, description = rig(), rig(lamp=Lamp(radiation="lambertian"))
    seen, before = (pixel_map(d, view(d, pose)) for d in (description, alike))
    light = np.array([math.sin(pose.light), 0.0, math.cos(pose.light)])
    to_lab = rotation("x", -pose.tilt) @ rotation("z", pose.spin)
    for i, j in [(0, 0), (47, 63), (0, 63), (23, 31), (11, 50)]:
        one = traced(pose, i, j)
        beam = to_lab @ np.array([one["x"], one["y"], 0.0]) - 700.0 * light
        off = math.acos(beam @ -light / np.linalg.norm(beam))
        assert seen.radiation[i, j] == pytest.approx(math.cos(off), rel=1e-11)  # rounding, as above
        assert seen.weight[i, j] == pytest.approx(before.weight[i, j] * math.cos(off), rel=1e-11)
    np.testing.assert_array_equal(before.radiation, 1.0)
    np.testing.assert_array_equal(before.weight, before.falloff * before.cos_theta_i * before.distance_factor)


def test_a_rectangle_is_a_part_of_the_frame() -> None:
    description = rig()
    at = view(description, POSES[2])
    whole, part = pixel_map(description, at), pixel_map(description, at, slice(5, 20), slice(30, 41))
    for name in ("x_mm", "y_mm", "cos_theta_i", "distance_factor", "falloff", "weight"):
        np.testing.assert_array_equal(getattr(whole, name)[5:20, 30:41], getattr(part, name))


def test_a_lens_without_falloff_weighs_all_pixels_alike() -> None:
    description = rig(camera=Camera(width=64, height=48))
    assert np.all(pixel_map(description, view(description, POSES[0])).falloff == 1.0)


def test_pixels_that_look_past_the_plane_see_nothing() -> None:
    """At 89.9 degrees, half of the frame looks over the horizon of the sample's plane."""
    description = rig()
    at = view(description, Pose(light=0.0, camera=math.radians(89.9)))
    seen = pixel_map(description, at)
    ray_z = np.array([[traced_z(at, i, j) for j in range(64)] for i in (0, 20)])
    np.testing.assert_array_equal(seen.sees_plane, np.repeat((ray_z < 0)[:1], 48, axis=0))
    assert 20 < np.count_nonzero(~seen.sees_plane[0]) < 44
    dark = ~seen.sees_plane
    assert np.all(np.isnan(seen.x_mm[dark]))
    for name in ("cos_theta_i", "distance_factor", "weight"):
        assert np.all(getattr(seen, name)[dark] == 0.0)
    assert np.all(pixel_map(rig(lamp=Lamp(radiation="lambertian")), at).weight[dark] == 0.0)


def traced_z(at: View, i: int, j: int) -> float:
    image = 80.0 * 500.0 / (500.0 - 80.0)
    axis = -at.camera_mm / np.linalg.norm(at.camera_mm)
    return float((image * axis + (j - 31.5) * 0.04 * at.image_x + (i - 23.5) * 0.04 * at.image_y)[2])


def test_no_light_comes_from_below_the_plane() -> None:
    description = rig()
    at = view(description, Pose(light=math.radians(100.0), camera=0.2))
    assert np.all(pixel_map(description, at).cos_theta_i == 0.0)


def test_a_camera_in_the_plane_sees_nothing() -> None:
    description = rig()
    at = view(description, Pose(light=0.1))
    edge_on = View(at.source_mm, np.array([700.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
    assert not pixel_map(description, edge_on).sees_plane.any()
    with pytest.raises(ConfigError, match="in the sample's plane"):
        roi(description, edge_on)


def test_a_camera_behind_the_plane_sees_each_spot_where_the_line_of_sight_meets_it() -> None:
    description = rig()
    at = view(description, Pose(light=0.4, camera=math.radians(130.0)))
    seen = pixel_map(description, at)
    assert seen.sees_plane.all()
    spots = np.stack([seen.x_mm, seen.y_mm, np.zeros_like(seen.x_mm)], axis=-1)
    to_camera = at.camera_mm - spots
    to_camera /= np.linalg.norm(to_camera, axis=-1, keepdims=True)
    np.testing.assert_allclose(seen.omega_r, to_camera, atol=1e-12)
    to_source = at.source_mm - spots
    np.testing.assert_allclose(seen.cos_theta_i, to_source[..., 2] / np.linalg.norm(to_source, axis=-1), rtol=1e-12)
    region = roi(description, at)
    centre = np.hypot(seen.x_mm, seen.y_mm)[region.rows, region.cols][region.mask]
    assert centre.max() <= description.acquisition.roi_radius_mm


def test_a_reference_beside_the_sample_has_a_region_of_its_own() -> None:
    beside = Reference(how="beside", offset_mm=(-4.0, 1.5))
    description = rig(acquisition=Acquisition(roi_radius_mm=1.0), reference=beside)
    at = view(description, POSES[0])
    whole = pixel_map(description, at)
    sample, reference = roi(description, at), roi(description, at, "reference")
    assert reference.of(whole.x_mm).mean() == pytest.approx(-4.0, abs=0.05)  # a pixel sees 0.2 mm
    assert reference.of(whole.y_mm).mean() == pytest.approx(1.5, abs=0.05)
    assert sample.shared(reference) == 0
    swapped = description.model_copy(update={"reference": Reference(how="swap", offset_mm=(-4.0, 1.5))})
    assert roi(swapped, at, "reference").shared(sample) == sample.count


@pytest.mark.parametrize("theta_r_deg", [80.0, 85.0, 88.0, 89.0, 89.5, 89.9])
def test_a_region_is_never_empty_near_grazing(theta_r_deg: float) -> None:
    """A pixel sees 0.21 mm / cos(theta_r) of the sample: more than the patch's diameter beyond 83 degrees."""
    description = rig(acquisition=Acquisition(roi_radius_mm=0.8))
    region = roi(description, view(description, Pose(light=0.3, camera=math.radians(theta_r_deg))))
    assert region.count >= 7  # the patch's 1.6 mm hold 7 rows of 0.21 mm
    nearest = pixel_map(description, view(description, Pose(light=0.3, camera=math.radians(theta_r_deg))))
    reach = np.hypot(region.of(nearest.x_mm), region.of(nearest.y_mm)).max()
    assert reach <= max(0.8, 1.001 * 0.04 * 500 * (1 / 80 - 1 / 500) / math.cos(math.radians(theta_r_deg)))


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_a_bayer_region_holds_the_pixels_of_its_channel(pattern: str) -> None:
    camera = Camera(width=64, height=48, pixel_um=40.0, focal_length_mm=80.0, pattern=pattern)  # type: ignore[arg-type]
    description = rig(camera=camera, acquisition=Acquisition(roi_radius_mm=2.0))
    at = view(description, POSES[0])
    mosaic = np.array([[pattern[2 * (i % 2) + j % 2] for j in range(64)] for i in range(48)])
    every = roi(description, at)
    counts = {}
    for channel in "RGB":
        region = roi(description, at, channel=channel)  # type: ignore[arg-type]
        assert set(region.of(mosaic)) == {channel}
        counts[channel] = region.count
    assert sum(counts.values()) == every.count
    np.testing.assert_array_equal(of_channel(pattern, "G", slice(3, 10), slice(5, 9)), mosaic[3:10, 5:9] == "G")


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("offset_mm", [(0.0, 0.0), (2.5, -1.5)])
def test_the_extent_of_a_patch_is_where_its_rim_is_seen(pose: Pose, offset_mm: tuple[float, float]) -> None:
    description = rig(
        acquisition=Acquisition(roi_radius_mm=1.0), reference=Reference(how="beside", offset_mm=offset_mm),
        camera=Camera(width=640, height=480, pixel_um=4.0, focal_length_mm=60.0),
    )  # fmt: skip
    at = view(description, pose)
    seen = pixel_map(description, at)
    rows, columns = np.nonzero(np.hypot(seen.x_mm - offset_mm[0], seen.y_mm - offset_mm[1]) <= 1.0)
    # the outermost pixels whose centres lie inside are within one of the rim, and 64 spots of it within 0.2 of the rim
    assert patch_extent(description, at, "reference") == pytest.approx(
        (columns.min(), columns.max(), rows.min(), rows.max()), abs=1.2
    )


def test_a_patch_that_reaches_behind_the_camera_is_in_no_frame() -> None:
    description = rig(
        geometry=Geometry(camera_distance_mm=30.0), camera=Camera(focal_length_mm=20.0, width=8000, height=8000),
        reference=Reference(how="beside", offset_mm=(40.0, 0.0)),
    )  # fmt: skip
    at = view(description, Pose(camera=math.radians(80.0)))
    assert not frame_holds(description, patch_extent(description, at, "reference"))
    with pytest.raises(
        ConfigError, match=r"reference at x = 40 mm.*outside the 8000 x 8000 frame; see reference.offset_mm"
    ):
        roi(description, at, "reference")


def test_what_always_holds_the_sample_holds_it_from_everywhere() -> None:
    """Frames a little larger and a little smaller than the promise needs, over random poses; both are met."""
    rng = np.random.default_rng(11)
    promised = 0
    for _ in range(300):
        radius, distance = rng.uniform(0.5, 20.0), rng.uniform(60.0, 900.0)
        size = int(rng.uniform(0.9, 1.3) * 2 * radius / distance * 60.0 / 0.005)
        description = rig(
            geometry=Geometry(camera_distance_mm=distance), acquisition=Acquisition(roi_radius_mm=radius),
            camera=Camera(width=max(size, 32), height=max(size, 32), focal_length_mm=50.0),
        )  # fmt: skip
        if always_holds_sample(description):
            promised += 1
            for tilt in (0.0, 0.6):
                pose = Pose(light=0.1, camera=rng.uniform(-1.5, 1.5), tilt=tilt, spin=rng.uniform(-3, 3))
                assert frame_holds(description, patch_extent(description, view(description, pose)))
    assert 50 < promised < 250
