"""The study `sweeps`: rig time against the error of the curves that come of it, for fixed and for adaptive plans."""

import time
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from gonio_sweeps.posterior import Posterior
from gonio_validation.bench import timing
from gonio_validation.bench.page import begun

from gonio.config import Strict
from gonio.lab.acquisition.measure import find_rig
from gonio.typing import Floats, JsonObject
from tools.studies import campaigns, sweeps_page, sweeps_rig
from tools.studies.campaigns import Campaigns, Record, Step, as_csv, at_least
from tools.studies.sweeps_page import SHARE
from tools.studies.sweeps_rig import (
    FLOOR,
    INCIDENCES,
    SAMPLES,
    SIZES,
    WAVELENGTH_NM,
    FrameFreeRig,
    Geometry,
    MeasuredSweep,
    Places,
    in_order,
)

FORMAT = 3
FIXED = ("uniform", "mirror-dense", "half-vector")
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
        Called with how many comparisons are done, and how many there are.

    Returns
    -------
    Path
        Where `index.html` is.

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
        write(summary(every.carried_out(wanted, jobs, dask, step), seeds=count, quick=quick, command=command), folder)
    return folder / "index.html"


def summary(records: Sequence[Record], *, seeds: int, quick: bool = False, command: str = "") -> JsonObject:
    """Every number of the report, as `results.json` holds it."""
    found = sweeps_page.levels(records)
    return begun("Rig time against error of curves", command, quick) | {
        "seeds": seeds,
        "seconds": sum(r["seconds"] for r in records),
        "machine": timing.machine(),
        "levels": found,
        "by_points": sweeps_page.by_points(found),
        "held": sweeps_page.held(records),
    }


def write(s: JsonObject, folder: Path) -> None:
    """Write page, numbers and figures into a folder that exists."""
    points = {"points.csv": partial(as_csv, s["levels"])}
    campaigns.write(folder, s, partial(sweeps_page.drawn, s), partial(sweeps_page.render, s), points)


# --- one comparison: a sample, a geometry, a seed; every plan measured, every curve held against the truth ------------


def carried_out(name: str, geometry: Geometry, seed: int) -> JsonObject:
    """The record of a comparison, as JSON has it."""
    began = time.perf_counter()
    description = find_rig("sim").description
    band = description.bands.containing(WAVELENGTH_NM)
    model = sweeps_rig.sample(name)
    number = list(sweeps_rig.SAMPLES).index(name)
    places = sweeps_rig.judged(geometry, description)

    def rig(kind: int) -> FrameFreeRig:
        # all plans of one comparison have the same errors of zeros and scale, and noise of their own
        return FrameFreeRig(description, band, model, (seed, number), kind)

    truth = rig(0).truth(places.directions)
    # what the values' uncertainties are made of is the rig's, and alike in all plans
    known = sweeps_rig.sampler(geometry, description, None).known
    results: list[JsonObject] = []
    for kind, plan in enumerate(FIXED):
        for size in SIZES[geometry]:
            points = sweeps_rig.fixed(plan, geometry, size, description)
            poses = [a.pose for a in points if a.pose is not None]
            measured = rig(10 * size + kind).measure(in_order([a.point for a in points], poses))
            results.append(_simple(plan, measured, places, truth))
            results.append(_by_process(plan, measured, known(measured.values), places, truth))
    most = max(SIZES[geometry]) * len(INCIDENCES[geometry])
    results += _adaptive("adaptive", rig(1), geometry, None, round(0.6 * most), places, truth)
    if geometry == "in plane":
        # of those that the blocked cone leaves
        by_points = int(SHARE * max(r["points"] for r in results if r["plan"] == "uniform"))
        results += _adaptive("adaptive by points", rig(2), geometry, by_points, by_points, places, truth)[-1:]
    seconds = time.perf_counter() - began
    return {
        "format": FORMAT, "sample": name, "geometry": geometry, "seed": seed, "seconds": seconds,
        "results": results,
    }  # fmt: skip


def _adaptive(
    plan: str, rig: FrameFreeRig, geometry: Geometry, most: int | None, stop: int, places: Places, truth: Floats
) -> list[JsonObject]:
    """After every batch: what is known by then."""
    sampler = sweeps_rig.sampler(geometry, rig.description, most)
    out: list[JsonObject] = []
    measured: MeasuredSweep | None = None
    why: JsonObject | None = None
    wanted = list(sampler.first(()))
    poses = dict(zip(sampler.candidates.points, sampler.candidates.poses, strict=True))
    while wanted:
        measured = rig.measure([poses[point] for point in wanted], measured)
        decided = sampler.decided([measured.values], measured.seconds, why)
        posterior, why = sampler.known(measured.values, why), decided.why
        out.append(_by_process(plan, measured, posterior, places, truth))
        wanted = list(decided.points) if len(measured.values) < stop else []
    return out


def _relative(f: Floats, truth: Floats) -> Floats:
    return np.asarray((f - truth) / np.maximum(truth, FLOOR * truth.max()))


def _simple(plan: str, measured: MeasuredSweep, places: Places, truth: Floats) -> JsonObject:
    error = _relative(sweeps_rig.interpolated(measured.values, places.directions), truth)
    return _result(plan, "interpolated", measured, error, places)


def _by_process(plan: str, measured: MeasuredSweep, known: Posterior, places: Places, truth: Floats) -> JsonObject:
    f, u, low, high = known.at(places.directions)
    inside = float(places.weight @ ((low <= truth) & (truth <= high)))
    u_rel = float(np.median(u / np.maximum(truth, FLOOR * truth.max())))
    return _result(plan, "process", measured, _relative(f, truth), places, inside, u_rel)


def _result(
    plan: str,
    way: str,
    measured: MeasuredSweep,
    error: Floats,
    places: Places,
    inside: float | None = None,
    u_rel: float | None = None,
) -> JsonObject:
    """A plan, measured and made into a curve.

    Parameters
    ----------
    plan
        "uniform", "mirror-dense", "half-vector", "adaptive" (by rig time) or "adaptive by points".
    way
        "interpolated" or "process": how the curve was made of the points.
    error
        Of the curve, relative.
    inside
        Part of the curve whose interval of 95 % holds the truth.
    u_rel
        Median stated relative standard uncertainty.
    """
    return {
        "plan": plan, "way": way, "points": len(measured.values), "seconds": measured.seconds,
        "rms": float(np.sqrt(places.weight @ error**2)), "largest": float(np.abs(error).max()), "inside": inside,
        "u_rel": u_rel,
    }  # fmt: skip
