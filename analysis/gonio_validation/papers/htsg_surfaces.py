"""The surfaces of HTSG's figures, the cones that they are seen through, and what both say on a page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from gonio_validation.papers.figure import Parameter

if TYPE_CHECKING:
    from gonio.models import HeTorrance

PAPER = "He, Torrance, Sillion and Greenberg, A Comprehensive Physical Model for Light Reflection, SIGGRAPH 1991"
CONE_SR = math.pi / 1024
"""HTSG sec. 4: the solid angles of incident and received light in the experiments of Figs. 7 and 8."""


class Cones(TypedDict):
    """What lamp and lens subtend [sr], as `gonio.instrument` takes it."""

    source_solid_angle_sr: float
    receiver_solid_angle_sr: float


CONES: Cones = {"source_solid_angle_sr": CONE_SR, "receiver_solid_angle_sr": CONE_SR}


@dataclass(frozen=True)
class HtsgSurface:
    """A surface of He and Torrance's model."""

    sigma0_um: float
    tau_um: float
    ior: str | float
    """A material, or n."""
    diffuse_albedo: float = 0.0

    @property
    def model(self) -> HeTorrance:
        """Its BRDF."""
        from gonio.models import HeTorrance

        return HeTorrance(self.sigma0_um, self.tau_um, self.ior, self.diffuse_albedo)

    @property
    def parameters(self) -> Mapping[str, str | float]:
        """As a sample file has them; without a diffuse part where there is none."""
        return {name: value for name, value in vars(self).items() if name != "diffuse_albedo" or value}


def index_parameter(material: str, wavelength_nm: float) -> Parameter:
    """The optical constants that a figure is made with."""
    from gonio import materials

    found = materials.ior(material)
    n = complex(found(wavelength_nm))
    text = f"{n.real:.4g} + {n.imag:.4g}i" if n.imag else f"{n.real:.5g} (k = 0)"
    return Parameter(
        f"n + ik at {wavelength_nm:g} nm", text, "database", f"{material}: {found.source}; the paper gives none"
    )


def cones_parameter(reason: str = "") -> Parameter:
    """The solid angles of light and detector."""
    value = f"π/1024 sr = {CONE_SR:.5f} sr each"
    if reason:
        return Parameter("solid angles dω_i, dω_r", value, "assumed", reason)
    return Parameter("solid angles dω_i, dω_r", value, "paper", "sec. 4, with Fig. 7")


def energy_limit(model: Any, wavelength_nm: float) -> tuple[float | None, float]:
    """The incidence [deg] beyond which more is reflected than falls in (None: nowhere), and the largest possible a."""
    from scipy.optimize import brentq

    def excess(theta_deg: float) -> float:
        return float(model.directional_hemispherical(math.radians(theta_deg), wavelength_nm=wavelength_nm)) - 1.0

    allowed = float(model.max_diffuse_albedo(wavelength_nm=wavelength_nm))
    tried = np.append(np.arange(0.0, 90.0, 5.0), 89.99)
    above = np.flatnonzero([excess(float(t)) > 0 for t in tried])
    if not above.size or above[0] == 0:
        return (0.0 if above.size else None), allowed
    return float(brentq(excess, tried[above[0] - 1], tried[above[0]], xtol=1e-3)), allowed
