"""GGX facets: Trowbridge-Reitz normals, height-correlated Smith shadowing [Walter2007, Heitz2014].

`GGXMultiscatter` has the light that meets several of them as well.
"""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import pi, sqrt
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import chebyshev

from gonio.errors import ArgumentError
from gonio.models import hemispherical
from gonio.models._compile import device, of_columns
from gonio.models._facets import by_cosines, facet, fresnel, index_constants
from gonio.models._hemisphere import gauss
from gonio.models.engine import Constants, Kernel
from gonio.models.fresnel import reflectance
from gonio.models.model import Model
from gonio.models.parameters import (
    INDEX,
    Declaration,
    Ior,
    Levels,
    Parameter,
    Values,
    index_at,
    optical,
    parameter,
    row,
)
from gonio.models.polarised import Facets
from gonio.typing import Floats

NARROWEST = 1e-3
"""Width below which nothing is fitted, and the light between facets is not known."""


@device
def lobe(slope2, sz, s2, lz, vz, lt2, vt2, own):  # type: ignore[no-untyped-def]
    """D G F/(4 N.L N.V) and the base; D's |s|^4/(pi a_x a_y (slope2 + s_z^2)^2), and lt2, vt2 of Smith's Lambda."""
    diffuse, scale, contrast, real, imag = own[0], own[1], own[2], own[3], own[4]
    root = slope2 + sz * sz
    f_up, f_down = fresnel(0.25 * s2, contrast, real, imag)
    smith = vz * sqrt(lz * lz + lt2) + lz * sqrt(vz * vz + vt2)
    value = diffuse + scale * (s2 * s2) * f_up / (root * root * f_down * smith)
    return value if value < 1e60 else math.inf


@device
def lobe_constants(ax, ay, diffuse_albedo, n, k):  # type: ignore[no-untyped-def]
    """What `lobe` takes of its parameters."""
    return (diffuse_albedo / pi, 0.5 / (pi * ax * ay)) + index_constants(n, k)  # noqa: RUF005 - numba adds tuples


@of_columns(by_cosines, 4)
def isotropic(sxy2, s2, lz, vz, p):  # type: ignore[no-untyped-def]
    """With a_x = a_y."""
    a2 = p[5]
    return lobe(sxy2 / a2, lz + vz, s2, lz, vz, a2 * (1.0 - lz) * (1.0 + lz), a2 * (1.0 - vz) * (1.0 + vz), p)


@device
def anisotropic(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """With a_x and a_y, in the sample's frame."""
    _, sz, s2, _, lz, vz = facet(lx, ly, lz, vx, vy, vz)
    ax2, ay2 = p[5], p[6]
    sx, sy = lx + vx, ly + vy
    lt2, vt2 = ax2 * lx * lx + ay2 * ly * ly, ax2 * vx * vx + ay2 * vy * vy
    return lobe(sx * sx / ax2 + sy * sy / ay2, sz, s2, lz, vz, lt2, vt2, p)


@dataclass(frozen=True, repr=False)
class GGX(Model):
    """Mirror facets over a diffuse base: brdf = D G F / (4 N.L N.V) + diffuse_albedo / pi [1/sr].

    D = 1/(pi a_x a_y (h_x^2/a_x^2 + h_y^2/a_y^2 + h_z^2)^2) of the half-vector h; its projection integrates to 1. G is
    1/(1 + Lambda(L) + Lambda(V)), F the exact unpolarised reflectance. Reciprocal. Facets reflect less than they
    receive: light that meets several is lost (`ggx-multiscatter` has it). The base may lift the sum above 1.

    rho_dh is right to 1e-6.
    """

    alpha: float = parameter(
        0.3,
        "[1e-4, 1]",
        "Width a_x of the slopes; an artist's roughness is its root.",
        scale="log",
        bounds=(NARROWEST, 1.0),
        geometry=True,
    )
    ior: Any = parameter(1.5, *INDEX)
    diffuse_albedo: float = parameter(0.0, "[0, 1]", "Reflectance of the base.", scale="linear")
    alpha_y: float | None = parameter(
        None,
        "[1e-4, 1]",
        "Width across x where it is another one; None: a_y = a_x.",
        scale="log",
        bounds=(NARROWEST, 1.0),
        geometry=True,
    )
    name: ClassVar[str] = "ggx"
    rank: ClassVar[int] = 13
    assumes: ClassVar[str] = "facets that are large against the wavelength (Walter et al. 2007)"
    in_sums: ClassVar[str] = "weighted gloss"
    has_ior: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        """See `Model.declaration`; `--free alpha_y` fits an anisotropic surface."""

        def starts(levels: Levels) -> list[Values]:
            grid = product((0.01, 0.05, 0.15, 0.3, 0.6), (1.3, 1.6, 3.0, 20.0), (0.1, 0.9))
            base = min(levels.diffuse, 1.0)
            return [{"alpha": a, "alpha_y": a, "ior": n, "diffuse_albedo": share * base} for a, n, share in grid]

        flat = {"diffuse_albedo": 1.0 / pi}
        return optical(cls.name, cls.fitted, ior, starts, only_freed=("alpha_y",), flat=lambda v: flat)

    @property
    def convention(self) -> str:
        return "GGX: Trowbridge-Reitz D of integral 1, height-correlated Smith, exact Fresnel; D G F/(4 N.L N.V)."

    @property
    def depends_on_azimuth(self) -> bool:
        return self.alpha_y not in (None, self.alpha)

    def facets(self, wavelength_nm: float) -> Facets:
        return Facets(index_at(self.ior, wavelength_nm), self.diffuse_albedo / pi)

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        a, b = self.alpha, self.alpha if self.alpha_y is None else self.alpha_y
        index = index_at(self.ior, wavelength_nm)
        own = lobe_constants(a, b, self.diffuse_albedo, index.real, index.imag)
        return (anisotropic, (*own, a * a, b * b)) if self.depends_on_azimuth else (isotropic, (*own, a * a))

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        if self.depends_on_azimuth:
            return super()._hemispherical(theta, phi, wavelength_nm, viewer, tolerance)
        return self.diffuse_albedo + albedo(theta, self.alpha, index_at(self.ior, wavelength_nm), tolerance)


# --- integrals over facets, by those that a direction sees [Heitz2018]: nothing of the lobe's width is in them ----


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


# --- with the light that meets several facets, by Kulla and Conty's lobe [Kulla2017] ------------------------------


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
    table: ClassVar[Mapping[str, Parameter]] = {
        **GGX.table,
        "alpha": row(0.3, f"[{NARROWEST:g}, 1]", GGX.table["alpha"].text, scale="log", geometry=True),
    }

    def __post_init__(self, *_: Any) -> None:
        super().__post_init__()
        if self.alpha_y is not None:
            raise ArgumentError("ggx-multiscatter: alpha_y is not taken")

    @property
    def convention(self) -> str:
        return f"{super().convention[:-1]}; light between facets by Kulla and Conty 2017, energy to 1e-3."

    def facets(self, wavelength_nm: float) -> Facets:
        """Light that meets several facets counts as depolarised."""
        return Facets(index_at(self.ior, wavelength_nm), alone=GGX(self.alpha, self.ior))

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
        lost, gone = _between(self.alpha)
        f = _mean_reflectance(index_at(self.ior, wavelength_nm))
        return lost, gone, f * f * (1.0 - gone) / (1.0 - f * gone)

    def _at(self, mu: Floats, lost: Floats) -> Floats:
        """1 - E."""
        return _lost_at(self.alpha, mu, lost)


def _lost_at(alpha: float, mu: Floats, lost: Floats) -> Floats:
    """1 - E by its coefficients at a width."""
    x = 2.0 * mu * (1.0 + alpha) / (mu + alpha) - 1.0
    return np.asarray(np.maximum(chebyshev.chebval(x, lost), 0.0))


def _cosines() -> tuple[Floats, Floats]:
    """Nodes and weights of a cosine-weighted mean."""
    x, w = gauss(64)
    return 0.5 * (x + 1.0), 0.5 * w * (x + 1.0)


@functools.lru_cache(maxsize=16)  # a fit's derivatives move one parameter at a time
def _between(alpha: float) -> tuple[Floats, float]:
    """Coefficients of 1 - E at a width, and 1 - E_avg."""
    place = 2.0 * math.log(alpha / NARROWEST) / -math.log(NARROWEST) - 1.0
    lost, (mu, weight) = np.asarray(chebyshev.chebval(place, _lost_energy())), _cosines()
    return lost, float(weight @ _lost_at(alpha, mu, lost))


@functools.lru_cache(maxsize=16)
def _mean_reflectance(index: complex) -> float:
    """F_avg."""
    mu, weight = _cosines()
    return float(weight @ reflectance(mu, index))


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
    x, w = gauss(NODES)
    p, share = np.sin(0.5 * pi * x)[:, None], np.cos(0.5 * pi * x)
    kept, _ = reflected(mu, a, p, np.sqrt(1.0 - p * p) * np.sin(0.5 * pi * x))
    return 1.0 - 0.25 * pi * float((w * share**2) @ kept @ (w * share))
