"""The last steps of a search, with derivatives of the model through the cones of the instrument.

Gauss and Newton's step takes the model as straight. Where the data reject it residuals are large, what it bends by
counts as much, and their steps creep along a valley: of 335 values a chi-square of 1e6 falls by 1e-3 a step for a
hundred steps. There Newton's step takes the second derivatives of the quick model, which costs little.
"""

from __future__ import annotations

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.forward import Averaging, apparent, averaging
from gonio_analysis.fitting.objective import Objective
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import derivatives, to_full
from gonio_analysis.fitting.steps import last_step

MOST = 6
"""Steps, at most; Newton's double the digits."""
PARTS = (1.0, 0.5, 0.25, 0.1)
"""Parts of a step that are tried, one after the other."""
SETTLED, SETTLED_PART = 1e-4, 1e-7
"""What a step gains of the sum of squares, and of it as a part, below which there is no other."""
BEND = 1e-3
"""Step for second derivatives, on the search scale: first ones are right to 1e-9, so second ones to 1e-6."""


def settle(
    problem: Problem, data: Observations, goal: Objective, vector: Floats, rules: Averaging = None
) -> tuple[Floats, Floats]:
    """Last steps with the full derivatives, while they help; the point, and the Jacobian where the last of them began.

    A parameter that stays at a bound is put onto it. The first step is Gauss and Newton's; those after it are Newton's,
    also where the first does not help.
    """
    rules = rules or averaging(problem.model(vector), data)
    lower, upper = problem.bounds
    predicted = apparent(problem.model(vector), data, rules=rules)
    for turn in range(MOST):
        residual = np.concatenate([goal.residual(predicted), problem.pulls(vector)])
        robust = goal.robust_weights(residual)
        jacobian = goal.jacobian(predicted, derivatives(problem, data, vector, rules=rules))
        jacobian = np.concatenate([jacobian, problem.pull_slopes(vector)]) * robust[:, None]
        weighted = residual * robust
        before = float(weighted @ weighted)
        bent = _bent(problem, data, goal, vector, predicted, weighted[: len(data)]) if turn else None
        moved = last_step(vector, weighted, jacobian, lower, upper, bent)
        for part in PARTS:
            trial = moved if part == 1.0 else vector + part * (moved - vector)
            there = apparent(problem.model(trial), data, rules=rules)
            after = np.concatenate([goal.residual(there), problem.pulls(trial)]) * robust
            gained = before - float(after @ after)
            # a bound that is put on exactly may cost the last digits of the sum
            if gained >= -1e-9 * before and (part == 1.0 or gained > 0.0):
                break
        else:
            if turn:
                break
            continue
        vector, predicted = trial, there
        if gained <= min(SETTLED, SETTLED_PART * before):
            break
    return vector, jacobian


def _bent(
    problem: Problem, data: Observations, goal: Objective, vector: Floats, predicted: Floats, residual: Floats
) -> Floats | None:
    """What residuals add to the second derivatives (p, p) of half their sum of squares; None where it is not finite.

    The model bends as the quick one times the ratio of both does.
    """
    (lower, upper), out = problem.bounds, np.zeros((vector.size, vector.size))
    ratio = to_full(predicted, apparent(problem.model(vector), data, quick=True))
    for k in np.flatnonzero((vector > lower) & (vector < upper)):
        slopes, (up, down) = [], (vector.copy(), vector.copy())
        up[k], down[k] = min(vector[k] + BEND, upper[k]), max(vector[k] - BEND, lower[k])
        for x in (up, down):
            here = apparent(problem.model(x), data, quick=True)
            columns = derivatives(problem, data, x, here=here) * ratio[:, None]
            slopes.append(goal.jacobian(here * ratio, columns).T @ residual)
        out[k] = (slopes[0] - slopes[1]) / (up[k] - down[k])
    return 0.5 * (out + out.T) if np.all(np.isfinite(out)) else None
