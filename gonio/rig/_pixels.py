"""Compiled loops over the pixels of a frame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.compiled import njit

# No term may be moved between operations (reassoc), and NaN must live: it marks pixels that see nothing.
FAST = {"contract", "arcp", "nsz"}


@njit(error_model="numpy", nogil=True, fastmath=FAST)
def spots(
    by_row: Any,
    by_col: Any,
    eye: Any,
    source: Any,
    distance: float,
    x: Any,
    y: Any,
    cos_i: Any,
    factor: Any,
) -> None:
    """Fill x, y, cos(theta_i) and (distance/d)^2 for lines of sight by_row[i] + by_col[:, j] from `eye`.

    A line that does not meet the plane z = 0 in front of the camera gives NaN, NaN, 0, 0. The loop has no
    branches, so that it runs on vectors.
    """
    up = max(source[2], 0.0)
    height_squared = source[2] * source[2]
    distance_squared = distance * distance
    above = eye[2] > 0.0
    for i in range(by_row.shape[0]):
        row_a, row_b, row_c = by_row[i, 0], by_row[i, 1], by_row[i, 2]
        x_i, y_i, cos_i_i, factor_i = x[i], y[i], cos_i[i], factor[i]
        for j in range(by_col.shape[1]):
            a = row_a + by_col[0, j]
            b = row_b + by_col[1, j]
            c = row_c + by_col[2, j]
            t = -eye[2] / c
            u = eye[0] + t * a
            v = eye[1] + t * b
            to_x = source[0] - u
            to_y = source[1] - v
            inverse = 1.0 / (to_x * to_x + to_y * to_y + height_squared)
            meets = above and c < 0.0
            x_i[j] = u if meets else np.nan
            y_i[j] = v if meets else np.nan
            cos_i_i[j] = up * math.sqrt(inverse) if meets else 0.0
            factor_i[j] = distance_squared * inverse if meets else 0.0


@njit(error_model="numpy", nogil=True)
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


@njit(error_model="numpy", nogil=True)
def unpack12(packed: Any, mosaic: Any) -> None:
    """The inverse of `pack12`."""
    width = mosaic.shape[1]
    for i in range(mosaic.shape[0]):
        line, out = packed[i], mosaic[i]
        for j in range(width // 2):
            first, second, third = np.uint16(line[3 * j]), np.uint16(line[3 * j + 1]), np.uint16(line[3 * j + 2])
            out[2 * j] = (first << 4) | (second >> 4)
            out[2 * j + 1] = ((second & 15) << 8) | third
        if width % 2:
            k = 3 * (width // 2)
            out[width - 1] = (np.uint16(line[k]) << 4) | (line[k + 1] >> 4)
