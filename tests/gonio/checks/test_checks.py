"""Verdicts: true runs are ok about as often as the limits say, and what is wrong is found; covariance is counted."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gonio import measurement
from gonio.checks import verdicts
from gonio.checks.hemisphere import reflectances
from gonio.checks.symmetry import repeats, symmetries
from gonio.checks.values import CheckedValues, incidences, values_of
from gonio.checks.verdicts import FramesTaken, VisitsOfBand, of_energy, of_pairs, of_run, of_values
from gonio.geometry import Directions
from gonio.typing import Floats
from tests.command_line import some
from tests.recipes import infrared_metals

OVER = VisitsOfBand(
    used=5, lost=(), unknown="", straight=True, chi_square=2.0, drift_per_hour=0.003, u_drift_per_hour=0.001,
    peak_to_peak=0.004,
)  # fmt: skip
WELL = FramesTaken(frames=100, frames_left_out=0, scatter=1.0, freedom=60, clipped=0.0, flags=[""] * 40)


def grid(theta_i: tuple[float, ...] = (20.0, 40.0, 60.0), turn: float = 0.0) -> Directions:
    """Every pair of some polar angles, over all azimuths in steps of 30 degrees."""
    angles = np.meshgrid(theta_i, np.arange(20.0, 81.0, 20.0), np.arange(0.0, 359.0, 30.0), indexing="ij")
    ti, tr, dphi = (np.radians(a.ravel()) for a in angles)
    return Directions(ti, np.full(ti.size, turn), tr, turn + dphi)


def drawn(seed: int, at: Directions, f: Floats, *, random: float = 0.003, reference: float = 0.02) -> CheckedValues:
    """Values with independent noise, and with a certificate's error that all of them share."""
    rng = np.random.default_rng(seed)
    measured = f * (1.0 + reference * rng.normal()) + random * f * rng.normal(size=f.size)
    return CheckedValues(at, measured, random * f, (reference * f)[:, None])


def matte(at: Directions) -> Floats:
    """A reciprocal surface of known reflectance: f = (1 + cos(theta_i) cos(theta_r)) / (2 pi)."""
    return np.asarray((1.0 + np.cos(at.theta_i) * np.cos(at.theta_r)) / (2.0 * np.pi))


def test_pairs_of_a_true_surface_scatter_as_their_covariance_says() -> None:
    at = grid()
    ratios = {"reciprocity": [], "left and right": []}  # type: dict[str, list[float]]
    for seed in range(40):
        for pairs in symmetries(drawn(seed, at, matte(at))):
            ratios[pairs.kind].append(some(pairs.reduced_chi_square))
    for found in ratios.values():
        # 36 and 60 pairs and more, 40 times: the mean is known to 4 % or better; three of these
        assert np.mean(found) == pytest.approx(1.0, abs=0.12)


def test_what_is_common_to_both_values_of_a_pair_does_not_excuse_a_difference() -> None:
    """2 % of the certificate's uncertainty cancel: sides that differ by 2 % stand out of 0.3 % of noise."""
    at = grid()
    values = drawn(1, at, matte(at))
    assert [c.verdict for c in of_values(values)[:2]] == ["ok", "ok"]
    bent = replace(values, brdf=np.where((at.dphi > 0.1) & (at.dphi < math.pi - 0.1), 1.02, 1.0) * values.brdf)
    check = of_values(bent)[1]
    assert (check.name, check.verdict) == ("left and right", "bad")
    assert some(check.value) > 10  # (2 % / (0.3 % sqrt 2))^2 = 22
    # were that certificate's error independent from value to value, it would be no difference
    loose = CheckedValues(bent.directions, bent.brdf, np.hypot(0.003, 0.02) * matte(at), np.zeros((len(bent), 0)))
    assert of_values(loose)[1].verdict == "ok"


def test_a_cause_that_all_pairs_share_counts_once() -> None:
    """An angle's zero bends left against right, for all pairs alike: one sigma of it is one degree of freedom."""
    at = grid()
    f = matte(at)
    odd = 0.01 * f * np.sin(at.dphi)
    (_, sides) = symmetries(CheckedValues(at, f + odd, 0.001 * f, odd[:, None]))
    assert sides.chi_square == pytest.approx(1.0, rel=0.02)  # Sherman-Morrison: 1 less the noise's share


def test_differences_around_a_ring_of_azimuths_are_correlated() -> None:
    """Each of four azimuths less the next: correlations of -1/2 with both neighbours, tr(R^2) = 1.5 n."""
    turned = [grid(turn=turn).angles for turn in np.radians([0.0, 90.0, 180.0, 270.0])]
    at = Directions(*np.concatenate(turned, axis=1))
    found = []
    for seed in range(120):
        (ring,) = (p for p in symmetries(drawn(seed, at, matte(at))) if p.kind == "azimuth of incidence")
        assert ring.freedom == pytest.approx(ring.pairs / 1.5, rel=0.02)  # of noise that differs with the values drawn
        found.append(some(ring.chi_square))
    # a chi-square of the same spread: a variance of 120 numbers is known to 13 %, and 2/3 is 2.5 of that off
    assert np.var(found) == pytest.approx(2.0 * ring.pairs**2 / ring.freedom, rel=0.3)
    assert np.mean(found) == pytest.approx(ring.pairs, rel=0.02)  # known to 0.5 %


def test_an_azimuth_measured_at_the_normal_turns_no_plane() -> None:
    """An aligned source stands 0.015 degrees beside the normal, at any azimuth."""
    found = []
    for theta, phi in ((0.0, 0.0), (0.015, 237.0)):
        at = grid((0.0, 20.0, 40.0, 60.0))
        normal = at.theta_i == 0.0
        theta_i = np.where(normal, math.radians(theta), at.theta_i)
        at = Directions(theta_i, np.where(normal, math.radians(phi), at.phi_i), at.theta_r, at.phi_r)
        found.append([(pairs.kind, pairs.pairs) for pairs in symmetries(CheckedValues(at, matte(at)))])
    assert found[0] == found[1]
    assert [kind for kind, _ in found[0]] == ["reciprocity", "left and right"]


@pytest.mark.parametrize(("typical", "verdict"), [(0.03, "ok"), (0.07, "look"), (0.15, "bad")])
def test_without_uncertainties_limits_are_fixed(typical: float, verdict: str) -> None:
    at = grid()
    left = (at.dphi > 0.1) & (at.dphi < math.pi - 0.1)
    check = of_values(CheckedValues(at, np.where(left, math.exp(typical), 1.0) * matte(at)))[1]
    assert check.value == pytest.approx(typical)
    assert check.verdict == verdict


def test_a_plan_without_such_pairs_is_told_what_to_measure() -> None:
    at = Directions(np.full(5, 0.3), np.zeros(5), np.linspace(0.0, 1.2, 5), np.full(5, math.pi))
    first, second, energy = of_values(CheckedValues(at, np.ones(5)))
    assert {first.verdict, second.verdict, energy.verdict} == {"undetermined"}
    assert "theta_i = 50, theta_r = 20" in first.advice
    assert "dphi_deg" in second.advice
    assert "hemisphere" in energy.advice


def test_repeats_are_found_among_other_points_and_judged() -> None:
    at = grid()
    again = Directions(*(np.concatenate([a, a[:12] + 1e-5]) for a in at.angles))
    values = drawn(3, again, matte(again))
    found = some(repeats(values))
    assert (found.pairs, of_pairs("repeats", found, "").verdict) == (12, "ok")
    moved = np.concatenate([np.ones(len(at.theta_i)), np.full(12, 1.03)])
    assert of_pairs("repeats", some(repeats(replace(values, brdf=values.brdf * moved))), "").verdict == "bad"
    assert repeats(drawn(3, at, matte(at))) is None


def test_azimuths_on_both_sides_of_zero_are_one_incidence() -> None:
    """Readbacks scatter around 0: half of a hemisphere would be missing on either side."""
    at = grid(theta_i=(30.0,))
    scattered = np.random.default_rng(0).normal(0.0, 1e-3, at.theta_i.size)
    (one,) = incidences(Directions(at.theta_i, scattered, at.theta_r, at.phi_r))
    assert one.rows.size == at.theta_i.size
    assert min(one.phi_i, 2 * math.pi - one.phi_i) < 1e-3


@pytest.mark.parametrize("reference", [0.0, 0.02])
def test_the_uncertainty_of_a_reflectance_is_that_of_drawn_tables(reference: float) -> None:
    """GUM supplement 1 by hand: with a common cause, points taken as independent give far too little."""
    at = grid(theta_i=(30.0,))
    f = matte(at)
    (one,) = reflectances(CheckedValues(at, f, 0.01 * f, (reference * f)[:, None]))
    assert one.u_values is not None
    assert one.u_independent is not None
    rho = [reflectances(drawn(seed, at, f, random=0.01, reference=reference))[0].rho_dh for seed in range(400)]
    # 400 draws tell a standard deviation to 3.5 %; three of these. Beyond the rim stands the median of the outermost
    # values where the uncertainty has their mean, which is less than that
    assert np.std([r for r in rho if r is not None], ddof=1) == pytest.approx(one.u_values, rel=0.11)
    if reference:
        assert one.u_values > 4 * one.u_independent
    else:
        assert one.u_independent == pytest.approx(one.u_values)


def test_energy_is_judged_by_the_uncertainty() -> None:
    """Around a reflectance of 5/6 with u = 1 %: rho is scaled to just above 1, and far above it."""
    at = grid(theta_i=(0.0,))
    dense = np.meshgrid([0.0], np.radians(np.arange(0.0, 89.1, 2.0)), np.radians(np.arange(0.0, 360.0, 10.0)))
    ti, tr, dphi = (a.ravel() for a in dense)
    at = Directions(ti, np.zeros(ti.size), tr, dphi)
    f = matte(at)
    for scale, verdict in ((1.0, "ok"), (1.21, "look"), (1.4, "bad")):
        (one,) = reflectances(CheckedValues(at, scale * f, 0.01 * f, (0.01 * scale * f)[:, None]))
        assert one.rho_dh == pytest.approx(scale * 5.0 / 6.0, rel=5e-3)  # 1/2 + 1/3, on a grid of 2 degrees
        assert of_energy([one]).verdict == verdict


@pytest.mark.parametrize(
    ("taken", "visits", "name", "verdict"),
    [
        (WELL, OVER, "", "ok"),
        (WELL, replace(OVER, unknown="one measurement of the white reference only"), "reference drift", "undetermined"),
        (WELL, replace(OVER, straight=False, chi_square=40.0), "reference drift", "look"),
        (WELL, replace(OVER, lost=["saturated"]), "reference drift", "look"),
        (WELL, replace(OVER, peak_to_peak=0.2), "reference drift", "bad"),
        (replace(WELL, scatter=2.0), OVER, "repeatability", "look"),
        (replace(WELL, scatter=6.0), OVER, "repeatability", "bad"),
        (replace(WELL, freedom=0), OVER, "repeatability", "undetermined"),
        (replace(WELL, flags=["saturated"] + [""] * 39), OVER, "saturation", "look"),
        (replace(WELL, frames_left_out=60), OVER, "saturation", "look"),
        (replace(WELL, flags=["saturated"] * 10 + [""] * 30), OVER, "saturation", "bad"),
        (replace(WELL, flags=["moved", "damaged"] + [""] * 38), OVER, "lost points", "look"),
        (replace(WELL, flags=["not_measured"] * 20 + [""] * 20), OVER, "lost points", "bad"),
        (replace(WELL, clipped=0.02), OVER, "dark level", "look"),
        (replace(WELL, clipped=0.4), OVER, "dark level", "bad"),
        (replace(WELL, clipped=1.0), OVER, "", "ok"),
    ],
)
def test_what_is_wrong_with_a_run_is_named(taken: FramesTaken, visits: VisitsOfBand, name: str, verdict: str) -> None:
    found = of_run(taken, visits, "green")
    assert {c.name: c.verdict for c in found if c.verdict != "ok"} == ({name: verdict} if name else {})
    assert all(c.band == "green" and (c.limit or c.verdict == "undetermined") for c in found)
    assert [verdicts.Check.from_json(c.to_json()) for c in found] == found
    assert verdicts.Check.from_json({"name": "another program's"}) is None


def test_the_place_of_a_difference_names_its_cause() -> None:
    """A bright lobe about the mirror direction: a background is felt far from it, a moved lobe beside it."""
    degrees = np.arange(10.0, 86.0, 5.0)
    ti, tr = (np.radians(a.ravel()) for a in np.meshgrid(degrees, degrees))
    at = Directions(ti, np.zeros(ti.size), tr, np.full(ti.size, math.pi))
    lobe = 1e-3 + np.exp(-(((np.sin(ti) - np.sin(tr)) / 0.15) ** 2))
    stray = of_values(CheckedValues(at, lobe + 2e-3 * (ti > tr)))[0]
    assert stray.verdict == "bad"
    assert "Most of it lies fainter than 1 %" in stray.advice
    moved = of_values(CheckedValues(at, lobe * np.where(np.isclose(tr - ti, math.radians(5.0)), 1.5, 1.0)))[0]
    assert moved.verdict == "bad"
    assert "Most of it lies within 5° of the mirror direction" in moved.advice


def test_infrared_metals_are_reciprocal_or_not_as_their_makers_say(tmp_path: Path) -> None:
    """Sandblasted aluminium agrees within 12 %; the shiny samples do not, and the check says where."""
    samples = measurement.tables(infrared_metals(tmp_path))
    found = {}
    for name, table in samples.items():
        (values,) = values_of(table).values()
        (found[name],) = (pairs for pairs in symmetries(values) if pairs.kind == "reciprocity")
    assert {name: found[name].pairs for name in found} == dict.fromkeys(samples, 45)
    assert math.exp(found["sandblasted aluminium"].largest) == pytest.approx(1.12, abs=0.005)
    verdict = {name: of_pairs("reciprocity", pairs, "") for name, pairs in found.items()}
    assert {name for name, check in verdict.items() if check.verdict == "ok"} == {"sandblasted aluminium"}
    assert {check.verdict for name, check in verdict.items() if name != "sandblasted aluminium"} == {"bad"}
    assert math.exp(found["brushed stainless steel"].largest) > 1.6
    assert "Most of it lies within 5° of the mirror" in verdict["galvanised steel"].advice
    assert "Most of it lies fainter than 1 %" in verdict["brass"].advice


@pytest.mark.parametrize(("directions", "visits", "pairs"), [(1, 8, 4), (2, 5, 4), (3, 3, 3), (5, 2, 5), (40, 12, 240)])
def test_visits_to_few_directions_are_compared_two_by_two(directions: int, visits: int, pairs: int) -> None:
    """No value is in two pairs, so that the chi-square counts each once."""
    rng = np.random.default_rng(directions)
    once = np.stack([np.full(directions, 0.7), np.zeros(directions), rng.uniform(0, 1.2, directions),
                     rng.uniform(0, 6.0, directions)])  # fmt: skip
    at = Directions(*np.tile(once, visits))
    assert some(repeats(drawn(4, at, matte(at)))).pairs == pairs
    moved = Directions(at.theta_i, at.phi_i, at.theta_r + rng.uniform(0, np.radians(0.01), at.theta_r.size), at.phi_r)
    assert some(repeats(drawn(4, moved, matte(moved)))).pairs == pairs
