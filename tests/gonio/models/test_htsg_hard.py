"""He-Torrance where it is hard: values finite, not negative, reciprocal, without a warning, or the stated limit."""

import itertools
import math

import mpmath as mp
import numpy as np
import pytest

from gonio.models import HeTorrance, htsg

HALF_PI = math.pi / 2
THETA = [0.0, 1e-300, 1e-9, 0.5, 1.2, math.radians(89.9999), float(np.nextafter(HALF_PI, 0.0)), HALF_PI]
DPHI = [0.0, 1e-9, 1.0, math.pi - 1e-9, math.pi, math.pi + 1e-9]
SURFACES = {
    "smooth": (0.0, 1.0),
    "nearly smooth": (1e-9, 1.0),
    "roughness below the smallest square": (1e-300, 1.0),
    "g = 1e8": (300.0, 3000.0),
    "tau/lambda = 1e4": (0.1, 5000.0),
    "steep": (5.0, 0.1),
    "correlation of a picometre": (0.3, 1e-6),
}
INDICES = [1.0, 1.0000001, 1.5, 1.5 + 1e-12j, 0.75, 1e-3, 0.77 + 6.08j, 1e8 + 1e8j]


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("ior", INDICES, ids=str)
def test_everywhere(surface: str, ior: complex) -> None:
    theta_i, theta_r, dphi = np.meshgrid(THETA, THETA, DPHI, indexing="ij")
    sigma0, tau = SURFACES[surface]
    for shadowing, tolerance in itertools.product(("smith", "paper"), (1e-12, 1e-6)):
        model = HeTorrance(sigma0_um=sigma0, tau_um=tau, ior=ior, shadowing=shadowing, tolerance=tolerance)
        there, back = model.brdf(theta_i, 0.3, theta_r, 0.3 + dphi), model.brdf(theta_r, 0.3, theta_i, 0.3 - dphi)
        assert np.all(np.isfinite(there) & (there >= 0.0))
        # the same terms added in another order; near grazing their rounding is scaled by tan(theta), at most 6e5 here
        np.testing.assert_allclose(back, there, rtol=1e-9, atol=1e-280)
        matrix = model.mueller(theta_i, 0.3, theta_r, 0.3 + dphi)
        np.testing.assert_allclose(matrix[..., 0, 0], there, rtol=1e-9, atol=1e-280)
        assert np.all(np.isfinite(matrix))
        spike = model.specular_reflectivity(np.array(THETA))
        assert np.all(np.isfinite(spike) & (spike >= 0.0) & (spike <= 1.0 + 1e-12))


def test_grazing_limits() -> None:
    """At exactly 90 degrees sigma is 0 in the limit, and with it the lobe; a smooth surface reflects all of it."""
    assert (HeTorrance().brdf(0.3, 0.0, HALF_PI, 1.0), HeTorrance().brdf(HALF_PI, 0.0, HALF_PI, 3.0)) == (0.0, 0.0)
    assert HeTorrance().specular_reflectivity(HALF_PI) == 0.0
    assert HeTorrance(sigma0_um=0.0, ior=1.5).specular_reflectivity(HALF_PI) == 1.0
    flat = np.array([1.0, 0.0, 0.0])
    assert HeTorrance().brdf_vectors(flat, -flat) == 0.0


def test_retro_is_continuous() -> None:
    """The printed forms of eqs. 61-65 and 76 are 0/0 at retro; one nano-radian away nothing may have jumped."""
    model = HeTorrance(sigma0_um=0.3, tau_um=1.0)
    at, near = model.mueller(0.7, 0.0, 0.7, 0.0), model.mueller(0.7, 0.0, 0.7 + 1e-9, 1e-9)
    np.testing.assert_allclose(near, at, rtol=0.0, atol=1e-7 * at[0, 0])  # slopes of order 10 a radian


def test_normal_incidence_takes_the_azimuth_given() -> None:
    """s and p at normal incidence are the limit at the given azimuth: continuous with 1e-9 rad of tilt."""
    model = HeTorrance(sigma0_um=0.3, tau_um=1.0)
    at, near = model.mueller(0.0, 0.4, 0.7, 1.5), model.mueller(1e-9, 0.4, 0.7, 1.5)
    np.testing.assert_allclose(near, at, rtol=0.0, atol=1e-7 * at[0, 0])


@pytest.mark.parametrize("g", [1e-12, 1e-3, 0.3, 10.0, 39.9, 40.1, 119.0, 121.0, 1.53e3, 1.55e3, 1e5, 1e8])
@pytest.mark.parametrize("ratio", [0.0, 1e-8, 1e-2, 1.0, 30.0])
def test_series_at_its_seams(g: float, ratio: float) -> None:
    """Both sides of every change of method, against 40-digit sums (c = ratio * g, and c = 1e10 at the largest)."""
    c = 1e10 if (g, ratio) == (1e8, 30.0) else ratio * g
    mp.mp.dps = 40
    if g > 1e4:  # too many terms to add: Laplace about the largest, whose next terms are below 1/m0^5
        if c == 0.0:
            reference = mp.log(mp.exp(-g) * (mp.ei(g) - mp.log(g) - mp.euler))
        else:
            u = mp.lambertw(2 * mp.mpf(c) / mp.mpf(g) ** 2).real / 2
            p, m0 = 1 / (1 + 2 * u), g * mp.exp(u)
            first = -mp.mpf(1) / 12 + p**2 / 4 + 5 * p**3 / 6
            second = (
                mp.mpf(1) / 288 - p / 12 - 5 * p**2 / 48 - 23 * p**3 / 72 - 133 * p**4 / 96 - 35 * p**5 / 24
            ) + 385 * p**6 / 72
            bracket = 1 + first / m0 + second / m0**2
            reference = mp.mpf(g) * mp.expm1(u) - 2 * mp.mpf(c) / m0 + mp.log(mp.sqrt(p) / m0 * bracket)
    else:
        reference = mp.log(
            mp.fsum(
                mp.exp(m * mp.log(g) - g - mp.loggamma(m + 1) - mp.log(m) - mp.mpf(c) / m)
                for m in range(max(1, int(g - 14 * math.sqrt(g) - 40)), int(g + 14 * math.sqrt(g) + 80 + 3 * ratio))
            )
        )
    conditioning = c / max(g, 1.0) + 1.0
    # 3e-14 is what the expansion's polynomials are fitted to, 2e-14 what exp(-40) leaves beyond any expansion
    assert abs(float(htsg.log_series(g, c) - reference)) <= 3e-14 * (1 + conditioning)


def test_a_pair_does_not_depend_on_its_neighbours() -> None:
    """Pairs are sorted and summed in groups; the value of one is the same to the last digit alone and in a crowd."""
    rng = np.random.default_rng(3)
    model = HeTorrance(sigma0_um=0.5, tau_um=2.0)
    theta_i, theta_r, phi = rng.uniform(0, 1.55, 3000), rng.uniform(0, 1.55, 3000), rng.uniform(0, 6.28, 3000)
    crowd = model.brdf(theta_i, 0.0, theta_r, phi, wavelength_nm=500.0)
    for j in range(0, 3000, 131):
        alone = model.brdf(theta_i[j], 0.0, theta_r[j], phi[j], wavelength_nm=500.0)
        assert alone == pytest.approx(crowd[j], rel=1e-13)  # vector and scalar code may fuse differently
