"""GGX facets with the light that meets several of them, by Kulla and Conty's lobe [Kulla2017]."""

import functools
import math
from math import pi
from typing import ClassVar

import numpy as np
from numpy.polynomial import chebyshev

from gonio.models._compile import of_columns
from gonio.models._facets import by_cosines
from gonio.models._visible_facets import reflected
from gonio.models.engine import Constants, Kernel
from gonio.models.fresnel import reflectance
from gonio.models.ggx import GGX, lobe
from gonio.models.parameters import index_at
from gonio.typing import Floats

NARROWEST = 1e-3
IN_MU, IN_ALPHA, NODES = 24, 12, 128
"""Coefficients over the cosine and the width; nodes a side of what they are made from. The energy lost between facets
is then right to 1e-3 of the light (tests/gonio/models/test_newer_models.py)."""


@of_columns(by_cosines, 4)
def multiscatter(sxy2, s2, lz, vz, p):  # type: ignore[no-untyped-def]
    """The single lobe, and weight (1 - E(L)) (1 - E(V)) with 1 - E a polynomial of mu (1 + a)/(mu + a)."""
    a2, alpha, weight = p[5], p[6], p[7]
    single = lobe(sxy2 / a2, lz + vz, s2, lz, vz, a2 * (1.0 - lz) * (1.0 + lz), a2 * (1.0 - vz) * (1.0 + vz), p)
    x = 2.0 * lz * (1.0 + alpha) / (lz + alpha) - 1.0
    y = 2.0 * vz * (1.0 + alpha) / (vz + alpha) - 1.0
    b1, b2, c1, c2 = 0.0, 0.0, 0.0, 0.0
    for k in range(len(p) - 1, 8, -1):  # Clenshaw's sum
        b1, b2 = p[k] + 2.0 * x * b1 - b2, b1
        c1, c2 = p[k] + 2.0 * y * c1 - c2, c1
    return single + weight * max(p[8] + x * b1 - b2, 0.0) * max(p[8] + y * c1 - c2, 0.0)


class GGXMultiscatter(GGX):
    """`GGX` with its lost energy: f + F_avg^2 E_avg/(1 - F_avg (1 - E_avg)) (1-E(L)) (1-E(V)) / (pi (1 - E_avg)).

    E is the single lobe's albedo where F = 1, E_avg and F_avg are cosine-weighted means. A perfect mirror's facets
    then reflect all that they receive, to 1e-3. Reciprocal. Isotropic: alpha_y is not taken. Parameters and errors as
    `GGX`, alpha at least 1e-3.
    """

    name: ClassVar[str] = "ggx-multiscatter"
    rank: ClassVar[int] = 14

    def __post_init__(self) -> None:
        from gonio.errors import ArgumentError

        super().__post_init__()
        if self.alpha_y is not None or self.alpha < NARROWEST:
            raise ArgumentError(f"ggx-multiscatter: alpha is at least {NARROWEST:g}, and alpha_y is not taken")

    @property
    def convention(self) -> str:
        return f"{super().convention[:-1]}; light between facets by Kulla and Conty 2017, energy to 1e-3."

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        _, constants = super()._evaluation(wavelength_nm)
        lost, gone, share = self._between_facets(wavelength_nm)
        return multiscatter, (*constants, self.alpha, share / (pi * gone), *lost.tolist())

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        lost, _, share = self._between_facets(wavelength_nm)
        single = super()._hemispherical(theta, phi, wavelength_nm, viewer, tolerance)
        return single + share * self._at(np.maximum(np.cos(theta), 0.0), lost)

    def _between_facets(self, wavelength_nm: float) -> tuple[Floats, float, float]:
        """Coefficients of 1 - E at this width, 1 - E_avg, and the share of it that leaves again."""
        place = 2.0 * math.log(self.alpha / NARROWEST) / -math.log(NARROWEST) - 1.0
        lost = np.asarray(chebyshev.chebval(place, _lost_energy()))
        x, w = np.polynomial.legendre.leggauss(64)
        mu, weight = 0.5 * (x + 1.0), 0.5 * w * (x + 1.0)
        gone = float(weight @ self._at(mu, lost))
        f = float(weight @ reflectance(mu, index_at(self.ior, wavelength_nm)))
        return lost, gone, f * f * (1.0 - gone) / (1.0 - f * gone)

    def _at(self, mu: Floats, lost: Floats) -> Floats:
        """1 - E."""
        x = 2.0 * mu * (1.0 + self.alpha) / (mu + self.alpha) - 1.0
        return np.asarray(np.maximum(chebyshev.chebval(x, lost), 0.0))


@functools.cache
def _lost_energy() -> Floats:
    """Chebyshev coefficients (alpha, mu) of 1 - E."""
    at = [np.cos(pi * (np.arange(n) + 0.5) / n) for n in (IN_ALPHA, IN_MU)]
    widths, places = NARROWEST ** (0.5 * (1.0 - at[0])), 0.5 * (1.0 + at[1])
    table = np.array([[_lost(a * x / (1.0 + a - x), a) for x in places.tolist()] for a in widths.tolist()])
    inner = np.linalg.solve(chebyshev.chebvander(at[1], IN_MU - 1), table.T).T
    return np.asarray(np.linalg.solve(chebyshev.chebvander(at[0], IN_ALPHA - 1), inner))


def _lost(mu: float, a: float) -> float:
    """1 - E at one cosine, where F = 1."""
    x, w = np.polynomial.legendre.leggauss(NODES)
    p, share = np.sin(0.5 * pi * x)[:, None], np.cos(0.5 * pi * x)
    kept, _ = reflected(mu, a, p, np.sqrt(1.0 - p * p) * np.sin(0.5 * pi * x))
    return 1.0 - 0.25 * pi * float((w * share**2) @ kept @ (w * share))
