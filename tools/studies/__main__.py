"""`python -m tools.studies NAME`, from the root: coverage, sweeps, scenes, materials or maps (see readme.md)."""

import contextlib
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer
from gonio_analysis.commands import Dask

from gonio.cli import console
from gonio.errors import ConfigError, GonioError

Jobs = Annotated[int | None, typer.Option(help="Processes. [default: one a processor]")]

app = typer.Typer(help="Measure the workbench itself.", no_args_is_help=True, add_completion=False)


def _made(module: str, *arguments: Any, **options: Any) -> None:
    """Make the page that a module of this folder makes, with the command line for its record, and print its path."""
    from gonio.platform import command_line

    if None not in (options.get("jobs"), options.get("dask")):
        raise ConfigError("--jobs: counts processes here, and --dask names a cluster; leave one of them out")
    print(import_module(f"tools.studies.{module}").make(*arguments, command=command_line(), **options))


@app.command()
def scenes(
    out: Annotated[Path, typer.Option(help="Folder of the report.")],
    quick: Annotated[bool, typer.Option("--quick", help="Small pictures: all is run, nothing is precise.")] = False,
) -> None:
    """Speed against error of pictures: rays, tolerances, wavelengths, approximations. Prints the report's path."""
    with console.counter("pictures") as step:
        _made("scenes", out, quick=quick, step=step)


@app.command()
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
        _made("sweeps", out, seeds=seeds, jobs=jobs, dask=dask, quick=quick, step=step)


@app.command()
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
            "coverage", out, campaigns=campaigns, seed=seed, jobs=jobs, dask=dask, only=_names(only), quick=quick,
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


@app.command()
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
        _made("materials", sources, out, models=_names(models), jobs=jobs, dask=dask, step=step)


@app.command()
def maps(
    out: Annotated[Path, typer.Option(help="Folder of the report.")],
    quick: Annotated[bool, typer.Option("--quick", help="Few pixels: errors are right, times are rough.")] = False,
) -> None:
    """Speed against error of fits of maps, beside fits of one table. Prints the report's path last."""
    _made("maps", out, quick=quick, progress=console.note)


def main() -> None:
    """Run one study, and end the process with its exit code."""
    sys.argv[0] = "tools.studies"
    try:
        app()
    except GonioError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
