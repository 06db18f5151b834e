"""Values of one measurement in the directions of another."""

from __future__ import annotations

import numpy as np
from gonio_analysis.change.resampling import carry, common_wavelengths
from gonio_analysis.fitting.observations import observations

from gonio.models import OrenNayar
from tests.gonio_analysis.synthetic import measure

MODEL = OrenNayar(0.6, 20.0)


def test_the_same_directions_carry_the_same_values() -> None:
    a, table = observations(measure(MODEL, seed=1)), measure(MODEL, seed=2)
    b = observations(table)
    carried = carry(a, b, table)
    assert carried.interpolated == 0
    assert carried.missing == {}
    np.testing.assert_allclose(carried.value, b.brdf[carried.rows], rtol=1e-12)  # weights of 1, to rounding


def test_nothing_is_invented_outside_of_the_other_s_directions() -> None:
    a = observations(measure(MODEL, incidences=(30.0,), views=np.array([-80.0, 0.0, 80.0])))
    table = measure(MODEL, incidences=(30.0,), views=np.arange(-40.0, 41.0, 5.0))
    carried = carry(a, observations(table), table)
    assert list(np.degrees(a.directions.theta_r[carried.rows])) == [0.0]
    assert sum(carried.missing.values()) == 2


def test_wavelengths_are_common_within_half_a_nanometre() -> None:
    a, b, c = (observations(measure(MODEL, wavelength_nm=nm)) for nm in (550.0, 550.4, 551.0))
    assert common_wavelengths(a, b) == [(550.0, 550.4)]
    assert common_wavelengths(a, c) == []
