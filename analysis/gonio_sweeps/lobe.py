"""A first guess of what of a curve is a lobe, and what is the base under it."""

import numpy as np
import numpy.typing as npt

from gonio.models.gaussian_process import Coordinates
from gonio.typing import Floats

WIDTHS_DEG = (3.0, 8.0, 20.0)
"""Slopes of the facets, from which the search begins."""
FEWEST = 8
"""A lobe's height, width and the base are told from each other by so many values."""


def begun(at: Coordinates, f: Floats, u: Floats, used: npt.NDArray[np.bool_]) -> tuple[Floats, Floats] | None:
    """Lobe and base [1/sr] of values, (n,) each: Gaussian slopes of one width over a constant, a height an incidence.

    The best of a few searches, by the squares of logarithms. None where there are too few values, or none above zero.
    """
    from scipy.optimize import least_squares

    good = used & (f > 3.0 * u)
    if good.sum() < FEWEST:
        return None
    _, which = np.unique(np.round(at.incidence, 3), axis=0, return_inverse=True)
    which = which.reshape(-1)
    count = int(which.max()) + 1
    square = np.tan(np.minimum(at.theta_h, 1.5)) ** 2
    log_f = np.log(f[good])

    def parts(x: Floats) -> tuple[Floats, Floats]:
        lobe = x[2:][which] - square * np.exp(-2.0 * x[1])
        return np.exp(np.maximum(lobe, x[0] - 30.0)), np.full(f.size, np.exp(x[0]))

    def away(x: Floats) -> Floats:
        lobe, base = parts(x)
        return np.log((lobe + base)[good]) - log_f

    best = None
    for width in WIDTHS_DEG:
        begin = np.concatenate([[np.percentile(log_f, 20.0), np.log(np.radians(width))], np.full(count, log_f.max())])
        found = least_squares(away, begin, loss="soft_l1", f_scale=0.1, max_nfev=60)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return parts(best.x)
