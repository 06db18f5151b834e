"""Clearance of bodies over a whole box of angles: the compiled loop of `gonio.lab.rig.motion_planning`.

A body is all that lies within a radius of the convex hull of some points: a ball has one, a capsule two, a box eight.
Vectors are written out component by component: numba takes seconds to compile an assignment of one array to another.
"""

import math
from typing import Any

import numpy as np

from gonio.compiled import njit
from gonio.typing import Floats

BENCH, LIGHT, CAMERA, TILT, SPIN = range(5)
"""What carries a point."""
DEEPEST = 256
"""Most boxes on the stack: halving a box adds one, and an angle can be halved some 20 times."""
STEPS = 64
"""Most steps of the search for the two closest points; a box against a box takes fewer than ten."""
SOON, DOWNHILL = 300, 40
"""Boxes after which the smallest distance of the bodies is looked for downhill, and the steps of that."""
SAME = 1e-12
"""Relative: closer than this to the smallest distance is it."""
FLAT = 1e-9
"""A tetrahedron so thin, against its edges, holds nothing: which side of a face a corner is on is rounding there."""


@njit()
def carried(on: int, angles: Floats, frames: Floats, onto: Floats, shift: Floats) -> None:
    """The rotation and the shift [mm] that bring what `on` carries to where it stands in the lab.

    `angles` are light, camera, tilt, spin, azimuth [rad]; `frames` as of `gonio.lab.rig.kinematics.frames`.
    """
    for i in range(3):
        shift[i] = 0.0
        for j in range(3):
            onto[i, j] = 1.0 if i == j else 0.0
    if on in (LIGHT, CAMERA):
        which = 0 if on == LIGHT else 1
        s, c = math.sin(angles[which]), math.cos(angles[which])
        for i in range(3):
            x, y, z = frames[which, i, 0], frames[which, i, 1], frames[which, i, 2]
            onto[i, 0], onto[i, 1], onto[i, 2] = c * x - s * z, y, s * x + c * z
            shift[i] = frames[which, i, 3]
        if on == CAMERA:
            turn, upright = np.empty((3, 3)), frames[2, :, :3]
            s, c = math.sin(angles[4]), math.cos(angles[4])
            for i in range(3):
                for j in range(3):
                    x, y, z = upright[j, 0], upright[j, 1], upright[j, 2]
                    turn[i, j] = upright[i, 0] * (c * x - s * y) + upright[i, 1] * (s * x + c * y) + upright[i, 2] * z
            _after(turn, frames[2, :, 3], onto, shift)
    elif on in (TILT, SPIN):
        if on == SPIN:
            s, c = math.sin(angles[3]), math.cos(angles[3])
            for i in range(3):
                x, y, z = frames[3, i, 0], frames[3, i, 1], frames[3, i, 2]
                onto[i, 0], onto[i, 1], onto[i, 2] = c * x + s * y, c * y - s * x, z
        s, c = math.sin(angles[2]), math.cos(angles[2])
        turn = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        _after(turn, frames[3, :, 3], onto, shift)


@njit()
def _after(turn: Floats, around: Floats, onto: Floats, shift: Floats) -> None:
    """Turn what is placed already around a point."""
    first, moved = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        moved[i] = shift[i] - around[i]
        for j in range(3):
            first[i, j] = onto[i, j]
    for i in range(3):
        shift[i] = around[i]
        for j in range(3):
            shift[i] += turn[i, j] * moved[j]
            onto[i, j] = turn[i, 0] * first[0, j] + turn[i, 1] * first[1, j] + turn[i, 2] * first[2, j]


@njit()
def placed(on: Any, points: Floats, count: int, angles: Floats, frames: Floats, out: Floats) -> None:
    """The points of a body in the lab [mm]; the first is carried by `on[0]`, the others by `on[1]`."""
    onto, shift = np.empty((3, 3)), np.empty(3)
    carried(on[0], angles, frames, onto, shift)
    for k in range(count):
        if k == 1 and on[1] != on[0]:
            carried(on[1], angles, frames, onto, shift)
        for i in range(3):
            out[k, i] = onto[i, 0] * points[k, 0] + onto[i, 1] * points[k, 1] + onto[i, 2] * points[k, 2] + shift[i]


@njit()
def between_lines(a: Floats, b: Floats, c: Floats, d: Floats) -> Any:
    """Smallest distance between the line from a to b and that from c to d.

    Ericson (2005), section 5.1.9.
    """
    uu = vv = uv = uw = vw = 0.0
    for k in range(3):
        u, v, w = b[k] - a[k], d[k] - c[k], a[k] - c[k]
        uu += u * u
        vv += v * v
        uv += u * v
        uw += u * w
        vw += v * w
    area = uu * vv - uv * uv
    s = min(max((uv * vw - uw * vv) / area, 0.0), 1.0) if area > 1e-12 * uu * vv else 0.0
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if t < 0.0 or t > 1.0 or vv == 0.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((uv * t - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        total += (a[k] + s * (b[k] - a[k]) - c[k] - t * (d[k] - c[k])) ** 2
    return math.sqrt(total)


@njit()
def _dot(a: Floats, b: Floats) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit()
def _difference(a: Floats, b: Floats) -> Any:
    return np.array([a[0] - b[0], a[1] - b[1], a[2] - b[2]])


@njit()
def _nearest_of_triangle(a: Floats, b: Floats, c: Floats, weights: Floats) -> None:
    """The point of a triangle that is nearest to the origin, by the weights of its corners.

    Ericson (2005), section 5.1.5.
    """
    ab, ac = _difference(b, a), _difference(c, a)
    d1, d2, d3 = -_dot(ab, a), -_dot(ac, a), -_dot(ab, b)
    d4, d5, d6 = -_dot(ac, b), -_dot(ab, c), -_dot(ac, c)
    weights[0], weights[1], weights[2] = 0.0, 0.0, 0.0
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0.0 and d2 <= 0.0:
        weights[0] = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        weights[1] = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        weights[1] = d1 / (d1 - d3)
        weights[0] = 1.0 - weights[1]
    elif d6 >= 0.0 and d5 <= d6:
        weights[2] = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        weights[2] = d2 / (d2 - d6)
        weights[0] = 1.0 - weights[2]
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        weights[2] = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        weights[1] = 1.0 - weights[2]
    else:
        whole = va + vb + vc
        weights[1], weights[2] = vb / whole, vc / whole
        weights[0] = 1.0 - weights[1] - weights[2]


@njit()
def _nearest(simplex: Floats, count: int, out: Floats) -> int:
    """The point of a simplex that is nearest to the origin; what of it holds that point is kept. 0: it holds the
    origin."""
    weights, best = np.zeros(3), np.inf
    keep, kept = np.zeros(3, np.int64), 0
    if count == 4:
        inside = True
        for k in range(4):
            a, b, c = simplex[(k + 1) % 4], simplex[(k + 2) % 4], simplex[(k + 3) % 4]
            normal = np.array([
                (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1]),
                (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2]),
                (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]),
            ])  # fmt: skip
            edge = _difference(simplex[k], a)
            own, origin = _dot(normal, edge), -_dot(normal, a)
            if own * origin <= 0.0 or own * own <= FLAT * FLAT * _dot(normal, normal) * _dot(edge, edge):
                inside = False
        if inside:
            return 0
    faces = 4 if count == 4 else 1
    corners, point, corners_kept = np.empty(3, np.int64), np.empty(3), np.empty((3, 3))
    for k in range(faces):
        for j in range(3):
            corners[j] = (k + 1 + j) % 4 if count == 4 else j
        if count == 2:
            line = _difference(simplex[1], simplex[0])
            long = _dot(line, line)
            weights[1] = min(max(-_dot(line, simplex[0]) / long, 0.0), 1.0) if long > 0.0 else 0.0
            weights[0], weights[2] = 1.0 - weights[1], 0.0
        else:
            _nearest_of_triangle(simplex[corners[0]], simplex[corners[1]], simplex[corners[2]], weights)
        for i in range(3):
            point[i] = 0.0
            for j in range(3):
                if weights[j] > 0.0:
                    point[i] += weights[j] * simplex[corners[j], i]
        size = _dot(point, point)
        if size < best:
            best, kept = size, 0
            for j in range(3):
                out[j] = point[j]
                if weights[j] > 0.0:
                    keep[kept] = corners[j]
                    kept += 1
    for j in range(kept):
        for i in range(3):
            corners_kept[j, i] = simplex[keep[j], i]
    for j in range(kept):
        for i in range(3):
            simplex[j, i] = corners_kept[j, i]
    return kept


@njit()
def between(a: Floats, count_a: int, b: Floats, count_b: int, least: float, enough: float) -> Any:
    """Smallest distance between the convex hulls of two sets of points; 0 where they meet.

    What is below `least`, or above `enough`, need not be exact: then it is a bound from above, or from below.
    Elsewhere too it is never too large: a plane between the two proves it. Gilbert, Johnson & Keerthi (1988).
    """
    if count_a <= 2 and count_b <= 2:
        return between_lines(a[0], a[count_a - 1], b[0], b[count_b - 1])
    simplex, toward = np.empty((4, 3)), _difference(a[0], b[0])
    for i in range(3):
        simplex[0, i] = toward[i]
    count, proved = 1, 0.0
    for _ in range(STEPS):
        size = math.sqrt(_dot(toward, toward))
        if size <= least or size == 0.0:
            return size
        low, low_k, high, high_k = np.inf, 0, -np.inf, 0
        for k in range(count_a):
            along = _dot(a[k], toward)
            if along < low:
                low, low_k = along, k
        for k in range(count_b):
            along = _dot(b[k], toward)
            if along > high:
                high, high_k = along, k
        proved = max(proved, (low - high) / size)
        if proved > enough or size - proved <= SAME * size:
            return proved
        corner = _difference(a[low_k], b[high_k])
        for k in range(count):
            if simplex[k, 0] == corner[0] and simplex[k, 1] == corner[1] and simplex[k, 2] == corner[2]:
                return proved
        for i in range(3):
            simplex[count, i] = corner[i]
        count = _nearest(simplex, count + 1, toward)
        if count == 0:
            return 0.0
    return proved


@njit()
def spare_of(
    tied: bool, on: Any, points: Floats, counts: Any, distance: float, angles: Floats, frames: Floats, room: Floats,
    enough: float,
) -> Any:  # fmt: skip
    """How much room two bodies have at a pose beyond `distance` [mm]; below 0 too little.

    What is above `enough` need not be exact: then there is at least so much.
    """
    for one in range(2):
        placed(on[one], points[one], counts[one], angles, frames, room[one])
    if tied:
        return distance - math.sqrt(
            (room[0, 0, 0] - room[1, 0, 0]) ** 2
            + (room[0, 0, 1] - room[1, 0, 1]) ** 2
            + (room[0, 0, 2] - room[1, 0, 2]) ** 2
        )
    least = distance if enough < np.inf else 0.0
    return between(room[0], counts[0], room[1], counts[1], least, distance + enough) - distance


@njit()
def _descended(
    tied: bool, on: Any, points: Floats, counts: Any, distance: float, frames: Floats, lows: Floats, highs: Floats,
    room: Floats, least: float, at: Floats,
) -> float:  # fmt: skip
    """The least room found by going downhill from angles in a box, along one axis at a time; `at` goes there."""
    step = np.empty(5)
    for k in range(5):
        step[k] = (highs[k] - lows[k]) / 4
    for _ in range(DOWNHILL):
        better = False
        for k in range(5):
            for sign in (-1.0, 1.0):
                before = at[k]
                at[k] = min(max(before + sign * step[k], lows[k]), highs[k])
                if at[k] == before:
                    continue
                spare = spare_of(tied, on, points, counts, distance, at, frames, room, np.inf)
                if spare < least:
                    least, better = spare, True
                else:
                    at[k] = before
        if least <= 0.0:
            break
        if not better:
            for k in range(5):
                step[k] /= 2
    return least


@njit()
def too_close(
    tied: bool, on: Any, points: Floats, counts: Any, levers: Floats, distance: float, frames: Floats, finest: float,
    most: int, lows: Floats, highs: Floats,
) -> Any:  # fmt: skip
    """Angles in a box at which two bodies have too little room, or may; an empty array where they keep off.

    Parameters
    ----------
    tied
        The ends of a cable, which may come no further apart than the distance; else they keep it.
    on
        What carries the points of either body, shape (2, 2); see `placed`.
    points, counts
        Of either body, in the frames of what carries them, shape (2, n, 3) [mm], and how many are its own.
    levers
        How far a point of one moves at most against the other for one radian of each axis, shape (5,) [mm].
    distance
        That they have to keep, or may come to [mm].
    finest
        Less room than this is none [mm].
    most
        Boxes that are looked at before the rest counts as too close.
    """
    boxes, room = np.empty((DEEPEST, 2, 5)), np.empty((2, points.shape[1], 3))
    middle, where, moves = np.empty(5), np.empty(5), np.empty(5)
    for k in range(5):
        boxes[0, 0, k], boxes[0, 1, k] = lows[k], highs[k]
        where[k] = (lows[k] + highs[k]) / 2
    waiting, closest = 1, np.inf
    for number in range(most):
        if number == SOON:  # where bodies do meet, this finds it sooner than halving does
            closest = _descended(tied, on, points, counts, distance, frames, lows, highs, room, closest, where)
            if closest <= 0.0:
                return where
        if waiting == 0:
            return middle[:0]
        waiting -= 1
        widest, whole = 0, 0.0
        for k in range(5):
            low, high = boxes[waiting, 0, k], boxes[waiting, 1, k]
            middle[k], moves[k] = (low + high) / 2, levers[k] * (high - low) / 2
            whole += moves[k]
            if moves[k] > moves[widest]:
                widest = k
        spare = spare_of(tied, on, points, counts, distance, middle, frames, room, whole)
        if spare > whole:
            continue
        if spare <= 0.0 or whole < finest or waiting + 2 > DEEPEST:
            return middle
        if spare < closest:
            closest = spare
            for k in range(5):
                where[k] = middle[k]
        for k in range(5):
            boxes[waiting + 1, 0, k], boxes[waiting + 1, 1, k] = boxes[waiting, 0, k], boxes[waiting, 1, k]
        boxes[waiting, 1, widest] = middle[widest]
        boxes[waiting + 1, 0, widest] = middle[widest]
        waiting += 2
    return where


@njit()
def first_too_close(
    tied: Any, on: Any, points: Floats, counts: Any, levers: Floats, distances: Floats, frames: Floats, finest: float,
    most: int, lows: Floats, highs: Floats,
) -> Any:  # fmt: skip
    """The first of several pairs of bodies that come too close in a box of angles, and where; -1 where none does.

    Arrays as of `too_close`, with the pairs along a first axis.
    """
    for pair in range(len(on)):
        found = too_close(
            tied[pair], on[pair], points[pair], counts[pair], levers[pair], distances[pair], frames, finest, most,
            lows, highs,
        )  # fmt: skip
        if len(found) > 0:
            return pair, found
    return -1, np.empty(0)


@njit()
def spares(
    tied: Any, on: Any, points: Floats, counts: Any, distances: Floats, frames: Floats, poses: Floats, out: Floats
) -> None:
    """The clearance of each pair of bodies at each pose, shape (poses, pairs) [mm]."""
    room = np.empty((2, points.shape[2], 3))
    for pose in range(len(poses)):
        for pair in range(len(on)):
            out[pose, pair] = spare_of(
                tied[pair], on[pair], points[pair], counts[pair], distances[pair], poses[pose], frames, room, np.inf
            )
