"""Curves that choose their points: what is known of them, what is chosen, and that stopping changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gonio_sweeps import curve
from gonio_sweeps.candidates import Candidates
from gonio_sweeps.curve import SAMPLER, CurveSampler, _angle_errors
from gonio_sweeps.lobe import TILT, Spike, begun
from gonio_sweeps.online import GrowingValues
from gonio_sweeps.posterior import AngleErrors, Before, Posterior

from gonio import models
from gonio.errors import ConfigError
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.instrument import apparent_brdf
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.reduction.angle_errors import angle_axes
from gonio.lab.reduction.spikes import overlap
from gonio.lab.rig.description import RigDescription
from gonio.models.gaussian_process import ENOUGH, Coordinates
from gonio.typing import Floats
from tests.command_line import some
from tests.gonio.numpy_rig import describe, plan_in

PLAN = """
name = "a curve"
wavelength_nm = [550]
[adaptive]
how = "curve"
budget_h = 1.0
theta_i_deg = [30]
theta_r_deg = { start = -70, stop = 70, step = 5 }
"""


def in_plane(signed: Floats, theta_i: float | Floats = 30.0) -> Directions:
    none = np.zeros(signed.size)
    return Directions.from_degrees(none + theta_i, none, np.abs(signed), np.where(signed < 0, 0.0, 180.0))


def satin(d: Directions) -> Floats:
    model = models.build("cook-torrance", {"s": 0.3, "m": 0.2, "diffuse_albedo": 0.5, "ior": 1.5})
    return np.asarray(model.brdf(*d.angles))


def half_angles(description: RigDescription) -> tuple[float, float]:
    return description.lamp.half_angle_deg, description.camera.lens_half_angle_deg


def sampler(folder: Path, text: str = PLAN) -> CurveSampler:
    return SAMPLER.open(plan_in(folder, text), describe())


def measured(
    candidates: Candidates, rows: list[int], before: GrowingValues | None = None, noise: float = 0.003
) -> GrowingValues:
    """What the rows of the candidates come to on the satin sample."""
    d = Directions.stack([candidates.points[k].directions for k in rows])
    f = satin(d) * (1.0 + noise * np.random.default_rng(len(rows)).standard_normal(len(rows)))
    poses = tuple(candidates.poses[k] for k in rows)
    none = np.zeros(len(rows))
    new = GrowingValues(np.array(rows), d, poses, f, noise * f, {"s_reference": 0.002 * f}, none)
    if before is None:
        return new
    angles = [np.concatenate(pair) for pair in zip(before.directions.angles, d.angles, strict=True)]
    f = np.concatenate([before.brdf, f])
    return GrowingValues(
        np.arange(f.size), Directions(*angles), before.poses + poses, f, noise * f, {"s_reference": 0.002 * f},
        np.zeros(f.size),
    )  # fmt: skip


# ---- what is known ----


@pytest.mark.slow
def test_a_lobe_is_found_between_the_points() -> None:
    def lobe(x: Floats) -> Floats:
        return 0.05 + np.exp(-0.5 * ((x - 30) / 8) ** 2)

    x = np.arange(-70.0, 71.0, 5.0)
    f = lobe(x)
    between = np.linspace(-70, 70, 141)
    curve, _, low, high = Posterior(in_plane(x), f, 1e-3 * f, np.zeros((x.size, 0))).at(in_plane(between))
    truth, straight = lobe(between), np.exp(np.interp(between, x, np.log(f)))
    assert rms(curve / truth - 1) < 0.5 * rms(straight / truth - 1)
    # 95 % are stated, of one curve whose errors go together
    assert ((low <= truth) & (truth <= high)).mean() > 0.8


def rms(x: Floats) -> float:
    return float(np.sqrt(np.mean(x**2)))


CONES = (np.radians(0.5), np.radians(0.5))
MIRROR = 60.0


def spiky(d: Directions) -> Floats:
    """What lamp and lens of half a degree see of a smooth metal: a lobe, and at 60 degrees a high spike."""
    model = models.build("he-torrance", {"sigma0_um": 0.16, "tau_um": 1.5, "ior": "Al"})
    solid = float(solid_angle_of_cone(CONES[0]))
    seen = apparent_brdf(
        model, *d.angles, wavelength_nm=500.0, source_solid_angle_sr=solid, receiver_solid_angle_sr=solid, spike="exact"
    )  # fmt: skip
    return np.asarray(seen)


@pytest.mark.slow
def test_a_spike_has_the_shape_of_the_cones() -> None:
    x = np.concatenate([np.arange(-20.0, 80.0, 4.0) + 1.0, MIRROR + np.array([-0.5, 0.0, 0.5])])
    d = in_plane(x, MIRROR)
    f = spiky(d)
    errors = AngleErrors(read=np.radians(0.005), zero=np.radians(0.005))
    between = in_plane(np.linspace(58.0, 62.0, 81), MIRROR)
    truth = spiky(between)

    def known(cones: tuple[float, float] | None) -> Posterior:
        return Posterior(d, f, 2e-3 * f, 2e-3 * f[:, None], errors, cones=cones)

    with_cones = known(CONES)
    error = with_cones.at(between)[0] / truth - 1
    assert with_cones.spike is not None
    # a reflectance that changes by a quarter a degree makes the edges' thin lenses uncertain
    assert rms(error) < 0.05
    assert rms(known(None).at(between)[0] / truth - 1) > 0.25, "no process over the half vector has such an edge"


def test_a_spike_adds_what_the_cones_share_and_scatters_as_landings_do() -> None:
    away = np.radians([0.0, 0.8, -0.7, 2.0])  # the cones share a part from 0.3 to 1.4 degrees
    theta_i = np.array([0.5, 0.5, 0.5, 0.5, np.radians(50.0)])
    d = in_plane(np.degrees(theta_i + np.append(away, 0.0)), np.degrees(theta_i))
    spike, n = Spike((0.01, 0.015), theta_i[-2:], np.array([3.0, 2.0])), away.size
    found, scatter = spike.effects(d)
    # chords stand for angles: a relative 8e-6 at 0.8 degrees, which falling shares double
    np.testing.assert_allclose(found[:n, 0], 3.0 * overlap(np.abs(away), 0.01, 0.015), rtol=2e-5)
    np.testing.assert_allclose(found[n], [0.0, 2.0, 0.0, 0.0], atol=1e-12)
    # a half of the angle is the source's; TILT is the slope's standard deviation
    np.testing.assert_allclose(found[:n, 2], found[:n, 0] * 0.5 * TILT * away, rtol=2e-5, atol=1e-12)
    np.testing.assert_allclose(scatter, 0.0, atol=1e-7)  # the root of a difference of rounded squares
    drawn = np.random.default_rng(2).normal(size=(2, 100_000))
    read = np.radians(0.05)
    for k in (1, 2):
        seen = 3.0 * overlap(np.hypot(away[k] + np.sqrt(2.0) * read * drawn[0], read * drawn[1]), 0.01, 0.015)
        found, scatter = spike.effects(d, read)
        # three nodes of a share that is bent, against 1e5 draws
        assert found[k, 0] == pytest.approx(seen.mean(), rel=5e-3)
        assert scatter[k] == pytest.approx(seen.std(), rel=0.05)


def test_lobe_and_base_of_gaussian_slopes_are_found_at_each_incidence() -> None:
    x = np.arange(-70.0, 71.0, 5.0)
    at = Coordinates.of(in_plane(np.tile(x, 2), np.repeat([20.0, 45.0], x.size)))
    lobe = np.repeat([0.8, 1.3], x.size) * np.exp(-((np.tan(at.theta_h) / np.tan(np.radians(9.0))) ** 2))
    found = begun(at, lobe + 0.04, np.full(2 * x.size, 1e-4), np.ones(2 * x.size, dtype=bool))
    # exact values: what the search leaves after its steps
    np.testing.assert_allclose(some(found), [lobe, np.full(2 * x.size, 0.04)], rtol=1e-3, atol=1e-5)
    assert begun(at, lobe + 0.04, np.full(2 * x.size, 1e-4), np.arange(2 * x.size) < 7) is None


def test_the_scale_is_a_logarithm_far_above_the_noise_and_straight_near_zero() -> None:
    x, f = np.array([-10.0, 0.0, 10.0]), np.array([0.5, -1e-3, 100.0])
    link = Posterior(in_plane(x), f, np.full(3, 1e-4), np.zeros((3, 0))).link
    assert link.e == pytest.approx(5.0 * np.hypot(1e-4, 2e-6 * 100.0))  # five uncertainties, with 2e-6 of the largest
    np.testing.assert_allclose(link.brdf(link.z(f)), f, rtol=1e-12)
    assert link.z(f)[2] == pytest.approx(np.log(100.0 / link.e), abs=1e-9)
    tiny = 1e-6 * link.e
    assert link.z(np.array([tiny]))[0] == pytest.approx(tiny / (2.0 * link.e))
    np.testing.assert_allclose(link.slope(f), (link.z(f + 1e-7) - link.z(f - 1e-7)) / 2e-7, rtol=1e-5)  # differences


def test_a_lobe_wider_than_the_cones_is_no_spike() -> None:
    x = np.concatenate([np.arange(-70.0, 71.0, 5.0), [29.5, 30.5]])
    f = satin(in_plane(x))
    assert Posterior(in_plane(x), f, 2e-3 * f, np.zeros((x.size, 0)), cones=CONES).spike is None


def test_no_interval_lies_below_zero() -> None:
    x = np.linspace(-70, 70, 15)
    f = np.exp(-(((x - 30) / 9) ** 2))
    curve, _, _, high = Posterior(in_plane(x), f, np.full(x.size, 1e-4), np.zeros((x.size, 0))).at(
        in_plane(np.linspace(-70, 70, 141))
    )
    assert (curve >= 0).all()
    assert (high > 0).all()


@pytest.mark.slow
def test_the_reference_is_in_the_interval_and_no_number_of_points_takes_it_out() -> None:
    x = np.linspace(-70, 70, 40)
    f = np.full(x.size, 0.2)
    alone = Posterior(in_plane(x), f, 1e-3 * f, np.zeros((x.size, 0))).at(in_plane(x))[1]
    with_scale = Posterior(in_plane(x), f, 1e-3 * f, 0.005 * f[:, None]).at(in_plane(x))[1]
    assert (alone / f).max() < 0.002
    np.testing.assert_allclose(with_scale / f, 0.005, rtol=0.1)  # the noise adds a tenth of that at most


@pytest.mark.slow
def test_values_below_zero_are_values() -> None:
    x = np.linspace(-70, 70, 21)
    noise = np.random.default_rng(1).standard_normal(x.size)
    f = np.exp(-(((x - 30) / 12) ** 2)) + 1e-4 * noise
    assert (f < 0).any()
    curve, u, low, high = Posterior(in_plane(x), f, np.full(x.size, 1e-4), np.zeros((x.size, 0))).at(in_plane(x))
    dark = np.abs(x - 30) > 50
    assert (np.abs(curve[dark]) < 3e-4).all()
    assert ((low < 0) & (high > 0))[dark].all(), "zero is in the interval where nothing is seen"
    assert np.isfinite(u).all()


@pytest.mark.slow
def test_errors_of_angles_count_where_the_curve_is_steep() -> None:
    x = np.linspace(0, 60, 31)
    f = 0.05 + np.exp(-(((x - 30) / 6) ** 2))
    errors = AngleErrors(read=np.radians(0.1), zero=np.radians(0.1))
    without = Posterior(in_plane(x), f, 1e-3 * f, np.zeros((x.size, 0)))
    known = Posterior(in_plane(x), f, 1e-3 * f, np.zeros((x.size, 0)), errors)
    flank, top = np.argmin(np.abs(x - 36)), np.argmin(np.abs(x - 30))
    u, u_without = known.at(in_plane(x))[1], without.at(in_plane(x))[1]
    # ln f falls by 2 (x - 30)/36 a degree there: 0.1 deg are about 3 %
    assert u[flank] / f[flank] > 0.02
    assert u[top] / f[top] < 0.01
    assert u_without[flank] / f[flank] < 0.005


def test_a_lobe_that_stands_on_a_base_is_known_at_its_foot() -> None:
    def narrow(x: Floats) -> Floats:
        return 0.1 + 3.0 * np.exp(-0.5 * ((x - 30) / 4) ** 2)

    x = np.concatenate([np.arange(-70.0, 12.0, 10.0), np.arange(14.0, 47.0, 4.0), np.arange(50.0, 71.0, 10.0)])
    between = np.linspace(10, 50, 81)
    curve, u, _, _ = Posterior(in_plane(x), narrow(x), 1e-3 * narrow(x), np.zeros((x.size, 0))).at(in_plane(between))
    # as factors they are off by several per cent there; a tenth of a per cent is the noise of a point
    assert rms(curve / narrow(between) - 1) < 0.01
    assert np.median(u / curve) < 0.01


def test_zeros_count_in_radians_once() -> None:
    description = find_rig("sim").description
    errors = _angle_errors(description)
    largest = max(axis.zero_u_deg for axis in angle_axes(description).values())
    assert largest > 0
    assert errors.zero == pytest.approx(np.radians(largest))


# ---- what is chosen ----


def test_the_first_points_cover_and_the_mirror_direction_is_one(tmp_path: Path) -> None:
    signed = [p.theta_r_deg * (1 if p.phi_r_deg else -1) for p in sampler(tmp_path).first(())]
    reach = sum(half_angles(describe()))
    assert {30.0 - 0.5 * reach, 30.0, 30.0 + 0.5 * reach} <= set(signed), "what a spike is told by"
    assert min(signed) == -70
    assert max(signed) == 70
    wanted = sampler(tmp_path, PLAN.replace("[30]", "[30]\nu_rel = 0.015\nmost_points = 40"))
    assert wanted.about()[:2] == [
        "target (relative standard uncertainty of the curve): 1.5 % everywhere",
        "budget: 1 h of rig time for the whole run; at most 40 points",
    ]


def test_a_form_that_many_values_told_is_kept_until_a_quarter_more_are_there(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.linspace(-70.0, 70.0, ENOUGH + 60)
    f = satin(in_plane(x))

    def known(n: int, before: Before | None = None) -> Posterior:
        some = np.linspace(0, x.size - 1, n).astype(int)
        return Posterior(in_plane(x[some]), f[some], 2e-3 * f[some], np.zeros((n, 0)), before=before)

    first = known(ENOUGH + 1)
    form, compared = first.form
    assert compared == ENOUGH + 1
    other = {"factors": "summands", "summands": "factors"}[form]
    told = Before(first.parameters, form, compared)
    monkeypatch.setattr(Posterior, {"factors": "_summed", "summands": "_without_spike"}[form], None)  # is not called
    assert known(ENOUGH + 40, told).form == (form, compared)
    monkeypatch.undo()
    assert known(ENOUGH + 60, Before(first.parameters, form, 200)).form == (form, ENOUGH + 60)
    assert known(ENOUGH, Before(first.parameters, other, ENOUGH)).form == (form, ENOUGH)


def test_points_go_where_the_curve_is_known_least(tmp_path: Path) -> None:
    curve = sampler(tmp_path)
    away = [k for k, p in enumerate(curve.candidates.points) if not (p.phi_r_deg and 15 < p.theta_r_deg < 45)]
    near = curve.decided([measured(curve.candidates, away)], 0.0).points
    # of six points one covers, and two bisect steep gaps
    assert sum(p.phi_r_deg == 180.0 and 15 <= p.theta_r_deg <= 45 for p in near) >= len(near) / 2


def test_a_steep_gap_is_bisected() -> None:
    x = np.concatenate([np.arange(-70.0, 20.0, 5.0), np.arange(20.0, 41.0, 2.5), [60.0, 70.0]])
    f = 0.01 + np.exp(-(((x - 30) / 8) ** 2))
    known = Posterior(in_plane(x), f, 1e-3 * f, np.zeros((x.size, 0)))
    places = in_plane(np.arange(-70.0, 71.0, 1.0))
    grid = curve.CurveGrid.of(places, np.ones(places.theta_r.size))
    noise = np.full(places.theta_r.size, 1e-3)
    _, _, covers = curve.batch([known], [noise], grid, 1e9, np.ones(places.theta_r.size), 3, 0, 1e-3)
    assert 40 < np.degrees(places.signed[covers[0]]) < 60, "where the flank was left out"


@pytest.mark.slow
def test_one_state_gives_one_choice_and_the_target_ends_it(tmp_path: Path) -> None:
    curve = sampler(tmp_path, PLAN + "u_rel = 0.01\n")
    rows = [curve.candidates.points.index(p) for p in curve.first(())]
    values: GrowingValues | None = None
    why = None
    for _ in range(8):
        values = measured(curve.candidates, rows, values)
        decided = curve.decided([values], 0.0, why)
        again = sampler(tmp_path, PLAN + "u_rel = 0.01\n").decided([values], 0.0, why)
        assert decided == again
        why, rows = decided.why, [curve.candidates.points.index(p) for p in decided.points]
        if not rows:
            break
    assert decided.met
    assert decided.why["u_rel"] <= 0.01


@pytest.mark.slow
def test_the_budget_and_the_number_of_points_are_kept(tmp_path: Path) -> None:
    curve = sampler(tmp_path, PLAN + "most_points = 14\n")
    rows = [curve.candidates.points.index(p) for p in curve.first(())]
    values = measured(curve.candidates, rows)
    more = curve.decided([values], 0.0)
    assert len(rows) + len(more.points) == 14
    rows = [curve.candidates.points.index(p) for p in more.points]
    assert not curve.decided([measured(curve.candidates, rows, values)], 0.0).points
    spent = curve.decided([values], 3600.0)
    assert not spent.points
    assert not spent.met
    assert "the budget is spent" in spent.message


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("u_rel = -0.01", "u_rel"),
        ("floor = 2.0", "floor"),
        ("most_points = 3", "most_points"),
        ("uncertainty = 0.01", "uncertainty"),
        ("dphi_deg = { start = 0, stop = 179, step = 3.5 }", "at most 1500"),
    ],
)
def test_a_wrong_key_is_named(tmp_path: Path, line: str, message: str) -> None:
    with pytest.raises(ConfigError, match=r"plan\.toml.*" + message):
        sampler(tmp_path, PLAN + line + "\n")


def test_a_budget_that_the_first_points_do_not_fit_into_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"budget_h = 0\.0001.*first \d+ points"):
        sampler(tmp_path, PLAN.replace("budget_h = 1.0", "budget_h = 0.0001"))


# ---- a whole run ----
