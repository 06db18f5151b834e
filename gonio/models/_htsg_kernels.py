"""Compiled kernels of He, Torrance, Sillion and Greenberg (1991); imported at the first evaluation.

Pairs of directions are worked through in blocks. A first pass computes what every pair needs (Fresnel, geometry,
shadowing, effective roughness, the place m0 of the series' largest term) without branches; a second sorts the pairs
by how the series is best summed, and sums each class with loops over pairs that a compiler turns into vector code.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from gonio.models import _htsg_expansion as expansion

FAST = {"contract", "arcp", "nsz"}
compiled = njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
inlined = njit(nogil=True, error_model="numpy", fastmath=FAST)

BLOCK = 256
LANES = 32
N_CLASSES = len(expansion.TERMS) + 4  # nothing, sums of so many terms, three expansions
MAGIC = 6755399441055744.0  # 1.5 * 2^52: adding it leaves the nearest integer in the low bits
LN2_HI = 6.93147180369123816490e-01
LN2_LO = 1.90821492927058770002e-10
SQRT_PI = math.sqrt(math.pi)

erfcx = inlined(expansion.erfcx)
full_low, full_mid, full_high = (
    inlined(expansion.full_40_to_120),
    inlined(expansion.full_120_to_1500),
    inlined(expansion.full_from_1500),
)
nano_low, nano_high = inlined(expansion.nano_28_to_150), inlined(expansion.nano_from_150)
micro_low, micro_high = inlined(expansion.micro_18_to_100), inlined(expansion.micro_from_100)
TERMS = np.array(expansion.TERMS)
RECIPROCALS = np.concatenate([[0.0], 1.0 / np.arange(1, 129)])


@inlined
def expm1_reduced(r):
    """exp(r) - 1 for |r| <= 0.35."""
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    return r + r * r * p


@inlined
def exp(x):
    """exp(x), 0 below -708."""
    y = max(x, -708.0)
    t = y * 1.4426950408889634 + MAGIC
    k = t - MAGIC
    r = (y - k * LN2_HI) - k * LN2_LO
    scale = ((np.float64(t).view(np.int64) + 1023) << 52).view(np.float64)
    value = scale + scale * expm1_reduced(r)
    return value if x >= -708.0 else 0.0


@inlined
def expm1(x):
    """exp(x) - 1 for x in [0, 700], accurate near 0."""
    t = x * 1.4426950408889634 + MAGIC
    k = t - MAGIC
    r = (x - k * LN2_HI) - k * LN2_LO
    scale = ((np.float64(t).view(np.int64) + 1023) << 52).view(np.float64)
    return scale * expm1_reduced(r) + (scale - 1.0)


@inlined
def log(x):
    """ln x for a normal x > 0."""
    bits = np.float64(x).view(np.int64)
    shifted = bits - np.int64(0x3FE6A09E00000000) + (np.int64(1023) << 52)
    k = np.int64(np.uint64(shifted) >> np.uint64(52))
    mantissa = (bits - ((k - 1023) << 52)).view(np.float64)
    exponent = (k | np.int64(0x4330000000000000)).view(np.float64) - (4503599627370496.0 + 1023.0)
    f = mantissa - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * (
        0.6666666666666735130
        + z
        * (
            0.3999999999940941908
            + z
            * (
                0.2857142874366239149
                + z
                * (
                    0.2222219843214978396
                    + z * (0.1818357216161805012 + z * (0.1531383769920937332 + z * 0.1479819860511658591))
                )
            )
        )
    )
    half = 0.5 * f * f
    return exponent * LN2_HI - ((half - (s * (half + w) + exponent * LN2_LO)) - f)


@inlined
def lambert_w(x):
    """W0(x) for x >= 0, by one step of Fritsch, Shafer and Crowley (1973) from a rational start within 1e-4."""
    x = min(max(x, 1e-300), 1e300)
    y = log(1.0 + x)
    y = x if x < 1e-4 else y
    w = y * (1.0 + y * (1.08250148 + y * (0.23181226 + y * (0.05815897 + y * 0.00200958))))
    w = w / (1.0 + y * (1.58004159 + y * (0.37723673 + y * (0.06811385 + y * 0.00202011))))
    z = log(x / w) - w
    q = 2.0 * (1.0 + w) * (1.0 + w + z * (2.0 / 3.0))
    return w * (1.0 + z * (q - z) / ((1.0 + w) * (q - 2.0 * z)))


@inlined
def shadowing_over_cos(z, s, a, printed):
    """(S_1 / cos theta, K) for cos theta = z, sin theta = s, a = tau / (2 sigma0); finite at grazing and normal.

    S_1 = 1 / (1 + exp(-h^2) / (sqrt(pi) h erfc(-h))), h = a z / s: He1991 eqs. 24, 25 with the factor exp(-h^2)
    that the print lacks (`printed`: as the print has it). K is eq. 82.
    """
    h = a * z / max(s, 1e-300)
    near = min(h, 6.5)
    e = exp(-near * near)
    e = e if h <= 6.5 else 0.0
    erfc = e * erfcx(near)
    lit = SQRT_PI * a * (2.0 - erfc)
    return lit / (z * lit + s * (1.0 if printed else e)), min(s * erfc / max(z, 1e-300), 1e140)


@inlined
def fresnel_power(c2, n2m1_re, n2_im):
    """|F|^2 = (|F_s|^2 + |F_p|^2) / 2 at cos^2 = c2; the index enters as Re(n^2) - 1 and Im(n^2).

    F_s = -(n^2 - 1)/(c + q)^2 and F_p = F_s (c q - s^2)/(c q + s^2) keep their digits where n is near 1.
    """
    c = math.sqrt(c2)
    s2 = 1.0 - c2
    re = n2m1_re + c2
    size = math.sqrt(re * re + n2_im * n2_im)
    large = math.sqrt(0.5 * (size + abs(re)))
    small = 0.5 * n2_im / max(large, 1e-300)
    q_re = large if re >= 0.0 else small
    q_im = small if re >= 0.0 else large
    sum_re = c + q_re
    d = sum_re * sum_re + q_im * q_im
    f_s = (n2m1_re * n2m1_re + n2_im * n2_im) / max(d * d, 1e-300)
    im2 = c * q_im * (c * q_im)
    minus = c * q_re - s2
    plus = c * q_re + s2
    return 0.5 * f_s * (1.0 + (minus * minus + im2) / max(plus * plus + im2, 1e-300))


@inlined
def saddle(g, c):
    """u, p and m0 of the series' largest term: m0 = g exp(u), 2u = W0(2c/g^2), p = 1/(1 + 2u)."""
    u = 0.5 * lambert_w(2.0 * (c / g) / g)
    return u, 1.0 / (1.0 + 2.0 * u), g * exp(u)


@inlined
def expansion_exponent(g, c, u, m0):
    """m0 (1 - u) - g - c/m0, stationary in u, without cancellation for small u."""
    return g * (expm1(u) * (1.0 - u) - u) - c / m0


@compiled
def sum_terms(terms, g, c, total, buffer):
    """T(g, c) = sum over m = 1..terms of exp(-g) g^(m-1) / (m! m) exp(-c/m), for up to LANES pairs.

    Only the upper half of the exponentials is computed: exp(-c/m) = exp(-c/2m)^2.
    """
    n = g.size
    for m in range(terms, terms // 2, -1):
        r = -RECIPROCALS[m]
        row = buffer[m]
        for i in range(n):
            row[i] = exp(c[i] * r)
    for m in range(terms // 2, 0, -1):
        row, twice = buffer[m], buffer[2 * m]
        for i in range(n):
            row[i] = twice[i] * twice[i]
    weight = buffer[0]
    for i in range(n):
        weight[i] = exp(-g[i])
        total[i] = weight[i] * buffer[1, i]
    for m in range(2, terms + 1):
        r = RECIPROCALS[m]
        row = buffer[m]
        for i in range(n):
            w = weight[i] * (g[i] * r)
            weight[i] = w
            total[i] += w * r * row[i]


@compiled
def expand(which, g, c, total):
    """T(g, c) by the expansion about the largest term: which = 0..2 full, 3..4 nano, 5..6 micro."""
    n = g.size
    for i in range(n):
        u, p, m0 = saddle(g[i], c[i])
        total[i] = exp(expansion_exponent(g[i], c[i], u, m0)) * math.sqrt(p) / (m0 * g[i])
    if which == 0:
        for i in range(n):
            u, p, m0 = saddle(g[i], c[i])
            total[i] *= full_low(1.0 / m0, p)
    elif which == 1:
        for i in range(n):
            u, p, m0 = saddle(g[i], c[i])
            total[i] *= full_mid(1.0 / m0, p)
    else:
        for i in range(n):
            u, p, m0 = saddle(g[i], c[i])
            total[i] *= full_high(1.0 / m0, p)
