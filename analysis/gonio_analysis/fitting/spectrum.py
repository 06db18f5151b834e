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
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gonio.cli.pace import Pace, Say, silent
from gonio.errors import DataError
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult, fit, known_by_blocks, remarks
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.misfit import estimated_tau
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.search import covariance
from gonio_analysis.fitting.shared_geometry import TRIALS, _Block, _Task
from gonio_analysis.fitting.solution import ROUNDING, SIGNIFICANCE, derived, estimates, residuals_on_log_scale
from gonio_analysis.result_records import SharedGeometry

if TYPE_CHECKING:
    import pandas as pd


MOST_WAVELENGTHS = 40
"""Wavelengths that are fitted together, evenly taken of more."""
MOST_VALUES = 200_000
"""Values that are fitted together, evenly taken of more."""
DISFAVOURED = 10.0
"""What a geometry of its own has to gain in AIC at one wavelength before sharing is called into question."""


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
