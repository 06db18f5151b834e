"""The models against their specification: compiled kernels and reference digits against `gonio.models.plain`.

The kernels are good to some 1e-15 (1 + conditioning); the plain formulas lose more, and each tolerance says what: a
count of roundings, eps, times the factor by which the formula lets them grow. Directions are drawn at random, and set
where formulas have difficulties. Where a plain formula is 0/0 it is not asked.
"""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any, cast

import numpy as np
import pytest

from gonio.instrument import apparent_spike
from gonio.models import Blinn, CookTorrance, HeTorrance, OrenNayar, Phong, fresnel, htsg
from gonio.models.blinn import coefficient
from gonio.models.cook_torrance import unblocked_fraction
from gonio.models.plain import blinn, cook_torrance, he_torrance, he_torrance_appendix_a, oren_nayar
from gonio.models.plain import fresnel as plain_fresnel
from gonio.models.plain.vectors import direction, dot, length, polar
from tests.gonio.models.reference import cases

EPS = float(np.finfo(float).eps)
PI = math.pi
INDICES = (1.5, 0.7, 1.0 + 0.1j, 0.77 + 6.08j, 0.05 + 3.9j, 2.15 + 20.7j)

HARD_DEG = [
    (0.0, 0.0, 0.0, 0.0),  # both along the normal
    (0.0, 0.0, 40.0, 10.0),
    (30.0, 0.0, 30.0, 180.0),  # mirror
    (30.0, 20.0, 30.0, 20.0),  # retro
    (50.0, 0.0, 50.0001, 180.0001),  # beside the mirror
    (50.0, 0.0, 50.0, 1e-5),  # beside retro
    (70.0, 0.0, 20.0, 90.0),  # cos(dphi) = 0
    (89.9, 0.0, 30.0, 180.0),  # grazing
    (45.0, 0.0, 89.9, 100.0),
    (89.0, 0.0, 89.5, 180.0),  # forward grazing
    (89.5, 0.0, 89.0, 3.0),  # backward grazing
    (80.0, 350.0, 80.0, 170.0),
]


Angles = tuple[Any, Any, Any, Any]


def pairs(seed: int, count: int = 60) -> Angles:
    """theta_i, phi_i, theta_r, phi_r [rad]: hard ones, then random ones, up to 89 degrees."""
    rng = np.random.default_rng(seed)
    theta, phi = rng.uniform(0.0, math.radians(89.0), (2, count)), rng.uniform(0.0, 2.0 * PI, (2, count))
    drawn = np.stack([theta[0], phi[0], theta[1], phi[1]], axis=1)
    return tuple(np.concatenate([np.radians(HARD_DEG), drawn]).T)


def vectors(seed: int) -> tuple[np.ndarray, np.ndarray]:
    theta_i, phi_i, theta_r, phi_r = pairs(seed)
    return direction(theta_i, phi_i), direction(theta_r, phi_r)


def agree(got: Any, plain: Any, loss: Any, roundings: float = 8.0, scale: Any = None) -> None:
    """`got` is within so many roundings of `plain`, each worth eps (1 + loss); below 1e-290 both are 0."""
    got, plain = np.asarray(got), np.asarray(plain)
    limit = roundings * EPS * (1.0 + np.asarray(loss)) * (np.abs(plain) if scale is None else scale) + 1e-290
    worst = np.argmax(np.abs(got - plain) / limit)
    assert np.all(np.abs(got - plain) <= limit), (
        f"[{worst}]: {np.ravel(got)[worst]!r} instead of {np.ravel(plain)[worst]!r}, "
        f"{np.ravel(np.abs(got - plain) / limit)[worst]:.3g} of the tolerance"
    )


# --- facets that reflect as mirrors -------------------------------------------------------------------------------


def facet_loss(light: np.ndarray, view: np.ndarray) -> tuple[Any, Any]:
    """The angle alpha, and what F and G lose: unit vectors are uncertain by eps, and H by eps/|L + V|."""
    h = cook_torrance.H(light, view)
    return polar(h), 1.0 / dot(view, h) ** 2


def schlick(f0: Any, theta: Any, ior: complex) -> Any:
    return plain_fresnel.schlick(theta, f0)


@pytest.mark.parametrize("reflectance", ["exact", "schlick"])
@pytest.mark.parametrize("distribution", ["beckmann", "gaussian"])
def test_cook_torrance(distribution: str, reflectance: str) -> None:
    light, view = vectors(1)
    alpha, loss = facet_loss(light, view)
    D = {"beckmann": cook_torrance.D_beckmann, "gaussian": cook_torrance.D_gaussian}[distribution]
    for ior, slopes in itertools.product(INDICES, (((0.4, 0.4), (0.2, 0.6)), ((0.05, 1.0),), ((1.5, 1.0),))):
        f0 = plain_fresnel.reflectance(0.0, ior)
        F: dict[str, Any] = {"exact": plain_fresnel.reflectance, "schlick": functools.partial(schlick, f0)}
        plain = cook_torrance.brdf(light, view, slopes, ior, 0.3, 0.6, 0.8, D, F[reflectance])
        m = min(m for m, _ in slopes)
        # dlnD/dalpha, of an alpha that is uncertain as H is; N.L and N.V are exact
        steep = (
            np.tan(alpha) * (1.0 + 1.0 / np.cos(alpha) ** 2 / m**2) if D is cook_torrance.D_beckmann else alpha / m**2
        )
        more: dict[str, Any] = {"distribution": distribution, "fresnel": reflectance, "diffuse_albedo": 0.8, "ior": ior}
        model = CookTorrance(0.3, 0.6, slopes, **more)
        agree(model.brdf_vectors(light, view), plain, 4.0 * (1.0 + steep) * loss)
        base = 0.6 * 0.8 / PI
        quarter = CookTorrance(0.3, 0.6, slopes, convention="normalised", **more)
        agree(quarter.brdf_vectors(light, view) - base, (plain - base) / 4.0, 4.0 * (1.0 + steep) * loss, scale=plain)


def test_cook_torrance_index_of_a_reflectance_and_colours() -> None:
    f0 = np.array([0.0, 1e-6, 0.04, 0.5, 0.95, 0.999])
    n = cook_torrance.n(f0)
    agree([fresnel.n_from_f0(float(f)) for f in f0], n, 1.0 / (1.0 - f0))
    # F_0 = ((n - 1)/(n + 1))^2 of n near 1 loses n/(n - 1)
    agree(cook_torrance.F_0(n[1:]), f0[1:], 1.0 / (n[1:] - 1.0) + n[1:])
    cos = np.linspace(0.0, 1.0, 21)
    for k in (1, 2, 3, 4):
        F = cook_torrance.F(cos, n[k])
        # g - c cancels where n is near 1, and 1 - F where it is large
        agree(fresnel.reflectance(cos, n[k]), F, 10.0 * (n[k] + 1.0 / (n[k] - 1.0)))
        first, last = np.array([0.95, 0.64, 0.54]), np.array([1.0, 0.98, 0.9])
        shifted = cook_torrance.colour(first, last, F[:, np.newaxis], f0[k])
        agree(fresnel.colour_shift(cos, float(f0[k]), first, last), shifted, 20.0 / (1.0 - f0[k]) + 20.0 / (n[k] - 1.0))


def test_cook_torrance_ambient_light() -> None:
    # a horizon that rises toward one side; 1000 x 1000 cells are good to 1/1000
    def horizon(phi: Any) -> Any:
        return 0.5 * (1.0 + np.cos(phi))

    def unblocked(theta: Any, phi: Any) -> Any:
        return PI / 2 - theta > horizon(phi)

    phi = 2.0 * PI * np.arange(720) / 720
    assert cook_torrance.f(unblocked) == pytest.approx(unblocked_fraction(horizon(phi)), abs=1e-3)
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
    assert model.ambient_reflectance() == pytest.approx(PI * 0.7 / PI, rel=4 * EPS)  # R_a = pi R_d


BLINN = {"phong": blinn.D_1, "gaussian": blinn.D_2, "trowbridge-reitz": blinn.D_3}


@pytest.mark.parametrize("distribution", list(BLINN))
def test_blinn(distribution: str) -> None:
    light, eye = vectors(2)
    alpha, loss = facet_loss(light, eye)
    for n, beta in itertools.product((1.5, 1.8, 200.0), (0.05, 0.3, 1.2)):
        c = {"phong": blinn.c_1, "gaussian": blinn.c_2, "trowbridge-reitz": blinn.c_3}[distribution](beta)
        # 1 - cos^2(beta) cancels
        assert coefficient(distribution, beta) == pytest.approx(c, rel=20 * EPS / beta**2)
        D = BLINN[distribution](alpha, c)
        # dlnD/dalpha; and the denominator of D_3 cancels
        steep = {
            "phong": c * np.tan(alpha),
            "gaussian": 2.0 * alpha * c**2,
            "trowbridge-reitz": 1.0 / c**2 + np.tan(alpha),
        }[distribution]
        cos = np.minimum(dot(eye, blinn.H(light, eye)), 1.0)
        for form in ("exact", "1977"):
            F = blinn.F_shortcut(cos, n, printed=form == "1977")
            s = blinn.s(D, blinn.G(light, eye), F, eye)
            model = Blinn(0.6, 0.4, n, distribution, float(c), form)
            # 1 - F is 4 g c of order 1/n: nothing is lost in F
            agree(model.brdf_vectors(light, eye), blinn.brdf(s, light, 0.6, 0.4), 4.0 * (1.0 + steep) * loss)
            theta_i, phi_i, theta_r, phi_r = pairs(2)
            # N.E by its angle: tan(theta_r)
            agree(
                model.highlight(theta_i, phi_i, theta_r, phi_r), s, 4.0 * (1.0 + steep) * loss * (1.0 + np.tan(theta_r))
            )
            by_cases = blinn.G_over_NE(light, eye) * D * F
            agree(
                model.highlight(theta_i, phi_i, theta_r, phi_r),
                by_cases,
                4.0 * (1.0 + steep) * loss * (1.0 + np.tan(theta_r)),
            )


def test_phong() -> None:
    light, eye = vectors(3)
    alpha, loss = facet_loss(light, eye)
    for c1 in (0.0, 1.0, 50.0, 1000.0):
        s = blinn.s_phong(light, eye, c1)
        # cos^c1 of a rounded N.H: c1 roundings, and c1 tan(alpha) of H's own
        steep = c1 * (1.0 + np.tan(alpha))
        model = Phong(0.5, 0.4, c1)
        agree(model.brdf_vectors(light, eye), blinn.brdf(s, light, 0.5, 0.4), (1.0 + steep) * loss)
        agree(model.highlight(*pairs(3)), s, (1.0 + steep) * loss)


def test_blinn_texture() -> None:
    alpha = np.linspace(0.0, PI / 2, 40)
    for c_min, t in itertools.product((0.1, 0.5, 1.0), (0.0, 0.3, 1.0)):
        plain = blinn.D_3_textured(alpha, c_min, t)
        # the denominator of D_3 cancels
        agree(Blinn.textured_d3(np.cos(alpha), c_min, t), plain, 2.0 / c_min**2)


def test_fresnel() -> None:
    theta = np.concatenate([[0.0, 1e-6, PI / 2 - 1e-6, PI / 2], np.linspace(0.01, 1.56, 40)])
    for ior in (*INDICES, 1.0001, 1.0 + 1e-3j):
        F_s, F_p = plain_fresnel.amplitudes(theta, ior)
        got_s, got_p = fresnel.amplitudes(np.cos(theta), ior)
        # the numerators cancel for n near 1, to |n^2 - 1|; sin^2 of the angle and of the cosine differ by eps,
        # which q magnifies by 1/|q|, |q|^2 >= |n^2 - sin^2|
        q2 = np.abs(ior**2 - np.sin(theta) ** 2)
        loss = 4.0 * (1.0 + abs(ior) ** 2) / abs(ior**2 - 1.0) * (1.0 + 1.0 / q2)
        agree(got_s, F_s, loss, scale=np.maximum(np.abs(F_s), abs(ior**2 - 1.0)))
        agree(got_p, F_p, loss, scale=np.maximum(np.abs(F_p), abs(ior**2 - 1.0)))
        agree(fresnel.reflectance(np.cos(theta), ior), plain_fresnel.reflectance(theta, ior), loss, scale=1.0)


# --- facets that reflect diffusely --------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma_deg", [0.0, 5.0, 30.0, 60.0, 89.0])
def test_oren_nayar_functional_and_qualitative(sigma_deg: float) -> None:
    theta_i, phi_i, theta_r, phi_r = pairs(4)
    sigma, rho = math.radians(sigma_deg), 0.8
    at = (theta_i, theta_r, phi_r - phi_i, sigma, rho)
    # an angle's rounding is worth tan^2 in tan(beta), and tan((alpha + beta)/2)^2 in the other; phi's 2 pi tan(beta).
    # The sum may pass through zero: held against its largest term
    beta, half = np.minimum(theta_i, theta_r), (theta_i + theta_r) / 2.0
    loss, scale = 8.0 * (np.tan(beta) ** 2 + np.tan(half) ** 2 + np.tan(beta)), rho / PI
    for interreflections in (True, False):
        twice = oren_nayar.L2(*at) if interreflections else 0.0
        plain = oren_nayar.f_r(oren_nayar.L(oren_nayar.L1(*at), twice), theta_i)
        model = OrenNayar(rho, sigma_deg, "functional", interreflections=interreflections)
        agree(model.brdf(theta_i, phi_i, theta_r, phi_r), plain, loss, scale=scale)
    plain = oren_nayar.f_r(oren_nayar.L_qualitative(*at), theta_i)
    agree(OrenNayar(rho, sigma_deg, "qualitative").brdf(theta_i, phi_i, theta_r, phi_r), plain, loss, scale=scale)


def test_oren_nayar_parallel_grooves() -> None:
    theta_i, phi_i, theta_r, phi_r = pairs(5)
    s, v = direction(theta_i, phi_i), direction(theta_r, phi_r)
    for slope_deg, azimuth_deg, twice in itertools.product((0.0, 20.0, 45.0, 80.0), (0.0, 75.0), (True, False)):
        theta_a, phi_a = math.radians(slope_deg), math.radians(azimuth_deg)
        plain = oren_nayar.L_uni_directional(s, v, theta_a, phi_a, 0.8, twice) / np.cos(theta_i)
        model = OrenNayar(
            0.8, form="single-slope", slope_deg=slope_deg, groove_azimuth_deg=azimuth_deg, interreflections=twice
        )
        # s.a and v.a of facets that are nearly edge-on, over both cosines; d(x, y) cancel to m_v m_s, above cos cos
        loss = 4.0 * np.tan(theta_a) ** 2 + 1.0 / (np.cos(theta_i) * np.cos(theta_r))
        agree(model.brdf(theta_i, phi_i, theta_r, phi_r), plain, loss, scale=np.maximum(plain, 0.8 / PI))


@pytest.mark.parametrize("twice", [True, False])
def test_oren_nayar_grooves_in_every_direction(twice: bool) -> None:
    found = [at for at in np.stack(pairs(6, 4), axis=1) if max(at[0], at[2]) < math.radians(85.0)]
    for theta_i, phi_i, theta_r, phi_r in found:  # nearer to grazing a facet is lit over less than a few nodes
        s, v = direction(theta_i, phi_i), direction(theta_r, phi_r)
        # kinks between 720 nodes of phi_a: (2 pi/720)^2 of their jump in slope, tan(theta) tan(theta_a)
        steep = 1.0 + max(math.tan(theta_i), math.tan(theta_r))
        model = OrenNayar(0.8, form="single-slope", slope_deg=40.0, interreflections=twice)
        plain = oren_nayar.L_isotropic(s, v, math.radians(40.0), 0.8, twice) / math.cos(theta_i)
        limit = (2.0 * PI / 720) ** 2 * steep * 0.8 / PI
        assert model.brdf(theta_i, phi_i, theta_r, phi_r) == pytest.approx(plain, abs=limit)
        # kinks in theta_a between 100 nodes too, where facets begin to be shadowed
        model = OrenNayar(0.8, 30.0, "exact", interreflections=twice)
        plain = oren_nayar.L_gaussian(s, v, math.radians(30.0), 0.8, twice, nodes=100) / math.cos(theta_i)
        assert model.brdf(theta_i, phi_i, theta_r, phi_r) == pytest.approx(
            plain, abs=(PI / 2 / 100) ** 2 * steep * 0.8 / PI
        )


# --- He-Torrance --------------------------------------------------------------------------------------------------

SURFACES = [  # sigma0 and tau [um], wavelength [um], index: Figs. 7, 8, 9, 12, 10, and a smooth one
    (0.28, 1.77, 2.0, 2.15 + 20.7j),
    (0.28, 1.77, 0.5, 0.77 + 6.08j),
    (1.45, 13.2, 0.5, 1.7),
    (0.18, 3.0, 0.55, 0.96 + 6.69j),
    (2.2, 0.5, 0.55, 1.5),
    (0.001, 2.0, 0.5, 0.7),
]


def lobe_loss(theta_i: Any, phi_i: Any, theta_r: Any, phi_r: Any, sigma0: float, tau: float, lam: float) -> Any:
    """What eq. 71 loses: the logarithm of the series g ln(g) + c; c by v_xy, tau k0; angles near grazing; shadowing."""
    k_i, k_r = he_torrance.directions(theta_i, phi_i, theta_r, phi_r)
    sigma = he_torrance_appendix_a.sigma(theta_i, theta_r, sigma0, tau)
    g = he_torrance.g(theta_i, theta_r, sigma, lam)
    c = he_torrance_appendix_a.v_xy(k_i, k_r, lam) ** 2 * tau**2 / 4.0
    series = g * (1.0 + np.abs(np.log(g))) + np.minimum(c, g + np.sqrt(c)) + np.sqrt(c) * tau * 2.0 * PI / lam
    grazing = np.tan(theta_i) + np.tan(theta_r)
    return 4.0 * series + grazing * (1.0 + g) + 1.0 / length(k_r - k_i) ** 2


@pytest.mark.parametrize("surface", SURFACES, ids=str)
def test_he_torrance_lobe_and_spike(surface: tuple[float, float, float, complex]) -> None:
    sigma0, tau, lam, n = surface
    at = pairs(7, 30)
    loss = lobe_loss(*at, sigma0, tau, lam)
    for form in ("smith", "paper"):
        model = HeTorrance(sigma0, tau, n, 0.3, form)
        plain = he_torrance.rho_dd(*at, sigma0, tau, lam, n, printed=form == "paper") + he_torrance.rho_ud(0.3)
        agree(model.brdf(*at, wavelength_nm=1000.0 * lam), plain, loss)
        theta = np.radians([0.0, 1e-3, 20.0, 60.0, 85.0, 89.9])
        gg = he_torrance.g(theta, theta, he_torrance_appendix_a.sigma(theta, theta, sigma0, tau), lam)
        plain = he_torrance.rho_s(theta, sigma0, tau, lam, n, printed=form == "paper")
        # exp(-g), by angles
        agree(model.specular_reflectivity(theta, wavelength_nm=1000.0 * lam), plain, (1.0 + gg) * (2.0 + np.tan(theta)))


@pytest.mark.parametrize("surface", SURFACES[:4], ids=str)
def test_he_torrance_polarised(surface: tuple[float, float, float, complex]) -> None:
    sigma0, tau, lam, n = surface
    at = cast(Angles, tuple(part[7:] for part in pairs(8, 40)))  # M is 0/0 along the normal and in retro-reflection
    k_i, k_r = he_torrance.directions(*at)
    apart = length(np.cross(k_r, k_i)) ** 2
    polarised = 1.0 / apart / np.minimum(np.sin(at[0]), np.sin(at[2]))
    model = HeTorrance(sigma0, tau, n, 0.2)
    jones = model.jones(*at, wavelength_nm=1000.0 * lam)
    agree(jones, he_torrance.J(k_i, k_r, n), polarised[:, None, None], scale=1.0)
    plain = he_torrance.mueller(*at, sigma0, tau, lam, n, 0.2)
    loss = (polarised + lobe_loss(*at, sigma0, tau, lam))[:, None, None]
    agree(model.mueller(*at, wavelength_nm=1000.0 * lam), plain, loss, scale=np.abs(plain).max((1, 2), keepdims=True))


def test_he_torrance_spike_in_its_cone() -> None:
    """Eqs. 6, 10 and 74, by an instrument whose receiver takes in less than the cone of specular reflection."""
    sigma0, tau, lam, n = SURFACES[0]
    source, theta_i = 1e-3, 0.8
    for model, plain in (
        (
            HeTorrance(sigma0, tau, n),
            he_torrance.rho_sp(he_torrance.rho_s(theta_i, sigma0, tau, lam, n), theta_i, source),
        ),
        (HeTorrance(0.0, tau, n), he_torrance.rho_sp_smooth(theta_i, source, n)),
    ):
        for away in (0.0, 0.1):  # the cone is 0.018 rad wide
            theta_r = theta_i + away
            cones = {"source_solid_angle_sr": source, "receiver_solid_angle_sr": 1e-5}
            at = (theta_i, 0.0, theta_r, PI)
            got = apparent_spike(model, *at, wavelength_nm=1000.0 * lam, spike="nominal", **cones)
            inside = he_torrance.Delta(direction(theta_r, 0.0), direction(theta_i, 0.0), source)
            # the overlap of the cones is all of the receiver's, or nothing
            assert got == pytest.approx(plain * inside, rel=1e-12)


def test_he_torrance_hemisphere() -> None:
    sigma0, tau, lam, n = SURFACES[1]
    for theta_i in (0.0, 0.6, 1.2):

        def lobe_of(theta: Any, phi: Any, at: float = theta_i) -> Any:
            return he_torrance.rho_dd(at, 0.0, theta, phi, sigma0, tau, lam, n)

        lobe = he_torrance.rho_dh(lobe_of, 64)
        total = he_torrance.rho_s(theta_i, sigma0, tau, lam, n) + lobe + 0.1
        model = HeTorrance(sigma0, tau, n, 0.1)
        # a lobe of 20 degrees is resolved; shadowing sets in fast near the horizon
        got = model.directional_hemispherical(theta_i, wavelength_nm=1000.0 * lam)
        assert got == pytest.approx(total, rel=1e-8)


def test_he_torrance_parts() -> None:
    theta = np.radians([0.0, 0.01, 10.0, 45.0, 80.0, 89.0, 89.99])
    for sigma0, tau in itertools.product((1e-3, 0.28, 4.4), (0.5, 1.77, 16.0)):
        for form in ("smith", "paper"):
            S_1 = he_torrance_appendix_a.S_1(theta, sigma0, tau, form == "paper")
            # h from an angle, exp(-h^2) where it counts, h < 6
            agree(htsg.shadowing(theta, sigma0, tau, form), S_1, 2.0 * np.tan(theta) + 72.0)
    K = np.concatenate([[0.0], 10.0 ** np.arange(-30, 31)])
    x = he_torrance_appendix_a.z0_over_sigma0(K)
    agree(htsg.effective_roughness(K), 1.0 / np.sqrt(1.0 + x**2), 1.0)
    for g, c in itertools.product((0.0, 1e-8, 0.3, 5.0, 60.0, 700.0), (0.0, 1e-3, 2.0, 300.0, 1e5)):
        plain = he_torrance_appendix_a.log_series(g, c)
        if g == 0.0:
            assert plain == htsg.log_series(g, c) == -math.inf
        else:
            # terms of the logarithm, the largest of them g ln(g), m ln(m) at its top, and c/m
            top = max(g, math.sqrt(c))
            agree(
                htsg.log_series(g, c), plain, 4.0 * (top * (1.0 + abs(math.log(top))) + g + abs(math.log(g))), scale=1.0
            )


# --- the specification against reference digits ---------------------------------------------------------------------


def test_plain_cook_torrance_digits() -> None:
    """Formulas of scalars, so that N need not be z."""
    for case in cases("cook_torrance_colour"):
        i, out = case["in"], case["out"]
        n = cook_torrance.n(i["F0"])
        # 1 - sqrt(F_0) cancels; F as in test_cook_torrance_index_of_a_reflectance_and_colours
        agree(n, float(out["n_from_F0"]), 1.0 / (1.0 - i["F0"]))
        agree(cook_torrance.F(i["cos"], i["n"]), float(out["F_n"]), 2.0 * (i["n"] + 1.0 / abs(i["n"] - 1.0)))
        F = cook_torrance.F(i["cos"], n)
        agree(F, float(out["F_theta"]), 2.0 * (n + 1.0 / (n - 1.0)))
        colours = cook_torrance.colour(np.array(i["col0"]), np.array(i["col90"]), F, i["F0"])
        agree(colours, [float(c) for c in out["colour"]], 20.0 / (1.0 - i["F0"]) + 20.0 / (n - 1.0))


def in_frame(values: dict[str, float], *names: str) -> list[np.ndarray]:
    """Unit vectors in a frame whose z is N."""
    n, *others = (np.array([values[name + axis] for axis in "xyz"]) for name in ("N", *names))
    z = n / np.linalg.norm(n)
    x = np.cross([1.0, 0.0, 0.0] if abs(z[0]) < 0.9 else [0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return [np.array([o @ x, o @ np.cross(z, x), o @ z]) / np.linalg.norm(o) for o in others]


@pytest.mark.parametrize("model", ["cook_torrance", "blinn"])
def test_plain_facet_digits(model: str) -> None:
    tried = 0
    for case in cases(model):
        i, out = case["in"], case["out"]
        light, view = in_frame(i, "L", "V" if model == "cook_torrance" else "E")
        if (
            light[2] <= 1e-6 or view[2] <= 1e-6
        ):  # below the surface the models are 0; the turned N.L has lost its digits
            continue
        tried += 1
        alpha, loss = facet_loss(light, view)
        loss = loss + 1.0 / (light[2] * view[2]) + (case["cond"]["R_s" if model == "cook_torrance" else "s"] or 0.0)
        if model == "cook_torrance":
            slopes = tuple((i[f"m{j}"], i[f"w{j}"]) for j in range(1, 9) if f"m{j}" in i)
            ior = cook_torrance.n(i["F0"]) if "F0" in i else complex(i["n"], i.get("k", 0.0))
            D = cook_torrance.D_gaussian if "gauss" in case["tags"] else cook_torrance.D_beckmann
            got = cook_torrance.brdf(light, view, slopes, ior, distribution=D)
            agree(got, float(out["R_s"]), 4.0 * loss * (1.0 + 1.0 / min(m for m, _ in slopes)))
            agree(cook_torrance.G(light, view), float(out["G"]), 4.0 * loss)
        else:
            c = {1: blinn.c_1, 2: blinn.c_2, 3: blinn.c_3}[i["dist"]](i["beta"])
            agree(c, float(out["c"]), 1.0 / i["beta"] ** 2)
            D = {1: blinn.D_1, 2: blinn.D_2, 3: blinn.D_3}[i["dist"]](alpha, c)
            cos = min(float(dot(view, blinn.H(light, view))), 1.0)
            # 1 - cos^2(beta) cancels in c, the denominator in D_3
            loss = 4.0 * loss * (1.0 + (1.0 / i["beta"] ** 2))
            if i["n"] ** 2 + cos**2 > 1.0:  # beyond the critical angle Blinn's F is not a number
                for printed, key in ((False, "s"), (True, "s_if_F_printed_without_half")):
                    F = blinn.F_shortcut(cos, i["n"], printed)
                    # g - c cancels for n near 1
                    agree(
                        blinn.s(D, blinn.G(light, view), F, view),
                        float(out[key]),
                        loss * (1.0 + 1.0 / abs(i["n"] - 1.0)),
                    )
            agree(blinn.G_over_NE(light, view), float(out["G_over_NE"]), loss)
    assert tried > 40


def test_plain_blinn_texture_digits() -> None:
    for case in cases("blinn_texture"):
        i, out = case["in"], case["out"]
        agree(blinn.C_3(i["cmin"], i["t"]), float(out["c3"]), 0.0)
        alpha = math.acos(i["cosa"])
        # acos loses 1/sin(alpha), which D_3 takes times its slope, sin(alpha) cos(alpha)/c3^2
        loss = 2.0 / i["cmin"] ** 2
        agree(blinn.D_3_textured(alpha, i["cmin"], i["t"]), float(out["D3_texture"]), loss)
        agree(blinn.D_3(alpha, float(out["c3"])), float(out["D3"]), loss)
        for function, key in ((blinn.c_1, "c1_beta"), (blinn.c_2, "c2_beta"), (blinn.c_3, "c3_beta")):
            agree(function(i["beta"]), float(out[key]), 1.0 / i["beta"] ** 2 + 1.0 / abs(math.log(math.cos(i["beta"]))))


def test_plain_fresnel_digits() -> None:
    for case in cases("fresnel_complex"):
        i, out = case["in"], case["out"]
        n = complex(i["n"], i["k"])
        theta = math.acos(i["cos"])
        F_s, F_p = plain_fresnel.amplitudes(theta, n)
        # numerators cancel to |n^2 - 1|; the angle is rounded, which counts near the critical angle
        q2 = abs(n**2 - math.sin(theta) ** 2)
        loss = 2.0 * (1.0 + abs(n) ** 2) / abs(n**2 - 1.0) * (1.0 + 1.0 / q2)
        for got, key in ((F_s, "Fs"), (F_p, "Fp")):
            expected = complex(float(out[key + "_re"]), float(out[key + "_im"]))
            agree(got, expected, loss, scale=max(abs(expected), abs(n**2 - 1.0)))
        # F_p changes within cosines of 1/|n|
        agree(plain_fresnel.reflectance(theta, n), float(out["F2"]), loss + 4.0 * abs(n), scale=1.0)


def test_plain_oren_nayar_digits() -> None:
    for case in cases("oren_nayar_closed"):
        i, out = case["in"], case["out"]
        at = (i["theta_i"], i["theta_r"], i["phi"])
        alpha, beta = max(at[0], at[1]), min(at[0], at[1])
        agree(oren_nayar.C_1(i["sigma"]), float(out["C1"]), 1.0)
        agree(oren_nayar.C_2(alpha, beta, i["phi"], i["sigma"]), float(out["C2"]), 10.0, scale=1.0)
        agree(oren_nayar.C_3(alpha, beta, i["sigma"]), float(out["C3"]), 1.0)
        L1, L2 = (f(*at, i["sigma"], i["rho"]) for f in (oren_nayar.L1, oren_nayar.L2))
        # the file's condition is that of the angles; tan(beta) of a rounded pi/2 - beta is the rest
        loss = 2.0 * (1.0 + (case["cond"]["f_r"] or 0.0)) * (1.0 + math.tan(beta))
        agree(oren_nayar.f_r(oren_nayar.L(L1, L2), at[0]), float(out["f_r"]), loss)
        got = oren_nayar.f_r(oren_nayar.L_qualitative(*at, i["sigma"], i["rho"]), at[0])
        agree(got, float(out["qual_fr"]), loss)


def test_plain_oren_nayar_groove_digits() -> None:
    for case in cases("oren_nayar_single_slope"):
        i, out = case["in"], case["out"]
        s, v = direction(i["theta_i"], 0.0), direction(i["theta_r"], i["phi"])
        a = direction(i["theta_a"], i["phi_a"])
        cosines = math.cos(i["theta_i"]) * math.cos(i["theta_r"]) * math.cos(i["theta_a"])
        agree(oren_nayar.GAF(s, v, a), float(out["GAF_facet"]), 1.0 / cosines, scale=1.0)
        once = oren_nayar.L_uni_directional(s, v, i["theta_a"], i["phi_a"], i["rho"], interreflections=False)
        both = oren_nayar.L_uni_directional(s, v, i["theta_a"], i["phi_a"], i["rho"])
        agree(once, float(out["uni_L1"]), 1.0 / cosines, scale=1.0)
        # d(x, y) cancel
        agree(both - once, float(out["uni_L2"]), 1.0 / cosines, scale=1.0)
        around = oren_nayar.L_isotropic(s, v, i["theta_a"], i["rho"], interreflections=False)
        # kinks between 720 nodes
        assert around == pytest.approx(float(out["isotropic_L1"]), rel=2e-3)


def test_plain_oren_nayar_integral_digits() -> None:
    tried = 0
    for case in cases("oren_nayar_exact")[::2]:
        i, out = case["in"], case["out"]
        if min(math.cos(i["theta_i"]), math.cos(i["theta_r"])) < 0.2 or i["sigma"] < 0.08:
            continue  # nodes are 0.5 degrees apart: neither kinks near grazing nor a narrow P are resolved
        tried += 1
        s, v = direction(i["theta_i"], 0.0), direction(i["theta_r"], i["phi"])
        got = oren_nayar.L_gaussian(s, v, i["sigma"], i["rho"], nodes=100)
        # its docstring's 1e-4 is for 200 nodes of theta_a, errors are of second order
        assert got / math.cos(i["theta_i"]) == pytest.approx(float(out["f_r"]), rel=4e-4)
    assert tried > 5


def test_plain_he_torrance_digits() -> None:
    for case in cases("htsg_unpolarised"):
        i, out = case["in"], case["out"]
        lam, sigma0, tau, n = i["lam"], i["sigma0"], i["tau"], complex(i["n"], i["k"])
        # the file's phi counts from the mirror half-plane
        at = (i["theta_i"], PI, i["theta_r"], i["phi"])
        g = float(out["g"])
        if sigma0 == 0.0 or g > 1e3 or float(out["c"]) > 1e8 or min(math.cos(at[0]), math.cos(at[2])) < 1e-8:
            continue  # no h; too many terms; cosines of no digits
        cond = (case["cond"] or {}).get("rho_dd") or 0.0
        loss = 4.0 * (lobe_loss(*at, sigma0, tau, lam) + cond)
        for printed, key in ((False, "rho_dd"), (True, "rho_dd_paper_noexp")):
            agree(he_torrance.rho_dd(*at, sigma0, tau, lam, n, printed), float(out[key]), loss)
        cond = (case["cond"] or {}).get("rho_s") or 0.0
        agree(he_torrance.rho_s(at[0], sigma0, tau, lam, n), float(out["rho_s"]), 4.0 * (cond + math.tan(at[0])))
        if sigma0 > 0.0:
            tangents = math.tan(at[0]) + math.tan(at[2])
            got = he_torrance_appendix_a.sigma(at[0], at[2], sigma0, tau)
            agree(got, float(out["sigma"]), 2.0 * (1.0 + tangents))


def test_plain_he_torrance_parts_digits() -> None:
    for case in cases("htsg_shadowing"):
        i, out = case["in"], case["out"]
        at = (i["theta"], i["sigma0"], i["tau"])
        loss = 2.0 * (1.0 + (case["cond"]["S1"] or 0.0) + math.tan(i["theta"]))
        agree(he_torrance_appendix_a.S_1(*at), float(out["S1"]), loss)
        agree(he_torrance_appendix_a.S_1(*at, printed=True), float(out["S1_paper_noexp"]), loss)
        if float(out["K"]) > 0.0:  # it may underflow
            agree(
                he_torrance_appendix_a.K(*at), float(out["K"]), 2.0 * (1.0 + case["cond"]["K"] + math.tan(i["theta"]))
            )
    for case in cases("htsg_z0"):
        K = case["in"]["K"]
        if K <= 1e40:  # as far as the bisection goes
            agree(he_torrance_appendix_a.z0_over_sigma0(K), float(case["out"]["z0_over_sigma0"]), 1.0)
    for case in cases("htsg_series"):
        g, c = case["in"]["g"], case["in"]["c"]
        if max(g, math.sqrt(c)) <= 1e3:
            top = max(g, math.sqrt(c), 1.0)
            loss = 4.0 * (top * (1.0 + math.log(top)) + g + abs(math.log(g)) + case["cond"]["S"])
            agree(he_torrance_appendix_a.log_series(g, c), float(case["out"]["ln_S"]), loss, scale=1.0)


def test_plain_he_torrance_polarised_digits() -> None:
    tried = 0
    for case in cases("htsg_polarised"):
        i, out = case["in"], case["out"]
        at = (i["theta_i"], i["phi_i"] + PI, i["theta_r"], i["phi_i"] + i["phi"])
        k_i, k_r = he_torrance.directions(*at)
        apart = float(length(np.cross(k_r, k_i)))
        if min(math.sin(at[0]), math.sin(at[2]), apart) < 1e-4:
            continue  # M is 0/0 there
        tried += 1
        n = complex(i["n"], i["k"])
        parts = [[complex(float(out[f"J{a}{b}_re"]), float(out[f"J{a}{b}_im"])) for b in "sp"] for a in "sp"]
        # azimuths of up to 10 rad, s and p near the normal, M/|k_r x k_i|^2
        loss = 2.0 / apart**2 / min(math.sin(at[0]), math.sin(at[2]))
        agree(he_torrance.J(k_i, k_r, n), parts, loss, scale=1.0)
    assert tried > 30
