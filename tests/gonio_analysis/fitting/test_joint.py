"""Several wavelengths in one fit: what is shared is known better, what is not keeps its own value."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting import search
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest, pose, together
from gonio_analysis.fitting.profile_likelihood import profiles

from gonio.errors import ConfigError
from gonio.models import build
from tests.gonio_analysis.synthetic import joined, known, measure

WAVES = {450.0: 0.10, 550.0: 0.20, 650.0: 0.30}
SURFACE = {"sigma0_um": 0.28, "tau_um": 1.77, "ior": 0.77 + 6.08j}


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """One rough surface whose diffuse albedo grows with the wavelength."""
    parts = [
        measure(build("he-torrance", {**SURFACE, "diffuse_albedo": a}), wavelength_nm=w, noise=0.01, seed=int(w))
        for w, a in WAVES.items()
    ]
    return joined(*parts)


def test_shared_parameters_are_known_better_and_others_by_wavelength(table: pd.DataFrame) -> None:
    one = fit(table, "he-torrance", ior=SURFACE["ior"])
    r = fit(table, "he-torrance", ior=SURFACE["ior"], each=["diffuse_albedo"])
    assert r.free == ("sigma0_um", "tau_um", *(f"diffuse_albedo@{w:g}" for w in WAVES))
    for n in ("sigma0_um", "tau_um"):
        e = r.parameters[n]
        assert abs(e.value - SURFACE[n]) < 3.5 * known(e.u)
        assert known(e.u) < known(one.parameters[n].u)
    for w, a in WAVES.items():
        e = r.parameters[f"diffuse_albedo@{w:g}"]
        assert abs(e.value - a) < 3.5 * known(e.u)
    assert len(r.data) == len(table)
    assert r.reduced_chi_square == pytest.approx(1.0, abs=0.35)  # 292 degrees of freedom: +- 0.083; 4 of them
    assert any("3 wavelengths are fitted together" in note for note in r.notes)
    assert math.isnan(r.wavelength_nm)
    low, high = (end for end, _ in profiles(r, ("diffuse_albedo@550",)).intervals["diffuse_albedo@550"].ends)
    assert low < r.parameters["diffuse_albedo@550"].value < high


def test_all_shared_where_the_sample_changes_is_rejected(table: pd.DataFrame) -> None:
    r = fit(table, "he-torrance", ior=SURFACE["ior"], each=[])
    assert r.free == ("sigma0_um", "tau_um", "diffuse_albedo")
    assert known(r.p_value) < 1e-6  # no chance: the albedo changes from wavelength to wavelength


def test_what_cannot_be_fitted_together_is_named(table: pd.DataFrame) -> None:
    with pytest.raises(ConfigError, match="fitted are albedo"):
        fit(table, "lambert", each=["sigma_deg"])
    with pytest.raises(ConfigError, match="takes two or more"):
        fit(table[table["wavelength_nm"] == 550.0], "lambert", each=[])
    with pytest.raises(ConfigError, match="leave it out"):
        fit(table, "lambert", each=[], wavelength_nm=550)
    with pytest.raises(ConfigError, match="prior of albedo"):
        fit(table, "lambert", each=["albedo"], priors={"albedo": (0.5, 0.1)})


def test_values_at_each_wavelength_cost_no_evaluation_of_their_own(
    table: pd.DataFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = together(pose(FitRequest("oren-nayar")), list(WAVES), ["albedo"])
    data = observations(table)
    vector = problem.vector({"sigma_deg": 20.0, **{f"albedo@{w:g}": a for w, a in WAVES.items()}})
    calls = []

    def counted(*arguments: Any, **options: Any) -> Any:
        calls.append(1)
        return apparent(*arguments, **options)

    monkeypatch.setattr(search, "apparent", counted)
    columns = search.derivatives(problem, data, vector)
    assert len(calls) == 4  # two central differences: of sigma, and of the albedos of all wavelengths
    quick = search.derivatives(problem, data, vector, here=apparent(problem.model(vector), data, quick=True))
    assert len(calls) == 6
    for k in range(vector.size):
        up, down = vector.copy(), vector.copy()
        up[k] += search.STEP
        down[k] -= search.STEP
        high, low = (apparent(problem.model(x), data) for x in (up, down))
        np.testing.assert_allclose(columns[:, k], (high - low) / (2 * search.STEP), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(quick[:, k], columns[:, k], rtol=1e-4, atol=1e-6)  # a one-sided step of 1e-6
    np.testing.assert_array_equal(search.derivatives(problem, data, vector, only=[2, 0]), columns[:, [2, 0]])
