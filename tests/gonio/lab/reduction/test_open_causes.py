"""What calibrations leave open: the causes together are the covariance that they are made of, carried to values."""

import datetime
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gonio_maps.reduction.map_grid import grid

from gonio.lab.reduction import light_and_lens
from gonio.lab.reduction.count_rates import _around, _widened
from gonio.lab.reduction.dark_signal import Darks
from gonio.lab.reduction.geometry_errors import GeometryErrors, zero_u_deg
from gonio.lab.reduction.light_and_lens import BEAM
from gonio.lab.rig import Pose, kinematics
from gonio.lab.rig.calibration_use import Calibrated, CalibrationUse
from gonio.lab.rig.description import Reference, RigDescription
from gonio.lab.rig.light_and_camera import Beam, Camera, Lamp
from gonio.lab.rig.regions import Roi
from tests.gonio.numpy_rig import BANDS, describe


def calibrated(known: dict[str, float], correlation: float, **changes: Any) -> RigDescription:
    """A rig of which a calibration knows some numbers, each pair of them with this correlation."""
    matrix = np.full((len(known), len(known)), correlation)
    np.fill_diagonal(matrix, 1.0)
    told = Calibrated(
        kind="geometry", file="g.toml", sha256="0" * 64, made=datetime.date(2026, 1, 1), parameters=list(known),
        u=list(known.values()), correlation=matrix.tolist(),
    )  # fmt: skip
    return describe(calibration=CalibrationUse(known=(told,)), **changes)


def half(changed: Any) -> Any:
    """Of causes up and down, shape (causes, 2): the change for one standard deviation of each."""
    return (changed[..., 0] - changed[..., 1]) / 2.0


@pytest.mark.parametrize("beam_mm", [None, 3.0])
def test_zeros_that_go_together_turn_the_directions_by_their_covariance(beam_mm: float | None) -> None:
    """In the plane of the arms theta_i and theta_r move by the two zeros, one up where the other goes down.

    A white changes with the cosine of the light's angle; where a whole beam is seen, with that of the camera's.
    """
    u = {"arms.light.zero_offset_deg": 0.05, "arms.camera.zero_offset_deg": 0.02}
    description = calibrated(u, 0.6, lamp=Lamp(beam_diameter_mm=beam_mm), reference=Reference(how="swap"))
    theta_i, theta_r = math.radians(50.0), math.radians(20.0)
    sights = GeometryErrors(description).at(Pose(light=theta_i, camera=-theta_r), "sample")
    assert sights.known[[0, 2]] == pytest.approx([theta_i, theta_r])
    moved = half(np.moveaxis(sights.changed[..., [0, 2]], 1, -1))
    one, other = np.radians(list(u.values()))
    covariance = np.array([[one**2, -0.6 * one * other], [-0.6 * one * other, other**2]])
    assert moved.T @ moved == pytest.approx(covariance, rel=1e-6)
    light = math.tan(theta_r) * other if beam_mm else math.tan(theta_i) * one
    assert np.sum(half(sights.relative_light) ** 2) == pytest.approx(light**2, rel=1e-4)
    assert zero_u_deg(description, ["light", "tilt"]) == {"light": 0.0, "tilt": description.axes()["tilt"].zero_u_deg}
    alone = calibrated(u, 0.0)
    assert GeometryErrors(alone).count == 0, "each is a cause of its own"
    assert zero_u_deg(alone, ["light"]) == pytest.approx({"light": 0.05})


def test_distances_change_the_lamp_straight_through_as_its_formula_says() -> None:
    """ln of (d_r/f - 1)^2 ((d_i + d_r)/(d_i d_r))^2, by its derivatives, with the covariance of both."""
    u = {"geometry.light_distance_mm": 0.5, "geometry.camera_distance_mm": 0.8}
    description = calibrated(u, -0.4, reference=Reference(how="beam", attenuation=0.01), lamp=Lamp(half_angle_deg=0.5))
    g, f = description.geometry, description.camera.focal_length_mm
    di, dr = g.light_distance_mm, g.camera_distance_mm
    slopes = np.array([2 / (di + dr) - 2 / di, 2 / (dr - f) + 2 / (di + dr) - 2 / dr])
    size = np.array(list(u.values()))
    covariance = np.outer(size, size) * [[1.0, -0.4], [-0.4, 1.0]]
    errors = GeometryErrors(description)
    assert errors.count == 2
    changed = errors.straight_through(Pose(light=math.pi / 2, camera=-math.pi / 2))
    assert np.sum(half(changed) ** 2) == pytest.approx(slopes @ covariance @ slopes, rel=1e-3)
    # over its own distance the sample's centre has as much light as before; a spot beside it has (d/|S - x|)^2
    assert errors.at(Pose(light=0.3, camera=-0.5), "sample").relative_distance_factor == pytest.approx(1.0)
    pose = Pose(light=0.6, camera=-0.5)
    beside = calibrated(
        {"geometry.light_distance_mm": 0.5}, 0.0, reference=Reference(how="beside", offset_mm=(8.0, 0.0))
    )
    sights, lamp = GeometryErrors(beside).at(pose, "reference"), np.asarray(kinematics.view(beside, pose).source_mm)
    way = lamp - [8.0, 0.0, 0.0]
    assert sights.known[[0, 4]] == pytest.approx([math.acos(way[2] / np.linalg.norm(way)), di**2 / (way @ way)])
    slope = 2 / di - 2 * (way @ lamp) / di / (way @ way)
    assert abs(half(sights.relative_distance_factor)) == pytest.approx([0.5 * abs(slope)], rel=1e-3)


def test_causes_of_the_camera_are_its_covariance() -> None:
    camera = Camera(nonlinearity=(-0.01, 0.004), stray_light=0.01)
    u = {"camera.nonlinearity[0]": 2e-3, "camera.nonlinearity[1]": 3e-3, "camera.stray_light": 1e-3}
    causes = light_and_lens._causes(calibrated(u, 0.0, camera=camera))
    assert list(causes) == ["s_linearity", "s_linearity_2", "s_stray_light"]
    stack = np.array(list(causes.values()))
    assert stack.T @ stack == pytest.approx(np.diag(np.square(list(u.values()))))
    known = light_and_lens._causes(calibrated({name: u[name] for name in list(u)[:2]}, 1.0, camera=camera))
    assert list(known) == ["s_linearity"], "what goes together wholly is one cause, and what nobody knows is none"
    assert abs(known["s_linearity"]) == pytest.approx([2e-3, 3e-3, 0.0])


@pytest.mark.parametrize(("how", "shift_mm"), [("beside", (6.0, -2.0)), ("beam", (0.0, 0.0))])
def test_a_slope_of_the_beam_counts_by_how_far_reference_and_sample_lie_apart_in_it(how: Any, shift_mm: Any) -> None:
    """At normal incidence the plane that faces the lamp is the sample's; obliquely it is seen foreshortened."""
    u = np.array([1e-3, 2e-3, 0.0, 0.0, 0.0])
    reference = Reference(how=how, offset_mm=shift_mm, attenuation=0.01) if how == "beam" else Reference(
        how=how, offset_mm=shift_mm)  # fmt: skip
    description = calibrated(
        dict(zip(BEAM, u, strict=True)), 0.0, reference=reference, lamp=Lamp(beam=Beam(), half_angle_deg=0.5),
        camera=Camera(width=160, height=120, pixel_um=40.0),
    )  # fmt: skip
    brdf = np.array([0.3, 0.2])
    points = [SimpleNamespace(pose=Pose(light=0.0, camera=0.4)), SimpleNamespace(pose=Pose(light=0.5, camera=-0.3))]
    measured: Any = SimpleNamespace(
        description=description, band=BANDS[0], visit=SimpleNamespace(pose=Pose(light=0.0, camera=0.7)), points=points
    )
    column, own = light_and_lens._beam(measured, np.diag(u**2), brdf)
    apart = math.hypot(1e-3 * shift_mm[0], 2e-3 * shift_mm[1])
    # pixels are counted whole: a region's middle is known to a hundredth of its 3 mm
    assert np.sqrt(column**2 + own**2) == pytest.approx(brdf * apart, abs=brdf.max() * 2e-3 * 0.05)


@pytest.mark.parametrize(("pattern", "pixel_mm"), [("mono", 0.36), ("RGGB", 0.72)])
def test_a_cell_of_a_map_is_a_pixel_or_a_bayer_cell_in_the_plane_in_focus(pattern: Any, pixel_mm: float) -> None:
    """40 um, ten focal lengths away: times nine."""
    assert grid(describe(camera=Camera(pixel_um=40.0, pattern=pattern)), 10.0, None).pixel_mm == pixel_mm


def test_dark_lines_and_the_places_that_they_are_known_at() -> None:
    frames = [(t, np.full((4, 5), 100.0 + 20.0 * t) + np.arange(5) * t) for t in (0.1, 2.1)]
    darks = Darks(frames, slice(10, 14), slice(20, 25), 7.0)
    region = Roi(slice(11, 13), slice(22, 25), np.array([[True, False, True], [False, False, True]]))
    assert darks.rate(region) == pytest.approx([22.0, 24.0, 24.0])
    assert darks.of(region, 3.1) - darks.of(region, 2.1) == pytest.approx(darks.rate(region))
    assert darks.of(region, 0.0) == pytest.approx(100.0)
    assert _around(region, (slice(12, 40), slice(5, 23))) == (slice(11, 40), slice(5, 25))
    assert _widened((slice(10, 20), slice(2, 22)), 0.2, (21, 100)) == (slice(8, 21), slice(0, 26))
