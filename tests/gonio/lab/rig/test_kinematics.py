"""Poses and directions of rigs with different axes: an independent rotation-matrix oracle, and the inverse."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from gonio import geometry
from gonio.errors import ConfigError
from gonio.geometry import Directions
from gonio.lab.rig import Pose
from gonio.lab.rig.description import ArmAxis, Arms, Geometry, Holder
from gonio.lab.rig.inverse_kinematics import Unreachable, branches, reach
from gonio.lab.rig.kinematics import blocked_cone, directions, left_its_side, separation
from tests.gonio.numpy_rig import describe

DEG = math.pi / 180
ROUND_TRIP = 5e-12 * DEG
FREE = ArmAxis(limits_deg=(-180, 180))
NO_BODIES = Geometry(light_body_radius_mm=0, camera_body_radius_mm=0, camera_distance_mm=700)
FULL = describe(
    geometry=NO_BODIES,
    arms=Arms(light=FREE, camera=FREE),
    holder=Holder(axes=("tilt", "spin"), tilt_limits_deg=(-90, 90)),
)
AZIMUTH = describe(geometry=NO_BODIES, arms=Arms(light=FREE, camera=FREE, azimuth=FREE), holder=Holder(axes=("spin",)))
STILL = describe(geometry=NO_BODIES, arms=Arms(light=FREE, camera=FREE, azimuth=FREE), holder=Holder())
FLAT = describe(geometry=NO_BODIES, holder=Holder())

thetas = st.floats(0, math.pi / 2)
phis = st.floats(0, 2 * math.pi, exclude_max=True)
near = st.floats(-1e-3, 1e-3)


def apart(a: Directions, b: Directions) -> float:
    """The larger of the two angles between the sources and between the detectors."""
    pairs = [((a.theta_i, a.phi_i), (b.theta_i, b.phi_i)), ((a.theta_r, a.phi_r), (b.theta_r, b.phi_r))]
    return max(math.dist(geometry.direction(*one), geometry.direction(*two)) for one, two in pairs)


@pytest.mark.parametrize("rig", [FULL, AZIMUTH], ids=["tilt and spin", "azimuth and spin"])
@settings(max_examples=50, deadline=None)
@given(thetas, phis, thetas, phis)
@example(0.0, 0.0, 0.0, 0.0)
@example(0.0, 1.0, 0.0, 3.0)
@example(math.pi / 2, 0.3, math.pi / 2, 1.3)
@example(math.pi / 2, 0.0, math.pi / 2, math.pi)
@example(0.5, 0.2, 0.5, 0.2)
@example(0.5, 0.2, 0.5, 0.2 + math.pi)
@example(0.0, 0.0, 0.7, 2.0)
@example(0.7, 2.0, 0.0, 0.0)
def test_round_trip(rig: object, theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> None:
    asked = Directions(theta_i, phi_i, theta_r, phi_r)
    assert apart(asked, directions(rig, reach(rig, asked))) <= ROUND_TRIP  # type: ignore[arg-type]


@pytest.mark.parametrize("rig", [FULL, AZIMUTH], ids=["tilt and spin", "azimuth and spin"])
@settings(max_examples=50, deadline=None)
@given(st.floats(0.01, math.pi / 2 - 0.01), phis, near, near, st.integers(0, 14))
def test_round_trip_next_to_retro(
    rig: object, theta: float, phi: float, d_theta: float, d_phi: float, power: int
) -> None:
    scale = 10.0**-power
    asked = Directions(theta, phi, theta + d_theta * scale, phi + d_phi * scale)
    assert apart(asked, directions(rig, reach(rig, asked))) <= ROUND_TRIP  # type: ignore[arg-type]


@settings(max_examples=50, deadline=None)
@given(thetas, phis, thetas, st.floats(-math.pi, math.pi))
@example(0.0, 0.0, 1e-9, 1.0)
def test_a_still_sample_is_seen_from_all_around(theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> None:
    asked = Directions(theta_i, math.pi * (phi_i > math.pi), theta_r, phi_r)
    pose = reach(STILL, asked)
    assert pose.spin == pose.tilt == 0
    assert apart(asked, directions(STILL, pose)) <= ROUND_TRIP


@settings(max_examples=50, deadline=None)
@given(st.floats(-89, 89), st.floats(-89, 89))
def test_arms_alone_scan_the_plane_of_incidence(light_deg: float, camera_deg: float) -> None:
    pose = reach(FLAT, directions(FLAT, Pose(light=light_deg * DEG, camera=camera_deg * DEG)))
    assert pose.spin == pose.tilt == pose.azimuth == 0
    assert abs(pose.light - light_deg * DEG) <= ROUND_TRIP
    assert abs(pose.camera - camera_deg * DEG) <= ROUND_TRIP


@pytest.mark.parametrize(
    ("rig", "asked", "word"),
    [
        (FLAT, Directions(0.5, 0, 0.5, 2.0), "out of the plane"),
        (FLAT, Directions(0.5, 1.0, 0.5, 1.0 + math.pi), "phi_i"),
        (FLAT, Directions(0.0, 0.0, 0.5, 1.0), "phi_r"),
        (STILL, Directions(0.5, 1.0, 0.5, 1.0 + math.pi), "phi_i"),
        (describe(geometry=NO_BODIES, holder=Holder(axes=("spin",))), Directions(0.5, 0, 0.5, 2.0), "out of the plane"),
        (describe(holder=Holder(axes=("tilt",))), Directions(0.5, 1.0, 0.5, 1.0 + math.pi), "tilt_deg of a sweep"),
    ],
    ids=["out of plane", "light's azimuth", "azimuth at normal incidence", "still sample", "spin alone", "tilt alone"],
)
def test_a_missing_axis_is_named(rig: object, asked: Directions, word: str) -> None:
    with pytest.raises(Unreachable, match=word) as caught:
        reach(rig, asked)  # type: ignore[arg-type]
    assert caught.value.flag == "unreachable"
    assert isinstance(caught.value, ConfigError)


def test_limits_choose_the_branch() -> None:
    one_sided = describe(geometry=NO_BODIES, arms=Arms(light=ArmAxis(limits_deg=(-90, 0)), camera=FREE))
    asked = Directions(30 * DEG, 0, 20 * DEG, math.pi)
    assert reach(FULL, asked).light > 0
    pose = reach(one_sided, asked)
    assert pose.light < 0
    assert abs(abs(pose.spin) - math.pi) < 1e-12  # half a turn of the sample, up to rounding
    assert apart(asked, directions(one_sided, pose)) <= ROUND_TRIP


def test_a_goal_beyond_every_limit_names_axis_and_limits() -> None:
    narrow = describe(geometry=NO_BODIES, arms=Arms(light=ArmAxis(limits_deg=(-40, 40))))
    with pytest.raises(Unreachable, match=r"60\.00 deg is outside the limits -40 to 40 deg of the light arm"):
        reach(narrow, Directions(60 * DEG, 0, 20 * DEG, math.pi))


@pytest.mark.parametrize("theta_deg", [90.0, -90.0])
def test_grazing_at_a_limit_of_ninety_degrees_is_inside(theta_deg: float) -> None:
    flat = describe(geometry=NO_BODIES, holder=Holder(), arms=Arms())
    pose = reach(flat, Directions(abs(theta_deg) * DEG, math.pi * (theta_deg < 0), 0.2, 0.0))
    assert math.degrees(pose.light) == theta_deg


def test_blocked_cone_of_two_bodies_at_300_mm() -> None:
    rig = describe(
        geometry=Geometry(
            light_distance_mm=300, camera_distance_mm=300, light_body_radius_mm=25, camera_body_radius_mm=30
        )
    )
    # two balls touch where the chord between their centres is 55 mm: 2 asin(55/600) = 10.52 deg
    assert math.degrees(blocked_cone(rig)) == pytest.approx(10.5, abs=0.05)
    blocked, flags = [], set()
    for signed in range(-80, 85, 5):  # 33 points in plane at theta_i = 30 deg
        asked = Directions(30 * DEG, 0, abs(signed) * DEG, math.pi * (signed > 0))
        try:
            reach(rig, asked)
        except Unreachable as error:
            flags.add(error.flag)
            blocked.append(signed)
    assert flags == {"blocked"}
    assert blocked == [-40, -35, -30, -25, -20]


@settings(max_examples=50, deadline=None)
@given(thetas, phis, thetas, phis)
def test_separation_agrees_with_the_law_of_cosines(theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> None:
    d = Directions(theta_i, phi_i, theta_r, phi_r)
    cosine = math.cos(theta_i) * math.cos(theta_r) + math.sin(theta_i) * math.sin(theta_r) * math.cos(phi_r - phi_i)
    assume(abs(cosine) < 0.99)  # where the arc cosine itself is accurate
    assert separation(d.floats) == pytest.approx(math.acos(cosine), abs=1e-14)


def test_a_source_below_the_surface_is_refused() -> None:
    with pytest.raises(Unreachable, match="theta_i") as caught:
        reach(FULL, Directions(1.6, 0, 0.1, 0))
    assert caught.value.flag == "below_horizon"


def test_an_arm_that_stops_at_the_horizon_does_not_reach_behind() -> None:
    stops = describe(arms=Arms(camera=ArmAxis(limits_deg=(-89.0, 89.0))))
    with pytest.raises(Unreachable, match="camera arm") as caught:
        reach(stops, Directions.from_degrees(30.0, 0.0, 150.0, 180.0))
    assert caught.value.flag == "unreachable"


BEHIND = describe(
    arms=Arms(camera=ArmAxis(limits_deg=(-180.0, 180.0))),
    holder=Holder(axes=("tilt", "spin"), tilt_limits_deg=(-90, 90), spin_limits_deg=(-180, 180)),
)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.02, 1.5), phis, st.floats(1.62, 3.12), phis)
def test_a_camera_behind_the_sample_sees_from_where_it_was_asked(
    theta_i: float, phi_i: float, theta_r: float, phi_r: float
) -> None:
    asked = Directions(theta_i, phi_i, theta_r, phi_r)
    np.testing.assert_allclose(
        directions(BEHIND, reach(BEHIND, asked)).vectors, asked.vectors, atol=1e-12
    )  # rounding of a few turns


def test_a_camera_on_the_other_side_than_asked_is_noticed() -> None:
    before, behind = Pose(light=0.1, camera=1.5), Pose(light=0.1, camera=1.6)
    assert left_its_side(BEHIND, before, behind)
    assert left_its_side(BEHIND, behind, before)
    assert not left_its_side(BEHIND, behind, behind)
    assert left_its_side(BEHIND, before, Pose(light=1.6, camera=1.5))


def test_a_spin_wider_than_a_turn_winds_its_cable_no_further_than_its_limits() -> None:
    """Off-centre and wide limits: every direction has a winding inside, and the one nearest to 0 is taken."""
    for limits in ((-10.0, 355.0), (200.0, 620.0), (-400.0, 400.0)):
        rig = describe(
            geometry=NO_BODIES,
            arms=Arms(light=FREE, camera=FREE),
            holder=Holder(axes=("tilt", "spin"), tilt_limits_deg=(-90, 90), spin_limits_deg=limits),
        )
        for phi in range(0, 360, 30):
            asked = Directions(0.5, phi * DEG, 0.7, (phi + 100) * DEG)
            pose = reach(rig, asked)
            windings = [p.spin for _, p in branches(rig, asked) if isinstance(p, Pose)]
            assert limits[0] <= math.degrees(pose.spin) <= limits[1]
            assert abs(pose.spin) == pytest.approx(min(map(abs, windings)))
            assert len(windings) >= (2 if limits[1] - limits[0] > 360 else 1)
            turns = [(one - pose.spin) / math.tau for one in windings]
            for whole in (k for k in turns if abs(k - round(k)) < 1e-9):
                assert apart(directions(rig, replace(pose, spin=pose.spin + whole * math.tau)), asked) < 1e-9
            assert apart(directions(rig, pose), asked) < 1e-9


def test_goals_whose_play_a_limit_leaves_open_are_refused() -> None:
    """At a limit an axis cannot arrive from the side of the limit: within the backlash its angle would be wrong."""
    stops = ArmAxis(limits_deg=(-80.0, 80.0), backlash_deg=0.5)
    rig = describe(geometry=NO_BODIES, arms=Arms(light=stops, camera=stops), holder=Holder())
    assert reach(rig, Directions(0.1, 0.0, 80 * DEG, 0.0)).camera == pytest.approx(80 * DEG)
    assert reach(rig, Directions(0.1, 0.0, 79.4 * DEG, math.pi)).camera == pytest.approx(-79.4 * DEG)
    with pytest.raises(
        Unreachable, match=r"closer to the lower limit of the camera arm than its backlash of 0\.5 deg"
    ) as e:
        reach(rig, Directions(0.1, 0.0, 79.8 * DEG, math.pi))
    assert e.value.flag == "unreachable"
    above = rig.model_copy(update={"arms": Arms(light=stops, camera=stops.model_copy(update={"approach_deg": -1.0}))})
    assert reach(above, Directions(0.1, 0.0, 79.8 * DEG, math.pi)).camera == pytest.approx(-79.8 * DEG)
    with pytest.raises(Unreachable, match="closer to the upper limit"):
        reach(above, Directions(0.1, 0.0, 79.8 * DEG, 0.0))
