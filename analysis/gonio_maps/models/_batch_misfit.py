"""The misfit of a pixel whose values reject the model: tau, the nearest model, and its errors by blocks."""

from math import copysign, sqrt

import numpy as np
from gonio_analysis.fitting.misfit import LARGEST, LEAST_LEFT, SETTLED, SMALLEST, TURNS

from gonio_maps.models._batch_algebra import (
    called,
    dot,
    inverted,
    log,
    on_scale,
    residuals,
    seen_by_causes,
    slopes_of_scale,
    solve,
    whitened_causes,
)
from gonio_maps.models._batch_steps import MOST_STEPS, linearised, minimised, shaded

TOGETHER = 8
"""Factors whose product has one logarithm; each lies between 1e-30 and 1e30."""


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
def estimated_tau(before, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count):  # type: ignore[no-untyped-def]
    """The misfit that makes residuals most probable: parabolas through three ln tau, from one or their scatter on."""
    x, width = log(max(before, SMALLEST)), 0.01
    if before == 0.0:
        x, width = 0.5 * log(max(dot(raw, raw, count) / count, SMALLEST * SMALLEST)), 0.25
    here = unlikely(x, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
    for _ in range(MOST_STEPS):
        below = unlikely(x - width, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
        above = unlikely(x + width, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
        bend = below + above - 2.0 * here
        step = 0.5 * width * (below - above) / bend if bend > 0.0 else copysign(1.0, below - above)
        step = min(max(step, -1.0), 1.0)
        if not log(SMALLEST) < x + step < log(LARGEST):
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
def freed_of_causes(raw, causes, inner, count):  # type: ignore[no-untyped-def]
    """Takes from the residuals what the causes are found to be in them."""
    r = causes.shape[0]
    other = np.empty(r)
    seen_by_causes(causes, inner, raw, count, other)
    for c in range(r - 1, -1, -1):
        for q in range(c + 1, r):
            other[c] -= inner[q, c] * other[q]
        other[c] /= inner[c, c]
    for j in range(count):
        for c in range(r):
            raw[j] -= causes[c, j] * other[c]


@called
def errors(plain, raw, causes, inner, numbers, moves, spread, count):  # type: ignore[no-untyped-def]
    """Standard errors by blocks, and no less than those of a misfit that is independent everywhere (in `spread`)."""
    k, r = plain.shape[0], causes.shape[0]
    blocks, least = np.empty((k, k)), np.empty(k)
    if r:
        freed_of_causes(raw, causes, inner, count)
    by_blocks(plain, raw, numbers, blocks, count)
    for a in range(k):
        least[a] = sqrt(max(spread[a, a] / max(blocks[a, a], 1e-300), 1.0))
    for a in range(k):
        for b in range(k):
            spread[a, b] = blocks[a, b] * least[a] * least[b]
    if r:  # what the common causes move together
        whole, triangle, right, gain = np.empty((k, k)), np.empty((k, k)), np.empty(k), np.empty((r, k))
        for a in range(k):
            for b in range(k):
                whole[a, b] = dot(plain[a], plain[b], count)
        for c in range(r):
            for a in range(k):
                right[a] = dot(plain[a], causes[c], count)
            solve(whole, right, moves, 0.0, triangle, gain[c])
        for a in range(k):
            for b in range(k):
                for c in range(r):
                    spread[a, b] += gain[c, a] * gain[c, b]


@called
def nearest(  # type: ignore[no-untyped-def]
    shade, derive, columns, values, u, z, w, small, relative, theta, free, lower, upper, f, work, numbers, spread,
    moves, room, count,
):  # fmt: skip
    """The nearest model with a misfit of its own, where the data reject every one (`fit._nearest`): tau.

    `theta` begins where the stated uncertainties end; it and its covariance `spread` are changed.
    """
    k, r = free.size, relative.shape[0]
    matrix, triangle, inner = np.empty((k, k)), np.empty((k, k)), np.empty((r, r))
    variance, raw, slope = np.empty(count), np.empty(count), np.empty(count)
    plain, causes, nothing = np.empty((k, count)), np.empty((r, count)), np.empty((0, count))
    trials, whole, _, differs = room[7:]
    for j in range(count):
        variance[j] = (u[j] / sqrt(values[j] * values[j] + 4.0 * small * small)) ** 2
        z[j] = on_scale(values[j], small)
        w[j] = 1.0
    minimised(
        shade, derive, columns, z, w, small, nothing, theta, free, lower, upper, f, work, matrix, moves, room, count,
        np.inf, theta, matrix,
    )  # fmt: skip
    tau = 0.0
    for turn in range(TURNS):
        slopes_of_scale(f, small, slope, count)
        raw_w = np.ones(count)
        shaded(shade, columns, theta, free, lower, upper, differs, trials, whole, count)
        linearised(
            shade, derive, columns, theta, whole, raw_w, slope, free, lower, upper, differs, trials, plain, count
        )
        residuals(f, z, raw_w, small, raw, count)
        before = tau
        tau = estimated_tau(before, variance, raw, plain, relative, f, slope, causes, inner, triangle, work, count)
        if turn and abs(log(tau / before)) < SETTLED:
            break
        for j in range(count):
            w[j] = 1.0 / sqrt(variance[j] + tau * tau)
        minimised(
            shade, derive, columns, z, w, small, relative, theta, free, lower, upper, f, work, matrix, moves, room,
            count, np.inf, theta, matrix,
        )  # fmt: skip
    slopes_of_scale(f, small, slope, count)
    shaded(shade, columns, theta, free, lower, upper, differs, trials, whole, count)
    linearised(shade, derive, columns, theta, whole, w, slope, free, lower, upper, differs, trials, plain, count)
    residuals(f, z, w, small, raw, count)
    inverted(matrix, moves, triangle, spread)
    if r:
        whitened_causes(relative, f, w, slope, causes, inner, count)
    errors(plain, raw, causes, inner, numbers, moves, spread, count)
    return tau
