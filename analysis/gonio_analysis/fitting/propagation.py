"""Points around a solution that carry its parameters' uncertainty to any number: inside the bounds, and near the data.

A slope carries it where parameters are known well. Where they trade (a level against an index) a standard deviation
along what the data hardly tell goes out of the bounds, or round a bend where the model is far from the values. Both
ends of each principal axis are taken instead, each no farther than the bounds and the data let it go.
"""

import math
from collections.abc import Callable

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.objective import Objective
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import derivatives

BENT = 1.5
"""Factor by which the sum of squares may rise more than a straight model's would."""
NEAREST = 1e-4
"""Part of a standard deviation that is tried at least."""
HALVINGS = 8
"""Steps of the search for the farthest point: right to 4 % of a standard deviation, above what an uncertainty needs."""
LEAST_VARIANCE = 1e-10
"""Eigenvalue of a correlation below which parameters determine each other: a sample file's has twelve decimals."""


def axes_of(spread: Floats) -> Floats:
    """Principal axes of a covariance, one standard deviation long, (k, p)."""
    u = np.sqrt(np.maximum(np.diag(spread), 0.0))
    scale = np.where(u > 0.0, u, 1.0)
    sizes, directions = np.linalg.eigh(spread / np.outer(scale, scale))
    kept = sizes > LEAST_VARIANCE
    return np.asarray((u[:, None] * directions[:, kept] * np.sqrt(sizes[kept])).T)


def points_around(problem: Problem, data: Observations, goal: Objective, vector: Floats, spread: Floats) -> Floats:
    """Both ends of each axis of the parameters' covariance, (2k, p); of f there, u(f)^2 is half the sum of (f - f0)^2.

    Parameters
    ----------
    problem, data, goal
        What was fitted, to what, and what was made small.
    vector : (p,) array
        The solution on the search scale.
    spread : (p, p) array
        Its covariance, finite.
    """

    def total(at: Floats) -> float:
        pulls = problem.pulls(at)
        return goal.total(goal.residual(apparent(problem.model(at), data, quick=True))) + float(pulls @ pulls)

    axes, least = axes_of(spread), total(vector)
    near = apparent(problem.model(vector), data, quick=True)
    columns = goal.jacobian(near, derivatives(problem, data, vector, here=near))
    most = float(max(len(data) - vector.size, 1))  # the residuals that are left then are twice what they are
    out = []
    for axis in axes:
        straight = float(np.sum((columns @ axis) ** 2))
        allowed = least + min(BENT * max(straight, 1.0), most)
        out += [_farthest(total, allowed, vector, sign * axis, problem.bounds) for sign in (1.0, -1.0)]
    return np.array(out).reshape(-1, vector.size)


def _farthest(
    total: Callable[[Floats], float], allowed: float, vector: Floats, axis: Floats, bounds: tuple[Floats, Floats]
) -> Floats:
    """The farthest point on a line that is inside the bounds and near the data, at most one standard deviation away."""
    lower, upper = bounds
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(axis > 0, (upper - vector) / axis, np.where(axis < 0, (lower - vector) / axis, np.inf))
    far = min(1.0, max(float(room.min()), 0.0))

    def at(part: float) -> Floats:
        return np.asarray(np.clip(vector + part * axis, lower, upper))

    if far == 0.0 or total(at(far)) <= allowed:
        return at(far)
    low, high = math.log(NEAREST * far), math.log(far)
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if total(at(math.exp(middle))) <= allowed else (low, middle)
    return at(math.exp(low))
