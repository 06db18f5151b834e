"""Reflectances of models and of measurements, and the symmetries of a table."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting import energy
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.observations import observations
from gonio_analysis.report.comparison import summarise
from gonio_analysis.selection.compare import examine

from gonio.checks.symmetry import symmetries
from gonio.formats.reader import table
from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure

MATTE = build("lambert", {"albedo": 0.5})
ROUGH = build("oren-nayar", {"albedo": 0.6, "sigma_deg": 30.0})


def hemisphere(
    model: Any, *, phi_i: tuple[float, ...] = (0.0,), theta_i: tuple[float, ...] = (30.0,), one_side: bool = False,
    u_rel: float = 0.0,
) -> pd.DataFrame:  # fmt: skip
    """Every 10 degrees of theta_r and 15 of azimuth."""
    azimuth = np.arange(0.0, 181.0 if one_side else 346.0, 15.0)
    grids = np.meshgrid(theta_i, phi_i, np.arange(0.0, 90.0, 10.0).clip(1e-9), azimuth, indexing="ij")
    ti, pi, tr, dphi = (g.ravel() for g in grids)
    brdf = model.brdf(*np.radians([ti, pi, tr, (pi + dphi) % 360]))
    u = u_rel * brdf if u_rel else np.nan
    brdf = brdf * (1 + u_rel * np.random.default_rng(1).normal(size=brdf.size))
    return table(
        theta_i_deg=ti, phi_i_deg=pi, theta_r_deg=tr, phi_r_deg=(pi + dphi) % 360, wavelength_nm=550.0, brdf=brdf,
        u_brdf=u, u_random=u, attrs={"source_solid_angle_sr": 0.0, "receiver_solid_angle_sr": 0.0},
    )  # fmt: skip


def test_a_model_s_reflectance_has_the_uncertainty_of_its_parameters() -> None:
    result = fit(measure(MATTE, noise=0.02, floor=0.0), "lambert")
    e = result.parameters["albedo"]
    for r in energy.of_model(result):
        assert r.rho_dh == pytest.approx(e.value, rel=1e-6)  # the integral's tolerance
        assert r.u == pytest.approx(e.u, rel=1e-6)
    assert [round(r.theta_i_deg) for r in energy.of_model(result)] == [8, 10, 30, 60]


@pytest.mark.parametrize("one_side", [False, True])
def test_a_table_over_the_hemisphere_is_integrated(one_side: bool) -> None:
    (found,) = energy.of_table(observations(hemisphere(ROUGH, one_side=one_side)))
    true = float(ROUGH.directional_hemispherical(math.radians(30.0)))
    assert abs(known(found.rho_dh) - true) < 2 * known(found.u)
    assert known(found.u) < 0.05 * true  # the 3 % of the hemisphere beyond 80 degrees, nearly all
    assert ("mirror image" in found.why) == one_side


def test_a_table_in_the_plane_alone_says_that_it_cannot_be_integrated() -> None:
    found = energy.of_table(observations(measure(MATTE)))
    assert [r.rho_dh for r in found] == [None] * 3
    assert all("plane of incidence" in r.why for r in found)


def test_a_model_above_one_is_marked() -> None:
    bright = build("phong", {"k_d": 0.4, "k_s": 40.0, "exponent": 60.0})
    frame = measure(bright, noise=0.01, floor=0.0, incidences=(10.0, 30.0))
    (facts,) = summarise([examine(frame, ["phong"], name="x")], title="", normalise="mirror", command="").datasets
    assert facts.models["phong"].reflects_too_much
    (eight,) = [r for r in facts.models["phong"].rho_dh if r.theta_i_deg == pytest.approx(8)]
    # values of 1 %, and an integral that hangs on most of them
    assert eight.rho_dh == pytest.approx(bright.directional_hemispherical(math.radians(8.0)), rel=0.01)
    assert "Against the conservation of energy phong (rho_dh = 5." in facts.conclusion


@pytest.mark.slow
@pytest.mark.parametrize("u_rel", [0.0, 0.01])
def test_anisotropy_is_seen_in_the_azimuth_of_incidence(u_rel: float) -> None:
    frame = hemisphere(ROUGH, phi_i=(0.0, 45.0, 90.0), u_rel=u_rel)
    assert not [s for s in symmetries(observations(frame).checked) if s.broken]
    brushed = frame.copy()
    brushed.loc[brushed["phi_i_deg"] == 90.0, "brdf"] *= 1.5
    found = {s.kind: s for s in symmetries(observations(brushed).checked)}["azimuth of incidence"]
    assert found.broken
    (facts,) = summarise([examine(brushed, ["lambert"], name="x")], title="", normalise="mirror", command="").datasets
    assert "The sample is anisotropic" in facts.conclusion
    assert "--models anisotropic" in facts.conclusion


@pytest.mark.slow
def test_a_fit_within_the_bound_reflects_no_more_than_it_receives() -> None:
    bright = build("phong", {"k_d": 0.4, "k_s": 40.0, "exponent": 60.0})
    frame = measure(bright, noise=0.01, floor=0.0, incidences=(10.0, 30.0))
    free = fit(frame, "phong")
    held = fit(frame, "phong", energy=True)
    # two incidences in the plane leave it open, and the model's own number is judged all the same
    assert max(r.of_model[0] or 0 for r in energy.of_model(free)) > 5
    assert 0.99 < max(r.of_model[0] or 0 for r in energy.of_model(held)) <= 1.0 + energy.ABOVE_ONE  # on the bound
    assert any("bound to 1" in n for n in held.notes)
    assert known(held.reduced_chi_square) > 100  # and the data say so


def test_the_bound_costs_nothing_where_it_is_not_needed() -> None:
    frame = measure(MATTE, noise=0.01)
    one, other = fit(frame, "lambert"), fit(frame, "lambert", energy=True)
    assert other.parameters["albedo"].value == pytest.approx(one.parameters["albedo"].value, rel=1e-9)
