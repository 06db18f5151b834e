"""A camera that is read out for 2 s: how long a run takes by the watch beside the simulated rig, and what it holds."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_sim.camera import SimulatedCamera, SlowCamera
from gonio_sim.rig import SIM, SimulatedRig

from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.plan import load_plan
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.rig import Frame
from gonio.lab.rig.description import RigDescription
from gonio.samples.description import SampleDescription
from tests.gonio_sim.conftest import describe

READOUT_S = 2.0
GLOSSY = SampleDescription(name="glossy", model="phong", parameters={"k_d": 0.2, "k_s": 0.5, "exponent": 300})
"""Bright at the mirror: there a metering frame saturates while the frame before it is on its way."""
SPEED = {"speed_deg_per_s": 75.0}
"""Every step of a simulated rig begins at rest, and its move takes about 2 s then."""


def rig(**changes: dict[str, Any]) -> RigDescription:
    tables: dict[str, dict[str, Any]] = {
        "camera": {"width": 48, "height": 32, "pixel_um": 60.0, "readout_s": READOUT_S, "responsivity_e_per_s": 4e5},
        "acquisition": {"frames": 1, "dark_frames": 1},
        "reference": {"how": "axis", "every": 25},
        "arms__light": SPEED,
        "arms__camera": SPEED,
    }
    return describe("sim", **tables | changes)


class Waits(SimulatedCamera):
    """The same camera, which does not say when an exposure is over; it counts its frames."""

    shots = 0

    def capture(self, exposure_s: float) -> Frame:
        Waits.shots += 1
        return super().capture(exposure_s)


@dataclass
class Plugin:
    """The simulated rig, with this camera."""

    camera: type[SimulatedCamera]
    toml: str = ""
    opened: list[SimulatedRig] = field(default_factory=list)

    def open(self, description: RigDescription, **how: Any) -> SimulatedRig:
        self.opened.append(SIM.open(description, **how))
        assert type(self.opened[-1].camera) is SlowCamera
        self.opened[-1].camera.__class__ = self.camera  # type: ignore[assignment]
        return self.opened[-1]

    @property
    def watch_s(self) -> float:
        return self.opened[-1].world.watch_s


def plan_in(folder: Path, incidences: int, theta_r: int) -> Path:
    path = folder / "plan.toml"
    angles = np.linspace(5.0, 75.0, incidences).tolist(), np.linspace(-72.0, 78.0, theta_r).tolist()
    path.write_text(
        f'name = "p"\nwavelength_nm = [550]\n[[sweep]]\ntheta_i_deg = {angles[0]}\ntheta_r_deg = {angles[1]}\n'
    )
    return path


def measured(folder: Path, plugin: Plugin, plan: Path, description: RigDescription, **more: Any) -> Run:
    choice = RigChoice(plugin, description, "slow")
    return carry_out(load_plan(plan), choice, folder, sample=GLOSSY, seed=3, **more)


@pytest.fixture(autouse=True)
def unsynced(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.fsync", lambda descriptor: None)
    Waits.shots = 0


@pytest.mark.parametrize("incidences", [1, pytest.param(10, marks=pytest.mark.slow)])
def test_a_run_takes_what_the_longer_of_read_outs_and_moves_takes(tmp_path: Path, incidences: int) -> None:
    plan, description = plan_in(tmp_path, incidences, 20 if incidences > 1 else 8), rig()
    slow, waits = Plugin(SlowCamera), Plugin(Waits)
    run = measured(tmp_path / "slow", slow, plan, description)
    waiting = measured(tmp_path / "waits", waits, plan, description)
    assert sum(step.overlapped for step in run.steps()) == len(run.steps()) - 1
    read_out_s = Waits.shots * description.camera.beside_s
    others_s = waits.watch_s - read_out_s
    assert 1.5 < others_s / len(run.steps()) < 3.5, "moves and exposures of a step take about as long as a read-out"
    assert slow.watch_s <= 1.1 * max(read_out_s, others_s)
    pd.testing.assert_frame_equal(brdf.reduce(run), brdf.reduce(waiting), check_exact=True)
    flags = brdf.reduce(run)["flag"].value_counts()
    assert flags[""] > 0.8 * flags.sum()
    assert max(step.time_s for step in run.steps()) == max(step.time_s for step in waiting.steps())
