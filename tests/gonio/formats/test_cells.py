"""Only a cell that holds a number is a number: each kind of other cell, in workbooks of today and of 1997."""

import io
import math
import struct
import zipfile
from collections.abc import Mapping, Sequence
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import openpyxl
import pytest

from gonio import measurement
from gonio.errors import DataError
from gonio.formats import own_pairs, workbook
from tests.gonio.formats.test_rt300s import SAMPLE, compound, record
from tests.gonio.formats.test_rt300s import workbook as rt300s

HEADER = ["theta_i_deg", "phi_i_deg", "theta_r_deg", "phi_r_deg", "wavelength_nm", "brdf", "sample"]
ROWS: list[list[object]] = [[40.0, 0.0, float(r), 180.0, 633.0, 0.125 + 0.01 * r, "chip"] for r in (5, 15, 25)]
BAD, OWN = (2, 5), {"theta_i": "ti", "phi_i": "pi", "theta_r": "tr", "phi_r": "pr"}
"""Row and column, from 0, of the cell that each test changes: brdf in row 3, column F."""


def xlsx(
    rows: Sequence[Any],
    formats: Mapping[tuple[int, int], str] | None = None,
    merged: str = "",
    hidden: int = 0,
) -> bytes:
    """A workbook of these rows; number formats by row and column from 0."""
    book = openpyxl.Workbook()
    sheet = book.active
    for row in rows:
        sheet.append(list(row))
    for (at, column), text in (formats or {}).items():
        sheet.cell(at + 1, column + 1).number_format = text
    if merged:
        sheet.merge_cells(merged)
    if hidden:
        sheet.row_dimensions[hidden].hidden = True
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def with_cell(value: object) -> list[list[object]]:
    """The table with another value for one brdf."""
    rows: list[list[object]] = [list(HEADER), *(list(row) for row in ROWS)]
    rows[BAD[0]][BAD[1]] = value
    return rows


def patched(data: bytes, old: str, new: str, part: str = "xl/worksheets/sheet1.xml") -> bytes:
    """A workbook with other text in one part."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(out, "w") as archive:
        for name in source.namelist():
            text = source.read(name).decode()
            assert name != part or old in text
            archive.writestr(name, text.replace(old, new) if name == part else text)
    return out.getvalue()


def xls(rows: Sequence[Sequence[object]], percent: bool = False) -> bytes:
    """A workbook of 1997 of these cells, after [MS-XLS]; a cell that is bytes is the body of a BOOLERR or a FORMULA."""
    texts = list(dict.fromkeys(str(cell) for row in rows for cell in row if isinstance(cell, str)))
    strings = struct.pack("<2I", len(texts), len(texts))
    strings += b"".join(struct.pack("<HB", len(text), 0) + text.encode("latin-1") for text in texts)
    # a style, then cells in formats General, date (14) and percent (10)
    formats = ((0, 0xFFF5), (0, 1), (14, 1), (10, 1))
    styles = b"".join(record(0x00E0, struct.pack("<3H", 0, key, kind) + bytes(14)) for key, kind in formats)
    body = record(0x0809, struct.pack("<2H", 0x0600, 0x0010) + bytes(12))
    for i, row in enumerate(rows):
        for j, cell in enumerate(row):
            if isinstance(cell, str):
                body += record(0x00FD, struct.pack("<3HI", i, j, 1, texts.index(cell)))
            elif isinstance(cell, bytes):
                kind = 0x0205 if len(cell) == 2 else 0x0006
                body += record(kind, struct.pack("<3H", i, j, 1) + cell)
            elif isinstance(cell, date):
                days = float((cell - date(1899, 12, 30)).days)
                body += record(0x0203, struct.pack("<3Hd", i, j, 2, days))
            elif cell is not None:
                body += record(0x0203, struct.pack("<3Hd", i, j, 3 if percent and j == BAD[1] else 1, float(str(cell))))
    body += record(0x000A, b"")
    head = record(0x0809, struct.pack("<2H", 0x0600, 0x0005) + bytes(12)) + styles
    shared = record(0x00FC, strings)
    name = struct.pack("<BB", 1, 0) + b"S"
    start = len(head) + 4 + 6 + len(name) + len(shared) + 4
    stream = head + record(0x0085, struct.pack("<IH", start, 0) + name) + shared + record(0x000A, b"") + body
    return compound(stream + bytes(max(0, 4096 - len(stream))))


NO_VALUE = b"\x03" + bytes(5) + b"\xff\xff" + struct.pack("<HI", 3, 0) + struct.pack("<H", 0)
"""A formula whose result is no text, as libraries write it that cannot compute."""


@pytest.mark.parametrize(
    ("cell", "told"),
    [
        ("#DIV/0!", "#DIV/0!, an error"),
        ("#N/A", "#N/A, an error"),
        (date(2031, 3, 7), "2031-03-07, a date"),
        (datetime(2031, 3, 7, 6, 30), "2031-03-07 06:30:00, a date"),
        (time(6, 30), "06:30:00, a date"),
        (timedelta(hours=30), "a date"),
        (True, "TRUE, true or false"),
        ("0.31", "the text '0.31' and no number"),
        ("0,31", "the text '0,31' and no number"),
        ("1 234", "the text '1 234' and no number"),
        ("=0.5/PI()", "=0.5/PI(), a formula without a stored value"),
    ],
)
def test_a_cell_of_another_kind_is_refused_with_its_place(cell: object, told: str) -> None:
    """Kind: a cell of another type than number becomes a value. Today's workbooks, .xlsm too."""
    for name in ("a.xlsx", "a.xlsm"):
        with pytest.raises(DataError) as caught:
            measurement.parse(xlsx(with_cell(cell)), Path(name))
        assert f"{name}, worksheet 1, row 3, column F: brdf is " in str(caught.value)
        assert told in str(caught.value)


@pytest.mark.parametrize(
    ("cell", "told"),
    [
        (bytes((0x07, 1)), "#DIV/0!, an error"),
        (bytes((0x2A, 1)), "#N/A, an error"),
        (bytes((0x0F, 1)), "#VALUE!, an error"),
        (bytes((1, 0)), "TRUE, true or false"),
        (date(2031, 3, 7), "2031-03-07, a date"),
        ("0,31", "the text '0,31' and no number"),
        (NO_VALUE, "a formula without a stored value"),
    ],
)
def test_a_cell_of_1997_of_another_kind_is_refused_with_its_place(cell: object, told: str) -> None:
    """Kind: as above, in the workbooks where an error was 7.0 or 42.0, a date 47914.0, TRUE 1.0."""
    with pytest.raises(DataError) as caught:
        measurement.parse(xls(with_cell(cell)), Path("a.xls"))
    assert "a.xls, worksheet 1, row 3, column F: brdf is " in str(caught.value)
    assert told in str(caught.value)


def test_plain_cells_of_both_are_read_alike() -> None:
    today, old = (measurement.parse(of([HEADER, *ROWS]), Path(f"a.{of.__name__}")) for of in (xlsx, xls))
    assert today["brdf"].tolist() == old["brdf"].tolist() == [row[5] for row in ROWS]
    hole = measurement.parse(xlsx(with_cell(None)), Path("a.xlsx"))
    assert hole["flag"].tolist() == ["", "not_measured", ""]  # an empty cell stays a hole


def test_own_columns_go_through_the_same_cells() -> None:
    """Kind: every reader that goes through cells. A date in a column that is left out, or of words, is let be."""
    header = ["ti", "pi", "tr", "pr", "when", "R", "sample"]
    rows: list[list[object]] = [[40.0, 0.0, float(r), 180.0, date(2031, 3, r), 0.5, date(2031, 3, 7)] for r in (5, 15)]
    pairs = {**OWN, "brdf": "R:factor", "sample": "sample"}
    frame = measurement.parse(xlsx([header, *rows]), Path("a.xlsx"), columns=pairs)
    assert frame["brdf"].tolist() == [0.5 / math.pi] * 2
    assert frame["sample"].tolist() == ["2031-03-07"] * 2
    for column, told in ((2, "row 3, column C: tr is 2031-05-09, a date"), (6, "column G: sample is #N/A, an error")):
        bad = [list(row) for row in rows]
        bad[1][column] = date(2031, 5, 9) if column == 2 else "#N/A"
        with pytest.raises(DataError) as caught:
            measurement.parse(xlsx([header, *bad]), Path("a.xlsx"), columns=pairs)
        assert told in str(caught.value)


def test_an_rt300s_workbook_refuses_what_is_no_number() -> None:
    """Kind: as above, in raw signals: one #N/A made 76.99 of a value of 0.00294. Text in other rows is let be."""
    data = rt300s(SAMPLE)
    number = struct.pack("<2H3Hd", 0x0203, 14, 4, 2, 0, 1.0)  # RT of the second column
    error = struct.pack("<2H3H2B", 0x0205, 8, 4, 2, 0, 0x2A, 1) + struct.pack("<2H2x", 0x0092, 2)  # and what fills up
    assert number in data
    assert len(number) == len(error)
    with pytest.raises(DataError, match=r"worksheet 1, row 5, column C: RT is #N/A, an error"):
        measurement.parse(data.replace(number, error), Path("nowhere/tile.xls"))


@pytest.mark.parametrize(
    ("shown", "unit", "values"),
    [
        ("0.0%", "percent", [0.62 / math.pi] * 3),
        ("0%", "factor", [0.62 / math.pi] * 3),
        ('0.0"%"', "factor", [0.62 / math.pi] * 3),  # a sign that only stands there: a plain number
        ("#,##0.00 [$EUR]", "factor", [0.62 / math.pi] * 3),
        ("0.00E+00", "factor", [0.62 / math.pi] * 3),
    ],
)
def test_a_percent_format_and_the_unit_percent_count_once(shown: str, unit: str, values: list[float]) -> None:
    """Kind: a number format and a unit that both divide by 100."""
    rows: list[Any] = [
        ["ti", "pi", "tr", "pr", "R"],
        *([30.0, 0.0, float(r), 180.0, 0.62] for r in (0, 10, 20)),
    ]
    data = xlsx(rows, {(row, 4): shown for row in (1, 2, 3)})
    frame = measurement.parse(data, Path("a.xlsx"), columns={**OWN, "brdf": f"R:{unit}"})
    assert frame["brdf"].tolist() == pytest.approx(values, rel=1e-15)  # one rounding each of the scale and of pi


def test_a_percent_format_where_no_share_belongs_is_refused() -> None:
    """Kind: angles, wavelengths and values in 1/sr in percent format; a column that is only partly in it."""
    for column, name in ((0, "theta_i_deg"), (4, "wavelength_nm"), (5, "brdf")):
        with pytest.raises(
            DataError, match=f"row 2, column [A-F]: {name} is a number in percent format, and .* its unit"
        ):
            measurement.parse(xlsx([HEADER, *ROWS], {(1, column): "0.0%"}), Path("a.xlsx"))
    with pytest.raises(DataError, match="row 2, column F: brdf is a number in percent format"):
        measurement.parse(xls([HEADER, *ROWS], percent=True), Path("a.xls"))
    rows: list[Any] = [
        ["ti", "pi", "tr", "pr", "R"],
        *([30.0, 0.0, float(r), 180.0, 0.62] for r in (0, 10, 20)),
    ]
    data = xlsx(rows, {(1, 4): "0%", (2, 4): "0%"})
    with pytest.raises(DataError, match=r"row 2, column E: R is a number in percent format, and that in row 4 is not"):
        measurement.parse(data, Path("a.xlsx"), columns={**OWN, "brdf": "R:percent"})


def test_formulas_count_with_the_value_that_is_stored() -> None:
    """Kind: a formula that a program wrote and nobody computed is no hole, and no zero."""
    data = xlsx(with_cell("=0.5/PI()"))
    stored = patched(data, "<f>0.5/PI()</f><v></v>", "<f>0.5/PI()</f><v>0.1591</v>")
    assert measurement.parse(stored, Path("a.xlsx"))["brdf"].tolist()[1] == 0.1591
    # some programs store a zero, and ask the spreadsheet to compute all when it opens the file
    zero = patched(data, "<f>0.5/PI()</f><v></v>", "<f>0.5/PI()</f><v>0</v>")
    with pytest.raises(DataError, match=r"brdf is =0\.5/PI\(\), a formula without a stored value; open the workbook"):
        measurement.parse(zero, Path("a.xlsx"))
    computed = patched(zero, ' fullCalcOnLoad="1"', "", part="xl/workbook.xml")
    assert measurement.parse(computed, Path("a.xlsx"))["brdf"].tolist()[1] == 0.0
    # a formula that gives an empty text is an empty cell; without any stored text it is not
    place = '<c r="F3"><f>0.5/PI()</f><v></v></c>'
    text = patched(data, place, '<c r="F3" t="str"><f>IF(1,"",2)</f><v></v></c>')
    assert measurement.parse(text, Path("a.xlsx"))["flag"].tolist()[1] == "not_measured"
    with pytest.raises(DataError, match="a formula without a stored value"):
        measurement.parse(patched(data, place, '<c r="F3" t="str"><f>IF(1,"",2)</f></c>'), Path("a.xlsx"))


def test_merged_cells_are_refused_and_hidden_rows_are_told() -> None:
    """Kind: what a sheet shows is not what its cells hold. A merged wavelength was a broad band in all rows but one."""
    with pytest.raises(DataError, match=r"row 2, column E: is merged with the cells to row 4, column E; unmerge them"):
        measurement.parse(xlsx([HEADER, *ROWS], merged="E2:E4"), Path("a.xlsx"))
    frame = measurement.parse(xlsx([HEADER, *ROWS], hidden=3), Path("a.xlsx"))
    assert len(frame) == 3
    assert "1 hidden rows of worksheet 1 are read, too" in frame.attrs["notes"]


def test_dates_above_a_table_of_ones_own_are_no_numbers_of_it() -> None:
    """Kind: a date in a header is legal: it is a name."""
    rows: list[Any] = [
        ["ti", "pi", "tr", "pr", "R", date(2031, 3, 7)],
        *([30.0, 0.0, float(r), 180.0, 0.6, 1.0] for r in (0, 10)),
    ]
    frame = measurement.parse(xlsx(rows), Path("a.xlsx"), columns={**OWN, "brdf": "R"})
    assert "columns left out: '2031-03-07'" in frame.attrs["notes"]


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (("mimetype", "META-INF/manifest.xml", "content.xml"), r"OpenDocument file \(\.ods\).* save it as \.xlsx"),
        (("xl/workbook.bin",), r"binary \(\.xlsb\).* save it as \.xlsx"),
    ],
)
def test_other_workbooks_are_named_with_the_way_out(names: tuple[str, ...], told: str) -> None:
    """Kind: a spreadsheet in a format that is not read, told as such."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name in names:
            archive.writestr(name, "x")
    with pytest.raises(DataError, match=told):
        measurement.parse(out.getvalue(), Path("a.ods"))
    with pytest.raises(DataError, match="is no Excel workbook, whatever its name"):
        workbook.as_csv(b"<html><table>", Path("a.xls"), lambda _: True)


def test_units_of_a_workbook_are_those_of_own_columns() -> None:
    rows: list[Any] = [
        ["ti", "pi", "tr", "pr", "R", "dR"],
        *([30.0, 0.0, float(r), 180.0, 62.0, 0.05] for r in (0, 10)),
    ]
    data = xlsx(rows, {(row, 5): "0%" for row in (1, 2)})
    pairs = own_pairs.pairs("theta_i=ti,phi_i=pi,theta_r=tr,phi_r=pr,brdf=R:percent,u_random=dR:relative-percent")
    frame = measurement.parse(data, Path("a.xlsx"), columns=pairs)
    assert frame["u_random"].tolist() == pytest.approx([0.05 * 0.62 / math.pi] * 2, rel=1e-15)
