"""Angle effects against functions whose derivatives are known."""

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gonio.geometry import Directions, angles, direction
from gonio.lab.reduction import angle_errors
from gonio.lab.reduction.angle_sensitivity import BandCurves
from gonio.lab.reduction.spikes import OverlapFraction, blurred_overlap, over_patch, overlap
from gonio.lab.rig import kinematics
from gonio.lab.rig.description import ArmAxis, Arms
from gonio.lab.rig.inverse_kinematics import reach
from gonio.lab.rig.light_and_camera import Lamp
from tests.gonio.lab.reduction.made_run import describe

HALF = math.radians(0.5)
stack = Directions.stack
Function = Callable[[Directions], float]


def at(theta_i: float, theta_r: float, dphi: float = 180.0) -> Directions:
    """Degrees; a negative theta_r lies on the other side."""
    turn = dphi + (180.0 if theta_r < 0 else 0.0)
    return Directions(math.radians(theta_i), 0.0, math.radians(abs(theta_r)), math.radians(turn % 360))


def curves(function: Function, goals: list[Directions], half: float = HALF, noise: float = 1e-6) -> BandCurves:
    values = np.array([function(d) for d in goals], dtype=np.float64)
    return BandCurves(stack(goals), stack(goals), values, noise * abs(values) + 1e-12, (half, half), sharp(goals, half))


def sharp(goals: list[Directions], half: float = HALF) -> list[OverlapFraction]:
    """Shares of the lamp's mirror image for angles that are known exactly."""
    return [blurred_overlap(d, stack([]), (half, half)) for d in goals]


def moved(d: Directions, i: float = 0.0, r: float = 0.0) -> Directions:
    return Directions(d.theta_i + i, d.phi_i, d.theta_r + r, d.phi_r)


def test_overlap_of_caps_against_counting() -> None:
    """Directions spread evenly over the smaller cap, counted in the other."""
    rng = np.random.default_rng(2)
    for first, second in ((0.5, 0.5), (0.5, 0.2), (0.15, 1.0), (0.009, 0.009)):
        small, large = sorted((first, second))
        z, angle = 1 - (1 - math.cos(small)) * rng.uniform(0, 1, 400_000), rng.uniform(0, 2 * np.pi, 400_000)
        across = np.sqrt(1 - z**2)
        for offset in (
            0.0,
            0.2 * small,
            large - 0.3 * small,
            large + 0.4 * small,
            large + 0.95 * small,
            1.2 * (small + large),
        ):
            away = np.array([math.sin(offset), 0.0, math.cos(offset)])
            chord = np.hypot(np.hypot(across * np.cos(angle) - away[0], across * np.sin(angle)), z - away[2])
            # 4e5 draws: a standard deviation of at most 8e-4
            assert overlap(offset, first, second) == pytest.approx(np.mean(chord <= 2 * math.sin(large / 2)), abs=4e-3)


@pytest.mark.parametrize("theta", [0.0, 1e-9, 30.0, 75.0])
def test_mirror_offset(theta: float) -> None:
    assert at(theta, theta).mirror_offset == pytest.approx(0.0, abs=1e-15)
    assert at(theta, theta + 0.5).mirror_offset == pytest.approx(math.radians(0.5), rel=1e-9)
    assert at(90.0, 90.0, 0.0).mirror_offset == pytest.approx(math.pi, rel=1e-15)  # a rounding


GRID = [at(i, float(r)) for i in (20.0, 25.0, 30.0, 35.0, 40.0) for r in range(-70, 71, 5)]


@pytest.mark.slow
def test_a_matt_sample_feels_the_cosine_alone() -> None:
    model, u = curves(lambda d: 0.25, GRID), math.radians(0.05)
    for k, d in enumerate(GRID):
        odd, even = model.effects(k, d, moved(d, i=u), moved(d, i=-u))
        # (cos(t + u) - cos(t - u)) / (2 cos t) = -tan(t) sin(u), and cos(u) - 1
        assert odd == pytest.approx(-0.25 * math.tan(d.theta_i) * math.sin(u), rel=1e-9)
        assert even == pytest.approx(0.25 * (math.cos(u) - 1), abs=1e-12)
        assert model.effects(k, d, moved(d, r=u), moved(d, r=-u)) == pytest.approx((0.0, 0.0), abs=1e-12)


def lobe(d: Directions) -> float:
    signed = -d.theta_r * math.cos(d.phi_r - d.phi_i)
    return (1 + math.cos(d.theta_i)) * math.exp(-(((signed - 1.1 * d.theta_i) / 0.4) ** 2)) + 0.1


@pytest.mark.slow
def test_a_lobe_that_follows_the_mirror_direction() -> None:
    """Not symmetric, and changing with theta_i: both derivatives within the error of 5 degrees' differences."""
    model, u = curves(lobe, GRID), math.radians(0.02)
    for k, d in enumerate(GRID):
        if not 24 < math.degrees(d.theta_i) < 36 or math.degrees(d.theta_r) > 61:
            continue
        for move in ("i", "r"):
            plus, minus = moved(d, **{move: u}), moved(d, **{move: -u})
            true = (lobe(plus) * math.cos(plus.theta_i) - lobe(minus) * math.cos(minus.theta_i)) / 2
            odd, even = model.effects(k, d, plus, minus)
            # a central difference misses (5 deg / 0.4)^2 / 6 of f''', at most 5 times the largest slope (4.1 a radian):
            # 4 % of that slope, in theta_r and along the mirror direction alike
            assert odd == pytest.approx(true / math.cos(d.theta_i), abs=0.08 * 4.1 * u)
            assert abs(even) < 1e-6


@pytest.mark.parametrize(
    ("beam_mm", "how", "axis", "angle_deg"),
    # a beam wider than the region's 6 mm spreads with the light's cosine, a narrower one with the camera's
    [
        (6.0, "swap", "light", 40.0),
        (5.9, "swap", "camera", 25.0),
        (None, "swap", "camera", None),
        (6.0, "beam", "light", None),
    ],
)
def test_readings_and_zeros_of_the_axes_in_radians(
    beam_mm: float | None, how: str, axis: str, angle_deg: float | None
) -> None:
    arm = ArmAxis(limits_deg=(-89.0, 89.0), encoder_step_deg=0.088, encoder_noise_deg=0.01, zero_u_deg=0.02)
    description = describe(
        arms=Arms(light=arm, camera=arm),
        lamp=Lamp(beam_diameter_mm=beam_mm),
        reference={"how": how} | ({"attenuation": 0.1} if how == "beam" else {}),
    )
    zero, step = math.radians(0.02), math.radians(math.sqrt(0.088**2 / 12.0 + 0.01**2))
    assert angle_errors.zero_uncertainties(description) == pytest.approx({"light": zero, "camera": zero})
    assert angle_errors.encoder_steps(description) == pytest.approx({"light": step, "camera": step})
    visit, u = reach(description, at(40.0, 25.0)), 0.01
    seen: Any = SimpleNamespace(pose=visit, directions=kinematics.directions(description, visit))
    signed = 0.0 if angle_deg is None else math.tan(math.radians(angle_deg)) * math.sin(u)
    assert abs(angle_errors.change_of_cosine(description, seen, axis, u)) == pytest.approx(signed, rel=1e-9, abs=1e-15)


def test_the_normal_is_no_edge() -> None:
    """A step of theta_r through 0 leads to the other side of the curve."""
    model, u = curves(lobe, GRID), math.radians(0.05)
    k = next(k for k, d in enumerate(GRID) if d.theta_r == 0 and abs(d.theta_i - math.radians(30)) < 1e-9)
    plus = Directions(GRID[k].theta_i, 0.0, u, math.pi)
    minus = Directions(GRID[k].theta_i, 0.0, u, 0.0)
    odd, _ = model.effects(k, GRID[k], plus, minus)
    assert odd == pytest.approx((lobe(plus) - lobe(minus)) / 2, rel=0.1)  # differences over 5 degrees


def test_normal_incidence_has_no_preferred_plane() -> None:
    """The azimuth of a source 0.02 deg off the normal is arbitrary; the lobe's slope along theta_r is not."""
    goals = [at(0.0, float(r)) for r in range(-60, 61, 5)]
    read = [Directions(math.radians(0.02), math.pi * (k % 2), d.theta_r, d.phi_r) for k, d in enumerate(goals)]

    def value(d: Directions) -> float:
        return math.exp(-((d.theta_r / 0.5) ** 2))

    f = np.array([value(d) for d in goals])
    model, u = BandCurves(stack(goals), stack(read), f, 1e-6 * f, (HALF, HALF), sharp(read)), math.radians(0.02)
    for k in range(2, len(goals) - 2):
        if goals[k].theta_r == 0:
            continue
        odd, _ = model.effects(k, read[k], moved(read[k], r=u), moved(read[k], r=-u))
        slope = -2 * goals[k].theta_r / 0.25 * f[k]
        assert odd == pytest.approx(slope * u, rel=0.15)  # differences over 5 degrees


def test_a_source_that_leaves_the_normal_across_the_curve_does_not_come_nearer() -> None:
    """To first order nothing on a curve through the normal changes where a tilt turns the source out of its plane."""
    goals = [at(i, float(r)) for i in (0.0, 30.0, 60.0) for r in range(-75, 76, 5)]
    model, u = curves(lobe, goals), math.radians(0.02)
    for k, d in enumerate(goals[:31]):
        plus, minus = (Directions(u, turn, d.theta_r, d.phi_r) for turn in (math.pi / 2, 3 * math.pi / 2))
        # cos(u) - 1 = 6e-8 of the value is left
        assert model.effects(k, d, plus, minus) == pytest.approx((0.0, 0.0), abs=1e-7 * lobe(d))
        along = Directions(u, 0.0, d.theta_r, d.phi_r)
        if 0.0 < d.theta_r < 1.0:
            assert abs(model.effects(k, d, along, Directions(u, math.pi, d.theta_r, d.phi_r))[0]) > 1e-5 * lobe(d)


SPIKED = [at(i, float(r)) for i in (60.0, 75.0) for r in np.arange(-80, 85.1, 2.5)]


def spiked(d: Directions) -> float:
    share = float(overlap(d.mirror_offset, HALF, HALF))
    return lobe(d) + (40.0 * share if d.theta_i > 1.2 else 0.0)


@pytest.mark.slow
def test_a_spike_is_told_from_its_lobe_and_has_its_own_shape() -> None:
    model = curves(spiked, SPIKED)
    top = next(k for k, d in enumerate(SPIKED) if d.mirror_offset < 1e-9 and d.theta_i > 1.2)
    # the cubic through the lobe's neighbours misses its fourth derivative: (2.5 deg / 0.4)^4 * 12 / 6
    assert model.spike[top] == pytest.approx(40.0, abs=0.01)
    assert model.lobe[top] == pytest.approx(lobe(SPIKED[top]), abs=0.01)
    assert not model.spike[[k for k, d in enumerate(SPIKED) if d.theta_i < 1.2]].any()


@pytest.mark.parametrize("step_deg", [0.02, 0.1, 0.3])
def test_the_top_of_a_spike_falls_to_both_sides(step_deg: float) -> None:
    """A slope would say that nothing happens there."""
    model, u = curves(spiked, SPIKED), math.radians(step_deg)
    top = next(k for k, d in enumerate(SPIKED) if d.mirror_offset < 1e-9 and d.theta_i > 1.2)
    d = SPIKED[top]
    odd, even = model.effects(top, d, moved(d, r=u), moved(d, r=-u))
    fall = 40.0 * (float(overlap(u, HALF, HALF)) - 1)
    assert even == pytest.approx(fall, rel=0.01)
    assert abs(odd) < 0.02 * abs(fall)


def test_a_point_just_outside_of_a_spike_knows_its_edge() -> None:
    goals = sorted([*SPIKED, at(75.0, 76.02)], key=lambda d: (d.theta_i, -d.theta_r * math.cos(d.phi_r)))
    model, u = curves(spiked, goals), math.radians(0.2)
    k = next(k for k, d in enumerate(goals) if abs(math.degrees(d.theta_r) - 76.02) < 1e-9)
    d = goals[k]
    odd, even = model.effects(k, d, moved(d, r=u), moved(d, r=-u))
    rise = 40.0 * float(overlap(moved(d, r=-u).mirror_offset, HALF, HALF))
    assert rise > 1.0
    assert (even, odd) == pytest.approx((rise / 2, -rise / 2), rel=0.05)


@pytest.mark.slow
def test_a_smooth_peak_is_no_spike() -> None:
    """Eight degrees wide, measured every 2.5 degrees."""

    def peak(d: Directions) -> float:
        return math.exp(-((d.mirror_offset / math.radians(8)) ** 2)) + 0.01

    assert not curves(peak, SPIKED).spike.any()


def test_points_out_of_the_plane_follow_their_neighbours() -> None:
    """Linear in the detector's place seen from above, between points 25 to 45 degrees apart."""

    def tilted(d: Directions) -> float:
        return float(1.0 - 0.5 * d.theta_r * math.cos(d.phi_r - d.phi_i))

    goals = [at(30.0, float(r), dphi) for dphi in (30.0, 75.0, 110.0, 150.0) for r in (15, 40, 65)]
    away, truth = departures(tilted, goals, math.radians(0.05))
    # two dozen departures of standard deviation 1 have a root mean square below 1.5 in all but one case in a thousand
    assert np.sqrt(np.mean(away**2)) < 1.5
    assert np.ptp(truth) > 0.0


def departures(function: Function, goals: list[Directions], u: float) -> tuple[np.ndarray, np.ndarray]:
    """Effects of steps of theta_r and phi_r less the true ones, in their stated uncertainty; and the true ones."""
    model, away, true = curves(function, goals), [], []
    for k, d in enumerate(goals):
        turned = [Directions(d.theta_i, d.phi_i, d.theta_r, d.phi_r + sign * u) for sign in (1, -1)]
        for plus, minus in ((moved(d, r=u), moved(d, r=-u)), turned):
            true.append((function(plus) - function(minus)) / 2)
            u_slope = model.slope_uncertainty(k, plus)
            if u_slope > 1e-9 * abs(true[-1]) + 1e-15:  # across the plane of incidence a lobe has no slope, for certain
                away.append((model.effects(k, d, plus, minus)[0] - true[-1]) / u_slope)
    return np.array(away), np.array(true)


def test_the_flank_of_a_lobe_out_of_the_plane_is_as_steep_as_between_points_that_it_hides_between() -> None:
    """A Gaussian seen from above, of 8 degrees, sampled every 15: its logarithm is a parabola."""
    width = math.radians(8.0)

    def lobe(d: Directions) -> float:
        x, y = -d.theta_r * math.cos(d.phi_r - d.phi_i), d.theta_r * math.sin(d.phi_r - d.phi_i)
        return 10.0 * math.exp(-0.5 * ((x - d.theta_i) ** 2 + y**2) / width**2)

    goals = [at(60.0, float(r), dphi) for dphi in (150.0, 165.0, 180.0) for r in (45, 60, 75)]
    away, truth = departures(lobe, goals, math.radians(0.02))
    # nine points, of which four see the lobe: 1.5 as above
    assert np.sqrt(np.mean(away**2)) < 1.5
    assert np.ptp(truth) > 0.0


@pytest.mark.slow
def test_curves_in_the_plane_tell_the_flank_of_a_lobe_that_points_out_of_it_do_not_resolve() -> None:
    """A lobe of facets with a slope of 0.11 over a matte base; at 60 degrees nothing is measured in the plane.

    The points at 150 degrees of azimuth see the base alone: between them and the lobe's edge, 13 degrees from its top,
    the slope would come out ten times too small.
    """

    def lobe(d: Directions) -> float:
        half = direction(d.theta_i, d.phi_i) + direction(d.theta_r, d.phi_r)
        return 0.06 + 7.0 * math.exp(-((float(np.hypot(half[0], half[1]) / half[2]) / 0.11) ** 2))

    in_plane = [at(float(i), abs(r), 180.0 if r > 0 else 0.0) for i in (50, 70) for r in np.arange(-78.0, 79.0, 2.5)]
    goals = [*in_plane, *(at(60.0, float(r), dphi) for dphi in (120.0, 150.0, 165.0) for r in (15, 30, 45, 60, 75))]
    model, u = curves(lobe, goals), math.radians(0.02)
    for k, d in list(enumerate(goals))[len(in_plane) :]:
        turned = [Directions(d.theta_i, d.phi_i, d.theta_r, d.phi_r + sign * u) for sign in (1, -1)]
        for plus, minus in ((moved(d, i=u), moved(d, i=-u)), (moved(d, r=u), moved(d, r=-u)), turned):
            odd, _ = model.effects(k, d, plus, minus)
            truth = (lobe(plus) * math.cos(plus.theta_i) - lobe(minus) * math.cos(minus.theta_i)) / 2
            # a fifth of a noise of 0.5 %, which such points have
            assert odd == pytest.approx(truth / math.cos(d.theta_i), rel=0.05, abs=1e-3 * lobe(d))


def test_repeated_readings_are_no_slope() -> None:
    """A grid finer than the encoder's step: several points read the same angle, and differ by their noise."""
    goals = [at(30.0, 40.0 + 0.01 * k) for k in range(60)]
    read = [at(30.0, round((40.0 + 0.01 * k) / 0.088) * 0.088) for k in range(60)]
    f = 0.2 + 1e-3 * np.random.default_rng(0).standard_normal(60)
    model, u = (
        BandCurves(stack(goals), stack(read), f, np.full(60, 1e-3), (0.0, 0.0), [OverlapFraction()] * 60),
        math.radians(0.025),
    )
    # differences over at least 0.2 deg of noise of 1e-3: 0.025/0.2 of it
    assert np.max(np.abs([model.effects(k, d, moved(d, r=u), moved(d, r=-u))[0] for k, d in enumerate(read)])) < 1e-3


@pytest.mark.parametrize("offset_deg", [0.0, 0.03, 0.4, 1.0])
def test_a_blurred_overlap_against_drawn_errors(offset_deg: float) -> None:
    """Both arms 0.03 deg, the tilt 0.02 deg, each drawn and put into vectors one by one."""
    u, tilt = math.radians(0.03), math.radians(0.02)
    read = at(40.0, 40.0 + offset_deg)
    across = 2 * tilt * math.cos(read.theta_i)
    turned = Directions(read.theta_i, 0.0, read.theta_r, read.phi_r + across / math.sin(read.theta_r))
    seen = blurred_overlap(read, stack([moved(read, i=u), moved(read, r=u), turned]), (HALF, HALF))
    rng = np.random.default_rng(3)
    along = math.radians(offset_deg) + u * (rng.standard_normal(200_000) + rng.standard_normal(200_000))
    drawn = overlap(np.hypot(along, across * rng.standard_normal(200_000)), HALF, HALF)
    # 41 quantiles a direction stand for the normal distribution within 1 % of its effect
    assert seen.mean == pytest.approx(drawn.mean(), abs=0.02 * float(drawn.std()) + 1e-5)
    assert math.sqrt(seen.variance) == pytest.approx(float(drawn.std()), rel=0.03)


@pytest.mark.slow
def test_what_a_spike_s_top_lacks_on_average_is_given_back() -> None:
    """Values measured with the mean overlap: the correction restores those at the read directions."""
    u = math.radians(0.04)
    shares = [blurred_overlap(d, stack([moved(d, i=u), moved(d, r=u)]), (HALF, HALF)) for d in SPIKED]
    exact = np.array([spiked(d) for d in SPIKED])
    at_read = np.array([float(overlap(d.mirror_offset, HALF, HALF)) for d in SPIKED])
    steep = np.array([d.theta_i > 1.2 for d in SPIKED])
    measured = exact + np.where(steep, 40.0 * (np.array([share.mean for share in shares]) - at_read), 0.0)
    model = BandCurves(stack(SPIKED), stack(SPIKED), measured, 1e-6 * measured, (HALF, HALF), shares)
    # 1e-3 of the spike: the cubic under it
    np.testing.assert_allclose(measured + model.spikes.correction, exact, atol=0.01)
    top = int(np.argmax(exact))
    assert model.spikes.correction[top] > 1.5
    assert math.sqrt(model.spikes.variance[top]) < model.spikes.correction[top]


def test_a_patch_turns_the_mirror_direction() -> None:
    """Against source and camera at their places, seen from each spot; and the spots fill the disc evenly."""
    d = at(50.0, 50.3)
    patch = over_patch(d, 0.8, 1000.0, 700.0)
    source, eye = 1000.0 * direction(d.theta_i, d.phi_i), 700.0 * direction(d.theta_r, d.phi_r)
    turn = (np.arange(24) + 0.5) * math.pi * (3 - math.sqrt(5))
    radius = 0.8 * np.sqrt((np.arange(24) + 0.5) / 24)
    for k in range(24):
        spot = radius[k] * np.array([math.cos(turn[k]), math.sin(turn[k]), 0.0])
        (ti, pi), (tr, pr) = angles(source - spot), angles(eye - spot)
        # second order in 0.8 / 700
        np.testing.assert_allclose(Directions(ti, pi, tr, pr).from_mirror - d.from_mirror, patch[k], atol=2e-6)
    # of an even disc: <r^2> = R^2 / 2; in y nothing is foreshortened
    assert float(np.sqrt(np.mean(patch[:, 1] ** 2))) == pytest.approx(0.8 / 2 * (1 / 1000 + 1 / 700), rel=0.03)


def test_a_spike_of_which_only_the_edge_was_met_is_uncertain_by_what_it_added() -> None:
    """The one point of a coarse curve near the mirror direction lies where errors of the angles make the overlap."""
    goals = [at(40.0, r) for r in (*range(-80, 40, 8), 39.0, *range(48, 81, 8))]
    shares, edge = [OverlapFraction()] * len(goals), 15
    shares[edge] = blurred_overlap(goals[edge], stack([moved(goals[edge], r=math.radians(0.03))]), (HALF, HALF))
    f = np.full(len(goals), 0.2)
    f[edge] += 3.0
    model = BandCurves(stack(goals), stack(goals), f, 1e-3 * f, (HALF, HALF), shares)
    # half of the places that the errors leave see no spike at all: the excess is as uncertain as it is large
    assert model.spikes.variance[edge] ** 0.5 > 3.0
    assert model.lobe[edge] == pytest.approx(0.2, rel=1e-12)  # a constant lobe


@pytest.mark.parametrize("times", [1, 2])
def test_a_run_over_theta_i_tells_slopes_though_no_incidence_has_two_points(times: int) -> None:
    """The detector stands still; the lobe moves over it with the mirror direction, and falls by half in 7 degrees."""

    def moving(d: Directions) -> float:
        return 0.05 + 4.0 * math.exp(-0.5 * ((d.theta_r - d.theta_i) / 0.1) ** 2)

    goals = [at(float(theta), 40.0) for theta in range(20, 62, 2) for _ in range(times)]
    found, u = curves(moving, goals), math.radians(0.03)
    for k, d in list(enumerate(goals))[times:-times]:
        for axis in ({"i": u}, {"r": u}):
            plus, minus = (moved(d, **{name: sign * by for name, by in axis.items()}) for sign in (1, -1))
            cosine = math.cos(d.theta_i)
            odd = 0.5 * (moving(plus) * math.cos(plus.theta_i) - moving(minus) * math.cos(minus.theta_i)) / cosine
            # steps of 2 degrees on a lobe of 0.1 rad leave a slope a few percent of the steepest: 24 [1/sr per rad]
            assert found.effects(k, d, plus, minus)[0] == pytest.approx(odd, abs=0.05 * 24.0 * u)
