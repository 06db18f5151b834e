"""A file of fits of every pixel of a map: tile by tile, and what it says in short."""

import math
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.selection import parallel

import gonio
from gonio.disk import check_writable
from gonio.errors import ConfigError, DataError
from gonio.hdf5 import MAP_SUFFIXES, is_map
from gonio.models.engine import alone
from gonio.threads import in_threads
from gonio.typing import Floats, JsonObject
from gonio_maps.files import FIT_FLAGS, MapFile, Parts, Tile, Variable
from gonio_maps.fits import materials as shared
from gonio_maps.fits.pixels import AT_BOUND, REJECTED, TOO_FEW, Arrays, PixelPlan, Places, fit_tile, plan, read_tile

MOST_PIXELS = 1_000_000
"""Whose values a summary orders."""
MOST_KINDS = 50
"""Materials that may be asked for."""
KEPT = ("sample", "quantity", "simulated")
"""Attributes of a map that its fits have, too."""

Count = Callable[[int, int], None]


def make(
    path: Path, out: Path, asked: FitRequest, *, materials: str | None = None, dask: str | None = None, count: Count,
    say: Callable[[str], None],
) -> PixelPlan:  # fmt: skip
    """Fit every pixel of a map.

    Parameters
    ----------
    path, out
        The map, and the file of fits to be.
    asked
        Model, optical constants, fixed parameters and wavelength.
    materials
        How many materials the pixels share, or "auto"; None: each pixel is fitted alone.
    dask
        Address of a Dask scheduler; its workers need this package, and neither the map nor a disk that is shared.
        Otherwise the threads of this process fit, which are as fast as processes and start at once.
    count, say
        Called with how many tiles are done, and how many there are; and lines for a person.

    Raises
    ------
    ConfigError
        The request does not fit the map, or `out` cannot be written.
    DataError
        The map is damaged, or lacks something.
    """
    if out.suffix not in MAP_SUFFIXES:
        raise ConfigError(f"--out {out}: fits of a map are an HDF5 file; choose a name that ends in .h5")
    if out.exists() and out.samefile(path):
        raise ConfigError(f"--out {out}: is the map itself; choose another name")
    if out.exists() and not is_map(out):
        raise ConfigError(f"--out {out}: is there already, and no map; choose another name")
    check_writable(out.parent)
    kinds = _count_of(materials)
    with MapFile(path) as map_file:
        if "brdf" not in map_file.names:
            raise DataError(f"{path}: is a map without values (brdf); gonio fit takes what gonio reduce --map made")
        wanted = plan(map_file, asked)
        for text in wanted.notes:
            say(text)
        about = _about(map_file, wanted)
        parts = Parts(out, about)  # the tiles are the same whatever materials are found of them
        every = map_file.tiles()
        todo = [tile for tile in every if not parts.has(tile)]
        if len(todo) < len(every):
            say(f"{len(every) - len(todo)} of {len(every)} tiles were done before")
        with parts.kept():
            for done, _ in enumerate(_fitted(map_file, wanted, parts, todo, dask), 1):
                count(done, len(todo))
            sizes, variables = _layout(map_file, wanted)
            if materials is not None:
                more, found = shared.variables(map_file, parts, wanted, kinds, say)
                sizes, variables, about = sizes | more, variables | found, about | {"materials": materials}
            parts.assemble(sizes, variables, {n: map_file.attrs[n] for n in KEPT if n in map_file.attrs} | about)
    return wanted


def _count_of(materials: str | None) -> int | None:
    """How many materials are asked for; None for "auto" or none at all."""
    if materials in (None, "auto"):
        return None
    try:
        count = int(materials or "")
    except ValueError:
        count = 0
    if not 0 < count <= MOST_KINDS:
        raise ConfigError(f"--materials {materials}: a number from 1 to {MOST_KINDS}, or auto")
    return count


def _about(map_file: MapFile, wanted: PixelPlan) -> JsonObject:
    """What the fits are, as attributes; and what tiles of an earlier try have to agree with."""
    versions = {"gonio": gonio.__version__, "python": platform.python_version()}
    versions |= {name: version(name) for name in ("numpy", "numba", "scipy")}
    return {
        "map": map_file.path.name,
        "map_sha256": map_file.sha256(),
        "model": wanted.model,
        "parameters": wanted.columns,
        "fixed": wanted.fixed
        | {other.column(n): v for other in wanted.others for n, v in other.fixed.items() if v != wanted.fixed[n]},
        "wavelength_nm": float(wanted.wavelength_nm),
        "versions": versions,
    }


def _fitted(map_file: MapFile, wanted: PixelPlan, parts: Parts, todo: list[Tile], dask: str | None) -> Iterator[None]:
    """Fits tiles and keeps them, by the threads of this process or by a cluster; yields once a tile."""
    if dask is None:
        return in_threads(lambda tile: parts.write(tile, fit_tile(wanted, read_tile(map_file, tile))), todo)
    found = parallel.each(_sent, ((wanted, read_tile(map_file, tile)) for tile in todo), dask=dask)
    return in_threads(lambda one: parts.write(todo[one[0]], one[1]), found)


def _sent(job: tuple[PixelPlan, Places]) -> Arrays:
    """What a thread of a worker of a cluster does: its neighbours have the other processors."""
    with alone():
        return fit_tile(*job)


def _layout(map_file: MapFile, wanted: PixelPlan) -> tuple[dict[str, int], dict[str, Variable]]:
    """Dimensions and variables of a file of fits."""
    rows, cols = map_file.shape
    sizes, yx = {"y": rows, "x": cols}, ("y", "x")
    out = {
        "x": Variable(("x",), map_file.x_mm, units="mm", about="middle of the pixel in the sample's frame"),
        "y": Variable(("y",), map_file.y_mm, units="mm", about="middle of the pixel in the sample's frame"),
    }
    for name, unit in wanted.columns.items():
        out[name] = Variable(
            yx, units=unit, about=f"{name} of {wanted.model}", attrs={"ancillary_variables": f"u_{name}"}
        )
        out[f"u_{name}"] = Variable(yx, units=unit, about=f"standard uncertainty of {name}")
    if wanted.pairs:
        sizes["pair"] = len(wanted.related)
        listed = " ".join(f"{a}:{b}" for a, b in wanted.related)
        out["correlation"] = Variable(
            (*yx, "pair"), None, "f4", about="correlation of parameters", attrs={"pairs": listed}
        )
    out["misfit"] = Variable(yx, None, "f4", about="relative misfit of a model that is rejected")
    out["chi_square"] = Variable(yx, None, "f4", about="chi-square with the stated uncertainties")
    out["n_values"] = Variable(yx, None, "i4", about="values that were fitted")
    masks = {
        "flag_masks": np.array([1 << k for k in range(len(FIT_FLAGS))], np.uint8),
        "flag_meanings": " ".join(FIT_FLAGS),
    }
    out["flag"] = Variable(yx, None, "u1", about="what is to be known of the fit", attrs=masks)
    return sizes, out


@dataclass(frozen=True)
class MapParameter:
    """One parameter over a map."""

    median: float
    spread: float
    """Half the distance between its 16th and 84th percentile."""
    u: float
    """Median of its standard uncertainty."""
    unit: str
    undetermined: int
    """Pixels where it is masked, for its uncertainty exceeds half of its range."""


@dataclass(frozen=True)
class FitsSummary:
    """What a file of fits says in short."""

    pixels: int
    fitted: int
    rejected: int
    at_bound: int
    misfit: float
    """Median of the misfit of pixels that are rejected; NaN without any."""
    parameters: dict[str, MapParameter]
    materials: list[dict[str, float]]
    """By material: its pixels, chi-square a degree of freedom, and parameters with u."""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers; None for those that are not there."""
        from gonio_analysis.result_records import as_json

        return dict(as_json(self))


def summary(path: Path) -> FitsSummary:
    """The summary of a file of fits; medians and percentiles are those of `MOST_PIXELS` evenly drawn ones, at most."""
    with MapFile(path) as fits:
        units = fits.attrs["parameters"]
        names = [column for name in units for column in (name, f"u_{name}")]
        step, size = max(1, math.ceil(math.prod(fits.shape) / MOST_PIXELS)), math.prod(fits.shape)

        def look(tile: Tile) -> tuple[list[int], dict[str, Floats]]:
            flag = fits.array("flag", tile)
            fitted, rejected = (flag & TOO_FEW) == 0, (flag & REJECTED) != 0
            found = {name: fits.array(name, tile) for name in names}
            unknown = [int((fitted & ~np.isfinite(found[name])).sum()) for name in units]
            counts = [int(fitted.sum()), int(rejected.sum()), int(((flag & AT_BOUND) != 0).sum()), *unknown]
            found["misfit"] = np.where(rejected, fits.array("misfit", tile), np.nan)
            return counts, {name: array.ravel()[::step].astype(float) for name, array in found.items()}

        seen = list(in_threads(look, fits.tiles()))
        fitted, rejected, bound, *unknown = np.sum([counts for counts, _ in seen], axis=0).tolist()
        some = {name: np.concatenate([arrays[name] for _, arrays in seen]) for name in (*names, "misfit")}
        some = {name: values[np.isfinite(values)] for name, values in some.items()}
        parameters = {}
        for (name, unit), masked in zip(units.items(), unknown, strict=True):
            values = some[name]
            low, middle, high = np.quantile(values, [0.16, 0.5, 0.84]) if values.size else [np.nan] * 3
            parameters[name] = MapParameter(
                float(middle), 0.5 * float(high - low), _middle(some[f"u_{name}"]), unit, masked
            )
        of_kinds = {name: fits.array(name) for name in fits.names if name.startswith(("material_", "u_material_"))}
        kinds = [dict(zip(of_kinds, map(float, row), strict=True)) for row in zip(*of_kinds.values(), strict=True)]
    return FitsSummary(size, fitted, rejected, bound, _middle(some["misfit"]), parameters, kinds)


def _middle(values: Floats) -> float:
    return float(np.median(values)) if values.size else np.nan
