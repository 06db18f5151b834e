"""The figures of a map: parameters, their uncertainties, the misfit, flags, materials and histograms."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_analysis.plots import pixels
from gonio_analysis.plots.pixels import Extent
from gonio_analysis.report.drawings import Drawing
from gonio_analysis.report.map_layers import QUANTILES, Grid, Layer, labelled, picture_of
from gonio_analysis.report.text import number, slug

WIDE_IN, LONGEST_IN = 5.6, 4.1
"""Of a figure, and of the longer side of a map."""
LEFT_IN, RIGHT_IN, BELOW_IN, ABOVE_IN = 0.62, 1.15, 0.62, 0.12
DECADE = 10.0
"""Quantiles so far apart have a logarithmic scale of colours."""
COLUMNS = 3
"""Histograms in a row."""


def draw(grid: Grid, layers: Sequence[Layer]) -> list[Drawing]:
    """Maps of layers, each with that of its uncertainty, then their histograms."""
    out = []
    for one in layers:
        colours = pixels.UNCERTAINTIES if one.name == "tau" else pixels.VALUES
        what = "misfit tau, relative" if one.name == "tau" else one.label
        out.append(_map(grid, f"map-{slug(one.name)}", one.picture, what, _limits(one), colours, _share(grid, one)))
        if one.picture_u is not None and np.isfinite(one.picture_u).any():
            known = one.picture_u[np.isfinite(one.picture_u)]
            low, high = np.quantile(known, QUANTILES).tolist()
            label = "u of " + labelled(one.name, one.unit)
            out.append(_map(grid, f"map-u-{slug(one.name)}", one.picture_u, label, (low, high), pixels.UNCERTAINTIES))
    shown = [one for one in layers if one.spread.determined and one.spread.high > one.spread.low]
    return [*out, *([_histograms(shown)] if shown else [])]


def kinds(grid: Grid, name: str, caption: str, kind: npt.NDArray[np.intp], names: Sequence[str]) -> Drawing:
    """A map of categories, below 0 where there is none."""
    every = f" Every {_nth(grid.step(256))} pixel." if grid.step(256) > 1 else ""
    on = partial(_on_kinds, kind=picture_of(grid, kind), extent=grid.extent, names=list(names))
    return Drawing(f"map-{name}", "map", "", caption + every, caption, _inches(grid), on)


def signed(grid: Grid, name: str, caption: str, value: Floats, label: str, top: float) -> Drawing:
    """A map of values about 0, their colours saturated at +-`top`."""
    inches = _inches(grid)
    on = partial(
        _on_map, value=value, extent=grid.extent, limits=(-top, top), label=label, colours=pixels.SIGNED,
        logarithmic=False,
    )  # fmt: skip
    return Drawing(f"map-{name}", "map", "", caption, caption, inches, on)


def _limits(one: Layer) -> tuple[float, float]:
    return one.spread.low, one.spread.high


def _share(grid: Grid, one: Layer) -> str:
    total = grid.shape[0] * grid.shape[1]
    missing = total - one.spread.determined
    return f" Grey: not determined, {missing} of {total} pixels." if missing else ""


def _map(
    grid: Grid, name: str, value: Floats, label: str, limits: tuple[float, float], colours: str, more: str = ""
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


def _inches(grid: Grid) -> tuple[float, float]:
    """Of a figure that holds a map of this shape."""
    _, _, high = _size(grid.extent)
    return WIDE_IN, high + BELOW_IN + ABOVE_IN


def _size(extent: Extent) -> tuple[float, float, float]:
    """Left edge, width and height of a map in its figure [in]."""
    wide, tall = extent[1] - extent[0], extent[3] - extent[2]
    room = WIDE_IN - LEFT_IN - RIGHT_IN
    per_mm = min(room / wide, LONGEST_IN / tall)
    return LEFT_IN, max(wide * per_mm, 0.4), max(tall * per_mm, 0.4)


def _axes(figure: Any, extent: Extent) -> tuple[Any, Any]:
    """Of the map and of its colour bar."""
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
    rows = math.ceil(len(layers) / COLUMNS)
    axes = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    high = figure.get_figheight()
    figure.subplots_adjust(0.03, 0.48 / high, 0.97, 1 - 0.08 / high, wspace=0.14, hspace=0.62)
    for ax in axes[len(layers) :]:
        ax.set_axis_off()
    for ax, (spread, label) in zip(axes, layers, strict=False):
        pixels.histogram(ax, spread.edges, spread.counts, median=spread.median, u=spread.typical_u, label=label)
