"""A page of this package as a PDF on A4: the same text, tables and figures, set without a browser.

Figures are the page's PNG files, two in a row: 160 dots per inch at 142 mm are 260 at the 86 mm that they have here.
The contents and the interactive plot are left out.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence, Set
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from gonio import canvas
from gonio.shown import visible
from gonio_analysis.report.blocks import (
    Block,
    Facts,
    Figures,
    Footer,
    Group,
    Heading,
    Notes,
    Page,
    Paragraph,
    Table,
    Text,
    plain,
)
from gonio_analysis.report.text import glued

MM = 72.0 / 25.4
WIDTH, HEIGHT, MARGIN = 210.0 * MM, 297.0 * MM, 16.0 * MM
INNER = WIDTH - 2 * MARGIN
INK, SOFT, RULE = "#1b1f24", "#55606e", "#c9ced6"
LEADING = 1.38
COLUMN_GAP = 6 * MM
COLUMN = (INNER - COLUMN_GAP) / 2
"""Width of a figure."""
CELL_GAP = 2.6 * MM
TEXTS = {"h1": 18.0, "h2": 13.5, "h3": 10.5, "p": 8.6, "li": 8.2, "footer": 7.4}
"""Size [pt] of what stands on lines of its own."""


def write(path: Path, pages: Sequence[Page]) -> None:
    """Set pages as one PDF.

    Parameters
    ----------
    path
        Of the PDF.
    pages
        In their order; the first one's title is the document's.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    look = {"pdf.fonttype": 3, "font.family": ["sans-serif"], "font.sans-serif": [canvas.FONT]}
    about = {"CreationDate": None, "Producer": "gonio", "Title": pages[0].title}
    with canvas.literal(), rc_context(look), PdfPages(path, metadata=about) as sink:
        sheet = _Sheet(sink)
        for page in pages:
            _set(sheet, page.blocks)
        sheet.close()


def _lines_of(text: Text) -> str:
    """A text with single spaces, as a browser sets it."""
    return visible(re.sub(r"[ \t\r\n]+", " ", plain(text)).strip(" "))


def _set(sheet: _Sheet | _Nowhere, blocks: Sequence[Block]) -> None:
    """What is printed of blocks, in their order."""
    for block, after in zip_longest(blocks, blocks[1:]):
        match block:
            case Group():
                _set(sheet, block.blocks)
            case Heading():
                beside = [f.png for f in after.figures[:2] if f.png] if isinstance(after, Figures) else []
                sheet.text(f"h{block.level}", _lines_of(block.text), beside)
            case Paragraph():
                sheet.text("p", _lines_of(block.text))
            case Footer():
                sheet.text("footer", _lines_of(block.text))
            case Notes():
                for item in block.items:
                    sheet.text("li", _lines_of(item))
            case Facts():
                sheet.facts([(_lines_of(name), _lines_of(value)) for name, value in block.rows])
            case Table():
                cells = [[_lines_of(cell) for cell in row] for row in [block.header, *block.rows]]
                sheet.table(_lines_of(block.caption), cells, block.right)
            case Figures():
                drawn = [f for f in block.figures if not f.failed]
                for f in block.figures:
                    if f.failed:
                        sheet.text("p", _lines_of(f"Missing: this figure could not be drawn: {f.failed}. {f.caption}"))
                for k in range(0, len(drawn), 2):
                    sheet.figures([(f.png, _lines_of(glued(f.caption))) for f in drawn[k : k + 2]])


def check(blocks: Sequence[Block]) -> None:
    """Raise what setting these blocks would, for the kinds of their words."""
    _set(_Nowhere(), blocks)


def _words() -> Any:
    """An artist that sets many lines of text, (x, y, text, size, weight, colour) in points from the lower left.

    The lines are laid out already: as many `Text` artists would lay them out again, which takes four times as long.
    """
    from matplotlib.artist import Artist
    from matplotlib.font_manager import FontProperties

    class Words(Artist):
        def __init__(self) -> None:
            super().__init__()
            self.lines: list[tuple[float, float, str, float, str, str]] = []

        def draw(self, renderer: Any) -> None:
            for x, y, text, size, weight, colour in self.lines:
                pen = renderer.new_gc()
                pen.set_foreground(colour)
                families = [canvas.FONT, *canvas.fallbacks(text)]
                renderer.draw_text(pen, x, y, text, FontProperties(family=families, size=size, weight=weight), 0.0)

    return Words()


def _tall(png: bytes) -> float:
    """Height of a figure in its column."""
    from PIL import Image

    wide, high = Image.open(io.BytesIO(png)).size
    return COLUMN * high / wide


def _advance(character: str, weight: str) -> float:
    """Width of a character over the size of its font: the first that has it, and else the box of a missing glyph."""
    from matplotlib.font_manager import FontProperties, findfont, get_font

    family = (canvas.fallbacks(character) or [canvas.FONT])[0]
    font = get_font(findfont(FontProperties(family=family, weight=weight)))
    font.set_size(10, 72)
    glyph = font.load_glyph(font.get_char_index(ord(character)))  # 0 is the box
    return float(glyph.linearHoriAdvance) / 65536 / 10


class _Nowhere:
    """Takes what a sheet takes."""

    def text(self, kind: str, content: str, beside: Sequence[bytes] = ()) -> None: ...

    def facts(self, rows: Sequence[tuple[str, str]]) -> None: ...

    def table(self, caption: str, rows: Sequence[Sequence[str]], right: Set[int]) -> None: ...

    def figures(self, pair: Sequence[tuple[bytes, str]]) -> None: ...


class _Sheet:
    """Pages that fill from the top; lengths are points, `y` counts down from the upper edge."""

    def __init__(self, sink: Any) -> None:
        self._sink = sink
        self._advances: dict[str, dict[str, float]] = {"normal": {}, "bold": {}}
        self._number = 0
        self._turn()

    def _turn(self) -> None:
        from matplotlib.figure import Figure

        self._number += 1
        self._canvas = Figure(figsize=(WIDTH / 72, HEIGHT / 72))
        self._words = _words()
        self._canvas.add_artist(self._words)
        self.y = MARGIN

    def close(self) -> None:
        """Put the last page out."""
        self._put(WIDTH - MARGIN, HEIGHT - 9 * MM, str(self._number), 7.0, colour=SOFT, right=True)
        self._sink.savefig(self._canvas)

    def _need(self, height: float) -> None:
        if self.y + height > HEIGHT - MARGIN and self.y > MARGIN:
            self.close()
            self._turn()

    # --- pieces -----------------------------------------------------------------------------------------------------

    def text(self, kind: str, content: str, beside: Sequence[bytes] = ()) -> None:
        """A heading, a paragraph or an item of a list; a heading stays on the page of the figures that follow it."""
        size = TEXTS[kind]
        heading = kind in ("h1", "h2", "h3")
        indent = 4 * MM if kind == "li" else 0.0
        lines = self._wrap(content, size, INNER - indent, "bold" if heading else "normal")
        self.y += {"h1": 0.0, "h2": 5 * MM, "h3": 3.2 * MM}.get(kind, 0.0)
        room = max((_tall(png) for png in beside), default=0.0) + 24 * MM
        self._need(len(lines) * size * LEADING + (room if heading and kind != "h1" else 0.0))
        if kind == "li":
            self._put(MARGIN + 1.2 * MM, self.y, "•", size)
        for line in lines:
            self._need(size * LEADING)
            colour = SOFT if kind == "footer" else INK
            self._put(MARGIN + indent, self.y, line, size, weight="bold" if heading else "normal", colour=colour)
            self.y += size * LEADING
        self.y += 1.6 * MM if kind != "li" else 0.4 * MM

    def facts(self, rows: Sequence[tuple[str, str]]) -> None:
        """Names and values."""
        size, name = 8.2, 34 * MM
        for key, value in rows:
            left, right = self._wrap(key, size, name - 2 * MM), self._wrap(value, size, INNER - name)
            high = max(len(left), len(right)) * size * LEADING
            self._need(high)
            self._lines(MARGIN, left, size, colour=SOFT)
            self._lines(MARGIN + name, right, size)
            self.y += high + 0.5 * MM
        self.y += 1.6 * MM

    def table(self, caption: str, rows: Sequence[Sequence[str]], right: Set[int]) -> None:
        """A table; its first row is the heading."""
        size = 7.4
        if caption:
            lines = self._wrap(caption, size, INNER)
            self._need((len(lines) + 4) * size * LEADING)
            self._lines(MARGIN, lines, size, colour=SOFT)
            self.y += len(lines) * size * LEADING + 0.8 * MM
        widths = self._widths(rows, size)
        for k, row in enumerate(rows):
            cells = [self._wrap(c, size, w, "normal" if k else "bold") for c, w in zip(row, widths, strict=False)]
            height = max(map(len, cells), default=1) * size * LEADING
            self._need(height + 1.4 * MM)
            x = MARGIN
            for column, (lines, width) in enumerate(zip(cells, widths, strict=False)):
                at = x + width if column in right else x
                self._lines(at, lines, size, weight="normal" if k else "bold", right=column in right)
                x += width + CELL_GAP
            self.y += height + 0.7 * MM
            self._rule(INK if k == 0 else RULE)
            self.y += 0.7 * MM
        self.y += 2.2 * MM

    def figures(self, pair: Sequence[tuple[bytes, str]]) -> None:
        """One or two figures side by side, with their captions."""
        from PIL import Image

        size = 7.0
        captions, tall = [self._wrap(text, size, COLUMN) for _, text in pair], [_tall(png) for png, _ in pair]
        needed = max(t + len(c) * size * LEADING for t, c in zip(tall, captions, strict=True)) + 4 * MM
        self._need(needed)
        top = self.y
        for k, ((png, _), height, caption) in enumerate(zip(pair, tall, captions, strict=True)):
            x = MARGIN + k * (COLUMN + COLUMN_GAP)
            ax = self._canvas.add_axes((x / WIDTH, 1 - (top + height) / HEIGHT, COLUMN / WIDTH, height / HEIGHT))
            ax.imshow(np.asarray(Image.open(io.BytesIO(png)).convert("RGB")), interpolation="none", aspect="auto")
            ax.set_axis_off()
            self.y = top + height + 1 * MM
            self._lines(x, caption, size, colour=SOFT)
        self.y = top + needed

    # --- lines ------------------------------------------------------------------------------------------------------

    def _put(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        *,
        weight: str = "normal",
        colour: str = INK,
        right: bool = False,
    ) -> None:
        at = x - self._measure(text, size, weight) if right else x
        self._words.lines.append((at, HEIGHT - y - 0.93 * size, text, size, weight, colour))

    def _lines(self, x: float, lines: Sequence[str], size: float, **look: Any) -> None:
        for k, line in enumerate(lines):
            self._put(x, self.y + k * size * LEADING, line, size, **look)

    def _rule(self, colour: str) -> None:
        from matplotlib.lines import Line2D

        y = 1 - self.y / HEIGHT
        self._canvas.add_artist(Line2D([MARGIN / WIDTH, 1 - MARGIN / WIDTH], [y, y], color=colour, lw=0.5))

    def _measure(self, text: str, size: float, weight: str) -> float:
        """Width of a text: its characters' advances (kerning is a few thousandths of that)."""
        known = self._advances[weight]
        for character in set(text) - known.keys():
            known[character] = _advance(character, weight)
        return sum(known[character] for character in text) * size

    def _wrap(self, text: str, size: float, width: float, weight: str = "normal") -> list[str]:
        """Lines no wider than `width`; a word that is wider is cut."""
        space = self._measure("n n", size, weight) - self._measure("nn", size, weight)
        lines: list[str] = []
        line, used = "", 0.0
        for word in text.split(" "):
            while self._measure(word, size, weight) > width and len(word) > 1:
                fits = next(
                    k for k in range(len(word) - 1, 0, -1) if k == 1 or self._measure(word[:k], size, weight) <= width
                )
                lines += [line] if line else []
                lines.append(word[:fits])
                line, used, word = "", 0.0, word[fits:]
            wide = self._measure(word, size, weight)
            if line and used + space + wide > width:
                lines.append(line)
                line, used = word, wide
            else:
                line, used = f"{line} {word}" if line else word, used + wide + (space if line else 0.0)
        return [*lines, line] if line or not lines else lines

    def _widths(self, rows: Sequence[Sequence[str]], size: float) -> list[float]:
        """Widths of the columns: what their cells need; where that is too much, wide columns get less."""
        count = max(map(len, rows))
        columns = [[row[k] for row in rows if k < len(row)] for k in range(count)]
        natural = [max(self._measure(cell, size, "bold") for cell in column) for column in columns]
        least = [
            max((self._measure(word, size, "bold") for cell in column for word in cell.split(" ")), default=0.0)
            for column in columns
        ]
        room = INNER - CELL_GAP * (count - 1)
        if sum(natural) <= room:
            return natural
        least = [min(w, room / 3) for w in least]
        spare, wish = max(0.0, room - sum(least)), sum(n - m for n, m in zip(natural, least, strict=True))
        scale = min(1.0, room / max(sum(least), 1e-9))
        return [(m + (n - m) * spare / max(wish, 1e-9)) * scale for n, m in zip(natural, least, strict=True)]
