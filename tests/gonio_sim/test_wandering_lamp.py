"""The simulated lamp's random walk: Brownian motion, alike whatever was asked before."""

import numpy as np
import pytest
from gonio_sim.world import World

from gonio.lab.rig.description import RigDescription
from tests.gonio.lab.reduction.drawn_runs import rig


def description(wander: float) -> RigDescription:
    """Of "sim", with no other change of the lamp."""
    known = rig().description
    lamp = known.lamp.model_copy(update={"noise": 0.0, "drift_per_hour": 0.0, "wander_per_sqrt_hour": wander})
    return known.model_copy(update={"lamp": lamp})


def level(world: World, seconds: float) -> float:
    world.begin(0)
    world._slot_s = 1e12
    world.spend(seconds)
    return world.lamp_level()


@pytest.mark.parametrize("lag", [30.0, 300.0, 3600.0])
def test_it_walks_as_far_as_its_key_says(lag: float) -> None:
    worlds = [World(description(0.01), None, seed) for seed in range(150)]
    begun = 5234.5
    walked = [level(world, begun + lag) - level(world, begun) for world in worlds]
    # 150 numbers know a standard deviation to 6 %
    assert np.std(walked) == pytest.approx(0.01 * np.sqrt(lag / 3600.0), rel=0.2)
    before = [level(world, begun) - level(world, begun - lag) for world in worlds]
    assert abs(np.corrcoef(walked, before)[0, 1]) < 0.25  # independent: 0 +- 0.08


def test_it_is_a_function_of_seed_and_time() -> None:
    one, other = World(description(0.01), None, 3), World(description(0.01), None, 3)
    times = [5.0, 5000.0, 17.25, 9e5, 5.0, 1e8, 2e8]
    forward = [level(one, t) for t in times]
    assert forward == list(reversed([level(other, t) for t in reversed(times)]))
    assert forward[-1] == forward[-2]  # beyond 48 days it stands
    assert level(World(description(0.01), None, 4), 5000.0) != forward[1]
    assert level(World(description(0.0), None, 3), 5000.0) == 1.0
