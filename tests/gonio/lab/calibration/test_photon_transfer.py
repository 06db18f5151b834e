"""Photon transfer, linearity and response curves against sensors of known truth, and other people's programs."""

import functools
import math
from typing import Any

import numpy as np
import pytest
from gonio_sim.camera import Sensor
from scipy.ndimage import gaussian_filter

from gonio.errors import DataError
from gonio.lab.calibration import linearity, photon_transfer
from gonio.lab.calibration.photon_transfer import CORRELATED, evened, inside
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Floats
from tests.command_line import some
from tests.places import measured

CAMERA = Camera(
    width=160, height=120, bits=12, electrons_per_dn=2.3, black_level_dn=64.0, full_well_e=8000.0, photon_noise=True,
    read_noise_e=6.0, dark_current_e_per_s=4.0, prnu=0.006, dsnu_e=2.0,
)  # fmt: skip
FULL_S = 8.0
"""Exposure that fills the well of `RATE`."""
RATE = np.full((120, 160), 1000.0, np.float32)


class ManualRig:
    """A sensor, and frames of it with one key after the other."""

    def __init__(self, camera: Camera, seed: int) -> None:
        self.sensor = Sensor(camera, lambda stream: np.uint64(1000 * seed + stream))
        self.seed, self.taken = seed, 0

    def frame(self, rate: Any, exposure_s: float, level: float = 1.0) -> np.ndarray[Any, np.dtype[np.uint16]]:
        self.taken += 1
        return self.sensor.read_out(rate, exposure_s, level, np.uint64(2**40 + 10**6 * self.seed + self.taken))

    def pairs(self, rate: Any, exposures: Any) -> list[photon_transfer.FramePair]:
        return [photon_transfer.pair(self.frame(rate, t), self.frame(rate, t), t) for t in exposures]


def transfer(camera: Camera, seed: int) -> tuple[photon_transfer.PhotonTransfer, list[Any], list[Any], Any]:
    manual = ManualRig(camera, seed)
    darks = manual.pairs(None, [1e-3] * 4 + [FULL_S] * 4)
    line = np.polyfit([p.exposure_s for p in darks], [p.mean_dn for p in darks], 1)
    levels = np.concatenate([np.linspace(0.03, 0.7, 14), np.linspace(0.75, 1.15, 9)])
    flats = manual.pairs(RATE, np.tile(levels * FULL_S, 3))
    return photon_transfer.photon_transfer(flats, darks, (line[1], line[0]), camera), flats, darks, line


@pytest.fixture(scope="module")
def plain() -> tuple[photon_transfer.PhotonTransfer, list[Any], list[Any], Any]:
    return transfer(CAMERA, 1)


def test_gain_and_read_noise_of_a_known_sensor(plain: Any) -> None:
    found = plain[0]
    # 14 levels x 3 pairs x 19 200 pixels: u = 0.3 %; four of them
    assert found.electrons_per_dn == pytest.approx(2.3, abs=4 * found.u_electrons_per_dn)
    assert found.u_electrons_per_dn < 0.005 * 2.3
    assert found.read_noise_e == pytest.approx(6.0, abs=4 * found.u_read_noise_e)
    assert found.u_read_noise_e < 0.01 * 6.0
    # the variance is largest before the well is full: noise must not reach it; levels are 5 % apart
    assert 0.9 * 8000 < found.saturation_e <= 8000
    assert found.saturated
    assert not found.hidden


def test_emva1288_package_gives_the_same_figures(plain: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(np, "asfarray", functools.partial(np.asarray, dtype=float), raising=False)  # gone from numpy 2
    results = pytest.importorskip("emva1288.process.results")
    found = plain[0]
    x, total = found.exposures_s, found.total_variance_dn2
    level = found.signal_dn  # no curve: the measured one
    dark = total - found.variance_dn2
    data = {"texp": x, "u_p": x, "u_y": level, "s2_y": total, "u_ydark": np.zeros(x.size), "s2_ydark": dark}
    # the package's own search for saturation stops at the noise of frames that are full: it is told
    last = int(np.argmax(total))
    oracle = results.Results1288({"temporal": data, "spatial": {}}, index_u_ysat=last, loglevel=50)
    # both solve the same least squares, the package by an iteration that ends at 1e-8
    assert (found.gain, found.saturation_dn) == (pytest.approx(oracle.K, rel=1e-7), level[last])
    assert found.dark_noise_dn == pytest.approx(oracle.sigma_y_dark, rel=1e-3)  # its own line over exposure
    assert found.threshold_e == pytest.approx(oracle.sigma_y_dark / oracle.K + 0.5, rel=1e-3)
    line = oracle.linearity()
    used = slice(oracle.index_linearity_min, oracle.index_linearity_max + 1)
    # the standard's release 4.0 means the departures that the package (3.1) takes the extremes of
    assert found.linearity_error == pytest.approx(np.mean(np.abs(line["relative_deviation"][used])) / 100, rel=1e-9)


def test_unevenness_is_that_of_the_standard(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(3)
    rows, cols = random.normal(0, 2.0, (300, 1)), random.normal(0, 1.0, (1, 400))
    found = photon_transfer.unevenness(50.0 + rows + cols + random.normal(0, 3.0, (300, 400)), 0.0)
    # relative u of a standard deviation is 1/sqrt(2 n): 4 % of 300 rows, 3.5 % of 400 columns, 0.2 % of the pixels
    assert found.row == pytest.approx(2.0, rel=0.13)
    assert found.column == pytest.approx(1.0, rel=0.11)
    assert found.pixel == pytest.approx(3.0, rel=0.01)
    # nothing is lost by the split, however few rows and columns there are
    for each in (found, photon_transfer.unevenness((rows[:6] + cols[:, :5] + random.normal(0, 3.0, (6, 5))), 2.0)):
        assert each.total == pytest.approx(math.sqrt(each.row**2 + each.column**2 + each.pixel**2))


@pytest.mark.slow
@pytest.mark.parametrize("lamp_noise", [0.0, 0.01])
def test_nonlinearity_of_one_per_cent_is_found_though_the_lamp_flickers(lamp_noise: float) -> None:
    true = CAMERA.model_copy(update={"nonlinearity": (-0.014, 0.003), "full_well_e": 9500.0})
    manual, random = ManualRig(true, 4), np.random.default_rng(8)
    rate = RATE.copy()
    rate[:, :80] *= 0.04
    parts = (np.s_[:, 80:], np.s_[:, :80])
    exposures = np.tile(np.linspace(0.3, 8.0, 18), 4)
    level, u = np.zeros((2, 2, exposures.size))
    for k, t in enumerate(exposures):
        frame = manual.frame(rate, t, 1.0 + lamp_noise * random.standard_normal()).astype(float)
        for b, part in enumerate(parts):
            level[b, k] = frame[part].mean() - 64.0 - 4.0 * t / 2.3
            u[b, k] = math.sqrt((level[b, k] / 2.3 + 7.0) / frame[part].size)
    found = linearity.fit(level, u, np.zeros(2) + 0.002, exposures, np.full(exposures.size, math.nan), CAMERA)
    x = np.linspace(400.0, 3600.0, 9)
    truth = linearity.Linearity(np.array([-0.014, 0.003]), found.covariance, 0, 0, x, x, 2).departure(CAMERA, x)
    away, known = found.departure(CAMERA, x) - truth, found.u_departure(CAMERA, x)
    assert np.all(np.abs(away) < 4 * known)
    assert known.max() < 1.5e-3  # of 9600 pixels; a whole frame of a rig has thirty times as many
    if lamp_noise:
        assert found.lamp_noise == pytest.approx(lamp_noise, rel=0.35)  # 72 frames: 8 %, four of them


def test_flats_of_nearly_one_level_tell_no_curve() -> None:
    with pytest.raises(DataError, match="too few levels"):
        linearity.fit(np.full((1, 6), 100.0), np.ones((1, 6)), np.ones(1), np.ones(6), np.full(6, math.nan), CAMERA)


@pytest.mark.slow
def test_debevec_and_malik_of_a_photographed_bracket() -> None:
    folder = measured("camera/hdr_bracket")
    samples = np.load(folder / "test_samples_Grossberg2003.npy").astype(int)
    for channel in range(3):
        expected = np.load(folder / f"test_g_solve_g_{channel}.npy")  # by colour-hdri, from the same samples
        found = linearity.solve(samples[..., channel], np.log([0.125, 1.0, 8.0]))
        assert np.abs(found - expected).max() < 1e-7  # least squares by another way, in double precision


def test_gamma_of_a_video_camera_is_found() -> None:
    random = np.random.default_rng(2)
    light = np.exp(random.uniform(-3.0, 0.5, (40, 40)))
    exposures = np.geomspace(0.02, 4.0, 16)
    curve = 255.0 * (np.arange(256) / 255.0) ** 2.2
    frames = []
    for t in exposures:
        linear = 255.0 * np.minimum(light * t, 1.0)
        noisy = np.interp(linear, curve, np.arange(256.0)) + random.normal(0.0, 0.5, light.shape)
        frames.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    found, covariance = linearity.curve(frames, exposures)
    # 8 bits: half a step is 1 % of the linear value at 100, 3 % at 40
    assert np.abs(found[40:] / curve[40:] - 1.0).max() < 0.01
    assert (found[0], found[-1]) == (0.0, pytest.approx(255.0, abs=1e-9))
    s = found[40:] / 255.0
    u = np.sqrt(np.einsum("ks,kl,ls->s", [s, s**2], covariance, [s, s**2]))
    off = found[40:] / curve[40:] - 1.0
    assert 0.0 < u.max() < 0.03
    assert np.abs(off - off[0]).max() < 5 * u.max()  # a bound on gross errors: two coefficients do not tell all
    with pytest.raises(DataError, match="3 exposures"):
        linearity.curve(frames[:2], exposures[:2])
    with pytest.raises(DataError, match="near 0 to near 255"):
        linearity.curve(frames[:4], exposures[:4])


def test_pairs_of_one_exposure_may_differ_as_a_lamp_does() -> None:
    """A scatter of 1 % is two steps of a bright frame: only a longer exposure that is darker is a fault."""
    light, exposures = np.geomspace(0.05, 1.6, 1600).reshape(40, 40), np.repeat(np.geomspace(0.02, 4.0, 16), 2)
    lamp = 1.0 + 0.01 * np.tile([1.0, -1.0], 16)
    frames = [np.rint(255.0 * np.minimum(light * t, 1.0)).astype(np.uint8) for t in exposures * lamp]
    found, _ = linearity.curve(frames, exposures)
    # the lamp's 1 % in each frame, of which there are 32
    assert np.abs(found[40:] / np.arange(40.0, 256.0) - 1.0).max() < 0.01
    with pytest.raises(DataError, match="a longer exposure are darker"):
        linearity.curve(frames[::-1], exposures)


def test_dark_current_doubles_where_arrhenius_says() -> None:
    t = np.array([0.0, 10.0, 20.0, 30.0])
    rate = 3.0 * np.exp(-0.6 / photon_transfer.BOLTZMANN_EV * (1 / (t + 273.15) - 1 / 288.15))
    law = some(photon_transfer.temperature_law(t, rate, 0.01 * rate))
    assert law.energy_ev == pytest.approx(0.6, rel=1e-9)
    assert law.doubling_c == pytest.approx(math.log(2) * photon_transfer.BOLTZMANN_EV * 288.15**2 / 0.6, rel=1e-3)
    assert photon_transfer.temperature_law(t[:1], rate[:1], rate[:1]) is None


# ---- what flat frames say of single pixels, whatever of the frame the white fills ----


PRNU = 0.005


def flat(radius_px: float, blur_px: float, seed: int) -> Floats:
    """A white disc with a dark mark on it, out of focus, with vignetting, seen by uneven pixels."""
    y, x = np.indices((120, 160)) - np.array([60, 80])[:, None, None]
    white = (np.hypot(x, y) < radius_px).astype(float)
    white[(np.abs(x - 15) < 4) & (np.abs(y) < 4)] = 0.3
    course = 1.0 - 1e-5 * (x**2 + y**2)
    pixels = 1.0 + PRNU * np.random.default_rng(seed).normal(size=white.shape)
    return np.asarray(1000.0 * gaussian_filter(white, blur_px) * course * pixels)


@pytest.mark.parametrize("radius_px", [30.0, 45.0, 300.0])
@pytest.mark.parametrize("blur_px", [1.0, 4.0])
def test_rims_and_marks_are_no_uneven_pixels(radius_px: float, blur_px: float) -> None:
    for seed in range(4):
        signal = flat(radius_px, blur_px, seed)
        ratio, region, variance = evened(signal, inside(signal > 500.0))
        count = np.count_nonzero(region)
        # 4 standard deviations of a standard deviation by second differences
        assert np.sqrt(variance) == pytest.approx(PRNU, rel=4 * CORRELATED / np.sqrt(2 * max(int(count), 1000)))
        if count:  # of a small disc that is wholly blurred nothing is left
            assert float(np.std(ratio[region])) == pytest.approx(
                PRNU, rel=0.15
            )  # local means of 1.5 times the variance


def test_a_course_of_fourth_degree_is_found_whole() -> None:
    row, col = np.indices((30, 40)) / 20.0
    course = 3.0 + row - 0.5 * col + row * col**3 - 0.7 * row**2 * col**2 + 0.2 * row**4
    where = row + col > 0.5
    found = photon_transfer.trend(np.where(where, course, np.nan), where)
    np.testing.assert_allclose(found, np.where(where, course, 1.0), rtol=1e-10)  # the fit's rounding
