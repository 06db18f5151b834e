"""Samples of several materials by area: where regions lie, what pixels see of them, and what a file cannot say."""

import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from gonio_sim.render import Renderer
from gonio_sim.world import World

from gonio.config import to_toml
from gonio.errors import GonioError
from gonio.lab.rig import Pose
from gonio.lab.rig.imaging import pixel_map
from gonio.lab.rig.kinematics import view
from gonio.samples.description import SampleDescription
from gonio.samples.files import load_model, load_sample
from gonio.typing import Floats
from tests.gonio_sim.conftest import describe, measured

BARE = describe("sim-ideal", camera={"cos4": False, "vignetting": 0.0, "width": 160, "height": 120, "pixel_um": 13.8})
"""The camera of sim with pixels four times as large."""
SINGLE = 1e-6
"""A scene is kept in single precision: 6e-8, and a few roundings."""
MATT: dict[str, Any] = {"name": "plate", "model": "lambert", "parameters": {"albedo": 0.2}}
WHITE: dict[str, Any] = {"model": "lambert", "parameters": {"albedo": 0.8}}
GOLD: dict[str, Any] = {"model": "cook-torrance", "parameters": {"m": 0.25, "ior": "Au", "diffuse_albedo": 0.0}}
PLASTER: dict[str, Any] = {"model": "oren-nayar", "parameters": {"albedo": 0.7, "sigma_deg": 25.0}}


def plate(**changes: Any) -> SampleDescription:
    return SampleDescription.model_validate(MATT | changes)


def scene(what: SampleDescription, pose: Pose) -> Floats:
    """Rendered rate of every pixel [e-/s]."""
    world = World(BARE, what, 1)
    world.pose = pose
    return Renderer(world).rate(BARE.bands.containing(550)).astype(float)


def deg(light: float, camera: float) -> Pose:
    return Pose(math.radians(light), math.radians(camera), 0.0, 0.0)


def file(folder: Path, **changes: Any) -> Path:
    (folder / "plate.toml").write_text(to_toml(MATT | changes), encoding="utf-8")
    return folder / "plate.toml"


def picture(folder: Path, values: Any) -> None:
    assert cv2.imwrite(str(folder / "mask.png"), np.array(values))


def test_counts_of_two_halves_are_as_their_albedos_and_an_edge_pixel_has_its_share_of_both() -> None:
    """The camera along the normal: columns of pixels lie along the edge, and their width on the sample is known."""
    edge = 0.313  # mm, within a column of pixels
    made = scene(plate(region=[WHITE | {"rectangle_mm": [edge, -20, 20, 20]}]), deg(40, 0))
    dark = scene(plate(), deg(40, 0))
    seen = pixel_map(BARE, view(BARE, deg(40, 0)))
    width = np.abs(np.gradient(seen.x_mm, axis=1))
    inside = np.hypot(seen.x_mm, seen.y_mm) < 9.5
    share = np.clip(0.5 + (seen.x_mm - edge) / width, 0.0, 1.0)
    ratio = made[inside] / dark[inside]
    pure = (share[inside] == 0.0) | (share[inside] == 1.0)
    np.testing.assert_allclose(ratio[pure], np.where(share[inside][pure] == 1.0, 4.0, 1.0), rtol=SINGLE)
    mixed = ratio[~pure]
    assert mixed.size > 50
    # 34 spots divide a pixel along its rows to 1/68 of it, and so the ratio to 3/68
    np.testing.assert_allclose(mixed, 1.0 + 3.0 * share[inside][~pure], atol=3.0 / 68.0 + SINGLE)
    assert 1.0 < mixed.mean() < 4.0


def test_each_region_shows_its_own_model_with_its_textures() -> None:
    gradient = {"albedo": {"pattern": "gradient", "low": 0.3, "high": 0.7, "size_mm": [12, 1]}}
    whole = plate(
        region=[GOLD | {"disc_mm": [-4.0, 0.0, 3.0]}, PLASTER | {"disc_mm": [4.0, 0.0, 3.0], "texture": gradient}]
    )
    pose = deg(35, -38)
    made = scene(whole, pose)
    seen = pixel_map(BARE, view(BARE, pose))
    for middle, one in ((-4.0, GOLD), (4.0, PLASTER | {"texture": gradient})):
        alone = scene(SampleDescription.model_validate({"name": "alone", **one}), pose)
        inside = np.hypot(seen.x_mm - middle, seen.y_mm) < 2.6
        assert inside.sum() > 500
        # a texture of few spots instead of many is the mean over other places of a pixel
        np.testing.assert_allclose(made[inside], alone[inside], rtol=2e-4 if "texture" in one else SINGLE)
    rest = (np.hypot(seen.x_mm + 4, seen.y_mm) > 3.4) & (np.hypot(seen.x_mm - 4, seen.y_mm) > 3.4)
    np.testing.assert_array_equal(made[rest], scene(plate(), pose)[rest])


def test_regions_lie_where_the_file_says_and_the_last_one_counts() -> None:
    triangle = [[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]
    what = plate(
        region=[
            WHITE | {"rectangle_mm": [2.0, 3.0, -2.0, -3.0]},
            WHITE | {"disc_mm": [1.0, 0.0, 0.5]},
            WHITE | {"polygon_mm": triangle},
        ]
    )
    places = [(-1.9, 2.9), (-2.1, 0.0), (1.0, -0.4), (1.0, -0.6), (1.0, 0.4), (2.1, 1.8), (2.1, 2.0), (-0.1, 3.1)]
    x, y = np.array(places).T
    assert what.region_at(x, y).tolist() == [1, 0, 2, 1, 3, 3, 0, 0]
    assert [one.name for one in what.materials()] == ["plate", "region 1", "region 2", "region 3"]


@pytest.mark.parametrize("azimuth_deg", [0.0, 30.0])
def test_a_mask_lies_with_its_first_row_above_about_its_middle(azimuth_deg: float, tmp_path: Path) -> None:
    picture(tmp_path, np.array([[10, 20, 30], [0, 40, 300]], np.uint16))
    what = load_sample(
        file(
            tmp_path,
            mask={"file": "mask.png", "mm_per_pixel": 2.0, "center_mm": [1.0, -1.0], "azimuth_deg": azimuth_deg},
            region=[WHITE | {"mask": value} for value in (10, 20, 30, 40, 300)],
        )
    )
    # middles of pixels along the picture's own axes, in mm from its middle
    u, v = np.array([[-2, 1], [0, 1], [2, 1], [-2, -1], [0, -1], [2, -1], [3.1, 0], [0, 2.1]]).T
    c, s = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    found = what.region_at(1.0 + u * c - v * s, -1.0 + u * s + v * c)
    assert found.tolist() == [1, 2, 3, 0, 4, 5, 0, 0]


def test_a_mask_may_be_in_colour(tmp_path: Path) -> None:
    picture(tmp_path, np.array([[[0, 128, 255], [7, 7, 7]]], np.uint8))  # OpenCV's order: blue, green, red
    what = load_sample(
        file(
            tmp_path,
            mask={"file": "mask.png", "mm_per_pixel": 1.0},
            region=[WHITE | {"mask": "#ff8000"}, WHITE | {"mask": 7}],
        )
    )
    assert what.region_at(np.array([-0.5, 0.5, 1.5]), np.zeros(3)).tolist() == [1, 2, 0]
    picture(tmp_path, np.array([[1, 2]], np.uint8))
    with pytest.raises(GonioError, match=r"mask.file = .*has changed since the sample file was read"):
        what.region_at(np.zeros(1), np.zeros(1))


def test_a_region_may_be_the_file_of_another_sample_and_a_run_holds_it_whole(tmp_path: Path) -> None:
    (tmp_path / "gold.toml").write_text(to_toml({"name": "gold", **GOLD}), encoding="utf-8")
    what = load_sample(file(tmp_path, region=[{"rectangle_mm": [0, -20, 20, 20], "file": "gold.toml"}]))
    (tmp_path / "gold.toml").unlink()
    _, gold = what.materials()
    assert (gold.name, gold.model, gold.parameters) == ("gold", "cook-torrance", GOLD["parameters"])
    run = measured(tmp_path, BARE, [30], [0], sample=what)
    assert run.sample == what


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"region": [WHITE]}, "one of rectangle_mm, disc_mm, polygon_mm or mask, and this has none"),
        ({"region": [WHITE | {"disc_mm": [0, 0, 1], "mask": 3}]}, "and this has disc_mm and mask"),
        ({"region": [{"disc_mm": [0, 0, 1]}]}, "either model and parameters, or file"),
        ({"region": [WHITE | {"disc_mm": [0, 0, 1], "file": "gold.toml"}]}, "either model and parameters, or file"),
        ({"region": [{"disc_mm": [0, 0, 1], "file": "gold.toml"}]}, 'region[1].file = "gold.toml": there is no'),
        ({"region": [{"disc_mm": [0, 0, 1], "model": "lambert", "parameters": {"albedo": 2.0}}]},
         "region[1] [parameters]"),
        ({"region": [WHITE | {"disc_mm": [0, 0, 1], "texture": {"m": {"pattern": "edge", "low": 0, "high": 1}}}]},
         'region[1]: texture: there is no number "m"'),
        ({"region": [WHITE | {"mask": 3}]}, "[mask], and a [[region]] with mask = VALUE, go together"),
        ({"region": [WHITE | {"mask": "red"}], "mask": {"file": "mask.png", "mm_per_pixel": 1}}, 'written "#rrggbb"'),
        ({"region": [WHITE | {"mask": 3}], "mask": {"file": "mask.png", "mm_per_pixel": 1}}, "it has 5, 250"),
        ({"region": [WHITE | {"mask": 5}], "mask": {"file": "no.png", "mm_per_pixel": 1}}, "no.png': there is no"),
    ],
)  # fmt: skip
def test_what_a_file_cannot_say(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    picture(tmp_path, np.array([[250, 5]], np.uint8))
    with pytest.raises(GonioError) as error:
        load_sample(file(tmp_path, **changes))
    assert said in str(error.value)
    assert "plate.toml" in str(error.value)


def test_who_needs_one_model_refuses_a_plate(tmp_path: Path) -> None:
    with pytest.raises(GonioError, match=r"plate.toml: \[\[region\]\]: one model is needed here"):
        load_model(file(tmp_path, region=[WHITE | {"disc_mm": [0, 0, 1]}]))
