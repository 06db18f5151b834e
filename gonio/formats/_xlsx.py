"""The cells of an Excel workbook of today (Office Open XML): as much of it as tables of numbers need.

A workbook is a zip of XML files. Nothing is unpacked that is larger than stated limits, and no document type is
followed, so that a damaged or a hostile file ends in a `DataError`, after a time and with a memory that are bounded.
ECMA-376 part 1, chapter 18, for the elements.
"""

from __future__ import annotations

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
_MAX_ELEMENTS = 4_000_000
"""Elements of one part, empty cells among them: a small file may hold very many, and each takes memory and time."""


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

    def _part(self, name: str) -> bytes:
        try:
            info = self.archive.getinfo(name)
        except KeyError:
            missing = f"it has no part {name[:60]!r}"
            raise DataError(f"{self.path}: is a zip, but no Excel workbook ({missing}); unpack it first") from None
        with self.archive.open(info) as stream:
            text = stream.read(_MAX_PART + 1)
        if len(text) > _MAX_PART:
            raise DataError(f"{self.path}: part {name!r} unpacks to more than {_MAX_PART >> 20} MiB")
        if re.search(rb"<!(DOCTYPE|ENTITY)", text):
            raise DataError(f"{self.path}: part {name!r} has a document type, which no workbook needs")
        return text

    def _elements(self, name: str) -> Iterator[ElementTree.Element]:
        """The elements of a part as they end, the innermost first; the last is the root.

        A row of a worksheet is emptied once it was given out: a whole sheet is never in memory.
        """
        count, rows = 0, []
        try:
            for event, element in ElementTree.iterparse(io.BytesIO(self._part(name)), events=("start", "end")):
                kind = element.tag.rpartition("}")[2]
                if event == "start":
                    count += 1
                    if count > _MAX_ELEMENTS:
                        raise DataError(
                            f"{self.path}: part {name!r} has more than {_MAX_ELEMENTS} elements; if most cells are "
                            "empty, save the filled ones as a workbook of their own"
                        )
                    if kind == "sheetData":
                        rows.append(element)
                    continue
                yield element
                if kind == "row" and rows:
                    rows[-1].clear()
        except (ElementTree.ParseError, ValueError, LookupError) as error:
            raise DataError(f"{self.path}: part {name!r} is not valid XML: {str(error)[:80]}") from None

    def _root(self, name: str) -> ElementTree.Element:
        """The whole of a part."""
        root = ElementTree.Element("")
        for element in self._elements(name):
            root = element
        return root

    def _parts(self) -> list[str]:
        """Names of the worksheets' parts, in the order of the workbook."""
        targets = {
            link.get("Id"): str(link.get("Target"))
            for link in self._root("xl/_rels/workbook.xml.rels")
            if str(link.get("Type")).endswith("/worksheet")
        }
        names = []
        for sheet in self._root("xl/workbook.xml").iterfind(".//{*}sheet"):
            link = next((value for key, value in sheet.attrib.items() if key.endswith("}id")), None)
            if link in targets:
                names.append(posixpath.normpath(posixpath.join("/xl", targets[link])).removeprefix("/"))
        if not names:
            raise DataError(f"{self.path}: the workbook names no worksheet")
        return names

    def _strings(self) -> list[str]:
        if "xl/sharedStrings.xml" not in self.archive.namelist():
            return []
        return [_text(item) for item in self._root("xl/sharedStrings.xml").iterfind(".//{*}si")]

    def _cells(self, part: str) -> Sheet:
        cells: Sheet = {}
        row = -1
        for line in (e for e in self._elements(part) if e.tag.rpartition("}")[2] == "row"):
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
