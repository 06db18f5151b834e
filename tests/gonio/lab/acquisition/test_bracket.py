"""Planned brackets: the wanted uncertainty, within the camera's limits and the time."""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.errors import DeviceError
from gonio.lab.acquisition import exposure
from gonio.lab.rig import Frame, Pose, regions
from gonio.lab.rig.description import Acquisition, RigDescription
from gonio.lab.rig.kinematics import view
from gonio.lab.rig.light_and_camera import Camera
from tests.gonio.numpy_rig import describe

CAMERA = {
    "electrons_per_dn": 2.7, "read_noise_e": 2.5, "photon_noise": True, "full_well_e": 10_800.0, "prnu": 0.0,
    "dark_current_e_per_s": 5.0, "exposure_limits_s": (1e-5, 60.0), "frame_overhead_s": 0.05,
}  # fmt: skip
COUNT = 1024


def rig(target: float = 0.002, longest_point_s: float = 120.0, lamp: float = 0.0, **camera: Any) -> RigDescription:
    description = describe()
    parts = {
        "camera": description.camera.model_copy(update=CAMERA | camera),
        "acquisition": description.acquisition.model_copy(
            update={"u_rel_target": target, "longest_point_s": longest_point_s}
        ),
        "lamp": description.lamp.model_copy(update={"noise": lamp}),
    }
    return description.model_copy(update=parts)


def planned(description: RigDescription, rates: npt.NDArray[np.float64]) -> tuple[float, ...]:
    """The bracket of a region whose pixels have these rates [e-/s], metered by noisy frames."""
    camera, rng = description.camera, np.random.default_rng(1)

    def shot(exposure_s: float) -> Frame:
        charge = rng.poisson((rates + camera.dark_current_e_per_s) * exposure_s).astype(float)
        charge = np.minimum(charge, camera.full_well_e) + camera.read_noise_e * rng.standard_normal(rates.shape)
        dn = np.clip(np.floor(charge / camera.electrons_per_dn + camera.black_level_dn + 0.5), 0, camera.white_level_dn)
        return Frame(dn.astype(np.uint16), exposure_s, camera.black_level_dn, camera.white_level_dn, time_s=0.0)

    def used(mosaic: npt.NDArray[np.uint16]) -> npt.NDArray[np.uint16]:
        return mosaic.reshape(-1)

    return exposure.bracket(description, exposure.meter(description, shot, used, 1.0), used)


def variance(description: RigDescription, rates: npt.NDArray[np.float64], exposures_s: tuple[float, ...]) -> float:
    """Relative variance of the mean of all pixels by their best weights, written out pixel by pixel."""
    camera, weights = description.camera, np.zeros(rates.shape)
    for t in exposures_s:
        charge = (rates + camera.dark_current_e_per_s) * t
        weights += np.where(
            charge < 0.9 * camera.full_well_e,
            t**2 / (charge + camera.read_noise_e**2 + camera.electrons_per_dn**2 / 12),
            0.0,
        )
    return float(np.sum(1.0 / weights) / rates.sum() ** 2 + description.lamp.noise**2 / len(exposures_s))


@pytest.mark.parametrize("rate", [30.0, 1e3, 1e5, 1e7, 3e8])
@pytest.mark.parametrize(("target", "lamp"), [(0.01, 0.0), (0.001, 0.0), (0.002, 0.008)])
def test_a_bracket_reaches_its_target(rate: float, target: float, lamp: float) -> None:
    description, rates = rig(target, lamp=lamp), np.full(COUNT, rate)
    exposures_s = planned(description, rates)
    # 10 %: of the metering frame's own noise, where it is dim
    assert variance(description, rates, exposures_s) < 1.1 * target**2
    assert all(1e-5 <= t <= 60.0 for t in exposures_s)
    overhead = 0.05 * len(exposures_s)
    assert sum(exposures_s) + overhead <= 120.0 + 0.1  # the shorter frame's overhead is not part of the time
    assert max(exposures_s) * (rate + 5.0) < 0.9 * 10_800.0
    assert exposures_s[-1] == pytest.approx(max(exposures_s) / 4, abs=1e-5)
    if lamp:
        assert len(exposures_s) >= (lamp / target) ** 2


def test_a_bracket_is_no_longer_than_it_has_to_be() -> None:
    """10 times the uncertainty costs a hundredth of the photons, of which two frames are the least."""
    rates = np.full(COUNT, 200.0)
    fine, coarse = (planned(rig(target), rates) for target in (0.001, 0.01))
    assert sum(fine) > 30 * sum(coarse)
    assert variance(rig(), rates, fine) > 0.3 * 0.001**2


def test_where_time_is_short_it_does_what_it_can() -> None:
    description, rates = rig(1e-4, longest_point_s=5.0), np.full(COUNT, 20.0)
    exposures_s = planned(description, rates)
    assert 3.0 < sum(exposures_s) <= 5.0
    assert variance(description, rates, exposures_s) > 1e-8


def test_pixels_that_a_peak_keeps_dark_get_longer_frames() -> None:
    """A peak on 2 % of the pixels, and read noise that matters for the others in frames that are short enough."""
    rates = np.full(COUNT, 400.0)
    rates[:20] = 1e5
    description = rig(0.002, read_noise_e=60.0, frame_overhead_s=0.2)
    exposures_s = planned(description, rates)
    long = [t for t in exposures_s[:-1] if t * 1e5 > 10_800.0]
    assert len([t for t in exposures_s[:-1] if t * 1e5 < 0.9 * 10_800.0]) >= 2
    assert len(long) >= 2
    assert variance(description, rates, exposures_s) < 1.1 * 0.002**2
    assert max(long) * 400.0 < 0.9 * 10_800.0


@pytest.mark.parametrize(
    ("changes", "longest_s"),
    [
        ({"dark_current_e_per_s": 1000.0}, 5.4),  # half of 10 800 electrons
        ({"dark_current_e_per_s": 0.0, "longest_point_s": 9.0}, 4.0),  # two frames of it, and a quarter
        ({"dark_current_e_per_s": 0.0}, 120.0 / 2.25),
        ({"dark_current_e_per_s": 0.0, "exposure_limits_s": (1e-5, 20.0)}, 20.0),
    ],
)
def test_the_longest_frame_of_the_dimmest_light(changes: dict[str, Any], longest_s: float) -> None:
    dim = np.full(8, 0.01)
    plan = exposure._Planned(rig(1e-6, **changes), dim, dim, COUNT)
    assert plan._allowed(1e4) == pytest.approx(longest_s, abs=1e-6)
    assert max(plan.exposures(60.0, 2)) <= longest_s


@pytest.mark.parametrize("camera_deg", [0.0, 40.0, -60.0, 75.0])
def test_the_pixels_that_are_expected_are_those_of_the_region(camera_deg: float) -> None:
    description, pose = describe(), Pose(camera=math.radians(camera_deg))
    count = regions.roi(description, view(description, pose)).count
    # the edge of a disc of 7 to 15 pixels across
    assert exposure.expected_pixels(description, pose) == pytest.approx(count, rel=0.08)


def test_a_region_smaller_than_a_pixel_has_one() -> None:
    assert exposure.expected_pixels(describe(acquisition=Acquisition(roi_radius_mm=0.05)), Pose()) == 1


def test_what_responsivities_leave_is_not_exposed_for() -> None:
    """Half of the target is left to noise at least: 1 % of 25 pixels is the target itself."""
    uneven = exposure._Planned(rig(0.002, prnu=0.01), np.full(8, 1e3), np.full(8, 1e3), 25)
    assert uneven._wanted == pytest.approx(0.25 * 0.002**2)
    uneven = exposure._Planned(rig(0.002, prnu=0.01), np.full(8, 1e3), np.full(8, 1e3), 100)
    assert uneven._wanted == pytest.approx(0.002**2 - 0.01**2 / 100)


FRAME = Frame(np.full((32, 32), 100, np.uint16), 0.1, 64.0, 4095.0, time_s=0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"exposure_s": 0.0}, r"exposure_s = 0.0: seconds above 0"),
        ({"exposure_s": math.nan}, "exposure_s = nan"),
        ({"exposure_s": None}, "exposure_s = None"),
        ({"exposure_s": 0.13}, "exposed 0.13 s where 0.1 s were asked"),
        ({"white_level_dn": 65535.0}, "white level 65535 DN; the rig file says camera.bits = 12"),
        ({"white_level_dn": 1023.0}, "white level 1023 DN"),
        ({"black_level_dn": 512.0}, "black level 512 DN; the rig file says camera.black_level_dn = 64"),
    ],
)
def test_a_frame_that_contradicts_what_is_known_is_refused(change: dict[str, Any], message: str) -> None:
    values = {name: getattr(FRAME, name) for name in ("mosaic", "exposure_s", "black_level_dn", "white_level_dn")}
    frame = Frame(**(values | change), time_s=0.0)
    with pytest.raises(DeviceError, match=message):
        exposure.require_asked(rig().camera, frame, 0.1, "camera")


@pytest.mark.parametrize(("asked_s", "given_s"), [(0.1, 0.1125), (1e-4, 1.5e-4), (1 / 60, 1 / 64), (0.1, 0.0899)])
def test_exposures_that_a_camera_rounds_are_no_contradiction(asked_s: float, given_s: float) -> None:
    exposure.require_asked(rig().camera, Frame(FRAME.mosaic, given_s, 64.0, 4095.0, time_s=0.0), asked_s, "camera")


@pytest.mark.parametrize("count", [1, 3, 9])
def test_small_regions_have_brackets_too(count: int) -> None:
    assert len(planned(rig(), np.full(count, 1e5))) >= 3


# ---- metering: from any brightness, within limits, without a saturated pixel ----


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
