"""The figures of a comparison point by point, and maps of signed values, which other comparisons have too."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.geometry import Directions, groups
from gonio.typing import Floats, Ints
from gonio_analysis.changes.point_by_point import Change
from gonio_analysis.changes.verdict import LEVEL
from gonio_analysis.curves.in_plane import Curve, evenly, labels
from gonio_analysis.curves.line import Line
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import in_plane, maps, thinning
from gonio_analysis.report.detail import DISC_PT
from gonio_analysis.report.drawings import Drawing
from gonio_analysis.report.figures import LEGEND_ROW_IN, PANEL_PT, legend

MOST_DISCS = 4
MOST_LEVELS = 24
"""Incidences of a map of the plane."""
MOST_DRAWN = 2400
"""Values in one panel."""


def draw(c: Change, at: Observations, drawn: list[Curve], shown: float) -> list[Drawing]:
    """Every figure of a comparison: `at` holds the directions and `drawn` the curves of the wavelength `shown` [nm]."""
    where = "" if math.isnan(shown) else f" at {shown:g} nm"
    out = [_values(c, at, drawn, where)] if drawn else []
    out += [_changes(c, at, drawn, where)] if drawn and c.verdict is not None else []
    return out + (_change_maps(c, at, where) if np.any(c.difference[at.rows]) else [])  # of equal values all is white


def _made(c: Change) -> str:
    """A sentence on which side is simulated; "" where none is."""
    which = [letter for letter, x in (("A", c.a), ("B", c.b)) if x.simulated]
    return f" Simulated: {' and '.join(which)}." if which else ""


def _values(c: Change, at: Observations, drawn: list[Curve], where: str) -> Drawing:
    every = []
    for curve, label in zip(drawn, labels(drawn), strict=True):
        rows, k = at.rows[curve.rows], thinning.of_curve(curve, thinning.share(drawn, MOST_DRAWN))
        every.append(Line(label, k.angle, c.value_b[at.rows[k.rows]], curve.angle, c.value_a[rows], c.u_a[rows]))
    lines = thinning.on_logarithm(every, PANEL_PT, 0.7 * PANEL_PT, MOST_DRAWN)
    points = (c.a.kind == "measurement", c.b.kind == "measurement")
    filled, hollow = (", filled markers" * points[0], ", hollow markers" * points[1])
    caption = f"In the plane of incidence{where}: {c.a.title} (dashed{filled}) and {c.b.title} (solid{hollow})."
    caption += thinning.words(thinning.measured(lines), thinning.measured(every))
    on = partial(_on_values, lines=lines, points=points, names=(f"A: {c.a.title}", f"B: {c.b.title}"))
    return Drawing("values", "values", "", caption, caption, (5.6, 4.4), on)


def _on_values(figure: Any, *, lines: list[Line], points: tuple[bool, bool], names: tuple[str, str]) -> None:
    below = (0.45 + LEGEND_ROW_IN * (-(-len(lines) // _columns(lines)) + 1)) / figure.get_figheight()
    ax = figure.add_axes((0.135, below, 0.83, 0.975 - below))
    maps.both(ax, lines, points)
    ax.set_xlabel("θr: retro side negative, mirror side positive")
    legend(figure, [line.label for line in lines], _columns(lines), in_plane.pair(*names, points))


def _changes(c: Change, at: Observations, drawn: list[Curve], where: str) -> Drawing:
    assert c.verdict is not None
    relative, scores, marks, nothing = list[Line](), list[Line](), [], np.empty(0)
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
    changed = int(c.verdict.marked.sum())
    alt = f"Relative change over angle and its significance; {changed} values are marked as changed."
    on = partial(_on_changes, relative=relative, marks=marks, scores=scores, limit=limit)
    return Drawing("change", "change", "", caption, alt, (5.6, 4.4), on)


def _on_changes(figure: Any, *, relative: list[Line], marks: list[Any], scores: list[Line], limit: float) -> None:
    top, low = figure.subplots(2, 1, height_ratios=(1.7, 1), sharex=True)
    figure.subplots_adjust(0.135, 0.17, 0.975, 0.975, hspace=0.12)
    maps.changes(top, relative, marks)
    maps.significance(low, scores, limit)
    low.set_xlabel("θr: retro side negative, mirror side positive")
    figure.align_ylabels([top, low])
    legend(figure, [line.label for line in relative], _columns(relative))


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
        what = label = "ln(B/A)"
        marked = np.zeros(rows.size, dtype=bool)
        top = max(float(np.quantile(np.abs(value), 0.95)) if rows.size else 0.0, 1e-3)
    what += "; upright triangles: above 0, circles: 0" + "; rings mark values that changed" * (c.verdict is not None)
    d = at.directions
    off, out = ~d.in_plane, []
    flat = np.flatnonzero(~off)
    if flat.size and np.unique(np.round(np.degrees(d.theta_i[flat]), 1)).size <= MOST_LEVELS:
        kept = np.union1d(plane_rows(d[flat], marked[flat], MOST_DRAWN), thinning.ends(value[flat])).astype(np.intp)
        caption = f"Map of the plane of incidence{where}: {what}.{without}{_made(c)}"
        caption += thinning.words(kept.size, flat.size)
        out.append(plane_map("map-plane", caption, d[flat], value[flat], marked[flat], kept, label, top))
    every = [g for g in groups(d.theta_i, d.phi_i, np.arange(len(at))) if np.count_nonzero(off[g]) >= 4]
    for k, g in enumerate(every[place] for place in evenly(len(every), MOST_DISCS)):
        h = g[thinning.over_hemisphere(d[g].theta_r, d[g].dphi, value[g], DISC_PT, MOST_DRAWN, keep=marked[g])]
        theta = f"θi = {np.degrees(d.theta_i[g].mean()):.1f}°"
        caption = f"Map of the hemisphere, {theta}{where}: {what}. Empty: no shared direction.{without}{_made(c)}"
        caption += thinning.words(h.size, g.size)
        out.append(disc_map(f"map-{k + 1}", caption, d[h], value[h], marked[h], label, top))
    return out


def plane_rows(d: Directions, marked: maps.Marks, most: int) -> Ints:
    """Which values of a map of the plane of incidence to draw; marked ones go before others."""
    tilts = np.round(np.degrees(d.theta_i), 1)
    # one row of the map a level: values overlap only along it
    heights = 100.0 * np.searchsorted(np.unique(tilts), tilts).astype(np.float64)
    return thinning.enough(d.signed * PANEL_PT / np.pi, heights, most=most, keep=marked)


def plane_map(
    name: str, caption: str, d: Directions, value: Floats, marked: maps.Marks, kept: Ints, label: str, top: float
) -> Drawing:
    """A map over the signed angle and the incidences of directions in the plane, of which those `kept` are drawn."""
    tilts = np.round(np.degrees(d.theta_i), 1)
    high = max(1.3 + 0.22 * np.unique(tilts).size, 2.1)
    on = partial(
        _on_plane, angle=d.signed[kept], parameter=np.radians(tilts[kept]), value=value[kept], marked=marked[kept],
        label=label, top=top,
    )  # fmt: skip
    return Drawing(name, "map", "", caption, caption, (5.6, high), on)


def _on_plane(figure: Any, *, angle: Floats, parameter: Floats, value: Floats, **look: Any) -> None:
    ax = figure.add_subplot()
    figure.subplots_adjust(0.1, 0.55 / figure.get_figheight(), 0.9, 0.94)
    maps.plane_map(ax, angle, parameter, value, y_label="θi", **look)
    ax.set_xlabel("θr: retro side negative, mirror side positive")


def disc_map(
    name: str, caption: str, d: Directions, value: Floats, marked: maps.Marks, label: str, top: float
) -> Drawing:
    """A map over the directions of the receiver at one incidence."""
    on = partial(_on_disc, theta_r=d.theta_r, dphi=d.dphi, value=value, marked=marked, label=label, top=top)
    return Drawing(name, "map", "", caption, caption, (4.6, 4.0), on)


def _on_disc(figure: Any, *, theta_r: Floats, dphi: Floats, value: Floats, **look: Any) -> None:
    maps.change_map(figure.add_axes((0.02, 0.04, 0.84, 0.94)), theta_r, dphi, value, **look)


def _columns(lines: Sequence[Line]) -> int:
    """Of the legend."""
    return min(len(lines), 6 if max(len(line.label) for line in lines) < 12 else 3)
