"""What the zeros of the arms do to a fit: by the model, where a table's provenance names them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from gonio_analysis.fitting.fit import fit
from gonio_analysis.fitting.forward import by_model
from gonio_analysis.fitting.observations import observations

from gonio import models
from tests.gonio_analysis.synthetic import known

U = math.radians(0.02)
TRUTH = models.Phong(k_d=0.1, k_s=0.6, exponent=80.0)


def f(theta_i: np.ndarray, signed: np.ndarray) -> np.ndarray:
    """The true BRDF [1/sr] in the plane of incidence."""
    phi_r = np.where(signed < 0.0, 0.0, math.pi)
    return np.asarray(TRUTH.brdf(theta_i, 0.0 * theta_i, np.abs(signed), phi_r, wavelength_nm=550.0))


def table(zero: float = 0.0, seed: int = 0) -> pd.DataFrame:
    """Some points beside the lobe's top at three incidences, an arm's zero being wrong by so much [rad].

    The column for that zero has the wrong sign at every point of the last incidence.
    """
    points = [(i, i + by) for i in (20.0, 45.0, 70.0) for by in (-40.0, -12.0, -8.0, -4.0, 0.0, 4.0, 8.0, 12.0)]
    theta_i, signed = np.radians(np.array(points)).T
    true = f(theta_i + zero, signed) * np.cos(theta_i + zero) / np.cos(theta_i)
    up, down = (f(theta_i + by, signed) * np.cos(theta_i + by) / np.cos(theta_i) for by in (U, -U))
    out = pd.DataFrame(
        {
            "theta_i_deg": np.degrees(theta_i),
            "phi_i_deg": 0.0,
            "theta_r_deg": np.degrees(np.abs(signed)),
            "phi_r_deg": np.where(signed < 0.0, 0.0, 180.0),
            "wavelength_nm": 550.0,
            "polarisation": "unpolarised",
            "brdf": true * (1.0 + 1e-4 * np.random.default_rng(seed).standard_normal(theta_i.size)),
            "u_random": 1e-4 * true,
            "s_theta_i_zero": 0.5 * (up - down) * np.where(theta_i > 1.0, -1.0, 1.0),
            "flag": "",
        }
    )
    out["u_brdf"] = np.hypot(out["u_random"], out["s_theta_i_zero"])
    out.attrs.update(quantity="brdf", source_solid_angle_sr=0.0, receiver_solid_angle_sr=0.0)
    return out


def named(made: pd.DataFrame) -> pd.DataFrame:
    made.attrs["provenance"] = {"zeros_rad": {"theta_i_zero": U}}
    return made


def test_the_model_tells_what_a_zero_does() -> None:
    made = named(table())
    data = observations(made, "the table")
    wrong = made["theta_i_deg"].to_numpy() > 60.0
    column, stated = known(by_model(data, TRUTH, data.brdf).covariance).common[:, 0], made["s_theta_i_zero"].to_numpy()
    # exactly the difference that the columns were made from; they were turned round at the last incidence
    assert column == pytest.approx(np.where(wrong, -stated, stated), rel=1e-9, abs=1e-12)


def test_without_named_zeros_the_table_is_believed() -> None:
    for provenance in ({}, {"zeros_rad": 3}, {"zeros_rad": {"theta_i_zero": "wide"}}, "none"):
        made = table()
        made.attrs["provenance"] = provenance
        data = observations(made, "the table")
        assert by_model(data, TRUTH, data.brdf) is data


def test_errors_of_a_zero_are_within_what_the_fit_states() -> None:
    pulls, rejected = [], []
    for seed, zero in enumerate((-2.0, -1.0, 1.0, 2.0)):
        found = fit(named(table(zero * U, seed)), "phong")
        assert not found.rejected
        exponent = found.parameters["exponent"]
        pulls.append((exponent.value - 80.0) / known(exponent.u))
        rejected.append(fit(table(zero * U, seed), "phong").rejected)
    # the zero was wrong by two standard deviations at most, and noise adds about one
    assert max(map(abs, pulls)) < 3.5
    assert all(rejected), "a table with wrong columns is found out: the test tells the difference"


def test_the_model_tells_what_readings_do() -> None:
    """What a table has added for them goes, and what the model says comes: much on a flank, and nothing on a level."""
    made = named(table())
    made.attrs["provenance"]["readings_rad"] = {"theta_i_zero": 0.5 * U, "theta_r_zero": U}
    noise = made["u_random"].to_numpy()
    made["u_angles"] = 0.05 * made["brdf"]
    made["u_random"] = np.hypot(noise, made["u_angles"])
    data = observations(made, "the table")
    found = known(by_model(data, TRUTH, f(data.directions.theta_i, data.directions.signed)).covariance)
    theta_i, signed = data.directions.theta_i, data.directions.signed
    of_i, of_r = (
        0.5 * (f(theta_i + a, signed + b) * np.cos(theta_i + a) - f(theta_i - a, signed - b) * np.cos(theta_i - a))
        for a, b in ((0.5 * U, 0.0), (0.0, U))
    )
    slopes = np.hypot(of_i, of_r) / np.cos(theta_i)
    # beside slopes there is what is bent: a fifth of the noise at the top of the lobe, elsewhere next to nothing
    assert found.random == pytest.approx(np.hypot(noise, slopes), rel=0.06)
    assert found.random[np.argmax(slopes)] > 5.0 * noise[np.argmax(slopes)]
    kept = known(by_model(replace(data, u_angles=np.zeros(0)), TRUTH, data.brdf).covariance)
    assert kept.random == pytest.approx(made["u_random"].to_numpy())
    assert data.take(np.arange(3)).u_angles.size == 3
