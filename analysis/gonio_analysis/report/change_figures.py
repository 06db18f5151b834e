"""The figures of a comparison point by point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gonio import geometry
from gonio_analysis import maps, polar
from gonio_analysis.change import LEVEL, Change
from gonio_analysis.observations import Observations
from gonio_analysis.planes import IN_PLANE, Curve, groups, labels
from gonio_analysis.polar import Line
from gonio_analysis.report.figures import Figure, rendered

MOST_DISCS = 4


def draw(c: Change, at: Observations, drawn: list[Curve], shown: float) -> list[Figure]:
    """Every figure of a comparison: `at` holds the directions and `drawn` the curves of the wavelength `shown` [nm]."""
    out = []
    where = "" if math.isnan(shown) else f" at {shown:g} nm"
    if drawn:
        out.append(_values(c, at, drawn, where))
        if c.verdict is not None:
            out.append(_changes(c, at, drawn, where))
    out += _change_maps(c, at, where)
    return out


def _values(c: Change, at: Observations, drawn: list[Curve], where: str) -> Figure:
    lines = []
    for curve, label in zip(drawn, labels(drawn), strict=True):
        rows = at.rows[curve.rows]
        lines.append(Line(label, curve.angle, c.value_b[rows], curve.angle, c.value_a[rows], c.u_a[rows]))

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.135, 0.17, 0.84, 0.805))
        polar.semilog(ax, lines)
        ax.set_xlabel("θr: retro side negative, mirror side positive")
        _legend(figure, lines)

    caption = f"In the plane of incidence{where}: markers and dashes {c.a.name}; solid lines {c.b.name}."
    return rendered("values", "values", "", caption, caption, (5.6, 4.4), on)


def _changes(c: Change, at: Observations, drawn: list[Curve], where: str) -> Figure:
    assert c.verdict is not None
    relative, scores, marks = [], [], []
    nothing = np.empty(0)
    for curve, label in zip(drawn, labels(drawn), strict=True):
        rows = at.rows[curve.rows]
        a, u, z = c.value_a[rows], c.u[rows], c.verdict.z[rows]
        large = a > 3 * u
        relative.append(
            Line(
                label,
                nothing,
                nothing,
                curve.angle[large],
                100 * c.difference[rows][large] / a[large],
                100 * u[large] / a[large],
            )
        )
        marks.append(c.verdict.marked[rows][large])
        scores.append(Line(label, nothing, nothing, curve.angle, z, z * np.nan))
    limit = _limit(len(c.at))

    def on(figure: Any) -> None:
        top, low = figure.subplots(2, 1, height_ratios=(1.7, 1), sharex=True)
        figure.subplots_adjust(0.135, 0.17, 0.975, 0.975, hspace=0.12)
        maps.changes(top, relative, marks)
        maps.significance(low, scores, limit)
        low.set_xlabel("θr: retro side negative, mirror side positive")
        figure.align_ylabels([top, low])
        _legend(figure, relative)

    caption = (
        f"Change{where}: above, (B − A)/A with the standard uncertainty of the difference, where A is above three of"
        " them; rings mark values that changed. Below, each difference against what all the others predict, in standard"
        f" deviations (band: ±2; dashed: ±{limit:.2g}, which the largest of all {len(c.at)} exceeds by chance in"
        f" {100 * LEVEL:g} % of comparisons)."
    )
    alt = (
        f"Relative change over angle and its significance; {int(c.verdict.marked.sum())} values are marked as changed."
    )
    return rendered("change", "change", "", caption, alt, (5.6, 4.4), on)


def _limit(n: int) -> float:
    from scipy.special import ndtri

    return float(-ndtri(-math.expm1(math.log1p(-LEVEL) / n) / 2))


def _change_maps(c: Change, at: Observations, where: str) -> list[Figure]:
    rows = at.rows
    if c.verdict is not None:
        value, label, marked = c.verdict.z[rows], "standard deviations", c.verdict.marked[rows]
        top = float(np.clip(np.abs(value).max(initial=0.0), 4.0, 8.0))
        what = "significance of the change, in standard deviations"
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.log(c.value_b[rows] / c.value_a[rows])
        label, marked = "ln(B/A)", np.zeros(rows.size, dtype=bool)
        value = np.where(np.isfinite(value), value, 0.0)
        top = max(float(np.quantile(np.abs(value), 0.95)), 1e-6)
        what = "ln(B/A)"
    rings = "; upright triangles: above 0" + ("; rings mark values that changed" if c.verdict is not None else "")
    dphi = at.phi_r - at.phi_i
    off = np.abs(np.sin(at.theta_r) * np.sin(dphi)) > np.sin(IN_PLANE)
    out = []
    flat = np.flatnonzero(~off)
    if flat.size:
        angle = geometry.in_plane_angle(at.theta_r[flat], dphi[flat])
        levels = np.unique(np.round(np.degrees(at.theta_i[flat]), 1)).size
        high = max(1.3 + 0.22 * levels, 2.1)

        def plane(figure: Any) -> None:
            ax = figure.add_subplot()
            figure.subplots_adjust(0.1, 0.55 / high, 0.9, 0.94)
            maps.plane_map(
                ax, angle, at.theta_i[flat], value[flat], label=label, top=top, y_label="θi", marked=marked[flat]
            )
            ax.set_xlabel("θr: retro side negative, mirror side positive")

        if levels <= 24:
            caption = f"Map of the plane of incidence{where}: {what}{rings}."
            out.append(rendered("map-plane", "map", "", caption, caption, (5.6, high), plane))
    every = [g for g in groups(at.theta_i, at.phi_i, np.arange(len(at))) if np.count_nonzero(off[g]) >= 4]
    some = (
        [every[k] for k in np.unique(np.round(np.linspace(0, len(every) - 1, min(MOST_DISCS, len(every)))).astype(int))]
        if every
        else []
    )
    for k, g in enumerate(some):

        def disc(figure: Any, g: Any = g) -> None:
            ax = figure.add_axes((0.02, 0.04, 0.84, 0.94))
            maps.change_map(ax, at.theta_r[g], dphi[g], value[g], label=label, top=top, marked=marked[g])

        theta = f"θi = {np.degrees(at.theta_i[g].mean()):.1f}°"
        caption = f"Map of the hemisphere, {theta}{where}: {what}{rings}. Empty: no shared direction."
        out.append(rendered(f"map-{k + 1}", "map", "", caption, caption, (4.6, 4.0), disc))
    return out


def _legend(figure: Any, lines: Sequence[Line]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], lw=1.5, ms=3.5, label=line.label, **polar.style(k)) for k, line in enumerate(lines)]
    columns = min(len(handles), 6 if len(lines[0].label) < 12 else 3)
    figure.legend(
        handles=handles, loc="lower center", ncol=columns, fontsize=7.5, frameon=False, handlelength=1.6,
        columnspacing=1.1, borderpad=0.1,
    )  # fmt: skip
