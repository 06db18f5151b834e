"""The solution for a table by the engine that fits pixels, in a millisecond; a search takes twenty to a thousand."""

import math

import numpy as np
from gonio_analysis.fitting.forward import known_wavelength
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem

from gonio import materials
from gonio.typing import Floats
from gonio_maps.models import batch
from gonio_maps.models._batch_models import MODELS, SCALES


def solved(problem: Problem, data: Observations, wavelength_nm: float) -> tuple[Floats, float, bool] | None:
    """Where the fit of a model to the values of one wavelength ends, cones being directions.

    Parameters
    ----------
    problem
        What moves.
    data
        Values with uncertainties, of unpolarised light. As in a search, common causes do not count.
    wavelength_nm
        NaN for a broad band.

    Returns
    -------
    tuple of array, float, bool
        The point of the search scale, the least chi-square, and whether that rejects the model, whose point is then
        that of the nearest one. None where the engine does not have this model or these parameters, or a value cannot
        be weighed.
    """
    known = _known(problem, wavelength_nm)
    if known is None or data.covariance is None:
        return None
    model, origin, u = MODELS[problem.asked.model], np.zeros(1), data.covariance.random[None]
    source, camera = data.directions.vectors

    def fitted(fixed: dict[str, float]) -> batch.Fits:
        return batch.fit(
            problem.asked.model, origin, origin, source, camera, data.brdf[None], u, fixed=fixed,
            wavelength_nm=known_wavelength(wavelength_nm), threads=1,
        )  # fmt: skip

    found = fitted(known)
    if found.used[0] < len(data) or set(found.free) != set(problem.free) or not math.isfinite(found.chi_square[0]):
        return None
    if found.tau[0] > 0.0 and model.scaled and set(model.scaled) <= set(found.free):
        # a wrong model may be least far off as rough as can be, which is further than the engine's starts reach
        rough = fitted(known | {model.scaled[0]: SCALES[-1] / model.own(wavelength_nm)[0]})
        found = rough if rough.chi_square[0] < found.chi_square[0] else found
    values = dict(zip(found.names, found.values[0].tolist(), strict=True))
    return problem.vector(values), float(found.chi_square[0]), bool(found.tau[0] > 0.0)


def _known(problem: Problem, wavelength_nm: float) -> dict[str, float] | None:
    """What is not fitted, with its value; None where the engine has no such model or parameters."""
    model = MODELS.get(problem.asked.model)
    if model is None or problem.words or not set(problem.free) <= set(model.names):
        return None
    known = {name: value for name, value in problem.fixed.items() if name in model.names}
    if isinstance(problem.ior, str):
        if math.isnan(wavelength_nm):
            return None
        index = complex(materials.ior(problem.ior)(wavelength_nm))
        known = {"ior": index.real, "k": index.imag} | known
    return known
