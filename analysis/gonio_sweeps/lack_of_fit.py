"""Whether a model describes what was measured: two tests of the residuals of a fit, with a stated rate of false alarms.

Both use whitened residuals, so that common causes of the run do not count as misfit. One is chi-square: values that
scatter more than they should. The other asks whether the residuals hang together: smooth functions of the directions
are fitted to them, and what chi-square falls by has a chi-square distribution of its own. A wrong model shows there
long before single values stand out.
"""

import math
from dataclasses import dataclass

import numpy as np
from gonio_analysis.fitting.value_covariance import Covariance

from gonio.geometry import Directions
from gonio.typing import Floats
from gonio_sweeps.candidates import places

FALSE_ALARMS = 0.01
"""Probability that a run with the right model is held to have a wrong one, over all looks together."""
DEGREE = 3
"""Of the smooth functions: Legendre polynomials of the place between its smallest and largest coordinates."""
SPARE = 4
"""Values beyond parameters and smooth functions that the second test needs."""


@dataclass(frozen=True)
class LackOfFit:
    """What the residuals say of a model."""

    chi_square: float
    degrees_of_freedom: int
    p_value: float
    """Of both tests together: the smaller one, twice."""

    def rejects(self, look: int) -> bool:
        """Whether the model is held to be wrong, at the look of this number (0 is the first).

        Each look spends 6 / (pi^2 (look + 1)^2) of `FALSE_ALARMS`, which adds up to it however many there are.
        """
        return self.p_value < FALSE_ALARMS * 6.0 / (math.pi * (look + 1)) ** 2


def judge(residual: Floats, jacobian: Floats, predicted: Floats, covariance: Covariance, at: Directions) -> LackOfFit:
    """Test a fit.

    Parameters
    ----------
    residual
        Measurement less model [1/sr], (n,).
    jacobian
        d(model)/d(parameter), (n, p); of the parameters that do not stand at a bound.
    predicted
        The model [1/sr], (n,).
    covariance
        Of the measurement.
    at
        Its directions.
    """
    from scipy.special import chdtrc

    white = covariance.whiten(residual)
    design = covariance.whiten(jacobian) if jacobian.shape[1] else np.zeros((white.size, 0))
    first, rank = _left(white, design)
    freedom = white.size - rank
    if freedom < 1:
        return LackOfFit(first, 0, 1.0)
    values = [float(chdtrc(freedom, first))]
    smooth = _smooth(at)[:, : max(freedom - SPARE, 0)]
    if smooth.shape[1]:
        more = covariance.whiten(smooth * predicted[:, None])
        second, with_more = _left(white, np.concatenate([design, more], axis=1))
        if with_more > rank:
            values.append(float(chdtrc(with_more - rank, max(first - second, 0.0))))
    return LackOfFit(first, freedom, min(1.0, len(values) * min(values)))


def _left(white: Floats, design: Floats) -> tuple[float, int]:
    """Sum of squares that is left when the columns have been fitted, and the rank of these."""
    if not design.shape[1]:
        return float(white @ white), 0
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    left, values, _ = np.linalg.svd(design / size, full_matrices=False)
    left = left[:, values > 1e-6 * values[0]]
    rest = white - left @ (left.T @ white)
    return float(rest @ rest), left.shape[1]


def _smooth(at: Directions) -> Floats:
    """Relative departures that change slowly with the directions: columns (n, m), the slowest first."""
    from numpy.polynomial import legendre

    here = places(at)
    low, high = here.min(axis=0), here.max(axis=0)
    scaled = 2.0 * (here - low) / np.where(high > low, high - low, 1.0) - 1.0
    along, across, incidence = (legendre.legvander(x, DEGREE) for x in scaled.T)
    columns = [along[:, i] * incidence[:, k] for i in range(DEGREE + 1) for k in range(2) if 0 < i + k <= DEGREE]
    if high[1] - low[1] > 0.1:
        columns += [across[:, 1], across[:, 2]]
    return np.stack(columns, axis=1)
