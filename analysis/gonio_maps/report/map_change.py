"""The report on two maps of fits compared pixel by pixel (`gonio compare A.h5 B.h5 --change`)."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gonio_analysis.changes.verdict import FALSE_DISCOVERIES
from gonio_analysis.report import files, frame
from gonio_analysis.report.blocks import (
    Figures,
    Heading,
    Page,
    Paragraph,
    Stamp,
    Table,
    dated,
    facts,
    footer,
    lead,
    stamp,
    table,
)
from gonio_analysis.report.drawing import Drawing, Figure, figure_workers
from gonio_analysis.report.files import write_columns, write_csv
from gonio_analysis.report.text import counted, number, percent, with_u

from gonio import lost
from gonio_maps.pixel_by_pixel import MapChange, ParameterChange, change
from gonio_maps.report import map_layers
from gonio_maps.report.map_layers import MapPixels, Real, block_medians, facts_of_grid, labelled

FIGURES = 6
"""Figures that a comparison has, about."""
TOP = 6.0
"""Standard deviations at which colours are saturated."""
METHOD = (
    "In each pixel the differences of all parameters that both maps determine are judged together, by chi-square with"
    " the uncertainties and correlations of both. Pixels are marked after Benjamini and Hochberg: about"
    f" {100 * FALSE_DISCOVERIES:g} % of those marked did not change. Each parameter is judged by itself in the same"
    " way. Causes that all pixels share (lamp, reference) are in u. A change of all pixels alike may be one of these;"
    " a change of some pixels alone is not."
)
FOOTER = footer(
    "Every number on this page is in `summary.json`, every changed pixel in `tables/changed.csv`, the figures as SVG "
    "in `figures/`."
)


def make(
    specs: Sequence[str], out: str | Path, *, command: str = "", progress: Callable[[str], None] = lambda text: None
) -> Path:
    """Compare two maps of fits and write a report: all of it or nothing.

    Parameters
    ----------
    specs
        Two files of fits on one grid.
    out
        Folder of the report; an earlier report there is replaced.
    command, progress
        The command line, for the record; called with a line before each step.

    Returns
    -------
    Path
        Where `index.html` is.

    Raises
    ------
    ConfigError, DataError
        From reading, comparing and writing; then nothing is left behind.
    """
    with files.staged(out) as stage, figure_workers(FIGURES) as workers:
        progress(f"comparing {specs[1]} with {specs[0]}")
        found = change(*specs)
        progress(conclusion(found))
        tables = lost.kept("tables", lambda: _write_tables(found, stage.work / "tables"), lambda loss: [])
        made = stamp(command)
        files.write_page(
            stage.work,
            _title(specs),
            partial(_page, found, specs, made),
            lambda figures: {**_summary(found, specs, made), "figures": figures, "tables": tables},
            lambda: workers.draw(_drawings(found), progress),
        )
    return Path(out) / "index.html"


def conclusion(c: MapChange) -> str:
    """The headline."""
    n = int(c.changed.sum())
    if not c.compared:
        return "Nothing can be compared: no pixel has a parameter that is determined in both maps."
    if not n:
        return f"No sign that anything changed: none of {c.compared} pixels stands out, all judged together."
    own = [f"{x.name} in {int(x.marked.sum())}" for x in c.parameters if x.marked.any()]
    each = f" Each parameter by itself changed: {', '.join(own)}." if own else ""
    by_chance = 100 * FALSE_DISCOVERIES
    return f"{n} of {c.compared} pixels changed ({percent(c.share)}), about {by_chance:g} % of these by chance.{each}"


def _of(c: MapChange, x: ParameterChange) -> dict[str, float | int | str | None]:
    """Numbers of one parameter."""

    def median(values: Real) -> float | None:
        known = values[np.isfinite(values)]
        return float(np.median(known)) if known.size else None

    return {
        "unit": x.unit,
        "compared": int(np.isfinite(x.z).sum()),
        "changed": int(x.marked.sum()),
        "median_change": median(x.difference),
        "median_change_where_changed": median(x.difference[c.changed]),
        "typical_u": x.u,
        "median_z": median(x.z),
    }


def _summary(c: MapChange, specs: Sequence[str], made: Stamp) -> dict[str, object]:
    return {
        "title": _title(specs),
        **made,
        "conclusion": conclusion(c),
        "a": specs[0],
        "b": specs[1],
        "model": c.model,
        **facts_of_grid(MapPixels(c.x_mm, c.y_mm)),
        "pixels": c.changed.size,
        "compared": c.compared,
        "changed": int(c.changed.sum()),
        "share": c.share,
        "false_discoveries": FALSE_DISCOVERIES,
        "parameters": {x.name: _of(c, x) for x in c.parameters},
    }


def _title(specs: Sequence[str]) -> str:
    return f"{Path(specs[1]).stem} against {Path(specs[0]).stem}, pixel by pixel"


def _drawings(c: MapChange) -> list[Drawing]:
    grid = MapPixels(c.x_mm, c.y_mm)
    kind = np.where(c.freedom == 0, -1, c.changed.astype(np.intp))
    words = "Changed: pixels whose parameters together changed. Grey: nothing to compare."
    out = [map_layers.kinds(grid, "changed", words, kind, ["not changed", "changed"])]
    for x in c.parameters:
        name = labelled(x.name, "")
        caption = f"Change of {name}: (B - A) in standard deviations of the difference; colours end at ±{TOP:g}."
        picture = block_medians(grid, x.z)
        out.append(map_layers.signed(grid, f"z-{x.name}", caption.replace(" - ", " − "), picture, f"z of {name}", TOP))
    return out


def _write_tables(c: MapChange, folder: Path) -> list[str]:
    """Parameters, and every changed pixel; the names of the files."""
    of = {x.name: _of(c, x) for x in c.parameters}
    write_csv(
        folder / "parameters.csv", ("parameter", *next(iter(of.values()))), ((n, *o.values()) for n, o in of.items())
    )
    rows, cols = np.nonzero(c.changed)
    columns: dict[str, npt.NDArray[Any]] = {"row": rows, "column": cols, "x_mm": c.x_mm[cols], "y_mm": c.y_mm[rows]}
    columns |= {"chi_square": c.chi_square[rows, cols], "freedom": c.freedom[rows, cols], "p": c.p[rows, cols]}
    for x in c.parameters:
        columns |= {f"change_{x.name}": x.difference[rows, cols], f"z_{x.name}": x.z[rows, cols]}
    write_columns(folder / "changed.csv", list(columns), [list(columns.values())])
    return ["parameters.csv", "changed.csv"]


def _page(c: MapChange, specs: Sequence[str], made: Stamp, figures: Sequence[Figure]) -> Page:
    folds = [
        Heading(3, "By parameter", counted(len(c.parameters), "parameter")),
        Figures(tuple(figures[1:])),
        _in_full(c),
        Heading(3, "What was compared", f"{c.compared} of {c.changed.size} pixels"),
        facts([("A", specs[0]), ("B", specs[1]), ("model", c.model)]),
        Heading(3, "How it is judged", "every pixel by chi-square of all its parameters"),
        Paragraph(METHOD),
        *frame.provenance(made),
    ]
    first = frame.answer([lead(conclusion(c))], [Figures(tuple(figures[:1]))], [_changed(c)])
    return frame.page(_title(specs), dated("Two maps", made), first, folds=folds, foot=FOOTER)


def _changed(c: MapChange) -> Table:
    rows = []
    for x in c.parameters:
        where = (of := _of(c, x))["median_change_where_changed"]
        rows.append([labelled(x.name, x.unit), str(of["changed"]), "–" if where is None else with_u(float(where), x.u)])
    head = ["parameter", "pixels changed by itself", "median change of changed pixels ± u of one"]
    return table("", head, rows, right=(1, 2))


def _in_full(c: MapChange) -> Table:
    rows = [
        [labelled(x.name, x.unit), str(of["compared"]), number(of["median_change"], 3), number(of["median_z"], 2)]  # type: ignore[arg-type]
        for x in c.parameters for of in [_of(c, x)]
    ]  # fmt: skip
    head = ["parameter", "pixels compared", "median change of all", "median z"]
    return table("z: the change in standard deviations of the difference.", head, rows, right=(1, 2, 3))
