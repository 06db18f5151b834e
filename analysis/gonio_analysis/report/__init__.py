"""The comparison report: `index.html` (self-contained), `summary.json`, figures as SVG and PNG, tables as CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from gonio_analysis.curves.in_plane import Normalise
from gonio_analysis.fitting.parameters import Ior
from gonio_analysis.report import detail, figures, files, html, page, pdf, tables, viewer
from gonio_analysis.report.comparison import summarise
from gonio_analysis.report.drawing import Draughtsmen, draughtsmen
from gonio_analysis.result_records import FigureSummary, Summary, as_json
from gonio_analysis.selection import parallel
from gonio_analysis.selection.choice import candidates
from gonio_analysis.selection.compare import Dataset, examine
from gonio_analysis.selection.run_record import run_facts

MARKERS = 40_000
"""On one page; each takes about 60 bytes."""


def make(
    specs: Sequence[str],
    out: str | Path,
    *,
    models: Sequence[str],
    normalise: Normalise = "mirror",
    ior: Ior = None,
    wavelength_nm: float | None = None,
    metric: str | None = None,
    u_rel: float | None = None,
    bound_energy: bool = False,
    separate: bool = False,
    dask: str | None = None,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Read measurements, fit every model, and write a report: all of it or nothing.

    Parameters
    ----------
    specs
        Tables, RUN folders, or `FILE:SAMPLE`.
    out
        Folder of the report; an earlier report there is replaced.
    models, normalise, ior, wavelength_nm, metric, u_rel, bound_energy, separate
        See `gonio_analysis.selection.compare.examine`.
    dask
        Address of a Dask scheduler to fit the samples on; by default several samples share the processors here.
    command
        The command line, for the record.
    progress
        Called with a line before each step.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError, DataError
        From reading, fitting and writing; then nothing is left behind.
    """
    from gonio import measurement

    with files.staged(out) as stage:
        found = []
        for spec in specs:
            run = run_facts(Path(spec))
            many = measurement.tables(spec)
            for sample, table in many.items():
                found.append((sample, spec if len(many) == 1 else f"{spec}:{sample}", table, run))
        names = _distinct([sample for sample, *_ in found], [source for _, source, *_ in found])
        examined = partial(
            examine,
            models=models,
            normalise=normalise,
            ior=ior,
            wavelength_nm=wavelength_nm,
            metric=metric,
            u_rel=u_rel,
            bound_energy=bound_energy,
            separate=separate,
        )
        jobs = [
            partial(examined, table, name=name, source=source, run=run)
            for name, (_, source, table, run) in zip(names, found, strict=True)
        ]
        tried = len(candidates(models, ior))
        with draughtsmen(2 * len(jobs) * tried) as hands:  # they get ready while the models are fitted
            if len(jobs) < parallel.FEW and dask is None:
                datasets = [job(progress=progress) for job in jobs]
            else:
                datasets = []
                for dataset in parallel.each(_examined, jobs, dask=dask):
                    datasets.append(dataset)
                    progress(f"{dataset.name}: fitted ({len(datasets)} of {len(jobs)})")
            title = names[0] if len(names) == 1 else " and ".join(names) if len(names) == 2 else f"{len(names)} samples"
            write(
                datasets, stage.work, title=title, normalise=normalise, command=command, hands=hands, progress=progress
            )
    return Path(out) / "index.html"


def _examined(job: Callable[[], Dataset]) -> Dataset:
    return job()


def write(
    datasets: Sequence[Dataset],
    folder: Path,
    *,
    title: str,
    normalise: Normalise = "mirror",
    command: str = "",
    hands: Draughtsmen | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Summary:
    """Write a report of these measurements into a folder that exists (see `files.staged`).

    Parameters
    ----------
    datasets
        The measurements with their fitted models, in the order of the page.
    title
        Heading of the page.
    normalise
        What was asked for the polar plots.
    command
        The command line, for the record.
    hands
        Who draws; this process alone if it is not given.
    progress
        Called with a line before each step.

    Returns
    -------
    Summary
        What `summary.json` holds: every number of the page.
    """
    summary = summarise(datasets, title=title, normalise=normalise, command=command)
    both = list(zip(datasets, summary.datasets, strict=True))
    progress("drawing")
    most = _most_values(datasets)
    groups = [[*figures.draw(d, facts, most), *detail.draw(d, facts, most)] for d, facts in both]
    every = (hands or Draughtsmen()).draw([drawing for group in groups for drawing in group], progress)
    rest = iter(every)
    drawn = [[next(rest) for _ in group] for group in groups]
    (folder / "tables").mkdir()
    listed = [FigureSummary(f.name, f.caption, f.alt) for f in every]
    room = viewer.BYTES // len(datasets)
    views = [viewer.viewer(d, facts, normalise, room) if d.curves else None for d, facts in both]
    summary = replace(summary, figures=listed, tables=tables.write(datasets, summary, views, folder / "tables"))
    pages = page.render(summary, drawn, views)
    for name, shown in pages.items():
        (folder / name).write_text(html.document(shown), encoding="utf-8")
    files.write(folder, as_json(summary), every)
    pdf.write(folder / "report.pdf", list(pages.values()))
    return summary


def _most_values(datasets: Sequence[Dataset]) -> int:
    """Measured values in one panel, so that those of all panels take about half of the room of a page."""
    panels = sum(3 * len(d.fitted) + 6 for d in datasets)
    return min(max(MARKERS // panels, 300), 2400)


def _distinct(names: Sequence[str], sources: Sequence[str]) -> list[str]:
    """Names of samples, told apart by their source (or a number) where two are alike."""
    out: list[str] = []
    for name, source in zip(names, sources, strict=True):
        if names.count(name) > 1:
            label = f"{name} ({source})"
            name = label if label not in out else f"{label}, {out.count(label) + 1}"
        out.append(name)
    return out
