"""What a page is made of: headings, paragraphs, tables, facts, figures, notes and the interactive plot.

`gonio_analysis.report.frame` puts them in the order of a page; `gonio_analysis.report.html` writes them.
"""

from __future__ import annotations

import datetime
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from gonio.lost import Loss, so_far
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.terms import MEANINGS
from gonio_analysis.report.text import cause, cut, glued, meaning

if TYPE_CHECKING:
    from gonio_analysis.report.viewer import ViewerData

VERSIONS = ("gonio", "numpy", "scipy", "numba", "pandas", "matplotlib")
MOST_ROWS = 300
"""Most rows of a table on a page; the files in `tables/` have all of them."""
MOST_FACTS, MOST_WORDS = 200, 2000
"""Entries of a list, and characters of one."""


class Stamp(TypedDict):
    """When, by which command and with which versions a page was made."""

    created: str
    command: str
    versions: dict[str, str]


def stamp(command: str) -> Stamp:
    """When, by which command and with which versions a page is made: now, and here."""
    return {
        "created": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds").replace("+00:00", "Z"),
        "command": command,
        "versions": {"python": platform.python_version(), **{name: version(name) for name in VERSIONS}},
    }


@dataclass(frozen=True)
class Span:
    """Some words of a text that look different from the others, lead elsewhere, or are explained at a touch."""

    text: str
    look: Literal["", "strong", "code", "name", "break"] = ""
    """"name" stays on one line; "break" begins a new line, and reads as its text where there are no lines."""
    href: str = ""
    meaning: str = ""
    """What the words mean, in one line."""


Text = str | Span | tuple[str | Span, ...]
"""Words, plain or with spans."""


def strong(text: str) -> Span:
    """Bold words."""
    return Span(text, "strong")


def code(text: str) -> Span:
    """A name as it is typed."""
    return Span(text, "code")


def term(text: str, meaning: str) -> Span:
    """A term, with its meaning at a touch."""
    return Span(text, meaning=meaning)


def caused(name: str, *, common: bool = True) -> Span:
    """A cause of an uncertainty, with what it is at a touch."""
    return term(cause(name), meaning(name, common=common))


def explained(name: Text) -> Text:
    """The name of a column or a fact, with its meaning at a touch where `MEANINGS` has it."""
    return term(name, MEANINGS[name]) if isinstance(name, str) and name in MEANINGS else name


def spans(text: Text) -> tuple[Span, ...]:
    """A text as spans alone."""
    return tuple(
        part if isinstance(part, Span) else Span(part) for part in (text if isinstance(text, tuple) else (text,))
    )


def plain(text: Text) -> str:
    """The words of a text."""
    return text if isinstance(text, str) else "".join(part.text for part in spans(text))


def _glued(text: Text) -> Text:
    if isinstance(text, str):
        return glued(text)
    return tuple(replace(part, text=glued(part.text)) for part in spans(text))


class Block:
    """A part of a page."""

    @property
    def kind(self) -> str:
        """What `blocks.html.jinja` knows it by: "heading", "paragraph", ..."""
        return type(self).__name__.lower()

    @property
    def empty(self) -> bool:
        """Whether nothing of it is printed: figures or notes of which there are none."""
        return False


@dataclass(frozen=True)
class Heading(Block):
    """A heading of the page (1), a section (2) or a part of one (3).

    `gonio_analysis.report.frame.folded` folds what follows one of a part, down to the next.
    """

    level: Literal[1, 2, 3]
    text: str
    result: Text = ""
    """The part in a few words, which stand beside its heading while it is folded."""
    open: bool = False
    """Whether the part is unfolded at first."""


@dataclass(frozen=True)
class Paragraph(Block):
    """A paragraph: the line below the title ("sub"), the conclusion ("lead"), a remark ("note"), what is missing
    ("lost") or any other.
    """

    text: Text
    look: Literal["", "sub", "lead", "note", "lost"] = ""


@dataclass(frozen=True)
class Table(Block):
    """A table; the first cell of each row is its heading. See `table`."""

    caption: str
    header: tuple[Text, ...]
    rows: tuple[tuple[Text, ...], ...]
    right: frozenset[int]
    """Columns that end at the right."""
    marks: tuple[str, ...]
    """What a row is: "best", or nothing."""
    draws: tuple[str, ...] = ()
    """What the interactive plot above or beside the table calls each row: a click on the row draws it."""


@dataclass(frozen=True)
class Facts(Block):
    """Names and values."""

    rows: tuple[tuple[Text, Text], ...]


@dataclass(frozen=True)
class Figures(Block):
    """Figures side by side; one without its drawing (`svg`) is named only: a page has no room, or it has failed."""

    figures: tuple[Figure, ...]
    small: bool = False
    """Whether more than two fit into a row: pictures rather than drawings."""
    printed: bool = False
    """Whether they stand on paper alone, where the interactive plot that shows the same cannot."""

    @property
    def empty(self) -> bool:
        return not self.figures


@dataclass(frozen=True)
class Notes(Block):
    """A list of remarks."""

    items: tuple[Text, ...]

    @property
    def empty(self) -> bool:
        return not self.items


@dataclass(frozen=True)
class Viewer(Block):
    """The interactive plot, hidden until the page's program fills it; not printed."""

    slug: str
    view: ViewerData = field(repr=False)


@dataclass(frozen=True)
class PixelViewer(Block):
    """A map under the cursor, hidden until the page's program fills it; not printed."""

    slug: str
    view: dict[str, Any] = field(repr=False)


@dataclass(frozen=True)
class Contents(Block):
    """Links to the sections: (address, name); not printed."""

    links: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Footer(Block):
    """The last line of a page."""

    text: Text


@dataclass(frozen=True)
class Group(Block):
    """The head of a page, a section that links lead to by its `slug`, or what stands together."""

    tag: Literal["header", "section", "div", "details"]
    blocks: tuple[Block, ...]
    slug: str = ""
    look: Literal["", "answer", "beside"] = ""
    """"answer" is the first screen; "beside" puts its parts side by side where there is room."""
    heading: Heading | None = None
    """Of "details": what stands there while the rest is folded."""


@dataclass(frozen=True)
class Page:
    """A page, whatever it is written as."""

    title: str
    blocks: tuple[Block, ...]


def section(blocks: Iterable[Block], slug: str = "") -> Group:
    """A section."""
    return Group("section", tuple(blocks), slug)


def header(title: str, sub: str, *more: Block) -> Group:
    """The head of a page: its title, and the line below that says what it is and when it was made."""
    return Group("header", (Heading(1, title), Paragraph(sub, "sub"), *more))


def footer(text: str) -> Footer:
    """The last line of a page; names as they are typed stand between backticks."""
    return Footer(tuple(code(part) if k % 2 else part for k, part in enumerate(text.split("`"))))


def dated(what: str, made: Mapping[str, Any]) -> str:
    """Below a title: `what` the page is, when and with which version it was made (a `Stamp`), and what its u are."""
    gonio = f"gonio {made['versions']['gonio']}"
    return f"{what}, {made['created'][:10]}, {gonio}. Uncertainties are standard uncertainties (k = 1)."


def provenance(made: Mapping[str, Any], *first: tuple[str, str], called: str = "report made") -> Facts:
    """When, by which command and with which versions a page was made (as in `Stamp`); `first` stands above."""
    versions = ", ".join(f"{name} {version}" for name, version in made["versions"].items())
    return facts([*first, ("command", made["command"] or "–"), (called, made["created"]), ("versions", versions)])


def table(
    caption: str,
    header: Sequence[Text],
    rows: Iterable[Sequence[Text]],
    *,
    right: tuple[int, ...] = (),
    marks: Sequence[str] = (),
    draws: Sequence[str] = (),
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
        tuple(explained(header[k]) for k in kept),
        tuple(tuple(row[k] for k in kept if k < len(row)) for row in every),
        frozenset(new for new, k in enumerate(kept) if k in right),
        tuple(marks),
        tuple(draws),
    )


def facts(rows: Iterable[tuple[Text, Text]]) -> Facts:
    """A list of names and values; what is too long for a page is cut, and stands in summary.json."""
    every = list(rows)
    kept = every[:MOST_FACTS]
    if len(every) > len(kept):
        kept.append(("more", f"{len(every) - len(kept)} further entries stand in summary.json"))
    return Facts(tuple((explained(_cut(k)), _glued(_cut(v))) for k, v in kept))


def _cut(text: Text) -> Text:
    return cut(text, MOST_WORDS) if isinstance(text, str) else text


def notes(texts: Sequence[str]) -> Notes:
    """A list of remarks; what is too long for a page is cut, and stands in summary.json."""
    shown = [cut(text, MOST_WORDS) for text in texts[:MOST_FACTS]]
    if len(texts) > MOST_FACTS:
        shown.append(f"{len(texts) - MOST_FACTS} further notes stand in summary.json.")
    return Notes(tuple(shown))


def lead(text: str) -> Paragraph:
    """The conclusion, in large type."""
    return Paragraph(glued(text), "lead")


def missing(loss: Loss) -> Paragraph:
    """What stands in the place of a part that could not be made."""
    return Paragraph((strong("Missing: "), f"{loss.words}."), "lost")


def with_notice(page: Page) -> Page:
    """The page with what it has lost until now named at its top."""
    losses = so_far()
    if not losses:
        return page
    told = section(
        [
            Heading(2, "What is missing"),
            Paragraph("These parts of the page could not be made; the others are whole.", "lost"),
            Notes(tuple(f"{one.words}." for one in losses)),
        ],
        "missing",
    )
    first = 1 if page.blocks and isinstance(page.blocks[0], Group) and page.blocks[0].tag == "header" else 0
    return Page(page.title, (*page.blocks[:first], told, *page.blocks[first:]))


def titled(title: str) -> Page:
    """A page with its title alone, where the page itself cannot be made: `with_notice` says why."""
    return Page(title, (Group("header", (Heading(1, title),)),))


def figures_of(blocks: Iterable[Block]) -> list[Figure]:
    """Every figure, in order."""
    found: list[Figure] = []
    for block in blocks:
        found += block.figures if isinstance(block, Figures) else ()
        found += figures_of(block.blocks) if isinstance(block, Group) else ()
    return found
