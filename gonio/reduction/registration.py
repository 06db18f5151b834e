"""By how much the pictures of a sample lie beside where the geometry puts them, told from the pictures themselves.

Each point's picture P on the sample's grid is compared with the mean M over all points of its band, both without what
is smooth (the lobe's own course over the sample). Least squares of P = (b + c . x) M - b s . grad M give contrast b,
its slope c over the sample, and shift s; the pictures are looked up with the shift, the mean is made again, and so on.
Standard uncertainties hold for residuals that are alike within strips of the picture, which run across its steepest
axis: along streaks. The mean of all shifts is zero by definition: where the sample's frame lies is not told. Where
the texture does not stand out of the noise, no shift is told; of an edge or of streaks, the shift across them alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from gonio.maps import Tile
from gonio.reduction.map_grid import Grid, Lookup
from gonio.reduction.map_planes import MapPoint, Planes
from gonio.reduction.threads import in_threads
from gonio.typing import Bools, Floats, Ints

Means = tuple[Floats, Floats]
"""The mean of pictures on the grid, and its variance."""
WINDOW = 512
"""Cells along a side, in the middle of the sample, that are compared."""
SMOOTH = 6.0
"""Standard deviation [cells] of the Gaussian that tells what is smooth."""
ROUNDS = 3
STRIP = 16.0
"""Cells across a strip."""
LEAST = 256
"""Cells that a comparison needs."""
FARTHEST = 3.0
"""Cells: a larger shift in one round is no shift."""
TOLD = 5.0
"""Standard errors that the contrast of a picture stands above zero, at least."""
PLAIN = 10.0
"""Times the noise of the mean's slopes: below, its texture is not told from noise that neighbours and pictures share
(a sample without texture gave up to 3)."""
FAINT = 0.03
"""Of the squared slopes across a texture: an axis that has less is not told. The stairs that pixels make of a straight
edge have 0.01 along it."""
UNSURE = 0.5
"""Cells: a shift that is not known better is not told."""


def window(grid: Grid) -> Tile:
    """The cells that are compared."""
    count = len(grid.places)
    side = min(count, WINDOW)
    start = (count - side) // 2
    return Tile(slice(start, start + side), slice(start, start + side))


def shifts(
    planes: Planes, grid: Grid, points: Sequence[MapPoint], progress: Callable[[int, int], None] | None = None
) -> tuple[Floats, Floats]:
    """Shift along x and y [mm] of every point, and its standard uncertainty, each of shape (n, 2).

    Where none is told the uncertainty is NaN.
    """
    found, u = np.zeros((len(points), 2)), np.full((len(points), 2), np.nan)
    rounds = _Rounds(planes, grid, found, u, progress, (ROUNDS + 1) * len(points))
    for name in dict.fromkeys(point.band.name for point in points):
        of_band = [point for point in points if point.band.name == name]
        means = None
        for _ in range(ROUNDS + 1):
            means = rounds.go(of_band, means)
    found[np.isnan(u).all(axis=1)] = 0.0
    return found, u


class _Rounds:
    """Compares the pictures of a band with their mean, and makes the mean again."""

    def __init__(
        self, planes: Planes, grid: Grid, found: Floats, u: Floats,
        progress: Callable[[int, int], None] | None, total: int,
    ) -> None:  # fmt: skip
        self._planes, self._grid, self._where = planes, grid, window(grid)
        self._found, self._u = found, u
        self._progress, self._done, self._total = progress, 0, total

    def go(self, points: Sequence[MapPoint], means: Means | None) -> Means:
        """Move every picture against the mean; the mean of the pictures as they were looked up, and its variance."""
        total, spread, count = (np.zeros(self._where.shape) for _ in range(3))
        steps: list[tuple[int, Floats, Floats]] = []

        def seen(point: MapPoint) -> tuple[Floats, Floats, tuple[Floats, Floats] | None]:
            value, variance = self._picture(point)
            return value, variance, None if means is None else _step(means, value, variance)

        for point, (value, variance, step) in zip(points, in_threads(seen, points), strict=True):
            there = np.isfinite(value)
            if step is not None:
                steps.append((point.number, *step))
            total[there] += value[there]
            spread[there] += variance[there]
            count[there] += 1.0
            self._done += 1
            if self._progress is not None:
                self._progress(self._done, self._total)
        for k, shift, u in steps:
            self._found[k] += shift * self._grid.pixel_mm
            self._u[k] = u * self._grid.pixel_mm
        told = [k for k, _, u in steps if np.isfinite(u).any()]
        if told:
            self._found[told] -= self._found[told].mean(axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return total / count, spread / count**2

    def _picture(self, point: MapPoint) -> tuple[Floats, Floats]:
        """A picture over its median, and its variance; NaN where it is flagged."""
        x, y = self._found[point.number].tolist()
        value, variance, flag = Lookup(self._planes, self._grid, point).at(self._where, (x, y))
        value = np.where(flag == 0, value, np.nan)
        scale = float(np.median(value[flag == 0])) if (flag == 0).any() else math.nan
        if not scale > 0.0:
            return np.full(value.shape, np.nan), variance
        return value / scale, variance / scale**2


def _rough(values: Floats, there: Bools) -> Floats:
    """A picture without what is smooth in it; 0 where it is not there."""
    from scipy.ndimage import gaussian_filter

    filled = gaussian_filter(np.where(there, values, 0.0), SMOOTH)
    known = gaussian_filter(there.astype(float), SMOOTH)
    return np.where(there, values - filled / np.maximum(known, 1e-12), 0.0)


def _step(means: Means, value: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """Shift of a picture against the mean [cells], and its uncertainty; 0 and NaN where there is too little texture."""
    from scipy.ndimage import binary_erosion

    nothing = np.zeros(2), np.full(2, np.nan)
    there = np.isfinite(value) & np.isfinite(means[0])
    inner = binary_erosion(there, iterations=2)
    if np.count_nonzero(inner) < LEAST:
        return nothing
    mean, picture = _rough(means[0], there), _rough(value, there)
    slopes = np.stack([slope[inner] for slope in np.gradient(mean)[::-1]])  # along x, and along y
    noise = float(np.mean(means[1][inner]))
    # of white noise the central difference has half the variance
    strength, axes = np.linalg.eigh(slopes @ slopes.T / slopes.shape[1] - 0.5 * noise * np.eye(2))
    rows, cols = np.nonzero(inner)
    strip = np.floor((axes[0, 1] * cols + axes[1, 1] * rows) / STRIP).astype(int)
    strip -= strip.min()
    # the contrast changes over the sample, with the directions; over its middle it is the first column's
    place = np.stack([np.ones(rows.size), cols - cols.mean(), rows - rows.mean()])
    contrast = mean[inner] * place / np.abs(place).max(axis=1, keepdims=True)
    least = PLAIN * noise
    for kept in (strength > max(least, FAINT * strength[1]), strength >= max(strength[1], least)):
        if kept.any():
            found, u = _along(axes[:, kept], contrast, slopes, picture[inner], strip)
            if np.isfinite(u).any():
                return found, u
    return nothing


def _along(axes: Floats, contrast: Floats, slopes: Floats, picture: Floats, strip: Ints) -> tuple[Floats, Floats]:
    """Shift along some axes (2, k) and its uncertainty along x and y: NaN where an axis is not told, or all is unsure.

    Cells are given as lists, `strip` numbers the part of the picture that each lies in.
    """
    columns = np.concatenate([contrast, -(axes.T @ slopes)])
    inverse = np.linalg.inv(columns @ columns.T)
    values = inverse @ (columns @ picture)
    left = picture - values @ columns
    scores = np.stack([np.bincount(strip, column * left) for column in columns])
    covariance = inverse @ (scores @ scores.T) @ inverse
    if values[0] ** 2 <= TOLD**2 * covariance[0, 0]:
        return np.zeros(2), np.full(2, np.nan)
    shift, spread = axes @ values[3:] / values[0], axes @ covariance[3:, 3:] @ axes.T / values[0] ** 2
    u = np.sqrt(np.diag(spread))
    if np.abs(shift).max() > FARTHEST or u.max() > UNSURE:
        return np.zeros(2), np.full(2, np.nan)
    return shift, np.where(np.sum(axes**2, axis=1) >= 0.5, u, np.nan)
