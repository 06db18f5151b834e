"""How steep a measured lobe is in any direction of the angles, from whatever points there are.

The logarithm of f is taken for a Gaussian process (Rasmussen and Williams 2006, chapters 2, 4 and 5) over what surfaces
of facets depend on: theta_h of the half vector, theta_d between it and either direction, and the cosines of both
angles. In theta_h it is even, as a lobe round in half vectors is. Its covariance is that of

    c + p(theta_h) + q(theta_h, cos theta_d, cos theta_i - cos theta_r) + r(theta_h) (ln cos theta_i, ln cos theta_r)

and, where the values say that the sample has a direction, of A(theta_h) cos 2 phi_h + B(theta_h) sin 2 phi_h, in which
phi_h is the half vector's azimuth on the sample. Sizes and lengths of these are learned from the values by their
likelihood; where that leaves them open, slopes are averages over what it allows. The slopes' covariance holds both. So
many points on a lobe tell it closely, and with few points what is stated goes over into how steep lobes usually are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial import cKDTree
from scipy.special import ndtri

from gonio.typing import Floats

USUAL = np.log([1.0, 0.3, 0.3, 0.35, 0.5, 0.5, 0.3])
"""Where the logarithms of p, q and r, of the lengths in theta_h, cos theta_d and the cosines' difference, and of A and B
lie before anything is measured: standard deviations of ln f, and radians or parts of 1."""
SPREAD = np.array([1.0, 1.0, 1.0, 0.6, 0.6, 0.6, 1.0])
"""Their standard deviations."""
OFFSET = 100.0
"""Variance of c: the level is not known before."""
FAINTEST = 3e-4
"""Relative standard uncertainty of a value at least: readings of the angles scatter values, too."""
STEP = 1e-3
"""Of the differences that stand for slopes [rad]."""
BEND = math.radians(0.5)
"""Of those for curvatures [rad]."""
ALLOWED = 15
"""Further sets of sizes and lengths that slopes are averaged over."""
EXACT = 128
"""With more points than this, so many teach the sizes and lengths, and each slope is told by `NEAREST` and `APART`."""
NEAREST, APART = 48, 32
AT_ONCE = 128
"""Points whose slopes are computed together: a few megabytes."""
DIRECTED = 6.0
"""A sample has a direction where that raises the logarithm of the likelihood by more."""
LOWEST = 0.02
"""Cosines below this are taken for it: logarithms have no end there."""


@dataclass(frozen=True, slots=True)
class _Pairs:
    """What the covariance of two sets of points depends on, for each pair."""

    less: Floats
    """Difference of theta_h."""
    more: Floats
    """Sum of theta_h."""
    difference: Floats
    """Difference of cos theta_d."""
    cosines: Floats
    """Difference of cos theta_i - cos theta_r."""
    grazing: Floats
    turned: Floats
    """Of the parts with a direction, without their size and length."""

    @classmethod
    def of(cls, p: Floats, q: Floats) -> _Pairs:
        """Of coordinates (..., 7) that broadcast."""
        return cls(
            abs(p[..., 0] - q[..., 0]),
            p[..., 0] + q[..., 0],
            abs(p[..., 1] - q[..., 1]),
            abs(p[..., 2] - p[..., 3] - q[..., 2] + q[..., 3]),
            np.log(p[..., 2]) * np.log(q[..., 2]) + np.log(p[..., 3]) * np.log(q[..., 3]),
            p[..., 4] * q[..., 4] * np.cos(2.0 * (p[..., 5] - q[..., 5])),
        )

    def covariance(self, logs: Floats) -> tuple[Floats, list[Floats]]:
        """Of ln f, and its derivatives by the logarithms of sizes and lengths."""
        p, q, r, in_half, in_difference, in_cosines, *turned = np.exp(logs).tolist()
        less, by_less = _smooth(self.less / in_half)
        more, by_more = _smooth(self.more / in_half)
        difference, by_difference = _kinked(self.difference / in_difference)
        cosines, by_cosines = _kinked(self.cosines / in_cosines)
        even, departs = less + more, q * q * difference * cosines
        mixed = p * p + departs + r * r * self.grazing
        out = OFFSET + even * mixed + r * r * self.grazing
        by = [
            2.0 * p * p * even,
            2.0 * even * departs,
            2.0 * r * r * (1.0 + even) * self.grazing,
            (by_less + by_more) * mixed,
            even * q * q * by_difference * cosines,
            even * q * q * difference * by_cosines,
        ]
        if turned:
            own = turned[0] ** 2 * self.turned
            out = out + own * less
            by[3] = by[3] + own * by_less
            by.append(2.0 * own * less)
        return out, by


def _smooth(x: Floats) -> tuple[Floats, Floats]:
    """Matern's covariance of 5/2 at a distance over its length, and its derivative by the logarithm of the length."""
    x = math.sqrt(5.0) * x
    falls = np.exp(-x)
    return (1.0 + x + x * x / 3.0) * falls, x * x * (1.0 + x) / 3.0 * falls


def _kinked(x: Floats) -> tuple[Floats, Floats]:
    """The same of 3/2: shadowing sets in with a kink."""
    x = math.sqrt(3.0) * x
    falls = np.exp(-x)
    return (1.0 + x) * falls, x * x * falls


def coordinates(places: Floats) -> Floats:
    """(theta_h, cos theta_d, cos theta_i, cos theta_r, sin^2 theta_h, phi_h) of places (x, y, theta_i, turn) [rad].

    Places are those of `angle_sensitivity.from_above`, with the azimuth of the plane of incidence on the sample.
    """
    x, y, theta_i, turn = np.moveaxis(places, -1, 0)
    theta_r = np.hypot(x, y)
    over = np.sinc(theta_r / math.pi)
    half_x, half_y, half_z = x * over - np.sin(theta_i), y * over, np.cos(theta_r) + np.cos(theta_i)
    across = np.hypot(half_x, half_y)
    theta_h = np.arctan2(across, half_z)
    return np.stack(
        [
            theta_h,
            0.5 * np.hypot(across, half_z),
            np.maximum(np.cos(theta_i), LOWEST),
            np.maximum(np.cos(theta_r), LOWEST),
            np.sin(theta_h) ** 2,
            np.arctan2(half_y, half_x) + turn,
        ],
        axis=-1,
    )


class Surface:
    """The logarithm of a lobe over all directions.

    Parameters
    ----------
    places : (n, 4) array [rad]
        Where it was measured: x, y and theta_i (`angle_sensitivity.from_above`), and the azimuth of incidence.
    log : (n,) array
        Its values there.
    u : (n,) array
        Their independent standard uncertainties.
    """

    def __init__(self, places: Floats, log: Floats, u: Floats) -> None:
        self._at, self._level = coordinates(places), float(np.mean(log))
        self._log, self._variance = log - self._level, u**2 + FAINTEST**2
        taught = np.arange(log.size) if log.size <= EXACT else self._spread(EXACT)
        self._pairs = _Pairs.of(self._at[taught, None], self._at[taught])
        self._taught = taught
        found, cost = self._learn(USUAL[:6])
        if np.ptp(np.cos(2.0 * self._at[:, 5])) + np.ptp(np.sin(2.0 * self._at[:, 5])) > 1e-3:
            turned, lower = self._learn(np.append(found, USUAL[6]))
            if cost - lower > DIRECTED:
                found = turned
        self._sets, self._weights = self._allowed(found) if log.size <= EXACT else (found[None], np.ones(1))
        if log.size > EXACT:
            self._common = self._spread(APART)
            self._tree = cKDTree(self._scaled(self._at))

    def _spread(self, count: int) -> npt.NDArray[np.intp]:
        """Points of which one half is far apart, and the other as dense as all are."""
        order = np.argsort(self._at[:, 0], kind="stable")
        out = order[np.linspace(0, order.size - 1, count // 2).astype(int)].tolist()
        far = np.full(order.size, np.inf)
        for new in out:
            far = np.minimum(far, np.sum((self._at[:, :4] - self._at[new, :4]) ** 2, axis=1))
        while len(out) < count:
            out.append(int(np.argmax(far)))
            far = np.minimum(far, np.sum((self._at[:, :4] - self._at[out[-1], :4]) ** 2, axis=1))
        return np.unique(np.array(out, dtype=np.intp))

    def _cost(self, logs: Floats) -> tuple[float, Floats]:
        """-ln(likelihood times what is known before), and its derivatives."""
        covariance, by = self._pairs.covariance(logs)
        log, size = self._log[self._taught], logs.size
        away = (logs - USUAL[:size]) / SPREAD[:size]
        try:
            factor = cho_factor(covariance + np.diag(self._variance[self._taught]), lower=True)
        except LinAlgError:
            return 1e300, np.zeros(size)
        inverse = cho_solve(factor, np.eye(log.size))
        solved = inverse @ log
        cost = 0.5 * log @ solved + np.sum(np.log(np.diag(factor[0]))) + 0.5 * away @ away
        rest = inverse - np.outer(solved, solved)
        return float(cost), np.array([0.5 * np.sum(rest * one) for one in by]) + away / SPREAD[:size]

    def _learn(self, start: Floats) -> tuple[Floats, float]:
        """The most probable sizes and lengths, and their cost."""
        around = zip(USUAL - 6.0, USUAL + 5.0, strict=True)
        found = minimize(self._cost, start, jac=True, method="L-BFGS-B", bounds=list(around)[: start.size])
        return found.x, float(found.fun)

    def _allowed(self, found: Floats) -> tuple[Floats, Floats]:
        """Sets of sizes and lengths around the most probable one, and their weights (Laplace, weighed again)."""
        step, size = 0.05, found.size
        bent = np.array([self._cost(found + e)[1] - self._cost(found - e)[1] for e in step * np.eye(size)])
        values, vectors = np.linalg.eigh((bent + bent.T) / (4.0 * step))
        # points spread evenly over a cube (a Kronecker sequence), as normal numbers
        ratio = 2.0
        for _ in range(50):
            ratio = (1.0 + ratio) ** (1.0 / (size + 1))
        even = (0.5 + np.outer(np.arange(1, ALLOWED + 1), ratio ** -np.arange(1.0, size + 1))) % 1.0
        normal = np.vstack([np.zeros(size), ndtri(even)])
        sets = found + (normal / np.sqrt(np.maximum(values, 0.3))) @ vectors.T
        weights = np.array([0.5 * z @ z - self._cost(one)[0] for one, z in zip(sets, normal, strict=True)])
        weights = np.minimum(weights, np.median(weights) + 3.0)
        weights = np.exp(weights - weights.max())
        return sets, weights / weights.sum()

    def _scaled(self, at: Floats) -> Floats:
        """Coordinates in units of their lengths."""
        lengths = np.exp(self._sets[0][3:6])
        return np.asarray(np.stack([at[..., 0], at[..., 1], at[..., 2] - at[..., 3]], axis=-1) / lengths)

    def slopes(self, places: Floats) -> tuple[Floats, Floats, Floats]:
        """Of ln f by x, y, theta_i and the azimuth of incidence, per radian, at places (n, 4).

        Returns
        -------
        slope : (n, 4) array
        covariance : (n, 4, 4) array
        bend : (n, 2) array
            Second derivatives along x and y.
        """
        out = np.zeros((len(places), 4)), np.zeros((len(places), 4, 4)), np.zeros((len(places), 2))
        for start in range(0, len(places), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            for whole, part in zip(out, self._slopes(places[some]), strict=True):
                whole[some] = part
        return out

    def _slopes(self, places: Floats) -> tuple[Floats, Floats, Floats]:
        step, bend = STEP * np.eye(4), BEND * np.eye(4)[:2]
        moves = np.concatenate([step, -step, bend, -bend, np.zeros((1, 4))])
        at = coordinates(places[:, None] + moves)
        first = np.concatenate([np.eye(4), -np.eye(4), np.zeros((5, 4))]).T / (2.0 * STEP)
        second = np.concatenate([np.zeros((8, 2)), np.eye(2), np.eye(2), np.full((1, 2), -2.0)]).T / BEND**2
        used, variance = self._telling(at[:, -1])
        known, log = self._at[used], self._log[used]
        among, toward = _Pairs.of(known[:, :, None], known[:, None]), _Pairs.of(at[:, :, None], known[:, None])
        own, diagonal = _Pairs.of(at[:, :8, None], at[:, None, :8]), np.arange(used.shape[1])
        means, covariances, bends = [], [], []
        for logs in self._sets:
            covariance, cross = among.covariance(logs)[0], toward.covariance(logs)[0]
            covariance[:, diagonal, diagonal] += variance
            rows = np.concatenate([first @ cross, second @ cross], axis=1)
            # rows times the inverse; one factor for all places where the same points tell all of them
            solved = np.linalg.solve(covariance, np.swapaxes(rows if len(used) > 1 else _flat(rows), 1, 2))
            solved = np.swapaxes(solved, 1, 2).reshape(rows.shape)
            mean = np.sum(solved * log[:, None], axis=2)
            means.append(mean[:, :4])
            bends.append(mean[:, 4:])
            prior = first[:, :8] @ own.covariance(logs)[0] @ first[:, :8].T
            covariances.append(prior - rows[:, :4] @ np.swapaxes(solved[:, :4], 1, 2))
        mean = np.einsum("s,sni->ni", self._weights, np.array(means))
        off = np.array(means) - mean
        covariance = np.einsum("s,snij->nij", self._weights, np.array(covariances))
        covariance += np.einsum("s,sni,snj->nij", self._weights, off, off)
        return mean, covariance, np.einsum("s,sni->ni", self._weights, np.array(bends))

    def _telling(self, at: Floats) -> tuple[npt.NDArray[np.intp], Floats]:
        """The points that tell the slopes at some coordinates, a row for each or one for all, and their variances."""
        if self._log.size <= EXACT:
            used = np.arange(self._log.size)[None]
            return used, self._variance[used]
        near = self._tree.query(self._scaled(at), k=NEAREST)[1]
        twice = (near[:, :, None] == self._common).any(axis=1)
        used = np.concatenate([near, np.broadcast_to(self._common, twice.shape)], axis=1)
        variance = self._variance[used]
        variance[:, NEAREST:][twice] = 1e6 * OFFSET  # a point counts once
        return used, variance


def _flat(rows: Floats) -> Floats:
    """The rows of all places as those of one."""
    return rows.reshape(1, -1, rows.shape[2])
