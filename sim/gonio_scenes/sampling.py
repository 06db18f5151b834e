"""Points that fill a square, or a square of squares, evenly: for pixels, lenses and discs of lamps."""

from __future__ import annotations

import math

import numpy as np

from gonio.typing import Floats

_ROOTS = {2: 1.3247179572447460, 4: 1.1673039782614187}
"""The root above 1 of x^(d + 1) = x + 1: multiples of its powers 1/x, 1/x^2, ... fill d dimensions evenly."""


def point(sample: int, shift: Floats) -> Floats:
    """Point number `sample` of an even sequence in [0, 1)^d, moved by each row of `shift` (n, d), d 2 or 4; (d, n).

    The sequence is Roberts' generalised golden ratio (2018). Moved by a random shift each of its points is uniformly
    distributed, so that means over them are without bias.
    """
    dimensions = shift.shape[1]
    step = _ROOTS[dimensions] ** -np.arange(1.0, dimensions + 1.0)
    return np.asarray(((shift + (sample + 0.5) * step) % 1.0).T)


def on_disc(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """The unit square onto the unit disc, areas in proportion and neighbours kept (Shirley and Chiu 1997)."""
    x, y = 2.0 * a - 1.0, 2.0 * b - 1.0
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    ratio = np.where(wide, y, x) / np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, math.pi / 4 * ratio, math.pi / 2 - math.pi / 4 * ratio)
    return radius * np.cos(angle), radius * np.sin(angle)
