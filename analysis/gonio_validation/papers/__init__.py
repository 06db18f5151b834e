"""The papers' own figures, made again: curves, verdicts on what the papers say about them, and a page for each."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.errors import ConfigError

if TYPE_CHECKING:
    from gonio_validation.papers.figure import PaperFigure

FIGURES = {
    "htsg-7": "rough aluminium at 2.0 µm: a specular spike over a weak lobe",
    "htsg-8": "the same aluminium at 0.5 µm: off-specular lobes, and a spike at 75 degrees",
    "htsg-9": "magnesium oxide ceramic: uniform diffuse, and what emerges at grazing incidence",
    "htsg-10": "sandpaper at normal incidence: bright at grazing reflection",
    "htsg-11": "smooth blue plastic: spikes over a uniform diffuse part, absolute",
    "cook-torrance-3": "Beckmann's and the Gaussian facet distribution, gentle and steep",
    "cook-torrance-4": "spectrum of a copper mirror, and of the daylight that it reflects",
    "cook-torrance-5": "reflectance and colour of copper over the angle of incidence",
    "blinn-5": "Phong's and Torrance and Sparrow's highlights at 30 degrees",
    "blinn-6": "the same at 70 degrees",
    "oren-nayar-5": "radiance of a rough diffuse surface, with and without interreflection",
    "oren-nayar-6": "its BRDF over the incidence, and its radiance outside the plane",
    "oren-nayar-8": "wall plaster",
    "oren-nayar-9": "white sand",
    "oren-nayar-10": "foam: body and surface reflection",
    "oren-nayar-11": "cotton towel: body and surface reflection",
    "oren-nayar-13": "brightness across a clay vase",
}
"""Name and subject of every figure that can be made, in the order of the index."""
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
        near = difflib.get_close_matches(name.lower(), [*FIGURES, "all", PICTURES, "list"], n=1, cutoff=0.5)
        hint = f'did you mean "{near[0]}"?' if near else '"gonio figures list" names them'
        raise ConfigError(f'there is no figure named "{name}"; {hint}')


def make(name: str, out: str | Path, *, command: str = "", progress: Callable[[str], None] = silent) -> Path:
    """Write the page of a paper's figure, or of every figure: all of it or nothing.

    Parameters
    ----------
    name
        As in `FIGURES`, or "all": a folder for each figure, and an index page that links them.
    out
        Folder of the page; an earlier page there is replaced.
    command
        The command line, for the record.
    progress
        Called with a line before each step.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError
        There is no such figure, or the folder cannot be written or holds something else.
    """
    from gonio_analysis.report import files

    from gonio_validation.papers import figure_page

    if name != "all":
        check(name)
    with files.staged(out) as stage:
        if name == "all":
            made = []
            for each in FIGURES:
                folder = stage.work / each
                folder.mkdir()
                made.append(figure_page.write(build(each, progress), folder, command))
            figure_page.write_index(made, stage.work, command)
        else:
            figure_page.write(build(name, progress), stage.work, command)
    return Path(out) / "index.html"
