"""Levenberg and Marquardt's least squares of one pixel, on a model that comes in as compiled functions (`SHADE`...)."""

import numpy as np
from numba import types

from gonio_maps.models._batch_algebra import (
    called,
    copied,
    cross,
    dot,
    inlined,
    residuals,
    seen_by_causes,
    slopes_of_scale,
    solve,
    viewing,
    whitened_causes,
)

ROW = types.float64[::1]
TAKE = types.int64(ROW, ROW, ROW, ROW)
"""Unit vectors to source and to camera, three numbers a value, what is known -> the columns of the model's kernel."""
SHADE = types.int64(ROW, ROW, types.int64, ROW)
"""Columns, sets of parameters one after the other, how many sets -> BRDF of each value [1/sr], set after set."""
DERIVE = types.int64(ROW, ROW, types.int64, ROW, ROW)
"""Columns, parameters, which of them, BRDF -> 1 and its derivative where a formula gives it; else 0."""
UNIT = types.int64(ROW)
"""Sets the levels among the parameters to 1 and 0; tells what of them follows by linear least squares."""
LEVELS = types.int64(ROW, types.float64, types.float64)
"""Sets parameters from the level of a lobe and from a base [1/sr]."""

STEP = 1e-7
"""Relative step of a parameter for a derivative by differences: its error is 1e-7 of the derivative."""
SETTLED = 1e-8
"""Decrease of chi-square by the last step, at most: it is shorter than 1e-4 standard errors, and not judged."""
MOST_STEPS, MOST_TRIALS = 1500, 12
"""Levels and an index may replace each other along a bent valley of 500 steps and more."""
FIRST_DAMPING = 1e-3
NEAR_BOUND = 1e-4
"""Part of a parameter's range; a last step is shorter."""
SAME_VALLEY = 0.1
"""Squared distance, in standard errors, from a minimum that is known: what is above it and as near leads to it."""


@inlined
def toward(value, step, low, high):  # type: ignore[no-untyped-def]
    """A step within bounds: onto a bound only from nearby, for there a slope may vanish (Oren-Nayar's at sigma = 0)."""
    bound = low if step < 0.0 else high
    if step == 0.0 or (value + step - bound) * step < 0.0:
        return value + step
    return bound if abs(bound - value) < NEAR_BOUND * (high - low) else value + 0.9 * (bound - value)


@called
def by_differences(derive, columns, free, lower, upper):  # type: ignore[no-untyped-def]
    """Which of the free parameters have no derivative by formula, in the middle of their ranges."""
    out, nothing = np.empty(free.size, np.bool_), columns[:0]
    for a in range(free.size):
        out[a] = derive(nothing, 0.5 * (lower + upper), free[a], nothing, nothing) == 0
    return out


@inlined
def difference(value, low, high):  # type: ignore[no-untyped-def]
    """The step for a derivative by differences, within bounds."""
    step = STEP * max(abs(value), 1e-3 * (high - low))
    return -step if value + step > high else step


@viewing
def shaded(shade, columns, theta, free, lower, upper, differs, trials, out, count):  # type: ignore[no-untyped-def]
    """The model, and after it the model a step further along each parameter that `differs`."""
    size, sets = theta.size, 1
    copied(theta, trials, 0, size)
    for a in range(free.size):
        if differs[a]:
            copied(theta, trials, sets * size, size)
            trials[sets * size + free[a]] += difference(theta[free[a]], lower[free[a]], upper[free[a]])
            sets += 1
    shade(columns, trials[: sets * size], sets, out[: sets * count])


@viewing
def linearised(  # type: ignore[no-untyped-def]
    shade, derive, columns, theta, values, w, slope, free, lower, upper, differs, trials, derivatives, count
):
    """Derivatives of the weighted values by the parameters that move, from what `shaded` gives."""
    f, sets = values[:count], 1
    for a in range(free.size):
        at = free[a]
        d = derivatives[a, :count]
        step = difference(theta[at], lower[at], upper[at])
        if differs[a]:
            for j in range(count):
                d[j] = (values[sets * count + j] - f[j]) / step
            sets += 1
        elif derive(columns, theta, at, f, d) == 0:
            copied(theta, trials, 0, theta.size)
            trials[at] += step
            shade(columns, trials[: theta.size], 1, d)
            for j in range(count):
                d[j] = (d[j] - f[j]) / step
        for j in range(count):
            d[j] *= w[j] * slope[j]


@viewing
def missed(f, z, w, small, r, causes, inner, residual, other, count):  # type: ignore[no-untyped-def]
    """Chi-square; `residual` and what the causes see of it."""
    residuals(f, z, w, small, residual, count)
    chi = dot(residual, residual, count)
    if r:
        seen_by_causes(causes, inner, residual, count, other)
        chi -= dot(other, other, r)
    return chi


@viewing
def normal(derivatives, residual, causes, inner, other, of_causes, matrix, right, count):  # type: ignore[no-untyped-def]
    """The normal equations, with the causes by Woodbury's formula."""
    k, r = right.size, other.size
    for a in range(k):
        right[a] = dot(derivatives[a], residual, count)
        if r:
            seen_by_causes(causes, inner, derivatives[a], count, of_causes[a])
            right[a] -= dot(of_causes[a], other, r)
        for b in range(a + 1):
            matrix[a, b] = cross(derivatives, a, derivatives, b, count)
            if r:
                matrix[a, b] -= dot(of_causes[a], of_causes[b], r)
            matrix[b, a] = matrix[a, b]


@called
def room_for(k, r, size, n, differs):  # type: ignore[no-untyped-def]
    """Memory that `minimised` and `narrowed` work in, for all their calls."""
    sets = 1 + max(differs.sum(), 1)
    return (
        np.empty((k, k)), np.empty((r, r)), np.empty(k), np.empty(k), np.empty((k, r)), np.empty(r), np.empty(size),
        np.empty(sets * size), np.empty(sets * n), np.empty(sets * n), differs,
    )  # fmt: skip


@viewing
def distance(theta, other, free, matrix):  # type: ignore[no-untyped-def]
    """Squared distance of the free parameters, in standard errors of a normal matrix."""
    out = 0.0
    for a in range(free.size):
        for b in range(free.size):
            out += (theta[free[a]] - other[free[a]]) * matrix[a, b] * (theta[free[b]] - other[free[b]])
    return out


@viewing
def minimised(  # type: ignore[no-untyped-def]
    shade, derive, columns, z, w, small, relative, theta, free, lower, upper, f, work, matrix, moves, room, count,
    known, there, around,
):  # fmt: skip
    """Levenberg and Marquardt's least squares from `theta` on, which is moved; chi-square at the end.

    `f` becomes the model at the end, `matrix` the normal matrix; `work` has rows for derivatives, causes, residual
    and slope. It stops where it comes to a minimum that is `known`, which lies `there` with the normal matrix `around`.
    """
    k, r = free.size, relative.shape[0]
    derivatives, causes = work[:k], work[k : k + r]
    residual, slope = work[k + r, :count], work[k + r + 1, :count]
    triangle, inner, right, step, of_causes, other, new, trials, values, tried, differs = room
    damping, chi = FIRST_DAMPING, np.inf
    shaded(shade, columns, theta, free, lower, upper, differs, trials, values, count)
    for _ in range(MOST_STEPS):
        slopes_of_scale(values, small, slope, count)
        linearised(
            shade, derive, columns, theta, values, w, slope, free, lower, upper, differs, trials, derivatives, count
        )
        if r:
            whitened_causes(relative, values, w, slope, causes, inner, count)
        chi = missed(values, z, w, small, r, causes, inner, residual, other, count)
        if chi > known and distance(theta, there, free, around) < SAME_VALLEY:
            break
        normal(derivatives, residual, causes, inner, other, of_causes, matrix, right, count)
        for a in range(k):
            at = free[a]
            held = (theta[at] <= lower[at] and right[a] < 0.0) or (theta[at] >= upper[at] and right[a] > 0.0)
            moves[a] = matrix[a, a] > 0.0 and not held
        ended = True
        for _ in range(MOST_TRIALS):
            solve(matrix, right, moves, damping, triangle, step)
            copied(theta, new, 0, theta.size)
            short = True
            for a in range(k):
                at = free[a]
                new[at] = toward(theta[at], step[a], lower[at], upper[at])
                inside = lower[at] < new[at] < upper[at] and abs(step[a]) < NEAR_BOUND * (upper[at] - lower[at])
                short = short and (inside or step[a] == 0.0)
            if dot(step, right, k) < SETTLED:
                if short:  # the end does not depend on the way there
                    copied(new, theta, 0, theta.size)
                break
            shaded(shade, columns, new, free, lower, upper, differs, trials, tried, count)
            if missed(tried, z, w, small, r, causes, inner, residual, other, count) <= chi:
                copied(new, theta, 0, theta.size)
                values, tried = tried, values
                damping = max(0.1 * damping, 1e-12)
                ended = False
                break
            damping = max(10.0 * damping, 1e-6)
        if ended:
            break
    copied(values, f, 0, count)
    return chi
