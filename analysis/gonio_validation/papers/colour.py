"""From a spectrum to a colour: CIE 1931 2-degree observer, illuminant D65, linear RGB of the sRGB primaries."""

from __future__ import annotations

import functools
from importlib.resources import files

import numpy as np

from gonio.typing import Floats

XYZ_TO_RGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
"""IEC 61966-2-1 primaries with the white point D65."""


@functools.cache
def _table() -> Floats:
    with files("gonio_validation.papers").joinpath("cie.csv").open(encoding="utf-8") as stream:
        return np.asarray(np.loadtxt(stream, delimiter=",", skiprows=1))


def wavelengths() -> Floats:
    """380 to 780 nm in steps of 10 nm: the table of CIE 15."""
    return np.asarray(_table()[:, 0])


def d65() -> Floats:
    """Relative spectral power of illuminant D65 (D6500), 100 at 560 nm."""
    return np.asarray(_table()[:, 1])


def xyz(reflectance: Floats) -> Floats:
    """XYZ of D65 light after a reflection, Y = 1 for a perfect white; (..., 41) to (..., 3)."""
    light = d65()[:, None] * _table()[:, 2:]
    return np.asarray(reflectance @ light / light[:, 1].sum())


def rgb(reflectance: Floats) -> Floats:
    """Linear RGB of D65 light after a reflection, 1 in every channel for a perfect white; (..., 41) to (..., 3)."""
    white = XYZ_TO_RGB @ xyz(np.ones(wavelengths().size))
    return np.asarray(xyz(reflectance) @ XYZ_TO_RGB.T / white)


def shown(linear: Floats) -> Floats:
    """Values for a screen from linear RGB: the sRGB curve, cut to [0, 1]."""
    cut = np.clip(linear, 0.0, 1.0)
    return np.asarray(np.where(cut <= 0.0031308, 12.92 * cut, 1.055 * cut ** (1 / 2.4) - 0.055))


def chromaticity(linear: Floats) -> Floats:
    """Shares of the channels, (..., 3): what is left of a colour without its brightness."""
    return np.asarray(linear / linear.sum(axis=-1, keepdims=True))
