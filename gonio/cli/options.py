"""What `gonio` itself takes, before any command; and what commands take that read tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gonio.cli import console

if TYPE_CHECKING:
    from gonio.measurement import Reading

Columns = Annotated[str | None, typer.Option(help="Names and units in a table of one's own: theta_i=ti:rad,brdf=f.")]


def _version(asked: bool) -> None:
    if asked:
        from gonio import __version__

        print(f"gonio {__version__}")
        raise typer.Exit


def options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version, and exit.", is_eager=True, callback=_version)
    ] = False,
) -> None:
    """A goniometer workbench: plan, measure, reduce, fit, compare and report BRDFs."""


def reading(columns: str | None) -> Reading:
    """What --columns says.

    Raises
    ------
    ConfigError
        --columns is written otherwise.
    """
    from gonio.formats import own_pairs
    from gonio.measurement import Reading

    return Reading(None if columns is None else own_pairs.pairs(columns))


def remember(specs: Sequence[str], how: Reading) -> None:
    """Write --columns beside the tables that they were right for, for the next command; say so."""
    from gonio import measurement
    from gonio.formats import own_pairs

    for path in (Path(measurement.split(spec)[0]) for spec in specs):
        said = own_pairs.remember(path, how.columns) if how.columns is not None and path.is_file() else None
        if said is not None:
            console.note(said)
