"""Lobes of curves: widths that are known from the model's formula, and what has none."""

import math

import numpy as np
import pytest
from gonio_analysis.curves.in_plane import curves
from gonio_analysis.curves.lobes import CurveLobe, _crossing, lobe
from gonio_analysis.fitting.observations import observations

from gonio.models import build
from tests.gonio_analysis.synthetic import known, measure


def lobes(model: object, **how: object) -> list[CurveLobe]:
    data = observations(measure(model, incidences=(10.0, 30.0, 60.0), **how))  # type: ignore[arg-type]
    return [known(lobe(curve, data)) for curve in curves(data)]


@pytest.mark.parametrize("step", [0.5, 2.0, 5.0])
@pytest.mark.parametrize("exponent", [80.0, 200.0])
def test_widths_are_those_of_the_formula_within_what_is_stated(step: float, exponent: float) -> None:
    """cos^n of the half vector's angle is one half where that is arccos 2^(-1/n); the detector turns twice as far."""
    width = 4.0 * math.degrees(math.acos(0.5 ** (1.0 / exponent)))
    model = build("phong", {"k_d": 0.3, "k_s": 0.5, "exponent": exponent})
    found = lobes(model, noise=0.01, views=np.arange(-80.0, 80.1, step), seed=3)
    assert all(one.resolved for one in found)
    for one, at in zip(found, (10.0, 30.0, 60.0), strict=True):
        # 0.3 degrees: the smoothed flanks, and at 60 degrees the formula's own factor of 1/cos(theta_r)
        assert math.degrees(one.width) == pytest.approx(width, abs=4 * math.degrees(one.u_width) + 0.3)
        assert math.degrees(one.at) == pytest.approx(at, abs=4 * math.degrees(one.u_at) + 0.3)
    assert math.degrees(max(one.u_width for one in found)) < 1.0


def test_a_matt_surface_has_no_lobe() -> None:
    assert not any(one.exists for one in lobes(build("lambert", {"albedo": 0.5}), noise=0.02))
    assert not any(one.exists for one in lobes(build("oren-nayar", {"albedo": 0.5, "sigma_deg": 30.0}), noise=0.02))


def test_a_lobe_that_the_steps_do_not_show_has_no_width() -> None:
    model = build("phong", {"k_d": 0.3, "k_s": 500.0, "exponent": 20000.0})
    found = lobes(model, noise=0.01)
    assert all(one.exists for one in found)
    assert not any(one.resolved for one in found)
    assert {one.why for one in found} <= {"the steps are too wide for it", "one of its flanks was not measured"}


def test_a_lobe_as_narrow_as_the_instruments_cones_says_so() -> None:
    model = build("phong", {"k_d": 0.3, "k_s": 50.0, "exponent": 5000.0})
    found = lobes(model, noise=0.01, cone_sr=0.01, views=np.arange(-80.0, 80.1, 0.5))
    assert {one.why for one in found if one.exists} == {"it is as narrow as the instrument's cones"}


def test_a_maximum_that_does_not_rise_from_the_base_has_no_crossing() -> None:
    """Values in wide steps, of a sheet for shading windows, were divided by a slope of zero."""
    x, f = np.radians(np.arange(-60.0, 61.0, 20.0)), np.ones(7)
    with np.errstate(all="raise"):
        assert _crossing(x, f, np.zeros(7), 3, 1, 0.5) is None
