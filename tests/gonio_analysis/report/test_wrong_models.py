"""A report of a sample that no model has: how far off models are, on its first line, in its tables and on its plots."""

import html
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.energy import combined
from gonio_analysis.fitting.fit import fit
from gonio_analysis.report import write
from gonio_analysis.report.facts import DatasetSummary
from gonio_analysis.report.verdict import of_fit
from gonio_analysis.result_records import MisfitSummary, Reflectance
from gonio_analysis.selection.compare import examine

from gonio.geometry import Directions
from tests.command_line import some

from .. import synthetic
from ..fitting.test_misfit import facets, of_facets
from ..synthetic import measure
from .test_verdict import PAINT

pytestmark = pytest.mark.slow  # a report of eight models is made once for all

MODELS = ("lambert", "oren-nayar", "blinn", "cook-torrance")
OFF = r"(off by )?[\d.]+ % (too high|too low|either way,)"
SAID = re.compile(
    r"^(?P<model>\S+) is (the nearest of the 4 models tried|the simplest of the models that cannot be told apart from"
    r" the nearest, \S+): it describes this sample to [\d.]+ % \([\d.]+ to [\d.]+\), worst "
    + OFF
    + r" (on the retro side|between normal and mirror|around the mirror direction|beyond the mirror direction)"
    r" at θi = \d+°( \(in one direction it is [^)]*\))?\."
)


def facts_of(table: pd.DataFrame, *models: str, **options: Any) -> DatasetSummary:
    return synthetic.facts_of(examine(table, models, name="facets", **options))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, str]:
    folder = tmp_path_factory.mktemp("wrong")
    write([examine(of_facets(7, "in plane")[0], MODELS, name="facets")], folder, title="facets")
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    text = re.sub(r"<[^>]+>", " ", (folder / "index.html").read_text(encoding="utf-8"))
    return (summary, Path(folder)), re.sub(r"\s+", " ", html.unescape(text))


@pytest.mark.slow
def test_the_first_line_says_how_far_off_the_nearest_is_and_where(page: tuple[Any, str]) -> None:
    (summary, _), text = page
    (facts,) = summary["datasets"]
    found = SAID.match(facts["conclusion"])
    assert found, facts["conclusion"]
    assert found["model"] == facts["best"]
    assert facts["choice"]["words"].startswith(found[0])
    assert "p < " not in facts["conclusion"]
    assert facts["conclusion"].replace("\u00a0", " ")[:60] in text
    near = list(facts["choice"]["near"])
    tried = [c["label"] for c in facts["choice"]["candidates"]]
    assert facts["best"] == min(near, key=tried.index), "of those that are as near, the simplest is named"
    assert facts["choice"]["named"] is None, "the data reject all of them"


def test_every_model_has_its_misfit_in_the_summary_and_in_both_tables(page: tuple[Any, str]) -> None:
    (summary, _), text = page
    (facts,) = summary["datasets"]
    for name, model in facts["models"].items():
        misfit = model["misfit"]
        low, high = misfit["interval"]
        assert 0 < low < misfit["value"] < high, name
        assert misfit["u"] > 0
        assert model["reduced_chi_square"] > 1
        cell = MisfitSummary(misfit["value"], misfit["u"], (low, high)).words
        assert text.replace("\u00a0", " ").count(cell) >= 2, f"{name}: {cell} stands in the choice and in the models"
    by = {c["label"]: c for c in facts["choice"]["candidates"]}
    for name, model in facts["models"].items():
        assert by[name]["reduced_chi_square"] == model["reduced_chi_square"], "one chi-square a model and wavelength"
        assert by[name]["misfit"] == model["misfit"]
    assert not facts["choice"]["intervals"], "an interval of a true model has no place here"


def test_plots_have_a_band_of_tau(page: tuple[Any, str]) -> None:
    (summary, folder), _ = page
    for name, caption in {f["name"]: f["caption"] for f in summary["figures"]}.items():
        if "-polar-" in name or "-absolute-" in name:
            assert "Light band: theory and its misfit, " in caption, name
            assert "opacity: 0.14" in (folder / "figures" / f"{name}.svg").read_text(encoding="utf-8"), name


def test_a_true_model_has_no_band_and_says_what_would_go_unnoticed() -> None:
    facts = facts_of(measure(PAINT, noise=0.01, seed=3), "lambert", "cook-torrance")
    assert facts.best == some(facts.choice.named).candidate.label == "cook-torrance"
    assert facts.conclusion.startswith(
        "cook-torrance describes the values within their uncertainties, the simplest of the 2 models tried that does"
    )
    misfit = some(facts.models["cook-torrance"].fit.tau)
    assert (misfit.value, misfit.interval[0]) == (0.0, 0.0)
    said = r" A misfit of at most 0\.\d+ % that is smooth over 20° would go unnoticed in half of the cases\."
    assert re.search(said, facts.conclusion)
    assert facts.rho_dh_combined == []


def test_rho_dh_over_models_that_cannot_be_told_apart() -> None:
    def one(value: float, u: float) -> list[Reflectance]:
        return [Reflectance(8.0, 9.0, 9.0, "", with_misfit=value, u_with_misfit=u)]

    (found,) = combined([(1.0, one(0.30, 0.003)), (0.5, one(0.33, 0.006))])
    mean = (0.30 + 0.5 * 0.33) / 1.5
    square = (0.003**2 + (0.30 - mean) ** 2) / 1.5 + 0.5 * (0.006**2 + (0.33 - mean) ** 2) / 1.5
    assert found.rho_dh == pytest.approx(mean, rel=1e-12)  # sums of four numbers
    assert found.u == pytest.approx(math.sqrt(square), rel=1e-12)
    assert combined([]) == []
    assert combined([(1.0, [Reflectance(8.0, 0.0, None, "the model reflects nothing")])]) == []


def test_the_combined_rho_dh_of_facets_is_theirs(page: tuple[Any, str]) -> None:
    (summary, _), _ = page
    (facts,) = summary["datasets"]
    _, of = of_facets(7, "in plane")
    for r in facts["rho_dh_combined"]:
        # the midpoint rule over 400 x 400 directions of equal projected solid angle: to 1e-4 for lobes as wide as these
        n = 400
        s = (np.arange(n) + 0.5) / n
        theta_r, phi_r = (a.ravel() for a in np.meshgrid(np.arcsin(np.sqrt(s)), 2 * np.pi * s, indexing="ij"))
        same = np.full(theta_r.size, math.radians(r["theta_i_deg"]))
        true = math.pi * float(
            facets(of["alpha"], of["f0"], of["rho"], Directions(same, 0 * same, theta_r, phi_r)).mean()
        )
        # the plan knows the plane of incidence alone; four standard deviations, for incidences share their errors
        assert abs(r["rho_dh"] - true) < 4 * math.hypot(r["u"], 0.002 * true), (r, true)


def test_gonio_fit_says_how_far_off_and_where() -> None:
    said = of_fit(fit(of_facets(7, "in plane")[0], "cook-torrance"))
    assert re.match(r"describes the values to [\d.]+ % \([\d.]+ to [\d.]+\), worst " + OFF, said)
    assert "; reduced chi-square " in said
    true = of_fit(fit(measure(PAINT, noise=0.01, seed=3), "cook-torrance"))
    assert re.match(r"reduced chi-square [\d.]+: not rejected", true)
    assert "would go unnoticed" in true


@pytest.mark.parametrize("how", [{"metric": "weighted"}, {"loss": "soft_l1"}])
def test_a_chosen_metric_or_loss_states_no_misfit_and_says_so(how: dict[str, Any]) -> None:
    result = fit(of_facets(7, "in plane")[0], "cook-torrance", **how)
    assert result.rejected
    assert result.tau is None
    assert any("standard errors are those of a true model, and too small" in note for note in result.notes)
