"""Energy-preserving Oren-Nayar [Portsmouth2025]: Fujii's form, and the light that meets several facets."""

import math
from dataclasses import dataclass, replace
from math import pi, sqrt
from typing import ClassVar

import numpy as np

from gonio.models._compile import device, of_columns
from gonio.models._math import GRAZING, atan_over
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model
from gonio.models.parameters import ALBEDO, Declaration, Ior, parameter, plain
from gonio.typing import Floats

FULL = 0.5 - 2.0 / (3.0 * pi)
MEAN = 2.0 / 3.0 - 28.0 / (15.0 * pi)


@device
def albedo_lost(mu):  # type: ignore[no-untyped-def]
    """FULL - G(mu)/pi, of positive terms; the exact albedo is E = 1 - A r (FULL - G/pi)."""
    s = sqrt((1.0 - mu) * (1.0 + mu))
    part = 1.0 / (1.0 + s)
    elevation = mu * part
    elevation *= 2.0 * atan_over(elevation * elevation)
    low = mu * mu * part  # 1 - s
    return (low * (pi * FULL - s * mu * (s + 2.0) * part * (1.0 / 3.0)) + s * elevation) * (1.0 / pi)


@device
def angular_terms(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """1 + s/t of Fujii's form, and what the albedo lacks for both directions."""
    s = lx * vx + ly * vy
    x, y = lx + vx, ly + vy
    widest = max(max(lz, vz), GRAZING)
    more = 1.0 + s / widest if s > 0.0 else 0.5 * (x * x + y * y + lz * lz + vz * vz)
    return more, albedo_lost(min(lz, 1.0)), albedo_lost(min(vz, 1.0))


@of_columns(angular_terms, 3)
def eon(more, lost_l, lost_v, p):  # type: ignore[no-untyped-def]
    """Single and multiple scattering."""
    single, r, several = p
    value = single * (1.0 - r + r * more) + several * lost_l * lost_v
    return value if value < 1e60 else math.inf


@dataclass(frozen=True, repr=False)
class EON(Model):
    """Rough diffuse reflectance that loses no light: brdf = f_ss + f_ms [1/sr].

    f_ss = rho/pi A (1 + r s/t), A = 1/(1 + (1/2 - 2/(3 pi)) r), s = L.V - N.L N.V, t = max(N.L, N.V) where s > 0 and 1
    elsewhere. f_ms takes what f_ss loses, coloured by the number of its reflections, with the exact albedo of f_ss. At
    rho = 1 everything is reflected from every direction. Reciprocal. r = 0 is Lambert.
    """

    rho: float = parameter(
        0.5, "[0, 1]", "Albedo of a single reflection.", scale="linear", bounds=ALBEDO, starts="diffuse"
    )
    r: float = parameter(
        0.5,
        "[0, 1]",
        "Roughness: about the rms slope of Oren and Nayar up to pi/4.",
        scale="linear",
        starts=(0.1, 0.5, 0.9),
        geometry=True,
    )
    name: ClassVar[str] = "eon"
    rank: ClassVar[int] = 11
    assumes: ClassVar[str] = "facets that are large against the wavelength (Oren and Nayar 1994)"
    in_sums: ClassVar[str] = "base"

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        return replace(
            plain(cls.name, cls.fitted), base_starts=lambda albedo: [{"rho": albedo, "r": r} for r in (0.2, 0.8)]
        )

    @property
    def convention(self) -> str:
        return "Energy-preserving Oren-Nayar (Portsmouth et al. 2025), exact albedo; rho is that of one reflection."

    @property
    def _several(self) -> float:
        """rho_ms of the paper: the albedo of the light between facets."""
        mean = (1.0 + self.r * MEAN) / (1.0 + self.r * FULL)
        return self.rho**2 * mean / (1.0 - self.rho * (1.0 - mean))

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        a = 1.0 / (1.0 + FULL * self.r)
        return eon, (self.rho * a / pi, self.r, self._several / pi * a * self.r / (FULL - MEAN))

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """In closed form, the same for both sides, as the model is reciprocal."""
        s, mu = np.sin(theta), np.maximum(np.cos(theta), 0.0)
        low = mu * mu / (1.0 + s)
        lost = (low * (pi * FULL - s * mu * (s + 2.0) / (3.0 * (1.0 + s))) + s * (0.5 * pi - theta)) / pi
        e = 1.0 - self.r * lost / (1.0 + FULL * self.r)
        return np.asarray(self.rho * e + self._several * (1.0 - e))
