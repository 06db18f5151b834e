"""Where the cells of a table made by hand stand: in a text, a worksheet or a Parquet file, a row a value or several.

The table is handed on with a row a value, whether its file has a column a wavelength or is a matrix.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gonio import polarisation
from gonio.errors import ConfigError, DataError
from gonio.formats import parquet, workbook
from gonio.formats.column_hints import are_units, unit_of
from gonio.formats.own_pairs import MATRIX, NUMBER, WIDE, Column, all_columns, pair_key
from gonio.formats.reader import SIDES
from gonio.formats.sheets import WORDS, Fits, Takes
from gonio.formats.text import BLANKS, CsvTable, cells_of, decode, header_in, lines_of, separator, table_from
from gonio.typing import Array

_ROWS, _HEADER = "#1", "header"
"""Where a matrix has theta_r and theta_i."""


@dataclass(frozen=True)
class Table:
    """The cells of a file, and what was said on the way to them."""

    cells: CsvTable
    notes: list[str]
    units: dict[str, str] = field(default_factory=dict)
    """What a row of units under the header says of each column, as `gonio.formats.column_hints` writes them."""
    units_line: int = 0


def as_text(data: bytes, path: Path, fits: Fits, takes: Takes = lambda _: {}) -> tuple[str, list[str]]:
    """The text of a table: its own, or that of a worksheet's or a Parquet file's cells as a CSV."""
    notes: list[str] = []
    if workbook.is_workbook(data):
        data, notes = workbook.as_csv(data, path, fits, takes)
    elif data.startswith(parquet.MAGIC):
        data = parquet.as_csv(data, path)
    return decode(data, path), notes


def table_of(data: bytes, path: Path, found: Mapping[str, Column]) -> Table:
    """The cells of the file, whose header is looked for."""
    named = [one.own for name, one in found.items() if not _is_given(name, one)]
    matrix = "brdf" in found and found["brdf"].own == MATRIX

    def takes(header: Iterable[str]) -> dict[str, str]:
        names = list(header)
        if matrix:
            angle = found.get("theta_r_deg", Column("", "deg")).unit
            return {name: found["brdf"].unit if k else angle for k, name in enumerate(names)}
        units = {column.own: column.unit for column in all_columns(found, names).values()}
        return units | {name: found["brdf"].unit for name, _ in _wide(found, names)}

    text, notes = as_text(data, path, lambda cells: _is_header(cells, found), takes)
    lines = lines_of(text)
    if not matrix and any(name.startswith("#") and name[1:].isdigit() for name in named):
        return _by_position(lines, path, found, notes)
    place = header_in(lines, lambda cells: _is_header(cells, found))
    first, mark = place if place is not None else (0, separator(text))
    cells = table_from(lines, first, mark, path)
    if missing := [name for name in named if name not in (_ROWS, _HEADER) and cells.header.count(name) != 1]:
        there = ", ".join(repr(name[:40]) for name in cells.header[:16])
        raise DataError(
            f"{path}, line {first + 1}: columns missing, or there twice: {', '.join(missing)}; the file has {there}"
        )
    out = _without_units(Table(cells, [*notes, *_skipped(first)]), lines, first, mark)
    if not out.cells.rows:
        raise DataError(f"{path}: has a header and no rows")
    return out


def units_under(lines: Sequence[str], first: int, header: Sequence[str], mark: str) -> tuple[int, dict[str, str]]:
    """The index of the row of units under a header at line `first`, and the unit of each column; 0 without one."""
    below = next((k for k in range(first + 1, len(lines)) if lines[k].strip()), 0)
    said = cells_of(lines[below], mark) if below else []
    if len(said) != len(header) or not are_units(said):
        return 0, {}
    return below, {name: unit for name, cell in zip(header, said, strict=True) if (unit := unit_of(cell))}


def _without_units(table: Table, lines: Sequence[str], first: int, mark: str) -> Table:
    """The table without a row of units under its header, which is told."""
    cells = table.cells
    below, units = units_under(lines, first, cells.header, mark)
    if not below:
        return table
    kept = [k for k, line in enumerate(cells.line_numbers) if line != below + 1]
    rows, numbers = [cells.rows[k] for k in kept], [cells.line_numbers[k] for k in kept]
    said = ", ".join(f"{name[:40]!r} [{unit}]" for name, unit in units.items())
    notes = [*table.notes, f"line {below + 1} is a row of units, and agrees with what is taken: {said}"]
    return Table(replace(cells, rows=rows, line_numbers=numbers), notes, units, below + 1)


def _skipped(first: int) -> list[str]:
    return [f"the table begins at line {first + 1}; what stands before it is not read"] if first else []


def _is_given(name: str, column: Column) -> bool:
    """Whether this may be no name of one column: a value for all rows, or a name for several columns."""
    if name == "brdf":
        return column.own in (*WIDE, MATRIX)
    return bool(NUMBER.fullmatch(column.own)) or column.own in GIVEN_WORDS.get(name, ())


GIVEN_WORDS = {"polarisation": polarisation.WORDS, "side": SIDES}


def _is_header(cells: list[str], found: Mapping[str, Column]) -> bool:
    """Whether these cells name every column that is needed."""
    if "brdf" in found and found["brdf"].own == MATRIX:
        return len(cells) > 1 and all(NUMBER.fullmatch(cell.replace(",", ".")) for cell in cells[1:])
    if any(cells.count(one.own) != 1 for name, one in found.items() if not _is_given(name, one)):
        return False
    if "brdf" in found and found["brdf"].own in WIDE:
        return bool(_wide(found, cells))
    return "brdf" in all_columns(found, cells)


def _by_position(lines: Sequence[str], path: Path, found: Mapping[str, Column], notes: list[str]) -> Table:
    """The table whose columns are named by their places, from the first line that has numbers there."""
    if others := [one.own for name, one in found.items() if not _is_given(name, one) and not one.own.startswith("#")]:
        raise DataError(f"{path}: a table without names has no {others[0]!r}; name all its columns as #1, #2, ...")
    places = {name: int(one.own[1:]) - 1 for name, one in found.items() if one.own.startswith("#")}
    numbers = [k for name, k in places.items() if name not in WORDS]

    def begins(cells: list[str]) -> bool:
        return len(cells) > max(places.values()) and all(
            k >= 0 and NUMBER.fullmatch(cells[k].replace(",", ".")) for k in numbers
        )

    place = header_in(lines, begins)
    if place is None:
        raise DataError(f"{path}: no line has numbers in the columns {', '.join(f'#{k + 1}' for k in sorted(numbers))}")
    first, mark = place
    width = len(lines[first].split()) if mark == BLANKS else lines[first].count(mark) + 1
    cells = table_from(lines, first, mark, path, [f"#{k}" for k in range(1, width + 1)])
    return Table(cells, [*notes, *_skipped(first)])


def _wide(found: Mapping[str, Column], header: Iterable[str]) -> list[tuple[str, float]]:
    """The columns of a file that have one wavelength each, and which [in the unit of their names]."""
    unit = WIDE.get(found["brdf"].own) if "brdf" in found else None
    if unit is None:
        return []
    pattern = re.compile(rf"\s*({NUMBER.pattern})\s*{unit}\s*", re.IGNORECASE)
    shown = [(name, pattern.fullmatch(name.replace(",", "."))) for name in header]
    return [(name, float(match[1])) for name, match in shown if match]


def unrolled(found: dict[str, Column], file: Table, where: str) -> tuple[dict[str, Column], CsvTable, dict[str, Array]]:
    """A table with a row a value, of one with several values a row; and what its header gives for each row."""
    table, notes = file.cells, file.notes
    own = found["brdf"].own if "brdf" in found else ""
    if own not in (*WIDE, MATRIX) or own in table.header:
        return found, table, {}
    if own == MATRIX:
        key, unit = "theta_i_deg", found.get("theta_i_deg", Column("", "deg")).unit
        wide = [(name, float(name.replace(",", "."))) for name in table.header[1:]]
        found.setdefault("theta_r_deg", Column(_ROWS, "deg"))
        for name, place in (("theta_r_deg", _ROWS), (key, _HEADER)):
            if found.get(name, Column(place, "")).own != place:
                raise ConfigError(
                    f"{where}: of a matrix {pair_key(name)} is in its {place}; write {pair_key(name)}={place}"
                )
        header = [_ROWS]
        notes.append(f"a matrix: theta_r in its rows, theta_i in its header ({_range(wide)})")
    else:
        key, unit = "wavelength_nm", WIDE[own] or "nm"
        wide = _wide(found, table.header)
        if key in found:
            raise ConfigError(f"{where}: wavelength is named, and brdf={own} takes it from the header; leave it out")
        header = [name for name in table.header if name not in dict(wide)]
        notes.append(f"brdf is in {len(wide)} columns, one a wavelength ({_range(wide)} {unit})")
    if len({value for _, value in wide}) < len(wide):
        raise DataError(f"{table.path}: two columns of {own!r} are of one value; leave one out")
    if len(said := {file.units.get(name, "") for name, _ in wide}) > 1:
        raise DataError(f"{table.path}, line {file.units_line}: {own!r} has several units: {', '.join(sorted(said))}")
    file.units.update({own: said.pop(), _ROWS: file.units.get(table.header[0], "") if own == MATRIX else ""})
    at = {name: k for k, name in enumerate(table.header)}
    kept = [0] if own == MATRIX else [at[name] for name in header]
    columns = [at[name] for name, _ in wide]
    rows = [[*(row[k] for k in kept), row[column]] for row in table.rows for column in columns]
    lines = [line for line in table.line_numbers for _ in columns]
    given: dict[str, Array] = {_HEADER: np.tile([value for _, value in wide], len(table.rows))}
    found[key] = replace(found.get(key, Column("", "")), own=_HEADER, unit=unit)
    return found, CsvTable(table.path, [*header, own], rows, lines, table.decimal), given


def _range(wide: Sequence[tuple[str, float]]) -> str:
    values = [value for _, value in wide]
    return f"{min(values):g} to {max(values):g}"
