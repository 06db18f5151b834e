"""The compiled part of `gonio.models.batch`: least squares of one pixel after the other.

A model comes in as five compiled functions (`SHADE` and its like), so that all this is compiled once for all models.
Indices: j values, a and b parameters that move, c common causes, p pixels. numba is imported with this module, which
`batch` imports at its first fit.
"""

from __future__ import annotations

import functools
from math import copysign, sqrt

import numba
import numpy as np
from numba import types

from gonio.compiled import njit
from gonio.models import _math
from gonio.models._compile import FASTMATH, jit

ROW = types.float64[::1]
TAKE = types.int64(ROW, ROW, ROW)
"""Unit vectors to source and to camera, three numbers a value -> the columns of the model's kernel."""
SHADE = types.int64(ROW, ROW, ROW)
"""Columns and parameters -> BRDF of each value [1/sr]."""
AFFINE = types.int64(ROW, types.int64, ROW)
"""Parameters and which of them -> 1 where d f / d parameter = factor f + flat [1/sr], and factor and flat; else 0."""
UNIT = types.int64(ROW)
"""Sets the levels among the parameters to 1 and 0; tells what of them follows by linear least squares."""
LEVELS = types.int64(ROW, types.float64, types.float64)
"""Sets parameters from the level of a lobe and from a base [1/sr]."""
OPTIONS = {"error_model": "numpy", "nogil": True, "fastmath": set(FASTMATH)}
called = numba.njit(**OPTIONS)
summing = numba.njit(error_model="numpy", nogil=True, fastmath={*FASTMATH, "reassoc"})
"""Sums may be taken in any order, so that they vectorise."""
inlined = numba.njit(inline="always", **OPTIONS)
log = jit(_math.log)

STEP = 1e-6
"""Of a parameter, relative, for a derivative by differences: its error is 1e-6 of the derivative."""
SETTLED = 1e-8
"""Decrease of chi-square that a last step would bring: it is then shorter than 1e-4 standard errors."""
MOST_STEPS, MOST_TRIALS = 60, 12
NEAR_BOUND = 1e-4
"""Of a parameter's range."""
FAR_VALLEY = 100.0
"""A second start is tried where its chi-square is at most so many times that of the first, and so much more."""
TURNS = 8
"""Parameters and misfit are found in turn, so often at most."""
FREE_LEVELS, FREE_BASE = 1, 2
"""What of a model`s levels follows by linear least squares: both, the base alone, none."""
LINEAR_BELOW = 0.05
"""Of the median value: below it the scale of logarithms is linear (`observations.LINEAR_BELOW`)."""
LEAST_TAU = 1e-12
LOWEST, HIGHEST = -27.6, 6.9
"""Between these ln tau is sought."""
TOGETHER = 8
"""Factors whose product has one logarithm; each lies between 1e-30 and 1e30."""
LEAST_LEFT = 1e-3
"""Part of what is known of a parameter that is left without a block, at least (`misfit.block_spread`)."""


@summing
def dot(x, y, count):  # type: ignore[no-untyped-def]
    """Sum of products of the first `count` numbers."""
    out = 0.0
    for j in range(count):
        out += x[j] * y[j]
    return out


@summing
def weighted_dot(x, y, w, count):  # type: ignore[no-untyped-def]
    """The same, each product times w."""
    out = 0.0
    for j in range(count):
        out += x[j] * y[j] * w[j]
    return out


@inlined
def on_scale(f, small):  # type: ignore[no-untyped-def]
    """asinh(f/(2 small)): ln f for all but the smallest values."""
    x = abs(f) / (2.0 * small)
    return copysign(log(x + sqrt(x * x + 1.0)), f)


@called
def solve(matrix, right, moves, damping, triangle, out):  # type: ignore[no-untyped-def]
    """Solve (matrix + damping times its diagonal) out = right by Cholesky; 0 for parameters that do not move."""
    k = out.size
    for a in range(k):
        for b in range(a + 1):
            if not (moves[a] and moves[b]):
                triangle[a, b] = 1.0 if a == b else 0.0
                continue
            rest = matrix[a, b] * (1.0 + damping if a == b else 1.0)
            for c in range(b):
                rest -= triangle[a, c] * triangle[b, c]
            triangle[a, b] = sqrt(max(rest, 1e-14 * matrix[a, a], 1e-300)) if a == b else rest / triangle[b, b]
    for a in range(k):
        rest = right[a] if moves[a] else 0.0
        for c in range(a):
            rest -= triangle[a, c] * out[c]
        out[a] = rest / triangle[a, a]
    for a in range(k - 1, -1, -1):
        rest = out[a]
        for c in range(a + 1, k):
            rest -= triangle[c, a] * out[c]
        out[a] = rest / triangle[a, a] if moves[a] else 0.0


@called
def inverted(matrix, moves, triangle, out):  # type: ignore[no-untyped-def]
    """The inverse of a matrix over the parameters that move; 0 elsewhere."""
    k = moves.size
    one, column = np.zeros(k), np.empty(k)
    for a in range(k):
        one[:] = 0.0
        one[a] = 1.0
        solve(matrix, one, moves, 0.0, triangle, column)
        for b in range(k):
            out[b, a] = column[b] if moves[a] else 0.0


@called
def whitened_causes(relative, f, w, slope, causes, inner, count):  # type: ignore[no-untyped-def]
    """Common causes in units of the values' own uncertainties, and Cholesky's triangle of 1 + causes causes'."""
    r = relative.shape[0]
    for c in range(r):
        for j in range(count):
            causes[c, j] = relative[c, j] * f[j] * slope[j] * w[j]
    for c in range(r):
        for e in range(c + 1):
            inner[c, e] = dot(causes[c], causes[e], count) + (1.0 if c == e else 0.0)
            for q in range(e):
                inner[c, e] -= inner[c, q] * inner[e, q]
            inner[c, e] = sqrt(inner[c, e]) if c == e else inner[c, e] / inner[e, e]


@called
def seen_by_causes(causes, inner, x, count, out):  # type: ignore[no-untyped-def]
    """What Woodbury's formula takes from products with x: inner^-1 causes x."""
    for c in range(causes.shape[0]):
        out[c] = dot(causes[c], x, count)
        for q in range(c):
            out[c] -= inner[c, q] * out[q]
        out[c] /= inner[c, c]


@called
def residuals(f, z, w, small, out, count):  # type: ignore[no-untyped-def]
    """(z - f) w on the scale; z is on it already."""
    if small == 0.0:
        for j in range(count):
            out[j] = (z[j] - f[j]) * w[j]
    else:
        for j in range(count):
            out[j] = (z[j] - on_scale(f[j], small)) * w[j]


@inlined
def toward(value, step, low, high):  # type: ignore[no-untyped-def]
    """A step within bounds: onto a bound only from nearby, for there a slope may vanish (Oren-Nayar's at sigma = 0)."""
    bound = low if step < 0.0 else high
    if (value + step - bound) * step < 0.0:
        return value + step
    return bound if abs(bound - value) < NEAR_BOUND * (high - low) else value + 0.9 * (bound - value)


@called
def slopes_of_scale(f, small, out, count):  # type: ignore[no-untyped-def]
    """d scale / d f."""
    for j in range(count):
        out[j] = 1.0 if small == 0.0 else 1.0 / sqrt(f[j] * f[j] + 4.0 * small * small)


@called
def linearised(shade, affine, columns, theta, f, w, slope, free, lower, upper, trial, derivatives, count):  # type: ignore[no-untyped-def]
    """Derivatives of the weighted values by the parameters that move."""
    effect = np.empty(2)
    for a in range(free.size):
        at = free[a]
        d = derivatives[a, :count]
        if affine(theta, at, effect):
            factor, flat = effect[0], effect[1]
            for j in range(count):
                d[j] = (factor * f[j] + flat) * w[j] * slope[j]
            continue
        step = STEP * max(abs(theta[at]), 1e-3 * (upper[at] - lower[at]))
        step = -step if theta[at] + step > upper[at] else step
        trial[:] = theta
        trial[at] += step
        shade(columns, trial, d)
        for j in range(count):
            d[j] = (d[j] - f[j]) * (w[j] * slope[j] / step)


@called
def minimised(shade, affine, columns, z, w, small, relative, theta, free, lower, upper, f, work, matrix, moves, count):  # type: ignore[no-untyped-def]
    """Levenberg and Marquardt's least squares from `theta` on, which is moved; chi-square at the end.

    `matrix` becomes the normal matrix at the end, `work` rows: derivatives, causes, then residual, slope and a trial.
    """
    k, r, size = free.size, relative.shape[0], theta.size
    derivatives, causes = work[:k], work[k : k + r]
    residual, slope, tried = work[k + r, :count], work[k + r + 1, :count], work[k + r + 2, :count]
    triangle, inner = np.empty((k, k)), np.empty((r, r))
    right, step, of_causes, other = np.empty(k), np.empty(k), np.empty((k, r)), np.empty(r)
    trial, new = np.empty(size), np.empty(size)
    damping, chi = 1e-3, np.inf
    shade(columns, theta, f)
    for _ in range(MOST_STEPS):
        slopes_of_scale(f, small, slope, count)
        linearised(shade, affine, columns, theta, f, w, slope, free, lower, upper, trial, derivatives, count)
        residuals(f, z, w, small, residual, count)
        chi = dot(residual, residual, count)
        if r:
            whitened_causes(relative, f, w, slope, causes, inner, count)
            seen_by_causes(causes, inner, residual, count, other)
            chi -= dot(other, other, r)
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
            if gain < SETTLED:
                theta[:] = new
                f[:count] = tried
                break
            residuals(tried, z, w, small, residual, count)
            found = dot(residual, residual, count)
            if r:
                seen_by_causes(causes, inner, residual, count, other)
                found -= dot(other, other, r)
            if found <= chi:
                theta[:] = new
                f[:count] = tried
                damping = max(0.1 * damping, 1e-12)
                ended = False
                break
            damping = max(10.0 * damping, 1e-6)
        if ended:
            break
    return chi


@called
def valleys(shade, unit, levels, columns, z, w, grid, widths, starts, f, g, count):  # type: ignore[no-untyped-def]
    """The two lowest valleys of chi-square over the grid's widths, and what stands there in `starts`; -1 for none.

    Rows of `grid` run over the width fastest. Where levels are solved for, the model is a lobe times a level and a
    base: both follow by linear least squares.
    """
    profile = np.full(widths, np.inf)
    theta, weight = np.empty(grid.shape[1]), f
    s0, sz, szz = 0.0, 0.0, 0.0
    for j in range(count):
        weight[j] = w[j] * w[j]
        s0 += weight[j]
        sz += weight[j] * z[j]
        szz += weight[j] * z[j] * z[j]
    for row in range(grid.shape[0]):
        theta[:] = grid[row]
        how = unit(theta)
        shade(columns, theta, g)
        sg = dot(weight, g, count)
        sgg, sgz = weighted_dot(g, g, weight, count), weighted_dot(g, z, weight, count)
        level, base = 1.0, 0.0
        if how == FREE_BASE:
            base = max((sz - sg) / s0, 0.0)
        elif how == FREE_LEVELS:
            det = s0 * sgg - sg * sg
            if det > 1e-12 * s0 * sgg:
                level, base = (s0 * sgz - sg * sz) / det, (sgg * sz - sg * sgz) / det
            if base < 0.0 or det <= 1e-12 * s0 * sgg:
                level, base = sgz / sgg, 0.0
            if level < 0.0:
                level, base = 0.0, max(sz / s0, 0.0)
        chi = szz + level * level * sgg + base * base * s0 + 2.0 * (level * base * sg - level * sgz - base * sz)
        if chi < profile[row % widths]:
            profile[row % widths] = chi
            levels(theta, level, base)
            starts[row % widths] = theta
    first, second = -1, -1
    for a in range(widths):
        low = (a == 0 or profile[a] <= profile[a - 1]) and (a == widths - 1 or profile[a] < profile[a + 1])
        if low and (first < 0 or profile[a] < profile[first]):
            first, second = a, first
        elif low and (second < 0 or profile[a] < profile[second]):
            second = a
    if second >= 0 and profile[second] > FAR_VALLEY * (profile[first] + 1.0):
        second = -1
    return first, second


@called
def unlikely(log_tau, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count):  # type: ignore[no-untyped-def]
    """-2 ln of the restricted likelihood of ln tau (`misfit.estimated_tau`); `plain` are unweighted derivatives."""
    k, r = plain.shape[0], relative.shape[0]
    w, residual, column = work[0, :count], work[1, :count], work[2, :count]
    tau2 = np.exp(2.0 * log_tau)
    for j in range(count):
        w[j] = 1.0 / sqrt(variance[j] + tau2)
        residual[j] = raw[j] * w[j]
    value = dot(residual, residual, count)
    for first in range(0, count, TOGETHER):
        product = 1.0
        for j in range(first, min(first + TOGETHER, count)):
            product *= w[j]
        value -= 2.0 * log(product)
    other, of_causes = np.empty(r), np.empty((k, r))
    if r:
        whitened_causes(relative, f, w, slope, causes, inner, count)
        seen_by_causes(causes, inner, residual, count, other)
        value -= dot(other, other, r)
        for c in range(r):
            value += 2.0 * log(inner[c, c])
    for a in range(k):
        for j in range(count):
            column[j] = plain[a, j] * w[j] * w[j]
        for b in range(a + 1):
            triangle[a, b] = dot(column, plain[b], count)
        if r:
            for j in range(count):
                column[j] = plain[a, j] * w[j]
            seen_by_causes(causes, inner, column, count, of_causes[a])
            for b in range(a + 1):
                triangle[a, b] -= dot(of_causes[a], of_causes[b], r)
        for b in range(a + 1):
            for c in range(b):
                triangle[a, b] -= triangle[a, c] * triangle[b, c]
            triangle[a, b] = sqrt(max(triangle[a, b], 1e-300)) if a == b else triangle[a, b] / triangle[b, b]
        value += 2.0 * log(triangle[a, a])
    return value


@called
def estimated_tau(variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count):  # type: ignore[no-untyped-def]
    """The misfit that makes residuals most probable: parabolas through three ln tau, from their scatter on."""
    x = 0.5 * log(max(dot(raw, raw, count) / count, LEAST_TAU * LEAST_TAU))
    width = 0.25
    here = unlikely(x, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
    for _ in range(MOST_STEPS):
        below = unlikely(x - width, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
        above = unlikely(x + width, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
        bend = below + above - 2.0 * here
        step = 0.5 * width * (below - above) / bend if bend > 0.0 else copysign(1.0, below - above)
        step = min(max(step, -1.0), 1.0)
        if x + step < LOWEST or x + step > HIGHEST:
            break
        x += step
        if abs(step) < 1e-4:
            break
        width = min(max(0.5 * abs(step), 0.01), 0.25)
        here = unlikely(x, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
    return np.exp(x)


@called
def by_blocks(derivatives, residual, numbers, spread, count):  # type: ignore[no-untyped-def]
    """Covariance of parameters by leaving out blocks of values, one after the other (`misfit.block_spread`).

    Every left-out solution is one linear step away. `numbers`: rows of block numbers, a way to cut a row; it counts
    from 0, and what is not used is negative.
    """
    k, ways = derivatives.shape[0], numbers.shape[0]
    whole, triangle = np.empty((k, k)), np.empty((k, k))
    moves, right, step = np.ones(k, np.bool_), np.empty(k), np.empty(k)
    for a in range(k):
        for b in range(k):
            whole[a, b] = dot(derivatives[a], derivatives[b], count)
        right[a] = dot(derivatives[a], residual, count)
    spread[:, :] = 0.0
    for way in range(ways):
        blocks = numbers[way].max() + 1
        inner, slope, used = np.zeros((blocks, k, k)), np.zeros((blocks, k)), np.zeros(blocks)
        for j in range(count):
            block = numbers[way, j]
            used[block] += 1.0
            for a in range(k):
                slope[block, a] += derivatives[a, j] * residual[j]
                for b in range(k):
                    inner[block, a, b] += derivatives[a, j] * derivatives[b, j]
        steps, mean, left = np.zeros((blocks, k)), np.zeros(k), 0.0
        for block in range(blocks):
            if used[block] == 0.0:
                continue
            left += 1.0
            for a in range(k):
                for b in range(k):
                    inner[block, a, b] = whole[a, b] - inner[block, a, b] * (1.0 - LEAST_LEFT)
                slope[block, a] = right[a] - slope[block, a]
            solve(inner[block], slope[block], moves, 0.0, triangle, step)
            steps[block] = step
            mean += step
        mean /= max(left, 1.0)
        for block in range(blocks):
            if used[block] > 0.0:
                for a in range(k):
                    for b in range(k):
                        away = (steps[block, a] - mean[a]) * (steps[block, b] - mean[b])
                        spread[a, b] += away * (left - 1.0) / (max(left, 1.0) * ways)


@called
def nearest(  # type: ignore[no-untyped-def]
    shade, affine, columns, values, u, z, w, small, relative, theta, free, lower, upper, f, work, numbers, spread,
    moves, count,
):  # fmt: skip
    """The nearest model with a misfit of its own, where the data reject every one (`fit._nearest`): tau.

    `theta` begins where the stated uncertainties end; it and its covariance `spread` are changed.
    """
    k, r, size = free.size, relative.shape[0], theta.size
    matrix, triangle, inner = np.empty((k, k)), np.empty((k, k)), np.empty((r, r))
    variance, raw, slope = np.empty(count), np.empty(count), np.empty(count)
    plain, causes, trial, nothing = np.empty((k, count)), np.empty((r, count)), np.empty(size), np.empty((0, count))
    for j in range(count):
        variance[j] = (u[j] / sqrt(values[j] * values[j] + 4.0 * small * small)) ** 2
        z[j] = on_scale(values[j], small)
        w[j] = 1.0
    minimised(shade, affine, columns, z, w, small, nothing, theta, free, lower, upper, f, work, matrix, moves, count)
    tau = 0.0
    for turn in range(TURNS):
        slopes_of_scale(f, small, slope, count)
        raw_w = np.ones(count)
        linearised(shade, affine, columns, theta, f, raw_w, slope, free, lower, upper, trial, plain, count)
        residuals(f, z, raw_w, small, raw, count)
        before = tau
        tau = estimated_tau(variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
        if turn and abs(log(tau / before)) < 1e-3:
            break
        for j in range(count):
            w[j] = 1.0 / sqrt(variance[j] + tau * tau)
        minimised(
            shade, affine, columns, z, w, small, relative, theta, free, lower, upper, f, work, matrix, moves, count
        )
    # standard errors: by blocks, and no less than those of a misfit that is independent everywhere
    slopes_of_scale(f, small, slope, count)
    linearised(shade, affine, columns, theta, f, w, slope, free, lower, upper, trial, plain, count)
    residuals(f, z, w, small, raw, count)
    formal, blocks = np.empty((k, k)), np.empty((k, k))
    inverted(matrix, moves, triangle, formal)
    if r:
        whitened_causes(relative, f, w, slope, causes, inner, count)
        other = np.empty(r)
        seen_by_causes(causes, inner, raw, count, other)
        for c in range(r - 1, -1, -1):  # what the causes are found to be in the residuals
            for q in range(c + 1, r):
                other[c] -= inner[q, c] * other[q]
            other[c] /= inner[c, c]
        for j in range(count):
            for c in range(r):
                raw[j] -= causes[c, j] * other[c]
    by_blocks(plain, raw, numbers, blocks, count)
    for a in range(k):
        for b in range(k):
            least_a = max(formal[a, a] / max(blocks[a, a], 1e-300), 1.0)
            least_b = max(formal[b, b] / max(blocks[b, b], 1e-300), 1.0)
            spread[a, b] = blocks[a, b] * sqrt(least_a * least_b)
    if r:  # what the common causes move together
        gain = np.zeros((k, r))
        for c in range(r):
            right = np.empty(k)
            for a in range(k):
                right[a] = dot(plain[a], causes[c], count)
            whole = np.empty((k, k))
            for a in range(k):
                for b in range(k):
                    whole[a, b] = dot(plain[a], plain[b], count)
            step = np.empty(k)
            solve(whole, right, moves, 0.0, triangle, step)
            gain[:, c] = step
        for a in range(k):
            for b in range(k):
                for c in range(r):
                    spread[a, b] += gain[a, c] * gain[b, c]
    return tau


REAL, WHOLE = types.float64, types.int64
RESULT = types.int64(
    *(types.FunctionType(one) for one in (TAKE, SHADE, AFFINE, UNIT, LEVELS)),
    *(WHOLE, REAL[::1], REAL[::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1]),
    *(WHOLE[::1], REAL[::1], REAL[::1], REAL[:, ::1], WHOLE, WHOLE[:, ::1], REAL[::1]),
    *(REAL[:, ::1], REAL[:, :, ::1], REAL[::1], REAL[::1], WHOLE[::1], WHOLE, WHOLE),
)


def fit_pixels(  # type: ignore[no-untyped-def]
    take, shade, affine, unit, levels, count_of_columns, x, y, source, camera, values, u, common, free, lower, upper,
    grid, widths, numbers, critical, theta, spread, chi, tau, used, start, stop,
):  # fmt: skip
    """Fit pixels `start` to `stop`, one after the other; see `gonio.models.batch.fit`."""
    n, k, r, size = values.shape[1], free.size, common.shape[0], grid.shape[1]
    omega_i, omega_r, every = np.empty(3 * n), np.empty(3 * n), np.empty(count_of_columns * n)
    packed, f, g = np.empty(count_of_columns * n), np.empty(n), np.empty(n)
    z, w, own, at = np.empty(n), np.empty(n), np.empty(n), np.empty(n, np.int64)
    relative, block = np.empty((r, n)), np.empty((numbers.shape[0], n), np.int64)
    work, starts, matrix = np.empty((k + r + 4, n)), np.empty((widths, size)), np.empty((k, k))
    triangle, moves, end = np.empty((k, k)), np.empty(k, np.bool_), np.empty(size)
    for p in range(start, stop):
        count = 0
        for j in range(n):
            if u[p, j] > 0.0 and values[p, j] - values[p, j] == 0.0:
                at[count] = j
                count += 1
        used[p] = count
        chi[p], tau[p], theta[p], spread[p] = np.nan, 0.0, np.nan, np.nan
        if count <= k:
            continue
        if p == start or x[p] != x[p - 1] or y[p] != y[p - 1]:
            for j in range(n):
                for place, out in ((source, omega_i), (camera, omega_r)):
                    dx, dy, dz = place[j, 0] - x[p], place[j, 1] - y[p], place[j, 2]
                    inverse = 1.0 / sqrt(dx * dx + dy * dy + dz * dz)
                    out[3 * j], out[3 * j + 1], out[3 * j + 2] = dx * inverse, dy * inverse, dz * inverse
            take(omega_i, omega_r, every)
        columns = packed[: count_of_columns * count]
        for j in range(count):
            for c in range(count_of_columns):
                columns[c * count + j] = every[c * n + at[j]]
            for c in range(r):
                relative[c, j] = common[c, at[j]]
            for c in range(numbers.shape[0]):
                block[c, j] = numbers[c, at[j]]
            z[j], own[j] = values[p, at[j]], u[p, at[j]]
            w[j] = 1.0 / own[j]
        first, second = valleys(shade, unit, levels, columns, z, w, grid, widths, starts, f, g[:count], count)
        best = np.inf
        for turn in range(2):
            which = first if turn == 0 else second
            if which < 0:
                break
            for a in range(size):
                end[a] = min(max(starts[which, a], lower[a]), upper[a])
            found = minimised(
                shade,
                affine,
                columns,
                z,
                w,
                0.0,
                relative,
                end,
                free,
                lower,
                upper,
                f[:count],
                work,
                matrix,
                moves,
                count,
            )
            if found < best:
                best = found
                theta[p] = end
                inverted(matrix, moves, triangle, spread[p])
        chi[p] = best
        if best > critical[count]:
            small = max(LINEAR_BELOW * np.median(np.abs(z[:count])), 1e-300)
            end[:] = theta[p]
            measured = z[:count].copy()
            tau[p] = nearest(
                shade, affine, columns, measured, own[:count], z[:count], w[:count], small, relative, end, free, lower,
                upper, f[:count], work, block[:, :count], spread[p], moves, count,
            )  # fmt: skip
            theta[p] = end
    return 0


@functools.cache
def engine():  # type: ignore[no-untyped-def]
    """`fit_pixels`, compiled: half a minute where it is not on the disk."""
    return njit(*RESULT.args, **OPTIONS)(fit_pixels)
