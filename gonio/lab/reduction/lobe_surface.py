"""How steep a measured lobe is in any direction of the angles, from whatever points there are.

The logarithm of f is taken for a Gaussian process (Rasmussen and Williams 2006, chapters 2, 4 and 5) over what surfaces
of facets depend on: theta_h of the half vector, theta_d between it and either direction, and the cosines of both
angles. In theta_h it is even, as a lobe round in half vectors is. Its covariance is that of

    c + p(theta_h) + q(theta_h, cos theta_d, cos theta_i - cos theta_r) + r(theta_h) (ln cos theta_i, ln cos theta_r)

and, where the values say that the sample has a direction, of a function of all these that is the same after half a turn
of phi_h, the half vector's azimuth on the sample, and vanishes with sin^2 theta_h. Sizes and lengths are learned from
the values by their likelihood. Slopes are averages over what that allows, and their covariance holds both. So many
points on a lobe tell it closely; with few points what is stated goes over into how steep lobes usually are.
"""

import math

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_triangular
from scipy.spatial import cKDTree
from scipy.special import ndtri

from gonio.typing import Floats, Ints

USUAL = np.log([1.0, 0.3, 0.7, 0.35, 0.8, 0.8, 5e-4, 0.3])
"""Where the logarithms of sizes and lengths lie before anything is measured: of p, q and r [standard deviations of
ln f], of the lengths in theta_h [rad], cos theta_d and the cosines' difference, of what readings of the angles scatter
values by, and of the part with a direction."""
SPREAD = np.array([1.0, 0.8, 1.0, 0.6, 0.4, 0.4, 1.0, 1.0])
"""Their standard deviations."""
OFFSET = 25.0
"""Variance of c: the level is not known before."""
ROUNDING = 1e-8
"""Variance of ln f at least: matrices of values that are all but alike have no factor below that."""
STEP = 1e-4
"""Step of the differences that tell how theta_h and the others follow x, y and theta_i [rad]."""
BEND = math.radians(0.5)
"""Step of the differences for curvatures of ln f [rad]."""
ALLOWED = 7
"""Further sets of sizes and lengths that slopes are averaged over."""
EXACT = 128
"""Points from which sizes and lengths are learned, at most; and points that tell the slopes of one place, at most."""
TOGETHER, APART = 48, 32
"""Where there are more: places whose slopes are computed together, and how many points far from them are asked."""
DIRECTED = 6.0
"""A sample has a direction where that raises the logarithm of the likelihood by more."""
LOWEST = 0.02
"""Cosines below this are taken for it: logarithms have no end there."""
SCATTER, DIRECTION = 6, 7
"""Indices among the sizes and lengths: the scatter of readings, and the part with a direction."""
HALF, DIFFERENCE, SOURCE, DETECTOR, TILTED, TURNED = range(6)
"""Coordinates: theta_h, cos theta_d, cos theta_i, cos theta_r, sin^2 theta_h, and the half vector's azimuth."""


class _Covariance:
    """The covariance of ln f between two sets of coordinates (..., 6) that broadcast, with its derivatives."""

    def __init__(self, p: Floats, q: Floats) -> None:
        at, to = np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)
        self._less, self._more = at[HALF] - to[HALF], at[HALF] + to[HALF]
        self._difference = at[DIFFERENCE] - to[DIFFERENCE]
        self._cosines = at[SOURCE] - at[DETECTOR] - to[SOURCE] + to[DETECTOR]
        self._logs = np.log(to[SOURCE]), np.log(to[DETECTOR])
        self._grazing = np.log(at[SOURCE]) * self._logs[0] + np.log(at[DETECTOR]) * self._logs[1]
        self._at, self._to = at, to

    def of(self, logs: Floats) -> Floats:
        """Itself, for the logarithms of sizes and lengths; what its derivatives are made of is kept."""
        self._p, self._q, self._r, *lengths = np.exp(logs[:6]).tolist()
        less, self._by_less = _smooth(self._less, lengths[0])
        more, self._by_more = _smooth(self._more, lengths[0])
        self._d, self._by_difference = _kinked(self._difference, lengths[1])
        self._w, self._by_cosines = _kinked(self._cosines, lengths[2])
        self._even = less + more
        self._mixed = self._p**2 + self._q**2 * self._d * self._w + self._r**2 * self._grazing
        out = OFFSET + self._even * self._mixed + self._r**2 * self._grazing
        self._size = float(np.exp(logs[DIRECTION])) ** 2 if logs.size > DIRECTION else 0.0
        if self._size:
            turn = 2.0 * (self._at[TURNED] - self._to[TURNED])
            self._less_value, self._round = less, 0.5 * np.cos(turn) * (1.0 + np.cos(turn))
            self._by_turn = -np.sin(turn) * (1.0 + 2.0 * np.cos(turn))
            self._tilted = self._size * self._at[TILTED] * self._to[TILTED]
            out = out + self._tilted * self._round * less * self._d * self._w
        return np.asarray(out)

    def by_logs(self) -> list[Floats]:
        """Its derivatives by the logarithms of sizes and lengths."""
        departs = self._q**2 * self._even
        out = [
            2.0 * self._p**2 * self._even,
            2.0 * departs * self._d * self._w,
            2.0 * self._r**2 * (1.0 + self._even) * self._grazing,
            -(self._by_less * self._less**2 + self._by_more * self._more**2) * self._mixed,
            -departs * self._by_difference * self._difference**2 * self._w,
            -departs * self._by_cosines * self._cosines**2 * self._d,
            np.zeros_like(self._even),
        ]
        if self._size:
            here = self._tilted * self._round
            out[3] = out[3] - here * self._d * self._w * self._by_less * self._less**2
            out[4] = out[4] - here * self._less_value * self._w * self._by_difference * self._difference**2
            out[5] = out[5] - here * self._less_value * self._d * self._by_cosines * self._cosines**2
            out.append(2.0 * here * self._less_value * self._d * self._w)
        return out

    def by_first(self) -> Floats:
        """Its derivatives by the coordinates of the first set, which come first in the shape."""
        departs, grazing = self._q**2 * self._even, self._r**2 * (1.0 + self._even)
        by_cosines = departs * self._d * self._by_cosines * self._cosines
        out = [
            (self._by_less * self._less + self._by_more * self._more) * self._mixed,
            departs * self._w * self._by_difference * self._difference,
            by_cosines + grazing * self._logs[0] / self._at[SOURCE],
            -by_cosines + grazing * self._logs[1] / self._at[DETECTOR],
        ]
        if self._size:
            here, apart = self._tilted * self._round, self._less_value * self._d * self._w
            by_cosines = here * self._less_value * self._d * self._by_cosines * self._cosines
            out[0] = out[0] + here * self._by_less * self._less * self._d * self._w
            out[1] = out[1] + here * self._less_value * self._w * self._by_difference * self._difference
            out[2], out[3] = out[2] + by_cosines, out[3] - by_cosines
            out += [self._size * self._to[TILTED] * self._round * apart, self._tilted * self._by_turn * apart]
        return np.array(np.broadcast_arrays(*out))


def _of_slopes(at: Floats, logs: Floats) -> Floats:
    """Covariance of the derivatives of ln f by its coordinates at one place, before anything is measured; (n, 6, 6)."""
    p, q, r, in_half, in_difference, in_cosines = np.exp(logs[:6])
    theta_h, _, source, detector, tilted, _ = at.T
    value, falls = _smooth(2.0 * theta_h, in_half)
    x = math.sqrt(5.0) * 2.0 * theta_h / in_half
    steepest, even = 5.0 / (3.0 * in_half**2), 1.0 + value
    by_source, by_detector = np.log(source) / source, np.log(detector) / detector
    mixed = p * p + q * q + r * r * (np.log(source) ** 2 + np.log(detector) ** 2)
    out = np.zeros((len(at), 6, 6))
    out[:, HALF, HALF] = steepest * mixed * (1.0 - (1.0 + x - x * x) * np.exp(-x))
    # the part with a direction, as q, changes with all of them
    turned = float(np.exp(2.0 * logs[DIRECTION])) * tilted**2 if logs.size > DIRECTION else np.zeros(len(at))
    out[:, DIFFERENCE, DIFFERENCE] = (even * q * q + turned) * 3.0 / in_difference**2
    apart = (even * q * q + turned) * 3.0 / in_cosines**2
    out[:, SOURCE, SOURCE] = apart + r * r * (1.0 + even) / source**2
    out[:, DETECTOR, DETECTOR] = apart + r * r * (1.0 + even) / detector**2
    out[:, SOURCE, DETECTOR] = out[:, DETECTOR, SOURCE] = -apart
    for which, by in ((SOURCE, by_source), (DETECTOR, by_detector)):
        out[:, HALF, which] = out[:, which, HALF] = r * r * by * falls * 2.0 * theta_h
    if logs.size > DIRECTION:
        out[:, HALF, HALF] += turned * steepest
        out[:, TILTED, TILTED] = np.exp(2.0 * logs[DIRECTION])
        out[:, TURNED, TURNED] = 6.0 * turned
    return out


def _smooth(distance: Floats, length: float) -> tuple[Floats, Floats]:
    """Matern's covariance of 5/2 over a signed distance, and its derivative over that distance."""
    x = math.sqrt(5.0) / length * np.abs(distance)
    falls = np.exp(-x)
    return (1.0 + x + x * x / 3.0) * falls, -5.0 / (3.0 * length**2) * (1.0 + x) * falls


def _kinked(distance: Floats, length: float) -> tuple[Floats, Floats]:
    """The same for Matern's covariance of order 3/2, which is less smooth: shadowing sets in with a kink."""
    x = math.sqrt(3.0) / length * np.abs(distance)
    falls = np.exp(-x)
    return (1.0 + x) * falls, -3.0 / length**2 * falls


def coordinates(places: Floats) -> Floats:
    """Coordinates (..., 6) of places (x, y, theta_i, turn) [rad].

    Places are those of `angle_sensitivity.from_above`.
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
        self._log, self._variance = log - self._level, u**2 + ROUNDING
        self._few = log.size <= EXACT
        self._taught = np.arange(log.size) if self._few else self._spread(EXACT)
        self._pairs = _Covariance(self._at[self._taught, None], self._at[self._taught])
        found, cost = self._learn(USUAL[:DIRECTION])
        if np.ptp(np.cos(2.0 * self._at[:, TURNED])) + np.ptp(np.sin(2.0 * self._at[:, TURNED])) > 1e-3:
            turned, lower = self._learn(USUAL)
            if cost - lower > DIRECTED:
                found = turned
        self.directed = found.size > DIRECTION
        """Whether the values say that the sample has a direction."""
        self._sets, self._weights = self._allowed(found)
        if not self._few:
            self._common, self._tree = self._spread(APART), cKDTree(self._scaled(self._at))

    def _spread(self, count: int) -> Ints:
        """Points of which one half is far apart, and the other as dense as all are."""
        order = np.argsort(self._at[:, 0], kind="stable")
        out = order[np.linspace(0, order.size - 1, count // 2).astype(int)].tolist()
        far = np.full(order.size, np.inf)
        for k in range(count):
            if k >= len(out):
                out.append(int(np.argmax(far)))
            far = np.minimum(far, np.sum((self._at[:, :4] - self._at[out[k], :4]) ** 2, axis=1))
        return np.unique(np.array(out, dtype=np.intp))

    def _cost(self, logs: Floats) -> tuple[float, Floats]:
        """-ln(likelihood times prior), and its derivatives."""
        covariance = self._pairs.of(logs)
        log, size = self._log[self._taught], logs.size
        away = (logs - USUAL[:size]) / SPREAD[:size]
        try:
            factor = cho_factor(
                covariance + np.diag(self._variance[self._taught] + np.exp(2.0 * logs[SCATTER])), lower=True
            )
        except LinAlgError:
            return 1e300, np.zeros(size)
        inverse = cho_solve(factor, np.eye(log.size))
        solved = inverse @ log
        cost = 0.5 * log @ solved + np.sum(np.log(np.diag(factor[0]))) + 0.5 * away @ away
        rest = inverse - np.outer(solved, solved)
        by = np.array([0.5 * np.sum(rest * one) for one in self._pairs.by_logs()])
        by[SCATTER] = np.trace(rest) * np.exp(2.0 * logs[SCATTER])
        return float(cost), by + away / SPREAD[:size]

    def _learn(self, start: Floats) -> tuple[Floats, float]:
        """The most probable sizes and lengths, and their cost."""
        around = list(zip(USUAL - 6.0, USUAL + 5.0, strict=True))[: start.size]
        from scipy.optimize import minimize  # where a lobe has to be fitted

        found = minimize(self._cost, start, jac=True, method="L-BFGS-B", bounds=around)
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
        curvature : (n, 2) array
            Second derivatives along x and y.
        """
        at, scale = coordinates(places), STEP * np.eye(4)
        by_place = coordinates(places[:, None] + scale) - coordinates(places[:, None] - scale)
        by_place[..., TURNED] = np.remainder(by_place[..., TURNED] + math.pi, 2.0 * math.pi) - math.pi
        by_place = np.swapaxes(by_place, 1, 2) / (2.0 * STEP)
        slope, covariance, curvature = np.zeros((len(at), 4)), np.zeros((len(at), 4, 4)), np.zeros((len(at), 2))
        for some, used in self._blocks(at):
            among = _Covariance(self._at[used, None], self._at[used])
            mean, covariances = self._of_coordinates(at[some], used, among)
            turn = by_place[some, : mean.shape[1]]
            slope[some] = np.einsum("nc,ncx->nx", mean, turn)
            covariance[some] = np.einsum("ncx,ncd,ndy->nxy", turn, covariances, turn)
            curvature[some] = self._curvatures(places[some], used, among)
        return slope, covariance, curvature

    def _blocks(self, at: Floats) -> list[tuple[Ints, Ints]]:
        """Places that are computed together, and the points that tell their slopes."""
        everything = np.arange(self._log.size)
        if self._few:
            return [(some, everything) for some in np.array_split(np.arange(len(at)), math.ceil(len(at) / EXACT))]
        scaled, blocks, out = self._scaled(at), [np.arange(len(at))], []
        while blocks:
            block = blocks.pop()
            if block.size > TOGETHER:
                widest = int(np.argmax(np.ptp(scaled[block], axis=0)))
                order = block[np.argsort(scaled[block, widest], kind="stable")]
                blocks += [order[: order.size // 2], order[order.size // 2 :]]
                continue
            near = self._tree.query(scaled[block].mean(axis=0), k=EXACT - APART)[1]
            out.append((block, np.union1d(near, self._common)))
        return out

    def _factor(self, used: Ints, among: _Covariance, logs: Floats) -> Floats:
        """Cholesky's factor of the covariance of some values, which `among` is without their noise."""
        noise = np.diag(self._variance[used] + np.exp(2.0 * logs[SCATTER]))
        return np.asarray(cho_factor(among.of(logs) + noise, lower=True, overwrite_a=True)[0])

    def _of_coordinates(self, at: Floats, used: Ints, among: _Covariance) -> tuple[Floats, Floats]:
        """Derivatives of ln f by coordinates (n, c), and their covariances."""
        toward = _Covariance(at[:, None], self._at[used])
        means, covariances = [], []
        for logs in self._sets:
            factor = self._factor(used, among, logs)
            toward.of(logs)
            rows = np.moveaxis(toward.by_first(), 0, 1)
            solved = solve_triangular(factor, rows.reshape(-1, used.size).T, lower=True)
            white = solve_triangular(factor, self._log[used], lower=True)
            solved = np.moveaxis(solved.reshape(used.size, *rows.shape[:2]), 0, 2)
            means.append(solved @ white)
            count = rows.shape[1]
            covariances.append(_of_slopes(at, logs)[:, :count, :count] - solved @ np.swapaxes(solved, 1, 2))
        mean = np.einsum("s,snc->nc", self._weights, np.array(means))
        off = np.array(means) - mean
        covariance = np.einsum("s,sncd->ncd", self._weights, np.array(covariances))
        return mean, covariance + np.einsum("s,snc,snd->ncd", self._weights, off, off)

    def _curvatures(self, places: Floats, used: Ints, among: _Covariance) -> Floats:
        """Second derivatives of ln f along x and y, of the most probable set."""
        moves = np.concatenate([BEND * np.eye(4)[:2], -BEND * np.eye(4)[:2], np.zeros((1, 4))])
        solved = cho_solve((self._factor(used, among, self._sets[0]), True), self._log[used])
        toward = _Covariance(coordinates(places[:, None] + moves)[:, :, None], self._at[used])
        values = toward.of(self._sets[0]) @ solved
        return np.asarray((values[:, :2] + values[:, 2:4] - 2.0 * values[:, 4:]) / BEND**2)
