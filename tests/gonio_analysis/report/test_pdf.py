"""The printable report: A4, every text and figure of the page, no character lost."""

from __future__ import annotations

import io
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from gonio_analysis.report import html, pdf
from gonio_analysis.report.figures import Figure


def png(shape: tuple[int, int]) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(np.zeros((*shape, 3), dtype=np.uint8)).save(out, format="PNG")
    return out.getvalue()


def page(rows: int) -> str:
    figures = [Figure(f"f{k}", "polar", "", f"figure {k}: caption", "", "<svg></svg>", b"") for k in range(3)]
    body = [
        "<header><h1>Title</h1><nav><ul><li>not printed</li></ul></nav></header>",
        html.facts([("source", "θi = 30°, χ² ± 5 × 10⁻⁷ sr⁻¹ ● " + "x" * 300)]),
        html.table("A table", ["a", "b"], [[f"row {k}", "a longer cell " * 20] for k in range(rows)], right=(1,)),
        html.grid(figures),
        '<div class="viewer"></div><script>var hidden;</script>',
    ]
    return html.document("t", body)


@pytest.mark.parametrize(("rows", "pages"), [(2, 1), (80, 5)])
def test_pages_are_a4_and_hold_every_figure(tmp_path: Path, rows: int, pages: int) -> None:
    pdf.write(tmp_path / "r.pdf", page(rows), {f"f{k}": png((60, 80 + k)) for k in range(3)})
    data = (tmp_path / "r.pdf").read_bytes()
    boxes = re.findall(rb"/MediaBox \[\s*([^\]]+)\]", data)
    assert len(boxes) >= pages
    for box in boxes:
        assert [float(x) for x in box.split()] == pytest.approx([0, 0, 595.2756, 841.8898], abs=0.01)  # 210 x 297 mm
    assert data.count(b"/Subtype /Image") == 3
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
    drawn = b"".join(zlib.decompressobj().decompress(s) for s in streams if s[:1] == b"x")
    text = b"".join(re.findall(rb"\((.*?)\)", drawn))  # kerning splits words into pieces
    assert b"Title" in text
    assert b"hidden" not in text
    assert b"not printed" not in text


def test_lines_keep_within_their_width(tmp_path: Path) -> None:
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(tmp_path / "w.pdf") as sink:
        sheet = pdf._Sheet(sink)
        text = "words of several lengths and oneverylongwordthatmustbecutbecauseitiswiderthanthecolumn end"
        lines = sheet._wrap(text, 8.0, 90.0)
        assert all(sheet._measure(line, 8.0, "normal") <= 90.0 for line in lines)
        assert "".join(lines).replace(" ", "") == text.replace(" ", "")
        sheet.close()
