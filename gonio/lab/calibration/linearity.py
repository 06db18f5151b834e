"""Nonlinearity of a camera from flat frames at several exposures, whatever the lamp does meanwhile.

Every flat holds parts of different brightness (white reference, holder, vignetted corners). The lamp changes all of
them by one factor; a bent curve does not. So each frame j has a factor of its own, each part b a brightness, and

    ln y_bj = ln rho_b + ln t_j + l_j + ln(1 + c[0] s + c[1] s^2 + ...),   s = x_bj / the highest value

is fitted by least squares. The factors l_j lie around a straight line over time (drift) with a scatter (noise of the
lamp) that the fit estimates too. Frames of one brightness alone then still tell c, as well as the lamp is steady.

Also here is the response curve of a camera of 8 bits from a bracket of exposures (Debevec1997).

Pixels of one still scene at several exposures read Z_ij, and g(Z_ij) = ln E_i + ln t_j with one smooth g for all.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.errors import DataError
from gonio.lab.rig.light_and_camera import Camera, bent, straightened
from gonio.typing import Array, Floats

DEGREE = 2
"""Coefficients of the departure."""
LEAST_SCATTER = 1e-5
ROUNDS = 40


@dataclass(frozen=True, slots=True)
class Linearity:
    """The coefficients of `camera.nonlinearity`, and what else came out."""

    coefficients: Floats
    covariance: Floats
    lamp_noise: float
    """Scatter of the frames' levels around their drift: lamp and shutter."""
    chi_square: float
    """Reduced, of the parts' levels; uncertainties are scaled by it where it is above 1."""
    residuals: Floats
    """Relative, of each part (rows) and frame (columns); NaN where it was not used."""
    signal_dn: Floats
    parts: int

    def departure(self, camera: Camera, signal_dn: Floats) -> Floats:
        """Relative departure at linear signals [DN]."""
        s = np.asarray(signal_dn, dtype=float) / camera.white_level_dn
        return np.asarray(np.polynomial.polynomial.polyval(s, np.array([0.0, *self.coefficients])))

    def u_departure(self, camera: Camera, signal_dn: Floats) -> Floats:
        """Standard uncertainty of `departure`."""
        s = np.asarray(signal_dn, dtype=float)[..., None] / camera.white_level_dn
        by = s ** np.arange(1, len(self.coefficients) + 1)
        return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", by, self.covariance, by)))


def _require_levels(signal_dn: Floats, exposures_s: Floats) -> None:
    near = signal_dn.size == 0 or signal_dn.max() < 3.0 * signal_dn.min()
    if near or len(set(np.round(exposures_s, 12))) < DEGREE + 2:
        raise DataError(
            "the flat frames have too few levels, or such of nearly one level, to tell a bent curve from a straight "
            "one: take flats at exposures from 5 to 95 % of full scale"
        )


def fit(
    signal_dn: Floats, u_dn: Floats, u_dark_dn: Floats, exposures_s: Floats, times_s: Floats, camera: Camera
) -> Linearity:  # fmt: skip
    """Fit the nonlinearity.

    Parameters
    ----------
    signal_dn, u_dn
        Mean of each part above the dark level and its standard uncertainty, shape (parts, frames); NaN is left out.
    u_dark_dn
        Standard uncertainty of the dark level of each part, which all frames share, shape (parts,).
    exposures_s, times_s
        Of each frame; times may be NaN.

    Raises
    ------
    DataError
        The levels lie too close together to tell a bent curve from a straight one.
    """
    parts, frames = signal_dn.shape
    use = np.isfinite(signal_dn) & (signal_dn > 0)
    b, j = np.nonzero(use)
    y, u = signal_dn[use], u_dn[use]
    _require_levels(y, exposures_s[np.unique(j)])
    timed = bool(np.isfinite(times_s).all()) and float(np.ptp(times_s)) > 0
    away = (times_s - times_s.mean()) / max(float(np.ptp(times_s)), 1e-9) if timed else np.zeros(frames)
    # unknowns: ln rho_b, departures of the frames' levels, drift, errors of the dark levels, coefficients
    at_frame, at_drift, at_dark, at_c = parts, parts + frames, parts + frames + 1, 2 * parts + frames + 1
    rows = np.arange(y.size)
    fixed, known, prior = (np.zeros((size, at_c + DEGREE)) for size in (y.size, parts + 1, frames))
    fixed[rows, b] = fixed[rows, at_frame + j] = 1.0
    fixed[rows, at_drift], fixed[rows, at_dark + b] = away[j], 1.0 / y
    known[1:, at_dark:at_c] = np.diag(1.0 / np.maximum(u_dark_dn, 1e-9))
    known[0, at_drift] = 0.0 if timed else 1e6
    prior[:, at_frame:at_drift] = np.eye(frames)
    c, scatter, weight = np.zeros(DEGREE), 0.01, y / u
    for _ in range(ROUNDS):
        now = camera.model_copy(update={"nonlinearity": tuple(c)})
        x = straightened(now, y)
        one = bent(now, x) / x
        # the slope counts that a larger departure means a smaller x at a given y
        slopes = (x / camera.white_level_dn)[:, None] ** np.arange(1, DEGREE + 1) / one[:, None]
        design = np.hstack([fixed[:, :at_c], slopes])
        value = np.log(y / exposures_s[j]) - np.log(one) + slopes @ c
        matrix = np.vstack([design * weight[:, None], prior / scatter, known])
        inverse = np.linalg.pinv(matrix.T @ matrix, rcond=1e-15, hermitian=True)
        solution = inverse @ (matrix.T @ np.concatenate([value * weight, np.zeros(frames + parts + 1)]))
        new, levels = solution[at_c:], solution[at_frame:at_drift]
        spread = float(np.sum(levels**2) + np.trace(inverse[at_frame:at_drift, at_frame:at_drift]))
        estimate = max(math.sqrt(spread / frames), LEAST_SCATTER)
        done = np.max(np.abs(new - c)) < 1e-8 and abs(estimate - scatter) < 1e-3 * scatter
        c, scatter = np.clip(new, -0.2, 0.2), estimate
        if done:
            break
    held = np.full(signal_dn.shape, math.nan)
    held[use] = value - design @ solution
    chi_square = float(np.sum((held[use] * weight) ** 2))
    chi_square /= max(y.size - parts - DEGREE - (frames if parts > 1 else 2), 1)
    covariance = inverse[at_c:, at_c:] * max(chi_square if parts > 1 else 1.0, 1.0)
    return Linearity(c, covariance, scatter, chi_square, held, straightened(now, signal_dn), parts)


VALUES = 256
SMOOTHNESS = 30.0
SMOOTHNESS_OF_MEANS = 300.0
"""Of means over many pixels, which have little noise: what a bracket leaves between its levels is filled smoothly."""
FEWEST_EXPOSURES = 3


def hat(values: Floats, low: float = 0.01, high: float = 0.99) -> Floats:
    """The weight of values between 0 and 1: largest in the middle, 0 at both ends and beyond."""
    middle = 0.5 * (low + high)
    inside = (values >= low) & (values <= high)
    weight = np.where(inside, np.where(values <= middle, values - low, high - values), 0.0)
    return np.asarray(weight / weight.max())


def solve(values: Array, log_exposures: Floats, smoothness: float = SMOOTHNESS, x: Floats | None = None) -> Floats:
    """g of every value, with g(128) = 0: the least squares of Debevec and Malik, eq. 3; 0 where no frame determines it.

    Parameters
    ----------
    values
        Of pixels (rows) at exposures (columns), 0 to 255. Between whole values g is straight.
    log_exposures
        ln of each exposure time [s].
    x
        Places of the 256 values on a scale on which g is smooth; by default the values, as in the paper.
    """
    values = np.asarray(values, dtype=float)
    weights = hat(values / (VALUES - 1)) ** 2
    seen = weights.sum(axis=1) > 0
    values, weights = values[seen], weights[seen]
    of_pixel, low = weights.sum(axis=1), np.minimum(values.astype(int), VALUES - 2)
    pixels, ends = np.indices(values.shape)[0], ((low, 1.0 - (values - low)), (low + 1, values - low))
    shares, right, normal = np.zeros((len(values), VALUES)), np.zeros(VALUES), np.zeros((VALUES, VALUES))
    for value, part in ends:
        np.add.at(shares, (pixels, value), weights * part)
        np.add.at(right, value, weights * part * log_exposures)
        for other, its in ends:
            np.add.at(normal, (value, other), weights * part * its)
    # the light of each pixel is eliminated: what is left has the size of the curve
    right -= shares.T @ ((weights @ log_exposures) / of_pixel)
    normal -= shares.T @ (shares / of_pixel[:, None])
    normal[VALUES // 2, VALUES // 2] += 1.0
    curvature = np.zeros((VALUES - 2, VALUES))
    k, steps = np.arange(VALUES - 2), np.diff(np.arange(VALUES) if x is None else x)
    mean = 0.5 * (steps[1:] + steps[:-1])
    curvature[k, k], curvature[k, k + 2] = mean / steps[:-1], mean / steps[1:]
    curvature[k, k + 1] = -curvature.sum(axis=1)
    inner = hat(np.linspace(0.0, 1.0, VALUES))[1:-1, None] ** 2
    normal += smoothness**2 * curvature.T @ (inner * curvature)
    return np.asarray(np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ right)


def curve(frames: Sequence[Array], exposures_s: Floats, groups: int = 200) -> tuple[Floats, Floats]:
    """`camera.response` from frames of one still scene: 256 linear values [DN] that grow from 0 to 255.

    A pixel's noise would bend the curve, so pixels of about one brightness are averaged, in `groups`.

    Returns
    -------
    curve
        The linear values.
    covariance
        Of the coefficients of `camera.nonlinearity`, which a curve leaves at 0: how its shape changes where a
        frame of the bracket is left out (jackknife). Shape (2, 2).

    Raises
    ------
    DataError
        There are fewer than three exposures, or the frames do not reach from dark to bright, or do not get brighter
        with the exposure.
    """
    if len(set(exposures_s)) < FEWEST_EXPOSURES:
        raise DataError(
            f"a response curve needs frames of {FEWEST_EXPOSURES} exposures of one still scene, better 15; there are "
            f"{len(set(exposures_s))}"
        )
    order = np.argsort(exposures_s)
    stack = np.stack([np.asarray(frames[k]).ravel() for k in order], axis=1).astype(int)
    times = np.asarray(exposures_s, dtype=float)[order]
    levels = stack.mean(axis=0)
    if np.any(np.diff([levels[times == time].mean() for time in np.unique(times)]) < -1.0):  # pairs: the lamp is noisy
        raise DataError("frames of a longer exposure are darker: did the lamp or the automatic exposure change?")
    seen = np.unique(stack)
    if seen.min() > 0.1 * VALUES or seen.max() < 0.9 * VALUES:
        raise DataError(
            f"the frames hold values from {seen.min()} to {seen.max()}; a response curve needs them from near 0 "
            f"to near "
            "255: take shorter and longer exposures"
        )
    alike = np.array_split(np.argsort(stack.sum(axis=1), kind="stable"), min(groups, len(stack)))
    means = np.stack([stack[pixels].mean(axis=0) for pixels in alike])
    found = _grown(means, times)
    weight, s = hat(np.linspace(0.0, 1.0, VALUES))[1:, None], found[1:] / 255.0
    terms, bends = weight * np.stack([s**0, s, s**2], axis=1), []
    for k in range(len(times)):
        ratio = _grown(np.delete(means, k, axis=1), np.delete(times, k))[1:] / found[1:]
        bends.append(np.linalg.lstsq(terms, weight[:, 0] * ratio, rcond=None)[0][1:])
    off = np.array(bends) - np.mean(bends, axis=0)
    return found, np.asarray((len(times) - 1) / len(times) * off.T @ off)


def _grown(means: Floats, times: Floats) -> Floats:
    """Linear values by the groups' means at some exposures."""
    # a power of the value, and a linear camera, are straight over the logarithm of the value
    light = np.exp(solve(means, np.log(times), SMOOTHNESS_OF_MEANS, np.log1p(np.arange(VALUES))))
    first, last = np.flatnonzero(hat(np.linspace(0.0, 1.0, VALUES)) > 0)[[0, -1]]
    # the weights leave the ends undetermined: black is no light, and the top goes on as the curve does
    light[:first] = light[first] * np.arange(first) / first
    light[last + 1 :] = light[last] + (light[last] - light[last - 1]) * np.arange(1, VALUES - last)
    light /= light[-1]
    return np.asarray(np.maximum.accumulate(light + 1e-9 * np.arange(VALUES)) / (1.0 + 1e-9 * (VALUES - 1)) * 255.0)
