"""One value from several laboratories: consensus, dark uncertainty, consistent subsets, degrees of equivalence.

Everything takes the laboratories' values x and their covariance V, which need not be diagonal: causes that two of them
share stand outside the diagonal. With independent laboratories the formulas are those of the literature: DerSimonian
and Laird (Control. Clin. Trials 7, 177, 1986), Mandel and Paule (J. Res. NBS 87, 377, 1982), REML (Searle et al.,
Variance Components, ch. 6), and the largest consistent subset of Cox (Metrologia 44, 187, 2007).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple, get_args

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from gonio.errors import ArgumentError
from gonio.typing import Floats

Method = Literal["weighted", "dersimonian-laird", "mandel-paule", "reml"]
METHODS: tuple[Method, ...] = get_args(Method)
EVERY_SUBSET = 14
"""Of more laboratories, the one that fits worst is taken away until the rest agree."""


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
    variances, differences = _contrasts(x, v)
    squares = differences**2

    def missing(tau2: float) -> float:
        return variances.size - float(np.sum(squares / (variances + tau2)))

    if missing(0.0) >= 0.0:
        return 0.0
    return math.sqrt(brentq(missing, 0.0, float(squares.sum()), xtol=1e-16 * float(squares.sum()), rtol=1e-14))


def _reml(x: Floats, v: Floats) -> float:
    """Where the restricted likelihood is largest: at 0, or at a root of its slope."""
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
