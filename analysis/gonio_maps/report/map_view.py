"""What the page of a map holds for its program: every few pixels of its layers, in 16 bits, and measured values."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gonio_analysis.curves.in_plane import evenly
from gonio_analysis.fitting.observations import DEFAULT_WAVELENGTH_NM
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.plots import pixels

from gonio.geometry import Directions
from gonio.typing import Floats
from gonio_maps.files import MapFile
from gonio_maps.report.map_layers import Layer, MapPixels

MEASURED_VALUES = 125_000
"""Most measured values on one page; each takes 4 bytes."""
CURVES = 4
"""Angles of incidence of the polar plot."""
DRAWN_DEG = (15.0, 45.0, 65.0)
"""Incidences of the model where no map of values tells which were measured."""
DRAWN_PIXELS = 2500
"""Whose curves a page holds, of a model that its program does not evaluate, where no measured values are there."""
OF_THE_PAGE = ("", "cook-torrance", "ggx", "blinn", "oren-nayar")
"""Models that its program evaluates (`pixels.js`); the first is no model."""
STEP_DEG = 2.5
"""Step of other models' curves."""
LEVELS = 65534
"""Levels that 16 bits leave: 0 is what is not determined."""
FINE = 1e-5
"""A relative uncertainty below this is this."""
View = dict[str, Any]
"""JSON of the page."""


def of(
    grid: MapPixels, layers: Sequence[Layer], kind: npt.NDArray[np.intp], names: Sequence[str], *, model: str,
    fixed: dict[str, float], values: MapFile | None = None, wavelength_nm: float | None = None,
) -> View:  # fmt: skip
    """The data of the page's program.

    Parameters
    ----------
    grid, layers
        The map.
    kind : (rows, columns) array
        What is to be said of each pixel, by the place of its name in `names`.
    model, fixed
        What was fitted, and the parameters that were not.
    values
        The map of values that was fitted.
    wavelength_nm
        That was fitted.
    """
    rows, cols = grid.embedded()
    down = np.argsort(-grid.y_mm[rows], kind="stable")
    right = np.argsort(grid.x_mm[cols], kind="stable")
    rows, cols = rows[down], cols[right]
    at = np.ix_(down, right)
    measured = None if values is None else _measured(values, rows, cols, wavelength_nm)
    drawn = None
    if model not in OF_THE_PAGE:
        found = {one.name: one.embedded[at] for one in layers} | {n: np.array(v) for n, v in fixed.items()}
        drawn = _drawn(model, found, (rows.size, cols.size), measured, wavelength_nm)
    return {
        "rows": rows.size,
        "cols": cols.size,
        "x": _short(grid.x_mm[cols]),
        "y": _short(grid.y_mm[rows]),
        "step": grid.step(200),
        "width_mm": round(cols.size * grid.step(200) * grid.pixel_mm, 6),
        "model": model,
        "fixed": fixed,
        "palettes": {name: _palette(name) for name in (pixels.VALUES, pixels.UNCERTAINTIES)},
        "unknown": pixels.UNKNOWN,
        "kinds": {
            "names": list(names),
            "colours": list(pixels.KINDS[: len(names)]),
            "data": _bytes(kind[np.ix_(rows, cols)].astype(np.uint8)),
        },
        "layers": [_layer(one, at) for one in layers],
        "incidences": list(DRAWN_DEG),
        "measured": measured,
        "drawn": drawn,
    }


def _layer(one: Layer, at: tuple[npt.NDArray[np.intp], ...]) -> View:
    value, u = one.embedded[at], None if one.embedded_u is None else one.embedded_u[at]
    low, high = one.spread.low, one.spread.high
    out = {
        "name": one.name,
        "label": one.label,
        "low": float(low) if np.isfinite(low) else 0.0,
        "high": float(high) if np.isfinite(high) else 1.0,
        "fitted": u is not None,
        "value": packed(value, u),
        "u": None,
    }
    if u is not None and np.isfinite(u).any():
        ends = np.quantile(u[np.isfinite(u)], (0.005, 0.995)).tolist()
        out["u"] = {**packed(u, None), "low": ends[0], "high": ends[1]}
    return out


def packed(value: Floats, u: Floats | None) -> View:
    """Numbers in 16 bits, evenly or on a logarithmic scale: whichever costs less of the uncertainties.

    0 stands for what is not finite; k above 0 for low + (high - low) (k - 1)/65534, or for the same of logarithms,
    where what is at most a ten-millionth of the largest counts as that.
    """
    known = np.isfinite(value)
    if not known.any():
        return {"scale": "linear", "low": 0.0, "high": 0.0, "data": _bytes(np.zeros(value.shape, "<u2"))}
    inside = value[known]
    low, high = float(inside.min()), float(inside.max())
    scales = [("linear", low, high)]
    if low > 0:
        scales.append(("log", max(low, 1e-7 * high), high))
    error = np.where(np.isfinite(u[known]), u[known], np.inf) if u is not None else np.abs(inside) + 1e-300

    def cost(scale: tuple[str, float, float]) -> float:
        return float(np.median(np.abs(unpacked(_codes(value, *scale), *scale)[known] - inside) / error))

    best = min(scales, key=cost) if u is not None else scales[-1]
    return {"scale": best[0], "low": best[1], "high": best[2], "data": _bytes(_codes(value, *best).astype("<u2"))}


def unpacked(codes: npt.NDArray[np.integer[Any]], scale: str, low: float, high: float) -> Floats:
    """The numbers that 16 bits stand for."""
    place = (codes.astype(float) - 1.0) / LEVELS
    value = low + (high - low) * place if scale == "linear" else low * (high / low) ** place
    return np.where(codes == 0, np.nan, value)


def _codes(value: Floats, scale: str, low: float, high: float) -> npt.NDArray[np.int64]:
    known = np.isfinite(value)
    inside = np.where(known, value, low)
    if scale == "log":
        inside, low, high = np.log(np.maximum(inside, low)), np.log(low), np.log(high)
    place = (inside - low) / (high - low) if high > low else np.zeros(value.shape)
    return np.where(known, 1 + np.rint(LEVELS * place), 0).astype(np.int64)


def _measured(
    file: MapFile, rows: npt.NDArray[np.intp], cols: npt.NDArray[np.intp], wavelength_nm: float | None
) -> View | None:
    """Values in the plane of incidence, of every few of the pixels of the page."""
    angles = [np.radians(file.array(f"{name}_deg").astype(float)) for name in ("theta_i", "phi_i", "theta_r", "phi_r")]
    waves = file.array("wavelength_nm").astype(float)
    wanted = np.isnan(waves) | (waves == wavelength_nm) if wavelength_nm is not None else np.full(waves.shape, True)
    point = np.flatnonzero(Directions(*angles).in_plane & wanted)
    tilt = np.round(np.degrees(angles[0]), 1)
    levels = [t for t in np.unique(tilt[point]) if np.count_nonzero(tilt[point] == t) >= 3]
    if not levels:
        return None
    kept = [float(levels[k]) for k in evenly(len(levels), CURVES)]
    point = point[np.isin(tilt[point], kept)]
    stride = max(1, int(np.ceil(np.sqrt(rows.size * cols.size * point.size / MEASURED_VALUES))))
    first = (stride - 1) // 2
    brdf, u = _picked(file, rows[first::stride], cols[first::stride], point)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(u > 0, np.clip(u / np.abs(brdf), FINE, 1.0), np.nan)
    place = 1 + np.rint(254 * (1 - np.log(relative) / np.log(FINE)))
    return {
        "first": first,
        "stride": stride,
        "rows": brdf.shape[0],
        "cols": brdf.shape[1],
        "incidences": kept,
        "curve": [kept.index(t) for t in tilt[point]],
        "phi": _short(angles[1][point]),
        "source": [_short(p) for p in file.array("source_mm")[point].astype(float)],
        "camera": [_short(p) for p in file.array("camera_mm")[point].astype(float)],
        "brdf": packed(np.where(brdf > 0, brdf, np.nan), None),
        "u": _bytes(np.where(np.isfinite(place), np.minimum(place, 255), 0).astype(np.uint8)),
        "fine": FINE,
    }


def _drawn(
    model: str, found: Mapping[str, Floats], shape: tuple[int, int], measured: View | None, wavelength_nm: float | None
) -> View:
    """A model's curves in the plane of incidence: of the pixels with measured values, or of every few."""
    stride = max(1, int(np.ceil(np.sqrt(shape[0] * shape[1] / DRAWN_PIXELS))))
    first = (stride - 1) // 2
    tilts = DRAWN_DEG
    if measured is not None:
        first, stride, tilts = measured["first"], measured["stride"], measured["incidences"]
    problem = pose(FitRequest(model))
    names = [name for name in ("k", *problem.family.parameters) if name in found]
    some = [np.broadcast_to(found[name], shape)[first::stride, first::stride] for name in names]
    view = np.union1d(np.arange(-85.0, 85.1, STEP_DEG), tilts)
    tilt, angle = (np.radians(a) for a in np.meshgrid(tilts, view, indexing="ij"))
    to_camera = np.abs(angle), np.where(angle > 0.0, np.pi, 0.0)
    out = np.full((*some[0].shape, *tilt.shape), np.nan)
    for row, col in np.argwhere(np.isfinite(np.sum(some, axis=0))).tolist():
        values = {name: float(one[row, col]) for name, one in zip(names, some, strict=True)}
        made = problem.make(problem.family.arguments(problem.fixed | values))
        out[row, col] = made.brdf(tilt, 0.0, *to_camera, wavelength_nm=wavelength_nm or DEFAULT_WAVELENGTH_NM)
    return {
        "first": first, "stride": stride, "rows": out.shape[0], "cols": out.shape[1],
        "angles": view.tolist(), "brdf": packed(np.where(out > 0.0, out, np.nan), None),
    }  # fmt: skip


def _picked(
    file: MapFile, rows: npt.NDArray[np.intp], cols: npt.NDArray[np.intp], point: npt.NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Values and uncertainties of some pixels and points, read tile by tile."""
    out = np.full((2, rows.size, cols.size, point.size), np.nan)
    for tile in file.tiles():
        r = np.flatnonzero((rows >= tile.rows.start) & (rows < tile.rows.stop))
        c = np.flatnonzero((cols >= tile.cols.start) & (cols < tile.cols.stop))
        if r.size and c.size:
            at = np.ix_(rows[r] - tile.rows.start, cols[c] - tile.cols.start, point)
            for k, found in enumerate(file.values(tile)):
                out[k][np.ix_(r, c)] = found[at]
    return out[0], out[1]


def _bytes(array: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _short(values: Floats) -> list[float]:
    return [float(f"{v:.7g}") for v in values.tolist()]


def _palette(name: str) -> str:
    """64 colours, six hexadecimal digits each."""
    from matplotlib import colormaps

    found = np.rint(255 * colormaps[name](np.linspace(0.0, 1.0, 64))[:, :3]).astype(np.uint8)
    return str(found.tobytes().hex())
