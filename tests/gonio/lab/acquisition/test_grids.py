"""Grids of a plan: half vectors against rotations in thirty digits, caps against the solid angle of their parts."""

import math
from collections import Counter
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from gonio.errors import ConfigError
from gonio.geometry import direction
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.acquisition.plan import Plan, assess
from gonio.lab.acquisition.plan_tables import HalfVector, Hemisphere, Spaced, even_cap
from tests.gonio.numpy_rig import plan_in

HEAD = 'name = "p"\nwavelength_nm = [550]\n'
RIGHT = 1e-9
"""Directions of a grid are right within this [rad]: a millionth of an encoder's step."""


def plan(tmp_path: Path, text: str) -> Plan:
    return plan_in(tmp_path, HEAD + text)


def vector(theta_deg: float, phi_deg: float) -> mpmath.matrix:
    theta, phi = mpmath.radians(mpmath.mpf(theta_deg)), mpmath.radians(mpmath.mpf(phi_deg))
    return mpmath.matrix([mpmath.sin(theta) * mpmath.cos(phi), mpmath.sin(theta) * mpmath.sin(phi), mpmath.cos(theta)])


def half_turned(about: mpmath.matrix, what: mpmath.matrix) -> mpmath.matrix:
    """`what` after half a turn about a unit vector, by Rodrigues' rotation matrix."""
    x, y, z = about
    cross = mpmath.matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (mpmath.eye(3) + mpmath.sin(mpmath.pi) * cross + 2 * cross * cross) * what


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 89), st.floats(0, 89), st.floats(-360, 360), st.sampled_from(["reflection", "transmission"]))
def test_a_half_vector_becomes_the_direction_that_has_it(
    theta_i: float, theta_h: float, phi_h: float, side: str
) -> None:
    grid = HalfVector(theta_i_deg=[theta_i], theta_h_deg=[theta_h], phi_h_deg=[phi_h], side=side)  # type: ignore[arg-type]
    with mpmath.workdps(30):
        light, half = vector(theta_i, 0.0), vector(theta_h, phi_h)
        wanted = half_turned(half, light)
        cosine = (light.T * half)[0]
        if abs(wanted[2]) < 1e-8 or abs(cosine) < 1e-8:
            return  # on the horizon a rounding decides
        found = list(grid.rows())
        assert grid.below == (0 if found else 1)
        assert bool(found) == (cosine > 0 and wanted[2] > 0)
        for i, phi_i, theta_r, phi_r in found:
            assert (i, phi_i) == (theta_i, 0.0)
            assert (theta_r > 90.0) == (side == "transmission")
            there = vector(180.0 - theta_r if side == "transmission" else theta_r, phi_r)
            assert mpmath.norm(there - wanted) < RIGHT
            # and back: the half vector of source and detector is the one that was asked for
            middle = light + there
            assert mpmath.norm(middle / mpmath.norm(middle) - half) < RIGHT


def test_the_mirror_direction_stands_once_for_each_incidence(tmp_path: Path) -> None:
    found = plan(
        tmp_path,
        "[[half_vector]]\ntheta_i_deg = [20, 60]\ntheta_h_deg = { stop = 40, count = 9, spacing = 'square' }\n"
        "phi_h_deg = { start = 0, stop = 330, step = 30 }\n",
    )
    mirror = [p for p in found.points if p.theta_i_deg == p.theta_r_deg and p.phi_r_deg == 180.0]
    assert [p.theta_i_deg for p in mirror] == [20, 60]
    assert found.repeated == 0
    assert len(found.points) + found.below_horizon == 2 * (8 * 12 + 1)
    assert found.below_horizon > 0
    assert all(p.theta_r_deg < 90.0 for p in found.points)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.01, 5), st.floats(1, 80), st.integers(3, 60))
def test_spacings_grow_away_from_the_start(start: float, way: float, count: int) -> None:
    stop = start + way
    square = np.diff(Spaced(start=start, stop=stop, count=count, spacing="square").values())
    assert square == pytest.approx(way * (2 * np.arange(count - 1) + 1) / (count - 1) ** 2, abs=1e-8)  # of 9 digits
    log = np.array(Spaced(start=start, stop=stop, count=count, spacing="log").values())
    assert log[1:] / log[:-1] == pytest.approx((stop / start) ** (1 / (count - 1)), rel=1e-6)  # of 9 digits of 0.01
    even = Spaced(start=start, stop=stop, count=count).values()
    assert even == pytest.approx(np.linspace(start, stop, count), abs=1e-8)
    assert (even[0], even[-1]) == (log[0], log[-1]) == (start, stop)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 3000), st.floats(1.0, 90.0))
def test_every_direction_of_a_hemisphere_has_the_same_solid_angle(count: int, cap_deg: float) -> None:
    theta, phi = even_cap(count, math.radians(cap_deg))
    assert len(theta) == count
    # Archimedes: the solid angle of a zone is 2 pi times its height, so middles lie in the middle of heights
    height = (1.0 - math.cos(math.radians(cap_deg))) / count
    done = 0
    for angle, number in sorted(Counter(np.round(theta, 12).tolist()).items()):
        if done or number > 1:
            assert 1.0 - math.cos(angle) == pytest.approx((done + number / 2) * height, abs=1e-11)  # of 12 digits
        else:
            assert angle == 0.0
        done += number
        azimuths = np.sort(phi[np.round(theta, 12) == angle])
        assert np.diff(azimuths) == pytest.approx(2 * math.pi / number, abs=1e-12)
        assert np.abs(azimuths - math.pi).min() <= 1e-12  # rounding of angles up to 2 pi


@pytest.mark.parametrize("count", [50, 200, 1000, 5000])
def test_neighbours_are_about_as_far_apart_everywhere(count: int) -> None:
    """Squares of one size have neighbours one side apart; 0.85 to 1.3 is what rings of whole numbers leave."""
    where = direction(*even_cap(count, math.pi / 2))
    nearest = cKDTree(where).query(where, k=2)[0][:, 1] / math.sqrt(2 * math.pi / count)
    assert nearest.min() > 0.85
    assert nearest.max() < 1.3
    integral = 2.0 * math.pi * where[:, 2].mean()
    assert integral == pytest.approx(math.pi, rel=2.0 / count)  # of cos over the hemisphere, each point a share


def test_a_hemisphere_has_both_sides_and_both_ways_to_say_how_dense(tmp_path: Path) -> None:
    by_count = plan(tmp_path, "[[hemisphere]]\ntheta_i_deg = [0, 45]\ncount = 206\n")
    by_step = plan(tmp_path, "[[hemisphere]]\ntheta_i_deg = [0, 45]\nstep_deg = 10.0\n")
    assert by_count.points == by_step.points  # 2 pi / (10 deg)^2 = 206.3
    assert len(by_count.points) == 412
    there = {(round(p.theta_r_deg, 6), round(p.phi_r_deg, 6)) for p in by_count.points[:206]}
    mirrored = {(theta, round((360.0 - phi) % 360.0, 6)) for theta, phi in there if theta}
    assert {one for one in there if one[0]} == mirrored
    assert (0.0, 180.0) in there
    behind = plan(tmp_path, "[[hemisphere]]\ntheta_i_deg = [45]\ncount = 50\nside = 'transmission'\n")
    assert all(90.0 < p.theta_r_deg <= 180.0 for p in behind.points)


def test_grids_of_a_cap_stay_in_it() -> None:
    rows = list(Hemisphere(theta_i_deg=[10.0], count=300, theta_r_max_deg=70.0).rows())  # type: ignore[arg-type]
    assert len(rows) == 300
    assert 65.0 < max(r for _, _, r, _ in rows) < 70.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[[hemisphere]]\ntheta_i_deg = [45]\n", ["hemisphere[1]", "count", "step_deg", "neither"]),
        ("[[hemisphere]]\ntheta_i_deg = [45]\ncount = 9\nstep_deg = 5\n", ["hemisphere[1]", "both"]),
        ("[[hemisphere]]\ntheta_i_deg = [45]\ncount = 0\n", ["hemisphere[1].count = 0", "1"]),
        (
            "[[hemisphere]]\ntheta_i_deg = [45]\nstep_deg = -1\n",
            ["hemisphere[1].step_deg = -1", "equal to 0.01"],
        ),
        ("[[hemisphere]]\ntheta_i_deg = [145]\ncount = 9\n", ["hemisphere[1].theta_i_deg", "145", "0 to 90"]),
        ("[[hemisphere]]\ntheta_i_deg = [45]\ncount = 9\ntheta_r_max_deg = 95\n", ["theta_r_max_deg = 95", "90"]),
        ("[[hemisphere]]\ntheta_i_deg = [45]\nstep_deg = 0.05\n", ["8250592 points", "1000000"]),
        ("[[hemisphere]]\ntheta_i_deg = [45]\nstep_deg = 1e-300\n", ["step_deg = 1e-300", "0.01"]),
        ("[hemisphere]\ntheta_i_deg = [45]\ncount = 9\n", ["hemisphere", "[[hemisphere]]", "two brackets"]),
        ("[sweep]\ntheta_i_deg = [45]\ntheta_r_deg = [9]\n", ["sweep", "[[sweep]]", "two brackets"]),
        ("[[half_vector]]\ntheta_i_deg = [45]\n", ["half_vector[1].theta_h_deg", "missing"]),
        ("[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = [-5]\n", ["theta_h_deg", "-5", "phi_h_deg", "180"]),
        ("[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = [5]\nphi_h_deg = [400]\n", ["phi_h_deg", "400", "360"]),
        (
            "[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = { stop = 30, count = 9, spacing = 'log' }\n",
            ["theta_h_deg", "start above 0", "square"],
        ),
        (
            "[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = { stop = 30, count = 9, spacing = 'cubic' }\n",
            ["theta_h_deg", "spacing", "'square'"],
        ),
        (
            "[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = { stop = 30, step = 3, count = 9 }\n",
            ["theta_h_deg", "count"],
        ),
        (
            "[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = { start = 30, stop = 3, count = 9 }\n",
            ["theta_h_deg", "start < stop"],
        ),
        ("[[half_vector]]\ntheta_i_deg = [45]\ntheta_h_deg = [5]\nside = 'both'\n", ["side = 'both'", "transmission"]),
        ("[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = [5]\nrepeats = 0\n", ["sweep[1].repeats = 0", "1"]),
        (
            "[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = [5]\nrepeats = 1.5\n",
            ["sweep[1].repeats = 1.5", "whole number"],
        ),
        ("[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = [5]\nrepeats = true\n", ["sweep[1].repeats", "number"]),
        ("order = 'quick'\n[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = [5]\n", ["order = 'quick'", "short"]),
        ("reference_every = -1\n[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = [5]\n", ["reference_every = -1", "0"]),
    ],
)
def test_a_wrong_grid_names_file_key_and_remedy(tmp_path: Path, text: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        plan(tmp_path, text)
    for word in ["plan.toml", *words]:
        assert word in str(caught.value)


def test_a_grid_without_a_point_above_the_horizon_says_so(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"plan\.toml: .*no points.*1 half vectors.*below the horizon"):
        plan(tmp_path, "[[half_vector]]\ntheta_i_deg = [80]\ntheta_h_deg = [40]\nphi_h_deg = [180]\n")


def test_repeats_are_spread_over_the_run(tmp_path: Path) -> None:
    text = "[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = { start = 0, stop = 60, step = 1 }\nrepeats = 3\n"
    found = plan(tmp_path, text)
    once = plan(tmp_path, text.replace("repeats = 3\n", ""))
    assert (found.points, found.repeated) == (once.points * 3, 0)
    assert found.sha256 != once.sha256


def test_a_few_repeated_points_among_many_come_back_at_even_distances(tmp_path: Path) -> None:
    found = plan(
        tmp_path,
        "[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = { start = -80, stop = 79, step = 1 }\n"
        "[[sweep]]\ntheta_i_deg = [30]\ntheta_r_deg = [10, 20]\nrepeats = 8\n",
    )
    assert len(found.points) == 160 + 16
    for angle in (10, 20):
        at = [k for k, p in enumerate(found.points) if (p.theta_i_deg, p.theta_r_deg) == (30, angle)]
        assert len(at) == 8
        assert set(np.diff(at)) <= set(range(20, 25))  # 176 / 8 = 22, and two places where the two stand themselves
    single = [p for p in found.points if p.theta_i_deg == 45]
    assert [p.theta_r_deg if p.phi_r_deg else -p.theta_r_deg for p in single] == list(range(-80, 80))


def test_a_point_that_two_tables_name_is_visited_as_often_as_the_one_that_asks_for_more(tmp_path: Path) -> None:
    sweep = "[[sweep]]\ntheta_i_deg = [45]\ntheta_r_deg = [10, 20]\n"
    found = plan(tmp_path, sweep + sweep.replace("[10, 20]", "[20, 30]") + "repeats = 2\n")
    assert [p.theta_r_deg for p in found.points].count(20) == 2
    assert [p.theta_r_deg for p in found.points].count(10) == 1
    assert found.repeated == 1


def test_a_leaning_sample_sees_what_its_tilt_makes_of_the_arms(tmp_path: Path) -> None:
    """Arms and tilt of docs/conventions.md in mpmath; a rig with a tilt alone reaches every point."""
    text = "[[sweep]]\ntheta_i_deg = [0, 30, 70]\ntheta_r_deg = [-50, 20, 60]\ntilt_deg = [-25, 40]\n"
    points = plan(tmp_path, text).points
    asked = [(t, i, r) for t in (-25, 40) for i in (0, 30, 70) for r in (-50, 20, 60)]
    for point, (tilt, light, camera) in zip(points, asked, strict=True):
        t = mpmath.radians(tilt)
        axes = mpmath.matrix([[1, 0, 0], [0, mpmath.cos(t), -mpmath.sin(t)], [0, mpmath.sin(t), mpmath.cos(t)]])
        seen = ((point.theta_i_deg, point.phi_i_deg, light), (point.theta_r_deg, point.phi_r_deg, -camera))
        for theta, phi, arm in seen:
            a = mpmath.radians(arm)
            there = axes * mpmath.matrix([mpmath.sin(a), 0, mpmath.cos(a)])
            assert mpmath.norm(vector(theta, phi) - there) < RIGHT
    rig = find_rig("three-servos").description
    poses = [assessed.pose for assessed in assess(plan(tmp_path, text), rig)]
    assert [round(math.degrees(pose.tilt)) for pose in poses if pose is not None] == [t for t, _, _ in asked]
    with pytest.raises(ConfigError, match="tilt_deg goes with theta_i_deg and theta_r_deg alone"):
        plan(tmp_path, text + "dphi_deg = [90]\n")
