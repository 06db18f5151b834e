"""How these models are usually evaluated, as comparison: through the models' own loops, checks and compiler.

He-Torrance's geometry, shadowing and Fresnel factors are those of the model; only the series is summed in other ways.
"""

# mypy: allow-untyped-defs, allow-untyped-calls

import math

import numpy as np

from gonio.models._compile import device, template
from gonio.models._facets import fresnel
from gonio.models._htsg_kernels import lobe_state, vector_states
from gonio.models._htsg_series import lambert_w
from gonio.models._loops import vector_part
from gonio.models._math import exp
from gonio.models.htsg import sum_around

BLOCK = 1024
BECKMANN_FROM = 18.5
"""The g above which public code replaces the series by its limit of geometrical optics."""


@device
def from_one(lx, ly, lz, vx, vy, vz, p):
    """The BRDF with p[11] terms of the series from m = 1, pair by pair, as public code has it."""
    factor, k, c, g0 = lobe_state(lx, ly, lz, vx, vy, vz, p)
    _, narrowing, _ = lambert_w(k * k * (0.125 / math.pi))
    g = narrowing * g0
    weight = exp(-g)
    total = weight * exp(-c)
    for m in range(2, int(p[11]) + 1):
        weight *= g / m
        total += weight / m * exp(-c / m)
    return p[0] + factor * narrowing * total


@device
def from_one_vectorised(lx, ly, lz, vx, vy, vz, p):
    """The state of `lobe_state`, for p[11] terms from m = 1 below g = p[12], and exp(-c/g)/g above."""
    return lobe_state(lx, ly, lz, vx, vy, vz, p)


@template("r1 i r1 i p w1 i i")
def over_vectors(omega_i, step_i, omega_r, step_r, constants, out, start, stop):
    wrong = 0
    state, below = np.empty((4, BLOCK)), np.empty((4, BLOCK))
    place = np.empty(BLOCK, np.int64)
    factor, spread, c, g = state[0], state[1], state[2], state[3]
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        l, v = vector_part(omega_i, first, count, step_i), vector_part(omega_r, first, count, step_r)  # noqa: E741
        wrong |= vector_states(count, l, v, constants, factor, spread, c, g)
        total = out[first : first + count]
        for j in range(count):
            k = spread[j]
            _, narrowing, _ = lambert_w(k * k * (0.125 / math.pi))
            factor[j] *= narrowing
            g[j] *= narrowing
            r = 1.0 / max(g[j], BECKMANN_FROM)
            total[j] = exp(-c[j] * r) * r * r
        n = 0
        for j in range(count):
            if g[j] < constants[12]:
                place[n], below[0, n], below[1, n] = j, g[j], c[j]
                n += 1
        sum_from_one(n, int(constants[11]), below[0], below[1], below[2], below[3])
        for i in range(n):
            total[place[i]] = below[3, i]
        for j in range(count):
            total[j] = factor[j] * total[j] + constants[0]
    return wrong


@device
def sum_from_one(count, terms, g, c, weight, total):
    """T(g, c) by terms from m = 1, one after another over all pairs, so that each loop vectorises."""
    for j in range(count):
        weight[j] = exp(-g[j])
        total[j] = weight[j] * exp(-c[j])
    for m in range(2, terms + 1):
        r = 1.0 / m
        for j in range(count):
            weight[j] *= g[j] * r
            total[j] += weight[j] * r * exp(-c[j] * r)


from_one_vectorised.__dict__["over_vectors"] = over_vectors


@device
def log_poisson(m, g):
    """ln(exp(-g) g^m / m!), for large m by the deviance (Loader 2000)."""
    if m < 16.0:
        return m * math.log(g) - g - math.lgamma(m + 1.0)
    difference = m - g
    if abs(difference) < 0.1 * (m + g):
        v = difference / (m + g)
        deviance, e, v2 = difference * v, 2.0 * m * v, v * v
        for j in range(1, 12):
            e *= v2
            deviance += e / (2.0 * j + 1.0)
    else:
        deviance = m * math.log(m / g) + g - m
    r = 1.0 / (m * m)
    stirling = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r / 1680.0))) / m
    return -stirling - deviance - 0.5 * math.log(2.0 * math.pi * m)


@device
def windowed(lx, ly, lz, vx, vy, vz, p):
    """The BRDF with the series summed from its largest term to both sides, until terms no longer count."""
    factor, k, c, g0 = lobe_state(lx, ly, lz, vx, vy, vz, p)
    _, narrowing, _ = lambert_w(k * k * (0.125 / math.pi))
    g = narrowing * g0
    if factor == 0.0 or g <= 0.0:
        return p[0]
    w, _, _ = lambert_w(min(2.0 * c / (g * g), 1e280))
    top = max(1.0, math.floor(g * math.exp(0.5 * w) + 0.5))
    total = sum_around(g, c, top)
    return p[0] + factor * narrowing * (math.exp(log_poisson(top, g) - c / top) / (top * g)) * total


# --- Fresnel: functions of the cosine; p: |n~^2 - 1|^2, n^2 - k^2 - 1, n k, the real index, normal reflectance, average


@device
def fresnel_complex(c, unused, p):
    """Exact, for n + ik: what the models compute."""
    up, down = fresnel(c * c, p[0], p[1], p[2])
    return up / down


@device
def fresnel_real(c, unused, p):
    """Cook and Torrance: a real index with the same reflectance at normal incidence, g^2 = n^2 + c^2 - 1."""
    g2 = p[3] * p[3] + c * c - 1.0
    g = math.sqrt(max(g2, 0.0))
    a, b = (g - c) / (g + c), (c * (g + c) - 1.0) / (c * (g - c) + 1.0)
    return 0.5 * a * a * (1.0 + b * b) if g2 > 0.0 else 1.0


@device
def schlick(c, unused, p):
    """Schlick 1994: F_0 + (1 - F_0)(1 - c)^5."""
    x = 1.0 - c
    x2 = x * x
    return p[4] + (1.0 - p[4]) * x2 * x2 * x


@device
def colour_interpolation(c, unused, p):
    """Cook and Torrance's colours: from p[4] to 1 as the average goes (real index p[3], normal reflectance p[5])."""
    return p[4] + (1.0 - p[4]) * max(0.0, fresnel_real(c, unused, p) - p[5]) / (1.0 - p[5])


# --- effective roughness -----------------------------------------------------------------------------------------


@device
def newton_roughness(k, unused, p):
    """sigma/sigma0 by p[0] Newton steps for sqrt(pi/2) x = (K/4) exp(-x^2/2), x = z0/sigma0, from ln(1 + K^2/8 pi)."""
    root = math.sqrt(0.5 * math.pi)
    x = math.sqrt(math.log1p(k * k * (0.125 / math.pi)))
    for _ in range(int(p[0])):
        e = 0.25 * k * exp(-0.5 * min(x * x, 1400.0))
        x -= (root * x - e) / (root + x * e)
    return 1.0 / math.sqrt(1.0 + x * x)


@device
def closed_roughness(k, unused, p):
    """sigma/sigma0 = 1/sqrt(1 + W0(K^2/8 pi)), as the model's kernel has it."""
    return math.sqrt(lambert_w(k * k * (0.125 / math.pi))[1])
