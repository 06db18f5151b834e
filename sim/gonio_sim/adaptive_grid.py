"""A smooth function over the sample, from as few evaluations as its shape allows.

The directions change by about a degree over a sample of 20 mm seen from 1 m, and a BRDF that an instrument sees changes
smoothly with them. So it is evaluated on a square grid of nodes and interpolated by cubics of four nodes a side. The
spacing is halved until every new node is predicted from the old ones within `TOLERANCE`; the finer grid is used, whose
own error is smaller still, by about 16 where the function is smooth.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.compiled import njit
from gonio.models._compile import jit
from gonio.models._math import cubic
from gonio.typing import Bools, Floats

TOLERANCE = 1e-4
"""Largest error of a prediction, relative to the value, that ends the refinement."""
FLOOR = 1e-3
"""Values below this part of the largest one, or below `DARK`, are followed less closely: within TOLERANCE of these."""
DARK = 1e-4
"""BRDF [1/sr] of a hundredth of a black plate."""
Function = Callable[[Floats, Floats], Floats]
FEWEST, MOST = 5, 129
"""Nodes a side."""


@dataclass(frozen=True, slots=True)
class NodeGrid:
    """A function on the square from -`reach` to `reach`, as values at equidistant nodes."""

    values: Floats
    """Shape (nodes in y, nodes in x)."""
    reach: float

    def paint(self, x: Floats, y: Floats, centre: tuple[float, float], radius: float, out: Floats) -> None:
        """Write the interpolated function into `out` where (x, y) lies in a disc; arrays of one two-dimensional shape.

        Where x or y is NaN nothing is written.
        """
        spacing = 2 * self.reach / (len(self.values) - 1)
        _paint(self.values, -self.reach, spacing, x, y, *centre, radius * radius, out)

    def at(self, x: Floats, y: Floats) -> Floats:
        """The interpolated function at points of any shape."""
        out = np.empty(np.shape(x))
        flat = (1, out.size)
        self.paint(x.reshape(flat), y.reshape(flat), (0.0, 0.0), math.inf, out.reshape(flat))
        return out


def sample_function(function: Function, reach: float, finest: float = 0.0) -> NodeGrid:
    """A grid that follows `function(x, y)` (arrays of one shape in, one value each out) over a square.

    Below a spacing of `finest`, and beyond `MOST` nodes a side, it is not refined: a function with finer features is
    followed as well as that grid can.
    """
    if reach < finest * (FEWEST - 1):
        return _evaluate(function, None, FEWEST, reach)
    finer = _evaluate(function, None, 2 * FEWEST - 1, reach)  # the two coarsest grids in one evaluation
    grid = NodeGrid(np.ascontiguousarray(finer.values[::2, ::2]), reach)
    while not _predicts(grid, finer):
        nodes = finer.values.shape[0]
        if nodes >= MOST or reach < finest * (nodes - 1):
            break
        grid, finer = finer, _evaluate(function, finer, 2 * nodes - 1, reach)
    return finer


def _predicts(grid: NodeGrid, finer: NodeGrid) -> bool:
    """Whether a grid gives the values at the nodes that only the next finer one has."""
    new, x, y = _new_nodes(finer.values.shape[0], finer.reach)
    error = np.abs(grid.at(x, y) - finer.values[new])
    size = np.abs(finer.values[new]) + FLOOR * np.max(np.abs(finer.values)) + DARK
    return bool(np.all(error <= TOLERANCE * size))


def _new_nodes(count: int, reach: float, every: bool = False) -> tuple[Bools, Floats, Floats]:
    """Nodes that a grid of half as many does not have (or all of them): which, and where they are."""
    x, y = np.meshgrid(*2 * [-reach + np.linspace(0.0, 2 * reach, count)])
    new = np.ones(x.shape, dtype=bool)
    new[::2, ::2] = every
    return new, x[new], y[new]


def _evaluate(function: Function, coarse: NodeGrid | None, count: int, reach: float) -> NodeGrid:
    """The function at all nodes; those of the grid of half as many are taken over."""
    new, x, y = _new_nodes(count, reach, every=coarse is None)
    values = np.empty(new.shape)
    if coarse is not None:
        values[::2, ::2] = coarse.values
    values[new] = function(x, y)
    return NodeGrid(values, reach)


_cubic = jit(cubic)


@njit(nogil=True, error_model="numpy")
def _paint(
    values: Any,
    first: float,
    h: float,
    x: Any,
    y: Any,
    centre_x: float,
    centre_y: float,
    radius_squared: float,
    out: Any,
) -> None:
    """Lagrange's cubic through the four nearest nodes in each direction, one-sided at the edges."""
    last = values.shape[0] - 4
    per_h = 1.0 / h
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            if not (x[i, j] - centre_x) ** 2 + (y[i, j] - centre_y) ** 2 <= radius_squared:
                continue  # as for a NaN, which is below nothing
            s = (x[i, j] - first) * per_h
            t = (y[i, j] - first) * per_h
            col = min(max(int(s) - 1, 0), last)
            row = min(max(int(t) - 1, 0), last)
            s, t = s - col, t - row
            l0, l1, l2, l3 = values[row], values[row + 1], values[row + 2], values[row + 3]
            out[i, j] = _cubic(
                t,
                _cubic(s, l0[col], l0[col + 1], l0[col + 2], l0[col + 3]),
                _cubic(s, l1[col], l1[col + 1], l1[col + 2], l1[col + 3]),
                _cubic(s, l2[col], l2[col + 1], l2[col + 2], l2[col + 3]),
                _cubic(s, l3[col], l3[col + 1], l3[col + 2], l3[col + 3]),
            )


@njit(nogil=True, error_model="numpy")
def electrons_per_s(scale: float, weight: Any, brdf: Any, most: float, out: Any) -> None:
    """Fill `out`, of single precision, with scale weight brdf, kept between 0 and `most`."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = min(max(scale * weight[i, j] * brdf[i, j], 0.0), most)
