"""The figures of a report, each as SVG (inlined into the page, and as a file); `--png` writes PNGs, too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.curves.in_plane import Line
from gonio_analysis.plots import diagnostics, in_plane, style, thinning
from gonio_analysis.report.drawing import Drawing
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.text import cause, model_slugs, number, percent
from gonio_analysis.selection.compare import Dataset, FittedModel

PANEL_PT = 335.0
"""Width of a panel over the angle."""
SEEN = 1e-5
"""A cause whose 95th percentile is a smaller share of the value has no bar to be seen."""
SERIES_COLUMNS = 2
"""Panels of parameters beside each other: more leave no room for the numbers of their axes."""
LEGEND_ROW_IN = 0.19
OVERLAY_IN = 1.55
"""Height of a row of panels in which all models stand together."""
SAME_CURVE = 5e-3
"""Curves that differ by less coincide on paper: in a panel of three decades the width of a line is 2 %."""
SAME_RESIDUAL = 0.1
"""Whitened residuals that differ by less coincide: markers are three times as large."""
RADIUS = {
    "mirror": "BRDF / BRDF in the mirror direction",
    "max": "BRDF / largest in-plane value",
    "model": "BRDF / model's BRDF in the mirror direction",
}
NORMS = {
    "mirror": "at the mirror direction (eq. 11)",
    "max": "at the largest in-plane value",
    "model": "by the fitted model at the mirror direction",
}
MOST_CAUSES = 20
"""Most causes of uncertainty, common to all values, in one figure."""


def draw(d: DatasetSummary, most: int, radius: float | None = None) -> list[Drawing]:
    """Every figure of one measured sample.

    Parameters
    ----------
    d
        The measurement with its fitted models.
    most
        Measured values that one panel shows, at most.
    radius
        Of the rim of polar plots; each by what it shows if none is given.
    """
    groups = coinciding(d)
    out = [_polar(d, names, most, radius) for names in groups if d.models[names[0]].drawn]
    out += [_absolute(d, names, most) for names in groups]
    if len(groups) > 1 and d.curves:
        out.append(_overlay(d, groups, most))
    if d.budget:
        out.append(_budget(d))
    files = model_slugs(d.models)
    out += [_series(d, model, f, files[model]) for model, f in d.models.items() if len(f.series) > 1]
    return out


def coinciding(d: Dataset) -> list[list[str]]:
    """Names of the fitted models; those whose curves and values cannot be told apart on paper stand together."""
    groups: list[list[str]] = []
    for model, f in d.models.items():
        same = next((g for g in groups if _coincide(d.models[g[0]], f)), None)
        if same is None:
            groups.append([model])
        else:
            same.append(model)
    return groups


def _coincide(a: FittedModel, b: FittedModel) -> bool:
    if a.fit.goal.whitened and not np.allclose(a.fit.whitened, b.fit.whitened, rtol=0.0, atol=SAME_RESIDUAL):
        return False
    pairs = [(a.fit.predicted, b.fit.predicted)]
    for x, y in zip(a.drawn, b.drawn, strict=True):
        pairs += [(x.theory_angle, y.theory_angle), (x.theory, y.theory)]
    return all(x.shape == y.shape and np.allclose(x, y, rtol=SAME_CURVE, atol=0.0, equal_nan=True) for x, y in pairs)


def _named(names: Sequence[str]) -> str:
    """As in "lambert" or "lambert and oren-nayar, which coincide"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}, which coincide"


def _polar(d: DatasetSummary, names: Sequence[str], most: int, radius: float | None) -> Drawing:
    model, f = names[0], d.models[names[0]]
    every = [c.normalised() for c in f.drawn]
    rim = in_plane.radius_of(every) if radius is None else radius
    lines = thinning.on_half_disc(every, rim, 0.42 * 5.6 * thinning.POINTS_AN_INCH, most)
    cut = [c.label for c, x in zip(f.drawn, every, strict=True) if max(_top(x.theory), _top(x.measured)) > 1.001 * rim]
    caption = f"{_named(names)}: normalised {_norm_words(f)}. Solid: theory; dashed{bars(d)}: {measurement(d)}."
    caption += in_plane.rim_words(every, rim, radius)
    if cut:
        caption += f" Cut at the rim: {', '.join(cut)}."
    caption += _spikes(f) + _band(f) + thinning.words(thinning.measured(lines), thinning.measured(every))
    alt = f"Half-disc polar plot for {d.name} ({measurement(d)}) and {model}. " + " ".join(
        "{0}: measured peak at {2:.1f}°, theory's at {1:.1f}°.".format(c.label, *np.degrees(c.peaks)) for c in f.drawn
    )
    legend = _Legend.of(d, f)
    kinds = {c.norm.kind for c in f.drawn}
    label = (
        RADIUS[kinds.pop()]
        if len(kinds) == 1
        else "BRDF / its value in the mirror direction;  * largest in-plane value"
    )
    on = partial(_on_half_disc, lines=lines, rim=rim, label=label, legend=legend, called=_called(d))
    high = 3.22 + LEGEND_ROW_IN * legend.rows
    return Drawing(f"{d.slug}-polar-{model_slugs(d.models)[model]}", "polar", model, caption, alt, (5.6, high), on)


def measurement(d: Dataset) -> str:
    """What captions call the values: those of a simulated rig are called so."""
    return "simulated measurement" if d.simulated else "measurement"


def _called(d: Dataset) -> str:
    """What legends and notes call the values."""
    return "simulated" if d.simulated else "measured"


def bars(d: Dataset) -> str:
    """What the error bars are, as part of a sentence; "" where there are none."""
    if d.data.covariance is None:
        return ""
    assumed = d.data.u_rel_assumed
    return ", with error bars" + ("" if assumed is None else f" of an ASSUMED {100 * assumed:g} % (--u-rel)")


def _on_half_disc(figure: Any, *, lines: list[Line], rim: float, label: str, legend: _Legend, called: str) -> None:
    below = LEGEND_ROW_IN * legend.rows
    ax = figure.add_axes((0.01, below / (3.22 + below), 0.98, 3.2 / (3.22 + below)))
    in_plane.polar(ax, lines, radius=rim, radius_label=label, called=called)
    legend.draw(figure)


def _norm_words(f: FittedModel) -> str:
    kinds = {c.norm.kind for c in f.drawn}
    if len(kinds) == 1:
        return NORMS[kinds.pop()]
    other = NORMS[min(kinds - {"mirror"})]
    why = "because their mirror direction was not measured or is dark beside the rest"
    return f"{NORMS['mirror']}; curves marked * {other}, {why}"


def _spikes(f: FittedModel) -> str:
    """A sentence on the curves whose spike leaves nothing else to see."""
    found: dict[str, float] = {}
    for c in f.drawn:
        rest = c.curve.brdf[np.abs(c.curve.angle - c.curve.parameter) > np.radians(4)]
        if c.norm.kind == "mirror" and rest.size and c.norm.measured > 15 * max(float(rest.max()), 0.0) > 0:
            found[c.label] = c.norm.measured / float(rest.max())
    if not found:
        return ""
    low, high = number(min(found.values()), 2), number(max(found.values()), 2)
    times = low if low == high else f"{low} to {high}"
    everywhere = len(found) == len(f.drawn) > 1 and f.drawn[0].curve.scanned == "theta_r"
    where = "every incidence" if everywhere else ", ".join(found)
    return f" The spike at {where} is {times} times the largest value beside it: see the semilog curves."


def _absolute(d: DatasetSummary, names: Sequence[str], most: int) -> Drawing:
    model, f, data = names[0], d.models[names[0]], d.models[names[0]].fit.data
    lines, stated = [c.absolute() for c in f.drawn], f.fit.goal.whitened
    rest = np.setdiff1d(np.arange(len(data)), [row for c in f.drawn for row in c.curve.rows])
    with np.errstate(divide="ignore"):
        values = f.fit.whitened[rest] if stated else f.fit.predicted[rest] / data.brdf[rest] - 1.0
    scanned = d.curves[0].scanned if d.curves else "theta_r"
    at = data.directions.swapped if scanned == "theta_i" else data.directions
    angle = at.settled_at_normal()[rest].signed
    low = thinning.of_residuals(lines, PANEL_PT, 0.25 * PANEL_PT, most)
    some = thinning.residuals(angle, values, PANEL_PT, 0.25 * PANEL_PT, most)
    kind = (
        "residuals in standard deviations: model minus measurement over u, correlations taken out (band: ±2)"
        + ", of the assumed uncertainty" * (data.u_rel_assumed is not None)
        + ", the model's own misfit among them" * (f.fit.misfit is not None)
        if stated
        else "model divided by measurement"
    )
    if lines:
        what = f"absolute in-plane BRDF of a {measurement(d)}{bars(d)} (dashed), and theory (solid)"
        caption = f"{_named(names)}: {what}. Below: {kind}"
        caption += "; grey: values that belong to no curve shown." if rest.size else "."
        caption += _above(lines) + _band(f)
    else:
        caption = f"{_named(names)}: {measurement(d)} without an in-plane curve, so residuals alone: {kind}."
    caption += thinning.words(thinning.measured(low) + some.size, thinning.measured(lines) + rest.size)
    chi = d.models[model].fit.reduced_chi_square
    alt = f"{'Semilog curves and residuals' if lines else 'Residuals'} for {d.name} and {model}"
    alt += f"; reduced chi-square {number(chi)}." if chi is not None else "."
    legend = _Legend.of(d, f, star=False)
    on = partial(
        _on_two_panels, lines=thinning.on_logarithm(lines, PANEL_PT, 0.6 * PANEL_PT, most), below=low,
        others=(angle[some], values[some]), whitened=stated, running="θr" if scanned == "theta_r" else "θi",
        legend=legend,
    )  # fmt: skip
    high = (3.57 if lines else 1.6) + 0.46 + LEGEND_ROW_IN * legend.rows
    return Drawing(
        f"{d.slug}-absolute-{model_slugs(d.models)[model]}", "absolute", model, caption, alt, (5.6, high), on
    )


def _band(f: FittedModel) -> str:
    """A sentence on the band around theory; "" where the data do not reject the model."""
    if f.fit.misfit is None or f.fit.tau is None:
        return ""
    drawn = "Thin lines" if any(map(in_plane.wide, (c.absolute() for c in f.drawn))) else "Light band"
    return f" {drawn}: theory and its misfit, {f.fit.tau.words}, to either side."


def _above(lines: Sequence[Line]) -> str:
    """A sentence on theory that leaves a logarithmic panel; "" where none does."""
    ceiling = in_plane.ceiling(lines)
    cut = [f"{x.label} to {number(_top(x.theory), 2)} sr⁻¹" for x in lines if _top(x.theory) > 1.5 * ceiling]
    return f" Theory leaves the panel: {', '.join(cut)}." if cut else ""


def _on_two_panels(
    figure: Any, *, lines: list[Line], below: list[Line], others: tuple[Any, Any], whitened: bool,
    running: str, legend: _Legend,
) -> None:  # fmt: skip
    room, high = 0.46 + LEGEND_ROW_IN * legend.rows, figure.get_figheight()
    axes = figure.subplots(2, 1, height_ratios=(2.4, 1), sharex=True) if lines else [figure.subplots()]
    figure.subplots_adjust(0.145, room / high, 0.975, 1 - 0.11 / high, hspace=0.12)
    low = axes[-1]
    if lines:
        in_plane.semilog(axes[0], lines)
        axes[0].set_xlabel("")
    in_plane.residuals(low, below, whitened=whitened, others=others)
    low.set_xlabel(f"{running}: retro side negative, mirror side positive")
    for ax in axes:  # a fixed place: to look for one, every tick would be laid out once more
        ax.yaxis.set_label_coords(-0.1, 0.5)
    low.xaxis.set_label_coords(0.5, -0.235)
    legend.draw(figure)


def _overlay(d: DatasetSummary, groups: Sequence[Sequence[str]], most: int) -> Drawing:
    names = [" = ".join(group) for group in groups]
    first = d.models[groups[0][0]].drawn
    share = max(most // len(first), 24)
    panels = []
    for k, c in enumerate(first):
        measured = Line(c.label, np.empty(0), np.empty(0), c.curve.angle, c.curve.brdf, c.curve.u)
        (shown,) = thinning.on_logarithm([measured], 0.45 * PANEL_PT, OVERLAY_IN * thinning.POINTS_AN_INCH, share)
        theory = [(d.models[g[0]].drawn[k].theory_angle, d.models[g[0]].drawn[k].theory) for g in groups]
        panels.append((shown, theory))
    caption = (
        f"All models: absolute in-plane BRDF, a panel for each curve. Points{bars(d)}: {measurement(d)}; lines: theory."
        + _above([replace(line, theory=np.concatenate([v for _, v in theory])) for line, theory in panels])
        + thinning.words(sum(line.measured.size for line, _ in panels), sum(c.curve.angle.size for c in first))
    )
    columns = style.columns(names, 5.6)
    on = partial(_on_overlay, panels=panels, names=names, columns=columns, called=measurement(d))
    high = OVERLAY_IN * (-(-len(panels) // 2)) + 0.42 + LEGEND_ROW_IN * (-(-len(names) // columns) + 1)
    return Drawing(f"{d.slug}-overlay", "overlay", "", caption, caption, (5.6, high), on)


def _on_overlay(
    figure: Any, *, panels: list[tuple[Line, list[tuple[Any, Any]]]], names: list[str], columns: int, called: str
) -> None:
    from matplotlib.lines import Line2D

    rows, high = -(-len(panels) // 2), figure.get_figheight()
    below = 0.42 + LEGEND_ROW_IN * (-(-len(names) // columns) + 1)
    axes = figure.subplots(rows, min(len(panels), 2), squeeze=False, sharex=True, sharey=True)
    figure.subplots_adjust(0.11, below / high, 0.97, 1 - 0.2 / high, hspace=0.3, wspace=0.08)
    limits = []
    for ax, (line, theory) in zip(axes.ravel(), panels, strict=False):
        limits.append(in_plane.overlay(ax, line, theory))
        ax.set_title(line.label, fontsize=7.5, loc="left", pad=2, color=style.INK)
    ends = np.array([pair for pair in limits if np.isfinite(pair).all()])
    if ends.size:
        top = in_plane.ceiling([line for line, _ in panels])
        in_plane.log_axis(axes[0, 0], float(ends[:, 0].min()), min(float(ends[:, 1].max()), top))
    for ax in axes[:, 0]:
        ax.set_ylabel("BRDF [1/sr]")
    for ax in axes.ravel()[len(panels) :]:
        ax.set_axis_off()
    for column in axes.T:
        lowest = [ax for ax in column if ax.axison][-1]
        lowest.tick_params(labelbottom=True)
        in_plane.degrees_along(lowest, 60, 30)
        lowest.set_xlabel("signed angle: retro side negative")
    lines = [
        Line2D([], [], color=in_plane.style(k)["color"], lw=1.4, ls=in_plane.dashes(k), label=name)
        for k, name in enumerate(names)
    ]
    key(figure, lines, columns, [Line2D([], [], color=style.INK, ls="none", marker=".", ms=4, label=called)], long=2.6)


def largest(medians: list[float]) -> list[int]:
    """Which causes of a budget are drawn, in their order: all but the smallest of very many."""
    return sorted(sorted(range(len(medians)), key=lambda k: -medians[k])[:MOST_CAUSES])


def _budget(d: DatasetSummary) -> Drawing:
    named = [(cause(p.cause), p.median, p.p95) for p in d.budget]
    every = named[:2] + [part for part in named[2:] if part[2] >= SEEN]
    parts = every[:2] + [every[2:][k] for k in largest([p[1] for p in every[2:]])]
    caption = (
        "Uncertainty budget: standard uncertainty by cause, relative to the value. Bar: median over the values; tick:"
        " 95th percentile. Values within 3 u of zero are left out."
    )
    if len(every) < len(named):
        caption += f" Causes below {percent(SEEN)} have no bar."
    if len(parts) < len(every):
        caption += f" The {len(parts) - 2} largest of {len(every) - 2} common causes."
    alt = "Uncertainty by cause. " + " ".join(
        f"{c}: median {100 * m:.2g} %, 95th percentile {100 * p:.2g} %." for c, m, p in parts
    )
    on = partial(_on_bars, parts=parts)
    return Drawing(f"{d.slug}-budget", "budget", "", caption, alt, (5.6, budget_height(len(parts))), on)


def _on_bars(figure: Any, *, parts: list[tuple[str, float, float]]) -> None:
    ax = figure.add_subplot()
    figure.subplots_adjust(0.25, 0.48 / budget_height(len(parts)), 0.97, 0.97)
    diagnostics.budget(ax, parts)


def budget_height(parts: int) -> float:
    """Height of the figures of an uncertainty budget [in], which stand side by side."""
    return 0.7 + 0.3 * parts


def _series(d: DatasetSummary, model: str, f: FittedModel, file: str) -> Drawing:
    x = np.array([r.wavelength_nm for r in f.series])
    values = {
        name: np.array([(r.parameters[name].value, r.parameters[name].u) for r in f.series], dtype=float)
        for name in f.fit.free
        if any(not r.parameters[name].fixed for r in f.series)
    }
    same = [name for name, of in values.items() if len(of) > 1 and np.ptp(of[:, 0]) == 0.0]
    caption = (
        f"{model}: fitted parameters at each of the {len(f.series)} wavelengths, with standard errors (those wider"
        " than the panel are not drawn)." + (f" One value for all of them: {', '.join(same)}." if same else "")
    )
    high = 0.35 + 1.55 * -(-len(values) // SERIES_COLUMNS)
    on = partial(_on_series, x=x, values=values)
    return Drawing(f"{d.slug}-series-{file}", "series", model, caption, caption, (5.6, high), on)


def _on_series(figure: Any, *, x: Any, values: dict[str, Floats]) -> None:
    columns = min(len(values), SERIES_COLUMNS)
    axes = figure.subplots(-(-len(values) // columns), columns, squeeze=False).ravel()
    high = figure.get_figheight()
    figure.subplots_adjust(0.1, 0.48 / high, 0.985, 1 - 0.25 / high, wspace=0.3, hspace=0.75)
    for ax in axes[len(values) :]:
        ax.set_axis_off()
    for k, (ax, (name, found)) in enumerate(zip(axes, values.items(), strict=False)):
        y, u = found.T
        span = float(np.ptp(y)) or float(np.abs(y).max()) or 1.0
        u = np.where(np.isfinite(u) & (u < 2 * span), u, 0.0)
        diagnostics.series(ax, x, y, u, x_label="wavelength [nm]", y_label="", colour=in_plane.COLOURS[k % 6])
        ax.set_title(name, fontsize=8, color=style.INK)  # a power of ten stands on the left


@dataclass(frozen=True)
class _Legend:
    """The curves' labels below a figure, and what its solid and dashed lines are."""

    labels: list[str]
    columns: int
    measured: str
    """What the values are called."""

    @classmethod
    def of(cls, d: Dataset, f: FittedModel, *, star: bool = True) -> _Legend:
        mixed = star and len({c.norm.kind for c in f.drawn}) > 1
        names = [c.label + "*" * (mixed and c.norm.kind != "mirror") for c in f.drawn]
        return cls(names, style.columns(names, 5.6), measurement(d))

    @property
    def rows(self) -> int:
        return -(-len(self.labels) // self.columns) + 1 if self.labels else 0

    def draw(self, figure: Any) -> None:
        if self.labels:
            legend(figure, self.labels, self.columns, in_plane.kinds("theory", self.measured))


def legend(figure: Any, names: Sequence[str], columns: int, kinds: Sequence[Any] = ()) -> None:
    """Labels of curves in the order of their colours, below a figure, and what kinds of lines they are."""
    from matplotlib.lines import Line2D

    curves = [Line2D([], [], lw=1.5, ms=3.5, label=x, **in_plane.style(k)) for k, x in enumerate(names)]
    key(figure, curves, columns, kinds)


def key(figure: Any, curves: Sequence[Any], columns: int, kinds: Sequence[Any] = (), *, long: float = 1.6) -> None:
    """A legend at the foot of a figure: its curves, and below them what kinds of lines they are."""
    for handles, beside in ((curves, columns), (kinds, len(kinds))):
        for one in handles:
            one.set_label(style.short(one.get_label(), figure.get_figwidth(), beside=beside))
    look = {"fontsize": 7.5, "frameon": False, "columnspacing": 1.1, "borderpad": 0.1, "borderaxespad": 0.15}
    if kinds:
        figure.legend(handles=kinds, loc="lower center", ncol=len(kinds), handlelength=2.6, **look)
    above = LEGEND_ROW_IN / figure.get_figheight() if kinds else 0.0
    figure.legend(
        handles=curves, loc="lower center", ncol=columns, handlelength=long, bbox_to_anchor=(0.5, above), **look
    )


def _top(values: Any) -> float:
    return float(np.nanmax(values)) if len(values) else 0.0
