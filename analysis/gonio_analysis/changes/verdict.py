"""Whether two measurements differ: tests of all points together, and of what would change all values in one way.

Two such effects are looked for: a common factor, and a zero of an angle, as a new mount or homing of an axis makes it.
Each is one number, which chi-square of many values drowns: generalised least squares of the difference by what the
effect does to each value, with the whole covariance. Effects resemble each other. What was found first is free where
the next is looked for, so that a zero is not told as a factor too.
"""

from collections.abc import Mapping, Sequence
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
"""Condition number of effects, above which the values do not tell one from the other."""
CLOSER = 0.9
"""A factor or a zero is worth words where what it leaves is less than this share."""
ALIKE = 4.0
"""How many neighbouring values are alike in what remains: the shape of a lobe that is another one is smooth."""
OFTEN = 0.9
"""Share of the cases in which a change as large as `Effect.detectable` is found."""
FACTOR = "the common factor"
ZEROS = {"theta_r": "the zero of \u03b8r", "theta_i": "the zero of \u03b8i"}
"""What the test of each arm's zero is called."""


@dataclass(frozen=True)
class Effect:
    """What changes all values in one way: a common factor, or a zero of an angle."""

    value: float
    """Factor of B over A less 1, or by how much B's angle reads larger than A's [rad]; with what was found free."""
    u: float
    """Standard uncertainty of that, with what B and A differ by beyond all that was found; infinite: undetermined."""
    p: float
    """Probability by chance of one that far from 0, with what else was found free and what remains as uncertainty."""
    found: bool
    detectable: float
    """Size that is found in `OFTEN` of the cases, where nothing else changed; infinite: undetermined."""


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
    factor: Effect
    """Common factor of B over A, less 1."""
    zeros: Mapping[str, Effect]
    """By the angle, of those whose zero the values show."""
    remains: float
    """Relative standard deviation of the differences beyond what is stated and what was found."""
    alike: float
    """Cosine between what the zeros of both arms do to the values: near -1 nobody tells one from the other's opposite.
    """

    @property
    def scale(self) -> float:
        """Common factor of B over A, less 1."""
        return self.factor.value

    @property
    def u_scale(self) -> float:
        """Its standard uncertainty."""
        return self.factor.u

    @property
    def p_scale(self) -> float:
        """Probability of a factor that far from 1 by chance."""
        return self.factor.p

    @property
    def effects(self) -> dict[str, Effect]:
        """The effects that have a test, by its name."""
        return {FACTOR: self.factor} | {ZEROS[angle]: zero for angle, zero in self.zeros.items()}

    @property
    def tests(self) -> dict[str, float]:
        """What the verdict rests on, each with its probability by chance."""
        return {
            "chi-square of all values": self.p_value,
            "the largest single value": self.p_largest,
            **{name: effect.p for name, effect in self.effects.items()},
        }

    @property
    def found_by(self) -> list[str]:
        """Those of `tests` that say that something changed, at `LEVEL` for all together."""
        effects = self.effects
        return [
            name
            for name, p in self.tests.items()
            if (effects[name].found if name in effects else len(self.tests) * p < LEVEL)
        ]

    @property
    def changed(self) -> bool:
        """Whether any test says so."""
        return bool(self.found_by)


def judge(
    value_a: Floats,
    value_b: Floats,
    covariance: Covariance,
    zeros: Mapping[str, Floats] | None = None,
    together: Floats | None = None,
) -> Verdict:
    """Whether B - A is more than its covariance allows.

    Parameters
    ----------
    value_a, value_b : (n,) arrays [1/sr]
    covariance
        Of the difference.
    zeros
        What angles of B that read too large do to its values [1/(sr rad)], by the angle (of `ZEROS`).
    together : (n,) array [1/sr]
        In place of the covariance's `random` where factor and zeros are looked for: noise of neighbours that goes
        together counts more in what all of them say than in each.
    """
    from scipy.special import chdtrc, ndtr

    difference, middle = value_b - value_a, 0.5 * (value_a + value_b)
    n = difference.size
    total = covariance.chi_square(difference)
    z = covariance.alone(difference)
    p = 2 * ndtr(-np.abs(z))
    p_largest = float(-np.expm1(n * np.log1p(-min(float(p.min()), 1 - 1e-16))))
    seen = {angle: column for angle, column in (zeros or {}).items() if n > 3 and column.any()}
    of_all = covariance if together is None else replace(covariance, random=together)
    factor, of_zeros, remains, alike = _effects(difference, middle, of_all, seen)
    tests = 3 + len(of_zeros)
    p_value = float(chdtrc(n, total))
    by_effect = factor.found or any(zero.found for zero in of_zeros.values())
    changed = by_effect or tests * min(p_value, p_largest) < LEVEL
    return Verdict(
        chi_square=total,
        p_value=p_value,
        z=z,
        beyond=int(np.count_nonzero(np.abs(z) > BEYOND)),
        expected=float(n * 2 * ndtr(-BEYOND)),
        largest=float(np.abs(z).max()),
        p_largest=p_largest,
        # one verdict: where nothing says that anything changed, no single value has
        marked=_discoveries(p) if changed else np.zeros(n, dtype=bool),
        factor=factor,
        zeros=of_zeros,
        remains=remains,
        alike=alike,
    )


@dataclass(frozen=True)
class _Whitened:
    """The difference and what effects do to it, whitened and made small (R of their QR decomposition)."""

    columns: Floats
    target: Floats

    @classmethod
    def of(cls, difference: Floats, known: Covariance, columns: Sequence[Floats]) -> "_Whitened":
        *white, target = _triangle(known, [*columns, difference]).T
        return cls(np.stack(white, axis=1), target)

    def fitted(self, some: Sequence[int]) -> tuple[Floats, Floats]:
        """Least squares by some columns: values and standard uncertainties; infinite ones where they are alike."""
        matrix = self.columns[:, some]
        size = np.linalg.norm(matrix, axis=0)
        if not size.all() or np.linalg.cond(matrix / size) > CONDITION:
            return np.zeros(len(some)), np.full(len(some), np.inf)
        inverse = np.linalg.inv((matrix / size).T @ (matrix / size)) / np.outer(size, size)
        return inverse @ (matrix.T @ self.target), np.sqrt(np.diag(inverse))

    def cosine(self, j: int, k: int) -> float:
        """Between two columns."""
        one, other = self.columns[:, j], self.columns[:, k]
        return float(one @ other / max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-300))

    def left(self, some: Sequence[int]) -> float:
        """Chi-square with some columns free."""
        rest = self.target - self.columns[:, some] @ self.fitted(some)[0] if some else self.target
        return float(rest @ rest)

    def found(self, wanted: Sequence[int], level: float) -> tuple[list[int], Floats]:
        """Which columns there are, the clearest first, and the probability of each by chance when it was looked for."""
        from scipy.special import ndtr

        some, p = list[int](), np.ones(self.columns.shape[1])
        for _ in wanted:
            for k in (k for k in wanted if k not in some):
                values, u = self.fitted([*some, k])
                p[k] = 2 * ndtr(-abs(values[-1]) / u[-1])
            best = min((k for k in wanted if k not in some), key=lambda k: p[k])
            if p[best] >= level:
                break
            some.append(best)
        return some, p


def _effects(
    difference: Floats, middle: Floats, covariance: Covariance, zeros: Mapping[str, Floats]
) -> tuple[Effect, dict[str, Effect], float, float]:
    """The common factor, the zeros, what remains beyond what is stated and found, and how alike the zeros are.

    Where much remains none of them tells all. They are then looked for once more with that as uncertainty, and so are
    the numbers told; what does not stand out of it is not named.
    """
    from scipy.special import chdtrc, ndtr, ndtri

    columns = [middle, *zeros.values()]
    level = LEVEL / (2 + len(columns))
    white = _Whitened.of(difference, covariance, columns)
    alone = [float(white.fitted([k])[1][0]) for k in range(len(columns))]
    alike = white.cosine(1, 2) if len(columns) > 2 else 0.0
    some, p = white.found(range(len(columns)), level)
    remains = 0.0
    if float(chdtrc(max(difference.size - len(some), 1), white.left(some))) < level:
        remains, _ = _excess(difference, np.abs(middle), covariance, [columns[k] for k in some])
        random = np.hypot(covariance.random, ALIKE**0.5 * remains * _level(np.abs(middle)))
        white = _Whitened.of(difference, Covariance(random, covariance.common, covariance.causes), columns)
        some, _ = white.found(some, level)
    times = float(ndtri(OFTEN) - ndtri(0.5 * level))
    out = []
    for k, u_alone in enumerate(alone):
        values, u = white.fitted([*(j for j in some if j != k), k])
        chance = float(2 * ndtr(-abs(values[-1]) / u[-1])) if remains > 0.0 else float(p[k])
        out.append(Effect(float(values[-1]), float(u[-1]), chance, k in some, times * u_alone))
    factor, of_mean = out[0], min(out[0].value, 2.0 - 1e-12)
    factor = replace(factor, value=_ratio(of_mean) - 1.0, u=4.0 * factor.u / (2.0 - of_mean) ** 2)
    return factor, dict(zip(zeros, out[1:], strict=True)), remains, alike


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
    """The same with B divided by `scale`."""
    scale: float
    """The common factor, B over A."""
    with_zero: float | None = None
    """The same with B's angle taken back too; None where the values do not show a zero."""
    zero: float | None = None
    """By how much B's angle reads larger than A's, in the plane of incidence [rad]."""
    angle: str = "theta_r"
    """Which angle that is."""


def within(
    value_a: Floats,
    value_b: Floats,
    covariance: Covariance | None,
    zeros: Mapping[str, Floats],
    verdict: Verdict | None = None,
) -> Within:
    """Within what two agree: how large an independent relative uncertainty would have to be, and with what taken away.

    Parameters
    ----------
    value_a, value_b : (n,) arrays [1/sr]
    covariance
        Of the difference; None where nothing is stated.
    zeros
        As of `judge`.
    verdict
        What `judge` says: the factor and the zero are its. Without one both are those that leave least.
    """
    middle, difference = 0.5 * (value_a + value_b), value_b - value_a
    mean = np.abs(middle)
    as_they_are, _ = _excess(difference, mean, covariance, [])
    if verdict is not None:
        k = 1.0 + verdict.scale
        scaled = difference - 2.0 * (k - 1.0) / (k + 1.0) * middle
        out = Within(as_they_are, _excess(scaled, mean, covariance, [])[0], k)
        for angle, zero in verdict.zeros.items():
            if zero.found:
                rest = (scaled if verdict.factor.found else difference) - zero.value * zeros[angle]
                return replace(out, with_zero=_excess(rest, mean, covariance, [])[0], zero=zero.value, angle=angle)
        return out
    with_scale, found = _excess(difference, mean, covariance, [middle])
    out = Within(as_they_are, with_scale, _ratio(found[0]))
    slope = zeros.get("theta_r")
    if slope is None or mean.size < 4 or not slope.any():
        return out
    both = _triangle(Covariance(np.maximum(mean, 1e-300), np.zeros((mean.size, 0))), [middle, slope])
    if np.linalg.cond(both / np.linalg.norm(both, axis=0)) > CONDITION:
        return out
    with_zero, found = _excess(difference, mean, covariance, [middle, slope])
    if with_zero >= CLOSER * with_scale:
        return out
    return replace(out, scale=_ratio(found[0]), with_zero=with_zero, zero=found[1])


def _ratio(of_mean: float) -> float:
    """B over A, by B - A over the mean of both."""
    return (2.0 + of_mean) / (2.0 - of_mean) if of_mean < 2.0 else np.inf


def _level(mean: Floats) -> Floats:
    """What relative uncertainties are of: the smallest of values count as a hundredth of the median."""
    return np.asarray(np.maximum(mean, 0.01 * float(np.median(mean)) + 1e-300))


def _excess(
    difference: Floats, mean: Floats, covariance: Covariance | None, columns: Sequence[Floats]
) -> tuple[float, tuple[float, ...]]:
    """The relative uncertainty at which chi-square is its expectation, and what the columns are found to be."""
    from scipy.optimize import brentq

    level = _level(mean)  # relative to 0 everything differs
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
