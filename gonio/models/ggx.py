"""GGX facets: Trowbridge-Reitz normals, height-correlated Smith shadowing [Walter2007, Heitz2014]."""

import math
from dataclasses import dataclass
from itertools import product
from math import pi, sqrt
from typing import Any, ClassVar

from gonio.models._compile import device, of_columns
from gonio.models._facets import by_cosines, facet, fresnel, fresnel_constants
from gonio.models._visible_facets import albedo
from gonio.models.declaration import DIFFUSE, Declaration, Ior, Levels, Values, optical
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model, store
from gonio.models.parameters import Fitted, checked_index, index_at, number
from gonio.typing import Floats

WIDTH = Fitted(1e-3, 1.0, "log", geometry=True)


@device
def lobe(slope2, sz, s2, lz, vz, lt2, vt2, own):  # type: ignore[no-untyped-def]
    """D G F/(4 N.L N.V) and the base; D's |s|^4/(pi a_x a_y (slope2 + s_z^2)^2), and lt2, vt2 of Smith's Lambda."""
    diffuse, scale, contrast, real, imag = own[0], own[1], own[2], own[3], own[4]
    root = slope2 + sz * sz
    f_up, f_down = fresnel(0.25 * s2, contrast, real, imag)
    smith = vz * sqrt(lz * lz + lt2) + lz * sqrt(vz * vz + vt2)
    value = diffuse + scale * (s2 * s2) * f_up / (root * root * f_down * smith)
    return value if value < 1e60 else math.inf


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

    Parameters
    ----------
    alpha
        Width a_x of the slopes, in [1e-4, 1]; an artist's roughness is its root.
    ior
        Index n + ik, [n, k], a material's name, or a function of wavelength_nm.
    diffuse_albedo
        Reflectance of the base, in [0, 1].
    alpha_y
        Width across x where it is another one; None: a_y = a_x.

    rho_dh is right to 1e-6. Raises `ArgumentError` for a parameter out of range, naming it.
    """

    alpha: float = 0.3
    ior: Any = 1.5
    diffuse_albedo: float = 0.0
    alpha_y: float | None = None
    name: ClassVar[str] = "ggx"
    rank: ClassVar[int] = 13
    in_sums: ClassVar[str] = "weighted gloss"
    has_ior: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        """See `Model.declaration`; `--free alpha_y` fits an anisotropic surface."""

        def starts(levels: Levels) -> list[Values]:
            grid = product((0.01, 0.05, 0.15, 0.3, 0.6), (1.3, 1.6, 3.0, 20.0), (0.1, 0.9))
            base = min(levels.diffuse, 1.0)
            return [{"alpha": a, "alpha_y": a, "ior": n, "diffuse_albedo": share * base} for a, n, share in grid]

        rows, flat = {"alpha": WIDTH, "diffuse_albedo": DIFFUSE, "alpha_y": WIDTH}, {"diffuse_albedo": 1.0 / pi}
        return optical(cls.name, rows, ior, starts, only_freed=("alpha_y",), flat=lambda v: flat)

    def __post_init__(self) -> None:
        store(self, alpha=number("alpha", self.alpha, 1e-4, 1.0), ior=checked_index(self.ior))
        store(self, diffuse_albedo=number("diffuse_albedo", self.diffuse_albedo, 0.0, 1.0))
        if self.alpha_y is not None:
            store(self, alpha_y=number("alpha_y", self.alpha_y, 1e-4, 1.0))

    @property
    def convention(self) -> str:
        return "GGX: Trowbridge-Reitz D of integral 1, height-correlated Smith, exact Fresnel; D G F/(4 N.L N.V)."

    @property
    def depends_on_azimuth(self) -> bool:
        return self.alpha_y not in (None, self.alpha)

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        a, b = self.alpha, self.alpha if self.alpha_y is None else self.alpha_y
        own = (self.diffuse_albedo / pi, 0.5 / (pi * a * b), *fresnel_constants(index_at(self.ior, wavelength_nm)))
        return (anisotropic, (*own, a * a, b * b)) if self.depends_on_azimuth else (isotropic, (*own, a * a))

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        if self.depends_on_azimuth:
            return super()._hemispherical(theta, phi, wavelength_nm, viewer, tolerance)
        return self.diffuse_albedo + albedo(theta, self.alpha, index_at(self.ior, wavelength_nm), tolerance)
