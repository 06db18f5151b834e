"""Directions, azimuths and cones: the arithmetic behind docs/conventions.md.

Angles are radians. `theta` is measured from the outward normal z, `phi` from the sample's x axis toward its y axis.
Directions leave the surface, toward the source and toward the detector alike.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gonio.errors import ArgumentError
from gonio.typing import Floats

TWO_PI = 2.0 * np.pi


def direction(theta: npt.ArrayLike, phi: npt.ArrayLike) -> Floats:
    """Unit vectors, shape (..., 3), of the directions at polar angle `theta` and azimuth `phi` [rad]."""
    theta, phi = np.broadcast_arrays(np.asarray(theta, dtype=np.float64), np.asarray(phi, dtype=np.float64))
    sine = np.sin(theta)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)], axis=-1)


def angles(omega: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Polar angle in [0, pi] and azimuth in [0, 2 pi) [rad] of vectors of any length, shape (..., 3).

    The azimuth of the normal itself is 0. Both angles are accurate to a few units in the last place everywhere (atan2
    forms; no arccos).
    """
    omega = np.asarray(omega, dtype=np.float64)
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    return np.arctan2(np.hypot(x, y), z), wrap(np.arctan2(y, x))


def wrap(phi: npt.ArrayLike) -> Floats:
    """An azimuth [rad] brought to [0, 2 pi)."""
    out = np.mod(np.asarray(phi, dtype=np.float64), TWO_PI)
    # the remainder of a tiny negative angle rounds to 2 pi itself
    return np.where(out >= TWO_PI, 0.0, out)


def in_plane_angle(theta_r: npt.ArrayLike, dphi: npt.ArrayLike) -> Floats:
    """Signed viewing angle [rad] in the plane of incidence: positive on the mirror side, negative on the retro side.

    Parameters
    ----------
    theta_r : array_like
        Polar angle of the detector, in [0, pi/2].
    dphi : array_like
        phi_r - phi_i: 0 (retro half-plane) or pi (mirror half-plane), in any turn. Directions out of the plane get the
        sign of the half-space that they lie in; choosing the rows that lie in the plane is the caller's part.
    """
    side = np.where(np.cos(np.asarray(dphi, dtype=np.float64)) < 0.0, 1.0, -1.0)
    return side * np.asarray(theta_r, dtype=np.float64) + 0.0  # + 0.0: the normal has no side, and no -0


def solid_angle_of_cone(half_angle: npt.ArrayLike) -> Floats:
    """Solid angle [sr] of a circular cone of half-angle `half_angle` [rad, 0 to pi].

    2 pi (1 - cos) written as 4 pi sin^2(half_angle / 2), which loses no digits for a narrow cone.

    Raises
    ------
    ArgumentError
        An angle is outside [0, pi] or is not a number.
    """
    half = np.asarray(half_angle, dtype=np.float64)
    if not np.all((half >= 0.0) & (half <= np.pi)):
        raise ArgumentError(f"half_angle = {half} rad: the half-angle of a cone lies in [0, pi]")
    return np.asarray(4.0 * np.pi * np.sin(half / 2.0) ** 2)


def half_angle_of_cone(solid_angle_sr: npt.ArrayLike) -> Floats:
    """Half-angle [rad] of the circular cone of a solid angle [sr, 0 to 4 pi].

    Raises
    ------
    ArgumentError
        A solid angle is outside [0, 4 pi] or is not a number.
    """
    omega = np.asarray(solid_angle_sr, dtype=np.float64)
    if not np.all((omega >= 0.0) & (omega <= 4.0 * np.pi)):
        raise ArgumentError(f"solid_angle_sr = {omega}: the solid angle of a cone lies in [0, 4 pi] sr")
    return np.asarray(2.0 * np.arcsin(np.sqrt(omega / (4.0 * np.pi))))
