"""Radiances against what radiometry says of simple scenes."""

import math
from typing import Any

import gonio_scenes.material
import numpy as np
import pytest
from gonio_scenes.picture import left_out

from gonio import materials
from gonio.geometry import angles
from gonio.models import Blinn, CookTorrance, HeTorrance, Model, OrenNayar, fresnel
from gonio.typing import Floats
from tests.gonio_scenes.scenes import SPHERE, rendered, scene, tables

EXACT = 1e-9
"""Of analytic shapes, relative: the goal of the geometry; the arithmetic itself is better than 1e-12."""

ALUMINIUM = {"model": "he-torrance", "parameters": {"sigma0_um": 0.18, "tau_um": 3.0, "ior": "Al"}}
MIRROR = {"model": "he-torrance", "parameters": {"sigma0_um": 0.0, "tau_um": 2.0, "ior": [1.5, 0.0]}}
WHITE = {"model": "lambert", "parameters": {"albedo": 1.0}}


def sphere_by_hand(camera: dict[str, Any], radius: float) -> tuple[Floats, Floats, Floats]:
    """Which pixels see a sphere about the origin, its normals there, and the directions back to the camera."""
    eye, height, width = np.array(camera["position_mm"]), camera["height"], camera["width"]
    half = math.tan(math.radians(camera["vertical_field_deg"]) / 2)
    row, column = np.mgrid[0:height, 0:width]
    x = (2 * (column + 0.5) / width - 1) * half * width / height
    y = (1 - 2 * (row + 0.5) / height) * half
    ray = np.stack([x, y, -np.ones_like(x)], axis=-1)  # this camera looks along -z, y is up
    ray /= np.linalg.norm(ray, axis=-1)[..., None]
    b, c = ray @ eye, eye @ eye - radius**2
    disc = b * b - c
    distance = np.where(disc > 0, -b - np.sqrt(np.maximum(disc, 0)), np.nan)
    position = eye + distance[..., None] * ray
    return disc > 0, position / radius, -ray


def test_a_lambertian_sphere_under_distant_light_is_albedo_over_pi_times_the_irradiance() -> None:
    picture = rendered()
    seen, normal, _ = sphere_by_hand(SPHERE["camera"], 40.0)
    toward = np.array([1.0, 0.5, 2.0]) / math.sqrt(5.25)
    expected = np.where(seen, 0.7 / math.pi * 3.0 * np.maximum(normal @ toward, 0.0), 0.0)
    assert (picture.shape >= 0).tolist() == seen.tolist()
    np.testing.assert_allclose(picture.radiance[..., 0], expected, rtol=0, atol=EXACT)
    np.testing.assert_allclose(picture.normal[seen], normal[seen], rtol=0, atol=EXACT)


@pytest.mark.parametrize(
    ("table", "model"),
    [
        (ALUMINIUM, HeTorrance(sigma0_um=0.18, tau_um=3.0, ior="Al")),
        (
            {
                "model": "cook-torrance",
                "parameters": {"s": 0.6, "d": 0.4, "slopes": [[0.3, 1.0]], "diffuse_albedo": 0.5},
            },
            CookTorrance(s=0.6, d=0.4, slopes=((0.3, 1.0),), diffuse_albedo=0.5),
        ),
        (
            {"model": "oren-nayar", "parameters": {"albedo": 0.8, "sigma_deg": 35}},
            OrenNayar(albedo=0.8, sigma_deg=35),
        ),
    ],
)
def test_pixels_are_the_models_value_at_their_own_geometry(table: dict[str, Any], model: Model) -> None:
    waves = [450.0, 550.0, 650.0]
    light = {"kind": "point", "position_mm": [300.0, 200.0, 500.0], "intensity": 2e5}
    picture = rendered(wavelength_nm=waves, material={"m": table}, light=[light])
    seen, normal, back = sphere_by_hand(SPHERE["camera"], 40.0)
    checked = 0
    for row, column in np.argwhere(seen)[::7]:
        n, v = normal[row, column], back[row, column]
        away = np.array(light["position_mm"]) - 40.0 * n
        to_light = away / np.linalg.norm(away)
        expected = np.zeros(3)
        if n @ to_light > 0:
            # the angles alone, in a frame of its own: these models are isotropic
            x = np.cross([0.3, -0.4, 0.866], n)
            frame = np.array([x / np.linalg.norm(x), np.cross(n, x / np.linalg.norm(x)), n])
            at = [*angles(frame @ to_light), *angles(frame @ v)]
            irradiance = 2e5 / (away @ away) * (n @ to_light)
            expected = np.array([float(model.brdf(*map(float, at), wavelength_nm=w)) for w in waves]) * irradiance
            checked += 1
        # the two paths round their angles apart, which a steep lobe multiplies by up to 1e3
        np.testing.assert_allclose(picture.radiance[row, column], expected, rtol=1e-10, atol=1e-14)
    assert checked > 50


def test_a_disc_of_light_gives_pi_l_sine_squared_on_its_axis() -> None:
    """E = pi L R^2/(R^2 + d^2) below the centre of a Lambertian disc that faces a surface."""
    picture = rendered(
        camera=SPHERE["camera"] | {"width": 1, "height": 1, "vertical_field_deg": 0.001, "position_mm": [0, 0, 150]},
        shape=[{"kind": "plane", "material": "m"}],
        material={"m": WHITE},
        light=[
            {
                "kind": "disc", "center_mm": [0.0, 0.0, 100.0], "normal": [0.0, 0.0, -1.0], "radius_mm": 60.0,
                "radiance": 2.0, "samples": 4096,
            }
        ],
    )  # fmt: skip
    # an even sequence of n points misses the integral of a smooth function by about 1/n: 4096 points, cos^4 within
    np.testing.assert_allclose(picture.radiance[0, 0, 0], 2.0 * 60.0**2 / (60.0**2 + 100.0**2), rtol=1e-3)


def test_a_closed_white_room_has_one_radiance() -> None:
    shapes = [
        {"kind": "box", "center_mm": [0.0, 0.0, 0.0], "size_mm": [300.0, 300.0, 300.0], "material": "white"},
        {"kind": "sphere", "radius_mm": 40.0, "material": "white"},
        {"kind": "sphere", "center_mm": [70.0, 0.0, -20.0], "radius_mm": 20.0, "material": "perfect"},
    ]
    perfect = {"model": "he-torrance", "parameters": {"sigma0_um": 0.0, "tau_um": 2.0, "ior": [1e-8, 1e8]}}
    picture = rendered(
        camera=SPHERE["camera"] | {"position_mm": [0.0, 0.0, 140.0], "vertical_field_deg": 100.0},
        shape=shapes,
        material={"white": WHITE, "perfect": perfect},
        light=[{"kind": "ambient", "radiance": 1.25}],
        mirror_depth=8,
    )
    assert set(np.unique(picture.shape)) == {0, 1, 2}
    # a metal of k = 1e8 reflects 1 but for 4/k at grazing incidence and less elsewhere; quadrature of rho_hd 1e-9
    np.testing.assert_allclose(picture.radiance, 1.25, rtol=1e-6)


def test_a_smooth_plane_shows_the_mirror_image_times_its_reflectivity() -> None:
    lit = {"kind": "directional", "toward": [0.2, 1.0, 0.4], "irradiance": 1.0}
    ball = {"kind": "sphere", "center_mm": [0.0, 60.0, 0.0], "radius_mm": 40.0, "material": "m"}
    floor = {"kind": "plane", "normal": [0.0, 1.0, 0.0], "material": "mirror"}
    materials = {"m": SPHERE["material"]["m"], "mirror": MIRROR}
    camera = {"position_mm": [0.0, 120.0, 600.0], "look_at_mm": [0.0, -60.0, 0.0], "vertical_field_deg": 8.0}
    camera |= {"width": 64, "height": 48}
    below = rendered(camera=camera, shape=[ball, floor], material=materials, light=[lit])
    # the same seen from the mirrored camera, whose picture is upside down in no way: look and up are mirrored too
    twin = camera | {"position_mm": [0.0, -120.0, 600.0], "look_at_mm": [0.0, 60.0, 0.0], "up": [0.0, -1.0, 0.0]}
    direct = rendered(camera=twin, shape=[ball], material={"m": materials["m"]}, light=[lit])
    floor_seen = below.shape == 1
    # the mirrored camera's right is reversed
    through = np.where(floor_seen, direct.radiance[:, ::-1, 0], 0.0)
    away = below.position - np.array([0.0, 120.0, 600.0])
    f_s, f_p = fresnel.amplitudes(np.abs(away[..., 1]) / np.linalg.norm(away, axis=-1), 1.5)
    expected = through * (abs(f_s) ** 2 + abs(f_p) ** 2) / 2
    assert (through > 0).sum() > 100
    np.testing.assert_allclose(below.radiance[floor_seen, 0], expected[floor_seen], rtol=EXACT, atol=1e-14)


def test_a_sphere_shadows_the_plane_behind_it_and_a_light_that_is_nearer_does_not() -> None:
    shapes = [
        {"kind": "sphere", "center_mm": [0.0, 0.0, 80.0], "radius_mm": 30.0, "material": "m"},
        {"kind": "plane", "material": "m"},
    ]
    camera = SPHERE["camera"] | {"vertical_field_deg": 14.0, "width": 60, "height": 60}
    toward = np.array([1.0, 0.5, 1.0]) / 1.5
    picture = rendered(camera=camera, shape=shapes, light=[SPHERE["light"][0] | {"toward": toward.tolist()}])
    plane = picture.shape == 1
    to_centre = np.array([0.0, 0.0, 80.0]) - picture.position
    from_line = np.linalg.norm(to_centre - (to_centre @ toward)[..., None] * toward, axis=-1)
    assert ((picture.radiance[..., 0] == 0.0) == (from_line < 30.0))[plane].all()
    assert (from_line < 30.0)[plane].sum() > 50
    near = rendered(camera=camera, shape=shapes, light=[{"kind": "point", "position_mm": [0, 0, 45], "intensity": 1.0}])
    assert (near.radiance[plane] > 0).all()


@pytest.mark.parametrize(
    "walls",
    [
        {"kind": "box", "size_mm": [100.0, 80.0, 60.0], "axis": [0.3, 0.2, 1.0]},
        {"kind": "cylinder", "radius_mm": 40.0, "height_mm": 70.0, "axis": [0.3, 0.2, 1.0]},
        {"kind": "sphere", "radius_mm": 50.0},
        {"kind": "revolution", "profile_mm": [[20.0, -40.0], [45.0, -10.0], [30.0, 20.0], [10.0, 40.0]], "caps": True},
        {"kind": "revolution", "profile_mm": [[0.0, -40.0], [45.0, -10.0], [30.0, 20.0], [0.0, 40.0]], "smooth": True},
    ],
    ids=["box", "cylinder", "sphere", "frusta", "smooth"],
)
def test_a_closed_room_is_dark_inside_under_light_from_outside(walls: dict[str, Any]) -> None:
    camera = SPHERE["camera"] | {"position_mm": [3.0, 2.0, 1.0], "look_at_mm": [9.0, -5.0, 2.0]}
    picture = rendered(
        camera=camera | {"vertical_field_deg": 140.0},
        shape=[walls | {"material": "m"}],
        light=[{"kind": "point", "position_mm": [120.0, -180.0, 240.0], "intensity": 1e5}, *SPHERE["light"]],
    )
    assert (picture.shape == 0).all()
    assert (picture.radiance == 0.0).all()


def test_a_shape_far_away_changes_nothing_on_a_smooth_one() -> None:
    profile = [[0.0, -40.0], [45.0, -10.0], [30.0, 20.0], [0.0, 40.0]]
    smooth = {"kind": "revolution", "profile_mm": profile, "smooth": True, "material": "m"}
    far = {"kind": "disc", "center_mm": [0.0, 0.0, -9000.0], "radius_mm": 1.0, "material": "m"}
    camera = SPHERE["camera"] | {"position_mm": [300.0, 200.0, 1000.0], "width": 160, "height": 160}
    light = [{"kind": "directional", "toward": [0.6, 0.2, 1.0], "irradiance": 1.0}]
    alone, two = (rendered(camera=camera, shape=shapes, light=light) for shapes in ([smooth], [smooth, far]))
    np.testing.assert_array_equal(alone.radiance, two.radiance)


def test_ambient_light_is_multiplied_by_the_hemispherical_directional_reflectance() -> None:
    model = OrenNayar(albedo=0.9, sigma_deg=30)
    table = {"model": "oren-nayar", "parameters": {"albedo": 0.9, "sigma_deg": 30}}
    picture = rendered(material={"m": table}, light=[{"kind": "ambient", "radiance": 2.0}])
    seen, normal, back = sphere_by_hand(SPHERE["camera"], 40.0)
    cosine = np.einsum("...j,...j", normal, back)[seen]
    # a midpoint sum over the hemisphere, of another kind than the product's: cos^2 and the azimuth evenly
    sine2 = (np.arange(400) + 0.5) / 400
    phi = (np.arange(400) + 0.5) * math.pi / 400
    theta_i = np.arcsin(np.sqrt(sine2))[:, None]
    for k in range(0, cosine.size, 297):
        rho = model.brdf(theta_i, phi, float(np.arccos(cosine[k])), 0.0).mean() * math.pi
        # the sum is right to 1e-5 but for grazing views, where the interpolation between 65 angles is right to 1e-4
        np.testing.assert_allclose(picture.radiance[seen][k, 0], 2.0 * rho, rtol=2e-4)


def test_grooves_send_ambient_light_back_by_the_azimuth_they_are_seen_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gonio_scenes.material, "AMBIENT_NODES", 9)  # of the table: each is a quadrature of its own
    monkeypatch.setattr(gonio_scenes.material, "AMBIENT_AZIMUTHS", 9)
    parameters: dict[str, Any] = {"albedo": 0.9, "form": "single-slope", "slope_deg": 40.0, "groove_azimuth_deg": 20.0}
    model = OrenNayar(**parameters)
    camera = SPHERE["camera"] | {
        "width": 2,
        "height": 2,
        "position_mm": [600.0, 400.0, 250.0],
        "vertical_field_deg": 10.0,
    }
    picture = rendered(
        camera=camera,
        shape=[{"kind": "plane", "x_axis": [1.0, 0.0, 0.0], "material": "m"}],
        material={"m": {"model": "oren-nayar", "parameters": parameters}},
        light=[{"kind": "ambient", "radiance": 1.0}],
    )
    away = np.array(camera["position_mm"]) - picture.position.reshape(-1, 3)
    theta, phi = angles(away / np.linalg.norm(away, axis=1)[:, None])
    rho = model.hemispherical_directional(theta, phi_r=phi, tolerance=1e-6)
    # along the grooves, and across them, rho_hd is farther apart than the table of 9 x 9 directions is wrong
    along, across = model.hemispherical_directional(theta[0], phi_r=np.radians([20.0, 110.0]), tolerance=1e-6)
    np.testing.assert_allclose(picture.radiance.ravel(), rho, rtol=0, atol=0.2 * abs(along - across))


def test_a_stated_ambient_reflectance_takes_the_place_of_the_integral() -> None:
    copper = {"model": "cook-torrance", "parameters": {"ior": "Cu"}, "ambient_reflectance": "normal"}
    ambient = [{"kind": "ambient", "radiance": 1.0}]
    picture = rendered(wavelength_nm=[450.0, 650.0], material={"m": copper}, light=ambient)
    n = np.array([materials.ior("Cu")(w) for w in (450.0, 650.0)])
    expected = abs((n - 1) / (n + 1)) ** 2
    seen = picture.shape >= 0
    np.testing.assert_allclose(picture.radiance[seen], np.broadcast_to(expected, (seen.sum(), 2)), rtol=1e-12)
    # where there is no shape the ambient light itself is seen
    np.testing.assert_allclose(picture.radiance[~seen], 1.0, rtol=1e-15)


def test_a_mirror_shows_a_disc_of_light_with_its_radiance() -> None:
    disc = {
        "kind": "disc", "center_mm": [0.0, 0.0, 500.0], "normal": [0.0, 0.0, -1.0], "radius_mm": 10.0, "radiance": 7.0,
        "samples": 1,
    }  # fmt: skip
    camera = SPHERE["camera"] | {"position_mm": [0.0, 0.0, 400.0], "vertical_field_deg": 3.0}
    picture = rendered(camera=camera, shape=[{"kind": "plane", "material": "m"}], material={"m": MIRROR}, light=[disc])
    # seen at normal incidence in a mirror 400 mm away, the disc is 900 mm away
    half_field = math.tan(math.radians(1.5))
    row, column = np.mgrid[0:40, 0:48]
    radius = np.hypot((column + 0.5 - 24) / 20, (row + 0.5 - 20) / 20) * half_field * 900.0
    # R changes by 1e-4 of itself within 1.5 degrees from the normal
    np.testing.assert_allclose(picture.radiance[..., 0], np.where(radius <= 10.0, 7.0 * 0.04, 0.0), rtol=1e-4)


def test_shininess_that_changes_over_a_surface_is_blinns_textured_distribution() -> None:
    table = {
        "model": "blinn",
        "parameters": {"k_d": 0.3, "k_s": 0.5, "ior": 1.5, "c": 0.5},
        "textures": {"c": {"pattern": "speckle", "low": 0.2, "high": 1.0, "repeat": [4, 4]}},
    }
    built = scene(material={"m": table})
    material = built.material[0]
    random = np.random.default_rng(5)
    uv = random.random((500, 2))
    omega = random.normal(size=(2, 500, 3))
    omega[..., 2] = np.abs(omega[..., 2])
    omega /= np.linalg.norm(omega, axis=-1)[..., None]
    t = gonio_scenes.material.Texture(pattern="speckle", repeat=(4, 4)).load(built.source.parent, "")(uv)
    assert len(np.unique(t)) > 8
    half = omega.sum(axis=0)
    flat = Blinn(k_d=0.3, k_s=0.5, ior=1.5, c=1.0)  # D3 = 1 everywhere
    d3 = Blinn.textured_d3(half[:, 2] / np.linalg.norm(half, axis=-1), 0.2, t)
    diffuse = 0.3 / math.pi
    expected = diffuse + (flat.brdf_vectors(omega[0], omega[1]) - diffuse) * d3
    np.testing.assert_allclose(material.brdf(omega[0], omega[1], uv)[:, 0], expected, rtol=1e-12)


def test_light_polarised_along_s_and_p_makes_up_unpolarised_light() -> None:
    light = {"kind": "directional", "toward": [1.0, 0.0, 2.0], "irradiance": 1.0}
    pair = [light | {"irradiance": 0.5, "polarisation": p} for p in ([0.0, 1.0, 0.0], [2.0, 0.0, -1.0])]
    one, both, whole = (
        rendered(material={"m": ALUMINIUM}, light=lights).radiance for lights in (pair[:1], pair, [light])
    )
    np.testing.assert_allclose(both, whole, rtol=1e-9, atol=1e-14)
    assert np.abs(2.0 * one - whole).max() > 1e-3 * whole.max()


def test_what_is_not_known_of_the_polarisation_in_a_mirror_is_said() -> None:
    lamp = {"kind": "disc", "center_mm": [0, 0, 300], "normal": [0, 0, -1], "radius_mm": 50.0, "radiance": 1.0}
    mirror = {"m": MIRROR}

    def said(**changes: Any) -> str:
        return " ".join(each["what"] for each in left_out(scene(material=mirror, **changes)))

    assert "polarisation of what a mirror shows" in said(light=[lamp | {"polarisation": [1, 0, 0]}])
    assert "that the camera sees" in said(light=[lamp | {"polarisation": [1, 0, 0], "visible": True}])
    assert "a mirror shows" not in said(light=[lamp])


def test_a_field_along_the_light_prefers_no_direction() -> None:
    lamp = {"kind": "point", "position_mm": [0.0, 0.0, 500.0], "intensity": 1e5}
    camera = SPHERE["camera"] | {"width": 3, "height": 3, "vertical_field_deg": 2.0}
    pictures = [
        rendered(camera=camera, light=[lamp | more], material={"m": ALUMINIUM}).radiance[1, 1, 0]
        for more in ({}, {"polarisation": [0.0, 0.0, 1.0]})
    ]
    # the middle pixel's light comes along z: what is left of its field is rounding, and none of the picture is NaN
    assert pictures[1] == pytest.approx(pictures[0], rel=1e-12)


def test_what_a_scene_does_not_name_is_not_computed() -> None:
    assert set(rendered(material={"m": ALUMINIUM}).rays) == {"camera"}
    two = tables()["shape"] + [{"kind": "plane", "center_mm": [0.0, 0.0, -50.0], "material": "m"}]
    assert set(rendered(shape=two).rays) == {"camera", "shadow"}
    assert set(rendered(shape=two, material={"m": ALUMINIUM}).rays) == {"camera", "shadow", "mirror"}


def test_lights_add_up() -> None:
    first = SPHERE["light"][0]
    second = {"kind": "point", "position_mm": [-500.0, 0.0, 300.0], "intensity": 1e5}
    separate = rendered(light=[first]).radiance + rendered(light=[second]).radiance
    np.testing.assert_allclose(rendered(light=[first, second]).radiance, separate, rtol=1e-14)
