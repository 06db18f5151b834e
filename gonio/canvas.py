"""Figures whose words are data: no name is taken for a formula, and what the usual font lacks comes from another one.

Every figure is saved by `save`. Whoever measures texts before that does it within `literal`.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from gonio.shown import visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FONT = "DejaVu Sans"
"""Comes with matplotlib; holds Latin, Greek, Cyrillic, Hebrew, Arabic and some others."""


@contextmanager
def literal() -> Iterator[None]:
    """Within, `$` in a text is a dollar sign, and a glyph that no font has is a box and no warning."""
    from matplotlib import rc_context

    with warnings.catch_warnings(), rc_context({"text.parse_math": False}):
        _hush()
        yield


def _hush() -> None:
    for words in ("Glyph .* missing from", "Matplotlib currently does not support"):
        warnings.filterwarnings("ignore", words, UserWarning)


def save(figure: Figure, file: Any, **how: Any) -> None:
    """`figure.savefig`, with every word as it is."""
    settle(figure)
    with warnings.catch_warnings():
        _hush()
        figure.savefig(file, **how)


def settle(figure: Figure) -> None:
    """Draw all words of a figure as they are, in fonts that have them; numbers along its axes keep their powers."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text
    from matplotlib.ticker import FuncFormatter, LogFormatter, LogitFormatter, ScalarFormatter

    every = figure.findobj()
    for text in (one for one in every if isinstance(one, Text)):
        words = text.get_text()
        text.set_parse_math(False)
        text.set_text(visible(words))
        others = fallbacks(words)
        if others:
            text.set_fontfamily([FONT, *others])
    for axis in (one for one in every if isinstance(one, Axis)):
        for formatter, ticks in (
            (axis.get_major_formatter(), axis.get_major_ticks),
            (axis.get_minor_formatter(), axis.get_minor_ticks),
        ):
            if isinstance(formatter, FuncFormatter):  # of words that somebody has put there, which it sets again
                formatter.func = partial(_visible_at, formatter.func)
            numbers = isinstance(formatter, LogFormatter | LogitFormatter | ScalarFormatter)
            for label in (label for tick in ticks() * numbers for label in (tick.label1, tick.label2)):
                label.set_parse_math(True)
        axis.get_offset_text().set_parse_math(True)  # the power of ten of its numbers


def _visible_at(words: Any, x: float, position: int | None = None) -> str:
    return visible(words(x, position))


def fallbacks(text: str) -> list[str]:
    """Families of installed fonts that have what `FONT` lacks of a text, each once; none for what nobody has."""
    if text.isascii():
        return []
    own = _own()
    found = (_family_of(character) for character in text if ord(character) not in own)
    return list(dict.fromkeys(name for name in found if name))


@cache
def _own() -> frozenset[int]:
    from matplotlib.font_manager import findfont, get_font

    return frozenset(get_font(findfont(FONT)).get_charmap())


@cache
def _family_of(character: str) -> str:
    """The family of an installed font that has a character, a sans serif before others; "" where there is none."""
    from matplotlib.font_manager import fontManager, get_font

    upright = (f for f in fontManager.ttflist if f.style == "normal" and "LastResort" not in f.name.replace(" ", ""))
    for font in sorted(upright, key=lambda f: ("Sans" not in f.name, f.weight not in (400, "normal"), f.name)):
        try:
            if get_font(font.fname).get_char_index(ord(character)):
                return str(font.name)
        except (OSError, RuntimeError):  # a font that was removed since matplotlib listed it, or is damaged
            continue
    return ""
