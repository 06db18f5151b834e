"""The folder of a report: what it holds, and all of it or nothing."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gonio import platform
from gonio.disk import MANIFEST, NOT_OWN, foreign_files, manifest_of, remove_own, require_name, write_manifest
from gonio.errors import ConfigError
from gonio_analysis.report import html, pdf
from gonio_analysis.result_records import as_json

if TYPE_CHECKING:
    from gonio_analysis.report.blocks import Page
    from gonio_analysis.report.drawings import Figure

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a write that name no file."""


@dataclass(frozen=True)
class Staged:
    """A folder in the making."""

    work: Path
    """Where to write now."""
    final: Path
    """Where it will be."""


@contextmanager
def staged(folder: str | Path) -> Iterator[Staged]:
    """A temporary folder beside `folder` that takes its place when the block ends, and vanishes when the block fails.

    An earlier report in `folder` is replaced where nothing else lies there and no file of it was changed since, as its
    manifest tells (`gonio.disk`). What a killed process had begun beside it is tidied up.

    Raises
    ------
    ConfigError
        The folder cannot be written, or holds something that this program did not write.
    """
    shown = Path(folder)
    require_name(shown)
    final = shown.resolve()  # where the folder is a link its target is replaced, and the link stays
    _check(final, shown)
    made: list[Path] = []
    try:
        for parent in reversed([final.parent, *final.parent.parents]):
            if not parent.exists():
                parent.mkdir()
                made.append(parent)
        _tidy(final)
        work = _beside(final, "part")
    except OSError as error:
        _remove(made)
        raise ConfigError(f"{shown}: cannot be written: {error.strerror}") from None
    try:
        mask = os.umask(0)  # it is read by being set
        os.umask(mask)
        work.chmod(0o777 & ~mask)
        write_manifest(work, {})
        yield Staged(work, final)
        write_manifest(work, manifest_of(work))
        _check(final, shown)  # once more: somebody may have put something there meanwhile
        _put(work, final)
    except BaseException as error:
        shutil.rmtree(work, ignore_errors=True)
        _remove(made)
        if isinstance(error, OSError) and (error.errno in FULL or str(work.parent) in str(error.filename)):
            raise ConfigError(f"{shown}: cannot be written: {error.strerror}") from None
        raise


def write(folder: Path, summary: object, figures: Iterable[Figure] = ()) -> None:
    """Write `summary.json` and the drawings (`figures/`, as SVG and PNG) into a folder that exists."""
    for figure in figures:
        drawn = folder / "figures"
        drawn.mkdir(exist_ok=True)
        (drawn / f"{figure.name}.svg").write_text(figure.svg, encoding="utf-8", newline="\n")
        (drawn / f"{figure.name}.png").write_bytes(figure.png)
    text = json.dumps(as_json(summary), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n", encoding="utf-8", newline="\n")


def write_page(
    folder: Path, page: Page, summary: object, figures: Iterable[Figure] = (), *, printed: bool = False
) -> None:
    """Write `index.html`, and with it what `write` writes; `printed` as `report.pdf`, too."""
    write(folder, summary, figures)
    (folder / "index.html").write_text(html.document(page), encoding="utf-8", newline="\n")
    if printed:
        pdf.write(folder / "report.pdf", [page])


def _check(final: Path, shown: Path) -> None:
    try:
        if final.is_dir():
            foreign = foreign_files(final, {})
            if foreign:
                names = ", ".join(foreign[:5]) + (" ..." if len(foreign) > 5 else "")
                raise ConfigError(
                    f"{shown}: holds what {NOT_OWN} ({names}), and is not replaced; move it away, or choose another "
                    "folder with --out"
                )
        elif os.path.lexists(final):
            raise ConfigError(f"{shown}: is a file; --out names a folder")
    except OSError as error:
        raise ConfigError(f"{shown}: cannot be read: {error.strerror}") from None


def _put(work: Path, final: Path) -> None:
    if not final.exists():
        os.rename(work, final)
        return
    old = _beside(final, "old")
    try:
        os.rename(final, old / "report")
        try:
            os.rename(work, final)
        except OSError:
            os.rename(old / "report", final)
            raise
    finally:
        _discard(old)


def _discard(old: Path) -> None:
    """Remove an earlier report that was moved aside; what is not our own in it stays where it is then."""
    with suppress(OSError):
        if (old / "report").is_dir():
            remove_own(old / "report", {})
        old.rmdir()


def _beside(final: Path, what: str) -> Path:
    """A new hidden folder beside the report, whose name tells the process that made it."""
    return Path(tempfile.mkdtemp(prefix=f".{final.name}.{os.getpid()}.", suffix=f".{what}", dir=final.parent))


def _tidy(final: Path) -> None:
    """Remove the hidden folders of processes that died; a report that one had moved aside comes back."""
    for left in final.parent.iterdir():
        found = re.fullmatch(rf"\.{re.escape(final.name)}\.(\d+)\.\w+\.(part|old)", left.name)
        if found is None or platform.is_alive(int(found[1])):
            continue
        if left.is_symlink() or not left.is_dir():
            continue
        if (left / "report").is_dir() and not final.exists():
            os.rename(left / "report", final)
        if found[2] == "part" and (left / MANIFEST).is_file():
            shutil.rmtree(left, ignore_errors=True)
        else:
            _discard(left)


def _remove(folders: list[Path]) -> None:
    for folder in reversed(folders):
        folder.rmdir()
