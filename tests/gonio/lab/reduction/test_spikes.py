"""Specular spikes on the simulated rig: zooms, points out of the plane, edges, and what nothing tells."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from gonio.geometry import Directions
from gonio.lab.acquisition.measure import carry_out
from gonio.lab.acquisition.plan import Plan, Point
from gonio.lab.acquisition.run import Run
from gonio.lab.reduction import brdf, spikes
from gonio.lab.reduction.angle_sensitivity import BandCurves
from gonio.lab.reduction.spikes import OverlapFraction, blurred_overlap, lagrange, overlap
from gonio.samples.description import SampleDescription
from tests.gonio.lab.reduction.drawn_runs import measured_around_spikes, pulls, rig

HALF = math.radians(0.5)
stack = Directions.stack
ALUMINIUM = SampleDescription(
    name="rough aluminium",
    model="he-torrance",
    parameters={"sigma0_um": 0.28, "tau_um": 1.77, "ior": [0.77, 6.08], "diffuse_albedo": 0.0},
)
ZOOM = [(75.0, 73.8 + 0.2 * k, 180.0) for k in range(13)]
CURVE = [(75.0, float(r), 180.0) for r in (62.5, 65.0, 67.5, 70.0, 72.5, 75.0, 77.5, 80.0, 82.5)]


def reduced(
    folder: Path, points: list[tuple[float, float, float]], seed: int = 0, name: str = "sim", azimuth: bool = False
) -> pd.DataFrame:
    """The table of points (theta_i, theta_r, dphi) [deg] on aluminium."""
    plan = Plan("spike", (500.0,), tuple(Point(i, 0.0, round(r, 6), p) for i, r, p in points), 0, "test")
    carry_out(plan, rig(azimuth, name), folder / "run", sample=ALUMINIUM, seed=seed, yes=True)
    return brdf.reduce(Run.open(folder / "run"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_zoom_into_a_spike_gets_back_what_its_top_lacks(tmp_path: Path, seed: int) -> None:
    """No point lies outside the cones' sum by more than 0.2 degrees: the overlap's shape tells the spike."""
    table = reduced(tmp_path, ZOOM, seed)
    z = pulls(table, ALUMINIUM)
    assert table.attrs["notes"] == []
    # 13 values that share two zeros; without a correction the top lies 5 to 15 stated uncertainties too low
    assert np.all(abs(z) < 4.0)
    top = int((table["theta_r_deg"] - 75.0).abs().argmin())
    # errors of the angles leave the top uncertain by a few percent (steps and zeros of 0.045 deg on cones of 0.5 deg)
    assert 0.02 < table["u_brdf"].iloc[top] / table["brdf"].iloc[top] < 0.12


@pytest.mark.parametrize("azimuth", [False, True])
def test_points_out_of_the_plane_share_the_spike_of_their_incidence(tmp_path: Path, azimuth: bool) -> None:
    table = reduced(tmp_path, CURVE + [(75.0, 75.0, 180.0 + turn) for turn in (0.5, 1.0)], 2, azimuth=azimuth)
    # 11 values; uncorrected, those aside lay up to 7 stated uncertainties off
    assert np.all(abs(pulls(table, ALUMINIUM)) < 4.0)
    # across the plane errors of 0.017 deg (tilt) or 0.031 deg (azimuth) move the overlap of 0.39 by 0.02 or 0.04
    assert 0.02 < table["u_brdf"].iloc[-2] / table["brdf"].iloc[-2] < 0.3


def test_edges_of_a_spike_without_noise(tmp_path: Path) -> None:
    """Angles known exactly: what is left to correct is the patch, whose spots see different parts of the spike."""
    aside = [(75.0, 75.0, 180.0 + turn) for turn in (0.5, 0.9, 1.0)]
    edges = [(75.0, r, 180.0) for r in (74.0, 74.05, 74.2, 75.9, 75.98)]
    table = reduced(tmp_path, CURVE + edges + aside, name="sim-ideal")
    error = pulls(table, ALUMINIUM) * table["u_brdf"]
    # a thirtieth of the correction, which is up to 3 % of an edge's value on average, and 20 % at the very end
    assert np.all(abs(error) < 1e-3 * table["brdf"])
    # the curvature of the lobe over the patch, 1e-4 of the value, is not in the budget
    assert np.all(abs(error) < 3.0 * table["u_brdf"] + 1e-4 * table["brdf"])
    assert np.all(table["u_brdf"] < 1e-2 * table["brdf"])


def test_where_nothing_tells_the_spike_its_bound_is_in_u_and_a_note_says_so(tmp_path: Path) -> None:
    """One point alone, 0.3 degrees from the mirror direction."""
    table = reduced(tmp_path, [(75.0, 75.3, 180.0), (75.0, 40.0, 180.0)], 3)
    assert abs(pulls(table, ALUMINIUM)[0]) < 3.0
    assert table["u_brdf"][0] > 0.05 * table["brdf"][0]
    assert table["u_brdf"][1] < 0.02 * table["brdf"][1]
    [note] = [note for note in table.attrs["notes"] if "specular spike" in note]
    assert "(75, 75.3, 180) deg" in note
    assert "more" not in note


@pytest.mark.slow
def test_drawn_plans_around_spikes(tmp_path: Path) -> None:
    """One plan of each kind of the campaign, every other one on the rig with an azimuth axis."""
    found = []
    for number in (1, 3, 4, 5, 8, 9):
        table, what, _ = measured_around_spikes(tmp_path, 11, number, most=14)
        z = pulls(table, what)
        found.append(z[np.isfinite(z)])
    z = np.concatenate(found)
    assert z.size > 60
    # 12 000 pulls of 192 whole plans have a standard deviation of 0.95 and none beyond 4.5; of about 80, a fifth of
    # whose variance is common to a run, it is known to 0.1: three of these
    assert 0.65 < z.std() < 1.25
    assert abs(z).max() < 5.0


def at(theta_i: float, theta_r: float, dphi: float = 180.0) -> Directions:
    return Directions(math.radians(theta_i), 0.0, math.radians(theta_r), math.radians(dphi))


def shares(goals: list[Directions], u: float) -> list[OverlapFraction]:
    """For errors of both arms of `u` [rad]."""
    return [
        blurred_overlap(
            d,
            Directions(d.theta_i + np.array([u, 0.0]), 0.0, d.theta_r + np.array([0.0, u]), d.phi_r),
            (HALF, HALF),
        )
        for d in goals
    ]


@pytest.mark.slow
def test_neighbouring_incidences_tell_a_spike_that_one_point_cannot() -> None:
    """Amplitudes cos(theta)^-1 exp(-30 cos(theta)^2), as a rough surface has them; at 70 degrees the top alone."""

    def amplitude(theta_i: float) -> float:
        return 2000.0 * math.exp(-30.0 * math.cos(theta_i) ** 2) / math.cos(theta_i)

    goals = [at(i, i + r) for i in (65.0, 75.0) for r in np.arange(-10.0, 10.1, 0.5)] + [at(70.0, 70.0)]
    seen = shares(goals, math.radians(0.03))
    f = np.array([0.5 + amplitude(float(d.theta_i)) * share.mean for d, share in zip(goals, seen, strict=True)])
    found = BandCurves(stack(goals), stack(goals), f, 0.005 * f, (HALF, HALF), seen).spikes
    assert found.told[-1]
    # the lobe of 0.5 under the ends, and their noise
    assert found.amplitude[-1] == pytest.approx(amplitude(float(goals[-1].theta_i)), rel=0.05)
    alone = BandCurves(stack(goals[-1:]), stack(goals[-1:]), f[-1:], 0.005 * f[-1:], (HALF, HALF), seen[-1:]).spikes
    assert not alone.told[0]
    assert alone.correction[0] == 0.0
    # the bound is the value itself: all of it spike, with two standard deviations of noise and blur
    assert alone.u_amplitude[0] > amplitude(float(goals[-1].theta_i))


def test_beside_an_edge_that_nothing_tells_the_bound_is_that_of_physics() -> None:
    """A point 0.97 degrees from the mirror direction shows its lobe; what the spike adds there nobody knows."""
    goals = [at(40.0, 40.97), *(at(40.0, float(r)) for r in (30, 34, 37, 43, 46, 50))]
    f = np.full(len(goals), 0.2)
    found = BandCurves(stack(goals), stack(goals), f, 0.005 * f, (HALF, HALF), shares(goals, math.radians(0.03))).spikes
    assert found.told.tolist() == [False] + [True] * 6
    mirror = 1.0 / (math.cos(math.radians(40.0)) * 2.0 * math.pi * (1.0 - math.cos(HALF)))
    share = float(overlap(math.radians(0.97), HALF, HALF))
    assert found.u_amplitude[0] == pytest.approx(mirror, rel=1e-9)  # the same formula twice
    assert math.sqrt(found.variance[0]) > 0.5 * mirror * share
    assert np.all(found.variance[1:] == 0.0)


def test_a_value_that_departs_from_the_spike_says_so() -> None:
    """A rare error of the angles brings light into a point just outside: 1/2.5 of what it adds is in its variance."""
    goals = [at(75.0, 75.0 + x) for x in (-8, -6, -4, -2, -0.6, -0.3, 0.0, 0.3, 0.6, 1.1, 2, 4, 6, 8)]
    seen = shares(goals, math.radians(0.03))
    f = np.array([1.0 + 1000.0 * share.mean for share in seen])
    quiet = BandCurves(stack(goals), stack(goals), f, 0.005 * f, (HALF, HALF), seen).spikes.variance[9]
    f[9] += 2.0
    loud = BandCurves(stack(goals), stack(goals), f, 0.005 * f, (HALF, HALF), seen).spikes.variance[9]
    # the fit gives the lobe at most a percent of it
    assert math.sqrt(loud) == pytest.approx(2.0 / 2.5, rel=0.02)
    assert loud > 100.0 * quiet


@pytest.mark.parametrize(("step", "start"), [(5.0, 0.0), (5.0, 2.5), (15.0, 0.0), (15.0, 7.5)])
def test_beside_a_lobe_narrower_than_the_steps_u_is_large_enough(step: float, start: float) -> None:
    """Gaussians of the half vector's slope on a matte ground, 3 and 6 degrees wide in it."""
    u = math.radians(0.04)
    for slope in (0.03, 0.05, 0.08):

        def lobe(d: Directions, slope: float = slope) -> float:
            # in the plane: half the angle from the mirror direction
            return 0.05 + 5.0 * math.exp(-((math.tan(0.5 * (d.theta_r - d.theta_i)) / slope) ** 2))

        goals = [at(60.0, float(r)) for r in np.arange(start, 86.0, step)]
        f = np.array([lobe(d) for d in goals])
        model = BandCurves(stack(goals), stack(goals), f, 0.005 * f, (HALF, HALF), shares(goals, u))
        for k, d in enumerate(goals):
            plus, minus = at(60.0, math.degrees(d.theta_r + u)), at(60.0, math.degrees(d.theta_r - u))
            truth = 0.5 * (lobe(plus) - lobe(minus))
            stated = math.hypot(model.effects(k, d, plus, minus)[0], model.slope_uncertainty(k, plus))
            total = math.sqrt(stated**2 + model.spikes.variance[k] + (0.005 * f[k]) ** 2)
            # docs/radiometry.md, "Narrow lobes and coarse steps"
            assert math.hypot(truth, 0.005 * f[k]) < 1.2 * total


@pytest.mark.parametrize("theta", [30.0, 63.0, 74.0])
def test_rare_errors_that_lead_down_from_a_flat_top_are_in_its_variance(theta: float) -> None:
    """A lens wider than the lamp's image: the overlap is flat to 0.07 degrees, and then falls.

    Its standard deviation is below 0.6 %, and one error of 4000 takes more than six of them away.
    """
    u, goal, rng = math.radians(0.02), at(theta, theta), np.random.default_rng(4)
    moved = Directions(goal.theta_i + np.array([u, 0.0]), 0.0, goal.theta_r + np.array([0.0, u]), goal.phi_r)
    wider = math.radians(0.57)
    top = blurred_overlap(goal, moved, (HALF, wider))
    lost = overlap(u * math.sqrt(2.0) * abs(rng.standard_normal(4000)), HALF, wider) - top.mean
    assert np.std(lost) < 0.006
    assert np.min(lost) < -6.0 * np.std(lost)
    # the largest of 4000 normal numbers is four standard deviations: no more of this one's
    f = np.array([1000.0 * top.mean])
    u = math.sqrt(BandCurves(goal[None], goal[None], f, 1e-6 * f, (HALF, wider), [top]).spikes.variance[0])
    assert np.all(1000.0 * abs(lost) < 4.5 * u)


def test_pixels_of_the_patch_count_as_they_are() -> None:
    """Few places stand for the errors of the angles, all pixels for the patch: both together without errors."""
    d, rng = at(50.0, 50.8), np.random.default_rng(5)
    pixels = 2e-3 * rng.standard_normal((400, 3))
    seen = blurred_overlap(d, stack([]), (HALF, HALF), pixels[:24], pixels)
    places = np.linalg.norm(d.from_mirror + pixels, axis=1)
    assert seen.mean == pytest.approx(float(np.mean(overlap(2 * np.arcsin(places / 2), HALF, HALF))), rel=1e-12)
    assert seen.variance == 0.0
    assert seen.most == seen.mean  # errors of the angles would leave more
    assert seen.at_read == pytest.approx(float(overlap(d.mirror_offset, HALF, HALF)), rel=1e-12)


def test_a_point_beside_a_spike_that_nothing_tells_has_at_most_what_stands_above_its_lobe() -> None:
    """1.03 degrees from the mirror direction nothing is seen where it was read: errors may only bring light."""
    goals = [at(46.0, 47.03), *(at(46.0, float(r)) for r in (31, 36, 41, 51, 56, 61))]
    f = np.full(len(goals), 0.159)
    seen = shares(goals, math.radians(0.03))
    found = BandCurves(Directions.stack(goals), Directions.stack(goals), f, 0.005 * f, (HALF, HALF), seen).spikes
    assert seen[0].mean > 0.0
    assert not found.told[0]
    # two standard deviations of the lobe's shape (3 %) and of the noise; the whole value was stated before
    assert math.sqrt(found.variance[0]) == pytest.approx(2.0 * math.hypot(0.03, 0.005) * 0.159, rel=0.05)
    spiked = np.where(np.arange(f.size) == 0, 0.5, f)
    found = BandCurves(Directions.stack(goals), Directions.stack(goals), spiked, 0.005 * f, (HALF, HALF), seen).spikes
    assert math.sqrt(found.variance[0]) > 0.5 - 0.159


def test_curvature_over_the_region_of_interest_is_in_the_budget(tmp_path: Path) -> None:
    """Without noise, toward grazing: a patch of 0.8 mm at 1 m sees a lobe that is narrow across the plane."""
    table = reduced(tmp_path, [(75.0, float(r), 180.0) for r in range(63, 86, 2)], name="sim-ideal")
    assert np.all(abs(pulls(table, ALUMINIUM)) < 3.0)
    assert np.all(table["u_brdf"] < 2e-3 * table["brdf"])


# ---- parts, by their formulas ----


def test_lagranges_polynomial_goes_through_cubics() -> None:
    def cubic(x: Any) -> Any:
        return 1.0 - 2.0 * x + 0.5 * x**2 + 3.0 * x**3

    at, x = np.array([-1.0, 0.2, 0.9, 2.0]), np.linspace(-1.5, 2.5, 17)
    np.testing.assert_allclose(lagrange(x, at, cubic(at)), cubic(x), rtol=1e-12, atol=1e-12)
    many = np.asarray(at + np.arange(17.0)[:, None], np.float64)
    np.testing.assert_allclose(lagrange(x, many, cubic(many)), cubic(x), rtol=1e-9, atol=1e-9)


def test_the_largest_amplitude_is_that_of_the_point_which_allows_least() -> None:
    """Of a share, two standard deviations of it count as unsure; points that may see nothing allow anything."""
    share, variance = np.array([0.5, 0.8, 0.1]), np.array([0.01, 0.04, 0.04])
    values = np.array([1.2, 1.0, 1e-6])
    # 1.2 / (0.5 - 0.2) = 4, 1 / (0.8 - 0.4) = 2.5, and the third may see nothing: 0.1 < 0.4
    assert spikes._largest(share, variance, values) == pytest.approx(2.5)
    assert spikes._largest(share, variance, -values) == 0.0
    assert spikes._largest(share[2:], variance[2:], values[2:]) == math.inf


@pytest.mark.parametrize(("brdf", "bound"), [(3.0, (3.0 + 2.0 * 0.5) / 0.8), (-1.0, 2.0 * 0.5 / 0.8), (1e9, None)])
def test_a_spike_is_bound_by_its_points_and_by_all_light(brdf: float, bound: float | None) -> None:
    """A mirror gives 1 / (cos(theta) w) with w the solid angle of the wider cone."""
    scene = SimpleNamespace(
        half_angles=(0.01, 0.02), brdf=np.array([brdf]), u=np.array([0.5]), mean=np.array([0.8]),
        variance=np.array([0.0]),
    )  # fmt: skip
    mirror = 1.0 / (math.cos(0.7) * 2.0 * math.pi * (1.0 - math.cos(0.02)))
    found = spikes._bound(cast(spikes.SpikeScene, scene), np.array([0]), 0.7)
    assert found == pytest.approx(mirror if bound is None else bound, rel=1e-9)


def at_incidence(theta: float, amplitude: float, u: float = 0.0, *, stands_out: bool = True) -> spikes._Fit:
    """A spike that is told."""
    return spikes._Fit(
        theta=theta, lobe=np.zeros(1), u_lobe=0.1, solution=np.array([amplitude, 0.0]),
        covariance=np.diag([u**2, 0.0]), common=0.0, told=True, most=1e4, stands_out=stands_out,
    )  # fmt: skip


def rough(theta: float) -> float:
    """exp(-g) / cos(theta), g = (4 pi sigma cos(theta) / lambda)^2 with sigma a tenth of the wavelength."""
    return 50.0 * math.exp(-((0.4 * math.pi * math.cos(theta)) ** 2)) / math.cos(theta)


def test_between_its_neighbours_a_spike_is_that_of_a_rough_surface() -> None:
    below, here, above = 0.2, 0.6, 0.9
    found = spikes._from_neighbours(at_incidence(here, 0.0), [at_incidence(t, rough(t)) for t in (below, above)])
    assert found.solution[0] == pytest.approx(rough(here), rel=1e-12)
    assert (found.told, found.stands_out) == (True, True)
    # a tenth, and a tenth of what the logarithms of both differ by
    step = abs(math.log(rough(above) * math.cos(above) / (rough(below) * math.cos(below))))
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(rough(here) * (0.1 + 0.1 * step), rel=1e-12)


def test_the_nearest_neighbours_count() -> None:
    others = [at_incidence(t, rough(t)) for t in (0.3, 0.8)]
    far = [at_incidence(0.1, 7.0), at_incidence(1.2, 7.0)]
    one, other = (spikes._from_neighbours(at_incidence(0.5, 0.0), some) for some in (others, [*far, *others]))
    assert one.solution[0] == other.solution[0]


def test_where_the_neighbour_toward_grazing_shows_no_spike_there_is_none() -> None:
    found = spikes._from_neighbours(at_incidence(0.5, 0.0), [at_incidence(0.8, 1.0, 0.5, stands_out=False)])
    assert (found.solution[0], found.told, found.stands_out) == (0.0, True, False)
    assert found.most == pytest.approx(1.0 + 2.0 * 0.5), "no more than that one may have"
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(2.0)


def test_a_spike_that_nobody_tells_has_its_bound_as_uncertainty() -> None:
    found = spikes._from_neighbours(at_incidence(0.5, 0.0), [])
    assert (found.solution[0], found.told, found.stands_out) == (0.0, False, False)
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(1e4)
