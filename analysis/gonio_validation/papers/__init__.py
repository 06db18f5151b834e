"""The papers' own figures, made again: curves, verdicts on what the papers say about them, and a page for each."""

from __future__ import annotations

import difflib
import shutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from gonio import lost
from gonio.errors import ConfigError
from gonio.typing import JsonObject
from gonio_validation.papers.index import FIGURES
from gonio_validation.papers.pictures.catalogue import SHOWN

if TYPE_CHECKING:
    from gonio_validation.papers.figure import PaperFigure

PICTURES = "pictures"
"""Names the rendered figures: `gonio_validation.papers.pictures`."""
PAPERS = {"htsg": "htsg", "cook-torrance": "cook_torrance", "blinn": "blinn", "oren-nayar": "oren_nayar"}
"""Prefix of a figure's name -> module that builds it."""


def silent(text: str) -> None:
    """Nobody watches."""


def build(name: str, progress: Callable[[str], None] = silent) -> PaperFigure:
    """Curves, claims and drawings of a paper's figure.

    Parameters
    ----------
    name
        As in `FIGURES`: "htsg-8".
    progress
        Called with a line before each step.

    Raises
    ------
    ConfigError
        There is no such figure (with the nearest name).
    """
    check(name)
    paper, _, number = name.rpartition("-")
    page: PaperFigure = import_module(f"gonio_validation.papers.{PAPERS[paper]}").build(int(number), progress)
    return page


def check(name: str) -> None:
    """Raise `ConfigError` where there is no such figure."""
    if name not in FIGURES:
        known = [*FIGURES, *(shown.name for shown in SHOWN), "all", PICTURES, "list"]
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        hint = f'did you mean "{near[0]}"?' if near else '"gonio figures list" names them'
        raise ConfigError(f'there is no figure named "{name}"; {hint}')


def make(
    name: str,
    out: str | Path,
    *,
    radius: float | None = None,
    command: str = "",
    progress: Callable[[str], None] = silent,
) -> Path:
    """Write the page of a paper's figure, or of every figure: all of it or nothing.

    Parameters
    ----------
    name
        As in `FIGURES`, or "all": a folder for each figure, and an index page that links them.
    out
        Folder of the page; an earlier page there is replaced.
    radius
        Of the rim of every polar drawing; each by what it shows if none is given.
    command
        The command line, for the record.
    progress
        Called with a line before each step.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        There is no such figure, or the folder cannot be written or holds something else.
    Incomplete
        All is written, but for parts that could not be made (`gonio.lost`); of all figures, some.
    """
    from gonio_analysis.report import files

    from gonio_validation.papers import figure_page

    if name != "all":
        check(name)
    with files.staged(out) as stage:
        if name == "all":
            made = [_one_of_all(each, stage.work / each, command, radius, progress) for each in FIGURES]
            figure_page.write_index([one for one in made if one is not None], stage.work, command)
        else:
            figure_page.write(build(name, progress).of_radius(radius), stage.work, command)
    return Path(out) / "index.html"


def _one_of_all(
    name: str, folder: Path, command: str, radius: float | None, progress: Callable[[str], None]
) -> JsonObject | None:
    """A figure's page among those of all; what its summary holds. None, and no folder, where it cannot be made."""
    from gonio_validation.papers import figure_page

    def made() -> JsonObject:
        folder.mkdir()
        with lost.of_one_page(name):
            return figure_page.write(build(name, progress).of_radius(radius), folder, command)

    def instead(loss: lost.Loss) -> None:
        shutil.rmtree(folder)

    return lost.kept(f"the page of {name}", made, instead)
