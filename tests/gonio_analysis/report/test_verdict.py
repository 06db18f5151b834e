"""What a headline may say where nobody stated an uncertainty."""

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.report import model_tables
from gonio_analysis.report.blocks import Heading, plain
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.selection.compare import examine

from gonio.errors import ConfigError
from gonio.models import build
from tests.command_line import says, some
from tests.gonio_analysis.synthetic import facts_of, measure

PAINT = build("cook-torrance", {"s": 0.1, "d": 0.9, "slopes": ((0.25, 1.0),), "diffuse_albedo": 0.4, "ior": 1.5})


def bare(model: Any = PAINT, **options: Any) -> pd.DataFrame:
    """A measurement that states no uncertainty."""
    frame = measure(model, floor=0.0, **options)
    frame[["u_brdf", "u_random"]] = np.nan
    return frame


def headline(frame: pd.DataFrame, *models: str, **options: Any) -> DatasetSummary:
    return facts_of(examine(frame, models, name="paint", **options))


@pytest.mark.slow
def test_without_uncertainties_nothing_is_not_rejected() -> None:
    facts = headline(bare(noise=0.03), "lambert", "cook-torrance")
    words = facts.conclusion + facts.choice.words
    assert "not rejected" not in words
    assert "do not reject" not in words
    assert facts.conclusion.startswith("cook-torrance is the nearest of the 2 models")
    assert "--u-rel 0.03" in facts.conclusion
    misfit = some(facts.models["cook-torrance"].fit.tau)
    assert misfit.value == pytest.approx(0.03, rel=0.3)  # the noise, which nobody stated; of 95 it is known to 7 %
    assert f"describes this sample to {misfit.words}, worst " in facts.conclusion


@pytest.mark.slow
def test_models_that_are_far_off_do_not_describe_the_sample() -> None:
    mirror = build("cook-torrance", {"s": 0.9, "d": 0.1, "slopes": ((0.1, 1.0),), "diffuse_albedo": 0.05, "ior": 3.0})
    facts = headline(bare(mirror), "lambert", "oren-nayar")
    best = facts.models[facts.best or ""]
    assert best.fit.tau is not None
    assert best.fit.tau.value > math.log(2)
    assert f"misses this sample by a factor of {math.exp(best.fit.tau.value):.2g} (" in facts.conclusion
    where, zone = some(best.missed).words.split(", ")
    assert f"{zone} at {where}" in facts.conclusion


@pytest.mark.slow
def test_a_missing_lobe_is_named_though_the_typical_factor_is_small() -> None:
    """A narrow lobe is few of the values: the typical factor alone would overlook it."""
    shiny = build("cook-torrance", {"s": 0.4, "d": 0.6, "slopes": ((0.03, 1.0),), "diffuse_albedo": 0.5, "ior": 1.5})
    views = np.concatenate([np.linspace(-80, 80, 400), [29.0, 30.0, 31.0]])
    facts = headline(bare(shiny, incidences=(30.0,), views=np.sort(views)), "lambert")
    assert "lambert is the only model tried: it misses this sample by a factor of " in facts.conclusion
    assert "worst off by a factor of" in facts.conclusion  # too low on top, too high beside it
    assert "around the mirror direction" in facts.conclusion


@pytest.mark.slow
def test_metrics_that_disagree_are_named() -> None:
    # the base of the truth is Oren-Nayar's, its peak Phong's: logarithms follow the one, differences the other
    matte = {"weight": 1, "albedo": 0.5, "sigma_deg": 50}
    truth = build("sum", {"oren-nayar": matte, "phong": {"k_d": 0, "k_s": 0.5, "exponent": 5000}})
    views = np.sort(np.concatenate([np.linspace(-80, 80, 200), [10.0, 60.0]]))
    facts = headline(bare(truth, incidences=(10.0, 60.0), views=views), "oren-nayar", "phong")
    log = {m: f.metrics["log_ratio"] or 0 for m, f in facts.models.items()}
    high = {m: f.metrics["ngan"] or 0 for m, f in facts.models.items()}
    assert min(log, key=log.__getitem__) != min(high, key=high.__getitem__)  # else there is nothing to say
    says(facts.conclusion, "metrics disagree", "is nearest by")


@pytest.mark.slow
def test_an_assumed_uncertainty_judges_and_is_called_assumed() -> None:
    facts = headline(bare(noise=0.03), "lambert", "cook-torrance", u_rel=0.03)
    assert facts.data.u_rel_assumed == 0.03
    assert facts.uncertainty_stated is False
    f = facts.models["cook-torrance"]
    # 95 degrees of freedom: 1 +- 0.145; 3.4 of them
    assert f.fit.reduced_chi_square == pytest.approx(1.0, abs=0.5)
    assert "assumed uncertainty of 3 %" in facts.conclusion
    assert "assumed uncertainty of 3 %" in facts.choice.words
    assert any("ASSUMED" in n for n in facts.notes)
    assert facts.models["lambert"].fit.verdict.startswith("rejected")
    assert facts.budget == []


def test_an_assumed_uncertainty_gives_the_standard_errors_that_a_stated_one_does() -> None:
    stated = measure(PAINT, noise=0.03, floor=0.0)
    assumed = fit(bare(noise=0.03), "cook-torrance", u_rel=0.03)
    for name, e in fit(stated, "cook-torrance").parameters.items():
        if not e.fixed:
            assert e.u is not None
            # weights from noisy values of 3 % against logarithms: a tenth of a standard error or so
            assert assumed.parameters[name].value == pytest.approx(e.value, abs=0.5 * e.u)
            assert assumed.parameters[name].u == pytest.approx(e.u, rel=0.1)


def test_a_table_with_uncertainties_keeps_its_own() -> None:
    result = fit(measure(PAINT), "lambert", u_rel=0.5)
    assert result.data.u_rel_assumed is None
    assert any("is not used" in n for n in result.notes)


@pytest.mark.parametrize("u_rel", [0.0, -1.0, 3.0, math.nan])
def test_an_assumed_uncertainty_is_a_share(u_rel: float) -> None:
    with pytest.raises(ConfigError, match="--u-rel"):
        fit(bare(), "lambert", u_rel=u_rel)


def test_metrics_minimise_what_they_are_named_for() -> None:
    table = bare(noise=0.05)
    found = {m: headline(table, "phong", metric=m).models["phong"] for m in ("log", "ngan", "cube-root", "relative")}
    for name, key in {"log": "log_ratio", "ngan": "ngan", "cube-root": "cube_root", "relative": "relative"}.items():
        own = some(found[name].metrics[key])
        # a thousandth: the logarithmic fit bends into differences where values are small
        assert all(own <= 1.001 * (f.metrics[key] or math.inf) for f in found.values()), name
        assert found[name].fit.goal.metric == name


def test_a_metric_that_is_none_or_that_lacks_uncertainties_is_refused() -> None:
    with pytest.raises(ConfigError, match="--metric nan"):
        fit(bare(), "lambert", metric="nan")
    with pytest.raises(ConfigError, match="--u-rel"):
        fit(bare(), "lambert", metric="weighted")


def test_a_metric_without_weights_gives_no_chi_square() -> None:
    result = fit(measure(PAINT), "cook-torrance", metric="ngan")
    assert result.chi_square is None
    assert "does not weigh" in result.verdict


@pytest.mark.slow
def test_the_headline_and_the_choice_name_the_same_model_as_the_nearest() -> None:
    """Phong's lobe takes up some scatter of a matte sample; AIC counts its parameters, a bare metric does not."""
    frame = bare(build("lambert", {"albedo": 0.5}), noise=0.2)
    facts = headline(frame, "lambert", "oren-nayar", "phong")
    aic = {j.candidate.label: j.aic for j in facts.choice.judged}
    logs = {name: f.metrics["log_ratio"] or math.inf for name, f in facts.models.items()}
    assert min(aic, key=aic.__getitem__) != min(logs, key=logs.__getitem__)  # else there is nothing to tell apart
    first = next(iter(facts.choice.near))
    assert set(facts.choice.near) == set(facts.models)  # noise of 20 % hides what tells them apart
    named = some(facts.choice.named)
    assert facts.best == named.candidate.label == "lambert", "the simplest of them"
    said = f"lambert is the simplest of the models that cannot be told apart from the nearest, {first}: it describes"
    if first == "lambert":
        said = "lambert is the nearest of the 3 models tried: it describes"
    assert facts.choice.words.startswith(said)
    assert facts.conclusion.startswith(said)
    by = headline(frame, "lambert", "oren-nayar", "phong", metric="ngan")
    assert by.best is not None
    assert by.choice.words.startswith(f"{by.best} comes nearest")
    assert by.conclusion.startswith(f"{by.best} is the nearest")


@pytest.mark.slow
def test_the_column_of_misfits_says_what_it_ranks_by() -> None:
    for frame in (measure(PAINT, noise=0.03), bare(noise=0.03)):
        facts = headline(frame, "lambert", "oren-nayar")
        found = model_tables.compared(facts)
        header = list(map(plain, found.header))
        judged = {one.candidate.label: one for one in facts.choice.judged}
        assert header[2:4] == ["off by", "worst"]
        for row in found.rows:
            label, off, worst = (plain(row[k]).replace("\u00a0", " ") for k in (0, 2, 3))
            assert off == some(judged[label].fit.tau).words
            assert not worst or some(judged[label].fails).off == worst, "the number of the headline, and no second one"
        assert any(plain(row[3]) for row in found.rows)


@pytest.mark.slow
def test_of_many_models_the_best_stand_beside_the_plot_and_all_in_a_fold(monkeypatch: pytest.MonkeyPatch) -> None:
    facts = headline(measure(PAINT, noise=0.03), "lambert", "oren-nayar")
    every = model_tables.compared(facts)
    assert model_tables.beside_plot(facts) == every
    assert model_tables.below_plot(facts) == []
    monkeypatch.setattr(model_tables, "FEW", len(every.rows) - 1)
    monkeypatch.setattr(model_tables, "NEAR", 1)
    few = model_tables.beside_plot(facts)
    assert list(map(plain, few.header)) == ["model", "free", "off by", "verdict"]
    assert [plain(row[0]) for row in few.rows] == list(few.draws) == [facts.best]
    heading, table = model_tables.below_plot(facts)
    assert isinstance(heading, Heading)
    assert heading.text == f"All {len(every.rows)} models"
    assert table == every


def test_a_value_of_zero_does_not_make_a_table_silent() -> None:
    frame = measure(PAINT, noise=0.03)
    frame.loc[frame.index[0], "brdf"] = 0.0
    facts = headline(frame, "lambert", metric="log")
    assert facts.uncertainty_stated
    assert facts.median_u_rel == pytest.approx(0.03, rel=0.05)  # the floor adds a little to the noise
