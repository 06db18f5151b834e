"""A small workbook that holds very many empty cells takes no memory to speak of."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path

import pytest

from gonio.errors import DataError
from gonio.formats import _xlsx

RELATIONS = '<Relationships><Relationship Id="r1" Type="x/worksheet" Target="worksheets/sheet1.xml"/></Relationships>'
BOOK = '<workbook xmlns:r="r"><sheets><sheet name="a" r:id="r1"/></sheets></workbook>'


def workbook(sheet: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("xl/_rels/workbook.xml.rels", RELATIONS)
        made.writestr("xl/workbook.xml", BOOK)
        made.writestr("xl/worksheets/sheet1.xml", sheet)
    return out.getvalue()


def test_empty_cells_are_counted_and_not_kept() -> None:
    row = b'<row><c r="A1"><v>1.5</v></c>' + 999 * b"<c/>" + b"</row>"
    few = workbook(b"<worksheet><sheetData>" + 1000 * row + b"</sheetData></worksheet>")
    tracemalloc.start()
    (sheet,) = _xlsx.worksheets(few, Path("few.xlsx"))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(sheet) == 1000
    # a million cells: 4 MB of text, held twice, and one row of elements; kept as a tree they would be 100 MB
    assert peak < 20e6
    many = workbook(b"<worksheet><sheetData><row>" + 4_100_000 * b"<c/>" + b"</row></sheetData></worksheet>")
    assert len(many) < 100_000
    with pytest.raises(DataError, match="more than 4000000 elements"):
        _xlsx.worksheets(many, Path("many.xlsx"))
