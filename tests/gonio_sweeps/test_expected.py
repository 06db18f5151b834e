"""What visits are expected to tell and to cost, by the formulas of a sensor's noise and a made-up clock."""

import math
from typing import cast

import numpy as np
import pytest
from gonio_sweeps import expected

from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.schedule import reference_pose
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import Acquisition, Reference
from gonio.lab.rig.light_and_camera import Camera, Lamp
from tests.gonio.numpy_rig import BANDS, describe

CAMERA = Camera(
    width=64, height=48, pixel_um=40.0, exposure_limits_s=(1e-4, 10.0), photon_noise=True, read_noise_e=8.0,
    electrons_per_dn=3.0, dark_current_e_per_s=40.0, full_well_e=10_000.0, responsivity_e_per_s=50_000.0,
)  # fmt: skip
RIG = describe(
    camera=CAMERA, lamp=Lamp(noise=0.002), reference=Reference(every=3, frames=4),
    acquisition=Acquisition(frames=2, exposure_target=0.6, roi_radius_mm=3.0),
)  # fmt: skip


def weight(pixels: float, factor: float, cosine: float, frames: int) -> float:
    """Frames that bring the target's share of a full well, and a shorter one; 1 / (relative variance) of each."""
    rate = 50_000.0 * factor * cosine
    t = round(0.6 * 10_000.0 / rate, 6)
    out = 0.0
    for one in (*[t] * frames, round(t / 4.0, 9)):
        noise = (rate + 40.0) * one + 8.0**2 + 3.0**2 / 12.0
        out += 1.0 / (noise / (pixels * (rate * one) ** 2) + 0.002**2)
    return out


@pytest.mark.parametrize(("light_deg", "brdf"), [(0.0, 0.3), (60.0, 0.3), (30.0, 0.02)])
def test_a_visit_tells_what_photons_read_noise_and_lamp_leave(light_deg: float, brdf: float) -> None:
    pose = Pose(light=math.radians(light_deg), camera=math.radians(-10.0))
    found = expected.Expected(Durations(RIG, BANDS[:1]), [pose, pose]).visits(np.array([brdf, 0.0]))
    wanted = weight(exposure.expected_pixels(RIG, pose), math.pi * brdf, math.cos(math.radians(light_deg)), 2)
    assert found.u_rel[0] == pytest.approx(1.0 / math.sqrt(wanted), rel=1e-4)  # exposures in whole microseconds
    assert found.u_rel[1] == math.inf, "nothing is seen"
    assert found.seconds[1] > found.seconds[0] > 0.0


def test_planned_brackets_count_all_their_frames() -> None:
    fine = RIG.model_copy(update={"acquisition": RIG.acquisition.model_copy(update={"u_rel_target": 0.001})})
    (u,) = expected.Expected(Durations(fine, BANDS[:1]), [Pose(camera=-0.2)]).visits(np.array([0.3])).u_rel
    assert 0.5 * 0.001 < u < 1.02 * 0.001


def test_the_level_is_that_of_a_line_through_expected_visits() -> None:
    """Equal visits at equal steps: the first point's time follows from the steps before it."""
    durations, home = Durations(RIG, BANDS[:1]), reference_pose(RIG)
    at = Pose(light=0.5, camera=-0.5)
    steps = [Step(0, "reference", pose=home), Step(1, "point", 0, at), Step(2, "reference", pose=home)]
    fitted, times = expected.level(durations, steps, {0: 0.3})
    first = durations.step(Pose(), steps[0]).total_s
    assert times == {0: pytest.approx(first + durations.step(home, steps[1], math.pi * 0.3).total_s)}
    assert fitted.line(np.array([times[0]]))[0] == pytest.approx(1.0)


class Clockwork:
    """A rig of which every way takes the difference of the light's angles, and a visit to the reference 7 s."""

    def __init__(self, every: int) -> None:
        self.description = RIG.model_copy(
            update={"reference": RIG.reference.model_copy(update={"every": every, "theta_i_deg": 0.0})}
        )

    def frames_s(self, step: Step) -> float:
        assert step.kind == "reference"
        return 7.0

    def move_s(self, start: Pose, goal: Pose) -> float:
        return abs(goal.light - start.light)

    def beside_s(self, move_s: float) -> float:
        return 0.0


@pytest.mark.parametrize(
    ("every", "seconds"),
    [
        # from 0 to 1, 2 and on to 4; then back
        (0, 4.0 + 4.0 + 6.0 + 7.0),
        (3, 4.0 + 4.0 + 6.0 + 7.0),
        # to 1 and 2, back, to 4, and back
        (2, 2.0 + 2.0 + 7.0 + 4.0 + 4.0 + 7.0 + 6.0),
        # back after each
        (1, 2.0 * (1.0 + 2.0 + 4.0) + 3 * 7.0 + 6.0),
    ],
)
def test_a_batch_takes_its_ways_its_frames_and_its_visits(every: int, seconds: float) -> None:
    poses = [Pose(light=float(k)) for k in (1, 2, 4)]
    found = expected.batch_s(cast(Durations, Clockwork(every)), poses, [1.0, 2.0, 3.0], Pose())
    assert found == pytest.approx(seconds)
