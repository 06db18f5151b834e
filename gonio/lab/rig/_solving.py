"""The pose of a rig with errors of alignment that comes closest to given directions: compiled, from many starts."""

import math
from typing import Any

import numpy as np

from gonio.compiled import njit
from gonio.lab.rig._clearance import CAMERA, LIGHT, SPIN, carried
from gonio.typing import Floats

MOST = 5
"""Axes."""
PROBE = 1e-7
"""Step of differences [rad]."""
FIRST_DAMPING = 1e-3
LARGEST_DAMPING = 1e6


@njit()
def beside(angles: Floats, wanted: Floats, frames: Floats, heads: Floats, centre: Floats, surface: Floats,
           out: Floats) -> None:  # fmt: skip
    """By how much the directions to source and detector differ from those wanted, as six components."""
    onto_sample, to_sample = np.empty((3, 3)), np.empty(3)
    onto, shift, seen = np.empty((3, 3)), np.empty(3), np.empty(3)
    carried(SPIN, angles, frames, onto_sample, to_sample)
    for which in range(2):
        carried(LIGHT if which == 0 else CAMERA, angles, frames, onto, shift)
        for i in range(3):
            shift[i] -= to_sample[i]
            for j in range(3):
                shift[i] += onto[i, j] * heads[which, j]
        for i in range(3):
            seen[i] = -centre[i]
            for j in range(3):
                seen[i] += onto_sample[j, i] * shift[j]
        size = 0.0
        for i in range(3):
            out[3 * which + i] = surface[0, i] * seen[0] + surface[1, i] * seen[1] + surface[2, i] * seen[2]
            size += out[3 * which + i] ** 2
        for i in range(3):
            out[3 * which + i] = out[3 * which + i] / math.sqrt(size) - wanted[3 * which + i]


@njit()
def _product(a: Floats, b: Floats) -> Any:
    total = 0.0
    for k in range(6):
        total += a[k] * b[k]
    return total


@njit()
def _copy(source: Floats, into: Floats) -> None:
    """`into[:] = source`, which takes numba a second to compile."""
    for k in range(len(source)):
        into[k] = source[k]


@njit()
def closer(start: Floats, axes: Any, wanted: Floats, frames: Floats, heads: Floats, centre: Floats, surface: Floats,
           steps: int, enough: float, out: Floats) -> Any:  # fmt: skip
    """Levenberg & Marquardt's method over some axes; the root of the sum of squares that is left [rad].

    Nocedal & Wright (2006), section 10.3.
    """
    n, damping = len(axes), FIRST_DAMPING
    _copy(start, out)
    error, then, slopes = np.empty(6), np.empty(6), np.empty((MOST, 6))
    matrix, step, place = np.empty((MOST, MOST)), np.empty(MOST), np.empty(MOST)
    beside(out, wanted, frames, heads, centre, surface, error)
    size = math.sqrt(_product(error, error))
    for _ in range(steps):
        if size < enough or damping > LARGEST_DAMPING:
            break
        for k in range(n):
            _copy(out, place)
            place[axes[k]] += PROBE
            beside(place, wanted, frames, heads, centre, surface, then)
            for i in range(6):
                slopes[k, i] = (then[i] - error[i]) / PROBE
        while damping <= LARGEST_DAMPING:
            # (J'J + damping) step = -J'r by Cholesky's decomposition
            for i in range(n):
                step[i] = -_product(slopes[i], error)
                for j in range(i + 1):
                    total = _product(slopes[i], slopes[j]) + (damping if i == j else 0.0)
                    for k in range(j):
                        total -= matrix[i, k] * matrix[j, k]
                    matrix[i, j] = math.sqrt(max(total, 1e-300)) if i == j else total / matrix[j, j]
            for i in range(n):
                for k in range(i):
                    step[i] -= matrix[i, k] * step[k]
                step[i] /= matrix[i, i]
            for i in range(n - 1, -1, -1):
                for k in range(i + 1, n):
                    step[i] -= matrix[k, i] * step[k]
                step[i] /= matrix[i, i]
            _copy(out, place)
            for k in range(n):
                place[axes[k]] += step[k]
            beside(place, wanted, frames, heads, centre, surface, then)
            smaller = math.sqrt(_product(then, then))
            if smaller < size:
                _copy(place, out)
                _copy(then, error)
                size, damping = smaller, max(damping / 10.0, 1e-14)
                break
            damping *= 10.0
    return size
