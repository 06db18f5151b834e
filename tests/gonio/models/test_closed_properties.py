"""Properties that the models promise for every geometry and parameter: reciprocity, sign, rotation, energy, and their
limits.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gonio.errors import ArgumentError
from gonio.models import Blinn, CookTorrance, HeTorrance, Lambert, Model, OrenNayar, Phong, Sum, fresnel
from gonio.models.blinn import DISTRIBUTIONS
from gonio.models.plain import cook_torrance
from gonio.models.plain.vectors import direction

PI = math.pi
thetas = st.floats(0.0, PI / 2)
phis = st.floats(-2 * PI, 2 * PI)
shares = st.floats(0.0, 1.0)
indices = st.builds(complex, st.floats(0.1, 10.0), st.floats(0.0, 10.0))
slopes = st.floats(0.02, 1.0)

lamberts = st.builds(Lambert, shares)
phongs = st.builds(Phong, shares, shares, st.floats(0.0, 500.0))
blinns = st.one_of(
    st.builds(Blinn, shares, shares, indices, st.sampled_from(DISTRIBUTIONS), beta_deg=st.floats(1.0, 89.0)),
    st.builds(Blinn, shares, shares, indices, st.just("trowbridge-reitz"), c=st.floats(0.01, 1.0)),
)
cooks = st.builds(
    lambda s, m, n, dist, albedo, form: CookTorrance(s, 1.0 - s, m, n, dist, albedo, form),
    shares,
    slopes,
    indices,
    st.sampled_from(["beckmann", "gaussian"]),
    shares,
    st.sampled_from(["paper", "normalised"]),
)
closed_orens = st.builds(OrenNayar, shares, st.floats(0.0, 40.0), st.sampled_from(["functional", "qualitative"]))
slow_orens = st.one_of(
    st.builds(OrenNayar, shares, st.floats(0.0, 60.0), st.just("exact")),
    st.builds(OrenNayar, shares, st.floats(0.0, 60.0), st.just("exact"), mean_slope_deg=st.floats(0.0, 85.0)),
    st.builds(OrenNayar, shares, form=st.just("single-slope"), slope_deg=st.floats(0.0, 85.0)),
    st.builds(
        OrenNayar,
        shares,
        form=st.just("single-slope"),
        slope_deg=st.floats(0.0, 85.0),
        groove_azimuth_deg=st.floats(0.0, 360.0),
    ),
)


@given(st.one_of(lamberts, phongs, blinns, cooks, closed_orens), thetas, phis, thetas, phis, st.floats(-3.0, 3.0))
def test_reciprocity_sign_and_turning_the_sample_about_its_normal(
    model: Model, theta_i: float, phi_i: float, theta_r: float, phi_r: float, turn: float
) -> None:
    there, back = float(model.brdf(theta_i, phi_i, theta_r, phi_r)), float(model.brdf(theta_r, phi_r, theta_i, phi_i))
    if not isinstance(model, Phong):
        # the same sums in another order: a few roundings, but values that underflow
        assert there == pytest.approx(back, rel=1e-13, abs=1e-290)
    assert there >= 0.0 or isinstance(model, OrenNayar)  # whose functional form is negative near grazing
    if max(theta_i, theta_r) <= 1.5:
        # azimuths are rounded by up to 1e-15 rad; a lobe of width 0.02 rad or more magnifies that by less than
        # (pi/0.02)^2
        turned = float(model.brdf(theta_i, phi_i + turn, theta_r, phi_r + turn))
        assert turned == pytest.approx(there, rel=1e-10, abs=1e-100)


@settings(max_examples=60, deadline=None)
@given(slow_orens, thetas, phis, thetas, phis)
def test_groove_integrals_are_reciprocal_and_never_negative(
    model: Model, theta_i: float, phi_i: float, theta_r: float, phi_r: float
) -> None:
    there, back = float(model.brdf(theta_i, phi_i, theta_r, phi_r)), float(model.brdf(theta_r, phi_r, theta_i, phi_i))
    # exchanging the directions turns phi_a by pi, which the quadrature sees as another set of arcs: its error, 1e-8,
    # either way
    assert there == pytest.approx(back, rel=2e-8)
    assert there >= 0.0


def test_the_printed_normalisation_of_cook_torrance_is_four_times_too_large() -> None:
    # erratum: for F = 1 and normal incidence the printed form reflects 4.0000 (m = 0.05 to 0.2) and 3.190 (m = 0.6)
    for m, expected in ((0.05, 4.0), (0.2, 4.0), (0.6, 3.190)):
        mirror = 1e7 + 1e7j  # reflects all but 1e-7
        assert CookTorrance(slopes=m, ior=mirror).ambient_reflectance(0.0) == pytest.approx(expected, rel=1e-3)


def test_the_m_of_cook_torrance_is_the_total_rms_slope() -> None:
    """Not the slope along a line, which is 1/sqrt(2) of it. In retro-reflection G is 1 and D = pi cos^2 R_s / F_0."""
    node, weight = np.polynomial.legendre.leggauss(200)
    alpha = 0.35 * (node + 1.0)
    facets = CookTorrance(slopes=0.1).specular(alpha, 0.0, alpha, 0.0) * np.cos(alpha) ** 3 * np.sin(alpha) * weight
    # what lies beyond 0.7 rad is exp(-70) of all
    assert facets @ np.tan(alpha) ** 2 / facets.sum() == pytest.approx(0.1**2, rel=1e-9)


@given(shares, st.sampled_from(["functional", "qualitative"]), thetas, phis, thetas, phis)
def test_oren_nayar_without_roughness_is_lambert(
    albedo: float, form: str, theta_i: float, phi_i: float, theta_r: float, phi_r: float
) -> None:
    got = float(OrenNayar(albedo, 0.0, form).brdf(theta_i, phi_i, theta_r, phi_r))
    assert got == pytest.approx(albedo / PI, rel=1e-15)  # a few roundings


@given(st.floats(0.0, 1.0), indices)
def test_reflectance_is_between_0_and_1(cosine: float, index: complex) -> None:
    assert -1e-15 <= fresnel.reflectance(cosine, index) <= 1.0 + 1e-14


def test_sum_of_rough_base_and_highlight() -> None:
    base, gloss = OrenNayar(0.8, 20.0), CookTorrance(ior=1.5, convention="normalised")
    both = Sum((base, 0.7), (gloss, 0.3))
    theta = np.linspace(0.0, 1.5, 7)
    expected = 0.7 * base.brdf(0.4, 0.0, theta, PI) + 0.3 * gloss.brdf(0.4, 0.0, theta, PI)
    np.testing.assert_array_equal(both.brdf(0.4, 0.0, theta, PI), expected)
    assert not both.has_spike


def test_sum_passes_the_specular_spike_on() -> None:
    smooth = HeTorrance(sigma0_um=0.05)
    both = Sum((Lambert(), 0.5), (smooth, 0.25))
    # one multiplication and one sum
    assert both.specular_reflectivity(0.3) == pytest.approx(0.25 * float(smooth.specular_reflectivity(0.3)), rel=1e-15)
    assert both.has_spike
    assert not Sum((Lambert(), 0.5)).has_spike


@pytest.mark.parametrize("model", [Lambert(), CookTorrance(), Sum((Lambert(), 0.5), (OrenNayar(), 0.5))], ids=repr)
def test_a_model_without_a_spike_reflects_nothing_in_it(model: Model) -> None:
    theta = np.linspace(0.0, 1.5, 3)
    one = model.specular_reflectivity(0.3)
    assert isinstance(one, float)
    assert one == 0.0
    np.testing.assert_array_equal(model.specular_reflectivity(theta), np.zeros(3))
    waves = np.array([[450.0], [550.0]])
    np.testing.assert_array_equal(model.specular_reflectivity(theta, wavelength_nm=waves), np.zeros((2, 3)))
    with pytest.raises(ArgumentError, match="theta_i"):
        model.specular_reflectivity(2.0)


def test_a_spike_is_known_by_the_method_that_a_model_brings() -> None:
    class Mirror(Lambert):
        def specular_reflectivity(self, theta_i: Any, *, wavelength_nm: Any = 550.0, out: Any = None) -> Any:
            return 0.5 + 0.0 * np.asarray(theta_i)

    assert Mirror().has_spike
    assert HeTorrance().has_spike
    assert Sum((Mirror(), 0.5), (Lambert(), 0.5)).specular_reflectivity(0.3) == 0.25


@pytest.mark.parametrize(
    ("preset", "expected"),
    [
        ("carbon", (0.3, 0.7, 0.40)),
        ("rubber", (0.4, 0.6, 0.30)),
        ("obsidian", (0.8, 0.2, 0.15)),
        ("rust", (0.2, 0.8, 0.35)),
    ],
)
def test_cook_torrance_table_1(preset: str, expected: Any) -> None:
    model = CookTorrance.preset(preset, f0=0.05)
    assert (model.s, model.d, model.slopes[0][0]) == expected
    assert model.diffuse_albedo == 0.05  # R_d = F_0/pi in the paper's figures


def test_presets_that_name_their_material() -> None:
    copper = CookTorrance.preset("copper")
    assert (copper.s, copper.d, copper.slopes) == (1.0, 0.0, ((0.4, 0.4), (0.2, 0.6)))
    assert CookTorrance.preset("plastic").diffuse_albedo == pytest.approx(
        0.6, abs=0.1
    )  # copper reflects some 60 % at 550 nm
    oxide = Blinn.preset("magnesium oxide")
    assert (oxide.k_s, oxide.k_d, oxide.ior, oxide.c) == (0.667, 0.333, 1.8, 0.35)


def test_cook_torrance_ambient_light() -> None:
    # a horizon that rises toward one side; 1000 x 1000 cells are good to 1/1000
    def horizon(phi: Any) -> Any:
        return 0.5 * (1.0 + np.cos(phi))

    def unblocked(theta: Any, phi: Any) -> Any:
        return PI / 2 - theta > horizon(phi)

    phi = 2.0 * PI * np.arange(720) / 720
    assert cook_torrance.f(unblocked) == pytest.approx(np.mean(np.cos(horizon(phi)) ** 2), abs=1e-3)
    model = CookTorrance(0.4, 0.6, 0.4, ior=1.5, diffuse_albedo=0.7)
    theta_r = 0.6
    plain = cook_torrance.R_a(
        lambda theta, phi: cook_torrance.brdf(
            direction(theta, phi), direction(theta_r, 0.0), ((0.4, 1.0),), 1.5, 0.4, 0.6, 0.7
        ),
        128,
    )
    # 1e-3 is what the model states
    assert model.ambient_reflectance(theta_r) == pytest.approx(plain, rel=1e-3)
    assert model.ambient_reflectance() == pytest.approx(PI * 0.7 / PI, rel=8e-16)  # R_a = pi R_d
