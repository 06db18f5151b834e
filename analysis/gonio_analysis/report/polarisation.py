"""Ratios of polarised states: their part of a sample's page."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from gonio_analysis.curves.in_plane import Line
from gonio_analysis.plots.in_plane import clean, style
from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import Block, Figures, Heading, Paragraph, Text, table
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.report.figures import LEGEND_ROW_IN, legend
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import counted, number
from gonio_analysis.selection.polarised import RATIOS, PolarisationRatios


def section(found: PolarisationRatios, figures: Sequence[Figure]) -> list[Block]:
    """The ratios in words, drawn, and in numbers."""
    rows: list[Sequence[Text]] = []
    for name, numbers in found.summary().items():
        if isinstance(numbers, dict):
            off = (numbers["rms_residual"], numbers["chi_square_per_value"])
            low, high = (number(numbers[key]) for key in ("lowest", "highest"))
            told = f"{low} to {high}"
            rows.append((RATIOS[name].label, RATIOS[name].words, str(numbers["points"]), told, *map(number, off)))
    beside = "" if found.model is None else f" Residuals are measured less {found.model}."
    return [
        Heading(3, "Polarisation", counted(len(found.lines), "ratio")),
        Paragraph(f"Ratios of states in one direction: what all states share has no part in them.{beside}"),
        Figures(tuple(figures)),
        table("", ("ratio", "what it is", "values", "range", "rms residual", "χ² a value"), rows, right=(2, 4, 5)),
    ]


def draw(found: PolarisationRatios, name: str, slug: str) -> list[Drawing]:
    """A panel for each ratio over the angle."""
    what = ", ".join(RATIOS[key].label for key in found.lines)
    theory = "" if found.model is None else f" Lines: {found.model}."
    caption = f"Polarisation in the plane of incidence: {what}. Marks: measurement, with u.{theory}"
    high = 2.3 * -(-len(found.lines) // 2) + 0.7
    drawn = partial(_panels, lines=found.lines)
    return [Drawing(f"{slug}-states", "states", "", caption, f"{what} of {name} over the angle.", (6.4, high), drawn)]


def _panels(figure: Any, *, lines: dict[str, list[Line]]) -> None:
    names = [line.label for line in next(iter(lines.values()))]
    high, foot = figure.get_figheight(), LEGEND_ROW_IN * -(-len(names) // 4)
    axes = figure.subplots(-(-len(lines) // 2), 2, sharex=True, squeeze=False)
    figure.subplots_adjust(0.09, (0.5 + foot) / high, 0.97, 1 - 0.28 / high, wspace=0.22, hspace=0.25)
    for ax, (key, some) in zip(axes.ravel(), lines.items(), strict=False):
        for k, line in enumerate(some):
            look = style(k)
            if line.theory.size:
                ax.plot(np.degrees(line.theory_angle), line.theory, color=look["color"], lw=1.2, zorder=3)
            bars = {"yerr": line.u if line.u.any() else None, "ls": "none", "ms": 2.6, "elinewidth": 0.7, "zorder": 4}
            ax.errorbar(np.degrees(line.angle), line.measured, label=line.label, **bars, **look)
        ax.set_title(RATIOS[key].label, fontsize=8, loc="left")
        ax.set_xlim(-90, 90)
        ax.set_xticks([-90, -60, -30, 0, 30, 60, 90])
        ax.grid(color=FAINT, lw=0.4)
        clean(ax)
    for ax in axes.ravel()[len(lines) :]:
        ax.axis("off")
    figure.supxlabel("θr, positive on the mirror side", fontsize=8, y=(0.12 + foot) / high)
    legend(figure, names, min(len(names), 4))


SECTIONS = (
    Section(
        "states",
        lambda d, figures: [] if d.ratios is None else section(d.ratios, figures.get("states", ())),
        lambda d, facts: [] if d.ratios is None else draw(d.ratios, d.name, facts.slug),
        lambda d: None if d.ratios is None else d.ratios.summary(),
    ),
)
