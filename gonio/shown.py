"""How results show themselves at a prompt and in a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape


def marked(name: str, simulated: bool) -> str:
    """A sample's name where people read it: simulated values are called so wherever they are named."""
    return name + " (simulated)" * simulated


def value(number: float, u: float | None = None, unit: str = "") -> str:
    """A value with its standard uncertainty, if it has one: both to the second digit of the uncertainty."""
    if not u or not math.isfinite(u) or not math.isfinite(number):
        text = f"{number:.5g}"
    else:
        power = math.floor(math.log10(max(abs(number), u)))
        far = not -4 <= power < 6
        scale = 10.0**power if far else 1.0
        digits = max(1 - math.floor(math.log10(u / scale)), 0)
        text = f"{number / scale:.{digits}f} ± {u / scale:.{digits}f}"
        text = f"({text})e{power}" if far else text
    return f"{text} {'µm' if unit == 'um' else unit}".strip()


def html(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[str]) -> str:
    """A heading, a table and sentences, for a notebook."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    said = "".join(f"<p>{escape(text)}</p>" for text in words)
    return f"<p><b>{escape(title)}</b></p><table><tr>{head}</tr>{body}</table>{said}"
