"""The commands `gonio bench ...`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(help="Measure the workbench itself.", no_args_is_help=True)


@app.callback()
def bench() -> None:
    """Measure the workbench itself."""


@app.command()
def models(
    out: Annotated[Path, typer.Option(help="Folder of the report.", show_default=False)],
    quick: Annotated[bool, typer.Option("--quick", help="Few pairs: errors are right, times are rough.")] = False,
) -> None:
    """Speed against error of every way of evaluating the models. Also the hard cases; prints the report's path last."""
    from gonio.acquisition.run import command_line
    from gonio.cli import console
    from gonio_validation.bench.report import make

    print(make(out, quick=quick, command=command_line(), progress=console.note))
