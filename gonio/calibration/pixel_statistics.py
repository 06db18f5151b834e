"""Dark current, DSNU, PRNU and defects: what dark and flat frames say of single pixels (EMVA 1288, 8 and 9)."""

import math
from dataclasses import dataclass

import numpy as np

from gonio.typing import Bools, Floats

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
"""The variance by `SECOND` is known by so much less than that of as many independent pixels: (1 + 2 (2/3)^2 + 2/36)."""
OUTLIER = 9.0
"""Of median second differences, beyond which one is a defect's: six standard deviations."""
FEWEST = 500
"""Pixels that tell single ones from a smooth course."""
WORST, ROUNDS = 0.3, 20
"""Of the largest scatter: what is above it goes first, for what is left out changes the course through what is kept."""
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
    """Of a mean picture whose pixels have a known temporal variance (8.2): the three parts by the standard's split."""
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
