"""Least squares of a model that is linear in three columns of the directions (Oren-Nayar's), on sums over the values.

f = C_0 + C_1 x_1 + C_2 x_2 + C_3 x_3 with constants C that the parameters make, so chi-square is a quadratic form of C,
and one pass over the values gives its 15 sums. They tell starts, steps and standard errors. Chi-square at the end, and
whether a step is left, are told by the values themselves: in sums the difference of large terms has lost digits.
"""

import numpy as np

from gonio_maps.models._batch_algebra import called, copied, dot, inlined, solve, summing, viewing
from gonio_maps.models._batch_steps import FIRST_DAMPING, MOST_STEPS, MOST_TRIALS, SETTLED, toward

SUMS = 15
"""Of w^2 times: 1, x_1, x_2, x_3, the products of two x (11, 12, 13, 22, 23, 33), z times 1 and each x, z^2."""


@called
def room_for_sums(k, size):  # type: ignore[no-untyped-def]
    """Memory that `walked` works in: the sums first."""
    return (
        np.empty(SUMS), np.empty(4), np.empty((k, 4)), np.empty(4), np.empty(4), np.empty(k), np.empty(k),
        np.empty(size), np.empty(4),
    )  # fmt: skip


@summing
def summed(columns, z, w, count, out):  # type: ignore[no-untyped-def]
    """The sums over the values."""
    a, b, c = columns[:count], columns[count : 2 * count], columns[2 * count : 3 * count]
    s0, s1, s2, s3, s11, s12, s13, s22, s23, s33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    z0, z1, z2, z3, zz = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(count):
        weight = w[j] * w[j]
        one, two, three, value = weight * a[j], weight * b[j], weight * c[j], weight * z[j]
        s0 += weight
        s1 += one
        s2 += two
        s3 += three
        s11 += one * a[j]
        s12 += one * b[j]
        s13 += one * c[j]
        s22 += two * b[j]
        s23 += two * c[j]
        s33 += three * c[j]
        z0 += value
        z1 += value * a[j]
        z2 += value * b[j]
        z3 += value * c[j]
        zz += value * z[j]
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = s0, s1, s2, s3, s11, s12, s13, s22
    out[8], out[9], out[10], out[11], out[12], out[13], out[14] = s23, s33, z0, z1, z2, z3, zz


@inlined
def four(x, y):  # type: ignore[no-untyped-def]
    """`dot` of four numbers."""
    return x[0] * y[0] + x[1] * y[1] + (x[2] * y[2] + x[3] * y[3])


@viewing
def moments_by_sums(sums, x, turned):  # type: ignore[no-untyped-def]
    """`_batch_algebra.moments` of a model whose parameters are four constants."""
    product(sums, x, turned)
    return turned[0], four(x, turned), x[0] * sums[10] + x[1] * sums[11] + x[2] * sums[12] + x[3] * sums[13]


@inlined
def product(sums, x, out):  # type: ignore[no-untyped-def]
    """The matrix of the sums times four constants."""
    out[0] = sums[0] * x[0] + sums[1] * x[1] + sums[2] * x[2] + sums[3] * x[3]
    out[1] = sums[1] * x[0] + sums[4] * x[1] + sums[5] * x[2] + sums[6] * x[3]
    out[2] = sums[2] * x[0] + sums[5] * x[1] + sums[7] * x[2] + sums[8] * x[3]
    out[3] = sums[3] * x[0] + sums[6] * x[1] + sums[8] * x[2] + sums[9] * x[3]


@inlined
def missed_by_sums(sums, x, misses):  # type: ignore[no-untyped-def]
    """Chi-square of four constants; `misses` become the sums of residuals times 1 and each column."""
    product(sums, x, misses)
    chi = sums[14]
    for a in range(4):
        misses[a] = sums[10 + a] - misses[a]
        chi -= x[a] * (sums[10 + a] + misses[a])
    return chi


@summing
def missed_by_values(columns, z, w, x, misses, count):  # type: ignore[no-untyped-def]
    """The same from the values themselves."""
    a, b, c = columns[:count], columns[count : 2 * count], columns[2 * count : 3 * count]
    x0, x1, x2, x3 = x[0], x[1], x[2], x[3]
    m0, m1, m2, m3, chi = 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(count):
        miss = (z[j] - (x0 + x1 * a[j] + x2 * b[j] + x3 * c[j])) * w[j]
        weighted = miss * w[j]
        chi += miss * miss
        m0 += weighted
        m1 += weighted * a[j]
        m2 += weighted * b[j]
        m3 += weighted * c[j]
    misses[0], misses[1], misses[2], misses[3] = m0, m1, m2, m3
    return chi


@viewing
def missed_by(sums, columns, z, w, x, misses, count):  # type: ignore[no-untyped-def]
    """The one where `count` is 0, the other elsewhere."""
    return missed_by_values(columns, z, w, x, misses, count) if count else missed_by_sums(sums, x, misses)


@viewing
def walked(  # type: ignore[no-untyped-def]
    constants, columns, z, w, theta, free, lower, upper, matrix, moves, triangle, room, count
):
    """`_batch_steps.minimised` with chi-square from `missed_by`."""
    sums, x, slopes, misses, turned, right, step, new, tried = room
    k, damping = free.size, FIRST_DAMPING
    constants(theta, -1, x)
    chi = missed_by(sums, columns, z, w, x, misses, count)
    for _ in range(MOST_STEPS):
        for a in range(k):
            constants(theta, free[a], slopes[a])
            product(sums, slopes[a], turned)
            for b in range(a + 1):
                matrix[a, b] = matrix[b, a] = four(slopes[b], turned)
        for a in range(k):
            at = free[a]
            right[a] = four(slopes[a], misses)
            held = (theta[at] <= lower[at] and right[a] < 0.0) or (theta[at] >= upper[at] and right[a] > 0.0)
            moves[a] = matrix[a, a] > 0.0 and not held
        ended = True
        for _ in range(MOST_TRIALS):
            solve(matrix, right, moves, damping, triangle, step)
            settled = dot(step, right, k) < SETTLED
            if settled and count:
                break
            copied(theta, new, 0, theta.size)
            for a in range(k):
                new[free[a]] = toward(theta[free[a]], step[a], lower[free[a]], upper[free[a]])
            constants(new, -1, tried)
            better = missed_by(sums, columns, z, w, tried, turned, count)
            if better <= chi or settled:  # the sums' last step is taken: chi-square may have no digits for it
                copied(new, theta, 0, theta.size)
                x, tried, misses, turned, chi = tried, x, turned, misses, better
                damping = max(0.1 * damping, 1e-12)
                ended = settled
                break
            damping = max(10.0 * damping, 1e-6)
        if ended:
            break
    return chi
