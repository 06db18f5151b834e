"""Worksheets: their cells, and the table that one of them holds, as a CSV.

Only a cell that holds a number is a number. An error, a date, a truth value, a text or a formula without a stored value
is refused where a number belongs, with its place; a date or a truth value may be a word. A number counts as it is
stored, whatever its format shows, but for a percent format: its cells are shares, and only a column whose unit is one
has them. Rows that are hidden are read, and a note says so; merged cells are refused.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from gonio.errors import DataError
from gonio.formats.column_hints import are_units
from gonio.formats.reader import ANGLES, COLUMNS, EXTRA
from gonio.formats.text import csv_of

WORDS = ("polarisation", "side", "sample", "flag")
"""Columns of a measurement table that hold words."""
_OF_PERCENT = {"percent": 100.0, "relative-percent": 100.0, "factor": 1.0, "relative": 1.0}
"""By what a number in percent format is multiplied for each unit: it is stored as the share that it shows."""
Takes = Callable[[Iterable[str]], Mapping[str, str]]
Fits = Callable[[list[str]], bool]
"""Whether names are those of a table's header."""
MAX_PLACES = 4_000_000
"""Rows times columns, empty ones too: what the lines of the CSV take, four times the cells of a workbook."""


@dataclass(frozen=True)
class Odd:
    """A cell that is neither a number nor a text, and never becomes one that counts."""

    shown: str
    what: str
    """What it is and what to do, after `shown` in a message."""
    word: bool
    """Whether its text may stand in a column of words."""


class Percent(float):
    """A number whose cell shows a hundred times as much, by its number format."""


Cell = float | str | Odd


class Sheet(dict[tuple[int, int], Cell]):
    """The cells of a worksheet by (row, column), both from 0."""

    def __init__(self, cells: Mapping[tuple[int, int], Cell] | None = None) -> None:
        super().__init__(cells or {})
        self.merged: list[tuple[int, int, int, int]] = []
        """First row, last row, first column and last column of cells that are merged."""
        self.hidden: set[int] = set()
        """Rows that a spreadsheet does not show."""


def table_of(sheets: Sequence[Sheet], path: Path, fits: Fits, takes: Takes) -> tuple[bytes, list[str]]:
    """The table of the first worksheet that has a header which fits, as a CSV, and notes on what was taken.

    Where none has one, the first line of the first worksheet is the header.

    Raises
    ------
    DataError
        No worksheet has cells, one stands in a column without a name, or one is no number where one belongs.
    """
    full = [(number, sheet) for number, sheet in enumerate(sheets, start=1) if sheet]
    if not full:
        raise DataError(f"{path}: the workbook holds no cells")
    found = [(n, s, *place) for n, s in full for place in _places(s, fits)]
    number, sheet, first, _ = next(
        (one for one in found if one[3]), next(iter(found), (*full[0], min(row for row, _ in full[0][1]), False))
    )
    by_row = _rows(sheet)
    header, rows = _header(by_row[first], min(column for _, column in sheet)), len(by_row)
    where = f"{path}, worksheet {number}"
    if rows * len(header) > MAX_PLACES:
        raise DataError(
            f"{where}: {rows} rows of {len(header)} columns are more than {MAX_PLACES} places, "
            "most of them empty; leave out the columns that hold nothing"
        )
    units = takes(header.values())
    taken = {column: (name, units[name]) for column, name in header.items() if name in units}
    _require_unmerged(sheet, first, taken, where)
    percent = _in_percent(sheet, first, taken, where)
    lines: dict[int, list[str]] = {}
    units_row = min((row for row, _ in sheet if row > first), default=first)
    if not are_units([_shown(value) for (row, _), value in sheet.items() if row == units_row]):
        units_row = first
    at = {column: k for k, column in enumerate(header)}
    for (row, column), value in sheet.items():
        if row <= first:
            continue
        if column not in at:
            raise DataError(f"{where}, row {row + 1}: a cell in a column without a name; row {first + 1} names them")
        factor = percent.get(column, 1.0)
        if isinstance(value, float):
            text = repr(float(value) if factor == 1.0 else float(f"{value * factor:.16g}"))
        elif row == units_row:
            text = _shown(value)
        else:
            text = _taken(value, *taken[column], place(where, row, column)) if column in taken else _shown(value)
        lines.setdefault(row, [""] * len(at))[at[column]] = text
    notes = [f"worksheet {number} of {len(sheets)} is read"] if len(sheets) > 1 else []
    if first > min(row for row, _ in sheet):
        notes.append(f"the table begins at row {first + 1} of worksheet {number}; what stands above it is not read")
    notes += [f"the cells of {header[column]!r} are in percent format: 50 % of them is 0.5" for column in percent]
    if hidden := len(sheet.hidden & lines.keys()):
        notes.append(f"{hidden} hidden rows of worksheet {number} are read, too")
    return csv_of(header.values(), (lines[row] for row in sorted(lines))), notes


def place(where: str, row: int, column: int) -> str:
    """A place in a worksheet; row and column from 0."""
    from openpyxl.utils import get_column_letter

    return f"{where}, row {row + 1}, column {get_column_letter(column + 1)}"


def _taken(value: str | Odd, name: str, unit: str, at: str) -> str:
    """A cell that holds no number, in a column that is read; `DataError` where it does not belong there."""
    if isinstance(value, Odd) and not (value.word and not unit):
        raise DataError(f"{at}: {name} is {no_number(value)}")
    if isinstance(value, str) and unit and value.strip().lower() not in ("", "nan"):
        raise DataError(f"{at}: {name} is {no_number(value)}")
    return _shown(value)


def no_number(value: Cell | None) -> str:
    """What a cell is that should be a number, for messages."""
    if isinstance(value, Odd):
        return f"{value.shown}, {value.what}"
    if isinstance(value, str):
        return f"the text {value[:40]!r} and no number; format the column as a number, and turn its texts into numbers"
    if isinstance(value, Percent):
        return f"{100 * value:g} % by its number format; format it as a number"
    return "empty" if value is None else f"{value!r}"


def _in_percent(sheet: Sheet, first: int, taken: Mapping[int, tuple[str, str]], where: str) -> dict[int, float]:
    """The columns of numbers whose cells are in percent format, and by what to multiply these for their unit.

    Raises
    ------
    DataError
        A column's unit is no share, or only some of its cells are in percent format.
    """
    found: dict[int, dict[bool, int]] = {}
    for (row, column), value in sheet.items():
        if row > first and isinstance(value, float) and taken.get(column, ("", ""))[1]:
            found.setdefault(column, {}).setdefault(isinstance(value, Percent), row)
    every = {column: rows for column, rows in found.items() if True in rows}
    for column, rows in every.items():
        name, unit = taken[column]
        told = f"{place(where, rows[True], column)}: {name} is a number in percent format"
        if unit not in _OF_PERCENT:
            raise DataError(f"{told}, and {unit} is its unit; format it as a number, or name its unit with --columns")
        if False in rows:
            raise DataError(f"{told}, and that in row {rows[False] + 1} is not; format the column as one")
    return {column: _OF_PERCENT[taken[column][1]] for column in every}


def _require_unmerged(sheet: Sheet, first: int, taken: Mapping[int, object], where: str) -> None:
    """`DataError` for merged cells in columns that are read: only the first of them holds what all show."""
    for top, bottom, left, right in sheet.merged:
        filled = top > first and (top, left) in sheet and (bottom > top or right > left)
        if filled and any(left <= column <= right for column in taken):
            raise DataError(
                f"{place(where, top, left)}: is merged with the cells to {place('', bottom, right)[2:]}; unmerge them, "
                "and fill each one"
            )


def _rows(sheet: Sheet) -> dict[int, dict[int, Cell]]:
    """The cells of each row by their columns, in order."""
    out: dict[int, dict[int, Cell]] = {}
    for (row, column), value in sorted(sheet.items(), key=lambda cell: cell[0]):
        out.setdefault(row, {})[column] = value
    return out


def _header(cells: Mapping[int, Cell], left: int) -> dict[int, str]:
    """Names of the columns by their places, in a row; of a matrix the corner, in the column `left`, may be empty."""
    names = {column: _shown(value).strip() for column, value in cells.items()}
    numbers = all(isinstance(value, float) for value in cells.values())
    return {left: "", **names} if numbers and left not in names else names


def _places(sheet: Sheet, fits: Fits) -> Iterator[tuple[int, bool]]:
    """The rows whose cells are a header that fits, and whether every cell below stands under one of its names."""
    rows, left = _rows(sheet), min(column for _, column in sheet)
    for k, first in enumerate([*rows][:_HEADER_WITHIN]):
        header = _header(rows[first], left)
        if fits([*header.values()]):
            yield first, set().union(*[*rows.values()][k + 1 :]) <= header.keys()


_HEADER_WITHIN = 200
"""Rows in which a header is looked for."""


def _shown(value: Cell) -> str:
    return value if isinstance(value, str) else value.shown if isinstance(value, Odd) else repr(value)


def under_its_own_names(header: Iterable[str]) -> dict[str, str]:
    """The units of the columns of a measurement table; "" of words."""
    units = {name: "deg" for name in ANGLES} | {"wavelength_nm": "nm"} | dict.fromkeys(WORDS, "")
    known = (*COLUMNS, *EXTRA)
    return {name: units.get(name, "1/sr") for name in header if name in known or name.startswith("s_")}
