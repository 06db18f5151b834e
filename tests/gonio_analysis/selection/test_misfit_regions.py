"""The region of angles where a model is farthest from the data."""

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from gonio_analysis.curves.in_plane import curves
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.report import verdict
from gonio_analysis.selection.regions import FEWEST, WorstRegion, farthest, too_far, worst

from gonio.formats.reader import table
from gonio.typing import Floats
from tests.gonio_analysis.synthetic import known

RINGS = np.array([10.0, 20.0, 40.0, 50.0, 60.0])


def misfitting(away_deg: float) -> FitResult:
    """At 30 degrees, along the plane of incidence and so far out of it; the model is wrong in the latter by 5 u."""
    turn = np.degrees(np.arcsin(np.sin(np.radians(away_deg)) / np.sin(np.radians(RINGS))))
    frame = table(
        theta_i_deg=30.0,
        phi_i_deg=0.0,
        theta_r_deg=np.concatenate([RINGS, RINGS]),
        phi_r_deg=np.concatenate([np.full(5, 180.0), 180.0 - turn]),
        wavelength_nm=550.0,
        brdf=np.full(10, 0.3),
        u_brdf=np.full(10, 0.01),
        u_random=np.full(10, 0.01),
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )
    data = observations(frame)
    whitened = np.repeat([0.5, 5.0], 5)
    return of(data, data.brdf + 0.01 * whitened)


def of(data: Observations, predicted: Floats, tau: float | None = None) -> FitResult:
    """A fit, as far as `farthest` looks at it."""
    misfit = None if tau is None else SimpleNamespace(tau=tau)
    return cast(FitResult, SimpleNamespace(data=data, predicted=predicted, misfit=misfit))


@pytest.mark.parametrize(("away_deg", "in_plane"), [(1.4, True), (1.6, False), (4.0, False)])
def test_in_plane_means_the_same_in_regions_and_in_curves(away_deg: float, in_plane: bool) -> None:
    result = misfitting(away_deg)
    assert ("out of plane" not in known(farthest(result)).words) == in_plane
    (curve,) = curves(result.data)
    assert curve.rows.size == (10 if in_plane else 5)


def test_the_share_and_the_ratio_of_a_region() -> None:
    found = known(farthest(misfitting(4.0)))
    assert (found.words, found.values) == ("θi = 30°, out of plane", 5)
    # sums and means of a few products: some roundings
    here, there = 5 * np.log(0.35 / 0.3) ** 2, 5 * np.log(0.305 / 0.3) ** 2
    assert found.excess == pytest.approx(here, rel=1e-12)
    assert (found.share, found.ratio) == pytest.approx((here / (here + there), 0.35 / 0.3), rel=1e-12)
    assert found.typical == pytest.approx(math.sqrt(np.log(0.35 / 0.3) ** 2 - (0.01 / 0.3) ** 2), rel=1e-12)


def test_a_source_that_moves_in_small_steps_has_ranges_and_each_value_its_own_mirror_direction() -> None:
    """The detector stands at 45 degrees, and the model lacks the lobe: it is too low where theta_i is near 45."""
    theta_i = np.arange(1.0, 90.0)
    frame = table(
        theta_i_deg=theta_i,
        phi_i_deg=0.0,
        theta_r_deg=np.tile([45.0, 10.0], (theta_i.size, 1)).T.ravel()[: theta_i.size],
        phi_r_deg=180.0,
        wavelength_nm=550.0,
        brdf=np.where(np.abs(theta_i - 45.0) < 8, 3.0, 0.3),
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )
    data = observations(frame)
    found = known(farthest(of(data, np.full(theta_i.size, 0.3))))
    assert found.ratio == pytest.approx(0.1, rel=1e-12)
    low, high = (float(x.strip("°")) for x in found.words.removeprefix("θi = ").split(",")[0].split(" to "))
    assert high - low <= 15
    assert 30 <= low < high <= 60
    assert found.words.endswith("around the mirror direction")


@pytest.mark.parametrize("seed", range(4))
def test_a_value_in_a_zone_of_its_own_is_in_the_region_beside_it(seed: int) -> None:
    """It was in no region, and the one that was named was not the worst."""
    rng = np.random.default_rng(seed)
    along = np.array([-70.0, -60.0, -50.0, 5.0, 15.0, 25.0, 82.5, 40.0, 40.0])
    frame = table(
        theta_i_deg=82.5,
        phi_i_deg=0.0,
        theta_r_deg=np.abs(along),
        phi_r_deg=np.where(np.arange(along.size) > 6, 60.0, np.where(along >= 0, 180.0, 0.0)),
        wavelength_nm=550.0,
        brdf=1.0,
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )
    data = observations(frame)
    predicted = np.exp(rng.normal(0.0, 0.1, along.size))
    at = int(np.argmax(along))
    predicted[at] = 1e-4
    found = known(farthest(of(data, predicted)))
    assert found.words == "θi = 82.5°, between normal and mirror and around the mirror direction and out of plane"
    assert found.values == 6
    assert found.single_ratio == pytest.approx(1e-4, rel=1e-12)
    assert found.single_words == "θi = 82.5°, signed θr = 82.5°"
    words = verdict.where(found)
    assert "off by a factor of 43" in words  # the root mean square of six logarithms, one of them ln 1e4
    assert "in one direction it is too low by a factor of 10\u00a0000: θi = 82.5°, signed θr = 82.5°" in words
    # the same of a value out of the plane
    predicted[at], predicted[-1] = 1.0, 300.0
    found = known(farthest(of(data, predicted)))
    assert found.single_words == "θi = 82.5°, θr = 40°, φr − φi = 60°"
    assert "it is too high by a factor of 300: θi = 82.5°, θr = 40°" in verdict.where(found)


def sweep(rng: np.random.Generator, u_rel: float = 0.0) -> Observations:
    """A few values at a few incidences, in and out of the plane: many zones hold one or two."""
    count = int(rng.integers(4, 20))
    frame = table(
        theta_i_deg=rng.choice(rng.uniform(5, 70, 3), count),
        phi_i_deg=0.0,
        theta_r_deg=rng.uniform(2, 75, count),
        phi_r_deg=rng.choice([0.0, 180.0, 60.0], count),
        wavelength_nm=550.0,
        brdf=rng.uniform(0.1, 2.0, count),
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )
    if u_rel:
        frame[["u_brdf", "u_random"]] = u_rel * np.stack([frame["brdf"]] * 2, axis=1)
    return observations(frame)


@pytest.mark.parametrize("seed", range(20))
def test_the_worst_is_at_least_the_typical_and_every_value_is_in_a_region(seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = sweep(rng)
    logs = rng.normal(0.0, 0.1, len(data))
    found = known(farthest(of(data, data.brdf * np.exp(logs))))
    # mean squares of the parts are at least the mean square of the whole, whatever the parts are, if they are all
    assert found.typical >= np.sqrt(np.mean(logs**2)) * (1 - 1e-12)
    assert found.values >= FEWEST
    # a region that is no farther off than the whole is not called the worst
    for tau, words in ((1.1 * found.typical, "no region is farther off"), (0.9 * found.typical, "worst ")):
        said = worst(farthest(of(data, data.brdf * np.exp(logs), tau)))
        assert words in said
        assert ("worst" in said) == (words == "worst ")


@pytest.mark.parametrize("seed", range(5))
def test_a_value_that_is_hardly_known_is_not_the_worst(seed: int) -> None:
    """Three values of 30 % scatter by it, and no model is to blame."""
    rng = np.random.default_rng(seed)
    along = np.array([-70.0, -50.0, -30.0, 10.0, 15.0, 20.0, 60.0, 65.0, 70.0])
    u = np.where(np.arange(along.size) < 3, 0.3, 0.001)
    frame = table(
        theta_i_deg=45.0,
        phi_i_deg=0.0,
        theta_r_deg=np.abs(along),
        phi_r_deg=np.where(along >= 0, 180.0, 0.0),
        wavelength_nm=550.0,
        brdf=1.0,
        u_brdf=u,
        u_random=u,
        attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )
    off = np.where(u > 0.1, rng.choice([-0.3, 0.3], u.size), rng.choice([-0.02, 0.02], u.size))
    off[-3:] = 0.04
    found = known(farthest(of(observations(frame), np.exp(off), 0.03)))
    assert found.words == "θi = 45°, beyond the mirror direction"
    assert found.typical == pytest.approx(0.04, rel=1e-2)  # the noise of 0.001 is taken out
    assert found.single == ""


@pytest.mark.parametrize(
    ("ratio", "words"),
    [
        (46.0, "too high by a factor of 46"),
        (1.113, "11 % too high"),
        (0.46, "too low by a factor of 2.2"),  # it was "0.46 of the measurement"
        (0.54, "46 % too low"),
        (1.3e-6, "too low by a factor of 770\u00a0000"),  # it was "100 % too low"
    ],
)
def test_how_a_model_stands_to_a_measurement(ratio: float, words: str) -> None:
    assert too_far(ratio) == words


@pytest.mark.parametrize(("part", "words"), [(0.71, "too high"), (0.69, "either way")])
def test_a_region_is_off_one_way_where_its_median_is_most_of_its_scatter(part: float, words: str) -> None:
    typical = 0.2
    for sign, said in ((1, words), (-1, words.replace("high", "low"))):
        assert said in WorstRegion("", 4, 4 * typical**2, 1.0, float(np.exp(sign * part * typical)), typical).off


@pytest.mark.parametrize(
    ("typical", "ratio", "words"),
    [
        (0.12, 0.89, "12 % too low around the mirror direction at θi = 45°"),
        (0.12, 1.0, "off by 12 % either way, around the mirror direction at θi = 45°"),
        (0.9, 0.4, "too low by a factor of 2.5, around the mirror direction at θi = 45°"),
    ],
)
def test_a_region_is_said_on_the_scale_of_tau(typical: float, ratio: float, words: str) -> None:
    region = WorstRegion("θi = 45°, around the mirror direction", 4, 4 * typical**2, 1.0, ratio, typical)
    assert region.off == words
    assert verdict.where(region) == f"It is worst {words}."
