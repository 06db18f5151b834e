"""Encoders, backlash and zeros: what a reading says about where the arm is."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from gonio_sim.rig import SimulatedRig
from scipy import stats

from gonio.errors import ConfigError, DeviceError
from gonio.lab.rig import Pose
from tests.gonio_sim.conftest import describe, step

Build = Callable[..., SimulatedRig]
STEP_DEG = 0.088
EXACT = 1e-12
"""Rounding of sums of a few angles [rad]."""


def test_ideal_arms_stand_where_they_are_told(rig: Build) -> None:
    with rig(describe("sim-ideal")) as ideal:
        goal = Pose(light=0.3, camera=-1.2, tilt=0.4, spin=2.0)
        assert ideal.arms.move(goal) == ideal.world.pose == ideal.arms.read() == goal


def test_readings_are_whole_encoder_steps_from_the_known_zero(rig: Build) -> None:
    with rig(describe("sim")) as sim:
        for degrees in np.linspace(-80, 80, 23):
            read = sim.arms.move(Pose(light=math.radians(degrees)))
            counts = (math.degrees(read.light) + 0.37) / STEP_DEG  # 0.37: zero_offset_deg of the light arm
            assert counts == pytest.approx(round(counts), abs=1e-8)
            # the motor lands on the count nearest to the goal
            assert abs(math.degrees(read.light) - degrees) <= STEP_DEG / 2 + 1e-9


def test_true_position_is_uniform_within_the_count_that_is_read(rig: Build) -> None:
    """So the standard uncertainty of a reading is step/sqrt(12), and independent from step to step and axis to axis."""
    description = describe("sim", arms__light={"zero_u_deg": 0.0}, arms__camera={"zero_u_deg": 0.0})
    errors = []
    with rig(description) as sim:
        for n in range(1500):
            sim.begin(step(n))
            read = sim.arms.move(Pose(light=math.radians(-70 + 0.09 * n), camera=0.5))
            true = sim.world.pose
            errors.append((true.light - read.light, true.camera - read.camera))
    light, camera = np.degrees(errors).T
    half = STEP_DEG / 2
    assert max(np.abs(light).max(), np.abs(camera).max()) <= half + 1e-9
    # p-values below 1e-4 would be a fault: the seed is fixed
    assert stats.kstest(light, stats.uniform(-half, STEP_DEG).cdf).pvalue > 1e-4
    assert stats.kstest(camera, stats.uniform(-half, STEP_DEG).cdf).pvalue > 1e-4
    assert abs(np.corrcoef(light, camera)[0, 1]) < 5 / math.sqrt(light.size)
    assert abs(np.corrcoef(light[1:], light[:-1])[0, 1]) < 5 / math.sqrt(light.size)


def test_zero_errors_are_drawn_as_the_description_says(rig: Build) -> None:
    description = describe("sim")
    drawn = [
        (w.zero_error["light"], w.zero_error["camera"], w.zero_error["tilt"], w.zero_error["spin"])
        for w in (rig(description, seed=seed).world for seed in range(400))
    ]
    pulls = np.degrees(drawn) / 0.02
    assert stats.kstest(pulls.ravel(), "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(pulls.T) - np.eye(4)).max() < 5 / math.sqrt(len(drawn))


def test_zero_error_is_the_same_at_every_pose_of_a_seed(rig: Build) -> None:
    with rig(describe("sim", arms__light={"encoder_step_deg": 0.0}, arms__camera={"encoder_step_deg": 0.0})) as sim:
        for degrees in (-60, 0, 45):
            read = sim.arms.move(Pose(light=math.radians(degrees), camera=math.radians(degrees)))
            assert read.light - sim.world.pose.light == pytest.approx(sim.world.zero_error["light"], abs=EXACT)
            assert read.camera - sim.world.pose.camera == pytest.approx(sim.world.zero_error["camera"], abs=EXACT)


def test_known_offset_is_taken_out_and_hidden_offset_is_suffered(rig: Build) -> None:
    clean = {"encoder_step_deg": 0.0, "zero_u_deg": 0.0, "zero_offset_deg": 0.7}
    goal = Pose(light=math.radians(30))
    with rig(describe("sim", arms__light=clean | {"zero_offset_known": True})) as known:
        assert known.arms.move(goal).light == pytest.approx(goal.light, abs=EXACT)
        assert known.world.pose.light == pytest.approx(goal.light, abs=EXACT)
    with rig(describe("sim", arms__light=clean | {"zero_offset_known": False})) as hidden:
        assert hidden.arms.move(goal).light == pytest.approx(goal.light, abs=EXACT)
        assert hidden.world.pose.light == pytest.approx(goal.light - math.radians(0.7), abs=EXACT)


def test_approach_from_below_takes_the_backlash_up(rig: Build) -> None:
    """The true angle at a goal does not hang on where the arm came from, once the approach is longer than that."""
    goal = Pose(light=math.radians(20))
    with rig(describe("sim", arms__light={"encoder_step_deg": 0.0, "zero_u_deg": 0.0, "backlash_deg": 0.5})) as sim:
        for before in (-60, 19.9, 20.1, 60):
            sim.arms.move(Pose(light=math.radians(before)))
            sim.arms.move(goal)
            assert sim.world.pose.light == pytest.approx(goal.light, abs=EXACT)


def test_backlash_shows_without_an_approach(rig: Build) -> None:
    """From above the arm hangs back by the whole backlash, and the encoder does not see it."""
    clean = {"encoder_step_deg": 0.0, "zero_u_deg": 0.0, "backlash_deg": 0.5}
    goal = Pose(light=math.radians(20))
    with rig(describe("sim", arms__light=clean, acquisition={"approach_deg": 0.0})) as sim:
        sim.arms.move(Pose(light=math.radians(10)))
        assert sim.arms.move(goal).light == pytest.approx(goal.light, abs=EXACT)
        assert sim.world.pose.light == pytest.approx(goal.light, abs=EXACT)
        sim.arms.move(Pose(light=math.radians(40)))
        assert sim.arms.move(goal).light == pytest.approx(goal.light, abs=EXACT)
        assert sim.world.pose.light == pytest.approx(goal.light + math.radians(0.5), abs=EXACT)


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (Pose(light=math.radians(89.5)), r"light = 89\.5 deg is outside the limits of this axis, -89 to 89 deg"),
        (Pose(camera=math.radians(-120)), r"camera = -120 deg"),
        (Pose(tilt=math.radians(81)), r"tilt = 81 deg is outside .* -80 to 80"),
        (Pose(azimuth=0.1), r'azimuth = 5\.72958 deg: the rig "simulated goniometer" has no such axis'),
    ],
)
def test_goals_beyond_the_axes_are_refused_and_nothing_moves(rig: Build, goal: Pose, message: str) -> None:
    with rig(describe("sim")) as sim:
        before = sim.arms.move(Pose(light=0.1))
        with pytest.raises(ConfigError, match=message):
            sim.arms.move(goal)
        assert sim.arms.read() == before


def test_azimuth_axis_where_the_rig_has_one(rig: Build) -> None:
    with rig(describe("sim-ideal", arms__azimuth={"limits_deg": [-180, 180]}, holder={"axes": []})) as sim:
        goal = Pose(light=0.2, camera=0.3, azimuth=1.5)
        assert sim.arms.move(goal) == sim.world.pose == goal
        with pytest.raises(ConfigError, match=r"tilt = .* has no such axis; it has light, camera, azimuth"):
            sim.arms.move(Pose(tilt=0.1))


def test_devices_of_a_closed_rig_are_refused(rig: Build) -> None:
    sim = rig(describe("sim"))
    for use in (lambda: sim.arms.move(Pose()), sim.arms.read, sim.light.on, lambda: sim.camera.capture(0.1)):
        with pytest.raises(DeviceError, match="is not open"):
            use()
