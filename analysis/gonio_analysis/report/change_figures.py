"""The figures of a comparison point by point, and maps of signed values, which other comparisons have too.

Among these are the figures of a comparison of laboratories.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gonio.geometry import Directions, groups
from gonio.typing import Floats, Ints
from gonio_analysis.changes.laboratories import LaboratoryComparison, LaboratoryVerdict
from gonio_analysis.changes.point_by_point import Change
from gonio_analysis.changes.verdict import LEVEL
from gonio_analysis.curves.in_plane import Curve, Line, curves, evenly, labels
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import in_plane, maps, thinning
from gonio_analysis.plots.style import FAINT, INK, WIDE, around, beside_points, columns, short, xy
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.figures import LEGEND_ROW_IN, PANEL_PT, key, legend

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
    d = at.directions.settled_at_normal()
    off, out = ~d.in_plane, []
    flat = np.flatnonzero(~off)
    if flat.size and np.unique(np.round(np.degrees(d.theta_i[flat]), 1)).size <= MOST_LEVELS:
        kept = np.union1d(plane_rows(d[flat], marked[flat], MOST_DRAWN), thinning.ends(value[flat])).astype(np.intp)
        caption = f"Map of the plane of incidence{where}: {what}.{without}{_made(c)}"
        caption += thinning.words(kept.size, flat.size)
        out.append(plane_map("map-plane", caption, d[flat], value[flat], marked[flat], kept, label, top))
    every = [g for g in groups(d.theta_i, d.phi_i, np.arange(len(at))) if np.count_nonzero(off[g]) >= 4]
    for k, g in enumerate(every[place] for place in evenly(len(every), MOST_DISCS)):
        h = g[thinning.over_hemisphere(d[g].theta_r, d[g].dphi, value[g], MOST_DRAWN, keep=marked[g])]
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
    """Columns of the legend."""
    return columns([line.label for line in lines], 5.6)


MOST_MAPS = 4
"""Laboratories that have maps: those farthest off."""
OFF = "#b3261e"
"""Colour of a laboratory that is not consistent."""
LABORATORIES_IN = 6.4
"""Width of their polar plot."""


def draw_laboratories(c: LaboratoryComparison) -> list[Drawing]:
    """Every figure."""
    out = [_overview(c)]
    at, shown = c.at.nearest(None)
    at = replace(at, rows=np.flatnonzero(np.isin(c.at.rows, at.rows)))
    where = "" if math.isnan(shown) else f" at {shown:g} nm"
    along = curves(at)
    if along:
        out += [_polar(c, at, max(along, key=lambda one: one.rows.size), where), _deviations(c, at, along, where)]
    out += [_youden(c)] if len(c.at) >= 4 else []
    return out + _maps(c, at, where)


def _overview(c: LaboratoryComparison) -> Drawing:
    caption = (
        "Overview: degrees of equivalence of scales with their expanded uncertainties (k = 2), zeros of the angle with"
        " theirs, and scatter over what is stated. Red diamonds: not consistent with the others."
    )
    high = 1.0 + 0.26 * len(c.laboratories)
    return Drawing("overview", "overview", "", caption, caption, (7.0, high), partial(_on_overview, who=c.laboratories))


def _on_overview(figure: Any, *, who: Sequence[LaboratoryVerdict]) -> None:
    axes = figure.subplots(1, 3, sharey=True)
    high = figure.get_figheight()
    figure.subplots_adjust(0.16, 0.52 / high, 0.985, 1.0 - 0.12 / high, wspace=0.16)
    rows = np.arange(len(who))[::-1]
    zeros = [(math.nan if x.zero is None else math.degrees(x.zero), 2 * math.degrees(x.u_zero or 0.0)) for x in who]
    scatters = [math.nan if x.scatter is None else x.scatter for x in who]
    panels = (
        ("scale: d ± U / %", 0.0, [(100 * x.degree, 200 * x.u_degree) for x in who], [x.scale_consistent for x in who]),
        ("zero ± U / °", 0.0, zeros, [x.zero_consistent for x in who]),
        ("scatter / stated", 1.0, [(value, 0.0) for value in scatters], [x.scatter_consistent for x in who]),
    )
    for ax, (label, level, values, fine) in zip(axes, panels, strict=True):
        ax.axvline(level, color=FAINT, lw=1.0, zorder=0)
        for row, (value, u), ok in zip(rows, values, fine, strict=True):
            if math.isnan(value):
                ax.text(level, row, "undetermined", ha="center", va="center", fontsize=7, color="#777777")
            else:
                look = {"color": INK if ok else OFF, "elinewidth": 1.2, "capsize": 2}
                ax.errorbar(value, row, xerr=u or None, fmt="o" if ok else "D", ms=4, **look)
        ax.locator_params(axis="x", nbins=5)
        ax.set_xlabel(label)
        in_plane.clean(ax)
    positive = [value for value in scatters if value > 0 and math.isfinite(value)]
    axes[2].set_xlim(0.0, 1.08 * max([*positive, 1.0]) if positive else 2.0)  # marks stand clear of the edge
    axes[0].set_yticks(rows, [short(x.name, 1.5, handle_pt=0.0) for x in who])
    axes[0].set_ylim(-0.6, len(who) - 0.4)


def _polar(c: LaboratoryComparison, at: Observations, curve: Curve, where: str) -> Drawing:
    rows, none = at.rows[curve.rows], np.empty(0)
    lines = [
        Line(x.name, curve.angle, values[rows], none, none, u[rows])
        for x, values, u in zip(c.laboratories, c.values, c.u, strict=True)
    ]
    rim = in_plane.radius_of(lines, math.inf)
    caption = f"{curve.label}{where}: BRDF of every laboratory, with bands of two standard uncertainties"
    caption += " (thin lines, where they are as large as the values)." if any(map(_wide, lines)) else "."
    caption += in_plane.rim_words(lines, rim)
    legend_rows = -(-len(lines) // columns([line.label for line in lines], LABORATORIES_IN))
    size = (LABORATORIES_IN, 3.7 + LEGEND_ROW_IN * legend_rows)
    return Drawing("polar", "polar", "", caption, caption, size, partial(_on_polar, lines=lines, rim=rim))


def _wide(line: Line) -> bool:
    """Whether two lines stand for the band of two standard uncertainties."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return bool(np.nanmedian(1.0 + 2.0 * line.u / np.abs(line.theory)) >= WIDE)


def _on_polar(figure: Any, *, lines: list[Line], rim: float) -> None:
    beside = columns([line.label for line in lines], LABORATORIES_IN)
    below = LEGEND_ROW_IN * -(-len(lines) // beside) / figure.get_figheight()
    ax = figure.add_axes((0.04, below, 0.92, 0.97 - below))
    in_plane.polar(ax, lines, radius=rim, radius_label="BRDF / sr⁻¹")
    for k, line in enumerate(lines):
        high, low = (np.clip(line.theory + s * 2.0 * line.u, 0.0, rim) for s in (1.0, -1.0))
        edges = xy(line.theory_angle, low), xy(line.theory_angle, high)
        around(ax, *edges, in_plane.style(k)["color"], wide=_wide(line))
    key(figure, in_plane.handles(lines), beside)


def _deviations(c: LaboratoryComparison, at: Observations, along: Sequence[Curve], where: str) -> Drawing:
    every = np.concatenate([at.rows[curve.rows] for curve in along])
    kept = evenly(every.size, MOST_DRAWN // 2)
    angle, rows = np.concatenate([curve.angle for curve in along])[kept], every[kept]
    level = c.at.brdf[rows]
    parts = [
        (x.name, angle, 100 * (values[rows] / level - 1), 200 * u[rows] / np.abs(level))
        for x, values, u in zip(c.laboratories, c.values, c.u, strict=True)
    ]
    caption = (
        f"In the plane of incidence{where}: deviation of every laboratory from the consensus, in percent, with its"
        " expanded uncertainty (k = 2); the consensus' level is the zero."
    )
    high = 0.5 + 1.55 * -(-len(parts) // 3)
    on = partial(_on_deviations, parts=parts)
    return Drawing("deviations", "deviations", "", caption, caption, (7.0, high), on)


def _on_deviations(figure: Any, *, parts: Sequence[tuple[str, Floats, Floats, Floats]]) -> None:
    axes = figure.subplots(-(-len(parts) // 3), min(3, len(parts)), sharex=True, sharey=True, squeeze=False)
    high = figure.get_figheight()
    figure.subplots_adjust(0.09, 0.45 / high, 0.985, 1.0 - 0.22 / high, wspace=0.06, hspace=0.28)
    reach = 1.6 * max(float(np.nanquantile(np.abs(off), 0.98)) for _, _, off, _ in parts)
    for ax in axes.ravel()[len(parts) :]:
        ax.set_visible(False)
    for k, (ax, (name, angle, off, half)) in enumerate(zip(axes.ravel(), parts, strict=False)):
        ax.axhline(0.0, color=FAINT, lw=1.0, zorder=0)
        look = {"fmt": ".", "ms": 3, "color": in_plane.style(k)["color"], "elinewidth": 0.4, "alpha": 0.8}
        ax.errorbar(np.degrees(angle), off, yerr=half, **look)
        ax.set_title(short(name, 2.1, handle_pt=0.0), fontsize=8, pad=2)
        in_plane.angle_axis(ax)
        ax.set_xticks([-60, -30, 0, 30, 60])
        in_plane.clean(ax)
    axes[0][0].set_ylim(-reach, reach)
    for row in axes:
        row[0].set_ylabel("deviation / %")
    axes[-1][0].set_xlabel("θr")


def _youden(c: LaboratoryComparison) -> Drawing:
    """A Youden plot of two halves of the directions instead of two samples."""
    far = c.at.directions.mirror_offset
    near = far <= np.median(far)
    deviation = c.values / c.at.brdf - 1.0
    weight = 1.0 / (c.u / np.abs(c.at.brdf)) ** 2
    halves = [
        100 * np.sum((weight * deviation)[:, rows], axis=1) / weight[:, rows].sum(axis=1) for rows in (near, ~near)
    ]
    caption = (
        "Youden plot: each laboratory's mean deviation from the consensus in the half of the directions that is nearer"
        " to the mirror direction, against the other half. On the diagonal lies what is alike at all angles, as a"
        " reference; off it what is not."
    )
    points = [(x, y, one.name, one.consistent) for x, y, one in zip(*halves, c.laboratories, strict=True)]
    return Drawing("youden", "youden", "", caption, caption, (6.4, 3.4), partial(_on_youden, points=points))


def _on_youden(figure: Any, *, points: Sequence[tuple[float, float, str, bool]]) -> None:
    ax = figure.add_axes((0.27, 0.14, 0.46, 0.84))
    reach = 1.35 * max(1e-6, *(abs(value) for x, y, *_ in points for value in (x, y)))
    ax.plot([-reach, reach], [-reach, reach], color=FAINT, lw=1.0, zorder=0)
    ax.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
    ax.axvline(0.0, color=FAINT, lw=0.6, zorder=0)
    for x, y, _, ok in points:
        ax.plot(x, y, "o" if ok else "D", ms=5, color=INK if ok else OFF)
    ends = (-reach, reach)
    ax.set(xlim=ends, ylim=ends, xlabel="near the mirror direction / %", ylabel="elsewhere / %")
    beside_points(ax, [(x, y, short(name, 1.9, handle_pt=0.0)) for x, y, name, _ in points])
    in_plane.clean(ax)


def _maps(c: LaboratoryComparison, at: Observations, where: str) -> list[Drawing]:
    """E_n over the directions of those laboratories that are farthest off."""
    score = np.array([x.e_n for x in c.alone])
    farthest = sorted(range(len(c.laboratories)), key=lambda k: -float(np.mean(score[:, k] ** 2)))[:MOST_MAPS]
    out, d = [], at.directions.settled_at_normal()
    for k in sorted(farthest):
        map_name, name, value = f"map-{k + 1}", c.laboratories[k].name, score[at.rows, k]
        far = np.abs(value) > 1.0
        said = (
            f"{name}{where}: E_n in every direction; beyond ±1 (rings) it differs by more than its expanded uncertainty"
        )
        if d.in_plane.all():
            rows = plane_rows(d, far, MOST_DRAWN // 2)
            out.append(plane_map(map_name, f"{said}.", d, value, far, rows, "E_n", 2.0))
        else:
            g = max(groups(d.theta_i, d.phi_i, np.arange(len(at))), key=lambda rows: rows.size)
            g = g[thinning.over_hemisphere(d[g].theta_r, d[g].dphi, value[g], MOST_DRAWN)]
            caption = f"{said}. Hemisphere, θi = {np.degrees(d.theta_i[g].mean()):.1f}°."
            out.append(disc_map(map_name, caption, d[g], value[g], far[g], "E_n", 2.0))
    return out
