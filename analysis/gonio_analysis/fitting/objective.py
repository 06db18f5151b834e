"""What a fit makes small: residuals, whitened by the data's uncertainties or, without any, of logarithms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.value_covariance import Covariance, independent

LOSSES: dict[str, tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]] = {
    "linear": (lambda z2: z2, np.ones_like),
    "soft_l1": (lambda z2: 2.0 * (np.sqrt(1.0 + z2) - 1.0), lambda z2: (1.0 + z2) ** -0.25),
    "huber": (lambda z2: np.where(z2 <= 1.0, z2, 2.0 * np.sqrt(z2) - 1.0), lambda z2: np.maximum(z2, 1.0) ** -0.25),
    "cauchy": (np.log1p, lambda z2: (1.0 + z2) ** -0.5),
    "arctan": (np.arctan, lambda z2: (1.0 + z2**2) ** -0.5),
}
"""Name -> the loss of a squared residual, and the root of its derivative."""
LINEAR_BELOW = 0.05
"""Without uncertainties: the fraction of the median |f| below which differences count as such, not as ratios."""


@dataclass(frozen=True)
class Objective:
    """Whitened residuals; without stated uncertainties, residuals of asinh(f / 2 e), which is ln(f / e) above e.

    A relative residual (F - f)/f would cost a model that is far too low at most 1 and one that is far too high
    without limit, and so fit too low; a difference of logarithms costs both alike.
    """

    measured: Floats
    weights: Covariance | None
    small: float = 1.0
    """e [1/sr]."""
    loss: str = "linear"
    """How large residuals count: a name of `scipy.optimize.least_squares`."""

    def residual(self, predicted: Floats) -> Floats:
        """Of a prediction (n,) [1/sr]; its sum of squares is what a fit minimises."""
        if self.weights is not None:
            return self.weights.whiten(predicted - self.measured)
        return np.asarray(np.arcsinh(predicted / (2 * self.small)) - np.arcsinh(self.measured / (2 * self.small)))

    def jacobian(self, predicted: Floats, columns: Floats) -> Floats:
        """Derivatives of `residual`, from those of the prediction (n, p)."""
        if self.weights is not None:
            return self.weights.whiten(columns)
        return np.asarray(columns / np.hypot(predicted, 2 * self.small)[:, None])

    def total(self, residual: Floats) -> float:
        """The sum of the losses of whitened residuals; the sum of squares, unless the loss is a robust one."""
        return float(LOSSES[self.loss][0](residual**2).sum())

    def robust_weights(self, residual: Floats) -> Floats:
        """sqrt(d loss / d z^2) at whitened residuals z: what rows of a linearised problem are multiplied by."""
        return np.asarray(LOSSES[self.loss][1](residual**2))

    @property
    def words(self) -> str:
        """For reports."""
        robust = "" if self.loss == "linear" else f"; large residuals count by the loss {self.loss}"
        if self.weights is None:
            return f"logarithmic: every value alike, as ln f above {self.small:.2g} 1/sr and as f below{robust}"
        causes = ", ".join(self.weights.causes)
        return "the table's covariance" + (f", with the common causes {causes}" if causes else "") + robust


def objective(data: Observations) -> Objective:
    """With the table's whole covariance, or logarithmic where it states none."""
    if data.covariance is not None:
        return Objective(data.brdf, data.covariance)
    small = LINEAR_BELOW * float(np.median(np.abs(data.brdf)))
    return Objective(data.brdf, None, max(small, 1e-300))


def alone(data: Observations) -> Objective:
    """With the independent part of the covariance only."""
    if data.covariance is None:
        return objective(data)
    return Objective(data.brdf, independent(data.covariance.random))


def scaled_to(data: Observations, predicted: Floats) -> Objective:
    """With the whole covariance, its common causes scaled from the measured values to a model's.

    See `Covariance.scaled`; the ratio is used where a value is above 3 u, and held between 1/2 and 2.
    """
    if data.covariance is None or not data.covariance.causes:
        return objective(data)
    seen = data.brdf > 3 * data.u
    ratio = np.where(seen, predicted / np.where(seen, data.brdf, 1.0), 1.0)
    return Objective(data.brdf, data.covariance.scaled(np.clip(ratio, 0.5, 2.0)))


def softened(data: Observations, relative: float) -> Objective:
    """With `relative` f added to every uncertainty, so that a steep flank does not hide the right valley."""
    if data.covariance is None:
        return objective(data)
    return Objective(data.brdf, independent(np.hypot(data.u, relative * np.abs(data.brdf))))
