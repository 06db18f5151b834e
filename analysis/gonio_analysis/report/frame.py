"""How a page is laid out, whatever it is of: verdict, picture, table, then what is folded.

Docs: docs/page.md.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from gonio_analysis.report import blocks as made_of
from gonio_analysis.report.blocks import Block, Group, Heading, Page, header
from gonio_analysis.report.text import slug


def answer(
    verdict: Sequence[Block], picture: Sequence[Block] = (), table: Sequence[Block] = (), below: Sequence[Block] = ()
) -> Group:
    """The first screen: a verdict, and below it a picture with a table beside it; on a phone one below the other.

    What stands `below` belongs to the plot, too.
    """
    return Group("section", (*verdict, *beside(picture, table), *below), look="answer")


def beside(left: Iterable[Block], right: Iterable[Block]) -> list[Block]:
    """Blocks side by side where there is room: a picture and what is said of it."""
    sides = [Group("div", tuple(side)) for side in (_shown(left), _shown(right)) if side]
    return [Group("div", tuple(sides), look="beside")] if len(sides) > 1 else list(sides)


def folded(blocks: Iterable[Block], within: str = "page") -> list[Block]:
    """Blocks, of which each heading of a part (level 3) folds what follows it, down to the next.

    Parameters
    ----------
    within
        The identifier of what they stand in: those of the parts are "SAMPLE.checks", and no name has a dot.
    """
    out: list[Block] = []
    heading: Heading | None = None
    inside: list[Block] = []
    taken = set[str]()

    def close() -> None:
        if heading is None:
            out.extend(_shown(inside))
        elif shown := _shown(inside):
            name = f"{within}.{slug(heading.text) or 'part'}"
            while name in taken:
                name += "-more"
            taken.add(name)
            out.append(Group("details", tuple(shown), name, heading=heading))

    for block in blocks:
        if isinstance(block, Heading):
            close()
            inside = []
            heading = block if block.level == 3 else None
            out += [] if block.level == 3 else [block]
        else:
            inside.append(block)
    close()
    return out


def page(
    title: str,
    sub: str,
    first: Group,
    *,
    shown: Sequence[Block] = (),
    folds: Iterable[Block] = (),
    foot: Block,
    called: str = "",
) -> Page:
    """A page.

    Parameters
    ----------
    title, sub
        Its heading; what it is and when it was made.
    first
        See `answer`.
    shown, folds
        What follows: open, and folded by its headings (`folded`).
    foot
        Its last line.
    called
        The title of the browser's tab, where it is not that of the page.
    """
    return Page(called or title, (header(title, sub), first, *shown, *folded(folds), foot))


def provenance(made: Mapping[str, Any], *first: tuple[str, str], called: str = "report made") -> list[Block]:
    """How a page was made, to be folded; arguments as of `blocks.provenance`."""
    result = f"{made['created'][:10]}, gonio {made['versions']['gonio']}"
    return [Heading(3, "Provenance", result), made_of.provenance(made, *first, called=called)]


def _shown(blocks: Iterable[Block]) -> list[Block]:
    return [block for block in blocks if not block.empty]
