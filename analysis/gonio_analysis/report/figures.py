"""The figures of a report, each as SVG (inlined into the page, and as a file) and as PNG."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio import geometry
from gonio_analysis import polar
from gonio_analysis.compare import Dataset, Fitted
from gonio_analysis.report.text import cause, number, slug

SVG = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gonio",
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans"],
}
FONTS = "'DejaVu Sans', Verdana, 'Segoe UI', sans-serif"
"""Metrics close to those that matplotlib lays out with, so that labels keep their places."""
PNG_DPI = 160
LEGEND_ROW_IN = 0.19


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


def draw(d: Dataset, facts: dict[str, Any]) -> list[Figure]:
    """Every figure of one measured sample.

    Parameters
    ----------
    d
        The measurement with its fitted models.
    facts
        Its part of the summary.
    """
    out = []
    for model, f in d.fitted.items():
        if f.drawn:
            out.append(_polar(d, facts, model, f))
    for model, f in d.fitted.items():
        out.append(_absolute(d, facts, model, f))
    if facts["budget"]:
        out.append(_budget(facts))
    out += [_series(facts, model, f) for model, f in d.fitted.items() if len(f.series) > 1]
    return out


def _polar(d: Dataset, facts: dict[str, Any], model: str, f: Fitted) -> Figure:
    lines = [c.normalised() for c in f.drawn]
    rim = polar.radius_of(lines)

    below = LEGEND_ROW_IN * _legend_rows(f)

    def on(figure: Any) -> None:
        ax = figure.add_axes((0.01, below / (3.22 + below), 0.98, 3.2 / (3.22 + below)))
        polar.polar(ax, lines, radius=rim, radius_label=_radius_label(f))
        _legend(figure, f, "lower center")

    cut = [c.label for c, x in zip(f.drawn, lines, strict=True) if max(_top(x.theory), _top(x.measured)) > 1.001 * rim]
    caption = f"{model}: normalised {_norm_words(f)}. Solid: theory; dashed, with error bars: measurement."
    if cut:
        caption += f" Cut at the rim: {', '.join(cut)}."
    caption += _spikes(f)
    alt = f"Half-disc polar plot for {d.name} and {model}. " + " ".join(
        f"{c['label']}: measured peak at {c['measured_peak_deg']:.1f}°, theory's at {c['theory_peak_deg']:.1f}°."
        for c in facts["models"][model]["curves"]
    )
    return rendered(f"{facts['slug']}-polar-{slug(model)}", "polar", model, caption, alt, (5.6, 3.22 + below), on)


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
    return f"{words['mirror']}; curves marked * {words[other]}, because their mirror direction was not measured"


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


def _absolute(d: Dataset, facts: dict[str, Any], model: str, f: Fitted) -> Figure:
    lines = [c.absolute() for c in f.drawn]
    stated = d.data.covariance is not None
    used = np.concatenate([c.curve.rows for c in f.drawn]) if f.drawn else np.empty(0, dtype=np.intp)
    rest = np.setdiff1d(np.arange(len(d.data)), used)
    data = d.data
    moving = data.theta_i if d.curves and d.curves[0].scanned == "theta_i" else data.theta_r
    with np.errstate(divide="ignore"):
        values = f.fit.whitened if stated else f.fit.predicted / data.brdf - 1.0
    others = (geometry.in_plane_angle(moving[rest], data.phi_r[rest] - data.phi_i[rest]), values[rest])

    below = 0.46 + LEGEND_ROW_IN * _legend_rows(f)
    high = 3.57 + below

    def on(figure: Any) -> None:
        top, low = figure.subplots(2, 1, height_ratios=(2.4, 1), sharex=True)
        figure.subplots_adjust(0.145, below / high, 0.975, 1 - 0.11 / high, hspace=0.12)
        if lines:
            polar.semilog(top, lines)
        else:
            top.set_axis_off()
        top.set_xlabel("")
        polar.residuals(low, lines, whitened=stated, others=others)
        running = "θr" if not d.curves or d.curves[0].scanned == "theta_r" else "θi"
        low.set_xlabel(f"{running}: retro side negative, mirror side positive")
        for ax in (top, low):  # a fixed place: to look for one, every tick would be laid out once more
            ax.yaxis.set_label_coords(-0.1, 0.5)
        low.xaxis.set_label_coords(0.5, -0.235)
        _legend(figure, f, "lower center", star=False)

    kind = (
        "whitened residuals: model minus measurement in standard deviations, correlations taken out (band: ±2)"
        if stated
        else "model divided by measurement"
    )
    caption = f"{model}: absolute in-plane BRDF. Below: {kind}"
    caption += "; grey: values that belong to no curve shown." if rest.size else "."
    chi = facts["models"][model]["reduced_chi_square"]
    alt = f"Semilog curves and residuals for {d.name} and {model}" + (
        f"; reduced chi-square {number(chi)}." if chi is not None else "."
    )
    return rendered(f"{facts['slug']}-absolute-{slug(model)}", "absolute", model, caption, alt, (5.6, high), on)


def _budget(facts: dict[str, Any]) -> Figure:
    parts = [(cause(p["cause"]), p["median"], p["p95"]) for p in facts["budget"]]

    def on(figure: Any) -> None:
        ax = figure.add_subplot()
        figure.subplots_adjust(0.25, 0.48 / budget_height(len(parts)), 0.97, 0.97)
        polar.budget(ax, parts)

    caption = (
        "Uncertainty budget: standard uncertainty by cause, relative to the value. Bar: median over the values; tick:"
        " 95th percentile. Values within 3 u of zero are left out."
    )
    alt = "Uncertainty by cause. " + " ".join(
        f"{c}: median {100 * m:.2g} %, 95th percentile {100 * p:.2g} %." for c, m, p in parts
    )
    return rendered(f"{facts['slug']}-budget", "budget", "", caption, alt, (5.6, budget_height(len(parts))), on)


def budget_height(parts: int) -> float:
    """Of the figures of an uncertainty budget [in], which stand side by side."""
    return 0.7 + 0.3 * parts


def _series(facts: dict[str, Any], model: str, f: Fitted) -> Figure:
    free = [n for n in f.fit.free if any(not r.parameters[n].fixed for r in f.series)]
    x = np.array([r.wavelength_nm for r in f.series])

    def on(figure: Any) -> None:
        axes = figure.subplots(1, len(free), squeeze=False)[0]
        figure.subplots_adjust(0.1, 0.26, 0.985, 0.87, wspace=0.42)
        for k, (ax, name) in enumerate(zip(axes, free, strict=True)):
            y = np.array([r.parameters[name].value for r in f.series], dtype=float)
            u = np.array([r.parameters[name].u for r in f.series], dtype=float)
            span = float(np.ptp(y)) or float(np.abs(y).max()) or 1.0
            u = np.where(np.isfinite(u) & (u < 2 * span), u, 0.0)
            polar.series(ax, x, y, u, x_label="wavelength [nm]", y_label="", colour=polar.COLOURS[k % 6])
            ax.set_title(name, fontsize=8, color=polar.INK)  # a power of ten stands on the left

    caption = (
        f"{model}: fitted parameters at each of the {len(f.series)} wavelengths, with standard errors (those wider"
        " than the panel are not drawn)."
    )
    return rendered(f"{facts['slug']}-series-{slug(model)}", "series", model, caption, caption, (5.6, 1.9), on)


def _legend_columns(f: Fitted) -> int:
    count = len(f.drawn)
    return min(count, 6 if max(len(c.label) for c in f.drawn) < 10 else 4 if count != 6 else 3)


def _legend_rows(f: Fitted) -> int:
    return -(-len(f.drawn) // _legend_columns(f)) if f.drawn else 0


def _legend(figure: Any, f: Fitted, where: str, star: bool = True) -> None:
    from matplotlib.lines import Line2D

    if not f.drawn:
        return
    mixed = star and len({c.norm.kind for c in f.drawn}) > 1
    handles = []
    for k, c in enumerate(f.drawn):
        look = polar.style(k)
        text = c.label + ("*" if mixed and c.norm.kind != "mirror" else "")
        handles.append(Line2D([], [], lw=1.5, ms=3.5, label=text, **look))
    figure.legend(
        handles=handles,
        loc=where,
        ncol=_legend_columns(f),
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
    """SVG that can stand in an HTML page: no prologue, no fixed size, ids of its own, shorter numbers."""
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", svg, count=1)
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r"url\(#([^)]+)\)", rf"url(#{name}-\1)", svg)
    svg = re.sub(r'href="#([^"]+)"', rf'href="#{name}-\1"', svg)
    svg = re.sub(r"'DejaVu Sans'(, sans-serif)*", FONTS, svg)
    # inside of tags alone: what a label says stays as it is
    return re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\d+\.\d{2})\d+", r"\1", tag[0]), svg)


def _top(values: Any) -> float:
    return float(np.nanmax(values)) if len(values) else 0.0
