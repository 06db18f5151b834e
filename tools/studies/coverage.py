"""Blind campaigns, as many as are asked for, and the report of the study `coverage`."""

import shutil
import tempfile
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

from gonio_validation.bench import timing
from gonio_validation.bench.page import begun

from gonio.config import Strict
from gonio.typing import JsonObject
from tools.studies import coverage_campaign, coverage_hidden, coverage_judgement, coverage_page
from tools.studies.campaigns import Campaigns, Record, Step, as_csv, at_least, write
from tools.studies.coverage_campaign import FORMAT

CAMPAIGNS, FEW = 200, 12
"""Without a number; and of a quick run."""
POINTS, FEW_POINTS = 40, 15
"""Most points of a campaign's plan."""


class CoverageSettings(Strict):
    """What makes the campaigns of a folder what they are: with others they would be other campaigns."""

    format: int = FORMAT
    seed: int
    errors: tuple[str, ...]
    points: int
    gonio: str


def make(
    out: str | Path,
    *,
    campaigns: int | None = None,
    seed: int = 1,
    jobs: int | None = None,
    dask: str | None = None,
    only: Sequence[str] = (),
    quick: bool = False,
    command: str = "",
    step: Step = lambda done, total: None,
) -> Path:
    """Carry out the campaigns that are missing, and write the report on all.

    Parameters
    ----------
    out
        Folder of the report and of the records.
    campaigns
        How many; 200 by default, or 12 of a quick run.
    seed
        At least 0.
    jobs
        Processes; one for each processor by default.
    dask
        Address of a Dask scheduler whose workers carry out the campaigns, in folders of their own disks.
    only
        Names of the errors that the benches have; all by default.
    quick
        Few campaigns of few points.
    command
        The command line, for the record.
    step
        Called with how many campaigns are done, and how many there are.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        An argument is wrong; or the folder cannot be written, holds something else, or campaigns of another kind.
    Interrupted
        Somebody stopped it; the records that are there count.
    """
    total = campaigns if campaigns is not None else FEW if quick else CAMPAIGNS
    at_least(campaigns=(total, 1), seed=(seed, 0), jobs=(jobs, 1))
    errors, points = tuple(cause.name for cause in coverage_hidden.chosen(only)), FEW_POINTS if quick else POINTS
    settings = CoverageSettings(seed=seed, errors=errors, points=points, gonio=version("gonio"))
    folder = Path(out)
    every = Campaigns(folder, "coverage", "campaigns", settings)
    with every.opened():
        shutil.rmtree(folder / "work", ignore_errors=True)  # of campaigns that were cut short
        work = folder / "work" if dask is None else None
        wanted = {f"{k:05d}": partial(_carried_out, k, settings, work) for k in range(total)}
        records = every.carried_out(wanted, jobs, dask, step)
        shutil.rmtree(folder / "work", ignore_errors=True)
        found = summary(records, settings, quick=quick, command=command)
        lines = {"campaigns.csv": lambda: as_csv([coverage_judgement.line(r) for r in records])}
        write(folder, found, partial(coverage_page.drawn, found), partial(coverage_page.render, found), lines)
    return folder / "index.html"


def _carried_out(number: int, settings: CoverageSettings, work: Path | None) -> Record:
    drawn = coverage_hidden.campaign(settings.seed, number, settings.errors, settings.points)
    if work is not None:
        return coverage_campaign.carried_out(drawn, work / f"{number:05d}")
    from distributed import get_worker

    # what a killed worker leaves in its folder, Dask removes when the next one starts
    with tempfile.TemporaryDirectory(dir=get_worker().local_directory) as own:
        return coverage_campaign.carried_out(drawn, Path(own, "campaign"))


def summary(
    records: Sequence[Record], settings: CoverageSettings, *, quick: bool = False, command: str = ""
) -> JsonObject:
    """Every number of the report, as `results.json` holds it."""
    counts, pulls, uniform = coverage_judgement.judged(records)
    measured = [r for r in records if r["points"] and r["points"]["brdf"]]
    drawn = [coverage_judgement.chosen_parameter(r) for r in records if r["fit"]]
    return begun("Do the stated intervals hold the truth?", command, quick) | {
        "seed": settings.seed,
        "campaigns": len(records),
        "values": sum(len(r["points"]["brdf"]) for r in measured),
        "seconds": sum(r["seconds"] for r in records),
        "machine": timing.machine(),
        "causes": [
            {"name": c.name, "hidden": c.hidden, "learned": c.learned, "on": c.name in settings.errors}
            for c in coverage_hidden.CAUSES
        ],
        "counts": counts,
        "pulls": pulls,
        "uniform": uniform,
        "single_pulls": coverage_judgement.single_points(measured),
        "parameter_pulls": coverage_judgement.known_pulls(drawn),
        "worst": coverage_judgement.worst(records),
        "refused": coverage_judgement.failed(records),
    }
