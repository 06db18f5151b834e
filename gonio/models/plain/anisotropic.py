"""Facets with a direction: Walter2007's Trowbridge-Reitz facets, Burley2012's two widths, Heitz2014's shadowing.

Vectors are in the frame of the surface's own direction: x along the brushing, z the normal.
"""

import numpy as np

from gonio.models.plain import fresnel
from gonio.models.plain.vectors import N, Numbers, Vectors, dot, unit

PI = np.pi


def h(L: Vectors, V: Vectors) -> Vectors:
    """Walter2007 h: the unit vector halfway between light and viewer; 0/0 where they are opposite.

    Compiled: gonio.models.anisotropic.anisotropic
    """
    return unit(np.asarray(V) + L)


def D(h: Vectors, alpha_x: Numbers, alpha_y: Numbers) -> Numbers:
    """Burley2012 D_GTR2aniso: 1/(pi a_x a_y ((h.x/a_x)^2 + (h.y/a_y)^2 + (h.z)^2)^2), Walter2007's D if a_x = a_y.

    Compiled: gonio.models.anisotropic.anisotropic
    """
    h = np.asarray(h)
    bracket = (h[..., 0] / alpha_x) ** 2 + (h[..., 1] / alpha_y) ** 2 + h[..., 2] ** 2
    return 1 / (PI * alpha_x * alpha_y * bracket**2)


def Lambda(V: Vectors, alpha_x: Numbers, alpha_y: Numbers) -> Numbers:
    """Heitz2014 Lambda: (sqrt(1 + a^2 tan^2) - 1)/2, where a^2 tan^2 = ((a_x v_x)^2 + (a_y v_y)^2)/v_z^2.

    Loses digits where a tan is small: the difference cancels.

    Compiled: gonio.models.anisotropic.anisotropic
    """
    V = np.asarray(V)
    square = ((alpha_x * V[..., 0]) ** 2 + (alpha_y * V[..., 1]) ** 2) / V[..., 2] ** 2
    return (np.sqrt(1 + square) - 1) / 2


def G_1(V: Vectors, alpha_x: Numbers, alpha_y: Numbers) -> Numbers:
    """Heitz2014 G_1 = 1/(1 + Lambda): the share of the facets that is seen from V.

    Compiled: none, part of the hemispherical reflectance
    """
    return 1 / (1 + Lambda(V, alpha_x, alpha_y))


def G_2(L: Vectors, V: Vectors, alpha_x: Numbers, alpha_y: Numbers) -> Numbers:
    """Heitz2014 G_2 = 1/(1 + Lambda(L) + Lambda(V)): the share that is lit and seen, correlated in height.

    Compiled: gonio.models.anisotropic.anisotropic
    """
    return 1 / (1 + Lambda(L, alpha_x, alpha_y) + Lambda(V, alpha_x, alpha_y))


def f_r(L: Vectors, V: Vectors, alpha_x: Numbers, alpha_y: Numbers, ior: complex) -> Numbers:
    """Walter2007 f_r = F G D/(4 (N.L)(N.V)): the BRDF of the facets [1/sr].

    Compiled: gonio.models.AnisotropicFacets.brdf
    """
    half = h(L, V)
    F = fresnel.reflectance(np.arccos(np.minimum(dot(V, half), 1)), ior)
    shown = G_2(L, V, alpha_x, alpha_y)
    return F * D(half, alpha_x, alpha_y) * shown / (4 * dot(N, L) * dot(N, V))
