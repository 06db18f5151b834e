"""What is known of the uncertainties of a sample's values: the part of a page.

Of a run it is the budget: every part of it in words and numbers, and which of them matters where.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, TypedDict

import numpy as np

from gonio.run_facts import BudgetCurve, BudgetFacts, RunFacts
from gonio_analysis.curves.in_plane import evenly
from gonio_analysis.plots.in_plane import COLOURS, clean, degrees_along
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import MOST_ROWS, Block, Figures, Heading, Notes, Paragraph, Text, caused, table, term
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.figures import LEGEND_ROW_IN, key
from gonio_analysis.report.section import Figures as ByKind
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import cause, number, percent

KIND = "budget-shares"
REST = "the rest"
MOST_PANELS = 6
PANEL_IN = 1.45
FOOT_IN = 0.45
COLUMNS = 2
LEAST = 1e-5
MEDIAN = term("median u / f", "Standard uncertainty over the value: half of the values have a smaller one.")
SHARE = term("share of variance", "The part of u² that the cause makes, averaged over the values.")
KIND_OF_CAUSE = term("kind", "Common: one error moves all values together. Own: each value has its own error.")


def of(run: RunFacts | None, wavelength_nm: float | None) -> BudgetFacts | None:
    """The budget at one wavelength; None for a table that no run made, or that an older version reduced."""
    for found in run.budget if run is not None else []:
        if found.wavelength_nm is None or wavelength_nm is None or abs(found.wavelength_nm - wavelength_nm) < 1e-6:
            return found
    return None


def draw(found: BudgetFacts | None, slug: str) -> list[Drawing]:
    """Shares of the variance over the signed angle of reflection, one panel an angle of incidence."""
    if found is None or not found.curves:
        return []
    every = found.curves
    curves = [every[k] for k in evenly(len(every), MOST_PANELS)]
    caption = (
        "Shares of the variance: what that of each value is made of, along the curves in the plane of incidence. The"
        f" {len(found.largest)} largest causes, and the rest."
    )
    if len(curves) < len(every):
        caption += f" {len(curves)} of {len(every)} angles of incidence are drawn."
    alt = "Mean share of the variance: " + ", ".join(
        f"{cause(p.cause)} {percent(p.share)}" for p in found.parts if p.cause in found.largest
    )
    rows = -(-len(curves) // COLUMNS)
    columns = min(len(curves), COLUMNS)
    size = (5.6, PANEL_IN * rows + FOOT_IN + LEGEND_ROW_IN * (-(-(len(found.largest) + 1) // 3)))
    on = partial(_on_panels, curves=curves, names=[*found.largest, REST], rows=rows, columns=columns)
    return [Drawing(f"{slug}-budget-shares", KIND, "", caption, alt + ".", size, on)]


def section(found: BudgetFacts, figures: Sequence[Figure]) -> list[Block]:
    """The table of the parts, what is not among them, and the figure."""
    rows: list[list[Text]] = [[caused("combined"), percent(found.median), percent(found.highest), percent(1.0), ""]]
    rows += [
        [caused(p.cause, common=p.common), _percent(p.median), _percent(p.largest), _percent(p.share),
         "common" if p.common else "own"]
        for p in found.parts if p.largest > 0.0
    ]  # fmt: skip
    head: list[Text] = ["cause", MEDIAN, term("largest", "The largest u / f of a value."), SHARE, KIND_OF_CAUSE]
    caption = "Standard uncertainties (k = 1) relative to the value, and the mean share of the variance."
    out: list[Block] = [table(caption, head, rows, right=(1, 2, 3))]
    words = (
        f"Expanded uncertainty (k = 2) of the {found.values} values in this budget, those beyond 3 u: median"
        f" {percent(2 * found.median)}, largest {percent(2 * found.highest)}. Apart from the certificate of the white"
        f" reference: median {percent(2 * found.median_apart)}, largest {percent(2 * found.highest_apart)}."
    )
    if found.nu_eff is not None:
        words += f" Effective degrees of freedom: at least {number(found.nu_eff, 2)}."
    if found.coarse:
        words += (
            f" {found.coarse} values lie beside a lobe that the plan's steps do not resolve (column coarse of"
            " budget.csv): their uncertainty is that of the steepest lobe that the data allow."
        )
    nothing = [part for p in found.parts if p.largest <= 0.0 for part in (", ", caused(p.cause, common=p.common))][1:]
    without = (" Budgeted, and without a part in these values: ", *nothing, ".") if nothing else ()
    out.append(Paragraph((words, *without)))
    if found.monte_carlo:
        out.append(Paragraph(f"Checked by drawing the inputs: {found.monte_carlo}."))
    out.append(Figures(tuple(figures)))
    left_out = tuple((caused(name), f": {why}") for name, why in found.left_out.items())
    return [*out, Paragraph("Not in the budget:"), Notes(left_out)] if left_out else out


def _in_short(d: DatasetSummary) -> str:
    """The typical uncertainty of a value, and the cause that makes most of it."""
    if not d.uncertainty_stated:
        assumed = d.data.u_rel_assumed
        return "none is stated" if assumed is None else f"{percent(assumed)} of each value is assumed"
    parts = of(d.run, d.wavelength_nm)
    if parts is not None and parts.parts:
        most = max(parts.parts, key=lambda p: p.share)
        return f"median {percent(parts.median)}; {percent(most.share)} of the variance: {cause(most.cause)}"
    most_of = max(d.budget[1:], key=lambda p: p.median, default=None)
    return f"median {percent(d.median_u_rel)}" + (f"; mostly {cause(most_of.cause)}" if most_of else "")


def _words(d: DatasetSummary, by: ByKind) -> list[Block]:
    """What is known of the values' uncertainties."""
    if d.data.u_rel_assumed is not None:
        return [
            Paragraph(
                f"The table states no uncertainties. A standard uncertainty of {percent(d.data.u_rel_assumed)} of each"
                " value, independent from value to value, is assumed: error bars, standard errors and χ² rest on it."
            )
        ]
    if "budget" not in by:
        return [
            Paragraph(
                "The table states no uncertainties: there are no error bars and no chi-square, and "
                "fits compare logarithms, every value alike."
            )
        ]
    drawn, parts = Figures((*by["budget"], *by.get("budget-angle", ()))), of(d.run, d.wavelength_nm)
    if parts is not None:
        return [drawn, *section(parts, by.get(KIND, ()))]
    rows: list[list[Text]] = [[caused(p.cause), percent(p.median), percent(p.p95)] for p in d.budget]
    caption, most = "Standard uncertainties relative to the value.", (MOST_ROWS, f"{d.slug}-budget.csv")
    return [drawn, table(caption, ["cause", MEDIAN, "95th percentile"], rows, right=(1, 2), most=most)]


def _percent(value: float) -> str:
    """A part of a budget: what is far too small to matter is not spelled out."""
    return f"< {percent(LEAST)}" if 0.0 < value < LEAST else percent(value)


def _on_panels(figure: Any, *, curves: list[BudgetCurve], names: list[str], rows: int, columns: int) -> None:
    from matplotlib.patches import Patch

    high = figure.get_figheight()
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    foot = (FOOT_IN + LEGEND_ROW_IN * -(-len(names) // 3)) / high
    figure.subplots_adjust(0.085, foot, 0.975, 1 - 0.22 / high, hspace=0.36, wspace=0.09)
    looks = [_filled(k, len(names)) for k in range(len(names))]
    for k, ax in enumerate(axes.flat):
        clean(ax)
        if k >= len(curves):
            ax.set_axis_off()
            continue
        curve, shares = curves[k], 100 * np.array(curves[k].shares)
        shares = np.vstack([shares, 100 - shares.sum(axis=0)])
        for area, look in zip(ax.stackplot(curve.theta_r_deg, shares), looks, strict=True):
            area.set(**look)
        ax.set_title(f"θi = {curve.theta_i_deg:g}°", fontsize=7.5, pad=4)  # centred, as the label 100 % is at the left
        ax.set_xlim(-90, 90)
        degrees_along(ax, 60, 60)
        ax.set_ylim(0, 100)
        ax.set_yticks([0, 50, 100], ["0", "50 %", "100 %"])
        ax.tick_params(labelsize=7, labelbottom=k + columns >= len(curves))
        if k + columns >= len(curves):
            ax.set_xlabel("signed θr", fontsize=7.5)
    key(figure, [Patch(label=cause(n), **look) for n, look in zip(names, looks, strict=True)], 3)


HATCHES = ("", "////", "....", "\\\\\\\\", "xxxx", "----")
"""Of areas, which tell them apart in print without colours."""


class _Filled(TypedDict):
    """Colour and hatch of an area, as matplotlib takes them."""

    facecolor: str
    edgecolor: str
    linewidth: float
    hatch: str


def _filled(k: int, count: int) -> _Filled:
    """The look of area `k`; the last one is what remains."""
    rest = k == count - 1
    colour, hatch = FAINT if rest else COLOURS[k % len(COLOURS)], "" if rest else HATCHES[k % len(HATCHES)]
    return {"facecolor": colour, "edgecolor": "white", "linewidth": 0.5, "hatch": hatch}


SECTIONS = (
    Section(
        "uncertainty",
        lambda d, figures: [Heading(3, "Uncertainty", _in_short(d)), *_words(d, figures)],
        lambda d, facts: draw(of(facts.run, facts.wavelength_nm), facts.slug),
    ),
)
