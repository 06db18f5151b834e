"""The clock of the simulated rig: frames have growing times, and no step reaches into the next one."""

import itertools

import pytest
from gonio_sim.world import LAST_S, World

from gonio.acquisition.measure import find_rig


@pytest.fixture
def world() -> World:
    return World(find_rig("sim").description, None, 1)


def test_stamps_join_the_clock_and_grow_through_the_last_millisecond(world: World) -> None:
    world.begin(3)
    slot = world._slot_s
    end = world.description.lamp.warm_up_s + 4 * slot
    world.spend(slot - LAST_S)
    before = world.frame_time_s()
    assert before == pytest.approx(end - LAST_S, abs=1e-9)  # a rounding of seconds
    world.spend(1e-6)
    # it goes on where the clock was: the first microsecond moves it by less than that
    assert before < world.frame_time_s() < before + 1e-6 + 1e-9
    stamps = []
    for _ in range(50):
        world.spend(slot)
        stamps.append(world.frame_time_s())
    assert all(a < b for a, b in itertools.pairwise(stamps))
    assert stamps[-1] < end
    assert world.now_s() == pytest.approx(end, abs=1e-9)
