"""Samples whose parameters change over them, against values worked out pixel by pixel without the renderer's levels."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gonio_sim.render import Renderer
from gonio_sim.rig import SimulatedRig
from gonio_sim.world import World
from scipy import special

from gonio import models
from gonio.errors import ConfigError
from gonio.geometry import angles, solid_angle_of_cone
from gonio.instrument import apparent_brdf
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Pose
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.kinematics import view
from gonio.samples.description import SampleDescription
from gonio.samples.files import load_sample
from gonio.typing import Floats
from tests.gonio_sim.conftest import describe, measured

R = 40_000.0
"""responsivity_e_per_s of the shipped rigs."""
BARE: dict[str, Any] = {"cos4": False, "vignetting": 0.0}
SINGLE = 1e-6
"""A scene is kept in single precision: 6e-8, and a few roundings."""
LEVELS = 2e-4
"""The grid of nodes is followed to 1e-4, and levels of a texture to 1e-4."""


def deg(light: float, camera: float, tilt: float = 0.0, spin: float = 0.0) -> Pose:
    return Pose(*(math.radians(angle) for angle in (light, camera, tilt, spin)))


def textured(
    model: str, parameters: dict[str, Any], texture: dict[str, Any], diameter_mm: float | None = None
) -> SampleDescription:
    values = {"name": "test", "model": model, "parameters": parameters, "texture": texture}
    return SampleDescription.model_validate(values | {"diameter_mm": diameter_mm})


def scene(description: RigDescription, what: SampleDescription, pose: Pose) -> Floats:
    """Rendered rate of every pixel [e-/s]."""
    world = World(description, what, 1)
    world.pose = pose
    return Renderer(world).rate(description.bands.containing(550)).astype(float)


def two_paints(x: Floats, y: Floats) -> dict[str, Floats]:
    right = (x - 0.3) * math.cos(math.radians(5)) + y * math.sin(math.radians(5)) >= 0
    return {"albedo": np.where(right, 0.7, 0.25), "sigma_deg": np.where(right, 30.0, 10.0)}


def rough_gradient(x: Floats, y: Floats) -> dict[str, Floats]:
    return {"m": np.interp(x, [-8, 8], [0.15, 0.35])}


def brushed_plate(x: Floats, y: Floats) -> dict[str, Floats]:
    """The streaks' values are those of `speckle`: one of 16 shades for each pair of whole numbers."""
    c, s = math.cos(math.radians(35)), math.sin(math.radians(35))
    along, across = (x - 0.5) * c + (y + 1.0) * s, (y + 1.0) * c - (x - 0.5) * s
    inside = (np.abs(along) < 7.0) & (np.abs(across) < 0.125)
    streak = np.floor(y / 0.5) % 8
    shade = np.floor(16 * ((np.sin(streak * 78.233) * 43758.5453) % 1.0)) / 15
    return {"s": np.where(inside, 0.45, 0.9), "m": 0.16 + 0.1 * shade}


POLISHED = textured(
    "he-torrance",
    {"sigma0_um": 0.05, "tau_um": 2.0, "ior": "Al"},
    {"sigma0_um": {"pattern": "gradient", "low": 0.02, "high": 0.12, "size_mm": [20, 20], "azimuth_deg": 90}},
)


WIDE = textured(
    "cook-torrance",
    {"s": 0.9, "m": 0.1, "diffuse_albedo": 0.3},
    {"m": {"pattern": "gradient", "low": 0.05, "high": 0.5, "size_mm": [20, 20]}},
)


def wide(x: Floats, y: Floats) -> dict[str, Floats]:
    return {"m": np.interp(x, [-10, 10], [0.05, 0.5])}


def polished(x: Floats, y: Floats) -> dict[str, Floats]:
    return {"sigma0_um": np.interp(y, [-10, 10], [0.02, 0.12])}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "truth", "pose"),
    [
        ("two-paints", two_paints, deg(40, -50)),
        ("brushed-plate", brushed_plate, deg(30, -33)),
        ("brushed-plate", brushed_plate, deg(60, -70, 10, 40)),
        ("rough-gradient", rough_gradient, deg(30, -33)),
        (POLISHED, polished, deg(30, -30)),
        (POLISHED, polished, deg(30, -38)),
        (WIDE, wide, deg(30, -45)),
    ],
)
def test_pixels_equal_a_direct_evaluation_with_their_own_parameters(
    what: str | SampleDescription, truth: Callable[[Floats, Floats], dict[str, Floats]], pose: Pose
) -> None:
    """At pixels drawn over the sample, those at an edge left out: every pixel's model is built for it alone."""
    sample = load_sample(what) if isinstance(what, str) else what
    description = describe("sim-ideal", camera=BARE)
    rendered = scene(description, sample, pose)
    seen = pixel_map(description, view(description, pose))
    rows, cols = np.nonzero(np.hypot(seen.x_mm, seen.y_mm) < 9.9)
    chosen = np.random.default_rng(3).choice(rows.size, 60, replace=False)
    cone = float(solid_angle_of_cone(math.radians(0.5)))
    compared, values = 0, set[tuple[float, ...]]()
    for at in zip(rows[chosen], cols[chosen], strict=True):
        x, y = seen.x_mm[at], seen.y_mm[at]
        near = truth(x + np.array([-0.15, 0, 0.15]), y + np.array([[-0.15], [0], [0.15]]))
        if truth in (two_paints, brushed_plate) and any(np.ptp(each) > 0 for each in near.values()):
            continue  # a step near the pixel
        here = {name: float(np.broadcast_to(each, (3, 3))[1, 1]) for name, each in near.items()}
        direct = apparent_brdf(
            models.build(sample.model, sample.parameters | here),
            *angles(seen.omega_i[at]),
            *angles(seen.omega_r[at]),
            wavelength_nm=550,
            source_solid_angle_sr=cone,
            receiver_solid_angle_sr=cone,
            spike="exact",
        )
        assert rendered[at] == pytest.approx(R * math.pi * seen.weight[at] * direct, rel=LEVELS), (x, y)
        compared, values = compared + 1, values | {tuple(here.values())}
    assert compared >= 15
    assert len(values) > 1


def share_beyond(corners: list[tuple[float, float]], offset: float, normal: tuple[float, float]) -> float:
    """The part of a polygon's area where normal . (x, y) >= offset: clipped, and measured by the shoelace formula."""

    def area(points: list[tuple[float, float]]) -> float:
        pairs = zip(points, points[1:] + points[:1], strict=True)
        return abs(sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairs)) / 2

    heights = [normal[0] * x + normal[1] * y - offset for x, y in corners]
    kept = []
    for k, (corner, height) in enumerate(zip(corners, heights, strict=True)):
        after, next_height = corners[(k + 1) % len(corners)], heights[(k + 1) % len(corners)]
        if height >= 0:
            kept.append(corner)
        if height * next_height < 0:
            t = height / (height - next_height)
            kept.append((corner[0] + t * (after[0] - corner[0]), corner[1] + t * (after[1] - corner[1])))
    return area(kept) / area(corners) if len(kept) > 2 else 0.0


@pytest.mark.parametrize("azimuth_deg", [0.0, 5.0, 37.0, 90.0])
def test_a_pixel_on_an_edge_sees_the_mean_over_its_area(azimuth_deg: float) -> None:
    """Lambertian halves: the pixel's albedo is that of its area, by the corners that it sees."""
    edge = {"pattern": "edge", "low": 0.2, "high": 0.8, "origin_mm": [0.31, 0.17], "azimuth_deg": azimuth_deg}
    what = textured("lambert", {"albedo": 0.2}, {"albedo": edge})
    description, pose = describe("sim-ideal", camera=BARE), deg(0, 45)
    seen = pixel_map(description, view(description, pose))
    share = (scene(description, what, pose) / (R * seen.weight) - 0.2) / 0.6
    normal = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    offset = 0.31 * normal[0] + 0.17 * normal[1]
    inside = np.hypot(seen.x_mm, seen.y_mm) < 9.9
    rows, cols = np.nonzero(inside & (share > 1e-4) & (share < 1 - 1e-4))
    assert len(rows) > 150
    errors = []
    for row, col in zip(rows, cols, strict=True):
        # the corner of four pixels lies in the middle of their centres
        corners = [
            (float(seen.x_mm[r : r + 2, c : c + 2].mean()), float(seen.y_mm[r : r + 2, c : c + 2].mean()))
            for r, c in ((row - 1, col - 1), (row - 1, col), (row, col), (row, col - 1))
        ]
        errors.append(share[row, col] - share_beyond(corners, offset, normal))
    # 34 spots of a lattice: along rows and columns 1/68, and for slanted edges at most three spots
    assert np.abs(errors).max() < (0.016 if azimuth_deg in (0.0, 90.0) else 3 / 34)
    # over all pixels of a slanted edge the errors cancel; along a row all pixels may have the same one
    assert abs(np.mean(errors)) < (0.016 if azimuth_deg in (0.0, 90.0) else 0.003)


def test_a_scratch_thinner_than_a_pixel_takes_its_share_of_light() -> None:
    """0.02 mm wide, in pixels of 0.045 mm: across it, what is missing adds up to its width."""
    scratch = {"pattern": "scratch", "low": 0.5, "high": 0.0, "size_mm": [30.0, 0.02], "azimuth_deg": 80.0}
    what = textured("lambert", {"albedo": 0.5}, {"albedo": scratch})
    description, pose = describe("sim-ideal", camera=BARE), deg(30, 0)
    seen = pixel_map(description, view(description, pose))
    albedo = scene(description, what, pose) / (R * seen.weight)
    rows = np.nonzero(np.abs(seen.y_mm[:, 320]) < 5)[0]
    missing = [np.sum(1 - albedo[row, np.abs(seen.x_mm[row]) < 3] / 0.5) for row in rows]
    across = 0.02 / math.sin(math.radians(80)) / 0.045
    assert np.mean(missing) == pytest.approx(across, rel=0.01)  # 200 rows of some 15 lit spots each


def test_a_texture_of_one_value_is_the_uniform_sample() -> None:
    what = textured(
        "cook-torrance",
        {"s": 0.5, "m": 0.2, "diffuse_albedo": 0.3},
        {"m": {"pattern": "gradient", "low": 0.2, "high": 0.2, "size_mm": [9, 9]}},
    )
    description, pose = describe("sim-ideal"), deg(30, -35)
    plain = what.model_copy(update={"texture": {}})
    # weights of levels add up to 1 but for rounding
    np.testing.assert_allclose(scene(description, what, pose), scene(description, plain, pose), rtol=SINGLE)


def test_a_picture_is_laid_over_the_sample_in_mm(tmp_path: Path) -> None:
    """Four texels of 2 mm and 1 mm: the first row above, from x = 1 mm and y = -1 mm on."""
    np.save(tmp_path / "four.npy", np.array([[0.1, 0.2], [0.3, 0.4]]))
    (tmp_path / "s.toml").write_text(
        'name = "four"\nmodel = "lambert"\n[parameters]\nalbedo = 0.5\n[texture.albedo]\nfile = "four.npy"\nlow = 0\n'
        "high = 1\nsize_mm = [4, 2]\norigin_mm = [1, -1]\n"
    )
    description, pose = describe("sim-ideal", camera=BARE), deg(0, 45)
    seen = pixel_map(description, view(description, pose))
    albedo = scene(description, load_sample(tmp_path / "s.toml"), pose) / (R * seen.weight)
    for x, y, expected in ((2, 0.5, 0.1), (4, 0.5, 0.2), (2, -0.5, 0.3), (4, -0.5, 0.4), (-2, 2.5, 0.1), (0, 1.5, 0.4)):
        at = np.unravel_index(np.argmin(np.hypot(seen.x_mm - x, seen.y_mm - y)), albedo.shape)
        assert albedo[at] == pytest.approx(expected, rel=SINGLE)
    np.save(tmp_path / "four.npy", np.array([[0.1, 0.2], [0.3, 0.9]]))
    sample = load_sample(tmp_path / "s.toml")
    np.save(tmp_path / "four.npy", np.array([[0.1, 0.2], [0.3, 0.4]]))
    with pytest.raises(ConfigError, match=r"texture\.albedo\.file.*has changed since"):
        scene(description, sample, pose)


def test_a_back_changes_over_the_sample_too() -> None:
    what = textured(
        "diffuse-transmitter",
        {"reflectance": 0.3, "transmittance": 0.2},
        {"transmittance": {"pattern": "edge", "low": 0.2, "high": 0.6}},
    )
    long = {"limits_deg": [-170.0, 170.0]}
    description = describe("sim-ideal", camera=BARE, arms={"light": long, "camera": long})
    pose = deg(0, 150)
    seen = pixel_map(description, view(description, pose))
    rate = scene(description, what, pose) / (R * seen.weight)
    inside = np.hypot(seen.x_mm, seen.y_mm) < 9
    for side, expected in ((seen.x_mm < -0.1, 0.2), (seen.x_mm > 0.1, 0.6)):
        np.testing.assert_allclose(rate[inside & side], expected, rtol=SINGLE)


def test_the_lens_blurs_an_edge_as_an_integral_of_a_gaussian_says() -> None:
    """Across the edge the share of its brighter side is Phi(distance/sigma), averaged over the pixel."""
    sigma, offset = 2.0, 0.317
    edge = {"pattern": "edge", "low": 0.2, "high": 0.8, "origin_mm": [offset, 0.0]}
    what = textured("lambert", {"albedo": 0.2}, {"albedo": edge})
    description, pose = describe("sim-ideal", camera=BARE | {"blur_px": sigma}), deg(30, 0)
    seen = pixel_map(description, view(description, pose))
    albedo = scene(description, what, pose) / (R * seen.weight)
    row = albedo[240, np.abs(seen.x_mm[240]) < 5]
    ends = ((seen.x_mm[240, np.abs(seen.x_mm[240]) < 5] - offset) / 0.045)[:, None] + np.linspace(-0.5, 0.5, 201)
    expected = 0.2 + 0.6 * special.ndtr(ends / sigma).mean(axis=1)
    # the blur adds up whole pixels: 1/(12 sigma^2) of the Gaussian's steepest slope, 0.24, and 1/68 of a pixel's share
    assert np.abs(row - expected).max() < 0.6 * (0.242 / (12 * sigma**2) + 0.2 / 68)
    sharp = scene(describe("sim-ideal", camera=BARE), what, pose) / (R * seen.weight)
    far = (np.abs(seen.x_mm - offset) > 0.5) & (np.hypot(seen.x_mm, seen.y_mm) < 9.5)
    np.testing.assert_allclose(albedo[far], sharp[far], rtol=3e-5)  # irradiance is curved: 1e-9 a pixel squared, x 4


def test_backlash_moves_a_mark_by_a_third_of_a_pixel_between_poses(rig: Callable[..., SimulatedRig]) -> None:
    """The spin reads 0 twice; let down it lags by 0.1 deg, and 8 mm off the axis that is 0.014 mm: 0.31 pixels."""
    mark = {"pattern": "scratch", "low": 0.0, "high": 0.8, "size_mm": [1.0, 1.0], "origin_mm": [8.0, 0.0]}
    what = textured("lambert", {"albedo": 0.5}, {"albedo": mark})
    exact = {"encoder_step_deg": 0.0, "zero_u_deg": 0.0}
    arms = {"light": exact, "camera": exact}
    description = describe("sim", camera=BARE, holder=exact | {"spin_approach_deg": 0.0})
    description = RigDescription.model_validate(
        description.model_dump() | {"arms": {n: getattr(description.arms, n).model_dump() | arms[n] for n in arms}}
    )
    places, read = [], []
    with rig(description, what) as sim:
        for start in (-40.0, 40.0):
            sim.arms.move(deg(30, 0, 0, start))
            read.append(sim.arms.move(deg(30, 0, 0, 0)))
            rate = scene(description, what, sim.world.pose)
            seen = pixel_map(description, view(description, read[-1]))
            weight = np.where(np.hypot(seen.x_mm - 8, seen.y_mm) < 1.5, rate, 0.0)
            places.append([np.average(each, weights=weight) for each in (seen.x_mm, seen.y_mm)])
    assert read[0] == read[1]
    (x0, y0), (x1, y1) = places
    # centroids of 22 x 22 pixels whose edges are right to 1/34 pixel: 0.01 pixels
    assert abs(y1 - y0) / 0.045 == pytest.approx(8 * math.radians(0.1) / 0.045, abs=0.01)
    assert x1 == pytest.approx(x0, abs=0.01 * 0.045)


def test_a_run_keeps_the_textures_and_refuses_to_go_on_with_others(tmp_path: Path) -> None:
    sample = load_sample("two-paints")
    description = describe("sim-ideal", camera={"width": 64, "height": 64})
    run = measured(tmp_path, description, [0], [45], sample=sample)
    assert Run.open(tmp_path / "run").sample == sample == run.sample
    other = sample.texture["albedo"].model_copy(update={"high": 0.6})
    changed = sample.model_copy(update={"texture": sample.texture | {"albedo": other}})
    with pytest.raises(ConfigError, match=r"texture.*high"):
        measured(tmp_path, description, [0], [45], sample=changed, resume=True)
