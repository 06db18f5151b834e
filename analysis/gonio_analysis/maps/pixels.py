"""What is fitted to every pixel of a map, and the fits of one tile."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio import materials
from gonio.errors import ConfigError, DataError
from gonio.geometry import Directions
from gonio.maps import FIT_FLAGS, Held, MapFile, Tile
from gonio.models import batch
from gonio.typing import Floats
from gonio_analysis.fitting.misfit import groupings
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM
from gonio_analysis.fitting.problem import FitRequest, pose

TOO_FEW, AT_BOUND, UNDETERMINED, REJECTED = (1 << k for k in range(len(FIT_FLAGS)))
CLOSE = 1e-7
"""Of its range: nearer to a bound a parameter stands at it, as in `gonio fit`."""
UNKNOWN = 0.5
"""Of its range: where its standard uncertainty is larger, a parameter is not determined."""

Arrays = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True)
class Plan:
    """What is fitted, and where from it is seen: all that a pixel's fit depends on besides its place and values."""

    model: str
    fixed: dict[str, float]
    free: tuple[str, ...]
    """In the order in which fits have them."""
    units: tuple[str, ...]
    lower: Floats
    """Bounds of the free parameters, on the scale on which they are searched."""
    upper: Floats
    log: npt.NDArray[np.bool_]
    """Whose scale that of logarithms is."""
    wavelength_nm: float
    points: npt.NDArray[np.intp]
    """Which points of the map are fitted."""
    source_mm: Floats
    camera_mm: Floats
    common: Floats
    """Relative changes by causes that pixels share, shape (r, n)."""
    u_point: Floats
    """Relative; the part of the values' own uncertainties that all pixels of a point share (n,)."""
    blocks: npt.NDArray[np.int64]
    notes: tuple[str, ...]

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of free parameters, in the order of `correlation`."""
        return [(a, b) for b in range(len(self.free)) for a in range(b)]


def plan(map_file: MapFile, asked: FitRequest) -> Plan:
    """What a request comes to for a map.

    Raises
    ------
    ConfigError
        The model cannot be fitted to maps, or a parameter, the material or the wavelength is wrong.
    DataError
        The map lacks something.
    """
    model = batch.require(asked.model)
    problem = pose(asked)
    if problem.words:
        raise ConfigError(f"--fix {next(iter(problem.words))}=...: maps are fitted with numbers alone; leave it out")
    points, wavelength, notes = _wavelength(map_file, asked.wavelength_nm)
    known = {name: value for name, value in problem.fixed.items() if name in model.names}
    odd = [name for name, value in (asked.fix or {}).items() if name not in model.names]
    if odd:
        raise ConfigError(f"--fix {odd[0]}=...: maps of {asked.model} have {', '.join(model.names)}")
    if isinstance(problem.ior, str):
        if math.isnan(wavelength):
            raise ConfigError(f"--ior {problem.ior}: the map's band has no wavelength; give --wavelength-nm")
        index = complex(materials.ior(problem.ior)(wavelength))
        known = {"ior": index.real, "k": index.imag} | known
    if math.isnan(wavelength) and problem.family.needs_wavelength:
        raise ConfigError(f"{asked.model} needs a wavelength, and the map's band has none; give --wavelength-nm")
    free = tuple(name for name in model.names if name not in known)
    rows = [problem.family.parameters[name] for name in free]
    log = np.array([row.scale == "log" for row in rows])
    bounds = np.array([[math.log(b) if row.scale == "log" else b for b in (row.lower, row.upper)] for row in rows])
    source, camera = (map_file.array(name).astype(float)[points] for name in ("source_mm", "camera_mm"))
    common = np.array([changes[points] for changes in map_file.causes.values()]).reshape(-1, len(points))
    u_point = map_file.array("u_point").astype(float)[points] if "u_point" in map_file.names else np.zeros(len(points))
    cuts = np.array(groupings(Directions.from_vectors(source, camera)), np.int64)
    return Plan(
        asked.model, known, free, tuple(row.unit or "1" for row in rows), bounds[:, 0], bounds[:, 1], log, wavelength,
        points, source, camera, common, u_point, cuts, (*problem.notes, *notes),
    )  # fmt: skip


def _wavelength(map_file: MapFile, asked: float | None) -> tuple[npt.NDArray[np.intp], float, list[str]]:
    """Which points are fitted, their wavelength [nm], and what is said of it."""
    if asked is not None and not 0.0 < asked < math.inf:
        raise ConfigError(f"--wavelength-nm {asked:g}: a wavelength is above 0 nm")
    waves = map_file.array("wavelength_nm").astype(float)
    if not waves.size:
        raise DataError(f"{map_file.path}: has no points")
    if np.isnan(waves).any():
        if not np.isnan(waves).all():
            raise DataError(f"{map_file.path}: wavelength_nm is missing for some points, and given for others")
        return np.arange(waves.size), math.nan if asked is None else asked, []
    several = np.unique(waves)
    wanted = DEFAULT_WAVELENGTH_NM if asked is None else asked
    nearest = float(several[np.argmin(np.abs(several - wanted))])
    notes = []
    if asked is None and several.size > 1:
        listed = ", ".join(f"{one:g}" for one in several)
        notes.append(f"The map has values at {listed} nm; those at {nearest:g} nm are fitted (--wavelength-nm).")
    elif asked is not None and nearest != asked:
        notes.append(f"The map has no values at {asked:g} nm; those at {nearest:g} nm are fitted.")
    return np.flatnonzero(waves == nearest), nearest, notes


@dataclass(frozen=True)
class Places:
    """Pixels of a tile: where they lie, and their values, packed."""

    x_mm: Floats
    """Of the columns."""
    y_mm: Floats
    """Of the rows."""
    held: Held

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.y_mm), len(self.x_mm)

    def values(self, points: npt.NDArray[np.intp]) -> tuple[Floats, Floats, Floats, Floats]:
        """x, y (pixels,) [mm], values and u (pixels, n) [1/sr]; raises `DataError` where the file is damaged."""
        y, x = np.meshgrid(self.y_mm, self.x_mm, indexing="ij")
        values, u = self.held.values(points)
        n = values.shape[-1]
        return x.ravel(), y.ravel(), values.reshape(-1, n), u.reshape(-1, n)


def read_tile(map_file: MapFile, tile: Tile) -> Places:
    """The pixels of a tile; raises `DataError` where it is damaged."""
    return Places(map_file.x_mm[tile.cols], map_file.y_mm[tile.rows], map_file.held(tile))


def fit_tile(plan: Plan, pixels: Places) -> Arrays:
    """The arrays of a tile of a file of fits."""
    wavelength = DEFAULT_WAVELENGTH_NM if math.isnan(plan.wavelength_nm) else plan.wavelength_nm
    x_mm, y_mm, values, u = pixels.values(plan.points)
    fits = batch.fit(
        plan.model, x_mm, y_mm, plan.source_mm, plan.camera_mm, values, u, common=plan.common, fixed=plan.fixed,
        blocks=plan.blocks, wavelength_nm=wavelength,
    )  # fmt: skip
    return {name: array.reshape(*pixels.shape, *array.shape[1:]) for name, array in _judged(plan, fits).items()}


def _judged(plan: Plan, fits: batch.Fits) -> Arrays:
    """Parameters with what is to be known of them; what is not determined is NaN."""
    found = fits.values[:, [fits.names.index(name) for name in plan.free]]
    error = fits.u
    there = np.isfinite(fits.chi_square)
    span = plan.upper - plan.lower
    with np.errstate(divide="ignore", invalid="ignore"):
        place, spread = np.where(plan.log, np.log(found), found), np.where(plan.log, error / found, error)
        ends = (place <= plan.lower + CLOSE * span) | (place >= plan.upper - CLOSE * span)
        # what the values do not feel has no error, and does not move
        unknown = ((spread > UNKNOWN * span) | ~np.isfinite(error) | ((error == 0.0) & ~ends)) & there[:, None]
        root = np.where(error > 0.0, error, np.nan)
        related = [fits.covariance[:, a, b] / (root[:, a] * root[:, b]) for a, b in plan.pairs]
    masked = unknown | ~there[:, None]
    flag = np.where(there, 0, TOO_FEW) | np.where((ends & ~masked).any(axis=1), AT_BOUND, 0)
    flag |= np.where(unknown.any(axis=1), UNDETERMINED, 0) | np.where(fits.tau > 0.0, REJECTED, 0)
    out: Arrays = {}
    for k, name in enumerate(plan.free):
        out[name] = np.where(masked[:, k], np.nan, found[:, k])
        out[f"u_{name}"] = np.where(masked[:, k] | (error[:, k] == 0.0), np.nan, error[:, k])
    if related:
        out["correlation"] = np.stack(related, axis=1).astype(np.float32)
    out["tau"] = np.where(there, fits.tau, np.nan).astype(np.float32)
    out["chi_square"] = fits.chi_square.astype(np.float32)
    return out | {"n_values": fits.used.astype(np.int32), "flag": flag.astype(np.uint8)}
