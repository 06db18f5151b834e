"""What commands show: results on stdout, and how far long work is on stderr."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from gonio.progress import duration
from gonio.shown import visible

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.progress import Progress as ProgressBar
    from rich.table import Table

LINES = 20
"""Lines of progress where there is no terminal, at most, about."""
SILENT_S = 3.0
"""Work that is done sooner writes none of them."""


def show(*things: RenderableType) -> None:
    """Print results on stdout: tables are fitted to the terminal, and are plain text in a pipe."""
    from rich.table import Table

    console = terminal(stderr=False)
    for thing in things:
        if isinstance(thing, Table):
            for column in thing.columns:
                column.header = visible(str(column.header))
                column._cells = [visible(cell) if isinstance(cell, str) else cell for cell in column._cells]
        console.print(visible(thing) if isinstance(thing, str) else thing, highlight=False, markup=False)
        if isinstance(thing, Table):
            console.print()


def table(*headings: str, title: str | None = None) -> Table:
    """An empty table in the style of all commands; headings and title are plain text."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    heading = Text(visible(title), no_wrap=True, overflow="ignore") if title is not None else None
    return Table(
        *headings, title=heading, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD,
        show_edge=False, padding=(0, 1, 0, 0),
    )  # fmt: skip


def note(text: str) -> None:
    """One line for the person at the terminal, on stderr."""
    print(visible(text), file=sys.stderr, flush=True)


@contextlib.contextmanager
def counter(what: str, *, lines: bool = False) -> Iterator[Callable[[int, int], None]]:
    """Somebody who is told how much of a work is done: a bar on a terminal, which goes when it is done.

    Elsewhere nobody; with `lines` a few lines with the time that is left.
    """
    if not sys.stderr.isatty():
        yield _counted(what) if lines else lambda done, total: None
        return
    with progress_bar(what, terminal(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _counted(what: str) -> Callable[[int, int], None]:
    """A counter that writes at most about `LINES` lines, and none in the first seconds."""
    began, told = time.monotonic(), [0.0]

    def line(done: int, total: int) -> None:
        elapsed = time.monotonic() - began
        part = done / total
        if elapsed < SILENT_S or done >= total or not done or part - told[0] < 1.0 / LINES:
            return
        told[0] = part
        note(f"{what}: {done} of {total}, about {duration(elapsed / part - elapsed)} left")

    return line


def progress_bar(what: str, console: Console, *, transient: bool = False, own_rest: bool = False) -> ProgressBar:
    from rich import progress as bars

    columns = (
        bars.TextColumn(what), bars.BarColumn(None), bars.MofNCompleteColumn(),
        bars.TimeElapsedColumn(),
    )  # fmt: skip
    rest = (bars.TextColumn("left"), bars.TimeRemainingColumn())
    own = (bars.TextColumn("{task.fields[left]}"),)
    return bars.Progress(*columns, *(own if own_rest else rest), console=console, expand=True, transient=transient)


def terminal(*, stderr: bool) -> Console:
    from rich.console import Console

    out = Console(stderr=stderr, soft_wrap=False, emoji=False)
    # a table in a pipe is for grep: as wide as it needs to be
    return out if out.is_terminal else Console(stderr=stderr, width=max(out.width, 120), emoji=False)
