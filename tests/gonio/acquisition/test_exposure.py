"""Metering: from any brightness, within limits, without a saturated pixel."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.acquisition import exposure
from gonio.errors import DeviceError
from gonio.rig import Frame, Pose
from gonio.rig.description import RigDescription
from gonio.rig.light_and_camera import Camera
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
    level = exposure.expected_level_per_s(describe(camera=camera), Pose(light=math.radians(60)), 0.5)
    assert level == pytest.approx(1.0, rel=1e-14)  # 40000 / 2 / 2 / 10000, and cos 60 degrees: roundings


CLIPS = RIG.camera.model_copy(
    update={"photon_noise": True, "electrons_per_dn": 2.7, "read_noise_e": 2.5, "dsnu_e": 2.0}
)
SHAPES = ("even", "spot", "disc", "ramp")


def picture(shape: str, peak_e: float, rng: np.random.Generator, *, gain: float, well_e: float) -> Frame:
    """A frame of 100 x 100 pixels of a camera whose well holds `well_e` and whose DN is `gain` electrons."""
    y, x = np.indices((100, 100)) - 49.5
    r = np.hypot(x, y)
    form = {"even": np.ones(r.shape), "spot": np.exp(-((r / 30.0) ** 2)), "disc": np.clip(30.0 - r, 0.01, 1.0),
            "ramp": (x + 50.0) / 100.0}[shape]  # fmt: skip
    charge = np.minimum(rng.poisson(peak_e * form * (1.0 + 0.005 * rng.standard_normal(r.shape))), well_e)
    dn = (charge + rng.normal(0.0, 3.5, r.shape)) / gain + 64.0
    return Frame(np.clip(np.rint(dn), 0, 4095).astype(np.uint16), 0.1, 64.0, 4095.0, time_s=0.0)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("gain", [2.3, 3.1, 3.9])  # the rig file says 2.7
def test_the_level_at_which_charge_clips_is_seen_and_nothing_else_is_taken_for_it(shape: str, gain: float) -> None:
    rng, well = np.random.default_rng(7), 0.8 * 4031 * 2.3
    for part in (0.05, 0.3, 0.6, 0.85):
        assert exposure.clipped_dn(CLIPS, picture(shape, part * well, rng, gain=gain, well_e=well)) == math.inf
    for over in (1.5, 4.0, 30.0):
        frame = picture(shape, over * well, rng, gain=gain, well_e=well)
        # read noise and unevenness of 3.5 electrons, of which the middle is the level
        assert exposure.clipped_dn(CLIPS, frame) == pytest.approx(well / gain + 64.0, abs=2.0)
        assert exposure.level(CLIPS, frame, used) >= exposure.SATURATED


def test_a_camera_without_photon_noise_is_not_judged_by_it() -> None:
    ideal = CLIPS.model_copy(update={"photon_noise": False})
    even = Frame(np.full((50, 50), 2000, np.uint16), 0.1, 64.0, 4095.0, time_s=0.0)
    assert exposure.clipped_dn(ideal, even) == math.inf
    assert exposure.full_scale_dn(ideal, even) == pytest.approx(4031.0, abs=60.0)  # of the converter, or of the well
