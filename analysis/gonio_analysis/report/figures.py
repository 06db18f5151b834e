"""The figures of a report, each as SVG (inlined into the page, and as a file) and as PNG."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from gonio.typing import Floats
from gonio_analysis.curves.line import Line
from gonio_analysis.plots import diagnostics, in_plane, thinning
from gonio_analysis.report.text import cause, number, slug
from gonio_analysis.result_records import DatasetSummary
from gonio_analysis.selection.compare import Dataset, Fitted

SVG = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gonio",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
}
FONTS = "'DejaVu Sans', Verdana, 'Segoe UI', sans-serif"
"""Metrics close to those that matplotlib lays out with, so that labels keep their places."""
PNG_DPI = 160
PANEL_PT = 335.0
"""Width of a panel over the angle."""
LEGEND_ROW_IN = 0.19
MOST_CAUSES = 20
"""Of uncertainty, common to all values, in one figure."""


@dataclass(frozen=True)
class Figure:
    """One drawn figure."""

    name: str
    kind: str
    """"polar", "absolute", "budget" or "series": the page groups by it."""
    model: str
    caption: str
    alt: str
    svg: str
    png: bytes


@dataclass(frozen=True)
class Drawing:
    """A figure that is still to be drawn, with what its drawing needs: little enough to be sent to another process."""

    name: str
    kind: str
    model: str
    caption: str
    alt: str
    inches: tuple[float, float]
    on: Callable[[Any], None]
    """Draws on a canvas of that size: a function of a module, with its arguments (`functools.partial`)."""

    def rendered(self) -> Figure:
        """The figure as SVG and PNG."""
        return rendered(self.name, self.kind, self.model, self.caption, self.alt, self.inches, self.on)


def draw(d: Dataset, facts: DatasetSummary, most: int) -> list[Drawing]:
    """Every figure of one measured sample.

    Parameters
    ----------
    d
        The measurement with its fitted models.
    facts
        Its part of the summary.
    most
        Measured values that one panel shows, at most.
    """
    out = []
    for model, f in d.fitted.items():
        if f.drawn:
            out.append(_polar(d, facts, model, f, most))
    for model, f in d.fitted.items():
        out.append(_absolute(d, facts, model, f, most))
    if facts.budget:
        out.append(_budget(facts))
    out += [_series(facts, model, f) for model, f in d.fitted.items() if len(f.series) > 1]
    return out


def _polar(d: Dataset, facts: DatasetSummary, model: str, f: Fitted, most: int) -> Drawing:
    every = [c.normalised() for c in f.drawn]
    rim = in_plane.radius_of(every)
    lines = thinning.on_half_disc(every, rim, 0.42 * 5.6 * thinning.POINTS_AN_INCH, most)
    cut = [c.label for c, x in zip(f.drawn, every, strict=True) if max(_top(x.theory), _top(x.measured)) > 1.001 * rim]
    caption = f"{model}: normalised {_norm_words(f)}. Solid: theory; dashed{bars(d)}: {measurement(d)}."
    if cut:
        caption += f" Cut at the rim: {', '.join(cut)}."
    caption += _spikes(f) + thinning.words(thinning.measured(lines), thinning.measured(every))
    alt = f"Half-disc polar plot for {d.name} ({measurement(d)}) and {model}. " + " ".join(
        f"{c.label}: measured peak at {c.measured_peak_deg:.1f}°, theory's at {c.theory_peak_deg:.1f}°."
        for c in facts.models[model].curves
    )
    on = partial(_on_half_disc, lines=lines, rim=rim, label=_radius_label(f), legend=_Legend.of(f))
    high = 3.22 + LEGEND_ROW_IN * _Legend.of(f).rows
    return Drawing(f"{facts.slug}-polar-{slug(model)}", "polar", model, caption, alt, (5.6, high), on)


def measurement(d: Dataset) -> str:
    """What captions call the values: those of a simulated rig are called so."""
    return "simulated measurement" if d.simulated else "measurement"


def bars(d: Dataset) -> str:
    """What the error bars are, as part of a sentence; "" where there are none."""
    if d.data.covariance is None:
        return ""
    assumed = d.data.u_rel_assumed
    return ", with error bars" + ("" if assumed is None else f" of an ASSUMED {100 * assumed:g} % (--u-rel)")


def _on_half_disc(figure: Any, *, lines: list[Line], rim: float, label: str, legend: _Legend) -> None:
    below = LEGEND_ROW_IN * legend.rows
    ax = figure.add_axes((0.01, below / (3.22 + below), 0.98, 3.2 / (3.22 + below)))
    in_plane.polar(ax, lines, radius=rim, radius_label=label)
    legend.draw(figure)


def _radius_label(f: Fitted) -> str:
    kinds = {c.norm.kind for c in f.drawn}
    if kinds == {"mirror"}:
        return "BRDF / BRDF in the mirror direction"
    if kinds == {"max"}:
        return "BRDF / largest in-plane value"
    if kinds == {"model"}:
        return "BRDF / model's BRDF in the mirror direction"
    return "BRDF / its value in the mirror direction;  * largest in-plane value"


def _norm_words(f: Fitted) -> str:
    words = {
        "mirror": "at the mirror direction (eq. 11)",
        "max": "at the largest in-plane value",
        "model": "by the fitted model at the mirror direction",
    }
    kinds = {c.norm.kind for c in f.drawn}
    if len(kinds) == 1:
        return words[kinds.pop()]
    other = next(k for k in sorted(kinds) if k != "mirror")
    why = "because their mirror direction was not measured or is dark beside the rest"
    return f"{words['mirror']}; curves marked * {words[other]}, {why}"


def _spikes(f: Fitted) -> str:
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
    where = (
        "every incidence"
        if len(found) == len(f.drawn) > 1 and f.drawn[0].curve.scanned == "theta_r"
        else ", ".join(found)
    )
    return f" The spike at {where} is {times} times the largest value beside it: see the semilog curves."


def _absolute(d: Dataset, facts: DatasetSummary, model: str, f: Fitted, most: int) -> Drawing:
    lines = [c.absolute() for c in f.drawn]
    stated = f.fit.goal.whitened
    used = np.concatenate([c.curve.rows for c in f.drawn]) if f.drawn else np.empty(0, dtype=np.intp)
    free = np.ones(len(d.data), dtype=bool)
    free[used] = False
    rest = np.flatnonzero(free)
    data = d.data
    at = data.directions[rest]
    with np.errstate(divide="ignore"):
        values = f.fit.whitened[rest] if stated else f.fit.predicted[rest] / data.brdf[rest] - 1.0
    angle = (at.swapped if d.curves and d.curves[0].scanned == "theta_i" else at).signed
    top = thinning.on_logarithm(lines, PANEL_PT, 0.6 * PANEL_PT, most)
    low = thinning.of_residuals(lines, PANEL_PT, 0.25 * PANEL_PT, most)
    some = thinning.residuals(angle, values, PANEL_PT, 0.25 * PANEL_PT, most)

    kind = (
        "whitened residuals: model minus measurement in standard deviations, correlations taken out (band: ±2)"
        + (", of the assumed uncertainty" if d.data.u_rel_assumed is not None else "")
        if stated
        else "model divided by measurement"
    )
    if lines:
        caption = f"{model}: absolute in-plane BRDF of a {measurement(d)}{bars(d)}. Below: {kind}"
        caption += "; grey: values that belong to no curve shown." if rest.size else "."
    else:
        caption = f"{model}: {measurement(d)} without an in-plane curve, so residuals alone: {kind}."
    drawn = thinning.measured(low) + some.size
    caption += thinning.words(drawn, thinning.measured(lines) + rest.size)
    chi = facts.models[model].reduced_chi_square
    alt = f"{'Semilog curves and residuals' if lines else 'Residuals'} for {d.name} and {model}" + (
        f"; reduced chi-square {number(chi)}." if chi is not None else "."
    )
    running = "θr" if not d.curves or d.curves[0].scanned == "theta_r" else "θi"
    on = partial(
        _on_two_panels, lines=top, below=low, others=(angle[some], values[some]), whitened=stated, running=running,
        legend=_Legend.of(f, star=False),
    )  # fmt: skip
    high = (3.57 if lines else 1.6) + 0.46 + LEGEND_ROW_IN * _Legend.of(f).rows
    return Drawing(f"{facts.slug}-absolute-{slug(model)}", "absolute", model, caption, alt, (5.6, high), on)


def _on_two_panels(
    figure: Any, *, lines: list[Line], below: list[Line], others: tuple[Any, Any], whitened: bool,
    running: str, legend: _Legend,
) -> None:  # fmt: skip
    room = 0.46 + LEGEND_ROW_IN * legend.rows
    high = figure.get_figheight()
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


def largest(medians: list[float]) -> list[int]:
    """Which causes of a budget are drawn, in their order: all but the smallest of very many."""
    first = sorted(range(len(medians)), key=lambda k: -medians[k])[:MOST_CAUSES]
    return sorted(first)


def _budget(facts: DatasetSummary) -> Drawing:
    every = [(cause(p.cause), p.median, p.p95) for p in facts.budget]
    parts = every[:2] + [every[2:][k] for k in largest([p[1] for p in every[2:]])]
    caption = (
        "Uncertainty budget: standard uncertainty by cause, relative to the value. Bar: median over the values; tick:"
        " 95th percentile. Values within 3 u of zero are left out."
    )
    if len(parts) < len(every):
        caption += f" The {len(parts) - 2} largest of {len(every) - 2} common causes."
    alt = "Uncertainty by cause. " + " ".join(
        f"{c}: median {100 * m:.2g} %, 95th percentile {100 * p:.2g} %." for c, m, p in parts
    )
    size = (5.6, budget_height(len(parts)))
    return Drawing(f"{facts.slug}-budget", "budget", "", caption, alt, size, partial(_on_bars, parts=parts))


def _on_bars(figure: Any, *, parts: list[tuple[str, float, float]]) -> None:
    ax = figure.add_subplot()
    figure.subplots_adjust(0.25, 0.48 / budget_height(len(parts)), 0.97, 0.97)
    diagnostics.budget(ax, parts)


def budget_height(parts: int) -> float:
    """Of the figures of an uncertainty budget [in], which stand side by side."""
    return 0.7 + 0.3 * parts


def _series(facts: DatasetSummary, model: str, f: Fitted) -> Drawing:
    x = np.array([r.wavelength_nm for r in f.series])
    values = {
        name: np.array([(r.parameters[name].value, r.parameters[name].u) for r in f.series], dtype=float)
        for name in f.fit.free
        if any(not r.parameters[name].fixed for r in f.series)
    }
    caption = (
        f"{model}: fitted parameters at each of the {len(f.series)} wavelengths, with standard errors (those wider"
        " than the panel are not drawn)."
    )
    on = partial(_on_series, x=x, values=values)
    return Drawing(f"{facts.slug}-series-{slug(model)}", "series", model, caption, caption, (5.6, 1.9), on)


def _on_series(figure: Any, *, x: Any, values: dict[str, Floats]) -> None:
    axes = figure.subplots(1, len(values), squeeze=False)[0]
    figure.subplots_adjust(0.1, 0.26, 0.985, 0.87, wspace=0.42)
    for k, (ax, (name, found)) in enumerate(zip(axes, values.items(), strict=True)):
        y, u = found.T
        span = float(np.ptp(y)) or float(np.abs(y).max()) or 1.0
        u = np.where(np.isfinite(u) & (u < 2 * span), u, 0.0)
        diagnostics.series(ax, x, y, u, x_label="wavelength [nm]", y_label="", colour=in_plane.COLOURS[k % 6])
        ax.set_title(name, fontsize=8, color=in_plane.INK)  # a power of ten stands on the left


@dataclass(frozen=True)
class _Legend:
    """The curves' labels below a figure."""

    labels: list[str]
    columns: int

    @classmethod
    def of(cls, f: Fitted, *, star: bool = True) -> _Legend:
        mixed = star and len({c.norm.kind for c in f.drawn}) > 1
        names = [c.label + ("*" if mixed and c.norm.kind != "mirror" else "") for c in f.drawn]
        count = len(names)
        short = max((len(c.label) for c in f.drawn), default=0) < 10
        return cls(names, min(count, 6 if short else 4 if count != 6 else 3))

    @property
    def rows(self) -> int:
        return -(-len(self.labels) // self.columns) if self.labels else 0

    def draw(self, figure: Any) -> None:
        if self.labels:
            legend(figure, self.labels, self.columns)


def legend(figure: Any, names: list[str], columns: int) -> None:
    """Labels of curves in the order of their colours, below a figure."""
    from matplotlib.lines import Line2D

    figure.legend(
        handles=[Line2D([], [], lw=1.5, ms=3.5, label=x, **in_plane.style(k)) for k, x in enumerate(names)],
        loc="lower center",
        ncol=columns,
        fontsize=7.5,
        frameon=False,
        handlelength=1.6,
        columnspacing=1.1,
        borderpad=0.1,
    )


def rendered(
    name: str, kind: str, model: str, caption: str, alt: str, inches: tuple[float, float], on: Callable[[Any], None]
) -> Figure:
    """What `on` draws on a canvas of some `inches`, as SVG and PNG; the same drawing gives the same bytes."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure as Canvas

    with rc_context(SVG):
        figure = Canvas(figsize=inches)
        on(figure)
        png, svg = io.BytesIO(), io.StringIO()
        quick = {"compress_level": 3}  # a tenth larger than at best, in a third of the time
        figure.savefig(png, format="png", dpi=PNG_DPI, metadata={"Software": "gonio"}, pil_kwargs=quick)
        figure.savefig(svg, format="svg", metadata={"Date": None, "Creator": "gonio"})
    return Figure(name, kind, model, caption, alt, _tidy(svg.getvalue(), name), png.getvalue())


def _tidy(svg: str, name: str) -> str:
    """SVG that can stand in an HTML page: no prologue, no fixed size, ids of its own, and a third of the bytes.

    What is referred to is numbered as it comes, so that the same drawing gives the same bytes in every process.
    """
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = _numbered(svg, "f" + hashlib.sha256(name.encode()).hexdigest()[:8])
    svg = re.sub(r"font-family: 'DejaVu Sans'(, sans-serif)*(; )?", "", svg)
    svg = svg.replace("<svg", f'<svg style="font-family: {FONTS}"', 1)
    # inside of tags alone: what a label says stays as it is
    svg = re.sub(r"<[^>]*>", lambda tag: re.sub(r"\.(\d\d)\d+|\.(\d+)", _decimals, tag[0]), svg)
    svg = re.sub(r' d="[^"]*"', lambda d: re.sub(r"\s*([MLCQz])\s*", r"\1", d[0]).replace(' "', '"'), svg)
    svg = re.sub(r">\s+<", ">\n<", svg)
    return _joined(svg)


def _numbered(svg: str, prefix: str) -> str:
    """Only ids that something refers to, numbered."""
    found = re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', svg)
    new = {old: f"{prefix}-{k}" for k, old in enumerate(dict.fromkeys(a or b for a, b in found))}
    svg = re.sub(r' id="([^"]+)"', lambda m: f' id="{new[m[1]]}"' if m[1] in new else "", svg)
    svg = re.sub(r"url\(#([^)]+)\)", lambda m: f"url(#{new[m[1]]})", svg)
    return re.sub(r'href="#([^"]+)"', lambda m: f'href="#{new[m[1]]}"', svg)


def _decimals(match: re.Match[str]) -> str:
    digits = (match[1] or match[2]).rstrip("0")
    return f".{digits}" if digits else ""


def _joined(svg: str) -> str:
    """Markers of one look in one group, and lines of one look in one path."""

    def group(run: re.Match[str]) -> str:
        uses = re.sub(r' style="[^"]*"', "", run[0])
        return f'<g style="{run[2]}">\n{uses}</g>\n'

    def path(run: re.Match[str]) -> str:
        every = "".join(re.findall(r' d="([^"]*)"', run[0]))
        return f'<path d="{every}" {run[1]}/>\n'

    use, style = r'<use xlink:href="(#[^"]+)" x="[^"]*" y="[^"]*"', r' style="([^"]*)"/>\n'
    svg = re.sub(rf'{use}{style}(?:<use xlink:href="\1" x="[^"]*" y="[^"]*" style="\2"/>\n)+', group, svg)
    return re.sub(r'<path d="[^"]*" ([^>]*fill: none[^>]*)/>\n(?:<path d="[^"]*" \1/>\n)+', path, svg)


def _top(values: Any) -> float:
    return float(np.nanmax(values)) if len(values) else 0.0
