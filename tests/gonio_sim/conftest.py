import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from gonio_sim.rig import SIM, SIM_IDEAL, SIM_METROLOGY, SimulatedRig

from gonio.config import parse, to_toml
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription


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


def measured(
    folder: Path,
    description: RigDescription,
    theta_i: Iterable[float],
    theta_r: Iterable[float],
    *,
    truth: dict[str, Any] | None = None,
    bands: Iterable[float] = (550,),
    name: str = "run",
    sample: SampleDescription = MATTE,
    plan: dict[str, Any] | None = None,
    **more: Any,
) -> Run:
    """A run in plane, unless `plan` has other keys, on a rig of which `truth` is true."""
    if truth is not None:
        (folder / "truth.toml").write_text(to_toml(truth))
        description = description.model_copy(update={"truth": str(folder / "truth.toml")})
    sweep = {"theta_i_deg": list(theta_i), "theta_r_deg": list(theta_r)}
    keys = {"name": "p", "wavelength_nm": list(bands), "sweep": [sweep]} | (plan or {})
    (folder / "plan.toml").write_text(to_toml(keys))
    choice = RigChoice(SIM, description, "sim")
    return carry_out(
        load_plan(folder / "plan.toml"), choice, folder / name, sample=sample, **{"seed": 1, "yes": True} | more
    )
