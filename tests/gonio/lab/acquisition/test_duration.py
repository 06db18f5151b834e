"""How long moves, steps and runs take, by the rig file: against times that were worked out by hand."""

import math
from dataclasses import astuple
from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gonio.errors import ConfigError
from gonio.lab.acquisition.duration import SAME_PLACE, SETTLE_S, Durations, TimeParts
from gonio.lab.acquisition.exposure import dark_exposures_s, expected_bracket, expected_exposure_s
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.schedule import reference_pose, schedule
from gonio.lab.rig import Pose, Step
from gonio.lab.rig.description import Acquisition, ArmAxis, Arms, Body, Cable, Reference, RigDescription
from gonio.lab.rig.light_and_camera import Camera, Lamp
from gonio.lab.rig.motion_planning import route
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


@pytest.mark.parametrize(
    ("start", "goal", "seconds"),
    [
        (deg(), deg(light=30), 3.0 + 0.2 + SETTLE_S),  # 10 deg/s at 50 deg/s^2: 0.2 s more
        (deg(light=30), deg(), 3.2 + 0.2 + 2 * math.sqrt(2 / 50) + 2 * SETTLE_S),  # 2 deg are not enough for full speed
        (deg(), deg(camera=4), 2 * math.sqrt(4 / 50) + SETTLE_S),
    ],
)
def test_starting_and_stopping_takes_time_where_the_rig_file_says_so(start: Pose, goal: Pose, seconds: float) -> None:
    devices = {"servos": {"acceleration_deg_per_s2": 50.0}, "holder": {"acceleration_deg_per_s2": "?"}, "port": "x"}
    durations = Durations(rig(devices=devices), BANDS[:1])
    assert durations.move_s(start, goal) == pytest.approx(seconds, abs=ROUNDING)


def test_an_axis_that_comes_from_above_is_slow_on_its_way_up() -> None:
    durations = Durations(rig(acquisition=Acquisition(approach_deg=-2.0)), BANDS[:1])
    assert durations.move_s(deg(), deg(light=30)) == pytest.approx(3.2 + 0.2 + 2 * SETTLE_S, abs=ROUNDING)
    assert durations.move_s(deg(light=30), deg()) == pytest.approx(3.0 + SETTLE_S, abs=ROUNDING)


angle = st.floats(-80, 80)


@example(1.0, 0.0, 6e-8, 0.0)
@given(angle, angle, angle, angle)
def test_a_way_by_a_third_pose_is_never_quicker(light: float, camera: float, other: float, another: float) -> None:
    """Else an order of points could be bettered by going nowhere; approaches cost the same on the way."""
    durations = Durations(rig(acquisition=Acquisition(approach_deg=0.0)), BANDS[:1])
    start, goal, third = deg(), deg(light=light, camera=camera), deg(light=other, camera=another)
    direct, around = (durations.move_s(start, goal), durations.move_s(start, third) + durations.move_s(third, goal))
    unseen = (
        math.degrees(SAME_PLACE) / 10.0
    )  # an axis stands within so much of its goal, which takes no time: once a leg
    assert direct <= around + 2.0 * unseen + ROUNDING


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
    parts, here, by_hand = durations.parts(steps), Pose(), TimeParts(warm_up_s=600.0)
    for step in steps:
        by_hand += durations.step(here, step)
        here = here if step.kind == "dark" else step.pose
    assert astuple(parts) == pytest.approx(astuple(by_hand), abs=ROUNDING)
    assert parts.dark_s == durations.frames_s(steps[0])
    visits = [step for step in steps if step.kind == "reference"]
    assert parts.reference_s == pytest.approx(len(visits) * durations.frames_s(visits[0]), abs=ROUNDING)
    assert parts.travel_s > 0.0
    assert parts.frames_s > 0.0


def test_frames_that_are_kept_are_those_of_the_rig_file_in_every_band() -> None:
    """Darks at two exposures, whatever the bands; points end with a shorter frame, visits do not."""
    dark, visit, point = (Step(0, kind, 0, deg(light=20)) for kind in ("dark", "reference", "point"))
    description = rig(reference=Reference(frames=7))
    durations = Durations(description, BANDS)
    assert [durations.frames(step) for step in (dark, visit, point)] == [4 * 2, 2 * 7, 2 * (3 + 1)]
    overhead = description.camera.frame_overhead_s
    assert durations.frames_s(dark) == pytest.approx(4 * sum(t + overhead for t in dark_exposures_s(description)))
    one = expected_exposure_s(description, visit.pose, 1.0)
    assert durations.frames_s(visit) == pytest.approx(2 * (7 + 1) * (one + overhead)), "one of them meters"
    planned = rig(acquisition=Acquisition(u_rel_target=0.002, dark_frames=4))
    for step, albedo in ((visit, 1.0), (point, 0.5)):
        assert Durations(planned, BANDS).frames(step) == 2 * len(expected_bracket(planned, step.pose, albedo))


def test_a_visit_that_looks_into_the_lamp_takes_the_exposure_of_the_lamp_through_its_filter() -> None:
    """White paper sends back the lamp's radiance times its solid angle over pi; half-angles of 2 deg: 1 / 820."""
    camera = Camera(lens_half_angle_deg=1.0, responsivity_e_per_s=4000.0, full_well_e=10_000.0)
    description = rig(
        reference=Reference(how="beam", attenuation=0.01, frames=7), lamp=Lamp(half_angle_deg=2.0), camera=camera
    )
    durations, step = Durations(description, BANDS), Step(0, "reference", 0, deg(light=90, camera=-90))
    level_per_s = 0.4 * 0.01 / math.radians(2.0) ** 2  # of small cones; 2 deg are small to 1e-3
    one = description.acquisition.exposure_target / level_per_s
    assert durations.frames_s(step) == pytest.approx(2 * 8 * (one + camera.frame_overhead_s), rel=1e-3)
    bright = rig(
        reference=Reference(how="beam", attenuation=1.0, frames=7),
        lamp=Lamp(half_angle_deg=0.1),
        camera=camera.model_copy(update={"lens_half_angle_deg": 0.1, "exposure_limits_s": (0.01, 10.0)}),
    )
    assert Durations(bright, BANDS).frames_s(step) == pytest.approx(2 * 8 * (0.01 + camera.frame_overhead_s))


@pytest.mark.parametrize(
    ("light", "camera", "stands"),
    [
        ((-100, 100), (-100, 100), (90, -90)),
        ((-60, 60), (-130, 130), (58, -122)),
        ((-100, 40), (-100, 145), (-90, 90)),
        ((-80, 60), (-60, 128), (-78, 102)),
        ((0, 170), (-40, 60), (142, -38)),
        ((-80, 80), (-80, 80), None),
        ((-91, 91), (-91, 91), None),
    ],
)
def test_arms_face_each_other_as_near_to_a_right_angle_as_their_limits_allow(
    light: tuple[float, float], camera: tuple[float, float], stands: tuple[float, float] | None
) -> None:
    """Less the room of an approach, 2 deg."""
    arms = Arms(light=ArmAxis(limits_deg=light), camera=ArmAxis(limits_deg=camera))
    description = rig(arms=arms, reference=Reference(how="beam", attenuation=0.01))
    if stands is None:
        with pytest.raises(ConfigError, match="needs arms that stand 180 deg apart"):
            reference_pose(description)
        return
    pose = reference_pose(description)
    assert (math.degrees(pose.light), math.degrees(pose.camera)) == pytest.approx(stands)


def test_moves_hide_the_read_out_before_them_and_no_more_than_that() -> None:
    """A dark, a visit 30 deg away (3.2 s), a point 0.5 deg further (0.65 s and the approach), and one in its place."""
    steps = [
        Step(0, "dark"),
        Step(1, "reference", pose=deg(light=30)),
        Step(2, "point", 0, deg(light=30.5)),
        Step(3, "point", 1, deg(light=30.5)),
    ]
    slow = Camera(width=64, height=48, pixel_um=40, exposure_limits_s=(1e-4, 10.0), readout_s=1.0)
    plain = Camera(width=64, height=48, pixel_um=40, exposure_limits_s=(1e-4, 10.0))
    with_it, without = Durations(rig(camera=slow), BANDS[:1]), Durations(rig(camera=plain), BANDS[:1])
    moves = [with_it.move_s(a.pose, b.pose) for a, b in pairwise(steps)]
    shots = [8, 3, 5, 5]  # two dark exposures of four frames; metering and two; metering, three and the shorter one
    assert moves[0] > 1.0 > moves[1] > moves[2] == 0.0
    whole, waits = with_it.parts(steps), without.parts(steps)
    assert whole.travel_s == waits.travel_s
    assert whole.dark_s == pytest.approx(waits.dark_s + shots[0], abs=ROUNDING)
    assert whole.reference_s == pytest.approx(waits.reference_s + shots[1] - 1.0, abs=ROUNDING)
    assert whole.frames_s == pytest.approx(waits.frames_s + shots[2] + shots[3] - moves[1], abs=ROUNDING)
    one, two, three = (with_it.step(a.pose, b) for a, b in pairwise(steps))
    assert astuple(one + two + three)[:3] == pytest.approx(astuple(whole)[:3], abs=ROUNDING)
