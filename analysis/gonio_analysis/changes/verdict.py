"""Whether two measurements differ: tests of all points together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_analysis.fitting.value_covariance import Covariance

LEVEL = 0.01
"""Probability that the verdict is "changed" where nothing changed."""
FALSE_DISCOVERIES = 0.05
"""Share of the marked values that are marked by chance."""
BEYOND = 2.0
CONDITION = 1e4
"""Condition number of a common factor and a zero, above which the values do not tell one from the other."""


@dataclass(frozen=True)
class Verdict:
    """What the differences say about whether the two are the same."""

    chi_square: float
    p_value: float
    """Probability of a larger chi-square by chance."""
    z: Floats
    """(n,) each difference against what the others predict, in standard deviations."""
    beyond: int
    """How many of them are beyond `BEYOND`."""
    expected: float
    """How many that would be by chance."""
    largest: float
    p_largest: float
    """Probability that the largest of n is that large by chance."""
    marked: npt.NDArray[np.bool_]
    """The values that changed, among which `FALSE_DISCOVERIES` are expected to be marked by chance."""
    scale: float
    """Common factor of B over A, less 1."""
    u_scale: float
    p_scale: float
    """Probability of a factor that far from 1 by chance."""

    @property
    def tests(self) -> dict[str, float]:
        """What the verdict rests on, each with its probability by chance."""
        return {
            "chi-square of all values": self.p_value,
            "the largest single value": self.p_largest,
            "the common factor": self.p_scale,
        }

    @property
    def found_by(self) -> list[str]:
        """Those of `tests` that say that something changed, at `LEVEL` for all together."""
        return [name for name, p in self.tests.items() if len(self.tests) * p < LEVEL]

    @property
    def changed(self) -> bool:
        """Whether any test says so."""
        return bool(self.found_by)


def judge(value_a: Floats, value_b: Floats, covariance: Covariance) -> Verdict:
    """Whether B - A is more than its covariance allows.

    Parameters
    ----------
    value_a, value_b : (n,) arrays [1/sr]
    covariance
        Of the difference.
    """
    from scipy.special import chdtrc, ndtr

    difference = value_b - value_a
    n = difference.size
    total = covariance.chi_square(difference)
    z = covariance.alone(difference)
    p = 2 * ndtr(-np.abs(z))
    mean = covariance.whiten(0.5 * (value_a + value_b))
    strength = float(mean @ mean)
    scale, u_scale = 0.0, np.inf  # of two that are 0 everywhere
    if strength > 0.0:
        scale, u_scale = float(mean @ covariance.whiten(difference)) / strength, float(strength**-0.5)
    found = Verdict(
        chi_square=total,
        p_value=float(chdtrc(n, total)),
        z=z,
        beyond=int(np.count_nonzero(np.abs(z) > BEYOND)),
        expected=float(n * 2 * ndtr(-BEYOND)),
        largest=float(np.abs(z).max()),
        p_largest=float(-np.expm1(n * np.log1p(-min(float(p.min()), 1 - 1e-16)))),
        marked=_discoveries(p),
        scale=scale,
        u_scale=u_scale,
        p_scale=float(2 * ndtr(-abs(scale) / u_scale)),
    )
    # one verdict: where nothing says that anything changed, no single value has
    return found if found.changed else replace(found, marked=np.zeros(n, dtype=bool))


def _discoveries(p: Floats) -> npt.NDArray[np.bool_]:
    """Benjamini and Hochberg (1995): the smallest probabilities, up to the last below its share of the rate."""
    small = np.flatnonzero(p <= FALSE_DISCOVERIES)
    small = small[np.argsort(p[small])]
    below = np.flatnonzero(p[small] * (p.size / np.arange(1, small.size + 1)) <= FALSE_DISCOVERIES)
    out = np.zeros(p.size, dtype=bool)
    out[small[: below[-1] + 1 if below.size else 0]] = True
    return out


@dataclass(frozen=True)
class Within:
    """By how much two differ beyond what they state, as a relative standard deviation of the differences."""

    as_they_are: float
    with_scale: float
    """The same with a common factor free."""
    scale: float
    """The common factor, B over A."""
    with_zero: float | None = None
    """The same with a zero of the angle free too; None where the values do not show one."""
    zero: float | None = None
    """By how much B's angle reads larger than A's, in the plane of incidence [rad]."""


def within(value_a: Floats, value_b: Floats, covariance: Covariance | None, slope: Floats | None) -> Within:
    """Within what two agree: how large an independent relative uncertainty would have to be, and with what set free.

    Parameters
    ----------
    value_a, value_b : (n,) arrays [1/sr]
    covariance
        Of the difference; None where nothing is stated.
    slope : (n,) array [1/(sr rad)]
        Change of the values with the receiver's angle; None where there is none.
    """
    middle, difference = 0.5 * (value_a + value_b), value_b - value_a
    mean = np.abs(middle)
    as_they_are, _ = _excess(difference, mean, covariance, [])
    with_scale, found = _excess(difference, mean, covariance, [middle])
    out = Within(as_they_are, with_scale, 1.0 + found[0])
    if slope is None or mean.size < 4 or not slope.any():
        return out
    both = _triangle(Covariance(np.maximum(mean, 1e-300), np.zeros((mean.size, 0))), [middle, slope])
    if np.linalg.cond(both / np.linalg.norm(both, axis=0)) > CONDITION:
        return out
    with_zero, found = _excess(difference, mean, covariance, [middle, slope])
    return replace(out, with_zero=with_zero, zero=-found[1])


def _excess(
    difference: Floats, mean: Floats, covariance: Covariance | None, columns: Sequence[Floats]
) -> tuple[float, tuple[float, ...]]:
    """The relative uncertainty at which chi-square is its expectation, and what the columns are found to be.

    The smallest of values count as a hundredth of the median: relative to 0 everything differs.
    """
    from scipy.optimize import brentq

    level = np.maximum(mean, 0.01 * float(np.median(mean)) + 1e-300)
    freedom = difference.size - len(columns)

    def fitted(x: float) -> tuple[float, tuple[float, ...]]:
        random, common, causes = x * level, np.zeros((level.size, 0)), tuple[str, ...]()
        if covariance is not None:
            random, common, causes = np.hypot(covariance.random, random), covariance.common, covariance.causes
        *white, target = _triangle(Covariance(random, common, causes), [*columns, difference]).T
        known = np.stack(white, axis=1) if white else np.zeros((target.size, 0))
        found = np.linalg.lstsq(known, target, rcond=None)[0]
        rest = target - known @ found
        return float(rest @ rest), tuple(float(v) for v in found)

    top = float(np.abs(difference / level).max())
    least = 1e-9 if covariance is None else 0.0
    if freedom < 1 or top == 0.0:
        return 0.0, (0.0,) * len(columns)
    if fitted(max(least, 1e-12 * top))[0] <= freedom:
        return 0.0, fitted(max(least, 1e-12 * top))[1]
    x = float(brentq(lambda x: fitted(x)[0] - freedom, max(least, 1e-12 * top), 2.0 * top, rtol=1e-6))
    return x, fitted(x)[1]


def _triangle(known: Covariance, columns: Sequence[Floats]) -> Floats:
    """R of the whitened columns (n, p) = Q R: as good as they are for a least-squares problem, and small."""
    out = np.zeros((0, len(columns)))
    for white in known.whiten_in_blocks(columns):
        out = np.asarray(np.linalg.qr(np.concatenate([out, white]), mode="r"))
    return out
