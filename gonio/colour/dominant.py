"""Dominant wavelength and excitation purity: where a colour lies between white and the colours of pure light."""

import numpy as np

from gonio.colour.cie import chromaticity, spectrum_locus
from gonio.colour.cie import white as white_of
from gonio.errors import ArgumentError
from gonio.typing import ArrayLike, Floats, NDArray

RED_END_NM = 699.0
"""From here on all light has the same chromaticity, to the tables' digits."""
BLOCK = 65536
"""Colours handled at a time, so that what is computed of them stays in the cache."""


def dominant_wavelength(xy: ArrayLike, white: str | ArrayLike = "D65") -> tuple[Floats, Floats]:
    """Dominant wavelength [nm] and excitation purity of chromaticities.

    The line from white through the colour meets the boundary of all colours at the dominant wavelength. Where it
    meets the line of purples, the wavelength on the other side of white is given with a minus: the complementary one.
    The purity is the colour's share of the way from white to the boundary: 0 for white, 1 for pure light, and above 1
    for what no light has.

    The boundary is the polygon of the observer's table in steps of 1 nm, from 360 to 699 nm, closed by the line of
    purples.

    Parameters
    ----------
    xy
        Chromaticities (..., 2), as `chromaticity` gives them.
    white
        The white: the name of an illuminant, or its xy.

    Returns
    -------
    Two float64 arrays of the shape without the last axis. White itself has the purity 0 and no wavelength (NaN); NaN
    (black) gives NaN.

    Raises
    ------
    ArgumentError
        The last axis is not of length 2, or the white is no xy inside the boundary.
    """
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim == 0 or points.shape[-1] != 2:
        raise ArgumentError(f"xy has shape {points.shape}: its last axis must have x and y")
    centre = _white(white)
    boundary = _Boundary(centre)
    dx, dy = (points.reshape(-1, 2) - centre).T
    wave, purity = np.empty(dx.size), np.empty(dx.size)
    for first in range(0, dx.size, BLOCK):
        part = slice(first, first + BLOCK)
        wave[part], purity[part] = boundary.meets(np.ascontiguousarray(dx[part]), np.ascontiguousarray(dy[part]))
    return wave.reshape(points.shape[:-1])[()], purity.reshape(points.shape[:-1])[()]


def _white(white: str | ArrayLike) -> Floats:
    centre = chromaticity(white_of(white)) if isinstance(white, str) else np.asarray(white, dtype=np.float64)
    if centre.shape != (2,) or not bool(np.all(np.isfinite(centre))):
        raise ArgumentError(f"white = {white!r}: must be the name of an illuminant, or x and y")
    return centre


class _Boundary:
    """The polygon of all colours as seen from a white: its sides by the direction in which they lie."""

    def __init__(self, centre: Floats) -> None:
        nm, values = spectrum_locus()
        visible = nm <= RED_END_NM
        self.nm = nm[visible]
        self.x, self.y = (chromaticity(values[visible]) - centre).T
        self.along_x, self.along_y = np.roll(self.x, -1) - self.x, np.roll(self.y, -1) - self.y
        self.moment = self.x * self.along_y - self.y * self.along_x
        angle = np.unwrap(np.arctan2(self.y, self.x))
        self.first = angle[0]
        # clockwise from the violet end, where the table runs back by a trifle as some whites see it
        self.turned = np.maximum.accumulate(angle[0] - angle)
        if not np.pi < self.turned[-1] < 2.0 * np.pi:
            raise ArgumentError(f"white = {centre.tolist()}: must lie inside the colours of pure light")

    def meets(self, dx: Floats, dy: Floats) -> tuple[Floats, Floats]:
        """Wavelength, negative for the complementary one, and purity of colours at (dx, dy) from white."""
        with np.errstate(invalid="ignore", divide="ignore"):
            angle = np.arctan2(dy, dx)
            side = self._side(angle)
            purity = (dx * self.along_y[side] - dy * self.along_x[side]) / self.moment[side]
            wave = self._wavelength(side, dx, dy)
            purple = np.flatnonzero(side == self.nm.size - 1)
            dx, dy = -dx[purple], -dy[purple]
            wave[purple] = -self._wavelength(self._side(angle[purple] + np.pi), dx, dy)
        wave[purity == 0.0] = np.nan
        return wave, purity

    def _side(self, angle: Floats) -> NDArray[np.intp]:
        after = np.remainder(self.first - angle, 2.0 * np.pi)
        after[np.isnan(after)] = 0.0  # the colour stays NaN
        return np.asarray(np.searchsorted(self.turned, after, side="right") - 1)

    def _wavelength(self, side: NDArray[np.intp], dx: Floats, dy: Floats) -> Floats:
        share = (self.x[side] * dy - self.y[side] * dx) / (dx * self.along_y[side] - dy * self.along_x[side])
        return np.asarray(self.nm[side] + np.clip(share, 0.0, 1.0))  # the sides are 1 nm long
