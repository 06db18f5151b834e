"""Directions, azimuths and cones: the arithmetic behind docs/conventions.md.

Angles are radians. `theta` is measured from the outward normal z, `phi` from the sample's x axis toward its y axis.
Directions leave the surface, toward the source and toward the detector alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from gonio.errors import ArgumentError
from gonio.typing import Floats

if TYPE_CHECKING:
    import pandas as pd

TWO_PI = 2.0 * np.pi
ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")


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


@dataclass(frozen=True)
class Directions:
    """Where source and detector are, seen from the sample (docs/conventions.md): what every step takes and gives.

    Attributes
    ----------
    theta_i, phi_i, theta_r, phi_r
        Polar angles and azimuths [rad], toward the source and toward the detector: float64 arrays that broadcast.
    """

    theta_i: Floats
    phi_i: Floats
    theta_r: Floats
    phi_r: Floats

    def __post_init__(self) -> None:
        for name in ANGLES:
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))

    @classmethod
    def from_table(cls, table: pd.DataFrame) -> Directions:
        """The directions of a measurement table or of a plan: its four columns of angles in degrees."""
        return cls(*(np.radians(table[f"{name}_deg"].to_numpy(np.float64)) for name in ANGLES))

    @classmethod
    def from_vectors(cls, omega_i: npt.ArrayLike, omega_r: npt.ArrayLike) -> Directions:
        """The directions of vectors of any length that leave the surface, shape (..., 3)."""
        return cls(*angles(omega_i), *angles(omega_r))

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape that the four angles broadcast to."""
        return np.broadcast_shapes(self.theta_i.shape, self.phi_i.shape, self.theta_r.shape, self.phi_r.shape)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: Any) -> Directions:
        """Some of the directions."""
        return Directions(*(np.broadcast_to(getattr(self, name), self.shape)[rows] for name in ANGLES))

    @property
    def dphi(self) -> Floats:
        """phi_r - phi_i, in [0, 2 pi): 0 is the retro half-plane, pi the mirror half-plane."""
        return wrap(self.phi_r - self.phi_i)

    @property
    def signed(self) -> Floats:
        """theta_r with the sign of its side: positive on the mirror side (`in_plane_angle`)."""
        return in_plane_angle(self.theta_r, self.phi_r - self.phi_i)

    @property
    def out_of_plane(self) -> Floats:
        """Angle between the detector and the plane of incidence, positive toward larger azimuths."""
        dphi = self.phi_r - self.phi_i
        sine = np.sin(self.theta_r)
        return np.asarray(np.arctan2(sine * np.sin(dphi), np.hypot(sine * np.cos(dphi), np.cos(self.theta_r))))

    @property
    def mirror_offset(self) -> Floats:
        """Angle between the detector and the mirror direction of the source."""
        source, detector = self.vectors
        return _between(source * (-1.0, -1.0, 1.0), detector)

    @property
    def half(self) -> tuple[Floats, Floats]:
        """theta_h, between the normal and the half vector, and theta_d, between the half vector and either direction.

        At exactly grazing opposite directions there is no half vector; theta_h is 0 there.
        """
        source, detector = self.vectors
        x, y, z = np.moveaxis(source + detector, -1, 0)
        return np.asarray(np.arctan2(np.hypot(x, y), z)), 0.5 * _between(source, detector)

    @property
    def vectors(self) -> tuple[Floats, Floats]:
        """Unit vectors toward the source and toward the detector, shape (..., 3)."""
        return direction(self.theta_i, self.phi_i), direction(self.theta_r, self.phi_r)


def _between(a: Floats, b: Floats) -> Floats:
    """Angle between unit vectors, without cancellation near 0 and near pi."""
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))
