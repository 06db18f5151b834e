"""A smooth function over the sample, from as few evaluations as its shape allows.

The directions change by about a degree over a sample of 20 mm seen from 1 m, and a BRDF that an instrument sees changes
smoothly with them. So it is evaluated on a square grid of nodes and interpolated by cubics of four nodes a side. The
spacing is halved until every new node is predicted from the old ones within `TOLERANCE`; the finer grid is used, whose
own error is smaller still, by about 16 where the function is smooth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.compiled import njit

Array = npt.NDArray[np.float64]

TOLERANCE = 1e-4
"""Largest error of a prediction, relative to the value, that ends the refinement."""
FLOOR = 1e-3
"""Values below this part of the largest one, or below `DARK`, are followed less closely: within TOLERANCE of these."""
DARK = 1e-4
"""BRDF [1/sr] of a hundredth of a black plate."""
FEWEST, MOST = 5, 129
"""Nodes a side."""


@dataclass(frozen=True, slots=True)
class NodeGrid:
    """A function on the square [left, left + side] x [bottom, bottom + side], as values at equidistant nodes."""

    values: Array
    """Shape (nodes in y, nodes in x)."""
    left: float
    bottom: float
    side: float

    def fill(self, x: Array, y: Array, inside: npt.NDArray[np.bool_], out: Array) -> None:
        """Write the interpolated function into `out` at every pixel of `inside`; all of one two-dimensional shape."""
        spacing = self.side / (self.values.shape[0] - 1)
        _interpolate(self.values, self.left, self.bottom, spacing, x, y, inside, out)

    def at(self, x: Array, y: Array) -> Array:
        """The interpolated function at points of any shape."""
        out = np.empty(np.shape(x))
        flat = (1, out.size)
        self.fill(x.reshape(flat), y.reshape(flat), np.ones(flat, np.bool_), out.reshape(flat))
        return out


def sample_function(
    function: Callable[[Array, Array], Array], left: float, bottom: float, side: float, finest: float = 0.0
) -> NodeGrid:
    """A grid that follows `function(x, y)` (arrays of one shape in, one value each out) over a square.

    Below a spacing of `finest`, and beyond `MOST` nodes a side, it is not refined: a function with finer features is
    followed as well as that grid can.
    """
    grid = _evaluate(function, None, FEWEST, left, bottom, side)
    while grid.values.shape[0] < MOST and side / (grid.values.shape[0] - 1) >= 2.0 * finest:
        finer = _evaluate(function, grid, 2 * grid.values.shape[0] - 1, left, bottom, side)
        new = np.ones(finer.values.shape, dtype=bool)
        new[::2, ::2] = False
        x, y = _node_positions(finer.values.shape[0], left, bottom, side)
        error = np.abs(grid.at(x[new], y[new]) - finer.values[new])
        size = np.abs(finer.values[new]) + FLOOR * np.max(np.abs(finer.values)) + DARK
        grid = finer
        if not np.any(error > TOLERANCE * size):
            break
    return grid


def _node_positions(count: int, left: float, bottom: float, side: float) -> tuple[Array, Array]:
    t = np.linspace(0.0, side, count)
    x, y = np.meshgrid(left + t, bottom + t)
    return x, y


def _evaluate(
    function: Callable[[Array, Array], Array],
    coarse: NodeGrid | None,
    count: int,
    left: float,
    bottom: float,
    side: float,
) -> NodeGrid:
    """The function at all nodes; those of the grid of half as many are taken over."""
    x, y = _node_positions(count, left, bottom, side)
    values = np.empty(x.shape)
    new = np.ones(x.shape, dtype=bool)
    if coarse is not None:
        values[::2, ::2] = coarse.values
        new[::2, ::2] = False
    values[new] = function(x[new], y[new])
    return NodeGrid(values, left, bottom, side)


@njit(nogil=True, error_model="numpy")
def _interpolate(values: Any, left: float, bottom: float, h: float, x: Any, y: Any, inside: Any, out: Any) -> None:
    """Lagrange's cubic through the four nearest nodes in each direction, one-sided at the edges."""
    last = values.shape[0] - 4
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            if not inside[i, j]:
                continue
            s = (x[i, j] - left) / h
            t = (y[i, j] - bottom) / h
            col = min(max(int(s) - 1, 0), last)
            row = min(max(int(t) - 1, 0), last)
            a0, a1, a2, a3 = _weights(s - col)
            b0, b1, b2, b3 = _weights(t - row)
            total = 0.0
            for k, b in ((0, b0), (1, b1), (2, b2), (3, b3)):
                line = values[row + k]
                total += b * (a0 * line[col] + a1 * line[col + 1] + a2 * line[col + 2] + a3 * line[col + 3])
            out[i, j] = total


@njit(nogil=True, error_model="numpy")
def _weights(t: float) -> tuple[float, float, float, float]:
    """Weights of nodes 0, 1, 2, 3 at the position t in units of their spacing."""
    u, v, w = t - 1.0, t - 2.0, t - 3.0
    return -u * v * w / 6.0, t * v * w / 2.0, -t * u * w / 2.0, t * u * v / 6.0
