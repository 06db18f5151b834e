"""What is known of the uncertainties of a sample's values: the part of a page."""

from __future__ import annotations

from gonio_analysis.report import blocks, budget
from gonio_analysis.report.blocks import MOST_ROWS, Block, Heading, Paragraph, Table, table
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.section import Figures, Section
from gonio_analysis.report.text import cause, meaning, percent


def _words(d: DatasetSummary, by: Figures) -> list[Block]:
    """What is known of the values' uncertainties."""
    if d.u_rel_assumed is not None:
        return [
            Paragraph(
                f"The table states no uncertainties. A standard uncertainty of {percent(d.u_rel_assumed)} of each"
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
    parts = budget.of(d.run, d.wavelength_nm)
    shown = [_budget(d)] if parts is None else budget.section(parts, by.get(budget.KIND, ()))
    return [blocks.Figures((*by["budget"], *by.get("budget-angle", ()))), *shown]


def _budget(d: DatasetSummary) -> Table:
    rows = [[cause(p.cause), percent(p.median), percent(p.p95), meaning(p.cause, common=True)] for p in d.budget]
    return table(
        "Standard uncertainties relative to the value.",
        ["cause", "median", "95th percentile", "what it is"],
        rows,
        right=(1, 2),
        most=(MOST_ROWS, f"{d.slug}-budget.csv"),
    )


SECTION = Section(
    "uncertainty",
    lambda d, figures: [Heading(3, "Uncertainty"), *_words(d, figures)],
    lambda d, facts: budget.draw(budget.of(facts.run, facts.wavelength_nm), facts.slug),
)
