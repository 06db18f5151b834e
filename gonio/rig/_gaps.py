"""Gaps between capsules that axes carry, over a whole box of angles: the inner loop of `gonio.rig.ways`, compiled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from gonio.compiled import njit
from gonio.typing import Floats

BENCH, LIGHT, CAMERA, TILT, SPIN = range(5)
"""What carries a capsule."""
DEEPEST = 256
"""Boxes that wait; a box that is halved leaves one more, and an angle can be halved some 20 times."""


@njit()
def placed(on: int, point: Floats, angles: Floats, out: Floats) -> None:
    """A point of what `on` carries, in the lab; see `gonio.rig.kinematics` for the frames.

    `angles` are light, camera, tilt, spin, azimuth [rad].
    """
    x, y, z = point[0], point[1], point[2]
    if on in (LIGHT, CAMERA):
        arm = angles[0] if on == LIGHT else angles[1]
        s, c = math.sin(arm), math.cos(arm)
        x, z = c * x + s * z, c * z - s * x
        if on == CAMERA:
            s, c = math.sin(angles[4]), math.cos(angles[4])
            x, y = c * x - s * y, s * x + c * y
    elif on in (TILT, SPIN):
        if on == SPIN:
            s, c = math.sin(angles[3]), math.cos(angles[3])
            x, y = c * x - s * y, s * x + c * y
        s, c = math.sin(angles[2]), math.cos(angles[2])
        y, z = c * y + s * z, c * z - s * y
    out[0], out[1], out[2] = x, y, z


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
def too_close(
    on: Any, lines: Floats, levers: Floats, distance: float, finest: float, most: int, lows: Floats, highs: Floats
) -> Any:
    """Angles in a box at which two lines come closer than `distance`, or may; an empty array where they keep off.

    Parameters
    ----------
    on
        What carries either line.
    lines
        Their ends in the frames of what carries them, shape (2, 2, 3) [mm].
    levers
        How far a point of one moves at most against the other for one radian of each axis, shape (5,) [mm].
    finest
        Gaps smaller than this beyond `distance` are none [mm].
    most
        Boxes that are looked at before the rest counts as too close.
    """
    boxes = np.empty((DEEPEST, 2, 5))
    boxes[0, 0], boxes[0, 1] = lows, highs
    waiting = 1
    middle = (lows + highs) / 2
    ends = np.empty((2, 2, 3))
    for _ in range(most):
        if waiting == 0:
            return middle[:0]
        waiting -= 1
        low, high = boxes[waiting, 0].copy(), boxes[waiting, 1].copy()
        middle = (low + high) / 2
        moves = levers * (high - low) / 2
        for one in range(2):
            for end in range(2):
                placed(on[one], lines[one, end], middle, ends[one, end])
        spare = between_lines(ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1]) - distance
        whole = moves.sum()
        if spare > whole:
            continue
        if spare <= 0.0 or whole < finest or waiting + 2 > DEEPEST:
            return middle
        k = np.argmax(moves)
        boxes[waiting, 0], boxes[waiting, 1] = low, high
        boxes[waiting, 1, k] = middle[k]
        boxes[waiting + 1, 0], boxes[waiting + 1, 1] = low, high
        boxes[waiting + 1, 0, k] = middle[k]
        waiting += 2
    return middle


@njit()
def first_too_close(
    on: Any, lines: Floats, levers: Floats, distances: Floats, finest: float, most: int, lows: Floats, highs: Floats
) -> Any:
    """The first of several pairs of lines that come too close in a box of angles, and where; -1 where none does.

    Arrays as of `too_close`, with the pairs along a first axis.
    """
    for pair in range(len(on)):
        found = too_close(on[pair], lines[pair], levers[pair], distances[pair], finest, most, lows, highs)
        if len(found) > 0:
            return pair, found
    return -1, (lows + highs) / 2
