"""What is fitted to every pixel of a map, and the fits of one tile."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from gonio_analysis.fitting.misfit import groupings
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM, check_wavelength
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.spectrum import geometry, picked

from gonio import materials
from gonio.errors import ConfigError, DataError
from gonio.geometry import Directions
from gonio.typing import Floats
from gonio_maps.files import FIT_FLAGS, Held, MapFile, Tile
from gonio_maps.models import batch, batch_spectra

TOO_FEW, AT_BOUND, UNDETERMINED, REJECTED = (1 << k for k in range(len(FIT_FLAGS)))
CLOSE = 1e-7
"""Share of its range: a parameter that is nearer to a bound counts as at it, as in `gonio fit`."""
UNKNOWN = 0.5
"""Share of its range: a parameter whose standard uncertainty is larger is not determined."""

Arrays = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True)
class PixelPlan:
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
    geometry: tuple[str, ...] = ()
    """Free parameters that are the same at all wavelengths."""
    others: tuple[PixelPlan, ...] = ()
    """What is fitted together with it: the same model at other wavelengths."""

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """Pairs of free parameters, in the order of `correlation`."""
        return [(a, b) for b in range(len(self.free)) for a in range(b)]

    def column(self, name: str) -> str:
        """A parameter's name at another wavelength than the one that is shown."""
        return name if name in self.geometry else f"{name}@{self.wavelength_nm:g}"

    @property
    def columns(self) -> dict[str, str]:
        """Every fitted parameter of a file of fits, and its unit."""
        units, plans = dict(zip(self.free, self.units, strict=True)), (self, *self.others)
        return {(plans[k].column(name) if k else name): units[name] for k, name in self.numbered}

    @property
    def numbered(self) -> list[tuple[int, str]]:
        """By column of `columns`: the wavelength, by number (0: the one that is shown), and the parameter."""
        own = [name for name in self.free if name not in self.geometry]
        return [(0, name) for name in self.free] + [(k, name) for k in range(1, len(self.others) + 1) for name in own]

    @property
    def related(self) -> list[tuple[str, str]]:
        """Pairs of them whose correlation a file of fits has."""
        out = [(self.free[a], self.free[b]) for a, b in self.pairs]
        for one in self.others:
            out += [(one.column(self.free[a]), one.column(self.free[b])) for a, b in one.own_pairs]
        return out

    @property
    def own_pairs(self) -> list[tuple[int, int]]:
        """Those of `pairs` that are not of two shared parameters."""
        return [(a, b) for a, b in self.pairs if not {self.free[a], self.free[b]} <= set(self.geometry)]


def plan(map_file: MapFile, asked: FitRequest) -> PixelPlan:
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
    odd = [name for name, value in (asked.fix or {}).items() if name not in model.names]
    if odd:
        raise ConfigError(f"--fix {odd[0]}=...: maps of {asked.model} have {', '.join(model.names)}")
    shown, others, notes = _wavelengths(map_file, asked, geometry(problem))
    made = _at(map_file, asked, *shown)
    if not others:
        return replace(made, notes=(*problem.notes, *notes))
    same = geometry(problem)
    together = tuple(replace(_at(map_file, asked, *other), geometry=same) for other in others)
    return replace(made, notes=(*problem.notes, *notes), geometry=same, others=together)


def _at(map_file: MapFile, asked: FitRequest, points: npt.NDArray[np.intp], wavelength: float) -> PixelPlan:
    """What a request comes to at one wavelength."""
    model, problem = batch.require(asked.model), pose(asked)
    known = {name: value for name, value in problem.fixed.items() if name in model.names}
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
    return PixelPlan(
        asked.model, known, free, tuple(row.unit or "1" for row in rows), bounds[:, 0], bounds[:, 1], log, wavelength,
        points, source, camera, common, u_point, cuts, (),
    )  # fmt: skip


Points = tuple[npt.NDArray[np.intp], float]
"""Points of a map, and their wavelength [nm]."""


def _wavelengths(map_file: MapFile, asked: FitRequest, same: tuple[str, ...]) -> tuple[Points, list[Points], list[str]]:
    """Points that are fitted and shown, points that are fitted with them, and what is said of it."""
    check_wavelength(asked.wavelength_nm)
    waves = map_file.array("wavelength_nm").astype(float)
    if not waves.size:
        raise DataError(f"{map_file.path}: has no points")
    if np.isnan(waves).any():
        if not np.isnan(waves).all():
            raise DataError(f"{map_file.path}: wavelength_nm is missing for some points, and given for others")
        return (np.arange(waves.size), math.nan if asked.wavelength_nm is None else asked.wavelength_nm), [], []
    several = np.unique(waves)
    wanted = DEFAULT_WAVELENGTH_NM if asked.wavelength_nm is None else asked.wavelength_nm
    nearest = float(several[np.argmin(np.abs(several - wanted))])
    shown = np.flatnonzero(waves == nearest), nearest
    if asked.wavelength_nm is not None or several.size == 1:
        missed = asked.wavelength_nm is not None and nearest != asked.wavelength_nm
        said = f"The map has no values at {wanted:g} nm; those at {nearest:g} nm are fitted."
        return shown, [], [said] if missed else []
    listed = ", ".join(f"{one:g}" for one in several)
    if asked.separate or not same:
        said = f"The map has values at {listed} nm; those at {nearest:g} nm are fitted (--wavelength-nm)."
        return shown, [], [said]
    others = [wave for wave in picked(several.tolist(), nearest) if wave != nearest]
    said = f"{len(others) + 1} wavelengths ({listed} nm) are fitted together:"
    if len(others) + 1 < several.size:
        said = f"{len(others) + 1} of {several.size} wavelengths are fitted together:"
    said += f" {', '.join(same)} {'is' if len(same) == 1 else 'are'} the same at all. Of {nearest:g} nm are the"
    said += " parameters without a wavelength in their name; --separate fits these alone."
    return shown, [(np.flatnonzero(waves == wave), wave) for wave in others], [said]


@dataclass(frozen=True)
class Places:
    """Pixels of a tile: where they lie, and their values, packed."""

    x_mm: Floats
    """Places of the columns."""
    y_mm: Floats
    """Places of the rows."""
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


def fit_tile(plan: PixelPlan, pixels: Places) -> Arrays:
    """The arrays of a tile of a file of fits."""
    plans = (plan, *plan.others)
    bands = []
    for one in plans:
        wavelength = DEFAULT_WAVELENGTH_NM if math.isnan(one.wavelength_nm) else one.wavelength_nm
        x_mm, y_mm, values, u = pixels.values(one.points)
        bands.append(batch_spectra.Band(
            one.source_mm, one.camera_mm, values, u, one.common, one.fixed, one.blocks, wavelength))  # fmt: skip
    found = batch_spectra.fit(plan.model, x_mm, y_mm, bands, plan.geometry)
    out = _judged(plan, found[0])
    relations = [out.pop("correlation")] if plan.pairs else []
    for one, fits in zip(plan.others, found[1:], strict=True):
        more = _judged(one, fits)
        places = [one.pairs.index(pair) for pair in one.own_pairs]
        relations += [more["correlation"][:, places]] if places else []
        out["flag"] = np.bitwise_or(out["flag"], more["flag"])
        own = [name for name in one.free if name not in plan.geometry]
        out |= {f"{u}{one.column(name)}": more[f"{u}{name}"] for name in own for u in ("", "u_")}
    if relations:
        out["correlation"] = np.concatenate(relations, axis=1)
    return {name: array.reshape(*pixels.shape, *array.shape[1:]) for name, array in out.items()}


def _judged(plan: PixelPlan, fits: batch.Fits) -> Arrays:
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
    out["misfit"] = np.where(there, fits.tau, np.nan).astype(np.float32)
    out["chi_square"] = fits.chi_square.astype(np.float32)
    return out | {"n_values": fits.used.astype(np.int32), "flag": flag.astype(np.uint8)}
