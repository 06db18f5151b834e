"""What is said of a single frame."""

import re

import numpy as np
import pytest

from gonio.by_hand.snapshot import Snapshot
from gonio.rig import Frame
from gonio.rig.light_and_camera import Camera
from tests.gonio.by_hand.frames import HEIGHT, WIDTH, camera, expose


def shot(of: Camera, frame: Frame) -> Snapshot:
    return Snapshot(frame, of, None, None, None, "the arms do not say where they stand")


def eight_bits(pattern: str = "mono", **changes: object) -> Camera:
    numbers: dict[str, object] = {"bits": 8, "black_level_dn": 4.0, "electrons_per_dn": 40.0}
    return camera(pattern, **numbers | changes)


def plain(dn: int, of: Camera) -> Frame:
    mosaic = np.full((HEIGHT, WIDTH), dn, np.uint16)
    return Frame(mosaic, 1.0, of.black_level_dn, of.white_level_dn, of.pattern, time_s=0.0)


@pytest.mark.parametrize("pattern", ["mono", "RGGB"])
def test_noise_and_saturation_of_8_bits_are_said(pattern: str) -> None:
    of = eight_bits(pattern)
    scene = np.full((HEIGHT, WIDTH), 4000.0)
    scene[:24] = 1e6  # a tenth of the pixels, far beyond full scale
    (said,) = shot(of, expose(of, scene, seed=3)).remarks()
    assert "10 % of the pixels are saturated" in said
    noise = float(re.findall(r"noise of a pixel ([0-9.]+) DN", said)[0])
    # photons, reading and rounding; the median of 7e4 second differences of whole numbers tells it to a third
    assert noise == pytest.approx(np.hypot(np.sqrt(4025.0) / 40.0, 12.0**-0.5), rel=0.33)


def test_noise_that_rounding_hides_is_not_called_none() -> None:
    of = eight_bits()
    (said,) = shot(of, plain(90, of)).remarks()
    assert "noise of a pixel 0.29 DN, 0.29 of it at least from rounding; 0 % of the pixels are saturated" in said


def test_levels_are_those_of_the_linear_signal() -> None:
    """A video camera whose curve is steep at its lower end: 200 of 255 DN are less than half of what it can hold."""
    curve = 255.0 * (np.arange(256) / 255.0) ** 3.0
    bent = eight_bits(black_level_dn=0.0, response=tuple(map(float, curve)))
    assert shot(bent, plain(200, bent)).numbers()["brightest_level"] == pytest.approx(curve[200] / 255.0, abs=0.01)


@pytest.mark.parametrize("of", [camera(), camera("RGGB"), eight_bits()])
def test_a_black_frame_is_told_from_a_faint_and_from_an_even_one(of: Camera) -> None:
    dark = np.zeros((HEIGHT, WIDTH))
    spot = dark.copy()
    spot[100:120, 100:120] = 2000.0
    even = np.full_like(dark, 0.05 * (of.white_level_dn - of.black_level_dn) * of.electrons_per_dn)
    said = ["black" in " ".join(shot(of, expose(of, scene, seed=1)).remarks(lit=True)) for scene in (dark, spot, even)]
    assert said == [True, False, False]
