"""`gonio rig new`: a rig file for what is plugged in."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from gonio.cli import console
from gonio.cli.opened import require_new
from gonio.cli.rigs import app
from gonio.disk import put
from gonio.errors import ConfigError

if TYPE_CHECKING:
    from gonio.by_hand.new_rig import DriverPlugin

__all__ = ["app"]

NEEDED = "ports", "servos", "lamp_on", "is_release", "wiggle", "count_of"


@app.command("new")
def new_rig(
    out: Annotated[Path, typer.Option(help="The rig file to write.")] = Path("my.toml"),
    port: Annotated[
        list[str] | None, typer.Option(help="Look at this port; by default at all there are.", show_default=False)
    ] = None,
    answers: Annotated[
        Path | None, typer.Option(help="A TOML file with the answers: nobody is asked.", show_default=False)
    ] = None,
    driver: Annotated[str, typer.Option(help="The driver that the rig is for.")] = "lab",
) -> None:
    """Ask what a rig file needs, find ports, servos and lamp, and write the file, with a comment on each value."""
    from gonio import plugins
    from gonio.by_hand.new_rig import Answers, Person, make
    from gonio.config import read_toml

    require_new(out)
    plugin = plugins.load("gonio.rigs", driver)
    if not all(hasattr(plugin, name) for name in NEEDED):
        raise ConfigError(
            f'the driver "{driver}" cannot look for devices: gonio rig show {driver} > {out}, and edit it'
        )
    person: Person | Answers = (
        Answers(answers, read_toml(answers)) if answers is not None else Person(_line, console.note)
    )
    text, _ = make(cast("DriverPlugin", plugin), person, console.note, ports=port or ())
    put(out, text.encode())
    console.show(f"{out} is written; next: gonio rig check --rig {out}, then gonio rig align --rig {out}")


def _line(prompt: str) -> str:
    print(prompt, end="", file=sys.stderr, flush=True)
    line = sys.stdin.readline() if sys.stdin is not None else ""
    if not line:
        raise EOFError
    return line
