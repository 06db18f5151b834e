"""The cells of Excel workbooks, of 1997 (xlrd) and of today (openpyxl), with bounds on what a small file may unpack to.

A damaged or a hostile file ends in a `DataError`, after a time and with a memory that are bounded.
"""

import io
import re
import zipfile
from collections.abc import Iterator
from datetime import date, datetime, time
from pathlib import Path

from gonio.errors import DataError

OLD, NEW = bytes.fromhex("d0cf11e0a1b11ae1"), b"PK\x03\x04"
"""How workbooks of 1997 and of today begin."""
MOST_BYTES = 128 * 2**20
"""Of one part of a workbook of today, unpacked."""
MOST_CELLS = 1_000_000
MOST_COLUMNS = 16_384
"""Of a worksheet, by the format's own limits: all cells of a row are held at once."""
MOST_TAGS = 6 * MOST_CELLS
"""Of one part: a cell has itself, its value, and what its row and its text add; each begins and ends."""

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
        for name in names:
            with archive.open(name) as stream:
                text = stream.read(MOST_BYTES + 1)
            if len(text) > MOST_BYTES:
                raise DataError(f"{path}: part {name!r} unpacks to more than {MOST_BYTES >> 20} MiB")
            if text.count(b"<") > MOST_TAGS:
                raise DataError(f"{path}: part {name!r} has more than {MOST_TAGS // 2} elements, empty cells included")
            if max(sum(map(row.count, (b"<c ", b"<c>", b"<c/"))) for row in text.split(b"<row")) > MOST_COLUMNS:
                raise DataError(f"{path}: part {name!r} has more than {MOST_COLUMNS} cells in a row")
            if re.search(rb"<!(DOCTYPE|ENTITY)", text):
                raise DataError(f"{path}: part {name!r} has a document type, which no workbook needs")


def _plain(value: object) -> float | str:
    """A cell's number or text; a date is the number that it is kept as."""
    if isinstance(value, date | datetime | time):
        from openpyxl.utils.datetime import to_excel

        return float(to_excel(value))
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else str(value)
