"""What a fit makes small, and how far a model is from a measurement.

A fit makes residuals small, whitened by the data's uncertainties, of logarithms, or by another metric.

Of a model that the data reject they are residuals of logarithms, whitened by the stated covariance and the model's own
misfit (docs/misfit.md).

Several numbers say how far a model is from a measurement, because no single one is fair to spikes and to tails.

With f the measured and F the model's BRDF [1/sr] in the same directions:

- `weighted`: root mean square of the whitened residuals (1 is perfect agreement with the stated uncertainties);
- `log_ratio`: root mean square of ln(F / f): 0.1 is a typical disagreement of 10 %;
- `log_cosine`: root mean square of ln(1 + F cos theta_i) - ln(1 + f cos theta_i);
- `ngan`: root mean square of (F - f) cos theta_i [1/sr] (Ngan, Durand and Matusik 2005);
- `cube_root`: root mean square of the difference of the cube roots of F cos theta_i and f cos theta_i;
- `relative`: root mean square of (F - f) / f, of the values that the logarithmic ones use.

The directions are the measured ones, each counted once: no sample has been resampled to a uniform grid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from gonio.errors import ConfigError
from gonio.typing import Floats
from gonio_analysis.fitting.observations import LINEAR_BELOW, Observations
from gonio_analysis.fitting.value_covariance import Covariance, independent

BELOW = 3.0
"""Logarithmic metrics leave out values below this many standard uncertainties."""

DESCRIPTIONS = {
    "weighted": ("residual / u", "rms of (model - measured) / u, correlations taken out; 1 agrees with the stated u"),
    "log_ratio": ("log ratio", "rms of ln(model / measured), values above 3 u; 0.1 is a typical disagreement of 10 %"),
    "log_cosine": ("log(1 + f cos)", "rms of the difference of ln(1 + f cos θi), values above 3 u"),
    "ngan": (
        "cosine-weighted difference",
        "rms of (model - measured) cos θi, in 1/sr, after Ngan et al. 2005: governed by the highest values",
    ),
    "cube_root": ("cube-root difference", "rms of the difference of (f cos θi)^(1/3)"),
    "relative": (
        "relative difference",
        "rms of (model - measured) / measured, values above 3 u: costs too low a model less",
    ),
}
"""Name -> short label, and what it is."""


def meaning(name: str, *, known: bool) -> str:
    """What a metric is; of values whose uncertainty is not known all that are above 0 take part."""
    words = DESCRIPTIONS[name][1]
    return words if known else words.replace(f"above {BELOW:g} u", "above 0")


def metrics(
    model: Floats, measured: Floats, cos_theta_i: Floats, u: Floats | None = None, whitened: Floats | None = None
) -> dict[str, float | None]:
    """All metrics of one model on one set of directions.

    Parameters
    ----------
    model, measured : (n,) arrays [1/sr]
    cos_theta_i : (n,) array
    u : (n,) array [1/sr], optional
        Combined standard uncertainties; without them every positive value counts in the logarithmic metrics.
    whitened : (n,) array, optional
        Whitened residuals; without them `weighted` is None.

    Returns
    -------
    dict
        The metrics by name, and `n_log`, the number of values that the logarithmic ones use.
    """
    above = measured > (BELOW * u if u is not None else 0.0)
    logs = above & (model > 0)
    out: dict[str, float | None] = {
        "weighted": None if whitened is None else _rms(whitened),
        "log_ratio": _rms(np.log(model[logs] / measured[logs])) if logs.any() else None,
        "log_cosine": _rms(np.log1p(model[logs] * cos_theta_i[logs]) - np.log1p(measured[logs] * cos_theta_i[logs]))
        if logs.any()
        else None,
        "ngan": _rms((model - measured) * cos_theta_i),
        "cube_root": _rms(np.cbrt(model * cos_theta_i) - np.cbrt(measured * cos_theta_i)),
        "relative": _rms(model[above] / measured[above] - 1.0) if above.any() else None,
        "n_log": float(np.count_nonzero(logs)),
    }
    return out


def _rms(x: Floats) -> float:
    return float(np.sqrt(np.mean(x**2)))


LOSSES: dict[str, tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]] = {
    "linear": (lambda z2: z2, np.ones_like),
    "soft_l1": (lambda z2: 2.0 * (np.sqrt(1.0 + z2) - 1.0), lambda z2: (1.0 + z2) ** -0.25),
    "huber": (lambda z2: np.where(z2 <= 1.0, z2, 2.0 * np.sqrt(z2) - 1.0), lambda z2: np.maximum(z2, 1.0) ** -0.25),
    "cauchy": (np.log1p, lambda z2: (1.0 + z2) ** -0.5),
    "arctan": (np.arctan, lambda z2: (1.0 + z2**2) ** -0.5),
}
"""Name -> the loss of a squared residual, and the root of its derivative."""
PSI_STEP = 1e-4
"""Half of the step over which the slope of psi is taken, in residuals: far below the width of every loss, 1."""
LEAST_SLOPE = 0.1
"""Least mean slope of psi, in mean weights: 0.40 to 0.75 of normal residuals. It may be below 0 where most residuals
are outliers; the covariance of such a fit says nothing."""


METRICS = {
    "weighted": "differences in units of their uncertainty, correlations taken out",
    "log": "logarithmic",
    "ngan": "differences times cos theta_i, after Ngan et al. 2005",
    "cube-root": "differences of the cube roots of f cos theta_i",
    "relative": "differences relative to the measured value",
}
"""Name, as of `--metric` -> what a fit by it makes small."""


@dataclass(frozen=True)
class Objective:
    """Residuals by one of `METRICS`.

    Those of "log" are differences of asinh(f / 2 e), which is ln(f / e) above e. A relative residual (F - f)/f would
    cost a model that is far too low at most 1 and one that is far too high without limit, and so fit too low; a
    difference of logarithms costs both alike.
    """

    measured: Floats
    weights: Covariance | None
    """Weights of the residuals of "weighted" [1/sr], or of "log"; None where residuals count as they are."""
    small: float = 1.0
    """e [1/sr]."""
    loss: str = "linear"
    """How large residuals count: a name of `scipy.optimize.least_squares`."""
    metric: str = "log"
    cosine: Floats | None = None
    """cos theta_i (n,)."""
    tau: float = 0.0
    """The model's own misfit on the scale of "log", which `weights` hold."""
    assumed: float | None = None
    """The relative uncertainty that is assumed, for `words`."""

    @property
    def whitened(self) -> bool:
        """Whether residuals are in units of an uncertainty, so that their sum of squares is a chi-square."""
        return self.weights is not None

    def take(self, rows: npt.NDArray[np.intp] | npt.NDArray[np.bool_]) -> Objective:
        """That of some of the values."""
        weights = None if self.weights is None else self.weights.take(rows)
        cosine = None if self.cosine is None else self.cosine[rows]
        return replace(self, measured=self.measured[rows], weights=weights, cosine=cosine)

    def residual(self, predicted: Floats) -> Floats:
        """Residuals of a prediction [1/sr], shape (n,), or of several, (m, n); a fit minimises their sum of squares."""
        if self.metric in ("weighted", "ngan", "relative"):
            return self._white((predicted - self.measured) * self._factor)
        return self._white((self.scaled(predicted) - self.scaled(self.measured)) * self._factor)

    def slopes(self, predicted: Floats, change: Floats) -> Floats:
        """Changes of `residual` with a change of the prediction, both of one shape."""
        if self.metric == "log":
            return self._white(change / np.hypot(predicted, 2 * self.small))
        if self.metric == "cube-root":  # held where the root is vertical
            root = np.cbrt(np.maximum(np.abs(predicted), 1e-3 * self.small))
            return self._white(change * self._factor / (3.0 * root**2))
        return self._white(change * self._factor)

    def jacobian(self, predicted: Floats, columns: Floats) -> Floats:
        """Derivatives of `residual`, from those of the prediction (n, p)."""
        return self.slopes(predicted, columns.T).T

    def _white(self, plain: Floats) -> Floats:
        return np.asarray(plain if self.weights is None else self.weights.whiten(plain.T).T)

    def scaled(self, f: Floats) -> Floats:
        """f [1/sr] on the scale of "log" or "cube-root"."""
        return np.asarray(np.cbrt(f) if self.metric == "cube-root" else np.arcsinh(f / (2 * self.small)))

    @property
    def _factor(self) -> Floats | float:
        """What differences are multiplied by."""
        if self.metric == "relative":
            return np.asarray(1.0 / np.maximum(np.abs(self.measured), 2 * self.small))
        if self.metric in ("log", "weighted") or self.cosine is None:
            return 1.0
        return np.asarray(np.cbrt(self.cosine)) if self.metric == "cube-root" else self.cosine

    def total(self, residual: Floats) -> float:
        """The sum of the losses of whitened residuals; the sum of squares, unless the loss is a robust one."""
        return float(LOSSES[self.loss][0](residual**2).sum())

    def robust_weights(self, residual: Floats) -> Floats:
        """sqrt(d loss / d z^2) at whitened residuals z: what rows of a linearised problem are multiplied by."""
        return np.asarray(LOSSES[self.loss][1](residual**2))

    def widened(self, residual: Floats, freedom: int) -> float:
        """What a robust loss makes of the covariance that its weights state, by residuals as they scatter.

        With psi = z d loss/d z^2 the variance of an estimate is K^2 mean(psi^2)/mean(psi')^2 times that of least
        squares, K = 1 + p/n var(psi')/mean(psi')^2 [Huber1981, section 7.6]; weights alone state 1/mean(psi/z).
        """
        below, psi, above = (
            z * self.robust_weights(z) ** 2 for z in (residual - PSI_STEP, residual, residual + PSI_STEP)
        )
        slopes = (above - below) / (2.0 * PSI_STEP)
        weight = float(np.mean(self.robust_weights(residual) ** 2))
        slope = max(float(np.mean(slopes)), LEAST_SLOPE * weight)
        k = 1.0 + max(1.0 - freedom / residual.size, 0.0) * float(np.var(slopes)) / slope**2
        return k * k * weight * float(np.sum(psi**2)) / (max(freedom, 1) * slope * slope)

    @property
    def words(self) -> str:
        """For reports."""
        robust = "" if self.loss == "linear" else f"; large residuals count by the loss {self.loss}"
        unit = "" if self.assumed is None else f", in units of an assumed {100 * self.assumed:g} % of each value"
        causes = ", ".join(self.weights.causes) if self.weights is not None else ""
        stated = "the table's covariance" + (f", with the common causes {causes}" if causes else "")
        if self.metric == "weighted":
            return f"{stated if self.assumed is None else f'weighted{unit}'}{robust}"
        if self.metric == "log":
            scale = f"as ln f above {self.small:.2g} 1/sr and as f below"
            if self.tau:
                return f"logarithmic, {scale}: {stated}{unit}, and the model's own misfit of {100 * self.tau:.2g} %"
            return f"logarithmic: every value alike, {scale}{unit}{robust}"
        return f"{METRICS[self.metric]}{robust}"


def objective(data: Observations, metric: str | None = None) -> Objective:
    """By a metric.

    Without one: with the table's whole covariance, or logarithmic where it states none (in units of what is assumed).
    """
    stated = data.covariance is not None and data.u_rel_assumed is None
    chosen = metric or ("weighted" if stated else "log")
    small = smallest_of(data)
    if chosen == "weighted":
        if data.covariance is None:
            raise ConfigError(
                "--metric weighted: the table states no uncertainties; --u-rel 0.03 assumes one of 3 % of each value"
            )
        return Objective(data.brdf, data.covariance, metric=chosen, assumed=data.u_rel_assumed)
    assumed = data.u_rel_assumed if chosen == "log" else None
    return Objective(
        data.brdf,
        None if assumed is None else on_log_scale(data, small, data.brdf),
        small,
        metric=chosen,
        cosine=np.cos(data.directions.theta_i),
        assumed=assumed,
    )


def smallest(brdf: Floats) -> float:
    """e [1/sr] of the scale of "log", for measured values."""
    return max(LINEAR_BELOW * float(np.median(np.abs(brdf))), 1e-300)


def smallest_of(data: Observations) -> float:
    """`smallest` of values, some of which may be elements of Mueller matrices or Stokes parameters.

    Those are differences, small beside the intensity that they belong to: where there are such, what is below a typical
    intensity counts as a difference.
    """
    apart = data.differences
    if not apart.any():
        return smallest(data.brdf)
    return 0.5 / LINEAR_BELOW * smallest(data.brdf[~apart] if not apart.all() else data.brdf)


def on_log_scale(data: Observations, small: float, predicted: Floats, tau: float = 0.0) -> Covariance | None:
    """The covariance of asinh(f/2e), with a misfit `tau` of every value; None where neither says anything.

    Common causes are scaled to a model, as in `scaled_to`; what is independent is not.
    """
    if data.covariance is None:
        return independent(np.full(len(data), tau)) if tau else None
    ratio = ratio_to(predicted, data.brdf, data.u)
    known = data.covariance.scaled(ratio, predicted)
    slope = 1.0 / np.hypot(data.brdf, 2 * small)
    of_model = 1.0 / np.hypot(data.brdf * ratio, 2 * small)
    return Covariance(np.hypot(known.random * slope, tau), known.common * of_model[:, None], known.causes)


def with_misfit(data: Observations, tau: float, predicted: Floats) -> Objective:
    """Of a model whose own misfit is `tau`: logarithmic, with the stated covariance and tau^2 of every value.

    tau^2 depends on no fitted value: a model cannot make itself likely by a larger variance.
    """
    small = smallest_of(data)
    weights = on_log_scale(data, small, predicted, tau)
    return Objective(data.brdf, weights, small, metric="log", tau=tau, assumed=data.u_rel_assumed)


def alone(data: Observations, metric: str | None = None) -> Objective:
    """With the independent part of the covariance only."""
    goal = objective(data, metric)
    return goal if goal.weights is None else replace(goal, weights=independent(goal.weights.random))


def scaled_to(data: Observations, predicted: Floats, metric: str | None = None) -> Objective:
    """With the whole covariance, its common causes scaled from the measured values to a model's.

    See `Covariance.scaled`; the ratio is used where a value is above 3 u, and held between 1/2 and 2.
    """
    goal = objective(data, metric)
    if goal.metric != "weighted" or not goal.weights or not goal.weights.causes:
        return goal
    return replace(goal, weights=goal.weights.scaled(ratio_to(predicted, data.brdf, data.u), predicted))


def ratio_to(expected: Floats, measured: Floats, u: Floats) -> Floats:
    """What `Covariance.scaled` takes: expected over measured values, 1 for those that are within 3 u of zero."""
    seen = measured > 3 * u
    ratio = np.where(seen, expected / np.where(seen, measured, 1.0), 1.0)
    return np.asarray(np.clip(ratio, 0.5, 2.0))


def softened(data: Observations, relative: float) -> Objective:
    """With `relative` f added to every uncertainty, so that a steep flank does not hide the right valley."""
    if data.covariance is None:
        return objective(data)
    return Objective(data.brdf, independent(np.hypot(data.u, relative * np.abs(data.brdf))), metric="weighted")
