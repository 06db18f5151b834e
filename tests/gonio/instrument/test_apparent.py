"""What source and receiver cones do: exact cases, independent quadrature, narrow lobes, horizons, spikes."""

import math
from typing import Any

import numpy as np
import pytest

from gonio.errors import ArgumentError
from gonio.geometry import direction, half_angle_of_cone
from gonio.instrument import Cones, apparent_brdf, apparent_lobe, apparent_spike
from gonio.models import CookTorrance, HeTorrance, Lambert

CONE = math.pi / 1024
MIRROR = math.pi


def cones(source: float = CONE, receiver: float = CONE) -> dict[str, Any]:
    return {"wavelength_nm": 500.0, "source_solid_angle_sr": source, "receiver_solid_angle_sr": receiver}


def grid(theta: float, phi: float, solid_angle: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints of n x 2n equal solid angles of a cap, built from the sphere's own coordinates about its axis."""
    drop, psi = np.meshgrid(
        (np.arange(n) + 0.5) / n * solid_angle / (2 * math.pi), (np.arange(2 * n) + 0.5) * (math.pi / n), indexing="ij"
    )
    rho = np.arccos(1.0 - drop.ravel())
    axis, up = direction(theta, phi), direction(theta - math.pi / 2, phi)
    side = np.cross(axis, up)
    psi = psi.ravel()[:, None]
    points = np.cos(rho)[:, None] * axis + np.sin(rho)[:, None] * (np.cos(psi) * up + np.sin(psi) * side)
    return points, np.full(len(points), solid_angle / len(points))


def test_a_perfect_diffuser_looks_the_same_through_any_cone() -> None:
    theta = np.radians([0.0, 30.0, 75.0, 89.9, 90.0])
    for w in (0.0, 1e-6, CONE, 0.3):
        seen = apparent_brdf(Lambert(0.7), theta, 0.0, theta[:, None], 2.0, **cones(w, w))
        np.testing.assert_allclose(seen, 0.7 / math.pi, rtol=1e-13)  # weights sum to 1 within their rounding


def test_cones_without_width_are_directions() -> None:
    surface = HeTorrance()
    at = (0.5, 0.0, 0.8, 2.9)
    # by vectors there and by angles here: two roundings
    assert apparent_lobe(surface, *at, **cones(0.0, 0.0)) == pytest.approx(
        surface.brdf(*at, wavelength_nm=500.0), rel=1e-15
    )
    # the second-order terms of 1e-9 sr are below 1e-8
    assert apparent_lobe(surface, *at, **cones(1e-9, 1e-9)) == pytest.approx(
        surface.brdf(*at, wavelength_nm=500.0), rel=1e-6
    )


@pytest.mark.parametrize(
    ("model", "at", "rtol"),
    [
        # the reference's own midpoint rule leaves (cone / (40 lobe widths))^2
        (HeTorrance(sigma0_um=0.28, tau_um=1.77), (0.6, 0.2, 0.7, 3.3), 1e-4),
        (HeTorrance(sigma0_um=0.05, tau_um=16.0), (0.6, 0.0, 0.61, MIRROR), 3e-3),
        (CookTorrance(s=1, d=0, slopes=((0.01, 1.0),), convention="normalised"), (0.6, 0.0, 0.61, MIRROR), 3e-3),
    ],
    ids=["broad", "narrow He-Torrance", "narrow Cook-Torrance"],
)
def test_lobes_against_plain_sums(model: Any, at: tuple[float, ...], rtol: float) -> None:
    source, light = grid(at[0], at[1], CONE, 20)
    receiver, weight = grid(at[2], at[3], CONE, 20)
    values = model.brdf_vectors(source[:, None], receiver[None], wavelength_nm=500.0)
    light = light * source[:, 2]
    expected = light @ values @ weight / (light.sum() * weight.sum())
    assert apparent_lobe(model, *at, **cones()) == pytest.approx(expected, rel=rtol)


@pytest.mark.parametrize("tau_um", [20.0, 1000.0])
@pytest.mark.parametrize("wide", ["source", "receiver"])
def test_a_cone_that_takes_in_a_narrow_lobe_sees_its_energy(tau_um: float, wide: str) -> None:
    """Lobes 0.45 and 0.01 degrees wide in a cone of 25 degrees: their integral, here by quadrature in theta alone.

    At normal incidence everything depends on sin(theta) alone.
    """
    surface = HeTorrance(sigma0_um=0.02, tau_um=tau_um, ior=1e8 + 0j)
    angle = 0.6
    half = float(half_angle_of_cone(angle))
    edges = np.concatenate([[0.0], 2.0 ** np.arange(-16.0, 1.0)]) * half
    x, w = np.polynomial.legendre.leggauss(20)
    step = 0.5 * np.diff(edges)[:, None]
    theta, weight = (edges[:-1, None] + step * (1.0 + x)).ravel(), (step * w).ravel()
    values = surface.brdf(0.0, 0.0, theta, 0.0, wavelength_nm=500.0) * np.sin(theta)
    if wide == "source":
        expected = 2 * math.pi * np.sum(weight * values * np.cos(theta)) / (math.pi * math.sin(half) ** 2)
        seen = apparent_lobe(surface, 0.0, 0.0, 0.0, 0.0, **cones(angle, 0.0))
    else:
        expected = 2 * math.pi * np.sum(weight * values) / angle
        seen = apparent_lobe(surface, 0.0, 0.0, 0.0, 0.0, **cones(0.0, angle))
    assert seen == pytest.approx(expected, rel=1e-6)  # what apparent_lobe states


def test_a_lobe_narrower_than_both_cones_is_seen_like_a_spike() -> None:
    """Lobe 0.01 degrees wide, cones 1.8 in half-angle: its energy over the overlap, as the spike's."""
    surface, theta = HeTorrance(sigma0_um=0.02, tau_um=1000.0, ior=1e8 + 0j), 0.5
    energy = surface.directional_hemispherical(theta, wavelength_nm=500.0) - surface.specular_reflectivity(
        theta, wavelength_nm=500.0
    )
    spike = apparent_spike(surface, theta, 0.0, theta, MIRROR, **cones(), spike="exact")
    expected = energy * spike / surface.specular_reflectivity(theta, wavelength_nm=500.0)
    # the edge loses about (lobe width)/(cone radius) = 0.5 % where the mirror image of the source meets the receiver
    assert apparent_lobe(surface, theta, 0.0, theta, MIRROR, **cones()) == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("theta_deg", [10.0, 45.0, 75.0])
def test_nominal_spike_is_eq_6(theta_deg: float) -> None:
    surface, theta = HeTorrance(sigma0_um=0.1, tau_um=2.0), math.radians(theta_deg)
    expected = surface.specular_reflectivity(theta, wavelength_nm=500.0) / (CONE * math.cos(theta))
    assert apparent_spike(surface, theta, 0.3, theta, 0.3 + MIRROR, **cones()) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("spike", ["nominal", "exact"])
@pytest.mark.parametrize(("source", "receiver"), [(CONE, CONE), (CONE, CONE / 3), (CONE / 3, CONE)])
# of the largest value: beyond 1.540 the horizon cuts cones of 1.8 degrees; 4e-3 are stated there, 1e-3 are the sum's
@pytest.mark.parametrize(("theta", "tolerance"), [(1.1, 1e-4), (1.53, 5e-3)], ids=["whole", "cut"])
@pytest.mark.parametrize("offset", [(0.0, 0.0), (0.01, 0.0), (-0.02, 0.015), (0.05, 0.0), (0.08, 0.0)])
def test_spike_against_plain_sums(
    spike: Any, source: float, receiver: float, theta: float, tolerance: float, offset: tuple[float, float]
) -> None:
    surface = HeTorrance(sigma0_um=0.2, tau_um=2.0, ior=1.5)
    at = (theta, 0.0, min(theta + offset[0], math.pi / 2), MIRROR + offset[1])
    seen, weight = grid(at[2], at[3], receiver, 300)
    lit, light = grid(theta, 0.0, source, 100)
    weight, light = weight * (seen[:, 2] > 0.0), light * (lit[:, 2] > 0.0)
    inside = (seen @ (direction(theta, 0.0) * (-1.0, -1.0, 1.0)) >= 1.0 - source / (2.0 * math.pi)) & (weight > 0.0)
    if spike == "exact":
        rho = surface.specular_reflectivity(np.arccos(seen[inside, 2]), wavelength_nm=500.0)
        flux = light @ lit[:, 2]
    else:
        rho = surface.specular_reflectivity(theta, wavelength_nm=500.0)
        flux = np.sum(light) * math.cos(theta)
    expected = np.sum(rho * weight[inside]) / (np.sum(weight) * flux)
    # an edge through 300 x 600 midpoints is placed to 1e-3 of the cone's radius at worst, far better on average
    scale = surface.specular_reflectivity(theta, wavelength_nm=500.0) / flux
    assert apparent_spike(surface, *at, **cones(source, receiver), spike=spike) == pytest.approx(
        expected, rel=2e-3, abs=tolerance * scale
    )


def test_exact_spike_at_75_degrees_is_larger_than_the_nominal() -> None:
    """6.5 % at 75 degrees and pi/1024 sr for Fig. 8's aluminium."""
    surface, theta = HeTorrance(sigma0_um=0.28, tau_um=1.77, ior=0.769 + 6.08j), math.radians(75.0)
    at = (theta, 0.0, theta, MIRROR)
    ratio = apparent_spike(surface, *at, **cones(), spike="exact") / apparent_spike(surface, *at, **cones())
    assert ratio == pytest.approx(1.065, abs=5e-4)  # the figure is given to three digits


def test_spike_far_from_the_mirror_direction_is_nothing() -> None:
    assert apparent_spike(HeTorrance(), 0.5, 0.0, 0.6, MIRROR, **cones()) == 0.0
    assert apparent_spike(Lambert(), 0.5, 0.0, 0.5, MIRROR, **cones()) == 0.0


def test_one_cone_of_no_width() -> None:
    surface, theta = HeTorrance(sigma0_um=0.1, tau_um=2.0), 0.7
    rho = surface.specular_reflectivity(theta, wavelength_nm=500.0)
    for source, receiver in ((0.0, CONE), (CONE, 0.0)):
        for kind in ("nominal", "exact"):
            inside = apparent_spike(surface, theta, 0.0, theta, MIRROR, **cones(source, receiver), spike=kind)
            # exact: int cos over the cone is pi sin^2 cos, 2.4e-4 below w cos
            assert inside == pytest.approx(rho / (CONE * math.cos(theta)), rel=3e-4)
            assert (
                apparent_spike(surface, theta, 0.0, theta + 0.04, MIRROR, **cones(source, receiver), spike=kind) == 0.0
            )


def test_horizon_cuts_the_caps() -> None:
    """A cone that looks along the surface has half of itself left: its average is over that half."""
    theta = math.radians(90.0)
    receiver, weight = grid(theta, 0.0, CONE, 400)
    above = receiver[:, 2] > 0.0
    surface = HeTorrance(sigma0_um=0.5, tau_um=1.0)
    values = surface.brdf_vectors(direction(0.4, math.pi), receiver[above], wavelength_nm=500.0)
    expected = np.sum(values * weight[above]) / np.sum(weight[above])
    # the plain sum's cells at the horizon, 1/400 of the cap's radius
    assert apparent_lobe(surface, 0.4, math.pi, theta, 0.0, **cones(0.0, CONE)) == pytest.approx(expected, rel=2e-3)


def test_rules_of_a_model_are_taken_again_for_another() -> None:
    """A geometry of each kind: expanded, by cubature, narrower than the cones, cut by the horizon."""
    model = CookTorrance(s=1, d=0, slopes=((0.01, 1.0),), convention="normalised")
    for surface in (HeTorrance(sigma0_um=0.28, tau_um=1.77), HeTorrance(sigma0_um=0.02, tau_um=1000.0), model):
        where = Cones([0.3, 0.6, 0.6, 1.2], 0.0, [0.9, 0.6, 0.65, 1.56], MIRROR, CONE, CONE)
        lobe = where.lobe(surface, wavelength_nm=500.0)
        again = where.lobe(surface, wavelength_nm=500.0, rules=where.rules(surface, wavelength_nm=500.0))
        np.testing.assert_allclose(again, lobe, rtol=1e-7)  # what successive cubatures may differ by


def test_broadcasts() -> None:
    surface = HeTorrance()
    seen = apparent_brdf(surface, np.full((3, 1), 0.5), 0.0, np.linspace(0.4, 0.6, 4), MIRROR, **cones())
    assert seen.shape == (3, 4)
    one = apparent_brdf(surface, 0.5, 0.0, 0.4, MIRROR, **cones())
    assert np.shape(one) == ()
    assert one == pytest.approx(seen[0, 0], rel=1e-12)  # the same rule, summed in other blocks
    assert apparent_brdf(surface, np.empty(0), 0.0, 0.1, 0.0, **cones()).shape == (0,)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"source_solid_angle_sr": -1.0}, "source_solid_angle_sr"),
        ({"receiver_solid_angle_sr": 7.0}, "receiver_solid_angle_sr"),
        ({"spike": "none"}, "spike"),
        ({"wavelength_nm": 0.0}, "wavelength_nm"),
    ],
)
def test_bad_arguments_are_named(change: dict[str, Any], name: str) -> None:
    with pytest.raises(ArgumentError, match=name):
        apparent_brdf(HeTorrance(), 0.1, 0.0, 0.1, MIRROR, **{**cones(), **change})
    with pytest.raises(ArgumentError, match="theta_r"):
        apparent_brdf(HeTorrance(), 0.1, 0.0, 2.0, MIRROR, **cones())
    with pytest.raises(ArgumentError, match="model must be"):
        apparent_brdf("he-torrance", 0.1, 0.0, 0.1, MIRROR, **cones())  # type: ignore[arg-type]
