"""Oren and Nayar's V-groove integral (their eqs. 4 to 13): one bounce with shadowing and masking, and two bounces.

In S = 1 + A cos(phi_a), A = tan(theta_i) tan(theta_a), and V = 1 + B cos(phi_a - Delta), B = tan(theta_r) tan(theta_a), what a facet and its
opposite (S' = 2 - S) contribute to the BRDF of a groove of slope theta_a is, before averaging over phi_a,

    rho/pi cos(theta_a) min(S V, 2 V, 2 S)                                    where S > 0 and V > 0
    (rho/pi)^2 cos(theta_a) min(S', 2) min(V, 2) J(m_s, m_v)                  where S' > 0 and V > 0

with m_s = min(1, 2/S') the lit part of one facet, m_v = min(1, 2/V) the visible part of the other, and J the mean of the kernel K' (eq. 8) over
them. Kinks in phi_a lie where S or V is 0 or 2 and where A cos(phi_a) = +-B cos(phi_a - Delta); kinks in theta_a where such lines meet.
Between kinks everything is analytic, and Gauss-Legendre rules are used in variables that crowd their nodes toward the ends.
"""

from __future__ import annotations

from math import acos, atan2, cos, exp, hypot, log, pi, sin, sqrt, tanh

import numpy as np

from gonio.models._compile import device
from gonio.models._math import sincos

_SMALL = np.polynomial.legendre.leggauss(10)
_LARGE = np.polynomial.legendre.leggauss(20)
_SLOPE = np.polynomial.legendre.leggauss(14)
SMALL_X, SMALL_W = (np.ascontiguousarray(part) for part in _SMALL)
LARGE_X, LARGE_W = (np.ascontiguousarray(part) for part in _LARGE)
SLOPE_X, SLOPE_W = (np.ascontiguousarray(part) for part in _SLOPE)
STEEPEST = 1e15  # the largest tangent of a direction: at exactly grazing the limit is reached to the last digits
RATIO = 10.0  # intervals of theta_a that span a larger ratio are divided


@device
def mean_exchange(ms, mv, c):  # type: ignore[no-untyped-def]
    """J, the mean of K' over the lit part m_s and the visible part m_v of the facets of a groove with cos(theta_a) = c.

    Oren1994 eq. 11, the second difference of d(x, y) = sqrt((x - y)^2 + 4 x y c^2), with every difference of roots rationalised.
    """
    f = 4.0 * c * c
    d11 = 2.0 * c
    d1v = sqrt(mv * mv + (1.0 - mv) * f)
    ds1 = sqrt(ms * ms + (1.0 - ms) * f)
    dsv = sqrt((ms - mv) * (ms - mv) + (1.0 - ms) * (1.0 - mv) * f)
    p = d1v + d11
    q = dsv + ds1
    turn = (ms - f) / (ds1 + d11) + (ms - 2.0 * mv - f * (1.0 - mv)) / (dsv + d1v)
    return 0.5 * pi * ((2.0 - f) / q + (mv - f) * turn / (p * q))


@device
def groove_point(s, v, c, second):  # type: ignore[no-untyped-def]
    """The integrand at S = s, V = v, without cos(theta_a): one bounce plus `second` (rho/pi) times two."""
    one = min(s, 2.0) * v
    one = min(one, 2.0 * s)
    opposite = 2.0 - s
    ms = 2.0 / opposite if opposite > 2.0 else 1.0
    mv = 2.0 / v if v > 2.0 else 1.0
    lit = min(max(opposite, 0.0), 2.0)
    total = max(one, 0.0) + second * lit * min(v, 2.0) * mean_exchange(ms, mv, c)
    return total if v > 0.0 else 0.0


@device
def arc(low, high, a, b, delta, c, second, x, w):  # type: ignore[no-untyped-def]
    """The integral over one arc of phi_a without kinks; nodes crowd to both ends as far as the steepness asks."""
    half = 0.5 * (high - low)
    mid = 0.5 * (high + low)
    reach = 0.5 * log(1.0 + 4.0 * max(a, b) * half)
    scale = tanh(reach)
    total = 0.0
    for j in range(x.size):
        e = exp(2.0 * reach * x[j])
        t = (e - 1.0) / (e + 1.0)
        phi = mid + half * t / scale
        s = 1.0 + a * sincos(phi)[1]
        v = 1.0 + b * sincos(phi - delta)[1]
        total += w[j] * (1.0 - t * t) * groove_point(s, v, c, second)
    return total * half * reach / scale


@device
def around(ti, tr, delta, turns, tangent, c, second, edges):  # type: ignore[no-untyped-def]
    """The mean over phi_a for grooves of one slope, without cos(theta_a)."""
    a = ti * tangent
    b = tr * tangent
    if a <= 1.0 and b <= 1.0:  # nothing is shadowed or masked, m_s = m_v = 1, J = pi (1 - c)
        cross = 0.5 * a * b * cos(delta)
        return 1.0 + cross + second * pi * (1.0 - c) * (1.0 - cross)
    count = 0
    if a > 1.0:
        open_ = acos(1.0 / a)
        for edge in (open_, -open_, pi - open_, open_ - pi):
            edges[count] = edge
            count += 1
    if b > 1.0:
        open_ = acos(1.0 / b)
        for edge in (open_, -open_, pi - open_, open_ - pi):
            edges[count] = edge + delta
            count += 1
    for turn in turns:
        edges[count] = turn
        edges[count + 1] = turn + pi
        count += 2
    for j in range(count):  # into [0, 2 pi), sorted
        edge = edges[j] - 2.0 * pi * np.floor(edges[j] / (2.0 * pi))
        k = j
        while k > 0 and edges[k - 1] > edge:
            edges[k] = edges[k - 1]
            k -= 1
        edges[k] = edge
    total = 0.0
    for j in range(count):
        low = edges[j]
        high = edges[j + 1] if j + 1 < count else edges[0] + 2.0 * pi
        if high - low < 1e-15:
            continue
        mid = 0.5 * (low + high)
        if 1.0 + b * cos(mid - delta) <= 0.0:
            continue
        if max(a, b) * (high - low) < 4.0:
            total += arc(low, high, a, b, delta, c, second, SMALL_X, SMALL_W)
        else:
            total += arc(low, high, a, b, delta, c, second, LARGE_X, LARGE_W)
    return total / (2.0 * pi)


@device
def directions(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """(tan theta_i, tan theta_r, Delta, the two azimuths where A cos(phi_a) = +-B cos(phi_a - Delta))."""
    ti = min(hypot(lx, ly) / max(lz, 1e-300), STEEPEST)
    tr = min(hypot(vx, vy) / max(vz, 1e-300), STEEPEST)
    delta = atan2(lx * vy - ly * vx, lx * vx + ly * vy)
    cd = tr * cos(delta)
    sd = tr * sin(delta)
    return ti, tr, delta, (atan2(ti - cd, sd), atan2(ti + cd, -sd))


@device
def gaussian_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for P(theta_a) = c exp(-theta_a^2/(2 sigma^2)); p: rho/pi, rho/pi of the second bounce, 1/(2 sigma^2), c, the largest theta_a."""
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    edges = np.empty(16)
    knots = np.empty(64)
    knots[0] = 0.0
    count = 1
    for tangent in (ti, tr, ti * abs(cos(turns[0])), ti * abs(cos(turns[1]))):
        knot = atan2(1.0, tangent)
        if knot < p[4]:
            k = count
            while knots[k - 1] > knot:
                knots[k] = knots[k - 1]
                k -= 1
            knots[k] = knot
            count += 1
    knots[count] = p[4]
    total = 0.0
    for j in range(count):
        low = knots[j]
        while low < knots[j + 1]:
            high = knots[j + 1] if low == 0.0 else min(knots[j + 1], RATIO * low)
            half = 0.5 * (high - low)
            if half > 1e-16:
                for k in range(SLOPE_X.size):
                    u = SLOPE_X[k]
                    theta = low + half * (1.0 + 0.5 * u * (3.0 - u * u))
                    weight = half * SLOPE_W[k] * 1.5 * (1.0 - u * u) * exp(-theta * theta * p[2])
                    c = cos(theta)
                    total += weight * sin(theta) * c * around(ti, tr, delta, turns, sin(theta) / c, c, p[1], edges)
            low = high
    value = p[0] * p[3] * total
    return value if value < 1e13 else np.inf


@device
def isotropic_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for grooves of one slope in every direction (eq. 12); p: rho/pi, rho/pi of the second bounce, tan, cos of theta_a."""
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    value = p[0] * p[3] * around(ti, tr, delta, turns, p[2], p[3], p[1], np.empty(16))
    return value if value < 1e13 else np.inf


@device
def parallel_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for parallel grooves of one slope (sec. 3.1): the mean of the two facets; p as above, then cos and sin of the facets' azimuth."""
    li = (lx * p[4] + ly * p[5]) * p[2]
    lr = (vx * p[4] + vy * p[5]) * p[2]
    a = li / max(lz, 1e-300)
    b = lr / max(vz, 1e-300)
    a = min(max(a, -STEEPEST), STEEPEST)
    b = min(max(b, -STEEPEST), STEEPEST)
    value = groove_point(1.0 + a, 1.0 + b, p[3], p[1]) + groove_point(1.0 - a, 1.0 - b, p[3], p[1])
    value = 0.5 * p[0] * p[3] * value
    return value if value < 1e13 else np.inf
