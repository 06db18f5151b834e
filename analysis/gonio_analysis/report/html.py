"""The pieces of a page that needs no other file: its frame, tables, lists of facts, and figures."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

from gonio_analysis.report.figures import Figure

MOST_FACTS, MOST_WORDS = 200, 2000
"""Entries of a list, and characters of one."""


def document(title: str, body: Iterable[str]) -> str:
    """A page, as HTML text, from parts that are HTML already; empty parts are left out."""
    css = files("gonio_analysis.report").joinpath("style.css").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{css}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in body if part)
        + "\n</main>\n</body>\n</html>\n"
    )


def grid(figures: Sequence[Figure]) -> str:
    """Figures side by side."""
    return '<div class="figures">\n' + "\n".join(figure(f) for f in figures) + "\n</div>"


def figure(f: Figure) -> str:
    """A figure with its caption; what stands before the caption's colon is bold."""
    svg = f.svg.replace("<svg", f'<svg role="img" aria-label="{escape(f.alt, quote=True)}"', 1)
    head, colon, rest = f.caption.partition(":")
    caption = f"<b>{escape(glued(head))}</b>{colon}{escape(glued(rest))}"
    return f'<figure id="{f.name}">{svg}<figcaption>{caption}</figcaption></figure>'


def table(
    caption: str,
    header: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    right: tuple[int, ...] = (),
    marks: Sequence[str] = (),
    most: tuple[int, str] | None = None,
    of: tuple[int, str] | None = None,
) -> str:
    """A table; cells are HTML already, the first of each row is its heading; columns that say nothing are left out.

    Parameters
    ----------
    most
        Rows that the page shows, and the file in `tables/` that has all of them.
    of
        How many rows there would be in all, where `rows` are the first of them, and the file that has them.
    """
    rows = [[glued(cell) for cell in row] for row in rows]
    if most is not None:
        rows, of = rows[: most[0]], (len(rows), most[1])
    if of is not None and of[0] > len(rows):
        caption = f"{caption} The first {len(rows)} of {of[0]} rows; all are in tables/{of[1]}.".strip()
    kept = [k for k in range(len(header)) if k == 0 or any(k < len(row) and row[k] not in ("", "–") for row in rows)]
    header, rows = [header[k] for k in kept], [[row[k] for k in kept if k < len(row)] for row in rows]
    right = tuple(new for new, k in enumerate(kept) if k in right)
    head = "".join(f'<th scope="col"{" class=n" if k in right else ""}>{escape(h)}</th>' for k, h in enumerate(header))
    body = []
    for number_of_row, row in enumerate(rows):
        cells = [f'<th scope="row">{row[0]}</th>']
        cells += [f"<td{' class=n' if k in right else ''}>{cell}</td>" for k, cell in enumerate(row) if k]
        mark = marks[number_of_row] if number_of_row < len(marks) else ""
        body.append(f"<tr{f' class={mark}' if mark else ''}>{''.join(cells)}</tr>")
    title = f"<caption><span>{escape(caption)}</span></caption>" if caption else ""
    return (
        f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead><tbody>{"".join(body)}</tbody></table></div>'
    )


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """A list of names and values in plain text; what is too long for a page is cut, and stands in summary.json."""
    every = list(rows)
    kept = every[:MOST_FACTS]
    if len(every) > len(kept):
        kept.append(("more", f"{len(every) - len(kept)} further entries stand in summary.json"))
    pairs = ((escape(cut(k, MOST_WORDS)), escape(glued(cut(v, MOST_WORDS)))) for k, v in kept)
    return '<dl class="facts">' + "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in pairs) + "</dl>"


def cut(text: str, most: int) -> str:
    """A text of at most so many characters, about; what is left out is said."""
    return text if len(text) <= most else f"{text[:most]} … ({len(text) - most} more characters in summary.json)"


def notes(texts: Sequence[str]) -> str:
    """A list of remarks in plain text."""
    shown = [f"<li>{escape(cut(n, MOST_WORDS))}</li>" for n in texts[:MOST_FACTS]]
    if len(texts) > MOST_FACTS:
        shown.append(f"<li>{len(texts) - MOST_FACTS} further notes stand in summary.json.</li>")
    return f'<ul class="notes">{"".join(shown)}</ul>'


def size(text: str) -> int:
    """Bytes of a text in a file."""
    return len(text.encode("utf-8"))


def within(section: str, room: int) -> str:
    """A section of at most `room` bytes: the largest drawings are named instead of shown until it is."""
    over = size(section) - room
    if over <= 0:
        return section
    found = re.findall(r'<figure id="([^"]+)">(<svg.*?</svg>)', section, re.DOTALL)
    for name, svg in sorted(found, key=lambda item: -len(item[1])):
        words = f'<p class="note">Too large for this page: see <code>figures/{name}.svg</code>.</p>'
        section = section.replace(svg, words, 1)
        over -= size(svg) - size(words)
        if over <= 0:
            break
    return section


def glued(text: str) -> str:
    """A text whose numbers stay on one line with what belongs to them: 1.2 ± 0.3, 4 × 10⁻⁷, 22 %, θi = 30°."""
    text = re.sub(r"(?<=[\d)]) (?=[±×%])|(?<=[±×]) (?=[\d−])", "\u00a0", text)
    return re.sub(r"(?<=θ[ir]) = (?=\d)", "\u00a0=\u00a0", text)
