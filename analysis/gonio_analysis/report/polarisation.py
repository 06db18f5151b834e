"""Measured Mueller matrices: their part of a page."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from gonio_analysis.curves.line import Line
from gonio_analysis.plots import in_plane, polarisation
from gonio_analysis.report.blocks import Block, Figures, Heading, Paragraph, Text, code, table
from gonio_analysis.report.drawings import Drawing, Figure
from gonio_analysis.report.section import Section
from gonio_analysis.report.text import number
from gonio_analysis.selection.polarisation import Polarisation


def draw(p: Polarisation, name: str, slug: str) -> list[Drawing]:
    """The elements over the angle, where there are in-plane curves."""
    if not any(p.lines.values()):
        return []
    theory = f" Lines: {p.model}, fitted to the BRDF alone." if p.model else ""
    caption = f"Mueller matrix: its elements over the first one, in the plane of incidence. Marks: measurement.{theory}"
    alt = f"Grid of the 15 elements of the Mueller matrix of {name} over the angle."
    return [Drawing(f"{slug}-mueller", "mueller", "", caption, alt, (6.4, 6.0), partial(_on_grid, lines=p.lines))]


def section(m: Polarisation, figures: Sequence[Figure]) -> list[Block]:
    """The elements in numbers, and the figures."""
    words = (
        f"{m.points} values have a Mueller matrix. Its elements are divided by the first one, on s and p of docs/"
        "conventions.md: rows are the reflected light's I, Q, U, V, columns the incident light's."
    )
    if m.model is not None:
        words += (
            f" Residuals are measured less the matrix of {m.model}, which was fitted to the BRDF alone, in single"
            " directions."
        )
    rows: list[Sequence[Text]] = [
        (code(e.name), str(e.points), *map(number, (e.rms, e.mean_residual, e.rms_residual, e.chi_square_per_value)))
        for e in m.elements
        if e.points
    ]
    header = ["element", "values", "rms", "mean residual", "rms residual", "χ² a value"]
    return [
        Heading(3, "Polarisation: Mueller matrix"),
        Paragraph(words),
        Figures(tuple(figures)),
        table("", header, rows, right=(1, 2, 3, 4, 5)),
    ]


def _on_grid(figure: Any, *, lines: dict[str, list[Line]]) -> None:
    from matplotlib.lines import Line2D

    axes = figure.subplots(4, 4, sharex=True, sharey=True)
    figure.subplots_adjust(0.075, 0.085, 0.985, 0.99, wspace=0.1, hspace=0.1)
    polarisation.grid(axes, lines)
    names = [line.label for line in next(iter(lines.values()))]
    axes[0][0].legend(
        handles=[Line2D([], [], lw=1.2, ms=3, label=x, **in_plane.style(k)) for k, x in enumerate(names)],
        loc="center", fontsize=7, frameon=False, handlelength=1.4, labelspacing=0.3,
    )  # fmt: skip
    figure.supxlabel("θr, positive on the mirror side", fontsize=8, y=0.012)


SECTION = Section(
    "polarisation",
    lambda d, figures: [] if d.mueller is None else section(d.mueller, figures.get("mueller", ())),
    lambda d, facts: [] if d.polarisation is None else draw(d.polarisation, d.name, facts.slug),
)
