"""Plots about a fit and about the data's uncertainties: each draws on the `ax` that it is given."""

from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np

from gonio.typing import Floats
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.plots.in_plane import COLOURS, angle_axis, clean
from gonio_analysis.plots.style import FAINT, INK

Dashes = str | tuple[int, tuple[float, ...]]
DASHES: tuple[Dashes, ...] = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (5, 1.5, 1, 1.5)), (0, (3, 1)), (0, (8, 2)))


class Look(TypedDict):
    """Colour and dashes of a line, as matplotlib's `plot` takes them."""

    color: str
    ls: Dashes


def look(k: int) -> Look:
    """Colour and dashes of part k of a budget (0: the combined uncertainty); 36 of them differ."""
    n = len(COLOURS)
    return {"color": INK if k == 0 else COLOURS[(k - 1) % n], "ls": DASHES[(k + max(k - 1, 0) // n) % len(DASHES)]}


def profile(ax: Any, interval: Interval, *, value: float, threshold: float, unit: str = "") -> list[Any]:
    """Rise of chi-square over one parameter with all others fitted again, and the interval that it gives.

    Parameters
    ----------
    interval
        The profile.
    value
        The fitted value.
    threshold
        Rise of chi-square at the ends of the interval.
    unit
        Of the parameter, for the label.
    """
    from scipy.interpolate import PchipInterpolator

    x, first = np.unique(interval.values, return_index=True)
    rise = np.maximum(interval.rise[first], 0.0)
    near = rise <= 3 * threshold
    # the root of the rise is nearly straight: few points are enough for the curve between them
    root = np.sign(x - value) * np.sqrt(rise)
    dense = np.linspace(x[near].min(), x[near].max(), 101)
    curve = PchipInterpolator(x, root)(dense) ** 2 if x.size > 1 else 0 * dense
    artists: list[Any] = [ax.axvspan(interval.low, interval.high, color="#e9eef5", zorder=0)]
    artists += ax.plot(dense, curve, color=COLOURS[0], lw=1.2, zorder=3)
    artists += ax.plot(x[near], rise[near], ls="none", color=COLOURS[0], marker="o", ms=3, zorder=3)
    artists.append(ax.axhline(threshold, color=INK, lw=0.8, ls=(0, (4, 3)), zorder=2))
    artists.append(ax.axvline(value, color=INK, lw=0.8, zorder=2))
    ax.set_ylim(0.0, max(2.0 * threshold, 1.1 * float(rise[near].max(initial=0.0))))
    ax.set_title(interval.name + (f" [{unit}]" if unit else ""), fontsize=8, loc="left", color=INK)
    ax.ticklabel_format(useOffset=False, useMathText=True)
    ax.locator_params(axis="x", nbins=3)
    ax.tick_params(labelsize=7)
    ax.xaxis.get_offset_text().set_size(7)
    ax.spines[["top", "right"]].set_visible(False)
    return artists


def budget_over_angle(ax: Any, angle: Floats, parts: Sequence[tuple[str, Floats]]) -> list[Any]:
    """Standard uncertainties by cause, relative to the value, over the signed angle, on a logarithmic axis.

    Parameters
    ----------
    angle : (n,) array [rad]
    parts
        (label, (n,) relative uncertainties, 1 = 100 %); the first one, the combined, is drawn strongest.
    """
    artists: list[Any] = []
    top = 100 * float(max(np.nanmax(u) for _, u in parts))
    for k, (label, u) in enumerate(parts):
        shown = np.where(u > 0, 100 * u, np.nan)
        artists += ax.plot(np.degrees(angle), shown, lw=1.2 if k else 1.8, label=label, zorder=4 - (k > 0), **look(k))
    ax.set_yscale("log")
    ax.set_ylim(top / 3e3, top * 1.5)
    ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    angle_axis(ax)
    ax.grid(color=FAINT, lw=0.5)
    return artists


def budget(ax: Any, parts: Sequence[tuple[str, float, float]]) -> list[Any]:
    """Uncertainty budget: a bar for the median of each part relative to the value, with a tick at its 95th percentile.

    Parameters
    ----------
    parts
        (label, median, 95th percentile), relative (1 = 100 %); the first one on top.
    """
    y, high = np.arange(len(parts))[::-1], np.array([p[2] for p in parts]) * 100
    median = np.array([max(p[1], 0.0) for p in parts]) * 100
    colours = [INK if label.startswith("combined") else "#0072B2" for label, *_ in parts]
    artists: list[Any] = [ax.barh(y, median, height=0.55, color=colours, zorder=2)]
    artists += ax.plot(high, y, ls="none", marker="|", ms=12, mew=1.6, color="#D55E00", zorder=3)
    ax.set_yticks(y, [p[0] for p in parts])
    smallest = min((m for m in median if m > 0), default=1e-3)
    if high.max(initial=0.0) > 50 * smallest:
        ax.set_xscale("log")
        ax.set_xlim(max(smallest / 3, high.max() / 1e4), high.max() * 2)
        ax.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    ax.set_xlabel("standard uncertainty relative to the value [%]")
    ax.grid(axis="x", color=FAINT, lw=0.6)
    clean(ax)
    ax.tick_params(axis="y", length=0)
    return artists


def series(
    ax: Any, x: Floats, y: Floats, u: Floats, *, x_label: str, y_label: str, colour: str = COLOURS[0]
) -> list[Any]:
    """A fitted parameter over wavelength, with standard errors where they are known."""
    artists = [ax.errorbar(x, y, yerr=np.nan_to_num(u), marker="o", ms=3, lw=1.0, elinewidth=0.8, color=colour)]
    ax.set(xlabel=x_label, ylabel=y_label)
    ax.grid(color=FAINT, lw=0.5)
    clean(ax)
    return artists
