"""What the page of a paper's figure consists of: parameters, claims, results, and the drawings that figures share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.plots import in_plane, style

from gonio import geometry
from gonio.typing import Floats

Origin = Literal["paper", "database", "derived", "assumed"]
ORIGINS: dict[Origin, str] = {
    "paper": "the paper",
    "database": "measured constants",
    "derived": "follows from the paper",
    "assumed": "assumed",
}
COLUMNS = ("panel", "curve", "kind", "x", "y", "u_y")
"""Header of `curves.csv`."""
CurveRow = tuple[str, str, float, float, float | None]
"""Curve, kind, x, y, and u_y where there is one."""
Row = Mapping[str, str | float | list[float] | None]
"""A row of results at full precision; each figure names its own columns."""


@dataclass(frozen=True)
class FigureParameter:
    """A value that the figure is made with, and where it comes from."""

    name: str
    value: str
    origin: Origin
    why: str = ""
    """The source, or the reason of an assumed value."""


@dataclass(frozen=True)
class Claim:
    """What the paper says about a figure, against the curves."""

    text: str
    """The paper's statement."""
    holds: bool | None
    """None: no verdict, because it hangs on a value that is not in the paper."""
    found: str
    """The numbers from the curves."""
    criterion: str
    """What was asked of them."""

    @property
    def verdict(self) -> str:
        """In words."""
        return "no verdict" if self.holds is None else "holds" if self.holds else "does not hold"

    @property
    def summary(self) -> dict[str, str]:
        """What `summary.json` says of it."""
        return {"claim": self.text, "verdict": self.verdict, "found": self.found, "criterion": self.criterion}


def agreed(answers: Iterable[bool]) -> bool | None:
    """The verdict where every choice of the assumed values gives the same one; None where it hangs on the choice."""
    found = {bool(answer) for answer in answers}
    return found.pop() if len(found) == 1 else None


@dataclass(frozen=True)
class Panel:
    """One drawing of a page, and the numbers in it."""

    name: str
    caption: str
    """What stands before its colon is set bold."""
    inches: tuple[float, float]
    draw: Callable[[Any], None]
    """Draws on a matplotlib figure."""
    axes: tuple[str, str]
    """What x and y are, with their units."""
    rows: Sequence[CurveRow]
    """Every plotted curve: `COLUMNS` without the panel."""
    again: Callable[[float], Panel] | None = None
    """Of a polar drawing: the same with another radius of its rim."""


@dataclass(frozen=True)
class Results:
    """Results at full precision, for `summary.json`, and a table of them on the page."""

    caption: str
    columns: Mapping[str, Callable[[Any], str]]
    """By the header of a column: what makes the text of its cell from a row."""
    rows: Sequence[Row]


@dataclass(frozen=True)
class PaperFigure:
    """One figure of a paper, made again."""

    name: str
    title: str
    paper: str
    parameters: Sequence[FigureParameter]
    claims: Sequence[Claim]
    panels: Sequence[Panel]
    results: Results
    notes: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    """Provenance beyond command, date and versions."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Further files of the page, by their path in its folder."""

    def of_radius(self, radius: float | None) -> PaperFigure:
        """The same with this radius in every polar drawing; None leaves each its own."""
        if radius is None:
            return self
        return replace(self, panels=[p if p.again is None else p.again(radius) for p in self.panels])


NOTHING = np.empty(0)
WIDTH_IN = 5.6
POLAR_IN, ANGLE_IN = 3.22, 3.2
"""Height of a drawing above its legend, axes' labels included."""
X_LABEL_IN = 0.45
LEGEND_ROW_IN = 0.185
THEORY, SIMULATED = "theory", "simulated measurement"
RETRO_TO_MIRROR = "θr: retro side negative, mirror side positive"
MIRROR_TO_RETRO = "θr: mirror side positive (left), retro side negative (right), as the paper draws it"


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


def polar_panel(
    name: str,
    caption: str,
    lines: Sequence[Line],
    radius_label: str,
    radius: float | None = None,
    *,
    most: float = 2.5,
    retro_right: bool = False,
) -> Panel:
    """The half-disc of `in_plane.polar` with its legend; its rim at the `radius`, or by what it shows."""
    rim = in_plane.radius_of(lines, most) if radius is None else radius
    key = Key(in_plane.handles(lines), measured=any(line.measured.size for line in lines))
    high = POLAR_IN + key.high

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.01, key.high / high, 0.98, (POLAR_IN - 0.02) / high))
        in_plane.polar(ax, lines, radius=rim, radius_label=radius_label, retro_right=retro_right, called="simulated")
        key.draw(figure)

    words, axes = caption + in_plane.rim_words(lines, rim, radius), ("signed angle [deg]", radius_label)
    again = partial(polar_panel, name, caption, lines, radius_label, most=most, retro_right=retro_right)
    return Panel(name, words, (WIDTH_IN, high), on, axes, line_rows(lines), again)


def angle_panel(
    name: str,
    caption: str,
    lines: Sequence[Line],
    y_label: str,
    *,
    logarithmic: bool = False,
    retro_right: bool = False,
) -> Panel:
    """Curves over the signed angle, on a linear or a logarithmic axis."""
    key = Key(in_plane.handles(lines), measured=any(line.measured.size for line in lines))
    high = ANGLE_IN + key.high

    def on(figure: Any) -> None:
        ax = _axes(figure, key)
        if logarithmic:
            in_plane.semilog(ax, lines, unit=y_label)
        else:
            in_plane.linear(ax, lines, y_label=y_label, retro_right=retro_right)
        ax.set_xlabel(MIRROR_TO_RETRO if retro_right else RETRO_TO_MIRROR)
        key.draw(figure)

    axes = ("signed angle [deg]", y_label)
    return Panel(name, caption, (WIDTH_IN, high), on, axes, line_rows(lines))


def trace_panel(name: str, caption: str, traces: Sequence[Trace], x_label: str, y_label: str) -> Panel:
    """Curves over anything."""
    lines = [theory(trace.label, trace.x, trace.y) for trace in traces]
    paired = any(trace.dashed for trace in traces)
    strokes = [(0, (4, 2)) if t.dashed else "-" if paired else in_plane.stroke(k, lines) for k, t in enumerate(traces)]
    handles = in_plane.handles(lines)
    for handle, ls in zip(handles, strokes, strict=True):
        handle.set_linestyle(ls)
    key = Key(handles, measured=False)

    def on(figure: Any) -> None:
        ax = _axes(figure, key)
        for k, (trace, ls) in enumerate(zip(traces, strokes, strict=True)):
            ax.plot(trace.x, trace.y, lw=1.4, zorder=3, color=in_plane.style(k)["color"], ls=ls)
        ax.margins(x=0.0)
        ax.set_ylim(bottom=0.0)
        plain_axes(ax, x_label, y_label)
        key.draw(figure)

    rows: list[CurveRow] = [(t.label, "theory", x, y, None) for t in traces for x, y in zip(t.x, t.y, strict=True)]
    return Panel(name, caption, (WIDTH_IN, ANGLE_IN + key.high), on, (x_label, y_label), rows)


def _axes(figure: Any, key: Key) -> Any:
    """Axes above a legend."""
    high = figure.get_figheight()
    below = (X_LABEL_IN + key.high) / high
    return figure.add_axes((0.13, below, 0.83, 1.0 - below - 0.1 / high))


def plain_axes(ax: Any, x_label: str, y_label: str) -> None:
    """Grid, labels and frame in the style of `in_plane`'s plots."""
    ax.set_xlabel(x_label, fontsize=8)
    ax.set_ylabel(y_label, fontsize=8)
    ax.grid(color=style.FAINT, lw=0.5)
    ax.tick_params(labelsize=7.5, color="#77808c")
    ax.set_axisbelow(True)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color("#77808c")


class Key:
    """A drawing's legend below its axes: the curves, and what solid and dashed lines are."""

    def __init__(self, handles: Sequence[Any], *, measured: bool) -> None:
        self._curves = [handle for handle in handles if handle.get_label()]
        self._kinds = in_plane.kinds(THEORY, SIMULATED) if measured else []
        longest = max((len(handle.get_label()) for handle in self._curves), default=1)
        self._columns = min(len(self._curves), max(1, int(104 / (longest + 9))))

    @property
    def high(self) -> float:
        """In inches."""
        rows = -(-len(self._curves) // self._columns) if self._curves else 0
        return LEGEND_ROW_IN * (rows + bool(self._kinds)) + 0.03

    def draw(self, figure: Any) -> None:
        """At the bottom of the figure."""
        look = {"fontsize": 7.5, "frameon": False, "columnspacing": 1.1, "borderpad": 0.1, "labelspacing": 0.3}
        above = LEGEND_ROW_IN / figure.get_figheight() if self._kinds else 0.0
        if self._kinds:
            figure.legend(handles=self._kinds, loc="lower center", ncol=2, handlelength=2.6, borderaxespad=0.1, **look)
        if self._curves:
            figure.legend(
                handles=self._curves,
                loc="lower center",
                ncol=self._columns,
                handlelength=2.6,
                borderaxespad=0.1,
                bbox_to_anchor=(0.5, above),
                **look,
            )


def line_rows(lines: Sequence[Line]) -> list[CurveRow]:
    """The points of curves for `curves.csv`; angles in degrees."""
    rows: list[CurveRow] = []
    for line in lines:
        for kind, angle, value, u in (
            ("theory", line.theory_angle, line.theory, np.full(line.theory.size, np.nan)),
            ("simulated", line.angle, line.measured, line.u),
        ):
            # without the rounding of the way from degrees to radians and back
            rows += [(line.label, kind, *row) for row in zip(np.round(np.degrees(angle), 10), value, u, strict=True)]
    return rows
