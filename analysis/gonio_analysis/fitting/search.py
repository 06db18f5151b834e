"""The optimiser: a coarse grid, several short searches, one long one, and the derivatives that they need.

The shapes of these models are multi-modal in their roughness, so a search that starts anywhere ends anywhere.
Parameters move on their natural scale (logarithmic for lengths, widths and indices) inside bounds.

For He-Torrance the grid has 99 points of sigma0/lambda and slope, judged by logarithms. The best four points are
searched, the best two of these with the true weights. Where the data reject what was found, the best point of every
other width is tried. Where they do not, and the surface has more than one parameter, the profile of chi-square over
its width shows other valleys. Of 2400 drawn He-Torrance tables (100 values, noise of 1 %) 4 end in a wrong one, by 0.2
to 1 of chi-square; without the profile 2 to 5 % did, by up to 37. Where n and k are both free, the solution's shape is
tried with other metals. The last search averages the lobe over the cones to 1e-5. Of more than 1000 values 1000 are
searched, and the best end is refined on all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import count, pairwise
from typing import Any

import numpy as np

from gonio.checks.values import Rows
from gonio.models.parameters import Values
from gonio.progress import Pace, Say, silent
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.forward import Averaging, apparent, averaging, pointlike
from gonio_analysis.fitting.objective import Objective, alone, softened
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem, acceptable
from gonio_analysis.fitting.steps import last_step

GRID_POINTS = 250
"""Values that a start is judged by."""
COARSE_U = 0.15
"""Relative uncertainty added while the start is sought."""
MOST = 1000
"""Values that are searched, of more than that; the least end is then refined on all."""
HIGHEST = ("ngan", "cube-root", "relative")
"""Metrics whose valleys are sought apart from that of the logarithms."""
AT_BOUND = 1e-3
"""Closer to a bound than this part of its range a parameter has come to its end."""
APART = 0.05
"""Distance on the search scale: starts that are nearer to each other are one."""
SHORT = 12
"""Steps of a search that begins again inside a bound: enough to see which of several goes lowest."""
LONG = 2000
"""Evaluations of a search that goes on to its end: levels and an index may replace each other along a bent valley."""
INSIDE, DOGLEG = 60, 300
"""Evaluations of a long search by steps inside the bounds, and then by those that end on them; the rest goes inside.
Of 60 searches with n and k free that took 110 to 2000, none then took more than 400, and none ended higher."""
BRIEF = INSIDE + DOGLEG + 1
"""Evaluations of several searches before the least of them alone goes on: others creep along the same valley."""
PROFILED = 5
"""Evaluations at a width of the profile, each but the last followed by a step."""
NEAR = 25.0
"""Other valleys of the profile are searched where half their chi-square is at most so much above its least."""
FAR = 30.0
"""Between widths whose cost is at most so many times that the profile is looked at once more."""
STEP = 1e-4
"""Central differences, on the search scale: an error of 1e-8 relative, far above the rounding of the models."""
SMALL_STEP = 1e-6
"""One-sided differences, on the search scale: good to about 1e-6, which is enough for the way to the solution."""
LARGEST = 1e6
"""Residual that counts, at most, where starts are judged."""
LEVELLED = 3
"""Steps to the level of a Lambertian part."""


def search_from(
    problem: Problem, data: Observations, starts: Sequence[Values], say: Say = silent
) -> list[tuple[Floats, float]]:
    """As `search`, of searches with the quick forward model that begin at solutions of relatives."""
    some = _some(problem, data)
    ends = _apart(sorted(_approaches(problem, some, map(problem.vector, starts), say), key=lambda f: f[1]))
    return ends if some is data else _of_all(problem, data, len(some), ends, say)


def _approaches(problem: Problem, data: Observations, starts: Iterable[Floats], say: Say) -> list[tuple[Floats, float]]:
    """Where searches from several starts end; only the least one goes on beyond `BRIEF`."""
    goal = replace(alone(data, problem.asked.metric), loss=problem.asked.loss)
    ends = [refined(problem, data, goal, start, quick=True, limit=BRIEF, say=say) for start in starts]
    best, *others = sorted(ends, key=lambda f: f[1])
    return [best[:2] if best[2] else approach(problem, data, best[0], say), *(one[:2] for one in others)]


def _some(problem: Problem, data: Observations) -> Observations:
    """At most `MOST` of the values, and as many of the highest ones for metrics that these govern."""
    if len(data) <= MOST:
        return data
    some = data.take(np.sort(np.random.default_rng(0).choice(len(data), MOST, replace=False)))
    return _with_brightest(some, data) if problem.asked.metric in HIGHEST else some


def _of_all(
    problem: Problem, data: Observations, searched: int, ends: Sequence[tuple[Floats, float]], say: Say
) -> list[tuple[Floats, float]]:
    """Ends of a search on some values: the first one refined on all, the others with what they may cost there."""
    return [approach(problem, data, ends[0][0], say), *((x, cost * len(data) / searched) for x, cost in ends[1:])]


def _apart(ends: Sequence[tuple[Floats, float]]) -> list[tuple[Floats, float]]:
    """Ends without those that are one with an earlier one."""
    apart: list[tuple[Floats, float]] = []
    for end in ends:
        if all(np.abs(end[0] - other).max() > APART for other, _ in apart):
            apart.append(end)
    return apart


def search(problem: Problem, data: Observations, say: Say = silent) -> list[tuple[Floats, float]]:
    """Where several searches with the quick forward model end, the first part of each with softened weights.

    Points and half their sums of squares, the least one first; the others, `APART` from it and each other, may be a few
    steps from their ends. Only the independent part of the covariance counts here: common causes need a model to be
    scaled by.
    """
    asked, some = problem.asked, _some(problem, data)
    if some is not data:
        return _of_all(problem, data, len(some), search(problem, some, say), say)
    few = data if len(data) <= GRID_POINTS else data.take(np.arange(len(data))[:: -(-len(data) // GRID_POINTS)])
    starts = _starts(problem, data)
    candidates = _levelled(problem, few, starts, say)
    coarse = _coarse(problem, few, softened(few, COARSE_U), candidates)
    others = [vector for vector, _ in coarse[1:] if np.abs(vector - coarse[0][0]).max() > APART]
    begin = [coarse[0][0], *others[: max(asked.searches // 4, 1)]]
    if asked.metric in HIGHEST:  # its valley may be another one than that of the logarithms
        brightest = _with_brightest(few, data)
        goal = alone(brightest, asked.metric)
        costs = [goal.residual(apparent(problem.model(v), brightest, quick=True)) ** 2 for v in starts]
        by_metric = [(float(cost.sum()), v) for cost, v in zip(costs, starts, strict=True)]
        begin.append(_coarse(problem, brightest, goal, by_metric)[0][0])
    ends = _approaches(problem, data, begin, say)
    found = min(ends, key=lambda f: f[1])
    goal = replace(alone(few, asked.metric), loss=asked.loss)
    if inside := _inside(problem, found[0], starts) + _of_other_indices(problem, few, goal, found[0]):
        more = [refine(problem, few, goal, vector, quick=True, limit=INSIDE) for vector in inside]
        found = min(found, approach(problem, data, min(more, key=lambda f: f[1])[0], say), key=lambda f: f[1])
        ends += [(vector, cost * len(data) / len(few)) for vector, cost in more]
    if asked.metric is None and asked.loss == "linear" and data.covariance is not None and data.u_rel_assumed is None:
        found = _beyond(problem, data, few, found, candidates, say)
    return _apart([found, *sorted(ends, key=lambda f: f[1])])


def _beyond(
    problem: Problem, data: Observations, few: Observations, found: tuple[Floats, float],
    candidates: Sequence[tuple[float, Floats]], say: Say,
) -> tuple[Floats, float]:  # fmt: skip
    """The best of searches that begin in other valleys: at the best start of each width while the data reject the best.

    Where they do not, and the surface has more than one parameter, at the valleys of the profile over the width.
    """
    soft, goal = softened(few, COARSE_U), alone(few)
    shapes = [k for k, n in enumerate(problem.free) if problem.parameter(n).geometry]
    starts: dict[float, Floats] = {}
    for _, vector in sorted(candidates, key=lambda c: c[0]) if shapes else ():
        starts.setdefault(float(vector[shapes[0]]), vector)
    best, ends = (found if few is data else refine(problem, few, goal, found[0], quick=True)), [found[0]]
    limit = 0.5 * float(acceptable(len(few) - best[0].size))
    for vector in starts.values():
        if best[1] <= limit:
            break
        vector = refine(problem, few, soft, vector, quick=True, limit=SHORT)[0]
        if min(np.abs(vector - end).max() for end in ends) > APART:
            ends.append(vector)
            best = min(best, refine(problem, few, goal, vector, quick=True), key=lambda f: f[1])
    if len(shapes) > 1 and best[1] <= limit:
        for vector in _valleys(problem, few, goal, best[0], shapes[0], [starts[w] for w in sorted(starts)]):
            best = min(best, refine(problem, few, goal, vector, quick=True), key=lambda f: f[1])
    if np.abs(best[0] - found[0]).max() <= APART:
        return found
    return min(found, approach(problem, data, best[0], say), key=lambda f: f[1])


def _valleys(
    problem: Problem, data: Observations, goal: Objective, known: Floats, width: int, starts: Sequence[Floats]
) -> list[Floats]:
    """The valleys of the profile over the width that a search may miss, that of the `known` point left out.

    The profile is known at the widths of the starts, and half-way between them where both neighbours are low.
    """
    profile = [_holding([width], problem, data, goal, start, PROFILED) for start in starts]
    low = min(cost for cost, _ in profile) + NEAR
    if not math.isfinite(low):
        return []
    for (a, left), (b, right) in list(pairwise(profile)):
        if max(a, b) < FAR * low:
            profile.append(_holding([width], problem, data, goal, 0.5 * (left + right), PROFILED - 2))
    profile.sort(key=lambda found: float(found[1][width]))
    costs = np.array([np.inf, *(cost for cost, _ in profile), np.inf])
    here = costs[1:-1]
    rows = np.flatnonzero((here <= costs[:-2]) & (here <= costs[2:]) & (here < low)).tolist()
    nearest = int(np.argmin([abs(x[width] - known[width]) for _, x in profile]))
    own = min(rows, key=lambda row: abs(row - nearest))
    return [profile[row][1] for row in rows if row != own or abs(row - nearest) > 1]


def _of_other_indices(problem: Problem, data: Observations, goal: Objective, found: Floats) -> list[Floats]:
    """Where to begin again where nothing is known of n and k: a glass and metals, whose lobes are much alike."""
    if "k" not in problem.free or problem.family.fixed.get("k"):
        return []
    values, held = problem.values(found), [k for k, n in enumerate(problem.free) if n in ("ior", "k")]
    starts = [problem.vector({**values, "ior": n, "k": k}) for n, k in parameters.INDICES]
    return [_holding(held, problem, data, goal, start, PROFILED)[1] for start in starts]


def _holding(
    held: Sequence[int], problem: Problem, data: Observations, goal: Objective, start: Floats, evaluations: int
) -> tuple[float, Floats]:
    """The lowest cost of Gauss-Newton steps of all parameters but those held, and where that is."""
    others, (lower, upper), x = np.delete(np.arange(start.size), held), problem.bounds, start
    least, best = math.inf, start
    for left in reversed(range(evaluations)):
        here = apparent(problem.model(x), data, quick=True)
        residual = np.concatenate([goal.residual(here), problem.pulls(x)])
        cost = 0.5 * float(residual @ residual)
        if not math.isfinite(cost):
            break
        if cost < least:
            least, best = cost, x
        if left:
            columns = derivatives(problem, data, x, here=here, only=others)
            slopes = np.concatenate([goal.jacobian(here, columns), problem.pull_slopes(x)[:, others]])
            x = x.copy()
            x[others] = last_step(x[others], residual, slopes, lower[others], upper[others])
    return least, best


def _levelled(problem: Problem, data: Observations, starts: Sequence[Floats], say: Say) -> list[tuple[float, Floats]]:
    """What starts cost, and the starts, with the level of a Lambertian part that costs least.

    Large residuals count by their logarithm: a lobe in the right place must win over one that is merely low.
    """
    goal, (lower, upper) = softened(data, COARSE_U), problem.bounds
    pace, evaluated = Pace("fitting: starts tried", len(starts), say), []
    for k, start in enumerate(starts):
        pace.step(k)
        evaluated.append(apparent(problem.model(start), data, quick=True))
    predicted, vectors = np.array(evaluated), np.array(starts)

    def costs() -> tuple[Floats, Floats]:
        residual = np.clip(goal.residual(predicted), -LARGEST, LARGEST)
        return np.log1p(residual**2).sum(axis=1), residual

    (least, residual), best = costs(), vectors.copy()
    known = [problem.known_slopes(start) for start in starts]
    flat = 1.0 if data.light is None else data.light.depolarised
    for name in () if data.first.size else known[0]:
        k, slope = problem.free.index(name), np.array([one[name] for one in known])
        for _ in range(LEVELLED):
            column = goal.slopes(predicted, np.broadcast_to(slope[:, None] * flat, predicted.shape))
            weight = column / (1.0 + residual**2)
            step = (weight * residual).sum(axis=1) / np.maximum((weight * column).sum(axis=1), 1e-300)
            moved = np.clip(vectors[:, k] - step, lower[k], upper[k])
            predicted += (slope * (moved - vectors[:, k]))[:, None] * flat
            vectors[:, k] = moved
            cost, residual = costs()
            best[cost < least] = vectors[cost < least]
            least = np.minimum(cost, least)
    return list(zip(least.tolist(), best, strict=True))


def _starts(problem: Problem, data: Observations) -> list[Floats]:
    """The coarse grid; over n and k, too, where nothing is known of them."""
    known = {n: v for n, v in problem.family.fixed.items() if n in problem.free and v}
    starts = problem.family.starts(parameters.levels(data))
    if "k" in problem.free and not known:
        shapes = {tuple((n, x) for n, x in start.items() if n != "ior"): None for start in starts}
        starts = [{**dict(shape), "ior": n, "k": k} for shape in shapes for n, k in parameters.INDICES]
    vectors = [problem.vector({"k": 1.0, **start, **known}) for start in starts]
    return list({vector.tobytes(): vector for vector in vectors}.values())  # what is fixed makes some of them equal


def _coarse(
    problem: Problem, data: Observations, goal: Objective, starts: Sequence[tuple[float, Floats]]
) -> list[tuple[Floats, float]]:
    """Short searches from the starts that cost least, the best one first."""
    nearest = sorted(starts, key=lambda c: c[0])[: problem.asked.searches]
    return sorted((refine(problem, data, goal, v, quick=True, limit=25) for _, v in nearest), key=lambda f: f[1])


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
    return data.take(np.union1d(np.flatnonzero(np.isin(data.rows, few.rows)), highest))


def approach(problem: Problem, data: Observations, start: Floats, say: Say = silent) -> tuple[Floats, float]:
    """As `refine`, with the quick forward model and the independent part of the covariance."""
    goal = replace(alone(data, problem.asked.metric), loss=problem.asked.loss)
    return refine(problem, data, goal, start, quick=True, say=say)


def refine(problem: Problem, data: Observations, goal: Objective, start: Floats, **how: Any) -> tuple[Floats, float]:
    """As `refined`, wherever it ended."""
    return refined(problem, data, goal, start, **how)[:2]


def refined(
    problem: Problem,
    data: Observations,
    goal: Objective,
    start: Floats,
    *,
    quick: bool = False,
    limit: int = LONG,
    rules: Averaging = None,
    say: Say = silent,
    free: Rows | None = None,
    ratio: Floats | None = None,
) -> tuple[Floats, float, bool]:
    """Trust-region least squares from one start; the point, half its sum of squares, and whether that is its end.

    Derivatives are one-sided ones of the quick forward model, scaled to the full one; `settle` takes the last step with
    those of the full one. Averages over the cones are taken by `rules`, or as is found good at the start.

    With `ratio` (n,) the model is the quick one times that, and found to 1e-6; `free` parameters alone move then.
    """
    lower, upper = problem.bounds
    latest = np.empty(len(data))
    pace, steps = Pace("fitting: trial points", limit, say, at_most=True), count()
    rules = rules or (None if quick else averaging(problem.model(start), data))
    quick = quick or pointlike(data)
    moving = np.arange(start.size) if free is None else free
    scale = np.ones(1) if ratio is None else ratio

    def whole(part: Floats) -> Floats:
        x = start.copy()
        x[moving] = part
        return x

    def residual(part: Floats) -> Floats:
        pace.step(next(steps))
        x = whole(part)
        latest[:] = apparent(problem.model(x), data, quick=quick, rules=rules)
        return np.concatenate([goal.residual(latest * scale), problem.pulls(x)])

    def jacobian(part: Floats) -> Floats:
        x = whole(part)
        near = latest if quick else apparent(problem.model(x), data, quick=True)
        columns = derivatives(problem, data, x, here=near, only=free)
        if ratio is not None or not quick:
            columns = columns * (to_full(latest, near) if ratio is None else ratio)[:, None]
        return np.concatenate([goal.jacobian(latest * scale, columns), problem.pull_slopes(x)[:, moving]])

    accuracy = (1e-9, 1e-10 if quick else 1e-8, 1e-12) if ratio is None else (1e-6, 1e-6, 1e-10)
    bounds = (lower[moving], upper[moving])
    found = least(residual, jacobian, start[moving], bounds, accuracy, limit=limit, loss=goal.loss)
    return whole(found.x), float(found.cost), bool(found.status)


def least(
    residual: Callable[[Floats], Floats],
    jacobian: Callable[[Floats], Floats],
    start: Floats,
    bounds: tuple[Floats, Floats],
    accuracy: tuple[float, float, float],
    *,
    limit: int,
    loss: str = "linear",
) -> Any:
    """`scipy.optimize.least_squares` from a start that is brought inside the bounds; `accuracy` is xtol, ftol, gtol.

    Its steps stay inside the bounds, and where n and a level follow k down to 0 thousands of them halve what is left.
    Those of the dogleg end on the bound; where they come to a stop, steps inside go on.
    """
    from scipy.optimize import least_squares

    lower, upper = bounds
    margin = np.where(np.isfinite(upper - lower), 1e-9 * (upper - lower), 0.0)

    def ended(start: Floats, method: str, limit: int) -> Any:
        begin = start if method == "dogbox" else np.clip(start, lower + margin, upper - margin)
        return least_squares(
            residual, begin, jac=jacobian, bounds=bounds, method=method, x_scale="jac", loss=loss, xtol=accuracy[0],
            ftol=accuracy[1], gtol=accuracy[2], max_nfev=limit,
        )  # fmt: skip

    inside = ended(start, "trf", min(limit, INSIDE))
    if inside.status or limit <= INSIDE + DOGLEG:
        return inside
    onto = ended(inside.x, "dogbox", DOGLEG)
    return min(onto, ended(onto.x, "trf", limit - INSIDE - DOGLEG), key=lambda found: float(found.cost))


def to_full(full: Floats, quick: Floats) -> Floats:
    """What derivatives of the quick model are multiplied by to be those of the full one: the ratio of the two."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.clip(full / quick, 0.2, 5.0), nan=1.0)


def derivatives(
    problem: Problem,
    data: Observations,
    vector: Floats,
    *,
    quick: bool = False,
    rules: Averaging = None,
    only: Iterable[int] | None = None,
    here: Floats | None = None,
) -> Floats:
    """d(model)/d(search scale), (n, p); `only` names the columns, `quick` and `rules` are those of `apparent`.

    Exact for the level of a Lambertian part, else by central differences (one-sided at a bound). From the values `here`
    of the quick model they are one-sided ones of that, by one more evaluation a parameter.
    """
    lower, upper = problem.bounds
    known = {} if data.first.size else problem.known_slopes(vector)
    asked = list(range(vector.size) if only is None else only)
    columns = np.empty((vector.size, len(data)))
    for k in (k for k in asked if problem.free[k] in known):
        columns[k] = known[problem.free[k]] * (1.0 if data.light is None else data.light.depolarised)
    for together in problem.moved_together(k for k in asked if problem.free[k] not in known):
        up, down = vector.copy(), vector.copy()
        if here is None:
            up[together] = np.minimum(vector[together] + STEP, upper[together])
            down[together] = np.maximum(vector[together] - STEP, lower[together])
            high, low = (apparent(problem.model(x), data, quick=quick, rules=rules) for x in (up, down))
            rise = high - low
        else:
            for k in together:
                up[k] += SMALL_STEP if vector[k] + SMALL_STEP <= upper[k] else -SMALL_STEP
            rise = apparent(problem.model(up), data, quick=True) - here
        for k in together:  # a parameter of one wavelength changes the values at that alone
            np.divide(rise, up[k] - down[k], out=columns[k])
            if (wave := problem.own_wavelength(k)) is not None:
                columns[k] *= data.wavelength_nm == wave
    return columns[asked].T
