"""Figures beyond the plane of incidence, of a fit's parameters, and of the uncertainty over the angle."""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio import geometry
from gonio_analysis import diagnostics, maps, polar
from gonio_analysis.compare import Dataset
from gonio_analysis.forward import NO_WAVELENGTH_NM, seen
from gonio_analysis.planes import IN_PLANE, Curve, Rows, groups, labels
from gonio_analysis.polar import Line
from gonio_analysis.report.figures import LEGEND_ROW_IN, Figure, budget_height, rendered
from gonio_analysis.report.text import cause, unit

MOST = 3
"""Incidences that are drawn, at most."""
FEWEST = 8
"""Values out of the plane that a map needs."""


def draw(d: Dataset, facts: dict[str, Any]) -> list[Figure]:
    """What the data allow: maps, slices and a lobe where there are values out of plane, profiles, the budget."""
    out = []
    chosen = _incidences(d)
    for k, rows in enumerate(chosen):
        out.append(_heat(d, facts, rows, k))
    for k, rows in enumerate(chosen):
        lines = maps.slices(d.data, rows)
        if lines:
            out.append(_slices(d, facts, rows, lines, k))
    if chosen and facts["best"]:
        out.append(_lobe(d, facts, chosen[len(chosen) // 2]))
    if d.choice.intervals:
        out.append(_profiles(d, facts))
    if facts["budget"] and d.curves:
        out.append(_budget(d, facts))
    return out


def _incidences(d: Dataset) -> list[Rows]:
    data = d.data
    off = np.abs(np.sin(data.theta_r) * np.sin(data.phi_r - data.phi_i)) > np.sin(IN_PLANE)
    every = [g for g in groups(data.theta_i, data.phi_i, np.arange(len(data))) if np.count_nonzero(off[g]) >= FEWEST]
    return [every[k] for k in _evenly(len(every))]


def _evenly(count: int) -> list[int]:
    """At most `MOST` of so many, spread evenly."""
    return sorted({round(x) for x in np.linspace(0, count - 1, min(MOST, count))})


def _theta(d: Dataset, rows: Rows) -> float:
    return float(d.data.theta_i[rows].mean())


def _heat(d: Dataset, facts: dict[str, Any], rows: Rows, k: int) -> Figure:
    data, theta = d.data, _theta(d, rows)

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.02, 0.04, 0.84, 0.94))
        dphi = data.phi_r[rows] - data.phi_i[rows]
        maps.heat_map(ax, data.theta_r[rows], dphi, data.brdf[rows], label="BRDF [1/sr]", theta_i=theta)

    caption = (
        f"Hemisphere, θi = {np.degrees(theta):.1f}°: measured BRDF over the receiver's direction; radius: θr. Cross:"
        " mirror direction; circle: source. Points were measured; colours between neighbours within 15° are a guide."
    )
    return rendered(f"{facts['slug']}-heat-{k + 1}", "heat", "", caption, caption, (4.6, 4.0), on)


def _slices(d: Dataset, facts: dict[str, Any], rows: Rows, lines: list[Line], k: int) -> Figure:
    picks = np.unique(np.round(np.linspace(0, len(lines) - 1, min(6, len(lines)))).astype(int))
    shown = [lines[p] for p in picks]

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.135, 0.23, 0.85, 0.74))
        polar.semilog(ax, shown)
        ax.set_xlabel("θr: toward the source's side negative, mirror side positive")
        _legend(figure, [(line.label, polar.style(i)) for i, line in enumerate(shown)])

    caption = (
        f"Slices out of the plane, θi = {np.degrees(_theta(d, rows)):.1f}°: measured BRDF with standard uncertainties"
        " in half-planes of constant azimuth, each with its opposite."
    )
    return rendered(f"{facts['slug']}-slices-{k + 1}", "slices", "", caption, caption, (5.6, 3.72), on)


def _lobe(d: Dataset, facts: dict[str, Any], rows: Rows) -> Figure:
    best = d.fitted[facts["best"]].fit
    data, theta = d.data, _theta(d, rows)
    wave = data.wavelengths[0]

    def brdf(theta_r: Any, dphi: Any) -> Any:
        still = np.full(theta_r.shape, theta)
        cones = (0.0, 0.0)  # the lobe without its spike, which would leave nothing else to see
        nm = NO_WAVELENGTH_NM if np.isnan(wave) else wave
        return seen(best.model, still, 0 * still, theta_r, geometry.wrap(dphi), wavelength_nm=nm, cones=cones)

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
        measured = (data.theta_r[rows], data.phi_r[rows] - data.phi_i[rows], data.brdf[rows])
        maps.lobe(ax, brdf, measured=measured, label="BRDF / largest value of the model's lobe")

    caption = (
        f"Lobe, θi = {np.degrees(theta):.1f}°: {best.name} as fitted, without a spike (mesh); measured values (points)."
    )
    return rendered(f"{facts['slug']}-lobe", "lobe", "", caption, caption, (4.6, 4.0), on)


def _profiles(d: Dataset, facts: dict[str, Any]) -> Figure:
    from gonio_analysis.profile import rise

    named = d.choice.named
    assert named is not None
    result = named.fit
    intervals = list(d.choice.intervals.values())
    level = intervals[0].level
    threshold = rise(result, level)
    wide = (len(intervals) + 3) // 4

    def on(figure: Any) -> None:
        axes = figure.subplots(wide, min(len(intervals), 4), squeeze=False).ravel()
        figure.subplots_adjust(0.085, 0.2 / wide, 0.985, 1 - 0.13 / wide, wspace=0.3, hspace=0.6)
        for ax, interval in zip(axes, intervals, strict=False):
            e = result.parameters[interval.name]
            diagnostics.profile(ax, interval, value=e.value, threshold=threshold, unit=unit(e.unit))
        for ax in axes[len(intervals) :]:
            ax.set_axis_off()

    what = (
        "Rise of chi-square"
        if result.data.covariance is not None
        else "Rise of the sum of squares, in units of the scatter,"
    )
    caption = (
        f"Profiles of {named.candidate.label}: {what[:1].lower() + what[1:]} over each parameter, with all others"
        f" fitted again. Line: fitted value; dashes: the rise at the ends of the {100 * level:g} % interval (shaded)."
    )
    return rendered(f"{facts['slug']}-profiles", "profile", "", caption, caption, (5.6, 1.9 * wide), on)


def _budget(d: Dataset, facts: dict[str, Any]) -> Figure:
    assert d.data.covariance is not None
    names = labels(d.curves)
    shown = [(d.curves[k], names[k]) for k in _evenly(len(d.curves))]
    legend = [cause(c) for c in d.data.covariance.causes]
    entries = [(part, diagnostics.look(k)) for k, part in enumerate(["combined", "random", *legend])]
    high = budget_height(len(entries))
    below = 0.5 + LEGEND_ROW_IN * -(-len(entries) // 4)

    def on(figure: Any) -> None:
        axes = figure.subplots(1, len(shown), squeeze=False, sharey=True)[0]
        figure.subplots_adjust(0.1, below / high, 0.985, 1 - 0.25 / high, wspace=0.1)
        for ax, (curve, name) in zip(axes, shown, strict=True):
            diagnostics.budget_over_angle(ax, *_parts(d, curve))
            ax.set_xticks(range(-60, 61, 60), [f"{a}°".replace("-", "−") for a in range(-60, 61, 60)])
            ax.set_xlabel("θr" if curve.scanned == "theta_r" else "θi")
            ax.set_title(name, fontsize=8, loc="left", color=polar.INK)
        axes[0].set_ylabel("u / value [%]")
        _legend(figure, entries)

    caption = (
        "Uncertainty over the angle: standard uncertainty by cause, relative to the value, along in-plane curves;"
        " values within 3 u of zero are left out."
    )
    return rendered(f"{facts['slug']}-budget-angle", "budget-angle", "", caption, caption, (5.6, high), on)


def _parts(d: Dataset, curve: Curve) -> tuple[Any, list[tuple[str, Any]]]:
    c = d.data.covariance
    assert c is not None
    rows = curve.rows
    size = np.where(np.abs(curve.brdf) > 3 * curve.u, np.abs(curve.brdf), np.nan)
    parts = [("combined", c.total[rows] / size), ("random", c.random[rows] / size)]
    parts += [(name, np.abs(c.common[rows, k]) / size) for k, name in enumerate(c.causes)]
    return curve.angle, parts


def _legend(figure: Any, entries: list[tuple[str, dict[str, Any]]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], lw=1.4, ms=3.5, label=text, **look) for text, look in entries]
    figure.legend(
        handles=handles, loc="lower center", ncol=min(len(handles), 4 if len(handles) > 6 else 3), fontsize=7.5,
        frameon=False, handlelength=2.0, columnspacing=1.1, borderpad=0.1,
    )  # fmt: skip
