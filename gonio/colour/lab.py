"""CIE 1976 L*a*b* (CIE 15, ISO 11664-4), and how it changes with XYZ."""

import numpy as np

from gonio.colour.cie import white
from gonio.errors import ArgumentError, refuse_masked
from gonio.typing import ArrayLike, Floats

_EDGE = 6.0 / 29.0
"""Cube root of the ratio to white below which f is a straight line."""
_MIX = np.array([[0.0, 116.0, 0.0], [500.0, -500.0, 0.0], [0.0, 200.0, -200.0]])
"""L* + 16, a* and b* from f(X/Xn), f(Y/Yn), f(Z/Zn)."""


def lab(xyz: ArrayLike, illuminant: str = "D65") -> Floats:
    """L*a*b* of XYZ against the white of an illuminant, (..., 3) to (..., 3).

    Parameters
    ----------
    xyz
        Y = 1 for a perfect white, as `gonio.colour.xyz` gives it. Values below 0, as noise makes them, go on along the
        straight line that ends at black.
    illuminant
        A name of `ILLUMINANTS`; its white has L* = 100, a* = b* = 0.

    Raises
    ------
    ArgumentError
        There is no such illuminant, or the last axis is not of length 3.
    """
    ratio = _ratio(xyz, illuminant)
    f = np.where(ratio > _EDGE**3, np.cbrt(ratio), ratio / (3.0 * _EDGE**2) + 4.0 / 29.0)
    return np.asarray(f @ _MIX.T - (16.0, 0.0, 0.0))


def lab_slope(xyz: ArrayLike, illuminant: str = "D65") -> Floats:
    """d(L*, a*, b*)/d(X, Y, Z) at XYZ, (..., 3) to (..., 3, 3): what carries a covariance from XYZ to L*a*b*.

    Parameters and errors as `lab`.
    """
    ratio = _ratio(xyz, illuminant)
    slope = np.where(ratio > _EDGE**3, np.cbrt(np.maximum(ratio, _EDGE**3)) ** -2, _EDGE**-2) / 3.0
    return np.asarray(_MIX * (slope / white(illuminant))[..., None, :])


def _ratio(xyz: ArrayLike, illuminant: str) -> Floats:
    refuse_masked("xyz", xyz)
    values = np.asarray(xyz, dtype=np.float64)
    if values.ndim == 0 or values.shape[-1] != 3:
        raise ArgumentError(f"xyz has shape {values.shape}: its last axis must hold X, Y and Z")
    return np.asarray(values / white(illuminant))
