"""Squares of pixels of a photograph: means over them, what makes these uncertain, and what cannot be used."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from gonio.errors import DataError
from gonio.shown import with_u
from gonio.typing import Array, Bools, Floats, Ints, NDArray
from gonio_scenes.exposures import Exposure
from gonio_scenes.vantage import Seen, Vantage

UNSURE = 0.1
"""Share of a square's correction for its curvature that is taken as uncertain: what the next order may be."""
FLAGS = ("limb", "facets", "below_horizon", "blocked", "saturated", "clamped")
"""Why a pixel is not used; a square takes the first that one of its pixels has."""
Mask = Bools
MIXED = 1 + FLAGS.index("facets")
RING = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0))
"""Steps to the eight neighbours."""


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
class WholePicture:
    """The whole picture, (height, width)."""

    received: Floats
    """Irradiance on the surface, NaN off the shape."""
    why: NDArray[np.int8]
    """1 + the place in `FLAGS` of why a pixel is not used, 0 where it is, -1 off the shape."""
    piece: Ints | None
    """The facet, or the frustum, that a pixel sees, numbered; None where the shape has no creases."""
    flat: bool
    """Whether there are so many facets that they are looked at together."""
    kinked: bool
    """Whether normals are smoothed across facets: where these meet, the normal changes its pace."""


class Squares:
    """Means over squares of pixels, on a grid (rows, columns); NaN where a pixel of one is not used.

    Parameters
    ----------
    pixels, exposure
        The picture.
    size
        Pixels along a side.
    whole
        Whether a pixel sees the mean over its area, and not its centre's radiance.
    """

    def __init__(self, pixels: WholePicture, exposure: Exposure, size: int, whole: bool) -> None:
        self.size, self.flat = size, pixels.flat
        height, width = (n // size for n in pixels.why.shape)

        def cut(array: Array) -> Array:
            whole = array[: height * size, : width * size].reshape(height, size, width, size)
            return whole.swapaxes(1, 2).reshape(height, width, size * size)

        used = cut(exposure.used)
        self.of_shape = (np.where(used, cut(pixels.why), -1) >= 0).any(axis=2)
        """Squares that see something of the shape."""
        self.piece: Ints | None = None
        """What most of a square's pixels see of a shape with creases, -1 where none can be used; only they count."""
        if pixels.piece is not None:
            self.piece = _most(np.where(used & (cut(pixels.why) == 0), cut(pixels.piece), -1))
            used &= (cut(pixels.piece) == self.piece[..., None]) | (self.piece[..., None] < 0)
            used &= (cut(pixels.why) != MIXED) | (self.piece[..., None] < 0)
        why = np.where(used, cut(pixels.why), 0)
        worst = np.where(why == -1, 1, why)
        first = np.where(worst > 0, worst, 127).min(axis=2)
        self.why = np.where(first == 127, 0, first)
        """As in `WholePicture`; a square that the shape's limb goes through counts as the limb."""
        good = self.why == 0
        count = used.sum(axis=2)
        with np.errstate(divide="ignore", invalid="ignore"):
            self.count = np.where(count > 0, count, 1)
            per_value = cut(exposure.per_radiance) * cut(pixels.received)
            gain = np.where(used & (per_value > 0.0), 1.0 / per_value, 0.0)  # 0 off the shape too
            value = np.where(used, cut(exposure.value), 0.0)
            self.mean = np.where(good, (gain * value).sum(axis=2) / self.count, np.nan)
        per_value = np.where(good, gain.sum(axis=2) / self.count, np.nan)
        row, column = (n.reshape(1, 1, -1) for n in np.divmod(np.arange(size * size), size))

        def over(place: Array) -> Floats:
            return np.asarray((used * place).sum(axis=2) / self.count)

        y, x = over(row), over(column)
        self.row = np.arange(height)[:, None] * size + y + 0.5
        """Where the middle of its used pixels lies; 0 is the picture's upper edge."""
        self.column = np.arange(width)[None, :] * size + x + 0.5
        if self.piece is not None and pixels.piece is not None:
            at = pixels.piece[self.row.astype(np.intp), self.column.astype(np.intp)]
            elsewhere = (self.why == 0) & (at != self.piece)  # where pieces of one normal lie apart
            self.why[elsewhere], self.mean[elsewhere] = MIXED, np.nan
        area = 1.0 / 12.0 if whole else 0.0
        xx, yy, xy = over(column**2) - x**2 + area, over(row**2) - y**2 + area, over(row * column) - x * y
        moments = [np.zeros_like(xx)] * 3 if pixels.flat else [xx, yy, xy]  # a facet's normal is the same over a square
        self.above = self._bent(self.mean, moments)
        """By how much the mean lies above the value in the middle, from second differences."""
        self.per_value = per_value - self._bent(per_value, moments)
        """BRDF [1/sr] of a picture whose pixels all have the value 1."""
        u_curvature = self._bent(self.mean, (np.full_like(xx, 1 / 12), np.full_like(yy, 1 / 12), np.zeros_like(xy)))
        self.around = self._of_others()
        """Mean of the eight neighbours: what is expected of a square, free of its own noise. Of facets, their mean."""
        self.noise = self._noise(exposure, gain, used, cut, self.around)
        """Standard uncertainty of the mean."""
        self.random = self._random(moments, u_curvature, kinked=pixels.kinked)
        """The same of `value`."""
        self.value = self.mean - self.above
        """The BRDF in the middle [1/sr]; NaN too where a neighbour has none."""

    def _random(self, moments: Sequence[Floats], u_curvature: Floats, *, kinked: bool) -> Floats:
        """Standard uncertainty of `mean` less `above`, to which the square and its neighbours contribute."""
        xx, yy, _ = moments
        # in mean - above the square itself counts 1 + k + m, and its neighbours -k/2 and -m/2
        k, m = xx / self.size**2, yy / self.size**2
        weights = (1.0 + k + m) ** 2 + 0.5 * (k**2 + m**2)
        unsure = (UNSURE * self.above) ** 2
        if kinked:  # second differences do not say whether the kink is in the square or beside it
            beside = np.stack([self.above, *(_shifted(self.above, *step) for step in RING)])
            unsure = np.where(np.isfinite(beside), beside**2, 0.0).max(axis=0)
        return np.asarray(np.sqrt(weights * self.noise**2 + unsure + u_curvature**2))

    def _bent(self, grid: Floats, moments: Sequence[Floats]) -> Floats:
        """`_curved`; NaN where a neighbour lies beyond a crease, and 0 for what is flat."""
        if self.flat:
            return np.zeros_like(grid)
        out = _curved(grid, moments, self.size)
        if self.piece is not None:
            own = np.where(self.piece < 0, np.nan, self.piece)
            out[~(np.abs(sum((_shifted(own, *step) - own) ** 2 for step in RING)) < 0.5)] = np.nan
        return out

    def _of_others(self) -> Floats:
        if not self.flat or self.piece is None:
            return _around(self.mean)
        known = np.isfinite(self.mean)
        piece, mean = self.piece[known], self.mean[known]
        count, total = np.bincount(piece), np.bincount(piece, mean)
        neighbours = np.stack([_shifted(self.mean, *step) for step in RING])
        have = np.isfinite(neighbours)
        alone = np.where(have, neighbours, 0.0).sum(axis=0) / np.maximum(have.sum(axis=0), 1)
        alone = np.where(have.any(axis=0), alone, self.mean)
        out = np.full_like(self.mean, np.nan)
        others = count[piece] - 1
        out[known] = np.where(others > 0, (total[piece] - mean) / np.maximum(others, 1), alone[known])
        return out

    def _noise(
        self, exposure: Exposure, gain: Floats, used: Mask, cut: Callable[[Any], Any], expected: Floats
    ) -> Floats:
        """The sensor's noise, from what the square's neighbours say of its signal and not from its own noisy one."""
        constant = cut(np.broadcast_to(exposure.constant, exposure.value.shape))
        # where none of the squares around counted an electron, one may have been missed
        f = np.maximum(expected, gain.sum(axis=2) / (len(RING) * self.count**2))
        steady = (gain**2 * np.where(used, constant, 0.0)).sum(axis=2)
        light = exposure.shot * f * gain.sum(axis=2) + (exposure.relative * f) ** 2 * self.count
        rounding = exposure.step**2 / 12.0 * (gain**2).sum(axis=2)
        # pixels that are alike within half a step round alike
        alike = steady + light < 0.25 * exposure.step**2 * (gain**2).sum(axis=2)
        variance = steady + light + np.where(alike, rounding * self.count, rounding)
        return np.asarray(np.sqrt(variance) / self.count)


def _shifted(grid: Floats, down: int, right: int) -> Floats:
    """The grid's values `down` squares below and `right` squares to the right, NaN beyond its edge."""
    out = np.full_like(grid, np.nan)
    height, width = grid.shape
    to, of = (
        tuple(slice(max(0, s * n), m + min(0, s * n)) for n, m in ((down, height), (right, width))) for s in (-1, 1)
    )
    out[to] = grid[of]
    return out


def _curved(mean: Floats, moments: Sequence[Floats], size: int) -> Floats:
    """What second moments (columns, rows, both) [px^2] add to a mean, from second differences of a grid."""
    xx, yy, xy = moments
    along = _shifted(mean, 0, 1) + _shifted(mean, 0, -1) - 2.0 * mean
    across = _shifted(mean, 1, 0) + _shifted(mean, -1, 0) - 2.0 * mean
    both = _shifted(mean, 1, 1) + _shifted(mean, -1, -1) - _shifted(mean, 1, -1) - _shifted(mean, -1, 1)
    return np.asarray((0.5 * xx * along + 0.5 * yy * across + 0.25 * xy * both) / size**2)


def _around(mean: Floats) -> Floats:
    """The mean of the eight neighbours."""
    return np.asarray(sum(_shifted(mean, *step) for step in RING) / len(RING))


def _most(piece: Ints) -> Ints:
    """The number that most of each square's pixels have (rows, columns, pixels); -1 where all have that."""
    height, width, pixels = piece.shape
    of = np.repeat(np.arange(height * width), pixels)
    both, count = np.unique(np.stack([of, piece.ravel()])[:, piece.ravel() >= 0], axis=1, return_counts=True)
    out = np.full(height * width, -1, dtype=np.intp)
    by_count = np.argsort(count, kind="stable")
    out[both[0, by_count]] = both[1, by_count]  # the last one stays
    return out.reshape(height, width)


# --- causes ----------------------------------------------------------------------------------------------------------


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


def _slopes(squares: Squares, used: Mask, normal: Floats, across: Floats) -> _Slopes:
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


def _over_facets(piece: Ints, normal: Floats, log: Floats, across: Floats) -> tuple[Floats, Floats]:
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


def require_light(image: Path, squares: Squares, used: Mask, exposure: Exposure, black_level_dn: float) -> None:
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


def common(
    squares: Squares,
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
    squares: Squares, used: Mask, slopes: _Slopes, inverse: Floats, seen: Seen, turned: Floats, opened: Floats
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
