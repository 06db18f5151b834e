"""Fresnel reflection at a smooth surface, and what Cook and Torrance make of the normal reflectance."""

from math import sqrt
from typing import Any

import numpy as np

from gonio.errors import ArgumentError
from gonio.models.engine import common_shape, real_array
from gonio.models.parameters import number
from gonio.typing import ArrayLike, Floats, NDArray


def _cosine(cos_theta: ArrayLike) -> Floats:
    c = real_array("cos_theta", cos_theta)
    if not bool(np.all((c >= 0.0) & (c <= 1.0))):
        raise ArgumentError(f"cos_theta = {c[~((c >= 0.0) & (c <= 1.0))].flat[0]!r}: must lie in [0, 1]")
    return c


def _index(ior: ArrayLike) -> NDArray[np.complex128]:
    try:
        n = np.asarray(ior)
    except ValueError as error:
        raise ArgumentError(f"ior is not an array of numbers: {error}") from error
    if n.dtype.kind not in "fiuc" or not bool(np.all(np.isfinite(n) & (n.real > 0.0) & (n.imag >= 0.0))):
        raise ArgumentError(f"ior = {ior!r}: must be n + ik with n above 0 and k at least 0")
    return n.astype(np.complex128)


def _channels(name: str, colour: ArrayLike) -> Floats:
    array = real_array(name, colour)
    if not bool(np.all(np.isfinite(array))):
        raise ArgumentError(f"{name} = {colour!r}: must be finite")
    return array


def amplitudes(cos_theta: ArrayLike, ior: ArrayLike) -> tuple[Any, Any]:
    """Amplitude reflection coefficients (F_s, F_p) from the air side.

    With q = sqrt(n~^2 - sin^2), Im q >= 0: F_s = (cos - q)/(cos + q) and F_p = (n~^2 cos - q)/(n~^2 cos + q), both
    rearranged so that nothing cancels as n~ approaches 1 (He et al. 1991 sign convention: F_p = -F_s at normal
    incidence; fields go as exp(-i omega t)).

    Parameters
    ----------
    cos_theta
        Cosine of the angle of incidence, in [0, 1].
    ior
        Complex index n + ik, n > 0, k >= 0; broadcasts with `cos_theta`.

    Raises
    ------
    ArgumentError
        An argument is NaN or out of range.
    """
    c, n = _cosine(cos_theta), _index(ior)
    common_shape(("cos_theta", "ior"), [c.shape, n.shape])
    c, n = np.broadcast_arrays(c, n)
    contrast = (n - 1.0) * (n + 1.0)
    square = n * n
    q = np.sqrt(contrast + c * c)
    sum_s = c + q
    sum_p = square * c + q
    matched = sum_s == 0.0  # n~ = 1 at exactly grazing: nothing is reflected at any other angle
    f_s = -contrast / np.where(matched, 1.0, sum_s) ** 2
    f_p = contrast * (square * c * c - (1.0 - c) * (1.0 + c)) / np.where(matched, 1.0, sum_p) ** 2
    return f_s[()], f_p[()]


def reflectance(cos_theta: ArrayLike, ior: ArrayLike) -> Any:
    """Reflectance for unpolarised light, (|F_s|^2 + |F_p|^2)/2, in [0, 1]; parameters as `amplitudes`."""
    f_s, f_p = amplitudes(cos_theta, ior)
    return 0.5 * (f_s.real**2 + f_s.imag**2 + f_p.real**2 + f_p.imag**2)


def n_from_f0(f0: float) -> float:
    """The real index whose reflectance at normal incidence is `f0`, n = (1 + sqrt F_0)/(1 - sqrt F_0).

    Parameters
    ----------
    f0
        Reflectance at normal incidence, in [0, 0.9999999].

    Raises
    ------
    ArgumentError
        `f0` is NaN or out of range.
    """
    root = sqrt(number("f0", f0, 0.0, 0.9999999))
    return (1.0 + root) / (1.0 - root)


def colour_shift(cos_theta: ArrayLike, f0: float, colour_0: ArrayLike, colour_90: ArrayLike) -> Any:
    """The colour of a reflection between normal and grazing incidence, interpolated as in Cook and Torrance (1982).

    C = C_0 + (C_90 - C_0) max(0, F - F_0)/(1 - F_0), with F for the real index that the average normal reflectance
    gives.

    Parameters
    ----------
    cos_theta
        Cosine of the angle of incidence, in [0, 1].
    f0
        Average normal reflectance over the spectrum, in [0, 0.9999999].
    colour_0, colour_90
        Colour of the material at normal incidence and of the light, one value a channel.

    Returns
    -------
    Array of the shape of `cos_theta` with the channels as a last axis.

    Raises
    ------
    ArgumentError
        An argument is NaN or out of range, or the two colours differ in their channels; it names the argument.
    """
    f = np.asarray(reflectance(cos_theta, n_from_f0(f0)))
    share = np.maximum(0.0, f - float(f0)) / (1.0 - float(f0))
    first, last = _channels("colour_0", colour_0), _channels("colour_90", colour_90)
    common_shape(("colour_0", "colour_90"), [first.shape, last.shape])
    return first + (last - first) * share[..., np.newaxis]
