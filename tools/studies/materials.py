"""What measured materials say of the models: every file in folders, every model, by the error of values left out.

Published fits (`*.fit`) among them are a second list.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.parameters import declared
from gonio_analysis.report import frame
from gonio_analysis.report.blocks import (
    MOST_ROWS,
    Block,
    Figures,
    Heading,
    Page,
    footer,
    lead,
    stamp,
    table,
)
from gonio_analysis.report.drawing import Figure, rendered
from gonio_analysis.report.section import parts
from gonio_analysis.report.text import percent
from gonio_analysis.selection.choice import candidates, choose

from gonio import measurement
from gonio.config import Strict
from gonio.errors import ConfigError, GonioError
from gonio.typing import JsonObject
from tools.studies import published
from tools.studies.campaigns import Campaigns, Record, Step, as_csv, write

FEWEST, MOST = 20, 1500
"""Values of a material: with fewer nothing is left out sensibly; of more a part is drawn, always the same."""
LEFT_OUT = "left_out"
"""The name of the picture of all materials."""
CLOSE = 1.25
"""A model within this factor of the nearest one's left-out error counts as near."""
TITLE = "Materials and models"
FOOTER = footer("Every number is in `results.json` and `materials.csv`.")


class Settings(Strict):
    """What the records rest on."""

    format: int = 1
    models: tuple[str, ...] = ()


def make(
    sources: Sequence[str],
    out: str | Path,
    *,
    models: Sequence[str] = (),
    jobs: int | None = None,
    dask: str | None = None,
    command: str = "",
    step: Step = lambda done, total: None,
) -> Path:
    """Fit every model to every material that is not done yet, and write the page on all.

    Parameters
    ----------
    sources
        Measurement files, published fits (`*.fit`), and folders of them; what cannot be read is listed on the page.
    out
        Folder of the page and of the records; what was done there before counts.
    models
        Names on the command line; all that can be fitted by default.
    jobs
        Processes; one for each processor by default.
    dask
        Address of a Dask scheduler whose workers fit; they read the files at the paths that they have here.
    command, step
        The command line, for the record; called with how many materials are done, and how many there are.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError
        Nothing can be read, a model is unknown, or the folder holds something else.
    DataError
        A line of published fits is none.
    Interrupted
        Somebody stopped it; the records that are there count.
    """
    tried = tuple(models) or declared()
    candidates(tried)  # which raises for an unknown one
    campaigns = Campaigns(Path(out), "materials", "records", Settings(models=tried))
    fits = [fit for _, file in _files(sources) if file.suffix == ".fit" for fit in published.read(file)]
    samples, unread = _samples(sources)
    if not samples and not fits:
        raise ConfigError(f"{', '.join(sources)}: no measurement there can be read and has {FEWEST} usable values")
    with campaigns.opened():
        wanted = {name: partial(judged, name, *place, tried) for name, place in samples.items()}
        records = campaigns.carried_out(wanted, jobs, dask, step)
        results: JsonObject = {"title": TITLE, "materials": records, "not_read": unread, **stamp(command)}
        if fits:
            results["published"] = published.judged(fits)

        def draw() -> list[Figure]:
            return [*([_picture(records, tried)] if records else []), *([published.picture(fits)] if fits else [])]

        render = partial(_page, records, tried, unread, results.get("published"))
        write(campaigns.folder, results, draw, render, {"materials.csv": partial(_csv, records)})
    return campaigns.folder / "index.html"


def _samples(sources: Sequence[str]) -> tuple[dict[str, tuple[str, str]], dict[str, str]]:
    """File and sample by a name of each, and why files were passed over."""
    found, unread = dict[str, tuple[str, str]](), dict[str, str]()
    for label, file in _files(sources):
        if file.suffix == ".fit":
            continue
        try:
            for sample in measurement.tables(str(file), apart=True):
                name = f"{label} {sample}" if sample not in label else label
                found["".join(c if c.isalnum() or c in "-._" else "-" for c in name)] = str(file), sample
        except (GonioError, ValueError) as error:
            unread[label] = str(error).partition("\n")[0].removeprefix(f"{file}: ")
    return found, unread


def _files(sources: Sequence[str]) -> list[tuple[str, Path]]:
    """All files, with what the page calls them."""
    out = []
    for source in sources:
        given = Path(source)
        files = sorted(p for p in given.rglob("*") if p.is_file()) if given.is_dir() else [given]
        out += [(str(file.relative_to(given)) if given.is_dir() else file.name, file) for file in files]
    return out


def judged(name: str, file: str, sample: str, models: tuple[str, ...]) -> Record:
    """The record of one material."""
    record: Record = {"format": Settings().format, "name": name, "models": {}}
    try:
        data = _part(observations(measurement.tables(file, apart=True)[sample], name).nearest(None)[0])
        if len(data) < FEWEST:
            return {**record, "why": f"{len(data)} usable values"}
        choice = choose(data, candidates(models), name=name, all_of_them=True)
    except GonioError as error:
        return {**record, "why": str(error).partition("\n")[0]}
    by_model: Record = {}
    for one in sorted(choice.judged, key=lambda j: j.aic, reverse=True):  # the best form of a model stays
        left = None if one.misses is None else float(np.sqrt(np.median(one.misses)))
        by_model[one.candidate.model] = {
            "free": len(one.fit.free), "left_out": left, "aic": one.aic, "rejected": one.rejected,
            "fails": one.fails.words if one.fails is not None else "",
        }  # fmt: skip
    named = choice.named.candidate.model if choice.named else None
    return {
        **record, "values": len(data), "wavelength_nm": None if np.isnan(data.wavelength_nm[0]) else
        float(data.wavelength_nm[0]), "models": by_model, "not_rejected": named, "left_out_models": choice.left_out,
    }  # fmt: skip


def _part(data: Observations) -> Observations:
    if len(data) <= MOST:
        return data
    return data.take(np.sort(np.random.default_rng(1).choice(len(data), MOST, replace=False)))


def _errors(record: Record) -> dict[str, float]:
    models: Mapping[str, Record] = record["models"]
    return {name: one["left_out"] for name, one in models.items() if one["left_out"] is not None}


def _picture(records: Sequence[Record], models: Sequence[str]) -> Figure:
    rows = [record for record in records if _errors(record)]
    values = np.array([[_errors(r).get(m, np.nan) for m in models] for r in rows]).reshape(len(rows), len(models))

    def on(figure: Any) -> None:
        from gonio_analysis.plots.maps import SEQUENTIAL
        from matplotlib.colors import LogNorm

        figure.set_layout_engine("constrained")
        ax = figure.add_subplot()
        image = ax.imshow(100.0 * values, cmap=f"{SEQUENTIAL}_r", norm=LogNorm(1.0, 100.0), aspect="auto")
        ax.set_xticks(range(len(models)), models, rotation=60, ha="right", fontsize=8)
        ax.set_yticks(range(len(rows)), [str(r["name"])[-44:] for r in rows], fontsize=7)
        figure.colorbar(image, ax=ax, label="left-out value off by / %", extend="both")

    size = (4.0 + 0.42 * len(models), 2.0 + 0.24 * max(len(rows), 1))
    said = "Errors of values left out, by material and model; white: the model could not be fitted."
    return rendered(LEFT_OUT, "materials", "", said, said, size, on)


def _page(
    records: Sequence[Record], models: Sequence[str], unread: Mapping[str, str], fits: Record | None,
    drawn: Sequence[Figure],
) -> Page:  # fmt: skip
    good = [record for record in records if _errors(record)]
    nearest = {r["name"]: min(_errors(r), key=_errors(r).__getitem__) for r in good}
    rows = []
    for r in good:
        errors = _errors(r)
        near = [m for m in errors if errors[m] <= CLOSE * errors[nearest[r["name"]]]]
        rows.append([
            str(r["name"]), str(r["values"]), nearest[r["name"]], percent(errors[nearest[r["name"]]]),
            ", ".join([m for m in near if m != nearest[r["name"]]][:3]) or "–", str(r["not_rejected"] or "none"),
        ])  # fmt: skip
    families = []
    for m in models:
        own = [_errors(r)[m] for r in good if m in _errors(r)]
        where = [str(r["models"][m]["fails"]) for r in good if m in r["models"] and r["models"][m]["fails"]]
        often = max(set(where), key=where.count) if where else "–"
        first = sum(best == m for best in nearest.values())
        families.append([m, str(len(own)), str(first), percent(float(np.median(own))) if own else "–", often])
    passed = [[str(r["name"]), str(r["why"])] for r in records if "why" in r] + [list(x) for x in unread.items()]
    said = (
        f"{len(good)} materials, {len(models)} models. A value that a fit had not seen is off by so much: the median of"
        " |ln(model/measured)|, with whole incidences or ranges of angle left out."
    )
    table_of_models = table(
        "", ["model", "materials", "nearest of all", "median left-out error", "most often farthest off"],
        families, right=(1, 2, 3),
    )  # fmt: skip
    folds: list[Block] = []
    if rows:
        folds += [
            Heading(3, "Materials", f"{len(rows)}"),
            table(f"Near: within a factor {CLOSE:g} of the nearest model's error.",
                  ["material", "values", "nearest", "left-out error", "as near", "simplest not rejected"], rows,
                  right=(1, 3), most=(MOST_ROWS, "materials.csv")),
        ]  # fmt: skip
    widths = [figure for figure in drawn if figure.name != LEFT_OUT]
    if fits is not None:
        folds += parts({'section "Published fits"': partial(published.section, fits, widths)})
    if passed:
        folds += [
            Heading(3, "Passed over", f"{len(passed)}"),
            table("", ["file", "why"], passed, most=(MOST_ROWS, "results.json")),
        ]
    picture = Figures(tuple(figure for figure in drawn if figure.name == LEFT_OUT))
    answer = frame.answer([lead(_verdict(nearest, models, fits))], [picture], [table_of_models] if records else [])
    return frame.page(TITLE, said, answer, folds=folds, foot=FOOTER)


def _verdict(nearest: Mapping[str, str], models: Sequence[str], fits: Record | None) -> str:
    """Which model is nearest most often."""
    if not nearest:
        return "No material was fitted: only published fits were read." if fits else "No material was fitted."
    often = max(models, key=[*nearest.values()].count)
    count = [*nearest.values()].count(often)
    return f"{often} is the nearest of {len(models)} models for {count} of {len(nearest)} materials."


def _csv(records: Sequence[Record]) -> bytes:
    columns = ("free", "left_out", "aic", "rejected", "fails")
    rows = [
        {"material": r["name"], "model": m} | {k: one[k] for k in columns}
        for r in records
        for m, one in r["models"].items()
    ]
    return as_csv(rows, ("material", "model", *columns))
