"""The drawings that the papers' figures share, with their numbers for `curves.csv`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gonio_analysis.curves.line import Line
from gonio_analysis.plots import in_plane

from gonio import geometry
from gonio.typing import Floats
from gonio_validation.papers.figure import CurveRow, Panel

NOTHING = np.empty(0)
SIZE = (5.6, 3.72)
RETRO_TO_MIRROR = "θr: retro side negative, mirror side positive"


@dataclass(frozen=True)
class Trace:
    """A curve over something that is not an angle of the instrument."""

    label: str
    x: Floats
    y: Floats
    dashed: bool = False


def theory(label: str, angle: Floats, value: Floats, mirror: float | None = None) -> Line:
    """A curve without a measurement."""
    return Line(label, angle, value, NOTHING, NOTHING, NOTHING, mirror)


def signed(theta_deg: Floats) -> tuple[Floats, Floats]:
    """Polar angle and azimuth [rad] of signed in-plane angles [deg], for a source at azimuth 0."""
    return geometry.unsigned(np.radians(theta_deg))


def at(x: Floats, y: Floats, where: float) -> float:
    """The value of a curve at an abscissa that it has (or the nearest to it)."""
    return float(y[int(np.argmin(np.abs(x - where)))])


def polar_panel(name: str, caption: str, lines: Sequence[Line], radius_label: str, *, most: float = 2.5) -> Panel:
    """The half-disc of `in_plane.polar` with its legend; curves that go beyond `most` are cut at the rim."""
    rim = in_plane.radius_of(lines, most)

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.01, 0.1, 0.98, 0.89))
        in_plane.polar(ax, lines, radius=rim, radius_label=radius_label)
        legend(figure, [line.label for line in lines])

    return Panel(name, caption, SIZE, on, ("signed angle [deg]", radius_label), line_rows(lines))


def angle_panel(
    name: str, caption: str, lines: Sequence[Line], y_label: str, *, logarithmic: bool = False, x_label: str = ""
) -> Panel:
    """Curves over the signed angle, on a linear or a logarithmic axis."""

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.13, 0.235, 0.85, 0.74))
        if logarithmic:
            in_plane.semilog(ax, lines, unit=y_label)
        else:
            in_plane.linear(ax, lines, y_label=y_label)
        ax.set_xlabel(x_label or RETRO_TO_MIRROR)
        legend(figure, [line.label for line in lines])

    return Panel(name, caption, SIZE, on, (f"{x_label or 'signed angle'} [deg]", y_label), line_rows(lines))


def trace_panel(
    name: str, caption: str, traces: Sequence[Trace], x_label: str, y_label: str, *, bottom: float | None = 0.0
) -> Panel:
    """Curves over anything."""

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.13, 0.235, 0.85, 0.74))
        for k, trace in enumerate(traces):
            look = {"color": in_plane.style(k)["color"], "ls": (0, (4, 2)) if trace.dashed else "-"}
            ax.plot(trace.x, trace.y, lw=1.4, zorder=3, **look | in_plane.sparse(k))
        ax.margins(x=0.0)
        if bottom is not None:
            ax.set_ylim(bottom=bottom)
        plain_axes(ax, x_label, y_label)
        legend(figure, [trace.label for trace in traces], [trace.dashed for trace in traces])

    rows: list[CurveRow] = [(t.label, "theory", x, y, None) for t in traces for x, y in zip(t.x, t.y, strict=True)]
    return Panel(name, caption, SIZE, on, (x_label, y_label), rows)


def plain_axes(ax: Any, x_label: str, y_label: str) -> None:
    """Grid, labels and frame in the style of `in_plane`'s plots."""
    ax.set_xlabel(x_label, fontsize=8)
    ax.set_ylabel(y_label, fontsize=8)
    ax.grid(color=in_plane.FAINT, lw=0.5)
    ax.tick_params(labelsize=7.5, color="#77808c")
    ax.set_axisbelow(True)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color("#77808c")


def legend(figure: Any, labels: Sequence[str], dashed: Sequence[bool] = ()) -> None:
    """Labels below the axes, in as many rows as their lengths need."""
    from matplotlib.lines import Line2D

    styles = [(0, (3, 1.5)) if d else "-" for d in dashed] or ["-"] * len(labels)
    handles = [
        Line2D([], [], lw=1.5, ls=ls, ms=3.5, label=label, **in_plane.style(k))
        for k, (label, ls) in enumerate(zip(labels, styles, strict=True))
        if label
    ]
    longest = max(len(label) for label in labels)
    columns = min(len(handles), max(1, int(104 / (longest + 9))))
    figure.legend(
        handles=handles,
        loc="lower center",
        ncol=columns,
        fontsize=7.5,
        frameon=False,
        handlelength=1.6,
        columnspacing=1.1,
        borderpad=0.1,
        labelspacing=0.3,
    )


def line_rows(lines: Sequence[Line]) -> list[CurveRow]:
    """The points of curves for `curves.csv`; angles in degrees."""
    rows: list[CurveRow] = []
    for line in lines:
        for kind, angle, value, u in (
            ("theory", line.theory_angle, line.theory, np.full(line.theory.size, np.nan)),
            ("experiment", line.angle, line.measured, line.u),
        ):
            # without the rounding of the way from degrees to radians and back
            shown = np.round(np.degrees(angle), 10)
            rows += [(line.label, kind, *row) for row in zip(shown, value, u, strict=True)]
    return rows
