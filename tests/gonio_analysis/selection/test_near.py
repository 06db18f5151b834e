"""Which models are as near as the nearest, where no one is true: by what they predict, and by their own misfit."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.observations import observations
from gonio_analysis.report.verdict import disagreement
from gonio_analysis.selection.choice import choose
from gonio_analysis.selection.judging import Candidate, Judged, _near, _reject, few_incidences
from gonio_analysis.selection.regions import incidences

from gonio.geometry import Directions
from gonio.measurement import read
from gonio.models import Lambert
from tests.gonio_analysis.synthetic import known, measure
from tests.places import measured

VIEWS = np.arange(-70.0, 71.0, 10.0)
AT = Directions.from_degrees(np.repeat([12.0, 33.0, 57.0], VIEWS.size), 0.0, np.tile(np.abs(VIEWS), 3), 180.0)


def judged(label: str, tau: float, misses: list[float], u_log: float = 0.2) -> Judged:
    """A model with its misfit, and its mean squared error at each of three incidences when that was left out."""
    data = SimpleNamespace(directions=AT, covariance=None)
    misfit = SimpleNamespace(tau=tau, u_log=u_log, small=0.01)
    fit = SimpleNamespace(data=data, misfit=misfit, predicted=np.ones(len(AT.theta_i)), p_value=None)
    return Judged(Candidate(label), cast(Any, fit), 0.0, 0.0, None, np.repeat(misses, VIEWS.size), None)


# errors of the left-out incidences by which three of them tell nothing: the better one loses at one incidence
LOBE, FLAT = [0.02, 4.0, 0.5], [1.9, 1.0, 2.2]


@pytest.mark.parametrize("u_log", [0.1, 0.3, 5.0])
def test_a_model_that_misses_by_a_factor_is_not_as_near_however_little_is_left_out(u_log: float) -> None:
    both = [judged("lambert", 1.3, FLAT), judged("tape", 0.27, LOBE, u_log)]
    assert list(_near(both)) == ["tape"]
    alike = [judged("lambert", 0.34, FLAT), judged("tape", 0.27, LOBE, u_log)]
    assert set(_near(alike)) == {"lambert", "tape"}  # else the factor has excluded nothing


def test_a_model_that_predicts_best_by_chance_is_not_nearest_by_that_alone() -> None:
    both = [judged("lambert", 1.3, [1.0, 1.0, 1.0]), judged("tape", 0.27, [0.05, 9.0, 0.5])]
    assert list(_near(both)) == ["tape"]
    (worse,) = (j.rejected for j in _reject(both) if j.rejected)
    assert worse == "its misfit is 4.8 times that of tape"


def test_a_misfit_that_noise_hides_tells_no_models_apart() -> None:
    table = measure(Lambert(0.5), noise=0.1, floor=0.0, incidences=(20.0, 45.0), views=VIEWS)
    data, near = observations(table), {"one": 1e-6, "other": 1e-3}
    both = []
    for label, tau in near.items():
        fit = SimpleNamespace(data=data, misfit=SimpleNamespace(tau=tau, u_log=0.2, small=0.01), predicted=data.brdf)
        both.append(Judged(Candidate(label), cast(Any, fit), 0.0, 0.0, None, np.ones(len(data)), None))
    assert set(_near(both)) == set(near)


def test_few_incidences_are_named() -> None:
    for count, words in ((1, "One angle of incidence"), (3, "Three angles of incidence"), (7, "")):
        theta_i = tuple(np.linspace(5.0, 65.0, count))
        data = observations(measure(Lambert(0.5), incidences=theta_i, views=VIEWS))
        assert few_incidences(data) == words


@pytest.mark.slow
def test_three_incidences_of_a_tape_do_not_make_a_model_without_retroreflection_as_near() -> None:
    data = observations(read(measured("brdf/cea_retro/retro-3M-jaune.dat")))
    assert len(incidences(data.directions.theta_i)) == 3
    names = ("phong", "cook-torrance", "retroreflecting+cook-torrance")
    choice = choose(data.take(np.arange(0, len(data), 18)), [Candidate(m) for m in names], all_of_them=True)
    assert list(choice.near) == ["retroreflecting+cook-torrance"]
    # by model and by the measurement itself: of two incidences that lean on the same values, 2.58 for 1 % of tables
    fits = {j.candidate.label: j.fit for j in choice.judged}
    found = energy.combined([(weight, energy.of_model(fits[name])) for name, weight in choice.near.items()])
    together = {round(r.theta_i_deg): r for r in found}
    compared = [(r, together[round(r.theta_i_deg)]) for r in energy.of_table(data) if r.rho_dh is not None]
    assert len(compared) == 2, "the third incidence leaves a fifth of the hemisphere open"
    for of_table, of_models in compared:
        off = known(of_models.rho_dh) - known(of_table.rho_dh)
        assert abs(off) < 2.58 * np.hypot(known(of_models.u), known(of_table.u))


@pytest.mark.parametrize("best", ["a", "b"])
def test_metrics_that_all_name_one_model_do_not_disagree_whichever_a_page_picks(best: str) -> None:
    agreed = {"a": {"log_ratio": 0.1, "ngan": 0.2, "cube_root": 0.1}, "b": {"log_ratio": 0.3, "ngan": 0.5}}
    assert disagreement(agreed, best) == ""


def test_metrics_that_name_different_models_disagree() -> None:
    metrics: dict[str, dict[str, float | None]] = {
        "a": {"log_ratio": 0.1, "ngan": 0.5, "cube_root": 0.4},
        "b": {"log_ratio": 0.3, "ngan": 0.2, "cube_root": 0.1},
        "c": {"log_ratio": 0.2, "ngan": 0.3, "cube_root": 0.2},
    }
    said = disagreement(metrics, "c")
    assert "a is nearest by log ratio (c is 2 times as far off by it)" in said
    assert "b is nearest by " in said
    alike = {"a": {"log_ratio": 0.1, "ngan": 0.102}, "b": {"log_ratio": 0.2, "ngan": 0.1}}
    assert disagreement(alike, "b") == ""  # two percent are no disagreement: a is nearest, or as near, by both
