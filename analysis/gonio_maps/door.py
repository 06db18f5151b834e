"""What commands of other packages do with maps (the group `gonio.rooms`); their options are read already."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.report.text import with_u

from gonio.cli import console
from gonio.errors import ConfigError
from gonio.geometry import direction
from gonio.platform import command_line
from gonio.typing import Floats
from gonio_maps.fits import fits
from gonio_maps.fits.tables import solved as solved

if TYPE_CHECKING:
    from gonio.lab.acquisition.run import Run
    from gonio.lab.reduction.brdf import Reduction
    from gonio_maps.reduction.maps import Written


def fit(
    path: Path, out: Path | None, asked: FitRequest, dask: str | None, materials: str | None, *, as_json: bool
) -> None:
    """Fit every pixel of a map, and print what came out."""
    if out is None:
        raise ConfigError(f"{path}: is a map; name the file of its fits with --out FITS.h5")
    with console.counter("fitting tiles", lines=True) as count:
        fits.make(path, out, asked, materials=materials, dask=dask, count=count, say=console.note)
    found = fits.summary(out)
    if as_json:
        print(json.dumps({"model": asked.model, "map": str(path), "out": str(out), **found.to_json()}, indent=1))
        return
    _print_map(found, f"{asked.model} on {path.name}")
    if found.materials:
        _print_materials(found)
    print(out)


def _print_map(found: fits.FitsSummary, title: str) -> None:
    rows = console.table("parameter", "median", "spread", "typical u", "", title=f"{title}: {found.pixels} pixels")
    for name, one in found.parameters.items():
        unit = "" if one.unit == "1" else f" {one.unit}"
        masked = f"not determined in {one.undetermined} pixels, masked there" if one.undetermined else ""
        numbers = [f"{v:.4g}{unit}" if math.isfinite(v) else "-" for v in (one.median, one.spread)]
        rows.add_row(name, *numbers, f"{one.u:.2g}{unit}" if math.isfinite(one.u) else "-", masked)
    share = 100.0 * found.rejected / max(found.fitted, 1)
    misfit = f", their misfit {found.misfit:.2g} (median)" if found.rejected else ""
    console.show(
        rows,
        f"fitted {found.fitted} of {found.pixels} pixels; the model is rejected in {share:.3g} % of them{misfit};"
        f" a parameter is at its bound in {found.at_bound}",
        "spread: half the distance between the 16th and the 84th percentile over the map",
    )


def _print_materials(found: fits.FitsSummary) -> None:
    rows = console.table("material", "pixels", "chi-square", *found.parameters, title="materials")
    for k, one in enumerate(found.materials):
        values = [with_u(one[f"material_{name}"], one[f"u_material_{name}"]) for name in found.parameters]
        rows.add_row(str(k), f"{one['material_pixels']:.0f}", f"{one['material_chi_square']:.4g}", *values)
    console.show(rows, "chi-square: a degree of freedom, of the values of a material's pixels fitted together")


def report(path: Path, out: Path | None, values: Path | None, unused: list[str]) -> Path:
    """The report on a map; `unused` names options that belong to fits."""
    from gonio_maps.report import map_page

    if out is None:
        raise ConfigError(f"{path}: the report on a map needs a folder: --out DIR")
    if unused:
        raise ConfigError(f"--{unused[0]}: {path} is a map, of which nothing is fitted here; leave it out")
    return map_page.make(path, out, values=values, command=command_line(), progress=console.note)


def change(specs: list[str], out: Path) -> Path:
    """The report on two maps of fits compared pixel by pixel."""
    from gonio_maps.report import map_change

    return map_change.make(specs, out, command=command_line(), progress=console.note)


def textures(source: str, target: Path) -> list[str]:
    """A map of fits as textures for renderers; what is to be said, what was done last."""
    from gonio_maps import textures

    return textures.write(source, target)


def require(run: Run, path: Path, pixel_mm: float | None) -> None:
    """Raise `ConfigError` or `DataError` where a run cannot become a map; before it is reduced."""
    from gonio_maps.reduction import maps

    maps.require(run, path, pixel_mm)


def reduce(run: Run, found: Reduction, path: Path, pixel_mm: float | None) -> None:
    """Write the map of a run that is reduced, and say what it has."""
    from gonio_maps.reduction import maps

    _show(path, maps.write(run, found, path, pixel_mm, partial(console.counter, lines=True)))


def _show(path: Path, written: Written) -> None:
    """What a map has."""
    rows, cols = written.shape
    part = 100.0 * written.good / max(written.values, 1)
    console.show(
        f"{path}: {rows} x {cols} pixels of {written.pixel_mm:g} mm, {written.points} points;"
        f" {part:.3g} % of the values on the sample without a flag"
    )
    if written.told:
        console.show(
            f"registered: the shifts of {written.told} points are told, the largest {written.largest_shift_mm:.2g} mm"
        )
    else:
        console.show("not registered: the sample has too little texture to tell a shift")
    for note in written.notes:
        console.note(note)


def jobs(directions: tuple[Floats, ...], brdf: Floats) -> list[Callable[[], Any]]:
    """Fits of one pixel by every model that has them, which `gonio warm` compiles."""
    from gonio_maps.models import batch
    from gonio_maps.models._batch_models import MODELS

    origin, values = np.zeros(1), brdf[None]
    source, camera = (1000.0 * direction(*directions[k : k + 2]) for k in (0, 2))
    return [partial(batch.fit, name, origin, origin, source, camera, values, 0.01 * values) for name in MODELS]
