"""The commands `gonio demo`, `figures` and `bench ...`. Nothing heavy is imported before one runs."""

from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from gonio_analysis.commands import Radius

from gonio.cli import console
from gonio.errors import ConfigError
from gonio.platform import command_line

NAME_HELP = 'A figure, as htsg-8; "all" of them; "pictures", all the rendered ones; or "list", which names them.'

bench = typer.Typer(help="Measure the workbench itself.", no_args_is_help=True)


def demo(
    out: Annotated[Path, typer.Option(help="Folder for everything that is made.")] = Path("gonio-demo"),
    quick: Annotated[bool, typer.Option("--quick", help="Fewer directions: done in seconds.")] = False,
) -> None:
    """Measure, reduce, fit and report one simulated sample. Prints the report's path last."""
    from gonio_validation.demonstration import run_demo

    print(run_demo(out, quick=quick))


def figures(
    name: Annotated[str, typer.Argument(metavar="NAME", help=NAME_HELP)],
    out: Annotated[Path | None, typer.Option(help="Folder of the page.")] = None,
    radius: Radius = "auto",
) -> None:
    """Make a paper's figure again, and judge the paper's claims. Prints the page's path."""
    from gonio_analysis.commands.arguments import read_radius

    from gonio_validation.papers import PICTURES, check
    from gonio_validation.papers.index import FIGURES
    from gonio_validation.papers.pictures.catalogue import SHOWN, TITLE

    rendered = {shown.name: shown.title for shown in SHOWN if shown.name not in FIGURES}
    if name == "list":
        rows = console.table("name", "what it shows")
        for key, what in (*FIGURES.items(), *rendered.items(), (PICTURES, TITLE)):
            rows.add_row(key, what)
        console.show(rows)
        return
    if name not in ("all", PICTURES, *rendered):
        check(name)
    if out is None:
        raise ConfigError(f"gonio figures {name}: --out DIR is missing, the folder of the page")
    if name == PICTURES or name in rendered:
        with console.counter("rendering") as step:
            _made("papers.pictures.page", out, figure=None if name == PICTURES else name, step=step)
    else:
        _made("papers", name, out, radius=read_radius(radius), progress=console.note)


def _made(module: str, *arguments: Any, **options: Any) -> None:
    """Make the page that a module of this package makes, with the command line for its record, and print its path."""
    print(import_module(f"gonio_validation.{module}").make(*arguments, command=command_line(), **options))


def verify(out: Annotated[Path | None, typer.Option(help="Folder of a page to sign.")] = None) -> None:
    """Check that this installation computes what it should. Exit code 1 where a part fails."""
    import tempfile

    from gonio_analysis.report import files

    from gonio_validation import verify as of_all

    if out is not None:
        files.require(out)
    with tempfile.TemporaryDirectory(prefix="gonio-verify-") as folder:
        found = of_all.verify(Path(folder), command_line(), console.note)
    console.note(found["conclusion"])
    if out is not None:
        print(of_all.make(out, found))
    if not found["passed"]:
        raise typer.Exit(1)


@bench.callback()
def _bench() -> None:
    """Measure the workbench itself."""


@bench.command()
def models(
    out: Annotated[Path, typer.Option(help="Folder of the report.")],
    sample: Annotated[Path | None, typer.Option(help="A measurement table: which model will do for it?")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few pairs: errors are right, times are rough.")] = False,
) -> None:
    """Which model will do, and speed against error of every way of evaluating them. Prints the report's path last."""
    _made("bench.speed_and_error", out, sample=sample, quick=quick, progress=console.note)
