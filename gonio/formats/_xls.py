"""The cells of an Excel 97 workbook (BIFF8 in a compound file): as much of it as instruments' exports need.

Every chain and count is checked against the file's size, so that a damaged file ends in a `DataError` with the byte
offset where it is wrong, after a time and with a memory that its size bounds.
[MS-CFB] for the compound file, [MS-XLS] for the records.
"""

from __future__ import annotations

import struct
from pathlib import Path

from gonio.errors import DataError

MAGIC = bytes.fromhex("d0cf11e0a1b11ae1")
_END, _FREE = 0xFFFFFFFE, 0xFFFFFFFA
_MAX_CELLS = 1_000_000

Cell = float | str
Sheet = dict[tuple[int, int], Cell]
"""Numbers and texts by (row, column), both from 0."""


def worksheets(data: bytes, path: Path) -> list[Sheet]:
    """The cells of each worksheet.

    Raises
    ------
    DataError
        This is not such a workbook, it is encrypted, or it is damaged (with the byte offset).
    """
    stream = _Compound(data, path).stream(("Workbook", "Book"))
    return _Workbook(stream, path).sheets


class _Compound:
    """The compound file: a little file system of 512-byte sectors."""

    def __init__(self, data: bytes, path: Path) -> None:
        self.data = data
        self.path = path
        if len(data) < 1024 or data[:8] != MAGIC:
            raise DataError(f"{path}: is not an Excel 97 workbook")
        self.size = 1 << struct.unpack_from("<H", data, 30)[0] if data[30] in (9, 12) and data[31] == 0 else 0
        if not self.size:
            raise DataError(f"{path}, byte 30: the sector size is none of this format's")
        self.table = self._sectors_of_table()

    def _sectors_of_table(self) -> list[int]:
        sectors = [s for s in struct.unpack_from("<109I", self.data, 76) if s < _FREE]
        (following, _) = struct.unpack_from("<2I", self.data, 68)
        limit = len(self.data) // self.size + 1
        seen = 0
        while following < _FREE:
            block = self._sector(following, 68)
            numbers = struct.unpack(f"<{self.size // 4}I", block)
            sectors += [s for s in numbers[:-1] if s < _FREE]
            following = numbers[-1]
            seen += 1
            if seen > limit:
                raise DataError(f"{self.path}, byte 68: the table of sectors runs in a circle")
        if len(sectors) > limit:
            raise DataError(f"{self.path}, byte 76: the table of sectors is longer than the file")
        out: list[int] = []
        for sector in sectors:
            out += struct.unpack(f"<{self.size // 4}I", self._sector(sector, 76))
        return out

    def _sector(self, number: int, named_at: int) -> bytes:
        start = (number + 1) * self.size
        block = self.data[start : start + self.size]
        if not block:
            raise DataError(f"{self.path}, byte {named_at}: sector {number} lies beyond the end of the file")
        return block.ljust(self.size, b"\0")

    def _chain(self, first: int, named_at: int) -> bytes:
        parts: list[bytes] = []
        number = first
        most = len(self.data) // self.size + 1
        while number < _FREE:
            parts.append(self._sector(number, named_at))
            if number >= len(self.table) or len(parts) > most:
                raise DataError(f"{self.path}, byte {named_at}: a chain of sectors does not end")
            number = self.table[number]
        return b"".join(parts)

    def stream(self, names: tuple[str, ...]) -> bytes:
        directory = self._chain(struct.unpack_from("<I", self.data, 48)[0], 48)
        for at in range(0, len(directory) - 127, 128):
            length = struct.unpack_from("<H", directory, at + 64)[0]
            name = directory[at : at + max(0, min(length, 64) - 2)].decode("utf-16-le", "replace")
            if name in names and directory[at + 66] == 2:
                first, size = struct.unpack_from("<2I", directory, at + 116)
                content = self._chain(first, 48)
                if size < 4096 or size > len(content):
                    raise DataError(f'{self.path}, byte 48: the stream "{name}" has {size} bytes; it is damaged')
                return content[:size]
        raise DataError(f"{self.path}, byte 48: the file holds no workbook")


class _Workbook:
    """The records of the workbook's stream."""

    def __init__(self, stream: bytes, path: Path) -> None:
        self.stream = stream
        self.path = path
        self.cells: dict[tuple[int, int], Cell] = {}
        self.strings: list[str] = []
        self.sheets: list[dict[tuple[int, int], Cell]] = []
        count = 0
        for start in self._globals():
            self.cells = {}
            self._rows(start)
            self.sheets.append(self.cells)
            count += len(self.cells)
            if count > _MAX_CELLS:
                raise DataError(f"{path}: the workbook has more than {_MAX_CELLS} cells")

    def _record(self, at: int) -> tuple[int, bytes, int]:
        if at + 4 > len(self.stream):
            raise DataError(f"{self.path}: the workbook ends within a record (byte {at} of its stream)")
        kind, length = struct.unpack_from("<2H", self.stream, at)
        body = self.stream[at + 4 : at + 4 + length]
        if len(body) < length:
            raise DataError(f"{self.path}: the workbook ends within a record (byte {at} of its stream)")
        return kind, body, at + 4 + length

    def _globals(self) -> list[int]:
        """Read the shared strings; where the worksheets start."""
        at = 0
        starts: list[int] = []
        while True:
            kind, body, following = self._record(at)
            if at == 0 and (kind != 0x0809 or body[:2] != b"\x00\x06"):
                raise DataError(f"{self.path}: is not a workbook of Excel 97 or later (BIFF8)")
            if kind == 0x002F:
                raise DataError(f"{self.path}: the workbook is encrypted")
            if kind == 0x0085 and len(body) >= 6 and body[5] == 0:
                starts.append(struct.unpack_from("<I", body)[0])
            if kind == 0x00FC:
                blocks = [body]
                while self._record(following)[0] == 0x003C:
                    _, more, following = self._record(following)
                    blocks.append(more)
                self._shared_strings(blocks, at)
            if kind == 0x000A:
                break
            at = following
        if not starts or len(starts) != len(set(starts)) or len(starts) > 256:
            raise DataError(f"{self.path}: the workbook names {len(starts)} worksheets; 1 to 256, each once, are read")
        return starts

    def _shared_strings(self, blocks: list[bytes], at: int) -> None:
        def damaged() -> DataError:
            return DataError(f"{self.path}: the table of texts is damaged (byte {at} of the workbook's stream)")

        block, pos = 0, 8
        count = struct.unpack_from("<I", blocks[0], 4)[0] if len(blocks[0]) >= 8 else 0
        if count > sum(map(len, blocks)):
            raise damaged()

        def take(length: int) -> bytes:
            nonlocal block, pos
            out = b""
            while len(out) < length:
                if pos >= len(blocks[block]):
                    block, pos = block + 1, 0
                    if block >= len(blocks):
                        raise damaged()
                piece = blocks[block][pos : pos + length - len(out)]
                out += piece
                pos += len(piece)
            return out

        for _ in range(count):
            length, flags = struct.unpack("<HB", take(3))
            runs = struct.unpack("<H", take(2))[0] if flags & 8 else 0
            extra = struct.unpack("<I", take(4))[0] if flags & 4 else 0
            text = ""
            while len(text) < length:
                if pos >= len(blocks[block]):  # a text that goes on in the next block repeats its first flag there
                    flags = take(1)[0]
                wide = 2 if flags & 1 else 1
                room = (len(blocks[block]) - pos) // wide
                if room == 0:
                    raise damaged()
                piece = take(min(length - len(text), room) * wide)
                text += piece.decode("utf-16-le" if wide == 2 else "latin-1", "replace")
                if wide == 2 and len(text) > length:
                    raise damaged()
            take(4 * runs)
            take(extra)
            self.strings.append(text)

    def _rows(self, at: int) -> None:
        kind, body, at = self._record(at)
        if kind != 0x0809:
            raise DataError(f"{self.path}: the worksheet does not begin where the workbook says")
        while True:
            start = at
            kind, body, at = self._record(at)
            if kind == 0x000A:
                return
            try:
                self._cell(kind, body)
            except (struct.error, IndexError):
                raise DataError(f"{self.path}: a cell is damaged (byte {start} of the workbook's stream)") from None
            if len(self.cells) > _MAX_CELLS:
                raise DataError(f"{self.path}: the worksheet has more than {_MAX_CELLS} cells")

    def _cell(self, kind: int, body: bytes) -> None:
        if kind not in (0x0203, 0x027E, 0x00BD, 0x00FD, 0x0006, 0x0204):
            return
        row, column = struct.unpack_from("<2H", body)
        if kind == 0x0203:
            self.cells[row, column] = struct.unpack_from("<d", body, 6)[0]
        elif kind == 0x027E:
            self.cells[row, column] = _rk(struct.unpack_from("<I", body, 6)[0])
        elif kind == 0x00BD:
            for k in range((len(body) - 6) // 6):
                self.cells[row, column + k] = _rk(struct.unpack_from("<I", body, 6 + 6 * k)[0])
        elif kind == 0x00FD:
            self.cells[row, column] = self.strings[struct.unpack_from("<I", body, 6)[0]]
        elif kind == 0x0006:
            if body[12:14] != b"\xff\xff":
                self.cells[row, column] = struct.unpack_from("<d", body, 6)[0]
        else:
            length, flags = struct.unpack_from("<HB", body, 6)
            encoding, wide = ("utf-16-le", 2) if flags & 1 else ("latin-1", 1)
            self.cells[row, column] = body[9 : 9 + wide * length].decode(encoding, "replace")


def _rk(value: int) -> float:
    """[MS-XLS] RkNumber: the upper 30 bits of a float, or an integer; bit 0 divides by 100."""
    if value & 2:
        signed = value - (1 << 32) if value & 0x80000000 else value
        number = float(signed >> 2)
    else:
        number = struct.unpack("<d", struct.pack("<Q", (value & 0xFFFFFFFC) << 32))[0]
    return number / 100 if value & 1 else number
