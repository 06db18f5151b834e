"""Fits whose solution an engine finds count where they are certain, and otherwise say why they are not."""

from dataclasses import replace

import numpy as np
import pytest
from gonio_analysis.fitting.by_engine import SHORT, Engine, fit_by
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest

from gonio.models import OrenNayar
from gonio.typing import Floats
from tests.gonio_analysis.synthetic import measure

ASKED = FitRequest("oren-nayar")


def at(vector: Floats, rejected: bool = False) -> Engine:
    """An engine that always finds the same."""
    return lambda problem, data, wavelength_nm: (vector, rejected)


def test_a_solution_is_the_fit_and_one_that_is_none_is_not_taken() -> None:
    data = observations(measure(OrenNayar(albedo=0.5, sigma_deg=20.0)), polarised=True)
    known = fit(data, ASKED)
    found = fit_by(at(known.vector), data, ASKED)
    assert isinstance(found, FitResult)
    for name in known.free:
        one, other = found.parameters[name], known.parameters[name]
        assert one.u is not None
        assert other.u is not None
        # the last step is taken once more, from where it had ended: below its own error of 1e-4 u
        assert one.value == pytest.approx(other.value, abs=1e-4 * other.u)
        assert one.u == pytest.approx(other.u, rel=1e-4)
    assert found.chi_square == pytest.approx(known.chi_square)
    beside = known.vector + 3.0 * SHORT * np.sqrt(np.diag(known.spread))
    assert fit_by(at(beside), data, ASKED) == "an unsettled solution"
    assert fit_by(at(known.vector, rejected=True), data, ASKED) == "a rejected model"
    assert fit_by(lambda *_: None, data, ASKED) == "a model or parameters that the engine of maps does not have"


def test_what_an_engine_does_not_do_is_said_before_it_is_asked() -> None:
    data = observations(measure(OrenNayar(albedo=0.5, sigma_deg=20.0)), polarised=True)

    def never(*_: object) -> None:
        raise AssertionError

    for other, asked, said in (
        (replace(data, covariance=None), ASKED, "no stated uncertainties"),
        (replace(data, zeros_rad={"theta_i_zero": 1e-3}), ASKED, "angles whose zeros are uncertain"),
        (data.take(np.arange(2)), ASKED, "too few values"),
        (data, replace(ASKED, priors={"albedo": (0.5, 0.1)}), "another metric, loss, bound or prior"),
    ):
        assert fit_by(never, other, asked) == said
