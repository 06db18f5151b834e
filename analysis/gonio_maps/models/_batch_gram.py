"""The compiled part of `gonio_maps.models.batch_spectra`: what one wavelength of a pixel says near given parameters."""

import functools
from math import sqrt

import numpy as np
from numba import types

from gonio.compiled import njit
from gonio.models._compile import fingerprint
from gonio_maps.models._batch_algebra import (
    OPTIONS,
    called,
    dot,
    inverted,
    on_scale,
    residuals,
    slopes_of_scale,
    smallest,
    whitened_causes,
)
from gonio_maps.models._batch_loops import REAL, WHOLE, gathered, seen_from, taken
from gonio_maps.models._batch_misfit import errors, estimated_tau
from gonio_maps.models._batch_steps import DERIVE, SHADE, TAKE, by_differences, linearised, normal, shaded

GRAM, GRAM_OF_LOGARITHMS, TAU, ERRORS = range(4)
"""What is worked out: sums of products, with a misfit on the scale of logarithms or without; the misfit; the errors."""


@called
def on_logarithms(z, own, tau, w, variance, count):  # type: ignore[no-untyped-def]
    """Values and weights on the scale of logarithms, as in `_batch_misfit.nearest`; `tau` is inf for equal weights."""
    small = smallest(z[:count])
    for j in range(count):
        variance[j] = (own[j] / sqrt(z[j] * z[j] + 4.0 * small * small)) ** 2
        z[j] = on_scale(z[j], small)
        w[j] = 1.0 / sqrt(variance[j] + tau * tau) if tau < np.inf else 1.0
    return small


@called
def products(derivatives, relative, f, slope, w, residual, rows, out, count):  # type: ignore[no-untyped-def]
    """Sums of products of derivatives, causes and residuals, all weighted."""
    k, r = derivatives.shape[0], relative.shape[0]
    for a in range(k):
        rows[a, :count] = derivatives[a, :count]
    for c in range(r):
        for j in range(count):
            rows[k + c, j] = relative[c, j] * f[j] * slope[j] * w[j]
    rows[k + r, :count] = residual[:count]
    for a in range(k + r + 1):
        for b in range(a + 1):
            out[a, b] = out[b, a] = dot(rows[a], rows[b], count)


def examine(  # type: ignore[no-untyped-def]
    job, take, shade, derive, count_of_columns, x, y, source, camera, values, u, common, free, lower, upper, numbers,
    theta, tau, which, out, start, stop,
):  # fmt: skip
    """Of the pixels `which[start:stop]` what `job` says, into `out` (pixels, k + r + 1, k + r + 1), for r causes.

    Sums of products have the parameters first, then the causes, then the residuals. The misfit stands in the first
    place, the covariance of the parameters in the first rows. A pixel with too few values gets zeros.
    """
    n, k, r = values.shape[1], free.size, common.shape[0]
    omega_i, omega_r, packed = np.empty(3 * n), np.empty(3 * n), np.empty(count_of_columns * n)
    source_of, camera_of = np.empty((3, n)), np.empty((3, n))
    z, w, own, at = np.empty(n), np.empty(n), np.empty(n), np.full(n, -1, np.int64)
    differs = by_differences(derive, packed, free, lower, upper)
    sets = 1 + differs.sum()
    whole, trials = np.empty(sets * n), np.empty(sets * theta.shape[1])
    slope, variance, residual = np.empty(n), np.empty(n), np.empty(n)
    work, rows, inner = np.empty((3, n)), np.empty((k + r + 1, n)), np.empty((r, r))
    triangle, matrix, spread = np.empty((k, k)), np.empty((k, k)), np.empty((k, k))
    right, other, of_causes, moves = np.empty(k), np.empty(r), np.empty((k, r)), np.empty(k, np.bool_)
    for q in range(start, stop):
        p = which[q]
        out[q] = 0.0
        count, _ = taken(values[p], u[p], z, own, w, at)
        if count <= k:
            continue
        relative, block = np.empty((r, count)), np.empty((numbers.shape[0], count), np.int64)
        derivatives, causes = np.empty((k, count)), np.empty((r, count))
        gathered(at, count, source, camera, common, numbers, source_of, camera_of, relative, block)
        columns, f = packed[: count_of_columns * count], whole[:count]
        seen_from(x[p], y[p], source_of, camera_of, count, omega_i, omega_r)
        take(omega_i[: 3 * count], omega_r[: 3 * count], lower, columns)
        small = on_logarithms(z, own, tau[p], w, variance, count) if job != GRAM else 0.0
        shaded(shade, columns, theta[p], free, lower, upper, differs, trials, whole, count)
        slopes_of_scale(f, small, slope, count)
        if job == TAU:
            w[:count] = 1.0
        linearised(
            shade, derive, columns, theta[p], whole, w, slope, free, lower, upper, differs, trials, derivatives, count
        )
        residuals(f, z, w, small, residual, count)
        if job == TAU:
            out[q, 0, 0] = estimated_tau(
                0.0, variance, residual[:count], derivatives, relative, f, slope, causes, inner, triangle, work, count
            )
        elif job == ERRORS:
            for a in range(k):
                moves[a] = lower[free[a]] < theta[p, free[a]] < upper[free[a]]
            if r:
                whitened_causes(relative, f, w, slope, causes, inner, count)
            other[:] = 0.0
            normal(derivatives, residual, causes, inner, other, of_causes, matrix, right, count)
            inverted(matrix, moves, triangle, spread)
            errors(derivatives, residual[:count], causes, inner, block, moves, spread, count)
            out[q, :k, :k] = spread
        else:
            products(derivatives, relative, f, slope, w, residual, rows, out[q], count)
    return 0


RESULT = types.int64(
    *(WHOLE, types.FunctionType(TAKE), types.FunctionType(SHADE), types.FunctionType(DERIVE)),
    *(WHOLE, REAL[::1], REAL[::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1], REAL[:, ::1]),
    *(WHOLE[::1], REAL[::1], REAL[::1], WHOLE[:, ::1]),
    *(REAL[:, ::1], REAL[::1], WHOLE[::1], REAL[:, :, ::1], WHOLE, WHOLE),
)


@functools.cache
def engine():  # type: ignore[no-untyped-def]
    """`examine`, compiled."""
    examine.__name__ = examine.__qualname__ = f"examine_{fingerprint(examine)}"
    return njit(*RESULT.args, **OPTIONS)(examine)
