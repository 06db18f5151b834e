"""The tables of a plan file that name angles one by one: sweeps, and lists of points in a file of their own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from gonio.config import Strict

MAX_POINTS = 1_000_000
ANGLES = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")
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
    """So many angles [deg], both ends included, that may lie closer at the start."""

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


AngleList = tuple[Angle, ...]


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
            what = f"unknown key; a range has {' and '.join(_keys(kind))}" if unknown else item["msg"]
            what = "is missing from the range" if item["type"] == "missing" else what
            raise ValueError(f"{where}: {what.removeprefix('Value error, ')}".removeprefix(": ")) from None
    if isinstance(value, list) and not value:
        raise ValueError(f"the list is empty; give angles in degrees, or {how}")
    if not isinstance(value, list):
        raise ValueError(f"give a list of angles in degrees, or {how}")
    return value


def _keys(kind: type[Strict]) -> list[str]:
    """Its keys, the last two as people join them."""
    *first, last = kind.model_fields
    return [", ".join(first), last]


def require_incidence(angles: tuple[float, ...]) -> tuple[float, ...]:
    """Raise `ValueError` where an angle of incidence is outside its range."""
    for angle in angles:
        if not 0 <= angle <= 90:
            raise ValueError(f"{angle:g} deg is outside 0 to 90 deg: theta_i is counted from the normal")
    return angles


class Repeated(Strict):
    """A table of points that may be measured several times."""

    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    """How often each point is measured. Its visits are spread over the run."""


class Sweep(Repeated):
    """Every combination of its angles; in the plane of incidence unless `dphi_deg` is given."""

    theta_i_deg: AngleList
    theta_r_deg: AngleList
    """Without `dphi_deg` signed: positive on the mirror side, negative on the retro side."""
    dphi_deg: AngleList | None = None
    """phi_r - phi_i: 0 is retro, 180 the mirror half-plane. A negative theta_r lies on the opposite side."""
    side: Literal["reflection", "transmission"] = "reflection"
    """Of transmission theta_r goes on beyond the horizon, from 90 to 180 in size: 180 is behind, along the normal."""

    @property
    def count(self) -> int:
        """How many points it stands for."""
        return len(self.theta_i_deg) * len(self.theta_r_deg) * (1 if self.dphi_deg is None else len(self.dphi_deg))

    @model_validator(mode="before")
    @classmethod
    def _light_at_azimuth_0(cls, value: object) -> object:
        if isinstance(value, dict) and "phi_i_deg" in value:
            raise ValueError(
                "phi_i_deg: the light of a sweep stands at azimuth 0. For other azimuths of incidence name a table "
                'of points: [[points]] with file = "points.csv" and the columns ' + ", ".join(ANGLES)
            )
        return value

    @field_validator("theta_i_deg", "theta_r_deg", "dphi_deg", mode="before")
    @classmethod
    def _expanded(cls, value: object) -> object:
        return angles_of(value)

    @field_validator("theta_i_deg")
    @classmethod
    def _incidence(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        return require_incidence(value)

    @model_validator(mode="after")
    def _on_its_side(self) -> Sweep:
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

    @field_validator("dphi_deg")
    @classmethod
    def _azimuth(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        for angle in value or ():
            if not -360 <= angle <= 360:
                raise ValueError(f"{angle:g} deg is outside -360 to 360 deg")
        return value

    def rows(self) -> Iterator[Row]:
        """In plane: a scan of theta_r for each theta_i. Out of plane: for each theta_i and dphi a scan of theta_r."""
        for i in self.theta_i_deg:
            for d in (180.0,) if self.dphi_deg is None else self.dphi_deg:
                yield from ((i, 0.0, r, d) for r in self.theta_r_deg)


class PointsFile(Repeated):
    """Points that stand in a file of their own."""

    file: str
    """A CSV with the four angle columns, beside the plan."""
