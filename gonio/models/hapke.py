"""Hapke's reflectance of particulate surfaces, with macroscopic roughness [Hapke1984, Hapke2002]."""

import math
from dataclasses import dataclass
from math import pi, sqrt
from typing import ClassVar

from gonio.models._compile import device
from gonio.models._math import HALF_PI, atan_over, exp, log
from gonio.models.arrays import GRAZING
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model
from gonio.models.parameters import parameter


@device
def several(x, w, gamma, newer):  # type: ignore[no-untyped-def]
    """H - 1: of 1981, or where `newer` is 1 that of 2002."""
    r0 = w / ((1.0 + gamma) * (1.0 + gamma))
    lit = w * x * (r0 + 0.5 * (1.0 - 2.0 * r0 * x) * log(1.0 + 1.0 / x)) if newer > 0.0 else 0.0
    return lit / (1.0 - lit) if newer > 0.0 else 2.0 * x * w / (1.0 + gamma) / (1.0 + 2.0 * x * gamma)


@device
def scattered(lx, ly, lz, vx, vy, vz, mu_i, mu_r, shade, p):  # type: ignore[no-untyped-def]
    """r/mu_0 with effective cosines, `shade` being S/(mu_0 mu_e)."""
    w, gamma, newer, per_h, b0, b, _, _ = p
    x, y, z = lx - vx, ly - vy, lz - vz
    apart = x * x + y * y + z * z
    x, y, z = lx + vx, ly + vy, lz + vz
    beside = x * x + y * y + z * z
    half = sqrt(apart / max(beside, 1e-30))  # tan(g/2)
    lobe = 1.0 - abs(b) + 0.5 * abs(b) * (apart if b < 0.0 else beside)  # 1 + b cos(g)
    one, other = several(mu_i, w, gamma, newer), several(mu_r, w, gamma, newer)
    braces = (1.0 + b0 / (1.0 + half * per_h)) * lobe + one + other + one * other
    return w / (4.0 * pi) * mu_i * mu_r / (mu_i + mu_r) * braces * shade


@device
def smooth(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """Without macroscopic roughness."""
    ci, cr = max(lz, GRAZING), max(vz, GRAZING)
    return scattered(lx, ly, lz, vx, vy, vz, ci, cr, 1.0 / (ci * cr), p)


@device
def alone(c, s, tan, chi):  # type: ignore[no-untyped-def]
    """Of one direction: E_1, E_2, and its effective cosine where nothing hides the other direction (eqs. 46 to 50)."""
    cot = c / max(s, 1e-30) / tan
    e1, e2 = exp(-2.0 / pi * cot), exp(-(cot * cot) / pi)
    return e1, e2, chi * (c + s * tan * e2 / (2.0 - e1))


@device
def rough(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """With effective cosines and a shadowing that exchanging both directions leaves as they are [Hapke1984]."""
    tan, chi = p[6], p[7]
    ci, cr = max(lz, GRAZING), max(vz, GRAZING)
    si, sr = sqrt(lx * lx + ly * ly), sqrt(vx * vx + vy * vy)
    along, across = lx * vx + ly * vy, abs(lx * vy - ly * vx)
    size = max(sqrt(along * along + across * across), 1e-300)
    beyond = along < 0.0  # more than a right angle of azimuth, psi
    t = across / (size + abs(along))  # tan of half of psi, or of half of pi - psi
    half_angle = t * atan_over(t * t)
    psi = 2.0 * (HALF_PI - half_angle if beyond else half_angle)
    turn = (1.0 if beyond else t * t) / (1.0 + t * t)  # sin^2(psi/2)
    f = exp(-2.0 / max(t, 1e-300)) if beyond else exp(-2.0 * t)
    c1, c2 = max(ci, cr), min(ci, cr)
    s1, s2 = (si, sr) if ci >= cr else (sr, si)
    a1, b1, n1 = alone(c1, s1, tan, chi)
    a2, b2, n2 = alone(c2, s2, tan, chi)
    down = 2.0 - a2 - psi / pi * a1
    m1 = chi * (c1 + s1 * tan * ((1.0 - 2.0 * turn) * b2 + turn * b1) / down)
    m2 = chi * (c2 + s2 * tan * (b2 - turn * b1) / down)
    shade = chi / (n1 * n2 * (1.0 - f + f * chi * c1 / n1))
    return scattered(lx, ly, lz, vx, vy, vz, m1, m2, shade, p)


@dataclass(frozen=True, repr=False)
class Hapke(Model):
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

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        gamma, tan = math.sqrt(1.0 - self.w), math.tan(math.radians(self.theta_bar_deg))
        chi = 1.0 / math.sqrt(1.0 + math.pi * tan * tan)
        newer = 1.0 if self.h_function == "2002" else 0.0
        constants = (self.w, gamma, newer, 1.0 / self.h, self.b0, self.b, tan, chi)
        return smooth if tan < 1e-9 else rough, constants
