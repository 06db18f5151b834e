"""`gonio bench sweeps`: rig time against the error of the curves that come of it, for fixed and for adaptive plans."""

import datetime
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path

from gonio.config import Strict
from gonio_validation.bench import campaigns, sweeps_page, sweeps_results, timing
from gonio_validation.bench.campaigns import Campaigns, Record, Step, as_csv, at_least
from gonio_validation.bench.sweeps_plans import INCIDENCES, SAMPLES, Geometry
from gonio_validation.bench.sweeps_results import Sweeps
from gonio_validation.bench.sweeps_run import FORMAT, carried_out

SEEDS = 3
QUICK = ("rough aluminium", "matte")


class SweepsSettings(Strict):
    """What makes the comparisons of a folder what they are."""

    format: int = FORMAT
    gonio: str


def make(
    out: str | Path,
    *,
    seeds: int | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    quick: bool = False,
    command: str = "",
    step: Step = lambda done, total: None,
) -> Path:
    """Make the comparisons that are missing, and write the report on all.

    Parameters
    ----------
    out
        Folder of the report and of the records.
    seeds
        Runs of every plan, each with errors and noise of its own; 3 by default, or 1 of a quick run.
    jobs
        Processes; one for each processor by default.
    dask
        Address of a Dask scheduler whose workers make the comparisons.
    quick
        Two samples, in plane alone.
    command
        The command line, for the record.
    step
        Told how many comparisons are done, of how many.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError
        An argument is wrong; or the folder cannot be written, or holds something else.
    Interrupted
        Somebody stopped it; the records that are there count.
    """
    count = seeds if seeds is not None else 1 if quick else SEEDS
    at_least(seeds=(count, 1), jobs=(jobs, 1))
    folder = Path(out)
    geometries: Sequence[Geometry] = ("in plane",) if quick else tuple(INCIDENCES)
    wanted = {
        f"{geometry} {sample} {seed:03d}".replace(" ", "-"): partial(carried_out, sample, geometry, seed)
        for seed in range(count)
        for geometry in geometries
        for sample in (QUICK if quick else SAMPLES)
    }
    every = Campaigns(folder, "sweeps", "comparisons", SweepsSettings(gonio=version("gonio")))
    with every.opened():
        records = every.carried_out(wanted, jobs, dask, step)
        write(summary(records, seeds=count, quick=quick, command=command), folder)
    return folder / "index.html"


def summary(records: Sequence[Record], *, seeds: int, quick: bool = False, command: str = "") -> Sweeps:
    """Every number of the report, as `results.json` holds it."""
    found = sweeps_results.levels(records)
    return Sweeps(
        title="Rig time against error of curves",
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=command,
        quick=quick,
        seeds=seeds,
        seconds=sum(r["seconds"] for r in records),
        machine=timing.machine(),
        levels=found,
        by_points=sweeps_results.by_points(found),
        held=sweeps_results.held(records),
    )


def write(s: Sweeps, folder: Path) -> None:
    """Write page, numbers and figures into a folder that exists."""
    drawn = sweeps_page.drawn(s)
    points = {"points.csv": as_csv([asdict(level) for level in s.levels])}
    campaigns.write(folder, sweeps_page.render(s, drawn), s, drawn, points)
