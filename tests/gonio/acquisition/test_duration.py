"""How long moves, steps and runs take, by the rig file: against times that were worked out by hand."""

from __future__ import annotations

import math
from dataclasses import astuple, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.acquisition.duration import SETTLE_S, Durations, Parts
from gonio.acquisition.exposure import expected_bracket, expected_exposure_s
from gonio.acquisition.plan import Plan, Point
from gonio.acquisition.schedule import schedule
from gonio.rig import Pose, Step
from gonio.rig.description import Acquisition, ArmAxis, Arms, Body, Cable, RigDescription
from gonio.rig.light_and_camera import Lamp
from gonio.rig.motion_planning import route
from tests.gonio.numpy_rig import BANDS, describe

ROUNDING = 1e-9
"""Of some ten sums and products of seconds."""


def deg(**angles: float) -> Pose:
    return Pose(**{name: math.radians(value) for name, value in angles.items()})


def rig(**changes: object) -> RigDescription:
    """Light arm 10 deg/s, camera arm 20 deg/s, holder 30 deg/s; everything comes from 2 deg below."""
    arms = Arms(light=ArmAxis(speed_deg_per_s=10.0), camera=ArmAxis(speed_deg_per_s=20.0))
    return describe(**{"arms": arms, "acquisition": Acquisition(approach_deg=2.0, frames=3, dark_frames=4)} | changes)


@pytest.mark.parametrize(
    ("start", "goal", "seconds"),
    [
        (deg(), deg(), 0.0),
        (deg(), deg(light=30), 3.0 + SETTLE_S),  # up: no detour
        (deg(light=30), deg(), 3.2 + 0.2 + 2 * SETTLE_S),  # down: 2 deg too far, and back
        (deg(), deg(light=1), 0.1 + 0.2 + 2 * SETTLE_S),  # up by less than the approach: it goes back first
        (deg(), deg(light=30, camera=-50), 52 / 20 + 3.0 + 2 * SETTLE_S),  # the light waits for the camera
        (deg(light=30, camera=40), deg(light=20, camera=60), 1.2 + 1.0 + 2 * SETTLE_S),
        (deg(light=80), deg(light=-90), 17.0 + SETTLE_S + SETTLE_S),  # at its lower limit there is no room below
    ],
)
def test_a_move_takes_what_its_slowest_axis_takes_twice(start: Pose, goal: Pose, seconds: float) -> None:
    at_limit = Arms(light=ArmAxis(speed_deg_per_s=10.0, limits_deg=(-90.0, 90.0)), camera=ArmAxis(speed_deg_per_s=20.0))
    durations = Durations(rig(arms=at_limit), BANDS[:1])
    assert durations.move_s(start, goal) == pytest.approx(seconds, abs=ROUNDING)
    assert durations.moves_s(start, [goal, start]) == pytest.approx([seconds, 0.0], abs=ROUNDING)


def test_an_axis_that_comes_from_above_is_slow_on_its_way_up() -> None:
    durations = Durations(rig(acquisition=Acquisition(approach_deg=-2.0)), BANDS[:1])
    assert durations.move_s(deg(), deg(light=30)) == pytest.approx(3.2 + 0.2 + 2 * SETTLE_S, abs=ROUNDING)
    assert durations.move_s(deg(light=30), deg()) == pytest.approx(3.0 + SETTLE_S, abs=ROUNDING)


angle = st.floats(-80, 80)


@given(angle, angle, angle, angle)
def test_a_way_by_a_third_pose_is_never_quicker(light: float, camera: float, other: float, another: float) -> None:
    """Else an order of points could be bettered by going nowhere; approaches cost the same on the way."""
    durations = Durations(rig(acquisition=Acquisition(approach_deg=0.0)), BANDS[:1])
    start, goal, third = deg(), deg(light=light, camera=camera), deg(light=other, camera=another)
    direct, around = (durations.move_s(start, goal), durations.move_s(start, third) + durations.move_s(third, goal))
    assert direct <= around + ROUNDING


LAMP_AND_LENS = (
    Body(name="lamp", on="light", from_mm=(0, -150, 250), to_mm=(0, 150, 250), radius_mm=20),
    Body(name="lens", on="camera", from_mm=(0, -150, 250), to_mm=(0, 150, 250), radius_mm=20),
)
LEASH = Cable(name="leash", from_on="light", from_mm=(0, 0, 400), to_on="camera", to_mm=(0, 0, 400), length_mm=580)
"""It lets the arms stand 93 degrees apart: the way below passes 100 if the camera arm is the quicker one."""


@pytest.mark.parametrize(
    ("what", "start", "goal"),
    [
        ({"bodies": LAMP_AND_LENS}, deg(light=-40, camera=-10), deg(light=20, camera=60)),
        ({"cables": (LEASH,)}, deg(light=-40, camera=30), deg(light=5, camera=60)),
    ],
)
def test_a_detour_around_bodies_and_cables_is_counted_leg_by_leg(
    what: dict[str, object], start: Pose, goal: Pose
) -> None:
    description = rig(**what)
    durations = Durations(description, BANDS[:1])
    legs = route(description, start, goal)
    assert len(legs) > 1
    plain = Durations(rig(), BANDS[:1])
    expected = sum(plain.move_s(a, b) for a, b in zip([start, *legs], legs, strict=False))
    assert durations.move_s(start, goal) == pytest.approx(expected, abs=ROUNDING)
    assert expected > plain.move_s(start, goal)


def test_frames_are_metering_frames_and_a_shorter_one() -> None:
    description = rig()
    durations, step = Durations(description, BANDS), Step(5, "point", 0, deg(light=20))
    overhead = description.camera.frame_overhead_s
    for reflectance in (0.1, 0.9):
        expected = 2 * ((1 + 3 + 1 / 4) * expected_exposure_s(description, step.pose, reflectance) + 5 * overhead)
        assert durations.frames_s(step, reflectance) == pytest.approx(expected, abs=ROUNDING)
    by_band = durations.frames_s(step, {BANDS[0].name: 0.1, BANDS[1].name: 0.9})
    either = durations.frames_s(step, 0.1), durations.frames_s(step, 0.9)
    assert by_band == pytest.approx(sum(either) / 2, abs=ROUNDING)
    assert durations.frames_s(step) == durations.frames_s(step, 0.5)


def test_a_planned_bracket_is_counted_as_it_is_planned() -> None:
    description = rig(acquisition=Acquisition(u_rel_target=0.002))
    step = Step(5, "point", 0, deg(light=20))
    planned = expected_bracket(description, step.pose, 0.5)
    metering = 1.25 * expected_exposure_s(description, step.pose, 0.5)
    expected = sum(planned) + metering + (len(planned) + 1) * description.camera.frame_overhead_s
    assert Durations(description, BANDS[:1]).frames_s(step) == pytest.approx(expected, abs=ROUNDING)


def test_parts_of_a_run_add_up_to_its_steps() -> None:
    description = rig(lamp=Lamp(warm_up_s=600.0))
    points = tuple(Point(20.0, 0.0, float(r), 180.0) for r in range(0, 60, 10))
    steps = schedule(Plan("p", (550.0,), points, 0, "test"), description)
    durations = Durations(description, BANDS[:1])
    parts, here, by_hand = durations.parts(steps), Pose(), Parts(warm_up_s=600.0)
    for step in steps:
        by_hand += durations.step(here, step)
        here = here if step.kind == "dark" else step.pose
    assert astuple(parts) == pytest.approx(astuple(by_hand), abs=ROUNDING)
    assert durations.total_s(steps) == parts.total_s
    assert parts.dark_s == durations.frames_s(steps[0])
    visits = [step for step in steps if step.kind == "reference"]
    assert parts.reference_s == pytest.approx(len(visits) * durations.frames_s(visits[0]), abs=ROUNDING)
    assert parts.travel_s > 0.0
    assert parts.frames_s > 0.0


def test_time_grows_with_bands_and_with_darker_samples() -> None:
    description = rig()
    step = Step(2, "point", 0, deg(light=20))
    one, two = Durations(description, BANDS[:1]), Durations(description, BANDS)
    assert one.step_s(Pose(), step) < two.step_s(Pose(), step) < 2 * one.step_s(Pose(), step)
    assert one.step_s(Pose(), step, 0.01) > one.step_s(Pose(), step, 0.5)
    assert one.step_s(Pose(), replace(step, kind="dark")) == one.frames_s(replace(step, kind="dark"))
