"""One sample at several wavelengths: one geometry, and levels and optical constants of each wavelength's own.

Roughness, correlation length and slopes belong to the surface, whatever the light; n, k and albedos do not. So all
wavelengths are fitted together, and what comes out is one fit a wavelength: with the geometry that they share, and with
its uncertainty from all of them.

Least squares goes block by block. Residuals and derivatives of a wavelength are brought to triangular form before the
next one is evaluated: sums of squares and their derivatives stay what they are, and nothing grows with values times
parameters. Causes that are common to values are parameters of their own, each with a standard deviation of 1: the
smallest sum over them is r^T C^-1 r.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from gonio.checks.values import SIGNIFICANCE
from gonio.progress import Pace, Say, silent
from gonio.typing import DataFrame, Floats
from gonio_analysis.fitting.fit import FitResult, at_solution, elsewhere, fit, known_by_blocks, remarks
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.misfit import estimated_tau
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.search import LONG
from gonio_analysis.fitting.shared_geometry import _Task
from gonio_analysis.fitting.solution import ROUNDING, residuals_on_log_scale
from gonio_analysis.fitting.steps import covariance
from gonio_analysis.result_records import SharedGeometry

MOST_WAVELENGTHS = 40
"""Wavelengths that are fitted together, evenly taken of more."""
MOST_VALUES = 200_000
"""Values that are fitted together, evenly taken of more."""
DISFAVOURED = 10.0
"""What a geometry of its own has to gain in AIC at one wavelength before sharing is called into question."""

ROUNDED = 1e-6
"""A misfit below this is the rounding of a file's values, or the end of a search, and speaks against nothing."""


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
    table: DataFrame | Observations, asked: FitRequest, *, name: str = "the table", say: Say = silent
) -> list[FitResult]:
    """Fit one model to a table: as `gonio_analysis.fitting.fit.fit`, with the geometry shared where it can be.

    A request that names a wavelength is for that one alone.

    Returns
    -------
    list of FitResult
        The fit that is reported first, then those at the other wavelengths that share its geometry.
    """
    data = table if isinstance(table, Observations) else observations(table, name, asked.u_rel, polarised=True)
    first = fit(data, asked, name=name, say=say)
    if asked.wavelength_nm is not None or not shares(asked, data):
        return [first]
    return sorted(fit_shared(data, first, name=name, say=say), key=lambda r: r.wavelength_nm != first.wavelength_nm)


def fit_every(
    table: Observations, asked: FitRequest, *, name: str = "the table", every: bool = True, say: Say = silent
) -> list[FitResult]:
    """Fit one model at all wavelengths of a table, with one geometry unless the data ask for another at some of them.

    They are asked at the wavelength that is reported, the shortest and the longest: each of these is fitted alone, too.

    Parameters
    ----------
    table
        Usable values. Where they state no uncertainties, `MOST_VALUES` of more are taken.
    asked
        One that names a wavelength is for that one alone, and one of `each` for all of them in one fit.
    name, say
        As for `fit_table`.
    every
        Whether all wavelengths are fitted also where they have nothing in common.

    Returns
    -------
    list of FitResult
        The fit that is reported first, then those at the other wavelengths; `shared` is None where each has its own
        geometry.
    """
    waves = [w for w in table.wavelengths if not math.isnan(w)]
    if asked.wavelength_nm is not None or asked.each is not None or len(waves) < 2:
        return [fit(table, asked, name=name, say=say)]
    data = thinned(table)
    first = fit(data, asked, name=name, say=say)
    shown = first.wavelength_nm
    together = fit_shared(data, first, name=name, say=say) if shares(asked, data) else [first]
    by_wave = {one.wavelength_nm: one for one in together}

    def alone(wave: float) -> FitResult:
        near = [{n: e.value for n, e in one.parameters.items()} for one in (by_wave.get(wave), first) if one]
        own = replace(asked, start=near)
        return first if wave == shown else fit(data.at(wave), own, name=f"{name} at {wave:g} nm", say=say)

    if len(together) > 1:
        ends = {wave: alone(wave) for wave in {shown, min(by_wave), max(by_wave)}}
        against = [said for wave, one in ends.items() for said in _tension(one, by_wave[wave])]
        if not against:
            return sorted(together, key=lambda r: r.wavelength_nm != shown)
        first = replace(first, notes=[*first.notes, f"Each wavelength has a geometry of its own. {against[0]}"])
    elif not every:
        return [first]
    others = [alone(wave) for wave in picked(waves, shown) if wave != shown]
    return [first, *others]


def thinned(data: Observations) -> Observations:
    """The same, or where nothing weighs more values than `MOST_VALUES` so many of them, evenly taken."""
    every = -(-len(data) // MOST_VALUES)
    stated = data.covariance is not None and data.u_rel_assumed is None
    if every == 1 or stated:
        return data
    rows = [np.flatnonzero(data.wavelength_nm == wave)[::every] for wave in data.wavelengths]
    taken = data.take(np.sort(np.concatenate(rows)))
    said = f"{len(taken)} of {len(data)} values are fitted, evenly taken: without uncertainties more tell no more."
    return replace(taken, notes=(*data.notes, said))


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
    problem = first.problem
    common = geometry(problem)
    own = len(problem.free) - len(common)
    known = [w for w in data.wavelengths if not math.isnan(w)]
    whole = {w: data.at(w) for w in picked(known, first.wavelength_nm)}
    whole = {w: one for w, one in whole.items() if len(one) > own + 1}
    if len(whole) < 2:
        return [first]
    every = -(-sum(len(one) for one in whole.values()) // MOST_VALUES)
    taken = {w: one.take(np.arange(0, len(one), every)) if every > 1 else one for w, one in whole.items()}
    task = _Task(problem, common, taken)
    words = f"{name}: {label or first.name}, {len(whole)} wavelengths together, trial points"
    pace = Pace(words, LONG, say, at_most=True)
    begun = (task.begin(s) for s in [first, *elsewhere(first, taken, name)])
    task, vector = _solved(task, min(begun, key=lambda found: found[1])[0], pace.step)
    vector, jacobian, total = task.settle(vector)
    shared, whitened = _facts(task, list(taken), common, total)
    spread, condition = covariance(jacobian)
    if not whitened:
        spread = spread * max(total / max(shared.n_points - shared.n_free, 1), ROUNDING)
    nearest = problem.asked.metric is None and (not whitened or _rejected(shared))
    stated: dict[float, float] = {}
    if nearest and whitened:
        for block in task.blocks:
            residual = block.residual(vector[block.index], whole[block.wavelength_nm])
            stated[block.wavelength_nm] = float(residual @ residual)
        task, vector = _nearest(first, common, taken, pace.step)
        vector, jacobian, _ = task.settle(vector)
        spread, condition = covariance(jacobian)
    fits = []
    for block in task.blocks:
        x, of_one = vector[block.index], whole[block.wavelength_nm]
        goal = block.scaled(of_one, apparent(problem.model(x), of_one, quick=True))
        found = at_solution(problem, of_one, goal, x, block.wavelength_nm)
        found = replace(found, condition=condition, shared=shared, wall_s=time.perf_counter() - began)
        if goal.whitened:  # by the stated uncertainties, where the block has a misfit
            found = replace(found, chi_square=stated.get(block.wavelength_nm, found.chi_square))
        fits.append(found.known_to(spread[np.ix_(block.index, block.index)]))
    return [_told(first, result) for result in (_known_by_blocks(fits) if nearest else fits)]


def _solved(task: _Task, start: Floats, step: Callable[[int], None]) -> tuple[_Task, Floats]:
    """The best point, by the quick model and then through the cones and with common causes; and the task it is of."""
    vector = task.solve(start, quick=True, step=step)
    if task.simple:
        return task, vector
    task = task.through_cones(vector)
    return task, task.solve(vector, quick=False, step=step)


def _facts(task: _Task, waves: list[float], common: Sequence[str], total: float) -> tuple[SharedGeometry, bool]:
    """What was fitted together, and whether the sum of squares `total` is a chi-square."""
    values = sum(len(block.data) for block in task.blocks)
    free = len(common) + (len(task.problem.free) - len(common)) * len(waves)
    whitened = task.blocks[0].goal.whitened
    shared = SharedGeometry(
        wavelengths_nm=waves,
        parameters=list(common),
        n_points=values,
        n_free=free,
        chi_square=total if whitened else None,
        reduced_chi_square=total / (values - free) if whitened and values > free else None,
    )
    return shared, whitened


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
    taus = []
    for b in task.blocks:
        data, x = taken[b.wavelength_nm], vector[b.index]
        seen = apparent(b.problem.model(x), data)
        taus.append(estimated_tau(*residuals_on_log_scale(b.problem, data, x, seen)))
    return _solved(_Task(first.problem, common, taken, taus), vector, step)


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


def picked(waves: Sequence[float], keep: float) -> list[float]:
    """The wavelengths that are fitted together, ascending: all, or `MOST_WAVELENGTHS` of more; `keep` among them."""
    if len(waves) <= MOST_WAVELENGTHS:
        return list(waves)
    even = {waves[k] for k in np.linspace(0, len(waves) - 1, MOST_WAVELENGTHS - 1).round().astype(int)}
    return sorted(even | {keep})


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
        f" {', '.join(shared.parameters)} {'is' if len(shared.parameters) == 1 else 'are'} the same at all,"
        f" {', '.join(own) or 'nothing'} at each its own; {result.wavelength_nm:g} nm is shown.{over}"
        " --separate fits each wavelength alone."
    )


def _tension(first: FitResult, result: FitResult) -> list[str]:
    """Whether the values at one wavelength ask for another geometry than the shared one."""
    assert result.shared is not None
    here, own, names = result.misfit, first.misfit, result.shared.parameters
    apart = ", ".join(
        f"{n} = {first.parameters[n].value:.3g} (shared: {result.parameters[n].value:.3g})" for n in names
    )
    said = f"{result.wavelength_nm:g} nm alone asks for another geometry: {apart} describes it better"
    if here is not None or own is not None:  # of models that are not true: whether the misfit lies beyond its interval
        if here is None or here.tau < ROUNDED or (own is not None and here.tau <= own.interval[1]):
            return []
        to = "" if own is None else f", to {100 * own.tau:.2g} % and not {100 * here.tau:.2g} %"
        return [f"{said}{to}."]
    of_one, of_all = (float(r.whitened @ r.whitened) for r in (first, result))
    ratio = max(of_all, 1e-300) / max(of_one, 1e-300)
    gain = of_all - of_one if result.goal.whitened else len(result.data) * math.log(ratio)
    gain -= 2 * len(names)
    if gain <= DISFAVOURED:
        return []
    return [
        f"{said} by {gain:.3g} in AIC. Either the model is not right at every wavelength, or its parameters are not the"
        " surface's."
    ]
