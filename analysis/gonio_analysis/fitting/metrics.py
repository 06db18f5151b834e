"""How far a model is from a measurement: several numbers, because no single one is fair to spikes and to tails.

With f the measured and F the model's BRDF [1/sr] in the same directions:

- `weighted`: root mean square of the whitened residuals (1 is perfect agreement with the stated uncertainties);
- `log_ratio`: root mean square of ln(F / f): 0.1 is a typical disagreement of 10 %;
- `log_cosine`: root mean square of ln(1 + F cos theta_i) - ln(1 + f cos theta_i);
- `ngan`: root mean square of (F - f) cos theta_i [1/sr] (Ngan, Durand and Matusik 2005);
- `cube_root`: root mean square of the difference of the cube roots of F cos theta_i and f cos theta_i;
- `relative`: root mean square of (F - f) / f, of the values that the logarithmic ones use.

The directions are the measured ones, each counted once: no sample has been resampled to a uniform grid.
"""

import numpy as np

from gonio.typing import Floats

BELOW = 3.0
"""Logarithmic metrics leave out values below this many standard uncertainties."""

DESCRIPTIONS = {
    "weighted": ("weighted residual", "rms of the whitened residuals; 1 agrees with the stated uncertainties"),
    "log_ratio": ("log ratio", "rms of ln(model / measured), values above 3 u; 0.1 is a typical disagreement of 10 %"),
    "log_cosine": ("log(1 + f cos)", "rms of the difference of ln(1 + f cos θi), values above 3 u"),
    "ngan": ("Ngan cos-weighted", "rms of (model - measured) cos θi, in 1/sr: governed by the highest values"),
    "cube_root": ("cube root", "rms of the difference of (f cos θi)^(1/3)"),
    "relative": ("relative", "rms of (model - measured) / measured, values above 3 u: costs too low a model less"),
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
