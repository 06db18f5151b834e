"""Directions and dot products, which the papers write without a number."""

from typing import Any, TypeAlias

import numpy as np

Numbers: TypeAlias = Any
"""A number or an array of numbers; arguments broadcast."""

Vectors: TypeAlias = Any
"""An array (..., 3) of vectors in the sample's frame, whose z is the surface normal."""

N = np.array([0.0, 0.0, 1.0])
"""The unit normal of the mean surface: the papers' N, n and z."""


def direction(theta: Numbers, phi: Numbers) -> Vectors:
    """The unit vector at a polar angle and an azimuth [rad]; it leaves the surface."""
    theta, phi = np.broadcast_arrays(theta, phi)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def dot(a: Vectors, b: Vectors) -> Numbers:
    """a . b."""
    return np.sum(np.asarray(a) * b, axis=-1)


def length(a: Vectors) -> Numbers:
    """|a|."""
    return np.sqrt(dot(a, a))


def unit(a: Vectors) -> Vectors:
    """a / |a|; 0/0 for a vector of no length."""
    return a / length(a)[..., np.newaxis]


def polar(a: Vectors) -> Numbers:
    """The angle between a vector and the normal [rad]."""
    a = np.asarray(a)
    return np.arctan2(np.sqrt(a[..., 0] ** 2 + a[..., 1] ** 2), a[..., 2])
