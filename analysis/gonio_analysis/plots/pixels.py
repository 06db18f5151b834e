"""Maps of a sample's pixels: values in colours, kinds in colours, a ruler in mm, and how values spread."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_analysis.plots.style import FAINT, INK

VALUES, UNCERTAINTIES, SIGNED = "viridis", "cividis", "RdBu_r"
"""Perceptually even colour maps that readers with any colour vision can tell."""
STEPS = 128
"""Colours of a map: enough for an eye, and a third of the bytes of 256 in a noisy picture."""
UNKNOWN = "#c4c9d0"
"""Colour of what is not determined; no colour of the maps."""
KINDS = ("#f4f1e8", "#0072B2", "#E69F00", "#CC79A7", "#D55E00", "#009E73", "#56B4E9", "#8a6d3b", "#000000")
"""Colours of categories; the first one is the usual."""
RULER_IN = 0.39
"""Height of the ruler below a map."""
Extent = tuple[float, float, float, float]
"""Left, right, lower and upper edge of a map [mm]."""


def scale(limits: tuple[float, float], *, logarithmic: bool = False) -> Any:
    """Colours over a range of values."""
    from matplotlib.colors import LogNorm, Normalize

    low, high = limits
    if not high > low:
        low, high = low - (abs(low) or 1.0) * 1e-3, high + (abs(high) or 1.0) * 1e-3
    return LogNorm(low, high) if logarithmic and low > 0 else Normalize(low, high)


def value_map(
    ax: Any, bar: Any, value: Floats, extent: Extent, *, norm: Any, label: str, colours: str = VALUES
) -> list[Any]:
    """Values of pixels in colours with a colour bar; what is not finite has the colour `UNKNOWN`.

    Parameters
    ----------
    ax, bar
        Axes of the map and of its colour bar.
    value : (rows, columns) array
        Row 0 is the lowest y.
    extent
        Edges [mm].
    norm
        As `scale` makes it; what lies beyond has the colour of its end, and the bar an arrow there.
    label
        Of the colour bar, with the unit.
    """
    from matplotlib import colormaps

    colour_map = colormaps[colours].resampled(STEPS).with_extremes(bad=UNKNOWN)
    picture = ax.imshow(
        np.ma.masked_invalid(value), cmap=colour_map, norm=norm, origin="lower", extent=extent, interpolation="none"
    )
    known = value[np.isfinite(value)]
    below, above = (bool(np.any(known < norm.vmin)), bool(np.any(known > norm.vmax))) if known.size else (False, False)
    ends = {(True, True): "both", (True, False): "min", (False, True): "max"}.get((below, above), "neither")
    drawn = ax.figure.colorbar(picture, cax=bar, extend=ends, extendfrac=0.03)
    drawn.set_label(label, fontsize=8)
    drawn.outline.set_linewidth(0.5)
    bar.tick_params(which="both", labelsize=7.5)
    _edges(ax)
    return [picture, *ruler(ax, extent)]


def kind_map(ax: Any, kind: npt.NDArray[np.intp], extent: Extent, names: Sequence[str]) -> list[Any]:
    """Kinds of pixels in colours, with a legend of those that occur; below 0 is `UNKNOWN`."""
    from matplotlib.colors import BoundaryNorm, ListedColormap
    from matplotlib.patches import Patch

    colours = [UNKNOWN, *(KINDS[k % len(KINDS)] for k in range(len(names)))]
    norm = BoundaryNorm(np.arange(-1.5, len(names) + 0.1), len(colours))
    picture = ax.imshow(
        kind, cmap=ListedColormap(colours), norm=norm, origin="lower", extent=extent, interpolation="none"
    )
    _edges(ax)
    seen = [k for k in range(-1, len(names)) if np.any(kind == k)]
    handles = [
        Patch(facecolor=colours[k + 1], edgecolor=INK, linewidth=0.4, label=names[k] if k >= 0 else "none")
        for k in seen
    ]
    ax.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=7.5, frameon=False, borderaxespad=0.0
    )
    return [picture, *ruler(ax, extent)]


def ruler(ax: Any, extent: Extent) -> list[Any]:
    """A bar of a round length below the left of a map, and its length in mm."""
    left, right = extent[:2]
    length = round_length((right - left) / 3.5)
    y = -RULER_IN / _tall(ax)
    at = ax.get_xaxis_transform()
    bar = ax.plot([left, left + length], [y, y], color=INK, lw=2.5, solid_capstyle="butt", clip_on=False, transform=at)
    words = ax.text(
        left + length + 0.015 * (right - left), y, f"{length:g} mm", fontsize=8, color=INK, va="center", transform=at
    )
    return [*bar, words]


def round_length(most: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above `most`."""
    power = 10.0 ** math.floor(math.log10(most))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most * (1 + 1e-9))


def histogram(
    ax: Any, edges: Floats, counts: npt.NDArray[np.intp], *, median: float, u: float | None, label: str
) -> list[Any]:
    """How values spread: counts of pixels, the median as a line, and median +- a typical uncertainty as a band."""
    artists: list[Any] = [ax.stairs(counts, edges, fill=True, color="#8fb3d4", zorder=2)]
    if u is not None and math.isfinite(u):
        artists.append(ax.axvspan(median - u, median + u, color="#D55E00", alpha=0.25, lw=0, zorder=3))
    artists.append(ax.axvline(median, color="#D55E00", lw=1.3, zorder=4))
    ax.set_xlim(edges[0], edges[-1])
    ax.set_xlabel(label, fontsize=8)
    ax.set_yticks([])
    ax.tick_params(labelsize=7.5)
    for side in ("top", "left", "right"):
        ax.spines[side].set_visible(False)
    return artists


def _tall(ax: Any) -> float:
    """Height of axes [in]."""
    return float(ax.get_position().height * ax.figure.get_figheight())


def _edges(ax: Any) -> None:
    ax.set_xlabel("x [mm]", fontsize=8, labelpad=2)
    ax.set_ylabel("y [mm]", fontsize=8, labelpad=2)
    ax.tick_params(labelsize=7.5, length=2.5)
    for spine in ax.spines.values():
        spine.set(color=FAINT, linewidth=0.6)
