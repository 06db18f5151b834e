"""What a page is made of: headings, paragraphs, tables, facts, figures, notes and the interactive plot.

`gonio_analysis.report.html` and `gonio_analysis.report.pdf` write the same blocks; neither reads what the other wrote.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from gonio_analysis.report.drawings import Figure
from gonio_analysis.report.text import cut, glued
from gonio_analysis.report.viewer import View

MOST_ROWS = 300
"""Of a table on a page; the files in `tables/` have all of them."""
MOST_FACTS, MOST_WORDS = 200, 2000
"""Entries of a list, and characters of one."""


@dataclass(frozen=True)
class Span:
    """Some words of a text that look different from the others, or lead elsewhere."""

    text: str
    look: Literal["", "strong", "code", "break"] = ""
    """"break" begins a new line; it reads as its text where there are no lines."""
    href: str = ""


Text = str | Span | tuple[str | Span, ...]
"""Words, plain or with spans."""


def strong(text: str) -> Span:
    """Bold words."""
    return Span(text, "strong")


def code(text: str) -> Span:
    """A name as it is typed."""
    return Span(text, "code")


def spans(text: Text) -> tuple[Span, ...]:
    """A text as spans alone."""
    parts = text if isinstance(text, tuple) else (text,)
    return tuple(part if isinstance(part, Span) else Span(part) for part in parts)


def plain(text: Text) -> str:
    """The words of a text."""
    return text if isinstance(text, str) else "".join(part.text for part in spans(text))


def _glued(text: Text) -> Text:
    if isinstance(text, str):
        return glued(text)
    return tuple(Span(glued(part.text), part.look, part.href) for part in spans(text))


@dataclass(frozen=True)
class Heading:
    """Of the page (1), a section (2) or a part of one (3)."""

    kind: ClassVar[str] = "heading"
    level: Literal[1, 2, 3]
    text: str


@dataclass(frozen=True)
class Paragraph:
    """A paragraph: the line below the title ("sub"), the conclusion ("lead"), a remark ("note") or any other."""

    kind: ClassVar[str] = "paragraph"
    text: Text
    look: Literal["", "sub", "lead", "note"] = ""


@dataclass(frozen=True)
class Table:
    """A table; the first cell of each row is its heading. See `table`."""

    kind: ClassVar[str] = "table"
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[Text, ...], ...]
    right: frozenset[int]
    """Columns that end at the right."""
    marks: tuple[str, ...]
    """What a row is: "best", or nothing."""


@dataclass(frozen=True)
class Facts:
    """Names and values."""

    kind: ClassVar[str] = "facts"
    rows: tuple[tuple[str, Text], ...]


@dataclass(frozen=True)
class Figures:
    """Figures side by side; one without its drawing (`svg`) is named only where a page has no room for it."""

    kind: ClassVar[str] = "figures"
    figures: tuple[Figure, ...]
    small: bool = False
    """Whether more than two fit into a row: pictures rather than drawings."""


@dataclass(frozen=True)
class Notes:
    """A list of remarks."""

    kind: ClassVar[str] = "notes"
    items: tuple[Text, ...]


@dataclass(frozen=True)
class Viewer:
    """The interactive plot, hidden until the page's program fills it; not printed."""

    kind: ClassVar[str] = "viewer"
    slug: str
    view: View = field(repr=False)


@dataclass(frozen=True)
class Contents:
    """Links to the sections: (address, name); not printed."""

    kind: ClassVar[str] = "contents"
    links: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Footer:
    """The last line of a page."""

    kind: ClassVar[str] = "footer"
    text: Text


@dataclass(frozen=True)
class Group:
    """The head of a page, or a section that links lead to by its `slug`."""

    kind: ClassVar[str] = "group"
    tag: Literal["header", "section"]
    blocks: tuple[Block, ...]
    slug: str = ""


Block = Heading | Paragraph | Table | Facts | Figures | Notes | Viewer | Contents | Footer | Group


@dataclass(frozen=True)
class Page:
    """A page, whatever it is written as."""

    title: str
    blocks: tuple[Block, ...]


def section(blocks: Iterable[Block], slug: str = "") -> Group:
    """A section."""
    return Group("section", tuple(blocks), slug)


def table(
    caption: str,
    header: Sequence[str],
    rows: Iterable[Sequence[Text]],
    *,
    right: tuple[int, ...] = (),
    marks: Sequence[str] = (),
    most: tuple[int, str] | None = None,
    of: tuple[int, str] | None = None,
) -> Table:
    """A table without the columns that say nothing.

    Parameters
    ----------
    most
        Rows that the page shows, and the file in `tables/` that has all of them.
    of
        How many rows there would be in all, where `rows` are the first of them, and the file that has them.
    """
    every = [[_glued(cell) for cell in row] for row in rows]
    if most is not None:
        every, of = every[: most[0]], (len(every), most[1])
    if of is not None and of[0] > len(every):
        caption = f"{caption} The first {len(every)} of {of[0]} rows; all are in tables/{of[1]}.".strip()
    kept = [k for k in range(len(header)) if k == 0 or any(k < len(row) and row[k] not in ("", "–") for row in every)]
    return Table(
        caption,
        tuple(header[k] for k in kept),
        tuple(tuple(row[k] for k in kept if k < len(row)) for row in every),
        frozenset(new for new, k in enumerate(kept) if k in right),
        tuple(marks),
    )


def facts(rows: Iterable[tuple[str, str]]) -> Facts:
    """A list of names and values; what is too long for a page is cut, and stands in summary.json."""
    every = list(rows)
    kept = every[:MOST_FACTS]
    if len(every) > len(kept):
        kept.append(("more", f"{len(every) - len(kept)} further entries stand in summary.json"))
    return Facts(tuple((cut(k, MOST_WORDS), glued(cut(v, MOST_WORDS))) for k, v in kept))


def notes(texts: Sequence[str]) -> Notes:
    """A list of remarks; what is too long for a page is cut, and stands in summary.json."""
    shown = [cut(text, MOST_WORDS) for text in texts[:MOST_FACTS]]
    if len(texts) > MOST_FACTS:
        shown.append(f"{len(texts) - MOST_FACTS} further notes stand in summary.json.")
    return Notes(tuple(shown))


def lead(text: str) -> Paragraph:
    """The conclusion, in large type."""
    return Paragraph(glued(text), "lead")


def figures_of(blocks: Iterable[Block]) -> list[Figure]:
    """Every figure, in order."""
    found: list[Figure] = []
    for block in blocks:
        if isinstance(block, Figures):
            found += block.figures
        elif isinstance(block, Group):
            found += figures_of(block.blocks)
    return found
