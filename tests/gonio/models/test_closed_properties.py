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
    st.builds(OrenNayar, shares, form=st.just("single-slope"), slope_deg=st.floats(0.0, 85.0)),
    st.builds(
        OrenNayar,
        shares,
        form=st.just("single-slope"),
        slope_deg=st.floats(0.0, 85.0),
        groove_azimuth_deg=st.floats(0.0, 360.0),
    ),
)
reciprocal = st.one_of(lamberts, blinns, cooks, closed_orens)


@given(reciprocal, thetas, phis, thetas, phis)
def test_reciprocity(model: Model, theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> None:
    there, back = float(model.brdf(theta_i, phi_i, theta_r, phi_r)), float(model.brdf(theta_r, phi_r, theta_i, phi_i))
    # the same sums in another order: a few roundings, but values that underflow
    assert there == pytest.approx(back, rel=1e-13, abs=1e-290)


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


@given(st.one_of(lamberts, phongs, blinns, cooks), thetas, phis, thetas, phis)
def test_never_negative_and_never_nan(model: Model, theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> None:
    assert float(model.brdf(theta_i, phi_i, theta_r, phi_r)) >= 0.0


@given(
    st.one_of(lamberts, phongs, blinns, cooks, closed_orens),
    st.floats(0.0, 1.5),
    phis,
    st.floats(0.0, 1.5),
    phis,
    st.floats(-3.0, 3.0),
)
def test_turning_the_sample_about_its_normal(
    model: Model, theta_i: float, phi_i: float, theta_r: float, phi_r: float, turn: float
) -> None:
    one = float(model.brdf(theta_i, phi_i, theta_r, phi_r))
    # azimuths are rounded by up to 1e-15 rad; a lobe of width 0.02 rad or more magnifies that by less than (pi/0.02)^2
    assert float(model.brdf(theta_i, phi_i + turn, theta_r, phi_r + turn)) == pytest.approx(one, rel=1e-10, abs=1e-100)


@pytest.mark.slow
@given(reciprocal, st.floats(0.0, 1.56), phis, st.floats(0.0, 1.56), phis)
def test_angles_and_vectors_agree(model: Model, theta_i: float, phi_i: float, theta_r: float, phi_r: float) -> None:
    def vector(theta: float, phi: float) -> list[float]:
        return [math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)]

    by_angles = float(model.brdf(theta_i, phi_i, theta_r, phi_r))
    by_vectors = float(model.brdf_vectors(vector(theta_i, phi_i), vector(theta_r, phi_r)))
    # components are rounded by 1e-16; cosines down to 0.01 and lobes down to 0.02 rad magnify that by less than 1e5
    assert by_vectors == pytest.approx(by_angles, rel=1e-10, abs=1e-100)


@settings(max_examples=30, deadline=None)
@given(slopes, indices, st.floats(0.0, 1.4))
def test_normalised_beckmann_facets_reflect_no_more_than_falls_on_them(
    m: float, index: complex, theta_i: float
) -> None:
    # reciprocity makes the hemispherical-directional integral the directional-hemispherical one; its quadrature is
    # good to 1e-3
    assert CookTorrance(slopes=m, ior=index, convention="normalised").ambient_reflectance(theta_i) <= 1.0 + 1e-3


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


def test_the_c2_of_blinn_is_a_reciprocal_width() -> None:
    model = Blinn(distribution="gaussian", c=20.0)
    there, top = (model.highlight(a, 0.0, a, 0.0) * math.cos(a) for a in (1.0 / 20.0, 0.0))  # retro: s = D F_0/(N.E)
    assert there / top == pytest.approx(math.exp(-1.0), rel=1e-12)  # D2 = exp(-(alpha c2)^2), to rounding


@settings(max_examples=10, deadline=None)
@given(st.floats(0.0, 1.3), st.floats(5.0, 60.0))
def test_exact_oren_nayar_conserves_energy(theta_i: float, sigma_deg: float) -> None:
    node, weight = np.polynomial.legendre.leggauss(24)
    theta = PI / 4 * (node + 1.0)
    phi = np.linspace(0.0, 2 * PI, 32, endpoint=False)
    f = OrenNayar(1.0, sigma_deg, "exact").brdf(theta_i, 0.0, theta[:, None], phi)
    # white facets: what leaves the groove after one or two bounces, at most all of it; the quadrature over kinks is
    # good to 2e-3
    assert 0.6 < float((f.mean(axis=1) * 2 * PI * np.sin(theta) * np.cos(theta)) @ weight * PI / 4) <= 1.0 + 2e-3


@given(shares, st.sampled_from(["functional", "qualitative"]), thetas, phis, thetas, phis)
def test_oren_nayar_without_roughness_is_lambert(
    albedo: float, form: str, theta_i: float, phi_i: float, theta_r: float, phi_r: float
) -> None:
    got = float(OrenNayar(albedo, 0.0, form).brdf(theta_i, phi_i, theta_r, phi_r))
    assert got == pytest.approx(albedo / PI, rel=1e-15)  # a few roundings


@given(st.floats(0.2, 5.0), st.floats(0.0, 1.5), st.floats(0.0, 1.5), phis)
def test_the_limit_of_no_absorption(n: float, theta_i: float, theta_r: float, phi: float) -> None:
    dielectric, metal, mirror = (
        float(CookTorrance(ior=ior).brdf(theta_i, 0.0, theta_r, phi))
        for ior in (n, complex(n, 1e-14), complex(1.0, 1e8))
    )
    # F changes by some k/n, and beyond the critical angle by sqrt(k): 1e-7. Where n is nearly 1 it is of the order
    # of k^2 / (4 c^4), with c at least cos(1.5): 1e-24 of what F = 1 gives
    assert metal == pytest.approx(dielectric, rel=1e-5, abs=max(1e-24 * mirror, 1e-290))


@given(st.floats(0.0, 1.0), indices)
def test_reflectance_is_between_0_and_1(cosine: float, index: complex) -> None:
    assert -1e-15 <= fresnel.reflectance(cosine, index) <= 1.0 + 1e-14


@given(st.floats(1.0, 50.0))
def test_normal_reflectance_and_index_are_inverse(n: float) -> None:
    # 1 - sqrt(f0) = 2/(n + 1): an error of eps in f0 becomes n eps; at n = 1 the root magnifies it further
    assert fresnel.n_from_f0(float(fresnel.reflectance(1.0, n))) == pytest.approx(n, rel=1e-13)


def test_blinn_1977_shortcut_is_twice_the_reflectance() -> None:
    # erratum: the shortcut lacks the factor 1/2
    angles = (0.7, 0.0, 0.4, 2.5)
    exact, printed = (Blinn(ior=1.8, fresnel=form).highlight(*angles) for form in ("exact", "1977"))
    assert printed == pytest.approx(2.0 * float(exact), rel=1e-15)


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
