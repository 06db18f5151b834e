"""Figures beyond the plane of incidence, of a fit's parameters, and of the uncertainty over the angle."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.geometry import Directions, groups, wrap
from gonio.polarisation import UNPOLARISED
from gonio.typing import Floats, Ints
from gonio_analysis.curves.in_plane import Curve, Line, evenly, labels
from gonio_analysis.fitting.forward import NO_WAVELENGTH_NM, seen
from gonio_analysis.fitting.profile_likelihood import Interval, rise
from gonio_analysis.plots import diagnostics, in_plane, maps, style, thinning
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.figures import LEGEND_ROW_IN, PANEL_PT, SEEN, bars, budget_height, key, largest
from gonio_analysis.report.text import cause, number, unit
from gonio_analysis.selection.compare import Dataset

MOST = 3
"""Incidences that are drawn, at most."""
MOST_ON_DISC = 3000
"""Values on a disc, whose markers are drawn as one picture where they are many."""
FEWEST = 8
"""Values out of the plane that a map needs."""


def draw(d: DatasetSummary, most: int) -> list[Drawing]:
    """What the data allow: maps, slices and a lobe where there are values out of plane, profiles, the budget.

    Parameters
    ----------
    d
        The measurement with its fitted models.
    most
        Measured values that one panel shows, at most.
    """
    chosen = _incidences(d)
    out = [_heat(d, rows, k, most) for k, rows in enumerate(chosen) if np.any(d.data.brdf[rows] > 0)]
    cuts = [maps.slices(d.data, rows) for rows in chosen]
    out += [_slices(d, chosen[k], lines, k, most) for k, lines in enumerate(cuts) if lines]
    if chosen and d.best:
        out.append(_lobe(d, chosen[len(chosen) // 2], most))
    if d.choice.intervals and d.choice.named is not None and d.choice.named.fit.misfit is None:
        out.append(_profiles(d))
    return [*out, _budget(d, most)] if d.budget and d.curves else out


def _incidences(d: Dataset) -> list[Ints]:
    at = d.data.directions.settled_at_normal()
    every = groups(at.theta_i, at.phi_i, np.arange(len(d.data)))
    enough = [g for g in every if np.count_nonzero(~at.in_plane[g]) >= FEWEST]
    return [enough[k] for k in evenly(len(enough), MOST)]


def _measured(d: Dataset) -> str:
    return "simulated" if d.simulated else "measured"


def _theta(d: Dataset, rows: Ints) -> float:
    return float(d.data.directions.theta_i[rows].mean())


def _heat(d: DatasetSummary, rows: Ints, k: int, most: int) -> Drawing:
    data, theta = d.data, _theta(d, rows)
    rows = rows[data.brdf[rows] > 0]
    at = data.directions.settled_at_normal()[rows]
    some = thinning.over_hemisphere(at.theta_r, at.dphi, data.brdf[rows], max(most, MOST_ON_DISC))
    caption = (
        f"Hemisphere, θi = {np.degrees(theta):.1f}°: {_measured(d)} BRDF over the receiver's direction; radius: θr."
        f" Cross: mirror direction; circle: source. Points were {_measured(d)}; colours between neighbours within 15°"
        " are a guide." + thinning.words(some.size, rows.size)
    )
    on = partial(_on_disc, theta_r=at[some].theta_r, dphi=at[some].dphi, value=data.brdf[rows[some]], theta_i=theta)
    return Drawing(f"{d.slug}-heat-{k + 1}", "heat", "", caption, caption, (4.6, 4.0), on)


def _on_disc(figure: Any, *, theta_r: Floats, dphi: Floats, value: Floats, theta_i: float) -> None:
    maps.heat_map(figure.add_axes((0.02, 0.04, 0.84, 0.94)), theta_r, dphi, value, label="BRDF [1/sr]", theta_i=theta_i)


def _slices(d: DatasetSummary, rows: Ints, lines: list[Line], k: int, most: int) -> Drawing:
    every = [lines[k] for k in evenly(len(lines), 6)]
    shown = thinning.on_logarithm(every, PANEL_PT, 0.5 * PANEL_PT, most)
    caption = (
        f"Slices out of the plane, θi = {np.degrees(_theta(d, rows)):.1f}°: {_measured(d)} BRDF{bars(d)}"
        " in half-planes of constant azimuth, each with its opposite."
        + thinning.words(thinning.measured(shown), thinning.measured(every))
    )
    on = partial(_on_slices, lines=shown)
    return Drawing(f"{d.slug}-slices-{k + 1}", "slices", "", caption, caption, (5.6, 3.72), on)


def _on_slices(figure: Any, *, lines: list[Line]) -> None:
    ax = figure.add_axes((0.135, 0.23, 0.85, 0.74))
    in_plane.semilog(ax, lines)
    ax.set_xlabel("θr: toward the source's side negative, mirror side positive")
    _legend(figure, [(line.label, in_plane.style(i)) for i, line in enumerate(lines)])


def _lobe(d: DatasetSummary, rows: Ints, most: int) -> Drawing:
    assert d.best is not None
    best, data, theta = d.models[d.best].fit, d.data, _theta(d, rows)
    nm = NO_WAVELENGTH_NM if np.isnan(data.wavelengths[0]) else data.wavelengths[0]
    state = str(data.states[0]) if data.states.size else UNPOLARISED

    def brdf(theta_r: Any, dphi: Any) -> Any:
        still = np.full(theta_r.shape, theta)
        at = Directions(still, 0 * still, theta_r, wrap(dphi))
        # the lobe without its spike, which would leave nothing else to see
        return seen(best.model, at, wavelength_nm=nm, cones=(0.0, 0.0), state=state, polarisers=data.polarisers)

    at = data.directions.settled_at_normal()[rows]
    mesh, values = maps.lobe_mesh(brdf), data.brdf[rows]
    some = thinning.over_hemisphere(at.theta_r, at.dphi, values, most)
    far = values[maps.beyond(mesh, values)]
    caption = (
        f"Lobe, θi = {np.degrees(theta):.1f}°: {best.name} as fitted, without a spike (mesh);"
        f" {_measured(d)} values (points)." + thinning.words(some.size, rows.size)
    )
    if far.size:
        times = number(float(far.max() / np.nanmax(mesh.value)), 2)
        caption += (
            f" Not drawn: {far.size} {'value' if far.size == 1 else 'values'} above {maps.FAR:g} times the mesh's"
            f" largest, up to {times} times."
        )
    on = partial(_on_space, mesh=mesh, measured=(at[some].theta_r, at[some].dphi, values[some]))
    return Drawing(f"{d.slug}-lobe", "lobe", "", caption, caption, (4.6, 4.0), on)


def _on_space(figure: Any, *, mesh: maps.Mesh, measured: tuple[Floats, Floats, Floats]) -> None:
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
    maps.lobe(ax, mesh, measured=measured, label="BRDF / largest value of the model's lobe")


def _profiles(d: DatasetSummary) -> Drawing:
    named = d.choice.named
    assert named is not None
    result = named.fit
    intervals = list(d.choice.intervals.values())
    level = intervals[0].level
    what = "Rise of chi-square" if result.goal.whitened else "Rise of the sum of squares, in units of the scatter,"
    caption = (
        f"Profiles of {named.candidate.label}: {what[:1].lower() + what[1:]} over each parameter, with all others"
        f" fitted again. Line: fitted value; dashes: the rise at the ends of the {100 * level:g} % interval (shaded)."
    )
    panels = [(i, result.parameters[i.name].value, unit(result.parameters[i.name].unit)) for i in intervals]
    on = partial(_on_profiles, panels=panels, threshold=rise(result, level))
    return Drawing(f"{d.slug}-profiles", "profile", "", caption, caption, (5.6, 1.9 * _rows_of(len(panels))), on)


def _rows_of(panels: int) -> int:
    return (panels + 3) // 4


def _on_profiles(figure: Any, *, panels: list[tuple[Interval, float, str]], threshold: float) -> None:
    high = _rows_of(len(panels))
    axes = figure.subplots(high, min(len(panels), 4), squeeze=False).ravel()
    figure.subplots_adjust(0.085, 0.2 / high, 0.965, 1 - 0.13 / high, wspace=0.3, hspace=0.6)
    for ax, (interval, value, symbol) in zip(axes, panels, strict=False):
        diagnostics.profile(ax, interval, value=value, threshold=threshold, unit=symbol)
    for ax in axes[len(panels) :]:
        ax.set_axis_off()


def _budget(d: DatasetSummary, most: int) -> Drawing:
    assert d.every_state.covariance is not None
    names = labels(d.curves)
    shown = [(d.curves[k], names[k]) for k in evenly(len(d.curves), MOST)]
    common = [k for k in largest([p.median for p in d.budget[2:]]) if d.budget[2 + k].p95 >= SEEN]
    parts = ["combined", "random", *(cause(d.every_state.covariance.causes[k]) for k in common)]
    entries = [(part, diagnostics.look(k)) for k, part in enumerate(parts)]
    # every cause is a line over the same angles
    each = max(most // (len(entries) * len(shown)), 16)
    panels = [(name, curve.scanned, *_parts(d, thinning.of_curve(curve, each), common)) for curve, name in shown]
    caption = (
        "Uncertainty over the angle: standard uncertainty by cause, relative to the value, along in-plane curves;"
        " values within 3 u of zero are left out."
        + thinning.words(sum(angle.size for *_, angle, _ in panels), sum(curve.angle.size for curve, _ in shown))
    )
    size, on = (5.6, budget_height(len(entries))), partial(_on_budget, panels=panels, entries=entries)
    return Drawing(f"{d.slug}-budget-angle", "budget-angle", "", caption, caption, size, on)


def _on_budget(figure: Any, *, panels: list[Any], entries: list[tuple[str, diagnostics.Look]]) -> None:
    high = budget_height(len(entries))
    below = 0.5 + LEGEND_ROW_IN * -(-len(entries) // _columns([text for text, _ in entries]))
    axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    figure.subplots_adjust(0.1, below / high, 0.985, 1 - 0.25 / high, wspace=0.1)
    for ax, (name, scanned, angle, parts) in zip(axes, panels, strict=True):
        diagnostics.budget_over_angle(ax, angle, parts)
        in_plane.degrees_along(ax, 60, 60)
        ax.set_xlabel("θr" if scanned == "theta_r" else "θi")
        ax.set_title(name, fontsize=8, loc="left", color=style.INK)
    axes[0].set_ylabel("u / value [%]")
    _legend(figure, entries)


def _parts(d: Dataset, curve: Curve, common: list[int]) -> tuple[Any, list[tuple[str, Any]]]:
    c = d.every_state.covariance
    assert c is not None
    rows = curve.rows
    size = np.where(np.abs(curve.brdf) > 3 * curve.u, np.abs(curve.brdf), np.nan)
    parts = [("combined", c.total[rows] / size), ("random", c.random[rows] / size)]
    parts += [(c.causes[k], np.abs(c.common[rows, k]) / size) for k in common]
    return curve.angle, parts


def _legend(figure: Any, entries: Sequence[tuple[str, diagnostics.Look | in_plane.Style]]) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], lw=1.4, ms=3.5, label=text, **look) for text, look in entries]
    key(figure, handles, _columns([text for text, _ in entries]), long=2.0)


def _columns(names: Sequence[str]) -> int:
    return style.columns(names, 5.6, most=4 if len(names) > 6 else 3)
