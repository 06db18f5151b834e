"""How well a fit knows its parameters: profile-likelihood intervals, and what the data cannot tell.

An interval is how far a parameter can go while all others follow as best they can.

A standard error looks at the curvature in one point. Where chi-square is no parabola (a lobe that hides behind the
noise, an index of refraction near a bound, two parameters that replace each other) an interval has to be walked out:
the parameter is held, the others are fitted again, and the ends lie where chi-square has risen by 3.84 (95 %).

The small fits use the neighbourhood of the solution, so that hundreds of them cost little. Near the solution the model
through the instrument's cones is the quick model (the lobe at the cones' centre, and the spike) times a ratio that
hardly changes. The ratio is taken from the solution.

What data cannot tell is found from the curvature of chi-square at the solution. Two parameters that replace each other
leave a valley along which chi-square hardly rises. Its direction is the eigenvector of the covariance with the largest
variance, on a relative scale for each parameter; what the data do determine is the combination across the valley, as
sigma0/tau of a very rough surface (He et al. 1991, eq. 78: g >> 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TypeVar

import numpy as np

from gonio.checks.values import Rows
from gonio.models.parameters import Values
from gonio.shown import interval, with_u
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.search import derivatives, refine, to_full
from gonio_analysis.fitting.solution import ROUNDING, Solution
from gonio_analysis.fitting.steps import gauss_newton

STEPS = 4
"""Most last steps of a small fit that holds parameters at their bounds."""


class Near:
    """The model of a fit for values of its parameters near the fitted ones, over all or some of its data."""

    def __init__(self, result: Solution, rows: Rows | None = None) -> None:
        self.problem, self.data, self.goal = result.problem, result.data, result.goal
        predicted = result.predicted
        if rows is not None:
            self.data, self.goal, predicted = self.data.take(rows), self.goal.take(rows), predicted[rows]
        self._ratio = to_full(predicted, apparent(result.model, self.data, quick=True))

    def predicted(self, vector: Floats) -> Floats:
        """The model [1/sr] at a point of the search scale."""
        return apparent(self.problem.model(vector), self.data, quick=True) * self._ratio

    def cost(self, vector: Floats) -> float:
        """What `refit` makes small: the sum of squares (or of the losses), priors included."""
        white = self.goal.residual(self.predicted(vector))
        return self.goal.total(np.concatenate([white, self.problem.pulls(vector)]))

    def refit(self, start: Floats, free: Rows, *, limit: int = 30) -> tuple[Floats, float]:
        """The best point with only the parameters `free` moving, and its sum of squares.

        A search stays some 1e-10 inside the bounds: where values near 0 are known to 1 %, an albedo of 1e-10 in place
        of 0 may cost more than anything else. Parameters at their bounds therefore move apart, by Newton's steps.
        """
        held = np.intersect1d(free, self._at_bound(start))
        x, total = self._apart(start, free, held, limit)
        ends = np.intersect1d(free, self._at_bound(x))
        if np.array_equal(ends, held):
            return x, total
        lower, upper = self.problem.bounds
        begin, come = x.copy(), np.setdiff1d(ends, held)
        begin[come] = np.where(x - lower < upper - x, lower, upper)[come]
        return min((x, total), self._apart(begin, free, ends, limit), key=lambda found: found[1])

    def _at_bound(self, x: Floats) -> Rows:
        """Parameters that are nearer to a bound than a search can tell."""
        lower, upper = self.problem.bounds
        return np.flatnonzero(np.minimum(x - lower, upper - x) <= 1e-6 * np.minimum(upper - lower, 1.0))

    def _apart(self, x: Floats, free: Rows, held: Rows, limit: int) -> tuple[Floats, float]:
        """As `refit`, with those `held` moving only by the last steps, which may end on a bound exactly."""
        moving = np.setdiff1d(free, held)
        if moving.size:
            x, half = refine(
                self.problem, self.data, self.goal, x, quick=True, limit=limit, free=moving, ratio=self._ratio
            )
        total = 2.0 * half if moving.size else self.cost(x)
        for _ in range(STEPS if held.size else 0):
            y = self._stepped(x, free)
            after = self.cost(y)
            if not after < total:
                break
            x, total = y, after
        return x, total

    def _stepped(self, x: Floats, free: Rows) -> Floats:
        """Where Newton's step ends of the parameters that no bound stops."""
        lower, upper = self.problem.bounds
        here = apparent(self.problem.model(x), self.data, quick=True)
        predicted = here * self._ratio
        columns = derivatives(self.problem, self.data, x, here=here, only=free) * self._ratio[:, None]
        slopes = np.concatenate([self.goal.jacobian(predicted, columns), self.problem.pull_slopes(x)[:, free]])
        residual = np.concatenate([self.goal.residual(predicted), self.problem.pulls(x)])
        robust = self.goal.robust_weights(residual)
        slopes, residual = slopes * robust[:, None], residual * robust
        downhill = -(slopes.T @ residual)
        open_ = ~((x <= lower)[free] & (downhill <= 0) | (x >= upper)[free] & (downhill >= 0))
        y, rows, slopes = x.copy(), free[open_], slopes[:, open_]
        if rows.size:
            y[rows] = np.clip(x[rows] + gauss_newton(slopes, residual), lower[rows], upper[rows])
        return y


POOR = 0.05
"""Relative standard error above which a parameter counts as poorly known."""
MOST = 8.0
"""Ratio of relative errors beyond which a product of powers says nothing that the better known one does not."""
TIED = 0.98
"""Correlation above which two parameters count as tied."""


def tied(names: tuple[str, ...], values: Floats, covariance: Floats) -> list[str]:
    """Sentences about pairs of parameters that are tied, and about what is known of them nevertheless.

    Parameters
    ----------
    names, values
        Fitted parameters.
    covariance
        Theirs; infinite or zero entries belong to parameters that the data do not see.
    """
    u = np.sqrt(np.diag(covariance))
    out = []
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            if not (np.isfinite(u[[i, j]]).all() and u[i] > 0 and u[j] > 0 and values[i] != 0 and values[j] != 0):
                continue
            r = float(covariance[i, j] / (u[i] * u[j]))
            if abs(r) <= TIED:
                continue
            relative = float(u[i] / abs(values[i])), float(u[j] / abs(values[j]))
            poor = max(relative) > POOR
            text = f"{b} and {a} " + ("can hardly be told apart by these data" if poor else "are strongly correlated")
            text += f" (correlation {r:+.4f})"
            known = _combination((b, a), (values[j], values[i]), (relative[1], relative[0]), r)
            if known:
                text += f"; {'what they determine is' if poor else 'better known than either is'} {known}"
            out.append(text + ".")
    return out


def _combination(names: tuple[str, str], values: tuple[float, float], u: tuple[float, float], r: float) -> str:
    """The best known product of powers of two parameters, with its standard error; "" where none is better known."""
    # d ln a and d ln b move together in the ratio u_a : sign u_b; a^p b^q stays where p u_a + q sign u_b = 0
    ratio = u[0] / u[1]
    if not 1 / MOST <= ratio <= MOST:
        return ""
    power = Fraction(ratio).limit_denominator(4)
    p, q = (1.0, -math.copysign(float(power), r)) if power > 0 else (1.0, -math.copysign(ratio, r))
    if power > 0 and abs(float(power) - ratio) > 0.1 * ratio:
        q = -math.copysign(ratio, r)
    spread = math.sqrt(max((p * u[0]) ** 2 + (q * u[1]) ** 2 + 2 * p * q * r * u[0] * u[1], 0.0))
    if spread > 0.5 * min(1.0, *u):  # hardly better known than the parameters
        return ""
    value = values[0] ** p * abs(values[1]) ** q
    exponent = "" if abs(q) == 1.0 else f"^{abs(q):.3g}"
    sign = "/" if q < 0 else " "
    return f"{names[0]}{sign}{names[1]}{exponent} = {with_u(value, spread * abs(value))}"


Found = TypeVar("Found", bound=Solution)
LEVEL = 0.95
TRIES = 14
"""Small fits a side."""
CLOSE = 0.02
"""An end is found where sqrt(rise of chi-square) is this close to what it has to be."""
STEEP = 3.0
"""Farther from the threshold than this factor, up or down, sqrt(rise) is not taken as a straight line to the end."""
BETTER = 0.1
"""A fall of chi-square by more than this on the way means that the solution was none."""


@dataclass(frozen=True)
class Interval:
    """One parameter's interval, and the profile that it was read from."""

    name: str
    low: float
    high: float
    open_low: bool
    """The interval ends on the parameter's bound: the data set no lower limit above it."""
    open_high: bool
    level: float
    values: Floats
    """Parameter values that were tried, ascending."""
    rise: Floats
    """chi-square there, less its minimum."""

    @property
    def ends(self) -> tuple[tuple[float, bool], tuple[float, bool]]:
        """Lower and upper end, and whether each is a bound."""
        return (self.low, self.open_low), (self.high, self.open_high)

    def __repr__(self) -> str:
        words = interval(self.low, self.high, float(self.values[int(np.argmin(self.rise))]))
        low, high = (word + " (bound)" * is_open for word, (_, is_open) in zip(words, self.ends, strict=False))
        return f"<{100 * self.level:g} % interval of {self.name}: {low} to {high}>"

    def summary(self) -> dict[str, object]:
        """Plain numbers."""
        ends = {name: getattr(self, name) for name in ("low", "high", "open_low", "open_high", "level")}
        return {**ends, "profile": {"values": self.values, "rise": self.rise}}

    def extended(self, other: Interval) -> Interval:
        """This interval, with the ends of another one of the same parameter where they lie farther out."""
        low, high = min(self, other, key=lambda i: i.low), max(self, other, key=lambda i: i.high)
        return replace(self, low=low.low, open_low=low.open_low, high=high.high, open_high=high.open_high)

    def linear(self, value: float, u: float | None) -> bool:
        """Whether a standard error says the same: both halves of the interval are its multiple, within a factor of 2.

        A half that ends on a bound says nothing against a standard error that is longer.
        """
        if u is None or not math.isfinite(u) or u <= 0:
            return False
        from scipy.special import ndtri

        half = u * float(ndtri(0.5 * (1.0 + self.level)))
        found = ((value - self.low, self.open_low), (self.high - value, self.open_high))
        ratios = [(max(length, 0.0) / half, is_open) for length, is_open in found]
        return all(0.5 <= ratio <= 2.0 for ratio, is_open in ratios if not is_open) and not all(o for _, o in ratios)

    def holds(self, value: float) -> bool:
        """Whether a value lies inside."""
        slack = 1e-9 * max(abs(self.low), abs(self.high))
        return self.low - slack <= value <= self.high + slack


@dataclass(frozen=True)
class Profiles:
    """The intervals of a fit's free parameters."""

    intervals: dict[str, Interval]
    better: Floats | None = None
    """A point of the search scale with a lower chi-square, met on the way: fit again from there."""


def profiles(result: Solution, names: tuple[str, ...] | None = None, *, level: float = LEVEL) -> Profiles:
    """Profile-likelihood intervals of the fitted parameters.

    Parameters
    ----------
    result
        A fit.
    names
        The free parameters to profile; all of them by default.
    level
        Probability that an interval holds the truth.

    Returns
    -------
    Profiles
        Of a model with a misfit (docs/misfit.md) there is no profile: the intervals are those of its standard errors.
        By a metric that does not weigh, the rise of chi-square is in units of the scatter of the residuals.
    """
    if result.misfit is not None:
        return Profiles({name: _linear(result, name, level) for name in result.free if names is None or name in names})
    walker = _Walker(result)
    threshold = math.sqrt(rise(result, level))
    out: dict[str, Interval] = {}
    for name in result.free if names is None else names:
        k = result.free.index(name)
        points = [(float(result.vector[k]), 0.0)]
        ends = []
        for side in (-1, 1):
            end, tried = walker.walk(k, side, threshold)
            points += tried
            ends.append(end)
        points.sort()
        out[name] = _interval(result, name, k, ends, points, level)
    return Profiles(out, walker.better)


def walked(
    result: Found, again: Callable[[list[Values]], Found], names: tuple[str, ...] | None = None, *, level: float = LEVEL
) -> tuple[Found, dict[str, Interval]]:
    """A fit and its intervals; or, where walking them out meets a lower chi-square, those of the fit that begins there.

    Parameters
    ----------
    result
        A fit.
    again
        Fits once more, from these sets of values.
    names, level
        As for `profiles`.
    """
    found = profiles(result, names, level=level)
    if found.better is not None:
        other = again([result.problem.values(found.better)])
        if other.goal.total(other.whitened) < result.goal.total(result.whitened):
            result, found = other, profiles(other, names, level=level)
    return result, found.intervals


def rise(result: Solution, level: float) -> float:
    """Rise of chi-square at the ends of a single parameter's interval (dimensionless).

    Without stated uncertainties it is in units of the scatter of the residuals.
    """
    from scipy.special import chdtri, fdtri

    if result.goal.whitened:
        return float(chdtri(1, 1.0 - level))
    return float(fdtri(1, len(result.data) - len(result.free), level))


def _linear(result: Solution, name: str, level: float) -> Interval:
    """An interval by the standard error."""
    from scipy.special import ndtri

    k = result.free.index(name)
    lower, upper = result.problem.bounds
    variance = float(result.spread[k, k])
    far = float(ndtri(0.5 * (1.0 + level))) * math.sqrt(variance) if math.isfinite(variance) else math.inf
    place = float(result.vector[k])
    ends = [max(place - far, float(lower[k])), min(place + far, float(upper[k]))]
    return _interval(result, name, k, ends, [], level)


def _interval(
    result: Solution, name: str, k: int, ends: list[float], points: list[tuple[float, float]], level: float
) -> Interval:
    lower, upper = result.problem.bounds
    parameter = result.problem.parameter(name)
    value = [math.exp(x) if parameter.scale == "log" else x for x in (*ends, *(x for x, _ in points))]
    return Interval(
        name,
        parameter.inside(value[0]),
        parameter.inside(value[1]),
        bool(ends[0] <= lower[k]),
        bool(ends[1] >= upper[k]),
        level,
        np.array(value[2:]),
        np.array([r for _, r in points]),
    )


class _Walker:
    """Walks along one parameter at a time, with all others fitted."""

    def __init__(self, result: Solution) -> None:
        self._result = result
        self._lower, self._upper = result.problem.bounds
        self._near = Near(result)
        self._least = self._near.cost(result.vector)
        freedom = max(len(result.data) - len(result.free), 1)
        self._unit = 1.0 if result.goal.whitened else max(self._least / freedom, ROUNDING)
        self.better: Floats | None = None

    def _held(self, k: int, start: Floats) -> tuple[Floats, float]:
        """The best point with parameter k held, and the rise of chi-square there."""
        x, total = self._near.refit(start, np.delete(np.arange(start.size), k))
        rise = (total - self._least) / self._unit
        if rise < -BETTER and self.better is None:
            self.better = x
        return x, rise

    def _start(self, k: int, place: float, near: Floats, move: Floats) -> Floats:
        """Where the others begin with parameter k held at a place: as they were near it, or moved along the valley."""
        starts = [np.clip(x, self._lower, self._upper) for x in (near, near + move)]
        for x in starts:
            x[k] = place
        return min(starts, key=self._near.cost)

    def _elsewhere(self, k: int, x: Floats) -> list[Floats]:
        """Other starting points: n and k trade off along a curved valley, which one step cannot follow."""
        problem = self._result.problem
        if not {"ior", "k"} <= set(problem.free):
            return []
        known = problem.values(x)
        starts = [problem.vector({**known, "ior": ior, "k": absorption}) for ior, absorption in parameters.INDICES]
        for start in starts:
            start[k] = x[k]
        return starts

    def walk(self, k: int, side: int, threshold: float) -> tuple[float, list[tuple[float, float]]]:
        """The end [search scale] on one side, and the points (place, rise) that were tried."""
        best = self._result.vector
        centre = float(best[k])
        bound = float(self._upper[k] if side > 0 else self._lower[k])
        left = abs(bound - centre)
        if left <= 1e-9 * (self._upper[k] - self._lower[k]):
            return bound, []
        variance = float(self._result.spread[k, k])
        step = threshold * math.sqrt(variance) if math.isfinite(variance) and variance > 0 else left
        follow = self._result.spread[:, k] / variance if 0 < variance < math.inf else np.zeros(best.size)
        step = min(step, left)
        inside, outside = (0.0, 0.0), (math.inf, math.inf)  # (distance from the centre, root of the rise)
        known = {0.0: best}
        tried: list[tuple[float, float]] = []
        for attempt in range(TRIES):
            if math.isinf(outside[0]) and attempt == TRIES // 2:
                step = left  # chi-square hardly rises: is there an end before the bound?
            nearest = min(known, key=lambda d: abs(d - step))
            place = bound if step >= left else centre + side * step
            x, rise = self._held(
                k, self._start(k, place, known[nearest], np.nan_to_num(follow) * side * (step - nearest))
            )
            if rise >= threshold**2:  # before it counts as too far, other valleys are tried
                others = [self._held(k, other) for other in self._elsewhere(k, x)]
                x, rise = min([(x, rise), *others], key=lambda found: found[1])
            known[step] = x
            root = math.sqrt(max(rise, 0.0))
            tried.append((float(x[k]), max(rise, 0.0)))
            if root < threshold:
                if step >= left:
                    return bound, tried
                inside = (step, root)
            else:
                outside = (step, root)
            if abs(root - threshold) < CLOSE:
                break
            step = _next(inside, outside, threshold, left)
        if abs(root - threshold) < CLOSE:
            return centre + side * step, tried
        straight = outside[1] < STEEP * threshold and inside[1] > threshold / STEEP
        distance = _next(inside, outside, threshold, left) if straight else min(outside[0], left)
        return centre + side * distance, tried


def _next(inside: tuple[float, float], outside: tuple[float, float], threshold: float, left: float) -> float:
    """Where the root of the rise should meet the threshold: it is nearly a straight line, but not over a long way."""
    if math.isinf(outside[0]):
        grow = threshold / inside[1] if inside[1] > 0 else 4.0
        return min(inside[0] * min(max(1.02 * grow, 1.05), 4.0), left)
    if outside[1] > STEEP * threshold:
        return 0.5 * (inside[0] + outside[0])
    share = (threshold - inside[1]) / (outside[1] - inside[1])
    return inside[0] + min(max(share, 0.02), 0.98) * (outside[0] - inside[0])
