"""A measurement over days: the lamp is another one in each session, and the reference tells which."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from gonio.errors import Interrupted
from gonio.lab.acquisition.measure import RigChoice, carry_out
from gonio.lab.acquisition.progress import Silent
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf, white_reference
from gonio.lab.rig import Frame
from gonio.lab.rig.description import Reference, RigDescription
from gonio.samples.description import SampleDescription
from tests.gonio.numpy_rig import NumpyRig, StopAfter, describe, plan_in

PLAN = """name = "days"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [20]
theta_r_deg = [-70, -60, -50, -40, -5, 0, 10, 15, 30, 40, 50, 60]
"""
DAY_TO_DAY = 1.03


@dataclass
class Lamp(NumpyRig):
    """A bench whose frames are half a minute apart, with a lamp of its own level in each session."""

    level: float = 1.0
    clock: itertools.count[float] = field(default_factory=lambda: itertools.count(0.0))
    repeatable: bool = False

    def time_s(self) -> float:
        return next(self.clock)

    def capture(self, exposure_s: float) -> Frame:
        frame, camera = super().capture(exposure_s), self.description.camera
        signal_dn = (frame.mosaic.astype(float) - camera.black_level_dn) * (self.level if self.lit else 1.0)
        frame.mosaic[:] = np.clip(np.rint(signal_dn + camera.black_level_dn), 0, camera.white_level_dn)
        return frame


@dataclass
class Days:
    """Opens the bench for the next session."""

    gap_s: float
    level: float = 1.0
    now_s: float = 1.9e9
    toml: str = ""

    def open(self, description: RigDescription, *, sample: SampleDescription | None, seed: int, confirm: bool) -> Lamp:
        rig = Lamp(description, seed, level=self.level, clock=itertools.count(self.now_s, 30.0))
        self.level, self.now_s = self.level * DAY_TO_DAY, self.now_s + 200 * 30.0 + self.gap_s
        return rig


@pytest.mark.parametrize("gap_s", [43_200.0, 0.0], ids=["overnight", "soon"])
@pytest.mark.parametrize("stops", [(7,), (5, 6)], ids=["two sessions", "three sessions"])
def test_each_session_has_its_own_reference(tmp_path: Path, gap_s: float, stops: tuple[int, ...]) -> None:
    plan, rig = plan_in(tmp_path, PLAN), describe(reference=Reference(every=4, frames=2, how="axis"))
    days = Days(gap_s)
    for number, steps in enumerate((*stops, 0)):
        progress = StopAfter(steps) if steps else Silent()
        choice = RigChoice(days, rig, "numpy")
        if steps:
            with pytest.raises(Interrupted):
                carry_out(plan, choice, tmp_path / "run", resume=number > 0, progress=progress)
        else:
            carry_out(plan, choice, tmp_path / "run", resume=True, progress=progress)
    run = Run.open(tmp_path / "run")
    assert len(run.lit_anew_s) == len(stops)
    table = brdf.reduce_in_parts(run).table
    assert (table["flag"] == "").all()
    off = table["brdf"].to_numpy() / (0.5 / math.pi) - 1.0
    # 0.2 %: photon noise of the frames and of the visits; a lamp that is interpolated across the dark is off by 3 %
    assert np.abs(off - np.median(off)).max() < 2e-3


def test_the_level_is_not_interpolated_across_the_dark() -> None:
    times, values = np.array([0.0, 100.0, 200.0, 300.0, 400.0]), np.array([1.0, 1.001, 1.03, 1.031, 1.032])
    wanted = np.array([50.0, 140.0, 160.0, 250.0])
    dark = white_reference.fit(times, values, np.full(5, 1e-8), wanted, lit_s=[190.0])
    level = dark.at(wanted)
    np.testing.assert_allclose(level[1:3], 1.001, rtol=0, atol=1e-12)  # as at the last visit of their session
    assert level[0] == pytest.approx(1.0005, abs=3e-4)  # between the visits; a cubic bends a little
    # 40 s and 60 s after the last visit, of a lamp that drifts by 0.1 % in 100 s
    assert (dark.wander(wanted).u[1:3] >= [4e-4, 6e-4]).all()
    through = white_reference.fit(times, values, np.full(5, 1e-8), wanted)
    assert abs(through.at(wanted)[2] - 1.001) > 1e-2
    np.testing.assert_array_equal(through.held(wanted), wanted)
