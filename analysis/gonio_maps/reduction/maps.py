"""A run as a map: its BRDF in every pixel of a grid on the sample. What `gonio reduce RUN --map` does (docs/maps.md).

1. The frames of every point become one picture of the camera each (`gonio_maps.reduction.map_planes`).
2. The pictures tell by how much they lie beside each other (`gonio_maps.reduction.registration`).
3. Tiles of the grid look up all points (`gonio_maps.reduction.map_grid`), and become the file (`gonio_maps.files`).

Every picture and every tile is a file beside the map to be: what was killed goes on with those that are missing.
"""

from __future__ import annotations

import hashlib
import math
import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio import hdf5
from gonio.errors import ConfigError, DataError
from gonio.geometry import ANGLES_DEG
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction.brdf import Reduction
from gonio.lab.reduction.count_rates import RunFrames
from gonio.lab.rig import kinematics
from gonio.lab.rig.regions import filling
from gonio.threads import in_threads
from gonio.typing import DataFrame, Floats
from gonio_maps import files
from gonio_maps.files import FLAGS, Parts, Tile, Variable
from gonio_maps.reduction.map_grid import Grid, Lookup, grid
from gonio_maps.reduction.map_planes import OUTSIDE, PIXEL, MapPoint, Planes, lattices
from gonio_maps.reduction.registration import shifts

MANY_POINTS = 1500
"""Number of points above which one tile is made at a time: it takes 0.3 MB a point."""
OF_REGION = ("noise", "prnu", "dark", "region")
"""Parts of a value's `u_random` that the pixels of the table's region have in common, and other pixels do not."""
Counter = Callable[[str], AbstractContextManager[Callable[[int, int], None]]]
"""Shows how much of a named piece of work is done."""


@dataclass(frozen=True)
class Written:
    """What a map file has."""

    shape: tuple[int, int]
    points: int
    pixel_mm: float
    good: int
    """Values without a flag."""
    values: int
    """All of them within the sample's disc."""
    told: int
    """Points whose shift was determined."""
    largest_shift_mm: float
    notes: list[str]


def require(run: Run, path: Path, pixel_mm: float | None) -> None:
    """Raise what `write` would of a run that gives no map, of a file's name and of a pixel size, before any work."""
    hdf5.library()
    description = run.description
    if path.suffix not in hdf5.MAP_SUFFIXES:
        raise ConfigError(f"{path}: a map is an HDF5 file; give --map a name that ends with .h5")
    if path.exists() and not hdf5.is_map(path):
        raise ConfigError(f"{path}: is there already, and no map; choose another name")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: the folder {path.parent} does not exist; make it, or give --map another name")
    if not os.access(path.parent, os.W_OK):
        raise ConfigError(f"{path}: the folder {path.parent} cannot be written; give --map another name")
    if run.settings.run.polarisation:
        raise ConfigError(f"{run.path}: is of polarised light, and a map is of unpolarised light; leave --map out")
    if filling(description) == "under":
        raise ConfigError(
            f'{run.path}: rig "{description.name}": lamp.beam_diameter_mm = {description.lamp.beam_diameter_mm:g} is'
            f" narrower than the region (acquisition.roi_radius_mm = {description.acquisition.roi_radius_mm:g}): the"
            " irradiance of single pixels is not known, and there is no map"
        )
    _grid(run, pixel_mm)


def write(run: Run, found: Reduction, path: Path, pixel_mm: float | None, counter: Counter) -> Written:
    """Write the map of a run.

    Parameters
    ----------
    run, found
        The run, and what `gonio.lab.reduction.brdf.reduce_in_parts` made of it: levels of the lamp and common causes.
    path
        The file; `NAME.parts` beside it is made, and goes when the file is there.
    pixel_mm
        Side of a cell of the grid [mm]; None for the camera's pixel on the sample at normal view, to two digits.
    counter
        Told of the work.

    Raises
    ------
    ConfigError
        See `require`; the parts of another map lie there; or the disk has too little room.
    DataError
        No point of the run has a value.
    """
    points, rows = _points(run, found)
    if not points:
        raise DataError(f"{run.path}: no point of the run has a value; see the flags in brdf.csv")
    cells = _grid(run, pixel_mm)
    parts = Parts(path, _settings(run, found.table, cells))
    planes = Planes(RunFrames(run), parts.folder, cells.radius_mm)
    _require_room(planes, points, cells, parts.folder)
    table, notes = found.table.iloc[rows], _notes(found.table, rows, cells)
    level, of_reference = _u_points(found, points, rows), _of_reference(planes.frames, points)
    attrs = {str(name): value for name, value in found.table.attrs.items() if value is not None}
    attrs["notes"] = [*attrs.get("notes", []), *notes]
    sizes = {"y": len(cells.places), "x": len(cells.places), "point": len(points), "xyz": 3, "xy": 2}
    with parts.kept():
        _make_planes(planes, points, counter)
        shift = _shifts(planes, cells, points, parts.folder, counter)
        tiling = _Tiling(planes, cells, points, shift, np.where(np.isfinite(level), level, 0.0))
        good = _make_tiles(tiling, parts, counter)
        parts.assemble(sizes, _variables(tiling, table, rows // len(run.bands), of_reference), attrs)
    told = np.isfinite(shift[1]).any(axis=1)
    inside = int(np.count_nonzero(np.hypot(*np.meshgrid(cells.places, cells.places)) <= cells.radius_mm))
    return Written(
        shape=(sizes["y"], sizes["x"]),
        points=len(points),
        pixel_mm=cells.pixel_mm,
        good=good,
        values=inside * len(points),
        told=int(told.sum()),
        largest_shift_mm=float(np.abs(shift[0][told]).max(initial=0.0)),
        notes=notes,
    )


def radius_mm(run: Run) -> float:
    """Radius of the sample's disc [mm]: that of the holder's aperture, or of a smaller sample."""
    own = run.sample.diameter_mm if run.sample is not None else None
    whole = run.description.holder.sample_diameter_mm
    return 0.5 * min(own or whole, whole)


def _grid(run: Run, pixel_mm: float | None) -> Grid:
    return grid(run.description, radius_mm(run), pixel_mm)


def _points(run: Run, found: Reduction) -> tuple[list[MapPoint], npt.NDArray[np.intp]]:
    """The points with a value, in the order of the table, and their rows in it."""
    flags, count = found.table["flag"].tolist(), len(run.bands)
    steps = {step.point: step for step in run.steps() if step.kind == "point" and not step.flag}
    every = []
    for k, result in enumerate(found.bands):
        for point, level in zip(result.measured.points, result.measured.level.tolist(), strict=True):
            row = (point.point or 0) * count + k
            if not flags[row]:
                every.append((row, steps[point.point], result.band, point, level))
    every.sort(key=lambda one: one[0])
    points = [
        MapPoint(number, s, band, kinematics.view(run.description, s.pose), point.rate, level, point.merged.of_lamp)
        for number, (_, s, band, point, level) in enumerate(every)
    ]
    return points, np.array([row for row, *_ in every], dtype=np.intp)


def _u_points(found: Reduction, points: Sequence[MapPoint], rows: npt.NDArray[np.intp]) -> Floats:
    """Relative standard uncertainty that all pixels of a point share: the table's, but for what its region has alone.

    A picture is scaled by the region's mean in each frame to the rate of the table, which is that mean. So photons,
    dark signal, responsivities and the lobe's curvature over the region cancel, and each pixel has its own. The lamp's
    noise stays.
    """
    parts = found.budget.iloc[rows]
    cancel = (parts[list(OF_REGION)].to_numpy(dtype=float) ** 2).sum(axis=1)
    brdf, u = (found.table.iloc[rows][name].to_numpy(dtype=float) for name in ("brdf", "u_random"))
    lamp = np.array([point.of_lamp / point.level**2 for point in points])
    return np.asarray(np.sqrt(np.maximum(u**2 - cancel, 0.0) + lamp) / abs(brdf))


def _of_reference(frames: RunFrames, points: Sequence[MapPoint]) -> Floats:
    """Relative standard uncertainty of each point's level by the responsivities of the pixels that saw the reference.

    A value of the table sees the sample with most of these pixels, and they cancel.
    """
    return np.array([frames.prnu / math.sqrt(frames.reference[point.band.channel].count) for point in points])


def _settings(run: Run, table: DataFrame, cells: Grid) -> dict[str, Any]:
    """What pictures and tiles follow from."""
    import gonio

    values = hashlib.sha256(table.to_csv(index=False).encode()).hexdigest()
    journal = hashlib.sha256("\n".join(repr(step) for step in run.steps()).encode()).hexdigest()
    return {
        "map": "values", "gonio": gonio.__version__, "table": values, "steps": journal,
        "pixel_mm": cells.pixel_mm, "radius_mm": cells.radius_mm,
    }  # fmt: skip


def _require_room(planes: Planes, points: Sequence[MapPoint], cells: Grid, folder: Path) -> None:
    """Raise `ConfigError` where the disk cannot hold pictures and tiles."""
    needed = (
        2 * planes.camera.width * planes.camera.height * 4 + len(points) * len(cells.places) ** 2 * PIXEL.itemsize * 2
    )
    for point in points:
        for k, lattice in enumerate(lattices(planes.camera, point.band.channel)):
            rows, cols = planes.box(point.view, lattice)
            if not planes.file(point, k).is_file():
                needed += (rows.stop - rows.start) * (cols.stop - cols.start) * PIXEL.itemsize
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise ConfigError(
            f"{folder}: pictures and tiles need up to {needed / 1e9:.3g} GB, and the disk has {free / 1e9:.3g} GB left:"
            " give a larger --pixel-mm, or --map on another disk"
        )


def _make_planes(planes: Planes, points: Sequence[MapPoint], counter: Counter) -> None:
    missing = [point for point in points if not planes.done(point)]
    if not missing:
        return
    with counter("pictures") as progress:
        _ = planes.dark.usual_rate
        for number, _ in enumerate(in_threads(planes.make, missing)):
            progress(number + 1, len(missing))
    planes.frames.require_no_repeats()


def _shifts(
    planes: Planes, cells: Grid, points: Sequence[MapPoint], folder: Path, counter: Counter
) -> tuple[Floats, Floats]:
    """As `registration.shifts`; kept in a file, since all tiles depend on them."""
    kept = folder / "shifts.npz"
    if not kept.is_file():
        with counter("registering") as progress:
            shift, u = shifts(planes, cells, points, progress)
        files.write_tile(kept, {"shift": shift, "u": u})
    with files.readable_part(kept), kept.open("rb") as file, np.load(file) as held:
        return held["shift"], held["u"]


class _Tiling:
    """Makes tiles."""

    def __init__(
        self, planes: Planes, cells: Grid, points: Sequence[MapPoint], shift: tuple[Floats, Floats], u_point: Floats
    ) -> None:
        self.planes, self.cells, self.points, self.shift, self.u_point = planes, cells, points, shift, u_point
        self.lookups = [Lookup(planes, cells, point) for point in points]
        self.means = [lookup.means for lookup in self.lookups]

    def make(self, tile: Tile) -> dict[str, npt.NDArray[Any]]:
        """Values, uncertainties and flags of a tile, each of shape (rows, columns, points)."""
        shape = (*tile.shape, len(self.points))
        value, variance = np.full(shape, np.nan), np.full(shape, np.nan)
        flag = np.full(shape, OUTSIDE, np.uint8)
        if np.hypot(*self.cells.cells(tile)).min() <= self.cells.radius_mm:
            for k, lookup in enumerate(self.lookups):
                at = float(self.shift[0][k, 0]), float(self.shift[0][k, 1])
                value[..., k], variance[..., k], flag[..., k] = lookup.at(tile, at)
            variance += (value * self.u_point) ** 2 + self._of_shifts(value)
        return {
            "brdf": value.astype(np.float32), "u_random": np.sqrt(variance).astype(np.float32), "flag": flag
        }  # fmt: skip

    def _of_shifts(self, value: Floats) -> Floats:
        """Variance by what the registration leaves open: along the slopes of the mean over the points."""
        u = np.nan_to_num(self.shift[1])
        if not u.any() or min(value.shape[:2]) < 2:
            return np.zeros(value.shape)
        scale = _median(value.reshape(-1, value.shape[2]))
        mean = _mean(value / scale)
        slopes = np.nan_to_num(np.stack(list(np.gradient(mean, self.cells.pixel_mm)), axis=-1))
        return np.asarray((scale**2) * (slopes[..., 1:] * u[:, 0]) ** 2 + (scale**2) * (slopes[..., :1] * u[:, 1]) ** 2)


def _median(values: Floats) -> Floats:
    """Median of each column, without NaN; 1 where there is no number, or none above 0."""
    out = np.array(
        [np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else 1.0 for column in values.T]
    )
    return np.where(out > 0.0, out, 1.0)


def _mean(values: Floats) -> Floats:
    """Over the last axis, without NaN; NaN where there is no number."""
    known = np.isfinite(values)
    count = known.sum(axis=-1)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=-1) / np.maximum(count, 1), np.nan)


def _make_tiles(tiling: _Tiling, parts: Parts, counter: Counter) -> int:
    """Make the tiles that are missing; how many values of all of them have no flag."""
    count = len(tiling.cells.places)
    every = list(files.tiles(count, count))
    missing = [tile for tile in every if not parts.has(tile)]

    def work(tile: Tile) -> None:
        parts.write(tile, tiling.make(tile))

    beside = in_threads if len(tiling.points) <= MANY_POINTS else map
    with counter("tiles") as progress:
        for number, _ in enumerate(beside(work, missing)):
            progress(number + 1, len(missing))
    return sum(int(np.count_nonzero(parts.read(tile, "flag")["flag"] == 0)) for tile in every)


def _variables(
    tiling: _Tiling, table: DataFrame, plan_rows: npt.NDArray[np.intp], of_reference: Floats
) -> dict[str, Variable]:
    """What the file has beside dimensions."""
    cells, points = tiling.cells, tiling.points
    views = [point.view for point in points]
    brdf = table["brdf"].to_numpy(dtype=float)
    out = {name: Variable((name,), cells.places, units="mm", about=f"{name} on the sample") for name in ("y", "x")}
    for name in (*ANGLES_DEG, "wavelength_nm"):
        unit = "degree" if name in ANGLES_DEG else "nm"
        out[name] = Variable(("point",), table[name].to_numpy(dtype=float), units=unit, about=f"{name} at the centre")
    out |= {
        "plan_point": Variable(("point",), plan_rows.astype(np.int64), "i8", about="row of the plan"),
        "source_mm": Variable(("point", "xyz"), np.array([v.source_mm for v in views]), units="mm", about="source"),
        "camera_mm": Variable(("point", "xyz"), np.array([v.camera_mm for v in views]), units="mm", about="camera"),
        "footprint_mm": Variable(
            ("point", "xy"), np.array([lookup.footprint_mm() for lookup in tiling.lookups]),
            units="mm", about="width of what a cell sees: an edge makes 95 % of its step within it",
        ),
        "shift_mm": Variable(("point", "xy"), tiling.shift[0], units="mm", about="by how much the picture lay beside"),
        "u_shift_mm": Variable(("point", "xy"), tiling.shift[1], units="mm", about="its uncertainty; NaN: not told"),
        "u_point": Variable(
            ("point",), tiling.u_point, about="relative; the part of u_random that all pixels of a point share"
        ),
    }  # fmt: skip
    for name in table.columns:
        if name.startswith("s_") and not name.startswith(("s_dark_", "s_prnu_")):
            with np.errstate(divide="ignore", invalid="ignore"):
                change = table[name].to_numpy(dtype=float) / brdf
            if name == "s_reference_noise":
                change = -np.hypot(change, of_reference)
            about = "relative change for one standard deviation, the same for all pixels"
            out[name] = Variable(("point",), np.where(np.isfinite(change), change, 0.0), about=about)
    masks = {"flag_masks": np.array([1 << k for k in range(len(FLAGS))], np.uint8), "flag_meanings": " ".join(FLAGS)}
    return out | {
        "brdf": Variable(("y", "x", "point"), None, "f4", "sr-1", "bidirectional reflectance distribution function"),
        "u_random": Variable(("y", "x", "point"), None, "f4", "sr-1", "standard uncertainty of each value's own"),
        "flag": Variable(("y", "x", "point"), None, "u1", about="why a value must not be used", attrs=masks),
    }


def _notes(table: DataFrame, rows: npt.NDArray[np.intp], cells: Grid) -> list[str]:
    left_out = len(table) - len(rows)
    out = [f"the map covers the sample's disc of {2 * cells.radius_mm:g} mm in cells of {cells.pixel_mm:g} mm"]
    if left_out:
        out.append(f"{left_out} of {len(table)} values of the table have none, and no place in the map: see its flags")
    return out
