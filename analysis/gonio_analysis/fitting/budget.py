"""How much each cause adds to the uncertainty of a table's values."""

from __future__ import annotations

import numpy as np

from gonio_analysis.fitting.observations import Observations
from gonio_analysis.result_records import CauseSummary


def budget(data: Observations) -> list[CauseSummary]:
    """Uncertainty by cause: median and 95th percentile of |u / value|, the combined one first.

    Values within 3 u of zero are left out: relative to them nothing means anything. Empty where nothing is stated.
    """
    if data.covariance is None:
        return []
    c = data.covariance
    use = np.abs(data.brdf) > 3 * data.u
    if not use.any():
        return []
    size = np.abs(data.brdf[use])
    parts = [("combined", c.total[use]), ("random (independent)", c.random[use])]
    parts += [(cause.replace("_", " "), np.abs(c.common[use, k])) for k, cause in enumerate(c.causes)]
    return [CauseSummary(label, float(np.median(p / size)), float(np.quantile(p / size, 0.95))) for label, p in parts]
