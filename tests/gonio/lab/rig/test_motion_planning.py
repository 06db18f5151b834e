"""Ways on which no two bodies of a rig touch: distances, proofs against sampled motion, splits, branches."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from gonio_sim.rig import SIM_IDEAL

from gonio.config import parse
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.rig import Pose, Step, kinematics, motion_planning
from gonio.lab.rig.description import Acquisition, ArmAxis, Arms, Body, Cable, Geometry, Holder, RigDescription
from gonio.lab.rig.inverse_kinematics import Unreachable, reach
from gonio.lab.rig.light_and_camera import Camera, Lamp
from gonio.lab.rig.motion_planning import Blocked
from tests.gonio.numpy_rig import describe

AXIS = ArmAxis(limits_deg=(-89.0, 89.0))
HEADS = Geometry(
    light_distance_mm=400.0, camera_distance_mm=450.0, light_body_radius_mm=40.0, camera_body_radius_mm=50.0
)
BARS = (
    Body(name="light bar", on="light", from_mm=(0, 150, 0), to_mm=(0, 150, 420), radius_mm=20.0),
    Body(name="camera bar", on="camera", from_mm=(0, -150, 0), to_mm=(0, -150, 470), radius_mm=20.0),
    Body(name="light bracket", on="light", from_mm=(0, 150, 400), to_mm=(0, 0, 400), radius_mm=15.0),
    Body(name="camera bracket", on="camera", centre_mm=(0, -75, 460), size_mm=(30, 150, 20)),
    Body(name="plate", on="spin", centre_mm=(0, 0, -6), size_mm=(120, 60, 10)),
    Body(name="lamp post", on="bench", centre_mm=(300, 0, 250), size_mm=(40, 40, 60)),
)
RIG = describe(
    geometry=HEADS, arms=Arms(light=AXIS, camera=AXIS), holder=Holder(axes=("tilt", "spin")), bodies=BARS[:5]
)


def deg(light: float, camera: float, tilt: float = 0.0, spin: float = 0.0) -> Pose:
    return Pose(math.radians(light), math.radians(camera), math.radians(tilt), math.radians(spin))


def sampled(rng: np.random.Generator, start: Pose, goal: Pose) -> list[Pose]:
    """A move whose axes go each at a speed of its own, and arrive from a degree below where the limits leave room."""
    names = ("light", "camera", "tilt", "spin")
    stations = []
    for name in names:
        a, b = getattr(start, name), getattr(goal, name)
        before = max(b - math.radians(1), min(b, math.radians(RIG.limits_deg()[name][0])))
        length, speed = abs(before - a) + abs(b - before), rng.uniform(0.2, 3.0)
        stations.append((np.array([0.0, abs(before - a), length]) / speed, np.array([a, before, b])))
    grid = np.linspace(0, max(times[-1] for times, _ in stations), 40)
    return [
        Pose(*values) for values in zip(*[np.interp(grid, times, places) for times, places in stations], strict=True)
    ]


def test_no_way_that_is_found_touches_whatever_the_speeds_of_the_axes() -> None:
    rng = np.random.default_rng(2)
    at, found, split = Pose(*motion_planning._space_of(RIG).rest), 0, 0
    while found < 5:
        goal = Pose(*np.radians([*rng.uniform(-80, 80, 2), rng.uniform(-50, 50), rng.uniform(-180, 180)]).tolist())
        try:
            legs = motion_planning.route(RIG, at, goal)
        except Blocked:
            continue
        found, split = found + 1, split + (len(legs) > 1)
        assert legs[-1] == goal
        for leg in legs:
            assert not any(motion_planning.touching(RIG, pose) for pose in sampled(rng, at, leg))
            at = leg
    assert split > 0


def test_one_arm_goes_first_where_both_together_could_meet() -> None:
    start, goal = deg(-60, -20), deg(10, 50)
    assert motion_planning.route(RIG, start, goal) == [deg(-60, 50), deg(10, 50)]
    assert motion_planning.route(RIG.model_copy(update={"bodies": ()}), start, goal) == [goal]


def test_arms_in_one_plane_cannot_pass_each_other() -> None:
    with pytest.raises(
        Blocked, match=r"the way from light -89, camera 89, .* would touch: source head and camera head"
    ):
        motion_planning.route(RIG, deg(-89, 89), deg(30, -30))


def test_an_approach_from_above_is_part_of_the_way() -> None:
    """The balls meet 10.9 deg apart: at 18 deg there is room for an approach of 1 deg, and not for one of 10."""
    for approach in (-1.0, -10.0):
        light = AXIS.model_copy(update={"approach_deg": approach})
        rig = RIG.model_copy(update={"arms": Arms(light=light, camera=AXIS), "bodies": BARS[:1]})
        if approach == -1.0:
            assert motion_planning.route(rig, deg(-60, 0), deg(-18, 0)) == [deg(-18, 0)]
        else:
            with pytest.raises(Blocked, match="would touch: source head and camera head, near light -1"):
                motion_planning.route(rig, deg(-60, 0), deg(-18, 0))


def test_an_axis_that_stays_where_it_is_approaches_that_place_once_more() -> None:
    """`ArmsDevice.move` sends every axis to its goal from its side, the light from above too: it would swing to -8 deg
    while the camera comes back to 0, 10.9 deg apart being too close."""
    light = AXIS.model_copy(update={"approach_deg": -10.0})
    rig = RIG.model_copy(update={"arms": Arms(light=light, camera=AXIS), "bodies": BARS[:1]})
    with pytest.raises(Blocked, match="source head and camera head"):
        motion_planning.route(rig, deg(-18, 60), deg(-18, 0))


def test_directions_are_reached_by_the_branch_that_has_a_free_way() -> None:
    mirror = Directions.from_degrees(30, 0, 45, 180)
    without = reach(RIG.model_copy(update={"bodies": ()}), mirror)
    assert (without.light, without.camera) == pytest.approx((math.radians(30), math.radians(-45)))
    pose = reach(RIG, mirror)
    assert (pose.light, pose.camera) == pytest.approx((math.radians(-30), math.radians(45)))
    assert abs(pose.spin) == pytest.approx(math.pi)


def test_directions_without_a_free_way_are_blocked_and_say_by_what() -> None:
    rig = RIG.model_copy(update={"bodies": BARS, "holder": Holder(axes=("tilt",))})
    with pytest.raises(
        Unreachable, match=r"blocked: the way from .* would touch: source head and camera head"
    ) as caught:
        reach(rig, Directions.from_degrees(30, 0, 45, 180))
    assert caught.value.flag == "blocked"
    assert caught.value.cause == "the way there would touch: source head and camera head"


def test_the_branch_that_a_limit_closes_is_told_beside_the_one_that_bodies_close() -> None:
    """Else nobody sees that half a degree more of the spin would do."""
    holder = Holder(axes=("tilt", "spin"), spin_limits_deg=(-170.0, 170.0))
    with pytest.raises(Unreachable) as caught:
        reach(RIG.model_copy(update={"holder": holder}), Directions.from_degrees(30, 0, 45, 180))
    assert caught.value.flag == "blocked"
    assert caught.value.cause == (
        "the way there would touch: source head and camera head; or outside the limits -170 to 170 deg of the spin of "
        "the sample"
    )


def test_a_place_to_park_needs_ways_there_and_back() -> None:
    rig = RIG.model_copy(update={"bodies": BARS})
    motion_planning.require_parking(rig, {"light": -70.0}, "axes.{}.park_deg")
    motion_planning.require_parking(
        rig.model_copy(update={"bodies": ()}), {"light": 70.0, "camera": 69.0}, "axes.{}.park_deg"
    )
    with pytest.raises(ConfigError, match=r"^axes.light.park_deg = 70, axes.camera.park_deg = 20: .* camera head"):
        motion_planning.require_parking(rig, {"light": 70.0, "camera": 20.0}, "axes.{}.park_deg")


def test_a_box_is_as_large_as_it_is() -> None:
    """A cube of 200 mm, and a ball whose surface comes within 1 mm of its face, its edge and its corner."""
    cube = Body(name="cube", on="bench", centre_mm=(0, 0, 0), size_mm=(200, 200, 200))
    for toward in ((0, 0, 1), (0, 1, 1), (1, 1, 1)):
        for beyond in (-1.0, 1.0):
            middle = np.array(toward) * 100.0 + (30.0 + beyond) * np.array(toward) / np.linalg.norm(toward)
            place = (float(middle[0]), float(middle[1]), float(middle[2]))
            rig = describe(
                geometry=HEADS, bodies=(cube, Body(name="ball", on="light", from_mm=place, to_mm=place, radius_mm=30.0))
            )
            found = motion_planning.clearances(rig, [Pose()])[0]["cube", "ball"]
            assert found == pytest.approx(beyond, abs=1e-9)  # rounding of distances of 100 mm


def test_what_is_planned_is_found_again_from_where_the_axes_landed() -> None:
    """In any order, and with every axis up to 0.2 deg beside its goal."""
    rng = np.random.default_rng(3)
    poses: list[Pose] = []
    while len(poses) < 4:
        pose = Pose(*np.radians([*rng.uniform(-80, 80, 2), rng.uniform(-40, 40), rng.uniform(-180, 180)]).tolist())
        try:
            motion_planning.require_free(RIG, pose)
        except Blocked:
            continue
        poses.append(pose)
    for start, goal in itertools.permutations(poses, 2):
        landed = Pose(
            *(getattr(start, n) + rng.uniform(-1, 1) * motion_planning.LANDING for n in ("light", "camera", "tilt"))
        )
        assert motion_planning.route(RIG, replace(landed, spin=start.spin), goal)[-1] == goal


def test_a_body_in_the_light_or_in_the_sight_blocks_a_point() -> None:
    """A screen 60 mm beside the middle hides the lamp at 45 deg, and nothing else at the same poses."""
    lit = describe(geometry=HEADS, holder=Holder(axes=("tilt", "spin")), lamp=Lamp(half_angle_deg=0.5))
    screen = Body(name="screen", on="bench", from_mm=(200, -30, 200), to_mm=(200, 30, 200), radius_mm=10.0)
    rig = lit.model_copy(update={"bodies": (screen,)})
    with pytest.raises(Blocked, match="screen stands in the way of the light"):
        motion_planning.require_free(rig, deg(45, -30))
    with pytest.raises(Blocked, match="screen stands in the way of the camera's sight"):
        motion_planning.require_free(rig, deg(-30, 45))
    motion_planning.require_free(rig, deg(35, 60))
    own = rig.model_copy(update={"bodies": (screen.model_copy(update={"on": "light"}),)})
    motion_planning.require_free(own, deg(45, 60))
    # flush with the sample's surface, and a holder that the sample lies in: neither takes the light at a low angle
    for top in (0.0, 3.0):
        plate = Body(name="plate", on="spin", centre_mm=(0, 0, top - 5), size_mm=(100, 100, 10))
        motion_planning.require_free(lit.model_copy(update={"bodies": (plate,)}), deg(-80, 70))
    raised = Body(name="clamp", on="spin", centre_mm=(-30, 0, 0), size_mm=(10, 40, 40))
    with pytest.raises(Blocked, match="clamp stands in the way of the light"):
        motion_planning.require_free(lit.model_copy(update={"bodies": (raised,)}), deg(-80, 70))


@pytest.mark.slow
def test_a_cable_is_not_torn_and_nothing_runs_into_it() -> None:
    """From 300 mm over the crossing of the axes to the lamp: at 89 deg the ends are 500 mm apart."""
    lead = Cable(name="lead", from_on="bench", from_mm=(0, 0, 300), to_on="light", to_mm=(0, 0, 400), length_mm=520)
    rig = describe(geometry=HEADS, arms=Arms(light=AXIS, camera=AXIS), cables=(lead,))
    apart = math.sqrt(300**2 + 400**2 - 2 * 300 * 400 * math.cos(math.radians(70)))
    found = motion_planning.clearances(rig, [deg(70, -70)])[0]["lead, bench end", "lead, light end"]
    assert found == pytest.approx(520 - apart, abs=1e-9)  # the law of cosines
    motion_planning.require_free(rig, deg(-70, 70))
    short = rig.model_copy(update={"cables": (lead.model_copy(update={"length_mm": 400}),)})
    with pytest.raises(Blocked, match=r"the cable lead is 95\.8 mm too short"):
        motion_planning.require_free(short, deg(-89, 70))
    with pytest.raises(Blocked, match="would tear the cable lead, near light -"):
        motion_planning.route(short, deg(0, 70), deg(-89, 70))
    # the camera at -10 deg, the lamp at -60: the camera's head is 150 mm and more off the straight line; a cable that
    # hangs by 200 mm may lie there
    hanging = rig.model_copy(update={"cables": (lead.model_copy(update={"sag_mm": 200}),)})
    with pytest.raises(Blocked, match="camera head and lead"):
        motion_planning.require_free(hanging, deg(-60, -10))


def test_bodies_ride_on_the_axes_as_they_stand() -> None:
    """An arm whose axis is off by 20 mm carries its bar with it."""
    bar = Body(name="bar", on="light", from_mm=(0, 0, 400), to_mm=(0, 0, 400), radius_mm=10.0)
    post = Body(name="post", on="bench", from_mm=(0, 0, 450), to_mm=(0, 0, 450), radius_mm=10.0)
    for offset in (0.0, 20.0):
        light = AXIS.model_copy(update={"axis_offset_mm": (0.0, offset), "harmonics_deg": ((1, 2.0, 0.0),)})
        rig = describe(geometry=HEADS, arms=Arms(light=light, camera=AXIS), bodies=(bar, post))
        # at a reading of 0 the encoder reads 2 deg too much
        at = np.array([400 * math.sin(math.radians(-2)), offset + 400 * math.cos(math.radians(2))])
        expected = math.hypot(at[0], 450 - at[1]) - 20.0
        assert motion_planning.clearances(rig, [Pose()])[0]["bar", "post"] == pytest.approx(expected, abs=1e-9)


def test_the_simulated_bench_tells_collisions_and_a_rig_that_looks_ahead_has_none() -> None:
    import tomllib

    base = parse(RigDescription, tomllib.loads(SIM_IDEAL.toml), "sim-ideal")
    described = base.model_copy(update={"bodies": BARS[:5], "geometry": HEADS})
    with SIM_IDEAL.open(described, sample=None, seed=0, confirm=False) as rig:
        rig.begin(Step(0, "dark"))
        rig.arms.move(deg(30, -30))
        assert ("source head", "camera head") in rig.world.touched
        rig.world.touched.clear()
        rig.begin(Step(1, "dark"))
        for theta_r in (-60, 45):
            goal = reach(described, Directions.from_degrees(30, 0, abs(theta_r), 180 if theta_r > 0 else 0))
            for leg in motion_planning.route(described, rig.arms.read(), replace(goal)):
                rig.arms.move(leg)
        assert rig.world.touched == []
    assert rig.world.touched == []


@pytest.mark.parametrize("pose", [Pose(light=0.7, camera=-0.4), Pose(light=-0.3, camera=0.9, tilt=0.3, spin=-1.2)])
def test_light_goes_from_a_disc_of_the_lamp_s_size_to_the_patch_and_on_to_one_of_the_lens_s(pose: Pose) -> None:
    crooked = ArmAxis(axis_tilt_deg=(5.0, -4.0), elevation_deg=8.0)
    description = describe(
        arms=Arms(light=crooked, camera=crooked),
        lamp=Lamp(half_angle_deg=2.0),
        camera=Camera(lens_half_angle_deg=1.0),
        acquisition=Acquisition(roi_radius_mm=3.0),
    )
    g, view = description.geometry, kinematics.view(description, pose)
    ends = []
    for hull, distance, half_angle_deg in (
        (motion_planning.beams(description, pose)[0], g.light_distance_mm, 2.0),
        (motion_planning.beams(description, pose)[1], g.camera_distance_mm, 1.0),
    ):
        patch, disc = np.split(hull, 2)
        middle, end = patch.mean(axis=0), disc.mean(axis=0)
        around = 1.0 / math.cos(math.pi / motion_planning.RIM)  # a polygon that holds the disc
        assert np.linalg.norm(patch - middle, axis=1) == pytest.approx(3.0 * around)
        radius = distance * math.tan(math.radians(half_angle_deg))
        assert np.linalg.norm(disc - end, axis=1) == pytest.approx(radius * around)
        # the patch is lifted by less than a tenth of a millimetre off the surface
        assert np.linalg.norm(end - middle) == pytest.approx(distance, abs=0.1)
        assert (disc - end) @ (end - middle) == pytest.approx(0.0, abs=0.1 * radius)
        ends.append(end - middle)
    # as the rig's own kinematics has them, in the frame of the sample
    assert ends[0] @ ends[1] == pytest.approx(float(np.asarray(view.source_mm) @ np.asarray(view.camera_mm)), rel=1e-3)


def test_an_axis_stands_beyond_no_bound_that_its_encoder_s_errors_are_said_to_have() -> None:
    """Errors so large that angle and reading do not grow together: the bound holds for every reading below it."""
    for rows in (((1, 5.0, 3.0),), ((2, 40.0, 10.0), (3, 15.0, 0.0))):
        space = motion_planning._space_of(describe(arms=Arms(light=ArmAxis(harmonics_deg=rows))))
        axis = kinematics.AXES.index("light")
        read = np.radians(np.linspace(-90.0, 90.0, 181))
        true = np.array([space.true(axis, float(at)) for at in read])
        at = float(read[100])
        expected = at - sum(math.radians(c) * math.cos(k * at) + math.radians(s) * math.sin(k * at) for k, c, s in rows)
        assert space.true(axis, at) == pytest.approx(expected)
        assert true[:101].max() <= space.true(axis, at, 1.0) + 1e-12
        assert true[100:].min() >= space.true(axis, at, -1.0) - 1e-12
