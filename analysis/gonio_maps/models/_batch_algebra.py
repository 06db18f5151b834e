"""Sums, triangles and the scale of values for `_batch_steps` and what stands on it, compiled for one pixel at a time.

Indices: j values, a and b parameters that move, c common causes. numba is imported with this module, which `batch`
imports at its first fit.
"""

from math import copysign, sqrt

import numba
from gonio_analysis.fitting import objective

from gonio.compiled import counting
from gonio.models import _math
from gonio.models._compile import FASTMATH, jit, options

OPTIONS = {"error_model": "numpy", "nogil": True, "fastmath": set(FASTMATH)}
called = numba.njit(**OPTIONS, **counting(True))
viewing = numba.njit(**OPTIONS, **counting(False))
"""Makes no arrays, and views only of those that its caller holds: counting references to them took a quarter of all."""
summing = numba.njit(error_model="numpy", nogil=True, fastmath={*FASTMATH, "reassoc"})
"""Sums may be taken in any order, so that they vectorise."""
inlined = numba.njit(inline="always", **OPTIONS)
vectors = numba.njit(**options(), nogil=True, **counting(False))
"""For a loop over values without sums, which takes whole vectors."""
log, per_root = jit(_math.log), jit(_math.per_root)
smallest = called(objective.smallest)


@viewing
def copied(x, out, first, count):  # type: ignore[no-untyped-def]
    """The first `count` numbers into `out`, from `first` on; an assignment to a slice looks for overlap first."""
    for j in range(count):
        out[first + j] = x[j]


@summing
def dot(x, y, count):  # type: ignore[no-untyped-def]
    """Sum of products of the first `count` numbers."""
    out = 0.0
    for j in range(count):
        out += x[j] * y[j]
    return out


@summing
def sum_of(x, count):  # type: ignore[no-untyped-def]
    """Sum of the first `count` numbers."""
    out = 0.0
    for j in range(count):
        out += x[j]
    return out


@summing
def cross(x, a, y, b, count):  # type: ignore[no-untyped-def]
    """`dot` of a row of x and a row of y, without the views that a slice makes."""
    out = 0.0
    for j in range(count):
        out += x[a, j] * y[b, j]
    return out


@summing
def moments(x, w, wz, count):  # type: ignore[no-untyped-def]
    """Sums of w x, w x x and wz x."""
    first, second, other = 0.0, 0.0, 0.0
    for j in range(count):
        weighted = w[j] * x[j]
        first += weighted
        second += weighted * x[j]
        other += wz[j] * x[j]
    return first, second, other


@summing
def slope_moments(x, d, w, wz, count):  # type: ignore[no-untyped-def]
    """Sums of w d, w d d, w d x and wz d."""
    first, second, mixed, other = 0.0, 0.0, 0.0, 0.0
    for j in range(count):
        weighted = w[j] * d[j]
        first += weighted
        second += weighted * d[j]
        mixed += weighted * x[j]
        other += wz[j] * d[j]
    return first, second, mixed, other


@inlined
def on_scale(f, small):  # type: ignore[no-untyped-def]
    """asinh(f/(2 small)): ln f for all but the smallest values."""
    x = abs(f) / (2.0 * small)
    return copysign(log(x + sqrt(x * x + 1.0)), f)


@viewing
def factored(matrix, moves, damping, triangle):  # type: ignore[no-untyped-def]
    """Cholesky's triangle of matrix + damping times its diagonal, over the parameters that move."""
    for a in range(moves.size):
        for b in range(a + 1):
            if not (moves[a] and moves[b]):
                triangle[a, b] = 1.0 if a == b else 0.0
                continue
            rest = matrix[a, b] * (1.0 + damping if a == b else 1.0)
            for c in range(b):
                rest -= triangle[a, c] * triangle[b, c]
            triangle[a, b] = sqrt(max(rest, 1e-14 * matrix[a, a], 1e-300)) if a == b else rest / triangle[b, b]


@viewing
def substituted(triangle, right, moves, out):  # type: ignore[no-untyped-def]
    """What the factored matrix turns into `right`; 0 for parameters that do not move."""
    k = out.size
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


@viewing
def solve(matrix, right, moves, damping, triangle, out):  # type: ignore[no-untyped-def]
    """Solve (matrix + damping times its diagonal) out = right by Cholesky; 0 for parameters that do not move."""
    factored(matrix, moves, damping, triangle)
    substituted(triangle, right, moves, out)


@viewing
def inverted(matrix, moves, triangle, out):  # type: ignore[no-untyped-def]
    """The inverse of a matrix over the parameters that move; 0 elsewhere."""
    factored(matrix, moves, 0.0, triangle)
    for a in range(moves.size):
        row = out[a]
        row[:] = 0.0
        row[a] = 1.0
        substituted(triangle, row, moves, row)


@viewing
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


@viewing
def seen_by_causes(causes, inner, x, count, out):  # type: ignore[no-untyped-def]
    """What Woodbury's formula takes from products with x: inner^-1 causes x."""
    for c in range(causes.shape[0]):
        out[c] = dot(causes[c], x, count)
        for q in range(c):
            out[c] -= inner[c, q] * out[q]
        out[c] /= inner[c, c]


@viewing
def residuals(f, z, w, small, out, count):  # type: ignore[no-untyped-def]
    """(z - f) w on the scale; z is on it already."""
    if small == 0.0:
        for j in range(count):
            out[j] = (z[j] - f[j]) * w[j]
    else:
        for j in range(count):
            out[j] = (z[j] - on_scale(f[j], small)) * w[j]


@viewing
def slopes_of_scale(f, small, out, count):  # type: ignore[no-untyped-def]
    """d scale / d f."""
    for j in range(count):
        out[j] = 1.0 if small == 0.0 else 1.0 / sqrt(f[j] * f[j] + 4.0 * small * small)
