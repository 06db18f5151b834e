"""What the page of a map of values shows: values towards the mirror direction, their u, and what cannot be used."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gonio.geometry import Directions
from gonio.maps import FLAGS, MapFile, Tile
from gonio.reduction.threads import in_threads
from gonio_analysis.curves.in_plane import evenly
from gonio_analysis.report import map_figures, map_layers, map_view
from gonio_analysis.report.map_layers import Grid, Layer, Real, Told
from gonio_analysis.report.text import number, percent

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


def told(path: Path, progress: Callable[[str], None]) -> Told:
    """What the page says of a map of values."""
    with MapFile(path) as file:
        grid, at = Grid.of(file), _directions(file)
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
        flags = map_figures.kinds(grid, "flags", "Flags: whether the values of a pixel can be used.", kind, KINDS)
        drawings = map_figures.draw(grid, layers)
        drawings.insert(len(drawings) - (drawings[-1].kind == "histograms"), flags)
        share = float(found.usable.sum()) / (points * pixels)
        conclusion = (
            f"{points} directions were measured in {pixels} pixels of {grid.pixel_mm:.3g} mm; {percent(share)} of the"
            f" values can be used. A value typically has a standard uncertainty of its own of {_typical(layers)}."
        )
        numbers = {
            "source": str(path), **map_layers.facts_of_grid(grid), "points": points, "usable": share,
            "flags": found.counts, "parameters": {x.name: {"unit": x.unit, **x.spread.summary()} for x in layers},
        }  # fmt: skip
        view = map_view.of(grid, layers, kind, KINDS, model="", fixed={}, values=file)
        title = f"{file.attrs.get('sample') or file.path.stem}: values of every pixel"
        return Told(
            title, conclusion, layers, _facts(file, grid), found.counts, "values", points * pixels, drawings, numbers,
            view,
        )  # fmt: skip


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


def _facts(file: MapFile, grid: Grid) -> list[tuple[str, str]]:
    """Size, points, blur and registration."""
    rows = [("file", str(file.path)), ("pixels", map_layers.pixels_of(grid))]
    tilt = np.unique(np.round(file.array("theta_i_deg").astype(float), 1))
    listed = ", ".join(f"{t:g}°" for t in tilt[:8]) + (" and more" if tilt.size > 8 else "")
    rows.append(("points", f"{len(file.array('theta_i_deg'))}, at θi = {listed}"))
    if "footprint_mm" in file.names:
        width = float(np.nanmedian(file.array("footprint_mm")))
        rows.append(("footprint", f"typically {number(width)} mm, blur of the lens included"))
    if "shift_mm" in file.names:
        shift, u = (np.linalg.norm(file.array(n).astype(float), axis=1) for n in ("shift_mm", "u_shift_mm"))
        if np.isfinite(shift).any():
            rows.append(
                ("registration", f"shifts up to {number(np.nanmax(shift), 2)} mm, u up to {number(np.nanmax(u), 2)} mm")
            )
    if file.causes:
        rows.append(("causes that pixels share", ", ".join(name.removeprefix("s_") for name in file.causes)))
    return rows
