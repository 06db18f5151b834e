"""Counts of a step from its frames: what is taken off, and what a region spans."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gonio.lab.reduction.count_rates import RunFrames, _alike, _lines, without_dark
from gonio.lab.rig import Frame
from gonio.lab.rig.light_and_camera import Camera, straightened
from tests.gonio.lab.reduction.made_run import describe

BLACK, WHITE = 64.0, 4095


def camera(*nonlinearity: float) -> Camera:
    return Camera(
        width=32, height=32, pixel_um=10.0, exposure_limits_s=(1e-3, 1.0), black_level_dn=BLACK,
        nonlinearity=nonlinearity,
    )  # fmt: skip


LIGHT = np.array([[100.0, 1000.0], [2000.0, 3000.0]])
DARK = np.array([[20.0, 50.0], [80.0, 200.0]])


def test_with_a_curve_it_is_a_difference_of_what_is_straightened() -> None:
    """Signals above the black level read y (1 + c1 y / white + c2 (y / white)^2)."""

    def read(y: np.ndarray) -> np.ndarray:
        return BLACK + y * (1.0 - 0.1 * y / WHITE + 0.05 * (y / WHITE) ** 2)

    alone, with_dark = without_dark(camera(-0.1, 0.05), read(LIGHT + DARK), read(DARK), BLACK)
    np.testing.assert_allclose(alone, LIGHT, rtol=1e-10)
    np.testing.assert_allclose(with_dark, LIGHT + DARK, rtol=1e-10)


@pytest.mark.parametrize(
    ("other", "alike"),
    [(0.5, True), (0.50049, True), (0.49951, True), (0.50051, False), (0.49949, False), ("0.5", False), (None, False)],
)
def test_exposures_agree_to_a_thousandth(other: object, alike: bool) -> None:
    assert _alike(0.5, other) is alike


def test_very_short_exposures_agree_to_a_microsecond() -> None:
    assert _alike(1e-6, 2e-6)
    assert not _alike(1e-6, 2.2e-6)


def test_dark_frames_lie_on_a_line_of_each_channel() -> None:
    found = _lines([(t, [64.0 + 3.0 * t, 70.0 - 0.5 * t]) for t in (1.0, 2.0, 6.0)], ("R", "B"), rate=9.0)
    assert found["R"] == pytest.approx((64.0, 3.0), rel=1e-12)
    assert found["B"] == pytest.approx((70.0, -0.5), rel=1e-12)
    assert _lines([], ("R", "B"), rate=9.0) == {}


@pytest.mark.parametrize(("apart", "slope"), [(0.0, 9.0), (0.98e-3, 9.0), (1.02e-3, 3.0)])
def test_one_exposure_takes_the_slope_that_is_given(apart: float, slope: float) -> None:
    """So do two of them that lie closer than a thousandth of the mean to it, together: a square sum of 1e-6."""
    times = [2.0 * (1.0 - apart / math.sqrt(2.0)), 2.0 * (1.0 + apart / math.sqrt(2.0))]
    level, found = _lines([(t, [64.0 + 3.0 * t]) for t in times], ("mono",), rate=9.0)["mono"]
    assert found == pytest.approx(slope, rel=1e-9)
    assert level == pytest.approx(64.0 + (3.0 - slope) * 2.0, rel=1e-9)


@pytest.mark.parametrize("bend", [(), (-0.1,)])
def test_what_a_frame_spreads_is_a_share_of_its_light_without_its_dark_signal(bend: tuple[float, ...]) -> None:
    """An even frame of 500 DN of light over a dark signal of 10 + 3 * 2 DN; a fiftieth of the light is everywhere."""
    description = describe(camera={"stray_light": 0.02, "nonlinearity": bend})
    camera = description.camera
    rates: Any = SimpleNamespace(description=description, _dark_means={"mono": (1010.0, 3.0)}, full=0.0)
    mosaic = np.full((64, 64), 1516, dtype=np.uint16)
    frame = Frame(mosaic, 2.0, camera.black_level_dn, camera.white_level_dn, camera.pattern, time_s=0.0)
    added, _ = RunFrames.spread(rates, frame, "mono").at(np.array([3]), np.array([40]))
    lit, dark = straightened(camera, np.array([516.0, 16.0]))
    # the lens spreads a fiftieth of what arrives, of which the frame holds the whole
    assert added == pytest.approx([0.02 * (lit - dark) / 1.02], rel=1e-12)
    assert rates.full == 0.0
