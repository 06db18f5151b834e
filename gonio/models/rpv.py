"""Rahman, Pinty and Verstraete's form of land surfaces [Rahman1993]."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from gonio.models.arrays import GRAZING, ArrayModel
from gonio.models.parameters import parameter
from gonio.typing import Floats


@dataclass(frozen=True, repr=False)
class RPV(ArrayModel):
    """A bowl, a lobe and a hot spot: brdf = rho_0/pi M F (1 + R) [1/sr].

    M = (mu_0 mu (mu_0 + mu))^(k - 1); F = (1 - q^2)/(1 + q^2 + 2 q cos g)^(3/2) with q = theta_g, g the angle between
    source and detector; 1 + R = 1 + (1 - rho_0)/(1 + G), G^2 = tan^2 + tan^2 - 2 tan tan cos(dphi). Reciprocal, not
    normalised, not bound in energy: infinite at grazing for k < 1.
    """

    rho_0: float = parameter(
        0.1, "[0, 1]", "Level. No albedo.", scale="log", bounds=(1e-4, 1.0), starts=(0.02, 0.1, 0.4)
    )
    theta_g: float = parameter(
        -0.1,
        "[-0.9999, 0.9999]",
        "Asymmetry of the lobe; below 0 light goes back.",
        scale="linear",
        bounds=(-0.95, 0.95),
        starts=(-0.3, 0.0, 0.3),
    )
    k: float = parameter(0.8, "[0, 3]", "Bowl (below 1) or bell (above).", scale="linear", starts=(0.6, 0.9, 1.2))
    name: ClassVar[str] = "rpv"
    rank: ClassVar[int] = 16

    @property
    def convention(self) -> str:
        return "Rahman, Pinty and Verstraete 1993: rho_0/pi M F (1 + R), not normalised; rho_c of the hot spot = rho_0."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        mu_i, mu_r = (np.maximum(x[:, 2], GRAZING) for x in (omega_i, omega_r))
        q = self.theta_g
        way = omega_i - omega_r if q < 0.0 else omega_i + omega_r
        square = (1.0 - abs(q)) ** 2 + abs(q) * np.sum(way * way, axis=1)  # 1 + q^2 + 2 q cos(g)
        lobe = (1.0 - abs(q)) * (1.0 + abs(q)) / square**1.5
        apart = np.hypot(*(omega_i[:, :2] / mu_i[:, None] - omega_r[:, :2] / mu_r[:, None]).T)  # G
        bowl = (mu_i * mu_r * (mu_i + mu_r)) ** (self.k - 1.0)
        return np.asarray(self.rho_0 / math.pi * bowl * lobe * (1.0 + (1.0 - self.rho_0) / (1.0 + apart)))
