"""How many rays a picture takes to a tolerance, and what it says of its error."""

from typing import Any

import numpy as np
import pytest
from gonio_scenes import render as rendering
from gonio_scenes.picture import left_out

from tests.gonio_scenes.scenes import rendered, scene

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
    own = np.maximum(picture.radiance, picture.radiance.mean())
    stated = (picture.error / own)[..., 0]
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
