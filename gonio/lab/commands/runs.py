"""`gonio run`: is a run whole, and what can be made again."""

from pathlib import Path
from typing import Annotated

import typer

from gonio.cli import console
from gonio.errors import DataError

app = typer.Typer(help="Check and repair the folder of a run.", no_args_is_help=True)

NAMED = 20
"""Frames that are named on the terminal, at most; the journal names all."""

Folder = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]


@app.command("check")
def check_run(run: Folder) -> None:
    """Read every frame from end to end and compare it with the journal; change nothing."""
    from gonio.lab.acquisition import repair

    with console.counter("reading", lines=True) as progress:
        found = repair.check(run, progress=progress)
    wrong = [text for number in sorted(found.damaged) for text in found.damaged[number]]
    strange = [f"frames/{name} is not named by the journal" for name in found.orphans]
    if wrong or strange:
        head = f"{run}: {len(wrong)} of {found.frames} frames are missing or damaged"
        remedy = ["`gonio measure ... --resume` takes their steps again"] if wrong else []
        raise DataError("\n".join([head, *(f"  {line}" for line in some(wrong + strange)), *remedy]))
    console.show(f"{run}: {found.frames} frames, all as the journal names them")


@app.command("repair")
def repair_run(run: Folder) -> None:
    """Make a lost or damaged journal again, from what can be read of it and from what the frames carry."""
    from gonio.lab.acquisition import repair
    from gonio.lab.acquisition.run import Run

    with console.counter("reading", lines=True) as progress:
        done = repair.repair(run, progress=progress)
    if done is None:
        console.show(f"{run}: journal and frames are whole; nothing was changed")
        return
    _tell(
        [f"frames/{name}" for name in done.foreign],
        "say that they belong to another run. They count for nothing here, and stay where they are; --resume moves "
        "them to set-aside/:",
    )
    if not done.changed:
        console.show(f"{run}: the journal is whole, and so are the frames that it names; nothing was changed")
        return
    if done.journal is not None:
        console.note(f"the journal that was there is kept as {done.journal}")
    _tell(done.damaged, "are missing or damaged; their steps will be taken again:")
    _tell(
        [f"frames/{name}" for name in done.undetermined],
        "do not say enough of themselves: a step counts where its last frame holds the step's record and all its "
        "frames are whole. Pose and exposures of the others cannot be determined; they stay where they are, and their "
        "steps will be taken again:",
    )
    _tell(
        [f"frames/{name}" for name in done.unproved],
        "of an earlier version hold no checksum of their pixels, and the journal's is lost: nothing tells whether they "
        "are as they were taken:",
    )
    for line in done.untold:
        console.note(line)
    steps = len(Run.open(run).steps())
    console.show(
        f"{run}: the journal holds {steps} steps, {len(done.rebuilt)} of them made again from their frames",
        "next: gonio measure ... --resume, as the run was begun: " + Run.open(run).settings.run.command,
    )


def _tell(frames: list[str], what: str) -> None:
    """Say what is the matter with frames, and with which, where there are any."""
    if frames:
        console.note(f"{len(frames)} frames {what}")
        for line in some(frames):
            console.note(f"  {line}")


def some(lines: list[str]) -> list[str]:
    """The first of many lines, and how many more there are."""
    return lines[:NAMED] + ([f"and {len(lines) - NAMED} more"] if len(lines) > NAMED else [])
