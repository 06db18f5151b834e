"""Text files: lines, cells and numbers, every error naming the file and the line.

Everything that is no number where one belongs is a `DataError`.
"""

import csv
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gonio.errors import DataError
from gonio.typing import Floats

MAX_LINES = 5_000_000
"""Most lines of a text that is read line by line."""


class Text:
    """The lines of a text file, for readers whose messages name the line."""

    def __init__(self, data: bytes, path: Path) -> None:
        self.path = path
        self.lines = decode(data, path).splitlines()

    def where(self, line: int) -> str:
        """`file, line N`, for the line with index `line`."""
        return f"{self.path}, line {line + 1}"


def require_text(data: bytes, path: Path, most: int | None = None) -> None:
    """`DataError` where bytes hold control characters, so that they are no text at all, or far too many lines."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise DataError(f"{path}, byte 0: is text in UTF-16; save it as UTF-8")
    bad = re.search(rb"[\x00-\x08\x0e-\x1f\x7f]", data)
    if bad:
        raise DataError(f"{path}: byte {bad.start()} is {bad.group()[0]:#04x}: not a text file, or a damaged one")
    most = MAX_LINES if most is None else most
    if sum(data.count(end) for end in (b"\n", b"\r", b"\v", b"\f", b"\x85", b"\xe2\x80")) > 2 * most:
        raise DataError(f"{path}: has more than {most} lines, the most that are read")


def decode(data: bytes, path: Path) -> str:
    """Text as UTF-8, or as Latin-1 where it is not UTF-8 (old instruments' comments).

    Raises
    ------
    DataError
        The bytes hold control characters, so they are no text at all; or far too many lines.
    """
    require_text(data, path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


_LOOKED_AT = 65_536, 20
"""Characters and lines of a CSV from which its separator is told."""


def separator(text: str) -> str:
    """What separates the cells of a CSV that begins with its header: a comma, or a semicolon, or a tab.

    It is the mark that the header has outside its quotes, and the rows as often. Of several, the one that is there most
    often, and rather no comma: the one in "R (632,8 nm)" and the decimal commas below it separate nothing.
    """
    most, lines = _LOOKED_AT
    first = re.match(r"(?:[^\S\r\n]*[\r\n]+)*([^\r\n]*)", text)
    if first is not None and not ("\t" in first[1] or ";" in first[1]):
        return ","
    header, *rows = [line for line in re.split(r"[\r\n]+", text[:most]) if line.strip()][:lines] or [""]

    def count(line: str, mark: str) -> int:
        return re.sub(r'"[^"]*"', "", line).count(mark)

    def rank(mark: str) -> tuple[bool, int]:
        often = count(header, mark)
        return sum(count(row, mark) == often for row in rows) * 2 >= len(rows), often

    marks = [mark for mark in "\t;," if count(header, mark)]
    return max(marks, key=rank, default=",")


def column_names(head: bytes) -> list[str]:
    """The names in the first line of a CSV, to tell its format by."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip().decode("latin-1")
    line = re.split(r"[\r\n]", text, maxsplit=1)[0]
    return [name.strip().strip('"').strip() for name in line.split(separator(text))]


_MARKED = re.compile(r"[+-]?\d*[.,]\d*(?:[eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
"""What may be a whole number as well, with a mark between its thousands."""


class DecimalMark:
    """The decimal mark of the numbers in a file whose cells are not separated by commas: one for the whole file.

    A comma beside points is a mark between thousands, or the reverse, and which of them nobody can tell.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.seen: dict[str, tuple[str, str]] = {}
        """The first number with each mark: where it stands, and its cell."""
        self.unsettled: tuple[str, str, str] | None = None
        """The first number that may be one of thousands, beside one without a mark: where, its cell, and that one's."""
        self.settled = False

    def plain(self, cells: Sequence[str], where: Callable[[int], str], name: str) -> Sequence[str]:
        """The cells of a column with decimal points; `where(k)` says where cell k stands.

        Raises
        ------
        DataError
            A cell has the other mark than one before, or both.
        """
        joined = "\n".join(cells)
        if "," not in joined and "." not in joined:
            return cells
        for mark in ",.":
            if mark in joined and mark not in self.seen:
                k = next(k for k, cell in enumerate(cells) if mark in cell)
                self.seen[mark] = f"{where(k)}, {name}", cells[k].strip()
        if len(self.seen) > 1:
            (at, one), (there, other) = self.seen[","], self.seen["."]
            raise DataError(
                f"{at} is {_shown(one)}, and {there} is {_shown(other)}: decimal commas and points in one file; "
                "write all numbers with one of them, and without marks between thousands"
            )
        self._settle(cells, where, name)
        return [cell.replace(",", ".") for cell in cells] if "," in joined else cells

    def _settle(self, cells: Sequence[str], where: Callable[[int], str], name: str) -> None:
        """Heed what tells a decimal mark from one between thousands."""
        if self.settled:
            return
        marked = [(k, cell.strip()) for k, cell in enumerate(cells) if "," in cell or "." in cell]
        self.settled = any(_MARKED.fullmatch(cell) and not _THOUSANDS.fullmatch(cell) for _, cell in marked)
        whole = next((cell.strip() for cell in cells if re.fullmatch(r"\s*[+-]?[1-9]\d*\s*", cell)), None)
        if not self.settled and self.unsettled is None and whole is not None and marked:
            self.unsettled = f"{where(marked[0][0])}, {name}", marked[0][1], whole

    def require_settled(self) -> None:
        """`DataError` where nothing in the file tells whether 1,234 beside 987 is 1.234 or 1234."""
        if self.unsettled is not None and not self.settled:
            at, cell, whole = self.unsettled
            raise DataError(
                f"{at} is {_shown(cell)} beside {_shown(whole)}, and no number of the file tells whether its mark is a "
                f"decimal one; write {_shown(cell.replace(',', '').replace('.', ''))}, or {_shown(cell + '0')}"
            )

    def notes(self) -> list[str]:
        """What was taken, as a sentence, where there were decimal commas."""
        return [f"numbers have decimal commas, as {self.seen[','][1]}"] if "," in self.seen else []


@dataclass(frozen=True)
class CsvTable:
    """A CSV of numbers under a header: the cells as text, and where each row stands."""

    path: Path
    header: list[str]
    rows: list[list[str]]
    line_numbers: list[int]
    decimal: DecimalMark | None
    """The decimal mark of its numbers, where cells are separated by something else than commas; else a point."""

    def column(self, name: str, *, estimates: bool = False) -> Floats:
        """The numbers of a column; `DataError` naming the line of the first cell that is none.

        Among measured values (`estimates`) an empty cell is NaN.
        """
        k, read = self.header.index(name), estimate if estimates else number
        cells: Sequence[str] = [row[k] for row in self.rows]
        if self.decimal is not None:
            cells = self._plain(cells, name, self.decimal)
        return np.array([read(cell, self.where(j), name) for j, cell in enumerate(cells)])

    def _plain(self, cells: Sequence[str], name: str, decimal: DecimalMark) -> Sequence[str]:
        """The cells of a column with decimal points."""
        plain = decimal.plain(cells, self.where, name)
        if decimal.unsettled is not None and not decimal.settled:
            mark = "," if "," in decimal.unsettled[1] else "."
            marked = (cell.strip() for row in self.rows for cell in row if mark in cell)
            decimal.settled = any(_MARKED.fullmatch(cell) and not _THOUSANDS.fullmatch(cell) for cell in marked)
            decimal.require_settled()
        return plain

    def angles(self, name: str, limit_deg: float, told: str) -> Floats:
        """The angles of a column; `DataError`, with what is told, where one lies beyond +- the limit [degrees]."""
        angles = self.column(name)
        for row in np.flatnonzero(np.abs(angles) > limit_deg)[:1]:
            raise DataError(f"{self.where(int(row))}: {name} = {angles[row]:g}{told}")
        return angles

    def words(self, name: str) -> list[str]:
        """The cells of a column as text."""
        return [row[self.header.index(name)].strip() for row in self.rows]

    def where(self, row: int) -> str:
        """`file, line N`, for the row with index `row`."""
        return f"{self.path}, line {self.line_numbers[row]}"

    def notes(self) -> list[str]:
        """How the numbers of the columns that were read are written, where that is not as in Python."""
        return [] if self.decimal is None else self.decimal.notes()


def csv_table(data: bytes, path: Path, needed: Sequence[str]) -> CsvTable:
    """A CSV with a header line that has at least the `needed` columns; every row as long as the header.

    Cells are separated by commas, or else by semicolons or tabs, and then a number may have a decimal comma.

    Raises
    ------
    DataError
        A column is missing or there twice, a row is too long or too short (with its line), or there are no rows.
    """
    text = decode(data, path)
    table = table_from(lines_of(text), 0, separator(text), path)
    if missing := [name for name in needed if table.header.count(name) != 1]:
        there = ", ".join(repr(name[:40]) for name in table.header[:16])
        raise DataError(f"{path}, line 1: columns missing, or there twice: {', '.join(missing)}; the file has {there}")
    if not table.rows:
        raise DataError(f"{path}: has a header and no rows")
    return table


BLANKS = " "
"""As a separator: any run of blanks."""
_COMMENT = re.compile(r"\A\s*(?:#|%|//|!)+")
_HEADER_WITHIN = 200
"""Lines in which a header is looked for."""


def lines_of(text: str) -> list[str]:
    """The lines of a text with their ends."""
    return list(io.StringIO(text, newline=""))


def cells_of(line: str, mark: str) -> list[str]:
    """The cells of one line, without a comment's mark before them; names apart by two blanks may hold single ones."""
    bare = _COMMENT.sub("", line, count=1).strip("\r\n")
    if mark == BLANKS:
        return re.split(r"\s{2,}|\t", bare.strip()) if re.search(r"\S\s{2,}\S", bare) else bare.split()
    return [cell.strip() for cell in next(csv.reader([bare], delimiter=mark), [])]


def header_in(
    lines: Sequence[str], holds: Callable[[list[str]], bool], within: int = _HEADER_WITHIN
) -> tuple[int, str] | None:
    """The first line whose cells are a header by `holds`, with rows as long as it; and what separates them."""
    for first, line in enumerate(lines[:within]):
        for mark in ("\t", ";", ",", BLANKS):
            for cells in (cells_of(line, mark), line.split()) if mark == BLANKS else (cells_of(line, mark),):
                if holds(cells) and _followed(lines[first + 1 :], len(cells), mark):
                    return first, mark
    return None


def _followed(lines: Sequence[str], count: int, mark: str) -> bool:
    """Whether most of the next lines have so many cells; a header may end its file."""
    rows = [line for line in lines[: 2 * _LOOKED_AT[1]] if line.strip() and not _COMMENT.match(line)][: _LOOKED_AT[1]]
    return 2 * sum(len(_split(row, mark)) == count for row in rows) >= len(rows)


def _split(line: str, mark: str) -> list[str]:
    return line.split() if mark == BLANKS else next(csv.reader([line.strip("\r\n")], delimiter=mark), [])


def table_from(
    lines: Sequence[str], first: int, mark: str, path: Path, header: Sequence[str] | None = None
) -> CsvTable:
    """The table that begins with line `first`: with its header, or with rows where a `header` is given.

    Blank lines are left out, and comments (`#`) that are no rows.

    Raises
    ------
    DataError
        A row is too long or too short, with its line.
    """
    rows: dict[int, list[str]] = {}
    begin = first
    if header is None:
        begin = next((k for k in range(first, len(lines)) if lines[k].strip()), len(lines))
    if header is None and mark == BLANKS and begin < len(lines):
        width = len(lines[begin + 1].split()) if begin + 1 < len(lines) else 0
        split = cells_of(lines[begin], mark)
        header = split if len(split) == width else _COMMENT.sub("", lines[begin], count=1).split()
        begin += 1
    taken = list(header or ())
    if mark == BLANKS:
        for number, line in enumerate(lines[begin:], begin + 1):
            if line.strip() and not _is_remark(cells := line.split(), taken):
                require_cells(cells, taken, f"{path}, line {number}")
                rows[number] = cells
        return CsvTable(path, taken, list(rows.values()), list(rows), DecimalMark(path))
    reader = csv.reader(lines[begin:], delimiter=mark, strict=True)
    try:
        for cells in reader:
            number = begin + reader.line_num
            if not taken and any(map(str.strip, cells)):
                taken = [cell.strip() for cell in cells]
                taken[0] = _COMMENT.sub("", taken[0], count=1).strip() if len(taken) > 1 else taken[0]
            elif any(map(str.strip, cells)) and not _is_remark(cells, taken):
                require_cells(cells, taken, f"{path}, line {number}")
                rows[number] = cells
    except csv.Error as error:
        raise DataError(f"{path}, line {begin + reader.line_num}: {error}") from None
    return CsvTable(path, taken, list(rows.values()), list(rows), None if mark == "," else DecimalMark(path))


def _is_remark(cells: Sequence[str], header: Sequence[str]) -> bool:
    return cells[0].lstrip().startswith("#") and len(cells) != len(header)


def require_cells(cells: Sequence[str], header: Sequence[str], where: str) -> None:
    """`DataError` unless a row has as many cells as the header."""
    if len(cells) != len(header):
        raise DataError(f"{where}: {len(cells)} cells, and the header names {len(header)} columns")


def csv_of(header: Iterable[str], rows: Iterable[Iterable[str]]) -> bytes:
    """The bytes of a CSV of texts."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([header, *rows])
    return out.getvalue().encode()


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def number(text: str, where: str, what: str) -> float:
    """One finite decimal number.

    Raises
    ------
    DataError
        The text is not a number, or beyond the range of a float; names `where` and `what`.
    """
    text = text.strip()
    if not text.isascii() or not _NUMBER.fullmatch(text):
        raise DataError(f"{where}: {what} is {_shown(text)}, not a number")
    value = float(text)
    if not math.isfinite(value):
        raise DataError(f"{where}: {what} = {_shown(text)} is beyond the range of a float")
    return value


def integer(text: str, where: str, what: str, lower: int, upper: int) -> int:
    """One integer from `lower` to `upper`; else `DataError`."""
    value = number(text, where, what)
    if value != int(value) or not lower <= value <= upper:
        raise DataError(f"{where}: {what} = {_shown(text.strip())}; an integer from {lower} to {upper} is needed")
    return int(value)


def estimate(text: str, where: str, what: str) -> float:
    """A measured value: a number, or NaN for an empty cell or the word nan, where nothing was measured."""
    return math.nan if text.strip().lower() in ("", "nan") else number(text, where, what)


def numbers(
    cells: Sequence[str], where: str, names: Sequence[str], read: Callable[[str, str, str], float] = number
) -> list[float]:
    """The numbers (or by `read` the estimates) of one line; `names[k]` names cell k in messages."""
    joined = "".join(cells)
    if joined.isascii() and "_" not in joined:
        try:
            values = [float(cell) for cell in cells]
        except ValueError:
            values = [math.nan]  # named below
        if all(map(math.isfinite, values)):
            return values
    return [read(cell, where, name) for cell, name in zip(cells, names, strict=True)]


def _shown(text: str) -> str:
    return json.dumps(text if len(text) <= 40 else text[:37] + "...", ensure_ascii=False)


_FORMULA = re.compile(r"'*[=+\-@\t\r\n＝＋－＠]")


def cell_of(word: str) -> str:
    """A text as a cell of a CSV, with an apostrophe before what a spreadsheet would run as a formula."""
    return f"'{word}" if _FORMULA.match(word) else word


def plain_word(cell: str) -> str:
    """The text that `cell_of` made a cell of."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell
