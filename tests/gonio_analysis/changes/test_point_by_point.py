"""Two things point by point: alignment that invents nothing, and verdicts that are as rare as they say."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis import commands
from gonio_analysis.changes import sides
from gonio_analysis.changes.point_by_point import Change, change
from gonio_analysis.changes.resampling import carry
from gonio_analysis.changes.sides import Side
from gonio_analysis.changes.verdict import judge, within
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.value_covariance import Covariance
from gonio_analysis.report import change_figures
from gonio_analysis.report.drawing import Drawing
from scipy.special import ndtri
from scipy.stats import chi2

from gonio import measurement
from gonio.errors import ConfigError, DataError
from gonio.formats.reader import table
from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure

GLOSS = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 30})
SAMPLE = 'name = "gloss"\nmodel = "phong"\n[parameters]\nk_d = 0.3\nk_s = 0.5\nexponent = 30\n'


def side(frame: pd.DataFrame, name: str = "x") -> Side:
    return Side(name, f"{name}.csv", frame, observations(frame))


def hemisphere(model: object, *, step: float = 10.0, shift: float = 0.0) -> pd.DataFrame:
    """One incidence over the hemisphere, without noise."""
    polar, turn = np.meshgrid(
        np.arange(10.0, 71.0, step) + shift, np.arange(0.0, 360.0, 10.0) + 3 * shift, indexing="ij"
    )
    theta, dphi = polar.ravel(), turn.ravel() % 360.0
    true = model.brdf(np.radians(30.0), 0.0, np.radians(theta), np.radians(dphi))  # type: ignore[attr-defined]
    return table(
        theta_i_deg=np.full(theta.size, 30.0), phi_i_deg=0.0, theta_r_deg=theta, phi_r_deg=dphi, wavelength_nm=550.0,
        brdf=true, u_brdf=1e-3 * true, u_random=1e-3 * true, attrs={},
    )  # fmt: skip


def test_interpolation_over_the_hemisphere_stays_within_its_stated_error() -> None:
    frame, moved = hemisphere(GLOSS), hemisphere(GLOSS, shift=2.5)
    goal = observations(moved)
    found = carry(goal, observations(frame))
    off = np.abs(found.value - goal.brdf[found.rows])
    assert found.interpolated > 100
    # it counts as a standard uncertainty: 68 % within once, 95 % within twice
    assert np.mean(off <= found.error) > 0.68
    assert np.mean(off <= 2 * found.error) > 0.95
    # beyond the last ring nothing is known
    assert np.degrees(goal.directions.theta_r[found.rows].max()) < 70.0
    assert sum(found.missing.values()) == len(goal) - found.rows.size > 0


def test_holes_stay_holes() -> None:
    whole = measure(GLOSS, incidences=(30.0,))
    holed = whole.copy()
    holed.attrs = whole.attrs
    at = holed["theta_r_deg"].isin([25.0, 30.0]) & (holed["phi_r_deg"] == 0.0)
    holed.loc[at, "flag"] = "blocked"
    goal = observations(measure(GLOSS, incidences=(30.0,), views=np.arange(-60.0, 61.0, 2.0)))
    signed = np.degrees(np.where(np.cos(goal.directions.phi_r) < 0, 1, -1) * goal.directions.theta_r)
    kept = carry(goal, observations(holed))
    assert set(np.round(np.setdiff1d(signed, signed[kept.rows]))) == {-34, -32, -30, -28, -26, -24, -22}
    # nor is anything carried over where the neighbours are far apart
    sparse = measure(GLOSS, incidences=(30.0,), views=np.array([-60.0, -40.0, 0.0, 40.0, 60.0]))
    assert set(np.round(signed[carry(goal, observations(sparse)).rows])) == {-60, -40, 0, 40, 60}


def test_other_incidences_and_wavelengths_are_not_compared() -> None:
    a, b = measure(GLOSS, incidences=(10.0, 30.0)), measure(GLOSS, incidences=(30.0, 60.0))
    assert carry(observations(a), observations(b)).missing == {"at another incidence": 33}
    with pytest.raises(DataError, match=r"share no direction.*at another wavelength"):
        change(side(a), side(measure(GLOSS, wavelength_nm=650.0)))


def test_planes_of_other_azimuths_are_laid_on_each_other() -> None:
    a, b = measure(GLOSS), measure(GLOSS)
    b["phi_i_deg"] = 90.0
    b["phi_r_deg"] = (b["phi_r_deg"] + 90.0) % 360.0
    found = change(side(a), side(b))
    assert len(found.at) == len(a)
    assert np.allclose(found.difference, 0.0, atol=1e-12)  # rounding of the azimuths
    assert any("90°" in n for n in found.notes)


def test_verdicts_are_as_rare_as_they_say() -> None:
    """400 comparisons of the same sample, with a common cause ten times the noise."""
    rng = np.random.default_rng(2)
    n = 80
    value = rng.uniform(0.1, 1.0, n)
    c = Covariance(0.002 * value, (0.02 * value)[:, None], ("reference",))
    verdicts = []
    for _ in range(400):
        verdicts.append(judge(value, value + 0.002 * value * rng.normal(size=n) + 0.02 * value * rng.normal(), c))
    # binomial: 4 +- 2 of 400 at the level of 1 %; 4.55 % of 32 000 beyond 2, standard deviation 0.13 %
    assert sum(v.changed for v in verdicts) <= 12
    assert np.mean([v.beyond / n for v in verdicts]) == pytest.approx(0.0455, abs=0.005)
    assert np.mean([v.beyond / v.expected for v in verdicts]) == pytest.approx(1.0, abs=0.1)
    # with nothing to find, one mark anywhere is a false discovery: in 5 % of the comparisons (20 +- 4.4)
    assert sum(v.marked.any() for v in verdicts) <= 34


@pytest.mark.parametrize(("sigma", "least", "most"), [(0.0, 0, 12), (3.0, 190, 245), (4.0, 325, 365), (5.0, 384, 399)])
def test_a_change_of_scale_is_found_by_its_own_test(sigma: float, least: int, most: int) -> None:
    """Chi-square of 74 values and the largest of them found 28 % of 4 sigma, beside a factor that the page printed.

    Of 400: a normal number moved by 3, 4, 5 lies beyond 2.94 (a third of 1 %, two-sided) in 52, 86, 98 %; the limits
    are three binomial standard deviations around that, and around the 1 % of all tests together with no change.
    """
    rng, n = np.random.default_rng(8), 74
    value = rng.uniform(0.1, 1.0, n)
    c = Covariance(0.008 * value, (0.004 * value)[:, None], ("reference",))
    u = float(np.sum(c.whiten(value) ** 2) ** -0.5)
    found = []
    for _ in range(400):
        noise = c.random * rng.normal(size=n) + c.common[:, 0] * rng.normal()
        found.append(judge(value, value * (1.0 + sigma * u) + noise, c))
    by_scale = sum("the common factor" in v.found_by for v in found)
    assert least <= (by_scale if sigma else sum(v.changed for v in found)) <= most
    assert all(v.changed == bool(v.found_by) for v in found)


def lobe(n: int = 74) -> tuple[np.ndarray, dict[str, np.ndarray], Covariance]:
    """Values over the angle, what zeros of both arms do to them, and a covariance that states both zeros."""
    at = np.linspace(-1.2, 1.2, n)
    value = 0.1 + np.exp(-0.5 * ((at - 0.5) / 0.2) ** 2)
    slope = -(at - 0.5) / 0.2**2 * (value - 0.1)
    zeros = {"theta_r": -slope, "theta_i": slope + 0.5 * value}
    common = np.stack([0.004 * value, 2e-4 * slope, -2e-4 * zeros["theta_i"]], axis=1)
    return value, zeros, Covariance(0.008 * value, common, ("reference", "theta_r_zero", "theta_i_zero"))


@pytest.mark.parametrize("angle", ["theta_r", "theta_i"])
@pytest.mark.parametrize(("sigma", "least", "most"), [(0.0, 0, 12), (4.0, 300, 400), (5.0, 380, 400)])
def test_a_zero_is_found_by_its_own_test(angle: str, sigma: float, least: int, most: int) -> None:
    """Chi-square drowned one number among many: 0.2 degrees, seven u of two zeros, were found in 9 of 60 pairs.

    Of 400: a normal number moved by 4, 5 lies beyond 3.09 (a fifth of 1 %, two-sided) in 82, 97 %; the limits are
    three binomial standard deviations below that. Either arm's zero may be named where both look alike.
    """
    rng, (value, zeros, c) = np.random.default_rng(18), lobe()
    u = float(np.sum(c.whiten(zeros[angle]) ** 2) ** -0.5)
    found = []
    for _ in range(400):
        noise = c.random * rng.normal(size=value.size) + c.common @ rng.normal(size=3)
        found.append(judge(value, value + sigma * u * zeros[angle] + noise, c, zeros))
    by_zero = sum(any(zero.found for zero in v.zeros.values()) for v in found)
    assert least <= (by_zero if sigma else sum(v.changed for v in found)) <= most
    # one effect is told as one: a zero is no factor as well (1 % of 400 by chance, and three standard deviations)
    assert sum(v.factor.found for v in found) <= 12
    told = [v.zeros[angle] for v in found if v.zeros[angle].found]
    if sigma:
        pulls = np.array([(x.value - sigma * u) / x.u for x in told])
        assert (
            abs(np.mean(pulls)) < 0.5
        )  # those that are found are the larger ones: 0.22 of a normal number beyond 3.09
        # a size that is found in 90 of 100 cases is 3.09 + 1.28 standard uncertainties
        assert told[0].detectable == pytest.approx(4.37 * u, rel=0.01)


def test_what_two_different_samples_differ_by_is_no_precise_factor() -> None:
    """ "Common factor 0.6196 +- 0.0033" stood above "divided by 0.5827": now one number, as uncertain as it is."""
    a = measure(GLOSS, noise=0.003, reference=0.002, seed=1)
    b = measure(build("phong", {"k_d": 0.2, "k_s": 0.2, "exponent": 12}), noise=0.003, reference=0.002, seed=2)
    found = change(side(a), side(b))
    verdict = known(found.verdict)
    assert found.within.scale == 1.0 + verdict.scale
    assert verdict.u_scale > 5 * 0.003  # the shapes differ by tens of percent
    assert verdict.remains > 0.05
    # a factor of 0.6 of the same shape is told as it is, and not as 2 (k - 1) / (k + 1)
    less = change(side(a), side(a.assign(brdf=0.6 * a["brdf"], u_random=0.6 * a["u_random"])))
    assert 1.0 + known(less.verdict).scale == pytest.approx(0.6, rel=1e-6)
    assert less.within.scale == pytest.approx(0.6, rel=1e-6)
    assert less.within.with_scale == 0.0


def test_without_uncertainties_factor_and_zero_are_of_one_fit() -> None:
    """The factor was that of a fit without the zero."""
    at = np.linspace(-1.2, 1.2, 60)
    value, slope = 0.1 + np.exp(-0.5 * (at / 0.3) ** 2), -at / 0.09 * np.exp(-0.5 * (at / 0.3) ** 2)
    b = (value - 0.01 * slope) * 1.05
    found = within(value, b, None, {"theta_r": -slope})
    assert found.scale == pytest.approx(1.05, rel=2e-3)  # the mean of both is not quite that of either
    assert known(found.zero) == pytest.approx(0.01, rel=0.03)


@pytest.mark.slow
def test_each_test_is_named_where_it_finds_something(tmp_path: Path) -> None:
    a = measure(GLOSS, noise=0.003, reference=0.002, seed=3)
    other, spot = measure(GLOSS, noise=0.003, reference=0.002, seed=4), measure(GLOSS, noise=0.003, seed=4)
    same = known(change(side(a), side(other)).verdict)
    other["brdf"] *= (1.0 + 4.0 * same.u_scale) / (1.0 + same.scale)
    spot["brdf"] = spot["brdf"].where(spot.index != 40, 1.025 * spot["brdf"])  # six of 0.42 %
    for frame, name in ((other, "the common factor"), (spot, "the largest single value")):
        found = known(change(side(a), side(frame)).verdict)
        assert name in found.found_by, found.tests
    measurement.write(a, tmp_path / "a.csv")
    measurement.write(other, tmp_path / "b.csv")
    commands.compare([str(tmp_path / "a.csv"), str(tmp_path / "b.csv")], tmp_path / "out", change=True)
    facts = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert facts["verdict"]["found_by"] == ["the common factor"]
    assert facts["verdict"]["p_scale"] < 0.01 / 5
    assert set(facts["verdict"]["zeros"]) == {"theta_r", "theta_i"}
    assert facts["agree_within"]["scale"] == pytest.approx(1.0 + facts["verdict"]["scale"], rel=1e-12)
    assert facts["conclusion"].startswith("The sample changed, by the common factor: ")
    assert "share 1 %" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")


def test_references_of_different_quality_pull_no_common_factor() -> None:
    """Columns of noisy values pulled it by n u^2 / 2: 2 % of 99 values and a reference of 2 %, 1.0 standard errors."""
    pulls = []
    for seed in range(30):
        a, b = (measure(GLOSS, noise=0.003, reference=u, seed=seed + k) for u, k in ((0.02, 100), (0.002, 200)))
        found = known(change(side(a), side(b)).verdict)
        relative = found.u_scale / (1.0 + found.scale)
        assert relative == pytest.approx(np.hypot(0.02, 0.002), rel=0.03)  # the noise adds little
        pulls.append(found.scale / found.u_scale)
    assert abs(np.mean(pulls)) < 3.0 / np.sqrt(30)  # three standard errors of the mean of 30
    assert np.sum(np.square(pulls)) < chi2.ppf(0.999, 30)


def test_identical_inputs_are_called_identical(tmp_path: Path) -> None:
    measurement.write(measure(GLOSS, noise=0.003, reference=0.002, seed=3), tmp_path / "a.csv")
    commands.compare([str(tmp_path / "a.csv")] * 2, tmp_path / "out", change=True)
    facts = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert facts["conclusion"] == "The two are identical: each of the 99 values of B is that of A."
    frame = measure(GLOSS, noise=0.003, seed=3)
    assert change(side(frame), side(frame))._conclusion == "identical"


def test_two_that_are_black_have_no_common_factor(tmp_path: Path) -> None:
    black = hemisphere(GLOSS).assign(brdf=0.0, u_brdf=0.01, u_random=0.01)
    measurement.write(black, tmp_path / "a.csv")
    measurement.write(black.assign(brdf=-0.001), tmp_path / "b.csv")
    found = change(side(black), side(black))
    assert found.verdict is not None
    assert (found.verdict.scale, found.verdict.u_scale, found.verdict.changed) == (0.0, np.inf, False)
    commands.compare([str(tmp_path / name) for name in ("a.csv", "b.csv")], tmp_path / "out", change=True)
    told = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert "No value stands out of its uncertainty in both, so that no ratio is told." in told["conclusion"]


def test_what_agrees_with_a_scale_and_a_zero_free_says_so() -> None:
    a, b = measure(GLOSS, noise=0.0, floor=1e-9), measure(GLOSS, noise=0.0, floor=1e-9)
    silent = ["u_brdf", "u_random"]
    turned = 0.2
    moved = np.where(b["phi_r_deg"] == 180.0, b["theta_r_deg"], -b["theta_r_deg"]) + turned
    b = b.assign(theta_r_deg=np.abs(moved), phi_r_deg=np.where(moved >= 0.0, 180.0, 0.0), brdf=1.03 * b["brdf"])
    for frame in (a, b):
        frame[silent] = np.nan
    found = change(side(a, "a"), side(b, "b")).within
    assert known(found.with_zero) < 0.3 * found.with_scale < 0.9 * found.as_they_are
    # a lobe ten degrees wide in steps of 5: the slope between neighbours is known to some percent
    assert np.degrees(known(found.zero)) == pytest.approx(turned, rel=0.15)
    scaled = change(side(a, "a"), side(a.assign(brdf=0.98 * a["brdf"]), "b")).within
    assert scaled.scale == pytest.approx(0.98, rel=1e-9)  # of exact values
    assert scaled.with_scale < 1e-3
    assert scaled.as_they_are == pytest.approx(0.0202, rel=1e-3)


def test_nothing_is_left_beyond_what_is_stated() -> None:
    a, b = measure(GLOSS, seed=1), measure(GLOSS, seed=2)
    assert change(side(a), side(b)).within.as_they_are < 3e-3  # of noise of 1 %: chi-square's own chance
    louder = change(side(a), side(b.assign(brdf=b["brdf"] * np.random.default_rng(3).normal(1.0, 0.05, len(b))))).within
    assert louder.as_they_are == pytest.approx(0.05, rel=0.25)  # of 99 values


def test_one_changed_value_is_found_under_a_change_of_scale() -> None:
    a, b = measure(GLOSS, noise=0.003, reference=0.01, seed=3), measure(GLOSS, noise=0.003, reference=0.01, seed=4)
    spot = 40
    b["brdf"] = b["brdf"].where(b.index != spot, 1.05 * b["brdf"])
    verdict = known(change(side(a), side(b)).verdict)
    assert verdict.changed
    assert list(np.flatnonzero(verdict.marked)) == [spot]
    assert abs(verdict.scale) < 4 * verdict.u_scale  # 4 standard deviations: one seed in 16 000
    assert verdict.u_scale == pytest.approx(np.hypot(0.01, 0.01), rel=0.05)  # the noise adds little


def test_a_coarse_table_agrees_with_a_fine_one_of_the_same_sample() -> None:
    """A lobe 8 degrees wide, every 7.5 and every 2.5 degrees: in the coarse directions, whichever comes first."""
    shiny = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 300})
    other = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 320})
    coarse, fine = np.arange(-75.0, 75.1, 7.5), np.arange(-80.0, 80.1, 2.5)
    between = np.arange(-78.0, 79.0, 4.0)

    def against(b_model: object, a_views: np.ndarray, b_views: np.ndarray, seed: int) -> Change:
        a = measure(shiny, views=a_views, noise=0.005, reference=0.003, seed=seed)
        return change(side(a), side(measure(b_model, views=b_views, noise=0.005, reference=0.003, seed=100 + seed)))

    # 12 verdicts of which 1 % are wrong by chance; the seeds are fixed
    for seed in range(3):
        for views, onto in (
            ((coarse, fine), "A"),
            ((fine, coarse), "B"),
            ((coarse, between), "A"),
            ((between, coarse), "B"),
        ):
            found = against(shiny, *views, seed)
            assert found.onto == onto
            assert not known(found.verdict).changed
    # in common directions nothing is interpolated, and a lobe 3 % narrower is seen from either side
    for views in (coarse, fine), (fine, coarse):
        found = against(other, *views, 0)
        assert not found.error.any()
        assert known(found.verdict).changed


def test_every_direction_of_a_certificate_counts() -> None:
    """One of three stands exactly in a measured direction, the others between measured ones."""
    fine = measure(GLOSS)
    picked = fine[(fine["theta_r_deg"] > 20.0) & (fine["theta_r_deg"] < 60.0)].iloc[[0, 9, 18]].copy()
    picked["theta_r_deg"] += [0.0, 1.0, 1.0]
    few, many = side(picked, "certificate"), side(fine, "measured")
    for a, b, onto in ((many, few, "B"), (few, many, "A")):
        found = change(a, b)
        assert (len(found.at), found.onto) == (3, onto)


@pytest.mark.slow
def test_a_model_that_is_off_is_so_uncertain(tmp_path: Path) -> None:
    """What a sample file says of its misfit counts: the sample that the model was fitted to does not disagree."""
    measurement.write(measure(GLOSS, noise=0.003), tmp_path / "t.csv")
    found = {}
    for residual in (False, True):
        file = tmp_path / f"{residual}.toml"
        commands.fit("cook-torrance", str(tmp_path / "t.csv"), save=file, residual=residual)
        found[residual] = change(sides.side(str(tmp_path / "t.csv")), sides.side(str(file)))
        assert any("is a model that is off" in note for note in found[residual].notes)
    exact = replace(sides.side(str(tmp_path / "False.toml")), misfit=0.0)
    plain = change(sides.side(str(tmp_path / "t.csv")), exact)
    chi = {
        name: one.verdict.chi_square / len(one.at) for name, one in (("exact", plain), *found.items()) if one.verdict
    }
    assert chi["exact"] > 20.0
    assert 0.5 < chi[False] < 2.0  # tau is the scatter about the model
    assert chi[True] < 1.0  # the curve follows these very values
    assert float(np.median(found[True].u_b)) < 0.3 * float(np.median(found[False].u_b))


def test_step_up_of_benjamini_and_hochberg() -> None:
    # their example: 15 p-values, four discoveries at 5 % (Benjamini and Hochberg 1995, section 4.1)
    p = [
        0.0001,
        0.0004,
        0.0019,
        0.0095,
        0.0201,
        0.0278,
        0.0298,
        0.0344,
        0.0459,
        0.3240,
        0.4262,
        0.5719,
        0.6528,
        0.7590,
        1.0,
    ]
    z = -ndtri(np.array(p) / 2)  # differences in units of their standard uncertainties, no cause in common
    found = judge(np.ones(z.size), 1 + z, Covariance(np.ones(z.size), np.empty((z.size, 0)), ()))
    assert list(np.flatnonzero(found.marked)) == [0, 1, 2, 3]


def test_models_compare_with_files_and_with_each_other() -> None:
    other = Side("other", "other.toml", model=build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": 40}))
    same = Side("same", "same.toml", model=GLOSS)
    data = side(measure(GLOSS, noise=0.01))

    def changed(found: Change) -> bool:
        return known(found.verdict).changed

    assert not changed(change(data, same))
    assert changed(change(data, other))
    assert changed(change(other, data))
    assert (change(data, same).onto, change(same, data).onto) == ("A", "B")
    both = change(same, other)
    assert both.verdict is None
    assert both.metrics["log_ratio"]
    assert np.all(change(same, same).difference == 0)


@pytest.mark.slow
def test_command_writes_a_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, seed in (("before", 5), ("after", 6)):
        measurement.write(measure(GLOSS, noise=0.01, reference=0.005, seed=seed, name=name), tmp_path / f"{name}.csv")
    (tmp_path / "gloss.toml").write_text(SAMPLE)
    before, after, model = (str(tmp_path / n) for n in ("before.csv", "after.csv", "gloss.toml"))
    commands.compare([before, after], tmp_path / "out", change=True)
    assert capsys.readouterr().out.strip() == str(tmp_path / "out" / "index.html")
    facts = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert facts["verdict"]["changed"] is False
    assert facts["conclusion"].startswith("No sign that the sample changed")
    assert f"{facts['verdict']['expected_beyond_2']:.1f} are expected by chance" in facts["conclusion"]
    with open(tmp_path / "out" / "tables" / "change.csv", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == facts["n_points"] == 99
    beyond = sum(abs(float(r["standard_deviations"])) > 2 for r in rows)
    assert beyond == facts["verdict"]["beyond_2"]
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert page.count("<svg") == len(facts["figures"]) == 3
    commands.compare([after, model], tmp_path / "model", change=True)
    assert "two disagree" in json.loads((tmp_path / "model" / "summary.json").read_text(encoding="utf-8"))["conclusion"]
    with pytest.raises(ConfigError, match="two"):
        commands.compare([before], tmp_path / "one", change=True)
    with pytest.raises(ConfigError, match="--ior has no part in --change"):
        commands.compare([before, after], tmp_path / "one", ior=["Al"], change=True)


def test_unused_rows_are_looked_up_once_whatever_the_number_of_wavelengths(monkeypatch: pytest.MonkeyPatch) -> None:
    """The whole table was read for each wavelength and incidence: 10^5 rows took a minute, and 10^6 hours."""
    parts = [measure(build("lambert", {"albedo": 0.4}), wavelength_nm=float(nm)) for nm in range(400, 500, 10)]
    table = pd.concat(parts, ignore_index=True)
    table.attrs = parts[0].attrs
    table.loc[[7, 200], "flag"] = "shadow"
    read: list[int] = []
    plain = pd.Series.to_numpy

    def counted(self: Any, *arguments: Any, **options: Any) -> Any:
        read.append(len(self))
        return plain(self, *arguments, **options)

    monkeypatch.setattr(pd.Series, "to_numpy", counted)
    data = observations(table, "a")
    read.clear()
    assert carry(data, data).rows.size == len(data) == len(table) - 2
    assert not read


def _drawn(a: pd.DataFrame, b: pd.DataFrame) -> list[Drawing]:
    found = change(side(a), side(b))
    at = replace(found.at, brdf=found.value_a, rows=np.arange(len(found.at)))
    return change_figures.draw(found, at, [], 550.0)


def test_maps_hold_what_differs_and_has_a_ratio() -> None:
    bare = measure(GLOSS, noise=0.01)
    bare[["u_brdf", "u_random"]] = np.nan
    other = bare.copy()
    other["brdf"] *= 1.1
    other.loc[other.index[:3], "brdf"] = [-1e-6, 0.0, -2e-6]  # they had the colour of no change
    (plane,) = _drawn(bare, other)
    assert "3 directions, in which A or B is not above 0, have no logarithm" in plane.caption
    assert _drawn(bare, bare.copy()) == []  # white everywhere: the headline says that they are alike


def test_a_shift_by_its_own_uncertainty_has_weighted_residuals_of_one() -> None:
    frame = measure(build("lambert", {"albedo": 0.5}), incidences=(30.0,))
    moved = frame.assign(brdf=frame["brdf"] + np.hypot(frame["u_brdf"], frame["u_brdf"]))
    moved.attrs = frame.attrs
    # both sides' uncertainties, all independent: whitened differences are 1 each
    assert change(side(frame), side(moved)).metrics["weighted"] == pytest.approx(1.0, rel=1e-6)
    assert change(side(frame), side(frame.copy())).metrics["weighted"] == 0.0
