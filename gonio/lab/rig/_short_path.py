"""A short way through many poses and back: the compiled loops of `gonio.lab.acquisition.duration`.

Moves take another time there than back, because axes arrive from one side. So nothing here turns a stretch of the way
round.
"""

from typing import Any

import numpy as np

from gonio.compiled import njit
from gonio.typing import Floats, NDArray

Ints = NDArray[np.int64]
LONGEST = 3
"""Poses that are moved to another place of the way together."""
GAIN_S = 1e-9
"""Less than this is rounding."""


@njit()
def move_s(at: Floats, begin: Floats, speed: Floats, side: Floats, settle: float, same: float, a: int, b: int) -> Any:
    """Duration of a move between two poses; what `gonio.lab.acquisition.duration.Durations.direct_s` says of one."""
    first, second, moving, back = 0.0, 0.0, False, False
    for k in range(at.shape[1]):
        way = abs(at[b, k] - at[a, k])
        if way <= same:
            continue
        moving = True
        if (at[a, k] - begin[b, k]) * side[k] > same:
            back = True
            first = max(first, abs(begin[b, k] - at[a, k]) / speed[k])
            way = abs(at[b, k] - begin[b, k])
        second = max(second, way / speed[k])
    return first + second + (settle if moving else 0.0) + (settle if back else 0.0)


@njit()
def nearest_first(
    at: Floats, begin: Floats, speed: Floats, side: Floats, settle: float, same: float, near: Ints
) -> Ints:
    """A way from the last pose through all others: always on to the quickest of the neighbours that are left.

    Where no neighbour is left it goes on with the first pose that is, and `improved` mends what that spoils.

    Parameters
    ----------
    at, begin
        Angles of the axes, and where the approach to them begins, shape (poses, axes) [rad].
    speed, side
        Of the axes [rad/s], and the sign of their approach.
    settle, same
        Time to settle [s], and the way that is none [rad].
    near
        The neighbours of each pose, shape (poses, k).
    """
    count = at.shape[0]
    left = np.ones(count, dtype=np.bool_)
    out = np.empty(count - 1, dtype=np.int64)
    here, lowest = count - 1, 0
    left[here] = False
    for place in range(count - 1):
        best, best_s = -1, np.inf
        for c in near[here]:
            if left[c]:
                seconds = move_s(at, begin, speed, side, settle, same, here, c)
                if seconds < best_s:
                    best, best_s = c, seconds
        if best < 0:
            while not left[lowest]:
                lowest += 1
            best = lowest
        out[place] = best
        left[best] = False
        here = best
    return out


@njit()
def _place(
    at: Floats,
    begin: Floats,
    speed: Floats,
    side: Floats,
    settle: float,
    same: float,
    near: Ints,
    after: Ints,
    before: Ints,
    stretch: tuple[int, int, int],
    saved: float,
) -> tuple[int, int]:
    """Between which two poses a stretch (its first, its last, its length) costs least; -1 where that gains nothing."""
    a, b, length = stretch
    best, best_from, best_to = GAIN_S, -1, -1
    for end in range(2):
        for c in near[a if end == 0 else b]:
            inside, d = False, a
            for _ in range(length):
                inside = inside or d == c
                d = after[d]
            if inside:
                continue
            source, sink = (c, after[c]) if end == 0 else (before[c], c)
            if source == b or sink == a:
                continue
            first, last = (c, a) if end == 0 else (b, c)
            joined = move_s(at, begin, speed, side, settle, same, first, last)
            if joined >= saved:  # a neighbour so far away is no better place
                continue
            first, last = (b, sink) if end == 0 else (source, a)
            joined += move_s(at, begin, speed, side, settle, same, first, last)
            gain = saved - joined + move_s(at, begin, speed, side, settle, same, source, sink)
            if gain > best:
                best, best_from, best_to = gain, source, sink
    return best_from, best_to


@njit()
def improved(
    at: Floats, begin: Floats, speed: Floats, side: Floats, settle: float, same: float, near: Ints, way: Ints, most: int
) -> Ints:
    """A way, with stretches of up to `LONGEST` poses moved to where they cost less, until that gains nothing.

    Parameters as of `nearest_first`, and

    way
        The poses in order, without the last one, where it begins and ends.
    most
        Rounds through all poses.
    """
    count = at.shape[0]
    after, before = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    here = count - 1
    for c in way:
        after[here], before[c] = c, here
        here = c
    after[here], before[count - 1] = count - 1, here
    moved = np.ones(count, dtype=np.bool_)  # whether the surroundings of a pose have changed since it was looked at
    for _ in range(most):
        gained = False
        for a in range(count - 1):
            if not moved[a]:
                continue
            moved[a] = False
            b = a
            for length in range(1, LONGEST + 1):
                if length > 1:
                    b = after[b]
                if b == count - 1:
                    break
                p, q = before[a], after[b]
                if p == q:
                    break
                saved = (
                    move_s(at, begin, speed, side, settle, same, p, a)
                    + move_s(at, begin, speed, side, settle, same, b, q)
                    - move_s(at, begin, speed, side, settle, same, p, q)
                )
                best_from, best_to = _place(
                    at, begin, speed, side, settle, same, near, after, before, (a, b, length), saved
                )
                if best_from >= 0:
                    after[p], before[q] = q, p
                    after[best_from], before[a] = a, best_from
                    after[b], before[best_to] = best_to, b
                    for c in (a, b, p, q, best_from, best_to):
                        moved[c] = True
                    gained = True
                    break
        if not gained:
            break
    out = np.empty(count - 1, dtype=np.int64)
    here = after[count - 1]
    for place in range(count - 1):
        out[place] = here
        here = after[here]
    return out
