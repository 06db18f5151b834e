"""Lambert's law: the perfect diffuser, and the one that lets light through: the simplest sample with two sides."""

from dataclasses import dataclass, replace
from math import pi
from typing import Any, ClassVar

import numpy as np

from gonio.errors import ArgumentError
from gonio.models._compile import device
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model
from gonio.models.parameters import ALBEDO, Declaration, Ior, parameter, plain
from gonio.typing import Floats


@device
def lambert(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """The constant BRDF."""
    (brdf,) = p
    return brdf


@dataclass(frozen=True, repr=False)
class Lambert(Model):
    """A perfect diffuser: brdf = albedo / pi [1/sr]."""

    albedo: float = parameter(0.5, "[0, 1]", "Directional-hemispherical reflectance.", scale="linear", bounds=ALBEDO)
    name: ClassVar[str] = "lambert"
    rank: ClassVar[int] = 1
    in_sums: ClassVar[str] = "base"

    @classmethod
    def declaration(cls, ior: Ior = None, slopes: int = 1) -> Declaration:
        return replace(
            plain(cls.name, cls.fitted),
            starts=lambda levels: [{"albedo": cls.fitted["albedo"].inside(levels.median)}],
            flat=lambda v: {"albedo": 1.0 / pi},
        )

    @property
    def convention(self) -> str:
        return "Lambert: brdf = albedo / pi."

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        return lambert, (self.albedo / pi,)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        return np.full(theta.size, self.albedo)


@dataclass(frozen=True, repr=False)
class DiffuseTransmitter(Model):
    """A perfect diffuser on both sides: brdf = reflectance / pi, btdf = transmittance / pi [1/sr].

    Thin (light leaves where it fell), without regular transmission, and alike from every direction.
    The two shares are together at most 1.
    """

    reflectance: float = parameter(0.5, "[0, 1]", "Share of the incident light that comes back.")
    transmittance: float = parameter(0.4, "[0, 1]", "Share of the incident light that goes through.")
    name: ClassVar[str] = "diffuse-transmitter"

    def __post_init__(self, *_: Any) -> None:
        super().__post_init__()
        if self.reflectance + self.transmittance > 1.0 + 1e-12:  # rounding of a sum of decimals
            both = self.reflectance + self.transmittance
            raise ArgumentError(f"reflectance + transmittance = {both:g}: together they are at most 1")

    @property
    def convention(self) -> str:
        return "Lambert on both sides: brdf = reflectance / pi, btdf = transmittance / pi."

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        return lambert, (self.reflectance / pi,)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        return np.full(theta.size, self.reflectance)

    def _transmitted(self, theta_i: Floats, theta_r: Floats) -> Floats:
        return np.full(np.broadcast_shapes(theta_i.shape, theta_r.shape), self.transmittance / pi)
