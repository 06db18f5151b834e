"""Integrals over GGX facets by those that a direction sees [Heitz2018]: nothing of the lobe's width is left in them."""

import math
from math import pi
from typing import Any

import numpy as np

from gonio.models import hemispherical
from gonio.models.fresnel import reflectance
from gonio.typing import Floats


def reflected(mu: float, a: float, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Density over (x, y) in [-1, 1]^2, G/G_1 of height-correlated Smith, and V.H of the facets there.

    The disk of visible facets is p = sin(pi x/2) and, between its ends, a linear function of sin(pi y/2). The density
    is 1 in all; times G/G_1 it is what a mirror's facets of width `a` reflect, seen at the cosine `mu`.
    """
    sine = math.sqrt(max(1.0 - mu * mu, 0.0))
    seen_x, seen_z = (part / math.hypot(a * sine, mu) for part in (a * sine, mu))
    p = np.sin(0.5 * pi * x)
    half = np.sqrt(1.0 - p * p)
    q = 0.5 * (1.0 - seen_z) * half + 0.5 * (1.0 + seen_z) * half * np.sin(0.5 * pi * y)
    rest = np.sqrt(np.maximum(1.0 - p * p - q * q, 0.0))
    hx, hy, hz = a * (rest * seen_x - q * seen_z), a * p, np.maximum(q * seen_x + rest * seen_z, 0.0)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    vh = (hx * sine + hz * mu) / length
    z = 2.0 * vh * hz / length - mu

    def smith(c: Any) -> Any:
        return 0.5 * (np.sqrt(1.0 + a * a * np.maximum(1.0 - c * c, 0.0) / (c * c)) - 1.0)

    own = 1.0 + smith(max(mu, 1e-150))
    kept = np.where(z > 0.0, own / (own + smith(np.maximum(z, 1e-150))), 0.0)
    return 0.25 * pi * half * half * np.cos(0.5 * pi * y), kept, np.clip(vh, 0.0, 1.0)


def albedo(theta: Floats, a: float, index: complex, tolerance: float) -> Floats:
    """The share of light from polar angles [rad] that facets of an index reflect, to a tolerance of 1e-6 at best."""

    def of(angle: float) -> float:
        mu = math.cos(angle) if angle < 0.5 * pi else 0.0

        def rule(boxes: Floats, order: int) -> Floats:
            node, weight = hemispherical.unit_rule(order)
            x = (boxes[:, :1] + (boxes[:, 1:2] - boxes[:, :1]) * node)[:, :, None]
            y = (boxes[:, 2:3] + (boxes[:, 3:] - boxes[:, 2:3]) * node)[:, None, :]
            density, kept, vh = reflected(max(mu, 1e-12), a, x, y)
            value = density * kept * reflectance(vh, index)
            area = (boxes[:, 1] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 2])
            return np.asarray(area * np.einsum("bij,i,j->b", value, weight, weight))

        edges = np.linspace(-1.0, 1.0, 5)
        return hemispherical.adaptive(
            rule, hemispherical.boxes(edges, edges), max(tolerance, 1e-6), f"ggx: {angle:.6g} rad"
        )

    return np.array([of(angle) for angle in theta.tolist()])
