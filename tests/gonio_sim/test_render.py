"""The rendered scene against the measurement equation, pixel by pixel, and against what a mirror must show."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim import render
from gonio_sim.render import Renderer
from gonio_sim.rig import SimulatedRig
from gonio_sim.world import World

from gonio import models
from gonio.geometry import angles, solid_angle_of_cone
from gonio.instrument import apparent_brdf
from gonio.lab.reduction import brdf
from gonio.lab.rig import Pose, Target
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.kinematics import view
from gonio.materials import ior
from gonio.models import fresnel
from gonio.samples.description import SampleDescription
from gonio.typing import Floats
from tests.gonio_sim.conftest import MATTE, describe, measured

R = 40_000.0
"""responsivity_e_per_s of the shipped rigs."""
SINGLE = 1e-6
"""A scene is kept in single precision: 6e-8, and a few roundings."""
BARE: dict[str, Any] = {"cos4": False, "vignetting": 0.0}


def sample(model: str, **parameters: Any) -> SampleDescription:
    return SampleDescription(name="test", model=model, parameters=parameters)


def deg(light: float, camera: float, tilt: float = 0.0, spin: float = 0.0) -> Pose:
    return Pose(*(math.radians(angle) for angle in (light, camera, tilt, spin)))


def scene(
    description: RigDescription, what: SampleDescription | None, pose: Pose, target: Target = "sample", nm: float = 550
) -> Floats:
    """Rendered rate of every pixel [e-/s]."""
    world = World(description, what, 1)
    world.pose, world.target = pose, target
    return Renderer(world).rate(description.bands.containing(nm)).astype(float)


def test_matt_sample_gives_the_measurement_equation_in_every_pixel() -> None:
    """R pi V cos (d0/d)^2 albedo/pi, with the geometry worked out here from the pixels' lines of sight."""
    description = describe("sim-ideal")
    pose = deg(35, -50, 20, 40)
    rendered = scene(description, MATTE, pose)
    v = view(description, pose)
    rows, cols = np.array([0, 100, 239, 300, 470]), np.array([5, 200, 320, 400, 630])
    # the lens images 1 m to 1/(1/100 - 1/1000) = 111.11 mm behind it
    u, w = (cols - 319.5) * 0.005 / 111.1111111111, (rows - 239.5) * 0.005 / 111.1111111111
    ray = -v.camera_mm / 1000 + u[:, None] * v.image_x + w[:, None] * v.image_y
    spot = v.camera_mm - ray * (v.camera_mm[2] / ray[:, 2])[:, None]
    to_source = v.source_mm - spot
    distance = np.linalg.norm(to_source, axis=1)
    field_squared = u**2 + w**2
    corner_squared = (320**2 + 240**2) * (0.005 / 111.1111111111) ** 2
    lens = (1 + field_squared) ** -2 * (1 - 0.08 * (field_squared / corner_squared) ** 2)
    albedo = np.where(np.hypot(spot[:, 0], spot[:, 1]) <= 10, 0.5, 0.03)
    expected = R * lens * to_source[:, 2] / distance * (1000 / distance) ** 2 * albedo
    assert set(albedo) == {0.5, 0.03}
    np.testing.assert_allclose(rendered[rows, cols], expected, rtol=SINGLE)


@pytest.mark.parametrize(
    ("what", "pose"),
    [
        (
            sample("oren-nayar", albedo=0.8, sigma_deg=30),
            deg(40, -40),
        ),  # its kink at theta_r = theta_i crosses the frame
        (sample("phong", k_d=0.2, k_s=0.8, exponent=200), deg(50, -48)),
        (sample("blinn", c=0.1), deg(20, -24, 3)),
        (sample("cook-torrance", s=0.8, d=0.2, diffuse_albedo=0.4, slopes=[[0.1, 1.0]]), deg(60, -62)),
        (sample("he-torrance", sigma0_um=0.28, tau_um=1.77, ior="Al"), deg(60, -68)),
        (sample("he-torrance", sigma0_um=0.28, tau_um=1.77, ior="Al"), deg(75, -75)),  # with its spike
        (sample("he-torrance", sigma0_um=0.1, tau_um=4.0, ior="Al"), deg(30, -29, 0.3)),
    ],
)
def test_interpolated_scene_equals_a_direct_evaluation_at_every_pixel(what: SampleDescription, pose: Pose) -> None:
    """To 1e-4, the tolerance of the grid: at pixels drawn over the sample, midpoints between nodes among them."""
    description = describe("sim-ideal", camera=BARE)
    rendered = scene(description, what, pose)
    seen = pixel_map(description, view(description, pose))
    rows, cols = np.nonzero(np.hypot(seen.x_mm, seen.y_mm) < 9.99)
    chosen = np.random.default_rng(2).choice(rows.size, 150, replace=False)
    at = rows[chosen], cols[chosen]
    cone = float(solid_angle_of_cone(math.radians(0.5)))
    direct = apparent_brdf(
        models.build(what.model, what.parameters),
        *angles(seen.omega_i[at]),
        *angles(seen.omega_r[at]),
        wavelength_nm=550,
        source_solid_angle_sr=cone,
        receiver_solid_angle_sr=cone,
        spike="exact",
    )
    np.testing.assert_allclose(rendered[at], R * math.pi * seen.weight[at] * direct, rtol=1e-4)


def test_a_smooth_sample_shows_the_mirror_image_of_the_lamp() -> None:
    """Its place, size and radiance: rho_s times the lamp's.

    Source and camera lie at the same distance d. From a spot that is dx off the mirror point they are seen in
    directions that turn by dx cos(theta)/d each, against each other once mirrored; across the plane of incidence by
    dy/d. So the lamp's half-angle a is seen up to dx = a d / (2 cos(theta)) and dy = a d / 2. A lamp of radiance L
    gives the irradiance L w_s cos(theta), and R stands for a white surface under L w_s: the rate is R pi rho_s / w_s.
    """
    theta, half = math.radians(30), math.radians(0.5)
    description = describe("sim-ideal", camera=BARE | {"lens_half_angle_deg": 0.01}, holder={"holder_albedo": 0.0})
    mirror = sample("he-torrance", sigma0_um=0.0, tau_um=1.0, ior=[1.5, 0.0])
    pose = deg(30, -30)
    rendered = scene(description, mirror, pose)
    seen = pixel_map(description, view(description, pose))
    rho_s = models.build("he-torrance", mirror.parameters).specular_reflectivity(theta)
    expected = R * math.pi * rho_s / float(solid_angle_of_cone(half))
    # 1e-4: theta differs by 5e-4 rad within the pixel's spot and the lens
    assert rendered[239:241, 319:321].mean() == pytest.approx(expected, rel=1e-4)
    lit = rendered > 0.5 * expected
    pixel_mm = 0.045 / math.cos(theta)
    for along, radius in ((seen.x_mm[240], 1000 * half / (2 * math.cos(theta))), (seen.y_mm[:, 320], 1000 * half / 2)):
        line = lit[240] if along.size == 640 else lit[:, 320]
        # half a pixel of each edge, and 1 % for the second order of a spot 5 mm off at 1 m
        assert along[line].max() == pytest.approx(radius, abs=pixel_mm, rel=0.01)
        assert along[line].min() == pytest.approx(-radius, abs=pixel_mm, rel=0.01)
    # the plateau is as bright as its centre: radiance does not change along a mirrored ray
    inside = np.hypot(seen.x_mm / 4.0, seen.y_mm / 3.5) < 1
    np.testing.assert_allclose(rendered[inside], expected, rtol=0.02)  # Fresnel reflectivity changes over 0.5 deg


def test_point_source_and_pinhole_cost_no_cones_and_give_the_model_itself() -> None:
    description = describe("sim-ideal", camera=BARE | {"lens_half_angle_deg": 0.0}, lamp={"half_angle_deg": 0.0})
    pose = deg(40, -55, 10)
    rendered = scene(description, sample("cook-torrance"), pose)
    seen = pixel_map(description, view(description, pose))
    at = 240, 300
    value = models.build("cook-torrance", {}).brdf_vectors(seen.omega_i[at], seen.omega_r[at])
    # the grid of nodes follows a lobe to 1e-4
    assert rendered[at] == pytest.approx(R * math.pi * seen.weight[at] * value, rel=1e-4)


def test_a_smaller_sample_ends_at_its_own_edge() -> None:
    description = describe("sim-ideal")
    small = MATTE.model_copy(update={"diameter_mm": 6.0})
    rendered, seen = scene(description, small, deg(0, 45)), pixel_map(description, view(description, deg(0, 45)))
    ratio = rendered / scene(description, MATTE, deg(0, 45))
    radius = np.hypot(seen.x_mm, seen.y_mm)
    np.testing.assert_allclose(ratio[(radius > 3.001) & (radius < 9.999)], 0.03 / 0.5, rtol=SINGLE)
    np.testing.assert_allclose(ratio[radius < 2.999], 1.0, rtol=SINGLE)


@pytest.mark.parametrize("how", ["swap", "axis"])
def test_the_reference_takes_the_samples_place(how: str) -> None:
    description = describe("sim-ideal", reference={"how": how, "diameter_mm": 12.0})
    white, grey = scene(description, MATTE, deg(0, 45), "reference"), scene(description, MATTE, deg(0, 45))
    assert white[240, 320] / grey[240, 320] == pytest.approx(0.99 / 0.5, rel=SINGLE)
    assert white[240, 20] == pytest.approx(grey[240, 20], rel=SINGLE)  # the holder, 10 mm and more off


def test_the_reference_beside_the_sample_is_in_the_same_frame() -> None:
    description = describe(
        "sim-ideal",
        holder={"sample_diameter_mm": 8.0},
        reference={"how": "beside", "offset_mm": [7.0, 1.0], "diameter_mm": 4.0},
    )
    pose = deg(10, -20)
    seen = pixel_map(description, view(description, pose))
    rendered = scene(description, MATTE, pose)
    np.testing.assert_array_equal(rendered, scene(description, MATTE, pose, "reference"))
    albedo = rendered / (R * seen.weight)
    for x, y, expected in ((0, 0, 0.5), (3.9, 0, 0.5), (4.5, 0, 0.03), (7, 1, 0.99), (7, 2.9, 0.99), (7, 3.2, 0.03)):
        at = np.unravel_index(np.argmin(np.hypot(seen.x_mm - x, seen.y_mm - y)), albedo.shape)
        assert albedo[at] == pytest.approx(expected, rel=SINGLE)


def test_integral_over_the_band() -> None:
    """Against a trapezoid over +-4 sigma of a Gaussian of the band's width, where the model is steep in wavelength."""
    band = {"list": [{"name": "wide", "centre_nm": 550, "fwhm_nm": 60}], "tunable": None}
    description = describe("sim-ideal", camera=BARE | {"lens_half_angle_deg": 0.0}, lamp={"half_angle_deg": 0.0})
    description = RigDescription.model_validate(description.model_dump() | {"bands": band})
    what = sample("he-torrance", sigma0_um=0.05, tau_um=3.0, ior=[1.5, 0.0])
    pose = deg(10, -25)
    at_centre = scene(description, what, pose)[240, 320]
    integral = scene(description, what.model_copy(update={"integrate_band": True}), pose)[240, 320]
    model = models.build(what.model, what.parameters)
    sigma = 60 / (2 * math.sqrt(2 * math.log(2)))
    waves = np.linspace(550 - 4 * sigma, 550 + 4 * sigma, 401)
    shape = np.exp(-0.5 * ((waves - 550) / sigma) ** 2)
    seen = pixel_map(description, view(description, pose))
    directions = angles(seen.omega_i[240, 320]) + angles(seen.omega_r[240, 320])
    values = np.array([model.brdf(*directions, wavelength_nm=w) for w in waves])
    # the tails beyond 4 sigma hold 6e-5 of the weight; the values there differ by less than a half
    assert integral == pytest.approx(R * math.pi * seen.weight[240, 320] * np.average(values, weights=shape), rel=1e-4)
    assert abs(integral / at_centre - 1) > 1e-3  # and the integral is not the value at the centre


def test_a_bands_colour_reaches_only_its_pixels() -> None:
    bands = {"list": [{"name": "green", "centre_nm": 540, "fwhm_nm": 80, "channel": "G"}], "tunable": None}
    description = describe("sim-ideal", camera={"pattern": "RGGB"})
    description = RigDescription.model_validate(description.model_dump() | {"bands": bands})
    rendered = scene(description, MATTE, deg(0, 45), nm=540)
    assert rendered[0::2, 1::2].min() > 0
    assert rendered[1::2, 0::2].min() > 0
    assert not rendered[0::2, 0::2].any()
    assert not rendered[1::2, 1::2].any()


def test_nothing_is_seen_from_below_and_nothing_is_lit_from_below() -> None:
    description = describe("sim-ideal")
    assert not scene(description, MATTE, deg(0, 91)).any()
    assert not scene(description, MATTE, deg(-91.5, 45)).any()
    long = {"limits_deg": [-120.0, 120.0]}
    assert not scene(describe("sim-ideal", arms={"light": long, "camera": long}), MATTE, deg(-110, 115)).any()


def test_a_negative_brdf_is_dark() -> None:
    """Oren-Nayar's functional form is below zero near forward grazing; a pixel cannot be."""
    what = sample("oren-nayar", albedo=0.3, sigma_deg=60)
    description = describe("sim-ideal", camera={"lens_half_angle_deg": 0.0}, lamp={"half_angle_deg": 0.0})
    assert models.build(what.model, what.parameters).brdf(1.48, 0, 1.48, math.pi) < 0
    assert scene(description, what, deg(85, -85)).min() == 0


@pytest.mark.parametrize("knows", [True, False])
def test_a_lambertian_lamp_near_a_reference_beside_the_sample(tmp_path: Path, knows: bool) -> None:
    """300 mm from the lamp, 14 mm beside the centre: 1.1e-3, which the reduction takes out where the rig file says so.

    At normal incidence of both visit and point the light on the reference is lower by cos^4 of atan(14/300) for a
    Lambertian lamp, cos^3 for an isotropic one; the difference is the whole error.
    """
    description = describe(
        "sim-ideal",
        geometry={"light_distance_mm": 300.0, "camera_distance_mm": 300.0},
        lamp={"radiation": "lambertian"},
        camera={"focal_length_mm": 20.0},
        reference={"how": "beside", "offset_mm": [0.0, 14.0], "diameter_mm": 6.0, "frames": 4},
        acquisition={"frames": 4},
    )
    run = measured(tmp_path, description, [0], [45])
    if not knows:
        lamp = description.lamp.model_copy(update={"radiation": "isotropic"})
        run.settings = run.settings.model_copy(update={"rig": run.description.model_copy(update={"lamp": lamp})})
    found = brdf.reduce(run)["brdf"][0] / (0.5 / math.pi)
    # 16-bit levels at 0.6 of full scale in some 50 pixels of each region, and the finite patch: below 2e-5
    assert found == pytest.approx(1.0 if knows else 1 / math.cos(math.atan(14.0 / 300.0)), abs=2e-5)


# ---- What the simulated camera sees of a mirror, and of the lamp through an empty holder: one is the other,
# unfolded


CAMERA: dict[str, Any] = {"camera": {"width": 96, "height": 72, "pixel_um": 33.0, "cos4": False, "vignetting": 0.0}}


def rates(what: Any, pose: Pose, **changes: dict[str, Any]) -> np.ndarray[Any, Any]:
    rig = SimulatedRig(describe("sim-ideal", lamp={"half_angle_deg": 0.5}, **CAMERA, **changes), None, 0, confirm=False)
    with rig:
        rig.put(what)
        rig.world.pose = pose
        return rig.camera._renderer.rate(rig.description.bands.containing(550))


def test_the_mirror_shows_the_lamp_as_straight_through_by_its_reflectance() -> None:
    angle = math.radians(40)
    mirror = rates("mirror", Pose(light=angle, camera=-angle))
    through = rates("empty", Pose(light=angle, camera=angle - math.pi))
    f_s, f_p = fresnel.amplitudes(np.cos(angle), ior("Al")(550.0))
    middle = slice(30, 42), slice(42, 54)
    assert through[middle].mean() > 0
    assert mirror[middle].mean() / through[middle].mean() == pytest.approx(
        float(0.5 * (abs(f_s) ** 2 + abs(f_p) ** 2)), rel=2e-3
    )  # its change in view


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        (MATTE, {"holder": {"fiducials": {}}}),
        (MATTE, {"lamp": {"beam_diameter_mm": 6.0}}),
        (sample("he-torrance", sigma0_um=0.1, tau_um=3.0, ior="Al"), {}),
        (sample("he-torrance", sigma0_um=0.01, tau_um=3.0, ior="Al"), {"camera": {"distortion": [0.1, 0, 0, 0, 0]}}),
        (sample("phong", k_d=0.2, k_s=0.8, exponent=200), {"camera": {"pattern": "RGGB", "stray_light": 0.01}}),
    ],
)
def test_a_picture_is_the_same_however_many_rows_are_rendered_together(
    what: SampleDescription, changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Edges of markers and of the beam, whose pixels are judged by their neighbours; the spike; what lenses bend."""
    camera = CAMERA["camera"] | changes.get("camera", {})
    rig = describe("sim-ideal", **({"lamp": {"half_angle_deg": 0.5}} | changes | {"camera": camera}))
    whole = scene(rig, what, deg(40, -40, 5, 10))
    monkeypatch.setattr(render, "STRIP", 96 * 7)
    np.testing.assert_array_equal(scene(rig, what, deg(40, -40, 5, 10)), whole)


def test_of_large_pictures_one_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(describe("sim-ideal", **CAMERA), MATTE, 1)
    for most, kept in ((2**27, 2), (4 * 96 * 72 + 1, 1)):
        monkeypatch.setattr(render, "KEPT_BYTES", most)
        renderer = Renderer(world)
        for angle in (30, 40, 50):
            world.pose = deg(angle, -40)
            renderer.rate(world.truth.bands.containing(550))
        assert len(renderer._scenes) == kept
