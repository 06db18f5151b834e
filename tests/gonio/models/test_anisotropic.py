"""Anisotropic facets against 50 digits, in their limits, and over the hemisphere."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gonio.models import GGX, AnisotropicFacets, Sum, hemispherical
from gonio.models.fresnel import reflectance
from tests.gonio.models import newer_oracles

PI = math.pi
EPS = float(np.finfo(float).eps)
METAL = 0.77 + 6.08j
WHITE = 1e8
"""An index whose reflectance is 1 - 4e-8, but within 1e-7 rad of grazing."""
polar = st.floats(0.0, 1.57)
azimuths = st.floats(-6.3, 6.3)
widths = st.floats(0.02, 2.0)


GEOMETRIES = {
    "normal": (0.0, 0.0, 0.0, 0.0),
    "mirror": (0.7, 0.3, 0.7, 0.3 + PI),
    "beside the mirror": (0.7, 0.3, 0.7 + 1e-6, 0.3 + PI),
    "retro": (0.7, 0.3, 0.7, 0.3),
    "out of plane": (1.1, 0.4, 0.5, 2.9),
    "grazing": (1.5707, 0.4, 0.5, 2.9),
    "both grazing, sideways": (1.5707, 0.4, 1.5706, 1.5),
    "forward grazing": (1.5707, 0.4, 1.5706, 0.4 + PI),
}


@pytest.mark.parametrize("ior", [METAL, 1.5, 0.7, 1.5 + 1e-6j], ids=str)
@pytest.mark.parametrize(("a1", "a2"), [(0.1, 0.4), (0.4, 0.1), (1.0, 1.0), (1e-3, 0.3), (1e-6, 1e-6), (5.0, 0.5)])
@pytest.mark.parametrize("where", GEOMETRIES)
def test_the_kernel_in_50_digits(where: str, a1: float, a2: float, ior: complex) -> None:
    at = GEOMETRIES[where]
    got = float(AnisotropicFacets(a1, a2, 25.0, ior).brdf(*at))
    with mpmath.workdps(50):
        ti, pi_, tr, pr = (mpmath.mpf(x) for x in at)
        turn = mpmath.radians(mpmath.mpf(25.0))
        wanted = float(newer_oracles.ggx(ti, pi_ - turn, tr, pr - turn, alpha=a1, alpha_y=a2, ior=ior))
    # sines and cosines are rounded: a slope of the facet moves by eps over the cosine of H, which D sees over its width
    cosine = math.cos(at[0]) + math.cos(at[2])
    moved = 4.0 * (1.0 + 1.0 / min(a1, a2)) / cosine + 4.0 / math.cos(max(at[0], at[2]))
    assert got == pytest.approx(wanted, rel=8.0 * EPS * (8.0 + moved))


def test_equal_widths_are_walters_isotropic_facets() -> None:
    model = AnisotropicFacets(0.3, 0.3, 40.0, 1.5)
    assert not model.depends_on_azimuth
    assert AnisotropicFacets(0.3, 0.31).depends_on_azimuth
    assert Sum((AnisotropicFacets(0.3, 0.31), 0.5)).depends_on_azimuth
    wanted = GGX(0.3, 1.5).brdf(0.6, 0.0, 0.9, 2.5)
    for phi in (0.0, 1.0, 4.0):
        assert model.brdf(0.6, phi, 0.9, phi + 2.5) == pytest.approx(wanted, rel=1e-13)


def test_exactly_grazing_and_opposite() -> None:
    model = AnisotropicFacets(0.2, 0.5, 30.0, METAL)
    assert model.brdf(PI / 2, 0.0, 0.3, 1.0) == pytest.approx(model.brdf(PI / 2 - 1e-12, 0.0, 0.3, 1.0), rel=1e-10)
    assert model.brdf(PI / 2, 0.0, PI / 2, 1.0) == math.inf
    assert model.brdf(PI / 2, 0.0, PI / 2, PI) == math.inf
    assert AnisotropicFacets(ior=1.0).brdf([PI / 2, 0.4], 0.0, [PI / 2, 0.4], PI).tolist() == [0.0, 0.0]


# --- over the hemisphere ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ior", [METAL, 1.5])
@pytest.mark.parametrize(("a1", "a2"), [(0.1, 0.4), (0.5, 0.5), (0.2, 1.5)])
def test_over_slopes_and_over_directions(a1: float, a2: float, ior: complex) -> None:
    model = AnisotropicFacets(a1, a2, 30.0, ior, 0.8, 0.3)
    theta, phi = np.radians([0.0, 30.0, 80.0]), np.array([0.0, 1.0, 4.0])
    got = model.directional_hemispherical(theta, phi_i=phi)
    other = hemispherical.over_directions(model, theta, phi, 550.0, False, tolerance=1e-6)
    np.testing.assert_allclose(got, other, rtol=2e-6)  # the other rule's
    np.testing.assert_array_equal(model.hemispherical_directional(theta, phi_r=phi), got)


@given(widths, widths, st.floats(0.0, 1.5), azimuths)
def test_no_more_is_reflected_than_falls_on_it(a1: float, a2: float, theta: float, phi: float) -> None:
    rho = AnisotropicFacets(a1, a2, 0.0, WHITE).directional_hemispherical(theta, phi_i=phi, tolerance=1e-4)
    assert 0.0 < rho <= 1.0 + 1e-4


@pytest.mark.parametrize("a", [1e-6, 1e-20, 1e-50])
def test_narrow_widths_are_a_mirror(a: float) -> None:
    theta = np.radians([0.0, 30.0, 70.0])
    got = AnisotropicFacets(a, a, 0.0, METAL).directional_hemispherical(theta)
    np.testing.assert_allclose(got, reflectance(np.cos(theta), METAL), rtol=2e-6)  # tails of the order of the width
    value = AnisotropicFacets(a, a, 0.0, METAL).brdf(0.0, 0.0, 0.0, 0.0)
    assert value == pytest.approx(float(reflectance(1.0, METAL)) / (4.0 * PI * a * a), rel=1e-13)  # roundings


def test_grazing_incidence_is_the_limit() -> None:
    model = AnisotropicFacets(0.1, 0.4, 0.0, METAL)
    at, near = model.directional_hemispherical(PI / 2), model.directional_hemispherical(PI / 2 - 1e-7)
    assert at == pytest.approx(near, rel=1e-5)  # it changes as the angle over the width
    for off in (1e-2, 1e-3, 1e-4, 1e-5):  # and every angle before it has a value
        assert 0.8 < model.directional_hemispherical(PI / 2 - off, phi_i=0.4) < 1.0
