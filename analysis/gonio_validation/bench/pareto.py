"""Speed against error: the Pareto front of the ways of evaluating a quantity, and its drawing."""

import math
from collections.abc import Sequence
from typing import Any

from gonio_analysis.plots.in_plane import COLOURS
from gonio_analysis.plots.style import INK
from gonio_analysis.report.drawing import Figure, rendered

from gonio_validation.bench.page import plain_axes
from gonio_validation.bench.quantity import QuantitySummary, Set, WaySummary

FLOOR = 1e-17
"""Where an error of 0 is drawn."""
CEILING = 1e2
"""Where results that are no numbers, and larger errors, are drawn."""
PEER, COMPARISON = "#8a5a00", "#5f6670"


def front(points: Sequence[tuple[float, float | None]]) -> list[int]:
    """Which of the points (cost, error) no other point beats in both, by growing cost; None is never on it."""
    out: list[int] = []
    best = float("inf")
    for k in sorted(range(len(points)), key=lambda k: (points[k][0], points[k][1] or 0.0)):
        error = points[k][1]
        if error is not None and error < best:
            out.append(k)
            best = error
    return out


def draw(quantity: QuantitySummary) -> Figure:
    """ns an evaluation against relative error, on grid and hard set, with the Pareto front of the largest errors."""
    kinds = quantity.sets
    ways = list(enumerate((w for w in quantity.ways if w.errors), 1))
    rows = math.ceil(len(ways) / 2)
    height = 2.7 + 0.2 * rows

    def on(figure: Any) -> None:
        axes = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
        figure.subplots_adjust(0.12, (0.62 + 0.2 * rows) / height, 0.985, 1 - 0.24 / height, wspace=0.05)
        for ax, kind in zip(axes, kinds, strict=True):
            _panel(ax, ways, kind, len(kinds))
            ax.set_xlabel("ns an evaluation", fontsize=8)
            ax.set_title("stated grid" if kind == "grid" else "hard set", fontsize=8, loc="left", color=INK)
        axes[0].set_ylabel("relative error", fontsize=8)
        for k, (number, way) in enumerate(ways):
            x = 0.12 + 0.865 * (k // rows) / 2
            y = (0.2 * (rows - k % rows) - 0.06) / height
            box = {"boxstyle": "circle,pad=0.15", "fc": _colour(way), "ec": "none"}
            figure.text(x, y, f"{number}", fontsize=7, color="white", ha="center", va="center", bbox=box)
            figure.text(x + 0.024, y, way.way, fontsize=7.5, va="center", color=INK)

    caption = (
        f"{quantity.title}: time against relative error. Numbered: largest error; bar: 99th percentile; dot: median; "
        "line: Pareto front of the largest errors. Blue: ours; grey: comparison; brown: peers. "
        "An error of 0 is drawn at the lower edge."
    )
    alt = f"{quantity.title}. " + " ".join(
        f"{w.way}: {w.time.best_ns:.3g} ns, largest error {_said(w.errors[kinds[0]].max)}." for _, w in ways
    )
    return rendered(f"front-{quantity.name.replace(' ', '-')}", "front", quantity.name, caption, alt, (5.2, height), on)


def _colour(way: WaySummary) -> str:
    return COLOURS[0] if way.ours else PEER if way.peer else COMPARISON


def _said(error: float | None) -> str:
    return "not a number" if error is None else f"{error:.2g}"


def _drawn(error: float | None) -> float:
    return CEILING if error is None else min(max(error, FLOOR), CEILING)


def _panel(ax: Any, ways: list[tuple[int, WaySummary]], kind: Set, columns: int) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    here = [(n, w, w.time.best_ns, w.errors[kind]) for n, w in ways if kind in w.errors]
    steps = sorted((x, _drawn(e.max)) for _, w, x, e in here if w.on_front(kind))
    times = [x for _, _, x, _ in here]
    low, high = min(times) / 1.7, max(times) * 1.7
    if steps:
        xs, ys = [steps[0][0]], [CEILING * 10]
        for x, y in steps:
            xs += [x, x]
            ys += [ys[-1], y]
        ax.plot([*xs, high], [*ys, ys[-1]], color="#9fb8d6", lw=1.2, zorder=1)
    for number, way, x, e in here:
        colour, top = _colour(way), _drawn(e.max)
        ax.plot([x, x], [_drawn(e.median), top], color=colour, lw=0.8, alpha=0.6, zorder=2)
        ax.plot([x], [_drawn(e.p99)], marker="_", ms=7, mew=1.4, color=colour, zorder=3)
        ax.plot([x], [_drawn(e.median)], marker=".", ms=5, color=colour, zorder=3)
        ax.plot([x], [top], marker="o", ms=9.5, mfc=colour, mec="white", mew=0.8, zorder=4)
        ax.annotate(str(number), (x, top), fontsize=6.5, color="white", ha="center", va="center_baseline", zorder=5)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlim(low, high)
    ax.set_ylim(FLOOR / 4, CEILING * 8)
    ax.yaxis.set_major_locator(FixedLocator([10.0**p for p in range(-16, 1, 4)]))
    ax.yaxis.set_minor_locator(NullLocator())
    inside = [t for t in [m * 10.0**p for p in range(-2, 7) for m in (1, 2, 5)] if low <= t <= high]
    if len(inside) > 12 // columns:
        inside = [t for t in inside if math.isclose(math.log10(t), round(math.log10(t)), abs_tol=1e-9)]
    ax.xaxis.set_major_locator(FixedLocator(inside))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda t, _: f"{t:,.6g}".replace(",", " ")))
    plain_axes(ax)
