"""One sample at several wavelengths: one geometry, and levels and optical constants of each wavelength's own.

Roughness, correlation length and slopes belong to the surface, whatever the light; n, k and albedos do not. So all
wavelengths are fitted together, and what comes out is one fit a wavelength: with the geometry that they share, and with
its uncertainty from all of them.

Least squares goes block by block. Residuals and derivatives of a wavelength are brought to triangular form before the
next one is evaluated: sums of squares and their derivatives stay what they are, and nothing grows with values times
parameters. Causes that are common to values are parameters of their own, each with a standard deviation of 1: the
smallest sum over them is r^T C^-1 r.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gonio.cli.pace import Pace, Say, silent
from gonio.errors import DataError
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult, fit, known_by_blocks, remarks
from gonio_analysis.fitting.forward import apparent, averaging, pointlike
from gonio_analysis.fitting.misfit import estimated_tau
from gonio_analysis.fitting.objective import Objective, alone, scaled_to, with_misfit
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.search import covariance, derivatives, one_sided
from gonio_analysis.fitting.solution import ROUNDING, SIGNIFICANCE, derived, estimates, residuals_on_log_scale
from gonio_analysis.fitting.value_covariance import independent
from gonio_analysis.result_records import SharedGeometry

if TYPE_CHECKING:
    import pandas as pd

    from gonio.instrument import Rules

MOST_WAVELENGTHS = 40
"""Wavelengths that are fitted together, evenly taken of more."""
MOST_VALUES = 200_000
"""Values that are fitted together, evenly taken of more."""
TRIALS = 60
DISFAVOURED = 10.0
"""What a geometry of its own has to gain in AIC at one wavelength before sharing is called into question."""

Rows = npt.NDArray[np.intp]
Evaluated = tuple[Floats, Floats]
"""Residuals (m,) and their derivatives (m, p)."""


def geometry(problem: Problem) -> tuple[str, ...]:
    """The free parameters that belong to the surface."""
    return tuple(n for n in problem.free if problem.parameter(n).geometry)


def shares(asked: FitRequest, data: Observations) -> bool:
    """Whether a fit as asked for takes all wavelengths of a table together.

    It does where there are several and the model has a geometry to share. It does not under --energy (the bound holds
    one wavelength) and with a robust loss.
    """
    waves = [w for w in data.wavelengths if not math.isnan(w)]
    own_way = asked.separate or asked.each is not None or asked.energy or asked.loss != "linear"
    return not own_way and len(waves) > 1 and bool(geometry(pose(asked)))


def fit_table(
    table: pd.DataFrame | Observations, asked: FitRequest, *, name: str = "the table", say: Say = silent
) -> list[FitResult]:
    """Fit one model to a table: as `gonio_analysis.fitting.fit.fit`, with the geometry shared where it can be.

    A request that names a wavelength is for that one alone.

    Returns
    -------
    list of FitResult
        The fit that is reported first, then those at the other wavelengths that share its geometry.
    """
    data = table if isinstance(table, Observations) else observations(table, name, asked.u_rel)
    first = fit(data, asked, name=name, say=say)
    if asked.wavelength_nm is not None or not shares(asked, data):
        return [first]
    fits = fit_shared(data, first, name=name, say=say)
    return sorted(fits, key=lambda r: r.wavelength_nm != first.wavelength_nm)


def fit_shared(
    data: Observations, first: FitResult, *, name: str = "the table", label: str = "", say: Say = silent
) -> list[FitResult]:
    """Fits at all wavelengths of a table with one geometry, ascending.

    Parameters
    ----------
    data
        Usable values at all wavelengths.
    first
        A fit of one wavelength alone, whose request counts for all and whose wavelength is among those that come out.
    name, label
        What messages call the table, and the model.
    say
        Called with a line now and then.

    Returns
    -------
    list of FitResult
        One a wavelength that has more values than it has parameters of its own. `shared` says what was fitted together.
    """
    began = time.perf_counter()
    asked = first.problem.asked
    assert asked is not None
    asked = replace(asked, start=None, wavelength_nm=None)
    problem = first.problem
    common = geometry(problem)
    own = tuple(n for n in problem.free if n not in common)
    whole = {w: data.at(w) for w in _picked(data, first.wavelength_nm)}
    whole = {w: one for w, one in whole.items() if len(one) > len(own) + 1}
    if len(whole) < 2:
        return [first]
    every = -(-sum(len(one) for one in whole.values()) // MOST_VALUES)
    taken = {w: one.take(np.arange(0, len(one), every)) if every > 1 else one for w, one in whole.items()}
    task = _Task(problem, common, taken)
    starts: list[FitResult | None] = [first]
    if problem.family.needs_wavelength:  # one wavelength alone may prefer a valley that the others refute
        starts += [_alone(taken[w], asked, name) for w in (min(taken), max(taken)) if w != first.wavelength_nm]
    pace = Pace(
        f"{name}: {label or first.name}, {len(whole)} wavelengths together, trial points", TRIALS, say, at_most=True
    )
    vector = min((task.begin(s) for s in starts if s is not None), key=lambda found: found[1])[0]
    vector = task.solve(vector, quick=True, step=pace.step)
    if not task.simple:
        task = task.through_cones(vector)
        vector = task.solve(vector, quick=False, step=pace.step)
    vector, jacobian, total = task.settle(vector)
    spread, condition = covariance(jacobian)
    values = sum(len(one) for one in taken.values())
    free = len(common) + len(own) * len(taken)
    whitened = task.blocks[0].goal.whitened
    if not whitened:
        spread = spread * max(total / max(values - free, 1), ROUNDING)
    shared = SharedGeometry(
        wavelengths_nm=list(taken),
        parameters=list(common),
        n_points=values,
        n_free=free,
        chi_square=total if whitened else None,
        reduced_chi_square=total / (values - free) if whitened and values > free else None,
    )
    nearest = asked.metric is None and (not whitened or _rejected(shared))
    known: dict[float, float] = {}
    if nearest and whitened:
        for block in task.blocks:
            residual = block.residual(vector[block.index], whole[block.wavelength_nm])
            known[block.wavelength_nm] = float(residual @ residual)
        task, vector = _nearest(first, common, taken, pace.step)
        vector, jacobian, _ = task.settle(vector)
        spread, condition = covariance(jacobian)
    wall = time.perf_counter() - began
    fits = [
        _slice(first, block, whole[block.wavelength_nm], vector, spread, condition, shared, wall, known)
        for block in task.blocks
    ]
    return [_told(first, result) for result in (_known_by_blocks(fits) if nearest else fits)]


def _rejected(shared: SharedGeometry) -> bool:
    """Whether the values of all wavelengths reject what was fitted to them."""
    from scipy.special import chdtrc

    freedom = shared.n_points - shared.n_free
    return shared.chi_square is not None and freedom > 0 and float(chdtrc(freedom, shared.chi_square)) < SIGNIFICANCE


def _nearest(
    first: FitResult, common: Sequence[str], taken: dict[float, Observations], step: Callable[[int], None]
) -> tuple[_Task, Floats]:
    """As of a single wavelength (docs/misfit.md): logarithms, then with the misfit of each wavelength."""
    unstated = {w: replace(one, covariance=None, u_rel_assumed=None) for w, one in taken.items()}
    task = _Task(first.problem, common, unstated)
    vector = task.solve(task.begin(first)[0], quick=True, step=step)
    taus = [
        estimated_tau(*residuals_on_log_scale(b.problem, taken[b.wavelength_nm], vector[b.index])) for b in task.blocks
    ]
    task = _Task(first.problem, common, taken, taus)
    vector = task.solve(vector, quick=True, step=step)
    if not task.simple:
        task = task.through_cones(vector)
        vector = task.solve(vector, quick=False, step=step)
    return task, vector


def _known_by_blocks(fits: Sequence[FitResult]) -> list[FitResult]:
    """The same fits with the misfit of each, and the errors that follow from it.

    A model misses much the same at every wavelength, so values at many of them do not make it smaller. Errors are those
    of one wavelength alone, and what is shared has the median of them.
    """
    found = [known_by_blocks(f) for f in fits]
    shared = found[0].shared
    assert shared is not None
    u = np.sqrt([np.diag(f.spread) for f in found])
    same = np.array([n in shared.parameters for n in found[0].free])
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(same, np.nan_to_num(np.median(u, axis=0) / u, nan=1.0, posinf=1.0), 1.0)
    return [f.known_to(f.spread * np.outer(s, s)) for f, s in zip(found, scale, strict=True)]


def _picked(data: Observations, keep: float) -> list[float]:
    waves = [w for w in data.wavelengths if not math.isnan(w)]
    if len(waves) <= MOST_WAVELENGTHS:
        return waves
    even = {waves[k] for k in np.linspace(0, len(waves) - 1, MOST_WAVELENGTHS - 1).round().astype(int)}
    return sorted(even | {keep})


def _alone(data: Observations, asked: FitRequest, name: str) -> FitResult | None:
    try:
        return fit(data, asked, name=name)
    except DataError:
        return None  # too few values at this wavelength alone


@dataclass(frozen=True)
class _Block:
    """One wavelength of a task."""

    wavelength_nm: float
    problem: Problem
    data: Observations
    goal: Objective
    """Of the independent part of the covariance."""
    index: Rows
    """Where the parameters of `problem` stand among all."""
    common: Floats
    """d(residual)/d(cause), (n, causes)."""
    rules: list[Rules | None] | None = None

    def scaled(self, data: Observations, predicted: Floats) -> Objective:
        """Of values of this wavelength, with their common causes as they are at a prediction."""
        if self.goal.tau:
            return with_misfit(data, self.goal.tau, predicted)
        return scaled_to(data, predicted, self.goal.metric)

    def residual(self, x: Floats, data: Observations) -> Floats:
        """Of values of this wavelength, whitened."""
        model = self.problem.model(x)
        return self.scaled(data, apparent(model, data, quick=True)).residual(apparent(model, data))

    def evaluate(self, x: Floats, causes: Floats, *, quick: bool, full: bool = False) -> Evaluated:
        """Residuals and derivatives by its own parameters and the causes, in triangular form."""
        predicted = self.predicted(x, quick=quick)
        if full:
            columns = derivatives(self.problem, self.data, x, rules=self.rules)
        else:
            near = predicted if quick else apparent(self.problem.model(x), self.data, quick=True)
            columns = one_sided(self.problem, self.data, x, near)
            if not quick:
                with np.errstate(divide="ignore", invalid="ignore"):
                    columns = columns * np.nan_to_num(np.clip(predicted / near, 0.2, 5.0), nan=1.0)[:, None]
        residual = self.goal.residual(predicted) + self.common @ causes
        rows = np.column_stack([self.goal.jacobian(predicted, columns), self.common, residual])
        if rows.shape[0] > rows.shape[1]:
            rows = np.asarray(np.linalg.qr(rows, mode="r"))
        return rows[:, -1], rows[:, :-1]

    def predicted(self, x: Floats, *, quick: bool) -> Floats:
        """The model [1/sr]."""
        return apparent(self.problem.model(x), self.data, quick=quick, rules=self.rules)


class _Task:
    """Least squares over all wavelengths: the shared parameters first, then each wavelength's own, then the causes."""

    def __init__(
        self,
        problem: Problem,
        common: Sequence[str],
        taken: dict[float, Observations],
        taus: Sequence[float] | None = None,
    ) -> None:
        self.problem = problem
        free = problem.free
        self._shared = [k for k, n in enumerate(free) if n in common]
        self._own = [k for k, n in enumerate(free) if n not in common]
        self.blocks: list[_Block] = []
        asked = problem.asked
        assert asked is not None
        for number, (wave, data) in enumerate(taken.items()):
            index = np.zeros(len(free), dtype=np.intp)
            index[self._shared] = np.arange(len(self._shared))
            index[self._own] = len(self._shared) + number * len(self._own) + np.arange(len(self._own))
            none = np.zeros((len(data), 0))
            goal = alone(data, asked.metric)
            if taus is not None:
                goal = with_misfit(data, taus[number], data.brdf)
                assert goal.weights is not None
                goal = replace(goal, weights=independent(goal.weights.random))
            self.blocks.append(_Block(wave, problem, data, goal, index, none))
        self._size = len(self._shared) + len(self._own) * len(self.blocks)
        lower, upper = problem.bounds
        self._lower, self._upper = np.empty(self._size), np.empty(self._size)
        for block in self.blocks:
            self._lower[block.index], self._upper[block.index] = lower, upper
        self._causes = 0

    @property
    def simple(self) -> bool:
        """Whether the quick model is the whole one, and no cause is common to values."""
        weights = [b.goal.weights is not None and bool(_causes(b.data)) for b in self.blocks]
        return all(pointlike(b.data) for b in self.blocks) and not any(weights)

    def through_cones(self, vector: Floats) -> _Task:
        """The same with averages over the cones, and with the common causes, scaled to the model at `vector`."""
        out = _Task.__new__(_Task)
        out.__dict__.update(self.__dict__)
        names = list(dict.fromkeys(c for b in self.blocks for c in _causes(b.data) if b.goal.weights is not None))
        out._causes = len(names)
        out.blocks = []
        for b in self.blocks:
            x = vector[b.index]
            common = np.zeros((len(b.data), len(names)))
            if b.goal.weights is not None:
                goal = b.scaled(b.data, b.predicted(x, quick=True))
                assert goal.weights is not None
                columns = [names.index(c) for c in goal.weights.causes]
                common[:, columns] = goal.weights.common / goal.weights.random[:, None]
            rules = averaging(b.problem.model(x), b.data)
            out.blocks.append(replace(b, common=common, rules=rules))
        return out

    def begin(self, start: FitResult) -> tuple[Floats, float]:
        """Every wavelength's own parameters with the geometry of a fit, from its wavelength outward; and the sum."""
        near = dict.fromkeys((b.wavelength_nm for b in self.blocks), start.vector)
        out, total = np.empty(self._size), 0.0
        order = sorted(self.blocks, key=lambda b: abs(b.wavelength_nm - start.wavelength_nm))
        done: list[float] = []
        for b in order:
            x = near[min(done, key=lambda w: abs(w - b.wavelength_nm))].copy() if done else start.vector.copy()
            if self._own:
                x[self._own] = self._own_only(b, x)
            near[b.wavelength_nm] = x
            done.append(b.wavelength_nm)
            residual = b.goal.residual(b.predicted(x, quick=True))
            total += float(residual @ residual)
            out[b.index] = x
        return out, total

    def _own_only(self, b: _Block, x: Floats) -> Floats:
        lower, upper = (bound[self._own] for bound in b.problem.bounds)

        def evaluate(part: Floats) -> Evaluated:
            moved = x.copy()
            moved[self._own] = part
            residual, jacobian = b.evaluate(moved, np.zeros(0), quick=True)
            return residual, jacobian[:, self._own]

        return _least(evaluate, x[self._own], lower, upper, limit=10)

    def solve(self, vector: Floats, *, quick: bool, step: Callable[[int], None]) -> Floats:
        """The best point from a start, without the causes."""
        count = 0

        def evaluate(x: Floats) -> Evaluated:
            nonlocal count
            step(count)
            count += 1
            return self._evaluate(x, quick=quick)

        open_ends = np.full(self._causes, np.inf)
        lower, upper = np.append(self._lower, -open_ends), np.append(self._upper, open_ends)
        start = np.append(vector, np.zeros(self._causes))
        found = _least(evaluate, start, lower, upper, limit=TRIALS)
        self._found = found
        return found[: self._size]

    def _evaluate(self, x: Floats, *, quick: bool, full: bool = False) -> Evaluated:
        values, causes = x[: self._size], x[self._size :]
        residuals, jacobians = [], []
        at_causes = np.arange(self._size, x.size)
        for number, b in enumerate(self.blocks):
            f, j = b.evaluate(values[b.index], causes, quick=quick, full=full)
            pulls, slopes = self._pulls(b, values[b.index], first=number == 0)
            f, own = np.append(f, pulls), np.append(j[:, : b.index.size], slopes, axis=0)
            wide = np.zeros((f.size, x.size))
            wide[:, b.index] = own
            wide[: len(j), at_causes] = j[:, b.index.size :]
            residuals.append(f)
            jacobians.append(wide)
        if causes.size:
            residuals.append(causes)
            jacobians.append(np.eye(x.size)[self._size :])
        return np.concatenate(residuals), np.concatenate(jacobians)

    def _pulls(self, b: _Block, x: Floats, *, first: bool) -> Evaluated:
        """Priors: those of shared parameters count once."""
        names = list(b.problem.priors)
        if not names:
            return np.zeros(0), np.zeros((0, x.size))
        kept = [k for k, n in enumerate(names) if first or not b.problem.parameter(n).geometry]
        return b.problem.pulls(x)[kept], b.problem.pull_slopes(x)[kept]

    def settle(self, vector: Floats) -> tuple[Floats, Floats, float]:
        """One step with the full derivatives, if it helps: the point, the Jacobian, and the sum without priors."""
        quick = self.simple and self._causes == 0
        here = np.append(vector, self._found[self._size :])
        residual, jacobian = self._evaluate(here, quick=quick, full=True)
        margin = np.append(1e-6 * np.minimum(self._upper - self._lower, 1.0), np.zeros(self._causes))
        low = np.append(self._lower, np.full(self._causes, -np.inf))
        high = np.append(self._upper, np.full(self._causes, np.inf))
        inside = (here > low + margin) & (here < high - margin)
        step = np.zeros(here.size)
        if inside.any():
            size = np.maximum(np.linalg.norm(jacobian[:, inside], axis=0), 1e-300)
            step[inside] = np.linalg.lstsq(jacobian[:, inside] / size, -residual, rcond=1e-10)[0] / size
        step[: self._size] = np.clip(step[: self._size], -0.1, 0.1)
        moved = np.clip(here + step, low, high)
        moved = np.where(moved <= low + margin, low, np.where(moved >= high - margin, high, moved))
        before, after = self._total(here), self._total(moved)
        best, total = (moved, after) if after <= before * (1 + 1e-9) else (here, before)
        return best[: self._size], jacobian, total

    def _total(self, x: Floats) -> float:
        """The sum of squares, that of the causes included and that of the priors left out."""
        causes = x[self._size :]
        total = float(causes @ causes)
        for b in self.blocks:
            part = b.goal.residual(b.predicted(x[b.index], quick=False)) + b.common @ causes
            total += float(part @ part)
        return total


def _causes(data: Observations) -> tuple[str, ...]:
    return data.covariance.causes if data.covariance is not None else ()


def _least(
    evaluate: Callable[[Floats], Evaluated], start: Floats, lower: Floats, upper: Floats, *, limit: int
) -> Floats:
    """Trust-region least squares; residuals and derivatives come together, for both are turned alike."""
    from scipy.optimize import least_squares

    known: dict[bytes, Evaluated] = {}

    def at(x: Floats) -> Evaluated:
        key = x.tobytes()
        if key not in known:
            if len(known) > 1:
                known.pop(next(iter(known)))
            known[key] = evaluate(x)
        return known[key]

    margin = np.where(np.isfinite(upper - lower), 1e-9 * (upper - lower), 0.0)
    found = least_squares(
        lambda x: at(x)[0],
        np.clip(start, lower + margin, upper - margin),
        jac=lambda x: at(x)[1],
        bounds=(lower, upper),
        x_scale="jac",
        xtol=1e-8,
        ftol=1e-8,
        gtol=1e-12,
        max_nfev=limit,
    )
    return np.asarray(found.x)


def _slice(
    first: FitResult,
    block: _Block,
    data: Observations,
    vector: Floats,
    spread: Floats,
    condition: float,
    shared: SharedGeometry,
    wall_s: float,
    known: Mapping[float, float],
) -> FitResult:
    """The fit at one wavelength; `known` are chi-squares by the stated uncertainties, where `block` has a misfit."""
    problem, x = block.problem, vector[block.index]
    own = spread[np.ix_(block.index, block.index)]
    model = problem.model(x)
    goal = block.scaled(data, apparent(model, data, quick=True))
    predicted = apparent(model, data)
    white = goal.residual(predicted)
    slope = problem.slope(x)
    return FitResult(
        name=first.name,
        model=model,
        parameters=estimates(problem, x, own, block.wavelength_nm),
        free=problem.free,
        covariance=own * np.outer(slope, slope),
        derived=derived(problem, x, own),
        data=data,
        predicted=predicted,
        whitened=white,
        weighting=goal.words,
        chi_square=known.get(block.wavelength_nm, float(white @ white)) if goal.whitened else None,
        wavelength_nm=block.wavelength_nm,
        condition=condition,
        wall_s=wall_s,
        problem=problem,
        vector=x,
        spread=own,
        goal=goal,
        shared=shared,
    )


def _told(first: FitResult, result: FitResult) -> FitResult:
    """A fit at one wavelength, with notes."""
    said = [_words(result), *result.problem.notes]
    if result.misfit is not None:
        said.append(
            "The model misses much the same at every wavelength, so its standard errors are those of one wavelength"
            " alone; of what is shared, the median of them."
        )
    elif not result.goal.whitened:
        said.append("Standard errors come from the scatter of the residuals; there is no chi-square.")
    if result.wavelength_nm == first.wavelength_nm:
        said += _tension(first, result)
    return replace(result, notes=[*result.data.notes, *said, *remarks(result)])


def _words(result: FitResult) -> str:
    shared = result.shared
    assert shared is not None
    waves = shared.wavelengths_nm
    own = [n for n in result.free if n not in shared.parameters]
    chi = shared.reduced_chi_square
    over = "" if chi is None else f" Over all of them reduced chi-square is {chi:.4g}."
    return (
        f"{len(waves)} wavelengths from {waves[0]:g} to {waves[-1]:g} nm are fitted together:"
        f" {_listed(shared.parameters)} {'is' if len(shared.parameters) == 1 else 'are'} the same at all,"
        f" {_listed(own) or 'nothing'} at each its own; {result.wavelength_nm:g} nm is shown.{over}"
        " --separate fits each wavelength alone."
    )


def _tension(first: FitResult, result: FitResult) -> list[str]:
    """Whether the values at one wavelength ask for another geometry than the shared one."""
    shared = result.shared
    assert shared is not None
    n = len(result.data)
    if result.misfit is not None or first.misfit is not None:
        return _tension_of_misfits(first, result, shared.parameters)
    alone_, here = (float(r.whitened @ r.whitened) for r in (first, result))
    gain = here - alone_ if result.goal.whitened else n * math.log(max(here, 1e-300) / max(alone_, 1e-300))
    if gain - 2 * len(shared.parameters) <= DISFAVOURED:
        return []
    apart = ", ".join(
        f"{n} = {first.parameters[n].value:.3g} (shared: {result.parameters[n].value:.3g})" for n in shared.parameters
    )
    return [
        f"{result.wavelength_nm:g} nm alone asks for another geometry: {apart} describes it better by"
        f" {gain - 2 * len(shared.parameters):.3g} in AIC. Either the model is not right at every wavelength, or its"
        " parameters are not the surface's."
    ]


def _tension_of_misfits(first: FitResult, result: FitResult, shared: Sequence[str]) -> list[str]:
    """The same of models that are not true: whether the misfit is larger, beyond its interval."""
    here, alone_ = result.misfit, first.misfit
    if here is None or (alone_ is not None and here.tau <= alone_.interval[1]):
        return []
    to = "" if alone_ is None else f", to {100 * alone_.tau:.2g} % and not {100 * here.tau:.2g} %"
    apart = ", ".join(
        f"{n} = {first.parameters[n].value:.3g} (shared: {result.parameters[n].value:.3g})" for n in shared
    )
    return [f"{result.wavelength_nm:g} nm alone asks for another geometry: {apart} describes it better{to}."]


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)
