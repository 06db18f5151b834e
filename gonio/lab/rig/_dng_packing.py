"""Compiled loops that pack and unpack the 12-bit rows of a DNG (TIFF 6.0)."""

from typing import Any

import numpy as np

from gonio.compiled import njit


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
