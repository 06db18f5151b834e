"""Hemispherical reflectances against closed forms, high-precision integrals in other coordinates, and each other."""

import math
from dataclasses import dataclass
from math import pi
from typing import Any, ClassVar

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from gonio.errors import ArgumentError, DataError
from gonio.models import Blinn, CookTorrance, HeTorrance, Lambert, Model, OrenNayar, Phong, Sum, fresnel
from gonio.models._hemisphere import about_mirror, panels
from gonio.typing import Floats

ASKED = 1e-8
"""The stated relative error."""
ANGLES = np.radians([0.0, 25.0, 60.0, 85.0])


# --- closed forms -------------------------------------------------------------------------------------------------


def test_lambert_reflects_its_albedo() -> None:
    assert Lambert(0.3).directional_hemispherical(ANGLES) == pytest.approx(0.3, rel=1e-15)
    assert OrenNayar(0.7, 0.0).hemispherical_directional(ANGLES) == pytest.approx(0.7, rel=ASKED)


@pytest.mark.parametrize("exponent", [0.0, 3.5, 40.0, 1e5])
def test_phong_at_normal_incidence(exponent: float) -> None:
    """With x = N.H: dw = 4 (V.H) dw_H and cos(theta) = 2 x^2 - 1, both integrals are those of powers of x."""
    low, c = math.sqrt(0.5), exponent

    def power(p: float) -> float:
        return (1.0 - low ** (p + 1.0)) / (p + 1.0)

    surface = Phong(0.1, 0.6, exponent)
    assert surface.hemispherical_directional(0.0) == pytest.approx(0.1 + 0.6 * 8.0 * power(c + 1.0), rel=ASKED)
    received = 0.1 + 0.6 * 8.0 * (2.0 * power(c + 3.0) - power(c + 1.0))
    assert surface.directional_hemispherical(0.0) == pytest.approx(received, rel=ASKED)


def test_phong_is_not_reciprocal_and_infinite_at_grazing_incidence() -> None:
    flat = Phong(0.0, 1.0, 0.0)  # s = 1
    assert flat.directional_hemispherical(ANGLES) == pytest.approx(1.0 / np.cos(ANGLES), rel=ASKED)
    assert flat.hemispherical_directional(ANGLES) == pytest.approx(2.0, rel=ASKED)
    assert flat.directional_hemispherical(pi / 2) == math.inf
    assert flat.hemispherical_directional(pi / 2) == pytest.approx(2.0, rel=ASKED)


@pytest.mark.parametrize("distribution", ["beckmann", "gaussian"])
@pytest.mark.parametrize("m", [1e-3, 1e-5, 1e-60])
def test_a_narrow_lobe_is_a_mirror(m: float, distribution: str) -> None:
    ior = 0.8 + 3.0j
    surface = CookTorrance(0.6, 0.4, m, ior, distribution, 0.5)
    amplitude = 4.0 if distribution == "beckmann" else 4.0 * m * m  # as printed; the Gaussian D is 1 at its middle
    expected = 0.2 + 0.6 * amplitude * fresnel.reflectance(np.cos(ANGLES[:3]), ior)
    # the next term is of the order of (m tan(theta))^2
    assert surface.directional_hemispherical(ANGLES[:3]) == pytest.approx(expected, rel=max(ASKED, 30.0 * m * m))


def test_blinns_narrow_lobes_have_the_areas_of_their_distributions() -> None:
    f = fresnel.reflectance(np.cos(ANGLES[:3]), 1.7)
    # integrals of D over the facets: pi/c2^2, 2 pi/c1 and pi c3^2; brdf cos dw = k_s D F/pi 4 dw_H where nothing hides
    cases = {"gaussian": (1e6, 1e-12), "phong": (1e12, 2e-12), "trowbridge-reitz": (1e-6, 1e-12)}
    for distribution, (c, area) in cases.items():
        got = Blinn(0.0, 0.5, 1.7, distribution, c).directional_hemispherical(ANGLES[:3])
        assert got == pytest.approx(2.0 * area * f, rel=2e-5)  # D3 reaches far: its tail meets the horizon


# --- high precision -----------------------------------------------------------------------------------------------


def distributions() -> dict[str, tuple[Model, Any, float]]:
    """Models, their D(alpha) in mpmath with all factors but F G/(pi (N.L)(N.V)), and their index."""

    def beckmann(m: float) -> Any:
        return lambda a: mp.exp(-(mp.tan(a) ** 2) / mp.mpf(m) ** 2) / (mp.mpf(m) ** 2 * mp.cos(a) ** 4)

    def trowbridge_reitz(a: Any) -> Any:
        c2 = mp.mpf(0.3) ** 2
        return (c2 / (mp.cos(a) ** 2 * (c2 - 1) + 1)) ** 2

    gaussian = CookTorrance(slopes=0.35, ior=1.6, distribution="gaussian")
    return {
        "Beckmann": (CookTorrance(slopes=0.35, ior=1.6), beckmann(0.35), 1.6),
        "Gaussian": (gaussian, lambda a: mp.exp(-((a / mp.mpf(0.35)) ** 2)), 1.6),
        "narrow": (CookTorrance(slopes=1e-3, ior=1.6), beckmann(1e-3), 1.6),
        "D1": (Blinn(0.0, 1.0, 1.6, "phong", 13.0), lambda a: mp.cos(a) ** 13, 1.6),
        "D2": (Blinn(0.0, 1.0, 1.6, "gaussian", 2.0), lambda a: mp.exp(-((2 * a) ** 2)), 1.6),
        "D3": (Blinn(0.0, 1.0, 200.0, "trowbridge-reitz", 0.3), trowbridge_reitz, 200.0),
        "total reflection": (CookTorrance(slopes=0.6, ior=0.8), beckmann(0.6), 0.8),
    }


def plain_fresnel(cosine: Any, n: float) -> Any:
    """Cook1982: F = (g - c)^2/(2 (g + c)^2) (1 + (c (g + c) - 1)^2/(c (g - c) + 1)^2); 1 in total reflection."""
    g2 = mp.mpf(n) ** 2 + cosine**2 - 1
    if g2 <= 0:
        return mp.mpf(1)
    g = mp.sqrt(g2)
    less, more = g - cosine, g + cosine
    return less**2 / (2 * more**2) * (1 + (cosine * more - 1) ** 2 / (cosine * less + 1) ** 2)


@pytest.mark.parametrize("which", list(distributions()))
def test_facets_at_normal_incidence_against_mpmath(which: str) -> None:
    """There all is a function of alpha, G = min(1, 2 cos(2 alpha)), and the horizon at 45 degrees."""
    surface, d, n = distributions()[which]

    def integrand(a: Any) -> Any:
        g = min(mp.mpf(1), 2 * mp.cos(2 * a))
        return 8 * d(a) * plain_fresnel(mp.cos(a), n) * g * mp.cos(a) * mp.sin(a)

    with mp.workdps(25):
        ends = [mp.mpf(0), *(mp.mpf(q) for q in (1e-3, 3e-3, 8e-3, 0.05, 0.2)), mp.pi / 6, mp.pi / 4]
        if n < 1.0:
            ends = sorted([*ends, mp.acos(mp.sqrt(1 - mp.mpf(n) ** 2))])
            ends = [e for e in ends if e <= mp.pi / 4]
        expected = float(mp.quad(integrand, ends))
    assert surface.directional_hemispherical(0.0) == pytest.approx(expected, rel=ASKED)


@pytest.mark.parametrize("which", ["Beckmann", "Gaussian", "D1", "D2"])
def test_facets_at_grazing_incidence_against_another_quadrature(which: str) -> None:
    """There G is 2 (N.H)(N.V)/(V.H) all over the hemisphere, and rho the integral of 8/pi F D cos(alpha) dw_H."""
    surface, d, n = distributions()[which]

    def integrand(b: float, a: float) -> float:
        f = float(plain_fresnel(mp.mpf(math.sin(a) * math.cos(b)), n))
        return 16.0 / pi * f * float(d(a)) * math.cos(a) * math.sin(a)

    expected, _ = dblquad(integrand, 0.0, pi / 2, 0.0, pi / 2, epsabs=1e-10, epsrel=1e-9)
    assert surface.directional_hemispherical(pi / 2) == pytest.approx(expected, rel=ASKED)


@pytest.mark.parametrize(
    "surface",
    [
        CookTorrance(),
        CookTorrance(slopes=0.6, ior=1.5, fresnel="schlick"),
        CookTorrance(slopes=0.25, ior=1.1 + 7.0j, distribution="gaussian"),
        Blinn(),
        Blinn(0.2, 0.5, 1.8, "phong", 8.0),
        Phong(0.2, 0.5, 12.0),
    ],
    ids=lambda surface: f"{surface.name} {getattr(surface, 'distribution', '')}",
)
@pytest.mark.parametrize("theta", np.radians([20.0, 55.0, 80.0]))
def test_facets_against_the_brdf_over_directions(surface: Model, theta: float) -> None:
    """The rule of He-Torrance's integrals, in polar coordinates about the mirror direction in the disc of cosines."""
    fixed = np.array([math.sin(theta), 0.0, math.cos(theta)])
    moving, weight = about_mirror(float(theta), 0.05, 1.0, 60)
    for pair, got in (
        ((fixed, moving), surface.directional_hemispherical(theta)),
        ((moving, fixed), surface.hemispherical_directional(theta)),
    ):
        expected = float(np.vdot(surface.brdf_vectors(*pair), weight))
        assert got == pytest.approx(expected, rel=1e-5)  # that rule does not know of the kinks of G


@pytest.mark.parametrize("theta", [1.569, 1.56905, 1.5705])
def test_exact_grooves_near_grazing_take_few_directions(theta: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against panels of another rule, which halve toward the horizon, where the BRDF changes fastest."""
    surface = OrenNayar(1.0, 89.0, "exact")
    edges = [*(pi / 2 - 0.5 ** np.arange(14.0)), pi / 2]
    polar, w_polar = panels(np.array([0.0, *edges]), 10)
    azimuth, w_azimuth = panels(np.linspace(0.0, pi, 5), 10)
    values = surface.brdf(theta, 0.0, polar[:, None], azimuth)
    expected = float(2.0 * (w_polar * np.cos(polar) * np.sin(polar)) @ values @ w_azimuth)
    asked = []
    plain = OrenNayar.brdf_vectors

    def counted(self: OrenNayar, *pair: Floats, **options: Any) -> Any:
        values = plain(self, *pair, **options)
        asked.append(values.size)
        return values

    monkeypatch.setattr(OrenNayar, "brdf_vectors", counted)
    assert surface.directional_hemispherical(theta) == pytest.approx(expected, rel=1e-6)  # what the form states
    assert sum(asked) < 10_000  # of about 30 us each; before boxes shrank toward the horizon 100 000 and more


@pytest.mark.parametrize("surface", [OrenNayar(0.9, 30.0), OrenNayar(0.6, 15.0, "qualitative")])
@pytest.mark.parametrize("theta", np.radians([35.0, 80.0]))
def test_oren_nayar_against_another_quadrature(surface: Model, theta: float) -> None:
    def integrand(phi: float, polar: float) -> float:
        return 2.0 * surface.brdf(theta, 0.0, polar, phi) * math.cos(polar) * math.sin(polar)

    expected = sum(
        dblquad(integrand, *polar, *azimuth, epsabs=1e-10, epsrel=1e-9)[0]
        for polar in ((0.0, theta), (theta, pi / 2))
        for azimuth in ((0.0, pi / 2), (pi / 2, pi))
    )
    assert surface.directional_hemispherical(theta) == pytest.approx(expected, rel=ASKED)


def test_oren_nayars_exact_form_to_its_own_tolerance() -> None:
    """White facets with both bounces lose only what would go a third time; against four hundred thousand directions."""
    surface = OrenNayar(1.0, 20.0, "exact")
    moving, weight = about_mirror(0.6, 0.25, 1.0, 14)
    expected = float(np.vdot(surface.brdf_vectors(np.array([math.sin(0.6), 0.0, math.cos(0.6)]), moving), weight))
    got = surface.directional_hemispherical(0.6)
    assert got == pytest.approx(expected, rel=2e-5)  # that rule does not know of the kinks
    assert 0.97 < got < 1.0


# --- energy, reciprocity ------------------------------------------------------------------------------------------


@given(m=st.floats(0.01, 0.3), theta=st.floats(0.0, pi / 2))
@settings(max_examples=40, deadline=None)
def test_facets_without_loss_reflect_no_more_than_falls_on_gentle_slopes(m: float, theta: float) -> None:
    """F = 1: what the grooves hide is lost, and near the normal on gentle slopes they hide next to nothing."""
    mirror = CookTorrance(slopes=m, ior=1e8, convention="normalised")
    assert mirror.directional_hemispherical(theta) <= 1.0 + 1e-6  # at grazing the index leaves 1e-8 out, as 1/cos
    if m < 0.02:
        # 1 - G and the tails go with exp(-tan^2/m^2); the area of facets, 1/cos(alpha), with m^2
        assert mirror.directional_hemispherical(0.4 * theta) == pytest.approx(1.0, abs=2.0 * m * m + 1e-6)


RECIPROCAL = [
    CookTorrance(),
    Blinn(),
    OrenNayar(),
    HeTorrance(),
    OrenNayar(0.8, form="single-slope", slope_deg=20.0, groove_azimuth_deg=30.0),
]


@pytest.mark.parametrize("surface", RECIPROCAL, ids=lambda surface: f"{surface.name} {getattr(surface, 'form', '')}")
def test_both_are_equal_for_reciprocal_models(surface: Model) -> None:
    angles = np.radians([10.0, 70.0])
    there = surface.directional_hemispherical(angles, phi_i=0.4)
    assert surface.hemispherical_directional(angles, phi_r=0.4) == pytest.approx(there, rel=2 * ASKED)


def test_grooves_have_an_azimuth_of_their_own() -> None:
    grooves = OrenNayar(0.8, form="single-slope", slope_deg=30.0, groove_azimuth_deg=0.0)
    across, along = grooves.directional_hemispherical(1.2, phi_i=[0.0, pi / 2])
    turned = OrenNayar(0.8, form="single-slope", slope_deg=30.0, groove_azimuth_deg=90.0)
    assert abs(across - along) > 1e-3
    assert turned.directional_hemispherical(1.2, phi_i=[pi / 2, pi]) == pytest.approx([across, along], rel=2 * ASKED)


# --- spike, sums, other people's models ---------------------------------------------------------------------------


def test_the_spike_can_be_left_out() -> None:
    smooth = HeTorrance(sigma0_um=0.05, tau_um=2.0, diffuse_albedo=0.1)
    whole = smooth.directional_hemispherical(ANGLES)
    lobe = smooth.directional_hemispherical(ANGLES, spike=False)
    assert whole - lobe == pytest.approx(smooth.specular_reflectivity(ANGLES), rel=1e-12)
    assert bool(np.all(lobe > 0.1))
    assert smooth.hemispherical_directional(ANGLES, spike=False) == pytest.approx(lobe, rel=1e-12)


def test_a_sum_is_the_sum_of_its_terms() -> None:
    terms = [(HeTorrance(sigma0_um=0.1), 0.3), (Phong(0.2, 0.5, 9.0), 0.5), (Lambert(0.4), 0.2), (Phong(), 0.0)]
    both = Sum(*terms)
    for spike in (True, False):
        expected = sum(w * m.directional_hemispherical(ANGLES, spike=spike) for m, w in terms)
        assert both.directional_hemispherical(ANGLES, spike=spike) == pytest.approx(expected, rel=1e-12)
        expected = sum(w * m.hemispherical_directional(ANGLES, spike=spike) for m, w in terms)
        assert both.hemispherical_directional(ANGLES, spike=spike) == pytest.approx(expected, rel=1e-12)
    assert Sum((Phong(), 0.0)).directional_hemispherical(pi / 2) == 0.0


@dataclass(frozen=True, repr=False)
class Foreign(Model):
    """f = (N.L) (1 + x_r)/pi: neither reciprocal nor the same at every azimuth, and with a spike."""

    name: ClassVar[str] = "foreign"

    @property
    def convention(self) -> str:
        return "A model of somebody else."

    def brdf_vectors(self, omega_i: Any, omega_r: Any, *, wavelength_nm: Any = 550.0, out: Any = None) -> Any:
        i, r = np.asarray(omega_i), np.asarray(omega_r)
        return i[..., 2] * (1.0 + r[..., 0]) / pi

    def specular_reflectivity(self, theta_i: Any, *, wavelength_nm: Any = 550.0, out: Any = None) -> Any:
        return np.full(np.shape(theta_i), 0.125)


def test_other_peoples_models_have_both_reflectances() -> None:
    phi = 0.7
    dh = Foreign().directional_hemispherical(ANGLES, phi_i=phi)
    assert dh == pytest.approx(np.cos(ANGLES) + 0.125, rel=ASKED)  # the part with x_r integrates to 0
    hd = Foreign().hemispherical_directional(ANGLES, phi_r=phi, spike=False)
    assert hd == pytest.approx(2.0 / 3.0 * (1.0 + np.sin(ANGLES) * math.cos(phi)), rel=ASKED)


def test_an_integral_that_does_not_converge_is_told() -> None:
    class Rough(Foreign):
        def brdf_vectors(self, omega_i: Any, omega_r: Any, *, wavelength_nm: Any = 550.0, out: Any = None) -> Any:
            shape = np.broadcast_shapes(np.shape(omega_i), np.shape(omega_r))[:-1]
            return np.random.default_rng(1).uniform(0.0, 1.0, shape)

    with pytest.raises(DataError, match="foreign"):
        Rough().directional_hemispherical(0.3)


# --- arguments, speed ---------------------------------------------------------------------------------------------


def test_arguments_broadcast_and_are_checked() -> None:
    copper = CookTorrance(ior="Cu")
    table = copper.directional_hemispherical(ANGLES[:, None], wavelength_nm=[450.0, 650.0])
    assert table.shape == (4, 2)
    assert table[1, 1] == copper.directional_hemispherical(ANGLES[1], wavelength_nm=650.0)
    with pytest.raises(ArgumentError, match="theta_i"):
        copper.directional_hemispherical(2.0)
    with pytest.raises(ArgumentError, match="theta_r"):
        copper.hemispherical_directional(math.nan)
    with pytest.raises(ArgumentError, match="phi_r"):
        copper.hemispherical_directional(0.1, phi_r=math.inf)
    with pytest.raises(ArgumentError, match="wavelength_nm"):
        Lambert().directional_hemispherical(0.1, wavelength_nm=-1.0)


@given(theta=st.lists(st.floats(0.0, pi / 2), min_size=2, max_size=5))
@settings(max_examples=20, deadline=None)
def test_an_angle_alone_gives_what_it_gives_among_others(theta: list[float]) -> None:
    surface = CookTorrance(slopes=0.2, ior=0.8)
    together = surface.directional_hemispherical(theta)
    alone: Floats = np.array([surface.directional_hemispherical(t) for t in theta])
    assert together == pytest.approx(alone, rel=2 * ASKED)  # panels follow the angle nearest to grazing
