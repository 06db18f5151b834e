"""The cells of an Excel workbook of today (Office Open XML): as much of it as tables of numbers need.

A workbook is a zip of XML files. Nothing is unpacked that is larger than stated limits, and no document type is
followed, so that a damaged or a hostile file ends in a `DataError`, after a time and with a memory that are bounded.
ECMA-376 part 1, chapter 18, for the elements.
"""

from __future__ import annotations

import contextlib
import io
import posixpath
import re
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from gonio.errors import DataError
from gonio.formats._xls import Cell, Sheet

MAGIC = b"PK\x03\x04"
_MAX_PART = 128 * 2**20
"""Bytes of one part, unpacked."""
_MAX_CELLS = 1_000_000
_MAX_COLUMNS = 16_384
"""Of a worksheet, by the format's own limits."""
_MAX_ELEMENTS = 3 * _MAX_CELLS
"""Of one part: a cell has itself, its value, and what its row and its text add."""


def worksheets(data: bytes, path: Path) -> list[Sheet]:
    """The cells of each worksheet.

    Raises
    ------
    DataError
        This is no such workbook, it is encrypted, damaged, or unpacks to more than is read.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _Workbook(archive, path).sheets
    except DataError:
        raise
    except (zipfile.BadZipFile, zlib.error, RuntimeError, EOFError, OSError, ValueError, struct.error) as error:
        raise DataError(f"{path}: the workbook is damaged, or none: {str(error)[:80]}") from None


class _Workbook:
    """The parts of a workbook."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self.archive, self.path = archive, path
        self.left = _MAX_CELLS
        self.strings = self._strings()
        self.sheets = [self._cells(part) for part in self._parts()]

    def _part(self, name: str) -> ElementTree.Element:
        with self._parsing(name):
            return ElementTree.fromstring(self._text_of(name))

    @contextlib.contextmanager
    def _parsing(self, name: str) -> Iterator[None]:
        try:
            yield
        except (ElementTree.ParseError, ValueError, LookupError) as error:
            raise DataError(f"{self.path}: part {name!r} is not valid XML: {str(error)[:80]}") from None

    def _text_of(self, name: str) -> bytes:
        try:
            info = self.archive.getinfo(name)
        except KeyError:
            missing = f"it has no part {name[:60]!r}"
            raise DataError(f"{self.path}: is a zip, but no Excel workbook ({missing}); unpack it first") from None
        if info.file_size > _MAX_PART:
            raise DataError(f"{self.path}: part {name!r} unpacks to more than {_MAX_PART >> 20} MiB")
        with self.archive.open(info) as stream:
            text = stream.read(_MAX_PART + 1)
        if len(text) > _MAX_PART:
            raise DataError(f"{self.path}: part {name!r} unpacks to more than {_MAX_PART >> 20} MiB")
        if re.search(rb"<!(DOCTYPE|ENTITY)", text):
            raise DataError(f"{self.path}: part {name!r} has a document type, which no workbook needs")
        if text.count(b"<") > 2 * _MAX_ELEMENTS:  # counted before the tree is built, which takes most of the memory
            raise DataError(f"{self.path}: part {name!r} has more than {_MAX_ELEMENTS} elements, empty cells included")
        return text

    def _rows(self, name: str) -> Iterator[ElementTree.Element]:
        """The rows of a worksheet, each dropped when the next is asked for: a tree takes many times its text."""
        text, cells = io.BytesIO(self._text_of(name)), 0
        with self._parsing(name):
            root = None
            for event, element in ElementTree.iterparse(text, ("start", "end")):
                root = element if root is None else root
                tag = element.tag.rpartition("}")[2]
                if event == "end" and tag == "c":
                    cells += 1
                    if cells > _MAX_COLUMNS:
                        raise DataError(f"{self.path}: part {name!r} has more than {_MAX_COLUMNS} cells in a row")
                elif event == "end" and tag == "row":
                    yield element
                    cells = 0
                    element.clear()
                    for child in root:
                        if child.tag.rpartition("}")[2] == "sheetData":
                            child.clear()

    def _parts(self) -> list[str]:
        """Names of the worksheets' parts, in the order of the workbook."""
        targets = {
            link.get("Id"): str(link.get("Target"))
            for link in self._part("xl/_rels/workbook.xml.rels")
            if str(link.get("Type")).endswith("/worksheet")
        }
        names = []
        for sheet in self._part("xl/workbook.xml").iterfind(".//{*}sheet"):
            link = next((value for key, value in sheet.attrib.items() if key.endswith("}id")), None)
            if link in targets:
                names.append(posixpath.normpath(posixpath.join("/xl", targets[link])).removeprefix("/"))
        if not names:
            raise DataError(f"{self.path}: the workbook names no worksheet")
        return names

    def _strings(self) -> list[str]:
        if "xl/sharedStrings.xml" not in self.archive.namelist():
            return []
        return [_text(item) for item in self._part("xl/sharedStrings.xml").iterfind(".//{*}si")]

    def _cells(self, part: str) -> Sheet:
        cells: Sheet = {}
        row = -1
        for line in self._rows(part):
            row = _whole(line.get("r"), row + 2) - 1
            column = -1
            for cell in line.iterfind(".//{*}c"):
                place = re.fullmatch(r"([A-Z]{1,3})[0-9]+", str(cell.get("r")))
                column = _column(place[1]) if place else column + 1
                value = self._value(cell)
                if value is not None:
                    cells[row, column] = value
                    self.left -= 1
                    if self.left < 0:
                        raise DataError(f"{self.path}: the workbook has more than {_MAX_CELLS} cells")
        return cells

    def _value(self, cell: ElementTree.Element) -> Cell | None:
        kind = cell.get("t", "n")
        if kind == "inlineStr":
            return _text(cell)
        text = next((v.text for v in cell.iterfind(".//{*}v")), None)
        if not text:
            return None
        if kind == "s":
            number = _whole(text, -1)
            if not 0 <= number < len(self.strings):
                raise DataError(f"{self.path}: cell {cell.get('r')} names text {text[:20]!r}, which is not there")
            return self.strings[number]
        if kind in ("str", "e", "b"):
            return text
        try:
            return float(text)
        except ValueError:
            return text


def _text(element: ElementTree.Element) -> str:
    """All runs of a text, without the hints for its pronunciation."""
    hints = {id(t) for hint in element.iterfind(".//{*}rPh") for t in hint.iterfind(".//{*}t")}
    return "".join(t.text or "" for t in element.iterfind(".//{*}t") if id(t) not in hints)


def _whole(text: str | None, otherwise: int) -> int:
    return int(text) if text is not None and re.fullmatch(r"[0-9]{1,7}", text) else otherwise


def _column(letters: str) -> int:
    number = 0
    for letter in letters:
        number = 26 * number + ord(letter) - 64
    return number - 1
