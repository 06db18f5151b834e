"""A white diffuser that lets light through: the simplest sample with two sides."""

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import numpy as np

from gonio.errors import ArgumentError
from gonio.models.engine import Constants, Kernel
from gonio.models.lambert import lambert
from gonio.models.model import Model, store
from gonio.models.parameters import number
from gonio.typing import Floats


@dataclass(frozen=True, repr=False)
class DiffuseTransmitter(Model):
    """A perfect diffuser on both sides: brdf = reflectance / pi, btdf = transmittance / pi [1/sr].

    Thin (light leaves where it fell), without regular transmission, and alike from every direction.

    Parameters
    ----------
    reflectance, transmittance
        Shares of the incident light, each in [0, 1]; together at most 1.

    Raises
    ------
    ArgumentError
        One is outside its range, or both together exceed 1.
    """

    reflectance: float = 0.5
    transmittance: float = 0.4
    name: ClassVar[str] = "diffuse-transmitter"

    def __post_init__(self) -> None:
        for field in ("reflectance", "transmittance"):
            store(self, **{field: number(field, getattr(self, field), 0.0, 1.0)})
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
