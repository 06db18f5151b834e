"""Reads measurements, has models fitted to them, and writes the comparison report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from gonio import lost, measurement
from gonio.errors import ConfigError
from gonio.measurement import Reading, of_reader, said_once
from gonio.models.parameters import Ior
from gonio.run_facts import RunFacts
from gonio.run_facts import of as run_facts
from gonio.typing import DataFrame
from gonio_analysis.curves.in_plane import Normalise
from gonio_analysis.fitting.optical_constants import Constants, NamedSample, TakenConstants
from gonio_analysis.report import (
    across_plot,
    beyond_reflection,
    detail_figures,
    figures,
    files,
    page,
    sections,
    viewer,
)
from gonio_analysis.report.blocks import Page, titled
from gonio_analysis.report.comparison import summarise
from gonio_analysis.report.drawing import Drawing, Figure, FigureWorkers, figure_workers
from gonio_analysis.report.facts import DatasetSummary, Summary
from gonio_analysis.report.section import drawings_of
from gonio_analysis.report.sections import SECTIONS
from gonio_analysis.selection import parallel
from gonio_analysis.selection.beyond_reflection import Transmitted, transmitted
from gonio_analysis.selection.choice import candidates
from gonio_analysis.selection.compare import Dataset, check_models, examine

Measured = tuple[str, str, Any, RunFacts | None]
"""A sample's name, where it comes from, its table, and what its run says."""
FITTING = ("scipy.optimize", "gonio.models.engine", "gonio.instrument")
"""What takes long to import, of what fits need."""
MARKERS = 40_000
"""Most markers on one page; each takes about 60 bytes."""


def make(
    specs: Sequence[str],
    out: str | Path,
    *,
    models: Sequence[str],
    normalise: Normalise = "mirror",
    radius: float | None = None,
    ior: Ior | Constants = None,
    wavelength_nm: float | None = None,
    metric: str | None = None,
    u_rel: float | None = None,
    bound_energy: bool = False,
    separate: bool = False,
    dask: str | None = None,
    png: bool = False,
    how: Reading | None = None,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Read measurements, fit every model, and write a report: all of it or nothing.

    Parameters
    ----------
    specs, how
        Tables, RUN folders, or `FILE:SAMPLE`; columns of the tables, where they need any.
    out
        Folder of the report, whose `index.html` is returned; an earlier report there is replaced.
    models, normalise, wavelength_nm, metric, u_rel, bound_energy, separate
        See `gonio_analysis.selection.compare.examine`.
    ior
        Optical constants of all samples; or by sample, remembered beside the files.
    radius
        Of the rim of every polar plot, as a number of the divisor; each by what it shows if none is given.
    dask
        Address of a Dask scheduler to fit the samples on; by default several samples share the processors here.
    png
        Whether figures are written as PNG, too.
    command, progress
        The command line, for the record; called with a line before each step.

    Raises
    ------
    ConfigError, DataError
        From reading, fitting and writing; then nothing is left behind.
    Incomplete
        The page is there, and names parts that could not be made (`gonio.lost`).
    """
    check_models(models)
    asked = partial(
        examine, models=models, normalise=normalise, wavelength_nm=wavelength_nm, metric=metric, u_rel=u_rel,
        bound_energy=bound_energy, separate=separate,
    )  # fmt: skip
    with files.staged(out) as stage:
        found = [one for spec in specs for one in _read(spec, how)]
        tables = [table for _, _, table, _ in found]
        lost.kept("datacite.json", lambda: _cite(tables, stage.work, progress), lambda loss: None)
        through, found = _transmission_only(found, wavelength_nm, u_rel)
        samples = _told_apart(found)
        told = {name: of_reader(table) for name, _, table, _ in samples}
        for note in said_once(told | {t.name: t.data.notes for t in through}):
            progress(note)
        taken, iors = _optical_constants(ior, found, progress)
        jobs = [
            partial(asked, table, name=name, source=source, run=run, ior=own)
            for own, (name, source, table, run) in zip(iors, samples, strict=True)
        ]
        tried = max((len(candidates(models, own)) for own in iors), default=0)
        # the workers get ready while models are fitted
        with figure_workers(2 * len(jobs) * tried, modules=FITTING) as workers:
            workers.png = png
            datasets = _fitted(jobs, workers, dask, progress)
            every = [d.name for d in datasets] + [t.name for t in through]
            title = " and ".join(every) if len(every) <= 2 else f"{len(every)} samples"
            summary = write(
                datasets, stage.work, title=title, normalise=normalise, radius=radius, command=command,
                transmission_only=through, workers=workers, progress=progress,
            )  # fmt: skip
    for said in [*taken.remember(), *(summary.comparison.verdict if summary.comparison else ())]:
        progress(said)
    return Path(out) / "index.html"


def _read(spec: str, how: Reading | None) -> list[Measured]:
    """The samples that a table or a run holds."""
    run, many = run_facts(Path(spec)), measurement.tables(spec, how)
    return [(name, spec if len(many) == 1 else f"{spec}:{name}", table, run) for name, table in many.items()]


def _cite(tables: Sequence[DataFrame], folder: Path, progress: Callable[[str], None]) -> None:
    """Write `datacite.json` of one measurement whose laboratory is stated; say what is missing for it."""
    from gonio.formats import datacite, reader

    if len(tables) != 1 or reader.laboratory_of(tables[0]) is None:
        return
    try:
        content = datacite.record(tables[0], Path("datacite.json"))
    except ConfigError as error:
        progress(f"not written: {error}")
        return
    (folder / "datacite.json").write_bytes(datacite.encode(content))


def _transmission_only(
    found: list[Measured], wavelength_nm: float | None, u_rel: float | None
) -> tuple[list[Transmitted], list[Measured]]:
    """Samples of which transmission alone was measured, and the others."""
    transmission_only, others = list[Transmitted](), list[Measured]()
    for one in found:
        name, source, table, _ = one
        alone = "side" in table.columns and (table["side"] == "transmission").all()
        through = transmitted(table, name, wavelength_nm, u_rel) if alone else None
        if through is None:
            others.append(one)
        else:
            transmission_only.append(replace(through, source=source))
    return transmission_only, others


def _optical_constants(
    ior: Ior | Constants, found: Sequence[Measured], progress: Callable[[str], None]
) -> tuple[TakenConstants, list[Ior]]:
    """Optical constants of each sample, and what is to be remembered of them beside the files."""
    constants = ior if isinstance(ior, Constants) else Constants()
    taken = TakenConstants.of(constants, [NamedSample(source, sample) for sample, source, *_ in found])
    if not isinstance(ior, Constants):
        taken = replace(taken, remembered=[None] * len(found))
    for note in taken.notes:
        progress(note)
    return taken, list(taken.values) if isinstance(ior, Constants) else [ior] * len(found)


def _fitted(
    jobs: Sequence[partial[Dataset]], workers: FigureWorkers, dask: str | None, progress: Callable[[str], None]
) -> list[Dataset]:
    """What the jobs find: a few one after the other with all processors, many side by side."""
    if len(jobs) < parallel.FEW and dask is None:
        return [job(progress=progress, share=workers.share) for job in jobs]
    fitted = dict[int, Dataset]()
    for k, dataset in parallel.each(_examined, jobs, dask=dask, pool=workers):
        fitted[k] = dataset
        progress(f"{dataset.name}: fitted ({len(fitted)} of {len(jobs)})")
    return [fitted[k] for k in range(len(jobs))]


def _examined(job: Callable[[], Dataset]) -> Dataset:
    return job()


def write(
    datasets: Sequence[Dataset],
    folder: Path,
    *,
    title: str,
    normalise: Normalise = "mirror",
    radius: float | None = None,
    command: str = "",
    transmission_only: Sequence[Transmitted] = (),
    workers: FigureWorkers | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Write a report of these measurements into a folder that exists (see `files.staged`).

    Parameters
    ----------
    datasets
        The measurements with their fitted models, in the order of the page.
    title, command
        Heading of the page; the command line, for the record.
    normalise, radius
        What was asked for the polar plots.
    transmission_only
        Samples of which transmission alone was measured.
    workers
        Who draws; this process alone if it is not given.
    progress
        Called with a line before each step.

    Returns
    -------
    Summary
        What `summary.json` holds: every number of the page.
    """
    summary = summarise(
        datasets, title=title, normalise=normalise, command=command, sections=sections.every(SECTIONS),
        transmission_only=transmission_only,
    )  # fmt: skip
    progress("drawing")
    groups = _drawings(summary.datasets, radius)
    for t, slug in zip(transmission_only, page.slugs_of_transmission(summary), strict=True):
        groups.append(_kept("figures", t.name, partial(beyond_reflection.draw, t, (), slug)))
    if len(datasets) > 1:
        groups.append(_kept("figures", "all samples", partial(across_plot.draw, datasets)))
    views, listed = list[viewer.ViewerData | None](), list[str]()

    def views_and_tables() -> None:
        views.extend(_views(summary))
        listed.extend(files.write_tables(summary, views, folder / "tables"))

    wanted = [drawing for group in groups for drawing in group]
    every = (workers or FigureWorkers()).draw(wanted, progress, views_and_tables)
    summary = replace(summary, figures=every, tables=listed)
    rest = iter(every)
    drawn = [[next(rest) for _ in group] for group in groups]
    bare = {"index.html": titled(summary.title)}
    pages = lost.kept("the page", lambda: _pages(summary, drawn, views), lambda loss: bare)
    files.write_pages(folder, pages, summary, every)
    return summary


def _views(summary: Summary) -> list[viewer.ViewerData | None]:
    """What the interactive plot of each sample shows; None where it has no curves."""
    room, views = viewer.BYTES // max(len(summary.datasets), 1), list[viewer.ViewerData | None]()
    for d in summary.datasets:
        view = partial(viewer.viewer, d, summary.normalise, room)
        views.append(lost.kept(f"the interactive plot of {d.name}", view, lambda loss: None) if d.curves else None)
    return views


def _pages(
    summary: Summary, drawn: Sequence[Sequence[Figure]], views: Sequence[viewer.ViewerData | None]
) -> dict[str, Page]:
    """The pages by the name of their file: of several samples with a plot of all of them."""
    datasets = summary.datasets
    alone = len(datasets) + len(summary.transmission_only)
    beside: page.Beside = (None, ())
    if len(datasets) > 1:
        together = partial(across_plot.view, datasets, viewer.BYTES // 2)
        beside = lost.kept("the plot of all samples", together, lambda loss: None), drawn[-1]
    return page.render(summary, drawn[:alone], views, beside)


def _drawings(datasets: Sequence[DatasetSummary], radius: float | None) -> list[list[Drawing]]:
    """What is to be drawn of each sample, in the order of the page."""
    # measured values in one panel, so that those of all panels take about half of the room of a page
    most = min(max(MARKERS // max(sum(3 * len(d.models) + 6 for d in datasets), 1), 300), 2400)
    taken: dict[str, Drawing] = {}
    groups = []
    for d in datasets:
        group = [
            *_kept("figures", d.name, partial(figures.draw, d, most, radius)),
            *_kept("figures out of plane", d.name, partial(detail_figures.draw, d, most)),
        ]
        taken |= {one.name: one for one in group}
        for one in sections.every(SECTIONS):
            more = drawings_of(one, d, taken)
            taken |= {one.name: one for one in more}
            group += more
        groups.append(group)
    return groups


def _kept(what: str, name: str, draw: Callable[[], Sequence[Drawing]]) -> list[Drawing]:
    return lost.kept(f"{what} of {name}", lambda: list(draw()), lambda loss: [])


def _told_apart(found: Sequence[Measured]) -> list[Measured]:
    """The same with names that are told apart by their source (or a number) where two are alike."""
    names, out = [sample for sample, *_ in found], list[str]()
    for name, (_, source, *_) in zip(names, found, strict=True):
        if names.count(name) > 1:
            label = f"{name} ({source})"
            name = label if label not in out else f"{label}, {out.count(label) + 1}"
        out.append(name)
    return [(name, source, table, run) for name, (_, source, table, run) in zip(out, found, strict=True)]
