"""What a page of a map shows: one quantity after another, made small enough for pictures and for the page's program."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.errors import ConfigError
from gonio.maps import FIT_FLAGS, FitFile, MapFile
from gonio.typing import Floats
from gonio_analysis.plots.pixels import Extent
from gonio_analysis.report.drawings import Drawing

PICTURE, EMBEDDED = 256, 200
"""Pixels along the longer side of a picture, and of what a page holds for its program, at most."""
Real = npt.NDArray[np.floating[Any]]
QUANTILES = (0.005, 0.995)
"""Between which colours are told apart."""
BINS = 60
SEVERE = ("too_few", "undetermined", "rejected", "at_bound")
"""Flags of a fit, the gravest first."""


@dataclass(frozen=True)
class Grid:
    """The pixels of a map."""

    x_mm: Floats
    y_mm: Floats

    @classmethod
    def of(cls, file: MapFile) -> Grid:
        """Of a map file."""
        return cls(file.x_mm, file.y_mm)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.y_mm.size, self.x_mm.size

    @property
    def pixel_mm(self) -> float:
        """Side of a pixel; NaN of a single one."""
        axis = self.x_mm if self.x_mm.size > 1 else self.y_mm
        return abs(float(axis[-1] - axis[0])) / (axis.size - 1) if axis.size > 1 else float("nan")

    @property
    def extent(self) -> Extent:
        """Edges [mm]."""
        half = 0.5 * (self.pixel_mm if np.isfinite(self.pixel_mm) else 1.0)
        x, y = self.x_mm, self.y_mm
        return float(x.min()) - half, float(x.max()) + half, float(y.min()) - half, float(y.max()) + half

    def up(self, value: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """An array (rows, columns, ...) with x and y ascending."""
        return value[:: -1 if self.y_mm[0] > self.y_mm[-1] else 1, :: -1 if self.x_mm[0] > self.x_mm[-1] else 1]

    def step(self, most: int) -> int:
        """Pixels of the map for one of a picture of at most so many."""
        return -(-max(self.shape) // most)

    def embedded(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Rows and columns of the pixels that a page holds: one amid every block."""
        step = self.step(EMBEDDED)
        rows, cols = (np.arange((step - 1) // 2, n, step) for n in self.shape)
        return rows, cols


@dataclass(frozen=True)
class Spread:
    """How the values of a layer spread over the pixels where they are determined."""

    determined: int
    median: float
    low: float
    high: float
    """Quantiles `QUANTILES`."""
    least: float
    most: float
    typical_u: float
    """Median of the standard uncertainties; NaN where there are none."""
    edges: Floats
    counts: npt.NDArray[np.intp]
    """A histogram between `low` and `high`."""

    def summary(self) -> dict[str, float | int]:
        """Its numbers."""
        return {
            "determined": self.determined,
            "median": self.median,
            "quantile_0.005": self.low,
            "quantile_0.995": self.high,
            "least": self.least,
            "most": self.most,
            "typical_u": self.typical_u,
        }


@dataclass(frozen=True)
class Layer:
    """One quantity over a map."""

    name: str
    unit: str
    spread: Spread
    picture: Floats
    """Medians of blocks, x and y ascending."""
    picture_u: Floats | None
    embedded: Floats
    """Single pixels, as the file has them (`Grid.embedded`)."""
    embedded_u: Floats | None

    @property
    def label(self) -> str:
        """With its unit."""
        return labelled(self.name, self.unit)


@dataclass(frozen=True)
class Told:
    """What a page says of a map."""

    title: str
    conclusion: str
    layers: list[Layer]
    facts: list[tuple[str, str]]
    counts: dict[str, int]
    """By flag."""
    counted: str
    """What was counted: pixels or values."""
    total: int
    drawings: list[Drawing]
    summary: dict[str, object]
    view: dict[str, Any]
    """What the page holds for its program (`map_view`)."""
    materials: Materials | None = None


@dataclass(frozen=True)
class Materials:
    """Pixels that are alike, fitted together."""

    kind: npt.NDArray[np.intp]
    """Of every pixel the material, -1 where it belongs to none."""
    rows: list[dict[str, float]]
    """Their parameters."""


def facts_of_grid(grid: Grid) -> dict[str, object]:
    """Size of a map, for summary.json."""
    rows, cols = grid.shape
    left, right, low, high = grid.extent
    return {"rows": rows, "columns": cols, "pixel_mm": grid.pixel_mm, "width_mm": right - left, "height_mm": high - low}


def pixels_of(grid: Grid) -> str:
    """Size of a map, in words."""
    rows, cols = grid.shape
    left, right, low, high = grid.extent
    return f"{cols} × {rows} of {grid.pixel_mm:.3g} mm: {right - left:.4g} mm × {high - low:.4g} mm"


def labelled(name: str, unit: str) -> str:
    """A name as people read it, with the unit."""
    for end in ("_deg", "_um"):
        name = name.removesuffix(end)
    unit = {"um": "µm", "deg": "°", "degree": "°"}.get(unit, unit)
    return name.replace("_", " ") + (f" [{unit}]" if unit else "")


def layer(grid: Grid, name: str, unit: str, value: Real, u: Real | None = None) -> Layer:
    """What a page shows of values (rows, columns), NaN where they are not determined."""
    rows, cols = grid.embedded()
    at = np.ix_(rows, cols)
    return Layer(
        name, unit, spread(value, u), block_medians(grid, value), None if u is None else block_medians(grid, u),
        value[at].astype(float), None if u is None else u[at].astype(float),
    )  # fmt: skip


def spread(value: Real, u: Real | None = None) -> Spread:
    """How values spread; of none all is NaN."""
    known = value[np.isfinite(value)]
    typical = u[np.isfinite(u)] if u is not None else np.empty(0)
    if not known.size:
        none = float("nan")
        return Spread(0, none, none, none, none, none, none, np.array([0.0, 1.0]), np.zeros(1, np.intp))
    low, median, high = np.quantile(known, (QUANTILES[0], 0.5, QUANTILES[1])).tolist()
    ends = (low, high) if high > low else (low - 1e-3 * (abs(low) or 1.0), low + 1e-3 * (abs(low) or 1.0))
    counts, edges = np.histogram(known, BINS, ends)
    typical_u = float(np.median(typical)) if typical.size else float("nan")
    return Spread(known.size, median, low, high, float(known.min()), float(known.max()), typical_u, edges, counts)


def block_medians(grid: Grid, value: Real) -> Floats:
    """A picture of at most `PICTURE` pixels along a side: medians of what is determined in square blocks."""
    step, upright = grid.step(PICTURE), grid.up(value)
    if step == 1:
        return np.asarray(upright, float)
    rows, cols = (-(-n // step) for n in value.shape)
    out = np.full((rows, cols), np.nan)
    for row, line in enumerate(out):
        strip = np.full((step, cols * step), np.nan)
        held = upright[row * step : (row + 1) * step]
        strip[: held.shape[0], : held.shape[1]] = held
        blocks = strip.reshape(step, cols, step).transpose(1, 0, 2).reshape(cols, step * step)
        some = np.isfinite(blocks).any(axis=-1)
        line[some] = np.nanmedian(blocks[some], axis=-1)
    return out


def picture_of(grid: Grid, kind: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Categories as a picture: one pixel of every block."""
    step = grid.step(PICTURE)
    first = (step - 1) // 2
    return np.asarray(grid.up(kind)[first::step, first::step], np.intp)


# --- fits ------------------------------------------------------------------------------------------------------------


def of_fits(file: FitFile, say: Callable[[str], None] = lambda text: None) -> list[Layer]:
    """Every parameter, then the misfit tau."""
    grid, out = Grid.of(file), []
    for name in file.parameters:
        say(f"reading {name}")
        out.append(layer(grid, name, file.unit(name), *file.parameter(name)))
    if "tau" in file.names:
        out.append(layer(grid, "tau", "", np.where(file.flagged("too_few"), np.nan, file.array("tau").astype(float))))
    return out


def gravest(file: FitFile) -> npt.NDArray[np.intp]:
    """Of every pixel 0, or 1 and more for the gravest of its flags in the order of `SEVERE`."""
    out = np.zeros(file.shape, np.intp)
    for k, name in reversed(list(enumerate(SEVERE, 1))):
        out[file.flagged(name)] = k
    return out


def flag_counts(file: FitFile) -> dict[str, int]:
    """Pixels that have each flag."""
    return {name: int(file.flagged(name).sum()) for name in FIT_FLAGS}


def map_of(file: FitFile, given: Path | None) -> Path | None:
    """The map of values that was fitted: the one that is given, or the one of its name beside the fits.

    Raises
    ------
    ConfigError
        The one that is given is another.
    """
    path = given or file.path.parent / str(file.attrs.get("map", ""))
    if not path.is_file():
        if given is not None:
            raise ConfigError(f"--map {given}: there is no such file")
        return None
    with MapFile(path) as values:
        same = values.sha256() == file.attrs.get("map_sha256") if "map_sha256" in file.attrs else True
    if given is not None and not same:
        raise ConfigError(f"--map {given}: is not the map that was fitted ({file.attrs.get('map')}); name that one")
    return path if same else None
