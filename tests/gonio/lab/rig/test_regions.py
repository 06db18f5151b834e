"""Regions of a frame against geometry that is worked out here: the lamp straight through, the beam, a bent lens."""

import math
from typing import Any

import numpy as np
import pytest

from gonio.errors import ConfigError
from gonio.lab.rig import Pose, imaging, kinematics, regions
from gonio.lab.rig.description import Acquisition, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Beam, Camera, Lamp
from tests.gonio.numpy_rig import describe

CAMERA = Camera(width=160, height=120, pixel_um=60.0, lens_half_angle_deg=0.4)
LAMP = Lamp(half_angle_deg=0.7)


def into_the_lamp(camera: dict[str, Any] | None = None, **changes: Any) -> RigDescription:
    tables = {"lamp": LAMP, "reference": Reference(how="beam", attenuation=0.01)} | changes
    return describe(camera=CAMERA.model_copy(update=camera or {}), **tables)


FACING = Pose(light=math.radians(90), camera=math.radians(-90))


def radii_mm(description: RigDescription) -> tuple[float, float]:
    """Of the discs of lamp and lens."""
    g = description.geometry
    return (
        g.light_distance_mm * math.tan(math.radians(description.lamp.half_angle_deg)),
        g.camera_distance_mm * math.tan(math.radians(description.camera.lens_half_angle_deg)),
    )


@pytest.mark.parametrize("off_deg", [0.0, 0.3])
def test_straight_through_the_region_is_all_that_a_ray_from_lamp_to_lens_crosses(off_deg: float) -> None:
    """The outermost ray goes from the lamp's edge to the lens's: similar triangles; and a margin of 15 % around it."""
    description = into_the_lamp()
    view = kinematics.view(description, Pose(light=FACING.light, camera=FACING.camera + math.radians(off_deg)))
    g, (lamp, lens) = description.geometry, radii_mm(description)
    apart = g.light_distance_mm + g.camera_distance_mm
    outermost = (lamp * g.camera_distance_mm + lens * g.light_distance_mm) / apart
    pitch = CAMERA.pixel_um * 1e-3 * (g.camera_distance_mm / CAMERA.focal_length_mm - 1.0)
    region = regions.roi(description, view, "reference")
    # a disc of 40 pixels: its edge is made of some 250
    assert region.count * pitch**2 == pytest.approx(math.pi * (1.15 * outermost) ** 2, rel=0.01)
    rows, columns = np.nonzero(region.mask)
    # the camera turns about the sample's centre: the lamp behind it moves by the way to it over the way to the lens
    moved = math.radians(off_deg) * g.light_distance_mm / apart * g.camera_distance_mm / pitch
    assert abs(columns.mean() - 79.5) == pytest.approx(moved, abs=0.3)
    assert rows.mean() == pytest.approx(59.5, abs=0.2)


@pytest.mark.parametrize(
    ("pattern", "channel", "share"), [("mono", "mono", 1.0), ("RGGB", "R", 0.25), ("GRBG", "G", 0.5)]
)
def test_the_lamp_straight_through_weighs_as_a_unit_brdf(pattern: Any, channel: Any, share: float) -> None:
    """A lamp of radiance 1 sends lamp x lens / apart^2 through the lens, a share of it onto the pixels of a colour.

    At normal incidence a surface of unit BRDF has the radiance of its irradiance, lamp / d^2; a pixel of it sends that
    times its area and the lens's solid angle. The attenuator takes part of the first alone.
    """
    description = into_the_lamp({"pattern": pattern})
    view = kinematics.view(description, FACING)
    region = regions.straight_through(description, view, channel)
    g, (lamp, lens) = description.geometry, (math.pi * r**2 for r in radii_mm(description))
    through = 0.01 * lamp * lens / (g.light_distance_mm + g.camera_distance_mm) ** 2
    rates = np.random.default_rng(1).random(region.count)
    rates *= share * through / rates.sum()  # however it falls onto them
    pixel = (CAMERA.pixel_um * 1e-3 * (g.camera_distance_mm / CAMERA.focal_length_mm - 1.0)) ** 2
    unit = lamp / g.light_distance_mm**2 * pixel * lens / g.camera_distance_mm**2
    assert (rates / regions.straight_through_weight(description, view, region, channel)).mean() == pytest.approx(unit)


@pytest.mark.parametrize(
    ("changes", "turned_deg", "said"),
    [
        ({"lamp": Lamp(), "camera": {"lens_half_angle_deg": 0.0}}, 0.0, "needs lamp.half_angle_deg or"),
        ({"lamp": Lamp(), "camera": {"lens_half_angle_deg": 0.1}}, 0.0, ""),
        # the lens is 13.96 mm wide and 1 m away, the lamp 2 m: in the middle rays to the lamp's centre need half of it
        ({"lamp": Lamp(half_angle_deg=0.7, beam_diameter_mm=6.9)}, 0.0, "which takes 6.98 mm"),
        ({"lamp": Lamp(half_angle_deg=0.7, beam_diameter_mm=7.05)}, 0.0, ""),
        # the frame holds 32.4 mm up and down, and 43.2 to the sides
        ({"camera": {"lens_half_angle_deg": 2.6}}, 0.0, "33.1 mm radius .*, and the frame holds 32.4 mm"),
        ({"camera": {"lens_half_angle_deg": 2.5}}, 0.0, ""),
        # a degree moves the lamp by 8.7 mm, and without the margin it has a radius of 9.6 mm
        ({}, 4.0, "align the arms"),
        ({}, -4.0, "align the arms"),
        ({}, 3.7, ""),
        *[({"camera": {"principal_point_px": (0.0, sign * 39.0)}}, 0.0, "") for sign in (1, -1)],
        *[({"camera": {"principal_point_px": (0.0, sign * 43.0)}}, 0.0, "align the arms") for sign in (1, -1)],
    ],
)
def test_a_lamp_that_cannot_be_seen_whole_is_refused(changes: dict[str, Any], turned_deg: float, said: str) -> None:
    description = into_the_lamp(**changes)
    view = kinematics.view(description, Pose(light=FACING.light, camera=FACING.camera + math.radians(turned_deg)))
    if said:
        with pytest.raises(ConfigError, match=said):
            regions.straight_through(description, view)
    else:
        assert regions.straight_through(description, view).count > 0


@pytest.mark.parametrize("light_deg", [0.0, -35.0, 60.0])
def test_a_beam_s_profile_is_read_where_the_ray_to_a_spot_crosses_the_plane_that_faces_the_lamp(
    light_deg: float,
) -> None:
    beam = Beam(x_per_mm=0.01, y_per_mm=-0.02, xx_per_mm2=-0.001, xy_per_mm2=0.002, yy_per_mm2=-0.003)
    description = describe(camera=CAMERA, lamp=Lamp(beam=beam))
    view, farther = (
        kinematics.view(description, Pose(light=math.radians(light_deg) + step, camera=0.3)) for step in (0.0, 1e-6)
    )
    seen, lamp = imaging.pixel_map(description, view), np.asarray(view.source_mm)
    toward, along = lamp / np.linalg.norm(lamp), np.asarray(farther.source_mm) - lamp
    along /= np.linalg.norm(along)  # as the light arm's angle grows
    for i, j in ((0, 0), (10, 150), (119, 80), (60, 20)):
        way = np.array([seen.x_mm[i, j], seen.y_mm[i, j], 0.0]) - lamp
        crossing = lamp - way * (lamp @ toward) / (way @ toward)
        x, y = float(crossing @ along), float(crossing @ view.image_y)
        assert (seen.beam_xy_mm[0][i, j], seen.beam_xy_mm[1][i, j]) == pytest.approx((x, y), rel=1e-5, abs=1e-4)
        log = 0.01 * x - 0.02 * y - 0.001 * x**2 + 0.002 * x * y - 0.003 * y**2
        assert seen.radiation[i, j] == pytest.approx(math.exp(log), rel=1e-4)


def test_a_lens_that_hardly_bends_shows_the_same_region_and_one_that_bends_the_same_patch() -> None:
    """The second against the edge of the patch, projected spot by spot."""
    view = kinematics.view(describe(camera=CAMERA), Pose(light=0.2, camera=-0.7))
    straight, hardly, bent = (
        describe(
            camera=CAMERA.model_copy(update={"distortion": (k, 0.0, 0.0, 0.0, 0.0)}),
            acquisition=Acquisition(roi_radius_mm=25.0),
        )
        for k in (0.0, 1e-12, -30.0)
    )
    one, other = regions.roi(straight, view), regions.roi(hardly, view)
    assert np.array_equal(one.mask, other.mask)
    assert one.shared(other) == one.count
    extent, (columns, rows) = regions.patch_extent(bent, view), regions.outline(bent, view)
    assert extent == pytest.approx((columns.min(), columns.max(), rows.min(), rows.max()), abs=0.02)
    # its edge lies 36 pixels beside the middle, 0.0194 of the way to the lens's image: drawn in by 30 times the cube
    assert regions.patch_extent(straight, view)[1] - extent[1] == pytest.approx(36 * 30 * 0.0194**2, rel=0.03)


def test_a_region_is_every_pixel_that_sees_the_patch_however_oblique_the_camera_is() -> None:
    """Counted over the whole frame; and what two of them share, pixel by pixel."""
    description = describe(camera=CAMERA, reference=Reference(how="beside", offset_mm=(12.0, -5.0)))
    counted = []
    for target, camera_deg, centre in (
        ("sample", -10.0, (0, 0)),
        ("sample", 75.0, (0, 0)),
        ("reference", 0.0, (12, -5)),
    ):
        view = kinematics.view(description, Pose(light=0.2, camera=math.radians(camera_deg)))
        seen = imaging.pixel_map(description, view)
        whole = np.hypot(seen.x_mm - centre[0], seen.y_mm - centre[1]) <= description.acquisition.roi_radius_mm
        region = regions.roi(description, view, target)  # type: ignore[arg-type]
        assert region.count == np.count_nonzero(whole) > 5
        assert region.of(np.arange(whole.size).reshape(whole.shape)).tolist() == np.flatnonzero(whole).tolist()
        counted.append((region, whole))
    for one, in_one in counted:
        for other, in_other in counted:
            assert one.shared(other) == np.count_nonzero(in_one & in_other)
    # from 89.9 degrees a column is 309 mm long, and the radius grows to that: the two about the middle
    view = kinematics.view(description, Pose(light=0.2, camera=math.radians(89.9)))
    assert np.count_nonzero(regions.roi(description, view).mask.any(axis=0)) == 2
    assert [
        regions.always_holds_sample(describe(camera=CAMERA, acquisition=Acquisition(roi_radius_mm=r)))
        for r in (30.0, 33.0)
    ] == [True, False], "the frame holds 32.4 mm from 1 m, and 31.4 from 31.4 mm nearer"
