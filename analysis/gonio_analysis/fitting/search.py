"""The search for the best parameters: a coarse grid, several short searches, one long one.

The shapes of these models are multi-modal in their roughness, so a search that starts anywhere ends anywhere.
Parameters move on their natural scale (logarithmic for lengths, widths and indices) inside bounds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.errors import ConfigError
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.forward import ByWavelength, apparent, averaging, pointlike
from gonio_analysis.fitting.objective import Objective, alone, softened
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.parameters import Family, Ior, Parameter, Values

if TYPE_CHECKING:
    from gonio.instrument import Rules

GRID_POINTS = 250
"""Values that a start is judged by."""
STARTS = 4
COARSE_U = 0.15
"""Relative uncertainty added while the start is sought."""
MOST = 5000
"""Values that a search begins with, of more than that."""
STEP = 1e-4
"""Central differences, on the search scale: an error of 1e-8 relative, far above the rounding of the models."""
SMALL_STEP = 1e-6
"""One-sided differences, on the search scale: good to about 1e-6, which is enough for the way to the solution."""


@dataclass(frozen=True)
class Problem:
    """Which numbers move, on which scale, and the model that they make."""

    family: Family
    make: Callable[[Mapping[str, Any]], Any]
    """Constructor's arguments -> model."""
    free: tuple[str, ...]
    fixed: Values
    words: dict[str, str]
    ior: Ior
    notes: list[str]
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Parameter -> what is known of it beforehand: value and standard uncertainty."""
    waves: tuple[float, ...] = ()
    """Wavelengths [nm] that are fitted together; none for a fit at one."""
    each: tuple[str, ...] = ()
    """Parameters with a value of their own at each of `waves`: "albedo" is then fitted as "albedo@450", ..."""

    asked: tuple[Any, ...] = ()
    """The arguments of `pose` that it was made from."""

    def __reduce__(self) -> tuple[Any, ...]:
        # the functions of a family do not pickle: another process makes the problem again
        return _posed, (self.asked, self.waves, self.each)

    def parameter(self, name: str) -> Parameter:
        """The parameter of a name in `free`."""
        return self.family.parameter(name.partition("@")[0])

    def at(self, values: Values, wavelength_nm: float) -> Values:
        """The values that hold at one of `waves`."""
        own = {n: values[f"{n}@{wavelength_nm:g}"] for n in self.each}
        return {n: x for n, x in values.items() if "@" not in n} | own

    def pulls(self, vector: Floats) -> Floats:
        """Residuals of the priors, one each."""
        values = self.values(vector)
        return np.array([(values[n] - value) / u for n, (value, u) in self.priors.items()])

    def pull_slopes(self, vector: Floats) -> Floats:
        """d(pulls)/d(search scale), (priors, p)."""
        slope = self.slope(vector)
        rows = [np.where([m == n for m in self.free], slope / u, 0.0) for n, (_, u) in self.priors.items()]
        return np.array(rows).reshape(len(rows), vector.size)

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds on the search scale."""
        rows = [self.parameter(n) for n in self.free]
        lower = [math.log(p.lower) if p.scale == "log" else p.lower for p in rows]
        upper = [math.log(p.upper) if p.scale == "log" else p.upper for p in rows]
        return np.array(lower), np.array(upper)

    def values(self, vector: Floats) -> Values:
        """All parameters by name, for a point of the search."""
        out = dict(self.fixed)
        for n, x in zip(self.free, vector, strict=True):
            p = self.parameter(n)
            out[n] = p.inside(math.exp(x) if p.scale == "log" else float(x))
        return out

    def vector(self, values: Values) -> Floats:
        """The point of the search that has these values, brought inside the bounds."""
        rows = [(self.parameter(n), values[n]) for n in self.free]
        return np.array([math.log(p.inside(v)) if p.scale == "log" else p.inside(v) for p, v in rows])

    def slope(self, vector: Floats) -> Floats:
        """d(value)/d(search scale) of the free parameters."""
        values = self.values(vector)
        return np.array([values[n] if self.parameter(n).scale == "log" else 1.0 for n in self.free])

    def known_slopes(self, vector: Floats) -> Values:
        """d(model)/d(search scale) [1/sr] of the parameters for which it is the same in every direction."""
        if self.each:
            return {}
        flat = self.family.flat(self.values(vector))
        return {n: flat[n] * scale for n, scale in zip(self.free, self.slope(vector), strict=True) if n in flat}

    def model(self, vector: Floats) -> Any:
        """The model at a point of the search."""
        values = self.values(vector)
        if not self.waves:
            return self.make({**self.family.arguments(values), **self.words})
        several = {w: self.make({**self.family.arguments(self.at(values, w)), **self.words}) for w in self.waves}
        return ByWavelength(several)


def pose(
    model: str,
    ior: Ior,
    fix: Mapping[str, float | str],
    free: Sequence[str],
    slopes: int,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
) -> Problem:
    """What to fit, from what a user asks for; see `gonio_analysis.fitting.fit.fit`.

    Raises
    ------
    ConfigError
        Unknown model, parameter or option, or nothing is left to fit.
    """
    notes: list[str] = []
    given = ior
    if ior is not None and not parameters.needs_ior(model) and set(parameters.parts(model)) <= set(parameters.FAMILIES):
        ior = None
        notes.append(f"The optical constants are not used: {model} has none.")
    family = parameters.family(model, slopes=slopes, ior=ior)
    words = {k: v for k, v in fix.items() if isinstance(v, str)}
    if words and len(parameters.parts(model)) > 1:
        raise ConfigError(f"--fix {next(iter(words))}=...: words go to a single model's constructor, not to a sum")
    numbers = {k: float(v) for k, v in fix.items() if not isinstance(v, str)}
    for n, value in numbers.items():
        p = family.parameter(n)
        if not p.lower <= value <= p.upper:
            raise ConfigError(f"--fix {n}={value:g}: {n} of {model} lies between {p.lower:g} and {p.upper:g}")
    for n in free:
        family.parameter(n)
        if n in numbers:
            raise ConfigError(f"{n} is given to --fix and to --free")
        if isinstance(ior, str) and n in ("ior", "k"):
            raise ConfigError(
                f"--free {n}: with --ior {ior} the material fixes n + ik; give numbers (as 1.5+2j) to start from"
            )
    names = tuple(p.name for p in family.parameters)
    moving = tuple(n for n in names if (n in family.free or n in free) and n not in numbers)
    if not moving:
        raise ConfigError(f"every parameter of {model} is fixed: there is nothing to fit")
    if "k" in moving and "ior" in moving:
        metallic = tuple(parameters.METALLIC_N if p.name == "ior" else p for p in family.parameters)
        family = replace(family, parameters=metallic)
    family = _bounded(family, bounds or {}, moving)
    fixed = {**family.fixed, **numbers}
    if ior is None and "ior" in moving and parameters.needs_ior(model) and not fixed.get("k") and "k" not in moving:
        notes.append("No optical constants were given (--ior): a real refractive index n is fitted, with k = 0.")
    return Problem(
        family,
        parameters.maker(model),
        moving,
        {n: v for n, v in fixed.items() if n not in moving},
        words,
        ior,
        notes,
        _checked_priors(priors or {}, model, moving),
        asked=(model, given, dict(fix), tuple(free), slopes, bounds, priors),
    )


def _posed(asked: tuple[Any, ...], waves: tuple[float, ...], each: tuple[str, ...]) -> Problem:
    problem = pose(*asked)
    return together(problem, waves, each) if waves else problem


def together(problem: Problem, waves: Sequence[float], each: Sequence[str]) -> Problem:
    """The same fit at several wavelengths together: parameters are shared but for those that `each` names.

    Raises
    ------
    ConfigError
        `each` names a parameter that is not fitted, or one with a prior.
    """
    for n in each:
        if n not in problem.free:
            raise ConfigError(f"--each {n}: {n} is not fitted; fitted are {', '.join(problem.free)}")
        if n in problem.priors:
            raise ConfigError(f"--each {n}: a prior of {n} would hold at every wavelength; give one or the other")
    shared = tuple(n for n in problem.free if n not in each)
    own = tuple(f"{n}@{w:g}" for n in problem.free if n in each for w in waves)
    return replace(problem, free=shared + own, waves=tuple(waves), each=tuple(n for n in problem.free if n in each))


def _bounded(family: Family, bounds: Mapping[str, tuple[float, float]], moving: Sequence[str]) -> Family:
    """The family with narrower bounds."""
    for n, (low, high) in bounds.items():
        p = family.parameter(n)
        if not p.lower <= low < high <= p.upper:
            raise ConfigError(
                f"--bound {n}={low:g}:{high:g}: bounds of {n} ascend, between {p.lower:g} and {p.upper:g}"
            )
        if n not in moving:
            raise ConfigError(f"--bound {n}={low:g}:{high:g}: {n} is not fitted; --free {n} would fit it")
    narrower = (
        replace(p, lower=bounds[p.name][0], upper=bounds[p.name][1]) for p in family.parameters if p.name in bounds
    )
    by_name = {p.name: p for p in narrower}
    return replace(family, parameters=tuple(by_name.get(p.name, p) for p in family.parameters))


def _checked_priors(
    priors: Mapping[str, tuple[float, float]], model: str, moving: Sequence[str]
) -> Mapping[str, tuple[float, float]]:
    for n, (value, u) in priors.items():
        if n not in moving:
            raise ConfigError(f"--prior {n}={value:g}: {n} of {model} is not fitted; it fits {', '.join(moving)}")
        if not (math.isfinite(value) and math.isfinite(u) and u > 0):
            raise ConfigError(
                f"--prior {n}: a value and its standard uncertainty above 0 are needed, as in {n}=1.77+-0.05"
            )
    return priors


def search_from(problem: Problem, data: Observations, starts: Sequence[Values], loss: str = "linear") -> Floats:
    """The best point of searches with the quick forward model that begin at solutions of relatives.

    As in `search` only the independent part of the covariance counts.
    """
    found = [approach(problem, data, problem.vector(start), loss) for start in starts]
    return min(found, key=lambda f: f[1])[0]


def search(problem: Problem, data: Observations, loss: str = "linear", searches: int = STARTS) -> Floats:
    """The best point of several searches with the quick forward model, the first part of each with softened weights.

    Only the independent part of the covariance counts here: common causes need a model to be scaled by.
    """
    rows = np.arange(len(data))
    few = data if len(data) <= GRID_POINTS else data.take(rows[:: -(-len(data) // GRID_POINTS)])
    soft = softened(few, COARSE_U)
    known = {n: v for n, v in problem.family.fixed.items() if n in problem.free and v}
    candidates: list[tuple[float, Floats]] = []
    starts = problem.family.starts(data)
    if "k" in problem.free and not known:
        shapes = {tuple((n, x) for n, x in start.items() if n != "ior"): None for start in starts}
        starts = [{**dict(shape), "ior": n, "k": k} for shape in shapes for n, k in parameters.INDICES]
    for start in starts:
        vector = problem.vector({"k": 1.0, **start, **known})
        residual = soft.residual(apparent(problem.model(vector), few, quick=True))
        # large residuals count by their logarithm: a lobe in the right place must win over one that is merely low
        candidates.append((float(np.log1p(np.minimum(residual**2, 1e12)).sum()), vector))
    candidates.sort(key=lambda c: c[0])
    coarse = [refine(problem, few, soft, vector, quick=True, limit=25) for _, vector in candidates[:searches]]
    coarse.sort(key=lambda c: c[1])
    others = [c for c in coarse[1:] if np.abs(c[0] - coarse[0][0]).max() > 0.05]
    chosen = [coarse[0], *others[: max(searches // 4, 1)]]
    return min((approach(problem, data, vector, loss) for vector, _ in chosen), key=lambda f: f[1])[0]


def approach(problem: Problem, data: Observations, start: Floats, loss: str = "linear") -> tuple[Floats, float]:
    """As `refine`, with the quick forward model and the independent part of the covariance; first on `MOST` values."""
    if len(data) > MOST:
        few = data.take(np.sort(np.random.default_rng(0).choice(len(data), MOST, replace=False)))
        start, _ = refine(problem, few, replace(alone(few), loss=loss), start, quick=True)
    return refine(problem, data, replace(alone(data), loss=loss), start, quick=True)


def refine(
    problem: Problem, data: Observations, goal: Objective, start: Floats, *, quick: bool = False, limit: int = 60
) -> tuple[Floats, float]:
    """Trust-region least squares from one start; the point and half its sum of squares.

    Derivatives are one-sided ones of the quick forward model, scaled to the full one; `settle` takes the last step with
    those of the full one. Averages over the cones are taken as was found good at the start.
    """
    from scipy.optimize import least_squares

    lower, upper = problem.bounds
    margin = 1e-9 * (upper - lower)
    latest = np.empty(len(data))
    rules = None if quick else averaging(problem.model(start), data)
    quick = quick or pointlike(data)

    def residual(x: Floats) -> Floats:
        latest[:] = apparent(problem.model(x), data, quick=quick, rules=rules)
        return np.concatenate([goal.residual(latest), problem.pulls(x)])

    def jacobian(x: Floats) -> Floats:
        near = latest if quick else apparent(problem.model(x), data, quick=True)
        columns = _one_sided(problem, data, x, near)
        if not quick:
            with np.errstate(divide="ignore", invalid="ignore"):
                columns = columns * np.nan_to_num(np.clip(latest / near, 0.2, 5.0), nan=1.0)[:, None]
        return np.concatenate([goal.jacobian(latest, columns), problem.pull_slopes(x)])

    result = least_squares(
        residual,
        np.clip(start, lower + margin, upper - margin),
        jac=jacobian,
        bounds=(lower, upper),
        x_scale="jac",
        loss=goal.loss,
        xtol=1e-9,
        ftol=1e-10 if quick else 1e-8,
        gtol=1e-12,
        max_nfev=limit,
    )
    return np.asarray(result.x), float(result.cost)


def settle(problem: Problem, data: Observations, goal: Objective, vector: Floats) -> tuple[Floats, Floats]:
    """One Gauss-Newton step with the full derivatives, if it helps; the point, and the Jacobian of the residuals there.

    A parameter that stays at a bound is put onto it.
    """
    lower, upper = problem.bounds
    rules = averaging(problem.model(vector), data)
    predicted = apparent(problem.model(vector), data, rules=rules)
    residual = np.concatenate([goal.residual(predicted), problem.pulls(vector)])
    robust = goal.robust_weights(residual)
    jacobian = goal.jacobian(predicted, derivatives(problem, data, vector, rules=rules))
    jacobian = np.concatenate([jacobian, problem.pull_slopes(vector)]) * robust[:, None]
    residual = residual * robust
    margin = 1e-6 * np.minimum(upper - lower, 1.0)
    inside = (vector > lower + margin) & (vector < upper - margin)
    step = np.zeros(vector.size)
    if inside.any():
        size = np.maximum(np.linalg.norm(jacobian[:, inside], axis=0), 1e-300)
        step[inside] = np.linalg.lstsq(jacobian[:, inside] / size, -residual, rcond=1e-10)[0] / size
    moved = np.clip(vector + np.clip(step, -0.1, 0.1), lower, upper)
    moved = np.where(moved <= lower + margin, lower, np.where(moved >= upper - margin, upper, moved))
    after = goal.residual(apparent(problem.model(moved), data, rules=rules))
    after = np.concatenate([after, problem.pulls(moved)]) * robust
    # a bound that is put on exactly may cost the last digits of the sum
    return (moved, jacobian) if after @ after <= (residual @ residual) * (1 + 1e-9) else (vector, jacobian)


def derivatives(
    problem: Problem,
    data: Observations,
    vector: Floats,
    *,
    quick: bool = False,
    rules: list[Rules] | None = None,
    only: Iterable[int] | None = None,
) -> Floats:
    """d(model)/d(search scale), (n, p); `only` names the columns, `quick` and `rules` are those of `apparent`.

    Exact for the level of a Lambertian part, else by central differences (one-sided at a bound).
    """
    lower, upper = problem.bounds
    known = problem.known_slopes(vector)
    columns = []
    for k in range(vector.size) if only is None else only:
        if problem.free[k] in known:
            columns.append(np.full(len(data), known[problem.free[k]]))
            continue
        up, down = vector.copy(), vector.copy()
        up[k] = min(vector[k] + STEP, upper[k])
        down[k] = max(vector[k] - STEP, lower[k])
        high, low = (apparent(problem.model(x), data, quick=quick, rules=rules) for x in (up, down))
        columns.append((high - low) / (up[k] - down[k]))
    return np.stack(columns, axis=1)


def _one_sided(problem: Problem, data: Observations, vector: Floats, here: Floats) -> Floats:
    """As `derivatives` of the quick model, from its values `here` and one more evaluation a parameter."""
    _, upper = problem.bounds
    known = problem.known_slopes(vector)
    columns = np.empty((vector.size, len(data)))
    for k, name in enumerate(problem.free):
        if name in known:
            columns[k] = known[name]
            continue
        moved = vector.copy()
        moved[k] += SMALL_STEP if vector[k] + SMALL_STEP <= upper[k] else -SMALL_STEP
        columns[k] = (apparent(problem.model(moved), data, quick=True) - here) / (moved[k] - vector[k])
    return columns.T


def covariance(jacobian: Floats) -> tuple[Floats, float]:
    """(J^T J)^-1 on the search scale, and the condition number of J with columns of unit length.

    A column of zeros (a parameter without any effect) gets an infinite variance.
    """
    size = np.linalg.norm(jacobian, axis=0)
    seen = size > 0
    out = np.full((size.size, size.size), 0.0)
    out[~seen, ~seen] = np.inf
    if not seen.any():
        return out, math.inf
    _, values, right = np.linalg.svd(jacobian[:, seen] / size[seen], full_matrices=False)
    values = np.maximum(values, 1e-12 * values[0])
    inner = (right.T / values**2) @ right / np.outer(size[seen], size[seen])
    out[np.ix_(seen, seen)] = inner
    return out, float(values[0] / values[-1]) if seen.all() else math.inf
