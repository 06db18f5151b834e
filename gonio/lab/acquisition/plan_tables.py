"""The tables of a plan file: sweeps, grids over the hemisphere and in half vectors, and lists of points in a file.

Grids lie around a light at azimuth 0, and both sides of the plane of incidence are alike.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from gonio.config import Strict
from gonio.geometry import (
    ANGLES_DEG,
    AT_HORIZON,
    EXACTLY_IN_PLANE,
    angles,
    direction,
    half_angle_of_cone,
    solid_angle_of_cone,
)
from gonio.typing import Bools, Floats

Side = Literal["reflection", "transmission"]
DIGITS = 12
"""Digits of the angles of grids in degrees: 40.0 and not 39.99999999999999, at 2e-14 rad."""
MAX_POINTS = 1_000_000
Row = tuple[float, float, float, float]
"""The four angles of a point [deg]; a theta may be negative, which is the other side of the normal."""

Angle = Annotated[float, Field(strict=True)]
"""A number [deg]: neither a truth value nor text that looks like one."""


class Range(Strict):
    """Equally spaced angles [deg], both ends included where the step meets them."""

    start: Angle
    stop: Angle
    step: Annotated[Angle, Field(gt=0)]

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        if self.stop < self.start:
            raise ValueError("a range needs start <= stop")
        if (self.stop - self.start) / self.step > MAX_POINTS:
            raise ValueError(f"a range of more than {MAX_POINTS} angles; take a larger step")
        return self

    def values(self) -> list[float]:
        """The angles, free of accumulated rounding."""
        count = math.floor((self.stop - self.start) / self.step * (1 + 1e-12) + 1e-9) + 1
        return [round(self.start + k * self.step, 9) for k in range(count)]


class Spaced(Strict):
    """`count` angles [deg], both ends included; they may lie closer at the start."""

    start: Angle = 0.0
    stop: Angle
    count: Annotated[int, Field(ge=2, le=MAX_POINTS)]
    spacing: Literal["even", "square", "log"] = "even"
    """"square": the distance from the start grows with the square of the angle's number, so that steps grow evenly.
    "log": each angle is the same multiple of the one before."""

    @model_validator(mode="after")
    def _ordered(self) -> Spaced:
        if self.stop <= self.start:
            raise ValueError("start < stop is needed")
        if self.spacing == "log" and self.start <= 0.0:
            raise ValueError('spacing = "log" needs a start above 0; from 0 on take spacing = "square"')
        return self

    def values(self) -> list[float]:
        """The angles."""
        shares = [k / (self.count - 1) for k in range(self.count)]
        if self.spacing == "log":
            inner = [self.start * (self.stop / self.start) ** share for share in shares[1:-1]]
        else:
            power = 2 if self.spacing == "square" else 1
            inner = [self.start + (self.stop - self.start) * share**power for share in shares[1:-1]]
        return [self.start, *(round(angle, 9) for angle in inner), self.stop]


def angles_of(value: object, *, spaced: bool = False) -> object:
    """The list that a key's value stands for: a list of angles, or a table of `Range` or (where `spaced`) `Spaced`.

    Raises
    ------
    ValueError
        It is none of them; the message says what is wrong with it.
    """
    how = "{ start = ..., stop = ..., step = ... }"
    if spaced:
        how += ', or { start = ..., stop = ..., count = ..., spacing = "even", "square" or "log" }'
    if isinstance(value, dict):
        by_count = spaced and bool(value.keys() & {"count", "spacing"}) and "step" not in value
        kind: type[Range | Spaced] = Spaced if by_count else Range
        try:
            return kind.model_validate(value).values()
        except ValidationError as error:
            item = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
            where = ".".join(map(str, item["loc"]))
            unknown = item["type"] == "extra_forbidden"
            *first, last = kind.model_fields
            what = f"unknown key; a range has {', '.join(first)} and {last}" if unknown else item["msg"]
            what = "is missing from the range" if item["type"] == "missing" else what
            raise ValueError(f"{where}: {what.removeprefix('Value error, ')}".removeprefix(": ")) from None
    if isinstance(value, list) and not value:
        raise ValueError(f"the list is empty; give angles in degrees, or {how}")
    if not isinstance(value, list):
        raise ValueError(f"give a list of angles in degrees, or {how}")
    return value


def _in_range(lowest: float, highest: float, hint: str = "") -> AfterValidator:
    """Every angle of a list lies in a range [deg]."""

    def check(value: tuple[float, ...]) -> tuple[float, ...]:
        for angle in value:
            if not lowest <= angle <= highest:
                raise ValueError(f"{angle:g} deg is outside {lowest:g} to {highest:g} deg{hint}")
        return value

    return AfterValidator(check)


Angles = Annotated[tuple[Angle, ...], BeforeValidator(angles_of)]
SpacedAngles = Annotated[tuple[Angle, ...], BeforeValidator(partial(angles_of, spaced=True))]
AnglesOfIncidence = Annotated[Angles, _in_range(0, 90, ": theta_i is counted from the normal")]
HALF_VECTORS = (
    ": theta_h is counted from the normal; the sides are told by phi_h_deg, 0 toward the light and 180 away from it"
)


class Repeated(Strict):
    """A table of points that may be measured several times."""

    below: ClassVar[int] = 0
    """How many of its directions no light can take."""

    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    """How often each point is measured. Its visits are spread over the run."""


class Sweep(Repeated):
    """Every combination of its angles; in the plane of incidence unless `dphi_deg` is given."""

    theta_i_deg: AnglesOfIncidence
    theta_r_deg: Angles
    """Without `dphi_deg` signed: positive on the mirror side, negative on the retro side."""
    dphi_deg: Annotated[Angles, _in_range(-360, 360)] | None = None
    """phi_r - phi_i: 0 is retro, 180 the mirror half-plane. A negative theta_r lies on the opposite side."""
    tilt_deg: Annotated[Angles, _in_range(-90, 90)] | None = None
    """The sample leans so far out of the plane of the arms, at which `theta_i_deg` and `theta_r_deg` stand: directions
    out of plane that a tilt alone reaches. Azimuths are those that the sample sees."""
    side: Side = "reflection"
    """In transmission theta_r goes on beyond the horizon, from 90 to 180 in size: 180 is behind, along the normal."""

    @property
    def size(self) -> int:
        """How many points it stands for."""
        return len(self.theta_i_deg) * len(self.theta_r_deg) * len(self.dphi_deg or self.tilt_deg or (0.0,))

    @model_validator(mode="before")
    @classmethod
    def _light_at_azimuth_0(cls, value: object) -> object:
        if isinstance(value, dict) and "phi_i_deg" in value:
            raise ValueError(
                "phi_i_deg: the light of a sweep stands at azimuth 0. For other azimuths of incidence name a table "
                'of points: [[points]] with file = "points.csv" and the columns ' + ", ".join(ANGLES_DEG)
            )
        return value

    @model_validator(mode="after")
    def _on_its_side(self) -> Sweep:
        if self.tilt_deg is not None and (self.dphi_deg is not None or self.side != "reflection"):
            raise ValueError("tilt_deg goes with theta_i_deg and theta_r_deg alone, and with reflection")
        for angle in self.theta_r_deg:
            if self.side == "reflection" and not -90 <= angle <= 90:
                raise ValueError(
                    f"theta_r_deg: {angle:g} deg is outside -90 to 90 deg: theta_r is counted from the normal, "
                    "positive on the mirror side"
                    + ('; behind the sample, say side = "transmission"' if abs(angle) <= 180 else "")
                )
            if self.side == "transmission" and not 90 < abs(angle) <= 180:
                raise ValueError(
                    f'theta_r_deg: {angle:g} deg is not behind the sample: with side = "transmission" it lies beyond '
                    "90, up to 180 deg in size"
                )
        return self

    def rows(self) -> Iterator[Row]:
        """In plane: a scan of theta_r for each theta_i. Out of plane: for each theta_i and dphi a scan of theta_r."""
        for tilt in self.tilt_deg or ():
            for i in self.theta_i_deg:
                yield from (_leaning(tilt, i, r) for r in self.theta_r_deg)
        if self.tilt_deg is not None:
            return
        for i in self.theta_i_deg:
            for d in (180.0,) if self.dphi_deg is None else self.dphi_deg:
                yield from ((i, 0.0, r, d) for r in self.theta_r_deg)


def _leaning(tilt_deg: float, light_deg: float, camera_deg: float) -> Row:
    """What a sample sees whose normal leans by a tilt toward +y; the camera is positive on the mirror side."""
    tilt, light, camera = np.radians([tilt_deg, light_deg, -camera_deg])
    ends = np.array([
        [math.sin(arm), -math.sin(tilt) * math.cos(arm), math.cos(tilt) * math.cos(arm)] for arm in (light, camera)
    ])  # fmt: skip
    (theta_i, theta_r), (phi_i, phi_r) = np.degrees(angles(ends)).round(DIGITS).tolist()
    return theta_i, phi_i, theta_r, phi_r


class PointsFile(Repeated):
    """Points that stand in a file of their own."""

    file: str
    """A CSV with the four angle columns, beside the plan."""


class Hemisphere(Repeated):
    """Directions of the detector that share the hemisphere, or a cap of it, evenly: each has the same solid angle.

    Around the pole lie rings of equal parts (Leopardi 2006). Each ring has a point in the half-plane of the mirror.
    """

    theta_i_deg: AnglesOfIncidence
    count: Annotated[int, Field(ge=1, le=MAX_POINTS)] | None = None
    """Directions for each angle of incidence."""
    step_deg: Annotated[float, Field(ge=0.01, le=90)] | None = None
    """Instead of `count`: about so far apart; each direction has the solid angle of a square with this side."""
    theta_r_max_deg: Annotated[float, Field(gt=0, le=90)] = 90.0
    """Half-angle of the cap. Its parts reach to there, and their middles, where the points lie, not quite."""
    side: Side = "reflection"
    """In transmission the cap lies around the direction behind the sample."""

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

    def rows(self) -> Iterator[Row]:
        """A ring after the other, from the pole, for each theta_i."""
        detector = _in_degrees(*even_cap(self.each, math.radians(self.theta_r_max_deg)), self.side)
        for i in self.theta_i_deg:
            yield from ((i, 0.0, r, p) for r, p in detector)


class HalfVector(Repeated):
    """Directions of the detector by the half vector of source and detector: dense where the list of theta_h is.

    theta_h = 0 is the mirror direction. phi_h is counted as phi_r is: at 180 the half vector leans away from the light,
    and the detector stands beyond the mirror direction. Half vectors that no detector above the horizon has are left
    out, and counted (`below`).
    """

    theta_i_deg: AnglesOfIncidence
    theta_h_deg: Annotated[SpacedAngles, _in_range(0, 90, HALF_VECTORS)]
    """Angle between the normal and the half vector, 0 to 90. In plane the detector is twice as far from the mirror
    direction."""
    phi_h_deg: Annotated[SpacedAngles, _in_range(-360, 360)] = (0.0, 180.0)
    """Azimuth of the half vector less that of the light. By default in the plane of incidence, on both sides."""
    side: Side = "reflection"
    """In transmission the detector's direction is mirrored at the surface: theta_h = 0 is straight through."""

    @property
    def size(self) -> int:
        """How many half vectors it stands for, those that no detector has included."""
        return len(self.theta_i_deg) * len(self.theta_h_deg) * len(self.phi_h_deg)

    @property
    def below(self) -> int:  # type: ignore[override]
        """How many of its directions no light can take, because they lie below the horizon."""
        return sum(int(np.count_nonzero(~above)) for _, _, _, above in self._each())

    def rows(self) -> Iterator[Row]:
        """For each theta_i and phi_h a scan of theta_h; the mirror direction once for each theta_i."""
        for i, theta, phi, above in self._each():
            yield from ((i, 0.0, r, p) for r, p in _in_degrees(theta[above], phi[above], self.side))

    def _each(self) -> Iterator[tuple[float, Floats, Floats, Bools]]:
        """For each theta_i: theta_r and phi_r [rad] of all half vectors, and which of them are above the horizon."""
        pairs = [(h, p) for k, p in enumerate(self.phi_h_deg) for h in self.theta_h_deg if h or not k]
        half = direction(*np.radians(np.array(pairs)).T)
        for i in self.theta_i_deg:
            light = direction(math.radians(i), 0.0)
            cosine = half @ light
            detector = 2.0 * cosine[:, None] * half - light
            theta, phi = angles(detector)
            phi = np.where(theta > EXACTLY_IN_PLANE, phi, np.pi)  # along the normal there is no azimuth
            yield i, theta, phi, (cosine > 0.0) & (detector[:, 2] > AT_HORIZON)


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


def _in_degrees(theta: Floats, phi: Floats, side: Side) -> list[tuple[float, float]]:
    """Polar angles and azimuths in [0, 360) [deg]; of transmission those mirrored at the surface."""
    polar = np.degrees(theta)
    polar = np.round(180.0 - polar if side == "transmission" else polar, DIGITS)
    return list(zip(polar.tolist(), (np.round(np.degrees(phi), DIGITS) % 360.0).tolist(), strict=True))
