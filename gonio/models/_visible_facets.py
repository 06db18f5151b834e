"""Integrals over GGX facets, by those that a direction sees [Heitz2018]: nothing of the lobe's width is in them."""

import math
from math import pi
from typing import Any

import numpy as np

from gonio.models import hemispherical
from gonio.models.fresnel import reflectance
from gonio.typing import Floats


def reflected(mu: float, a: float, p: Any, q: Any) -> tuple[Any, Any]:
    """G/G_1 of height-correlated Smith, and V.H, at a point (p, q) of the unit disk: there facets are spread evenly.

    The mean of G/G_1 over the disk is what a mirror's facets of width `a` reflect, seen at the cosine `mu`.
    """
    sine = math.sqrt(max(1.0 - mu * mu, 0.0))
    seen_x, seen_z = (part / math.hypot(a * sine, mu) for part in (a * sine, mu))
    q = 0.5 * (1.0 - seen_z) * np.sqrt(1.0 - p * p) + 0.5 * (1.0 + seen_z) * q
    rest = np.sqrt(np.maximum(1.0 - p * p - q * q, 0.0))
    hx, hy, hz = a * (rest * seen_x - q * seen_z), a * p, np.maximum(q * seen_x + rest * seen_z, 0.0)
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    vh = (hx * sine + hz * mu) / length
    z = 2.0 * vh * hz / length - mu

    def smith(c: Any) -> Any:
        return 0.5 * (np.sqrt(1.0 + a * a * np.maximum(1.0 - c * c, 0.0) / (c * c)) - 1.0)

    own = 1.0 + smith(max(mu, 1e-150))
    kept = np.where(z > 0.0, own / (own + smith(np.maximum(z, 1e-150))), 0.0)
    return kept, np.clip(vh, 0.0, 1.0)


def albedo(theta: Floats, a: float, index: complex, tolerance: float) -> Floats:
    """The share of light from polar angles [rad] that facets of an index reflect, to a tolerance of 1e-6 at best.

    It is 1e-4 where an index below 1 has a critical angle. The variables are t = sqrt(1 - r^2) of the disk's radius r,
    and its azimuth. Facets that send light below the horizon lie about t = a, so there the boxes begin small.
    """
    edges = np.array([0.0, *(t for t in (0.03 * a, 0.3 * a, a, 3.0 * a, 30.0 * a) if t < 0.9), 1.0])
    turns = np.linspace(-0.5 * pi, 0.5 * pi, 5)  # and as much on the other side of the plane of incidence
    best = 1e-4 if index.real < 1.0 and index.imag < 0.1 else 1e-6

    def of(angle: float) -> float:
        mu = math.cos(angle) if angle < 0.5 * pi else 0.0

        def integrand(t: Floats, turn: Floats) -> Floats:
            r = np.sqrt(1.0 - t * t)
            kept, vh = reflected(max(mu, 1e-12), a, r * np.cos(turn), r * np.sin(turn))
            return np.asarray(2.0 / pi * t * kept * reflectance(vh, index))

        return hemispherical.adaptive(
            integrand,
            hemispherical.boxes(edges, turns),
            max(tolerance, best),
            f"ggx: {math.degrees(angle):.6g} deg",
        )

    return np.array([of(angle) for angle in theta.tolist()])
