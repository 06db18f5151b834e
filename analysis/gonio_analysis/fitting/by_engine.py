"""Fits whose solution an engine finds (`gonio_maps.fits.tables`), and `gonio_analysis.fitting.fit` confirms.

A search takes most of a fit's time. Here the engine searches, and what follows is that of every fit: common causes, the
last step, standard errors. What it finds counts where nothing is left to ask: the last step is short, no parameter
stands at a bound, and all of them are determined. Everything else is searched for as ever.

Where the data reject the model the engine tells both ends that such a fit needs: the least chi-square, and the nearest
model by logarithms. The second one is a neighbour of the first. Where the first one leaves a parameter open, as the
width of a lobe that has gone, another valley may be nearer: so with 20 of 95 fits of Cook-Torrance to other models'
values. There the nearest one is searched for.
"""

from collections.abc import Callable

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult, at_one_wavelength, concluded, nearest
from gonio_analysis.fitting.forward import apparent, pointlike
from gonio_analysis.fitting.minimum import as_stated
from gonio_analysis.fitting.objective import alone, scaled_to
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.search import refine
from gonio_analysis.fitting.settling import settle
from gonio_analysis.fitting.spectrum import shares

Engine = Callable[[Problem, Observations, float], tuple[Floats, float, bool] | None]
"""Problem, values of one wavelength, and that [nm] -> the point of the search scale where a search by the independent
part of the covariance ends, the least chi-square, and whether that rejects the model, whose point is then that of the
nearest one; None where it does not do that."""
SHORT = 1e-2
"""Longest last step, in standard errors, after which what an engine has found counts as a solution."""
SAME = 1e-6
"""Part of chi-square: a search that begins at the nearest model is in the valley of the least one where it ends no
higher. Both searches stop at 1e-10 of it a step."""
UNKNOWN = 0.5
"""Share of its range: beyond this standard error a parameter may have another valley."""


def fit_by(engine: Engine, data: Observations, asked: FitRequest, *, name: str = "the table") -> FitResult | str:
    """A fit by an engine; or, in words, why it has none that is certain.

    Raises
    ------
    ConfigError, DataError
        As `gonio_analysis.fitting.fit.fit`.
    """
    problem = pose(asked)
    if why := _beyond(problem, data):
        return why
    data, wavelength, _ = at_one_wavelength(data, problem, name)
    if len(data) <= len(problem.free):
        return "too few values"
    found = engine(problem, data, wavelength)
    if found is None:
        return "a model or parameters that the engine of maps does not have"
    close, least, rejected = found
    vector = close
    if rejected:
        vector, cost = refine(problem, data, alone(data), close, quick=True)
        if 2.0 * cost > least * (1.0 + SAME):
            return "a rejected model"
    goal = scaled_to(data, apparent(problem.model(vector), data))
    if goal.weights is not None and goal.weights.causes:
        vector = refine(problem, data, goal, vector)[0]
    vector = as_stated(problem, vector)
    end, jacobian = settle(problem, data, goal, vector)
    if not rejected and not np.linalg.norm(jacobian @ (end - vector)) < SHORT:
        return "an unsettled solution"
    result = concluded(problem, data, goal, end, jacobian, wavelength)
    if result.rejected and rejected:
        return nearest(result, end=close if _determined(result) else None)
    return "a rejected model" if result.rejected else _doubt(result) or result


def _beyond(problem: Problem, data: Observations) -> str:
    """What of a fit no engine does, in words; "" for nothing."""
    asked = problem.asked
    for said, true in (
        ("cones", not pointlike(data)),
        ("polarised light", data.light is not None),
        ("no stated uncertainties", data.covariance is None or data.u_rel_assumed is not None),
        ("wavelengths that share a geometry", asked.wavelength_nm is None and shares(asked, data)),
        ("angles whose zeros are uncertain", bool(data.zeros_rad)),
        ("another metric, loss, bound or prior", asked.metric is not None or asked.loss != "linear" or asked.energy
         or bool(asked.bounds) or bool(asked.priors) or bool(problem.words) or asked.each is not None),
    ):  # fmt: skip
        if true:
            return said
    return ""


def _doubt(result: FitResult) -> str:
    """Why a solution may not be the one that a search would end in; "" where nothing is left to ask."""
    if any(one.at_bound for one in result.parameters.values()):
        return "a parameter at its bound"
    return "" if _determined(result) else "a parameter that is not determined"


def _determined(result: FitResult) -> bool:
    """Whether the data tell each parameter."""
    lower, upper = result.problem.bounds
    return bool(np.all(np.sqrt(np.diag(result.spread)) < UNKNOWN * (upper - lower)))
