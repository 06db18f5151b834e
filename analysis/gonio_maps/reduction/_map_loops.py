"""The compiled loop over the cells of a map: what lies between the four pixels around a spot."""

import math
from typing import Any

import numpy as np

from gonio.compiled import njit

LITTLE = 1e-6
"""A pixel with a smaller share does not count, and neither does its flag."""


@njit(error_model="numpy", nogil=True)
def between(
    held: Any, row: Any, col: Any, top: int, left: int, there: Any, value: Any, variance: Any, flag: Any
) -> None:
    """Fill value [1/sr], its variance and flags by linear interpolation in a picture.

    Parameters
    ----------
    held
        A part of a picture, of `map_planes.PIXEL`; its first pixel is (`top`, `left`) of the whole.
    row, col, there
        Where each cell lies in the whole picture, and whether four pixels lie around it, shape (rows, columns).
    value, variance, flag
        Of the same shape; cells without pixels stay as they are.
    """
    for i in range(row.shape[0]):
        for j in range(row.shape[1]):
            if not there[i, j]:
                continue
            down, right = math.floor(row[i, j]), math.floor(col[i, j])
            below, beside = row[i, j] - down, col[i, j] - right
            y, x = int(down) - top, int(right) - left
            mean, spread, bits = 0.0, 0.0, np.int64(0)
            for k in range(2):
                for m in range(2):
                    share = (below if k else 1.0 - below) * (beside if m else 1.0 - beside)
                    if share > LITTLE:
                        pixel = held[y + k, x + m]
                        mean += share * pixel["brdf"]
                        spread += share * share * np.float64(pixel["u"]) * np.float64(pixel["u"])
                        bits |= np.int64(pixel["flag"])
            value[i, j], variance[i, j], flag[i, j] = mean, spread, bits
