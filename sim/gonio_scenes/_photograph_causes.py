"""What makes the values of a photograph uncertain, and what in it cannot be used."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from gonio.errors import DataError
from gonio.shown import with_u
from gonio.typing import Floats
from gonio_scenes._squares import Mask, _shifted, _Squares
from gonio_scenes.exposures import Exposure
from gonio_scenes.vantage import Seen, Vantage

if TYPE_CHECKING:
    pass

FLAT = 0.05
"""Directions in which the normal changes this much less than in the steepest one do not count as a gradient."""
LOW = 0.05
"""Quantile of the values that counts as their level far from the lobe."""
LEVEL_SLOPE, LOBE_SLOPE = 0.3, 0.5
"""How f may change with half the angle between light and viewer [1/rad], the lobe by 2 tan of it more: what microfacet
models do through 1 / (cos theta_i cos theta_r). docs/photograph.md has the slopes of random samples."""
STILL = 1e-5
"""Turns of the normal [rad] that are left out: what a sphere's picture has by its perspective."""
NEAREST = 15
"""Facets of the nearest normals that a quadratic through them takes: its six terms, and some noise averaged."""
DETECTED = 5.0
"""Standard deviations above which a picture holds light."""
DIM, DIM_DN = 3.0, 2.0
"""Standard deviations of a dark pixel, and DN, below which a picture without shades may be a wrong black level."""


@dataclass(frozen=True)
class _Slopes:
    """The logarithm (asinh) of squares' values around their middles, as a quadratic in pixels."""

    small: float
    level: Floats
    gradient: Floats
    """(n, 2): along columns and rows."""
    hessian: Floats
    """(n, 3): columns, rows, both."""

    def moved(self, step: Floats) -> Floats:
        """The BRDF [1/sr] at places (n, 2) [px] beside the middles."""
        x, y = step.T
        curvature = 0.5 * (self.hessian[:, 0] * x**2 + self.hessian[:, 1] * y**2) + self.hessian[:, 2] * x * y
        return np.asarray(2.0 * self.small * np.sinh(self.level + (self.gradient * step).sum(axis=1) + curvature))


def _slopes(squares: _Squares, used: Mask, normal: Floats, across: Floats) -> _Slopes:
    """The quadratic of least squares through 3 x 3 squares, or through facets (of `normal`, in `across`)."""
    value, size = squares.mean, float(squares.size)
    small = max(3.0 * float(np.median(squares.noise[used])), 1e-6 * float(np.abs(value[used]).max()), 1e-300)
    log = np.arcsinh(value / (2.0 * small))
    level = np.arcsinh(squares.value[used] / (2.0 * small))
    if squares.flat and squares.piece is not None:
        return _Slopes(small, level, *_over_facets(squares.piece[used], normal, level, across))
    at = {(r, c): _shifted(log, r, c) for r in (-1, 0, 1) for c in (-1, 0, 1)}
    rows = [(at[r, -1], at[r, 0], at[r, 1]) for r in (-1, 0, 1)]
    columns = [(at[-1, c], at[0, c], at[1, c]) for c in (-1, 0, 1)]
    x, y = (np.mean([b - a for a, _, b in lines], axis=0) / (2.0 * size) for lines in (rows, columns))
    xx, yy = (np.mean([a + b - 2.0 * m for a, m, b in lines], axis=0) / size**2 for lines in (rows, columns))
    xy = (at[1, 1] + at[-1, -1] - at[1, -1] - at[-1, 1]) / (4.0 * size**2)
    return _Slopes(
        small,
        level,
        np.stack([x[used], y[used]], axis=1),
        np.stack([xx[used], yy[used], xy[used]], axis=1),
    )


def _over_facets(piece: npt.NDArray[np.intp], normal: Floats, log: Floats, across: Floats) -> tuple[Floats, Floats]:
    """Gradient (n, 2) and Hessian (n, 3) by quadratics through the facets of the nearest normals."""

    _, facet = np.unique(piece, return_inverse=True)
    count = np.bincount(facet)
    middle = np.stack([np.bincount(facet, n) for n in normal.T], axis=1) / count[:, None]
    level = np.bincount(facet, log) / count
    _, near = cKDTree(middle).query(normal, min(NEAREST, count.size))
    x, y = np.moveaxis(np.einsum("nki,nij->nkj", middle[near] - normal[:, None, :], across), 2, 0)
    scale = np.sqrt(np.mean(x**2 + y**2, axis=1))[:, None] + 1e-12
    x, y = x / scale, y / scale
    terms = np.stack([np.ones_like(x), x, y, 0.5 * x**2, 0.5 * y**2, x * y], axis=2)
    weight = np.sqrt(count[near])
    found = np.einsum("nkj,nj->nk", np.linalg.pinv(weight[..., None] * terms, rcond=1e-3), weight * level[near])
    return found[:, 1:3] / scale, found[:, 3:] / scale**2


def _require_light(image: Path, squares: _Squares, used: Mask, exposure: Exposure, black_level_dn: float) -> None:
    """Raise `DataError` where the squares that can be used hold no light, or only an offset."""
    f, u = squares.mean[used], squares.noise[used]
    with np.errstate(divide="ignore"):
        weight = 1.0 / u**2
    offset = black_level_dn * exposure.step * squares.per_value[used]
    if np.isinf(weight).any() or (f / u).max() > 2.0 * DETECTED:
        return
    spread = math.sqrt(float(weight.sum()) + float((weight * offset).sum()) ** 2)
    remedy = "was the lens open, the lamp lit, and the exposure long enough?"
    if (weight * f).sum() < DETECTED * spread:
        raise DataError(
            f"{image}: holds no light of the shape: the mean BRDF of {f.size} squares is "
            f"{with_u(float((weight * f).sum() / weight.sum()), spread / float(weight.sum()))} per sr: {remedy}"
        )
    # an offset alone is the same in light and shade; what a surface reflects is about in proportion to its light
    signal, noise = f / squares.per_value[used], u / squares.per_value[used]
    dark = math.sqrt(float(np.mean(exposure.constant)) + exposure.step**2 / 12.0)
    level = float(np.average(signal, weights=noise**-2.0))
    even = float((((signal - level) / noise) ** 2).sum())
    matte = float((((f - np.average(f, weights=weight)) / u) ** 2).sum())
    if (
        level < max(DIM * dark, DIM_DN * exposure.step)
        and even < f.size + DETECTED * math.sqrt(2.0 * f.size)
        and matte > even + DETECTED**2
    ):
        raise DataError(
            f"{image}: the shape is as bright in shade as in light, {level:.2g} "
            f"{'electrons' if exposure.step else 'units'} a pixel: a wrong black level or dark current gives that: "
            f"{remedy}"
        )


def _tangents(normal: Floats) -> Floats:
    """Two unit vectors across each normal, (n, 3, 2)."""
    helper = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(helper, normal)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=2)


def _common(
    squares: _Squares,
    used: Mask,
    exposure: Exposure,
    given: dict[str, float],
    moved: dict[str, tuple[Vantage, Vantage]],
    seen: Seen,
    jacobian: Floats,
) -> tuple[dict[str, Floats], float]:
    """Cause -> what one standard deviation of it does to each value [1/sr]; and the angle [deg] of `_unseen`."""
    f = squares.value[used]
    out: dict[str, Floats] = {}
    if given["irradiance_rel"]:
        out["irradiance"] = f * given["irradiance_rel"]
    if given["black_level_dn"] and exposure.step:
        out["black_level"] = given["black_level_dn"] * exposure.step * squares.per_value[used]
    if not moved:
        return out, 0.0
    column, row = squares.column[used], squares.row[used]
    if squares.flat:
        jacobian = _tangents(seen.normal)
    inverse: Floats = np.asarray(np.linalg.pinv(jacobian, rcond=FLAT), np.float64)
    slopes = _slopes(squares, used, seen.normal, jacobian)
    turned, opened = np.zeros(f.size), np.zeros(f.size)
    for name, both in moved.items():
        ends, turns, angles = [], [], []
        for end in both:
            other = end.at(column, row)
            change = other.normal - seen.normal
            step = np.einsum("nij,nj->ni", inverse, change)
            beyond = change - np.einsum("nij,nj->ni", jacobian, step)
            beyond -= np.einsum("ni,ni->n", beyond, seen.normal)[:, None] * seen.normal  # unit vectors stay so
            turns.append(np.linalg.norm(beyond, axis=1))
            angles.append(other.difference)
            ends.append(slopes.moved(step) * other.received / seen.received)
        out[name] = 0.5 * (ends[0] - ends[1])
        turned += (0.5 * (turns[0] + turns[1])) ** 2
        opened += (0.5 * (angles[0] - angles[1])) ** 2
    widest = math.degrees(math.sqrt(float(np.nanmax(opened + turned))))
    turned, opened = np.asarray(np.sqrt(turned)), np.asarray(np.sqrt(opened))
    return out | _unseen(squares, used, slopes, inverse, seen, turned, opened), widest


def _unseen(
    squares: _Squares, used: Mask, slopes: _Slopes, inverse: Floats, seen: Seen, turned: Floats, opened: Floats
) -> dict[str, Floats]:
    """What all causes together may do in directions that the picture does not hold [1/sr].

    `opened` [rad] is the change of half the angle between light and viewer, which is nearly the same in the whole
    picture. What it does to f is, for all models here, close to a f + b (f - f_low) with f_low the level far from the
    lobe; a and b are unknown. `turned` [rad] is a turn of the normal that no place of the picture has, as along a
    cylinder; f may change with it as fast as along the picture.
    """
    f = squares.value[used]
    low = float(np.quantile(squares.around[used], LOW))
    tangent = np.tan(seen.difference)
    out = {
        "unseen_level": LEVEL_SLOPE * opened * f,
        "unseen_lobe": (LOBE_SLOPE + 2.0 * tangent) * opened * f * (1.0 - low / squares.around[used]),
    }
    if float(turned.max()) > STILL:
        steep = np.einsum("ni,nij->nj", slopes.gradient, inverse)
        out["unseen_turn"] = math.sqrt(float(np.mean(steep**2))) * turned * f
    return {name: column for name, column in out.items() if np.any(np.abs(column) > 0.0)}
