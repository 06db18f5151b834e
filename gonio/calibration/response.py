"""The response curve of a camera of 8 bits from a bracket of exposures (Debevec1997).

Pixels of one still scene at several exposures read Z_ij, and g(Z_ij) = ln E_i + ln t_j with one smooth g for all.
"""

from collections.abc import Sequence

import numpy as np

from gonio.errors import DataError
from gonio.typing import Array, Floats, NDArray

VALUES = 256
SMOOTHNESS = 30.0
FEWEST_EXPOSURES = 3


def hat(values: Floats, low: float = 0.01, high: float = 0.99) -> Floats:
    """The weight of values between 0 and 1: largest in the middle, 0 at both ends and beyond."""
    middle = 0.5 * (low + high)
    inside = (values >= low) & (values <= high)
    weight = np.where(inside, np.where(values <= middle, values - low, high - values), 0.0)
    return np.asarray(weight / weight.max())


def solve(values: NDArray[np.integer], log_exposures: Floats, smoothness: float = SMOOTHNESS) -> Floats:
    """g of every value, with g(128) = 0: the least squares of Debevec and Malik, eq. 3; 0 where no frame tells it.

    Parameters
    ----------
    values
        Of pixels (rows) at exposures (columns), 0 to 255.
    log_exposures
        ln of each exposure time [s].
    """
    squared = hat(np.linspace(0.0, 1.0, VALUES)) ** 2
    weights = squared[values]
    of_pixel = weights.sum(axis=1)
    seen = of_pixel > 0
    values, weights, of_pixel = values[seen], weights[seen], of_pixel[seen]
    pixels = np.repeat(np.arange(len(values)), values.shape[1])
    shares = np.zeros((len(values), VALUES))
    np.add.at(shares, (pixels, values.ravel()), weights.ravel())
    # the light of each pixel is eliminated: what is left has the size of the curve
    right = np.bincount(values.ravel(), (weights * log_exposures).ravel(), VALUES)
    right -= shares.T @ ((weights @ log_exposures) / of_pixel)
    normal = np.diag(shares.sum(axis=0)) - shares.T @ (shares / of_pixel[:, None])
    normal[VALUES // 2, VALUES // 2] += 1.0
    curvature = np.zeros((VALUES - 2, VALUES))
    k = np.arange(VALUES - 2)
    curvature[k, k], curvature[k, k + 1], curvature[k, k + 2] = 1.0, -2.0, 1.0
    normal += smoothness**2 * curvature.T @ (squared[1:-1, None] * curvature)
    return np.asarray(np.linalg.pinv(normal, rcond=1e-14, hermitian=True) @ right)


def curve(frames: Sequence[Array], exposures_s: Floats, pixels: int = 400) -> Floats:
    """`camera.response` from frames of one still scene: 256 linear values [DN] that grow from 0 to 255.

    Raises
    ------
    DataError
        There are fewer than three exposures, or the frames do not reach from dark to bright, or do not get brighter
        with the exposure.
    """
    if len(set(exposures_s)) < FEWEST_EXPOSURES:
        raise DataError(
            f"a response curve needs frames of {FEWEST_EXPOSURES} exposures of one still scene, better 15; there are "
            f"{len(set(exposures_s))}"
        )
    order = np.argsort(exposures_s)
    stack = np.stack([np.asarray(frames[k]).ravel() for k in order], axis=1).astype(int)
    times = np.asarray(exposures_s, dtype=float)[order]
    if np.any(np.diff(stack.mean(axis=0)) < -1.0):
        raise DataError("frames of a longer exposure are darker: did the lamp or the automatic exposure change?")
    seen = np.unique(stack)
    if seen.min() > 0.1 * VALUES or seen.max() < 0.9 * VALUES:
        raise DataError(
            f"the frames hold values from {seen.min()} to {seen.max()}; a response curve needs them from near 0 "
            f"to near "
            "255: take shorter and longer exposures"
        )
    # pixels of many brightnesses, each told by the sum over the bracket
    total = stack.sum(axis=1)
    chosen = np.argsort(total, kind="stable")[np.linspace(0, total.size - 1, min(pixels, total.size)).astype(int)]
    light = np.exp(solve(stack[chosen], np.log(times)))
    first, last = np.flatnonzero(hat(np.linspace(0.0, 1.0, VALUES)) > 0)[[0, -1]]
    # the weights leave the ends undetermined: black is no light, and the top goes on as the curve does
    light[:first] = light[first] * np.arange(first) / first
    light[last + 1 :] = light[last] + (light[last] - light[last - 1]) * np.arange(1, VALUES - last)
    light /= light[-1]
    return np.asarray(np.maximum.accumulate(light + 1e-9 * np.arange(VALUES)) / (1.0 + 1e-9 * (VALUES - 1)) * 255.0)
