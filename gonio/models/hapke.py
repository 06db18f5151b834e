"""Hapke's reflectance of particulate surfaces, with macroscopic roughness [Hapke1984, Hapke2002]."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gonio.models.arrays import GRAZING, ArrayModel
from gonio.models.parameters import parameter
from gonio.typing import Floats


@dataclass(frozen=True, repr=False)
class Hapke(ArrayModel):
    """Single scattering with its opposition effect and isotropic multiple scattering: brdf = r / mu_0 [1/sr].

    r = w/(4 pi) mu_0/(mu_0 + mu) ((1 + B(g)) P(g) + H(mu_0) H(mu) - 1) S, with B = b0 / (1 + tan(g/2)/h) and P = 1 + b
    cos(g); g is the angle between source and detector. Roughness changes mu_0 and mu into effective cosines and
    multiplies by the shadowing S (Hapke 1984). Reciprocal. Bound in energy for b0 = 0; b0 > 0 adds to it near grazing.
    """

    w: float = parameter(
        0.6, "[0, 1]", "Single-scattering albedo.", scale="linear", bounds=(1e-3, 1.0), starts=(0.2, 0.6, 0.95)
    )
    h: float = parameter(
        0.06,
        "(0, inf)",
        "Angular width of the opposition effect.",
        scale="log",
        bounds=(1e-3, 2.0),
        starts=(0.03, 0.3),
    )
    b0: float = parameter(1.0, "[0, 1]", "Size of the opposition effect.", scale="linear", starts=(0.5,))
    b: float = parameter(
        0.5,
        "[-1, 1]",
        "First Legendre coefficient of the phase function; above 0 light goes back.",
        scale="linear",
        starts=(-0.3, 0.3),
    )
    theta_bar_deg: float = parameter(
        0.0, "[0, 60]", "Mean slope of the macroscopic roughness.", "deg", scale="linear", starts=(5.0, 25.0)
    )
    h_function: str = parameter(
        "1981", ("1981", "2002"), '"1981": (1 + 2x)/(1 + 2x sqrt(1 - w)); "2002": Hapke\'s better approximation.'
    )
    name: ClassVar[str] = "hapke"
    rank: ClassVar[int] = 17
    assumes: ClassVar[str] = "particles that are large against the wavelength (Hapke 1984)"

    @property
    def convention(self) -> str:
        return f"Hapke's r/mu_0 with H of {self.h_function}, P = 1 + b cos g, and roughness by Hapke 1984."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        cos_i, cos_r = (np.maximum(x[:, 2], GRAZING) for x in (omega_i, omega_r))
        apart, beside = (np.sum(v * v, axis=1) for v in (omega_i - omega_r, omega_i + omega_r))
        half = np.sqrt(apart / np.maximum(beside, 1e-30))  # tan(g/2)
        mu_i, mu_r, shade = self._rough(cos_i, cos_r, omega_i, omega_r)
        lobe = 1.0 - abs(self.b) + 0.5 * abs(self.b) * (apart if self.b < 0.0 else beside)  # 1 + b cos(g)
        one, other = self._several(mu_i), self._several(mu_r)
        braces = (1.0 + self.b0 / (1.0 + half / self.h)) * lobe + one + other + one * other
        return np.asarray(self.w / (4.0 * math.pi) * mu_i * mu_r / (mu_i + mu_r) * braces * shade)

    def _several(self, x: Floats) -> Floats:
        """H - 1."""
        gamma = math.sqrt(1.0 - self.w)
        r0 = self.w / (1.0 + gamma) ** 2
        if self.h_function == "1981":
            return np.asarray(2.0 * x * self.w / (1.0 + gamma) / (1.0 + 2.0 * x * gamma))
        lit = self.w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * np.log1p(1.0 / x))
        return np.asarray(lit / (1.0 - lit))

    def _rough(self, ci: Floats, cr: Floats, omega_i: Floats, omega_r: Floats) -> tuple[Floats, Floats, Floats]:
        """Effective cosines, and S/(mu_0 mu_e), which exchanging both directions leaves as it is (eqs. 46 to 50)."""
        tan = math.tan(math.radians(self.theta_bar_deg))
        if tan < 1e-9:
            return ci, cr, 1.0 / (ci * cr)
        chi = 1.0 / math.sqrt(1.0 + math.pi * tan * tan)
        (x, y, _), (u, v, _) = omega_i.T, omega_r.T
        psi, si, sr = np.abs(np.arctan2(x * v - y * u, x * u + y * v)), np.hypot(x, y), np.hypot(u, v)
        source = ci >= cr  # which of both has the smaller angle
        c1, c2 = np.where(source, ci, cr), np.where(source, cr, ci)
        s1, s2 = np.where(source, si, sr), np.where(source, sr, si)
        cot1, cot2 = (c / np.maximum(s, 1e-30) / tan for c, s in ((c1, s1), (c2, s2)))
        a1, a2 = np.exp(-2.0 / math.pi * cot1), np.exp(-2.0 / math.pi * cot2)  # E_1
        b1, b2 = np.exp(-(cot1**2) / math.pi), np.exp(-(cot2**2) / math.pi)  # E_2
        turn, down = np.sin(0.5 * psi) ** 2, 2.0 - a2 - psi / math.pi * a1
        m1 = chi * (c1 + s1 * tan * (np.cos(psi) * b2 + turn * b1) / down)
        m2 = chi * (c2 + s2 * tan * (b2 - turn * b1) / down)
        n1, n2 = (chi * (c + s * tan * b / (2.0 - a)) for c, s, a, b in ((c1, s1, a1, b1), (c2, s2, a2, b2)))
        f = np.exp(-2.0 * np.tan(0.5 * psi))
        shade = chi / (n1 * n2 * (1.0 - f + f * chi * c1 / n1))
        return np.where(source, m1, m2), np.where(source, m2, m1), shade
