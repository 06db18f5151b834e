"""Blocks as a page that needs no other file: its look, its figures and its program are in it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from html import escape
from importlib.metadata import version
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from gonio import look
from gonio.shown import visible
from gonio_analysis.report.blocks import Block, Figures, Group, Page, PixelViewer, Viewer, figures_of, plain, spans
from gonio_analysis.report.text import glued

if TYPE_CHECKING:
    from jinja2 import Template

LOOK = ("style.css", "document.html.jinja", "blocks.html.jinja", "viewer.js", "page.js")
"""The files that say how a page looks."""
SHARED = ("style.css", "page.js")
"""Those of them that live pages have, too."""


def document(page: Page) -> str:
    """A page as HTML text."""
    shown = program() if _has(page.blocks, Viewer | PixelViewer) else ""
    shown += _file("pixels.js") if _has(page.blocks, PixelViewer) else ""
    shown += _file("page.js")
    told = {"style": _file("style.css"), "program": shown, "made_by": made_by()}
    return _template("document").render(title=page.title, blocks=page.blocks, **told)


def made_by() -> str:
    """Which program made a page, and which version of the page's look: "gonio 0.2.0, page 3f2a91c7"."""
    every = "".join(_file(name) for name in LOOK)
    return f"gonio {version('gonio')}, page {hashlib.sha256(every.encode()).hexdigest()[:8]}"


def program() -> str:
    """What fills the places of interactive plots."""
    return _file("viewer.js")


def fragment(blocks: Sequence[Block]) -> str:
    """Blocks as HTML text, as they stand in a page."""
    return _template("blocks").render(blocks=blocks)


def size(text: str) -> int:
    """Bytes of a text in a file."""
    return len(text.encode("utf-8"))


def within(block: Block, room: int) -> Block:
    """A block of at most `room` bytes: the largest drawings are named instead of shown until it is."""
    over, named = size(fragment([block])) - room, set[str]()
    for f in sorted(figures_of([block]), key=lambda f: -len(f.svg)):
        if over <= 0:
            break
        named.add(f.name)
        over -= size(fragment([Figures((f,))])) - size(fragment([Figures((replace(f, svg=""),))]))
    return _without_drawings(block, named) if named else block


def _without_drawings(block: Block, named: set[str]) -> Block:
    if isinstance(block, Figures):
        return replace(block, figures=tuple(replace(f, svg="") if f.name in named else f for f in block.figures))
    if isinstance(block, Group):
        return replace(block, blocks=tuple(_without_drawings(b, named) for b in block.blocks))
    return block


def _has(blocks: Sequence[Block], kind: Any) -> bool:
    return any(isinstance(b, kind) or (isinstance(b, Group) and _has(b.blocks, kind)) for b in blocks)


@cache
def _file(name: str) -> str:
    return look.part(name) if name in SHARED else files("gonio_analysis.report").joinpath(name).read_text("utf-8")


@cache
def _template(name: str) -> Template:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(lambda asked: _file(f"{asked}.html.jinja")),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_escaped,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {
        "spans": spans,
        "plain": plain,
        "glued": glued,
        "embedded": _embedded,
        "labelled": labelled,
    }
    return environment.get_template(name)


def _escaped(value: object) -> str:
    """Words as HTML has them, with the entities of Python's own `html.escape`."""
    from markupsafe import Markup

    return value if isinstance(value, Markup) else Markup(escape(visible(str(value))))


def labelled(svg: str, alt: str) -> str:
    """A drawing with the words that stand for it."""
    from markupsafe import Markup

    return Markup(svg.replace("<svg", f'<svg role="img" aria-label="{escape(visible(alt))}"', 1))


def _embedded(view: Mapping[str, Any]) -> str:
    """Data inside of a script element."""
    return json.dumps(view, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
