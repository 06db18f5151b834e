"""The comparison report: `index.html` (self-contained), `summary.json`, figures as SVG and PNG, tables as CSV."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gonio_analysis import parallel
from gonio_analysis.compare import Dataset, examine, run_facts
from gonio_analysis.families import Ior
from gonio_analysis.planes import Normalise
from gonio_analysis.report import detail, figures, files, page, pdf, tables, viewer
from gonio_analysis.report.summary import summarise

if TYPE_CHECKING:
    import pandas as pd


def make(
    specs: Sequence[str],
    out: str | Path,
    *,
    models: Sequence[str],
    normalise: Normalise = "mirror",
    ior: Ior = None,
    wavelength_nm: float | None = None,
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
    models, normalise, ior, wavelength_nm
        See `gonio_analysis.compare.examine`.
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
        options: dict[str, Any] = {"normalise": normalise, "ior": ior, "wavelength_nm": wavelength_nm}
        jobs = [
            (table, models, options | {"name": name, "source": source, "run": run})
            for name, (_, source, table, run) in zip(names, found, strict=True)
        ]
        if len(jobs) < parallel.FEW and dask is None:
            datasets = [examine(table, models, **own, progress=progress) for table, _, own in jobs]
        else:
            datasets = []
            for dataset in parallel.each(_examined, jobs, dask=dask):
                datasets.append(dataset)
                progress(f"{dataset.name}: fitted ({len(datasets)} of {len(jobs)})")
        title = names[0] if len(names) == 1 else " and ".join(names) if len(names) == 2 else f"{len(names)} samples"
        write(datasets, stage.work, title=title, normalise=normalise, command=command, progress=progress)
    return Path(out) / "index.html"


def _examined(job: tuple[pd.DataFrame, Sequence[str], dict[str, Any]]) -> Dataset:
    table, models, options = job
    return examine(table, models, **options)


def write(
    datasets: Sequence[Dataset],
    folder: Path,
    *,
    title: str,
    normalise: Normalise = "mirror",
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
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
    progress
        Called with a line before each step.

    Returns
    -------
    dict
        What `summary.json` holds: every number of the page.
    """
    summary = summarise(datasets, title=title, normalise=normalise, command=command)
    drawn = []
    for dataset, facts in zip(datasets, summary["datasets"], strict=True):
        progress(f"{dataset.name}: drawing")
        drawn.append([*figures.draw(dataset, facts), *detail.draw(dataset, facts)])
    (folder / "tables").mkdir()
    every = [figure for group in drawn for figure in group]
    summary["figures"] = [{"name": f.name, "caption": f.caption, "alt": f.alt} for f in every]
    views = [
        viewer.viewer(d, facts, normalise) if d.curves else None
        for d, facts in zip(datasets, summary["datasets"], strict=True)
    ]
    summary["tables"] = tables.write(datasets, summary, views, folder / "tables")
    html = page.render(summary, drawn, views)
    files.write(folder, html, summary, every)
    pdf.write(folder / "report.pdf", html, {f.name: f.png for f in every})
    return summary


def _distinct(names: Sequence[str], sources: Sequence[str]) -> list[str]:
    """Names of samples, told apart by their source (or a number) where two are alike."""
    out: list[str] = []
    for name, source in zip(names, sources, strict=True):
        if names.count(name) > 1:
            label = f"{name} ({source})"
            name = label if label not in out else f"{label}, {out.count(label) + 1}"
        out.append(name)
    return out
