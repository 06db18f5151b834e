"""Short ways through poses: durations by a plain formula, and ways beside the best of all orders."""

import itertools

import numpy as np
import pytest

from gonio.lab.rig import _short_path
from gonio.typing import Floats, NDArray

SETTLE_S, SAME = 0.3, 1e-6
SPEED = np.array([0.5, 0.25])


def poses(seed: int, count: int) -> Floats:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 2)).round(3)


def begins(at: Floats, side: Floats) -> Floats:
    """An approach of 0.05 rad."""
    return np.asarray(at - 0.05 * side)


def plain_s(at: Floats, side: Floats, a: int, b: int) -> float:
    """To where the last part begins, of axes that stand beyond it; settle; then all to the goal, and settle."""
    back_s, last_s = [0.0], [0.0]
    for goal, start, stands, speed, way in zip(at[b], begins(at, side)[b], at[a], SPEED, side, strict=True):
        if abs(goal - stands) <= SAME:
            continue
        if way and (stands - start) * way > SAME:
            back_s.append(abs(start - stands) / speed)
            last_s.append(abs(goal - start) / speed)
        else:
            last_s.append(abs(goal - stands) / speed)
    settles = (len(last_s) > 1) + (len(back_s) > 1)
    return max(back_s) + max(last_s) + settles * SETTLE_S


def rig(at: Floats, side: Floats) -> tuple[Floats, Floats, Floats, Floats, float, float]:
    return at, begins(at, side), SPEED, side, SETTLE_S, SAME


SIDES = [np.array(side) for side in ([1.0, 1.0], [1.0, -1.0], [0.0, 1.0])]


@pytest.mark.parametrize("side", SIDES)
def test_a_move_goes_back_first_where_an_axis_stands_beyond_its_approach(side: Floats) -> None:
    at = poses(1, 12)
    at[5, 0], at[7] = at[4, 0], at[6]  # an axis that stays, and both
    for a, b in itertools.permutations(range(12), 2):
        assert _short_path.move_s(*rig(at, side), a, b) == pytest.approx(plain_s(at, side, a, b), abs=1e-12)


def closed_s(at: Floats, side: Floats, way: NDArray[np.int64] | tuple[int, ...]) -> float:
    """From the last pose through the others and back."""
    last = len(at) - 1
    return sum(plain_s(at, side, a, b) for a, b in itertools.pairwise([last, *map(int, way), last]))


def everyone(count: int) -> NDArray[np.int64]:
    """All poses are neighbours of all."""
    return np.tile(np.arange(count), (count, 1))


@pytest.mark.parametrize("side", SIDES)
def test_the_nearest_one_that_is_left_comes_next(side: Floats) -> None:
    at = poses(2, 9)
    found = _short_path.nearest_first(*rig(at, side), everyone(9)).tolist()
    left, here = set(range(8)), 8
    for pose in found:
        assert plain_s(at, side, here, pose) == pytest.approx(min(plain_s(at, side, here, c) for c in left))
        left.remove(pose)
        here = pose
    assert not left


def test_without_neighbours_the_first_pose_that_is_left_comes_next() -> None:
    at = poses(2, 5)
    near = np.full((5, 1), 4)  # only the last pose, where the way begins
    assert _short_path.nearest_first(*rig(at, SIDES[0]), near).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("side", SIDES)
def test_an_improved_way_is_near_the_best_of_all_orders(seed: int, side: Floats) -> None:
    """720 orders of six poses. A local search may end above the best one."""
    at = poses(10 + seed, 7)
    found = _short_path.improved(*rig(at, side), everyone(7), np.arange(6), 50)
    assert sorted(found.tolist()) == list(range(6))
    best = min(closed_s(at, side, way) for way in itertools.permutations(range(6)))
    assert best - 1e-9 <= closed_s(at, side, found) <= 1.15 * best
    again = _short_path.improved(*rig(at, side), everyone(7), found, 50)
    assert again.tolist() == found.tolist(), "nothing more is gained"
