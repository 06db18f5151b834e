"""From the pictures of the camera to the grid on the sample: where a cell lies in a picture, and what it gets."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.errors import ConfigError
from gonio.lab.rig import imaging
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.kinematics import View
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Floats, Ints
from gonio_maps.files import Tile, readable_part
from gonio_maps.reduction.map_planes import BLURRED, FULL, HOT, OUTSIDE, PIXEL, SHADOWED, MapPoint, Planes, lattices

MEAN_FROM = 2.0
"""Width in pixels of the camera, along both sides, from which on a cell takes the mean of the pixels that see it."""
MOST = 40_000
"""Cells along a side, at most."""
Shift = tuple[float, float]


@dataclass(frozen=True)
class Grid:
    """Square cells on the sample's plane, the middle one of which lies at its centre."""

    pixel_mm: float
    radius_mm: float
    """Radius of the sample's disc."""

    @property
    def places(self) -> Floats:
        """Middles of the columns, and of the rows [mm]."""
        half = math.floor(self.radius_mm / self.pixel_mm)
        return np.asarray(np.arange(-half, half + 1) * self.pixel_mm, dtype=float)

    def cells(self, tile: Tile) -> tuple[Floats, Floats]:
        """x and y of the cells of a tile, each of its shape [mm]."""
        x, y = np.meshgrid(self.places[tile.cols], self.places[tile.rows])
        return x, y


def grid(description: RigDescription, radius: float, pixel_mm: float | None) -> Grid:
    """The grid that covers the sample's disc; raises `ConfigError` for a size of its cells that cannot be."""
    if pixel_mm is None:
        pitch = imaging.pixel_on_focus_mm(description)
        if description.camera.pattern != "mono":
            pitch *= 2.0
        pixel_mm = float(f"{pitch:.2g}")
    if not (math.isfinite(pixel_mm) and 0.0 < pixel_mm <= 0.5 * radius):
        raise ConfigError(
            f"--pixel-mm {pixel_mm:g}: a cell must be larger than 0 and at most a quarter of the sample, whose disc is"
            f" {2 * radius:g} mm wide (holder.sample_diameter_mm)"
        )
    if 2.0 * radius / pixel_mm > MOST:
        raise ConfigError(
            f"--pixel-mm {pixel_mm:g}: makes {2 * radius / pixel_mm:.0f} cells along a side; at most {MOST} are"
            f" possible: give at least {2 * radius / MOST:.2g}"
        )
    return Grid(pixel_mm, radius)


def jacobian(description: RigDescription, view: View) -> Floats:
    """Change of the spot's x and y [mm] by a column and by a row of the sensor, at the centre, shape (2, 2)."""
    column, row = imaging.place(description, view, "sample")
    ends = [(column + 0.5, row), (column - 0.5, row), (column, row + 0.5), (column, row - 0.5)]
    a, b, c, d = (imaging.spot(description, view, *end) for end in ends)
    return np.stack([a - b, c - d], axis=-1)


def blur_mm(description: RigDescription, view: View, x: Floats, y: Floats) -> Floats:
    """Diameter of the lens's circle of confusion at spots of the sample [mm], across the line of sight.

    The lens is focused on the sample's centre: 2 tan(half-angle) times the distance of a spot from the plane in focus.
    """
    axis = view.optical_axis
    half = math.tan(math.radians(description.camera.lens_half_angle_deg))
    return np.asarray(2.0 * half * np.abs(axis[0] * x + axis[1] * y))


def blurred_px(camera: Camera) -> float:
    """Width of the lens's blur in the plane in focus [pixels]: an edge makes 95 % of its step within it."""
    return 4.0 * camera.blur_px


class Lookup:
    """What the cells of the grid get from the picture of one point, one rule for all of its cells.

    Where a cell is at least `MEAN_FROM` pixels wide along both sides of a pixel, it gets the mean of the pixels whose
    spots lie in it. Else it gets what lies between the four nearest pixels, linearly.
    """

    def __init__(self, planes: Planes, grid: Grid, point: MapPoint) -> None:
        self._planes, self._grid, self._point = planes, grid, point
        self._lattices = lattices(planes.camera, point.band.channel)
        self._boxes = [planes.box(point.view, lattice) for lattice in self._lattices]
        self._jacobian = jacobian(planes.description, point.view)
        widest = float(np.linalg.norm(self._jacobian, axis=0).max()) * self._lattices[0].pitch
        self.means = grid.pixel_mm >= MEAN_FROM * widest
        """Whether cells get means."""
        self._apart = 0.0 if self.means else float(self._lattices[0].pitch)
        """Pixels between those that a cell is interpolated from."""
        axis = point.view.optical_axis
        self._widest = float(self._half(*(grid.radius_mm * axis[:2] / max(math.hypot(axis[0], axis[1]), 1e-12))))
        """How far what a cell sees may lie from its middle at most, anywhere on the sample [mm]."""
        self._offsets: dict[int, int] = {}

    def at(self, tile: Tile, shift: Shift = (0.0, 0.0)) -> tuple[Floats, Floats, Ints]:
        """Value [1/sr], its variance, and flags of the cells of a tile, of a picture that lies `shift` [mm] beside."""
        x, y = self._grid.cells(tile)
        parts = [
            (self._mean if self.means else self._between)(k, x + shift[0], y + shift[1])
            for k in range(len(self._lattices))
        ]
        value = np.mean([part[0] for part in parts], axis=0)
        variance = np.mean([part[1] for part in parts], axis=0) / len(parts)
        flag = np.bitwise_or.reduce([part[2] for part in parts])
        away, edge = np.hypot(x, y), self._grid.radius_mm
        if float(away.max()) + self._widest > edge:
            flag = flag | np.where(away + self._half(x, y) > edge, BLURRED, 0)
            flag = np.where(away > edge, OUTSIDE, flag)
        bad = (flag & (OUTSIDE | FULL | HOT | SHADOWED)) != 0
        return np.where(bad, np.nan, value), np.where(bad, np.nan, variance), flag

    def footprint_mm(self) -> Floats:
        """Width along x and y of what a cell sees [mm]: an edge makes at least 95 % of its step within it.

        A camera's pixel, the way to the next one where cells are interpolated (a cell's own width where they are
        means), the lens's blur, and what is out of focus at the sample's edge.
        """
        axis, edge = self._point.view.optical_axis, self._grid.radius_mm
        aside = edge * axis[:2] / max(math.hypot(axis[0], axis[1]), 1e-12)
        wide = blur_mm(self._planes.description, self._point.view, aside[0], aside[1])
        stretch = np.sqrt(1.0 + (axis[:2] / axis[2]) ** 2)
        pixels = 1.0 + self._apart + blurred_px(self._planes.camera)
        return np.asarray(pixels * np.abs(self._jacobian).sum(axis=1) + wide * stretch + self._own_mm)

    @property
    def _own_mm(self) -> float:
        """Width of a cell that is a mean; 0 of one that is interpolated."""
        return self._grid.pixel_mm if self.means else 0.0

    def _half(self, x: Floats, y: Floats) -> Floats:
        """How far outward from its middle a cell sees [mm], by all pixels that it is made of."""
        view = self._point.view
        outward = np.stack([x, y], axis=-1) / np.maximum(np.hypot(x, y), 1e-12)[..., None]
        pixel = np.abs(outward @ self._jacobian).sum(axis=-1) * (
            0.5 + self._apart + 0.5 * blurred_px(self._planes.camera)
        )
        blur = blur_mm(self._planes.description, view, x, y) / abs(float(view.optical_axis[2]))
        return np.asarray(pixel + 0.5 * blur + 0.5 * self._own_mm * np.abs(outward).sum(axis=-1))

    def _places(self, k: int, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Row and column of spots in a picture."""
        lattice, (rows, cols) = self._lattices[k], self._boxes[k]
        spots = np.stack([x, y, np.zeros(x.shape)], axis=-1)
        column, row = imaging.project(self._planes.description, self._point.view, spots)
        return (row - lattice.row) / lattice.pitch - rows.start, (column - lattice.col) / lattice.pitch - cols.start

    def _picture(self, k: int, rows: slice, cols: slice) -> npt.NDArray[Any]:
        """A part of a picture, of which no more is kept: a map would count as memory."""
        path = self._planes.file(self._point, k)
        with readable_part(path):
            if k not in self._offsets:
                self._offsets[k] = np.load(path, mmap_mode="r").offset
            return np.array(np.memmap(path, PIXEL, "r", self._offsets[k], self._size(k))[rows, cols])

    def _between(self, k: int, x: Floats, y: Floats) -> tuple[Floats, Floats, Ints]:
        """Linear interpolation between the four pixels around each spot."""
        from gonio_maps.reduction._map_loops import between

        (height, width), (row, col) = self._size(k), self._places(k, x, y)
        there = (row >= 0.0) & (col >= 0.0) & (row < height - 1) & (col < width - 1)
        out = np.zeros(x.shape), np.zeros(x.shape), np.where(there, 0, OUTSIDE)
        if there.any():
            top, left = int(row[there].min()), int(col[there].min())
            held = self._picture(k, slice(top, int(row[there].max()) + 2), slice(left, int(col[there].max()) + 2))
            between(held, row, col, top, left, there, *out)
        return out

    def _mean(self, k: int, x: Floats, y: Floats) -> tuple[Floats, Floats, Ints]:
        """The mean of the pixels whose spots lie in each cell; hot ones are left out while half of them are not."""
        (height, width), pitch = self._size(k), self._grid.pixel_mm
        x0, y0 = float(x[0, 0]) - 0.5 * pitch, float(y[0, 0]) - 0.5 * pitch
        ends = np.meshgrid([x0, x0 + pitch * x.shape[1]], [y0, y0 + pitch * x.shape[0]])
        box = []
        for at, size in zip(self._places(k, *ends), (height, width), strict=True):
            low, high = (np.nan_to_num(edge, posinf=size) for edge in (at.min(), at.max()))
            start = min(max(math.floor(low) - 1, 0), size)
            box.append(slice(start, min(max(math.ceil(high) + 2, start), size)))
        if any(s.stop <= s.start for s in box):
            return np.zeros(x.shape), np.zeros(x.shape), np.full(x.shape, OUTSIDE)
        held = self._picture(k, *box)
        lattice, (rows, cols) = self._lattices[k], self._boxes[k]
        span = lattice.of(*(slice(s.start + b.start, s.stop + b.start) for s, b in zip(box, (rows, cols), strict=True)))
        every = (slice(None, None, lattice.pitch),) * 2
        seen = imaging.pixel_map(self._planes.description, self._point.view, *(slice(s.start, s.stop) for s in span))
        with np.errstate(invalid="ignore"):
            i = np.floor(np.nan_to_num((seen.y_mm[every] - y0) / pitch, nan=-1.0)).astype(int)
            j = np.floor(np.nan_to_num((seen.x_mm[every] - x0) / pitch, nan=-1.0)).astype(int)
        inside = (i >= 0) & (j >= 0) & (i < x.shape[0]) & (j < x.shape[1])
        return _means(held[inside], i[inside] * x.shape[1] + j[inside], x.shape)

    def _size(self, k: int) -> tuple[int, int]:
        rows, cols = self._boxes[k]
        return rows.stop - rows.start, cols.stop - cols.start


def _means(pixels: npt.NDArray[Any], cell: Ints, shape: tuple[int, ...]) -> tuple[Floats, Floats, Ints]:
    """Mean, variance and flags of the pixels of each cell."""
    size = math.prod(shape)
    good = pixels["flag"] == 0
    count = np.bincount(cell[good], minlength=size)
    every = np.bincount(cell, minlength=size)
    total = np.bincount(cell[good], pixels["brdf"][good], size)
    squared = np.bincount(cell[good], pixels["u"][good].astype(float) ** 2, size)
    flag = np.where(every == 0, OUTSIDE, 0)
    for bit, part in ((FULL, 0.0), (SHADOWED, 0.0), (OUTSIDE, 0.0), (HOT, 0.5)):
        struck = np.bincount(cell[(pixels["flag"] & bit) != 0], minlength=size)
        flag |= np.where(struck > part * every, bit, 0)
    safe = np.maximum(count, 1)
    return (total / safe).reshape(shape), (squared / safe**2).reshape(shape), flag.reshape(shape)
