"""What a sample lets through: its part of a page."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio_analysis.curves.in_plane import Curve, labels
from gonio_analysis.curves.line import Line
from gonio_analysis.fitting.observations import describe_left_out
from gonio_analysis.plots import in_plane, two_sides
from gonio_analysis.report.blocks import Block, Figures, Heading, Notes, facts, notes, table
from gonio_analysis.report.drawings import Drawing, Figure
from gonio_analysis.report.figures import LEGEND_ROW_IN, legend
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import angle, number, reasons, with_u
from gonio_analysis.result_records import Reflectance
from gonio_analysis.selection.transmission import Transmitted


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
    out: list[Block] = [Heading(3, title), facts(rows), notes(t.notes)]
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
    missing = (
        f"tau_dh at {'θi = ' + ', '.join(where) if len(where) <= 8 else f'{len(where)} incidences'}: {reason}."
        for reason, where in reasons(t.tau_dh).items()
    )
    return [*out, Notes(tuple(missing)), Figures(tuple(figures))]


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
    """Of a legend that is as wide as the figure."""
    return 6 if max(map(len, names), default=0) < 10 else 3


def _on_disc(figure: Any, *, above: list[Line], below: list[Line], order: list[str]) -> None:
    room = LEGEND_ROW_IN * -(-len(order) // _columns(order)) + 0.1
    ax = figure.add_axes((0.01, room / figure.get_figheight(), 0.98, 0.99 - room / figure.get_figheight()))
    words = ("BRDF / its largest value" if above else "(no reflection)", "BTDF / its largest value")
    two_sides.disc(ax, above, below, order, words=words)
    legend(figure, order, _columns(order))


def _on_axis(figure: Any, *, lines: list[Line]) -> None:
    names, ax, high = [line.label for line in lines], figure.subplots(), figure.get_figheight()
    room = LEGEND_ROW_IN * -(-len(lines) // _columns(names)) + 0.46
    figure.subplots_adjust(0.145, room / high, 0.975, 1 - 0.11 / high)
    in_plane.semilog(ax, lines, unit="BTDF [1/sr]")
    ax.set_xlabel("angle from the normal of the back", fontsize=8)
    legend(figure, names, _columns(names))


SECTION = Section(
    "transmission",
    lambda d, figures: (
        []
        if d.transmission is None
        else section(d.transmission, (*figures.get("both-sides", ()), *figures.get("transmission", ())), d.rho_dh)
    ),
    lambda d, facts: [] if d.transmitted is None else draw(d.transmitted, d.curves, facts.slug, simulated=d.simulated),
)
