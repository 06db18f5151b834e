"""The command `gonio watch`. Nothing heavy is imported before it runs."""

from pathlib import Path
from typing import Annotated

import typer


def watch(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run; it need not exist yet.")],
    port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Port of the page; that of last time, or any that is free.")
    ] = None,
    host: Annotated[
        str, typer.Option(help="Address to serve at; other machines see the page at 0.0.0.0.")
    ] = "127.0.0.1",
    text: Annotated[bool, typer.Option("--text", help="Show the run in the terminal, too; end with it.")] = False,
) -> None:
    """Follow a run from another process, or look at one that has ended. Prints the page's address first."""
    from gonio_watch import serving

    serving.watch(run, host, port, text)
