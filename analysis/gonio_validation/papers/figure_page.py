"""`index.html`, `summary.json`, the drawings and the curves of a paper's figure; the index of all of them."""

from collections.abc import Sequence
from pathlib import Path

from gonio_analysis.report import files
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Heading,
    Notes,
    Page,
    Paragraph,
    Span,
    Stamp,
    Text,
    code,
    header,
    provenance,
    section,
    stamp,
    strong,
    table,
)
from gonio_analysis.report.drawings import Figure, rendered
from gonio_analysis.report.tables import write_csv
from gonio_analysis.result_records import as_json

from gonio_validation.papers.figure import COLUMNS, ORIGINS, PaperFigure
from gonio_validation.papers.figure_summary import ClaimSummary, FigureSummary, index_of, summarise
from gonio_validation.papers.index import FIGURES

VERDICTS = ("holds", "does not hold", "no verdict")
ALL = "The papers' figures, made again"
FOOTER = Footer(
    (
        *("Every curve is in ", code("curves.csv"), ", every verdict in ", code("summary.json")),
        *(", the drawings as SVG and PNG in ", code("figures/"), "."),
    )
)


def write(page: PaperFigure, folder: Path, command: str) -> FigureSummary:
    """Write a page into a folder that exists; returns what its summary holds."""
    drawn = [
        rendered(f"{page.name}-{p.name}", p.name, "", p.caption, f"{page.title}. {p.caption}", p.inches, p.draw)
        for p in page.panels
    ]
    for name, content in page.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    write_csv(folder / "curves.csv", COLUMNS, [(p.name, *row) for p in page.panels for row in p.rows])
    found = summarise(page, command)
    files.write_page(folder, render(page, found, drawn), as_json(found), drawn)
    return found


def write_index(pages: Sequence[FigureSummary], folder: Path, command: str) -> None:
    """Write the page that links all figures into the folder that holds theirs."""
    files.write_page(folder, index(pages, command), as_json(index_of(pages)))


def render(page: PaperFigure, found: FigureSummary, drawn: list[Figure]) -> Page:
    """The page of a figure."""
    claims = [[c.verdict, c.text, c.found, c.criterion] for c in page.claims]
    parameters = [
        [p.name, p.value, strong(ORIGINS[p.origin]) if p.origin == "assumed" else ORIGINS[p.origin], p.why]
        for p in page.parameters
    ]
    results, columns = page.results, tuple(range(1, len(page.results.header)))
    body: list[Block] = [
        header(page.title, f"{page.paper}. Made again with gonio {found.versions['gonio']}, {found.created[:10]}."),
        Paragraph(_words(found.claims), "lead"),
        Figures(tuple(drawn)),
        section(
            [
                Heading(2, "What the paper says, and what the curves say"),
                table("", ["verdict", "claim", "found", "criterion"], claims),
            ]
        ),
        section([Heading(2, "Curves"), table(results.caption, results.header, results.rows, right=columns)]),
        section([Heading(2, "Parameters"), table("", ["parameter", "value", "from", "source, or reason"], parameters)]),
    ]
    if page.notes:
        body.append(section([Heading(2, "Notes"), Notes(tuple(page.notes))]))
    made = Stamp(created=found.created, command=found.command, versions=dict(found.versions))
    body += [section([Heading(2, "Provenance"), provenance(made, *page.facts, called="made")]), FOOTER]
    return Page(page.title, tuple(body))


def index(pages: Sequence[FigureSummary], command: str) -> Page:
    """The page that links all figures, from their summaries."""
    made = stamp(command)
    when = f"with gonio {made['versions']['gonio']}, {made['created'][:10]}."
    rows: list[Sequence[Text]] = []
    for f in pages:
        verdicts = [c.verdict for c in f.claims]
        rows.append([_link(f), FIGURES[f.figure], *(str(verdicts.count(v)) for v in VERDICTS)])
    failing: list[Sequence[Text]] = [
        [_link(f), c.claim, c.found] for f in pages for c in f.claims if c.verdict == "does not hold"
    ]
    body = (
        header(ALL, f"Theory, simulated measurements and verdicts {when}"),
        Paragraph(_words([c for f in pages for c in f.claims]), "lead"),
        table("", ["figure", "what it shows", *VERDICTS], rows, right=(2, 3, 4)),
        section([Heading(2, "What does not hold"), table("", ["figure", "claim", "found"], failing)]),
        section([Heading(2, "Provenance"), provenance(made, called="made")]),
    )
    return Page(ALL, body)


def _link(found: FigureSummary) -> Span:
    return Span(found.title.partition(":")[0], href=f"{found.figure}/index.html")


def _words(claims: Sequence[ClaimSummary]) -> str:
    verdicts = [c.verdict for c in claims]
    holds, fails, open_ = (verdicts.count(v) for v in VERDICTS)
    words = f"{holds} of {len(verdicts)} claims that the text makes hold in the paper's own model"
    if fails:
        words += f"; {fails} {'does' if fails == 1 else 'do'} not"
    if open_:
        words += f"; {open_} {'hangs on a value' if open_ == 1 else 'hang on values'} that the scan does not give"
    return words + "."
