"""What `summary.json` of a paper's figure holds, key by key."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gonio_analysis.report.blocks import stamp

from gonio_validation.papers.figure import Cell, PaperFigure


@dataclass(frozen=True)
class ParameterSummary:
    """A value that the figure is made with, and where it comes from."""

    name: str
    value: str
    origin: str
    source: str


@dataclass(frozen=True)
class ClaimSummary:
    """What the paper says, and the verdict."""

    claim: str
    verdict: str
    found: str
    criterion: str


@dataclass(frozen=True)
class PanelSummary:
    """A drawing."""

    name: str
    caption: str
    x: str
    y: str


@dataclass(frozen=True)
class FigureSummary:
    """A paper's figure, made again."""

    figure: str
    title: str
    paper: str
    created: str
    command: str
    versions: dict[str, str]
    parameters: list[ParameterSummary]
    claims: list[ClaimSummary]
    panels: list[PanelSummary]
    curves: list[Mapping[str, Cell]]
    notes: list[str]


@dataclass(frozen=True)
class IndexedFigure:
    """A figure as the index has it."""

    figure: str
    title: str
    claims: list[ClaimSummary]


@dataclass(frozen=True)
class IndexSummary:
    """All figures."""

    figures: Sequence[IndexedFigure]


def summarise(page: PaperFigure, command: str) -> FigureSummary:
    """What is said of a figure that was made by this command."""
    return FigureSummary(
        figure=page.name,
        title=page.title,
        paper=page.paper,
        **stamp(command),
        parameters=[ParameterSummary(p.name, p.value, p.origin, p.why) for p in page.parameters],
        claims=[ClaimSummary(c.text, c.verdict, c.found, c.criterion) for c in page.claims],
        panels=[PanelSummary(p.name, p.caption, *p.axes) for p in page.panels],
        curves=[row.cells for row in page.numbers],
        notes=list(page.notes),
    )


def index_of(figures: Sequence[FigureSummary]) -> IndexSummary:
    """The index of figures."""
    return IndexSummary([IndexedFigure(f.figure, f.title, f.claims) for f in figures])
