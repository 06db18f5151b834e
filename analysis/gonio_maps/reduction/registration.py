"""By how much the pictures of a sample lie beside where the geometry puts them, told from the pictures themselves.

Each point's picture is compared on the sample's grid with the few pictures that are most like it: P with Q, both
without noise and without what is smooth (the lobe's own course over the sample). Least squares of
P = (b + c . x) Q - b s . grad Q give the contrast b, its slope c over the sample, and s: by how much P lies farther
aside than Q. Pictures that are alike need no model of how a texture's contrast changes with the directions. All these
differences together give the shifts, by least squares; what is left says how much larger than stated their errors are.
The pictures are looked up with their shifts, compared again, and so on.

Standard uncertainties of a comparison hold for residuals that are alike within strips of the picture, which run across
its steepest axis: along streaks. The mean of all shifts is zero by definition: where the sample's frame lies is not
told. Where the texture does not stand out of the noise, no shift is told; of an edge or of streaks, the shift across
them alone.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from gonio.threads import in_threads
from gonio.typing import Bools, Floats, Ints, NDArray
from gonio_maps.files import Tile
from gonio_maps.reduction.map_grid import Grid, Lookup
from gonio_maps.reduction.map_planes import MapPoint, Planes

WINDOW = 512
"""Cells along a side, in the middle of the sample, that are compared: fewer where all pictures had more than `HELD`."""
HELD = 3e7
"""Values of all pictures that are held at a time."""
FINE, SMOOTH = 1.0, 6.0
"""Standard deviations [cells] of the Gaussians below which all is noise, and above which all is smooth."""
ROUNDS = 3
ALIKE = 3
"""Pictures that each is compared with, at least."""
SAME = 0.6
"""Correlation, but for the noise, of two pictures that are compared, at least."""
STRIP = 16.0
"""Cells across a strip."""
LEAST = 256
"""Cells that a comparison needs."""
FARTHEST = 3.0
"""Cells: two pictures that lie farther apart in one round are not compared."""
TOLD = 5.0
"""Standard errors that the contrast of a picture stands above zero, at least."""
PLAIN = 0.4
"""Part of a picture's variance: a texture of smaller squared slopes is not told from noise that neighbours share."""
FAINT = 0.03
"""Part of the squared slopes across a texture: an axis that has less is not told. The stairs that pixels make of a
straight edge have 0.01 along it."""
SURE = 1e-4
"""Cells: least uncertainty of a comparison, also of pictures that are equal to the bit."""
UNSURE = 0.5
"""Cells: a shift whose uncertainty is larger is not determined."""


def window(grid: Grid, points: int) -> Tile:
    """The cells that are compared, for `points` pictures."""
    count = len(grid.places)
    side = min(count, WINDOW, int(math.sqrt(HELD / max(points, 1))))
    start = (count - side) // 2
    return Tile(slice(start, start + side), slice(start, start + side))


def shifts(
    planes: Planes, grid: Grid, points: Sequence[MapPoint], progress: Callable[[int, int], None] | None = None
) -> tuple[Floats, Floats]:
    """Shift along x and y [mm] of every point, and its standard uncertainty, each of shape (n, 2).

    Where none is told the uncertainty is NaN.
    """
    found, u = np.zeros((len(points), 2)), np.full((len(points), 2), np.nan)
    done = 0
    for name in dict.fromkeys(point.band.name for point in points):
        of_band = [point for point in points if point.band.name == name]
        rows = [point.number for point in of_band]
        where = window(grid, len(of_band))

        def picture(point: MapPoint, where: Tile) -> _Picture:
            x, y = found[point.number].tolist()
            return _Picture.of(*Lookup(planes, grid, point).at(where, (x, y)))

        for _ in range(ROUNDS):
            pictures = []
            for each in in_threads(partial(picture, where=where), of_band):
                pictures.append(each)
                done += 1
                if progress is not None:
                    progress(done, ROUNDS * len(points))
            step, u_step = _solved(len(of_band), *_compared(pictures))
            found[rows] += step * grid.pixel_mm
            # a step that has not come to its end is not known better than it is long
            u[rows] = np.hypot(u_step, step) * grid.pixel_mm
    found[np.isnan(u).all(axis=1)] = 0.0
    return found, u


@dataclass(frozen=True)
class _Picture:
    """A picture over its median, without noise and what is smooth."""

    rough: NDArray[np.float32]
    """0 where it is not there."""
    there: Bools
    noise: float
    """Variance of a cell before."""

    @cached_property
    def slopes(self) -> NDArray[np.float32]:
        """Along x and y, shape (2, rows, columns)."""
        along_y, along_x = np.gradient(self.rough)
        return np.stack([along_x, along_y])

    @cached_property
    def tensor(self) -> Floats:
        """Sums of products of slopes, shape (2, 2)."""
        return np.asarray(np.einsum("iyx,jyx->ij", self.slopes, self.slopes, dtype=float))

    @classmethod
    def of(cls, value: Floats, variance: Floats, flag: Ints) -> "_Picture":
        from scipy.ndimage import gaussian_filter

        there = flag == 0
        scale = float(np.median(value[there])) if there.any() else math.nan
        if not scale > 0.0:
            return cls(np.zeros(value.shape, np.float32), np.zeros(value.shape, bool), 0.0)
        filled, known = np.where(there, value / scale, 0.0), there.astype(float)
        fine, smooth = (
            gaussian_filter(filled, width) / np.maximum(gaussian_filter(known, width), 1e-12)
            for width in (FINE, SMOOTH)
        )
        noise = float(np.mean(variance[there])) / scale**2
        return cls(np.where(there, fine - smooth, 0.0).astype(np.float32), there, noise)


@dataclass(frozen=True)
class _Difference:
    """Along an axis, picture `first` lies `value` +- `u` cells farther aside than picture `second`."""

    first: int
    second: int
    axis: int
    value: float
    u: float


def _compared(pictures: Sequence[_Picture]) -> tuple[list[_Difference], Floats]:
    """Each picture with those most like it, and all of them in one chain as far as they are alike at all.

    Also the axes along which they differ, as columns: the second is steeper.
    """
    tensors = np.stack(list(in_threads(lambda picture: picture.tensor, pictures)))
    traces = np.trace(tensors, axis1=1, axis2=2)
    _, axes = np.linalg.eigh(np.sum(tensors / np.maximum(traces, 1e-30)[:, None, None], axis=0))
    found = in_threads(lambda pair: _compare(pictures, *pair, axes), _pairs(pictures))
    return [difference for of_pair in found for difference in of_pair], axes


def _pairs(pictures: Sequence[_Picture]) -> list[tuple[int, int]]:
    from scipy.sparse.csgraph import minimum_spanning_tree

    coarse = np.stack([picture.rough[::2, ::2].ravel() for picture in pictures])
    products = coarse @ coarse.T
    # what is left of white noise after a Gaussian
    noise = np.array([0.25 * np.count_nonzero(p.there) * p.noise / (4.0 * math.pi * FINE**2) for p in pictures])
    norm = np.sqrt(np.maximum(np.diag(products) - noise, 1e-3 * noise + 1e-30))
    alike = np.abs(products) / np.outer(norm, norm)
    np.fill_diagonal(alike, 0.0)
    tree = np.argwhere(minimum_spanning_tree(1.0 / np.maximum(alike, 1e-9)).toarray() > 0.0)
    nearest = np.argsort(-alike, axis=1)[:, :ALIKE]
    pairs = [*map(tuple, tree.tolist()), *((j, k) for j, row in enumerate(nearest.tolist()) for k in row if j != k)]
    return sorted({(min(pair), max(pair)) for pair in pairs if alike[pair] > SAME})


def _compare(pictures: Sequence[_Picture], first: int, second: int, axes: Floats) -> list[_Difference]:
    """How two pictures lie to each other, along no, one or both columns of `axes`, the second of which is steeper."""
    from scipy.ndimage import binary_erosion

    one, other = pictures[first], pictures[second]
    inner = binary_erosion(one.there & other.there, iterations=2)
    if np.count_nonzero(inner) < LEAST:
        return []
    slopes = axes.T @ other.slopes[:, inner]
    strength = np.mean(slopes**2, axis=1)
    least = PLAIN * other.noise
    rows, cols = np.nonzero(inner)
    strip = np.floor((axes[0, 1] * cols + axes[1, 1] * rows) / STRIP).astype(int)
    # the contrast changes over the sample, with the directions; over its middle it is the first column's
    place = np.stack([np.ones(rows.size), cols - cols.mean(), rows - rows.mean()])
    contrast = other.rough[inner] * place / np.abs(place).max(axis=1, keepdims=True)
    for kept in (strength > max(least, FAINT * strength[1]), strength >= max(strength[1], least)):
        if kept.any():
            found = _along(np.concatenate([contrast, -slopes[kept]]), one.rough[inner], strip - strip.min())
            if found is not None:
                return [
                    _Difference(first, second, a, float(s), float(u))
                    for a, s, u in zip(np.flatnonzero(kept).tolist(), *found, strict=True)
                ]
    return []


def _along(columns: Floats, picture: Floats, strip: Ints) -> tuple[Floats, Floats] | None:
    """Shifts along some axes and their uncertainties [cells]; None where they are not told.

    Of the columns the first three are the contrast's. Cells are given as lists, `strip` numbers the part of the picture
    that each lies in.
    """
    inverse = np.linalg.inv(columns @ columns.T)
    values = inverse @ (columns @ picture)
    left = picture - values @ columns
    scores = np.stack([np.bincount(strip, column * left) for column in columns])
    covariance = inverse @ (scores @ scores.T) @ inverse
    if values[0] ** 2 <= TOLD**2 * covariance[0, 0]:
        return None
    shift, u = values[3:] / values[0], np.maximum(np.sqrt(np.diag(covariance)[3:]) / abs(values[0]), SURE)
    return None if np.abs(shift).max() > FARTHEST or u.max() > UNSURE else (shift, u)


def _solved(count: int, differences: Sequence[_Difference], axes: Floats) -> tuple[Floats, Floats]:
    """Shifts of `count` pictures of which such differences are known, and their uncertainty [cells]; NaN: not told.

    Of pictures that do not hang together with the most, none is told.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    nothing = np.zeros((count, 2)), np.full((count, 2), np.nan)
    if not differences:
        return nothing
    first, second, axis = np.array([(d.first, d.second, d.axis) for d in differences]).T
    value, u = np.array([(d.value, d.u) for d in differences]).T
    _, part = connected_components(coo_array((np.ones(first.size), (first, second)), (count, count)))
    most = part == np.argmax(np.bincount(part))
    weight = most[first] / u
    matrix, row = np.zeros((first.size, count, 2)), np.arange(first.size)
    matrix[row, first], matrix[row, second] = axes.T[axis] * weight[:, None], -axes.T[axis] * weight[:, None]
    wanted = value * weight
    flat = matrix.reshape(len(differences), -1)
    strength, modes = np.linalg.eigh(flat.T @ flat)
    known = strength > 1e-9 * strength[-1]  # the others: all pictures together, and along streaks
    strength, modes = strength[known], modes[:, known]
    shift = modes @ (modes.T @ (flat.T @ wanted) / strength)
    freedom = np.count_nonzero(wanted) - np.count_nonzero(known)
    excess = max(1.0, float(np.sum((wanted - flat @ shift) ** 2)) / freedom) if freedom > 0 else 1.0
    # a picture's own noise is the same in all of its differences: half of their variance is never averaged out
    own, of_it = np.zeros((count, 2)), np.zeros((count, 2))
    for end in (first, second):
        np.add.at(own, (end, axis), 0.5 * u**2)
        np.add.at(of_it, (end, axis), 1.0)
    own = own / np.maximum(of_it, 1.0) @ axes.T**2
    spread = np.sqrt(np.maximum(excess * np.sum(modes**2 / strength, axis=1).reshape(-1, 2), own))
    told = (np.sum(modes**2, axis=1).reshape(-1, 2) > 0.25) & most[:, None]
    return shift.reshape(-1, 2), np.where(told, spread, np.nan)
