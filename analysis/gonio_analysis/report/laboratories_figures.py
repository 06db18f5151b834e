"""The figures of a comparison of laboratories."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gonio.geometry import groups
from gonio.typing import Floats
from gonio_analysis.changes.laboratories import Comparison, Laboratory
from gonio_analysis.curves.in_plane import Curve, curves, evenly
from gonio_analysis.curves.line import Line
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import half_disc, in_plane, thinning
from gonio_analysis.plots.style import FAINT, INK
from gonio_analysis.report.change_figures import MOST_DRAWN, disc_map, plane_map, plane_rows
from gonio_analysis.report.detail import DISC_PT
from gonio_analysis.report.drawings import Drawing
from gonio_analysis.report.figures import LEGEND_ROW_IN, key

MOST_MAPS = 4
"""Laboratories that have maps: those farthest off."""
OFF = "#b3261e"
"""Of a laboratory that is not consistent."""
COLUMNS = 6
"""Of a legend."""


def draw(c: Comparison) -> list[Drawing]:
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


def _overview(c: Comparison) -> Drawing:
    caption = (
        "Overview: degrees of equivalence of scales with their expanded uncertainties (k = 2), zeros of the angle with"
        " theirs, and scatter over what is stated. Red: not consistent with the others."
    )
    high = 1.0 + 0.26 * len(c.laboratories)
    return Drawing("overview", "overview", "", caption, caption, (7.0, high), partial(_on_overview, who=c.laboratories))


def _on_overview(figure: Any, *, who: Sequence[Laboratory]) -> None:
    axes = figure.subplots(1, 3, sharey=True)
    high = figure.get_figheight()
    figure.subplots_adjust(0.16, 0.52 / high, 0.985, 1.0 - 0.12 / high, wspace=0.08)
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
                ax.errorbar(value, row, xerr=u or None, fmt="o", ms=4, **look)
        ax.set_xlabel(label)
        in_plane.clean(ax)
    axes[2].set_xlim(0.0, None if any(value > 0 and math.isfinite(value) for value in scatters) else 2.0)
    axes[0].set_yticks(rows, [x.name for x in who])
    axes[0].set_ylim(-0.6, len(who) - 0.4)


def _polar(c: Comparison, at: Observations, curve: Curve, where: str) -> Drawing:
    rows, none = at.rows[curve.rows], np.empty(0)
    lines = [
        Line(x.name, curve.angle, values[rows], none, none, u[rows])
        for x, values, u in zip(c.laboratories, c.values, c.u, strict=True)
    ]
    caption = f"{curve.label}{where}: BRDF of every laboratory, with bands of two standard uncertainties."
    high = 3.9 + LEGEND_ROW_IN * (len(lines) // COLUMNS)
    return Drawing("polar", "polar", "", caption, caption, (6.4, high), partial(_on_polar, lines=lines))


def _on_polar(figure: Any, *, lines: list[Line]) -> None:
    below = LEGEND_ROW_IN * (1 + (len(lines) - 1) // COLUMNS) / figure.get_figheight()
    ax = figure.add_axes((0.04, below, 0.92, 0.97 - below))
    rim = in_plane.radius_of([replace(x, angle=x.theory_angle, measured=x.theory) for x in lines], math.inf)
    in_plane.polar(ax, lines, radius=rim, radius_label="BRDF / sr⁻¹")
    for k, line in enumerate(lines):
        high, low = (np.clip(line.theory + s * 2.0 * line.u, 0.0, rim) for s in (1.0, -1.0))
        out, back = half_disc.xy(line.theory_angle, high), half_disc.xy(line.theory_angle, low)
        x, y = (np.concatenate([a, b[::-1]]) for a, b in zip(out, back, strict=True))
        ax.fill(x, y, color=in_plane.style(k)["color"], alpha=0.18, lw=0.0, zorder=2)
    key(figure, in_plane.handles(lines), min(COLUMNS, len(lines)))


def _deviations(c: Comparison, at: Observations, along: Sequence[Curve], where: str) -> Drawing:
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
        ax.set_title(name, fontsize=8, pad=2)
        in_plane.angle_axis(ax)
        ax.set_xticks([-60, -30, 0, 30, 60])
        in_plane.clean(ax)
    axes[0][0].set_ylim(-reach, reach)
    for row in axes:
        row[0].set_ylabel("deviation / %")
    axes[-1][0].set_xlabel("θr")


def _youden(c: Comparison) -> Drawing:
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
    for x, y, name, ok in points:
        ax.plot(x, y, "o", ms=5, color=INK if ok else OFF)
        ax.annotate(name, (x, y), xytext=(4, 3), textcoords="offset points", fontsize=7.5)
    ends = (-reach, reach)
    ax.set(xlim=ends, ylim=ends, xlabel="near the mirror direction / %", ylabel="elsewhere / %")
    in_plane.clean(ax)


def _maps(c: Comparison, at: Observations, where: str) -> list[Drawing]:
    """E_n over the directions of those laboratories that are farthest off."""
    score = np.array([x.e_n for x in c.alone])
    farthest = sorted(range(len(c.laboratories)), key=lambda k: -float(np.mean(score[:, k] ** 2)))[:MOST_MAPS]
    out, d = [], at.directions
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
            g = g[thinning.over_hemisphere(d[g].theta_r, d[g].dphi, value[g], DISC_PT, MOST_DRAWN)]
            caption = f"{said}. Hemisphere, θi = {np.degrees(d.theta_i[g].mean()):.1f}°."
            out.append(disc_map(map_name, caption, d[g], value[g], far[g], "E_n", 2.0))
    return out
