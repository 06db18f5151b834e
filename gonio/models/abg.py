"""ABg: scatter of polished optics as stray-light programs take it [Pfisterer2011]."""

import math
from dataclasses import dataclass
from typing import ClassVar

from gonio.models._compile import device, of_columns
from gonio.models._math import _LOG2_E, exp2, log
from gonio.models.engine import Constants, Kernel
from gonio.models.model import Model
from gonio.models.parameters import parameter


@device
def off_mirror(lx, ly, lz, vx, vy, vz):  # type: ignore[no-untyped-def]
    """ln |beta - beta_0|^2: beta the direction's projection on the surface, beta_0 that of the mirror direction."""
    x, y = lx + vx, ly + vy
    square = x * x + y * y
    return log(max(square, 1e-300)), lz


@of_columns(off_mirror, 2, single_range=(math.inf, 0.0))
def abg(log_square, lz, p):  # type: ignore[no-untyped-def]
    """A / (B + |beta - beta_0|^g)."""
    a, b, half_g = p
    return a / (b + exp2(_LOG2_E * half_g * log_square))


@dataclass(frozen=True, repr=False)
class ABg(Model):
    """A lobe about the mirror direction: brdf = A / (B + |beta - beta_0|^g) [1/sr].

    beta and beta_0 are the projections on the surface of the unit vectors of the detector's and the mirror direction.
    Reciprocal. Not bound in energy: A above some (2 - g)/(2 pi) reflects more than falls in, which every command that
    uses the model says. The specular beam itself is not in it.
    """

    A: float = parameter(
        1e-3,
        "[0, inf)",
        "Level far from the mirror direction [1/sr].",
        scale="log",
        bounds=(1e-12, 1e4),
        starts=(1e-4, 1e-2, 0.3),
    )
    B: float = parameter(
        1e-3,
        "(0, inf)",
        "Where the lobe bends: A/B is the peak, and B^(1/g) the half width in |beta - beta_0|.",
        scale="log",
        bounds=(1e-12, 1e3),
        starts=(1e-5, 1e-3, 0.1),
    )
    g: float = parameter(
        1.5,
        "[0, 20]",
        "Slope; 0 is Lambertian with A/(B + 1).",
        scale="linear",
        bounds=(0.0, 6.0),
        starts=(1.0, 2.0, 3.0),
    )
    name: ClassVar[str] = "abg"
    rank: ClassVar[int] = 12

    @property
    def convention(self) -> str:
        return "ABg (Harvey-Shack fits of stray light): A/(B + |beta - beta_0|^g), not normalised; no specular beam."

    def _evaluation(self, wavelength_nm: float) -> tuple[Kernel, Constants]:
        return abg, (self.A, self.B, 0.5 * self.g)
