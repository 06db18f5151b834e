"""What is shown while a run is measured is what the reduction says in the end."""

from pathlib import Path

import numpy as np
import pytest
from gonio_watch.provisional import Provisional

from gonio.lab.acquisition.records import FrameRecord, StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf
from gonio.lab.reduction.count_rates import RunFrames
from gonio.lab.rig import Frame
from tests.gonio.lab.live.runs import measured

NARROW = """
name = "one step"
wavelength_nm = [550]
[[sweep]]
theta_i_deg = [30]
theta_r_deg = [-70, 0]
"""


def played(run: Run) -> Provisional:
    """All steps of a run, as they came."""
    found = Provisional(run)
    for step in run.steps():
        found.add(step)
    return found


def test_in_the_end_it_is_the_reduction_but_for_what_the_angles_do(whole: Path) -> None:
    run = Run.open(whole)
    found = played(run)
    table = brdf.reduce(run)
    for values in found.values():
        final = table[table["wavelength_nm"] == values.band.centre_nm].iloc[values.points]  # in the plan's order
        # a matt sample: the tilts' correction is far below the noise of the frames
        np.testing.assert_allclose(values.brdf, final["brdf"], rtol=1e-6)
        u = final["u_brdf"].to_numpy()
        assert np.all(values.u <= u * (1 + 1e-6)), "the angles' part is left out, and nothing is counted twice"
        assert np.all(values.u > 0.3 * u), "the reference and the frames are most of it on a matt sample"
        read = np.degrees(values.directions.theta_r)
        np.testing.assert_allclose(read, final["theta_r_deg"], rtol=1e-12)  # radians and back


def test_it_is_right_within_the_final_uncertainty_before_the_closing_reference(whole: Path) -> None:
    run = Run.open(whole)
    final = brdf.reduce(run)
    final = final[final["wavelength_nm"] == 550]
    known, u = final["brdf"].to_numpy(), final["u_brdf"].to_numpy()
    found, steps = Provisional(run), list(run.steps())
    seen = 0
    for step in steps[:8]:
        found.add(step)
        for values in found.values()[:1]:
            if len(values.points):
                seen = len(values.points)
                off = np.abs(values.brdf - known[values.points])
                assert np.all(off <= 4.0 * u[values.points]), "a normal value lies beyond 4 u once in 16 000"
    assert seen == 5


def test_a_step_is_read_once(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, read = Run.open(whole), list[str]()
    found = Provisional(run)
    original = RunFrames.read

    def reading(frames: RunFrames, step: StepRecord, entry: FrameRecord) -> Frame:
        read.append(entry.file)
        return original(frames, step, entry)

    monkeypatch.setattr(RunFrames, "read", reading)
    for step in run.steps():
        found.add(step)
        found.values()
    lit = [frame.file for step in run.steps() for frame in step.frames if frame.lamp]
    assert sorted(name for name in read if name in lit) == sorted(lit)


def test_visits_show_the_drift_of_the_reference(whole: Path) -> None:
    run = Run.open(whole)
    found = played(run)
    steps = [step.step for step in run.steps() if step.kind == "reference"]
    for values in found.values():
        assert [step for step, _, _ in values.visits] == steps
        assert values.visits[0][1:] == (1.0, 0.0)
        assert all(abs(ratio - 1.0) < 0.005 for _, ratio, _ in values.visits), "no drift; its pixels scatter by 0.2 %"


def test_what_was_lost_is_shown_no_more(whole: Path) -> None:
    run = Run.open(whole)
    found = played(run)
    found.drop([2])
    assert 2 not in found.values()[0].steps
    points, visits = len(found.values()[0].points), len(found.values()[0].visits)
    assert points + visits == len(run.steps()) - 2, "a dark has no rate"


def test_poses_that_look_beside_the_first_ones_are_reduced_too(tmp_path: Path) -> None:
    found = played(Run.open(measured(tmp_path, NARROW)))  # seen flat the patch is narrow, seen from above it is wide
    assert len(found.values()[0].points) == 2


def test_before_the_first_reference_there_is_nothing(whole: Path) -> None:
    run = Run.open(whole)
    found = Provisional(run)
    assert found.values() == []
    found.add(run.steps()[0])
    assert found.values() == []
