"""The commands `gonio demo`, `figures` and `bench ...`. Nothing heavy is imported before one runs."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from gonio_analysis.commands import Dask, Radius

from gonio.cli import console
from gonio.errors import ConfigError

Jobs = Annotated[int | None, typer.Option(help="Processes. [default: one a processor]")]
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
    from gonio.platform import command_line

    if None not in (options.get("jobs"), options.get("dask")):
        raise ConfigError("--jobs: counts processes here, and --dask names a cluster; leave one of them out")
    print(import_module(f"gonio_validation.{module}").make(*arguments, command=command_line(), **options))


def verify(out: Annotated[Path | None, typer.Option(help="Folder of a page to sign.")] = None) -> None:
    """Check that this installation computes what it should. Exit code 1 where a part fails."""
    import tempfile

    from gonio_analysis.report import files

    from gonio.platform import command_line
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
    quick: Annotated[bool, typer.Option("--quick", help="Few pairs: errors are right, times are rough.")] = False,
) -> None:
    """Speed against error of every way of evaluating the models. Also the hard cases; prints the report's path last."""
    _made("bench.speed_and_error", out, quick=quick, progress=console.note)


@bench.command()
def scenes(
    out: Annotated[Path, typer.Option(help="Folder of the report.")],
    quick: Annotated[bool, typer.Option("--quick", help="Small pictures: all is run, nothing is precise.")] = False,
) -> None:
    """Speed against error of pictures: rays, tolerances, wavelengths, approximations. Prints the report's path."""
    with console.counter("pictures") as step:
        _made("bench.scenes", out, quick=quick, step=step)


@bench.command()
def sweeps(
    out: Annotated[Path, typer.Option(help="Folder of the report and of the records.")],
    seeds: Annotated[
        int | None, typer.Option(help="Runs of every plan; those that are there already count. [default: 3]")
    ] = None,
    jobs: Jobs = None,
    dask: Dask = None,
    quick: Annotated[bool, typer.Option("--quick", help="Two samples, in plane: all is run.")] = False,
) -> None:
    """Rig time against error of curves: uniform, mirror-dense, half-vector, adaptive plans. Prints the report's path.

    A command that was cut short goes on where it stood.
    """
    with _counted("comparisons") as step:
        _made("bench.sweeps", out, seeds=seeds, jobs=jobs, dask=dask, quick=quick, step=step)


@bench.command()
def coverage(
    out: Annotated[Path, typer.Option(help="Folder of the report and of the campaigns' records.")],
    campaigns: Annotated[
        int | None, typer.Option(help="How many; those that are there already count. [default: 200]")
    ] = None,
    seed: Annotated[int, typer.Option(help="What is hidden follows from it.")] = 1,
    jobs: Jobs = None,
    dask: Dask = None,
    only: Annotated[
        str, typer.Option(metavar="A,B", help="Errors that the benches have; all of them without it.")
    ] = "",
    quick: Annotated[bool, typer.Option("--quick", help="12 campaigns of few points: all is run.")] = False,
) -> None:
    """Blind campaigns on simulated benches: do the stated intervals hold the truth? Prints the report's path.

    A command that was cut short goes on where it stood.
    """
    with _counted("campaigns") as step:
        _made(
            "bench.coverage", out, campaigns=campaigns, seed=seed, jobs=jobs, dask=dask, only=_names(only), quick=quick,
            step=step,
        )  # fmt: skip


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


@contextlib.contextmanager
def _counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """Who is told how many are done: a bar on a terminal, and lines elsewhere."""
    from gonio.progress import Pace

    lines: list[Pace] = []

    with console.counter(what) as step:

        def said(done: int, total: int) -> None:
            step(done, total)
            if not sys.stderr.isatty() and (not lines or done * console.LINES % total < console.LINES):
                lines[:] = lines or [Pace(what, total, console.note)]
                lines[0].step(done)

        yield said


@bench.command()
def materials(
    sources: Annotated[
        list[str],
        typer.Argument(metavar="FILE|FOLDER ...", help="Measurements of materials, and published fits (*.fit)."),
    ],
    out: Annotated[Path, typer.Option(help="Folder of the page and of the records.")],
    models: Annotated[str, typer.Option(metavar="A,B", help="Models; all without it.")] = "",
    jobs: Jobs = None,
    dask: Dask = None,
) -> None:
    """Every model on every measured material, by the error of values left out. Prints the page's path.

    A command that was cut short goes on where it stood.
    """
    with _counted("materials") as step:
        _made("bench.materials", sources, out, models=_names(models), jobs=jobs, dask=dask, step=step)


@bench.command()
def maps(
    out: Annotated[Path, typer.Option(help="Folder of the report.")],
    quick: Annotated[bool, typer.Option("--quick", help="Few pixels: errors are right, times are rough.")] = False,
) -> None:
    """Speed against error of fits of maps, beside fits of one table. Prints the report's path last."""
    _made("bench.maps", out, quick=quick, progress=console.note)
