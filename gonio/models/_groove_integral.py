"""Oren and Nayar's V-groove integral (their eqs. 4 to 13): one bounce with shadowing and masking, and two bounces.

In S = 1 + A cos(phi_a), A = tan(theta_i) tan(theta_a), and V = 1 + B cos(phi_a - Delta), B = tan(theta_r)
tan(theta_a), what a facet and its opposite (S' = 2 - S) contribute to the BRDF of a groove of slope theta_a is,
before averaging over phi_a,

    rho/pi cos(theta_a) min(S V, 2 V, 2 S)                                    where S > 0 and V > 0
    (rho/pi)^2 cos(theta_a) min(S', 2) min(V, 2) J(m_s, m_v)                  where S' > 0 and V > 0

with m_s = min(1, 2/S') the lit part of one facet, m_v = min(1, 2/V) the visible part of the other, and J the mean of
the kernel K' (eq. 8) over them. Kinks in phi_a lie where S or V is 0 or 2 and where A cos(phi_a) = +-B cos(phi_a -
Delta). Between kinks everything is analytic, and Gauss-Legendre rules are used in variables that crowd their nodes
toward the ends.

One slope is integrated over phi_a in arcs between its kinks. For all slopes theta_a is integrated first. With t =
tan(theta_a), x = tan(theta_i) cos(phi_a) and y = tan(theta_r) cos(phi_a - Delta), S = 1 + x t and V = 1 + y t; with l
the larger and m the smaller of |x| and |y|, and e = +-1 the sign of x y, a facet and its opposite give together

    slopes                once                 twice, times rho/pi
    t < 1/l               2 + 2 e l m t^2      2 pi (1 - c) (1 - e l m t^2)
    1/l < t < 1/m         2 + 2 e m t          pi (1 - e m t) (1 - c + sin(theta_a) (sqrt(1 + l^2) - l))
    1/m < t, e = 1        2 + 2 m t            0
    1/m < t, e = -1       0                    4 J(2/(1 + l t), 2/(1 + m t))

All but the last are sums of functions of theta_a alone times functions of phi_a: their integrals over theta_a are
polynomials of the bounds, made once for a sigma. Then over half a circle of phi_a there are four intervals without
kinks: between the zeros of x, y, x - y and x + y.
"""

import functools
import math
from math import acos, atan2, cos, floor, hypot, pi, sin, sqrt, tan

import numpy as np
from numpy.polynomial import chebyshev

from gonio.models._compile import device, table
from gonio.models._hemisphere import gauss
from gonio.models._math import atan_over, exp, log, sincos
from gonio.typing import Floats, NDArray


@table
def NODES() -> Floats:
    """The nodes of the rules of 4, 8, ..., 104 points: those of the rule of 4k points begin at 2k(k - 1)."""
    return np.concatenate([gauss(4 * k)[0] for k in range(1, 27)])


@table
def WEIGHTS() -> Floats:
    """Their weights."""
    return np.concatenate([gauss(4 * k)[1] for k in range(1, 27)])


GRADES = 2  # of steepness, to a unit of its logarithm: an arc takes the rule of the next steeper grade
STEEPEST_GRADE = 128
# quarters of points to a unit of reach, more, and at most: plain arcs, those with a ridge, all slopes at once
RULES = ((1.1, 1.5, 36), (1.1, 8.5, 36), (2.0, 3.0, 62))
MOST_NODES = 4 * 4 * RULES[2][2]


@functools.cache
def _crowded() -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Nodes and weights on (-1, 1) that crowd to both ends, s = tanh(reach x / 2) / tanh(reach / 2), rule after rule.

    reach is the logarithm of the steepness. Also where the rules begin: first by grade, then in the order of `RULES`.
    """
    nodes, weights = [], []
    for grade in range(1, STEEPEST_GRADE + 1):
        reach = grade / GRADES
        for steep, more, most in RULES:
            x, weight = gauss(4 * min(int(steep * reach + more), most))
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
def twice_over_arc(half, sm, cm, smd, cmd, a, b, ti, tr, sine, c, work):  # type: ignore[no-untyped-def]
    """The integral of min(S', 2) min(V, 2) J over one arc around an azimuth m, from sin and cos of m and of m - Delta.

    Nodes crowd to both ends as far as the steepness asks; most of them where there is a ridge. Where only
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
    rule = len(RULES) * min(int(GRADES * log(1.0 + 4.0 * steep * half)), STEEPEST_GRADE - 1) + (1 if ridge else 0)
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
def around(ti, tr, delta, turns, tangent, c, second, edges, work):  # type: ignore[no-untyped-def]
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
            total += second * twice_over_arc(half, sm, cm, smd, cmd, a, b, ti, tr, tangent * c, c, work)
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
    cd, sd = tr * cos(delta), tr * sin(delta)
    return ti, tr, delta, (atan2(ti - cd, sd), atan2(ti + cd, -sd))


TERMS = 24  # of the polynomials for integrals over slopes: the BRDF is off by 4e-11 where nothing else is


@functools.cache
def _over_slopes() -> tuple[Floats, Floats, Floats]:
    """Points v in (0, 1), and what makes polynomials of values h at the points, by two products.

    For m = 1, 2, 3 the first gives the Chebyshev series of the integral of u^m h(v u^2) over u in (0, 1), the second
    its powers of 2v - 1. One matrix for both would lose ten digits.
    """
    x = np.cos(pi * (np.arange(TERMS) + 0.5) / TERMS)
    v = 0.5 * (1.0 + x)
    series = np.linalg.inv(chebyshev.chebvander(x, TERMS - 1))
    node, weight = gauss(4 * (TERMS // 4 + 1))
    u = 0.5 * (1.0 + node)
    at = chebyshev.chebvander(2.0 * v[:, None] * u * u - 1.0, TERMS - 1)
    made = [series @ np.einsum("u,iuk->ik", 0.5 * weight * u**m, at) @ series for m in (1, 2, 3)]
    powers = [np.pad(chebyshev.cheb2poly(np.eye(k + 1)[k]), (0, TERMS - 1 - k)) for k in range(TERMS)]
    return v, np.array(made), np.array(powers).T


@functools.lru_cache(maxsize=64)
def gaussian_constants(sigma: float) -> tuple[float, ...]:
    """What `gaussian_grooves` takes after its first two constants, for sigma [rad] above 0.

    1/(2 sigma^2); c, for which the integral of P sin(theta_a) is 1; the angle beyond which P is below 1e-11; then, with
    E = P/c, polynomials in 2 (theta/largest)^2 - 1 for the integrals from 0 to theta of E sin cos and E sin cos^2, over
    theta^2; of E sin^2 and E sin^2 cos, over theta^3; of E sin^3 and (E - E(pi/2)) sin^3/cos, over theta^4.
    """
    largest = min(pi / 2, sigma * sqrt(2.0 * math.log(1e11)))
    node, weight = gauss(48)
    theta = 0.5 * largest * (node + 1.0)
    norm = 1.0 / (float(weight @ (np.exp(-0.5 * (theta / sigma) ** 2) * np.sin(theta))) * 0.5 * largest)
    v, series, powers = _over_slopes()
    theta = largest * np.sqrt(v)
    e, c, n = np.exp(-0.5 * (theta / sigma) ** 2), np.cos(theta), np.sin(theta) / theta
    less = e - math.exp(-0.5 * (0.5 * pi / sigma) ** 2)  # without the pole at pi/2
    h = np.array([[e * n * c, e * n * c * c], [e * n**2, e * n**2 * c], [e * n**3, less * n**3 / c]])
    made = powers @ (series @ h.swapaxes(1, 2))
    return 0.5 / (sigma * sigma), norm, largest, *made.swapaxes(1, 2).ravel().tolist()


@device
def log_part(z):  # type: ignore[no-untyped-def]
    """log(1 + z) - z/(1 + z): twice the integral of sin^3/cos from 0 to the slope of the tangent sqrt(z)."""
    x = min(z, 0.0625)
    near = 7.0 / 8.0 - x * (8.0 / 9.0 - x * (9.0 / 10.0 - x * (10.0 / 11.0)))
    near = 4.0 / 5.0 - x * (5.0 / 6.0 - x * (6.0 / 7.0 - x * near))
    near = 1.0 / 2.0 - x * (2.0 / 3.0 - x * (3.0 / 4.0 - x * near))
    return z * z * near if z < 0.0625 else log(1.0 + z) - z / (1.0 + z)


@device
def slope_of(cot):  # type: ignore[no-untyped-def]
    """The slope [rad] of a cotangent above 0."""
    gentle = cot > 1.0
    r = 1.0 / cot if gentle else cot
    angle = r * atan_over(r * r)
    return angle if gentle else 0.5 * pi - angle


@device
def slopes_at(theta, largest, powers, out):  # type: ignore[no-untyped-def]
    """Fill the rows of `out` with the integrals over slopes from 0 to each theta; the last row is for its own use."""
    x, per = out[6], 2.0 / (largest * largest)
    for j in range(theta.size):
        x[j] = per * theta[j] * theta[j] - 1.0
    for i in range(6):
        row = out[i]
        first = TERMS * i
        for j in range(theta.size):
            row[j] = 0.0
        for k in range(first + TERMS - 4, first - 1, -4):
            a, b, c, d = powers[k], powers[k + 1], powers[k + 2], powers[k + 3]
            for j in range(theta.size):
                row[j] = (((row[j] * x[j] + d) * x[j] + c) * x[j] + b) * x[j] + a
        for j in range(theta.size):
            square = theta[j] * theta[j]
            row[j] *= square if i < 2 else square * theta[j] if i < 4 else square * square


@device
def azimuths(ti, tr, delta, turns, largest, weight, sign, larger, smaller):  # type: ignore[no-untyped-def]
    """Nodes and weights over half a circle of phi_a: fill in the sign of x y and the larger and smaller of |x|, |y|.

    Returns how many they are.
    """
    sd, cd = sincos(delta)
    edges = np.empty(5)  # where x or y is 0, or both are of one size, from pi/2 to 3 pi/2
    edges[0] = 0.5 * pi
    count = 1
    for turn in (delta + 0.5 * pi, turns[0], turns[1]):
        edge = max(turn - pi * floor(turn / pi - 0.5), edges[0])
        k = count
        while edges[k - 1] > edge:
            edges[k] = edges[k - 1]
            k -= 1
        edges[k] = edge
        count += 1
    edges[4] = 1.5 * pi
    steep = max(ti, tr) * min(1.0, largest)  # of all that slopes up to the largest see
    size = 0
    for i in range(4):
        half = 0.5 * (edges[i + 1] - edges[i])
        if half < 1e-16:
            continue
        sm, cm = sincos(0.5 * (edges[i + 1] + edges[i]))
        smd = sm * cd - cm * sd
        cmd = cm * cd + sm * sd
        rule = len(RULES) * min(int(GRADES * log(1.0 + 4.0 * steep * half)), STEEPEST_GRADE - 1) + 2
        first = ARC_BEGINS[rule]
        for j in range(ARC_BEGINS[rule + 1] - first):
            sj, cj = sincos(half * ARC_NODES[first + j])
            x = abs(ti * (cm * cj - sm * sj))
            y = abs(tr * (cmd * cj - smd * sj))
            weight[size + j] = half * ARC_WEIGHTS[first + j]
            sign[size + j] = 1.0 if cm * cmd >= 0.0 else -1.0
            larger[size + j] = max(max(x, y), 1e-30)
            smaller[size + j] = max(min(x, y), 1e-30)
        size += ARC_BEGINS[rule + 1] - first
    return size


@device
def twice_over_slopes(per_2_sigma2, least, largest, weight, sign, larger, smaller, theta):  # type: ignore[no-untyped-def]
    """4 J where both facets are cut, over azimuths and the slopes from `theta` on; none of these is below `least`."""
    wide = max(largest - least, 0.0) * sqrt(8.0 * per_2_sigma2)  # in units of sigma
    rule = min(int(4.0 + 0.3 * wide), 26)
    first = 2 * rule * (rule - 1)
    nodes, weights = NODES[first : first + 4 * rule], WEIGHTS[first : first + 4 * rule]
    sums = np.zeros(4 * rule)
    for j in range(theta.size):
        low = theta[j]
        if sign[j] > 0.0 or low >= largest:
            continue
        half = 0.5 * (largest - low)
        scale = half * weight[j]
        big, small = larger[j], smaller[j]
        for k in range(nodes.size):
            u = nodes[k]
            slope = low + half * (1.0 + 0.5 * u * (3.0 - u * u))
            s, c = sincos(slope)
            ms = min(2.0 * c / (c + big * s), 1.0)
            mv = min(2.0 * c / (c + small * s), 1.0)
            e = exp(-slope * slope * per_2_sigma2)
            sums[k] += scale * (1.0 - u * u) * e * s * c * mean_exchange(ms, mv, c)
    total = 0.0
    for k in range(nodes.size):
        total += weights[k] * sums[k]
    return 6.0 * total


@device
def gaussian_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for P(theta_a) = c exp(-theta_a^2/(2 sigma^2)), Oren1994 eq. 13.

    p: rho/pi, rho/pi of the second bounce, then `gaussian_constants`.
    """
    albedo_pi, second, per_2_sigma2, norm, largest = p[:5]
    powers = np.array(p[5:])
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    if not ti + tr + delta < np.inf:  # the loop refuses it later
        return np.nan
    if max(ti, tr) * tan(largest) <= 1.0:  # nothing is shadowed or masked
        one = np.empty((7, 1))
        slopes_at(np.full(1, largest), largest, powers, one)
        whole, cross, cubic = one[0, 0], 0.5 * ti * tr * cos(delta), one[5, 0]
        twice = whole - one[1, 0] - cross * (cubic - one[4, 0])
        return albedo_pi * norm * (whole + cross * cubic + second * pi * twice)
    work = np.empty((5, MOST_NODES))
    weight, sign, larger, smaller, values = work[0], work[1], work[2], work[3], work[4]
    size = azimuths(ti, tr, delta, turns, largest, weight, sign, larger, smaller)
    theta = np.empty(2 * size + 1)
    for j in range(size):
        theta[j] = min(slope_of(larger[j]), largest)
        theta[size + j] = min(slope_of(smaller[j]), largest)
    theta[2 * size] = largest
    at = np.empty((7, theta.size))
    slopes_at(theta, largest, powers, at)
    f0, q0, f1, q1, f2, g2 = at[0], at[1], at[2], at[3], at[4], at[5]
    all_0, all_1 = f0[2 * size], f1[2 * size]
    at_grazing = 0.5 * exp(-0.25 * pi * pi * per_2_sigma2)
    for j in range(size):
        k = size + j
        big, small = larger[j], sign[j] * smaller[j]
        # the rows of the table above, in order; `cubic` is the integral of E sin^3/cos
        cubic = g2[j] + at_grazing * log_part(1.0 / (big * big))
        d0, d1, d2 = f0[k] - f0[j], f1[k] - f1[j], f2[k] - f2[j]
        e0, e1 = q0[k] - q0[j], q1[k] - q1[j]
        once = f0[k] + small * (big * cubic + d1)
        once += all_0 - f0[k] + small * (all_1 - f1[k]) if small > 0.0 else 0.0
        twice = 2.0 * (f0[j] - q0[j] - small * big * (cubic - f2[j]))
        less = 1.0 / (sqrt(1.0 + big * big) + big)  # sqrt(1 + l^2) - l
        twice += d0 - e0 + less * e1 - small * (d1 - e1 + less * d2)
        values[j] = weight[j] * (2.0 * once + second * pi * twice)
    total = 0.0
    for j in range(size):
        total += values[j]
    if second > 0.0:
        least = slope_of(max(min(ti, tr), 1e-30))
        total += second * twice_over_slopes(
            per_2_sigma2, least, largest, weight, sign, larger, smaller, theta[size : 2 * size]
        )
    value = albedo_pi * norm * total / (2.0 * pi)
    return np.inf if lz <= 0.0 and vz <= 0.0 and value > 1e6 else value


@device
def isotropic_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for grooves of one slope in every direction, Oren1994 eq. 12.

    p: rho/pi, rho/pi of the second bounce, tan and cos of theta_a.
    """
    albedo_pi, second, tan_a, cos_a = p
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    ring = around(ti, tr, delta, turns, tan_a, cos_a, second, np.empty(16), np.empty(144))
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
