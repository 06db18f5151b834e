"""A small run on a rig of numpy: measured once, and copied for every test that damages one or goes on with it."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gonio.acquisition.measure import RigChoice, carry_out
from gonio.acquisition.plan import Plan, load_plan
from gonio.acquisition.records import StepRecord
from gonio.acquisition.run import Run
from gonio.rig.description import RigDescription
from tests.gonio.numpy_rig import PLAN, SAMPLE, Plugin, describe

Measure = Callable[..., Run]


def _plan_in(folder: Path) -> Plan:
    (folder / "plan.toml").write_text(PLAN)
    return load_plan(folder / "plan.toml")


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return _plan_in(tmp_path)


@pytest.fixture
def measure(plan: Plan, tmp_path: Path) -> Measure:
    """Measure the plan into a folder; a rig that is given collects the rigs that were opened."""

    def go(out: str = "run", *, rig: Any = None, description: RigDescription | None = None, **changes: Any) -> Run:
        choice = RigChoice(rig or Plugin(), description or describe(), "numpy")
        arguments: dict[str, Any] = {"plan": plan, "sample": SAMPLE, "seed": 1, "command": "gonio measure ..."}
        arguments |= changes
        return carry_out(arguments.pop("plan"), choice, tmp_path / out, **arguments)

    return go


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the whole run; not to be written to."""
    folder = tmp_path_factory.mktemp("measured")
    choice = RigChoice(Plugin(), describe(), "numpy")
    return carry_out(_plan_in(folder), choice, folder / "run", sample=SAMPLE, seed=1, command="gonio measure ...").path


@pytest.fixture(scope="session")
def whole(measured: Path) -> list[StepRecord]:
    """Its steps."""
    return list(Run.open(measured).steps())


@pytest.fixture
def run(measured: Path, tmp_path: Path) -> Run:
    """A copy of it, where `measure` goes on."""
    return Run.open(shutil.copytree(measured, tmp_path / "run"))
