"""The level of a measurement beside a model that has none of its own: what a number is without "given n and k".

He-Torrance with known n and k says by itself how much light comes back. Its rho_dh then seems known to a millionth,
beside a reference that is known to 0.2 %. Were the level one more parameter, a factor 1 + g on the whole model, the
number would be the measurement's. That fit is one linear step away from the fit that was made.
"""

import math
from dataclasses import dataclass

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.search import derivatives
from gonio_analysis.fitting.solution import Solution

OWN = 1e-4
"""Part of what the values tell of a level that is left beside the parameters; of less the model has it of its own. Its
slopes are right to a hundredth of that."""
MOST = 0.1
"""Standard uncertainty of a level that the parameters follow: a step is no longer straight, and they hold it."""
TIGHTER = 1.05
"""Factor by which taking the model at its word has to sharpen a number; less is not worth a second number."""


@dataclass(frozen=True)
class MeasuredLevel:
    """The level of the measured values, over that of a fitted model which has none to fit."""

    off: float
    """g of the factor 1 + g."""
    u: float
    """Its standard uncertainty: the common scale of the values (the reference) is in it."""
    pull: Floats
    """(p,): the fit's parameters move by -spread @ pull for each unit of g."""

    def applied(self, value: float, u: float, along: float) -> tuple[float, float]:
        """A number that is proportional to the BRDF, at this level, and its standard uncertainty.

        Parameters
        ----------
        value, u
            The fitted model's.
        along
            What the number changes by where the parameters move by spread @ pull.
        """
        per = value - along
        return value + per * self.off, math.hypot(u, per * self.u)


def level(result: Solution) -> MeasuredLevel | None:
    """How the values' level stands to a fit's; None where the model has its own, is rejected, or nothing is stated.

    With f the model, J its derivatives, r what the values leave (all whitened), P the covariance of the parameters and
    b = J^T f, the parameters being at their optimum: g = f^T r / (f^T f - b^T P b), its variance 1 / (the same).
    """
    if result.misfit is not None or result.chi_square is None or result.rejected or result.goal.loss != "linear":
        return None
    problem, data, goal = result.problem, result.data, result.goal
    near = apparent(problem.model(result.vector), data, quick=True)
    known = np.isfinite(np.diag(result.spread))
    columns = goal.jacobian(near, derivatives(problem, data, result.vector, quick=True))[:, known]
    model = goal.jacobian(result.predicted, result.predicted[:, None])[:, 0]
    pull = np.zeros(known.size)
    pull[known] = columns.T @ model
    whole = float(model @ model)
    left = whole - float(pull[known] @ result.spread[np.ix_(known, known)] @ pull[known])
    if left <= max(OWN * whole, MOST**-2):
        return None
    return MeasuredLevel(-float(model @ result.whitened[: len(data)]) / left, 1.0 / math.sqrt(left), pull)
