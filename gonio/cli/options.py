"""What `gonio` itself takes, before any command."""

from __future__ import annotations

from typing import Annotated

import typer


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
