"""The report on a map: what was fitted to every pixel of a sample, or what was measured there."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from gonio.errors import ConfigError
from gonio.maps import FitFile, MapFile
from gonio_analysis.report import files, html, map_figures, map_layers, map_values, map_view
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Footer,
    Heading,
    Page,
    PixelViewer,
    Stamp,
    Table,
    code,
    facts,
    header,
    lead,
    provenance,
    stamp,
    table,
)
from gonio_analysis.report.drawing import figure_workers
from gonio_analysis.report.drawings import Figure
from gonio_analysis.report.map_layers import SEVERE, Grid, Layer, Materials, Told
from gonio_analysis.report.page import MOST_BYTES
from gonio_analysis.report.tables import write_csv
from gonio_analysis.report.text import number, percent, with_u

FIGURES = 10
"""That a map has, about."""
BY_CHANCE = 0.01
"""Share of pixels that reject a model that is true (`gonio.models.batch.SIGNIFICANCE`)."""
MEANINGS = {
    "too_few": "not more values than parameters",
    "undetermined": "the values do not tell the parameters",
    "rejected": "chi-square rejects the model (1 %)",
    "at_bound": "a parameter ended at its bound",
    "outside": "the picture does not show the pixel",
    "saturated": "the sensor was full",
    "hot": "a defect of the sensor",
    "shadowed": "an arm or the holder stood in the way",
    "blurred": "the lens blurs it over an edge",
}
FOOTER = Footer(
    (
        *(
            "Every number on this page is in ",
            code("summary.json"),
            " and in ",
            code("tables/"),
            ", the figures as SVG",
        ),
        *(" and PNG in ", code("figures/"), ". The map itself opens with xarray.open_dataset."),
    )
)


def make(
    path: Path,
    out: str | Path,
    *,
    values: Path | None = None,
    command: str = "",
    progress: Callable[[str], None] = lambda text: None,
) -> Path:
    """Write the report on a map: all of it or nothing.

    Parameters
    ----------
    path
        A map of fits, or one of values.
    out
        Folder of the report; an earlier report there is replaced.
    values
        The map of values that was fitted, where it is not at the place that the fits name.
    command, progress
        The command line, for the record; called with a line before each step.

    Returns
    -------
    Path
        Of `index.html`.

    Raises
    ------
    ConfigError, DataError
        From reading and writing; then nothing is left behind.
    """
    with MapFile(path) as file:
        fitted = "brdf" not in file.names
    if values is not None and not fitted:
        raise ConfigError(f"--map {values}: {path} is a map of values itself; leave it out")
    with files.staged(out) as stage, figure_workers(FIGURES) as workers:
        told = _of_fits(path, values, progress) if fitted else map_values.told(path, progress)
        figures = workers.draw(told.drawings, progress)
        tables = _write_tables(told, stage.work / "tables")
        made = stamp(command)
        summary = {"title": told.title, **made, "conclusion": told.conclusion, **told.summary}
        summary |= {"figures": figures, "tables": tables}
        files.write_page(stage.work, _page(told, made, figures), summary, figures, printed=True)
    return Path(out) / "index.html"


# --- what a map of fits says ------------------------------------------------------------------------------------------


def _of_fits(path: Path, values: Path | None, progress: Callable[[str], None]) -> Told:
    with FitFile(path) as file:
        grid = Grid.of(file)
        layers = map_layers.of_fits(file, progress)
        counts, kind = map_layers.flag_counts(file), map_layers.gravest(file)
        caption = "Flags: the gravest of each pixel. " + "; ".join(f"{_said(k)}, {n}" for k, n in counts.items() if n)
        flags = map_figures.kinds(grid, "flags", caption.rstrip(". ") + ".", kind, ["none", *map(_said, SEVERE)])
        drawings = map_figures.draw(grid, layers)
        drawings.insert(len(drawings) - (drawings[-1].kind == "histograms"), flags)
        materials = _materials(file)
        if materials is not None:
            names = [f"material {k + 1}" for k in range(len(materials.rows))]
            words = "Materials: which each pixel belongs to."
            drawings.append(map_figures.kinds(grid, "materials", words, materials.kind, names))
        conclusion = _conclusion(file, grid, layers, counts)
        told = {
            "source": str(path), "model": file.model, "fixed": file.fixed, **map_layers.facts_of_grid(grid),
            "flags": counts, "parameters": {one.name: {"unit": one.unit, **one.spread.summary()} for one in layers},
        }  # fmt: skip
        if materials is not None:
            told["materials"] = [{"share": s, **row} for s, row in zip(_shares(materials), materials.rows, strict=True)]
        title = f"{file.attrs.get('sample') or file.path.stem}: {file.model} in every pixel"
        rows = [("file", str(path)), ("model", file.model), ("pixels", map_layers.pixels_of(grid))]
        told_nm = float(file.attrs.get("wavelength_nm", np.nan))
        nm = None if np.isnan(told_nm) else told_nm
        if nm is not None:
            others = any("@" in name for name in file.parameters)
            rows.append(("wavelength", f"{nm:g} nm" + ("; of others where a name says so" if others else "")))
        if file.fixed:
            rows.append(("not fitted", ", ".join(f"{name} = {value:g}" for name, value in file.fixed.items())))
        measured = map_layers.map_of(file, values)
        rows.append(("measured values", str(measured) if measured else "not at hand: --map MAP.h5 brings them"))
        with ExitStack() as stack:
            there = stack.enter_context(MapFile(measured)) if measured else None
            view = map_view.of(
                grid, layers, kind, ["none", *map(_said, SEVERE)], model=file.model, fixed=file.fixed, values=there,
                wavelength_nm=nm,
            )  # fmt: skip
        total = grid.shape[0] * grid.shape[1]
        return Told(title, conclusion, layers, rows, counts, "pixels", total, drawings, told, view, materials)


def _said(flag: str) -> str:
    return flag.replace("_", " ")


def _conclusion(file: FitFile, grid: Grid, layers: Sequence[Layer], counts: dict[str, int]) -> str:
    total = grid.shape[0] * grid.shape[1]
    own = [one for one in layers if one.name in file.parameters]
    fitted = max((one.spread.determined for one in own), default=0)
    each = ", ".join(f"{one.name} {with_u(one.spread.median, one.spread.typical_u)}" for one in own)
    left, right, low, high = grid.extent
    words = [
        f"{file.model} is determined in {fitted} of {total} pixels of {grid.pixel_mm:.3g} mm,"
        f" over {right - left:.4g} mm × {high - low:.4g} mm.",
        f"Median of the pixels, with the typical standard uncertainty of one: {each}." if fitted else "",
    ]
    usable = total - counts["too_few"]
    if usable:
        share = counts["rejected"] / usable
        words.append(f"{percent(share)} of them reject the model, where {percent(BY_CHANCE)} do by chance.")
    return " ".join(word for word in words if word)


def _materials(file: FitFile) -> Materials | None:
    """The materials of a map that was fitted with some."""
    if "membership" not in file.names:
        return None
    own = {name: file.array(f"material_{name}") for name in ("pixels", "chi_square")}
    for name in file.parameters:
        own |= {name: file.array(f"material_{name}"), f"u_{name}": file.array(f"u_material_{name}")}
    rows = [dict(zip(own, map(float, row), strict=True)) for row in zip(*own.values(), strict=True)]
    return Materials(file.array("membership").astype(np.intp), rows)


def _shares(materials: Materials) -> list[float]:
    return [float(np.mean(materials.kind == k)) for k in range(len(materials.rows))]


# --- tables and page --------------------------------------------------------------------------------------------------


def _write_tables(told: Told, folder: Path) -> list[str]:
    """Parameters, flags, histograms and materials; the names of the files."""
    first = told.layers[0].spread.summary() if told.layers else {}
    write_csv(
        folder / "parameters.csv",
        ("parameter", "unit", *first),
        ((one.name, one.unit, *one.spread.summary().values()) for one in told.layers),
    )
    write_csv(folder / "flags.csv", ("flag", told.counted), told.counts.items())
    write_csv(
        folder / "histograms.csv",
        ("parameter", "from", "to", "pixels"),
        (
            (one.name, low, high, int(count))
            for one in told.layers
            for low, high, count in zip(
                one.spread.edges[:-1].tolist(), one.spread.edges[1:].tolist(), one.spread.counts, strict=True
            )
        ),
    )
    names = ["parameters.csv", "flags.csv", "histograms.csv"]
    if told.materials is not None:
        keys = list(dict.fromkeys(key for row in told.materials.rows for key in row))
        rows = [
            (k, share, *(row.get(key) for key in keys))
            for k, (share, row) in enumerate(zip(_shares(told.materials), told.materials.rows, strict=True), 1)
        ]
        write_csv(folder / "materials.csv", ("material", "share", *keys), rows)
        names.append("materials.csv")
    return names


def _page(told: Told, made: Stamp, figures: Sequence[Figure]) -> Page:
    sub = (
        f"A map, {made['created'][:10]}, gonio {made['versions']['gonio']}. Uncertainties are standard uncertainties"
        " (k = 1)."
    )
    first = [f for f in figures if f.kind == "map"]
    rest = [f for f in figures if f.kind != "map"]
    body: list[Block] = [header(told.title, sub), lead(told.conclusion), facts(told.facts)]
    body += [Heading(3, "A pixel under the cursor"), PixelViewer("pixels", told.view)]
    after: list[Block] = [Heading(3, "Spread over the pixels"), *([Figures(tuple(rest))] if rest else [])]
    after += [_parameters(told), Heading(3, "Flags"), _flags(told)]
    if told.materials is not None:
        after += [Heading(3, "Materials"), _of_materials(told.materials)]
    after += [Heading(2, "Provenance"), provenance(made), FOOTER]
    room = MOST_BYTES - html.size(html.document(Page(told.title, (*body, *after))))
    return Page(told.title, (*body, Heading(3, "Maps"), html.within(Figures(tuple(first)), room), *after))


def _parameters(told: Told) -> Table:
    rows = [
        [one.label, number(s.median, 4), number(s.typical_u, 2) if np.isfinite(s.typical_u) else "–",
         f"{number(s.low)} to {number(s.high)}", f"{number(s.least)} to {number(s.most)}", str(s.determined)]
        for one in told.layers for s in [one.spread]
    ]  # fmt: skip
    caption = "Over all pixels in which they are determined. Typical u: the median standard uncertainty of a pixel."
    head = ["", "median", "typical u", "99 % of pixels", "least to most", "determined in"]
    return table(caption, head, rows, right=(1, 2, 3, 4, 5))


def _flags(told: Told) -> Table:
    rows = [[_said(k), MEANINGS.get(k, ""), str(n), percent(n / told.total)] for k, n in told.counts.items()]
    caption = f"{told.counted.capitalize()} may have several."
    return table(caption, ["flag", "meaning", told.counted, "share"], rows, right=(2, 3))


def _of_materials(materials: Materials) -> Table:
    names = [name for name in materials.rows[0] if f"u_{name}" in materials.rows[0]]
    rows = [
        [f"material {k}", f"{row['pixels']:.0f}", percent(share), number(row["chi_square"], 3),
         *(with_u(row[name], row[f"u_{name}"]) for name in names)]
        for k, (share, row) in enumerate(zip(_shares(materials), materials.rows, strict=True), 1)
    ]  # fmt: skip
    caption = "Pixels that are alike, fitted together. Chi-square: a degree of freedom of that fit."
    head = ["", "pixels", "share", "chi-square", *names]
    return table(caption, head, rows, right=tuple(range(1, len(head))))
