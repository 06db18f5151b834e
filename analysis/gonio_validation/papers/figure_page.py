"""`index.html`, `summary.json`, the drawings and the curves of a paper's figure; the index of all of them."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from gonio_analysis.report import files, html
from gonio_analysis.report.figures import Figure, rendered
from gonio_analysis.report.summary import stamp
from gonio_analysis.report.tables import write_csv

from gonio_validation.papers import FIGURES
from gonio_validation.papers.figure import COLUMNS, ORIGINS, Page

VERDICTS = ("holds", "does not hold", "no verdict")


def write(page: Page, folder: Path, command: str) -> dict[str, Any]:
    """Write a page into a folder that exists; returns what its summary holds."""
    drawn = [
        rendered(f"{page.name}-{p.name}", p.name, "", p.caption, f"{page.title}. {p.caption}", p.inches, p.draw)
        for p in page.panels
    ]
    for name, content in page.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    write_csv(folder / "curves.csv", COLUMNS, [(p.name, *row) for p in page.panels for row in p.rows])
    facts = summary(page, command)
    files.write(folder, render(page, facts, drawn), facts, drawn)
    return facts


def summary(page: Page, command: str) -> dict[str, Any]:
    """What `summary.json` holds."""
    return {
        "figure": page.name,
        "title": page.title,
        "paper": page.paper,
        **stamp(command),
        "parameters": [
            {"name": p.name, "value": p.value, "origin": p.origin, "source": p.why} for p in page.parameters
        ],
        "claims": [
            {"claim": c.text, "verdict": c.verdict, "found": c.found, "criterion": c.criterion} for c in page.claims
        ],
        "panels": [{"name": p.name, "caption": p.caption, "x": p.axes[0], "y": p.axes[1]} for p in page.panels],
        "curves": [dict(row) for row in page.numbers],
        "notes": list(page.notes),
    }


def render(page: Page, facts: dict[str, Any], drawn: list[Figure]) -> str:
    """The page, as HTML text."""
    claims = [[c.verdict, escape(c.text), escape(c.found), escape(c.criterion)] for c in page.claims]
    parameters = [
        [
            escape(p.name),
            escape(p.value),
            f"<b>{ORIGINS[p.origin]}</b>" if p.origin == "assumed" else ORIGINS[p.origin],
            escape(p.why),
        ]
        for p in page.parameters
    ]
    notes = "".join(f"<li>{escape(n)}</li>" for n in page.notes)
    columns = tuple(range(1, len(page.results.header)))
    body = [
        _header(page.title, f"{page.paper}. Made again", facts),
        f'<p class="lead">{escape(_words(facts["claims"]))}</p>',
        html.grid(drawn),
        "<section><h2>What the paper says, and what the curves say</h2>",
        html.table("", ["verdict", "claim", "found", "criterion"], claims),
        "</section>",
        "<section><h2>Curves</h2>",
        html.table(
            page.results.caption,
            page.results.header,
            [[escape(cell) for cell in row] for row in page.results.rows],
            right=columns,
        ),
        "</section>",
        "<section><h2>Parameters</h2>",
        html.table("", ["parameter", "value", "from", "source, or reason"], parameters),
        "</section>",
        f'<section><h2>Notes</h2><ul class="notes">{notes}</ul></section>' if notes else "",
        "<section><h2>Provenance</h2>",
        html.facts([*page.facts, *_provenance(facts)]),
        "</section>",
        "<footer>Every curve is in <code>curves.csv</code>, every verdict in <code>summary.json</code>, the drawings "
        "as SVG and PNG in <code>figures/</code>.</footer>",
    ]
    return html.document(page.title, body)


def index(pages: Sequence[dict[str, Any]], command: str) -> str:
    """The page that links all figures, as HTML text, from their summaries."""
    facts = stamp(command)
    rows = []
    for f in pages:
        verdicts = [c["verdict"] for c in f["claims"]]
        rows.append([_link(f), escape(FIGURES[f["figure"]]), *(str(verdicts.count(v)) for v in VERDICTS)])
    failing = [
        [_link(f), escape(c["claim"]), escape(c["found"])]
        for f in pages
        for c in f["claims"]
        if c["verdict"] == "does not hold"
    ]
    body = [
        _header("The papers' figures, made again", "Theory, experiment and verdicts", facts),
        f'<p class="lead">{escape(_words([c for f in pages for c in f["claims"]]))}</p>',
        html.table("", ["figure", "what it shows", *VERDICTS], rows, right=(2, 3, 4)),
        "<section><h2>What does not hold</h2>",
        html.table("", ["figure", "claim", "found"], failing),
        "</section><section><h2>Provenance</h2>",
        html.facts(_provenance(facts)),
        "</section>",
    ]
    return html.document("The papers' figures, made again", body)


def _link(facts: dict[str, Any]) -> str:
    return f'<a href="{facts["figure"]}/index.html">{escape(facts["title"].partition(":")[0])}</a>'


def _header(title: str, sub: str, facts: dict[str, Any]) -> str:
    return (
        f'<header>\n<h1>{escape(title)}</h1>\n<p class="sub">{escape(sub)} with gonio '
        f"{escape(facts['versions']['gonio'])}, {escape(facts['created'][:10])}.</p>\n</header>"
    )


def _words(claims: Sequence[dict[str, Any]]) -> str:
    verdicts = [c["verdict"] for c in claims]
    holds, fails, open_ = (verdicts.count(v) for v in VERDICTS)
    words = f"{holds} of {len(verdicts)} claims that the text makes hold in the paper's own model"
    if fails:
        words += f"; {fails} {'does' if fails == 1 else 'do'} not"
    if open_:
        words += f"; {open_} {'hangs on a value' if open_ == 1 else 'hang on values'} that the scan does not give"
    return words + "."


def _provenance(facts: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        ("command", facts["command"] or "–"),
        ("made", facts["created"]),
        ("versions", ", ".join(f"{k} {v}" for k, v in facts["versions"].items())),
    ]
