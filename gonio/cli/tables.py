"""`gonio convert`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="A measurement file, or a run.", show_default=False)],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The file to write.", show_default=False)],
    source_format: Annotated[
        str | None,
        typer.Option("--from", help="Format of IN, where neither content nor ending tell.", show_default=False),
    ] = None,
    target_format: Annotated[
        str | None, typer.Option("--to", help="Format of OUT, where its ending does not tell.", show_default=False)
    ] = None,
) -> None:
    """Convert a measurement between file formats, by file ending or by name."""
    from gonio import measurement
    from gonio.cli import console

    table = measurement.read(source, format=source_format)
    for remark in measurement.write(table, target, format=target_format):
        console.note(remark)
    console.show(f"{target}: {len(table)} values")
