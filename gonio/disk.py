"""Files that are whole or not there: what a process that dies and a disk that is full may leave behind."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name in its folder, sync it to the disk, and rename it.

    Raises
    ------
    OSError
        It cannot be written; what was there before is there still, and nothing lies beside it.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.new")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def half_written(name: str, of: Iterable[str]) -> bool:
    """Whether `name` is that of a file among `of` which a process was writing when it died."""
    found = re.fullmatch(r"\.(.+)\.\d+\.new", name)
    return found is not None and found[1] in of


def sync_folder(folder: Path) -> None:
    """Wait until the names of a folder's files are on the disk too; raises `OSError`."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
