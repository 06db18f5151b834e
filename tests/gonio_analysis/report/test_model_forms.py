"""Cheaper forms of the model that is put first, in the directions of a sample."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from gonio_analysis.fitting.observations import observations
from gonio_analysis.report.model_forms import found, words

from gonio.models import HeTorrance, Lambert, Model, OrenNayar
from tests.gonio_analysis.synthetic import measure


def sample(model: Model) -> Any:
    """What of a report's sample is asked for."""
    data = observations(measure(Lambert(0.5), incidences=(20.0, 50.0)))
    return SimpleNamespace(
        best="this", models={"this": SimpleNamespace(fit=SimpleNamespace(model=model, data=data, name="this"))}
    )


def test_forms_are_held_against_the_dearest() -> None:
    exact, *cheaper = found(sample(OrenNayar(0.8, 25.0)))  # a functional fit: the integral is what counts
    assert (exact["form"], exact["off"]) == ("", 0.0)
    assert [one["form"] for one in cheaper] == ["qualitative", "functional"]
    assert cheaper[1]["off"] < cheaper[0]["off"]
    assert 0.001 < cheaper[1]["off"] < 0.06  # the notes on the paper: 5 % over all directions
    said = words([exact | {"wall_s": 1e-5}, cheaper[1] | {"wall_s": 2e-6}])
    assert len(said) == 1
    assert said[0].startswith("this (functional) is within ")
    assert said[0].endswith("at 20 % of the cost of an evaluation.")
    assert words([exact | {"wall_s": 1e-5}, cheaper[1] | {"wall_s": 9.5e-6}]) == []


def test_tiers_of_the_series_and_models_of_one_form() -> None:
    _, *tiers = found(sample(HeTorrance(0.28, 1.77, 1.5)))
    assert [one["form"] for one in tiers] == ["tolerance 1e-06", "tolerance 1e-09"]
    np.testing.assert_array_less([one["off"] for one in tiers], [1e-5, 1e-8])  # its bounds, with its conditioning
    assert found(sample(Lambert(0.5))) == []
