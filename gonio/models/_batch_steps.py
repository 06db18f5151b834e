"""Levenberg and Marquardt's least squares of one pixel, on a model that comes in as compiled functions (`SHADE`...)."""

from __future__ import annotations

import numpy as np
from numba import types

from gonio.models._batch_algebra import (
    called,
    dot,
    inlined,
    residuals,
    seen_by_causes,
    slopes_of_scale,
    solve,
    whitened_causes,
)

ROW = types.float64[::1]
TAKE = types.int64(ROW, ROW, ROW, ROW)
"""Unit vectors to source and to camera, three numbers a value, what is known -> the columns of the model's kernel."""
SHADE = types.int64(ROW, ROW, ROW)
"""Columns and parameters -> BRDF of each value [1/sr]."""
DERIVE = types.int64(ROW, ROW, types.int64, ROW, ROW)
"""Columns, parameters, which of them, BRDF -> 1 and its derivative where a formula gives it; else 0."""
UNIT = types.int64(ROW)
"""Sets the levels among the parameters to 1 and 0; tells what of them follows by linear least squares."""
LEVELS = types.int64(ROW, types.float64, types.float64)
"""Sets parameters from the level of a lobe and from a base [1/sr]."""

STEP = 1e-6
"""Of a parameter, relative, for a derivative by differences: its error is 1e-6 of the derivative."""
SETTLED = 1e-8
"""Decrease of chi-square that a last step would bring: it is then shorter than 1e-4 standard errors."""
MOST_STEPS, MOST_TRIALS = 400, 12
FIRST_DAMPING = 1e-3
NEAR_BOUND = 1e-4
"""Of a parameter's range."""


@inlined
def toward(value, step, low, high):  # type: ignore[no-untyped-def]
    """A step within bounds: onto a bound only from nearby, for there a slope may vanish (Oren-Nayar's at sigma = 0)."""
    bound = low if step < 0.0 else high
    if step == 0.0 or (value + step - bound) * step < 0.0:
        return value + step
    return bound if abs(bound - value) < NEAR_BOUND * (high - low) else value + 0.9 * (bound - value)


@called
def linearised(shade, derive, columns, theta, f, w, slope, free, lower, upper, trial, derivatives, count):  # type: ignore[no-untyped-def]
    """Derivatives of the weighted values by the parameters that move."""
    for a in range(free.size):
        at = free[a]
        d = derivatives[a, :count]
        step = 1.0
        if derive(columns, theta, at, f, d) == 0:
            step = STEP * max(abs(theta[at]), 1e-3 * (upper[at] - lower[at]))
            step = -step if theta[at] + step > upper[at] else step
            trial[:] = theta
            trial[at] += step
            shade(columns, trial, d)
            for j in range(count):
                d[j] = (d[j] - f[j]) / step
        for j in range(count):
            d[j] *= w[j] * slope[j]


@called
def missed(f, z, w, small, r, causes, inner, residual, other, count):  # type: ignore[no-untyped-def]
    """Chi-square; `residual` and what the causes see of it."""
    residuals(f, z, w, small, residual, count)
    chi = dot(residual, residual, count)
    if r:
        seen_by_causes(causes, inner, residual, count, other)
        chi -= dot(other, other, r)
    return chi


@called
def normal(derivatives, residual, causes, inner, other, of_causes, matrix, right, count):  # type: ignore[no-untyped-def]
    """The normal equations, with the causes by Woodbury's formula."""
    k, r = right.size, other.size
    for a in range(k):
        right[a] = dot(derivatives[a], residual, count)
        if r:
            seen_by_causes(causes, inner, derivatives[a], count, of_causes[a])
            right[a] -= dot(of_causes[a], other, r)
        for b in range(a + 1):
            matrix[a, b] = dot(derivatives[a], derivatives[b], count)
            if r:
                matrix[a, b] -= dot(of_causes[a], of_causes[b], r)
            matrix[b, a] = matrix[a, b]


@called
def minimised(shade, derive, columns, z, w, small, relative, theta, free, lower, upper, f, work, matrix, moves, count):  # type: ignore[no-untyped-def]
    """Levenberg and Marquardt's least squares from `theta` on, which is moved; chi-square at the end.

    `matrix` becomes the normal matrix at the end, `work` rows: derivatives, causes, then residual, slope and a trial.
    """
    k, r, size = free.size, relative.shape[0], theta.size
    derivatives, causes = work[:k], work[k : k + r]
    residual, slope, tried = work[k + r, :count], work[k + r + 1, :count], work[k + r + 2, :count]
    triangle, inner = np.empty((k, k)), np.empty((r, r))
    right, step, of_causes, other = np.empty(k), np.empty(k), np.empty((k, r)), np.empty(r)
    trial, new = np.empty(size), np.empty(size)
    damping, chi = FIRST_DAMPING, np.inf
    shade(columns, theta, f)
    for _ in range(MOST_STEPS):
        slopes_of_scale(f, small, slope, count)
        linearised(shade, derive, columns, theta, f, w, slope, free, lower, upper, trial, derivatives, count)
        if r:
            whitened_causes(relative, f, w, slope, causes, inner, count)
        chi = missed(f, z, w, small, r, causes, inner, residual, other, count)
        normal(derivatives, residual, causes, inner, other, of_causes, matrix, right, count)
        for a in range(k):
            at = free[a]
            held = (theta[at] <= lower[at] and right[a] < 0.0) or (theta[at] >= upper[at] and right[a] > 0.0)
            moves[a] = matrix[a, a] > 0.0 and not held
        ended = True
        for _ in range(MOST_TRIALS):
            solve(matrix, right, moves, damping, triangle, step)
            gain = dot(step, right, k)
            new[:] = theta
            for a in range(k):
                new[free[a]] = toward(theta[free[a]], step[a], lower[free[a]], upper[free[a]])
            shade(columns, new, tried)
            found = chi if gain < SETTLED else missed(tried, z, w, small, r, causes, inner, residual, other, count)
            if found <= chi:
                theta[:] = new
                f[:count] = tried
                damping = max(0.1 * damping, 1e-12)
                ended = gain < SETTLED
                break
            damping = max(10.0 * damping, 1e-6)
        if ended:
            break
    return chi
