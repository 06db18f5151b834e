"""The series of He, Torrance, Sillion and Greenberg (1991) for a block of pairs: sorted into classes, summed by class.

How a sum is taken depends on the place m0 of its largest term and on its width, m0 p: so many terms from m = 1, or the
largest term times a polynomial in 1/m0 and p (`_htsg_expansion`). Each class is a loop
over pairs that vectorises.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

import math
from typing import Any

import numpy as np

from gonio.models._compile import device, in_double, instead_of
from gonio.models._htsg_expansion import (
    FULL,
    LIMITS_FULL,
    LIMITS_MICRO,
    LIMITS_NANO,
    MICRO,
    NANO,
    TERMS,
    exp2_full,
    exp2_micro,
    lambert_start,
    rough_log1p,
)
from gonio.models._math import (
    _LN2_HIGH,
    _LN2_LOW,
    _LOG2_E,
    _MANTISSA,
    _ONE_BITS,
    _ROUND,
    _ROUND_BITS,
    _SQRT_HALF_BITS,
    _TWO_52,
    _TWO_52_BITS,
    exp,
    exp2,
)

BLOCK = 2048  # pairs sorted at a time: their state stays in the cache
LANES = 64  # pairs summed at a time: their exponentials stay in the cache
EXPANDED = 256  # pairs expanded at a time
SUMS = len(TERMS)
_COUNTS = np.array(TERMS)
_RECIPROCALS = np.concatenate([[0.0], 1.0 / np.arange(1, max(TERMS) + 1)])
_RATIOS = np.arange(max(TERMS) + 1) / np.arange(1, max(TERMS) + 2) ** 2  # of the weights of terms m + 1 and m, over g
_ROUND_BIASED = _ROUND + 1023.0  # adding it leaves the exponent's bits of 2^k in the low bits

_FIRST_KIND = int(np.array(2.0**-7).view(np.int64)) >> 49
_EDGES = np.outer(2.0 ** np.arange(-7, 11), 1.0 + np.arange(8) / 8.0).ravel()


_LIMITS = (LIMITS_FULL, LIMITS_NANO, LIMITS_MICRO)
_BANDS = (FULL, NANO, MICRO)
NOTHING = SUMS + max(len(bands) for bands in _BANDS)


def _kinds(limits: tuple[float, ...], bands: Any) -> tuple[list[int], list[float]]:
    """The class of each eighth of an octave of m0 from 2^-7 to 2^11, first of narrow sums, then of wide ones.

    Narrow is what no band holds: summed term by term up to m0 = 40, and 0 above. The second list is the smallest p of
    a wide sum.
    """
    sums = np.searchsorted(limits, np.append(_EDGES[1:], 2.0**11))
    band = np.searchsorted([low for low, *_ in bands], _EDGES, side="right") - 1
    wide = np.where(band < 0, sums, SUMS + band)
    least = [bands[k][1] / bands[k][0] if k >= 0 else 0.0 for k in band]
    return [int(k) for k in (*np.where(_EDGES < 40.0, sums, wide), *wide)], least


def _table() -> tuple[Any, Any, Any, Any]:
    """For each tier and band: scales, fours of coefficients in each row, where they start; and all rows in turn."""
    scales, fours = np.zeros((3, NOTHING - SUMS, 5)), np.zeros((3, NOTHING - SUMS, 16), np.int64)
    start = np.zeros((3, NOTHING - SUMS), np.int64)
    values: list[float] = []
    for tier, bands in enumerate(_BANDS):
        for k, (_, _, *numbers, rows) in enumerate(bands):
            scales[tier, k], start[tier, k] = numbers, len(values)
            for a, row in enumerate(rows):
                fours[tier, k, a] = max(2, -(-len(row) // 4))
                values += [0.0] * (4 * int(fours[tier, k, a]) - len(row)) + list(row)
    return scales, fours, start, np.array(values)


_CLASSES = [_kinds(limits, bands) for limits, bands in zip(_LIMITS, _BANDS, strict=True)]
_KINDS = np.array([kinds for kinds, _ in _CLASSES])
_LEAST = np.array([least for _, least in _CLASSES])
_SCALES, _FOURS, _START, _TABLE = _table()
TIERS = (1e-12, 1e-9, 1e-6)
"""Largest relative error (times 1 + conditioning) of the three ways of evaluating the series."""


@device
def expm1(x):
    """e^x - 1 for x in [0, 700], accurate near 0."""
    shifted = x * _LOG2_E + _ROUND
    k = shifted - _ROUND
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    r2 = r * r
    r4 = r2 * r2
    low = (0.5 + r * (1.0 / 6.0)) + r2 * (1.0 / 24.0 + r * (1.0 / 120.0))
    mid = (1.0 / 720.0 + r * (1.0 / 5040.0)) + r2 * (1.0 / 40320.0 + r * (1.0 / 362880.0))
    top = (1.0 / 3628800.0 + r * (1.0 / 39916800.0)) + r2 * (1.0 / 479001600.0 + r * (1.0 / 6227020800.0))
    p = low + r4 * (mid + r4 * top)
    bits = np.float64(shifted).view(np.int64) - _ROUND_BITS
    scale = np.int64((bits + 1023) << 52).view(np.float64)
    return scale * (r + r2 * p) + (scale - 1.0)


@device
def rough_lambert(x):
    """(W0(x), 1/(1 + W0(x))) within 1e-4 for x in [0, 1e280]."""
    bits = np.float64(1.0 + x).view(np.int64) + (_ONE_BITS - _SQRT_HALF_BITS)
    exponent = np.int64((bits >> 52) + _TWO_52_BITS).view(np.float64) - (_TWO_52 + 1023.0)
    y = exponent * _LN2_HIGH + rough_log1p(np.int64((bits & _MANTISSA) + _SQRT_HALF_BITS).view(np.float64) - 1.0)
    y = x if x < 1e-4 else y  # ln(1 + x)
    up, down = lambert_start(y)  # W0 = y up/down
    up *= y
    total = up + down
    r = 1.0 / (down * total)
    return up * total * r, down * down * r


@device
def better_lambert(x, a, p):
    """(w, 1/(1 + w), e^(w/2) - 1) with w = W0(x), from what `rough_lambert` gives: a near w, and p = 1/(1 + a).

    w = a + d with (a + d) e^d = x e^-a =: r, by the series in h = (r - a)/(1 + a); to a few units in the last place
    for x < 1e10, where d is small, and for all x the second time.
    """
    rise = expm1(0.5 * a)
    scale = 1.0 + rise  # e^(a/2)
    h = (x / (scale * scale) - a) * p
    d3 = 1.0 / 3.0 + p * (2.0 / 3.0 + 0.5 * p)
    d4 = 0.25 + 0.75 * p + p * p * (25.0 / 24.0 + 0.625 * p)
    d = h - h * h * (0.5 + 0.5 * p - h * (d3 - h * d4))
    e = d * p
    rise += scale * (0.5 * d * (1.0 + d * (0.25 + d * (1.0 / 24.0))))
    return a + d, p * (1.0 - e * (1.0 - e * (1.0 - e))), rise


@device
def lambert_w(x):
    """(w, 1/(1 + w), e^(w/2) - 1) with w = W0(x), for x in [0, 1e280]."""
    a, p = rough_lambert(x)
    a, p, _ = better_lambert(x, a, p)
    return better_lambert(x, a, p)


@device
def exp2_over(c, r, quick):
    """2^(-c r) for c r >= 0; `quick`: to 1e-7."""
    t = min(c * r, 1021.0)
    shifted = _ROUND_BIASED - t
    f = (_ROUND_BIASED - shifted) - t
    scale = np.int64(np.float64(shifted).view(np.int64) << 52).view(np.float64)
    return scale * (exp2_micro(f) if quick else exp2_full(f))


@instead_of(exp2_over)
def exp2_over_single(c, r, quick):
    """The same in float32."""
    return exp2(-(c * r))


@device
def sum_terms(terms, n, quick, g, c, total, powers):
    """T(g, c) = sum over m = 1..terms of exp(-g) g^(m-1)/(m! m) exp(-c/m), for n <= LANES pairs; c in units of ln 2.

    By Horner's rule in g from the last term, two terms at a time. Only the upper half of the exponentials is
    computed: exp(-c/m) = exp(-c/2m)^2. `quick`: to 1e-7.
    """
    for i in range(n):
        total[i] = 0.0
    for m in range(terms, terms // 2, -2):
        r, s, u, v = _RECIPROCALS[m], _RECIPROCALS[m - 1], _RATIOS[m], _RATIOS[m - 1]
        upper, lower = powers[m], powers[m - 1]
        if quick:
            for i in range(n):
                a, b = exp2_over(c[i], r, True), exp2_over(c[i], s, True)
                upper[i], lower[i] = a, b
                total[i] = b + g[i] * v * (a + g[i] * u * total[i])
        else:
            for i in range(n):
                a, b = exp2_over(c[i], r, False), exp2_over(c[i], s, False)
                upper[i], lower[i] = a, b
                total[i] = b + g[i] * v * (a + g[i] * u * total[i])
    for m in range(terms // 2, 2, -2):
        u, v = _RATIOS[m], _RATIOS[m - 1]
        upper, lower, twice, below = powers[m], powers[m - 1], powers[2 * m], powers[2 * m - 2]
        for i in range(n):
            a, b = twice[i] * twice[i], below[i] * below[i]
            upper[i], lower[i] = a, b
            total[i] = b + g[i] * v * (a + g[i] * u * total[i])
    twice, u, v = powers[4], _RATIOS[2], _RATIOS[1]
    for i in range(n):
        a = twice[i] * twice[i]
        total[i] = exp(-g[i]) * (a * a + g[i] * v * (a + g[i] * u * total[i]))


@device
def expand(tier, band, n, x, spread, value, work):
    """value = S m0/sqrt(p) exp(-phi) of n pairs, x = 1/m0, p = spread: a band's polynomial, four powers at a time."""
    scales = _SCALES[tier, band]
    b, x_centre, x_scale, q_centre, q_scale = scales[0], scales[1], scales[2], scales[3], scales[4]
    y, t, row = work[0], work[1], work[2]
    for i in range(n):  # the two variables on [-1, 1]: of 1/m0, and of q = p/(p + b (1 - p))
        p = spread[i]
        y[i] = (x[i] - x_centre) * x_scale
        t[i] = (p / (p + b * (1.0 - p)) - q_centre) * q_scale
        value[i] = 0.0
    k = _START[tier, band]
    for fours in _FOURS[tier, band]:
        for four in range(fours):
            c3, c2, c1, c0 = _TABLE[k], _TABLE[k + 1], _TABLE[k + 2], _TABLE[k + 3]
            k += 4
            if four == 0:
                for i in range(n):
                    row[i] = ((c3 * t[i] + c2) * t[i] + c1) * t[i] + c0
            elif four < fours - 1:
                for i in range(n):
                    row[i] = (((row[i] * t[i] + c3) * t[i] + c2) * t[i] + c1) * t[i] + c0
            else:
                for i in range(n):
                    top = (((row[i] * t[i] + c3) * t[i] + c2) * t[i] + c1) * t[i] + c0
                    value[i] = value[i] * y[i] + top
    for i in range(n):
        value[i] = 1.0 + x[i] * value[i]


# --- a block of pairs: the rows of its state are factor, K, c and g of each, and room for two numbers more ------------


@in_double
def narrow(n, state):
    """Factor and g of a block of n states from sigma0 to sigma: both times narrowing = (sigma/sigma0)^2."""
    factor, k, g = state[0], state[1], state[3]
    x, w, spread = state[1], state[4], state[5]  # x = K^2/8 pi takes K's place; w = W0(x), spread = 1/(1 + w)
    # in short loops: a processor overlaps only what it can look ahead to
    far = 0
    for i in range(n):
        x_i = k[i] * k[i] * (0.125 / math.pi)  # He1991 eqs. 80-83: narrowing = 1/(1 + W0(K^2/8 pi))
        x[i] = x_i
        w[i], spread[i] = rough_lambert(x_i)
        far |= 1 if x_i > 1e10 else 0
    if far:
        for i in range(n):
            if x[i] > 1e10:
                w[i], spread[i], _ = better_lambert(x[i], w[i], spread[i])
    for i in range(n):
        _, narrowing, _ = better_lambert(x[i], w[i], spread[i])
        factor[i] *= narrowing
        g[i] *= narrowing


@device
def largest_terms(n, state):
    """Where each series is largest: spread, m0 and phi in the rows 1, 4 and 5.

    Its largest term is at m0 = g e^(w/2), w = W0(2c/g^2), and as large as exp(phi); spread is p = 1/(1 + w).
    """
    c, g = state[2], state[3]
    spread, m0, phi = state[1], state[4], state[5]
    x, w = state[5], state[4]  # first x = 2c/g^2 in the row of phi, and w = W0(x) in the row of m0
    for i in range(n):
        g[i] = max(g[i], 1e-135)
        x_i = min(2.0 * c[i] / (g[i] * g[i]), 1e280)
        x[i] = x_i
        w[i], spread[i] = rough_lambert(x_i)
    for i in range(n):
        w_i, spread[i], rise = better_lambert(x[i], w[i], spread[i])
        m0[i] = g[i] + g[i] * rise
        phi[i] = g[i] * (rise * (1.0 - w_i) - w_i)  # m0 (1 - u) - g - c/m0, where c/m0 = u m0 and w = 2u


@device
def classify(n, tier, state, kind_of):
    """The class of each pair: a number of terms, a band, or `NOTHING` where the lobe is 0 or below 1e-306."""
    factor, spread, c, m0, phi = state[0], state[1], state[2], state[4], state[5]
    kinds, least_p = _KINDS[tier], _LEAST[tier]
    for i in range(n):
        eighth = (np.float64(m0[i]).view(np.int64) >> 49) - _FIRST_KIND
        place = min(max(eighth, 0), least_p.size - 1)
        kind = kinds[place + least_p.size if spread[i] >= least_p[place] else place]
        kind_of[i] = kind if factor[i] > 0.0 and max(phi[i], -c[i]) > -705.0 else NOTHING


@device
def sort_by_class(n, kind_of, order):
    """Pairs in the order of their classes, into `order`; where each class starts in it."""
    starts = np.zeros(NOTHING + 2, np.int64)
    for i in range(n):
        starts[kind_of[i] + 1] += 1
    for kind in range(NOTHING + 1):
        starts[kind + 1] += starts[kind]
    ends = starts.copy()
    for i in range(n):
        kind = kind_of[i]
        order[ends[kind]] = i
        ends[kind] += 1
    return starts


@in_double
def series(n, tier, state, out, order, kind_of, work, powers):
    """out = factor * T(g, c) for a block of n states, class by class: the series of He1991 eq. 78, T = S(g, c)/g."""
    factor, spread, c, g, m0, phi = state[0], state[1], state[2], state[3], state[4], state[5]
    largest_terms(n, state)
    classify(n, tier, state, kind_of)
    starts = sort_by_class(n, kind_of, order)
    for j in range(starts[NOTHING], n):
        out[order[j]] = 0.0
    # few terms: the sum from m = 1
    lane_g, lane_c, total = work[0], work[1], work[2]
    for kind in range(SUMS):
        for first in range(starts[kind], starts[kind + 1], LANES):
            count = min(LANES, starts[kind + 1] - first)
            whole = (count + 7) // 8 * 8  # whole vectors: the last pair is repeated
            for j in range(whole):
                i = order[first + min(j, count - 1)]
                lane_g[j], lane_c[j] = g[i], c[i] * _LOG2_E
            sum_terms(_COUNTS[kind], whole, tier == 2, lane_g, lane_c, total, powers)
            for j in range(count):
                i = order[first + j]
                out[i] = factor[i] * total[j]
    # many terms: the largest times sqrt(p) exp(phi) and a polynomial in 1/m0 and p
    lane_x, lane_phi, lane_spread, scale = work[0], work[1], work[3], work[4]
    for kind in range(SUMS, NOTHING):
        for first in range(starts[kind], starts[kind + 1], EXPANDED):
            count = min(EXPANDED, starts[kind + 1] - first)
            whole = (count + 7) // 8 * 8
            for j in range(whole):
                i = order[first + min(j, count - 1)]
                per_m0_g = 1.0 / (m0[i] * g[i])
                lane_x[j], lane_phi[j] = g[i] * per_m0_g, phi[i]
                lane_spread[j], scale[j] = spread[i], factor[i] * per_m0_g
            expand(tier, kind - SUMS, whole, lane_x, lane_spread, total, work[5:])
            for j in range(whole):
                total[j] *= scale[j] * (exp(lane_phi[j]) * math.sqrt(lane_spread[j]))
            for j in range(count):
                out[order[first + j]] = total[j]
