"""Which model: the simplest that the data do not reject, and where the others fail."""

import json
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.profile_likelihood import profiles
from gonio_analysis.result_records import as_json
from gonio_analysis.selection import choice as choosing
from gonio_analysis.selection.choice import ModelChoice, candidates, choose
from gonio_analysis.selection.judging import Candidate, blocks, deviance
from gonio_analysis.selection.regions import incidences

from gonio.errors import ConfigError, DataError
from gonio.models import Lambert, OrenNayar, Phong, Retroreflecting, Sum, build
from gonio.progress import silent
from tests.gonio_analysis.synthetic import known, measure

MATTE = Lambert(0.5)
PAINT = build("cook-torrance", {"s": 0.1, "d": 0.9, "slopes": ((0.25, 1.0),), "diffuse_albedo": 0.4, "ior": 1.5})
SOME = ("lambert", "oren-nayar", "phong", "cook-torrance")


def decide(table: pd.DataFrame, models: Sequence[str] = SOME, **options: Any) -> ModelChoice:
    return choose(observations(table), [Candidate(m) for m in models], **options)


def test_the_simplest_that_fits_is_named_and_not_the_best() -> None:
    choice = decide(measure(MATTE, noise=0.01, seed=2), all_of_them=True)
    assert known(choice.named).candidate.model == "lambert"
    others = [j for j in choice.judged if j is not known(choice.named)]
    assert any(j.fit.chi_square < known(choice.named).fit.chi_square for j in others)  # type: ignore[operator]
    assert set(choice.intervals) == {"albedo"}
    assert "lambert is the simplest model" in choice.words
    json.dumps(as_json(choice), allow_nan=False)


def test_gloss_rejects_matte_models_where_it_shines() -> None:
    choice = decide(measure(PAINT, noise=0.01))
    assert known(choice.named).candidate.model == "cook-torrance"
    by_name = {j.candidate.model: j for j in choice.judged}
    assert by_name["lambert"].rejected.startswith("reduced chi-square")
    assert "mirror direction" in known(by_name["lambert"].fails).words
    assert by_name["lambert"].held_out > 10 * by_name["cook-torrance"].held_out  # type: ignore[operator]


def test_a_difference_below_the_noise_does_not_call_for_a_richer_model() -> None:
    # sigma = 2 degrees changes f by 0.1 %: a tenth of the noise
    choice = decide(measure(OrenNayar(albedo=0.5, sigma_deg=2.0), noise=0.01, seed=5))
    assert known(choice.named).candidate.model == "lambert"


def test_an_error_common_to_all_values_rejects_nothing() -> None:
    choice = decide(measure(MATTE, noise=0.005, reference=0.05, seed=3), ("lambert", "oren-nayar"))
    assert known(choice.named).candidate.model == "lambert"


def test_a_smooth_misfit_that_chi_square_overlooks_is_rejected_by_comparison() -> None:
    # sigma = 4 degrees changes f by up to 7 % near grazing: chi-square of 99 values with 3 % of noise stays possible
    choice = decide(measure(OrenNayar(albedo=0.5, sigma_deg=4.0), noise=0.03, seed=1), ("lambert", "oren-nayar"))
    lambert = choice.judged[0]
    assert known(lambert.fit.p_value) > 0.01
    assert "oren-nayar describes the same values better" in lambert.rejected
    assert choice.named is choice.judged[1]


def test_a_sum_is_told_from_its_terms() -> None:
    model = Sum((OrenNayar(albedo=0.36, sigma_deg=25.0), 1.0), (Phong(k_d=0.0, k_s=0.5, exponent=20), 0.4))
    choice = decide(measure(model, noise=0.005), ("lambert", "oren-nayar", "phong", "oren-nayar+phong"))
    assert known(choice.named).candidate.model == "oren-nayar+phong"
    true = {"albedo": 0.36, "sigma_deg": 25.0, "k_s": 0.2, "exponent": 20.0}
    # four intervals of 95 %: all hold the truth in 81 % of draws; this seed is one of those
    assert all(choice.intervals[n].holds(x) for n, x in true.items())


def test_where_everything_fails_nothing_is_named() -> None:
    choice = decide(measure(PAINT, noise=0.003, floor=0.0), ("lambert", "oren-nayar"))
    assert choice.named is None
    assert "reject every model" in choice.words
    assert choice.named is None


def test_without_uncertainties_models_are_only_compared() -> None:
    table = measure(PAINT, noise=0.01)
    table[["u_brdf", "u_random"]] = np.nan
    choice = decide(table, ("lambert", "cook-torrance"))
    assert known(choice.named).candidate.model == "cook-torrance"
    assert "nothing is accepted or rejected" in choice.words


def test_all_means_every_family_simplest_first() -> None:
    labels = [c.label for c in candidates(["all"])]
    assert labels[:6] == ["lambert", "oren-nayar", "phong", "blinn", "cook-torrance", "he-torrance"]
    assert {"cook-torrance, n + ik", "cook-torrance, two slopes", "oren-nayar+he-torrance, n + ik"} <= set(labels)
    assert not any("n + ik" in c.label for c in candidates(["all"], "Al"))
    with pytest.raises(ConfigError, match="nothing can stand beside it"):
        candidates(["all", "lambert"])
    with pytest.raises(ConfigError, match="a sum to fit"):
        candidates(["phong+lambert"])


def test_blocks_to_leave_out_are_neighbours() -> None:
    data = observations(measure(MATTE))
    groups, by = blocks(data)
    assert by == "angle of incidence"
    assert [round(float(np.degrees(a))) for a, _ in incidences(data.directions.theta_i)] == [10, 30, 60]
    assert sorted(np.concatenate(groups)) == list(range(len(data)))
    one = observations(measure(MATTE, incidences=(30.0,)))
    groups, by = blocks(one)
    assert by == "range of the detector's angle"
    assert sorted(np.concatenate(groups)) == list(range(len(one)))
    signed = np.where(one.directions.phi_r > 1, one.directions.theta_r, -one.directions.theta_r)
    assert all(np.ptp(signed[g]) < np.radians(160 / 4) for g in groups)


def fitted(**values: float) -> FitResult:
    """What a fit has found."""
    return cast(FitResult, SimpleNamespace(problem=SimpleNamespace(values=lambda vector: values), vector=None))


def test_sums_begin_at_the_fit_of_their_gloss() -> None:
    """With the level of its Lambertian part, of which Cook and Torrance take the share d = 1 - s."""
    gloss = fitted(s=0.2, diffuse_albedo=0.5, m=0.1)
    found = choosing._starts(Candidate("oren-nayar+cook-torrance"), {Candidate("cook-torrance"): gloss})
    known = {"s": 0.2, "diffuse_albedo": 0.5, "m": 0.1}
    assert found[0] is None, "a search of its own besides"
    for start, sigma_deg in zip(known_list(found[1]), (5.0, 25.0), strict=True):
        assert start == pytest.approx(known | {"albedo": 0.4, "sigma_deg": sigma_deg})
    found = choosing._starts(Candidate("oren-nayar+phong"), {Candidate("phong"): fitted(k_d=0.3, k_s=0.2, exponent=9)})
    assert known_list(found[1])[0]["albedo"] == 0.3
    assert choosing._starts(Candidate("oren-nayar+phong"), {}) == [None]
    assert choosing._starts(Candidate("phong"), {}) == [None]


def test_a_sum_that_ends_above_its_part_begins_there(monkeypatch: pytest.MonkeyPatch) -> None:
    table = measure(Phong(0.2, 0.3, 20.0), noise=0.01)
    part, begun = fit(table, "phong"), list[Any]()

    def ended(data: Any, asked: FitRequest, name: str) -> FitResult:
        begun.append(asked.start)
        return replace(part, whitened=part.whitened * (2.0 if len(begun) < 3 else 1.0))

    monkeypatch.setattr(choosing, "fit", ended)
    candidate, simpler = Candidate("oren-nayar+phong"), {Candidate("phong"): part}
    begin, parts = choosing._starts(candidate, simpler), choosing._contained(candidate, simpler)
    found, _ = choosing._fit(observations(table), candidate.request(None), begin, "", "", parts, silent)
    (start,) = begun[2]
    problem = pose(candidate.request(None))
    same = problem.model(problem.vector(start)).brdf(0.4, 0.0, 0.5, 3.0)
    assert same == pytest.approx(part.model.brdf(0.4, 0.0, 0.5, 3.0), rel=1e-12)  # rounding
    assert deviance(cast(FitResult, found)) == deviance(part)


def test_a_rejected_sum_reaches_the_chi_square_of_its_part() -> None:
    part = fit(measure(PAINT, noise=0.01), "lambert")
    above = replace(part, chi_square=known(part.chi_square) + 1.0)
    assert choosing._no_worse(above, [part]).chi_square == part.chi_square
    assert choosing._no_worse(part, [above]) is part


def test_of_fits_with_one_misfit_the_least_chi_square_is_stated() -> None:
    """One ended in a valley of the stated uncertainties alone; its misfit is less by rounding."""
    found = fit(measure(PAINT, noise=0.01), "lambert")
    misfit = known(found.misfit)
    other = replace(
        found, chi_square=known(found.chi_square) + 5.0, misfit=replace(misfit, tau=misfit.tau * (1 - 1e-12))
    )
    assert choosing._nearest([other, found]).chi_square == found.chi_square


def known_list(found: Any) -> list[dict[str, float]]:
    assert found is not None
    return list(found)


def test_an_absorbing_index_is_looked_for_from_four_metals_and_the_fit_without() -> None:
    model = Candidate("cook-torrance")
    (starts,) = map(known_list, choosing._starts(replace(model, free=("k",)), {model: fitted(ior=1.4, m=0.1)}))
    assert starts[0] == {"ior": 1.4, "m": 0.1}
    assert [(start["ior"], start["k"], start["m"]) for start in starts[1:]] == [
        (1.5, 0.3, 0.1), (0.3, 3.0, 0.1), (1.0, 7.0, 0.1), (3.0, 3.5, 0.1),
    ]  # fmt: skip


def test_one_model_is_not_counted() -> None:
    said: list[str] = []
    decide(measure(MATTE, noise=0.01), ("lambert",), name="matte", progress=said.append)
    assert said[0] == "matte: fitting lambert"


def test_too_few_values_are_no_choice_and_no_error() -> None:
    choice = decide(measure(MATTE, incidences=(0.0,), views=np.array([10.0])), ("lambert", "oren-nayar"))
    assert choice.named is None
    assert not choice.judged
    assert "1 usable value at 550 nm" in choice.words
    json.dumps(as_json(choice), allow_nan=False)
    # enough values, but a broad band has no wavelength for the model that needs one
    broad = measure(MATTE).assign(wavelength_nm=np.nan)
    with pytest.raises(DataError, match="he-torrance could not be fitted"):
        decide(broad, ("he-torrance",))


@pytest.mark.slow
def test_intervals_of_a_model_without_absorption_let_k_follow_where_the_data_do_not_tell_it() -> None:
    """Iron's n + ik and n = 4.6 reflect alike up to 60 degrees; the share of the gloss hangs on which it is."""
    iron = {"s": 0.3, "d": 0.7, "slopes": ((0.25, 1.0),), "diffuse_albedo": 0.4, "ior": 2.9 + 3.05j}
    views = np.arange(-70.0, 71.0, 10.0)
    data = observations(measure(build("cook-torrance", iron), views=views, noise=0.01, seed=2))
    choice = choose(data, [Candidate("cook-torrance"), Candidate("cook-torrance", ("k",))])
    assert known(choice.named).candidate.label == "cook-torrance"
    assert "let k follow" in choice.words
    alone = profiles(known(choice.named).fit).intervals
    assert not alone["s"].holds(0.3)
    for name, truth in {"s": 0.3, "m": 0.25, "diffuse_albedo": 0.4, "ior": 2.9, "k": 3.05}.items():
        assert choice.intervals[name].holds(truth), name
        if name in alone:  # an end may lie anywhere within `CLOSE` of the rise that it should have
            assert choice.intervals[name].low <= alone[name].low * (1 + 1e-12)
            assert choice.intervals[name].high >= alone[name].high * (1 - 1e-12)


def test_models_of_a_direction_are_tried_unasked_only_where_the_directions_tell() -> None:
    data = observations(measure(MATTE, noise=0.01))  # in plane, at one azimuth
    tried = [c for c in candidates(["all"]) if c.label in ("lambert", "anisotropic")]
    choice = choose(data, tried, all_of_them=True)
    assert set(choice.left_out) == {"anisotropic"}
    assert "one azimuth" in choice.left_out["anisotropic"]
    asked = choose(data, candidates(["anisotropic"]), all_of_them=True)
    assert [j.candidate.model for j in asked.judged] == ["anisotropic"]
    far = observations(measure(MATTE, noise=0.01, incidences=(60.0,), views=np.arange(-30.0, 31.0, 5.0)))
    tried = [c for c in candidates(["all"]) if c.label in ("lambert", "retroreflecting")]
    assert "direction of incidence" in choose(far, tried, all_of_them=True).left_out["retroreflecting"]


def test_a_retroreflecting_sample_is_described_by_its_own_model_and_by_no_other() -> None:
    true = Retroreflecting(0.2, 3.0, 1.6, 0.4, 0.3)
    table = measure(true, noise=0.01, incidences=(5.0, 30.0, 60.0), views=np.arange(-75.0, 76.0, 2.5))
    names = ("oren-nayar", "phong", "cook-torrance", "retroreflecting")
    choice = choose(observations(table), [Candidate(m) for m in names], all_of_them=True)
    assert known(choice.named).candidate.model == "retroreflecting"
    assert all(j.rejected for j in choice.judged if j is not known(choice.named))
    for name, value in true.parameters.items():
        e = known(choice.named).fit.parameters[name]
        assert abs(e.value - value) < 4 * known(e.u), name  # by chance once in 16 000
