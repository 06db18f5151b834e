"""Oren and Nayar's V-groove integral (their eqs. 4 to 13): one bounce with shadowing and masking, and two bounces.

In S = 1 + A cos(phi_a), A = tan(theta_i) tan(theta_a), and V = 1 + B cos(phi_a - Delta), B = tan(theta_r)
tan(theta_a), what a facet and its opposite (S' = 2 - S) contribute to the BRDF of a groove of slope theta_a is,
before averaging over phi_a,

    rho/pi cos(theta_a) min(S V, 2 V, 2 S)                                    where S > 0 and V > 0
    (rho/pi)^2 cos(theta_a) min(S', 2) min(V, 2) J(m_s, m_v)                  where S' > 0 and V > 0

with m_s = min(1, 2/S') the lit part of one facet, m_v = min(1, 2/V) the visible part of the other, and J the mean of
the kernel K' (eq. 8) over them. Kinks in phi_a lie where S or V is 0 or 2 and where A cos(phi_a) = +-B cos(phi_a -
Delta); kinks in theta_a where such lines meet. Between kinks everything is analytic, and Gauss-Legendre rules are
used in variables that crowd their nodes toward the ends.
"""

import functools
import math
from math import acos, atan2, cos, hypot, pi, sin, sqrt, tan

import numpy as np

from gonio.models._compile import device, table
from gonio.models._math import exp, log, sincos
from gonio.typing import Floats, NDArray


@functools.cache
def _gauss(k: int) -> tuple[Floats, Floats]:
    """Nodes and weights of 4k points."""
    return np.polynomial.legendre.leggauss(4 * k)


def _rules(which: int) -> Floats:
    """Gauss-Legendre nodes (0) or weights (1) of 4, 8, ..., 104 points, one rule after the other."""
    return np.concatenate([_gauss(k)[which] for k in range(1, 27)])


@table
def NODES() -> Floats:
    """The nodes of all the rules: those of the rule of 4k points begin at 2k(k - 1)."""
    return _rules(0)


@table
def WEIGHTS() -> Floats:
    """The weights of all the rules."""
    return _rules(1)


GRADES = 2
"""Of steepness, to a unit of its logarithm: an arc takes the rule of the next steeper grade."""
STEEPEST_GRADE = 128
MORE = (1.5, 2.5, 8.5)
"""Quarters of points beyond what the grade asks: plain arcs, arcs with a ridge, those near the forward direction."""


@functools.cache
def _crowded() -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Nodes and weights on (-1, 1) that crowd to both ends, s = tanh(reach x / 2) / tanh(reach / 2), rule after rule.

    reach is the logarithm of the steepness. Also where the rules begin: first by grade, then in the order of `MORE`.
    """
    nodes, weights = [], []
    for grade in range(1, STEEPEST_GRADE + 1):
        reach = grade / GRADES
        for more in MORE:
            x, weight = _gauss(min(int(1.1 * reach + more), 36))
            t, end = np.tanh(0.5 * reach * x), math.tanh(0.5 * reach)
            nodes.append(t / end)
            weights.append(weight * (1.0 - t * t) * 0.5 * reach / end)
    return np.concatenate(nodes), np.concatenate(weights), np.cumsum([0, *map(len, nodes)])


@table
def ARC_NODES() -> Floats:
    """The nodes of the rules for arcs."""
    return _crowded()[0]


@table
def ARC_WEIGHTS() -> Floats:
    """Their weights."""
    return _crowded()[1]


@table
def ARC_BEGINS() -> NDArray[np.int64]:
    """Where each rule for arcs begins."""
    return _crowded()[2]


STEEPEST = 1e12  # the largest tangent of a direction: at exactly grazing the limit is reached to 1e-11
RATIO = 10.0  # intervals of theta_a that span a larger ratio are divided


@device
def mean_exchange(ms, mv, c):  # type: ignore[no-untyped-def]
    """J, the mean of K' over the lit part m_s and the visible part m_v of the facets of a groove with cos(theta_a) = c.

    Oren1994 eq. 11, the second difference of d(x, y) = sqrt((x - y)^2 + 4 x y c^2), with every difference of roots
    rationalised.
    """
    f = 4.0 * c * c
    d11 = 2.0 * c
    d1v = sqrt(mv * mv + (1.0 - mv) * f)
    ds1 = sqrt(ms * ms + (1.0 - ms) * f)
    dsv = sqrt((ms - mv) * (ms - mv) + (1.0 - ms) * (1.0 - mv) * f)
    sum_v = d1v + d11
    sum_s = dsv + ds1
    turn = (ms - f) / (ds1 + d11) + (ms - 2.0 * mv - f * (1.0 - mv)) / (dsv + d1v)
    return 0.5 * pi * ((2.0 - f) / sum_s + (mv - f) * turn / (sum_v * sum_s))


@device
def groove_point(s, v, c, second):  # type: ignore[no-untyped-def]
    """The integrand at S = s, V = v, without cos(theta_a): one bounce plus `second` (rho/pi) times two."""
    one_bounce = min(s, 2.0) * v  # Oren1994 eq. 6: min(S V, 2 V, 2 S)
    one_bounce = min(one_bounce, 2.0 * s)
    opposite = 2.0 - s  # S'
    ms = 2.0 / opposite if opposite > 2.0 else 1.0
    mv = 2.0 / v if v > 2.0 else 1.0
    lit = min(max(opposite, 0.0), 2.0)
    total = max(one_bounce, 0.0) + second * lit * min(v, 2.0) * mean_exchange(ms, mv, c)  # plus eq. 10
    return total if v > 0.0 else 0.0


@device
def twice_over_arc(half, sm, cm, smd, cmd, a, b, ti, tr, sine, c, more, work):  # type: ignore[no-untyped-def]
    """The integral of min(S', 2) min(V, 2) J over one arc around an azimuth m, from sin and cos of m and of m - Delta.

    Nodes crowd to both ends as far as the steepness asks; `more` is the place in `MORE` that a ridge has. Where only
    one facet is cut, J has the closed form V J = pi (1 - c + sin(theta_a) (sqrt(1 + w^2) - w)), w = tan(theta_r)
    cos(phi_a - Delta), and S' is a plain cosine.
    """
    lit_cut = 1.0 - a * cm > 2.0
    seen_cut = 1.0 + b * cmd > 2.0
    one_cut = lit_cut != seen_cut
    # with one side cut: w = uc cos(t) - us sin(t), and the uncut side is 1 + pc cos(t) - ps sin(t)
    uc, us = (tr * cmd, tr * smd) if seen_cut else (-ti * cm, -ti * sm)
    pc, ps = (-a * cm, -a * sm) if seen_cut else (b * cmd, b * smd)
    # cut on both sides, J has a ridge along S' = V as narrow as the smaller of 1/B and tan(theta_r)
    steep = (b if seen_cut else a) if one_cut else max(a, b) + 1.0 / max(ti, tr)
    ridge = not one_cut and abs(a * cm + b * cmd) < 0.5 * (b * cmd - a * cm)
    rule = len(MORE) * min(int(GRADES * log(1.0 + 4.0 * steep * half)), STEEPEST_GRADE - 1) + (more if ridge else 0)
    x = ARC_NODES[ARC_BEGINS[rule] : ARC_BEGINS[rule + 1]]
    weight = ARC_WEIGHTS[ARC_BEGINS[rule] : ARC_BEGINS[rule + 1]]
    if one_cut:
        for j in range(x.size):
            sj, cj = sincos(half * x[j])
            w = uc * cj - us * sj
            w = w if w > 0.0 else 0.0
            work[j] = weight[j] * (1.0 + pc * cj - ps * sj) * (1.0 - c + sine / (sqrt(1.0 + w * w) + w))
    else:
        for j in range(x.size):
            sj, cj = sincos(half * x[j])
            opposite = 1.0 - a * (cm * cj - sm * sj)
            v = 1.0 + b * (cmd * cj - smd * sj)
            ms = 2.0 / opposite if opposite > 2.0 else 1.0
            mv = 2.0 / v if v > 2.0 else 1.0
            work[j] = weight[j] * (4.0 / pi) * mean_exchange(ms, mv, c)
    total = 0.0
    for j in range(x.size):
        total += work[j]
    return total * pi * half


@device
def sine_less(h):  # type: ignore[no-untyped-def]
    """sin h - h."""
    z = h * h
    if h < 0.4:
        return h * z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362880.0 - z / 39916800.0))))
    return sincos(h)[0] - h


@device
def arc_edges(a, b, delta, turns, edges):  # type: ignore[no-untyped-def]
    """Fill `edges` with the azimuths in [0, 2 pi), in order, where shadow or mask begin or end; how many they are."""
    count = 0
    if a > 1.0:
        wide = acos(1.0 / a)
        edges[0], edges[1], edges[2], edges[3] = wide, -wide, pi - wide, wide - pi
        count = 4
    if b > 1.0:
        wide = acos(1.0 / b)
        edges[count], edges[count + 1] = delta + wide, delta - wide
        edges[count + 2], edges[count + 3] = delta + pi - wide, delta + wide - pi
        count += 4
    if a > 1.0 and b > 1.0:  # V and S, or V and S', can be equal above 2
        for turn in turns:
            edges[count], edges[count + 1] = turn, turn + pi
            count += 2
    for j in range(count):  # into [0, 2 pi), sorted
        edge = edges[j]
        edge = edge + 2.0 * pi if edge < 0.0 else edge
        edge = edge - 2.0 * pi if edge >= 2.0 * pi else edge
        k = j
        while k > 0 and edges[k - 1] > edge:
            edges[k] = edges[k - 1]
            k -= 1
        edges[k] = edge
    return count


@device
def around(ti, tr, delta, turns, tangent, c, second, more, edges, work):  # type: ignore[no-untyped-def]
    """The mean over phi_a for grooves of one slope, without cos(theta_a)."""
    a = ti * tangent
    b = tr * tangent
    if a <= 1.0 and b <= 1.0:  # nothing is shadowed or masked, m_s = m_v = 1, J = pi (1 - c)
        cross = 0.5 * a * b * cos(delta)
        return 1.0 + cross + second * pi * (1.0 - c) * (1.0 - cross)
    count = arc_edges(a, b, delta, turns, edges)
    sd, cd = sincos(delta)
    total = 0.0
    for j in range(count):
        low = edges[j]
        high = edges[j + 1] if j + 1 < count else edges[0] + 2.0 * pi
        half = 0.5 * (high - low)
        if half < 1e-16:
            continue
        mid = 0.5 * (low + high)
        sm, cm = sincos(mid)
        smd = sm * cd - cm * sd
        cmd = cm * cd + sm * sd
        v = 1.0 + b * cmd
        if v <= 0.0:
            continue
        s = 1.0 + a * cm
        if second > 0.0 and s < 2.0 and (v > 2.0 or s < 0.0):
            total += second * twice_over_arc(half, sm, cm, smd, cmd, a, b, ti, tr, tangent * c, c, more, work)
        if s <= 0.0:
            continue
        # integrals over the arc from the values at its middle: no difference of large terms
        less = sine_less(half)
        over_v = 2.0 * (half * v + b * cmd * less)
        if s <= 2.0 and v <= 2.0:
            square = -0.5 * sine_less(2.0 * half)  # of sin^2; of (1 - cos)^2: -4 less - square
            product = 2.0 * half * s * v + 2.0 * less * (s * b * cmd + v * a * cm)
            product += a * b * (cm * cmd * (-4.0 * less - square) + sm * smd * square)
            total += product + second * pi * (1.0 - c) * (2.0 * over_v - product)
        else:
            total += 2.0 * (over_v if v < s else 2.0 * (half * s + a * cm * less))
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
    """The BRDF for P(theta_a) = c exp(-theta_a^2/(2 sigma^2)), Oren1994 eq. 13.

    p: rho/pi, rho/pi of the second bounce, 1/(2 sigma^2), c, the largest theta_a.
    """
    albedo_pi, second, per_2_sigma2, norm, largest = p
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    edges = np.empty(16)
    work = np.empty(144)
    knots = np.empty(8)
    knots[0] = 0.0
    count = 1
    for tangent in (ti, tr, ti * abs(cos(turns[0])), ti * abs(cos(turns[1]))):
        knot = atan2(1.0, tangent)
        if knot < largest:
            k = count
            while knots[k - 1] > knot:
                knots[k] = knots[k - 1]
                k -= 1
            knots[k] = knot
            count += 1
    knots[count] = largest
    steep = max(ti, tr)
    # near the forward direction S' and V are nearly equal at every azimuth, and rings change fast beside a knot
    forward = ti * ti + tr * tr + 2.0 * ti * tr * cos(delta) < 0.01 * steep * steep
    more = 2 if forward else 1
    total = 0.0
    for j in range(count):
        low = knots[j]
        while low < knots[j + 1]:
            high = knots[j + 1] if low == 0.0 else min(knots[j + 1], RATIO * low)
            half = 0.5 * (high - low)
            if half > 1e-16:
                smooth = steep * tan(low + half) <= 1.0
                wide = half * sqrt(8.0 * per_2_sigma2)  # the interval in units of sigma
                rule = min(int((2.5 if smooth else 3.5) + 0.9 * wide), 16)
                if forward and not smooth:
                    rule += 2
                exponent = high * high * per_2_sigma2
                if high > 1.2 and exponent < 7.0:  # S and V grow without bound toward 90 degrees
                    rule += 8 if smooth else 2 if exponent > 2.5 else 4
                for k in range(2 * rule * (rule - 1), 2 * rule * (rule + 1)):
                    u = NODES[k]
                    weight = half * WEIGHTS[k] * (1.0 if smooth else 1.5 * (1.0 - u * u))
                    theta = low + half * (1.0 + (u if smooth else 0.5 * u * (3.0 - u * u)))
                    sine, c = sincos(theta)
                    ring = around(ti, tr, delta, turns, sine / c, c, second, more, edges, work)
                    total += weight * exp(-theta * theta * per_2_sigma2) * sine * c * ring
            low = high
    value = albedo_pi * norm * total
    return np.inf if lz <= 0.0 and vz <= 0.0 and value > 1e6 else value


@device
def isotropic_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for grooves of one slope in every direction, Oren1994 eq. 12.

    p: rho/pi, rho/pi of the second bounce, tan and cos of theta_a.
    """
    albedo_pi, second, tan_a, cos_a = p
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    ring = around(ti, tr, delta, turns, tan_a, cos_a, second, 2, np.empty(16), np.empty(144))
    value = albedo_pi * cos_a * ring
    return np.inf if lz <= 0.0 and vz <= 0.0 and value > 1e6 else value


@device
def parallel_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for parallel grooves of one slope, the mean of their two facets (Oren1994 sec. 3.1).

    p: as `isotropic_grooves`, then cos and sin of the facets' azimuth.
    """
    albedo_pi, second, tan_a, cos_a, cos_phi_a, sin_phi_a = p
    across_i = (lx * cos_phi_a + ly * sin_phi_a) * tan_a
    across_r = (vx * cos_phi_a + vy * sin_phi_a) * tan_a
    a = across_i / max(lz, 1e-300)  # A cos(phi_a): S = 1 + a for one facet, 1 - a for its opposite
    b = across_r / max(vz, 1e-300)  # B cos(phi_a - Delta): V = 1 + b and 1 - b
    a = min(max(a, -STEEPEST), STEEPEST)
    b = min(max(b, -STEEPEST), STEEPEST)
    value = groove_point(1.0 + a, 1.0 + b, cos_a, second) + groove_point(1.0 - a, 1.0 - b, cos_a, second)
    value = 0.5 * albedo_pi * cos_a * value
    return np.inf if lz <= 0.0 and vz <= 0.0 and value > 1e6 else value
