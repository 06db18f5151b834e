"""Nonlinearity of a camera from flat frames at several exposures, whatever the lamp does meanwhile.

Every flat holds parts of different brightness (white reference, holder, vignetted corners). The lamp changes all of
them by one factor; a bent curve does not. So each frame j has a factor of its own, each part b a brightness, and

    ln y_bj = ln rho_b + ln t_j + l_j + ln(1 + c[0] s + c[1] s^2 + ...),   s = x_bj / the highest value

is fitted by least squares. The factors l_j lie around a straight line over time (drift) with a scatter (noise of the
lamp) that the fit estimates too. Frames of one brightness alone then still tell c, as well as the lamp is steady.
"""

import math
from dataclasses import dataclass

import numpy as np

from gonio.errors import DataError
from gonio.rig.light_and_camera import Camera
from gonio.rig.sensor_response import bent, straightened
from gonio.typing import Floats

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
