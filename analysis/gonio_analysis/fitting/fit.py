"""Fitting a reflectance model to a measurement table.

Weighted least squares with the table's whole covariance: residuals are whitened
(`gonio_analysis.fitting.value_covariance`), the model is evaluated through the cones of the instrument
(`gonio_analysis.fitting.forward`), and the search starts from the best points of a coarse grid
(`gonio_analysis.fitting.search`).

Standard errors of a model that the data do not reject are those of linearised least squares with the stated
covariance. A model that they reject is fitted once more, with a misfit of its own (`gonio_analysis.fitting.misfit`,
docs/misfit.md): what comes out is the nearest model, and its standard errors hold that misfit. Without stated
uncertainties the fit is logarithmic, the misfit takes everything, and there is no chi-square.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.errors import ArgumentError, ConfigError, DataError
from gonio.models.parameters import Values
from gonio.progress import Say, silent
from gonio.typing import DataFrame, Floats
from gonio_analysis.fitting.forward import apparent, averaging, known_wavelength, rho_angles
from gonio_analysis.fitting.minimum import minimised, starts_below
from gonio_analysis.fitting.misfit import SETTLED, SMALLEST, TURNS, block_spread, estimated_tau, misfit
from gonio_analysis.fitting.objective import Objective, objective, on_log_scale, scaled_to, with_misfit
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM, Observations, observations
from gonio_analysis.fitting.parameters import tells_index
from gonio_analysis.fitting.problem import STARTS, Bound, FitRequest, Problem, pose, together
from gonio_analysis.fitting.profile_likelihood import Interval, Near, tied, walked
from gonio_analysis.fitting.search import derivatives, refine, search
from gonio_analysis.fitting.settling import settle
from gonio_analysis.fitting.solution import ROUNDING, Solution, residuals_on_log_scale
from gonio_analysis.fitting.steps import covariance, gauss_newton

EXCESS = 2e-5
"""What the bound on rho_dh gives way by, about."""
AT_BOUND, ON_BOUND = 1e-3, 1e-7
"""Part of a range: a parameter nearer to a bound is tried on it; on the search scale: one nearer stands on it."""
UNSETTLED = 0.1
"""Part of chi-square over its degrees of freedom that one more step would take away, above which a search has not come
to its end: of ten models' fits all that had left less than 1e-15."""
NOT_AT_THE_END = (
    "The search has not come to its end: one more step would lower chi-square by {:.2g}, so parameters may be off by"
    " more than is stated. Parameters replace each other here: fix one (--fix) or say what is known of it (--prior)."
)
AGAIN = 8
"""Steps of a fit without a block, from where the linear step says it ends."""


@dataclass(frozen=True, repr=False)
class FitResult(Solution):
    """A fitted model, and everything that a report says about the fit."""

    def intervals(self, *names: str, level: float = 0.95) -> dict[str, Interval]:
        """Profile-likelihood intervals of the fitted parameters, or of those named.

        Parameters
        ----------
        names
            Free parameters; all of them by default.
        level
            Probability that an interval holds the truth.

        Returns
        -------
        dict
            By parameter. Where walking them out meets a lower chi-square than this fit's, they are those of the fit
            that begins there: this fit stands in a valley of its own, and its values may lie outside.
            `gonio_analysis.fitting.profile_likelihood.walked` gives that fit, too.

        Raises
        ------
        ConfigError
            A parameter was not fitted.
        """
        for n in names:
            if n not in self.free:
                raise ConfigError(f"{n} of {self.name} is not fitted; it fits {', '.join(self.free)}")
        return walked(self, self._again, names or None, level=level)[1]

    def _again(self, start: list[Values]) -> FitResult:
        """The same fit, begun at other values."""
        return fit(self.data, replace(self.problem.asked, start=start))


def _require_enough(data: Observations, names: Sequence[str], wavelength: float, name: str) -> None:
    """Refuse too few values; and tables without one at the wavelength of the fit, for they would be left out unsaid."""
    for k, part in enumerate(data.parts):
        if not (data.part == k).any():
            at = "in a broad band" if math.isnan(wavelength) else f"at {wavelength:g} nm"
            raise DataError(
                f"{part.name}: has no value {at}, where the tables are fitted together; choose another with "
                "--wavelength-nm, or fit all wavelengths with --joint"
            )
    if len(data) <= len(names):
        at = "" if math.isnan(wavelength) else f" at {wavelength:g} nm"
        raise DataError(
            f"{name}: {len(data)} usable value{'s' * (len(data) != 1)}{at} cannot determine the parameter"
            f"{'s' * (len(names) != 1)} {', '.join(names)} with an uncertainty: at least {len(names) + 1} are needed"
        )


def fit(
    table: DataFrame | Observations,
    model: str | FitRequest,
    *,
    name: str = "the table",
    say: Say = silent,
    **options: Any,
) -> FitResult:
    """Fit one model to the usable values of a table, at one wavelength.

    Parameters
    ----------
    table
        A measurement table of one sample, or what `observations` made of one.
    model
        What to fit; or the name of a model, with the attributes of `FitRequest` as `options`.
    name, say
        What messages call the table; and who is told a line now and then.

    Raises
    ------
    ConfigError
        Unknown model or parameter, or a model that needs a wavelength for a broad band.
    DataError
        Fewer values than free parameters, or no usable value.
    """
    began = time.perf_counter()
    asked = FitRequest(model, **options) if isinstance(model, str) else replace(model, **options)
    if asked.each is not None and asked.wavelength_nm is not None:
        raise ConfigError(f"--wavelength-nm {asked.wavelength_nm:g}: all wavelengths are fitted together; leave it out")
    if asked.each is not None and asked.energy:
        raise ConfigError("--energy: the bound holds a fit at one wavelength; leave out --joint")
    data = table if isinstance(table, Observations) else observations(table, name, asked.u_rel, polarised=True)
    asked = _with_index(asked, data)
    problem, start = pose(asked), asked.start
    if asked.each is not None:
        first = fit(data, replace(asked, each=None, loss="linear", start=None, searches=STARTS), name=name, say=say)
        problem, data, notes = _together(problem, data, asked.each, name)
        wavelength = math.nan
        alone = [first, *elsewhere(first, {w: data.at(w) for w in data.wavelengths}, name)]
        known = [one.problem.values(one.vector) for one in alone]
        start = [{n: values[n.partition("@")[0]] for n in problem.free} for values in known]
    else:
        data, wavelength, notes = at_one_wavelength(data, problem, name)
    _require_enough(data, problem.free, wavelength, name)
    notes += problem.notes
    if asked.energy:
        problem, start, said = _bounded(problem, fit(data, replace(asked, energy=False), name=name, say=say), start)
        notes += said
    data, goal, vector, jacobian = minimised(problem, data, start, say)
    result = concluded(problem, data, goal, vector, jacobian, wavelength)
    if asked.metric is None and asked.loss == "linear":
        if result.rejected:
            result = nearest(result, say, starts=start or ())
        elif data.covariance is None:
            result = known_by_blocks(result)
    elif not goal.whitened:
        notes.append("Standard errors come from the scatter of the residuals; there is no chi-square.")
    notes += remarks(result)
    return replace(result, notes=[*data.notes, *result.notes, *notes], wall_s=time.perf_counter() - began)


def _with_index(asked: FitRequest, data: Observations) -> FitRequest:
    """With k free, too, where the light is polarised and nobody says what n + ik is: it tells them apart."""
    known = asked.ior is not None or "k" in {*asked.free, *(asked.fix or ())}
    return (
        asked
        if data.light is None or known or not tells_index(asked.model)
        else replace(asked, free=(*asked.free, "k"))
    )


def elsewhere(first: FitResult, by_wavelength: Mapping[float, Observations], name: str) -> list[FitResult]:
    """Fits of other wavelengths alone to begin at: one wavelength may prefer a valley that the others refute."""
    asked, out = replace(first.problem.asked, wavelength_nm=None), []
    for wave in (min(by_wavelength), max(by_wavelength)) if first.problem.family.needs_wavelength else ():
        if wave != first.wavelength_nm:
            with suppress(DataError):  # too few values at this wavelength alone
                out.append(fit(by_wavelength[wave], asked, name=name))
    return out


def concluded(
    problem: Problem, data: Observations, goal: Objective, vector: Floats, jacobian: Floats, wavelength_nm: float
) -> FitResult:
    """What a solution comes to; its standard errors are those of a true model."""
    found = at_solution(problem, data, goal, vector, wavelength_nm)
    spread, condition = covariance(jacobian)
    total = float(found.whitened @ found.whitened) / max(len(data) - len(problem.free), 1)
    if goal.loss != "linear":
        spread = spread * max(goal.widened(found.whitened, len(data) - len(problem.free)), ROUNDING)
    elif not goal.whitened:
        spread = spread * max(total, ROUNDING)
    lower, upper = problem.bounds
    columns = jacobian[:, np.minimum(vector - lower, upper - vector) > AT_BOUND * (upper - lower)]
    residual = np.concatenate([found.whitened, problem.pulls(vector)])
    residual = residual * goal.robust_weights(residual)
    left = float(np.sum((columns @ gauss_newton(columns, residual)) ** 2))
    if left > UNSETTLED * total:
        found = replace(found, notes=[NOT_AT_THE_END.format(left)])
    return replace(found, condition=condition).known_to(spread)


def at_solution(
    problem: Problem, data: Observations, goal: Objective, vector: Floats, wavelength_nm: float
) -> FitResult:
    """A model at a point of the search, before anything is known of its errors."""
    built = problem.model(vector)
    predicted = apparent(built, data)
    white = goal.residual(predicted)
    unknown = np.zeros((vector.size, vector.size))
    return FitResult(
        name=problem.asked.model,
        model=built,
        parameters={},
        free=problem.free,
        covariance=unknown,
        derived={},
        data=data,
        predicted=predicted,
        whitened=white,
        weighting=goal.words,
        chi_square=float(white @ white) if goal.whitened else None,
        wavelength_nm=wavelength_nm,
        condition=math.nan,
        wall_s=0.0,
        problem=problem,
        vector=vector,
        spread=unknown,
        goal=goal,
    )


def nearest(
    rejected: FitResult, say: Say = silent, *, end: Floats | None = None, starts: Sequence[Values] = ()
) -> FitResult:
    """The nearest model, where the data reject every one: with a misfit that makes the residuals most probable.

    The search begins anew without the stated uncertainties, for a fit that trusts them may lie in a valley that only
    the best known values are in. `end` is where such a search has ended already.
    The nearest one is no farther than any of `starts`.
    """
    problem, data = rejected.problem, rejected.data
    unstated = replace(data, covariance=None, u_rel_assumed=None)
    begin = [rejected.vector]
    if not problem.waves:  # a fit of several wavelengths began where one alone ended
        begin.insert(0, search(problem, unstated, say)[0][0] if end is None else end)
    goal = objective(unstated)
    found = [refine(problem, unstated, goal, start, quick=True) for start in begin]
    lower = starts_below(problem, unstated, goal, starts, min(cost for _, cost in found), quick=True)
    found += [refine(problem, unstated, goal, start, quick=True) for start, _ in lower]
    vector = min(found, key=lambda f: f[1])[0]
    residual, columns, stated, _ = residuals_on_log_scale(problem, data, vector, apparent(problem.model(vector), data))
    if stated is not None and estimated_tau(residual, columns, stated) < float(np.median(stated.random)):
        # over many decades a search by the stated uncertainties may end where nothing is right
        rejected = min(rejected, _weighted_from(rejected, vector, say), key=lambda one: one.goal.total(one.whitened))
        if not rejected.rejected:
            return rejected
    tau = 0.0
    for _ in range(TURNS):
        rules = averaging(problem.model(vector), data)
        predicted = apparent(problem.model(vector), data, rules=rules)
        before, tau = tau, estimated_tau(*residuals_on_log_scale(problem, data, vector, predicted))
        goal = with_misfit(data, tau, predicted)
        if before and abs(math.log(tau / before)) < SETTLED:
            break
        vector = refine(problem, data, goal, vector, rules=rules, say=say)[0]
    vector, jacobian = settle(problem, data, goal, vector, rules)
    result = concluded(problem, data, goal, vector, jacobian, rejected.wavelength_nm)
    return known_by_blocks(replace(result, chi_square=rejected.chi_square))


def _weighted_from(first: FitResult, vector: Floats, say: Say) -> FitResult:
    """The same fit by the stated uncertainties, begun at another place.

    A search stays off the bounds, if only by 1e-9. Over many decades that is too far: so they are tried as well.
    """
    problem, data = first.problem, first.data
    lower, upper = problem.bounds
    close = AT_BOUND * (upper - lower)
    on_bounds = np.where(vector < lower + close, lower, np.where(vector > upper - close, upper, vector))
    goal = scaled_to(data, apparent(problem.model(vector), data, quick=True))
    ends = [refine(problem, data, goal, vector, quick=True, say=say)[0]]
    if np.any(on_bounds != vector):
        ends.append(on_bounds)
    found = []
    for end in ends:
        goal = scaled_to(data, apparent(problem.model(end), data))
        for _ in range(TURNS):
            before, (end, jacobian) = end, settle(problem, data, goal, end)
            if np.array_equal(before, end):
                break
        found.append(concluded(problem, data, goal, end, jacobian, first.wavelength_nm))
    return min(found, key=lambda one: one.goal.total(one.whitened))


def known_by_blocks(result: FitResult) -> FitResult:
    """A fit with its misfit, and with the standard errors that follow from it."""
    data, goal, problem, vector = result.data, result.goal, result.problem, result.vector
    if not goal.tau:  # nothing is stated: the misfit takes everything
        freedom = len(data) - len(result.free)
        tau = max(math.sqrt(float(result.whitened @ result.whitened) / freedom), SMALLEST)
        goal = with_misfit(data, tau, result.predicted)
    weights = goal.weights
    assert weights is not None

    def without(kept: npt.NDArray[np.bool_], start: Floats) -> Floats:
        """From the solution to that of the values kept, by the parameters that move."""
        begin = vector.copy()
        begin[moving] += start
        near = Near(replace(result, goal=goal), np.flatnonzero(kept))
        return np.asarray((near.refit(np.clip(begin, lower, upper), moving, limit=AGAIN)[0] - vector)[moving])

    plain = replace(goal, weights=None)
    rules = averaging(result.model, data)
    columns = plain.jacobian(result.predicted, derivatives(problem, data, vector, rules=rules))
    lower, upper = problem.bounds
    moves = (vector > lower + ON_BOUND) & (vector < upper - ON_BOUND) & (np.linalg.norm(columns, axis=0) > 0)
    moving = np.flatnonzero(moves)
    columns, pulls = columns[:, moving], problem.pull_slopes(vector)[:, moving]
    white = np.concatenate([weights.whiten(columns), pulls])
    formal = covariance(white)[0]
    by_blocks = block_spread(
        np.concatenate([(columns.T / weights.random).T, pulls]),
        np.concatenate([weights.apart(plain.residual(result.predicted)), problem.pulls(vector)]),
        data.directions,
        without,
    )
    # few blocks may agree by chance: nothing is better known than with a misfit that is independent everywhere
    least = np.sqrt(np.maximum(np.diag(formal) / np.maximum(np.diag(by_blocks), 1e-300), 1.0))
    inner, of_noise = by_blocks * np.outer(least, least), np.zeros_like(formal)
    stated = on_log_scale(data, goal.small, result.predicted)
    if stated is not None:
        gain = weights.whiten_transposed(np.asarray(np.linalg.pinv(white)[:, : len(data)].T, np.float64)).T
        common = gain @ stated.common
        inner = inner + common @ common.T
        of_noise = (gain * stated.random**2) @ gain.T + common @ common.T
    # a parameter at a bound does not follow when values are left out: its error stays a formal one
    spread, noise = np.diag(np.where(moves, 0.0, np.diag(result.spread))), np.zeros_like(result.spread)
    spread[np.ix_(moving, moving)], noise[np.ix_(moving, moving)] = inner, of_noise
    return replace(
        result, misfit=misfit(result.model, data, goal, result.predicted, result.degrees_of_freedom), noise=noise
    ).known_to(spread)


def remarks(result: FitResult) -> list[str]:
    """How well each of several tables is described, what the data cannot tell, and where the model does not hold."""
    notes = [result.outside] if result.outside else []
    for k, part in enumerate(() if result.chi_square is None else result.data.parts):
        white = result.whitened[: len(result.data)][result.data.part == k]
        notes.append(f"{part.name}: chi-square {float(white @ white):.4g} of {white.size} values.")
    ends = dict(zip(("lower", "upper"), map(result.problem.values, result.problem.bounds), strict=True))
    for n, e in result.parameters.items():
        if e.at_bound:
            notes.append(
                f"{n} ended on its {e.at_bound} bound ({ends[e.at_bound][n]:g})"
                + (": its standard error is formal." if e.u is not None else ", where the data do not determine it.")
                + (" The model is not true, and there it comes nearest." if result.misfit is not None else "")
            )
        elif not e.fixed and e.u is None:
            notes.append(f"{n} is not determined by these data.")
    pairs = tied(result.free, np.array([result.parameters[n].value for n in result.free]), result.covariance)
    notes += pairs
    if result.rejected and result.misfit is not None:
        notes.append(
            "The data reject this model. Its parameters are those of the nearest one over the measured directions, and"
            " their errors say how much they hang on which directions these are."
        )
    elif result.rejected and result.shared is None:
        notes.append(
            "The data reject this model, and the metric or loss that was chosen knows no misfit: the standard errors"
            " are those of a true model, and too small, unless it is outliers that a robust loss is for."
        )
    if not pairs and result.condition > 1e3:
        notes.append(f"The parameters are poorly determined together (condition number {result.condition:.2g}).")
    return notes


def _bounded(
    problem: Problem, free: FitResult, start: Sequence[Values] | None
) -> tuple[Problem, Sequence[Values] | None, list[str]]:
    """The problem with the bound rho_dh <= 1, where to start from, and what to say; the bound costs nothing if unused.

    The bound is as tight as the data pull: what is left above it is far below their uncertainty.
    """
    phi_i = float(free.data.directions.phi_i[0])
    bound = Bound(tuple(rho_angles(free.data)), phi_i, known_wavelength(free.wavelength_nm), 1.0)
    highest = float(bound.rho_dh(free.model).max())
    known = free.problem.values(free.vector)
    if highest <= 1.0:
        return problem, [known], ["rho_dh stays below 1 without the bound of --energy."]
    # an excess e costs (e / width)^2. Data that pull with the slope T' leave e = width^2 T' / 2, and T' is about what a
    # model costs that is too low by this factor.
    cost = free.goal.total(free.goal.residual(free.predicted / highest)) / (highest - 1.0)
    width = math.sqrt(2.0 * EXCESS / max(cost, 1e-12))
    levels = [n for n in ("k_s", "s", "returned", "weight", "k_d", "albedo", "diffuse_albedo") if n in problem.free]
    lower = known | {n: known[n] / highest for n in levels}
    said = f"rho_dh is bound to 1 (--energy); without the bound it is {highest:.3g}."
    return replace(problem, bound=replace(bound, width=width)), start or [known, lower], [said]


def _together(
    problem: Problem, data: Observations, each: Sequence[str], name: str
) -> tuple[Problem, Observations, list[str]]:
    waves = [w for w in data.wavelengths if not math.isnan(w)]
    if len(waves) < 2:
        raise ConfigError(f"{name}: to fit wavelengths together takes two or more; it has {len(waves)}")
    data = data.take(np.isfinite(data.wavelength_nm))
    apart = f"; each has its own {', '.join(each)}" if each else ""
    return together(problem, waves, each), data, [f"{len(waves)} wavelengths are fitted together{apart}."]


def at_one_wavelength(data: Observations, problem: Problem, name: str) -> tuple[Observations, float, list[str]]:
    """The values that are fitted, their wavelength [nm] (NaN: a broad band), and what is said of the choice.

    Raises
    ------
    ConfigError
        A broad band, and a model that needs a wavelength.
    """
    wavelength_nm, family = problem.asked.wavelength_nm, problem.family
    if wavelength_nm is not None and not (math.isfinite(wavelength_nm) and wavelength_nm > 0):
        raise ArgumentError(f"wavelength_nm = {wavelength_nm}: a wavelength is above 0 nm")
    several = [w for w in data.wavelengths if not math.isnan(w)]
    chosen, wavelength = data.nearest(wavelength_nm)
    if not math.isnan(wavelength):
        notes = []
        if len(several) > 1:
            goal = DEFAULT_WAVELENGTH_NM if wavelength_nm is None else wavelength_nm
            asked = "" if wavelength == goal else f", the nearest to {goal:g} nm,"
            choose = "; --wavelength-nm takes another" if wavelength_nm is None else ""
            notes.append(f"The table has {len(several)} wavelengths; {wavelength:g} nm{asked} is fitted{choose}.")
        elif wavelength_nm is not None and abs(wavelength - wavelength_nm) > 1:
            notes.append(
                f"The table has one wavelength, {wavelength:g} nm; it is fitted instead of {wavelength_nm:g} nm."
            )
        return chosen, wavelength, notes
    if wavelength_nm is None:
        if family.needs_wavelength:
            raise ConfigError(
                f"{name} has no single wavelength, and {family.name} needs one: give it with --wavelength-nm"
            )
        return chosen, wavelength, []
    return (
        replace(chosen, wavelength_nm=np.full(len(chosen), float(wavelength_nm))),
        float(wavelength_nm),
        [f"The table has no single wavelength; the model is evaluated at {wavelength_nm:g} nm."],
    )
