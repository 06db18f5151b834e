"""Stray light from black parts of frames, beside frames that are spread at full resolution by scipy."""

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gonio.lab.calibration.black_frames import BlackFrame, fit
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Floats

HEIGHT, WIDTH = 96, 128
BLACK = slice(8, 88), slice(4, 60)
CAMERA = Camera(width=WIDTH, height=HEIGHT, pixel_um=10.0)


def scene(first: int, last: int, level: float = 2000.0) -> Floats:
    """A bright band of columns on black."""
    out = np.zeros((HEIGHT, WIDTH))
    out[:, first:last] = level
    return out


def frame(of: Floats, even: float, halo: float, halo_px: float, sigma_dn: float, seed: int) -> BlackFrame:
    """What lens and sensor make of a scene, with noise, and two defects in its black part."""
    rng = np.random.default_rng(seed)
    spread = even * of.mean() + halo * gaussian_filter(of, halo_px, mode="constant", truncate=8.0)
    signal = of + spread + sigma_dn * rng.standard_normal(of.shape)
    signal[20, 20] = signal[40, 10] = math.nan
    return BlackFrame(signal, BLACK, sigma_dn**2)


COUNT = 80 * 56 - 2
"""Pixels of the black part that have a value."""


def test_an_even_share_and_its_uncertainty_are_those_of_a_mean() -> None:
    of = scene(64, 128)
    found = fit([frame(of, 0.02, 0.0, 10.0, 1.0, seed=1)], CAMERA)
    assert found.halo == 0.0
    # the mean of N pixels over the mean of the scene; 0.3 % of the share is for the bins of a halo
    of_noise = 1.0 / math.sqrt(COUNT) / of.mean()
    u = math.hypot(of_noise * math.sqrt(max(found.chi_square, 1.0)), 3e-3 * 0.02)
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(u, rel=1e-3)
    assert abs(found.uniform - 0.02) < 4.0 * of_noise
    assert found.chi_square == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / COUNT))


def test_two_frames_are_known_better_by_the_root_of_two() -> None:
    of = scene(64, 128)
    two = fit([frame(of, 0.001, 0.0, 10.0, 2.0, seed=k) for k in (1, 2)], CAMERA)
    of_noise = 2.0 / math.sqrt(2 * COUNT) / of.mean()
    assert math.sqrt(two.covariance[0, 0]) == pytest.approx(of_noise, rel=0.03)
    assert abs(two.uniform - 0.001) < 4.0 * of_noise


def test_noise_that_is_larger_than_stated_widens_the_uncertainty() -> None:
    of = scene(64, 128)
    made = frame(of, 0.001, 0.0, 10.0, 2.0, seed=3)
    found = fit([BlackFrame(made.signal_dn, made.black, 1.0)], CAMERA)
    assert found.chi_square == pytest.approx(4.0, rel=4.0 * math.sqrt(2.0 / COUNT))
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(2.0 / math.sqrt(COUNT) / of.mean(), rel=0.05)


def test_a_halo_beside_an_edge_is_found_with_its_width() -> None:
    found = fit([frame(scene(64, 128), 0.01, 0.02, 16.0, 1.0, seed=4)], CAMERA)
    # bins of a quarter of the halo's width, which are linear in between
    assert (found.halo_px, found.halo, found.uniform) == pytest.approx((16.0, 0.02, 0.01), rel=0.05)
    assert abs(found.halo - 0.02) < 5.0 * math.sqrt(found.covariance[1, 1])


def test_a_halo_far_from_what_is_black_is_no_halo() -> None:
    """Ten standard deviations of the halo lie between the bright band and the black part."""
    found = fit([frame(scene(124, 128), 0.0, 0.02, 6.0, 1.0, seed=5)], CAMERA)
    assert found.halo == 0.0
    assert abs(found.uniform) < 4.0 / math.sqrt(COUNT) / scene(124, 128).mean()
