"""What of a page could not be made: it is named there and on the terminal, and takes nothing else along.

While a page is being made (`collecting`), an error of one of its parts is noted and the rest is made. Elsewhere it is
raised, as ever. What ends everything is raised in either case: an interruption, want of memory, a full disk. So it is
with a calibration and its picture.
"""

import errno
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from gonio.errors import Incomplete, Interrupted

T = TypeVar("T")
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a write that name no file."""
MOST_WORDS = 400
"""Characters of an error that are shown."""


@dataclass(frozen=True)
class Loss:
    """A part of a page that could not be made."""

    part: str
    error: str
    """Its type and its message, on one line."""

    @property
    def words(self) -> str:
        """As in 'section "spread" could not be made: ZeroDivisionError: division by zero'."""
        return f"{self.part} could not be made: {self.error}"


def incomplete(page: Path, losses: Sequence[Loss]) -> Incomplete:
    """The error that a command ends with whose page, or other file, lacks something."""
    many = "a part is" if len(losses) == 1 else f"{len(losses)} parts are"
    says = ", as the page says" if page.suffix == ".html" else ""
    lines = [f"{page}: written, but {many} missing{says}:", *(f"  {x.words}" for x in losses)]
    if not os.environ.get("GONIO_TRACEBACK"):
        lines.append("  GONIO_TRACEBACK=1 shows where")
    return Incomplete(page, "\n".join(lines))


_losses: ContextVar[list[Loss] | None] = ContextVar("losses", default=None)


@contextmanager
def collecting() -> Iterator[list[Loss]]:
    """What is lost meanwhile, as it comes."""
    losses = list[Loss]()
    before = _losses.set(losses)
    try:
        yield losses
    finally:
        _losses.reset(before)


@contextmanager
def whole(page: Path) -> Iterator[None]:
    """Raise `Incomplete` once `page` is written, where something was lost meanwhile."""
    with collecting() as losses:
        yield
    if losses:
        raise incomplete(page, losses)


@contextmanager
def of_one_page(name: str) -> Iterator[None]:
    """One page of several: it names its own losses alone, and the page of all of them names them, too."""
    every = _losses.get()
    if every is None:
        yield
        return
    with collecting() as own:
        yield
    every.extend(Loss(f"{name}: {one.part}", one.error) for one in own)


def so_far() -> list[Loss]:
    """What the page that is being made has lost until now."""
    return list(_losses.get() or ())


def kept(part: str, make: Callable[[], T], instead: Callable[[Loss], T]) -> T:
    """What `make` returns; where it fails while a page is being made, what stands in its place.

    Parameters
    ----------
    part
        What it is, for messages: 'section "spread"'.
    make, instead
        Makes it; what there is without it.
    """
    try:
        return make()
    except Exception as error:
        losses = _losses.get()
        if losses is None or _ends_all(error):
            raise
        if os.environ.get("GONIO_TRACEBACK"):
            traceback.print_exception(error, file=sys.stderr)
        loss = Loss(part, said(error))
        if loss not in losses:
            losses.append(loss)
        return instead(loss)


def said(error: BaseException) -> str:
    """An error in one line, of characters that every file can hold."""
    try:
        text = " ".join(str(error).split())
    except Exception:  # a class of somebody else
        text = ""
    text = text.encode("utf-8", "backslashreplace").decode()
    text = "".join(c if c.isprintable() else "?" for c in text)
    text = text if len(text) <= MOST_WORDS else f"{text[:MOST_WORDS]} ..."
    return f"{type(error).__name__}: {text}".removesuffix(": ")


def _ends_all(error: BaseException) -> bool:
    """Whether an error is of the whole: of memory or a disk, or what a library made of an interruption."""
    if isinstance(error, MemoryError | Interrupted):
        return True
    if isinstance(error, OSError) and error.errno in (*FULL, errno.ENOMEM):
        return True
    before: BaseException | None = error
    while before is not None:
        if isinstance(before, KeyboardInterrupt):
            return True
        before = before.__cause__ or before.__context__
    return False
