"""Other valleys of He-Torrance along sigma0 at one slope, from what a fit has found.

A surface much rougher than the wavelength reflects by its slopes alone, so sigma0 and tau scaled alike change little,
and chi-square may have two valleys or three along that way. The model is taken at a few scales, its other parameters
follow each by a linear step, and between neighbouring scales it is taken as linear: chi-square is a parabola there.
"""

import numpy as np

from gonio_maps.models._batch_algebra import called, dot, seen_by_causes, solve, whitened_causes
from gonio_maps.models._batch_steps import linearised, shaded

ABOVE, BELOW, HUMP = 5.0, 1.0, 0.1
"""A valley counts where its chi-square is less than `ABOVE` above what is found; next to it, at least `BELOW` below;
and where a lower one beside it lies beyond a scale at which chi-square is at least `HUMP` higher."""
REACH = 2.5
"""Scales are looked at up to so many times what is found."""


@called
def promising(theta, box, pair, place, found, step, own, promised, part, best, starts):  # type: ignore[no-untyped-def]
    """`starts` between neighbouring scales, `part` of the way, and what `scaled` returns."""
    (free, lower, upper), (first, second) = box, (pair[0], pair[1])
    chi, count_of_starts = np.empty(place.size), 0
    for a in range(place.size - 1):
        chi_here = promised[a + 1]
        beside = a == found or a + 1 == found
        same = promised[a] <= chi_here > own[a] - HUMP or promised[a + 2] < chi_here > own[a + 1] - HUMP
        if chi_here < best + (-BELOW if beside else ABOVE) and not same:
            start, turn = starts[count_of_starts], part[a]
            start[:] = theta
            for b in range(free.size):
                start[free[b]] += (1.0 - turn) * step[a, b] + turn * step[a + 1, b]
            scale = place[a] ** (1.0 - turn) * place[a + 1] ** turn
            start[second] *= scale / theta[first]
            start[first] = scale
            for b in range(free.size):
                start[free[b]] = min(max(start[free[b]], lower[free[b]]), upper[free[b]])
            chi[count_of_starts] = chi_here
            count_of_starts += 1
    return starts, count_of_starts, chi


@called
def scaled(  # type: ignore[no-untyped-def]
    shade, derive, columns, z, w, relative, theta, box, around, best, scales, pair, room, work, count,
):  # fmt: skip
    """Starts in other valleys, one a row, how many there are, and the chi-square that each promises.

    `pair` are the parameters that scale; `scales` are values of the first one. `around` is the normal matrix at
    `theta`.
    """
    free, lower, upper = box
    k, r, size, first, second = free.size, relative.shape[0], theta.size, pair[0], pair[1]
    derivatives, causes = work[:k], work[k : k + r]
    triangle, inner, differs = room[0], room[1], room[10]
    here, found, nodes = theta[first], 0, 1
    for one in scales:
        found += one < here
        nodes += one < here * REACH
    place, sets = np.empty(nodes), np.empty((nodes, size))
    for a in range(nodes):
        place[a] = here if a == found else scales[a - (1 if a > found else 0)]
        sets[a] = theta
        sets[a, first] = place[a]
        sets[a, second] = theta[second] * (place[a] / theta[first])
    values, slope = room[8], np.ones(count)
    shaded(shade, columns, theta, free, lower, upper, differs, room[7], values, count)
    linearised(
        shade, derive, columns, theta, values, w, slope, free, lower, upper, differs, room[7], derivatives, count
    )
    if r:
        whitened_causes(relative, values, w, slope, causes, inner, count)
    misses, whole, moves = np.empty((nodes, count)), np.empty(nodes * count), np.empty(k, np.bool_)
    shade(columns, sets.ravel(), nodes, whole)
    for a in range(k):
        moves[a] = free[a] != first and around[a, a] > 0.0 and lower[free[a]] < theta[free[a]] < upper[free[a]]
    seen, of_causes = np.zeros((nodes, r)), np.zeros(r)
    right, step = np.empty((nodes, k)), np.empty((nodes, k))
    for a in range(nodes):
        for j in range(count):
            misses[a, j] = (z[j] - whole[a * count + j]) * w[j]
        if r:
            seen_by_causes(causes, inner, misses[a], count, seen[a])
    for b in range(k):
        if r:
            seen_by_causes(causes, inner, derivatives[b], count, of_causes)
        for a in range(nodes):
            right[a, b] = dot(derivatives[b], misses[a], count) - dot(of_causes, seen[a], r)
    own, promised, part = np.empty(nodes), np.full(nodes + 1, np.inf), np.empty(nodes)
    for a in range(nodes):
        solve(around, right[a], moves, 0.0, triangle, step[a])
        own[a] = dot(misses[a], misses[a], count) - dot(seen[a], seen[a], r) - dot(right[a], step[a], k)
    for a in range(nodes - 1):  # between scales a and a + 1
        mixed = dot(misses[a], misses[a + 1], count) - dot(seen[a], seen[a + 1], r) - dot(right[a], step[a + 1], k)
        bend = own[a] + own[a + 1] - 2.0 * mixed
        part[a] = min(max((own[a] - mixed) / bend, 0.0), 1.0) if bend > 0.0 else 0.0
        promised[a + 1] = own[a] - part[a] * (2.0 * (own[a] - mixed) - part[a] * bend)
    return promising(theta, box, pair, place, found, step, own, promised, part, best, sets)
