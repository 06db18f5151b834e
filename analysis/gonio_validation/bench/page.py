"""What the pages of all benches have: parts with a note and a table, verdicts, and the machine.

A bench's results are a JSON object with `title`, `created`, `command` and `machine`, and lists of rows; a row is a
JSON object, or of a class of its own. A `TableSection` says which list a table shows, and each `Column` which value
of a row, and how.
"""

import datetime
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

from gonio_analysis.plots.style import FAINT
from gonio_analysis.report.blocks import (
    Block,
    Heading,
    Paragraph,
    Table,
    Text,
    facts,
    strong,
    table,
)
from gonio_analysis.report.section import parts
from gonio_analysis.report.text import number

from gonio.typing import JsonObject


class Column(NamedTuple):
    """A column of a table."""

    header: str
    key: str
    """Of the rows' value; "" for the whole row."""
    shown: Callable[[Any], Text] = str


class TableSection(NamedTuple):
    """A part of a page with one table."""

    title: str
    rows: str
    """Under which name the results have them."""
    words: str
    """What is to know before reading."""
    columns: Sequence[Column]
    right: tuple[int, ...]
    """Columns of numbers."""


def begun(title: str, command: str, quick: bool) -> JsonObject:
    """What the results of every bench begin with."""
    created = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {"title": title, "created": created, "command": command, "quick": quick}


def made(s: JsonObject, what: str) -> str:
    """The line below a title: day and version, and `what` was done."""
    return f"{s['created'][:10]}, gonio {s['machine']['versions']['gonio']}{what}"


def listed(rows: Iterable[Any], columns: Sequence[Column], right: tuple[int, ...], caption: str = "") -> Table:
    """A table of rows."""
    cells = [[c.shown(row[c.key] if c.key else row) for c in columns] for row in rows]
    return table(caption, [c.header for c in columns], cells, right=right)


def of_part(s: JsonObject, p: TableSection, result: Text, *figures: Block) -> list[Block]:
    """A part, to be folded: its note, figures, and the table of its rows."""
    return part(p.title, result, p.words, *figures, listed(s[p.rows], p.columns, p.right))


def of_parts(s: JsonObject, *tables: tuple[TableSection, Text]) -> list[Block]:
    """Parts (`of_part`) with their results, each with the line in its place where it cannot be made."""
    return parts({f'section "{p.title}"': partial(of_part, s, p, result) for p, result in tables})


def part(title: str, result: Text, words: str, *blocks: Block) -> list[Block]:
    """A heading that folds what is to know before reading, and what was found; `result` is that in a few words."""
    return [Heading(3, title, result), Paragraph(words, "note"), *blocks]


def held(rows: Iterable[Any], of: Callable[[Any], bool]) -> str:
    """How many of some rows hold."""
    every = [of(row) for row in rows]
    return f"{sum(every)} of {len(every)} hold"


def verdict(holds: bool) -> Text:
    """Yes, or a loud no."""
    return "yes" if holds else strong("no")


def milliseconds(seconds: float) -> str:
    """A time [s] in ms."""
    return number(1e3 * seconds)


def two_digits(value: float) -> str:
    """A number with two significant digits."""
    return number(value, 2)


def method(s: JsonObject, *rows: tuple[str, str]) -> list[Block]:
    """How it was done, and on what, to be folded."""
    m = s["machine"]
    system = f"{m['system']}, Python {m['python']}, " + ", ".join(f"{k} {v}" for k, v in m["versions"].items())
    shown = facts([*rows, ("system", system), ("command", s["command"] or "–")])
    return [Heading(3, "Method and machine", f"{m['system']}, Python {m['python']}"), shown]


def plain_axes(ax: Any, grid: Literal["x", "both"] = "both") -> None:
    """Small ticks, a faint grid, and no frame above and at the right."""
    ax.grid(True, color=FAINT, lw=0.4, axis=grid)
    ax.tick_params(labelsize=7.5, length=2.5)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
