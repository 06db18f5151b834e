"""What a part of a sample's page is: its facts, its drawings and its words, in one file.

Whoever wrote it, what it gives is tried before it comes into the page: a part that fails is named in its place
(`gonio.lost`).
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from gonio.lost import Loss, kept
from gonio_analysis.report import html
from gonio_analysis.report.blocks import Block, missing
from gonio_analysis.report.drawing import Drawing, Figure
from gonio_analysis.result_records import as_json

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
    """Of the same sample twice: its drawings, which `blocks` finds by their kind."""
    facts: Callable[[Dataset], Any] = lambda d: None
    """Numbers of its own, which stand under `sections` in `summary.json`, by its name; None for none."""


def part(what: str, name: str, make: Callable[[], Sequence[Block]]) -> list[Block]:
    """Blocks of a sample's page that can be printed, or the line that stands in their place.

    Parameters
    ----------
    what, name
        Which part, as in 'section "spread"', and of which sample.
    make
        Makes them.
    """

    return parts({f"{what} of {name}": make})


def _checked(made: Sequence[Block]) -> list[Block]:
    """Blocks; an error where they are none, or cannot be written."""
    blocks = list(made)
    for one in blocks:
        if not isinstance(one, Block):
            raise TypeError(f"{one!r} is no block of gonio_analysis.report.blocks")
    html.fragment(blocks).encode()
    return blocks


Part = Callable[[], Block | Sequence[Block]]


def parts(of: Mapping[str, Part]) -> list[Block]:
    """Parts of a page by what they are, each with the line in its place where it cannot be made."""

    def tried(make: Part) -> list[Block]:
        made = make()
        return _checked([made] if isinstance(made, Block) else made)

    out: list[Block] = []
    for what, make in of.items():
        out += kept(what, partial(tried, make), _instead)
    return out


def _instead(loss: Loss) -> list[Block]:
    return [missing(loss)]


def blocks_of(one: Section, d: DatasetSummary, figures: Figures) -> list[Block]:
    """What a section says of a sample."""
    return part(f'section "{one.name}"', d.name, lambda: one.blocks(d, figures))


def facts_of(sections: Sequence[Section], d: Dataset) -> dict[str, Any]:
    """The numbers of sections that have any, by their names: such that JSON can hold."""

    def tried(one: Section) -> Any:
        found = one.facts(d)
        json.dumps(as_json(found), ensure_ascii=False, allow_nan=False).encode()
        return found

    every = {
        one.name: kept(f'numbers of section "{one.name}" of {d.name}', partial(tried, one), lambda _: None)
        for one in sections
    }
    return {name: facts for name, facts in every.items() if facts is not None}


def drawings_of(one: Section, d: DatasetSummary, taken: Mapping[str, object]) -> list[Drawing]:
    """Its drawings, whose names are those of files and of no other figure (`taken`)."""

    def tried() -> list[Drawing]:
        found = list(one.draw(d, d))
        for drawing in found:
            if not isinstance(drawing, Drawing):
                raise TypeError(f"{drawing!r} is no Drawing")
            if not re.fullmatch(r"[\w][\w.,+@ -]*", drawing.name):
                raise ValueError(f"{drawing.name!r} is no name of a figure: it is that of its file")
            if drawing.name in taken or [other.name for other in found].count(drawing.name) > 1:
                raise ValueError(f"{drawing.name!r} is the name of another figure; begin it with facts.slug")
        return found

    return kept(f'drawings of section "{one.name}" of {d.name}', tried, lambda _: [])
