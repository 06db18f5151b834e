"""The figures of a comparison point by point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.changes.point_by_point import Change
from gonio_analysis.changes.verdict import LEVEL
from gonio_analysis.curves.in_plane import Curve, groups, labels
from gonio_analysis.curves.line import Line
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import in_plane, maps, thinning
from gonio_analysis.report.detail import DISC_PT
from gonio_analysis.report.drawings import Drawing
from gonio_analysis.report.figures import LEGEND_ROW_IN, PANEL_PT, key

MOST_DISCS = 4
MOST_DRAWN = 2400
"""Values in one panel."""


def draw(c: Change, at: Observations, drawn: list[Curve], shown: float) -> list[Drawing]:
    """Every figure of a comparison: `at` holds the directions and `drawn` the curves of the wavelength `shown` [nm]."""
    out = []
    where = "" if math.isnan(shown) else f" at {shown:g} nm"
    if drawn:
        out.append(_values(c, at, drawn, where))
        if c.verdict is not None:
            out.append(_changes(c, at, drawn, where))
    return out + (_change_maps(c, at, where) if np.any(c.difference[at.rows]) else [])  # of equal values all is white


def _made(c: Change) -> str:
    """A sentence on which side is simulated; "" where none is."""
    which = [letter for letter, x in (("A", c.a), ("B", c.b)) if x.simulated]
    return f" Simulated: {' and '.join(which)}." if which else ""


def _values(c: Change, at: Observations, drawn: list[Curve], where: str) -> Drawing:
    every = []
    for curve, label in zip(drawn, labels(drawn), strict=True):
        rows, k = at.rows[curve.rows], thinning.of_curve(curve, thinning.share(drawn, MOST_DRAWN))
        solid = at.rows[k.rows]
        every.append(Line(label, k.angle, c.value_b[solid], curve.angle, c.value_a[rows], c.u_a[rows]))
    lines = thinning.on_logarithm(every, PANEL_PT, 0.7 * PANEL_PT, MOST_DRAWN)
    points = (c.a.kind == "measurement", c.b.kind == "measurement")
    filled, hollow = (", filled markers" * points[0], ", hollow markers" * points[1])
    caption = f"In the plane of incidence{where}: {c.a.title} (dashed{filled}) and {c.b.title} (solid{hollow})."
    caption += thinning.words(thinning.measured(lines), thinning.measured(every))
    names = (f"A: {c.a.title}", f"B: {c.b.title}")
    on = partial(_on_values, lines=lines, points=points, names=names)
    return Drawing("values", "values", "", caption, caption, (5.6, 4.4), on)


def _on_values(figure: Any, *, lines: list[Line], points: tuple[bool, bool], names: tuple[str, str]) -> None:
    columns = _columns(lines)
    below = (0.45 + LEGEND_ROW_IN * (-(-len(lines) // columns) + 1)) / figure.get_figheight()
    ax = figure.add_axes((0.135, below, 0.83, 0.975 - below))
    maps.both(ax, lines, points)
    ax.set_xlabel("θr: retro side negative, mirror side positive")
    _legend(figure, lines, in_plane.pair(*names, points))


def _changes(c: Change, at: Observations, drawn: list[Curve], where: str) -> Drawing:
    assert c.verdict is not None
    relative, scores, marks = [], [], []
    nothing = np.empty(0)
    most = thinning.share(drawn, MOST_DRAWN)
    for curve, label in zip(drawn, labels(drawn), strict=True):
        rows = at.rows[curve.rows]
        a, u, z, marked = c.value_a[rows], c.u[rows], c.verdict.z[rows], c.verdict.marked[rows]
        some = thinning.residuals(curve.angle, z, PANEL_PT, 0.25 * PANEL_PT, most, keep=marked)
        scores.append(Line(label, nothing, nothing, curve.angle[some], z[some], z[some] * np.nan))
        large = np.flatnonzero(a > 3 * u)
        change = c.difference[rows][large] / a[large]
        some = thinning.residuals(curve.angle[large], change, PANEL_PT, 0.4 * PANEL_PT, most, keep=marked[large])
        large, change = large[some], change[some]
        relative.append(Line(label, nothing, nothing, curve.angle[large], 100 * change, 100 * u[large] / a[large]))
        marks.append(marked[large])
    limit = _limit(len(c.at))
    caption = (
        f"Change{where}: above, (B − A)/A with the standard uncertainty of the difference, where A is above three of"
        " them; rings mark values that changed. Below, each difference against what all the others predict, in standard"
        f" deviations (band: ±2; dashed: ±{limit:.2g}, which the largest of all {len(c.at)} exceeds by chance in"
        f" {100 * LEVEL:g} % of comparisons).{_made(c)}"
        + thinning.words(thinning.measured(scores), sum(curve.angle.size for curve in drawn))
    )
    alt = (
        f"Relative change over angle and its significance; {int(c.verdict.marked.sum())} values are marked as changed."
    )
    on = partial(_on_changes, relative=relative, marks=marks, scores=scores, limit=limit)
    return Drawing("change", "change", "", caption, alt, (5.6, 4.4), on)


def _on_changes(figure: Any, *, relative: list[Line], marks: list[Any], scores: list[Line], limit: float) -> None:
    top, low = figure.subplots(2, 1, height_ratios=(1.7, 1), sharex=True)
    figure.subplots_adjust(0.135, 0.17, 0.975, 0.975, hspace=0.12)
    maps.changes(top, relative, marks)
    maps.significance(low, scores, limit)
    low.set_xlabel("θr: retro side negative, mirror side positive")
    figure.align_ylabels([top, low])
    _legend(figure, relative)


def _limit(n: int) -> float:
    from scipy.special import ndtri

    return float(-ndtri(-math.expm1(math.log1p(-LEVEL) / n) / 2))


def _change_maps(c: Change, at: Observations, where: str) -> list[Drawing]:
    rows, without = at.rows, ""
    if c.verdict is not None:
        value, label, marked = c.verdict.z[rows], "standard deviations", c.verdict.marked[rows]
        top = float(np.clip(np.abs(value).max(initial=0.0), 4.0, 8.0))
        what = "significance of the change, in standard deviations"
    else:
        both = (c.value_a[rows] > 0) & (c.value_b[rows] > 0)
        if not both.all():
            without = f" {rows.size - int(both.sum())} directions, in which A or B is not above 0, have no logarithm."
            at, rows = at.take(np.flatnonzero(both)), rows[both]
        value = np.log(c.value_b[rows] / c.value_a[rows])
        label, marked = "ln(B/A)", np.zeros(rows.size, dtype=bool)
        top = max(float(np.quantile(np.abs(value), 0.95)) if rows.size else 0.0, 1e-3)
        what = "ln(B/A)"
    rings = "; upright triangles: above 0, circles: 0" + (
        "; rings mark values that changed" if c.verdict is not None else ""
    )
    d = at.directions
    off = ~d.in_plane
    out = []
    flat = np.flatnonzero(~off)
    if flat.size:
        angle = d[flat].signed
        tilts = np.round(np.degrees(d.theta_i[flat]), 1)
        levels = np.unique(tilts)
        high = max(1.3 + 0.22 * levels.size, 2.1)
        if levels.size <= 24:
            # one row of the map a level: values overlap only along it
            heights = 100.0 * np.searchsorted(levels, tilts).astype(np.float64)
            across = angle * PANEL_PT / np.pi
            kept = thinning.enough(across, heights, most=MOST_DRAWN, keep=marked[flat])
            kept = np.union1d(kept, thinning.ends(value[flat])).astype(np.intp)
            caption = f"Map of the plane of incidence{where}: {what}{rings}.{without}{_made(c)}"
            caption += thinning.words(kept.size, flat.size)
            on = partial(
                on_plane, angle=angle[kept], parameter=np.radians(tilts[kept]), value=value[flat][kept],
                marked=marked[flat][kept], label=label, top=top, high=high,
            )  # fmt: skip
            out.append(Drawing("map-plane", "map", "", caption, caption, (5.6, high), on))
    every = [g for g in groups(d.theta_i, d.phi_i, np.arange(len(at))) if np.count_nonzero(off[g]) >= 4]
    some = (
        [every[k] for k in np.unique(np.round(np.linspace(0, len(every) - 1, min(MOST_DISCS, len(every)))).astype(int))]
        if every
        else []
    )
    for k, g in enumerate(some):
        kept = thinning.over_hemisphere(d[g].theta_r, d[g].dphi, value[g], DISC_PT, MOST_DRAWN, keep=marked[g])
        theta = f"θi = {np.degrees(d.theta_i[g].mean()):.1f}°"
        caption = (
            f"Map of the hemisphere, {theta}{where}: {what}{rings}. Empty: no shared direction.{without}{_made(c)}"
        )
        caption += thinning.words(kept.size, g.size)
        h = g[kept]
        on = partial(
            on_disc, theta_r=d[h].theta_r, dphi=d[h].dphi, value=value[h], marked=marked[h], label=label, top=top
        )
        out.append(Drawing(f"map-{k + 1}", "map", "", caption, caption, (4.6, 4.0), on))
    return out


def on_plane(
    figure: Any, *, angle: Floats, parameter: Floats, value: Floats, marked: maps.Marks, label: str, top: float,
    high: float,
) -> None:  # fmt: skip
    ax = figure.add_subplot()
    figure.subplots_adjust(0.1, 0.55 / high, 0.9, 0.94)
    maps.plane_map(ax, angle, parameter, value, label=label, top=top, y_label="θi", marked=marked)
    ax.set_xlabel("θr: retro side negative, mirror side positive")


def on_disc(
    figure: Any, *, theta_r: Floats, dphi: Floats, value: Floats, marked: maps.Marks, label: str, top: float
) -> None:
    ax = figure.add_axes((0.02, 0.04, 0.84, 0.94))
    maps.change_map(ax, theta_r, dphi, value, label=label, top=top, marked=marked)


def _columns(lines: Sequence[Line]) -> int:
    """Of the legend."""
    return min(len(lines), 6 if max(len(line.label) for line in lines) < 12 else 3)


def _legend(figure: Any, lines: Sequence[Line], kinds: Sequence[Any] = ()) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], lw=1.5, ms=3.5, label=line.label, **in_plane.style(k)) for k, line in enumerate(lines)]
    key(figure, handles, _columns(lines), kinds)
