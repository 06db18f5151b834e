"""The blocks of a report as HTML and on A4: every text and figure, no character lost."""

import io
import json
import random
import re
import zlib
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from gonio_analysis.report import html, pdf
from gonio_analysis.report.blocks import (
    Contents,
    Figures,
    Footer,
    Group,
    Heading,
    Notes,
    Page,
    Paragraph,
    Span,
    Viewer,
    facts,
    section,
    strong,
    table,
)
from gonio_analysis.report.drawing import Figure
from gonio_analysis.report.viewer import View

from tests.names import CONTROLS, SCRIPTS, drawn_names


@pytest.fixture(scope="module", autouse=True)
def no_pdf() -> None:
    """Here a PDF is written."""


def png(shape: tuple[int, int]) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.zeros((*shape, 3), dtype=np.uint8)).save(out, format="PNG")
    return out.getvalue()


def page(rows: int) -> Page:
    figures = [
        Figure(f"f{k}", "polar", "", f"figure {k}: caption", "", "<svg></svg>", png((60, 80 + k))) for k in range(3)
    ]
    return Page(
        "t",
        (
            Group("header", (Heading(1, "Title"), Contents((("#s", "not printed"),)))),
            facts([("source", "θi = 30°, χ² ± 5 × 10⁻⁷ sr⁻¹ ● " + "x" * 300)]),
            table("A table", ["a", "b"], [[f"row {k}", "a longer cell " * 20] for k in range(rows)], right=(1,)),
            section([Notes(((strong("bold"), " remark"),)), Paragraph("paragraph", "note"), Footer("footing")]),
            Figures(tuple(figures)),
            Viewer("plot", cast(View, {"name": "hidden"})),
        ),
    )


@pytest.mark.parametrize(("rows", "pages"), [(2, 1), (80, 5)])
def test_pages_are_a4_and_hold_every_figure(tmp_path: Path, rows: int, pages: int) -> None:
    pdf.write(tmp_path / "r.pdf", [page(rows)])
    data = (tmp_path / "r.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[\s*([^\]]+)\]", data)
    assert len(boxes) >= pages
    for box in boxes:
        assert [float(x) for x in box.split()] == pytest.approx([0, 0, 595.2756, 841.8898], abs=0.01)  # 210 x 297 mm
    assert data.count(b"/Subtype /Image") == 3
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
    drawn = b"".join(zlib.decompressobj().decompress(s) for s in streams if s[:1] == b"x")
    text = b"".join(re.findall(rb"\((.*?)\)", drawn))  # kerning splits words into pieces
    for word in (b"Title", b"source", b"A table", b"longer", b"bold remark", b"paragraph", b"footing", b"gure 2"):
        assert word in text, word
    assert b"hidden" not in text
    assert b"not printed" not in text


def test_words_are_never_markup() -> None:
    sly = '<script>alert("x")</script> & co'
    blocks = (
        Heading(2, sly),
        Paragraph((sly, Span(sly, href=sly))),
        Notes((sly,)),
        facts([(sly, sly)]),
        table(sly, [sly, sly], [[sly, strong(sly)]]),
        Figures((Figure("f", "polar", "", f"{sly}: {sly}", sly, "<svg></svg>", b""),)),
        Viewer("v", cast(View, {"name": sly})),
        Contents(((sly, sly),)),
        Footer(sly),
    )
    text = html.document(Page(sly, (section(blocks),)))
    assert text.count("<script") == 2  # the plot's data and its program
    assert text.count("</script>") == 2
    assert "& co" not in text.replace(json.dumps(sly)[1:-1].replace("<", "\\u003c"), "")


def test_lines_keep_within_their_width(tmp_path: Path) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(tmp_path / "w.pdf") as sink:
        sheet = pdf._Sheet(sink)
        text = "words of several lengths and oneverylongwordthatmustbecutbecauseitiswiderthanthecolumn end"
        lines = sheet._wrap(text, 8.0, 90.0)
        assert all(sheet._measure(line, 8.0, "normal") <= 90.0 for line in lines)
        assert "".join(lines).replace(" ", "") == text.replace(" ", "")
        sheet.close()


def test_a_heading_stands_on_the_page_of_its_figures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    placed: dict[str, int] = {}
    text, figures = pdf._Sheet.text, pdf._Sheet.figures

    def heading(sheet: pdf._Sheet, kind: str, content: str, *more: object) -> None:
        text(sheet, kind, content, *more)  # type: ignore[arg-type]
        placed[content] = sheet._number

    def pair(sheet: pdf._Sheet, shown: list[tuple[bytes, str]]) -> None:
        figures(sheet, shown)
        placed["figures"] = sheet._number

    monkeypatch.setattr(pdf._Sheet, "text", heading)
    monkeypatch.setattr(pdf._Sheet, "figures", pair)
    tall = Figure("f", "polar", "", "caption", "", "<svg></svg>", png((80, 80)))
    for lines in range(40, 60):  # wherever on the page it comes to stand
        blocks = [Paragraph(f"line {k}", "note") for k in range(lines)]
        pdf.write(tmp_path / "t.pdf", [Page("t", (*blocks, Heading(3, "Heading"), Figures((tall,))))])
        assert placed["Heading"] == placed["figures"], lines


def test_names_of_every_script_and_what_no_font_has(tmp_path: Path) -> None:
    """The kind: a character that the font of the page lacks, or that acts on whoever sets it."""
    names = [*SCRIPTS.values(), *drawn_names(random.Random(7), 10), f"a{CONTROLS}\ud800b", "$x$", "x" * 300]
    blocks = (Heading(1, names[0]), facts([(name, name) for name in names]), table("", ["a"], [[n] for n in names]))
    pdf.write(tmp_path / "a.pdf", [Page(names[0], blocks)])
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


def test_a_missing_glyph_is_as_wide_as_its_box() -> None:
    none = pdf._advance("\u5857", "normal")
    assert none > 0.3
    assert pdf._advance("a", "bold") > pdf._advance("a", "normal") > 0.4
