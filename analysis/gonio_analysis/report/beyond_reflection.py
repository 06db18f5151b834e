"""What a sample lets through, and measured Mueller matrices: their parts of a page.

A polar plot has what the sample reflects in the upper half, and what it lets through in the lower one. Mueller
matrices stand in a grid of four by four panels over the angle.
"""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio.formats.reader import MUELLER
from gonio_analysis.curves.in_plane import Curve, Line, labels
from gonio_analysis.fitting.observations import describe_left_out
from gonio_analysis.plots import in_plane
from gonio_analysis.plots.in_plane import clean, style
from gonio_analysis.plots.style import FAINT, INK, columns, xy
from gonio_analysis.report.blocks import Block, Figures, Heading, Notes, Paragraph, Text, code, facts, notes, table
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.report.figures import LEGEND_ROW_IN, legend
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import angle, counted, number, reasons, with_u
from gonio_analysis.result_records import Reflectance
from gonio_analysis.selection.beyond_reflection import MuellerFacts, Transmitted


def grid(axes: Any, lines: Mapping[str, Sequence[Line]]) -> list[Any]:
    """The elements m01 to m33, over the first one, against the signed angle; all panels have one scale.

    Parameters
    ----------
    axes
        An array of 4 x 4 axes; the first is left to its caller, and switched off.
    lines
        By element: measured values, and theory where there is any. Values are dots with bars of u, theory is a line.

    Returns
    -------
    list of artists
        The lines and error bars.
    """
    artists: list[Any] = []
    axes[0][0].axis("off")
    reach = _reach(lines)
    for name in MUELLER:
        i, j = int(name[1]), int(name[2])
        ax = axes[i][j]
        ax.axhline(0.0, color="#9aa3ae", lw=0.6, zorder=1)
        for k, line in enumerate(lines[name]):
            look = style(k)
            if line.theory.size:
                x = np.degrees(line.theory_angle)
                artists += ax.plot(x, line.theory, color=look["color"], lw=1.2, zorder=3, label=line.label)
            u = np.nan_to_num(line.u)
            bars = {"yerr": u if u.any() else None, "ls": "none", "ms": 2.0, "elinewidth": 0.7, "zorder": 4}
            artists.append(ax.errorbar(np.degrees(line.angle), line.measured, **bars, **look))
        ax.set(xlim=(-90, 90), ylim=(-reach, reach))
        ax.set_yticks([-0.8 * reach, 0.0, 0.8 * reach] if reach < 1.0 else [-1.0, 0.0, 1.0])
        ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}".replace("-", "−"))
        ax.set_xticks([-60, 0, 60], ["−60°", "0°", "60°"] if i == 3 else ["", "", ""])
        ax.grid(color=FAINT, lw=0.4)
        clean(ax)
        first = j == (1 if i == 0 else 0)  # of its row: its axis says the scale
        ax.tick_params(labelleft=first)
        ax.text(0.04, 0.97, name, transform=ax.transAxes, ha="left", va="top", fontsize=7.5, color=INK, zorder=6)
    return artists


def _reach(lines: Mapping[str, Sequence[Line]]) -> float:
    """Half the height of every panel: round, and at most a little above 1."""
    values = [v for some in lines.values() for x in some for v in (x.measured, x.theory) if v.size]
    top = max((float(np.nanmax(np.abs(v))) for v in values if np.isfinite(v).any()), default=0.0)
    return next((step for step in (0.1, 0.2, 0.5) if top <= step), 1.08)


def draw_mueller(p: MuellerFacts, name: str, slug: str) -> list[Drawing]:
    """The elements over the angle, where there are in-plane curves."""
    if not any(p.lines.values()):
        return []
    theory = f" Lines: {p.model}, fitted to it." if p.model else ""
    caption = f"Mueller matrix: its elements over the first one, in the plane of incidence. Marks: measurement.{theory}"
    alt = f"Grid of the 15 elements of the Mueller matrix of {name} over the angle."
    return [Drawing(f"{slug}-mueller", "mueller", "", caption, alt, (6.4, 6.0), partial(_on_grid, lines=p.lines))]


def mueller_section(m: MuellerFacts, figures: Sequence[Figure]) -> list[Block]:
    """The elements in numbers, and the figures."""
    words = (
        f"{m.points} values have a Mueller matrix. Its elements are divided by the first one, on s and p of docs/"
        "conventions.md: rows are the reflected light's I, Q, U, V, columns the incident light's."
    )
    if m.model is not None:
        words += f" Residuals are measured less the matrix of {m.model}, which was fitted to it, in single directions."
    rows: list[Sequence[Text]] = [
        (code(e.name), str(e.points), *map(number, (e.rms, e.mean_residual, e.rms_residual, e.chi_square_per_value)))
        for e in m.elements
        if e.points
    ]
    header = ["element", "values", "rms", "mean residual", "rms residual", "χ² a value"]
    return [
        Heading(3, "Polarisation: Mueller matrix", counted(m.points, "value")),
        Paragraph(words),
        Figures(tuple(figures)),
        table("", header, rows, right=(1, 2, 3, 4, 5)),
    ]


def _on_grid(figure: Any, *, lines: dict[str, list[Line]]) -> None:
    from matplotlib.lines import Line2D

    axes = figure.subplots(4, 4, sharex=True, sharey=True)
    figure.subplots_adjust(0.075, 0.085, 0.985, 0.99, wspace=0.1, hspace=0.1)
    grid(axes, lines)
    names = [line.label for line in next(iter(lines.values()))]
    axes[0][0].legend(
        handles=[Line2D([], [], lw=1.2, ms=3, label=x, **in_plane.style(k)) for k, x in enumerate(names)],
        loc="center", fontsize=7, frameon=False, handlelength=1.4, labelspacing=0.3,
    )  # fmt: skip
    figure.supxlabel("θr, positive on the mirror side", fontsize=8, y=0.012)


RIM = 1.0


def disc(
    ax: Any, reflected: Sequence[Line], transmitted: Sequence[Line], order: Sequence[str], *, words: tuple[str, str]
) -> list[Any]:
    """Full disc: the normal of the lit side is up, that of the back down; the mirror's side and straight through right.

    Parameters
    ----------
    ax
        Cartesian axes; their frame is taken away.
    reflected, transmitted
        Measured curves, each already divided so that its largest value is 1. Angles of transmission are turned over:
        counted from the normal of the back, with the straight direction where reflection has the mirror's.
    order
        Labels of all curves: the place tells colour and marker, so that one incidence looks alike in both halves.
    words
        What the radius is, above and below.

    Returns
    -------
    list of artists
        Of each curve: the line, and the stroke that marks the mirror or the straight direction.
    """
    _frame(ax, words)
    artists: list[Any] = []
    for lines, sign in ((reflected, 1.0), (transmitted, -1.0)):
        for line in lines:
            place = order.index(line.label)
            look = style(place)
            size = max(5.0 - 0.9 * place, 2.0)  # those that coincide show around each other
            x, y = xy(line.angle, np.clip(line.measured, 0.0, RIM))
            artists += ax.plot(x, sign * y, lw=0.9, ls=(0, (4, 2)), ms=size, zorder=4, clip_on=False, **look)
            if line.mirror is not None:
                x, y = xy(np.array([line.mirror, line.mirror]), np.array([RIM, 1.04 * RIM]))
                artists += ax.plot(
                    x, sign * y, color=look["color"], lw=2.2, solid_capstyle="butt", clip_on=False, zorder=5
                )
    return artists


def _frame(ax: Any, words: tuple[str, str]) -> None:
    from matplotlib.collections import LineCollection

    ax.axis("off")
    ax.set(aspect="equal", xlim=(-1.14, 1.14), ylim=(-1.3, 1.3))
    turn = np.linspace(-np.pi, np.pi, 361)
    rings = [np.stack(xy(turn, np.full(turn.size, r)), axis=1) for r in (0.25, 0.5, 0.75)]
    rays = [np.stack(xy(np.full(2, a), np.array([0.0, RIM])), axis=1) for a in np.radians(np.arange(-165, 181, 15))]
    rim, sample = np.stack(xy(turn, np.full(turn.size, RIM)), axis=1), np.array([(-RIM, 0.0), (RIM, 0.0)])
    for lines, colour, width, order in (
        ([*rings, *rays], FAINT, 0.5, 1),
        ([rim], INK, 0.9, 1),
        ([sample], INK, 1.8, 2),
    ):
        ax.add_collection(LineCollection(lines, colors=colour, linewidths=width, zorder=order), autolim=False)
    for degrees in range(-150, 181, 30):
        (tx,), (ty,) = xy(np.radians([degrees]), np.array([1.085]))
        ax.text(tx, ty, f"{degrees}°".replace("-", "−"), ha="center", va="center", fontsize=7, color=INK)
    for r in (0.5, 1.0):
        ax.text(0.012, r - 0.035, f"{r:g}", ha="left", va="center", fontsize=6.5, color=INK, zorder=6)
        ax.text(0.012, 0.035 - r, f"{r:g}", ha="left", va="center", fontsize=6.5, color=INK, zorder=6)
    for y, text in zip((1.245, -1.245), words, strict=True):
        ax.text(0, y, text, ha="center", va="center", fontsize=7.5, color=INK)
    for x, y, text in ((-1.13, 1.13, "retro side"), (1.13, 1.13, "mirror side"), (1.13, -1.13, "straight on")):
        ax.text(x, y, text, ha="left" if x < 0 else "right", fontsize=7, color="#5a6472", va="center")


def draw(t: Transmitted, reflected: Sequence[Curve], slug: str, *, simulated: bool = False) -> list[Drawing]:
    """The figures of one sample: both sides in a polar plot, and the transmission in absolute values."""
    if not t.curves:
        return []
    measured = "simulated measurement" if simulated else "measurement"
    above, below = _lines(reflected, True), _lines(t.curves, True)
    order = list(dict.fromkeys(line.label for line in (*above, *below)))
    halves = (
        "BRDF in the upper half, BTDF in the lower one"
        if above
        else "BTDF in the lower half, no reflection was measured"
    )
    caption = (
        f"Both sides: {measured} in the plane of incidence; {halves}. Each curve is divided by its own largest value;"
        " the strokes on the rim mark the mirror direction above and the straight direction below."
    )
    alt = f"Polar plot of reflection and transmission of {t.name}: {len(above)} curves above, {len(below)} below."
    high = 5.55 + LEGEND_ROW_IN * -(-len(order) // _columns(order))
    on = partial(_on_disc, above=above, below=below, order=order)
    out = [Drawing(f"{slug}-both-sides", "both-sides", "", caption, alt, (5.6, high), on)]
    caption = (
        f"Transmission: BTDF, {measured} in the plane of incidence. The angle counts from the normal of the back,"
        " positive on the side of the straight direction; θr is 180° less its size."
    )
    alt = f"Transmission of {t.name} over the angle, {number(float(t.data.brdf.max()))} per steradian at most."
    absolute = _lines(t.curves, False)
    high = 2.9 + LEGEND_ROW_IN * -(-len(absolute) // _columns([line.label for line in absolute]))
    return [
        *out,
        Drawing(
            f"{slug}-transmission", "transmission", "", caption, alt, (5.6, high), partial(_on_axis, lines=absolute)
        ),
    ]


def section(
    t: Transmitted, figures: Sequence[Figure], rho_dh: Sequence[Reflectance] = (), title: str = "Transmission"
) -> list[Block]:
    """What was transmitted, in numbers and figures."""
    rows = [("source", t.source)] if t.source else []
    at, left_out = t.data, describe_left_out(t.data.left_out)
    rows += [("values used", f"{len(at)} of {t.rows}" + (f"; left out: {left_out}" if left_out else ""))]
    rows += [] if math.isnan(t.wavelength_nm) else [("wavelength", f"{t.wavelength_nm:g} nm")]
    rows.append(("BTDF", f"{number(float(at.brdf.min()))} to {number(float(at.brdf.max()))} sr⁻¹"))
    first = next((tau for tau in t.tau_dh if tau.rho_dh is not None), None)
    short = "" if first is None else f"lets {with_u(first.rho_dh, first.u)} through at {angle(first.theta_i_deg)}"
    out: list[Block] = [Heading(3, title, short, open=True), facts(rows), notes(t.notes)]
    known = [
        [angle(tau.theta_i_deg), with_u(tau.rho_dh, tau.u), *_beside(tau, rho_dh)]
        for tau in t.tau_dh
        if tau.rho_dh is not None
    ]
    if known:
        out.append(
            table(
                "Directional-hemispherical transmittance tau_dh, integrated over the measured values behind the sample;"
                " rho_dh is the measurement's own reflectance at that incidence.",
                ["θi", "tau_dh", "rho_dh", "both"],
                known,
                right=(1, 2, 3),
            )
        )
    return [*out, Notes(tuple(reasons("tau_dh", t.tau_dh))), Figures(tuple(figures))]


def _beside(tau: Reflectance, rho_dh: Sequence[Reflectance]) -> tuple[str, str]:
    """The reflectance at the incidence of a transmittance, and both together."""
    rho = next((r for r in rho_dh if abs(r.theta_i_deg - tau.theta_i_deg) < 0.5), None)
    if rho is None or rho.rho_dh is None or tau.rho_dh is None:
        return "–", "–"
    # the reference and the lamp are common to both: their uncertainties are added, not their squares
    u = None if tau.u is None or rho.u is None else tau.u + rho.u
    return with_u(rho.rho_dh, rho.u), with_u(tau.rho_dh + rho.rho_dh, u)


def _lines(curves: Sequence[Curve], normalised: bool) -> list[Line]:
    none = np.empty(0)
    out = []
    for c, label in zip(curves, labels(list(curves)), strict=True):
        top = float(c.brdf.max()) if normalised and c.brdf.max() > 0 else 1.0
        mirror = c.parameter if c.scanned == "theta_r" and math.isfinite(c.parameter) else None
        out.append(Line(label, none, none, c.angle, c.brdf / top, c.u / top, mirror))
    return out


def _columns(names: list[str]) -> int:
    """Columns of a legend that is as wide as the figure."""
    return columns(names, 5.6)


def _on_disc(figure: Any, *, above: list[Line], below: list[Line], order: list[str]) -> None:
    room = LEGEND_ROW_IN * -(-len(order) // _columns(order)) + 0.1
    ax = figure.add_axes((0.01, room / figure.get_figheight(), 0.98, 0.99 - room / figure.get_figheight()))
    words = ("BRDF / its largest value" if above else "(no reflection)", "BTDF / its largest value")
    disc(ax, above, below, order, words=words)
    legend(figure, order, _columns(order))


def _on_axis(figure: Any, *, lines: list[Line]) -> None:
    names, ax, high = [line.label for line in lines], figure.subplots(), figure.get_figheight()
    room = LEGEND_ROW_IN * -(-len(lines) // _columns(names)) + 0.46
    figure.subplots_adjust(0.145, room / high, 0.975, 1 - 0.11 / high)
    in_plane.semilog(ax, lines, unit="BTDF [1/sr]")
    ax.set_xlabel("angle from the normal of the back", fontsize=8)
    legend(figure, names, _columns(names))


SECTIONS = (
    Section(
        "transmission",
        lambda d, figures: (
            []
            if d.transmission is None
            else section(d.transmission, (*figures.get("both-sides", ()), *figures.get("transmission", ())), d.rho_dh)
        ),
        lambda d, facts: (
            [] if d.transmission is None else draw(d.transmission, d.curves, facts.slug, simulated=d.simulated)
        ),
    ),
    Section(
        "polarisation",
        lambda d, figures: [] if d.mueller is None else mueller_section(d.mueller, figures.get("mueller", ())),
        lambda d, facts: [] if d.mueller is None else draw_mueller(d.mueller, d.name, facts.slug),
    ),
)
