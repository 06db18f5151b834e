"""How far off a model may be that chi-square does not reject: a smooth misfit that it would find in half of the cases.

The misfit is relative and normal, smooth over `SMOOTH` of the half vector's and of the detector's direction, and X is
its root mean square over the measured directions. What parameters and common causes take up of it nobody sees. The
rest raises chi-square, by X^2 q on average. See docs/misfit.md.

Its kernel is exp(-d^2 / 2L^2): d is the distance in the half vector and in the detector's direction, and L = 20
degrees. With F the model, C the covariance of the test and J the derivatives by parameters the rest raises chi-square
to a noncentral one:

    lambda = (F m)^T P (F m),    P = W - W J (J^T W J)^-1 J^T W,    W = C^-1

X is where the mean probability of a rejection at the 1 % level, over 400 fixed draws of m, is one half. Above 50 %
nothing is said.
"""

import math

import numpy as np

from gonio.geometry import Directions
from gonio.models.corrected import folded
from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.objective import Objective
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import derivatives

SMOOTH = math.radians(20.0)
"""Length of the squared-exponential kernel: misfits of directions so far apart have the correlation 0.61."""
MOST_VALUES, MOST_NODES = 20_000, 200
"""Values that are looked at, each for its neighbours as well, and values that the kernel rests on; evenly taken."""
DRAWS = 400
"""Misfits that are drawn, always the same ones."""
SMALLEST, LARGEST = 1e-12, 1e3
"""Limits between which X is sought."""
FOUND = 0.5
JITTER = 1e-8
SURE = 6.0
"""A mean chi-square so many times its limit is always beyond it."""


def unnoticed(problem: Problem, data: Observations, goal: Objective, vector: Floats, significance: float) -> float:
    """X: the relative size of a smooth misfit that chi-square rejects in half of the cases, 1e-12 to 1e3.

    Parameters
    ----------
    problem, data, goal, vector
        What was fitted, to what, by which covariance, and the solution on the search scale.
    significance
        Level of the test.
    """
    n, freedom = len(data), len(data) - len(problem.free)
    if freedom < 1:
        return LARGEST
    rows = np.arange(0, n, -(-n // MOST_VALUES))
    data, goal = data.take(rows), goal.take(rows)
    predicted = apparent(problem.model(vector), data, quick=True)
    lower, upper = problem.bounds
    inside = np.flatnonzero((vector > lower) & (vector < upper))
    columns = goal.jacobian(predicted, derivatives(problem, data, vector, here=predicted, only=inside))
    root = smooth_root(folded(data.directions, problem.model(vector)))
    seen = math.sqrt(n / rows.size) * goal.jacobian(predicted, predicted[:, None] * root)
    return half_found(root, seen, columns, freedom, significance)


def smooth_root(directions: Directions) -> Floats:
    """root @ root.T is the kernel, of variance 1, among directions (n,)."""
    from scipy.linalg import solve_triangular

    omega_i, omega_r = directions.vectors
    half = omega_i + omega_r
    places = np.hstack([half / np.linalg.norm(half, axis=1, keepdims=True), omega_r]) / SMOOTH
    nodes = places[:: -(-len(places) // MOST_NODES)]
    among, to_nodes = (np.exp(-0.5 * ((a[:, None, :] - nodes[None, :, :]) ** 2).sum(axis=2)) for a in (nodes, places))
    lower = np.linalg.cholesky(among + JITTER * np.eye(len(nodes)))
    root = solve_triangular(lower, to_nodes.T, lower=True).T
    return np.asarray(root / np.maximum(np.linalg.norm(root, axis=1, keepdims=True), 1e-3))


def half_found(root: Floats, seen: Floats, columns: Floats, freedom: int, significance: float) -> float:
    """X of misfits that are sums of columns with normal weights.

    Parameters
    ----------
    root, seen : (n, m) arrays
        These columns, relative, and what they are of whitened residuals.
    columns : (n, p) array
        Derivatives of whitened residuals by the parameters.
    freedom, significance
        Of the test.
    """
    from scipy.optimize import brentq
    from scipy.special import chdtri, chndtr

    felt = columns[:, np.linalg.norm(columns, axis=0) > 0]
    basis = np.linalg.qr(felt / np.linalg.norm(felt, axis=0))[0]
    left = seen - basis @ (basis.T @ seen)
    weights = np.random.default_rng(20).standard_normal((root.shape[1], DRAWS))
    size, raised = (((x.T @ x @ weights) * weights).sum(axis=0) for x in (root, left))
    q = len(root) * np.maximum(raised, 0.0) / size
    limit = float(chdtri(freedom, significance))

    def short(log_x: float) -> float:
        missed = chndtr(limit, freedom, np.minimum(math.exp(2.0 * log_x) * q, SURE * limit))
        return float(np.mean(missed)) - (1.0 - FOUND)

    low, high = math.log(SMALLEST), math.log(LARGEST)
    if short(high) > 0.0:
        return LARGEST  # the values are all noise: they leave room for any misfit
    return SMALLEST if short(low) < 0.0 else math.exp(float(brentq(short, low, high, xtol=1e-4)))
