"""What the page of a paper's figure consists of: parameters, claims, drawings, results."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Origin = Literal["paper", "database", "derived", "assumed"]
ORIGINS: dict[Origin, str] = {
    "paper": "the paper",
    "database": "measured constants",
    "derived": "follows from the paper",
    "assumed": "assumed",
}
COLUMNS = ("panel", "curve", "kind", "x", "y", "u_y")
"""Header of `curves.csv`."""
CurveRow = tuple[str, str, float, float, float | None]
"""Curve, kind, x, y, and u_y where there is one."""
Row = Mapping[str, str | float | list[float] | None]
"""A row of results at full precision; each figure names its own columns."""


@dataclass(frozen=True)
class Parameter:
    """A value that the figure is made with, and where it comes from."""

    name: str
    value: str
    origin: Origin
    why: str = ""
    """The source, or the reason of an assumed value."""


@dataclass(frozen=True)
class Claim:
    """What the paper says about a figure, against the curves."""

    text: str
    """The paper's statement."""
    holds: bool | None
    """None: no verdict, because it hangs on a value that is not in the paper."""
    found: str
    """The numbers from the curves."""
    criterion: str
    """What was asked of them."""

    @property
    def verdict(self) -> str:
        """In words."""
        return "no verdict" if self.holds is None else "holds" if self.holds else "does not hold"

    @property
    def summary(self) -> dict[str, str]:
        """What `summary.json` says of it."""
        return {"claim": self.text, "verdict": self.verdict, "found": self.found, "criterion": self.criterion}


def agreed(answers: Iterable[bool]) -> bool | None:
    """The verdict where every choice of the assumed values gives the same one; None where it hangs on the choice."""
    found = {bool(answer) for answer in answers}
    return found.pop() if len(found) == 1 else None


@dataclass(frozen=True)
class Panel:
    """One drawing of a page, and the numbers in it."""

    name: str
    caption: str
    """What stands before its colon is set bold."""
    inches: tuple[float, float]
    draw: Callable[[Any], None]
    """Draws on a matplotlib figure."""
    axes: tuple[str, str]
    """What x and y are, with their units."""
    rows: Sequence[CurveRow]
    """Every plotted curve: `COLUMNS` without the panel."""


@dataclass(frozen=True)
class Results:
    """Results at full precision, for `summary.json`, and a table of them on the page."""

    caption: str
    columns: Mapping[str, Callable[[Any], str]]
    """By their headers: what a cell says, from its row."""
    rows: Sequence[Row]


@dataclass(frozen=True)
class PaperFigure:
    """One figure of a paper, made again."""

    name: str
    title: str
    paper: str
    parameters: Sequence[Parameter]
    claims: Sequence[Claim]
    panels: Sequence[Panel]
    results: Results
    notes: Sequence[str] = ()
    facts: Sequence[tuple[str, str]] = ()
    """Provenance beyond command, date and versions."""
    files: Mapping[str, bytes] = field(default_factory=dict)
    """Further files of the page, by their path in its folder."""
