"""Fits whose solution an engine finds (`gonio_maps.fits.tables`), and `gonio_analysis.fitting.fit` confirms.

A search takes most of a fit's time. Here the engine searches, and what follows is that of every fit: the last step, the
standard errors and the misfit. What it finds counts where nothing is left to ask: the last step is short, no parameter
stands at a bound, and all of them are determined. Everything else is searched for as ever.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult, as_stated, at_one_wavelength, concluded, known_by_blocks
from gonio_analysis.fitting.forward import apparent, pointlike
from gonio_analysis.fitting.objective import scaled_to, with_misfit
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.settling import settle
from gonio_analysis.fitting.spectrum import shares

Engine = Callable[[Problem, Observations, float], tuple[Floats, float, float] | None]
"""Problem, values of one wavelength, and that [nm] -> the point of the search scale, the least chi-square, and the
misfit of a model that is rejected; None where it does not do that."""
SHORT = 1e-2
"""Longest last step, in standard errors, after which what an engine has found counts as a solution."""
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
    vector, chi_square, tau = found
    if tau and data.covariance is not None and data.covariance.causes:
        return "a rejected model of values with common causes"  # what these are scaled to is not what the engine takes
    predicted = apparent(problem.model(vector), data)
    goal = with_misfit(data, tau, predicted) if tau else scaled_to(data, predicted)
    vector = as_stated(problem, vector)
    end, jacobian = settle(problem, data, goal, vector)
    if not np.linalg.norm(jacobian @ (end - vector)) < SHORT:
        return "an unsettled solution"
    result = concluded(problem, data, goal, end, jacobian, wavelength)
    if why := _doubt(result):
        return why
    if tau:
        return known_by_blocks(replace(result, chi_square=chi_square))
    return "a borderline chi-square" if result.rejected else result


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
    lower, upper = result.problem.bounds
    if any(one.at_bound for one in result.parameters.values()):
        return "a parameter at its bound"
    if not np.all(np.sqrt(np.diag(result.spread)) < UNKNOWN * (upper - lower)):
        return "a parameter that is not determined"
    return ""
