"""An order of a plan's points in which the rig travels less (`order = "short"`).

The order is that of plan.csv, so that a run goes on by the order that it was begun with.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gonio.acquisition.duration import SAME_PLACE, SETTLE_S, Durations, approach_starts
from gonio.acquisition.plan import Assessed, Plan, Point
from gonio.rig import Pose
from gonio.typing import Floats, NDArray

Ints = NDArray[np.int64]
NEIGHBOURS = 12
"""Poses that a way may go on to from a pose."""
PROMISING = 1.5
"""A way this many times longer than another one is not worth the time to improve it."""
ROUNDS = 100
"""More than any plan was seen to need."""


def ordered(
    plan: Plan, points: Sequence[Assessed], durations: Durations, reference: Pose, every: int
) -> tuple[Plan, list[Assessed]]:
    """A plan in the order that it asks for, and its points as the rig sees them.

    With `order = "short"` points that cannot be measured come last. Repeated points stay spread over the run: only what
    lies between two visits of any point changes places. Where no order is found that is quicker than the one of the
    plan, that stays.

    Parameters
    ----------
    plan, points
        What to measure, and what `assess` made of it.
    durations
        Of moves on the rig.
    reference
        The pose of visits to the white reference, where the way begins and ends.
    every
        Points between two visits; 0 for none between.
    """
    if plan.order == "as-written":
        return plan, list(points)
    reachable = [k for k, a in enumerate(points) if a.pose is not None]
    poses = [a.pose for a in points if a.pose is not None]
    if len(poses) > 2:
        way = shorter(poses, [points[k].point for k in reachable], durations, reference)
        before, after = (
            durations.way_s(list(_stations(each, reference, every))) for each in (poses, [poses[k] for k in way])
        )
        if after < before:
            reachable = [reachable[k] for k in way]
            points = [points[k] for k in [*reachable, *(k for k, a in enumerate(points) if a.pose is None)]]
    return replace(plan, points=tuple(a.point for a in points)), list(points)


def as_begun(plan: Plan, rows: Sequence[Sequence[float]]) -> Plan:
    """A plan in the order of a run that was begun with it; the plan itself where these are other points.

    `rows` are the four angles [deg] of the run's points, in order.
    """
    points = tuple(Point(*row) for row in rows)
    return replace(plan, points=points) if Counter(points) == Counter(plan.points) else plan


def shorter(poses: Sequence[Pose], points: Sequence[Point], durations: Durations, home: Pose) -> list[int]:
    """An order of poses in which the way from home through all of them and back takes less time.

    Between blocks in which no point comes twice nothing is exchanged.
    """
    out: list[int] = []
    for block in _blocks(points):
        way = [block[k] for k in _way([poses[k] for k in block], durations, home)]
        if out and len(way) > 1 and points[way[0]] == points[out[-1]]:
            way[:2] = way[1::-1]  # not twice in a row
        out += way
    return out


def _blocks(points: Sequence[Point]) -> list[list[int]]:
    """Stretches in which no point comes twice."""
    out: list[list[int]] = [[]]
    seen: set[Point] = set()
    for k, point in enumerate(points):
        if point in seen:
            out.append([])
            seen = set()
        out[-1].append(k)
        seen.add(point)
    return out


def _way(poses: Sequence[Pose], durations: Durations, home: Pose) -> list[int]:
    """The shortest way that is found through distinct points."""
    from scipy.spatial import cKDTree

    from gonio.rig import _short_path

    at = np.ascontiguousarray(durations.angles([*poses, home]))
    begin = np.ascontiguousarray(approach_starts(at, durations.approach, durations.limits))
    rig = at, begin, durations.speed, np.sign(durations.approach), SETTLE_S, SAME_PLACE
    seconds = at / durations.speed
    k = min(NEIGHBOURS + 1, len(at))
    _, near = cKDTree(seconds).query(seconds, k=k, p=np.inf)
    near = np.ascontiguousarray(near, dtype=np.int64)
    starts: list[Ints] = [np.arange(len(poses)), _short_path.nearest_first(*rig, near)]
    lengths = [_closed_s(at, way, durations) for way in starts]
    found: list[Ints] = [
        _short_path.improved(*rig, near, way, ROUNDS)
        for way, length in zip(starts, lengths, strict=True)
        if length <= PROMISING * min(lengths)
    ]
    best = min(range(len(found)), key=lambda k: _closed_s(at, found[k], durations))
    return list(map(int, found[best]))


def _closed_s(at: Floats, way: Ints, durations: Durations) -> float:
    """Duration of the way from the last pose through others and back [s]."""
    stations = np.concatenate([at[-1:], at[way], at[-1:]])
    return float(durations.direct_s(stations[:-1], stations[1:]).sum())


def _stations(poses: Sequence[Pose], reference: Pose, every: int) -> Iterator[Pose]:
    """The way from the reference through poses, with visits between, and back."""
    yield reference
    for k, pose in enumerate(poses, 1):
        yield pose
        if (every and k % every == 0) or k == len(poses):
            yield reference
