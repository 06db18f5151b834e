"""A lobe about the light: Burley2012's shape, in the observation angle, over Ashikhmin2007's denominator."""

import numpy as np

from gonio.models.plain.vectors import N, Numbers, Vectors, dot

PI = np.pi


def D(L: Vectors, V: Vectors, w: Numbers, tail: Numbers) -> Numbers:
    """Burley2012 D_GTR: c (1 + |V - L|^2/w^2)^-tail about L, with c for the integral 1 over all directions; tail not 1.

    Compiled: gonio.models.retroreflecting.retroreflecting
    """
    square = np.sum((np.asarray(V) - L) ** 2, axis=-1)
    c = (tail - 1) / (PI * w**2 * (1 - (1 + 4 / w**2) ** (1 - tail)))
    return c * (1 + square / w**2) ** (-tail)


def f_r(L: Vectors, V: Vectors, w: Numbers, tail: Numbers, entrance: Numbers) -> Numbers:
    """Ashikhmin2007 f_r: D/((N.L) + (N.V) - (N.L)(N.V)), times ((N.L)(N.V))^entrance [1/sr].

    Compiled: gonio.models.Retroreflecting.brdf
    """
    a, b = dot(N, L), dot(N, V)
    return D(L, V, w, tail) * (a * b) ** entrance / (a + b - a * b)
