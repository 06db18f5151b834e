"""Pictures: what noise is left, that a tolerance is kept, and that a seed gives one picture."""

import tracemalloc
from typing import Any

import numpy as np
import pytest
from gonio_scenes import render as rendering
from gonio_scenes.picture import display, left_out

from gonio.errors import ConfigError
from tests.gonio_scenes.scenes import SPHERE, rendered, scene

SMALL = SPHERE["camera"] | {"width": 24, "height": 20}
LAMP = {
    "kind": "disc",
    "center_mm": [200.0, 150.0, 400.0],
    "normal": [-200.0, -150.0, -400.0],
    "radius_mm": 120.0,
    "radiance": 5.0,
    "samples": 4,
}
TWO = [
    {"kind": "sphere", "radius_mm": 30.0, "material": "m"},
    {"kind": "plane", "center_mm": [0.0, 0.0, -30.0], "material": "m"},
]


def test_a_seed_gives_one_picture_and_another_seed_another() -> None:
    pictures = [
        rendered(camera=SMALL | {"samples": 4}, shape=TWO, light=[LAMP], seed=seed).radiance for seed in (1, 1, 2)
    ]
    assert (pictures[0] == pictures[1]).all()
    assert (pictures[0] != pictures[2]).any()


def test_without_random_numbers_it_does_not_matter_how_many_rays_go_together(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = rendered()
    monkeypatch.setattr(rendering, "FEWER", 7)
    parts = rendered()
    np.testing.assert_array_equal(parts.radiance, whole.radiance)
    np.testing.assert_array_equal(parts.position, whole.position)


@pytest.fixture(scope="module")
def truth() -> rendering.Picture:
    """Of a thousand rays a pixel."""
    return rendered(camera=SMALL | {"samples": 1024}, shape=TWO, light=[LAMP], seed=99)


def test_several_rays_a_pixel_give_the_mean_over_the_pixel() -> None:
    coarse = rendered(camera=SMALL | {"samples": 64})
    fine = rendered(camera=SMALL | {"width": 24 * 16, "height": 20 * 16}).radiance
    boxes = fine.reshape(20, 16, 24, 16).mean(axis=(1, 3))
    # eight batches of eight points: a pixel that the limb halves is known to 1/8 a batch at worst, 0.045 in the mean
    np.testing.assert_allclose(coarse.radiance[..., 0], boxes, rtol=0, atol=0.09 * fine.max())
    assert abs(coarse.radiance.mean() / boxes.mean() - 1.0) < 0.005


def test_a_lens_blurs_what_is_not_in_focus_and_keeps_what_is() -> None:
    sharp = rendered(camera=SMALL | {"samples": 64}).radiance[..., 0]
    here = rendered(camera=SMALL | {"samples": 64, "lens_radius_mm": 20.0, "focus_mm": 985.0}).radiance[..., 0]
    there = rendered(camera=SMALL | {"samples": 64, "lens_radius_mm": 20.0, "focus_mm": 700.0}).radiance[..., 0]
    assert np.abs(here - sharp).max() < 0.1 * sharp.max()  # the limb is 25 mm behind
    assert np.abs(there - sharp).max() > 0.15 * sharp.max()
    # blur moves light and loses none: the sphere's image is whole in the frame
    assert abs(there.sum() / sharp.sum() - 1.0) < 0.02


def test_a_camera_that_sees_nothing_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^scene\.toml: camera: no ray through a pixel's centre meets a shape"):
        rendered(camera=SMALL | {"look_at_mm": [0.0, 0.0, 2000.0]})


@pytest.mark.slow
@pytest.mark.parametrize("samples", [2, 3, 11, 13, 22])
def test_any_number_of_rays_tells_its_error(truth: rendering.Picture, samples: int) -> None:
    pictures = [rendered(camera=SMALL | {"samples": samples}, shape=TWO, light=[LAMP], seed=k) for k in range(8)]
    assert {int(s) for picture in pictures for s in picture.samples.flat} == {samples}
    errors = np.stack([picture.error for picture in pictures if picture.error is not None])
    assert np.isfinite(errors).all()
    stated = np.sqrt(np.mean(errors**2))
    true = np.sqrt(np.mean([(picture.radiance - truth.radiance) ** 2 for picture in pictures]))
    # 480 pixels, eight times: their scatter is known to a few per cent; the truth has a tenth of the error of 11 rays
    assert true == pytest.approx(stated, rel=0.15)


def test_a_picture_of_many_wavelengths_is_shown_without_a_copy_of_it() -> None:
    built = scene(wavelength_nm={"start": 400, "stop": 700, "step": 10}, camera=SMALL)
    radiance = np.random.default_rng(1).random((200, 200, built.wavelength_nm.size))
    display(built, radiance[:2])  # tables are read on the first use
    tracemalloc.start()
    display(built, radiance)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # a copy of the radiances has 31 numbers a pixel; XYZ, RGB and what lies between them have some 20
    assert peak < radiance.nbytes


def test_a_picture_that_is_no_finite_numbers_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"^scene\.toml: light: radiances of the picture are no finite numbers"):
        rendered(camera=SMALL, light=3 * [SPHERE["light"][0] | {"irradiance": 1.7e308}])
    with pytest.raises(ConfigError, match="radiances of the picture are no finite numbers"):  # sums of rays overflow
        rendered(camera=SMALL | {"samples": 4}, light=[SPHERE["light"][0] | {"irradiance": 1.7e308}])


# ---- how many rays a picture takes to a tolerance, and what it says of its error ----


EDGES: dict[str, Any] = {
    "camera": {
        "position_mm": [150.0, -600.0, 420.0],
        "look_at_mm": [5.0, 0.0, 10.0],
        "up": [0.0, 0.0, 1.0],
        "vertical_field_deg": 14.0,
        "width": 24,
        "height": 24,
    },
    "shape": [
        {"kind": "plane", "material": "m"},
        {"kind": "sphere", "center_mm": [0.0, 0.0, 40.0], "radius_mm": 40.0, "material": "m"},
    ],
    "light": [{"kind": "directional", "toward": [-1.0, -0.5, 1.2], "irradiance": 3.0}],
}
"""A sphere and its shadow: all error is at edges, which a few rays miss."""


def test_a_tolerance_is_kept_and_the_error_that_is_stated_is_the_error() -> None:
    tolerance = 0.005
    truth = rendered(**EDGES | {"camera": EDGES["camera"] | {"samples": 1024}, "seed": 99})
    picture = rendered(**EDGES, tolerance=tolerance, seed=3)
    level = np.maximum(truth.radiance, truth.radiance.mean())[..., 0]
    error = np.abs(picture.radiance - truth.radiance)[..., 0] / level
    assert picture.error is not None
    stated = (picture.error / np.maximum(picture.radiance, picture.radiance.mean()))[..., 0]
    # stopping on purpose where the error looks small makes it look smaller than it is: by less than a half
    assert np.sqrt(np.mean(error**2)) < 1.5 * np.sqrt(np.mean(stated**2))
    assert np.sqrt(np.mean(error**2)) < tolerance
    # normal errors: 0.3 % beyond three; the truth's own error is a third of the tolerance
    assert (error > 3.5 * tolerance).mean() < 0.005
    # those that took all the rays that there are; a rounding may tell one of them the other way
    assert picture.above_tolerance == pytest.approx((stated > tolerance).sum(), abs=1)
    assert (picture.samples[stated > tolerance] == rendering.MAX_RAYS).all()


def test_a_tolerance_costs_less_than_rays_for_all() -> None:
    picture = rendered(**EDGES, tolerance=0.02, seed=3)
    assert picture.samples.min() == rendering.FIRST_BATCHES * rendering.BATCH
    assert picture.samples.mean() < 0.2 * picture.samples.max()
    assert picture.rays["camera"] == picture.samples.sum()


def test_a_tolerance_gives_the_same_picture_again() -> None:
    a, b = (rendered(**EDGES, tolerance=0.05, seed=5) for _ in range(2))
    np.testing.assert_array_equal(a.radiance, b.radiance)
    np.testing.assert_array_equal(a.samples, b.samples)


def test_a_disc_that_is_looked_at_once_a_ray_is_not_its_centre() -> None:
    """Of many rays each looks at another point of the disc, so that their mean is the whole disc's."""
    lamp = {
        "kind": "disc", "center_mm": [0.0, 0.0, 100.0], "normal": [0.0, 0.0, -1.0], "radius_mm": 60.0, "radiance": 2.0,
    }  # fmt: skip
    camera = EDGES["camera"] | {"position_mm": [0.0, -100.0, 50.0], "vertical_field_deg": 0.01, "samples": 64}
    plane = [{"kind": "plane", "material": "m"}]
    once = rendered(camera=camera | {"look_at_mm": [0.0, 0.0, 0.0]}, shape=plane, light=[lamp | {"samples": 1}])
    # pi L R^2/(R^2 + d^2), where the disc's centre alone would give pi L R^2/d^2: the mean of 24 x 24 x 64 rays
    expected = 0.7 * 2.0 * 60.0**2 / (60.0**2 + 100.0**2)
    assert once.error is not None
    own = np.sqrt((once.error**2).sum()) / once.error.size
    assert 0.0 < own < 0.003 * expected
    assert once.radiance.mean() == pytest.approx(expected, abs=4.0 * own)


def test_a_disc_that_is_looked_at_once_is_said_to_be_its_centre() -> None:
    lamp = {
        "kind": "disc",
        "center_mm": [0.0, 0.0, 300.0],
        "normal": [0.0, 0.0, -1.0],
        "radius_mm": 60.0,
        "radiance": 2.0,
    }
    told = [[said["what"] for said in left_out(scene(light=[lamp | {"samples": k}]))] for k in (1, 4)]
    assert "the size of discs of light" in told[0]
    assert "the size of discs of light" not in told[1]
