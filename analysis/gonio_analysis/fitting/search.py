"""The optimiser: a coarse grid, several short searches, one long one, and the derivatives that they need.

The shapes of these models are multi-modal in their roughness, so a search that starts anywhere ends anywhere.
Parameters move on their natural scale (logarithmic for lengths, widths and indices) inside bounds.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from gonio.cli.pace import Pace, Say, silent
from gonio.models.declaration import Values
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.forward import apparent, averaging, pointlike
from gonio_analysis.fitting.objective import Objective, alone, softened
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import STARTS, Problem

if TYPE_CHECKING:
    from gonio.instrument import Rules

GRID_POINTS = 250
"""Values that a start is judged by."""
COARSE_U = 0.15
"""Relative uncertainty added while the start is sought."""
MOST = 5000
"""Values that a search begins with, of more than that."""
HIGHEST = ("ngan", "cube-root", "relative")
"""Metrics whose valleys are sought apart from that of the logarithms."""
AT_BOUND = 1e-3
"""Closer to a bound than this part of its range a parameter has come to its end."""
SHORT = 12
"""Steps of a search that begins again inside a bound: enough to see which of several goes lowest."""
STEP = 1e-4
"""Central differences, on the search scale: an error of 1e-8 relative, far above the rounding of the models."""
SMALL_STEP = 1e-6
"""One-sided differences, on the search scale: good to about 1e-6, which is enough for the way to the solution."""


def search_from(
    problem: Problem,
    data: Observations,
    starts: Sequence[Values],
    loss: str = "linear",
    metric: str | None = None,
    say: Say = silent,
) -> Floats:
    """The best point of searches with the quick forward model that begin at solutions of relatives.

    As in `search` only the independent part of the covariance counts.
    """
    found = [approach(problem, data, problem.vector(start), loss, metric, say) for start in starts]
    return min(found, key=lambda f: f[1])[0]


def search(
    problem: Problem,
    data: Observations,
    loss: str = "linear",
    searches: int = STARTS,
    metric: str | None = None,
    say: Say = silent,
) -> Floats:
    """The best point of several searches with the quick forward model, the first part of each with softened weights.

    Only the independent part of the covariance counts here: common causes need a model to be scaled by.
    """
    rows = np.arange(len(data))
    few = data if len(data) <= GRID_POINTS else data.take(rows[:: -(-len(data) // GRID_POINTS)])
    soft = softened(few, COARSE_U)
    known = {n: v for n, v in problem.family.fixed.items() if n in problem.free and v}
    candidates: list[tuple[float, Floats]] = []
    starts = problem.family.starts(parameters.levels(data))
    if "k" in problem.free and not known:
        shapes = {tuple((n, x) for n, x in start.items() if n != "ior"): None for start in starts}
        starts = [{**dict(shape), "ior": n, "k": k} for shape in shapes for n, k in parameters.INDICES]
    pace = Pace("fitting: starts tried", len(starts), say)
    for k, start in enumerate(starts):
        pace.step(k)
        vector = problem.vector({"k": 1.0, **start, **known})
        residual = soft.residual(apparent(problem.model(vector), few, quick=True))
        # large residuals count by their logarithm: a lobe in the right place must win over one that is merely low
        candidates.append((float(np.log1p(np.minimum(residual**2, 1e12)).sum()), vector))
    candidates.sort(key=lambda c: c[0])
    coarse = [refine(problem, few, soft, vector, quick=True, limit=25) for _, vector in candidates[:searches]]
    coarse.sort(key=lambda c: c[1])
    others = [c for c in coarse[1:] if np.abs(c[0] - coarse[0][0]).max() > 0.05]
    chosen = [coarse[0], *others[: max(searches // 4, 1)]]
    begin = [vector for vector, _ in chosen]
    if metric in HIGHEST:  # its valley may be another one than that of the logarithms
        brightest = _with_brightest(few, data)
        goal = alone(brightest, metric)
        by_metric = [
            (float((goal.residual(apparent(problem.model(v), brightest, quick=True)) ** 2).sum()), v)
            for _, v in candidates
        ]
        by_metric.sort(key=lambda c: c[0])
        near = [refine(problem, brightest, goal, v, quick=True, limit=25) for _, v in by_metric[:searches]]
        begin += [min(near, key=lambda c: c[1])[0]]
    found = min((approach(problem, data, vector, loss, metric, say) for vector in begin), key=lambda f: f[1])
    if inside := _inside(problem, found[0], [vector for _, vector in candidates]):
        goal = replace(alone(few, metric), loss=loss)
        short = [refine(problem, few, goal, vector, quick=True, limit=SHORT) for vector in inside]
        again = approach(problem, data, min(short, key=lambda f: f[1])[0], loss, metric, say)
        found = min(found, again, key=lambda f: f[1])
    return found[0]


def _inside(problem: Problem, found: Floats, starts: Sequence[Floats]) -> list[Floats]:
    """Where to begin again where a search ended on a bound: the same point, with a start in place of the bound.

    A level and an index replace each other along a long valley, which a search may leave by the wrong end. Levels at a
    bound are where they belong: the model is linear in them.
    """
    lower, upper = problem.bounds
    close = AT_BOUND * (upper - lower)
    levels = set(problem.known_slopes(found))
    out = []
    for k in np.flatnonzero((found <= lower + close) | (found >= upper - close)):
        if problem.free[k] in levels:
            continue
        values = np.unique([start[k] for start in starts])
        for value in np.union1d(values, 0.5 * (values[1:] + values[:-1])):
            if lower[k] + close[k] < value < upper[k] - close[k]:
                out.append(np.where(np.arange(found.size) == k, value, found))
    return out


def _with_brightest(few: Observations, data: Observations) -> Observations:
    """A few values, and as many of the highest ones, which govern some metrics."""
    highest = np.sort(np.argsort(data.brdf)[-GRID_POINTS:])
    rows = np.union1d(np.flatnonzero(np.isin(data.rows, few.rows)), highest)
    return data.take(rows)


def approach(
    problem: Problem,
    data: Observations,
    start: Floats,
    loss: str = "linear",
    metric: str | None = None,
    say: Say = silent,
) -> tuple[Floats, float]:
    """As `refine`, with the quick forward model and the independent part of the covariance; first on `MOST` values."""
    if len(data) > MOST:
        few = data.take(np.sort(np.random.default_rng(0).choice(len(data), MOST, replace=False)))
        few = _with_brightest(few, data) if metric in HIGHEST else few
        start, _ = refine(problem, few, replace(alone(few, metric), loss=loss), start, quick=True)
    return refine(problem, data, replace(alone(data, metric), loss=loss), start, quick=True, say=say)


def refine(
    problem: Problem,
    data: Observations,
    goal: Objective,
    start: Floats,
    *,
    quick: bool = False,
    limit: int = 60,
    say: Say = silent,
) -> tuple[Floats, float]:
    """Trust-region least squares from one start; the point and half its sum of squares.

    Derivatives are one-sided ones of the quick forward model, scaled to the full one; `settle` takes the last step with
    those of the full one. Averages over the cones are taken as was found good at the start.
    """
    from scipy.optimize import least_squares

    lower, upper = problem.bounds
    margin = 1e-9 * (upper - lower)
    latest = np.empty(len(data))
    pace, steps = Pace("fitting: trial points", limit, say, at_most=True), count()
    rules = None if quick else averaging(problem.model(start), data)
    quick = quick or pointlike(data)

    def residual(x: Floats) -> Floats:
        pace.step(next(steps))
        latest[:] = apparent(problem.model(x), data, quick=quick, rules=rules)
        return np.concatenate([goal.residual(latest), problem.pulls(x)])

    def jacobian(x: Floats) -> Floats:
        near = latest if quick else apparent(problem.model(x), data, quick=True)
        columns = one_sided(problem, data, x, near)
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
    rules: list[Rules | None] | None = None,
    only: Iterable[int] | None = None,
) -> Floats:
    """d(model)/d(search scale), (n, p); `only` names the columns, `quick` and `rules` are those of `apparent`.

    Exact for the level of a Lambertian part, else by central differences (one-sided at a bound).
    """
    lower, upper = problem.bounds
    known = problem.known_slopes(vector)
    asked = list(range(vector.size) if only is None else only)
    columns = np.empty((vector.size, len(data)))
    for k in (k for k in asked if problem.free[k] in known):
        columns[k] = known[problem.free[k]]
    for together in problem.moved_together(k for k in asked if problem.free[k] not in known):
        up, down = vector.copy(), vector.copy()
        up[together] = np.minimum(vector[together] + STEP, upper[together])
        down[together] = np.maximum(vector[together] - STEP, lower[together])
        high, low = (apparent(problem.model(x), data, quick=quick, rules=rules) for x in (up, down))
        for k in together:
            columns[k] = _own(problem, data, k, (high - low) / (up[k] - down[k]))
    return columns[asked].T


def _own(problem: Problem, data: Observations, k: int, column: Floats) -> Floats:
    """A derivative where the parameter counts: at its own wavelength, or everywhere."""
    wave = problem.own_wavelength(k)
    return column if wave is None else np.where(data.wavelength_nm == wave, column, 0.0)


def one_sided(
    problem: Problem, data: Observations, vector: Floats, here: Floats, *, only: Iterable[int] | None = None
) -> Floats:
    """As `derivatives` of the quick model, from its values `here` and one more evaluation a parameter."""
    _, upper = problem.bounds
    known = problem.known_slopes(vector)
    columns = np.empty((vector.size, len(data)))
    asked = list(range(vector.size) if only is None else only)
    for k in (k for k in asked if problem.free[k] in known):
        columns[k] = known[problem.free[k]]
    for together in problem.moved_together(k for k in asked if problem.free[k] not in known):
        moved = vector.copy()
        moved[together] += np.where(vector[together] + SMALL_STEP <= upper[together], SMALL_STEP, -SMALL_STEP)
        rise = apparent(problem.model(moved), data, quick=True) - here
        for k in together:
            columns[k] = _own(problem, data, k, rise / (moved[k] - vector[k]))
    return columns[asked].T


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
