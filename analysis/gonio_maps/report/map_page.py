"""The report on a map: what was fitted to every pixel of a sample, or what was measured there.

Of a map of values it shows values towards the mirror direction, their u, and what cannot be used.
"""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
from gonio_analysis.curves.in_plane import evenly
from gonio_analysis.report import files, frame, html
from gonio_analysis.report.blocks import (
    Block,
    Figures,
    Heading,
    Page,
    PixelViewer,
    Stamp,
    Table,
    dated,
    facts,
    figures_of,
    footer,
    lead,
    missing,
    stamp,
    table,
)
from gonio_analysis.report.drawing import Drawing, Figure, figure_workers
from gonio_analysis.report.files import write_csv
from gonio_analysis.report.page import MOST_BYTES
from gonio_analysis.report.section import parts
from gonio_analysis.report.text import counted, number, percent, with_u

from gonio import lost
from gonio.checks.values import SIGNIFICANCE
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.threads import in_threads
from gonio_maps.files import FLAGS, FitFile, MapFile, Tile
from gonio_maps.report import map_layers, map_view
from gonio_maps.report.map_layers import SEVERE, Layer, MapPixels, Materials, Real, Told

SHOWN = 4
"""Points that have a map of their own."""
KINDS = ("all usable", "some flagged", "none usable")


@dataclass(frozen=True)
class _Found:
    """What one way through the file tells."""

    brdf: Real
    """(points, rows, columns)"""
    u: Real
    usable: Real
    """Values of each pixel."""
    relative: Real
    """Median over its values of u / brdf."""
    counts: dict[str, int]


def _of_values(path: Path, progress: Callable[[str], None]) -> Told:
    """What the page says of a map of values."""
    with MapFile(path) as file:
        grid, at = MapPixels.of(file), _directions(file)
        shown = _shown(at)
        progress(f"reading {path}")
        found = _read(file, shown)
        layers = [
            map_layers.layer(grid, _name(at, k), "1/sr", found.brdf[j], found.u[j]) for j, k in enumerate(shown)
        ] + [
            map_layers.layer(grid, "u / value", "", found.relative),
            map_layers.layer(grid, "usable values", "", found.usable),
        ]  # fmt: skip
        points, pixels = len(at), grid.shape[0] * grid.shape[1]
        kind = np.where(found.usable == points, 0, np.where(found.usable == 0, 2, 1)).astype(np.intp)
        drawings = _drawings(grid, layers, "Flags: whether the values of a pixel can be used.", kind, KINDS)
        share = float(found.usable.sum()) / (points * pixels)

        def conclusion() -> str:
            return (
                f"{points} directions were measured in {pixels} pixels of {grid.pixel_mm:.3g} mm; {percent(share)} of"
                f" the values can be used. A value typically has a standard uncertainty of its own of"
                f" {_typical(layers)}."
            )

        numbers = {
            "source": str(path), **map_layers.facts_of_grid(grid), "points": points, "usable": share,
            "flags": found.counts, "parameters": {x.name: {"unit": x.unit, **x.spread.summary()} for x in layers},
        }  # fmt: skip
        view = _view(partial(map_view.of, grid, layers, kind, KINDS, model="", fixed={}, values=file))
        title = f"{file.attrs.get('sample') or file.path.stem}: values of every pixel"
        return Told(
            title, _headline(conclusion), layers, _facts(file, grid), found.counts, "values", points * pixels, drawings,
            numbers, view,
        )  # fmt: skip


def _drawings(
    grid: MapPixels, layers: Sequence[Layer], caption: str, kind: npt.NDArray[np.intp], names: Sequence[str],
    materials: Materials | None = None,
) -> list[Drawing]:  # fmt: skip
    """Maps of layers and flags, histograms, and the map of materials; none where a page lost them."""

    def draw() -> list[Drawing]:
        out = map_layers.draw(grid, layers)
        out.insert(len(out) - (out[-1].kind == "histograms"), map_layers.kinds(grid, "flags", caption, kind, names))
        if materials is not None:
            named = [f"material {k + 1}" for k in range(len(materials.rows))]
            words = "Materials: which each pixel belongs to."
            out.append(map_layers.kinds(grid, "materials", words, materials.kind, named))
        return out

    return lost.kept("figures", draw, lambda loss: [])


def _view(of: Callable[[], map_view.View]) -> Block:
    return lost.kept("the interactive plot", lambda: PixelViewer("pixels", of()), missing)


def _headline(of: Callable[[], str]) -> str:
    return lost.kept("the headline", of, lambda loss: f"Missing: {loss.words}.")


def _typical(layers: list[Layer]) -> str:
    middle = next(x for x in layers if x.name == "u / value").spread.median
    return percent(middle) if np.isfinite(middle) else "unknown size"


def _directions(file: MapFile) -> Directions:
    names = ("theta_i", "phi_i", "theta_r", "phi_r")
    return Directions(*(np.radians(file.array(f"{name}_deg").astype(float)) for name in names))


def _shown(at: Directions) -> list[int]:
    """The points nearest to the mirror direction, at a few angles of incidence."""
    tilt = np.round(np.degrees(at.theta_i), 1)
    off = np.hypot(at.theta_r * np.cos(at.dphi) + at.theta_i, at.theta_r * np.sin(at.dphi))
    nearest = [int(here[np.argmin(off[here])]) for t in np.unique(tilt) for here in [np.flatnonzero(tilt == t)]]
    return [nearest[k] for k in evenly(len(nearest), SHOWN)]


def _name(at: Directions, k: int) -> str:
    theta_i, theta_r, dphi = (float(np.degrees(x[k])) for x in (at.theta_i, at.theta_r, at.dphi))
    side = "" if at.in_plane[k] else f", Δφ = {dphi:.0f}°"
    signed = float(np.degrees(at.signed[k])) if at.in_plane[k] else theta_r
    return f"BRDF at θi = {theta_i:.3g}°, θr = {signed:.3g}°{side}"


def _read(file: MapFile, shown: list[int]) -> _Found:
    shape = file.shape
    brdf, u = np.full((2, len(shown), *shape), np.nan, np.float32)
    usable, relative = np.zeros(shape, np.float32), np.full(shape, np.nan, np.float32)
    counts = np.zeros(len(FLAGS), int)

    def look(tile: Tile) -> npt.NDArray[np.intp]:
        at = np.s_[tile.rows, tile.cols]
        values, error = file.values(tile)
        for j, k in enumerate(shown):
            brdf[j][at], u[j][at] = values[..., k], error[..., k]
        usable[at] = np.isfinite(values).sum(axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = error / np.abs(values)
        some = np.isfinite(part).any(axis=-1)
        relative[at][some] = np.nanmedian(part[some], axis=-1)
        bits = file.array("flag", tile)
        return np.array([np.count_nonzero(bits >> k & 1) for k in range(len(FLAGS))])

    for found in in_threads(look, file.tiles()):
        counts += found
    return _Found(brdf, u, usable, relative, dict(zip(FLAGS, counts.tolist(), strict=True)))


def _facts(file: MapFile, grid: MapPixels) -> list[tuple[str, str]]:
    """Size, points, blur and registration."""
    rows = [("file", str(file.path)), ("pixels", map_layers.pixels_of(grid))]
    tilt = np.unique(np.round(file.array("theta_i_deg").astype(float), 1))
    listed = ", ".join(f"{t:g}°" for t in tilt[:8]) + (" and more" if tilt.size > 8 else "")
    rows.append(("points", f"{len(file.array('theta_i_deg'))}, at θi = {listed}"))
    if "footprint_mm" in file.names:
        width = float(np.nanmedian(file.array("footprint_mm")))
        rows.append(("footprint", f"typically {number(width)} mm, blur of the lens included"))
    if "shift_mm" in file.names:
        shift, u = (file.array(name).astype(float) for name in ("shift_mm", "u_shift_mm"))
        told = np.isfinite(u)  # of an edge or of streaks that across it alone
        if told.any():
            largest = number(np.abs(shift[told]).max(), 2)
            rows.append(
                ("registration", f"shifts up to {largest} mm along x or y, u up to {number(u[told].max(), 2)} mm")
            )
    if file.causes:
        rows.append(("causes that pixels share", ", ".join(name.removeprefix("s_") for name in file.causes)))
    return rows


FIGURES = 10
"""Figures that a map has, about."""
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
FOOTER = footer(
    "Every number on this page is in `summary.json` and in `tables/`, the figures as SVG in `figures/`. The "
    "map itself opens with xarray.open_dataset."
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
        Where `index.html` is.

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
        told = _of_fits(path, values, progress) if fitted else _of_values(path, progress)
        tables = _write_tables(told, stage.work / "tables")
        made = stamp(command)
        summary = {"title": told.title, **made, "conclusion": told.conclusion, **told.summary}
        files.write_page(
            stage.work,
            told.title,
            partial(_page, told, made),
            lambda figures: {**summary, "figures": figures, "tables": tables},
            lambda: workers.draw(told.drawings, progress),
        )
    return Path(out) / "index.html"


# --- what a map of fits says ------------------------------------------------------------------------------------------


def _of_fits(path: Path, values: Path | None, progress: Callable[[str], None]) -> Told:
    with FitFile(path) as file:
        grid = MapPixels.of(file)
        layers = map_layers.of_fits(file, progress)
        counts, kind = map_layers.flag_counts(file), map_layers.gravest(file)
        caption = "Flags: the gravest of each pixel. " + "; ".join(f"{_said(k)}, {n}" for k, n in counts.items() if n)
        materials, names = _materials(file), ["none", *map(_said, SEVERE)]
        drawings = _drawings(grid, layers, caption.rstrip(". ") + ".", kind, names, materials)
        conclusion = _headline(partial(_conclusion, file, grid, layers, counts))
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
            view = _view(
                partial(
                    map_view.of, grid, layers, kind, names, model=file.model, fixed=file.fixed, values=there,
                    wavelength_nm=nm,
                )
            )  # fmt: skip
        total = grid.shape[0] * grid.shape[1]
        return Told(title, conclusion, layers, rows, counts, "pixels", total, drawings, told, view, materials)


def _said(flag: str) -> str:
    return flag.replace("_", " ")


def _conclusion(file: FitFile, grid: MapPixels, layers: Sequence[Layer], counts: dict[str, int]) -> str:
    total = grid.shape[0] * grid.shape[1]
    own = [one for one in layers if one.name in file.parameters]
    fitted = max((one.spread.determined for one in own), default=0)
    each = ", ".join(f"{one.name} {with_u(one.spread.median, one.spread.typical_u)}" for one in own)
    usable = total - counts["too_few"]
    rejects = ""
    if usable:
        share = percent(counts["rejected"] / usable)
        rejects = f"; {share} of those with values reject it, where {percent(SIGNIFICANCE)} do by chance"
    determined = f"{file.model} is determined in {fitted} of {total} pixels of {grid.pixel_mm:.3g} mm{rejects}."
    median = f"Median of the pixels, with the typical standard uncertainty of one: {each}."
    return f"{determined} {median}" if fitted else determined


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
    made = files.written(folder / "parameters.csv", partial(_parameters_table, told))
    made += files.written(folder / "flags.csv", partial(_flags_table, told))
    made += files.written(folder / "histograms.csv", partial(_histograms_table, told))
    if told.materials is not None:
        made += files.written(folder / "materials.csv", partial(_materials_table, told.materials))
    return made


def _parameters_table(told: Told, path: Path) -> None:
    first = told.layers[0].spread.summary() if told.layers else {}
    write_csv(
        path,
        ("parameter", "unit", *first),
        ((one.name, one.unit, *one.spread.summary().values()) for one in told.layers),
    )


def _flags_table(told: Told, path: Path) -> None:
    write_csv(path, ("flag", told.counted), told.counts.items())


def _histograms_table(told: Told, path: Path) -> None:
    write_csv(
        path,
        ("parameter", "from", "to", "pixels"),
        (
            (one.name, low, high, int(count))
            for one in told.layers
            for low, high, count in zip(
                one.spread.edges[:-1].tolist(), one.spread.edges[1:].tolist(), one.spread.counts, strict=True
            )
        ),
    )


def _materials_table(materials: Materials, path: Path) -> None:
    keys = list(dict.fromkeys(key for row in materials.rows for key in row))
    rows = [
        (k, share, *(row.get(key) for key in keys))
        for k, (share, row) in enumerate(zip(_shares(materials), materials.rows, strict=True), 1)
    ]
    write_csv(path, ("material", "share", *keys), rows)


def _page(told: Told, made: Stamp, figures: Sequence[Figure]) -> Page:
    every = [f for f in figures if f.kind == "map"]
    rest = [f for f in figures if f.kind != "map"]
    behind: list[Block] = []
    if rest:
        behind += [Heading(3, "Spread over the pixels", counted(len(told.layers), "histogram")), Figures(tuple(rest))]
    raised = [f"{_said(k)} {n}" for k, n in told.counts.items() if n]
    behind += [Heading(3, "Flags", ", ".join(raised) or "none"), *parts({"the table of flags": partial(_flags, told)})]
    if told.materials is not None:
        behind.append(Heading(3, "Materials", counted(len(told.materials.rows), "material")))
        behind += parts({"the table of materials": partial(_of_materials, told.materials)})
    behind += [Heading(3, "What was mapped", _pixels(told)), facts(told.facts), *frame.provenance(made)]
    parameters = parts({"the table of parameters": partial(_parameters, told)})

    def of(maps: Sequence[Figure]) -> Page:
        picture = [told.view, Figures(tuple(maps[:1]), printed=True)]
        first = frame.answer([lead(told.conclusion)], picture)
        others = [Heading(3, "Maps", counted(len(maps), "map")), Figures(tuple(maps[1:]))]
        folds = [*others, *behind]
        return frame.page(told.title, dated("A map", made), first, shown=parameters, folds=folds, foot=FOOTER)

    room = MOST_BYTES - html.size(html.document(of([])))
    return of(figures_of([html.within(Figures(tuple(every)), room)]))


def _pixels(told: Told) -> str:
    """Which pixels a map has."""
    return next((value for name, value in told.facts if name == "pixels"), "")


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
