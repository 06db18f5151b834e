"""Steps of least squares inside bounds, and the covariance at their end."""

from __future__ import annotations

import math

import numpy as np

from gonio.typing import Floats

LONGEST = 0.1
"""Longest that a last step of a search may be, on the search scale."""
NO_EFFECT = 1e-10
"""What a parameter's longest step changes of the residuals, as a part, below which it stays."""
LEAST_CURVED = 1e-8
"""Least curvature, of parameters of one size, that Newton's step goes by; a saddle has less than none."""


def last_step(
    vector: Floats, residual: Floats, jacobian: Floats, lower: Floats, upper: Floats, bent: Floats | None = None
) -> Floats:
    """Where the Gauss-Newton step of the parameters that stand at no bound ends; one that comes to a bound stays on it.

    Newton's step with `bent`, what residuals add to the second derivatives (p, p). What first comes to a bound, or to
    the longest step, is held there, and the others go on; what has no effect stays. Parameters with infinite bounds may
    go any way.
    """
    margin = 1e-6 * np.minimum(upper - lower, 1.0)
    longest = np.where(np.isfinite(upper - lower), LONGEST, np.inf)
    low, high = np.maximum(lower - vector, -longest), np.minimum(upper - vector, longest)
    tells = np.linalg.norm(jacobian, axis=0) * LONGEST > NO_EFFECT * np.linalg.norm(residual)
    step, moving = np.zeros(vector.size), np.flatnonzero((vector > lower + margin) & (vector < upper - margin) & tells)
    while moving.size:
        slopes, left = jacobian[:, moving], residual + jacobian @ step
        if bent is None:
            part = gauss_newton(slopes, left)
        else:
            part = newton(slopes, left, (bent @ step)[moving], bent[np.ix_(moving, moving)])
        limit = np.where(part < 0.0, low[moving], high[moving])
        first = int(np.argmax(part / limit))
        if part[first] / limit[first] <= 1.0:
            step[moving] = part
            break
        step[moving[first]] = limit[first]
        moving = np.delete(moving, first)
    moved = np.clip(vector + step, lower, upper)
    return np.where(moved <= lower + margin, lower, np.where(moved >= upper - margin, upper, moved))


def newton(jacobian: Floats, residual: Floats, slope: Floats, bent: Floats) -> Floats:
    """Newton's step (p,); Gauss and Newton's at a saddle.

    `bent` (p, p) and `slope` (p,) are what is added to the second and first derivatives that residuals have by
    themselves.
    """
    size = np.linalg.norm(jacobian, axis=0)
    columns = jacobian / size
    values, axes = np.linalg.eigh(columns.T @ columns + bent / size / size[:, None])
    if values[0] < LEAST_CURVED:
        return gauss_newton(jacobian, residual)
    return np.asarray(-(axes / values) @ (axes.T @ (columns.T @ residual + slope / size)) / size)


def gauss_newton(jacobian: Floats, residual: Floats) -> Floats:
    """The step (p,) that makes residual + jacobian step smallest, whatever the parameters' scales."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(jacobian / size, -residual, rcond=1e-10)[0] / size)


def covariance(jacobian: Floats) -> tuple[Floats, float]:
    """(J^T J)^-1 on the search scale, and the condition number of J with columns of unit length.

    A column of zeros (a parameter without any effect) gets an infinite variance.
    """
    size = np.linalg.norm(jacobian, axis=0)
    seen = size > 0
    out = np.full((size.size, size.size), 0.0)
    out[~seen, ~seen] = np.inf
    if not seen.any():
        return out, math.inf
    _, values, right = np.linalg.svd(jacobian[:, seen] / size[seen], full_matrices=False)
    values = np.maximum(values, 1e-12 * values[0])
    out[np.ix_(seen, seen)] = (right.T / values**2) @ right / np.outer(size[seen], size[seen])
    return out, float(values[0] / values[-1]) if seen.all() else math.inf
