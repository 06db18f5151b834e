"""The command `gonio` in this process: `gonio.cli.main` without the second that a process takes to start.

For what a command says and does. Signals, closed streams, imports and strangers' packages need a process of its own.
"""

import io
import os
import signal
import subprocess
import sys
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import pytest

from gonio import platform
from gonio.cli import application
from gonio.cli.signals import Ending

T = TypeVar("T")


def gonio(folder: Path, *arguments: str | Path, expect: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder: its exit code, which may have to be the one that is expected; and what it printed."""
    words = [str(argument) for argument in arguments]
    printed = io.BytesIO(), io.BytesIO()
    out, err = (io.TextIOWrapper(stream, encoding="utf-8", write_through=True) for stream in printed)
    with pytest.MonkeyPatch.context() as patch, open(os.devnull, encoding="utf-8") as nothing:
        patch.chdir(folder)
        for name, value in (("COLUMNS", "100"), ("NO_COLOR", "1"), ("TERM", "dumb")):
            patch.setenv(name, value)
        for name, stream in (("stdin", nothing), ("stdout", out), ("stderr", err)):
            patch.setattr(sys, name, stream)
        patch.setattr(sys, "argv", ["gonio", *words])
        heard = {number: signal.getsignal(number) for number in platform.ENDING}
        try:
            code = application.run(Ending())
        finally:  # a process that ends is deaf to its signals; this one goes on
            for number, handler in heard.items():
                signal.signal(number, handler)
    done = subprocess.CompletedProcess(words, code or 0, *(stream.getvalue().decode() for stream in printed))
    assert expect in (None, done.returncode), f"exit code {done.returncode}: {done.stdout}\n{done.stderr}"
    return done


def beside(site: str | Path, folder: Path, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a command that finds the packages of a folder, too; what it has imported of them is forgotten again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(site)
        try:
            return gonio(folder, *arguments)
        finally:
            for module in Path(site).glob("*.py"):
                sys.modules.pop(module.stem, None)


@contextmanager
def no_room_beyond(size: int) -> Iterator[None]:
    """The system writes no file beyond `size` bytes, in the middle of whatever writes it: as on a disk that is full."""
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def says(text: Container[str], *words: str) -> None:
    """A text has all these words in it; a list, all these texts."""
    for word in words:
        assert word in text, f"{word!r} is not in\n{text}"


def some(found: T | None) -> T:
    """What was looked for, which has to be there."""
    assert found is not None
    return found
