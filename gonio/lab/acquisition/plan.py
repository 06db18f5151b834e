"""What to measure: plan files, the points they stand for, and the numbered steps that a rig makes of them.

A plan knows nothing of a rig, so that one plan can run on several. `assess` says which of its points a rig can reach,
and why not the others; `schedule` makes the fixed list of steps that a run begins with (docs/acquisition.md).
"""

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

from pydantic import ConfigDict, Field, ValidationInfo, field_validator, model_validator

from gonio.config import Positive, Strict, parse, read_toml
from gonio.disk import only_file
from gonio.errors import ConfigError
from gonio.geometry import ANGLES_DEG, Directions
from gonio.lab.acquisition.plan_tables import MAX_POINTS, HalfVector, Hemisphere, PointsFile, Repeated, Sweep
from gonio.lab.rig import Pose, regions
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.inverse_kinematics import Unreachable, reach
from gonio.lab.rig.kinematics import directions, view
from gonio.lab.rig.laboratory import Laboratory
from gonio.lab.rig.light_and_camera import Band
from gonio.lab.rig.polarisers import in_states, letters
from gonio.polarisation import UNPOLARISED
from gonio.typing import TomlTable

SAME_DEG = 1e-7
"""Points closer than this in every angle [deg] are one point: above rounding, and far below an encoder's step."""
GRAZING_DEG = 1e-6
PLAN_COLUMNS = ["point", *ANGLES_DEG, "flag", "reason"]
"""Columns of a plan.csv."""


class Adaptive(Strict):
    """What a plan asks for in place of points: a sampler names them as the run grows (docs/adaptive_sweeps.md).

    All keys but these two are the sampler's own, and checked by it.
    """

    model_config = ConfigDict(extra="allow", frozen=True)

    how: str
    """The sampler: an entry point of the group `gonio.choosers`."""
    budget_h: Positive
    """Rig time that the whole run may take."""

    @property
    def own(self) -> TomlTable:
        """The sampler's own keys."""
        return dict(self.model_extra or {})


Order = Literal["as-written", "short"]


class PlanFile(Strict):
    """A plan.toml."""

    name: str
    wavelength_nm: tuple[Positive, ...]
    polarisation: tuple[str, ...] = ()
    """States of light and analyser (`gonio.polarisation`), all of them at each point; none: unpolarised."""
    order: Order = "as-written"
    """"short": the rig's travel is made short (`gonio.lab.acquisition.duration`)."""
    reference_every: Annotated[int, Field(ge=0)] | None = None
    """Points between two visits to the white reference, in place of the rig file's `reference.every`."""
    sweep: tuple[Sweep, ...] = ()
    half_vector: tuple[HalfVector, ...] = ()
    hemisphere: tuple[Hemisphere, ...] = ()
    points: tuple[PointsFile, ...] = ()
    adaptive: Adaptive | None = None
    laboratory: Laboratory | None = None

    @field_validator("wavelength_nm", mode="before")
    @classmethod
    def _some_wavelength(cls, value: object) -> object:
        if isinstance(value, list) and not value:
            raise ValueError("the list is empty; give at least one wavelength in nanometres")
        return value

    @field_validator("polarisation", mode="before")
    @classmethod
    def _states(cls, value: object) -> object:
        value = [value] if isinstance(value, str) else value
        if isinstance(value, list):
            for word in value:
                if value.count(word) > 1:
                    raise ValueError(f'"{word}" is there {value.count(word)} times; name each state once')
        return value

    @field_validator("sweep", "half_vector", "hemisphere", "points", mode="before")
    @classmethod
    def _several(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, dict):
            raise ValueError(f"a plan has any number of these tables: write [[{info.field_name}]], in two brackets")
        return value

    @model_validator(mode="after")
    def _something(self) -> "PlanFile":
        if not (self.sweep or self.half_vector or self.hemisphere or self.points or self.adaptive):
            raise ValueError(
                "the plan has no points; add a [[sweep]], [[half_vector]], [[hemisphere]] or [[points]] table, or "
                "[adaptive]"
            )
        if self.adaptive and self.polarisation:
            raise ValueError("polarisation: a sampler ([adaptive]) chooses for unpolarised light; leave one out")
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
    """What to measure: points in the order of the plan, and wavelengths; a point with `repeats` stands there for each
    visit.
    """

    name: str
    wavelength_nm: tuple[float, ...]
    points: tuple[Point, ...]
    repeated: int
    """How many further points of the plan were the same as one before; each is measured once."""
    source: str
    adaptive: Adaptive | None = None
    """What is to be chosen beyond these points."""
    order: Order = "as-written"
    reference_every: int | None = None
    """Points between two visits to the white reference; None: as the rig file says."""
    below_horizon: int = 0
    """How many directions of half-vector grids were left out because no light can take them."""
    laboratory: Laboratory | None = None
    """Who measures what, for records; no part of what tells plans apart."""
    polarisation: tuple[str, ...] = ()
    """States of light and analyser that every point is measured in; none: unpolarised."""

    @property
    def directions(self) -> Directions:
        """Those of all points."""
        return Directions.from_degrees(*zip(*self._rows, strict=True))

    @property
    def sha256(self) -> str:
        """What tells plans apart: a hash of points and wavelengths; name, comments and layout are free."""
        return points_sha256(self.wavelength_nm, self._rows, self.adaptive, self.polarisation)

    @property
    def _rows(self) -> list[list[float]]:
        return [[p.theta_i_deg, p.phi_i_deg, p.theta_r_deg, p.phi_r_deg] for p in self.points]

    def bands(self, description: RigDescription) -> tuple[Band, ...]:
        """The rig's bands that contain the plan's wavelengths, each once; each in every state of polarisation.

        Raises
        ------
        ConfigError
            A wavelength lies in no band of the rig, or its polarisers cannot do a state.
        """
        try:
            for word in self.polarisation or (UNPOLARISED,):
                description.polarisers.require(word)
                if description.reference.how == "beam" and "u" not in letters(word):
                    raise ConfigError(
                        f'polarisation = "{word}": with reference.how = "beam" the camera looks into the lamp through '
                        "both polarisers, which tells nothing of a white; take a white reference"
                    )
            bands = tuple(dict.fromkeys(description.bands.containing(w) for w in self.wavelength_nm))
            return in_states(bands, self.polarisation)
        except ConfigError as error:
            raise ConfigError(f"{self.source}: {error}") from None


def points_sha256(
    wavelength_nm: Sequence[float],
    rows: list[list[float]],
    adaptive: Adaptive | None = None,
    states: Sequence[str] = (),
) -> str:
    """The hash of wavelengths, of points, the four angles [deg] of each, and of states; see `Plan.sha256`."""
    content: list[Any] = [list(wavelength_nm), rows]
    if adaptive is not None:
        content.append(adaptive.model_dump(mode="json"))
    if states:
        content.append(list(states))
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
    listed = [(table, read_points(path.parent / table.file)) for table in file.points]
    grids: tuple[HalfVector | Hemisphere, ...] = (*file.half_vector, *file.hemisphere)
    count = sum(len(points) * table.repeats for table, points in listed)
    count += sum(sweep.size * sweep.repeats for sweep in file.sweep) + sum(grid.size * grid.repeats for grid in grids)
    if count > MAX_POINTS:
        raise ConfigError(f"{path}: the plan has {count} points; at most {MAX_POINTS} fit into one run")
    tables: list[tuple[Repeated, list[Point]]] = [
        *((sweep, [canonical(*row) for row in sweep.rows()]) for sweep in file.sweep),
        *((grid, [Point(*row) for row in grid.rows()]) for grid in grids),
        *listed,
    ]
    points, repeated = _visits(tables)
    below = sum(grid.below for grid in grids)
    if not points and file.adaptive is None:
        raise ConfigError(
            f"{path}: the plan has no points: {below} half vectors need a detector below the horizon; take smaller "
            "theta_h_deg, or other phi_h_deg"
        )
    return Plan(
        file.name, file.wavelength_nm, points, repeated, str(path), file.adaptive, file.order, file.reference_every,
        below, file.laboratory, file.polarisation,
    )  # fmt: skip


def _visits(tables: Sequence[tuple[Repeated, Sequence[Point]]]) -> tuple[tuple[Point, ...], int]:
    """The points of all tables, each as often as it is visited, and how many of them were named before.

    Visit k of n to point number i of m stands at the share (k + i/m)/n of the run: visits to a point are spread evenly,
    and points that are visited once keep their order.
    """
    first: dict[tuple[int, ...], Point] = {}
    visits: dict[tuple[int, ...], int] = {}
    named = 0
    for table, points in tables:
        named += len(points)
        for point in points:
            key = _identity(point)
            first.setdefault(key, point)
            if table.repeats > visits.get(key, 1):
                visits[key] = table.repeats
    if not visits:
        return tuple(first.values()), named - len(first)
    count = len(first)
    at = [((k * count + i) / visits.get(key, 1), i) for i, key in enumerate(first) for k in range(visits.get(key, 1))]
    every = list(first.values())
    return tuple(every[i] for _, i in sorted(at)), named - count


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


def _points_of(path: Path, lines: "csv.DictReader[str]") -> list[Point]:
    columns = [name.strip() for name in lines.fieldnames or ()]
    for name in ANGLES_DEG:
        if name not in columns:
            raise ConfigError(
                f"{path}: the column {name} is missing; a list of points needs {', '.join(ANGLES_DEG)}, in degrees"
            )
    for name in (*ANGLES_DEG, "side"):
        if columns.count(name) > 1:
            raise ConfigError(f"{path}: the column {name} is there {columns.count(name)} times")
    lines.fieldnames, points = columns, []
    for row in lines:
        values = {}
        if more := row.get(None, ()):
            raise ConfigError(
                f"{path}: line {lines.line_num}: {len(columns) + len(more)} cells, and the header names {len(columns)} "
                "columns; commas separate cells, and numbers have decimal points"
            )
        side = (row.get("side") or "reflection").strip()
        if side not in ("reflection", "transmission"):
            raise ConfigError(f"{path}: line {lines.line_num}: side = {side[:40]!r}; reflection or transmission")
        behind = side == "transmission"
        for name in ANGLES_DEG:
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
    angles = zip(*(each.tolist() for each in plan.directions.angles), strict=True) if plan.points else ()
    for point, asked in zip(plan.points, angles, strict=True):
        try:
            if point.theta_i_deg > 90.0 - GRAZING_DEG:
                raise Unreachable("grazing", "theta_i = 90 deg: no light falls on the sample")
            if abs(point.theta_r_deg - 90.0) < GRAZING_DEG:
                raise Unreachable("grazing", "theta_r = 90 deg: the sample is seen edge-on")
            pose = reach(description, asked)
            if description.lamp.beam_diameter_mm is not None:
                why = regions.cut(description, view(description, pose))
                if why:
                    raise Unreachable("partly_filled", why, "the beam's edge cuts through the region of interest")
            out.append(Assessed(point, pose))
        except Unreachable as error:
            out.append(Assessed(point, None, error.flag, str(error), error.cause))
    return out


def plan_csv(points: Sequence[Assessed]) -> str:
    """plan.csv: the points of a run, as a table that a person reads."""
    out = io.StringIO()
    lines = csv.writer(out, lineterminator="\n")
    lines.writerow(PLAN_COLUMNS)
    for row, a in enumerate(points):
        lines.writerow([row, *(repr(float(getattr(a.point, name))) for name in ANGLES_DEG), a.flag, a.reason])
    return out.getvalue()


def count_reasons(points: list[Assessed]) -> list[tuple[tuple[str, str], int]]:
    """How many points are not measured for which (flag, cause), the most frequent first."""
    return Counter((a.flag, a.cause) for a in points if a.pose is None).most_common()


def beside(points: Sequence[Assessed], description: RigDescription) -> tuple[int, float]:
    """How many points a rig measures beside what was asked, since its errors of alignment leave no pose for them, and
    by how much at most [deg].
    """
    if description.as_meant:
        return 0, 0.0
    off = []
    for a in points:
        if a.pose is not None:
            seen, asked = directions(description, a.pose).vectors, a.point.directions.vectors
            off.append(max(2.0 * math.asin(math.dist(s, w) / 2.0) for s, w in zip(seen, asked, strict=True)))
    degrees = [each for each in map(math.degrees, off) if each > SAME_DEG]
    return len(degrees), max(degrees, default=0.0)


def said_beside(points: Sequence[Assessed], description: RigDescription) -> list[str]:
    """`beside` for people: a line, where there are such points."""
    count, most_deg = beside(points, description)
    said = (
        f"{count} of the points that are measured lie up to {most_deg:.2g} deg beside what was asked: the rig's errors "
        "of alignment leave no pose for them. The table states the directions that they have"
    )
    return [said] if count else []


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
    turn = round(360.0 / SAME_DEG)
    i, pi, r, pr = (round(getattr(point, name) / SAME_DEG) for name in ANGLES_DEG)
    return (i, pi % turn if i else 0, r, pr % turn if r else 0)
