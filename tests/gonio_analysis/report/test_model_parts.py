"""The parts of models in a report: together they are the whole."""

import math

import numpy as np
import pytest
from gonio_analysis.curves.in_plane import curves
from gonio_analysis.fitting.observations import observations
from gonio_analysis.report.model_parts import _reflected
from gonio_analysis.report.viewer import of_line

from gonio.models import HeTorrance, Lambert, Model, OrenNayar, Sum
from gonio.typing import DataFrame

PLASTIC = HeTorrance(sigma0_um=0.1, tau_um=1.5, ior=1.5, diffuse_albedo=0.2)
SUM = Sum((OrenNayar(0.5, 20.0), 0.8), (HeTorrance(0.3, 2.0, 1.5), 0.5))


def plane() -> DataFrame:
    """Values in one plane at 45 degrees, through cones of 0.5 degrees."""
    import pandas as pd

    theta = np.arange(-80.0, 81.0, 5.0)
    frame = pd.DataFrame({
        "theta_i_deg": 45.0, "phi_i_deg": 0.0, "theta_r_deg": np.abs(theta),
        "phi_r_deg": np.where(theta > 0, 180.0, 0.0), "wavelength_nm": 550.0, "polarisation": "unpolarised",
        "brdf": 0.1, "u_brdf": 0.001, "u_random": 0.001, "flag": "",
    })  # fmt: skip
    solid = 2.0 * math.pi * (1.0 - math.cos(math.radians(0.5)))
    frame.attrs |= {"source_solid_angle_sr": solid, "receiver_solid_angle_sr": solid}
    return frame


def test_parts_of_a_line_are_below_the_whole() -> None:
    data = observations(plane(), "plane")
    (curve,) = curves(data)
    angle = np.radians([-30.0, 0.0, 44.9, 45.0, 60.0])
    whole = curve.theory(PLASTIC, angle, data)
    parts = of_line(PLASTIC, curve, angle, data)
    assert parts["directional diffuse"] is None  # what the others leave
    assert parts["uniform diffuse"] == pytest.approx(0.2 / math.pi, rel=1e-4)  # five digits are kept
    spike = np.array(parts["specular"])
    assert spike[[0, 1, 4]].tolist() == [0.0, 0.0, 0.0]
    assert spike[3] > 0.5 * whole[3]
    rest = whole - spike - 0.2 / math.pi
    lobe = curve.theory(HeTorrance(0.1, 1.5, 1.5), angle, data) - spike
    np.testing.assert_allclose(rest, lobe, atol=1e-4 * whole.max())  # the digits of the spike
    terms = of_line(SUM, curve, angle, data)
    assert list(terms) == ["oren-nayar 1", "he-torrance 2"]
    assert terms["he-torrance 2"] is None
    assert of_line(Lambert(0.5), curve, angle, data) == {}
    assert of_line(OrenNayar(0.5, 20.0), curve, angle, data) == {}


@pytest.mark.parametrize("model", [PLASTIC, SUM])
def test_shares_add_up_to_the_reflectance(model: Model) -> None:
    theta = np.radians([10.0, 60.0])
    rho = np.asarray(model.directional_hemispherical(theta))
    shares = _reflected(model, theta, rho, 550.0)
    np.testing.assert_allclose(sum(shares.values()), rho, rtol=1e-12)
    assert all((share > 0.0).all() for share in shares.values())
    last = list(shares)[-1]
    if model is SUM:  # the last term is the difference: it is that term's own, to the integrals' 1e-6
        own = 0.5 * np.asarray(SUM.terms[1][0].directional_hemispherical(theta))
        np.testing.assert_allclose(shares[last], own, rtol=1e-4)
