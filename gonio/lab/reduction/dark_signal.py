"""The dark signal of each pixel, and what its noise has in common at points that use nearly the same pixels.

The formulas are explained in docs/radiometry.md, sections 1 and 2.
"""

import math

import numpy as np

from gonio.checks.values import CLIPPED
from gonio.lab.rig.light_and_camera import Camera
from gonio.lab.rig.regions import Roi
from gonio.typing import Array, Floats

FEW = 300
"""Points, about, from whose regions patterns are made. They leave out little of the noise of the others."""
HELD = 2**24
"""Pixels of all these regions together that are held at once: 128 MB."""
PATTERNS = 6
COLUMNS = 3
"""How many columns of a table hold what its values share of the noise of the dark frames."""


class Darks:
    """Each pixel's dark signal as a line over exposure time, for one rectangle of the sensor."""

    def __init__(self, frames: list[tuple[float, Array]], rows: slice, cols: slice, rate: float) -> None:
        self._corner = rows.start, cols.start
        times = np.array([t for t, _ in frames])
        self._centre, self._count = float(times.mean()), len(frames)
        self._spread = float(np.sum((times - self._centre) ** 2))
        stack = np.stack([mosaic for _, mosaic in frames]).astype(float)
        self._mean = stack.mean(axis=0)
        if self._spread > 1e-6 * self._centre**2 and len(frames) > 1:
            self._slope = np.tensordot(times - self._centre, stack, 1) / self._spread
        else:  # one exposure only: the data sheet's dark current
            self._slope, self._spread = np.full(self._mean.shape, rate), math.inf
        longer = times > self._centre
        self._groups = [times[group] for group in (~longer, longer) if group.any()]

    def of(self, region: Roi, exposure_s: float) -> Floats:
        """Dark signal [DN] of the used pixels of a region, black level included."""
        rows = slice(region.rows.start - self._corner[0], region.rows.stop - self._corner[0])
        cols = slice(region.cols.start - self._corner[1], region.cols.stop - self._corner[1])
        mean, slope = self._mean[rows, cols][region.mask], self._slope[rows, cols][region.mask]
        return np.asarray(mean + slope * (exposure_s - self._centre))

    def rate(self, region: Roi) -> Floats:
        """Dark signal of the used pixels of a region in one second [DN/s]."""
        rows = slice(region.rows.start - self._corner[0], region.rows.stop - self._corner[0])
        cols = slice(region.cols.start - self._corner[1], region.cols.stop - self._corner[1])
        return np.asarray(self._slope[rows, cols][region.mask])

    @property
    def line(self) -> tuple[Floats, Floats, float]:
        """For each pixel of the rectangle: dark signal [DN] at an exposure, its slope [DN/s]; and that exposure [s]."""
        return self._mean, self._slope, self._centre

    @property
    def exposures_s(self) -> Floats:
        """Mean exposure of the shorter and of the longer dark frames (where there are several exposures)."""
        return np.array([group.mean() for group in self._groups])

    def leverage(self, exposure_s: float) -> Floats:
        """What the noise of the shorter and of the longer dark frames does to the line at an exposure.

        The change of the line for one standard deviation of a pixel of one such frame, with its sign: roots of sums of
        squares over the frames of each kind.
        """
        away = (exposure_s - self._centre) / self._spread
        shares = [1.0 / self._count + away * (group - self._centre) for group in self._groups]
        return np.array([math.copysign(float(np.linalg.norm(share)), float(share.sum())) for share in shares])


def u_black(camera: Camera, values: Array) -> float:
    """Standard uncertainty [DN] of dark and of small signals, from noise that is cut off at 0; 0 where none is.

    The part of the pixels that read 0, and the mean of all, tell mean and deviation of the normal number that was cut
    off at half a step [Tobin1958]_. The mean of what is left is too high by their difference: so much is missing of a
    signal well above the noise, and less of smaller ones. A response curve was measured with the same noise, without
    dark current: near black it is wrong by at most what is cut off there of a mean of 0, 0.4 deviations.

    Parameters
    ----------
    values
        What pixels read in dark frames of one exposure, linear [DN].
    """
    from scipy.special import ndtri

    half = 0.5 * (camera.response[1] if camera.response else 1.0)
    zero, mean = float(np.mean(values == 0)), float(values.mean())
    if zero == 1.0:  # a camera without noise; of one with a curve, black may be anything that reads 0
        return half if camera.response else 0.0
    if zero <= CLIPPED:
        return 0.0
    z, density = float(ndtri(zero)), math.sqrt(0.5 / math.pi)
    deviation = (mean - half * (1.0 - zero)) / (density * math.exp(-0.5 * z * z) - z * (1.0 - zero))
    of_curve = density * deviation / math.sqrt(3.0) if camera.response else 0.0
    return math.hypot(mean - half + z * deviation, of_curve)


class Patterns:
    """Orthonormal patterns of pixels that make up most of the regions of all points.

    The noise of a dark frame is independent from pixel to pixel, and so are responsivities. So what they do to the mean
    over a region is a sum over patterns: each has a normal number of its own, which all points share.

    Parameters
    ----------
    regions, box
        The regions of some points, and a rectangle around those of all.
    first
        A region whose mean is a pattern of its own, to which all others are orthogonal (`of` leaves it out).
    """

    def __init__(self, regions: list[Roi], box: tuple[slice, slice], first: Roi | None = None) -> None:
        rows, cols = box
        self._corner = rows.start, cols.start
        shape = rows.stop - rows.start, cols.stop - cols.start
        few = regions[:: max(-(-len(regions) * shape[0] * shape[1] // HELD), 1)]
        flat = np.zeros((len(few), *shape))
        for image, region in zip(flat, few, strict=True):
            image[self._place(region)] = region.mask / math.sqrt(region.count)
            if first is not None:
                image[self._place(first)] -= (
                    region.shared(first) / math.sqrt(region.count) / first.count * first.mask.astype(float)
                )
        values, vectors = np.linalg.eigh(np.tensordot(flat, flat, ((1, 2), (1, 2))))
        last = np.flatnonzero(values > 1e-9 * len(few))[-PATTERNS:]
        self._images = np.tensordot(vectors[:, last] / np.sqrt(values[last]), flat, (0, 0))

    def _place(self, region: Roi) -> tuple[slice, slice]:
        top, left = self._corner
        rows, cols = region.rows, region.cols
        return slice(rows.start - top, rows.stop - top), slice(cols.start - left, cols.stop - left)

    def of(self, region: Roi) -> Floats:
        """Coefficients of the mean over one of the regions, for noise with which that mean has the variance 1."""
        out = np.zeros(PATTERNS)
        images = self._images[:, *self._place(region)]
        out[: len(images)] = images[:, region.mask].sum(axis=1) / math.sqrt(region.count)
        return out


def strongest(effects: Floats, u: Floats, count: int = COLUMNS) -> tuple[Floats, Floats]:
    """The columns that hold most of a covariance, and the variance that they leave to each value.

    Parameters
    ----------
    effects
        Change of each value for one standard deviation of each cause, shape (n, causes).
    u
        Independent standard uncertainties, in units of which the columns are the strongest, shape (n,).
    count
        How many columns there are at most.

    Returns
    -------
    columns : shape (n, count)
        Each with a negative sum: more dark signal, less light.
    rest : shape (n,)
    """
    scale = np.where(u > 0, u, 1.0)[:, None]
    left, size, _ = np.linalg.svd(effects / scale, full_matrices=False)
    columns = np.zeros((len(effects), count))
    found = (left * size)[:, :count] * scale
    columns[:, : found.shape[1]] = np.where(found.sum(axis=0) > 0, -found, found)
    return columns, np.maximum(np.sum(effects**2, axis=1) - np.sum(columns**2, axis=1), 0.0)
