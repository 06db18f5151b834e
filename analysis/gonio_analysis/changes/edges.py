"""What an edge of a curve between measured neighbours does to a cubic through them.

Where the slope of a BRDF jumps, as where masking begins or at the normal, polynomials of any degree agree with each
other and are off together. Through `WINDOW` logarithms around a goal two curves are therefore laid, by least squares: a
polynomial of degree 5, and a cubic with a jump of its slope, at several places near the goal. The edge counts where it
stands out of the noise, and the polynomial does not describe the values clearly better. The error is what the edge
makes of the cubic through the four neighbours, at the place where that is the most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats, Ints

WINDOW = 8
"""Values that tell an edge from a smooth curve: a polynomial of degree 5 leaves two of them to judge it by."""
PLACES = (0.0, 0.25, 0.5, 0.75)
"""Where edges are looked for, as shares of an interval: between the four neighbours of the cubic."""
STANDS_OUT = 4.0
"""Standard deviations of its own noise that an edge is beyond. With 2.5 noise that is understated passes for edges: of
60 pairs with 1.5 times the stated noise 1 was found, with 4 it was 7."""
BETTER = 2.0
"""The polynomial is clearly better where its sum of squares, and the square of a value's noise, is smaller by this
factor. With 4, and 2.5 above, 7 of 360 fresh pairs of one model were called changed, with these numbers 10."""
CLEAR = 3.0
"""Logarithms are taken of values above so many standard uncertainties; an edge at the foot of a lobe needs its foot."""


@dataclass(frozen=True)
class Edges:
    """Where edges are looked for around goals, by their directions alone."""

    nodes: Ints
    """(n, WINDOW) the values around each goal, as places along the line; -1 where there are fewer."""
    left: Floats
    """(n, WINDOW - 4, WINDOW): from logarithms to what a cubic leaves of them."""
    fifth: Floats
    """(n, 2, WINDOW - 4): of that, what a polynomial of degree 5 takes away."""
    jump: Floats
    """(n, places, WINDOW - 4): of that, the shape of an edge, of length 1."""
    reach: Floats
    """(n, places): what an edge whose shape has length 1 there makes of the cubic at the goal."""

    @classmethod
    def around(cls, x: Floats, blocked: Floats, left: Ints, goal: Floats, cubic: Floats, farthest: float) -> Edges:
        """For goals right of the nodes `left` of places x.

        Parameters
        ----------
        blocked
            Places of rows that must not be used: nothing reaches across them.
        cubic : (n, 4) array
            Weights of the cubic through the neighbours.
        farthest
            Largest distance of neighbours.
        """
        first, good = _windows(x, blocked, left, farthest)
        nodes = np.where(good[:, None], first[:, None] + np.arange(WINDOW), -1)
        at = x[np.where(good, first, 0)[:, None] + np.arange(WINDOW)]
        scale = (at[:, -1] - at[:, 0])[:, None]
        at = (at - goal[:, None]) / scale  # the goal is at 0
        four = (x[np.clip(left - 1, 0, x.size - 4)[:, None] + np.arange(4)] - goal[:, None]) / scale
        places = four[:, :-1, None] + np.diff(four, axis=1)[:, :, None] * np.array(PLACES)
        places = places.reshape(goal.size, 3 * len(PLACES), 1)
        basis, _ = np.linalg.qr(at[:, :, None] ** np.arange(6))
        full, _ = np.linalg.qr(at[:, :, None] ** np.arange(4), mode="complete")
        rest = np.swapaxes(full[:, :, 4:], 1, 2)
        fifth = np.swapaxes(rest @ basis[:, :, 4:], 1, 2)
        jump = np.einsum("nij,nkj->nki", rest, np.maximum(at[:, None, :] - places, 0.0))
        size = np.linalg.norm(jump, axis=2)
        off = np.maximum(-places[:, :, 0], 0.0)
        off -= np.einsum("nj,nkj->nk", cubic, np.maximum(four[:, None, :] - places, 0.0))
        seen = size > 1e-9  # an edge between the first two values, or the last two, leaves nothing
        size = np.where(seen, size, 1.0)
        return cls(nodes, rest, fifth, jump / size[:, :, None], np.where(seen, np.abs(off) / size, 0.0))

    def error(self, which: Ints, values: Floats, noise: Floats | None) -> Floats:
        """Relative error at some of the goals, of values along the line; 0 where no edge is seen.

        `noise` is the values' independent standard uncertainty; None where none is stated.
        """
        nodes = self.nodes[which]
        f = values[nodes]
        u = np.zeros(f.shape) if noise is None else noise[nodes]
        out = np.zeros(which.size)
        some = np.flatnonzero((nodes[:, 0] >= 0) & (f > CLEAR * u).all(axis=1) & (f > 0.0).all(axis=1))
        if not some.size:
            return out
        at, u = which[some], u[some] / f[some]
        rest = np.einsum("nij,nj->ni", self.left[at], np.log(f[some]))
        left = (rest**2).sum(axis=1)
        polynomial = left - (np.einsum("nij,nj->ni", self.fifth[at], rest) ** 2).sum(axis=1)
        size = np.einsum("nki,ni->nk", self.jump[at], rest)
        of_noise = np.sqrt((np.einsum("nki,nij->nkj", self.jump[at], self.left[at]) ** 2 @ (u**2)[:, :, None])[:, :, 0])
        worse = left[:, None] - size**2
        limit = BETTER * ((u**2).mean(axis=1) + np.maximum(polynomial, 0.0))
        counts = (np.abs(size) > STANDS_OUT * of_noise) & (worse <= limit[:, None])
        out[some] = np.where(counts, np.abs(size) * self.reach[at], 0.0).max(axis=1)
        return out


def _windows(x: Floats, blocked: Floats, left: Ints, farthest: float) -> tuple[Ints, npt.NDArray[np.bool_]]:
    """First of the `WINDOW` nodes around each goal that nothing parts, as central as may be; whether there are any."""
    parted = (np.diff(x) > farthest) | (np.diff(np.searchsorted(blocked, x)) > 0)
    piece = np.concatenate([[0], np.cumsum(parted)])
    start, end = (np.searchsorted(piece, piece[left], side=side) for side in ("left", "right"))
    good = end - start >= WINDOW
    return np.clip(left - (WINDOW // 2 - 1), start, np.maximum(end - WINDOW, start)), np.asarray(good)
