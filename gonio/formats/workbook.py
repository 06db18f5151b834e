"""Tables of one's own in Excel workbooks, `.xlsx` and `.xls`: a worksheet with a header line, taken as a CSV.

A worksheet's first line that is not empty names the columns. It is read as a CSV with these cells would be: under the
measurement table's names, or under others that are named (`gonio.formats.own_columns`). Of several worksheets the first
is taken whose header has all the columns that are needed. Numbers come out with every bit that the workbook holds;
those that are written have 16 digits.

Also here are the cells of Excel workbooks, of 1997 (xlrd) and of today (openpyxl), with bounds on what they unpack to.

A damaged or a hostile file ends in a `DataError`, after a time and with a memory that are bounded.
"""

import contextlib
import io
import itertools
import json
import re
import zipfile
from collections.abc import Collection, Iterator, Sequence
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import DataError
from gonio.formats import native
from gonio.formats.curve_sheets import curves
from gonio.formats.reader import NOT_XML, Format, require_held, write_bytes
from gonio.formats.text import csv_of
from gonio.formats.xml_text import require_plain
from gonio.typing import DataFrame

OLD, NEW = bytes.fromhex("d0cf11e0a1b11ae1"), b"PK\x03\x04"
"""How workbooks of 1997 and of today begin."""
MOST_BYTES = 128 * 2**20
"""Most bytes of all parts of an .xlsx workbook together, unpacked."""
MOST_PARTS = 2000
MOST_CELLS = 1_000_000
MOST_COLUMNS = 16_384
"""Most columns of a worksheet, by the format's own limits: all cells of a row are held at once."""
MOST_TAGS = 6 * MOST_CELLS
"""Most tags of all parts together: a cell has itself, its value, and its row and text; each begins and ends."""

Sheet = dict[tuple[int, int], float | str]
"""Numbers and texts by (row, column), both from 0."""


def worksheets(data: bytes, path: Path) -> list[Sheet]:
    """The cells of each worksheet that are not empty.

    Raises
    ------
    DataError
        This is no such workbook, it is encrypted, damaged, or holds more than is read.
    """
    made = _of_1997(data) if data.startswith(OLD) else _of_today(data, path)
    out: list[Sheet] = []
    left = MOST_CELLS
    try:
        for rows in made:
            out.append({})
            for row, column, value in rows:
                out[-1][row, column] = value
                left -= 1
                if left < 0:
                    raise DataError(f"{path}: the workbook has more than {MOST_CELLS} cells")
    except DataError:
        raise
    except Exception as error:  # what the libraries raise of damaged files is of any kind
        raise DataError(f"{path}: the workbook is damaged, encrypted, or none: {str(error)[:80]}") from None
    return out


Cells = Iterator[tuple[int, int, float | str]]


def _of_1997(data: bytes) -> Iterator[Cells]:
    import xlrd

    with xlrd.open_workbook(file_contents=data, logfile=io.StringIO(), on_demand=True) as book:
        for sheet in book.sheets():
            yield (
                (row, column, value if kind == xlrd.XL_CELL_TEXT else float(value))
                for row in range(sheet.nrows)
                for column, (kind, value) in enumerate(zip(sheet.row_types(row), sheet.row_values(row), strict=True))
                if kind not in (xlrd.XL_CELL_EMPTY, xlrd.XL_CELL_BLANK)
            )


def _of_today(data: bytes, path: Path) -> Iterator[Cells]:
    import openpyxl

    _bounded(data, path)
    book = openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=True, keep_links=False)
    for sheet in book.worksheets:
        sheet.reset_dimensions()  # what a file says of its size is not believed
        yield (
            (cell.row - 1, cell.column - 1, _plain(cell.value))
            for row in sheet.iter_rows()
            for cell in row
            if cell.value is not None
        )


def _bounded(data: bytes, path: Path) -> None:
    """Raise `DataError` for a part that unpacks to more than is read, before anything takes a tree of it."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        if "xl/workbook.xml" not in names:
            raise DataError(f"{path}: is a zip, but no Excel workbook; unpack it first")
        if len(names) > MOST_PARTS or sum(part.file_size for part in archive.infolist()) > MOST_BYTES:
            raise DataError(
                f"{path}: has {len(names)} parts that unpack to "
                f"{sum(part.file_size for part in archive.infolist()) >> 20} MiB; "
                f"read are {MOST_PARTS} parts of {MOST_BYTES >> 20} MiB together"
            )
        tags = 0
        for name in names:
            text = archive.read(name)
            tags += text.count(b"<")
            if tags > MOST_TAGS:
                raise DataError(f"{path}: part {name!r} has more than {MOST_TAGS // 2} elements, empty cells included")
            if max(sum(map(row.count, (b"<c ", b"<c>", b"<c/"))) for row in text.split(b"<row")) > MOST_COLUMNS:
                raise DataError(f"{path}: part {name!r} has more than {MOST_COLUMNS} cells in a row")
            if name.endswith((".xml", ".rels")):
                require_plain(text, f"{path}: part {name!r}")


def _plain(value: object) -> float | str:
    """A cell's number or text; a date is the number that it is kept as."""
    if isinstance(value, date | datetime | time):
        from openpyxl.utils.datetime import to_excel

        return float(to_excel(value))
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


ABOUT = "attributes of the table, as JSON"
MOST_ROWS = 1_048_576
MOST_TEXT = 30_000
"""Characters of a cell: Excel takes 32 767."""
MAX_BYTES = 64 * 2**20
MAX_PLACES = 4_000_000
"""Rows times columns, empty ones too: what the lines of the CSV take, four times the cells of a workbook."""


def is_workbook(data: bytes) -> bool:
    """Whether the bytes begin as an Excel workbook does, of 1997 or of today."""
    return data.startswith((OLD, NEW))


def as_csv(data: bytes, path: Path, needed: Collection[str]) -> tuple[bytes, list[str]]:
    """The worksheet of a table as a CSV, and notes on which it is.

    Raises
    ------
    DataError
        It is no such workbook, is damaged, or holds nothing; a cell stands in a column without a name.
    """
    return _table_of(worksheets(data, path), path, needed)


def _table_of(sheets: Sequence[Sheet], path: Path, needed: Collection[str]) -> tuple[bytes, list[str]]:
    full = [(number, sheet) for number, sheet in enumerate(sheets, start=1) if sheet]
    if not full:
        raise DataError(f"{path}: the workbook holds no cells")
    number, sheet = next(((n, s) for n, s in full if set(needed) <= set(_header(s).values())), full[0])
    header = _header(sheet)
    first = min(row for row, _ in sheet)
    rows = len({row for row, _ in sheet})
    where = f"{path}, worksheet {number}"
    if rows * len(header) > MAX_PLACES:
        raise DataError(
            f"{where}: {rows} rows of {len(header)} columns are more than {MAX_PLACES} places, "
            "most of them empty; leave out the columns that hold nothing"
        )
    lines: dict[int, list[str]] = {}
    place = {column: k for k, column in enumerate(header)}
    for (row, column), value in sheet.items():
        if row > first and column not in place:
            raise DataError(
                f"{where}, row {row + 1}: a cell in a column without a name; the sheet's first line names them"
            )
        if row > first:
            lines.setdefault(row, [""] * len(place))[place[column]] = _cell(value)
    notes = [f"worksheet {number} of {len(sheets)} is read"] if len(sheets) > 1 else []
    return csv_of(header.values(), (lines[row] for row in sorted(lines))), notes


def _header(sheet: Sheet) -> dict[int, str]:
    """Names of the columns by their places: the first line that is not empty."""
    first = min(row for row, _ in sheet)
    return {column: _cell(value).strip() for (row, column), value in sorted(sheet.items()) if row == first}


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else repr(value)


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a workbook whose columns have the table's own names."""
    sheets = worksheets(data, path)
    text, notes = _table_of(sheets, path, native.NEEDED)
    stored = _stored(sheets)
    frame = native.read(io.BytesIO(text), path, stored)
    frame.attrs["notes"] = [*([] if stored else notes), *frame.attrs["notes"]]
    return frame


def _stored(sheets: Sequence[Sheet]) -> Any:
    """The attributes that `write` has put on a sheet of their own; None where there is none."""
    for sheet in sheets:
        if sheet.get((0, 0)) == ABOUT:
            with contextlib.suppress(ValueError):
                return json.loads("".join(str(v) for (row, column), v in sorted(sheet.items()) if row and not column))
    return None


def write(frame: DataFrame, path: Path) -> None:
    """A sheet of the whole table, one a curve, and one of the table's attributes; numbers to 16 digits."""
    from openpyxl import Workbook

    if len(frame) >= MOST_ROWS or frame.size > MOST_CELLS // 2:
        raise DataError(f"{path}: {len(frame)} rows are too many for a workbook; write .parquet or .csv")
    sheets = [("table", list(frame.columns), [frame[name].tolist() for name in frame.columns])]
    names: set[str] = {"table", "about"}
    shown = ("wavelength_nm", "brdf", "u_brdf", "flag")
    for curve in curves(frame, path):
        header = ["viewing angle [deg]", "wavelength [nm]", "BRDF [1/sr]", "u(BRDF) [1/sr]", "flag"]
        columns = [curve.signed_deg.tolist(), *(curve.rows[name].tolist() for name in shown)]
        sheets.append((_sheet_name(curve.name, names), header, columns))
    text = json.dumps(native.plain(frame.attrs), ensure_ascii=True, allow_nan=False)
    sheets.append(("about", [ABOUT], [[text[k : k + MOST_TEXT] for k in range(0, len(text), MOST_TEXT)]]))
    for _, header, columns in sheets:  # before a workbook is begun, which would have to be ended
        for word in {word for words in (header, *columns) for word in words if isinstance(word, str)}:
            require_held(word, path, "a workbook", NOT_XML)
    book = Workbook(write_only=True)
    for name, header, columns in sheets:
        sheet = book.create_sheet(name)
        for values in (header, *zip(*columns, strict=True)):
            sheet.append([_written(value, sheet) for value in values])
    buffer = io.BytesIO()
    book.save(buffer)
    write_bytes(path, buffer.getvalue())


def _written(value: Any, sheet: Any) -> Any:
    """What a cell is written as: a text always as text, whatever it looks like to a spreadsheet."""
    from openpyxl.cell import WriteOnlyCell

    if not isinstance(value, str):
        return None if isinstance(value, float) and np.isnan(value) else value
    if not value:
        return None
    cell = WriteOnlyCell(sheet, value)
    cell.data_type = "s"
    if value[0] in "=+-@":
        cell.quotePrefix = True
    return cell


def _sheet_name(name: str, taken: set[str]) -> str:
    """A name that Excel takes, and that no other sheet has."""
    plain = re.sub(rf"[\[\]:*?/\\']|{NOT_XML.pattern}", "-", name)[:27] or "curve"
    numbered = (f"{plain} {count}" for count in itertools.count(2))
    out = next(one for one in itertools.chain([plain], numbered) if one.lower() not in taken)
    taken.add(out.lower())
    return out


FORMAT = Format(
    name="xlsx",
    title="Excel workbook with a measurement table's columns",
    endings=(".xlsx",),
    sniff=lambda head: head.startswith(NEW),
    read=read,
    write=write,
    max_bytes=MAX_BYTES,
    carries=native.FORMAT.carries,
)
