"""One value, or one shape, from several laboratories: consensus, dark uncertainty, consistent subsets.

Everything takes the laboratories' values x and their covariance V, which need not be diagonal: causes that two of them
share stand outside the diagonal. With independent laboratories the formulas are those of the literature: DerSimonian
and Laird (Control. Clin. Trials 7, 177, 1986), Mandel and Paule (J. Res. NBS 87, 377, 1982), REML (Searle et al.,
Variance Components, ch. 6), and the largest consistent subset of Cox (Metrologia 44, 187, 2007).

A scale, a zero and a scatter of each laboratory are taken about one shape that they make together: weighted least
squares of each laboratory's values by the shape and by its slope over the angle of the receiver; with weights that go
with the shape, and with its scatter where that is larger than it states. docs/laboratories.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt

from gonio.checks.values import Rows
from gonio.errors import ArgumentError
from gonio.typing import Floats
from gonio_analysis.changes.resampling import slope_in_plane
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import Covariance

Method = Literal["weighted", "dersimonian-laird", "mandel-paule", "reml"]
METHODS: tuple[Method, ...] = get_args(Method)
EVERY_SUBSET = 14
"""With more laboratories than this, the one that fits worst is taken away until the rest agree."""


class Consensus(NamedTuple):
    """A consensus value, its standard uncertainty, and the dark uncertainty of each laboratory, in the values' unit."""

    value: float
    u: float
    tau: float


@dataclass(frozen=True)
class Equivalence:
    """A reference value, and how far each laboratory is from it."""

    reference: Consensus
    method: Method
    consistent: npt.NDArray[np.bool_]
    """(K,) which laboratories belong to the largest consistent subset."""
    degrees: Floats
    """(K,) x_k - x_ref."""
    u: Floats
    """(K,) their standard uncertainties."""

    @property
    def e_n(self) -> Floats:
        """(K,) d_k / (2 u(d_k))."""
        return self.degrees / (2.0 * self.u)

    @property
    def relative(self) -> Equivalence:
        """The same over the reference value."""
        by = self.reference.value
        reference = Consensus(*(part / by for part in self.reference))
        return Equivalence(reference, self.method, self.consistent, self.degrees / by, self.u / by)


def consensus(values: npt.ArrayLike, u: npt.ArrayLike, method: Method = "weighted") -> Consensus:
    """The consensus of several laboratories.

    Parameters
    ----------
    values : (K,) array
        One a laboratory.
    u : (K,) or (K, K) array
        Standard uncertainties, above 0, or the covariance.
    method
        "weighted" (no dark uncertainty), "dersimonian-laird", "mandel-paule" or "reml".

    Returns
    -------
    Consensus
        Value, standard uncertainty, and tau.

    Raises
    ------
    ArgumentError
        Shapes that do not fit, values that are not finite, an uncertainty that is not above 0, an unknown method.

    Examples
    --------
    >>> from gonio_analysis import consensus
    >>> found = consensus([0.98, 1.00, 1.05], [0.01, 0.01, 0.01], method="mandel-paule")
    >>> [round(float(x), 3) for x in (found.value, found.u, found.tau)]
    [1.01, 0.021, 0.035]
    """
    x, v = _checked(values, u)
    if method not in METHODS:
        raise ArgumentError(f'method = "{method}": one of {", ".join(METHODS)} is needed')
    tau = _TAU[method](x, v)
    mean, variance, _ = _mean(x, v + tau**2 * np.eye(x.size))
    return Consensus(mean, float(np.sqrt(variance)), tau)


def consistency(values: npt.ArrayLike, u: npt.ArrayLike) -> tuple[float, float]:
    """Chi-square of the weighted mean, and its probability by chance; arguments as of `consensus`."""
    x, v = _checked(values, u)
    return _chi_square(x, v), _p(x, v)


def equivalence(values: npt.ArrayLike, u: npt.ArrayLike, level: float) -> Equivalence:
    """The reference value of a comparison, and degrees of equivalence; `docs/laboratories.md` says by which rule.

    Parameters
    ----------
    values, u
        As of `consensus`.
    level
        Probability that somebody is left out of the consistent subset where all are honest.
    """
    x, v = _checked(values, u)
    inside = largest_consistent_subset(x, v, level)
    method: Method = "weighted"
    if 3 * np.count_nonzero(inside) < 2 * x.size:
        method = "mandel-paule"
        tau = _mandel_paule(x, v)
        v = v + tau**2 * np.eye(x.size)
        mean, variance, weights = _mean(x, v)
    else:
        tau = 0.0
        mean, variance, some = _mean(x[inside], v[np.ix_(inside, inside)])
        weights = np.zeros(x.size)
        weights[inside] = some
    apart = np.eye(x.size) - weights[None, :]
    of_degrees = np.einsum("ij,jk,ik->i", apart, v, apart)
    # a laboratory that alone makes the reference is no distance from it, whatever the rounding
    u_degrees = np.sqrt(np.maximum(of_degrees, 1e-24 * np.diag(v)))
    return Equivalence(Consensus(mean, float(np.sqrt(variance)), tau), method, inside, x - mean, u_degrees)


def largest_consistent_subset(values: Floats, covariance: Floats, level: float) -> npt.NDArray[np.bool_]:
    """(K,) which laboratories agree: the most whose chi-square has a probability of at least `level`.

    None where no two agree: nothing says which of them is right.
    """
    everybody = np.ones(values.size, dtype=bool)
    if _p(values, covariance) >= level:
        return everybody
    for size in range(values.size - 1, 1, -1):
        if values.size <= EVERY_SUBSET:
            tried = [np.isin(np.arange(values.size), some) for some in combinations(range(values.size), size)]
        else:
            tried = [everybody & (np.arange(values.size) != k) for k in np.flatnonzero(everybody)]
        found = [_p(values[some], covariance[np.ix_(some, some)]) for some in tried]
        best = int(np.argmax(found))
        if found[best] >= level:
            return tried[best]
        everybody = tried[best]
    return np.zeros(values.size, dtype=bool)


def _checked(values: npt.ArrayLike, u: npt.ArrayLike) -> tuple[Floats, Floats]:
    x, v = np.atleast_1d(np.asarray(values, dtype=np.float64)), np.asarray(u, dtype=np.float64)
    if v.ndim < 2:
        v = np.atleast_1d(v)
        if v.shape != x.shape or not np.all(v > 0.0):
            raise ArgumentError(f"u has shape {v.shape}: {x.shape}, all above 0, or a covariance is needed")
        v = np.diag(v**2)
    if x.ndim != 1 or v.shape != (x.size, x.size) or not (np.isfinite(x).all() and np.isfinite(v).all()):
        raise ArgumentError(f"values have shape {x.shape} and u {v.shape}: (K,) and (K,) or (K, K), finite, are needed")
    if not np.all(np.linalg.eigvalsh(v) > 0.0):
        raise ArgumentError("u: the covariance has to be positive definite")
    return x, v


def _mean(x: Floats, v: Floats) -> tuple[float, float, Floats]:
    """The mean by generalised least squares, its variance, and the weights."""
    weights = np.linalg.inv(v).sum(axis=0)
    total = float(weights.sum())
    return float(weights @ x) / total, 1.0 / total, weights / total


def _contrasts(x: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Variances and values of K - 1 independent differences between the laboratories; tau^2 adds to each variance.

    Chi-square is the sum of values^2 / variances, and the restricted likelihood is the likelihood of these differences.
    """
    k = x.size
    away = np.linalg.qr(np.column_stack([np.ones(k), np.eye(k)[:, 1:]]))[0][:, 1:]
    variances, axes = np.linalg.eigh(away.T @ v @ away)
    return np.asarray(variances), np.asarray(axes.T @ (away.T @ x))


def _chi_square(x: Floats, v: Floats) -> float:
    variances, differences = _contrasts(x, v)
    return float(np.sum(differences**2 / variances))


def _p(x: Floats, v: Floats) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(x.size - 1, _chi_square(x, v))) if x.size > 1 else 1.0


def _dersimonian_laird(x: Floats, v: Floats) -> float:
    variances, differences = _contrasts(x, v)
    excess = float(np.sum(differences**2 / variances)) - variances.size
    return math.sqrt(max(0.0, excess) / float(np.sum(1.0 / variances))) if variances.size else 0.0


def _mandel_paule(x: Floats, v: Floats) -> float:
    from scipy.optimize import brentq

    variances, differences = _contrasts(x, v)
    squares = differences**2

    def missing(tau2: float) -> float:
        return variances.size - float(np.sum(squares / (variances + tau2)))

    if missing(0.0) >= 0.0:
        return 0.0
    return math.sqrt(brentq(missing, 0.0, float(squares.sum()), xtol=1e-16 * float(squares.sum()), rtol=1e-14))


def _reml(x: Floats, v: Floats) -> float:
    """Where the restricted likelihood is largest: at 0, or at a root of its slope."""
    from scipy.optimize import brentq

    variances, differences = _contrasts(x, v)
    squares = differences**2

    def slope(tau2: npt.ArrayLike) -> Floats:
        total = variances + np.asarray(tau2)[..., None]
        return np.asarray(np.sum(1.0 / total - squares / total**2, axis=-1))

    def minus_log_likelihood(tau2: float) -> float:
        return float(np.sum(np.log(variances + tau2) + squares / (variances + tau2)))

    grid = np.concatenate([[0.0], np.geomspace(1e-8, 1.0, 65) * (float(squares.sum()) + 1e-300)])
    slopes = slope(grid)
    turns = np.flatnonzero((slopes[:-1] < 0.0) & (slopes[1:] >= 0.0))
    roots = [float(brentq(slope, grid[k], grid[k + 1], xtol=1e-16 * grid[k + 1], rtol=1e-14)) for k in turns]
    return math.sqrt(min([0.0, *roots], key=minus_log_likelihood))


_TAU: dict[Method, Callable[[Floats, Floats], float]] = {
    "weighted": lambda x, v: 0.0,
    "dersimonian-laird": _dersimonian_laird,
    "mandel-paule": _mandel_paule,
    "reml": _reml,
}


ROUNDS = 100
"""Most rounds in which scales, weights and scatters are found in turn."""
SETTLED = 1e-10
"""Scales that change by less in a round have settled."""
FACTOR = 3.0
"""Largest factor between two values over which a stated uncertainty is carried from one to the other."""
UNDETERMINED = float(np.radians(1.0))
"""A zero that is known no better than this [rad] says nothing."""


@dataclass(frozen=True)
class LaboratoryValues:
    """One laboratory's values in the common directions."""

    value: Floats
    covariance: Covariance
    error: Floats
    """Of the interpolation [1/sr], which the covariance holds too; 0 in the same direction."""

    def take(self, rows: Rows) -> LaboratoryValues:
        """Some of them."""
        return LaboratoryValues(self.value[rows], self.covariance.take(rows), self.error[rows])


@dataclass(frozen=True)
class CommonShape:
    """Scales, zeros and scatters about one shape."""

    shape: Floats
    scales: Floats
    v_scales: Floats
    zeros: Floats
    """[rad], NaN where the shape does not show it."""
    v_zeros: Floats
    scatter: Floats
    p_scatter: Floats


def common_shape(at: Observations, found: Sequence[LaboratoryValues], keys: Sequence[Sequence[Any]]) -> CommonShape:
    """Scales, zeros and scatters of all laboratories about a shape that they make together."""
    y = np.array([one.value for one in found])
    scales = np.array([_ratio(row, np.median(y, axis=0)) for row in y])
    shape, scatter = np.mean(y / scales[:, None], axis=0), np.ones(len(y))
    slope = np.zeros(shape.size)
    for again in range(2):
        for _ in range(ROUNDS):
            before = scales
            covariances = [_at_the_shape(one, s * shape) for one, s in zip(found, scales, strict=True)]
            weights = np.array([s / (f * c.random) for s, f, c in zip(scales, scatter, covariances, strict=True)]) ** 2
            shape = np.sum(weights * y / scales[:, None], axis=0) / weights.sum(axis=0)
            fits = [
                _fitted(values, replace(c, random=c.random * max(f, 1.0)), shape, slope)
                for values, c, f in zip(y, covariances, scatter, strict=True)
            ]
            scales = np.array([fit.scale for fit in fits])
            off = [v - fit.scale * shape + fit.tilt * slope for v, fit in zip(y, fits, strict=True)]
            errors = np.array([one.error / s for one, s in zip(found, scales, strict=True)])
            scatter, p_scatter = _scatters(off, covariances, weights, scales, errors, bool(slope.any()))
            if np.all(np.abs(scales / before - 1.0) < SETTLED):
                break
        if again == 0:
            slope = slope_in_plane(replace(at, brdf=shape))
    tilts = np.array([fit.tilt / fit.scale if np.isfinite(fit.variance[1]) else np.nan for fit in fits])
    v_scales, v_tilts = (
        joint([fit.of_causes[p] for fit in fits], [fit.variance[p] for fit in fits], keys) for p in (0, 1)
    )
    return CommonShape(shape, scales, v_scales, tilts, v_tilts / np.outer(scales, scales), scatter, p_scatter)


def joint(effects: Sequence[Floats], variances: Sequence[float], keys: Sequence[Sequence[Any]]) -> Floats:
    """(K, K) covariance of one number of each laboratory: its variance, and what shared causes do to two of them."""
    known = list(dict.fromkeys(key for of_one in keys for key in of_one))
    by_cause = np.zeros((len(keys), len(known)))
    for k, (of_one, effect) in enumerate(zip(keys, effects, strict=True)):
        by_cause[k, [known.index(key) for key in of_one]] = effect
    out = by_cause @ by_cause.T
    np.fill_diagonal(out, variances)
    return np.asarray(out)


def _ratio(values: Floats, shape: Floats) -> float:
    """A first guess of a scale; above 0."""
    used = (values > 0.0) & (shape > 0.0)
    return float(np.median(values[used] / shape[used])) if used.any() else 1.0


def _at_the_shape(one: LaboratoryValues, expected: Floats) -> Covariance:
    """The covariance that a laboratory would state of the expected values.

    What it states of measured ones goes with their noise, and would give low values more weight. How uncertainties go
    with values the table shows.
    """
    c, y = one.covariance, one.value
    used = (y > 0.0) & (expected > 0.0)
    factor = np.where(used, np.clip(expected / np.where(used, y, 1.0), 1.0 / FACTOR, FACTOR), 1.0)
    power = 0.0
    if np.count_nonzero(used) > 2:
        x, r = np.log(expected[used]), np.log(c.random[used])
        spread = float(np.var(x))
        power = float(np.clip(np.mean((x - x.mean()) * (r - r.mean())) / spread, 0.0, 1.0)) if spread > 1e-4 else 1.0
    return Covariance(c.random * factor**power, c.scaled(factor, expected).common, c.causes)


@dataclass(frozen=True)
class _Fit:
    """A laboratory's values by a shape and its slope."""

    scale: float
    tilt: float
    """The scale times the zero [rad]."""
    variance: Floats
    """Variance of both; infinite where a tilt is undetermined."""
    of_causes: Floats
    """(2, causes) what one standard deviation of each cause does to both."""


def _fitted(values: Floats, covariance: Covariance, shape: Floats, slope: Floats) -> _Fit:
    columns = np.column_stack([shape, -slope])
    causes = covariance.whiten(covariance.common) if covariance.causes else np.zeros((values.size, 0))
    target = covariance.whiten(values)
    for used in (2, 1):
        if used == 2 and (values.size < 4 or not slope.any()):
            continue
        white = covariance.whiten(columns[:, :used])
        if used == 2 and np.linalg.cond(white / np.linalg.norm(white, axis=0)) > 1e6:
            continue
        solver = np.linalg.pinv(white)
        variance = np.sum(solver**2, axis=1)
        if used == 2 and np.sqrt(variance[1]) > UNDETERMINED * abs(float((solver @ target)[0])):
            continue
        found = np.zeros(2)
        found[:used] = solver @ target
        of_causes, of_both = np.zeros((2, causes.shape[1])), np.full(2, np.inf)
        of_causes[:used], of_both[:used] = solver @ causes, variance
        return _Fit(float(found[0]), float(found[1]), of_both, of_causes)
    raise AssertionError  # one column alone always goes


def _scatters(
    off: Sequence[Floats],
    covariances: Sequence[Covariance],
    weights: Floats,
    scales: Floats,
    errors: Floats,
    with_slope: bool,
) -> tuple[Floats, Floats]:
    """How many times as much each laboratory scatters as it states, and the probability of as much by chance.

    The probability is that of its distances from the shape of the others, where it scatters as it states. Of their
    variance the others make a share, which is known as well as their own scatter.
    """
    k, n = weights.shape
    from scipy.special import chdtrc

    scatter, p = np.ones(k), np.ones(k)
    left = n - (2.0 if with_slope else 1.0)
    if k < 3 or left < 1.0:
        return scatter, p
    for i, (residual, c) in enumerate(zip(off, covariances, strict=True)):
        others = np.delete(weights, i, axis=0)
        shares, off_others = others / others.sum(axis=0), np.delete(errors, i, axis=0)
        # interpolations within one lobe err to one side, not each to its own, and by up to twice what is stated
        one_sided = (2.0 * (errors[i] - (shares * off_others).sum(axis=0))) ** 2
        one_sided -= errors[i] ** 2 + np.sum((shares * off_others) ** 2, axis=0)
        of_others = scales[i] ** 2 * (1.0 / others.sum(axis=0) + np.maximum(one_sided, 0.0))
        free = np.maximum(1.0 - weights[i] / weights.sum(axis=0), 1e-6)
        apart = residual / free
        expected = np.hypot(c.random, np.sqrt(of_others))
        of_all = Covariance(expected, c.common, c.causes).chi_square(apart) / left
        known = left / (1.0 + float(np.mean(of_others / expected**2)) ** 2 / (k - 2))
        p[i] = float(chdtrc(known, known * of_all))
        stated = np.sqrt(c.random**2 * free + scales[i] ** 2 * np.maximum(one_sided, 0.0) * free**2)
        scatter[i] = np.sqrt(Covariance(stated, c.common, c.causes).chi_square(residual) / left)
    return scatter, p
