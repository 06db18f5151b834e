"""The compiled loop over the pixels of a frame: where each line of sight meets the sample, and how it is lit there."""

import math
from typing import Any

import numpy as np

from gonio.compiled import FAST, njit

# No term may be moved between operations (reassoc), and NaN must live: it marks pixels that see nothing.


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

    A line that does not meet the plane z = 0 in front of the camera gives NaN, NaN, 0, 0; a camera behind the plane
    sees the spots from there. The loop has no
    branches, so that it runs on vectors.
    """
    up = max(source[2], 0.0)
    height_squared = source[2] * source[2]
    distance_squared = distance * distance
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
            meets = eye[2] * c < 0.0
            x_i[j] = u if meets else np.nan
            y_i[j] = v if meets else np.nan
            cos_i_i[j] = up * math.sqrt(inverse) if meets else 0.0
            factor_i[j] = distance_squared * inverse if meets else 0.0


@njit(error_model="numpy", nogil=True)
def patch_extent(
    eye: Any, sight: Any, image_x: Any, image_y: Any, x: float, y: float, radius: float, ring: Any
) -> tuple[float, float, float, float, float, float]:
    """Where the lens of a pinhole camera images a disc of the plane z = 0, in image distances.

    Lowest and highest u, lowest and highest v of its edge, whose cosines and sines are the rows of `ring`, and of its
    middle; then u and v of the middle. Infinite where a part of it lies behind the camera.
    """
    u_low = v_low = math.inf
    u_high = v_high = -math.inf
    u = v = math.inf
    for k in range(ring.shape[1] + 1):
        a, b, c = x - eye[0], y - eye[1], -eye[2]
        if k < ring.shape[1]:
            a, b = x + radius * ring[0, k] - eye[0], y + radius * ring[1, k] - eye[1]
        depth = a * sight[0] + b * sight[1] + c * sight[2]
        u = v = math.inf
        if depth > 0.0:
            u = (a * image_x[0] + b * image_x[1] + c * image_x[2]) / depth
            v = (a * image_y[0] + b * image_y[1] + c * image_y[2]) / depth
        u_low, u_high = min(u_low, u), max(u_high, u)
        v_low, v_high = min(v_low, v), max(v_high, v)
    return u_low, u_high, v_low, v_high, u, v
