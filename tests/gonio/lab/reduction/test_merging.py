"""Merging pixel by pixel against frames of exact statistics: no bias, honest uncertainties, no hits, no full pixels."""

import datetime
import math
from typing import Any

import numpy as np
import pytest

from gonio.lab.reduction import merging
from gonio.lab.rig.calibration_use import Calibrated, CalibrationUse
from gonio.lab.rig.description import RigDescription
from gonio.typing import Floats
from tests.command_line import some
from tests.gonio.lab.reduction.made_run import describe

SHAPE = (16, 16)
N = SHAPE[0] * SHAPE[1]
DARK = 5.0
BLACK = 64.0


def rig(lamp: float = 0.0, **camera: Any) -> RigDescription:
    known = {
        "electrons_per_dn": 2.7, "read_noise_e": 2.5, "photon_noise": True, "full_well_e": 10_800.0, "bits": 12,
        "black_level_dn": BLACK, "dark_current_e_per_s": DARK,
    }  # fmt: skip
    return describe(camera=known | camera, lamp={"noise": lamp})


def frames(
    description: RigDescription,
    rate: Floats | float,
    exposures_s: list[float],
    rng: np.random.Generator,
    hits: int = 0,
) -> merging.Stack:
    """Frames by numpy's own Poisson numbers; `hits` times 500 e- or more in one pixel of one frame."""
    camera, t = description.camera, np.array(exposures_s)[:, None]
    lamp = 1.0 + description.lamp.noise * rng.standard_normal(t.shape)
    charge = rng.poisson(np.broadcast_to(rate, N) * t * lamp + DARK * t).astype(float)
    charge = np.minimum(charge, camera.full_well_e) + camera.read_noise_e * rng.standard_normal(charge.shape)
    for _ in range(hits):
        charge[rng.integers(len(t)), rng.integers(N)] += 500.0 + rng.exponential(3000.0)
    dn = np.clip(np.floor(charge / camera.electrons_per_dn + BLACK + 0.5), 0, camera.white_level_dn)
    full = min(camera.white_level_dn - BLACK, camera.full_well_e / camera.electrons_per_dn)
    return merging.Stack(
        electrons=(dn - BLACK) * camera.electrons_per_dn - DARK * t,
        levels=(dn - BLACK) / full,
        exposures_s=t[:, 0],
        mask=np.ones(SHAPE, dtype=bool),
        per_weight=np.ones(N),
        dark_rate=np.full(N, DARK),
        hot=np.zeros(N, dtype=bool),
    )


def trials(description: RigDescription, rate: Any, exposures_s: list[float], count: int, hits: int = 0) -> Any:
    """Relative errors, pulls, and hits that were found, of repeated steps."""
    rng, out = np.random.default_rng(5), []
    true = float(np.mean(rate))
    for _ in range(count):
        merged = some(merging.merge(description, frames(description, rate, exposures_s, rng, hits)))
        out.append((merged.rate / true - 1.0, (merged.rate - true) / math.sqrt(merged.variance), merged.hits))
    return np.array(out).T


@pytest.mark.parametrize("rate_per_ms", [1.0, 10.0, 100.0, 1000.0])
def test_merged_rates_are_unbiased_and_their_uncertainty_is_theirs(rate_per_ms: float) -> None:
    """From 1 to 1000 e-/ms: exposures that bring 0.2 to 20 000 e-, of which the longest are full at the upper end."""
    count = 600
    error, pull, hits = trials(rig(), 1e3 * rate_per_ms, [0.02, 0.005, 0.00125, 0.0003], count)
    # three standard errors of 600 trials: of the mean, and of the standard deviation (1/sqrt(1200))
    assert abs(np.mean(error)) < max(3.0 * np.std(error) / math.sqrt(count), 1e-9)
    assert abs(np.mean(pull)) < 3.0 / math.sqrt(count)
    assert np.std(pull) == pytest.approx(1.0, abs=3.0 / math.sqrt(2.0 * count))
    assert hits.sum() <= 3  # false alarms: at most 1e-3 a step


def test_the_bias_is_below_two_parts_in_ten_thousand() -> None:
    """The mean of so many steps is known to 2e-5: four exposures of which the longest is just not full."""
    error, _, _ = trials(rig(), 4.5e5, [0.02, 0.02, 0.005, 0.00125], 400)
    assert np.std(error) / 20.0 < 3e-5
    assert abs(np.mean(error)) < 2e-4


@pytest.mark.parametrize("level", [0.80, 0.88, 0.92, 0.96, 1.02])
def test_pixels_near_saturation_are_left_out_without_a_bias(level: float) -> None:
    """A frame in which some pixels are full by their own noise, and three of a quarter of its exposure."""
    error, pull, _ = trials(rig(), level * 10_800.0 / 0.01, [0.01, 0.0025, 0.0025, 0.0025], 400)
    assert abs(np.mean(error)) < 3.0 * np.std(error) / 20.0
    assert np.std(pull) == pytest.approx(1.0, abs=0.11)  # three standard errors of 400 trials


def test_a_region_with_a_peak_uses_long_frames_for_its_faint_pixels() -> None:
    y, x = np.mgrid[-1:1:16j, -1:1:16j]
    rate = (1e3 + 1e6 * np.exp(-(x**2 + y**2) / 0.1)).ravel()
    description, rng = rig(), np.random.default_rng(1)
    both = merging.merge(description, frames(description, rate, [0.008, 0.008, 0.5, 0.5], rng))
    short = merging.merge(description, frames(description, rate, [0.008, 0.008], rng))
    assert both is not None
    assert short is not None
    assert both.variance < short.variance
    assert 0.05 < both.saturated < 0.5
    assert both.rate == pytest.approx(rate.mean(), abs=4.0 * math.sqrt(both.variance))
    faint = rate < 2e3  # as all of them: what pixels of the peak say comes from the short frames
    assert faint.any()
    assert some(both.shares)[2:, faint].sum() > 0.8 * some(both.shares)[:, faint].sum()
    _, pull, hits = trials(description, rate, [0.008, 0.008, 0.5, 0.5], 300)
    assert np.std(pull) == pytest.approx(1.0, abs=0.13)  # three standard errors of 300 trials
    assert hits.sum() <= 3


def test_a_region_that_is_full_in_every_frame_has_no_rate() -> None:
    description, rng = rig(), np.random.default_rng(1)
    assert merging.merge(description, frames(description, 2e6, [0.01, 0.02], rng)) is None


@pytest.mark.parametrize("exposures_s", [[0.004, 0.004, 0.001], [0.004, 0.004], [0.004]])
@pytest.mark.parametrize("rate", [1e3, 1e6])
def test_hits_of_cosmic_radiation_are_left_out(exposures_s: list[float], rate: float) -> None:
    """Three a step, of at least 500 e-: 8 standard deviations of the brighter frames' 4000 e-."""
    count = 200
    error, pull, hits = trials(rig(), rate, exposures_s, count, hits=3)
    assert np.mean(hits < 3) < 0.12  # two may fall on one pixel, beside a third in one frame, or stay below the bound
    assert abs(np.mean(error)) < 4.0 * np.std(error) / math.sqrt(count)
    assert np.std(pull) < 1.3


@pytest.mark.parametrize("count", [2, 3, 5])
def test_a_pixel_of_a_dark_frame_that_was_hit_takes_the_mean_of_the_others(count: int) -> None:
    dark = np.random.default_rng(4).integers(60, 69, (count, 8, 8)).astype(np.uint16)
    dark[1, 2, 3] = 900
    clean, hits = merging.without_hits(rig().camera, dark, BLACK)
    assert hits == 1
    assert clean[1, 2, 3] == pytest.approx(np.delete(dark[:, 2, 3], 1).mean(), rel=1e-12)
    kept = np.ones(dark.shape, dtype=bool)
    kept[1, 2, 3] = False
    assert (clean[kept] == dark[kept]).all()


def test_the_lamp_s_flicker_makes_frames_count_alike() -> None:
    """Bright frames: the lamp is the only noise that matters, whatever their exposure."""
    description = rig(lamp=0.01)
    merged = some(merging.merge(description, frames(description, 4e5, [0.02, 0.02, 0.005], np.random.default_rng(2))))
    np.testing.assert_allclose(merged.frame_weights, 1 / 3, atol=0.01)
    assert math.sqrt(merged.variance) / merged.rate == pytest.approx(0.01 / math.sqrt(3), rel=0.02)
    error, pull, _ = trials(description, 4e5, [0.02, 0.02, 0.005], 400)
    assert np.std(pull) == pytest.approx(1.0, abs=0.11)
    assert abs(np.mean(error)) < 3.0 * np.std(error) / 20.0


def test_the_rate_is_linear_in_the_frames() -> None:
    description = rig(lamp=0.01)
    stack = frames(description, 4e4, [0.02, 0.005], np.random.default_rng(2))
    merged = some(merging.merge(description, stack))
    assert merged.rate == pytest.approx(
        np.sum(some(merged.shares) * stack.electrons / stack.exposures_s[:, None]), rel=1e-12
    )
    assert some(merged.shares).sum() == pytest.approx(1.0, abs=0.02)  # but for what the lamp's prior takes


def test_noise_that_nobody_measured_is_poisson() -> None:
    """Without read noise and without a calibration, weights are exposures; a calibration says otherwise."""
    description = rig(read_noise_e=0.0)
    assert not merging.noise_is_known(description)
    day = datetime.date(2026, 1, 1)
    known = Calibrated(parameters=[], u=[], correlation=[], kind="camera", file="camera.toml", sha256="", made=day)
    assert merging.noise_is_known(description.model_copy(update={"calibration": CalibrationUse(known=(known,))}))
    assert merging.noise_is_known(rig())
    merged = some(merging.merge(description, frames(description, 1e5, [0.02, 0.005], np.random.default_rng(2))))
    np.testing.assert_allclose(merged.frame_weights, [0.8, 0.2], atol=1e-3)


def test_bernstein_s_bound_holds_for_poisson_numbers() -> None:
    from scipy import stats

    for mean in (0.01, 1.0, 30.0, 1e4):
        for limit in (5.0, 15.0):
            x = float(merging.bound(np.array(mean), limit))
            assert stats.poisson.sf(mean + x, mean) <= math.exp(-limit)
            assert x**2 / (2.0 * (mean + x / 3.0)) == pytest.approx(limit, rel=1e-12)  # and no wider than the bound is
