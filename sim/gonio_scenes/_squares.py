"""Squares of pixels of a photograph, and the means over them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_scenes.exposures import Exposure

if TYPE_CHECKING:
    pass

UNSURE = 0.1
"""Share of a square's correction for its curvature that is taken as uncertain: what the next order may be."""
FLAGS = ("limb", "facets", "below_horizon", "blocked", "saturated", "clamped")
"""Why a pixel is not used; a square takes the first that one of its pixels has."""
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class _Pixels:
    """The whole picture, (height, width)."""

    received: Floats
    """Irradiance on the surface, NaN off the shape."""
    why: npt.NDArray[np.int8]
    """1 + the place in `FLAGS` of why a pixel is not used, 0 where it is, -1 off the shape."""
    piece: npt.NDArray[np.intp] | None
    """The facet, or the frustum, that a pixel sees, numbered; None where the shape has no creases."""
    flat: bool
    """Whether there are so many facets that they are looked at together."""
    kinked: bool
    """Whether normals are smoothed across facets: where these meet, the normal changes its pace."""


class _Squares:
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

    def __init__(self, pixels: _Pixels, exposure: Exposure, size: int, whole: bool) -> None:
        self.size, self.flat = size, pixels.flat
        height, width = (n // size for n in pixels.why.shape)

        def cut(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
            whole = array[: height * size, : width * size].reshape(height, size, width, size)
            return whole.swapaxes(1, 2).reshape(height, width, size * size)

        used = cut(exposure.used)
        self.of_shape = (np.where(used, cut(pixels.why), -1) >= 0).any(axis=2)
        """Squares that see something of the shape."""
        self.piece: npt.NDArray[np.intp] | None = None
        """What most of a square's pixels see of a shape with creases, -1 where none can be used; only they count."""
        if pixels.piece is not None:
            self.piece = _most(np.where(used & (cut(pixels.why) == 0), cut(pixels.piece), -1))
            used &= (cut(pixels.piece) == self.piece[..., None]) | (self.piece[..., None] < 0)
            used &= (cut(pixels.why) != _MIXED) | (self.piece[..., None] < 0)
        why = np.where(used, cut(pixels.why), 0)
        worst = np.where(why == -1, 1, why)
        first = np.where(worst > 0, worst, 127).min(axis=2)
        self.why = np.where(first == 127, 0, first)
        """As in `_Pixels`; a square that the shape's limb goes through counts as the limb."""
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

        def over(place: npt.NDArray[Any]) -> Floats:
            return np.asarray((used * place).sum(axis=2) / self.count)

        y, x = over(row), over(column)
        self.row = np.arange(height)[:, None] * size + y + 0.5
        """Where the middle of its used pixels lies; 0 is the picture's upper edge."""
        self.column = np.arange(width)[None, :] * size + x + 0.5
        if self.piece is not None and pixels.piece is not None:
            at = pixels.piece[self.row.astype(np.intp), self.column.astype(np.intp)]
            elsewhere = (self.why == 0) & (at != self.piece)  # where pieces of one normal lie apart
            self.why[elsewhere], self.mean[elsewhere] = _MIXED, np.nan
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
            beside = np.stack([self.above, *(_shifted(self.above, *step) for step in _RING)])
            unsure = np.where(np.isfinite(beside), beside**2, 0.0).max(axis=0)
        return np.asarray(np.sqrt(weights * self.noise**2 + unsure + u_curvature**2))

    def _bent(self, grid: Floats, moments: Sequence[Floats]) -> Floats:
        """`_curved`; NaN where a neighbour lies beyond a crease, and 0 for what is flat."""
        if self.flat:
            return np.zeros_like(grid)
        out = _curved(grid, moments, self.size)
        if self.piece is not None:
            own = np.where(self.piece < 0, np.nan, self.piece)
            out[~(np.abs(sum((_shifted(own, *step) - own) ** 2 for step in _RING)) < 0.5)] = np.nan
        return out

    def _of_others(self) -> Floats:
        if not self.flat or self.piece is None:
            return _around(self.mean)
        known = np.isfinite(self.mean)
        piece, mean = self.piece[known], self.mean[known]
        count, total = np.bincount(piece), np.bincount(piece, mean)
        neighbours = np.stack([_shifted(self.mean, *step) for step in _RING])
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
        f = np.maximum(expected, gain.sum(axis=2) / (len(_RING) * self.count**2))
        steady = (gain**2 * np.where(used, constant, 0.0)).sum(axis=2)
        light = exposure.shot * f * gain.sum(axis=2) + (exposure.relative * f) ** 2 * self.count
        rounding = exposure.step**2 / 12.0 * (gain**2).sum(axis=2)
        # pixels that are alike within half a step round alike
        alike = steady + light < 0.25 * exposure.step**2 * (gain**2).sum(axis=2)
        variance = steady + light + np.where(alike, rounding * self.count, rounding)
        return np.asarray(np.sqrt(variance) / self.count)


def _shifted(grid: Floats, down: int, right: int) -> Floats:
    """The grid's values so many squares below and to the right, NaN beyond its edge."""
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
    return np.asarray(sum(_shifted(mean, *step) for step in _RING) / len(_RING))


def _most(piece: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """The number that most of each square's pixels have (rows, columns, pixels); -1 where all have that."""
    height, width, pixels = piece.shape
    of = np.repeat(np.arange(height * width), pixels)
    both, count = np.unique(np.stack([of, piece.ravel()])[:, piece.ravel() >= 0], axis=1, return_counts=True)
    out = np.full(height * width, -1, dtype=np.intp)
    by_count = np.argsort(count, kind="stable")
    out[both[0, by_count]] = both[1, by_count]  # the last one stays
    return out.reshape(height, width)


_MIXED = 1 + FLAGS.index("facets")
_RING = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if (down, right) != (0, 0))
