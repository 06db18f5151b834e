"""What flat frames say of single pixels, whatever of the frame the white fills."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gonio.calibration.pixel_statistics import CORRELATED, evened, inside
from gonio.typing import Floats

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
