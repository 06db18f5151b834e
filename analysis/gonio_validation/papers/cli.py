"""The command `gonio figures`. Nothing heavy is imported before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

NAME_HELP = 'A figure, as htsg-8; "all"; or "list", which names them.'


def figures(
    name: Annotated[str, typer.Argument(metavar="NAME", help=NAME_HELP, show_default=False)],
    out: Annotated[Path | None, typer.Option(help="Folder of the page.", show_default=False)] = None,
) -> None:
    """Make a paper's figure again, and judge the paper's claims. Prints the page's path."""
    from gonio.acquisition.run import command_line
    from gonio.cli import console
    from gonio.errors import ConfigError
    from gonio_validation.papers import FIGURES, check, make

    if name == "list":
        rows = console.table("name", "what it shows")
        for key, what in FIGURES.items():
            rows.add_row(key, what)
        console.show(rows)
        return
    if name != "all":
        check(name)
    if out is None:
        raise ConfigError(f"gonio figures {name}: --out DIR is missing, the folder of the page")
    print(make(name, out, command=command_line(), progress=console.note))
