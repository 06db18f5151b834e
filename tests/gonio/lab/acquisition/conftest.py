"""A small run on a rig of numpy: measured once, and copied for every test that damages one or goes on with it."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from gonio.lab.acquisition.plan import Plan
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig.description import RigDescription
from tests.gonio import numpy_rig
from tests.gonio.numpy_rig import plan_in

Measure = Callable[..., Run]


@pytest.fixture(autouse=True)
def _compared(one_id: None) -> None:
    """Runs are compared to the byte."""


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return plan_in(tmp_path)


@pytest.fixture
def measure(plan: Plan, tmp_path: Path) -> Measure:
    """Measure the plan into a folder; a rig that is given collects the rigs that were opened."""

    def go(out: str = "run", *, rig: Any = None, description: RigDescription | None = None, **changes: Any) -> Run:
        arguments: dict[str, Any] = {"plan": plan, "command": "gonio measure ..."} | changes
        return numpy_rig.measured(out=tmp_path / out, rig=rig, description=description, **arguments)

    return go


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the whole run; not to be written to."""
    folder = tmp_path_factory.mktemp("measured")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("secrets.token_hex", lambda size: "1d" * size)
        return numpy_rig.measured(plan_in(folder), folder / "run", command="gonio measure ...").path


@pytest.fixture(scope="session")
def whole(measured: Path) -> list[StepRecord]:
    """Its steps."""
    return list(Run.open(measured).steps())


@pytest.fixture(scope="session")
def table(measured: Path) -> pd.DataFrame:
    """Its reduction; not to be written to."""
    return brdf.reduce(Run.open(measured))


@pytest.fixture
def run(measured: Path, tmp_path: Path) -> Run:
    """A copy of it, where `measure` goes on."""
    return Run.open(shutil.copytree(measured, tmp_path / "run"))
