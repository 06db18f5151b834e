"""Tables of one's own in Excel workbooks, `.xlsx` and `.xls`: a worksheet with a header line, taken as a CSV.

The first line that holds all the columns that are needed names them, in the first worksheet that has one. It is read as
a CSV with these cells would be: under the measurement table's names, or under others that are named
(`gonio.formats.own_columns`). Numbers come out with every bit that the workbook holds;
those that are written have 16 digits.

Also here are the cells of Excel workbooks, of 1997 (xlrd) and of today (openpyxl), with bounds on what they unpack to.

A damaged or a hostile file ends in a `DataError`, after a time and with a memory that are bounded.
"""

import contextlib
import io
import itertools
import json
import re
import warnings
import zipfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import date, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from gonio.errors import DataError
from gonio.formats import native
from gonio.formats.column_hints import NEEDED
from gonio.formats.curve_sheets import curves
from gonio.formats.reader import NOT_XML, Format, require_held, write_bytes
from gonio.formats.sheets import Cell, Fits, Odd, Percent, Sheet, Takes, table_of, under_its_own_names
from gonio.formats.xml_text import require_plain
from gonio.shown import one_line
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

_ERROR = "an error and no number; mend what it comes from, or empty the cell where nothing was measured"
_DATE = "a date or a time and no number; format the column as a number, and enter the value again"
_BOOLEAN = "true or false and no number"
_FORMULA = "a formula without a stored value; open the workbook in a spreadsheet program, and save it"


def worksheets(data: bytes, path: Path) -> list[Sheet]:
    """The cells of each worksheet that are not empty.

    Raises
    ------
    DataError
        This is no such workbook, it is encrypted, damaged, or holds more than is read.
    """
    if not is_workbook(data):
        raise DataError(
            f"{path}: is no Excel workbook, whatever its name; save it as .xlsx, or name it .csv if it is one"
        )
    made = _of_1997(data) if data.startswith(OLD) else _of_today(data, path)
    out: list[Sheet] = []
    left = MOST_CELLS
    try:
        for sheet, rows in made:
            out.append(sheet)
            for row, column, value in rows:
                sheet[row, column] = value
                left -= 1
                if left < 0:
                    raise DataError(f"{path}: the workbook has more than {MOST_CELLS} cells")
    except (DataError, MemoryError):
        raise
    except Exception as error:  # what the libraries raise of damaged files is of any kind
        raise DataError(f"{path}: the workbook is damaged, encrypted, or none: {one_line(error)}") from None
    return out


Cells = Iterator[tuple[int, int, Cell]]


def _of_1997(data: bytes) -> Iterator[tuple[Sheet, Cells]]:
    import xlrd

    with xlrd.open_workbook(file_contents=data, logfile=io.StringIO(), on_demand=True, formatting_info=True) as book:
        for number in range(book.nsheets):
            found = book.sheet_by_index(number)
            sheet = Sheet()
            sheet.merged = [(top, end - 1, left, right - 1) for top, end, left, right in found.merged_cells]
            sheet.hidden = {row for row, info in found.rowinfo_map.items() if info.hidden}
            yield (
                sheet,
                (
                    (row, column, _old_cell(found, row, column))
                    for row in range(found.nrows)
                    for column, kind in enumerate(found.row_types(row))
                    if kind not in (xlrd.XL_CELL_EMPTY, xlrd.XL_CELL_BLANK)
                ),
            )
            book.unload_sheet(number)


def _old_cell(sheet: Any, row: int, column: int) -> Cell:
    import xlrd

    kind, value = sheet.cell_type(row, column), sheet.cell_value(row, column)
    if kind == xlrd.XL_CELL_NUMBER:
        book, place = sheet.book, sheet.cell_xf_index(row, column)
        known = book.format_map.get(book.xf_list[place].format_key) if place < len(book.xf_list) else None
        return Percent(value) if known is not None and _is_percent(known.format_str) else float(value)
    if kind == xlrd.XL_CELL_TEXT:  # no cell but a formula's holds an empty text
        return value or Odd("an empty text", f"or {_FORMULA}", word=False)
    if kind == xlrd.XL_CELL_ERROR:
        return Odd(xlrd.error_text_from_code.get(value, "an error"), _ERROR, word=False)
    if kind == xlrd.XL_CELL_BOOLEAN:
        return Odd("TRUE" if value else "FALSE", _BOOLEAN, word=True)
    try:
        shown = xlrd.xldate_as_datetime(value, sheet.book.datemode).isoformat(" ").removesuffix(" 00:00:00")
    except (ValueError, OverflowError):
        shown = f"{value:g}"
    return Odd(shown, _DATE, word=True)


def _of_today(data: bytes, path: Path) -> Iterator[tuple[Sheet, Cells]]:
    import openpyxl

    parts = _bounded(data, path)

    def opened(*, values: bool) -> Any:
        return openpyxl.load_workbook(io.BytesIO(data), read_only=True, data_only=values, keep_links=False)

    book = opened(values=True)
    formulas = opened(values=False).worksheets if any(part.formulas for part in parts.values()) else []
    stale = parts["xl/workbook.xml"].stale
    for number, found in enumerate(book.worksheets):
        part = parts.get(found._worksheet_path, _Part())
        sheet = Sheet()
        sheet.merged, sheet.hidden = part.merged, part.hidden
        others = [formulas[number]] if part.formulas else []
        yield sheet, _new_cells([found, *others], part, stale=stale)


def _new_cells(sheets: list[Any], part: "_Part", *, stale: bool) -> Cells:
    """The cells of a worksheet: of its values, and of its formulas where it has some."""
    for sheet in sheets:
        sheet.reset_dimensions()  # what a file says of its size is not believed
    percent: dict[str, bool] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a date beyond all calendars is told as the error that it becomes
        for rows in zip(*(sheet.iter_rows() for sheet in sheets), strict=True):
            for cell, *formula in zip(*rows, strict=True):
                value = _new_cell(cell, percent)
                if formula and formula[0].data_type == "f":
                    empty = value is None and (cell.data_type != "str" or cell.coordinate in part.bare)
                    if empty or (stale and value == 0.0):
                        said = formula[0].value
                        value = Odd(str(getattr(said, "text", said))[:60], _FORMULA, word=False)
                if value is not None:
                    yield cell.row - 1, cell.column - 1, value


def _new_cell(cell: Any, percent: dict[str, bool]) -> Cell | None:
    value = cell.value
    if value is None:
        return None
    if cell.data_type == "e":
        return Odd(str(value), _ERROR, word=False)
    if isinstance(value, bool):
        return Odd(str(value).upper(), _BOOLEAN, word=True)
    if isinstance(value, int | float):
        shown = cell.number_format
        if shown not in percent:
            percent[shown] = _is_percent(shown)
        return Percent(value) if percent[shown] else float(value)
    if isinstance(value, date | time | timedelta):  # a datetime is a date
        return Odd(str(value).removesuffix(" 00:00:00"), _DATE, word=True)
    return str(value)


def _is_percent(number_format: str) -> bool:
    """Whether numbers are shown times a hundred: a quoted or escaped percent sign only stands there."""
    return "%" in re.sub(r'"[^"]*"|\\.|\[[^\]]*\]', "", number_format).split(";")[0]


@dataclass(frozen=True)
class _Part:
    """What one part of an .xlsx workbook says beside its cells."""

    formulas: bool = False
    bare: frozenset[str] = frozenset()
    """Cells with a formula that gives a text, and no stored one."""
    stale: bool = False
    """Whether zeros that formulas have are what a program wrote that cannot compute them."""
    merged: list[tuple[int, int, int, int]] = field(default_factory=list)
    hidden: set[int] = field(default_factory=set)


_BARE = re.compile(
    r'<(?:\w+:)?c\s([^>]*\bt="str"[^>]*)>\s*<(?:\w+:)?f\b(?:[^>]*/>|[^>]*>[^<]*</[\w:]+>)\s*</(?:\w+:)?c>'
)
_MERGED = re.compile(r'<(?:\w+:)?mergeCell\s[^>]*?\bref="([A-Z]{1,3}\d{1,7}:[A-Z]{1,3}\d{1,7})"')
_HIDDEN = re.compile(r'<(?:\w+:)?row\s(?=[^>]*\bhidden="(?:1|true)")[^>]*?\br="(\d{1,7})"')


def _part(text: str) -> _Part:
    from openpyxl.utils.cell import range_boundaries

    merged = (range_boundaries(found) for found in _MERGED.findall(text))
    places = (re.search(r'\br="([A-Z]+\d+)"', found) for found in _BARE.findall(text))
    return _Part(
        formulas=re.search(r"<(\w+:)?f[\s>/]", text) is not None,
        bare=frozenset(place[1] for place in places if place),
        stale=re.search(r'\bfullCalcOnLoad="(1|true)"', text) is not None,
        merged=[(top - 1, bottom - 1, left - 1, right - 1) for left, top, right, bottom in merged],
        hidden={int(found) - 1 for found in _HIDDEN.findall(text)},
    )


def _bounded(data: bytes, path: Path) -> dict[str, _Part]:
    """What each part says; `DataError` for one that unpacks to more than is read, before any tree is made of it."""
    parts: dict[str, _Part] = {}
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = archive.namelist()
        if "xl/workbook.xml" not in names:
            raise DataError(f"{path}: {_other_zip(names)}")
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
                parts[name] = _part(require_plain(text, f"{path}: part {name!r}"))
    return parts


def _other_zip(names: Collection[str]) -> str:
    """What a zip is that is no .xlsx workbook, and what to do with it."""
    for name, what in (("META-INF/manifest.xml", "an OpenDocument file (.ods)"), ("xl/workbook.bin", "binary (.xlsb)")):
        if name in names:
            return f"is {what}, which is not read; open it in a spreadsheet program, and save it as .xlsx or as .csv"
    return "is a zip, but no Excel workbook; unpack it first"


ABOUT = "attributes of the table, as JSON"
MOST_ROWS = 1_048_576
MOST_TEXT = 30_000
"""Characters of a cell: Excel takes 32 767."""
MAX_BYTES = 64 * 2**20


def is_workbook(data: bytes) -> bool:
    """Whether the bytes begin as an Excel workbook does, of 1997 or of today."""
    return data.startswith((OLD, NEW))


def as_csv(data: bytes, path: Path, fits: Fits, takes: Takes = lambda _: {}) -> tuple[bytes, list[str]]:
    """The worksheet of a table as a CSV, and notes on which it is.

    `fits` tells whether a row is the table's header; `takes` of a header which of its columns are read, and their
    units; "" of words.

    Raises
    ------
    DataError
        It is no such workbook, is damaged, or holds nothing; a cell stands in a column without a name; a cell of a
        column that is read is no number where one belongs.
    """
    return table_of(worksheets(data, path), path, fits, takes)


def read(data: bytes, path: Path) -> DataFrame:
    """The measurement table in a workbook whose columns have the table's own names."""
    sheets = worksheets(data, path)
    text, notes = table_of(sheets, path, lambda names: set(NEEDED) <= set(names), under_its_own_names)
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
