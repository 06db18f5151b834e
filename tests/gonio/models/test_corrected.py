"""A model with the smooth curve of its misfit: what it keeps, and its table in a file."""

import json
import math
from typing import Any

import numpy as np
import pytest

from gonio import models
from gonio.errors import ArgumentError
from gonio.geometry import Directions
from gonio.models import Blinn, Corrected, Correction, HeTorrance, Lambert, Model, OrenNayar
from gonio.models.corrected import folded
from gonio.models.gaussian_process import OF_CURVES, Coordinates, Prior, Process, Training

TAU = 0.05
PLACES = Directions.from_degrees([20.0] * 7 + [40.0] * 7, 0.0, [0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 70.0] * 2, 180.0)


def corrected(model: Model, log_ratio: float = 0.1) -> Corrected:
    """Off by exp(log_ratio) everywhere that was measured."""
    prior = Prior(np.log(np.full(12, TAU)) + np.where(np.arange(12) % 2, 0.0, 2.0), OF_CURVES.spreads, TAU, 0.0)
    at = folded(PLACES, model)
    data = Training(Coordinates.of(at), np.full(14, log_ratio), np.full(14, 1e-4), np.zeros((14, 1)), prior=prior)
    return Corrected(model, Correction(Process(data, prior.centres), at, 1e-6, 1.0, TAU))


def test_it_is_the_measurement_where_that_is() -> None:
    found = corrected(Lambert(0.5)).brdf(*PLACES.angles)
    assert found == pytest.approx(0.5 / math.pi * math.exp(0.1), rel=1e-3)  # values are known to 1e-4


def test_no_spike_and_no_light_is_invented() -> None:
    plain = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5)
    one = corrected(plain)
    assert one.has_spike
    assert one.specular_reflectivity(0.3) == plain.specular_reflectivity(0.3)
    assert corrected(Lambert(0.0), 0.0).brdf(*PLACES.angles) == pytest.approx(0.0, abs=1e-12)


def test_an_isotropic_model_stays_isotropic() -> None:
    """Whatever the azimuth of incidence, and on either side of the plane of incidence."""
    one = corrected(Blinn(k_s=0.4, c=0.3, k_d=0.5))
    assert not one.depends_on_azimuth
    first = one.brdf(0.5, 0.9, 0.4, 2.0)
    assert one.brdf(0.5, 0.9 + 1.3, 0.4, 2.0 + 1.3) == pytest.approx(first, rel=1e-12)
    assert one.brdf(0.5, 2.0, 0.4, 0.9) == pytest.approx(first, rel=1e-12)


def test_it_is_the_same_after_a_file() -> None:
    one = corrected(OrenNayar(albedo=0.5, sigma_deg=20.0))
    again = models.build("corrected", json.loads(json.dumps(one.parameters)))
    at = Directions.from_degrees(35.0, 0.0, np.arange(0.0, 90.0, 5.0), 150.0)
    # angles are written to 1e-7 degrees, values to 1e-9
    assert again.brdf(*at.angles) == pytest.approx(one.brdf(*at.angles), rel=1e-6)
    assert isinstance(again, Corrected)
    there = folded(at, again.model)
    _, root = one.correction.beside(there, one.model.brdf(*there.angles))
    _, other = again.correction.beside(there, again.model.brdf(*there.angles))
    assert np.linalg.norm(other, axis=1) == pytest.approx(np.linalg.norm(root, axis=1), rel=1e-3)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"z": [0.1]}, "theta_i_deg has to be 1 finite numbers"),
        ({"z": ["a"] * 14}, "z has to be a list of numbers"),
        ({"kernel": [1.0]}, "kernel has to be 12 finite numbers"),
        ({"kernel": [0.0] * 12}, "above 0"),
        ({"u_z": [math.nan] * 14}, "u_z has to be 14 finite numbers"),
        ({"wider": -1.0}, "wider"),
        ({"width": 1.0}, "width is none of"),
    ],
)
def test_a_table_that_is_wrong_is_refused(change: dict[str, Any], words: str) -> None:
    parameters = corrected(Lambert(0.5)).parameters
    with pytest.raises(ArgumentError, match=words):
        models.build("corrected", {**parameters, "misfit": {**parameters["misfit"], **change}})


def test_a_part_that_is_missing_is_told() -> None:
    parameters = corrected(Lambert(0.5)).parameters
    for key in ("lambert", "misfit"):
        with pytest.raises(ArgumentError, match="takes the table of one model"):
            models.build("corrected", {k: v for k, v in parameters.items() if k != key})
    del parameters["misfit"]["z"]
    with pytest.raises(ArgumentError, match="z is missing"):
        models.build("corrected", parameters)
