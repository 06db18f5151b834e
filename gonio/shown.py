"""How results show themselves at a prompt and in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape


def marked(name: str, simulated: bool) -> str:
    """A sample's name where people read it: simulated values are called so wherever they are named."""
    return name + " (simulated)" * simulated


def value(number: float, u: float | None = None, unit: str = "") -> str:
    """A value with its standard uncertainty, if it has one."""
    text = f"{number:.5g}" if not u else f"{number:.5g} ± {u:.2g}"
    return f"{text} {unit}".strip()


def html(title: str, header: Sequence[str], rows: Sequence[Sequence[str]], words: Sequence[str]) -> str:
    """A heading, a table and sentences, for a notebook."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    said = "".join(f"<p>{escape(text)}</p>" for text in words)
    return f"<p><b>{escape(title)}</b></p><table><tr>{head}</tr>{body}</table>{said}"
