"""Gradients of sampled quantities are their difference quotients, value by value."""

from dataclasses import replace

import numpy as np
import pytest
from gonio_analysis.appearance import sampled, sampled_hemisphere
from gonio_analysis.appearance.glossmeter import GLOSSMETERS
from gonio_analysis.fitting.observations import Observations, observations

from gonio.models import HeTorrance
from gonio.typing import Floats
from tests.gonio_analysis.appearance.simulated import hemisphere, measured, plane

PAINT = HeTorrance(sigma0_um=0.1, tau_um=2.0, ior=1.5, diffuse_albedo=0.1)


def moved(data: Observations, row: int, step: float) -> Observations:
    """The observations with one value changed."""
    brdf: Floats = data.brdf.copy()
    brdf[row] += step
    return replace(data, brdf=brdf)


@pytest.mark.slow
@pytest.mark.parametrize("around", [False, True], ids=("plane", "around"))
def test_gradient_of_gloss(around: bool) -> None:
    directions = plane(60.0, np.arange(0.0, 87.6, 2.5))
    if around:
        directions = np.unique(np.vstack([directions, hemisphere(60.0, 5.0, 10.0)]), axis=0)
    data = observations(measured(PAINT, directions))
    found = sampled.gloss(data, GLOSSMETERS[1])
    strongest = np.argsort(-np.abs(found.gradient) * data.brdf)[:12]
    assert around == bool(np.any(~data.directions.in_plane[strongest]))
    for row in strongest:
        step = 1e-5 * data.brdf[row]
        ahead, behind = (sampled.gloss(moved(data, row, s * step), GLOSSMETERS[1]).value for s in (1.0, -1.0))
        # the logarithm's curvature over a step of 1e-5, and rounding over it
        assert found.gradient[row] == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5), row


def test_gradient_of_a_reflectance_is_exact() -> None:
    data = observations(measured(PAINT, hemisphere(8.0)))
    (found,) = sampled_hemisphere.reflectances(data).values()
    assert isinstance(found, sampled.Sampled)
    assert found.value == pytest.approx(float(found.gradient @ data.brdf), rel=1e-12)  # linear in every value


def test_reflectance_at_8_degrees_is_that_of_an_even_function_of_the_angle_between_two_others() -> None:
    """rho = a + b theta^2 exactly; what is seen nearer by is taken as it is, and nothing beyond 30 degrees."""

    def known(*degrees: float) -> dict[float, sampled.Sampled | sampled.NotMeasured]:
        rho = {t: 0.3 + 1e-4 * t**2 for t in degrees}
        return {np.radians(t): sampled.Sampled(r, np.array([r, 1.0]), 0.001) for t, r in rho.items()}

    mixed = sampled_hemisphere.reflectance_at_8(known(2.0, 20.0, 60.0))
    assert mixed.value == mixed.gradient[0] == pytest.approx(0.3 + 1e-4 * 64.0)
    assert mixed.error == pytest.approx(0.001 + 1e-4 * (400.0 - 4.0) / 4.0), "a quarter of what lies between"
    assert sampled_hemisphere.reflectance_at_8(known(2.0, 10.4, 20.0)).value == pytest.approx(0.3 + 1e-4 * 10.4**2)
    with pytest.raises(sampled.NotMeasured):
        sampled_hemisphere.reflectance_at_8(known(2.0, 31.0))
