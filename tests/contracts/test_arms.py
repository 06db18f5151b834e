"""What every set of arms has to do."""

import math
from dataclasses import replace

import pytest

from gonio.errors import ConfigError
from gonio.lab.rig import Rig
from tests.contracts.conftest import LANDED_DEG, STANDS_DEG, home, off_deg
from tests.contracts.rigs import Case


@pytest.mark.slow
def test_a_move_lands_inside_the_limits_and_read_says_where_it_stands(case: Case, rig: Rig) -> None:
    landed = rig.arms.move(home(case))
    assert off_deg(landed, home(case), case) <= LANDED_DEG
    assert off_deg(rig.arms.read(), landed, case) <= STANDS_DEG


def test_a_landing_from_above_is_the_same_as_one_from_below(case: Case, rig: Rig) -> None:
    """Every axis arrives from below, so that backlash in a gear is on the same side each time."""
    goal = home(case)
    landings = []
    for way in (-3.0, 3.0):
        rig.arms.move(replace(goal, **{name: getattr(goal, name) + math.radians(way) for name in movable(case)}))
        landings.append(rig.arms.move(goal))
    assert set(movable(case)) <= set(case.description.axes())
    assert off_deg(landings[0], landings[1], case) <= STANDS_DEG


def movable(case: Case) -> list[str]:
    """Axes that may go three degrees either way from home."""
    goal = home(case)
    limits = case.description.limits_deg()
    return [n for n, (low, high) in limits.items() if low + 3 <= math.degrees(getattr(goal, n)) <= high - 3]


def test_a_goal_outside_a_limit_is_refused_and_nothing_turns(case: Case, rig: Rig) -> None:
    before = rig.arms.read()
    for name, (low, high) in case.description.limits_deg().items():
        for beyond in (low - 1.0, high + 1.0):
            with pytest.raises(ConfigError, match=name):
                rig.arms.move(replace(home(case), **{name: math.radians(beyond)}))
    assert off_deg(rig.arms.read(), before, case) <= STANDS_DEG


def test_stop_never_raises_and_the_arms_go_on_after_it(case: Case, rig: Rig) -> None:
    goal = rig.arms.read()
    rig.arms.stop()
    rig.arms.stop()
    assert off_deg(rig.arms.move(home(case)), goal, case) <= STANDS_DEG


def test_park_ends_inside_the_limits(case: Case, rig: Rig) -> None:
    rig.arms.park()
    parked = rig.arms.read()
    for name, (low, high) in case.description.limits_deg().items():
        assert low - LANDED_DEG <= math.degrees(getattr(parked, name)) <= high + LANDED_DEG
