"""Photon transfer by EMVA Standard 1288, release 4.0, linear camera model: gain, noise, saturation, linearity error.

Two frames of one setting differ by temporal noise alone: sigma^2 = mean((a - b)^2)/2 - (mean(a) - mean(b))^2/2. Above
the dark frames' it grows with the mean as K, the gain [DN/e-]. Sections named here are those of the standard.

Dark current, DSNU, PRNU and defects come from dark and flat frames, pixel by pixel (sections 8 and 9).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.errors import DataError
from gonio.lab.rig.light_and_camera import Camera, straightened
from gonio.typing import Bools, Floats, NDArray

FIT_RANGE = 0.7
"""Part of saturation up to which points count for the gain's line (6.6)."""
LINEARITY_RANGE = 0.05, 0.95
"""Parts of saturation between which points count for the linearity error (7)."""
QUANTISATION = 1.0 / 12.0
LEAST_DARK_VARIANCE = 0.24
"""Temporal variance of dark frames [DN^2] below which rounding hides it (6.6): the standard takes this value then."""
FEWEST_LEVELS = 5
"""Levels in the gain's range below which no line is fitted."""


@dataclass(frozen=True, slots=True)
class FramePair:
    """Two frames of one setting, over one region."""

    exposure_s: float
    mean_dn: float
    variance_dn2: float
    """Temporal, of one pixel in one frame."""
    pixels: int

    @property
    def u_variance(self) -> float:
        """Standard uncertainty of the variance [DN^2]: of a sample of `pixels` differences of normal numbers."""
        return self.variance_dn2 * math.sqrt(2.0 / max(self.pixels - 1, 1))


def pair(a: NDArray[np.generic], b: NDArray[np.generic], exposure_s: float) -> FramePair:
    """The statistics of two frames, or of the same pixels of two (6.4)."""
    first, second = np.asarray(a, dtype=float).ravel(), np.asarray(b, dtype=float).ravel()
    means = float(first.mean()), float(second.mean())
    variance = 0.5 * float(np.mean((first - second) ** 2)) - 0.5 * (means[0] - means[1]) ** 2
    return FramePair(exposure_s, 0.5 * (means[0] + means[1]), variance, first.size)


@dataclass(frozen=True, slots=True)
class PhotonTransfer:
    """What pairs of flat and of dark frames say of a camera; u are standard uncertainties."""

    gain: float
    """K [DN/e-], by a line through the origin up to 70 % of saturation."""
    u_gain: float
    dark_noise_dn: float
    """Temporal noise of dark frames at no exposure [DN], rounding included."""
    u_dark_noise_dn: float
    hidden: bool
    """Rounding hides the dark noise: it is at most the one that is given."""
    saturation_dn: float
    """Level above the dark one where the variance is largest [DN]."""
    u_saturation_dn: float
    saturated: bool
    """False where the variance still grows at the brightest flats: saturation lies above."""
    linearity_error: float
    """Mean absolute departure from a straight line over exposure, between 5 and 95 % of saturation, as a fraction."""
    signal_dn: Floats
    """Signal of the flats, above the dark level, ascending; and what goes with each."""
    variance_dn2: Floats
    """Variance above that of the dark frames."""
    exposures_s: Floats
    total_variance_dn2: Floats

    @property
    def electrons_per_dn(self) -> float:
        """1/K [e-/DN]."""
        return 1.0 / self.gain

    @property
    def u_electrons_per_dn(self) -> float:
        """[e-/DN]."""
        return self.u_gain / self.gain**2

    @property
    def read_noise_e(self) -> float:
        """Temporal dark noise sigma_d without that of rounding [e-] (6.6)."""
        return math.sqrt(max(self.dark_noise_dn**2 - QUANTISATION, 0.0)) / self.gain

    @property
    def u_read_noise_e(self) -> float:
        """[e-]."""
        below = math.sqrt(max(self.dark_noise_dn**2 - QUANTISATION, 1e-12))
        own = self.dark_noise_dn * self.u_dark_noise_dn / below / self.gain
        return math.hypot(own, self.read_noise_e * self.u_gain / self.gain)

    @property
    def saturation_e(self) -> float:
        """Saturation capacity [e-]."""
        return self.saturation_dn / self.gain

    @property
    def threshold_e(self) -> float:
        """Electrons that the signal-to-noise ratio is 1 at (6.7)."""
        return self.dark_noise_dn / self.gain + 0.5

    @property
    def dynamic_range(self) -> float:
        """Saturation capacity over `threshold_e`."""
        return self.saturation_e / self.threshold_e

    @property
    def snr_max(self) -> float:
        """Signal-to-noise ratio at saturation."""
        return math.sqrt(self.saturation_e)


def _slope(camera: Camera, level: Floats) -> Floats:
    step = 1e-3 * np.maximum(level, 1.0)
    return np.asarray((straightened(camera, level + step) - straightened(camera, level - step)) / (2.0 * step))


def _by_level(flats: Sequence[FramePair], dark_level: tuple[float, float]) -> tuple[Floats, Floats, list[FramePair]]:
    """Exposures [s], levels above the dark one [DN], and pairs of one exposure averaged; by their levels."""
    merged = [_merged([p for p in flats if p.exposure_s == t]) for t in sorted({p.exposure_s for p in flats})]
    exposures = np.array([p.exposure_s for p in merged])
    level = np.array([p.mean_dn for p in merged]) - dark_level[0] - dark_level[1] * exposures
    order = np.argsort(level)
    return exposures[order], level[order], [merged[k] for k in order]


def photon_transfer(
    flats: Sequence[FramePair], darks: Sequence[FramePair], dark_level: tuple[float, float], camera: Camera,
    curve_covariance: Floats | None = None,
) -> PhotonTransfer:  # fmt: skip
    """The linear camera model from pairs.

    Parameters
    ----------
    flats, darks
        Of one region of nearly one brightness, in any order; pairs of one exposure are averaged.
    dark_level
        Mean of the dark frames: level [DN] and slope over exposure [DN/s].
    camera
        Its `nonlinearity` is taken out of means and variances; without one nothing is.
    curve_covariance
        Of its coefficients: it goes into the gain's uncertainty.

    Raises
    ------
    DataError
        There are too few levels below 70 % of saturation.
    """
    if not darks:
        raise DataError("there are no pairs of dark frames: the noise of the dark frames is not known")
    exposures, level, by_exposure = _by_level(flats, dark_level)
    total = np.array([p.variance_dn2 for p in by_exposure])
    dark_noise, u_dark, dark_slope = _dark_variance(darks)
    last = int(np.argmax(total))  # 6.6: beyond it pixels fill up
    usable = level <= FIT_RANGE * level[last]
    count = int(np.count_nonzero(usable))
    if count < FEWEST_LEVELS:
        raise DataError(
            f"flat frames have {count} levels below {100 * FIT_RANGE:.0f} % of saturation; the gain "
            f"needs {FEWEST_LEVELS}: take flats at more exposures from dark to full"
        )
    linear, slope = straightened(camera, level), _slope(camera, level)  # a bent curve changes noise by its slope
    shot = total * slope**2 - dark_noise - dark_slope * exposures
    x, y = linear[usable], shot[usable]
    u = np.array([p.u_variance for p in by_exposure])[usable] * slope[usable] ** 2
    gain = float(np.sum(x * y) / np.sum(x**2))
    u_gain = math.hypot(float(np.sqrt(np.sum((x * u) ** 2)) / np.sum(x**2)), u_dark * float(np.sum(x) / np.sum(x**2)))
    u_gain = math.hypot(u_gain, _u_of_curve(camera, curve_covariance, level[usable], total[usable], x, y, gain))
    if not gain > 0:
        raise DataError("the noise of the flat frames does not grow with their signal: are they flats, and raw?")
    hidden = dark_noise < LEAST_DARK_VARIANCE
    sigma = math.sqrt(max(dark_noise, LEAST_DARK_VARIANCE))
    ends = level[max(last - 1, 0)], level[min(last + 1, len(level) - 1)]
    return PhotonTransfer(
        gain=gain, u_gain=u_gain, dark_noise_dn=sigma, u_dark_noise_dn=0.5 * u_dark / sigma, hidden=hidden,
        saturation_dn=float(linear[last]), u_saturation_dn=float(abs(ends[1] - ends[0])) / math.sqrt(12.0),
        saturated=last < len(level) - 1, linearity_error=linearity_error(exposures, level, float(level[last])),
        signal_dn=linear, variance_dn2=shot, exposures_s=exposures, total_variance_dn2=total,
    )  # fmt: skip


def _u_of_curve(
    camera: Camera, covariance: Floats | None, level: Floats, total: Floats, x: Floats, y: Floats, gain: float
) -> float:
    """What the covariance of `camera.nonlinearity` does to the gain, to first order."""
    if covariance is None or not camera.nonlinearity:
        return 0.0
    by = np.zeros(len(camera.nonlinearity))
    before = _slope(camera, level)
    for k in range(by.size):
        changed = list(camera.nonlinearity)
        changed[k] += 1e-4
        other = camera.model_copy(update={"nonlinearity": tuple(changed)})
        moved, shot = straightened(other, level), y + total * (_slope(other, level) ** 2 - before**2)
        by[k] = (float(np.sum(moved * shot) / np.sum(moved**2)) - gain) / 1e-4
    return math.sqrt(max(float(by @ covariance @ by), 0.0))


def linearity_error(exposures_s: Floats, signal_dn: Floats, saturation_dn: float) -> float:
    """Mean absolute relative departure of signals from a line over exposure (7): least squares of relative departures.

    NaN where fewer than three levels lie between 5 and 95 % of saturation.
    """
    low, high = (part * saturation_dn for part in LINEARITY_RANGE)
    used = (signal_dn >= low) & (signal_dn <= high)
    if np.count_nonzero(used) < 3:
        return math.nan
    x, y = exposures_s[used], signal_dn[used]
    fitted = np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, y, 1, w=1.0 / y))
    return float(np.mean(np.abs((y - fitted) / fitted)))


def _merged(pairs: Sequence[FramePair]) -> FramePair:
    """Pairs of one setting, averaged."""
    return FramePair(
        pairs[0].exposure_s,
        float(np.mean([p.mean_dn for p in pairs])),
        float(np.mean([p.variance_dn2 for p in pairs])),
        sum(p.pixels for p in pairs),
    )


def _dark_variance(darks: Sequence[FramePair]) -> tuple[float, float, float]:
    """Temporal variance of dark frames at no exposure [DN^2], its uncertainty, and its growth with exposure [DN^2/s].

    The growth is the shot noise of the dark charge; with one exposure it is taken for zero.
    """
    t = np.array([p.exposure_s for p in darks])
    v, u = np.array([p.variance_dn2 for p in darks]), np.array([p.u_variance for p in darks])
    w = 1.0 / np.maximum(u, 1e-12) ** 2
    mean_t = float(np.sum(w * t) / np.sum(w))
    spread = float(np.sum(w * (t - mean_t) ** 2))
    if spread <= 1e-6 * mean_t**2 * float(np.sum(w)):
        return float(np.sum(w * v) / np.sum(w)), float(1.0 / np.sqrt(np.sum(w))), 0.0
    slope = max(float(np.sum(w * (t - mean_t) * v)) / spread, 0.0)
    level = float(np.sum(w * v) / np.sum(w)) - slope * mean_t
    return level, math.sqrt(1.0 / float(np.sum(w)) + mean_t**2 / spread), slope


DEFECT = 8.0
"""Robust standard deviations from the median beyond which a pixel is a defect: of normal noise none in 1e15."""
LEAST_DEPARTURE = 0.2
"""Relative departure of a responsivity below which a pixel is none, however narrow the others lie."""
SMOOTH_PX = 8.0
"""Standard deviation of the Gaussian that tells pixels from vignetting and beam."""
EDGE_PX = 4
"""Pixels beside the edge of a lit region that do not tell responsivities."""
UNEVEN = 1.5
"""Scatter about a pixel over that of neighbours, above which something else than pixels varies there. It is a mean of
800 values: of pixels alone ten standard deviations away."""
SECOND = np.outer([1.0, -2.0, 1.0], [1.0, -2.0, 1.0])
CORRELATED = 1.94
"""Variance of the variance by `SECOND`, over that of as many independent pixels: 1 + 2 (2/3)^2 + 2/36."""
OUTLIER = 9.0
"""Factor of the median second difference, beyond which one is a defect's: six standard deviations."""
FEWEST = 500
"""Pixels that tell single ones from a smooth course."""
WORST, ROUNDS = 0.3, 20
"""Share of the largest scatter: what is above it is left out first. Then the smooth course is fitted again."""
BOLTZMANN_EV = 8.617333262e-5
"""[eV/K], CODATA 2018."""


@dataclass(frozen=True, slots=True)
class Unevenness:
    """Spatial standard deviations of a picture, temporal noise taken out: in all, of rows, columns, pixels."""

    total: float
    row: float
    column: float
    pixel: float


def unevenness(picture: Floats, temporal_variance: float) -> Unevenness:
    """The three parts, as in the standard (8.2), of a mean picture whose pixels have a known temporal variance."""
    rows, cols = picture.shape
    total = float(picture.var(ddof=1)) - temporal_variance
    of_rows, of_cols = float(picture.mean(axis=1).var(ddof=1)), float(picture.mean(axis=0).var(ddof=1))
    # means of rows hold 1/cols of the single pixels, those of columns 1/rows
    pixel = (total + temporal_variance - of_rows - of_cols) / (1.0 - 1.0 / rows - 1.0 / cols)
    row, column = of_rows - pixel / cols, of_cols - pixel / rows
    parts = (total, row, column, pixel - temporal_variance)
    return Unevenness(*(math.sqrt(max(part, 0.0)) for part in parts))


def outliers(picture: Floats, least: float = 0.0) -> Bools:
    """Pixels far from the median, in robust standard deviations, and by `least` at least."""
    away = np.abs(picture - float(np.nanmedian(picture)))
    scale = 1.4826 * float(np.nanmedian(away))
    return np.asarray(np.isfinite(picture) & (away > max(DEFECT * scale, least)))


def smooth(picture: Floats, where: Bools, sigma: float = SMOOTH_PX) -> Floats:
    """A picture blurred by a Gaussian, over the pixels of a region alone; NaN far from it."""
    from scipy.ndimage import gaussian_filter

    weight = gaussian_filter(where.astype(float), sigma)
    values = gaussian_filter(np.where(where, picture, 0.0), sigma)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(weight > 1e-3, values / weight, math.nan))


def inside(region: Bools) -> Bools:
    """A region without the pixels near its edge, which see what lies beside it; dark single pixels do not count."""
    from scipy.ndimage import binary_closing, binary_erosion

    closed = binary_closing(region, iterations=2, border_value=False) | region
    return np.asarray(binary_erosion(closed, iterations=EDGE_PX, border_value=True))


def trend(picture: Floats, where: Bools) -> Floats:
    """The polynomial of fourth degree in rows and columns through the pixels of a region: vignetting and beam."""
    y, x = (2.0 * index / max(size - 1, 1) - 1.0 for index, size in zip(np.indices(picture.shape), picture.shape,
                                                                       strict=True))  # fmt: skip
    powers = [(i, j) for i in range(5) for j in range(5 - i)]
    some = np.flatnonzero(where)[:: max(np.count_nonzero(where) // 20_000, 1)]
    u, v = x.ravel()[some], y.ravel()[some]
    coefficients = np.linalg.lstsq(np.stack([u**i * v**j for i, j in powers], axis=1), picture.ravel()[some])[0]
    fitted = sum(c * x**i * y**j for c, (i, j) in zip(coefficients, powers, strict=True))
    return np.asarray(np.where(where, fitted, 1.0))


def evened(signal: Floats, region: Bools) -> tuple[Floats, Bools, float]:
    """A picture of a white over its own smooth course, the part of a region that tells pixels, and their variance.

    The variance is that of neighbours, by second differences both ways (`SECOND`). The rim of a white that does not
    fill the frame is blurred over several pixels, as are marks on it: there a picture scatters about its course by more
    than neighbours do, and such pixels are left out.
    """
    for _ in range(ROUNDS):
        level = signal / trend(signal, region)
        ratio = np.where(region, level / np.where(region, smooth(level, region), 1.0), math.nan)
        variance = independent_variance(ratio)
        scatter = smooth(np.nan_to_num(ratio - 1.0) ** 2, region)
        uneven = region & (scatter > max(UNEVEN * variance, WORST * float(np.max(scatter[region], initial=0.0))))
        if not uneven.any():
            break
        if np.count_nonzero(region & ~uneven) < FEWEST:
            return ratio, np.zeros_like(region), variance
        region = region & ~uneven
    return ratio, region, variance


def independent_variance(picture: Floats) -> float:
    """Variance of what differs from pixel to pixel, whatever the picture's smooth course; NaN is left out."""
    from scipy.ndimage import convolve

    there = np.isfinite(picture)
    whole = convolve(there.astype(float), np.ones((3, 3)), mode="constant") > 8.5
    bent = convolve(np.where(there, picture, 0.0), SECOND, mode="constant")[whole]
    return float(np.mean(np.minimum(bent**2, (OUTLIER * np.median(np.abs(bent))) ** 2))) / float((SECOND**2).sum())


@dataclass(frozen=True, slots=True)
class DarkTemperature:
    """Dark current over temperature: ln I = a - E/(k T)."""

    energy_ev: float
    doubling_c: float
    """Kelvin that double the dark current, at the mean temperature."""
    at_c: float


def temperature_law(temperatures_c: Floats, rates: Floats, u_rates: Floats) -> DarkTemperature | None:
    """Arrhenius' law through dark currents (any unit); None where temperatures differ by less than 2 K."""
    use = np.isfinite(temperatures_c) & (rates > 0)
    if np.count_nonzero(use) < 2 or float(np.ptp(temperatures_c[use])) < 2.0:
        return None
    kelvin = temperatures_c[use] + 273.15
    x, y = 1.0 / (BOLTZMANN_EV * kelvin), np.log(rates[use])
    w = (rates[use] / np.maximum(u_rates[use], 1e-12)) ** 2
    centre = float(np.sum(w * x) / np.sum(w))
    energy, middle = -float(np.sum(w * (x - centre) * y) / np.sum(w * (x - centre) ** 2)), float(np.mean(kelvin))
    doubling = math.log(2.0) * BOLTZMANN_EV * middle**2 / energy if energy > 0 else math.inf
    return DarkTemperature(energy, doubling, middle - 273.15)
