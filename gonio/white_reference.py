"""What the white reference says: its BRDF at the visits, and the signal per unit BRDF at any time in between."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gonio.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

    from gonio.kinematics import Directions

Array = npt.NDArray[np.float64]

PAIR = np.array([-1, 0])
REJECTED = 0.01
"""A straight line whose chi-square is rarer than this does not describe the visits."""
SAME_ANGLE = math.radians(0.5)
"""A visit within this angle of a curve's incidence, and of the plane of incidence, lies on it."""


@dataclass(frozen=True, slots=True)
class Level:
    """The signal per unit BRDF as a function of time, fitted to the visits of one band.

    Where the visits lie on a straight line within their noise, K(t) = level + slope (t - centre), whose two
    parameters are uncorrelated; `departure` and `extra` are zero. Otherwise K is interpolated linearly between the
    visits (and constant beyond the first and the last): `departure` is half of the difference between that and the
    line, `extra` what the noise of the nearest visits adds to the noise of the mean level.
    """

    centre_s: float
    level: float
    u_level: float
    slope: float
    u_slope: float
    straight: bool
    chi_square: float
    times_s: Array
    values: Array
    variances: Array

    def at(self, time_s: Array) -> Array:
        """K at given times."""
        return self._line(time_s) if self.straight else np.interp(time_s, self.times_s, self.values)

    def noise(self, time_s: Array) -> Array:
        """Change of K for one standard deviation of the mean level."""
        return np.full(np.shape(time_s), self.u_level)

    def drift(self, time_s: Array) -> Array:
        """Change of K for one standard deviation of the drift."""
        if self.straight:
            return self.u_slope * (time_s - self.centre_s)
        return 0.5 * (self._line(time_s) - self.at(time_s))

    def extra(self, time_s: Array) -> Array:
        """Standard deviation of K from single visits, beyond that of the mean level."""
        if self.straight:
            return np.zeros(np.shape(time_s))
        share = np.stack([np.interp(time_s, self.times_s, row) for row in np.eye(len(self.times_s))])
        return np.asarray(np.sqrt(np.maximum(np.einsum("vt,v->t", share**2, self.variances) - self.u_level**2, 0.0)))

    def _line(self, time_s: Array) -> Array:
        return self.level + self.slope * (time_s - self.centre_s)


def fit(times_s: Array, values: Array, variances: Array) -> Level:
    """Fit the level of the visits by weighted least squares; see `Level`.

    One visit gives a constant level without any knowledge of drift; two give a line without a test of it.

    Parameters
    ----------
    times_s, values, variances : (n,) arrays, n >= 1
        Of each visit: when it was [s], the signal per unit BRDF [e- sr/s], and that signal's variance.
    """
    order = np.argsort(times_s)
    times_s, values, variances = times_s[order], values[order], variances[order]
    weights = 1.0 / variances
    centre = float(np.average(times_s, weights=weights))
    level, u_level = float(np.average(values, weights=weights)), float(weights.sum() ** -0.5)
    spread = float(np.sum(weights * (times_s - centre) ** 2))
    slope, u_slope, chi_square, straight = 0.0, 0.0, 0.0, True
    if spread > 0:
        slope, u_slope = float(np.sum(weights * (times_s - centre) * (values - level)) / spread), spread**-0.5
    if len(values) > 2:
        from scipy.special import chdtrc  # of chi-square, beyond

        chi_square = float(np.sum(weights * (values - level - slope * (times_s - centre)) ** 2))
        straight = bool(chdtrc(len(values) - 2, chi_square) >= REJECTED)
    return Level(centre, level, u_level, slope, u_slope, straight, chi_square, times_s, values, variances)


def brdf_of_table(table: pd.DataFrame, directions: Directions, wavelength_nm: float) -> float:
    """BRDF [1/sr] of a reference in one visit's geometry, from a table of its BRDF.

    Linear in the signed angle of reflection on the curve of the table that has the visit's angle of incidence
    (within 0.5 degrees) or between the two curves around it, and linear in wavelength. The reference is taken for
    isotropic; only rows without a flag, in the plane of incidence and unpolarised count.

    Raises
    ------
    DataError
        The visit lies outside of the angles or wavelengths of the table, or out of the plane of incidence.
    """
    source = table.attrs.get("source_file") or "the table of the white reference"
    dphi = math.remainder(directions.phi_r - directions.phi_i, 2 * math.pi)
    if min(directions.theta_i, directions.theta_r, abs(dphi), math.pi - abs(dphi)) > SAME_ANGLE:
        raise DataError(f"{source}: holds curves in the plane of incidence; the visit to the reference lies out of it")
    signed = directions.theta_r * (1.0 if abs(dphi) > math.pi / 2 else -1.0)
    if directions.theta_i < SAME_ANGLE:
        signed = abs(signed)
    rows = table[table["flag"] == ""]
    polarised = rows["polarisation"] != "unpolarised"
    if polarised.any():
        raise DataError(f"{source}: a table of a white reference must be unpolarised")
    theta_i, theta_r = np.radians(rows["theta_i_deg"].to_numpy()), np.radians(rows["theta_r_deg"].to_numpy())
    turn = np.remainder(np.radians((rows["phi_r_deg"] - rows["phi_i_deg"]).to_numpy()) + np.pi, 2 * np.pi) - np.pi
    off = np.minimum(abs(turn), np.pi - abs(turn))
    in_plane = (off <= SAME_ANGLE) | (theta_r < SAME_ANGLE) | (theta_i < SAME_ANGLE)
    angle = np.where((abs(turn) > np.pi / 2) | (theta_i < SAME_ANGLE), theta_r, -theta_r)
    wavelengths, values = rows["wavelength_nm"].to_numpy(), rows["brdf"].to_numpy()

    def curve(incidence: float, wavelength: float) -> float:
        on = in_plane & (abs(theta_i - incidence) < 1e-6) & ((wavelengths == wavelength) | np.isnan(wavelengths))
        what = f"theta_r = {math.degrees(signed):g} deg at theta_i = {math.degrees(incidence):g} deg"
        return _interpolate(signed, angle[on], values[on], what, source)

    def spectrum(wavelength: float) -> float:
        known = np.unique(theta_i[in_plane])
        near = known[abs(known - directions.theta_i) <= SAME_ANGLE]
        if near.size:
            return curve(float(near[np.argmin(abs(near - directions.theta_i))]), wavelength)
        around = known[np.unique(np.clip(np.searchsorted(known, directions.theta_i) + PAIR, 0, known.size - 1))]
        what = f"theta_i = {math.degrees(directions.theta_i):g} deg"
        return _interpolate(
            directions.theta_i, around, np.array([curve(float(a), wavelength) for a in around]), what, source
        )

    known = np.unique(wavelengths[np.isfinite(wavelengths)])
    if known.size == 0:  # one broad band
        return spectrum(math.nan)
    around = known[np.unique(np.clip(np.searchsorted(known, wavelength_nm) + PAIR, 0, known.size - 1))]
    if wavelength_nm in known:
        around = np.array([wavelength_nm])
    what = f"wavelength_nm = {wavelength_nm:g}"
    return _interpolate(wavelength_nm, around, np.array([spectrum(float(w)) for w in around]), what, source)


def _interpolate(x: float, at: Array, values: Array, what: str, source: str) -> float:
    order = np.argsort(at)
    at, values = at[order], values[order]
    if at.size == 0 or not at[0] - SAME_ANGLE <= x <= at[-1] + SAME_ANGLE:
        raise DataError(f"{source}: the visit to the reference at {what} lies outside of this table")
    return float(np.interp(x, at, values))
