"""Whether an HDF5 file is whole: a seal behind its end tells, and of files without one a look by another process.

HDF5 itself keeps no checksum of plain arrays and of long attributes, and its library does not come back from some
damages. So the bytes are compared before it sees them.
"""

import io
import re
import subprocess
import sys
import zlib
from functools import lru_cache
from pathlib import Path

from gonio import platform
from gonio.disk import only_file
from gonio.errors import DataError

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""How an HDF5 file begins; where other bytes come first, at 512, 1024, 2048 and so on."""
SEAL = re.compile(rb"\ngonio-seal crc32 ([0-9a-f]{8})\n")
LENGTH = len(b"\ngonio-seal crc32 01234567\n")
END_AT = slice(28, 36)
"""Where versions 2 and 3 of a file's first block say where HDF5 ends."""
PIECE = 1 << 22
REMEDY = "remove it and make it anew, or fetch a copy"
LOOK_S = 8
"""Longest time of a processor for a look; the usual one takes 0.3 s, most of it the start of Python."""
WAIT_S = 120.0
"""Longest wait for it, on a busy computer or one that knows no limit of a processor's time."""
LOOK = """
import itertools, sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[2]), int(sys.argv[2])))
except ImportError:
    pass
import h5py
def tried(read):
    try:
        return read()
    except Exception:
        return None
with h5py.File(sys.argv[1], "r") as file:
    names = list(itertools.islice(file, 1000))
    own = [n for n in names if type(tried(lambda: file.get(n, getlink=True))) is h5py.HardLink]
    for one in (file, *filter(None, (tried(lambda: file[n]) for n in own))):
        for name in itertools.islice(one.attrs, 1000):
            tried(lambda: one.attrs[name])
        for dimension in getattr(one, "dims", ()):
            tried(lambda: list(dimension))
"""
"""Reads what a library may not come back from. What it merely refuses, it refuses whoever reads the file next, too."""


def seal(path: Path) -> None:
    """Add its checksum to a finished file, behind the end that HDF5 knows, and wait until all is on the disk.

    A program that opens the file to change it takes the seal away: HDF5 cuts a file to its own length then.

    Raises
    ------
    OSError
        The disk is full.
    """
    with open(path, "r+b") as file:
        found = _checksum(file, file.seek(0, io.SEEK_END))
        file.write(_told(found))
        file.flush()
        platform.sync(file.fileno())


def sealed(data: bytes) -> bytes:
    """The bytes of a file with their seal, as `seal` adds it."""
    return data + _told(zlib.crc32(data))


def _told(checksum: int) -> bytes:
    return b"\ngonio-seal crc32 %08x\n" % checksum


def look(path: str | Path) -> bool:
    """Whether a file is HDF5, and not damaged as far as can be told before its values are read.

    Raises
    ------
    DataError
        It is damaged.
    """
    try:
        there = Path(path).stat()
        return _look(str(path), there.st_size, there.st_mtime_ns, there.st_ino)
    except OSError:  # who reads it says why it cannot be read
        return False


@lru_cache(maxsize=64)
def _look(path: str, size: int, _changed: int, _number: int) -> bool:
    with open(path, "rb", opener=only_file) as file:
        head = file.read(END_AT.stop)
        file.seek(max(size - LENGTH, 0))
        told = SEAL.fullmatch(file.read(LENGTH))
        if told is not None:
            if _checksum(file, size - LENGTH) != int(told[1], 16):
                raise DataError(f"{path}: is damaged: its bytes are not those that were written; {REMEDY}")
            return True
        end = int.from_bytes(head[END_AT], "little")
        told_end = head.startswith(SIGNATURE) and len(head) == END_AT.stop and head[8] in (2, 3)
        if told_end and size < end:
            raise DataError(f"{path}: is damaged: it is truncated to {size} of {end} bytes; {REMEDY}")
        if told_end and size - end == LENGTH:
            raise DataError(f"{path}: is damaged: the checksum at its end cannot be read; {REMEDY}")
        at = 0
        while at < size and not _signed(file, at):
            at = max(512, 2 * at)
    if at < size:
        _look_from_afar(path)
    return at < size


def _signed(file: io.BufferedReader, at: int) -> bool:
    file.seek(at)
    return file.read(len(SIGNATURE)) == SIGNATURE


def _checksum(file: io.BufferedIOBase, size: int) -> int:
    """CRC-32 of the first `size` bytes."""
    file.seek(0)
    found = 0
    while size > 0 and (piece := file.read(min(PIECE, size))):
        found, size = zlib.crc32(piece, found), size - len(piece)
    return found


def _look_from_afar(path: str) -> None:
    """Raise `DataError` where HDF5's library does not come back from a file, or dies of it."""
    try:
        ended = subprocess.run(
            [sys.executable, "-P", "-c", LOOK, path, str(LOOK_S)],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=WAIT_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise DataError(
            f"{path}: HDF5 does not get through it in {WAIT_S:g} s: it is damaged ({REMEDY}), or this computer is too"
            " busy (try again)"
        ) from None
    if ended.returncode < 0:
        raise DataError(f"{path}: is damaged: HDF5 does not get through it; {REMEDY}")
