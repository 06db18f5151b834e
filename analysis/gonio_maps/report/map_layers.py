"""What a page of a map shows: one quantity after another, made small enough for the page's program, and drawn.

Drawn are parameters, their uncertainties, the misfit, flags, materials and histograms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gonio_analysis.plots import pixels
from gonio_analysis.plots.pixels import Extent
from gonio_analysis.report.blocks import Block
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.text import model_slugs, number

from gonio.errors import ConfigError
from gonio.typing import Floats
from gonio_maps.files import FIT_FLAGS, FitFile, MapFile

PICTURE, EMBEDDED = 256, 200
"""Pixels along the longer side of a picture, and of what a page holds for its program, at most."""
Real = npt.NDArray[np.floating[Any]]
QUANTILES = (0.005, 0.995)
"""Quantiles between which colours are told apart."""
BINS = 60
SEVERE = ("too_few", "undetermined", "rejected", "at_bound")
"""Flags of a fit, the gravest first."""


@dataclass(frozen=True)
class MapPixels:
    """The pixels of a map."""

    x_mm: Floats
    y_mm: Floats

    @classmethod
    def of(cls, file: MapFile) -> MapPixels:
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
        """Pixels of the map for one pixel of a picture that has at most `most`."""
        return -(-max(self.shape) // most)

    def embedded(self) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Rows and columns of the pixels that a page holds: one amid every block."""
        step = self.step(EMBEDDED)
        rows, cols = (np.arange((step - 1) // 2, n, step) for n in self.shape)
        return rows, cols


@dataclass(frozen=True)
class LayerSpread:
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
    spread: LayerSpread
    picture: Floats
    """Medians of blocks, x and y ascending."""
    picture_u: Floats | None
    embedded: Floats
    """Single pixels, as the file has them (`MapPixels.embedded`)."""
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
    view: Block
    """The interactive plot (`map_view`), or what stands in its place."""
    materials: Materials | None = None


@dataclass(frozen=True)
class Materials:
    """Pixels that are alike, fitted together."""

    kind: npt.NDArray[np.intp]
    """The material of every pixel, -1 where it belongs to none."""
    rows: list[dict[str, float]]
    """Their parameters."""


def facts_of_grid(grid: MapPixels) -> dict[str, object]:
    """Size of a map, for summary.json."""
    rows, cols = grid.shape
    left, right, low, high = grid.extent
    return {"rows": rows, "columns": cols, "pixel_mm": grid.pixel_mm, "width_mm": right - left, "height_mm": high - low}


def pixels_of(grid: MapPixels) -> str:
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


def layer(grid: MapPixels, name: str, unit: str, value: Real, u: Real | None = None) -> Layer:
    """What a page shows of values (rows, columns), NaN where they are not determined."""
    rows, cols = grid.embedded()
    at = np.ix_(rows, cols)
    return Layer(
        name, unit, spread(value, u), block_medians(grid, value), None if u is None else block_medians(grid, u),
        value[at].astype(float), None if u is None else u[at].astype(float),
    )  # fmt: skip


def spread(value: Real, u: Real | None = None) -> LayerSpread:
    """How values spread; of none all is NaN."""
    known = value[np.isfinite(value)]
    typical = u[np.isfinite(u)] if u is not None else np.empty(0)
    if not known.size:
        none = float("nan")
        return LayerSpread(0, none, none, none, none, none, none, np.array([0.0, 1.0]), np.zeros(1, np.intp))
    low, median, high = np.quantile(known, (QUANTILES[0], 0.5, QUANTILES[1])).tolist()
    ends = (low, high) if high > low else (low - 1e-3 * (abs(low) or 1.0), low + 1e-3 * (abs(low) or 1.0))
    counts, edges = np.histogram(known, BINS, ends)
    typical_u = float(np.median(typical)) if typical.size else float("nan")
    return LayerSpread(known.size, median, low, high, float(known.min()), float(known.max()), typical_u, edges, counts)


def block_medians(grid: MapPixels, value: Real) -> Floats:
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


def picture_of(grid: MapPixels, kind: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Categories as a picture: one pixel of every block."""
    step = grid.step(PICTURE)
    first = (step - 1) // 2
    return np.asarray(grid.up(kind)[first::step, first::step], np.intp)


# --- fits ------------------------------------------------------------------------------------------------------------


def of_fits(file: FitFile, say: Callable[[str], None] = lambda text: None) -> list[Layer]:
    """Every parameter, then the misfit."""
    grid, out = MapPixels.of(file), []
    for name in file.parameters:
        say(f"reading {name}")
        out.append(layer(grid, name, file.unit(name), *file.parameter(name)))
    if "misfit" in file.names:
        out.append(
            layer(grid, "misfit", "", np.where(file.flagged("too_few"), np.nan, file.array("misfit").astype(float)))
        )
    return out


def gravest(file: FitFile) -> npt.NDArray[np.intp]:
    """For every pixel 0, or 1 and more for the gravest of its flags in the order of `SEVERE`."""
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


WIDE_IN, LONGEST_IN = 5.6, 4.1
"""Width of a figure, and the longer side of a map."""
LEFT_IN, RIGHT_IN, BELOW_IN, ABOVE_IN = 0.62, 1.15, 0.62, 0.12
DECADE = 10.0
"""Quantiles so far apart have a logarithmic scale of colours."""
COLUMNS = 3
"""Histograms in a row."""


def draw(grid: MapPixels, layers: Sequence[Layer]) -> list[Drawing]:
    """Maps of layers, each with that of its uncertainty, then their histograms."""
    out, files = [], model_slugs(one.name for one in layers)
    for one in layers:
        colours = pixels.UNCERTAINTIES if one.name == "misfit" else pixels.VALUES
        file = files[one.name]
        out.append(_map(grid, f"map-{file}", one.picture, one.label, _limits(one), colours, _share(grid, one)))
        if one.picture_u is not None and np.isfinite(one.picture_u).any():
            low, high = np.quantile(one.picture_u[np.isfinite(one.picture_u)], QUANTILES).tolist()
            label = "u of " + labelled(one.name, one.unit)
            out.append(_map(grid, f"map-u-{file}", one.picture_u, label, (low, high), pixels.UNCERTAINTIES))
    shown = [one for one in layers if one.spread.determined and one.spread.high > one.spread.low]
    return [*out, *([_histograms(shown)] if shown else [])]


def kinds(grid: MapPixels, name: str, caption: str, kind: npt.NDArray[np.intp], names: Sequence[str]) -> Drawing:
    """A map of categories, below 0 where there is none."""
    every = f" Every {_nth(grid.step(256))} pixel." if grid.step(256) > 1 else ""
    on = partial(_on_kinds, kind=picture_of(grid, kind), extent=grid.extent, names=list(names))
    return Drawing(f"map-{name}", "map", "", caption + every, caption, _inches(grid), on)


def signed(grid: MapPixels, name: str, caption: str, value: Floats, label: str, top: float) -> Drawing:
    """A map of values about 0, their colours saturated at +-`top`."""
    inches = _inches(grid)
    on = partial(
        _on_map, value=value, extent=grid.extent, limits=(-top, top), label=label, colours=pixels.SIGNED,
        logarithmic=False,
    )  # fmt: skip
    return Drawing(f"map-{name}", "map", "", caption, caption, inches, on)


def _limits(one: Layer) -> tuple[float, float]:
    return one.spread.low, one.spread.high


def _share(grid: MapPixels, one: Layer) -> str:
    total = grid.shape[0] * grid.shape[1]
    missing = total - one.spread.determined
    return f" Grey: not determined, {missing} of {total} pixels." if missing else ""


def _map(
    grid: MapPixels, name: str, value: Floats, label: str, limits: tuple[float, float], colours: str, more: str = ""
) -> Drawing:
    low, high = limits
    logarithmic = bool(low > 0 and high > DECADE * low)
    step = grid.step(256)
    caption = (
        f"{label}: colours from {number(low)} to {number(high)}, quantiles {QUANTILES[0]:g} and {QUANTILES[1]:g}"
        + (", on a logarithmic scale" if logarithmic else "")
        + "."
        + more
        + (f" A dot is the median of {step} × {step} pixels." if step > 1 else "")
    )
    on = partial(
        _on_map, value=value, extent=grid.extent, limits=limits, label=label, colours=colours, logarithmic=logarithmic
    )
    return Drawing(name, "map", "", caption, f"Map of {label}.", _inches(grid), on)


def _nth(step: int) -> str:
    return {2: "second", 3: "third"}.get(step, f"{step}th")


def _inches(grid: MapPixels) -> tuple[float, float]:
    """Width and height of a figure that holds a map of this shape."""
    _, _, high = _size(grid.extent)
    return WIDE_IN, high + BELOW_IN + ABOVE_IN


def _size(extent: Extent) -> tuple[float, float, float]:
    """Left edge, width and height of a map in its figure [in]."""
    wide, tall = extent[1] - extent[0], extent[3] - extent[2]
    per_mm = min((WIDE_IN - LEFT_IN - RIGHT_IN) / wide, LONGEST_IN / tall)
    return LEFT_IN, max(wide * per_mm, 0.4), max(tall * per_mm, 0.4)


def _axes(figure: Any, extent: Extent) -> tuple[Any, Any]:
    """Axes for the map and for its colour bar."""
    left, wide, tall = _size(extent)
    across, high = figure.get_figwidth(), figure.get_figheight()
    ax = figure.add_axes((left / across, BELOW_IN / high, wide / across, tall / high))
    bar = figure.add_axes(((left + wide + 0.1) / across, BELOW_IN / high, 0.13 / across, tall / high))
    return ax, bar


def _on_map(
    figure: Any, *, value: Floats, extent: Extent, limits: tuple[float, float], label: str, colours: str,
    logarithmic: bool,
) -> None:  # fmt: skip
    norm = pixels.scale(limits, logarithmic=logarithmic)
    pixels.value_map(*_axes(figure, extent), value, extent, norm=norm, label=label, colours=colours)


def _on_kinds(figure: Any, *, kind: npt.NDArray[np.intp], extent: Extent, names: list[str]) -> None:
    ax, bar = _axes(figure, extent)
    bar.remove()
    pixels.kind_map(ax, kind, extent, names)


def _histograms(layers: Sequence[Layer]) -> Drawing:
    high = 0.15 + 1.35 * math.ceil(len(layers) / COLUMNS)
    caption = (
        "Histograms: pixels over values, between the quantiles of the maps. Line: median; band: median ± the typical"
        " standard uncertainty of a pixel."
    )
    on = partial(_on_histograms, layers=[(one.spread, one.label) for one in layers])
    return Drawing("histograms", "histograms", "", caption, caption, (7.0, high), on)


def _on_histograms(figure: Any, *, layers: list[tuple[Any, str]]) -> None:
    axes = figure.subplots(math.ceil(len(layers) / COLUMNS), COLUMNS, squeeze=False).ravel()
    high = figure.get_figheight()
    figure.subplots_adjust(0.03, 0.48 / high, 0.97, 1 - 0.08 / high, wspace=0.14, hspace=0.62)
    for ax in axes[len(layers) :]:
        ax.set_axis_off()
    for ax, (spread, label) in zip(axes, layers, strict=False):
        pixels.histogram(ax, spread.edges, spread.counts, median=spread.median, u=spread.typical_u, label=label)
