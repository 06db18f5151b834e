"""A sample's quantities of appearance (`gonio appearance`): what is named, their page, their table in other pages."""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gonio.measurement import Reading, of_one
from gonio.typing import Floats
from gonio_analysis.appearance.glossmeter import GLOSSMETERS, SOURCE_DEG
from gonio_analysis.appearance.of_models import of_sample
from gonio_analysis.appearance.quantities import of_table
from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Heading,
    Page,
    Stamp,
    Table,
    footer,
    lead,
    notes,
    stamp,
    table,
)
from gonio_analysis.report.drawing import Drawing, Figure, FigureWorkers
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import counted, number, quantity, with_u
from gonio_analysis.result_records import Appearance, Quantity, as_json

KINDS = {"table": "measurement", "model": "model", "fit": "fitted model"}
FIRST = 3
"""Quantities that a verdict names."""
HEADER = ["quantity", "value", "", "after"]


class Listed(NamedTuple):
    """One quantity in words."""

    label: str
    value: str
    remark: str
    """Why there is none, or what its value rests on."""
    after: str


def of(spec: str, *, wavelength_nm: float | None = None, how: Reading | None = None) -> Appearance:
    """The quantities of what a command line names: a table, a run, `FILE:SAMPLE`, or a model as a sample file (.toml).

    Raises
    ------
    ConfigError, DataError
        From reading it; a file of several samples has to be narrowed to one.
    """
    if spec.endswith(".toml"):
        from gonio.samples.files import load_sample

        return of_sample(load_sample(spec, uniform=True), source=spec, wavelength_nm=wavelength_nm)

    name, table = of_one(spec, how)
    return of_table(table, name=name, source=spec, wavelength_nm=wavelength_nm)


def listed(a: Appearance, *, reflectances: bool = True) -> list[Listed]:
    """Every quantity in words, in the order of a page; those by incidence may stand elsewhere."""
    gloss, integral, factor = "ISO 2813, ASTM D523", "integral over the hemisphere", "CIE 15"
    retro = [(f"{r.entrance_deg:g}°, observed at {r.observation_deg:g}°", r) for r in a.retroreflection]
    rows: list[tuple[str, Quantity, str]] = [
        ("gloss at 20°", a.gloss_20_gu, gloss),
        ("gloss at 60°", a.gloss_60_gu, gloss),
        ("gloss at 85°", a.gloss_85_gu, gloss),
        ("haze, G60 − G20", a.haze_gu, "ASTM D4039"),
        ("haze at 18.1° and 21.9° for 20°", a.haze_e430_20, "ASTM E430 method B, ISO 13803"),
        ("haze at 28° and 32° for 30°", a.haze_e430_30, "ASTM E430 method A"),
        ("reflectance at 8°", a.rho_dh_8, integral),
        *((f"ρ_dh at {q.theta_i_deg:g}°", q, integral) for q in a.rho_dh if reflectances),
        ("radiance factor 0:45", a.radiance_factor_0_45, factor),
        ("radiance factor 45:0", a.radiance_factor_45_0, factor),
        *(
            (f"{name} at {where}", q, "CIE e-ILV 17-24-103, -104")
            for where, r in retro
            for name, q in (("R_A", r.R_A), ("R_L", r.R_L))
        ),
        ("flop index", a.flop_index, "Alman 1987"),
        ("scattered share (TIS) at 8°", a.tis_8, "ASTM F1048"),
        ("rms roughness", a.rms_roughness_nm, "Davies 1954"),
    ]
    out = [Listed(label, _value(q), _remark(q), after) for label, q, after in rows]
    colour, reasons = "CIE 15, D65, 2°; ASTM E2194, E2539", {c.L.why for c in a.lab}
    if len(reasons) == 1 and None not in reasons:  # without a spectrum none of them has a colour, for one reason
        return [*out, Listed(f"L*, a*, b* in {len(a.lab)} geometries", "–", _remark(a.lab[0].L), colour)]
    for c in a.lab:
        where = f"L*, a*, b* at {c.theta_i_deg:g}°, aspecular {_signed(c.aspecular_deg)}°"
        parts = "; ".join(_value(q, 2) for q in (c.L, c.a, c.b))
        out.append(Listed(where, "–" if c.L.value is None else parts, _remark(c.L), colour))
    return out


def _caption(a: Appearance) -> str:
    at = "" if a.wavelength_nm is None else f"All but colours at {a.wavelength_nm:g} nm. "
    return at + "± is a standard uncertainty; the error is that of quadrature or of interpolation."


def known(a: Appearance) -> Table | None:
    """Those of the quantities that have a value, for a page about something else; None where there are none."""
    every = listed(a, reflectances=False)  # a measurement's own stand among its checks
    rows = [one for one in every if one.value != "–"]
    left = len(every) - len(rows)
    caption = f"{left} further quantities do not follow from these values: gonio appearance says why." if left else ""
    return table(caption, HEADER, rows) if rows else None


def make(a: Appearance, out: str | Path, *, command: str = "") -> Path:
    """Write a page on the quantities, with figures and `summary.json`: all of it or nothing.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that this program did not write.
    """
    with files.staged(out) as stage:
        made = stamp(command)
        files.write_page(
            stage.work,
            a.title,
            partial(_page, a, made),
            lambda figures: {**as_json(a), **made, "figures": figures},
            lambda: FigureWorkers().draw(_drawings(a)),
        )
    return Path(out) / "index.html"


def _page(a: Appearance, made: Stamp, figures: Sequence[Figure]) -> Page:
    what, gonio = f"{'simulated ' * a.simulated}{KINDS[a.kind]}", made["versions"]["gonio"]
    every = listed(a)
    rows, lacking = [one for one in every if one.value != "–"], [one for one in every if one.value == "–"]
    folds: list[Block] = []
    if rows:
        resting = sum(bool(one.remark) for one in rows)
        folds += [
            Heading(3, "After which standard, and what a value rests on", f"{resting} with a remark"),
            table("", ["quantity", "after", "remark"], [[one.label, one.after, one.remark] for one in rows]),
        ]
    if lacking:
        folds += [
            Heading(3, "What does not follow from these values", counted(len(lacking), "quantity", "quantities")),
            table("", ["quantity", "why", "after"], [[one.label, one.remark, one.after] for one in lacking]),
        ]
    if a.notes:
        folds += [Heading(3, "Notes", counted(len(a.notes), "note")), notes(a.notes)]
    folds += frame.provenance(made, ("source", a.source or "–"), called="page made")
    first = frame.answer(
        [lead(_verdict(rows, len(every)))],
        [Figures(tuple(figures))],
        [table(_caption(a), HEADER[:2], [one[:2] for one in rows])] if rows else [],
    )
    return frame.page(
        a.title,
        f"Appearance of a {what}, {made['created'][:10]}, gonio {gonio}.",
        first,
        folds=folds,
        foot=footer("Every number on this page is in `summary.json`."),
        called=f"Appearance of {a.title}",
    )


def _verdict(known: Sequence[Listed], count: int) -> str:
    if not known:
        return f"None of the {count} quantities follows from these values."
    first = ", ".join(f"{one.label} is {one.value}" for one in known[:FIRST])
    rest = f"{len(known)} of {count} quantities follow from these values."
    return f"{first[:1].upper()}{first[1:]}. {rest}"


def _drawings(a: Appearance) -> list[Drawing]:
    out = []
    coloured = [c for c in a.lab if c.L.value is not None]
    if coloured:
        made = " of the simulated measurement" * a.simulated
        caption = f"L*a*b*{made} against the aspecular angle, from the mirror direction toward the normal."
        groups = []
        for theta in sorted({c.theta_i_deg for c in coloured}, reverse=True):
            mine = [c for c in coloured if c.theta_i_deg == theta]
            values, u = (
                [np.array([getattr(getattr(c, letter), what) for c in mine], dtype=np.float64) for letter in "Lab"]
                for what in ("value", "u")
            )
            groups.append((theta, np.array([c.aspecular_deg for c in mine]), values, u))
        out.append(Drawing("colour", "colour", "", caption, caption, (6.4, 3.2), partial(_on_colours, groups=groups)))
    caption = (
        "The glossmeter's beams in the plane of incidence: source at the left, receiver at the right, full angles of"
        " their apertures."
    )
    words = [_value(q) for q in (a.gloss_20_gu, a.gloss_60_gu, a.gloss_85_gu)]
    return [*out, Drawing("gloss", "gloss", "", caption, caption, (6.4, 1.7), partial(_on_beams, words=words))]


def _on_colours(figure: Any, *, groups: list[tuple[float, Floats, list[Floats], list[Floats]]]) -> None:
    axes = figure.subplots(
        1, len(groups), squeeze=False, width_ratios=[max(len(g[1]), 2) for g in groups], sharey=True
    )[0]
    figure.subplots_adjust(0.08, 0.17, 0.86, 0.91, wspace=0.08)
    for ax, (theta, angles, values, u) in zip(axes, groups, strict=True):
        colours(ax, angles, values, u, label=f"θi = {theta:g}°")
        ax.set_xlabel("aspecular angle / °", fontsize=8)
    axes[-1].legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.02, 0.5), borderaxespad=0.0)


def _on_beams(figure: Any, *, words: Sequence[str]) -> None:
    axes = figure.subplots(1, len(GLOSSMETERS))
    figure.subplots_adjust(0.01, 0.02, 0.99, 0.88, wspace=0.05)
    for ax, meter, value in zip(axes, GLOSSMETERS, words, strict=True):
        beams(ax, meter.angle_deg, SOURCE_DEG[0], meter.receiver_deg[0], label=f"{meter.angle_deg:g}°: {value}")


def _value(q: Quantity, decimals: int | None = None) -> str:
    if q.value is None:
        return "–"
    if q.u is not None:
        shown = with_u(q.value, q.u)
    elif decimals is not None or q.unit == "GU":
        shown = f"{q.value + 0.0:.{decimals or 2}f}".replace("-0.00", "0.00").replace("-", "−")
    else:
        shown = number(q.value, 4)
    return quantity(shown, "" if q.unit == "1" else q.unit)


def _remark(q: Quantity) -> str:
    if q.value is None:
        bound = "" if q.at_least is None else f" (at least {number(q.at_least)})"
        return f"{q.why}{bound}"
    parts = [q.note] if q.note else []
    if q.error is not None and q.error > max(0.3 * (q.u or 0.0), 5e-4 * abs(q.value)):
        parts.append(f"error {number(q.error, 2)}")
    return "; ".join(parts)


def _signed(angle: float) -> str:
    return f"{angle:g}".replace("-", "−")


def _in_short(a: Appearance | None) -> str:
    """The first quantities that are known."""
    rows = [] if a is None else [one for one in listed(a, reflectances=False) if one.value != "–"]
    return ", ".join(f"{one.label}: {one.value}" for one in rows[:2])


def _beside(d: DatasetSummary, figures: object) -> list[Block]:
    quantities = None if d.appearance is None else known(d.appearance)
    return [] if quantities is None else [Heading(3, "Appearance", _in_short(d.appearance)), quantities]


SECTIONS = (Section("appearance", _beside),)


LETTERS = ("L*", "a*", "b*")
STYLES = (("#222222", "o", "-"), ("#b3322c", "s", "--"), ("#2a6db0", "^", ":"))
"""Colour, marker and line of L*, a* and b*."""


def colours(ax: Any, aspecular_deg: Floats, values: Sequence[Floats], u: Sequence[Floats], *, label: str) -> list[Any]:
    """L*, a* and b* over the aspecular angle at one incidence; a number that is missing is NaN.

    Parameters
    ----------
    aspecular_deg
        Angles from the mirror direction toward the normal, (n,).
    values, u
        Three arrays (n,) each; NaN in `u` draws no bar.
    label
        Of the incidence, as a title.
    """
    drawn = []
    for name, value, bar, (colour, marker, line) in zip(LETTERS, values, u, STYLES, strict=True):
        look = {"color": colour, "marker": marker, "ls": line, "ms": 4, "lw": 1, "capsize": 2, "label": name}
        drawn.append(ax.errorbar(aspecular_deg, value, yerr=bar, **look))
    ax.axhline(0.0, color="0.8", lw=0.7, zorder=0)
    ax.set_title(label, fontsize=9)
    ax.set_xticks(list(aspecular_deg))
    ax.tick_params(labelsize=8)
    return drawn


def beams(ax: Any, angle_deg: float, source_deg: float, receiver_deg: float, *, label: str) -> list[Any]:
    """A glossmeter's source and receiver in the plane of incidence, as wedges over the surface."""
    from matplotlib.patches import Wedge

    drawn = [ax.plot([-1.1, 1.1], [0.0, 0.0], color="0.3", lw=1.2)[0]]
    drawn += ax.plot([0.0, 0.0], [0.0, 1.0], color="0.7", lw=0.8, ls=":")
    for side, width, colour in ((-1.0, source_deg, "#c8861a"), (1.0, receiver_deg, "#2a6db0")):
        centre = 90.0 - side * angle_deg
        wedge = Wedge((0.0, 0.0), 1.0, centre - width / 2.0, centre + width / 2.0, facecolor=colour, edgecolor=colour)
        drawn.append(ax.add_patch(wedge))
        turn = math.radians(centre)
        above = 0.12 if angle_deg > 80.0 else 0.0  # clear of the surface
        place = (1.14 * math.cos(turn), 1.14 * math.sin(turn) + above)
        ax.annotate(f"{width:g}°", place, ha="center", va="center", fontsize=8)
    ax.set(xlim=(-1.35, 1.35), ylim=(-0.1, 1.25), aspect="equal")
    ax.set_axis_off()
    ax.set_title(label, fontsize=9)
    return drawn
