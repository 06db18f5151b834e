"""What the noise of dark frames has in common at points whose regions of interest are foreshortened differently."""

import math

import numpy as np
import pytest

from gonio.lab.reduction import dark_signal
from gonio.lab.reduction.dark_signal import COLUMNS, PATTERNS, Darks, Patterns, strongest, u_black
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.regions import Roi


def ellipse(width: float, height: float) -> Roi:
    """A round patch of 20 pixels' radius, seen at an angle."""
    rows, cols = np.mgrid[-20:21, -20:21]
    mask = (cols / width) ** 2 + (rows / height) ** 2 <= 1.0
    (top, bottom), (left, right) = (np.flatnonzero(mask.any(axis=axis))[[0, -1]] for axis in (1, 0))
    return Roi(
        slice(30 + int(top), 31 + int(bottom)),
        slice(50 + int(left), 51 + int(right)),
        mask[top : bottom + 1, left : right + 1],
    )


def correlation(regions: list[Roi]) -> np.ndarray:
    """Of means over regions, pixels being independent: counted, pixel by pixel."""
    return np.array([[a.shared(b) / math.sqrt(a.count * b.count) for b in regions] for a in regions])


REGIONS = [ellipse(20.0 * math.cos(math.radians(t)), 20.0) for t in range(0, 85, 4)]
REGIONS += [ellipse(20.0, 20.0 * math.cos(math.radians(t))) for t in range(10, 80, 10)]
BOX = slice(30, 71), slice(50, 91)


def test_the_line_of_dark_frames_is_that_of_least_squares() -> None:
    """And its leverage by one frame after the other, whose weights are rows of the design's inverse."""
    region, times = REGIONS[5], np.array([0.1, 0.1, 0.4, 2.0, 3.0])
    stack = np.random.default_rng(4).normal(100.0, 3.0, (5, 41, 41))
    darks = Darks(list(zip(times, stack, strict=True)), *BOX, rate=0.0)
    inverse = np.linalg.pinv(np.stack([np.ones(5), times], axis=1))
    used = stack[:, region.rows.start - 30 : region.rows.stop - 30, region.cols.start - 50 : region.cols.stop - 50]
    start, slope = inverse @ used[:, region.mask]
    np.testing.assert_allclose(darks.rate(region), slope, rtol=1e-9, atol=1e-12)  # rounding
    np.testing.assert_allclose(darks.of(region, 0.7), start + 0.7 * slope, rtol=1e-12)
    np.testing.assert_allclose(darks.exposures_s, [0.2, 2.5], rtol=1e-15)
    shares = np.array([1.0, 5.0]) @ inverse  # at 5 s the short frames pull the line down
    expected = [-np.linalg.norm(shares[:3]), np.linalg.norm(shares[3:])]
    np.testing.assert_allclose(darks.leverage(5.0), expected, rtol=1e-12)
    alone = Darks([(0.5, stack[0])], *BOX, rate=2.0)  # one exposure: its slope is the data sheet's
    np.testing.assert_allclose(alone.of(region, 1.5), used[0][region.mask] + 2.0, rtol=1e-15)


@pytest.mark.parametrize("mean", [-24.0, -8.0, 0.0, 16.0, 32.0])
def test_what_is_cut_off_at_black_is_told_by_what_is_left(mean: float) -> None:
    """Normal numbers of deviation 16 DN, as frames hold them."""
    signal = np.random.default_rng(1).normal(mean, 16.0, 400_000)
    drawn = np.maximum(np.rint(signal), 0.0)
    # 0.1 DN: of 400 000 numbers the share that reads 0 tells the place to 0.004 deviations
    assert u_black(Camera(), drawn) == pytest.approx(drawn.mean() - signal.mean(), rel=0.01, abs=0.1)
    curve = Camera(bits=8, black_level_dn=0.0, response=tuple(range(256)))
    more = u_black(curve, drawn) ** 2 - u_black(Camera(), drawn) ** 2
    assert more == pytest.approx((0.4 * 16.0) ** 2 / 3.0, rel=0.03)  # the mean of what a cut at 0 adds to a mean of 0


def test_a_camera_without_noise_cuts_nothing_off_and_one_with_a_curve_may() -> None:
    black = np.zeros(1000)
    assert u_black(Camera(), black) == u_black(Camera(), black + 64.0) == 0.0
    assert u_black(Camera(bits=8, black_level_dn=0.0, response=(0.0, *np.linspace(0.2, 255.0, 255))), black) == 0.1


def test_patterns_hold_what_regions_share() -> None:
    patterns = Patterns(REGIONS, BOX)
    coefficients = np.array([patterns.of(region) for region in REGIONS])
    assert coefficients.shape == (len(REGIONS), PATTERNS)
    assert np.all(np.sum(coefficients**2, axis=1) <= 1 + 1e-12)  # a part of a variance of 1
    # each pattern behind the sixth holds less than 1 % of all variance, but more of the narrowest region's
    np.testing.assert_allclose(coefficients @ coefficients.T, correlation(REGIONS), atol=0.15)
    few = [REGIONS[0], REGIONS[10], REGIONS[20]]
    found = np.array([Patterns(few, BOX).of(region) for region in few])
    np.testing.assert_allclose(found @ found.T, correlation(few), atol=1e-12)  # as many patterns as regions: exact


def test_a_run_without_a_measured_point_has_no_patterns() -> None:
    nothing = Roi(slice(0, 0), slice(0, 0), np.zeros((0, 0), dtype=bool))
    assert np.all(Patterns([], (slice(0, 0), slice(0, 0))).of(nothing) == 0.0)


def test_patterns_of_some_regions_serve_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a long run, or of many pixels, not all regions are held; what is not described is less, and never more."""
    monkeypatch.setattr(dark_signal, "HELD", 7 * 41 * 41)
    patterns = Patterns(REGIONS, BOX)
    held = np.sum(np.array([patterns.of(region) for region in REGIONS]) ** 2, axis=1)
    assert np.all(held <= 1 + 1e-12)
    # every fifth region describes those between them, but not the narrowest beyond the last: 0.90, of all regions 0.95
    assert held.mean() > 0.85


def test_columns_say_how_well_a_black_sample_is_known() -> None:
    """The standard error of a constant, from the columns and from the pixels' exact covariance."""
    patterns = Patterns(REGIONS, BOX)
    size = np.array([1.0 / math.sqrt(region.count) for region in REGIONS])  # of a mean over fewer pixels: larger
    shared = np.array([patterns.of(region) for region in REGIONS]) * size[:, None]
    columns, rest = strongest(shared, size)
    assert columns.shape == (len(REGIONS), COLUMNS)
    assert np.all(columns.sum(axis=0) <= 0)
    own = 2.0 * size**2 - np.sum(shared**2, axis=1)  # as much noise again of the frames themselves
    stated = np.diag(own + rest) + columns @ columns.T
    exact = np.diag(size**2) + correlation(REGIONS) * np.outer(size, size)
    np.testing.assert_allclose(np.diag(stated), np.diag(exact), rtol=1e-12)  # an identity
    weights = np.linalg.solve(stated, np.ones(len(REGIONS)))
    # the variance of a constant fitted with the stated covariance; 1.26 with one column instead of three
    assert abs(weights @ exact @ weights / weights.sum() - 1.0) < 0.05
    deviations = np.linalg.eigvals(np.linalg.solve(stated, exact)).real
    assert deviations.min() > 0.8  # in any direction; with one column 0.67 and 2.8
    assert deviations.max() < 2.0
