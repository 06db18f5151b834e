"""Oren and Nayar's V-groove integral for facets whose angles have a mean: eq. 13, over eq. 12 of each slope.

Eq. 12 is smooth in theta_a but where two kinks in phi_a meet: where tan(theta_a) is 1/tan(theta_i), 1/tan(theta_r), or
1/|tan(theta_i) cos(phi_a)| at an azimuth where |x| = |y| (`_groove_integral`). There it has roots of odd powers of the
distance. Panels end at these slopes, and their nodes crowd to both ends as far as a narrower neighbour asks.
"""

import functools
import math
from math import atan, cos, pi, sqrt

import numpy as np

from gonio.models._compile import device
from gonio.models._groove_integral import NODES, WEIGHTS, around, directions
from gonio.models._hemisphere import gauss
from gonio.models._math import exp, log, sincos

SAME = 1e-10  # slopes closer than this share are one: with roots of odd powers above 1 the rest is below 1e-14
RULE = 24  # points of a Gauss rule; a panel takes two or more


@functools.lru_cache(maxsize=64)
def mean_slope_constants(sigma: float, mean: float) -> tuple[float, ...]:
    """What `mean_slope_grooves` takes after its first two constants, for sigma [rad] above 0 and mu [rad] in [0, pi/2).

    1/(2 sigma^2); mu; c, for which the integral of P sin(theta_a) is 1; the two slopes beyond which P/c is below 1e-11.
    """
    reach = sigma * sqrt(2.0 * math.log(1e11))
    low, high = max(mean - reach, 0.0), min(mean + reach, 0.5 * pi)
    node, weight = gauss(64)
    off = low - mean + 0.5 * (high - low) * (node + 1.0)
    integral = 0.5 * (high - low) * float(weight @ (np.exp(-0.5 * (off / sigma) ** 2) * np.sin(mean + off)))
    return 0.5 / (sigma * sigma), mean, 1.0 / integral, low, high


@device
def panels(ti, tr, turns, mean, low, high, edges):  # type: ignore[no-untyped-def]
    """Fill `edges` with the slopes where panels from `low` to `high` end, in order; how many they are."""
    edges[0], edges[1], edges[2], edges[3] = low, mean, atan(1.0 / max(ti, 1e-30)), atan(1.0 / max(tr, 1e-30))
    edges[4] = atan(1.0 / max(abs(ti * cos(turns[0])), 1e-30))
    edges[5] = atan(1.0 / max(abs(ti * cos(turns[1])), 1e-30))
    count = 1
    for j in range(6):
        edge = min(max(edges[j], low), high)
        k = j
        while k > 0 and edges[k - 1] > edge:
            edges[k] = edges[k - 1]
            k -= 1
        edges[k] = edge
    for j in range(1, 6):
        if edges[j] - edges[count - 1] > SAME * edges[j] and high - edges[j] > SAME * high:
            edges[count] = edges[j]
            count += 1
    edges[count] = high
    return count + 1


@device
def panel(ti, tr, delta, turns, second, per_2_sigma2, mean, begin, width, narrow, arcs, work):  # type: ignore[no-untyped-def]
    """The integral of P/c sin(theta_a) times eq. 12 over a panel; `narrow` is the least width of it and its neighbours.

    theta_a runs as tanh(reach g/2) with g = (3u - u^3)/2: the reach resolves what is near beyond the ends, and g makes
    roots at the ends smooth in u.
    """
    reach = log(1.0 + 4.0 * width / narrow)
    per_end = 1.0 + 2.0 / (exp(reach) - 1.0)  # 1/tanh(reach/2)
    parts = int(1.7 + 0.55 * reach)
    first = RULE * (RULE // 4 - 1) // 2  # of the rule of 4k points: 2k(k - 1)
    total = 0.0
    for part in range(parts):
        for k in range(first, first + RULE):
            u = (2.0 * part + 1.0 + NODES[k]) / parts - 1.0
            t = 1.0 - 2.0 / (1.0 + exp(0.5 * reach * u * (3.0 - u * u)))
            off = begin - mean + 0.5 * width * (1.0 + t * per_end)
            s, c = sincos(mean + off)
            c = max(c, 1e-16)
            weight = WEIGHTS[k] * (1.0 - u * u) * (1.0 - t * t) * exp(-off * off * per_2_sigma2)
            total += weight * s * c * around(ti, tr, delta, turns, s / c, c, second, arcs, work)
    return total * 0.375 * reach * per_end * width / parts


@device
def mean_slope_grooves(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The BRDF for P(theta_a) = c exp(-(theta_a - mu)^2/(2 sigma^2)), Oren1994 eq. 13 with the mean mu of sec. 3.3.

    p: rho/pi, rho/pi of the second bounce, then `mean_slope_constants`.
    """
    albedo_pi, second, per_2_sigma2, mean, norm, low, high = p
    ti, tr, delta, turns = directions(lx, ly, lz, vx, vy, vz)
    if not ti + tr + delta < np.inf:  # the loop refuses it later
        return np.nan
    edges, arcs, work = np.empty(7), np.empty(16), np.empty(144)
    last = panels(ti, tr, turns, mean, low, high, edges) - 1
    total = 0.0
    for j in range(last):
        width = edges[j + 1] - edges[j]
        narrow = min(width, edges[j] - edges[j - 1]) if j > 0 else width
        narrow = min(narrow, edges[j + 2] - edges[j + 1]) if j + 1 < last else narrow
        total += panel(ti, tr, delta, turns, second, per_2_sigma2, mean, edges[j], width, narrow, arcs, work)
    value = albedo_pi * norm * total
    return np.inf if lz <= 0.0 and vz <= 0.0 and value > 1e6 else value
