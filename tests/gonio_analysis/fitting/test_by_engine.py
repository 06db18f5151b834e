"""Fits whose solution an engine finds count where they are certain, and otherwise say why they are not."""

from dataclasses import replace

import numpy as np
import pytest
from gonio_analysis.fitting.by_engine import SHORT, Engine, fit_by
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest

from gonio.models import CookTorrance, OrenNayar
from gonio.typing import Floats
from tests.gonio_analysis.synthetic import measure

ASKED = FitRequest("oren-nayar")


def at(vector: Floats, least: float = 0.0, rejected: bool = False) -> Engine:
    """An engine that always finds the same."""
    return lambda problem, data, wavelength_nm: (vector, least, rejected)


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
    assert known.chi_square is not None
    assert found.chi_square == pytest.approx(known.chi_square)
    beside = known.vector + 3.0 * SHORT * np.sqrt(np.diag(known.spread))
    assert fit_by(at(beside), data, ASKED) == "an unsettled solution"
    # a chi-square that the engine has found, and no search from what it calls near
    assert fit_by(at(known.vector, 0.9 * known.chi_square, rejected=True), data, ASKED) == "a rejected model"
    assert fit_by(lambda *_: None, data, ASKED) == "a model or parameters that the engine of maps does not have"


@pytest.mark.parametrize("reference", [0.0, 0.01])
def test_a_rejected_model_goes_on_from_the_nearest_one(reference: float, monkeypatch: pytest.MonkeyPatch) -> None:
    gloss = CookTorrance(s=0.4, d=0.6, m=0.3, diffuse_albedo=0.5, ior=1.5)
    data, asked = observations(measure(gloss, reference=reference), polarised=True), FitRequest("ggx")
    known = fit(data, asked)
    assert known.rejected
    assert known.chi_square is not None
    monkeypatch.setattr("gonio_analysis.fitting.fit.search", None)  # none begins
    found = fit_by(at(known.vector, 2.0 * known.chi_square, rejected=True), data, asked)
    assert isinstance(found, FitResult)
    assert found.misfit is not None
    assert known.misfit is not None
    # searches end where a step gains 1e-10 of chi-square, which from another side is another place: a part of 1e-5 in
    # standard errors, and as much in weights that are scaled to the model
    assert found.chi_square == pytest.approx(known.chi_square, rel=1e-6)
    assert found.misfit.tau == pytest.approx(known.misfit.tau, rel=1e-4)
    for name in known.free:
        u = known.parameters[name].u
        assert u is not None
        assert found.parameters[name].value == pytest.approx(known.parameters[name].value, abs=1e-3 * u)
        assert found.parameters[name].u == pytest.approx(u, rel=1e-3)


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
