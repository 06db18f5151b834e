"""`gonio measure` and `gonio reduce`."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gonio.cli import console
from gonio.errors import ConfigError, DataError
from gonio.lab.commands import plans
from gonio.lab.commands.progress import on_screen
from gonio.platform import command_line

if TYPE_CHECKING:
    import pandas as pd


def measure(
    plan: Annotated[Path, typer.Argument(metavar="PLAN", help="What to measure: a plan.toml.")],
    rig: Annotated[str, typer.Option(help="A rig's name (gonio rig list), or a rig file.")],
    out: Annotated[Path, typer.Option(help="Folder of the run; made if it is absent.")],
    sample: Annotated[
        Path | None, typer.Option(help="What a simulated rig measures: a sample.toml, or the name of a shipped one.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of a simulated rig; 0 where none is given.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a run that was cut short; sample and seed are its own.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Check everything and show the plan; move nothing.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Ask for no confirmation.")] = False,
) -> None:
    """Measure a plan on a rig: raw frames and a journal in a folder. Ctrl-C finishes the step and parks; p pauses."""
    from gonio.lab.acquisition.measure import carry_out, check, find_rig
    from gonio.lab.acquisition.plan import load_plan
    from gonio.lab.acquisition.progress import Pause
    from gonio.lab.acquisition.run import Run
    from gonio.lab.acquisition.run_folder import begun
    from gonio.samples.files import load_sample

    asked, chosen = load_plan(plan), find_rig(rig)
    described = load_sample(sample) if sample is not None else None
    if resume and begun(out) and None in (sample, seed):
        kept = Run.open(out)
        described, seed = described or kept.sample, kept.seed if seed is None else seed
    seed = seed or 0
    if dry_run:
        plans.describe(asked, check(asked, chosen, out, sample=described, seed=seed, resume=resume, yes=yes), out=out)
        if resume and begun(out):
            console.show(f"{out}: {len(Run.open(out).steps())} of these steps are taken")
        console.note(f"a picture of rig and points: gonio plan show {plan} --rig {rig} --picture plan.svg")
        console.note("nothing was moved or written (--dry-run)")
        return
    for warning in plans.unfit(chosen.description):
        console.note(warning)
    pause = Pause()
    with on_screen(pause) as progress:
        run = carry_out(
            asked, chosen, out, sample=described, seed=seed, resume=resume, yes=yes,
            command=command_line(), progress=progress, last=True, pause=pause,
        )  # fmt: skip
    flags = run.points.flags
    points, skipped = sum(not flag for flag in flags), _flags(flags)  # every step is done where this is reached
    console.show(
        f"{out}: {points} points measured" + (f", {len(flags) - points} not ({skipped})" if skipped else ""),
        f"next: gonio reduce {shlex.quote(str(out))}",
    )


def reduce(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    monte_carlo: Annotated[
        int | None,
        typer.Option(metavar="N", min=100, help="Check uncertainties by N draws: RUN/monte_carlo.csv, .npz."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 0,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="OUT.h5", help="A BRDF in every pixel of the sample too.")
    ] = None,
    pixel_mm: Annotated[
        float | None, typer.Option(metavar="MM", help="Of the map; else the camera's, seen at normal view.")
    ] = None,
) -> None:
    """Reduce a run's frames to BRDF with uncertainty: RUN/brdf.csv, and its parts in RUN/budget.csv."""
    from gonio import plugins
    from gonio.lab.acquisition.run import Run
    from gonio.lab.reduction import brdf

    opened = Run.open(run)
    opened.check_table()
    if pixel_mm is not None and map_file is None:
        raise ConfigError("--pixel-mm is the size of a map's pixels: give --map OUT.h5 with it")
    if map_file is not None:
        plugins.room("maps").require(opened, map_file, pixel_mm)
    with console.counter("reducing", lines=True) as progress:
        found = brdf.reduce_in_parts(opened, progress=progress)
    table, verdict = found.table, ""
    for note in table.attrs["notes"]:  # what the values rest on
        console.note(note)
    good, flags = table[table["flag"] == ""], _flags(table["flag"])
    if good.empty:
        again = "; gonio measure --resume goes on with it" if (table["flag"] == "not_measured").any() else ""
        raise DataError(f"{run}: none of its {len(table)} values is usable ({flags}): no table is written{again}")
    beside: dict[str, pd.DataFrame | bytes] = {"budget.csv": found.budget}
    if monte_carlo is not None:
        from gonio.lab.reduction import monte_carlo as drawing

        with console.counter("drawing", lines=True) as progress:
            drawn = drawing.check(opened, found, monte_carlo, seed, progress)
        beside["monte_carlo.csv"], verdict = drawn.values, drawn.verdict
        if drawn.every.size:
            beside["monte_carlo.npz"] = drawn.archive()
        else:
            verdict += f"; more than {drawing.KEPT:.0e} numbers: the draws are not kept"
        table.attrs["provenance"]["monte_carlo"] = {"draws": monte_carlo, "seed": seed, "verdict": verdict}
    path = opened.write_table(table, beside)
    console.show(f"{path}: {len(good)} values of {len(table)}" + (f" ({flags})" if flags else ""))
    relative = float((good["u_brdf"] / good["brdf"].abs()).median())
    console.show(f"median standard uncertainty {100 * relative:.2g} %")
    if verdict:
        console.show(verdict)
    for line in _checks(table.attrs["provenance"]["checks"]):
        console.show(line)
    if map_file is not None:
        plugins.room("maps").reduce(opened, found, map_file, pixel_mm)


def _checks(found: Iterable[Mapping[str, Any]]) -> list[str]:
    """Checks as lines: those that are fine by name, the others with their figure, over all bands the worst."""
    worst: dict[str, Mapping[str, Any]] = {}
    order = ("ok", "undetermined", "look", "bad")
    for check in found:
        other = worst.get(check["name"])
        if other is None or order.index(check["verdict"]) > order.index(other["verdict"]):
            worst[check["name"]] = check
    fine = [name for name, check in worst.items() if check["verdict"] == "ok"]
    undetermined = [name for name, check in worst.items() if check["verdict"] == "undetermined"]
    out = [f"checks: {', '.join(fine)}: ok"] if fine else []
    for name, check in worst.items():
        if check["verdict"] in ("look", "bad"):
            where = f" ({check['band']})" if check["band"] else ""
            out.append(f"check {check['verdict']}: {name}{where}: {check['figure']}")
    return [*out, f"not determined by this plan: {', '.join(undetermined)}"] if undetermined else out


def _flags(column: Iterable[str]) -> str:
    """Counts of the flags in a column, as text."""
    return ", ".join(f"{count} {flag}" for flag, count in Counter(filter(None, column)).most_common())
