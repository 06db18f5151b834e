"""The sensor against EMVA 1288: photon transfer, linearity, dark signal, fixed patterns, determinism.

Expected values are the standard's formulas with the numbers of the description. With N pixels a mean is known to
sigma/sqrt(N) and a variance to sqrt(2/N) of itself; every tolerance is five of those, which a right sensor exceeds once
in two million tests (the seeds are fixed, so a test that passes keeps passing).
"""

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from gonio_sim import camera as camera_module
from gonio_sim.camera import Sensor
from gonio_sim.world import Stream, World
from scipy import stats

from gonio.errors import ConfigError
from gonio.lab.rig.light_and_camera import Camera
from tests.gonio_sim.conftest import describe

SIGMAS = 5.0
SHAPE = (480, 640)
PIXELS = SHAPE[0] * SHAPE[1]
QUIET: dict[str, Any] = {
    "photon_noise": False, "read_noise_e": 0.0, "dark_current_e_per_s": 0.0, "prnu": 0.0, "dsnu_e": 0.0,
}  # fmt: skip


def sensor(seed: int = 3, **changes: Any) -> Sensor:
    description = describe("sim", camera=QUIET | {"bits": 16, "electrons_per_dn": 0.25, "full_well_e": 15000} | changes)
    return Sensor(description.camera, World(description, None, seed).key)


def electrons(of: Sensor, mean: float | None, exposure_s: float = 1.0, key: int = 1) -> npt.NDArray[np.float64]:
    """Charge of every pixel [e-] for a flat field of `mean` electrons a second."""
    rate = None if mean is None else np.full(SHAPE, mean, np.float32)
    model = of._camera
    mosaic = of.read_out(rate, exposure_s, 1.0, np.uint64(key))
    return (mosaic.astype(float) - model.black_level_dn) * model.electrons_per_dn


@pytest.mark.parametrize("mean", [0.0, 1e-4, 0.3, 10.0, 24.99, 101.0, 1000.0, 10000.0])
def test_photon_transfer(mean: float) -> None:
    """Mean, variance and third central moment of the charge are equal, and it is in whole electrons."""
    charge = electrons(sensor(photon_noise=True), mean)
    assert np.array_equal(charge, np.rint(charge))
    assert charge.mean() == pytest.approx(mean, abs=SIGMAS * math.sqrt(mean / PIXELS))
    # the scatter of a sample's central moments, from the higher moments of a Poisson number
    second = mean + 2 * mean**2
    assert np.mean((charge - mean) ** 2) == pytest.approx(mean, abs=SIGMAS * math.sqrt(second / PIXELS))
    sixth = mean + 25 * mean**2 + 15 * mean**3
    assert np.mean((charge - mean) ** 3) == pytest.approx(mean, abs=SIGMAS * math.sqrt(sixth / PIXELS))


def observed_and_expected(counts: npt.NDArray[np.int64], mean: float) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """How often each count occurred and should have; rare ones (below 10) are taken together on either side."""
    low, high = stats.poisson.ppf([10 / counts.size, 1 - 10 / counts.size], mean).astype(int)
    edges = np.arange(low, high + 1)
    expected = counts.size * np.diff(stats.poisson.cdf(edges, mean), prepend=0.0, append=1.0)
    return np.bincount(np.clip(counts, low, high + 1) - low, minlength=edges.size + 1), expected


# near 0; on and beside a row of the table (1/8 e-); on both sides of the change of method; far into the expansion
@pytest.mark.parametrize("mean", [1e-3, 0.125, 0.2499, 3.0, 11.9, 24.9, 25.1, 99.0, 300.0])
def test_electrons_are_poisson_numbers(mean: float) -> None:
    """The whole distribution is right: chi-square over all counts of ten frames."""
    of = sensor(photon_noise=True, electrons_per_dn=1.0)
    counts = np.concatenate([electrons(of, mean, key=key).astype(int).ravel() for key in range(10)])
    assert stats.chisquare(*observed_and_expected(counts, mean)).pvalue > 1e-4


def test_methods_meet_in_one_frame() -> None:
    """Dim and bright pixels side by side, within a block and from block to block: each pixel has its own mean."""
    of = sensor(photon_noise=True, electrons_per_dn=1.0)
    rate = np.tile(np.array([0.5, 24.0, 26.0, 60.0, 5.0], np.float32), PIXELS // 5).reshape(SHAPE)
    black = of._camera.black_level_dn
    counts = (of.read_out(rate, 1.0, 1.0, np.uint64(4)).astype(float) - black).astype(int).ravel()
    for mean in np.unique(rate):
        assert stats.chisquare(*observed_and_expected(counts[rate.ravel() == mean], float(mean))).pvalue > 1e-4


def test_electrons_and_read_noise_are_independent() -> None:
    """Both come from one hash in bright pixels, and from two in dim ones: variances add up."""
    for mean in (0.5, 20.0, 60.0):
        charge = electrons(sensor(photon_noise=True, read_noise_e=6.0, black_level_dn=400), mean)
        # a correlation r would add 2 r sigma sigma; fourth moments as for a Gaussian, and 1/mean of the Poisson part
        variance = mean + 36.0 + 0.25**2 / 12
        assert charge.var() == pytest.approx(variance, rel=SIGMAS * math.sqrt((2 + 1 / mean) / PIXELS))


def test_normal_numbers_have_the_right_distribution() -> None:
    """Kolmogorov-Smirnov over a map of normal numbers, and the share beyond four deviations (the ziggurat's tail)."""
    from gonio_sim.sensor import normals

    z = np.empty(4_000_000)
    normals(np.uint64(5), 0, z.size, 1.0, 0.0, z)
    assert stats.kstest(z, "norm").pvalue > 1e-4
    for limit in (3.0, 3.654, 4.0):
        expected = 2 * stats.norm.sf(limit) * z.size
        assert abs(np.count_nonzero(np.abs(z) > limit) - expected) < SIGMAS * math.sqrt(expected)
    # neighbours on the sensor are independent: the correlation of n pairs scatters by 1/sqrt(n)
    for lag in (1, 2, 640):
        assert abs(np.mean(z[lag:] * z[:-lag])) < SIGMAS / math.sqrt(z.size)


def test_linear_up_to_the_full_well_and_flat_beyond() -> None:
    of = sensor(full_well_e=10_000)
    for mean in (10.0, 100.0, 5_000.0, 9_999.0):
        # no noise: exact to half a step of 0.25 e- and to the float32 in which a scene is kept
        assert electrons(of, mean).mean() == pytest.approx(mean, rel=1e-6, abs=0.125)
        assert electrons(of, mean / 4, exposure_s=4.0).mean() == pytest.approx(mean, rel=1e-6, abs=0.125)
    assert np.all(electrons(of, 20_000.0) == 10_000.0)


def test_converter_clips_at_its_ends() -> None:
    of = sensor(bits=12, electrons_per_dn=2.0, black_level_dn=5, full_well_e=1e5, read_noise_e=30)
    assert of.read_out(np.full(SHAPE, 5e4, np.float32), 1.0, 1.0, np.uint64(1)).min() == 4095
    dark = of.read_out(None, 1.0, 1.0, np.uint64(1))
    assert dark.min() == 0
    assert dark.max() > 5


def test_dark_signal_grows_with_time_and_has_its_shot_noise() -> None:
    of = sensor(photon_noise=True, read_noise_e=2.5, dark_current_e_per_s=5.0, black_level_dn=64)
    for seconds in (0.01, 2.0, 10.0):
        dark = electrons(of, None, seconds)
        variance = 5.0 * seconds + 2.5**2 + 0.25**2 / 12
        assert dark.mean() == pytest.approx(5.0 * seconds, abs=SIGMAS * math.sqrt(variance / PIXELS))
        assert dark.var() == pytest.approx(variance, rel=SIGMAS * math.sqrt(3 / PIXELS))


def test_fixed_patterns_follow_from_the_seed_alone() -> None:
    of = sensor(prnu=0.005, dsnu_e=2.0)
    bright, dark = electrons(of, 8000.0, key=1), electrons(of, None, key=2)
    assert dark.std() == pytest.approx(2.0, rel=SIGMAS * math.sqrt(0.5 / PIXELS) + 0.002)  # 0.002: rounding to 0.25 e-
    assert ((bright - dark) / 8000.0).std() == pytest.approx(0.005, rel=SIGMAS * math.sqrt(0.5 / PIXELS) + 0.002)
    np.testing.assert_array_equal(bright, electrons(sensor(prnu=0.005, dsnu_e=2.0), 8000.0, key=9))
    other = electrons(sensor(seed=4, prnu=0.005, dsnu_e=2.0), 8000.0)
    assert abs(np.corrcoef(bright.ravel(), other.ravel())[0, 1]) < SIGMAS / math.sqrt(PIXELS)


def test_same_frame_whatever_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    camera = describe("sim").camera
    rate = np.linspace(0, 12_000, PIXELS, dtype=np.float32).reshape(SHAPE)

    def frame() -> npt.NDArray[np.uint16]:
        of = Sensor(camera, World(describe("sim"), None, 8).key)
        mosaic = of.read_out(rate, 1.0, 1.0, np.uint64(77))
        of.close()
        return mosaic

    frames = []
    for threads in (1, 2, 3):
        monkeypatch.setattr(camera_module, "THREADS", threads)
        frames.append(frame())
    np.testing.assert_array_equal(frames[0], frames[1])
    np.testing.assert_array_equal(frames[0], frames[2])


def test_frames_of_different_keys_are_independent() -> None:
    world = World(describe("sim"), None, 5)
    assert len({int(world.key(Stream.SENSOR, s, f)) for s in range(50) for f in range(20)}) == 1000
    of = sensor(photon_noise=True)
    a, b = (electrons(of, 5000.0, key=int(world.key(Stream.SENSOR, 3, f))) for f in (0, 1))
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < SIGMAS / math.sqrt(PIXELS)


def test_unquantised_levels_need_sixteen_bits() -> None:
    with pytest.raises(ConfigError, match=r"camera\.quantised = false with camera\.bits = 12"):
        Sensor(Camera(quantised=False), World(describe("sim"), None, 1).key)
