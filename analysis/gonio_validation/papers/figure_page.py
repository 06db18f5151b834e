"""`index.html`, `summary.json`, the drawings and the curves of a paper's figure; the index of all of them."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Heading,
    Notes,
    Page,
    Paragraph,
    Span,
    Table,
    Text,
    footer,
    stamp,
    strong,
    table,
)
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.section import parts

from gonio.typing import JsonObject
from gonio_validation.papers.figure import COLUMNS, ORIGINS, PaperFigure
from gonio_validation.papers.index import FIGURES

VERDICTS = ("holds", "does not hold", "no verdict")
ALL = "The papers' figures, made again"
FOOTER = footer(
    "Every curve is in `curves.csv`, every verdict in `summary.json`, the drawings as SVG and PNG in `figures/`."
)


def write(page: PaperFigure, folder: Path, command: str) -> JsonObject:
    """Write a page into a folder that exists; returns what its summary holds."""
    for name, content in page.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    files.written(folder / "curves.csv", partial(_curves, page))
    found = summarise(page, command)

    def draw() -> list[Figure]:
        return [
            rendered(f"{page.name}-{p.name}", p.name, "", p.caption, f"{page.title}. {p.caption}", p.inches, p.draw)
            for p in page.panels
        ]

    files.write_page(folder, page.title, partial(render, page, found), lambda _: found, draw)
    return found


def _curves(page: PaperFigure, path: Path) -> None:
    files.write_csv(path, COLUMNS, [(p.name, *row) for p in page.panels for row in p.rows])


def summarise(page: PaperFigure, command: str) -> JsonObject:
    """What `summary.json` says of a figure that was made by this command."""
    return {
        "figure": page.name,
        "title": page.title,
        "paper": page.paper,
        **stamp(command),
        "parameters": [
            {"name": p.name, "value": p.value, "origin": p.origin, "source": p.why} for p in page.parameters
        ],
        "claims": [c.summary for c in page.claims],
        "panels": [{"name": p.name, "caption": p.caption, "x": p.axes[0], "y": p.axes[1]} for p in page.panels],
        "curves": page.results.rows,
        "notes": page.notes,
    }


def write_index(pages: Sequence[JsonObject], folder: Path, command: str) -> None:
    """Write the page that links all figures into the folder that holds theirs."""
    kept = [{name: page[name] for name in ("figure", "title", "claims")} for page in pages]
    files.write_page(folder, ALL, lambda _: index(pages, command), lambda _: {"figures": kept})


def render(page: PaperFigure, found: JsonObject, drawn: Sequence[Figure]) -> Page:
    """The page of a figure."""
    claims = [[c.verdict, c.text] for c in page.claims]
    judged = [[c.text, c.found, c.criterion] for c in page.claims]
    parameters = [
        [p.name, p.value, strong(ORIGINS[p.origin]) if p.origin == "assumed" else ORIGINS[p.origin], p.why]
        for p in page.parameters
    ]
    assumed = sum(p.origin == "assumed" for p in page.parameters)
    folds: list[Block] = [
        Heading(3, "How each claim is judged", _tally(found["claims"])),
        table("", ["claim", "found", "criterion"], judged),
        Heading(3, "Curves", f"{len(page.results.rows)}"),
        *parts({'section "Curves"': partial(_results, page)}),
        Heading(3, "Parameters", f"{len(parameters)}, {assumed} of them assumed"),
        table("", ["parameter", "value", "from", "source, or reason"], parameters),
    ]
    if page.notes:
        folds += [Heading(3, "Notes", f"{len(page.notes)}"), Notes(tuple(page.notes))]
    folds += frame.provenance(found, *page.facts, called="made")
    return frame.page(
        page.title,
        f"{page.paper}. Made again with gonio {found['versions']['gonio']}, {found['created'][:10]}.",
        frame.answer(
            [Paragraph(_words(found["claims"]), "lead")],
            [Figures(tuple(drawn[:1]))],
            [table("What the paper says, and whether the curves say so.", ["verdict", "claim"], claims)],
        ),
        shown=[Figures(tuple(drawn[1:]))],
        folds=folds,
        foot=FOOTER,
    )


def _results(page: PaperFigure) -> Table:
    results = page.results
    cells = [[cell(row) for cell in results.columns.values()] for row in results.rows]
    return table(results.caption, list(results.columns), cells, right=tuple(range(1, len(results.columns))))


def index(pages: Sequence[JsonObject], command: str) -> Page:
    """The page that links all figures, from their summaries."""
    made = stamp(command)
    when = f"with gonio {made['versions']['gonio']}, {made['created'][:10]}."
    rows: list[Sequence[Text]] = []
    for f in pages:
        verdicts = [c["verdict"] for c in f["claims"]]
        rows.append([_link(f), FIGURES[f["figure"]], *(str(verdicts.count(v)) for v in VERDICTS)])
    failing: list[Sequence[Text]] = [
        [_link(f), c["claim"], c["found"]] for f in pages for c in f["claims"] if c["verdict"] == "does not hold"
    ]
    every = table("", ["figure", "what it shows", *VERDICTS], rows, right=(2, 3, 4))
    return frame.page(
        ALL,
        f"Theory, simulated measurements and verdicts {when}",
        frame.answer([Paragraph(_words([c for f in pages for c in f["claims"]]), "lead")], [], [every]),
        folds=[
            Heading(3, "What does not hold", f"{len(failing) or 'none'}"),
            table("", ["figure", "claim", "found"], failing),
            *frame.provenance(made, called="made"),
        ],
        foot=footer("Every verdict is in `summary.json`, every figure in the folder of its name."),
    )


def _link(found: JsonObject) -> Span:
    return Span(found["title"].partition(":")[0], href=f"{found['figure']}/index.html")


def _tally(claims: Sequence[JsonObject]) -> str:
    verdicts = [c["verdict"] for c in claims]
    return ", ".join(f"{verdicts.count(v)} {v}" for v in VERDICTS if v in verdicts)


def _words(claims: Sequence[JsonObject]) -> str:
    verdicts = [c["verdict"] for c in claims]
    holds, fails, open_ = (verdicts.count(v) for v in VERDICTS)
    words = f"{holds} of {len(verdicts)} claims that the text makes hold in the paper's own model"
    if fails:
        words += f"; {fails} {'does' if fails == 1 else 'do'} not"
    if open_:
        words += f"; {open_} {'hangs on a value' if open_ == 1 else 'hang on values'} that the scan does not give"
    return words + "."
