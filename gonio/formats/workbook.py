"""Tables of one's own in Excel workbooks, `.xlsx` and `.xls`: a worksheet with a header line, taken as a CSV.

A worksheet's first line that is not empty names the columns. It is read as a CSV with these cells would be: under the
measurement table's names, or under others that are named (`gonio.formats.own_columns`). Of several worksheets the first
is taken whose header has all the columns that are needed. Numbers come out with every bit that the workbook holds.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.errors import DataError
from gonio.formats import native, workbook_cells
from gonio.formats.reader import Format

if TYPE_CHECKING:
    import pandas as pd

MAX_BYTES = 64 * 2**20
MAX_PLACES = 4_000_000
"""Rows times columns, empty ones too: what the lines of the CSV take, four times the cells of a workbook."""


def is_workbook(data: bytes) -> bool:
    """Whether the bytes begin as an Excel workbook does, of 1997 or of today."""
    return data.startswith((workbook_cells.OLD, workbook_cells.NEW))


def as_csv(data: bytes, path: Path, needed: Collection[str]) -> tuple[bytes, list[str]]:
    """The worksheet of a table as a CSV, and notes on which it is.

    Raises
    ------
    DataError
        It is no such workbook, is damaged, or holds nothing; a cell stands in a column without a name.
    """
    sheets = workbook_cells.worksheets(data, path)
    full = [(number, sheet) for number, sheet in enumerate(sheets, start=1) if sheet]
    if not full:
        raise DataError(f"{path}: the workbook holds no cells")
    number, sheet = next(((n, s) for n, s in full if set(needed) <= set(_header(s).values())), full[0])
    header = _header(sheet)
    first = min(row for row, _ in sheet)
    rows = len({row for row, _ in sheet})
    if rows * len(header) > MAX_PLACES:
        raise DataError(
            f"{path}, worksheet {number}: {rows} rows of {len(header)} columns are more than {MAX_PLACES} places, "
            "most of them empty; leave out the columns that hold nothing"
        )
    lines: dict[int, list[str]] = {}
    place = {column: k for k, column in enumerate(header)}
    for (row, column), value in sheet.items():
        if row > first and column in place:
            lines.setdefault(row, [""] * len(place))[place[column]] = _cell(value)
        elif row > first:
            where = f"{path}, worksheet {number}, row {row + 1}"
            raise DataError(f"{where}: a cell in a column without a name; the sheet's first line names them")
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(header.values())
    writer.writerows(lines[row] for row in sorted(lines))
    notes = [f"worksheet {number} of {len(sheets)} is read"] if len(sheets) > 1 else []
    return out.getvalue().encode(), notes


def _header(sheet: workbook_cells.Sheet) -> dict[int, str]:
    """Names of the columns by their places: the first line that is not empty."""
    first = min(row for row, _ in sheet)
    return {column: _cell(value).strip() for (row, column), value in sorted(sheet.items()) if row == first}


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else repr(value)


def read(data: bytes, path: Path) -> pd.DataFrame:
    """The measurement table in a workbook whose columns have the table's own names."""
    text, notes = as_csv(data, path, native.NEEDED)
    frame = native.read(text, path)
    frame.attrs["notes"] = [*notes, *frame.attrs["notes"]]
    return frame


FORMAT = Format(
    name="xlsx",
    title="Excel workbook with a measurement table's columns",
    endings=(".xlsx",),
    sniff=lambda head: head.startswith(workbook_cells.NEW),
    read=read,
    max_bytes=MAX_BYTES,
)
