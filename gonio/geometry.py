"""Directions, azimuths and cones: the arithmetic behind docs/conventions.md.

Angles are radians. `theta` is measured from the outward normal z, `phi` from the sample's x axis toward its y axis.
Directions leave the surface, toward the source and toward the detector alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.errors import ArgumentError
from gonio.typing import ArrayLike, Bools, DataFrame, Floats, Ints

TWO_PI = 2.0 * np.pi
ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
ANGLES_DEG = tuple(f"{name}_deg" for name in ANGLES)
"""Their columns in tables and plans."""

# When angles agree, from rounding to what a person calls one direction: the one table of angular tolerances [rad].
PARALLEL = 1e-14
"""Two directions are one: below this their plane is lost in the rounding of their vectors."""
AT_LIMIT = 1e-12
"""A goal beyond a limit is at the limit: a hundred times the rounding of degrees in a plan."""
EXACTLY_IN_PLANE = 1e-9
"""A direction is in the only plane that a rig reaches: well below any encoder's step, and above the rounding of degrees
in a plan."""
AT_HORIZON = 1e-9
"""A direction grazes: its cosine is lost in the rounding of degrees in a table."""
SAME_NOMINAL = 1e-4
"""Angles of a plan are the same: plans give them to a hundredth of a degree (1.7e-4) at the finest."""
SAME_DIRECTION = float(np.radians(0.02))
"""Measured directions are the same: no BRDF that an instrument's cones of half a degree smooth changes in between."""
SAME_ANGLE = float(np.radians(0.4))
"""Polar angles belong to one curve, or an azimuth to one plane: encoders land a few tenths of a degree beside their
goal, and plans step by half a degree at the finest. A polar angle below it has no azimuth to speak of."""
AT_MIRROR = float(np.radians(0.6))
"""A value counts as measured in the mirror direction: `SAME_ANGLE`, with an error of landing in both directions."""
AT_NORMAL = float(np.radians(1.0))
"""Below this angle of incidence the plane of incidence is not a direction that a BRDF could depend on: it turns by many
degrees for one step of an encoder."""
IN_PLANE = float(np.radians(1.5))
"""A detector is in the plane of incidence: the angle between it and the plane, not an azimuth (near the normal a large
azimuth is a small angle). Instruments' cones are as wide."""
MOST_IN_PLANE = 5000
"""Directions of one incidence that are asked in which plane they lie: a second decimal of their share needs no more."""
SAME_SPIKE = float(np.radians(1.5))
"""Angles of incidence share one specular spike: its reflectivity changes by a few percent at most in between."""
SAME_AZIMUTH = float(np.radians(2.0))
"""Azimuths of incidence belong to one curve: spins of samples are set by hand on some instruments."""
SAME_INCIDENCE = float(np.radians(2.0))
"""Angles of incidence make one row of a report's regions: files of scattered directions have no curves to go by."""
AROUND_MIRROR = float(np.radians(12.0))
"""A value lies around the mirror direction: where the peaks of all but the roughest surfaces are."""
FARTHEST = float(np.radians(15.0))
"""Nothing is interpolated between directions farther apart than this."""


def direction(theta: ArrayLike, phi: ArrayLike) -> Floats:
    """Unit vectors, shape (..., 3), of the directions at polar angle `theta` and azimuth `phi` [rad]."""
    theta, phi = np.asarray(theta, dtype=np.float64), np.asarray(phi, dtype=np.float64)
    sine = np.sin(theta)
    out = np.empty((*np.broadcast(theta, phi).shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)
    return out


def angles(omega: ArrayLike) -> tuple[Floats, Floats]:
    """Polar angle in [0, pi] and azimuth in [0, 2 pi) [rad] of vectors of any length, shape (..., 3).

    The azimuth of the normal itself is 0. Both angles are accurate to a few units in the last place everywhere (atan2
    forms; no arccos).
    """
    omega = np.asarray(omega, dtype=np.float64)
    x, y, z = omega[..., 0], omega[..., 1], omega[..., 2]
    return np.arctan2(np.hypot(x, y), z), wrap(np.arctan2(y, x))


def wrap(phi: ArrayLike) -> Floats:
    """An azimuth [rad] brought to [0, 2 pi)."""
    out = np.mod(np.asarray(phi, dtype=np.float64), TWO_PI)
    # the remainder of a tiny negative angle rounds to 2 pi itself
    return np.where(out >= TWO_PI, 0.0, out)


def in_plane_angle(theta_r: ArrayLike, dphi: ArrayLike) -> Floats:
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


def unsigned(signed: ArrayLike) -> tuple[Floats, Floats]:
    """theta_r and dphi [rad] of signed viewing angles: `in_plane_angle` undone. The normal has the mirror's dphi."""
    signed = np.asarray(signed, dtype=np.float64)
    return np.abs(signed), np.where(signed < 0.0, 0.0, np.pi)


def solid_angle_of_cone(half_angle: ArrayLike) -> Floats:
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


def half_angle_of_cone(solid_angle_sr: ArrayLike) -> Floats:
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


def overlap_of_discs(apart: ArrayLike, a: float, b: float) -> Floats:
    """Area that two discs in a plane share, over that of the smaller one; their radii and distance in one unit.

    A disc without extent is a point: it is inside the other, to its edge, or it is not.
    """
    small, large = sorted((a, b))
    apart = np.asarray(apart, dtype=float)
    if small == 0.0:
        return np.where(apart <= large, 1.0, 0.0)
    d = np.clip(apart, large - small + 1e-12, large + small)
    at_a = np.arccos(np.clip((d**2 + small**2 - large**2) / (2.0 * d * small), -1.0, 1.0))
    at_b = np.arccos(np.clip((d**2 + large**2 - small**2) / (2.0 * d * large), -1.0, 1.0))
    lens = small**2 * (at_a - 0.5 * np.sin(2.0 * at_a)) + large**2 * (at_b - 0.5 * np.sin(2.0 * at_b))
    part = np.where(apart <= large - small, 1.0, lens / (math.pi * small**2))
    return np.where(apart < large + small, part, 0.0)


def mirrored(omega: ArrayLike) -> Floats:
    """The mirror directions of vectors, shape (..., 3)."""
    return np.asarray(omega, dtype=np.float64) * (-1.0, -1.0, 1.0)


def angle_between(a: Floats, b: Floats) -> Floats:
    """Angle [rad] between unit vectors of shape (..., 3), without cancellation near 0 and near pi."""
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)))


def groups(theta: Floats, phi: Floats, rows: Ints) -> list[Ints]:
    """Rows of one direction each: chains of nearly equal polar angle, split where azimuths differ by `SAME_AZIMUTH`."""
    out: list[Ints] = []
    if not rows.size:
        return out
    order = rows[np.argsort(theta[rows], kind="stable")]
    for chain in np.split(order, np.flatnonzero(np.diff(theta[order]) > SAME_ANGLE) + 1):
        if theta[chain].max() < SAME_ANGLE:
            out.append(chain)
            continue
        turn = np.exp(1j * phi[chain])
        while chain.size:
            near = np.abs(turn - turn[0]) <= SAME_AZIMUTH
            out.append(chain[near])
            chain, turn = chain[~near], turn[~near]
    return out


def _distinct(phi: Floats) -> Floats:
    """One of every degree that azimuths have."""
    return np.asarray(phi[np.unique(np.round(np.degrees(phi)), return_index=True)[1]])


def _fullest_plane(theta: Floats, phi: Floats, known: Floats) -> float:
    """Azimuth of the plane through the normal that holds most directions: the first of `known`, or through one of them.

    Of very many directions some thousands tell.
    """
    theta, phi = (a[:: 1 + a.size // MOST_IN_PLANE] for a in (theta, phi))
    planes = np.concatenate([known, _distinct(phi % np.pi)])
    off = np.abs(np.sin(theta) * np.sin(phi - planes[:, None]))
    inside = off <= math.sin(IN_PLANE)
    fullest = np.flatnonzero(inside.sum(axis=1) == inside.sum(axis=1).max())
    first = fullest[0] if fullest[0] < known.size else fullest[np.argmin((off * inside)[fullest].sum(axis=1))]
    return float(planes[first])


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Where source and detector are, seen from the sample (docs/conventions.md): what every step takes and gives.

    One pair of directions, or arrays of them: `len`, indices and loops go over the pairs. All angles are radians.

    Attributes
    ----------
    theta_i, phi_i, theta_r, phi_r
        Polar angles and azimuths, toward the source and toward the detector: float64 arrays that broadcast. One pair
        has arrays of no dimension; `floats` takes its four numbers out.
    """

    theta_i: Floats
    phi_i: Floats
    theta_r: Floats
    phi_r: Floats

    def __init__(self, theta_i: ArrayLike, phi_i: ArrayLike, theta_r: ArrayLike, phi_r: ArrayLike) -> None:
        for name, value in zip(ANGLES, (theta_i, phi_i, theta_r, phi_r), strict=True):
            object.__setattr__(self, name, np.asarray(value, dtype=np.float64))

    @classmethod
    def from_degrees(cls, theta_i: ArrayLike, phi_i: ArrayLike, theta_r: ArrayLike, phi_r: ArrayLike) -> Directions:
        """The directions of four angles in degrees."""
        return cls(*(np.radians(np.asarray(a, dtype=np.float64)) for a in (theta_i, phi_i, theta_r, phi_r)))

    @classmethod
    def from_table(cls, table: DataFrame) -> Directions:
        """The directions of a measurement table or of a plan: its four columns of angles in degrees."""
        return cls.from_degrees(*(table[f"{name}_deg"].to_numpy(np.float64) for name in ANGLES))

    @classmethod
    def from_vectors(cls, omega_i: ArrayLike, omega_r: ArrayLike) -> Directions:
        """The directions of vectors of any length that leave the surface, shape (..., 3)."""
        return cls(*angles(omega_i), *angles(omega_r))

    @classmethod
    def stack(cls, single: Sequence[Directions]) -> Directions:
        """An array of single pairs."""
        return cls(*np.array([d.floats for d in single], dtype=np.float64).reshape(-1, 4).T)

    @property
    def angles(self) -> tuple[Floats, Floats, Floats, Floats]:
        """theta_i, phi_i, theta_r, phi_r."""
        return self.theta_i, self.phi_i, self.theta_r, self.phi_r

    @property
    def floats(self) -> tuple[float, float, float, float]:
        """theta_i, phi_i, theta_r, phi_r of a single pair."""
        return float(self.theta_i), float(self.phi_i), float(self.theta_r), float(self.phi_r)

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape that the four angles broadcast to."""
        return np.broadcast(*self.angles).shape

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: Any) -> Directions:
        """Some of the directions."""
        return Directions(*(np.broadcast_to(a, self.shape)[rows] for a in self.angles))

    def __iter__(self) -> Iterator[Directions]:
        return (self[k] for k in range(len(self)))

    def seen_from(self, phi_i: ArrayLike) -> Directions:
        """The same detectors with another azimuth of the source: at normal incidence its own means nothing."""
        return Directions(self.theta_i, phi_i, self.theta_r, self.phi_r)

    def settled_at_normal(self) -> Directions:
        """The same directions, with azimuths of the source near the normal that say where the detectors are.

        Below `AT_NORMAL` a measured azimuth of the source is that of an error of alignment. It becomes that of the
        plane through the normal that holds most detectors: of planes with as many, one of the incidences beyond, then
        the stated one. The source is on the side that it has at the incidences beyond.
        """
        near = np.broadcast_to(self.theta_i < AT_NORMAL, self.shape)
        if not near.any():
            return self
        theta_i, phi_i, theta_r, phi_r = (np.broadcast_to(a, self.shape) for a in self.angles)
        beyond, settled = _distinct(phi_i[theta_i >= AT_NORMAL]), phi_i.copy()
        for rows in groups(theta_i, phi_i, np.flatnonzero(near)):
            own = np.angle(np.exp(1j * phi_i[rows]).sum()) % TWO_PI
            toward = beyond if beyond.size and theta_i[rows].max() < SAME_ANGLE else np.array([own])
            plane = _fullest_plane(theta_r[rows], phi_r[rows], np.append(toward, own))
            across = np.cos(toward - plane)
            side = across[np.argmax(np.round(np.abs(across), 6))]
            settled[rows] = plane if side >= 0.0 else wrap(plane + np.pi)
        return self.seen_from(settled)

    @property
    def swapped(self) -> Directions:
        """Source and detector exchanged, as for an instrument that moves the source past a detector that stands."""
        return Directions(self.theta_r, self.phi_r, self.theta_i, self.phi_i)

    def turned(self, turn: float) -> Directions:
        """The directions after the sample's x axis turned by -`turn`: both azimuths grow."""
        return Directions(self.theta_i, self.phi_i + turn, self.theta_r, self.phi_r + turn)

    @property
    def dphi(self) -> Floats:
        """phi_r - phi_i, in [0, 2 pi): 0 is the retro half-plane, pi the mirror half-plane."""
        return wrap(self.phi_r - self.phi_i)

    @property
    def signed(self) -> Floats:
        """theta_r with the sign of its side: positive on the mirror side (`in_plane_angle`)."""
        return in_plane_angle(self.theta_r, self.phi_r - self.phi_i)

    @property
    def along(self) -> Floats:
        """Angle from the normal to the detector's projection on the plane of incidence, positive on the mirror side.

        In the plane it is `signed`.
        """
        x, _, z = np.moveaxis(self.from_incidence, -1, 0)
        return np.asarray(np.arctan2(-x, z))

    @property
    def out_of_plane(self) -> Floats:
        """Angle between the detector and the plane of incidence, positive toward larger azimuths."""
        x, y, z = np.moveaxis(self.from_incidence, -1, 0)
        return np.asarray(np.arctan2(y, np.hypot(x, z)))

    @property
    def in_plane(self) -> Bools:
        """Whether the detector is in the plane of incidence, within `IN_PLANE`."""
        return np.asarray(np.abs(self.out_of_plane) <= IN_PLANE)

    @property
    def from_incidence(self) -> Floats:
        """Unit vectors toward the detector, shape (..., 3), with x toward the azimuth of the source."""
        return direction(self.theta_r, self.phi_r - self.phi_i)

    @property
    def from_mirror(self) -> Floats:
        """Unit vector toward the detector less that of the source's mirror direction, shape (..., 3)."""
        source, detector = self.vectors
        return detector - mirrored(source)

    @property
    def mirror_offset(self) -> Floats:
        """Angle between the detector and the mirror direction of the source."""
        source, detector = self.vectors
        return angle_between(mirrored(source), detector)

    @property
    def half(self) -> tuple[Floats, Floats]:
        """theta_h, between the normal and the half vector, and theta_d, between the half vector and either direction.

        At exactly opposite grazing directions there is no half vector, and theta_h is that of a rounding error.
        """
        source, detector = self.vectors
        x, y, z = np.moveaxis(source + detector, -1, 0)
        return np.asarray(np.arctan2(np.hypot(x, y), z)), 0.5 * angle_between(source, detector)

    @property
    def vectors(self) -> tuple[Floats, Floats]:
        """Unit vectors toward the source and toward the detector, shape (..., 3)."""
        return direction(self.theta_i, self.phi_i), direction(self.theta_r, self.phi_r)
