"""Tables of one's own in Excel workbooks, `.xlsx` and `.xls`: a worksheet with a header line, taken as a CSV.

A worksheet's first line that is not empty names the columns. It is read as a CSV with these cells would be: under the
measurement table's names, or under others that are named (`gonio.formats.own_columns`). Of several worksheets the first
is taken whose header has all the columns that are needed. Numbers come out with every bit that the workbook holds;
those that are written have 16 digits.
"""

import contextlib
import io
import itertools
import json
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import DataError
from gonio.formats import native, workbook_cells
from gonio.formats.curve_sheets import curves
from gonio.formats.reader import Format, write_bytes
from gonio.formats.text import csv_of
from gonio.typing import DataFrame

ABOUT = "attributes of the table, as JSON"
MOST_ROWS = 1_048_576
MOST_TEXT = 30_000
"""Characters of a cell: Excel takes 32 767."""
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
    return _table_of(workbook_cells.worksheets(data, path), path, needed)


def _table_of(sheets: Sequence[workbook_cells.Sheet], path: Path, needed: Collection[str]) -> tuple[bytes, list[str]]:
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


def _header(sheet: workbook_cells.Sheet) -> dict[int, str]:
    """Names of the columns by their places: the first line that is not empty."""
    first = min(row for row, _ in sheet)
    return {column: _cell(value).strip() for (row, column), value in sorted(sheet.items()) if row == first}


def _cell(value: float | str) -> str:
    return value if isinstance(value, str) else repr(value)


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a workbook whose columns have the table's own names."""
    sheets = workbook_cells.worksheets(data, path)
    text, notes = _table_of(sheets, path, native.NEEDED)
    stored = _stored(sheets)
    frame = native.read(io.BytesIO(text), path, stored)
    frame.attrs["notes"] = [*([] if stored else notes), *frame.attrs["notes"]]
    return frame


def _stored(sheets: Sequence[workbook_cells.Sheet]) -> Any:
    """The attributes that `write` has put on a sheet of their own; None where there is none."""
    for sheet in sheets:
        if sheet.get((0, 0)) == ABOUT:
            with contextlib.suppress(ValueError):
                return json.loads("".join(str(v) for (row, column), v in sorted(sheet.items()) if row and not column))
    return None


def write(frame: DataFrame, path: Path) -> None:
    """A sheet of the whole table, one a curve, and one of the table's attributes; numbers to 16 digits."""
    from openpyxl import Workbook

    if len(frame) >= MOST_ROWS or frame.size > workbook_cells.MOST_CELLS // 2:
        raise DataError(f"{path}: {len(frame)} rows are too many for a workbook; write .parquet or .csv")
    every = list(curves(frame, path))
    book = Workbook(write_only=True)
    _fill(book.create_sheet("table"), list(frame.columns), [frame[name].tolist() for name in frame.columns])
    names: set[str] = {"table", "about"}
    shown = ("wavelength_nm", "brdf", "u_brdf", "flag")
    for curve in every:
        header = ["viewing angle [deg]", "wavelength [nm]", "BRDF [1/sr]", "u(BRDF) [1/sr]", "flag"]
        columns = [curve.signed_deg.tolist(), *(curve.rows[name].tolist() for name in shown)]
        _fill(book.create_sheet(_sheet_name(curve.name, names)), header, columns)
    text = json.dumps(native.plain(frame.attrs), ensure_ascii=True, allow_nan=False)
    parts = [text[k : k + MOST_TEXT] for k in range(0, len(text), MOST_TEXT)]
    _fill(book.create_sheet("about"), [ABOUT], [parts])
    buffer = io.BytesIO()
    book.save(buffer)
    write_bytes(path, buffer.getvalue())


def _fill(sheet: Any, header: list[str], columns: list[list[Any]]) -> None:
    sheet.append(header)
    for row in zip(*columns, strict=True):
        sheet.append(
            [None if value == "" or (isinstance(value, float) and np.isnan(value)) else value for value in row]
        )


def _sheet_name(name: str, taken: set[str]) -> str:
    """A name that Excel takes, and that no other sheet has."""
    plain = re.sub(r"[\[\]:*?/\\']", "-", name)[:27] or "curve"
    numbered = (f"{plain} {count}" for count in itertools.count(2))
    out = next(one for one in itertools.chain([plain], numbered) if one.lower() not in taken)
    taken.add(out.lower())
    return out


FORMAT = Format(
    name="xlsx",
    title="Excel workbook with a measurement table's columns",
    endings=(".xlsx",),
    sniff=lambda head: head.startswith(workbook_cells.NEW),
    read=read,
    write=write,
    max_bytes=MAX_BYTES,
    carries=native.FORMAT.carries,
)
