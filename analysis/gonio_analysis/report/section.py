"""What a part of a sample's page is: its facts, its drawings and its words, in one file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gonio_analysis.report.blocks import Block
from gonio_analysis.report.drawing import Drawing, Figure

if TYPE_CHECKING:
    from gonio_analysis.report.facts import DatasetSummary
    from gonio_analysis.selection.compare import Dataset

Figures = Mapping[str, tuple[Figure, ...]]
"""A sample's figures by their kind (`Drawing.kind`)."""


def nothing(d: Dataset, facts: DatasetSummary) -> Sequence[Drawing]:
    """No drawings."""
    return ()


@dataclass(frozen=True)
class Section:
    """A part of a sample's page; `gonio_analysis.report.sections` lists them in order."""

    name: str
    blocks: Callable[[DatasetSummary, Figures], Sequence[Block]]
    """Its headings, words, tables and figures; nothing where there is nothing to say."""
    draw: Callable[[Dataset, DatasetSummary], Sequence[Drawing]] = nothing
    """Its drawings, which `blocks` finds by their kind."""
    facts: Callable[[Dataset], Any] = lambda d: None
    """Numbers of its own, which stand under `sections` in `summary.json`, by its name; None for none."""
