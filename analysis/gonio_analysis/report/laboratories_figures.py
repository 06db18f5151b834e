"""The figures of a comparison of laboratories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.changes.laboratories import Comparison, Laboratory
from gonio_analysis.curves.in_plane import Curve, curves, groups
from gonio_analysis.curves.line import Line
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.plots import half_disc, in_plane, thinning
from gonio_analysis.plots.style import FAINT, INK
from gonio_analysis.report.change_figures import MOST_DRAWN, on_disc, on_plane
from gonio_analysis.report.detail import DISC_PT
from gonio_analysis.report.drawings import Drawing
from gonio_analysis.report.figures import LEGEND_ROW_IN, PANEL_PT, key

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
        curve = max(along, key=lambda one: one.rows.size)
        out += [_polar(c, at, curve, where), _deviations(c, at, along, where)]
    out += [_youden(c)] if len(c.at) >= 4 else []
    return out + _maps(c, at, where)


def _names(c: Comparison) -> list[str]:
    return [x.name for x in c.laboratories]


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
    fine = [(x.scale_consistent, x.zero_consistent, x.scatter_consistent) for x in who]
    values = [
        [(100 * x.degree, 200 * x.u_degree) for x in who],
        [(math.nan if x.zero is None else math.degrees(x.zero), 2 * math.degrees(x.u_zero or 0.0)) for x in who],
        [(math.nan if x.scatter is None else x.scatter, 0.0) for x in who],
    ]
    labels = ("scale: d ± U / %", "zero ± U / °", "scatter / stated")
    for k, (ax, label, level) in enumerate(zip(axes, labels, (0.0, 0.0, 1.0), strict=True)):
        ax.axvline(level, color=FAINT, lw=1.0, zorder=0)
        for row, (value, u), ok in zip(rows, values[k], fine, strict=True):
            colour = INK if ok[k] else OFF
            if math.isnan(value):
                ax.text(level, row, "undetermined", ha="center", va="center", fontsize=7, color="#777777")
            else:
                ax.errorbar(value, row, xerr=u or None, fmt="o", ms=4, color=colour, elinewidth=1.2, capsize=2)
        ax.set_xlabel(label)
        in_plane.clean(ax)
    if not any(math.isfinite(v) and v > 0 for v, _ in values[2]):
        axes[2].set_xlim(0.0, 2.0)
    else:
        axes[2].set_xlim(left=0.0)
    axes[0].set_yticks(rows, [x.name for x in who])
    axes[0].set_ylim(-0.6, len(who) - 0.4)


def _polar(c: Comparison, at: Observations, curve: Curve, where: str) -> Drawing:
    rows = at.rows[curve.rows]
    lines = [
        Line(name, curve.angle, values[rows], np.empty(0), np.empty(0), u[rows])
        for name, values, u in zip(_names(c), c.values, c.u, strict=True)
    ]
    caption = f"{curve.label}{where}: BRDF of every laboratory, with bands of two standard uncertainties."
    on = partial(_on_polar, lines=lines)
    return Drawing("polar", "polar", "", caption, caption, (6.4, 3.9 + LEGEND_ROW_IN * (len(lines) // COLUMNS)), on)


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
    parts = []
    every = sum(curve.rows.size for curve in along)
    for name, values, u in zip(_names(c), c.values, c.u, strict=True):
        angle = np.concatenate([curve.angle for curve in along])
        rows = np.concatenate([at.rows[curve.rows] for curve in along])
        level = c.at.brdf[rows]
        off, half = 100 * (values[rows] / level - 1), 200 * u[rows] / np.abs(level)
        kept = np.unique(np.linspace(0, every - 1, min(every, MOST_DRAWN // 2)).astype(np.intp))
        parts.append((name, angle[kept], off[kept], half[kept]))
    caption = (
        f"In the plane of incidence{where}: deviation of every laboratory from the consensus, in percent, with its"
        " expanded uncertainty (k = 2); the consensus' level is the zero."
    )
    rows_of_panels = -(-len(parts) // 3)
    on = partial(_on_deviations, parts=parts)
    return Drawing("deviations", "deviations", "", caption, caption, (7.0, 0.5 + 1.55 * rows_of_panels), on)


def _on_deviations(figure: Any, *, parts: Sequence[tuple[str, Floats, Floats, Floats]]) -> None:
    down = -(-len(parts) // 3)
    across = min(3, len(parts))
    axes = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    high = figure.get_figheight()
    figure.subplots_adjust(0.09, 0.45 / high, 0.985, 1.0 - 0.22 / high, wspace=0.06, hspace=0.28)
    reach = max(float(np.nanquantile(np.abs(off), 0.98)) for _, _, off, _ in parts)
    for k, ax in enumerate(axes.ravel()):
        if k >= len(parts):
            ax.set_visible(False)
            continue
        name, angle, off, half = parts[k]
        ax.axhline(0.0, color=FAINT, lw=1.0, zorder=0)
        ax.errorbar(
            np.degrees(angle), off, yerr=half, fmt=".", ms=3, color=in_plane.style(k)["color"], elinewidth=0.4,
            alpha=0.8,
        )  # fmt: skip
        ax.set_title(name, fontsize=8, pad=2)
        in_plane.angle_axis(ax)
        ax.set_xticks([-60, -30, 0, 30, 60])
        in_plane.clean(ax)
    axes[0][0].set_ylim(-1.6 * reach, 1.6 * reach)
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
    fine = [x.consistent for x in c.laboratories]
    on = partial(_on_youden, near=halves[0], rest=halves[1], names=_names(c), fine=fine)
    return Drawing("youden", "youden", "", caption, caption, (6.4, 3.4), on)


def _on_youden(figure: Any, *, near: Floats, rest: Floats, names: Sequence[str], fine: Sequence[bool]) -> None:
    ax = figure.add_axes((0.27, 0.14, 0.46, 0.84))
    reach = 1.35 * max(float(np.abs(near).max()), float(np.abs(rest).max()), 1e-6)
    ax.plot([-reach, reach], [-reach, reach], color=FAINT, lw=1.0, zorder=0)
    ax.axhline(0.0, color=FAINT, lw=0.6, zorder=0)
    ax.axvline(0.0, color=FAINT, lw=0.6, zorder=0)
    for x, y, name, ok in zip(near, rest, names, fine, strict=True):
        ax.plot(x, y, "o", ms=5, color=INK if ok else OFF)
        ax.annotate(name, (x, y), xytext=(4, 3), textcoords="offset points", fontsize=7.5)
    ax.set_xlim(-reach, reach)
    ax.set_ylim(-reach, reach)
    ax.set_xlabel("near the mirror direction / %")
    ax.set_ylabel("elsewhere / %")
    in_plane.clean(ax)


def _maps(c: Comparison, at: Observations, where: str) -> list[Drawing]:
    """E_n over the directions of those laboratories that are farthest off."""
    score = np.array([x.e_n for x in c.alone])
    farthest = sorted(range(len(c.laboratories)), key=lambda k: -float(np.mean(score[:, k] ** 2)))[:MOST_MAPS]
    out, d = [], at.directions
    off = np.flatnonzero(~d.in_plane)
    for k in sorted(farthest):
        name, value = c.laboratories[k].name, score[at.rows, k]
        said = (
            f"{name}{where}: E_n in every direction; beyond ±1 (rings) it differs by more than its expanded uncertainty"
        )
        if off.size:
            g = max(groups(d.theta_i, d.phi_i, np.arange(len(at))), key=lambda rows: rows.size)
            g = g[thinning.over_hemisphere(d[g].theta_r, d[g].dphi, value[g], DISC_PT, MOST_DRAWN)]
            caption = f"{said}. Hemisphere, θi = {np.degrees(d.theta_i[g].mean()):.1f}°."
            on = partial(
                on_disc, theta_r=d[g].theta_r, dphi=d[g].dphi, value=value[g], marked=np.abs(value[g]) > 1.0,
                label="E_n", top=2.0,
            )  # fmt: skip
            out.append(Drawing(f"map-{k + 1}", "map", "", caption, caption, (4.6, 4.0), on))
            continue
        levels = np.unique(np.round(np.degrees(d.theta_i), 1))
        high = max(1.3 + 0.22 * levels.size, 2.1)
        across = d.signed * PANEL_PT / np.pi
        heights = 100.0 * np.searchsorted(levels, np.round(np.degrees(d.theta_i), 1)).astype(np.float64)
        kept = thinning.enough(across, heights, most=MOST_DRAWN // 2, keep=np.abs(value) > 1.0)
        on = partial(
            on_plane, angle=d.signed[kept], parameter=d.theta_i[kept], value=value[kept],
            marked=np.abs(value[kept]) > 1.0, label="E_n", top=2.0, high=high,
        )  # fmt: skip
        out.append(Drawing(f"map-{k + 1}", "map", "", f"{said}.", f"{said}.", (5.6, high), on))
    return out
