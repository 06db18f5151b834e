from __future__ import annotations

import tomllib
from collections.abc import Callable
from typing import Any

import pytest
from gonio_sim.rig import SIM, SIM_IDEAL, SIM_METROLOGY, SimulatedRig

from gonio.config import parse
from gonio.rig import Pose, Step
from gonio.rig.description import RigDescription, SampleDescription


def describe(base: str = "sim", **changes: dict[str, Any]) -> RigDescription:
    """A shipped rig file with some keys of some tables changed: `describe("sim", lamp={"noise": 0.0})`.

    A double underscore goes one table down: `arms__light={"backlash_deg": 0.5}`.
    """
    values = tomllib.loads({"sim": SIM, "sim-ideal": SIM_IDEAL, "sim-metrology": SIM_METROLOGY}[base].toml)
    for path, keys in changes.items():
        table = values
        for name in path.split("__"):
            table = table.setdefault(name, {})
        table.update(keys)
    return parse(RigDescription, values, base)


MATTE = SampleDescription(name="matte", model="lambert", parameters={"albedo": 0.5})


@pytest.fixture
def rig() -> Callable[..., SimulatedRig]:
    """Builds rigs, `rig(description, sample, seed=1)`, each at the start of step 0."""

    def build(description: RigDescription, sample: SampleDescription | None = None, seed: int = 1) -> SimulatedRig:
        return SIM.open(description, sample=sample, seed=seed, confirm=False)

    return build


def step(index: int, pose: Pose | None = None) -> Step:
    return Step(index=index, kind="point", point=index, pose=pose or Pose())
