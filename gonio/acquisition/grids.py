"""The tables of a plan file that stand for grids of directions: over the hemisphere, and in half vectors.

All lie around a light at azimuth 0, and both sides of the plane of incidence are alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, field_validator, model_validator

from gonio.acquisition.sweeps import MAX_POINTS, AngleList, Repeated, Row, angles_of, require_incidence
from gonio.geometry import AT_HORIZON, EXACTLY_IN_PLANE, angles, direction, half_angle_of_cone, solid_angle_of_cone
from gonio.typing import Floats

Side = Literal["reflection", "transmission"]
Flags = npt.NDArray[np.bool_]
DIGITS = 12
"""Of angles in degrees: 40.0 and not 39.99999999999999, at 2e-14 rad."""


class Hemisphere(Repeated):
    """Directions of the detector that share the hemisphere, or a cap of it, evenly: each has the same solid angle.

    Around the pole lie rings of equal parts (Leopardi 2006). Each ring has a point in the half-plane of the mirror.
    """

    theta_i_deg: AngleList
    count: Annotated[int, Field(ge=1, le=MAX_POINTS)] | None = None
    """Directions for each angle of incidence."""
    step_deg: Annotated[float, Field(ge=0.01, le=90)] | None = None
    """Instead of `count`: about so far apart; each direction has the solid angle of a square with this side."""
    theta_r_max_deg: Annotated[float, Field(gt=0, le=90)] = 90.0
    """Half-angle of the cap. Its parts reach to there, and their middles, where the points lie, not quite."""
    side: Side = "reflection"
    """Of transmission the cap lies around the direction behind the sample."""

    @field_validator("theta_i_deg", mode="before")
    @classmethod
    def _expanded(cls, value: object) -> object:
        return angles_of(value)

    @field_validator("theta_i_deg")
    @classmethod
    def _incidence(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return require_incidence(value)

    @model_validator(mode="after")
    def _one_density(self) -> Hemisphere:
        if (self.count is None) == (self.step_deg is None):
            given = "both are there" if self.count is not None else "neither is there"
            raise ValueError(f"a hemisphere needs one of count and step_deg; {given}")
        return self

    @property
    def each(self) -> int:
        """How many directions there are for each angle of incidence."""
        if self.count is not None:
            return self.count
        assert self.step_deg is not None
        whole = float(solid_angle_of_cone(math.radians(self.theta_r_max_deg)))
        return max(1, round(whole / math.radians(self.step_deg) ** 2))

    @property
    def size(self) -> int:
        """How many points it stands for."""
        return len(self.theta_i_deg) * self.each

    @property
    def below(self) -> int:
        """How many of its directions no light can take."""
        return 0

    def rows(self) -> Iterator[Row]:
        """A ring after the other, from the pole, for each theta_i."""
        theta, phi = even_cap(self.each, math.radians(self.theta_r_max_deg))
        detector = list(zip(_polar(theta, self.side), _azimuths(phi), strict=True))
        for i in self.theta_i_deg:
            yield from ((i, 0.0, r, p) for r, p in detector)


class HalfVector(Repeated):
    """Directions of the detector by the half vector of source and detector: dense where the list of theta_h is.

    theta_h = 0 is the mirror direction. phi_h is counted as phi_r is: at 180 the half vector leans away from the light,
    and the detector stands beyond the mirror direction. Half vectors that no detector above the horizon has are left
    out, and counted (`below`).
    """

    theta_i_deg: AngleList
    theta_h_deg: AngleList
    """Angle between the normal and the half vector, 0 to 90. In plane the detector is twice as far from the mirror
    direction."""
    phi_h_deg: AngleList = (0.0, 180.0)
    """Azimuth of the half vector less that of the light. By default in the plane of incidence, on both sides."""
    side: Side = "reflection"
    """Of transmission the detector's direction is mirrored at the surface: theta_h = 0 is straight through."""

    @field_validator("theta_i_deg", mode="before")
    @classmethod
    def _expanded(cls, value: object) -> object:
        return angles_of(value)

    @field_validator("theta_h_deg", "phi_h_deg", mode="before")
    @classmethod
    def _spaced(cls, value: object) -> object:
        return angles_of(value, spaced=True)

    @field_validator("theta_i_deg")
    @classmethod
    def _incidence(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return require_incidence(value)

    @field_validator("theta_h_deg")
    @classmethod
    def _polar(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        for angle in value:
            if not 0 <= angle <= 90:
                raise ValueError(
                    f"{angle:g} deg is outside 0 to 90 deg: theta_h is counted from the normal; the sides are told by "
                    "phi_h_deg, 0 toward the light and 180 away from it"
                )
        return value

    @field_validator("phi_h_deg")
    @classmethod
    def _azimuth(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        for angle in value:
            if not -360 <= angle <= 360:
                raise ValueError(f"{angle:g} deg is outside -360 to 360 deg")
        return value

    @property
    def size(self) -> int:
        """How many half vectors it stands for, those that no detector has included."""
        return len(self.theta_i_deg) * len(self.theta_h_deg) * len(self.phi_h_deg)

    @property
    def below(self) -> int:
        """How many of its directions no light can take, because they lie below the horizon."""
        return sum(int(np.count_nonzero(~above)) for _, _, _, above in self._each())

    def rows(self) -> Iterator[Row]:
        """For each theta_i and phi_h a scan of theta_h; the mirror direction once for each theta_i."""
        for i, theta, phi, above in self._each():
            kept = zip(_polar(theta[above], self.side), _azimuths(phi[above]), strict=True)
            yield from ((i, 0.0, r, p) for r, p in kept)

    def _each(self) -> Iterator[tuple[float, Floats, Floats, Flags]]:
        """For each theta_i: theta_r and phi_r [rad] of all half vectors, and which of them are above the horizon."""
        pairs = [(h, p) for k, p in enumerate(self.phi_h_deg) for h in self.theta_h_deg if h or not k]
        half = direction(*np.radians(np.array(pairs)).T)
        for i in self.theta_i_deg:
            theta, phi, above = detector_of(math.radians(i), half)
            yield i, theta, phi, above


def detector_of(theta_i: float, half: Floats) -> tuple[Floats, Floats, Flags]:
    """Where the detector stands for half vectors: theta_r, phi_r [rad], and which of them are above the horizon.

    Parameters
    ----------
    theta_i
        Angle of incidence [rad]; the light stands at azimuth 0.
    half
        Unit vectors, shape (n, 3).
    """
    light = direction(theta_i, 0.0)
    cosine = half @ light
    detector = 2.0 * cosine[:, None] * half - light
    theta, phi = angles(detector)
    phi = np.where(theta > EXACTLY_IN_PLANE, phi, np.pi)  # along the normal there is no azimuth
    return theta, phi, (cosine > 0.0) & (detector[:, 2] > AT_HORIZON)


def even_cap(count: int, half_angle: float) -> tuple[Floats, Floats]:
    """Polar angles and azimuths [rad] of `count` directions that share a cap around the pole evenly.

    The cap is cut into `count` parts of one solid angle: a round one at the pole, and rings that are cut into equal
    parts, as square as whole numbers allow. A direction lies in the middle of its part; the first of each ring at the
    azimuth pi. Leopardi 2006, section 3.

    Parameters
    ----------
    count
        At least 1.
    half_angle
        Of the cap [rad, above 0 to pi/2].
    """
    part = float(solid_angle_of_cone(half_angle)) / count
    pole = float(half_angle_of_cone(part))
    rings = max(1, round((half_angle - pole) / math.sqrt(part))) if count > 1 else 0
    theta, phi, placed, owed = [np.zeros(1)], [np.full(1, np.pi)], 1, 0.0
    edges = solid_angle_of_cone(np.linspace(pole, half_angle, rings + 1)) / part
    for ring in range(rings):
        wanted = float(edges[ring + 1] - edges[ring]) + owed
        number = round(wanted) if ring < rings - 1 else count - placed
        owed = wanted - number
        if number:
            middle = float(half_angle_of_cone((placed + number / 2.0) * part))
            theta.append(np.full(number, middle))
            phi.append(np.pi + 2.0 * np.pi * np.arange(number) / number)
        placed += number
    return np.concatenate(theta), np.concatenate(phi)


def _polar(theta: Floats, side: Side) -> list[float]:
    """Polar angles in degrees; of transmission those of the directions that are mirrored at the surface."""
    degrees = np.degrees(theta)
    return list(map(float, np.round(180.0 - degrees if side == "transmission" else degrees, DIGITS)))


def _azimuths(phi: Floats) -> list[float]:
    """Azimuths in degrees, in [0, 360)."""
    return list(map(float, np.round(np.degrees(phi), DIGITS) % 360.0))
