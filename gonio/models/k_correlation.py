"""Scatter of nearly smooth surfaces: the vector perturbation theory with an ABC spectrum [Church1979, Stover2012]."""

import math
from dataclasses import dataclass
from math import sqrt
from typing import Any, ClassVar

import numpy as np

from gonio.geometry import PARALLEL, Directions
from gonio.models._compile import device
from gonio.models._facets import index_constants
from gonio.models._math import _LOG2_E, exp2, log
from gonio.models.engine import Constants, Kernel
from gonio.models.fresnel import reflectance
from gonio.models.model import Model
from gonio.models.parameters import INDEX, Declaration, Ior, Levels, Values, index_at, optical, parameter, plain
from gonio.typing import Floats, NDArray

ROUGH = 0.1
"""Total integrated scatter above which the first order of the smooth-surface theory does not do."""


@device
def root_parts(z2, epsilon, loss):  # type: ignore[no-untyped-def]
    """Real and imaginary part of sqrt(epsilon + i loss - sin^2) at cos^2 = z2, with loss at least 0."""
    real = epsilon - 1.0 + z2
    size = sqrt(real * real + loss * loss)
    larger = sqrt(0.5 * (size + abs(real)))
    smaller = 0.5 * loss / max(larger, 1e-300)
    return (larger, smaller) if real >= 0.0 else (smaller, larger)


@device
def square(x, y):  # type: ignore[no-untyped-def]
    """|x + iy|^2."""
    return x * x + y * y


@device
def first_order(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """cos_i cos_r times the spectrum times the sum of the four amplitudes' squares (`_amplitudes`), as `p` weighs them.

    Each is over |s|^2 or |p|^2 of both directions; all four are brought to one denominator.
    """
    level, per_um2, half_slope, epsilon, loss, beyond = p
    si2, sr2, along, across = lx * lx + ly * ly, vx * vx + vy * vy, lx * vx + ly * vy, lx * vy - ly * vx
    any_azimuth = min(si2, sr2) < beyond
    flat2 = max(si2 * sr2, 1e-300)
    flat = sqrt(flat2)
    cos_p = 1.0 if any_azimuth else -along / flat
    sin2_p = 0.0 if any_azimuth else across * across / flat2
    a, b = root_parts(lz * lz, epsilon, loss)
    c, d = root_parts(vz * vz, epsilon, loss)
    s_i, s_r = square(lz + a, b), square(vz + c, d)
    p_i, p_r = square(epsilon * lz + a, loss * lz + b), square(epsilon * vz + c, loss * vz + d)
    both = sqrt(si2) * sqrt(sr2)
    pp = square((a * c - b * d) * cos_p - epsilon * both, (a * d + b * c) * cos_p - loss * both)
    mixed = sin2_p * (square(c, d) * p_i * s_r + square(a, b) * s_i * p_r)
    amplitudes = (cos_p * cos_p * p_i * p_r + mixed + pp * s_i * s_r) / (s_i * s_r) / (p_i * p_r)
    spectrum = exp2(half_slope * _LOG2_E * log(1.0 + per_um2 * square(lx + vx, ly + vy)))
    return level * lz * vz * spectrum * amplitudes


@dataclass(frozen=True, repr=False)
class KCorrelation(Model):
    """First-order scatter of a polished surface [1/sr]: (16 pi^2/lambda^4) cos_i cos_r Q S, beside its specular beam.

    S = sigma^2 (c - 1) B^2/(2 pi) / (1 + (B f)^2)^((c + 1)/2) [um^4] of the spatial frequency f, of integral sigma^2.
    Right where 4 pi sigma cos(theta)/lambda is far below 1; scales with the wavelength by itself. Reciprocal. Energy is
    right to first order: the beam keeps R exp(-(4 pi sigma_rel cos/lambda)^2).
    """

    sigma_um: float = parameter(
        0.005,
        "(0, inf)",
        "rms roughness over all spatial frequencies.",
        "um",
        scale="log",
        bounds=(1e-5, 1.0),
        starts=(0.002, 0.02, 0.1),
        geometry=True,
    )
    b_um: float = parameter(
        50.0,
        "(0, inf)",
        "B: 2 pi times the length beyond which the surface is white.",
        "um",
        scale="log",
        bounds=(0.01, 1e4),
        starts=(1.0, 10.0, 200.0),
        geometry=True,
    )
    c: float = parameter(
        2.0,
        "[1.000001, 10]",
        "Slope of the spectrum at high frequencies.",
        scale="linear",
        bounds=(1.01, 10.0),
        starts=(1.5, 2.5),
        geometry=True,
    )
    ior: Any = parameter("Al", *INDEX)
    name: ClassVar[str] = "k-correlation"
    rank: ClassVar[int] = 15
    needs_wavelength: ClassVar[bool] = True
    has_ior: ClassVar[bool] = True

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:

        def starts(levels: Levels) -> list[Values]:
            shape = plain(cls.name, cls.fitted, True).starts(levels)
            return [{**values, "ior": n} for values in shape for n in (1.5, 20.0)]

        return optical(cls.name, cls.fitted, ior, starts, needs_wavelength=True)

    def outside(self, wavelength_nm: float) -> str:
        """Whether the surface is too rough for the first order: (4 pi sigma_rel/lambda)^2 has to be far below 1.

        The next order is half of the square of that [Stover2012]: beyond `ROUGH` it is 5 % of the scatter.
        """
        if (scatter := self.tis(wavelength_nm)) <= ROUGH:
            return ""
        return (
            f"its surface has to be smooth: (4 pi sigma_rel/lambda)^2 = {scatter:.2g} has to be small against 1 (Stover"
            " 2012)"
        )

    @property
    def convention(self) -> str:
        return "ABC spectrum through the smooth-surface vector theory; sigma over all spatial frequencies, c > 1."

    def sigma_rel_um(self, wavelength_nm: float) -> float:
        """rms roughness [um] of the spatial frequencies up to 1/wavelength: what scatters at normal incidence."""
        edge = (self.b_um * 1e3 / wavelength_nm) ** 2
        return self.sigma_um * math.sqrt(-math.expm1(0.5 * (1.0 - self.c) * math.log1p(edge)))

    def tis(self, wavelength_nm: float) -> float:
        """Total integrated scatter at normal incidence over all that is reflected: (4 pi sigma_rel/lambda)^2."""
        return (4.0 * math.pi * self.sigma_rel_um(wavelength_nm) * 1e3 / wavelength_nm) ** 2

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        um, index = 1e-3 * wavelength_nm, index_at(self.ior, wavelength_nm)
        contrast, epsilon, loss = index_constants(index.real, index.imag)
        level = 4.0 * math.pi / um**4 * self.sigma_um**2 * (self.c - 1.0) * self.b_um**2 * contrast
        slope = -0.5 * (self.c + 1.0)
        constants = (level, (self.b_um / um) ** 2, slope, epsilon + 1.0, 2.0 * loss, PARALLEL**2)
        return first_order, constants

    def jones_at(self, at: Directions, wavelength_nm: float) -> NDArray[np.complex128]:
        """Signs of mixed elements are those of facets, which the first order is near the mirror direction."""
        theta_i, theta_r = (np.maximum(theta, PARALLEL) for theta in (at.theta_i, at.theta_r))  # azimuths count
        ss, sp, ps, pp = self._amplitudes(*Directions(theta_i, at.phi_i, theta_r, at.phi_r).vectors, wavelength_nm)
        return np.moveaxis(np.array([[ss, -ps], [-sp, -pp]]), (0, 1), (-2, -1))

    def _amplitudes(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> NDArray[np.complex128]:
        """The complex amplitudes (4, n) of ss, sp, ps and pp, the first letter that of the source."""
        epsilon = index_at(self.ior, wavelength_nm) ** 2
        ci, cr = omega_i[:, 2], omega_r[:, 2]
        si, sr = (np.hypot(x[:, 0], x[:, 1]) for x in (omega_i, omega_r))
        flat = np.maximum(si * sr, 1e-300)
        beyond = (si < PARALLEL) | (sr < PARALLEL)  # at the normal any azimuth is the plane's
        cos_p = np.where(beyond, 1.0, -np.sum(omega_i[:, :2] * omega_r[:, :2], axis=1) / flat)
        sin_p = np.where(beyond, 0.0, (omega_i[:, 0] * omega_r[:, 1] - omega_i[:, 1] * omega_r[:, 0]) / flat)
        root_i, root_r = np.sqrt(epsilon - si * si + 0j), np.sqrt(epsilon - sr * sr + 0j)
        s_i, s_r, p_i, p_r = ci + root_i, cr + root_r, epsilon * ci + root_i, epsilon * cr + root_r
        q = np.stack([
            cos_p / (s_i * s_r), sin_p * root_r / (s_i * p_r), sin_p * root_i / (p_i * s_r),
            (root_i * root_r * cos_p - epsilon * si * sr) / (p_i * p_r),
        ])  # fmt: skip
        return (epsilon - 1.0) * q

    def _spike(self, theta: Floats, wavelength_nm: float) -> Floats:
        g = (4.0 * math.pi * self.sigma_rel_um(wavelength_nm) * 1e3 / wavelength_nm * np.cos(theta)) ** 2
        return np.asarray(reflectance(np.cos(theta), index_at(self.ior, wavelength_nm)) * np.exp(-g))
