"""How far the lamp may be from its level between two visits to the white reference.

Three visits do not say how a lamp wanders; ten hardly do. So the departure of K(t) from a straight line is not fitted:
it is averaged over what it may be, each in proportion to how well it agrees with the visits (Bayes). The lamp walks at
random (Wiener), or smoothly, as in a warm-up (an integrated walk), each with any strength from far below the visits'
noise to far above what they differ by. In either case one interval may hold a jump, or one visit be off. Level and
slope of the line are free; level, anew, in each session. The means of all these curves are those of generalised least
squares (kriging), the weights their restricted likelihoods: Rasmussen and Williams 2006, Gaussian Processes for Machine
Learning, sections 2.7 and 5.4.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gonio.checks.values import NORMAL_95
from gonio.typing import Bools, Floats, Ints

WEAKEST = 0.1
"""Least step of a walk in one interval, over the noise of a visit: below it a lamp is as good as steady."""
STRONGEST = 10.0
"""Largest step of a walk, over the largest difference of two neighbouring visits in as much time."""
PER_DECADE = 3
"""Strengths that are tried."""
SMOOTHLY = 0.1
"""Probability, before the visits are seen, that a lamp that wanders does so smoothly."""
SINGLE = 0.002
"""Prior probability of a jump in the interval where one is likeliest; and of one visit that is off."""
FEWEST = 4
"""Degrees of freedom above which a jump, or one visit that is off, can be told from a walk."""
DRIFT = 0.5
"""Of the line's change in one interval over a walk's, where three visits cannot tell the one from the other."""
BLOCK = 32
"""Visits that are looked at together, at most."""
NODES = 32
"""Times at which errors that neighbouring points share are written out."""
HELD = 0.95
"""Probability of an interval of `NORMAL_95` standard uncertainties."""
LEAST = 1e-4
"""A curve of a smaller weight is left out."""


@dataclass(frozen=True, slots=True)
class Wander:
    """What K may depart by from what is taken for it, beyond the noise of the line through all visits."""

    u: Floats
    """Standard uncertainty of K at each time, so that 1.96 of it, with the line's, hold 95 %."""
    shared: Floats
    """The part of it that neighbouring points share: change of K for one standard deviation of each of `NODES` causes,
    shape (times, NODES); shape (times, 0) where there are more visits than `BLOCK`."""


@dataclass(frozen=True, slots=True)
class LampVisits:
    """Visits of one band, in the order of time."""

    times_s: Floats
    values: Floats
    variances: Floats
    session: Ints
    """Session of each visit; the lamp was dark between two of them."""


def wander(visits: LampVisits, times_s: Floats, line: Callable[[Floats], tuple[Floats, Floats]]) -> Wander:
    """The uncertainty of a level between the visits.

    Parameters
    ----------
    visits
        At least one; three, of one session, to say anything.
    times_s : (m,) array
        When the level is asked for [s].
    line
        What is taken for K at given times, shape (n,), and what standard deviations of the straight line through all
        visits change it by, shape (n, k).
    """
    count, zero = len(visits.times_s), np.zeros(len(times_s))
    if not times_s.size or count - _free(visits) < 1:
        return Wander(zero, np.zeros((len(times_s), 0)))
    level, noise = line(times_s)
    known = np.sum(noise**2, axis=1)
    if count > BLOCK:
        u, half = zero, BLOCK // 2
        place = np.searchsorted(visits.times_s, times_s) // half
        last = (count - 1) // half - 1
        for k in range(last + 1):
            here = np.flatnonzero(np.clip(place, 0, last) == k)
            rows = slice(max(k * half - half // 2, 0), (k + 1) * half + half // 2 if k < last else count)
            values, variances = visits.values[rows], visits.variances[rows]
            part = LampVisits(visits.times_s[rows], values, variances, visits.session[rows])
            if here.size and len(part.times_s) - _free(part) >= 1:
                straight, *curves = _curves(part, times_s[here])
                curves = [c._replace(variance=c.variance - straight.variance + known[here]) for c in curves]
                u[here] = _beyond(curves, level[here], known[here])
        return Wander(u, np.zeros((len(times_s), 0)))
    curves = _curves(visits, times_s)[1:]
    u = _beyond(curves, level, known)
    nodes = np.linspace(visits.times_s[0], visits.times_s[-1], NODES)
    root = _root(_curves(visits, nodes, full=True)[1:], *line(nodes))
    shared = np.stack([np.interp(times_s, nodes, column) for column in root.T], axis=1)
    of_curves = sum(c.weight * (c.variance + (c.mean - level) ** 2) for c in curves) - known
    size = np.maximum(of_curves, np.sum(shared**2, axis=1))
    return Wander(u, shared * (u / np.sqrt(np.where(size > 0, size, 1.0)))[:, None])


def _free(visits: LampVisits) -> int:
    """How many numbers the line has: a level in each session, and one slope where any session has two visits."""
    sessions = len(np.unique(visits.session))
    return sessions + int(len(visits.times_s) > sessions)


class _Curve(NamedTuple):
    """One way that K may go."""

    weight: float
    mean: Floats
    variance: Floats
    """Variance at some times, or the whole covariance."""


class _Single(NamedTuple):
    """What may have happened once: a jump of K at an unknown time between two, or visits that are off."""

    begin: float
    end: float
    squared: float
    """Square of the jump."""
    off: Floats
    """Variance of each visit."""

    def within(self, times: Floats) -> Floats:
        """The fraction of the interval gone by: a step at an unknown time in it has the covariance of a random walk."""
        return np.asarray(np.clip((times - self.begin) / (self.end - self.begin), 0.0, 1.0))


def _singles(t: Floats, y: Floats, together: Bools) -> list[_Single]:
    """The likeliest jump, and the visit that is likeliest to be off."""
    length, none = np.diff(t), np.zeros(t.size)
    slopes = np.diff(y) / length
    beside = np.concatenate([[slopes[1]], 0.5 * (slopes[:-2] + slopes[2:]), [slopes[-2]]])
    jumps = np.abs(slopes - beside) * length * together
    k = int(np.argmax(jumps))
    part = length[:-1] / (t[2:] - t[:-2])
    apart = np.abs(y[1:-1] - (1.0 - part) * y[:-2] - part * y[2:]) * together[1:] * together[:-1]
    j = int(np.argmax(apart))
    off = none.copy()
    off[j + 1] = apart[j] ** 2
    return [_Single(t[k], t[k + 1], jumps[k] ** 2, none), _Single(0.0, 1.0, 0.0, off)]


def _kernels(a: Floats, b: Floats, slope: float = 0.0) -> Floats:
    """Covariances at the times `a` and `b` of a walk and of an integrated walk of strength 1, stacked.

    `slope` is the variance of a straight line's slope that comes with either.
    """
    low, high = np.minimum(a, b), np.maximum(a, b)
    return np.stack([low, low**2 * (3.0 * high - low) / 6.0]) + slope * a * b


def _curves(visits: LampVisits, times_s: Floats, *, full: bool = False) -> list[_Curve]:
    """All curves that may be K, at some times; a straight line comes first, with the weight 0."""
    t, together = visits.times_s, np.diff(visits.session) == 0
    unit = float(np.median(np.diff(t)[together if together.any() else slice(None)]))
    start = min(float(t[0]), float(np.min(times_s)))
    # a point in a session without a visit has the level of the nearest one
    near = visits.session[np.clip(np.searchsorted(0.5 * (t[1:] + t[:-1]), times_s), 0, t.size - 1)]
    t, at = (t - start) / unit, (times_s - start) / unit
    size, mean = math.sqrt(float(np.mean(visits.variances))), float(np.mean(visits.values))
    y, v = (visits.values - mean) / size, visits.variances / size**2
    design, wanted = ((of[:, None] == np.unique(visits.session)).astype(float) for of in (visits.session, near))
    tells_slope = together.any() and t.size > design.shape[1] + 2
    if tells_slope:
        design, wanted = np.column_stack([design, t]), np.column_stack([wanted, at])
    steepest = np.max(np.abs(np.diff(y)[together]) / np.sqrt(np.diff(t)[together]), initial=0.0)
    top = max(STRONGEST * float(steepest), 3.0)
    strengths = np.geomspace(WEAKEST, top, round(PER_DECADE * math.log10(top / WEAKEST)) + 1)
    kinds = (1.0 - SMOOTHLY, SMOOTHLY) if tells_slope else (1.0,)
    slope = 0.0 if tells_slope else DRIFT**2
    singles = [_Single(0.0, 1.0, 0.0, np.zeros(t.size))]
    if t.size - design.shape[1] >= FEWEST:
        singles += _singles(t, y, together)
    of_kind = _kernels(t[:, None], t, slope)
    of_single = [x.squared * _kernels(x.within(t)[:, None], x.within(t))[0] + np.diag(x.off) for x in singles]
    ways = [(0.0, 0, 0, 0.0)]
    ways += [
        (s, kind, single, p / len(strengths) * (SINGLE if single else 1.0))
        for kind, p in enumerate(kinds) for single in range(len(singles)) for s in strengths
    ]  # fmt: skip
    joint = np.stack([s**2 * of_kind[kind] + of_single[single] for s, kind, single, _ in ways]) + np.diag(v)
    inverse = np.linalg.inv(joint)
    normal = design.T @ inverse @ design
    found = np.linalg.solve(normal, (design.T @ inverse @ y)[..., None])[..., 0]
    pulled = np.einsum("jkl,jl->jk", inverse, y - found @ design.T)
    likelihood = -0.5 * (pulled @ y + np.linalg.slogdet(joint)[1] + np.linalg.slogdet(normal)[1])
    weight = np.array([p for *_, p in ways]) * np.exp(likelihood - np.max(likelihood[1:]))
    weight /= weight.sum()
    out = []
    for j, (s, kind, single, _) in enumerate(ways):
        if j and weight[j] < LEAST:
            continue
        x = singles[single]
        to = s**2 * _kernels(at[:, None], t, slope)[kind] + x.squared * _kernels(x.within(at)[:, None], x.within(t))[0]
        a, b = (at[:, None], x.within(at)[:, None]) if full else (at, x.within(at))
        own = s**2 * _kernels(a, at, slope)[kind] + x.squared * _kernels(b, x.within(at))[0]
        share = to @ inverse[j]
        rest = wanted - share @ design
        free = rest @ np.linalg.inv(normal[j])
        variance = (
            own - share @ to.T + free @ rest.T
            if full
            else own + np.sum(free * rest, axis=1) - np.sum(share * to, axis=1)
        )
        out.append(_Curve(weight[j], mean + size * (wanted @ found[j] + to @ pulled[j]), size**2 * variance))
    return out


def _root(curves: list[_Curve], level: Floats, noise: Floats) -> Floats:
    """The symmetric root of the covariance of K - `level` beyond that of the line."""
    joint = sum(c.weight * (c.variance + np.outer(c.mean - level, c.mean - level)) for c in curves)
    values, vectors = np.linalg.eigh(joint - noise @ noise.T)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _beyond(curves: list[_Curve], level: Floats, known: Floats) -> Floats:
    """What the variance `known` lacks for `NORMAL_95` standard uncertainties around `level` to hold `HELD`."""
    from scipy.special import ndtr

    weight = np.array([c.weight for c in curves])
    off = np.stack([c.mean - level for c in curves])
    u = np.sqrt(np.maximum(np.stack([c.variance for c in curves]), 1e-300))
    low, high = np.zeros(level.size), np.max(np.abs(off) + 4.0 * u, axis=0)
    for _ in range(24):
        middle = 0.5 * (low + high)
        short = weight @ (ndtr((middle - off) / u) - ndtr((-middle - off) / u)) < HELD * weight.sum()
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return np.asarray(np.sqrt(np.maximum((high / NORMAL_95) ** 2 - known, 0.0)))
