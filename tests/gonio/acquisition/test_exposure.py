"""Metering: from any brightness, within limits, without a saturated pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.acquisition import exposure
from gonio.errors import DeviceError
from gonio.rig import Frame, Pose
from gonio.rig.description import Camera, RigDescription
from tests.gonio.numpy_rig import describe

RIG = describe()
TARGET = RIG.acquisition.exposure_target
SHORTEST, LONGEST = RIG.camera.exposure_limits_s


class Scene:
    """Frames of even brightness `rate` [1/s], as a fraction of full scale, with a little noise."""

    def __init__(self, rate: float, rig: RigDescription = RIG) -> None:
        self.rate, self.camera, self.taken = rate, rig.camera, 0

    def shot(self, exposure_s: float) -> Frame:
        self.taken += 1
        rng = np.random.default_rng(self.taken)
        full = min(4095 - 64, self.camera.full_well_e / self.camera.electrons_per_dn)
        dn = min(self.rate * exposure_s, 1.0) * full + 64 + rng.normal(0, 1, (4, 4))
        return Frame(np.clip(np.rint(dn), 0, 4095).astype(np.uint16), exposure_s, 64, 4095, time_s=0.0)


def used(mosaic: np.ndarray) -> np.ndarray:
    return mosaic.reshape(-1)


@given(st.floats(-3, 5), st.floats(-2, 4))  # from the longest exposure to the shortest
def test_any_brightness_is_brought_to_the_target(log_rate: float, log_expected: float) -> None:
    scene = Scene(10**log_rate)
    found = exposure.meter(RIG, scene.shot, used, 10**log_expected)
    level = scene.rate * found.exposure_s
    assert SHORTEST <= found.exposure_s <= LONGEST
    assert scene.taken <= exposure.MOST_FRAMES
    if found.saturated:
        assert found.exposure_s == SHORTEST
        assert scene.rate * SHORTEST >= exposure.SATURATED - 0.01
    else:
        assert level < exposure.SATURATED
        # read noise of 1 DN is 0.3 % of the least level that is computed from, and the brightest of 16 pixels 2.5 of it
        wanted = min(TARGET, scene.rate * LONGEST)
        assert level == pytest.approx(wanted, rel=0.02, abs=2e-3) or found.exposure_s == SHORTEST


def test_a_good_guess_costs_one_frame() -> None:
    scene = Scene(3.0)
    exposure.meter(RIG, scene.shot, used, 4.0)
    assert scene.taken == 1


def test_decisions_repeat() -> None:
    first, again = (exposure.meter(RIG, Scene(40.0).shot, used, 0.01) for _ in range(2))
    assert first == again


def test_light_that_jumps_is_a_device_error() -> None:
    scene = Scene(1.0)

    def jumping(exposure_s: float) -> Frame:
        scene.rate = 1e-9 if scene.taken % 2 else 1e9
        return scene.shot(exposure_s)

    with pytest.raises(DeviceError, match="steady"):
        exposure.meter(RIG, jumping, used, 1.0)


def test_exposures_are_whole_microseconds_within_limits() -> None:
    short, long = exposure.dark_exposures_s(RIG)
    assert (short, long) == (SHORTEST, LONGEST)
    for value in (exposure.shorter(RIG, 0.123457), exposure.expected_exposure_s(RIG, Pose(light=1.0), 0.5)):
        assert value * 1e6 == pytest.approx(round(value * 1e6), abs=1e-6)  # rounding of a decimal fraction
    assert exposure.shorter(RIG, SHORTEST) == SHORTEST


def test_long_darks_do_not_fill_the_well() -> None:
    warm = describe(camera=Camera(dark_current_e_per_s=5000, full_well_e=10_000, exposure_limits_s=(1e-4, 60)))
    assert exposure.dark_exposures_s(warm)[1] == 1.0


def test_expected_level_is_that_of_the_data_sheet() -> None:
    camera = Camera(full_well_e=10_000, responsivity_e_per_s=40_000, electrons_per_dn=3)
    pose = Pose(light=math.radians(60))
    level = exposure.expected_level_per_s(describe(camera=camera), pose, 0.5)
    assert level == pytest.approx(1.0, rel=1e-14)  # 40000 / 2 / 2 / 10000, and cos 60 degrees: roundings
