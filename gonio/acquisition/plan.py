"""What to measure: plan files, the points they stand for, and the numbered steps that a rig makes of them.

A plan knows nothing of a rig, so that one plan can run on several. `assess` says which of its points a rig can reach,
and why not the others; `schedule` makes the fixed list of steps that a run is (docs/acquisition.md).
"""

from __future__ import annotations

import csv
import functools
import hashlib
import io
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, ValidationError, field_validator, model_validator

from gonio.config import Strict, parse, read_toml
from gonio.disk import only_file
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.rig import Pose, filling
from gonio.rig.description import Band, Positive, RigDescription
from gonio.rig.kinematics import Unreachable, reach, view

ANGLES = ("theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg")
MAX_POINTS = 1_000_000
SAME_DEG = 1e-7
"""Points closer than this in every angle [deg] are one point: above rounding, and far below an encoder's step."""
GRAZING_DEG = 1e-6

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


AngleList = tuple[Angle, ...]


class Sweep(Strict):
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
        if isinstance(value, dict):
            try:
                return Range.model_validate(value).values()
            except ValidationError as error:
                item = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
                where = ".".join(map(str, item["loc"]))
                unknown = item["type"] == "extra_forbidden"
                what = "unknown key; a range has start, stop and step" if unknown else item["msg"]
                what = "is missing from the range" if item["type"] == "missing" else what
                raise ValueError(f"{where}: {what}".removeprefix(": Value error, ")) from None
        if isinstance(value, list) and not value:
            raise ValueError("the list is empty; give angles in degrees, or { start = ..., stop = ..., step = ... }")
        if not isinstance(value, list):
            raise ValueError("give a list of angles in degrees, or { start = ..., stop = ..., step = ... }")
        return value

    @field_validator("theta_i_deg")
    @classmethod
    def _incidence(cls, value: tuple[float, ...]) -> tuple[float, ...]:
        for angle in value:
            if not 0 <= angle <= 90:
                raise ValueError(f"{angle:g} deg is outside 0 to 90 deg: theta_i is counted from the normal")
        return value

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


class PointsFile(Strict):
    """Points that stand in a file of their own."""

    file: str
    """A CSV with the four angle columns, beside the plan."""


class Adaptive(Strict):
    """What a plan asks for in place of points: a chooser names them as the run grows (docs/campaigns.md).

    All keys but these two are the chooser's own, and checked by it.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    how: str
    """The chooser: an entry point of the group `gonio.choosers`."""
    budget_h: Positive
    """Rig time that the whole run may take."""

    @property
    def own(self) -> dict[str, Any]:
        """The chooser's own keys."""
        return dict(self.model_extra or {})


class PlanFile(Strict):
    """A plan.toml."""

    name: str
    wavelength_nm: tuple[Positive, ...]
    sweep: tuple[Sweep, ...] = ()
    points: tuple[PointsFile, ...] = ()
    adaptive: Adaptive | None = None

    @field_validator("wavelength_nm", mode="before")
    @classmethod
    def _some_wavelength(cls, value: object) -> object:
        if isinstance(value, list) and not value:
            raise ValueError("the list is empty; give at least one wavelength in nanometres")
        return value

    @model_validator(mode="after")
    def _something(self) -> PlanFile:
        if not self.sweep and not self.points and self.adaptive is None:
            raise ValueError("the plan has no points; add a [[sweep]] or a [[points]] table, or [adaptive]")
        return self


@dataclass(frozen=True, slots=True)
class Point:
    """A point of a plan in canonical angles [deg]: theta_i in [0, 90], theta_r in [0, 180], phi in [0, 360)."""

    theta_i_deg: float
    phi_i_deg: float
    theta_r_deg: float
    phi_r_deg: float

    @property
    def directions(self) -> Directions:
        """The directions of source and detector."""
        return Directions.from_degrees(self.theta_i_deg, self.phi_i_deg, self.theta_r_deg, self.phi_r_deg)


@dataclass(frozen=True, slots=True)
class Plan:
    """What to measure: points in the order of the plan, and wavelengths."""

    name: str
    wavelength_nm: tuple[float, ...]
    points: tuple[Point, ...]
    repeated: int
    """How many further points of the plan were the same as one before; each is measured once."""
    source: str
    adaptive: Adaptive | None = None
    """What is to be chosen beyond these points."""

    @property
    def directions(self) -> Directions:
        """Those of all points."""
        return Directions.from_degrees(*zip(*self._rows, strict=True))

    @property
    def sha256(self) -> str:
        """What tells plans apart: a hash of points and wavelengths; name, comments and layout are free."""
        return points_sha256(self.wavelength_nm, self._rows, self.adaptive)

    @property
    def _rows(self) -> list[list[float]]:
        return [[p.theta_i_deg, p.phi_i_deg, p.theta_r_deg, p.phi_r_deg] for p in self.points]

    def bands(self, description: RigDescription) -> tuple[Band, ...]:
        """The rig's bands that contain the plan's wavelengths, each once.

        Raises
        ------
        ConfigError
            A wavelength lies in no band of the rig.
        """
        try:
            return tuple(dict.fromkeys(description.bands.containing(w) for w in self.wavelength_nm))
        except ConfigError as error:
            raise ConfigError(f"{self.source}: {error}") from None


def points_sha256(wavelength_nm: Sequence[float], rows: list[list[float]], adaptive: Adaptive | None = None) -> str:
    """The hash of wavelengths and points, the four angles [deg] of each; see `Plan.sha256`."""
    content: list[Any] = [list(wavelength_nm), rows]
    if adaptive is not None:
        content.append(adaptive.model_dump(mode="json"))
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Assessed:
    """A point as one rig sees it: its pose, or why there is none."""

    point: Point
    pose: Pose | None
    flag: str = ""
    reason: str = ""
    cause: str = ""
    """The reason without the numbers of this one point."""


def load_plan(path: str | Path) -> Plan:
    """Read and check a plan.toml and the point lists that it names.

    Raises
    ------
    ConfigError
        A file is missing or wrong; the message names file, key, value and remedy.
    """
    path = Path(path)
    file = parse(PlanFile, read_toml(path), path)
    listed = [point for table in file.points for point in read_points(path.parent / table.file)]
    count = sum(sweep.count for sweep in file.sweep) + len(listed)
    if count > MAX_POINTS:
        raise ConfigError(f"{path}: the plan has {count} points; at most {MAX_POINTS} fit into one run")
    every = [point for sweep in file.sweep for point in _combinations(sweep)] + listed
    first: dict[tuple[int, ...], Point] = {}
    for point in every:
        first.setdefault(_identity(point), point)
    repeated = len(every) - len(first)
    return Plan(file.name, file.wavelength_nm, tuple(first.values()), repeated, str(path), file.adaptive)


def read_points(path: Path) -> list[Point]:
    """The points of a CSV with the columns theta_i_deg, phi_i_deg, theta_r_deg, phi_r_deg.

    A column `side` says which are transmission, as in a measurement table; others are passed over.

    Raises
    ------
    ConfigError
        The file is missing, a column is missing, or an angle is not a number or out of range (with its line).
    """
    try:
        with open(path, encoding="utf-8-sig", opener=only_file) as file:
            text = file.read()
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file (a plan's `file` is looked up beside the plan)") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as a table of points: {error}") from None
    lines = csv.DictReader(io.StringIO(text), skipinitialspace=True)
    try:
        return _points_of(path, lines)
    except csv.Error as error:
        raise ConfigError(f"{path}: line {lines.line_num}: cannot be read as a table of points: {error}") from None


def _points_of(path: Path, lines: csv.DictReader[str]) -> list[Point]:
    columns = [name.strip() for name in lines.fieldnames or ()]
    for name in ANGLES:
        if name not in columns:
            raise ConfigError(
                f"{path}: the column {name} is missing; a list of points needs {', '.join(ANGLES)}, in degrees"
            )
        if columns.count(name) > 1:
            raise ConfigError(f"{path}: the column {name} is there {columns.count(name)} times")
    lines.fieldnames = columns
    if columns.count("side") > 1:
        raise ConfigError(f"{path}: the column side is there {columns.count('side')} times")
    points = []
    for row in lines:
        values = {}
        side = (row.get("side") or "reflection").strip()
        if side not in ("reflection", "transmission"):
            raise ConfigError(f"{path}: line {lines.line_num}: side = {side[:40]!r}; reflection or transmission")
        behind = side == "transmission"
        for name in ANGLES:
            try:
                values[name] = float(row[name])
            except (TypeError, ValueError):
                values[name] = math.nan
            limit = 180.0 if behind and name == "theta_r_deg" else 90.0 if name.startswith("theta") else 360.0
            if not abs(values[name]) <= limit:
                hint = '; behind the sample, write transmission into a column "side"' if name == "theta_r_deg" else ""
                raise ConfigError(
                    f"{path}: line {lines.line_num}: {name} = {row[name]!r}; "
                    f"allowed are numbers from {-limit:g} to {limit:g}" + (hint if abs(values[name]) <= 180.0 else "")
                )
        if behind and abs(values["theta_r_deg"]) <= 90.0:
            raise ConfigError(
                f"{path}: line {lines.line_num}: theta_r_deg = {row['theta_r_deg']!r} is not behind the sample, and "
                'side = "transmission": it lies beyond 90, up to 180'
            )
        points.append(canonical(*values.values()))
    if not points:
        raise ConfigError(f"{path}: holds no points")
    return points


def assess(plan: Plan, description: RigDescription) -> list[Assessed]:
    """Every point of the plan, in order, with its pose on a rig, or with the flag and the reason why it has none."""
    out = []
    for point in plan.points:
        try:
            if point.theta_i_deg > 90.0 - GRAZING_DEG:
                raise Unreachable("grazing", "theta_i = 90 deg: no light falls on the sample")
            if abs(point.theta_r_deg - 90.0) < GRAZING_DEG:
                raise Unreachable("grazing", "theta_r = 90 deg: the sample is seen edge-on")
            pose = reach(description, point.directions)
            if description.lamp.beam_diameter_mm is not None:
                why = filling.cut(description, view(description, pose))
                if why:
                    raise Unreachable("partly_filled", why, "the beam's edge cuts through the region of interest")
            out.append(Assessed(point, pose))
        except Unreachable as error:
            out.append(Assessed(point, None, error.flag, str(error), error.cause))
    return out


def count_reasons(points: list[Assessed]) -> list[tuple[tuple[str, str], int]]:
    """How many points are not measured for which (flag, cause), the most frequent first."""
    return Counter((a.flag, a.cause) for a in points if a.pose is None).most_common()


def _combinations(sweep: Sweep) -> list[Point]:
    """In plane: a scan of theta_r for each theta_i. Out of plane: for each theta_i and dphi a scan of theta_r."""
    if sweep.dphi_deg is None:
        return [canonical(i, 0.0, r, 180.0) for i in sweep.theta_i_deg for r in sweep.theta_r_deg]
    return [canonical(i, 0.0, r, d) for i in sweep.theta_i_deg for d in sweep.dphi_deg for r in sweep.theta_r_deg]


def canonical(theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> Point:
    """Signed angles [deg] to theta not negative and phi in [0, 360): (-theta, phi) is (theta, phi + 180)."""
    phi_i, phi_r = phi_i + 180.0 * (theta_i < 0), phi_r + 180.0 * (theta_r < 0)
    return Point(abs(theta_i), _turn(phi_i), abs(theta_r), _turn(phi_r))


@functools.lru_cache(4096)  # a sweep has few azimuths
def _turn(phi: float) -> float:
    out = round(phi % 360.0, 9)
    return out if out < 360.0 else 0.0


def _identity(point: Point) -> tuple[int, ...]:
    """Equal for points with the same directions; along the normal the azimuth means nothing."""
    i, pi = round(point.theta_i_deg / SAME_DEG), round(point.phi_i_deg / SAME_DEG)
    r, pr = round(point.theta_r_deg / SAME_DEG), round(point.phi_r_deg / SAME_DEG)
    turn = round(360.0 / SAME_DEG)
    return (i, pi % turn if i else 0, r, pr % turn if r else 0)
