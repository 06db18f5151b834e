"""Compiled loops over the pixels of a frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
def spots(
    by_row: Any,
    by_col: Any,
    eye: Any,
    source: Any,
    distance: float,
    x: Any,
    y: Any,
    cos_i: Any,
    cos_r: Any,
    factor: Any,
) -> None:
    """Fill x, y, cos(theta_i), cos(theta_r) and (distance/d)^2 for lines of sight by_row[i] + by_col[j] from `eye`.

    A line that does not meet the plane z = 0 in front of the camera gives NaN, NaN, 0, 0, 0.
    """
    for i in range(by_row.shape[0]):
        for j in range(by_col.shape[0]):
            a = by_row[i, 0] + by_col[j, 0]
            b = by_row[i, 1] + by_col[j, 1]
            c = by_row[i, 2] + by_col[j, 2]
            meets = c < 0.0 and eye[2] > 0.0
            t = -eye[2] / c if meets else np.nan
            u = eye[0] + t * a
            v = eye[1] + t * b
            to_x = source[0] - u
            to_y = source[1] - v
            square = to_x * to_x + to_y * to_y + source[2] * source[2]
            x[i, j] = u
            y[i, j] = v
            cos_i[i, j] = max(source[2], 0.0) / math.sqrt(square) if meets else 0.0
            cos_r[i, j] = -c / math.sqrt(a * a + b * b + c * c) if meets else 0.0
            factor[i, j] = distance * distance / square if meets else 0.0


@njit(cache=True, error_model="numpy", nogil=True)  # type: ignore[untyped-decorator]
def pack12(mosaic: Any, packed: Any) -> None:
    """Pack rows of 12-bit values, most significant bit first, each row ending on a whole byte (TIFF 6.0)."""
    width = mosaic.shape[1]
    for i in range(mosaic.shape[0]):
        k = 0
        for j in range(0, width - 1, 2):
            first = mosaic[i, j]
            second = mosaic[i, j + 1]
            packed[i, k] = first >> 4
            packed[i, k + 1] = ((first & 15) << 4) | (second >> 8)
            packed[i, k + 2] = second & 255
            k += 3
        if width % 2:
            packed[i, k] = mosaic[i, width - 1] >> 4
            packed[i, k + 1] = (mosaic[i, width - 1] & 15) << 4
