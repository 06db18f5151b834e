"""Properties of He-Torrance, and the limits that tie it to other papers."""

import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from gonio.errors import ArgumentError
from gonio.models import HeTorrance, fresnel, htsg
from gonio.models._hemisphere import panels

THETA = st.floats(0.0, 1.5)
PHI = st.floats(0.0, 2.0 * math.pi)
SURFACE = st.builds(
    HeTorrance,
    sigma0_um=st.floats(0.0, 20.0),
    tau_um=st.floats(0.05, 100.0),
    ior=st.builds(complex, st.floats(0.1, 10.0), st.floats(0.0, 20.0)),
    shadowing=st.sampled_from(["smith", "paper"]),
)


@settings(max_examples=40, deadline=None)
@given(SURFACE, THETA, PHI, THETA, PHI)
def test_mueller_is_the_brdf_and_passes_no_more_than_it_gets(
    surface: HeTorrance, ti: float, pi_: float, tr: float, pr: float
) -> None:
    matrix, brdf = surface.mueller(ti, pi_, tr, pr), surface.brdf(ti, pi_, tr, pr)
    # |J|^2 / 2 is |F|^2 by another route (eqs. 59-65 against 75)
    assert matrix[0, 0] == pytest.approx(brdf, rel=1e-11, abs=1e-290)
    assert np.all(np.abs(matrix) <= matrix[0, 0] * (1 + 1e-12))  # a pure Mueller matrix's largest element is m00


def test_perfect_conductor_keeps_unpolarised_light_unpolarised_and_all_polarisations_alike() -> None:
    """Needs the minus of eq. 64, which the print lacks: |F_s| = |F_p| = 1 makes J unitary."""
    jones = HeTorrance(sigma0_um=0.28, tau_um=1.77, ior=1e8j + 1e-3).jones(0.6, 0.3, 1.1, 2.0)
    np.testing.assert_allclose(jones @ jones.conj().T, np.eye(2), atol=1e-7)  # index 1e8: F = 1 - 1e-8


@pytest.mark.parametrize("theta_i", [0.0, 0.5, 1.2])
@pytest.mark.parametrize("theta_r", [0.1, 0.9])
def test_large_roughness_is_beckmann_with_smith(theta_i: float, theta_r: float) -> None:
    """g -> infinity: |F|^2 S D_B/(4 cos cos) with m = 2 sigma_eff/tau; the deviation falls as 1/g."""
    sigma0, tau = 200.0, 1000.0
    surface = HeTorrance(sigma0_um=sigma0, tau_um=tau, ior=1e8 + 0j)
    dphi = math.pi - 0.3
    omega_i = np.array([math.sin(theta_i), 0.0, math.cos(theta_i)])
    omega_r = np.array([math.sin(theta_r) * math.cos(dphi), math.sin(theta_r) * math.sin(dphi), math.cos(theta_r)])
    h = omega_i + omega_r
    tan2 = (h[0] ** 2 + h[1] ** 2) / h[2] ** 2
    k = sum(float(mp.tan(t) * mp.erfc(tau * mp.cot(t) / (2 * sigma0))) if t else 0.0 for t in (theta_i, theta_r))
    m2 = (2.0 * sigma0 * float(htsg.effective_roughness(k)) / tau) ** 2
    beckmann = math.exp(-tan2 / m2) / (math.pi * m2) * (1.0 + tan2) ** 2
    smith = htsg.shadowing(theta_i, sigma0, tau) * htsg.shadowing(theta_r, sigma0, tau)
    expected = smith * beckmann / (4.0 * math.cos(theta_i) * math.cos(theta_r))
    # g is 2e6 to 2e7 here, 1/g times (tan^2/m^2)^2 below 30; index 1e8 leaves F = 1 - 4e-8
    assert float(surface.brdf(theta_i, 0.0, theta_r, dphi)) == pytest.approx(expected, rel=3e-5)


def test_small_roughness_is_the_mirror() -> None:
    """g -> 0: the lobe falls as sigma^4 cos^2... as g exp(-c), the spike tends to |F|^2."""
    smooth = HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=1.5)
    rough = [HeTorrance(sigma0_um=s, tau_um=1.0, ior=1.5) for s in (1e-5, 1e-6)]
    assert smooth.brdf(0.3, 0.0, 0.4, 3.0) == 0.0
    ratio = rough[0].brdf(0.3, 0.0, 0.4, 3.0) / rough[1].brdf(0.3, 0.0, 0.4, 3.0)
    assert ratio == pytest.approx(100.0, rel=1e-6)  # g is 5e-8: the next term of the series
    assert rough[1].specular_reflectivity(0.3) == pytest.approx(smooth.specular_reflectivity(0.3), rel=1e-9)  # exp(-g)
    f_s = (math.cos(0.3) - math.sqrt(2.25 - math.sin(0.3) ** 2)) / (
        math.cos(0.3) + math.sqrt(2.25 - math.sin(0.3) ** 2)
    )
    f_p = (2.25 * math.cos(0.3) - math.sqrt(2.25 - math.sin(0.3) ** 2)) / (
        2.25 * math.cos(0.3) + math.sqrt(2.25 - math.sin(0.3) ** 2)
    )
    assert smooth.specular_reflectivity(0.3) == pytest.approx((f_s**2 + f_p**2) / 2, rel=1e-14)


def test_absorption_tends_to_none() -> None:
    at = (0.7, 0.0, 0.9, 2.8)
    clear = HeTorrance(ior=1.5).brdf(*at)
    for k in (1e-6, 1e-9):
        assert HeTorrance(ior=1.5 + 1j * k).brdf(*at) == pytest.approx(clear, rel=10.0 * k)  # first order in k at most


def test_total_reflection_below_index_one() -> None:
    """n = 0.75: beyond the critical angle every facet reflects all, as a conductor does."""
    at = (1.3, 0.0, 1.3, math.pi)
    args: dict[str, Any] = {"sigma0_um": 0.15, "tau_um": 1.5}
    all_of_it = HeTorrance(ior=1e8 + 0j, **args).brdf(*at)
    assert HeTorrance(ior=0.75, **args).brdf(*at) == pytest.approx(all_of_it, rel=1e-6)  # F = 1 - 4e-8/cos


@pytest.mark.parametrize("theta", [0.0, 0.5])
def test_energy_of_a_perfect_reflector(theta: float) -> None:
    """Gentle slopes, F = 1, away from grazing: 1 within 0.3 % (1.0000 +- 0.0003 up to 30 degrees without
    shadowing; Smith and the effective roughness take up to 3 % at 30 degrees for steeper ones)."""
    surface = HeTorrance(sigma0_um=0.05, tau_um=2.0, ior=1e8 + 0j)
    assert surface.directional_hemispherical(theta, wavelength_nm=500.0) == pytest.approx(1.0, abs=3e-3)


@pytest.mark.slow
def test_diffuse_albedo_is_an_albedo() -> None:
    """Erratum of eq. 72: rho_ud = a/pi; Fig. 11's text (rho_dh = 0.195 with a = 0.15) needs it."""
    bare, painted = HeTorrance(ior=1.5), HeTorrance(ior=1.5, diffuse_albedo=0.15)
    assert painted.brdf(0.2, 0.0, 0.3, 1.0) - bare.brdf(0.2, 0.0, 0.3, 1.0) == pytest.approx(0.15 / math.pi, rel=1e-13)
    gain = painted.directional_hemispherical(0.2) - bare.directional_hemispherical(0.2)
    assert gain == pytest.approx(0.15, rel=1e-12)
    assert painted.max_diffuse_albedo() == pytest.approx(bare.max_diffuse_albedo(), rel=1e-12)


def test_energy_bound_is_that_of_the_worst_angle() -> None:
    surface = HeTorrance()
    bound = surface.max_diffuse_albedo(theta_max_deg=60.0)
    first = surface.directional_hemispherical(np.radians(np.linspace(0.0, 60.0, 25)))
    assert np.all(first + bound <= 1.0 + 1e-6)  # the grid of the search leaves second-order gaps
    assert bound == pytest.approx(1.0 - first.max(), abs=1e-3)  # 2.5 degrees of a flat maximum


def test_effective_roughness_is_continuous_and_monotonic() -> None:
    ratio = htsg.effective_roughness(np.concatenate([[0.0], 10.0 ** np.linspace(-300, 307, 3000)]))
    assert ratio[0] == 1.0
    assert np.all(np.diff(ratio) <= 0.0)
    below, above = htsg.effective_roughness([0.999999e139, 1.000001e139])  # where the form changes
    assert above == pytest.approx(below, rel=1e-8)
    assert htsg.effective_roughness(math.inf) == 0.0


@pytest.mark.parametrize(
    ("call", "name"),
    [
        (lambda: HeTorrance(sigma0_um=-1.0), "sigma0_um"),
        (lambda: HeTorrance(tau_um=0.0), "tau_um"),
        (lambda: HeTorrance(ior=float("nan")), "ior"),
        (lambda: HeTorrance(shadowing="smyth"), "shadowing"),
        (lambda: HeTorrance(tolerance=1e-15), "tolerance"),
        (lambda: HeTorrance(diffuse_albedo=1.5), "diffuse_albedo"),
        (lambda: HeTorrance(sigma0_um=1e300), "sigma0_um"),
        (lambda: HeTorrance(tau_um=1e-300), "tau_um"),
        (lambda: HeTorrance().brdf(0.1, 0.0, 0.1, 0.0, wavelength_nm=1e-300), "wavelength_nm"),
        (lambda: HeTorrance().specular_reflectivity(2.0), "theta_i"),
        (lambda: HeTorrance().brdf(0.1, 0.0, float("nan"), 0.0), "theta_r"),
        (lambda: HeTorrance().max_diffuse_albedo(theta_max_deg=91.0), "theta_max_deg"),
        (lambda: htsg.log_series(-1.0, 0.0), "g"),
        (lambda: htsg.log_series([1.0, 2.0], [1.0, 2.0, 3.0]), "g"),
        (lambda: htsg.shadowing(0.1, 1.0, 1.0, "printed"), "form"),
        (lambda: htsg.shadowing(0.1, -1.0, 1.0), "sigma0"),
        (lambda: htsg.effective_roughness(-1.0), "K"),
    ],
)
def test_bad_arguments_are_named(call: object, name: str) -> None:
    with pytest.raises(ArgumentError, match=name):
        call()  # type: ignore[operator]


@pytest.mark.parametrize(
    ("surface", "theta", "relative"),
    [
        # slopes of 1/500: shadowing sets in within 1/500 of the horizon, under a lobe that fills the hemisphere
        (HeTorrance(1e-3, 1.0, 1.5), math.radians(60.0), 1e-9),
        # total reflection sets in on a circle where the grid about the normal has no edge: it is good to some 1e-5
        (HeTorrance(0.3, 2.0, 0.8), math.radians(30.0), 3e-5),
        (HeTorrance(1.0, 8.0, 0.5), math.radians(20.0), 3e-5),
    ],
)
def test_reflected_flux_against_a_grid_about_the_normal(surface: HeTorrance, theta: float, relative: float) -> None:
    edges = np.concatenate([np.linspace(0.0, math.pi / 2, 65), math.pi / 2 - 0.5 ** np.arange(4.0, 24.0)])
    theta_r, weight = panels(np.unique(edges), 16)
    phi, around = panels(np.linspace(0.0, math.pi, 97), 16)
    lobe = surface.brdf(theta, 0.0, theta_r[:, None], phi)
    expected = 2.0 * float((weight * np.sin(theta_r) * np.cos(theta_r)) @ lobe @ around)
    got = surface.directional_hemispherical(theta) - surface.specular_reflectivity(theta)
    assert got == pytest.approx(expected, rel=relative)


@pytest.mark.parametrize(("tolerance", "allowed"), [(1e-12, 1e-13), (1e-9, 1e-10), (1e-6, 1e-7)])
def test_every_class_of_the_block_sums(tolerance: float, allowed: float) -> None:
    """brdf_vectors sums by classes of m0 and width; the same lobe from the functions, which mpmath holds to 3e-14.

    `allowed` is what the sums' lengths and the polynomials are made for; the conditioning is 1 + |dlnS/dlng| +
    |dlnS/dlnc|, by differences.
    """
    rng = np.random.default_rng(11)
    n = 3000
    z, phi = rng.uniform(1e-3, 1.0, (2, n)), rng.uniform(0.0, 2.0 * math.pi, (2, n))
    z[:, ::3] = 1.0 - 10.0 ** rng.uniform(-6, -0.1, z[:, ::3].shape)  # near the mirror direction, too
    s = np.sqrt((1.0 - z) * (1.0 + z))
    omega = np.stack([s * np.cos(phi), s * np.sin(phi), z], axis=-1)
    theta = np.arctan2(s, z)
    h = omega[0] + omega[1]
    flat = h[:, 0] ** 2 + h[:, 1] ** 2
    step, wave = 1e-5, 2.0 * math.pi / 0.5
    surfaces = ((0.02, 0.6), (0.08, 1.2), (0.2, 1.5), (0.3, 3.0), (0.5, 2.0), (0.5, 15.0), (1.0, 4.0), (4.0, 30.0))
    for sigma0, tau in surfaces:
        surface = HeTorrance(sigma0_um=sigma0, tau_um=tau, ior=1.5, tolerance=tolerance)
        got = surface.brdf_vectors(*omega, wavelength_nm=500.0)
        k = np.sum(s / z * special.erfc(tau / (2.0 * sigma0) * z / s), axis=0)
        g = (wave * sigma0 * htsg.effective_roughness(k) * h[:, 2]) ** 2
        c = 0.25 * (wave * tau) ** 2 * flat
        lit = np.prod(htsg.shadowing(theta, sigma0, tau) / z, axis=0)
        rest = fresnel.reflectance(0.5 * np.sqrt(flat + h[:, 2] ** 2), 1.5) * (flat / h[:, 2] + h[:, 2]) ** 2
        expected = np.log(lit * rest * (wave * tau) ** 2 / (16.0 * math.pi)) + htsg.log_series(g, c)
        condition = sum(
            np.abs(htsg.log_series(g * a, c * b) - htsg.log_series(g / a, c / b)) / (2.0 * step)
            for a, b in ((1.0 + step, 1.0), (1.0, 1.0 + step))
        )
        here = expected > -680.0
        assert here.sum() > n / 2
        assert np.max(np.abs(np.log(got[here]) - expected[here]) / (1.0 + condition[here])) < allowed
