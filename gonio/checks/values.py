"""The values of one wavelength that checks are about, with their covariance in factors."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gonio.geometry import SAME_ANGLE, SAME_AZIMUTH, Directions, wrap
from gonio.typing import Bools, DataFrame, Floats, Ints

Rows = Ints

NORMAL_95 = 1.959964
"""Standard deviations of a normal number's 95 % interval."""
SIGNIFICANCE = 0.01
"""A chi-square that is rarer than this rejects what it was computed for."""
CLIPPED = 1e-3
"""Part of the pixels of dark frames that read 0 DN, beyond which their noise is cut off there."""


@dataclass(frozen=True)
class CheckedValues:
    """Values of a table; their covariance is diag(random^2) + common common^T."""

    directions: Directions
    brdf: Floats
    """[1/sr]"""
    random: Floats | None = None
    """Standard uncertainty [1/sr] of what is independent from value to value; None where the table states none."""
    common: Floats | None = None
    """Signed change of each value [1/sr] by one standard deviation of each common cause, shape (values, causes)."""

    def __len__(self) -> int:
        return int(self.brdf.size)

    @property
    def u(self) -> Floats:
        """Combined standard uncertainty [1/sr]; NaN where none is stated."""
        if self.random is None:
            return np.full(len(self), np.nan)
        return np.asarray(np.sqrt(self.random**2 + (self._common**2).sum(axis=1)))

    @property
    def _common(self) -> Floats:
        return np.zeros((len(self), 0)) if self.common is None else self.common

    def take(self, rows: Rows | Bools) -> "CheckedValues":
        """Some of them."""
        random, common = (None if a is None else a[rows] for a in (self.random, self.common))
        return CheckedValues(self.directions[rows], self.brdf[rows], random, common)

    def chi_square(self, pairs: Rows) -> float:
        """Chi-square of ln(f_j / f_i) over pairs (i, j), shape (n, 2), with the whole covariance of the values.

        What is common to both values of a pair cancels, and what is common to several pairs counts once. A value that
        stands in several pairs counts as often: `freedom`.
        """
        assert self.random is not None, "without uncertainties there is no chi-square"
        i, j = pairs.T
        logs = np.log(self.brdf[j] / self.brdf[i])
        size = np.hypot(self.random[i] / self.brdf[i], self.random[j] / self.brdf[j])
        # a column goes with the measured values, noise and all, or with the true ones: the noise that is left of the
        # wrong one would take the differences for itself
        by_each = (self._common[j] / self.brdf[j, None] - self._common[i] / self.brdf[i, None]) / size[:, None]
        by_both = (self._common[j] - self._common[i]) * (2.0 / (self.brdf[i] + self.brdf[j]) / size)[:, None]
        shape = np.where((by_each**2).sum(axis=0) < (by_both**2).sum(axis=0), by_each, by_both)
        scaled = logs / size
        # Woodbury: (1 + T T^T)^-1 = 1 - T (1 + T^T T)^-1 T^T
        along = shape.T @ scaled
        inner = np.eye(shape.shape[1]) + shape.T @ shape
        return max(float(scaled @ scaled - along @ np.linalg.solve(inner, along)), 0.0)

    def freedom(self, pairs: Rows) -> float:
        """Of the chi-square of these pairs: n^2 over the sum of the squared correlations between n differences."""
        assert self.random is not None
        variance = (self.random[pairs] / self.brdf[pairs]) ** 2
        share, n = variance / variance.sum(axis=1, keepdims=True), len(pairs)
        in_all, alone = (np.bincount(pairs.ravel(), each.ravel()) for each in (share, share**2))
        return n**2 / (n + float(np.sum(in_all**2 - alone)))


def values_of(frame: DataFrame) -> dict[float, CheckedValues]:
    """The usable values of reflection of a measurement table, by wavelength [nm]; NaN stands for a broad band."""
    use = (frame["flag"].fillna("") == "") & frame["brdf"].notna()
    if "side" in frame.columns:
        use &= frame["side"] == "reflection"
    usable = frame[use]
    causes = [name for name in usable.columns if name.startswith("s_")]
    out = {}
    for nm, rows in usable.groupby("wavelength_nm", dropna=False, sort=True):
        random, common = None, None
        if "u_random" in rows.columns and bool((rows["u_random"] > 0).all()):
            random = rows["u_random"].to_numpy(dtype=float)
            common = rows[causes].fillna(0.0).to_numpy(dtype=float)
        out[float(str(nm))] = CheckedValues(
            Directions.from_table(rows), rows["brdf"].to_numpy(dtype=float), random, common
        )
    return out


@dataclass(frozen=True)
class Incidence:
    """One direction of the source, and the values measured at it."""

    theta_i: float
    phi_i: float
    rows: Rows


def incidences(at: Directions) -> list[Incidence]:
    """The directions of the source: angles of incidence within 0.4 degrees and azimuths within 2 are one."""
    theta, phi = at.theta_i, wrap(np.asarray(at.phi_i))
    out = []
    order = np.argsort(theta, kind="stable")
    for ring in np.split(order, np.flatnonzero(np.diff(theta[order]) > SAME_ANGLE) + 1):
        if not ring.size:
            continue
        if theta[ring].mean() < SAME_ANGLE:
            out.append(Incidence(float(theta[ring].mean()), 0.0, ring))
            continue
        # azimuths are counted from the widest gap between them: readbacks scatter on both sides of 0
        order_phi = np.sort(phi[ring])
        gaps = np.diff(order_phi, append=order_phi[0] + 2.0 * math.pi)
        begin = float(order_phi[(int(np.argmax(gaps)) + 1) % ring.size])
        away = wrap(phi - begin)
        turned = ring[np.argsort(away[ring], kind="stable")]
        for group in np.split(turned, np.flatnonzero(np.diff(away[turned]) > SAME_AZIMUTH) + 1):
            mean = float(wrap(begin + away[group].mean()))
            out.append(Incidence(float(theta[group].mean()), mean, group))
    return out


def apart(angles: list[float]) -> list[float]:
    """Those of ascending angles [rad] that differ from the one before by more than `SAME_ANGLE`."""
    return angles[:1] + [b for a, b in pairwise(angles) if b - a > SAME_ANGLE]
