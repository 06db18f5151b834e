"""Gloss through a glossmeter's apertures, against surfaces of which it is known."""

import math

import numpy as np
import pytest
from gonio_analysis.appearance.glossmeter import GLOSSMETERS, HAZEMETERS, Glossmeter, gloss
from scipy.integrate import dblquad

from gonio.models import CookTorrance, HeTorrance, Lambert, Model, Phong, Sum, fresnel

each = pytest.mark.parametrize("meter", GLOSSMETERS, ids=lambda m: f"{m.angle_deg:g}")


def smooth(index: complex) -> HeTorrance:
    """A surface without roughness."""
    return HeTorrance(sigma0_um=0.0, tau_um=1.0, ior=index)


@each
def test_the_standard_glass_has_100_units(meter: Glossmeter) -> None:
    value, error = gloss(smooth(1.567), meter, 550.0)
    assert value == pytest.approx(100.0, abs=1e-6)  # the same integral twice, by rules of different order
    assert error < 1e-6


@each
@pytest.mark.parametrize("index", [1.46, 1.6, 0.27 + 3.4j])
def test_a_smooth_surface_has_the_ratio_of_fresnel_reflectances(meter: Glossmeter, index: complex) -> None:
    value, _ = gloss(smooth(index), meter, 550.0)
    cosine = math.cos(meter.theta)
    ratio = 100.0 * fresnel.reflectance(cosine, index) / fresnel.reflectance(cosine, 1.567)
    assert value == pytest.approx(ratio, rel=1e-3)  # reflectance is not quite linear over the source


@each
def test_a_lambertian_surface_has_the_projected_solid_angle_of_the_receiver(meter: Glossmeter) -> None:
    sine, cosine = math.sin(meter.theta), math.cos(meter.theta)

    def projected(across: float, along: float) -> float:
        return (cosine - sine * along) / (1.0 + along**2 + across**2) ** 2  # cos(theta_r) dw

    a, b = (math.tan(math.radians(0.5 * width)) for width in meter.receiver_deg)
    flux = dblquad(projected, -a, a, -b, b, epsabs=1e-12)[0] * 0.8 / math.pi
    angles = np.radians(meter.angle_deg + np.linspace(-0.375, 0.375, 201))
    standard = float(np.mean(fresnel.reflectance(np.cos(angles), 1.567)))
    value, _ = gloss(Lambert(0.8), meter, 550.0)
    assert value == pytest.approx(100.0 * flux / standard, rel=2e-4)  # the source's height is left out of `standard`


@each
@pytest.mark.parametrize(
    "model",
    [
        HeTorrance(sigma0_um=0.05, tau_um=5.0, ior=1.5),
        CookTorrance(s=1, d=0, slopes=((0.02, 1.0),), ior=1.5, convention="normalised"),
        Phong(k_d=0.5, k_s=0.5, exponent=5000.0),
    ],
    ids=lambda m: m.name,
)
def test_the_stated_error_holds_against_uniform_panels(meter: Glossmeter, model: Model) -> None:
    value, error = gloss(model, meter, 550.0)
    omega_i, share = meter.source(6)
    omega_r, solid = meter.receiver(160)
    spike = float(share @ model.specular_reflectivity(np.arccos(omega_i[:, 2]), wavelength_nm=550.0))
    lobe = sum(
        w * float((solid * omega_r[:, 2]) @ model.brdf_vectors(np.broadcast_to(i, omega_r.shape), omega_r))
        for w, i in zip(share, omega_i, strict=True)
    )
    # 160 nodes a side resolve these lobes to 1e-4 of themselves
    assert value == pytest.approx(100.0 * (spike + lobe) / meter.standard, abs=3.0 * error, rel=2e-3)


HAZES = [meter for meters in HAZEMETERS.values() for meter in meters]


@pytest.mark.parametrize("meter", HAZES, ids=lambda m: f"{m.angle_deg:g}{m.offset_deg:+g}")
def test_a_smooth_surface_has_no_haze_and_a_lambertian_one_that_of_the_solid_angle(meter: Glossmeter) -> None:
    assert gloss(smooth(1.567), meter, 550.0)[0] == 0.0
    widths = [math.radians(width) for width in meter.receiver_deg]
    # a small rectangle: the cosine at its middle, to the square of its width; the image of the source cut as stated
    seen = math.prod(min(1.0, r / s) for r, s in zip(meter.receiver_deg, meter.source_deg, strict=True))
    flux = 0.8 / math.pi * widths[0] * widths[1] * math.cos(math.radians(meter.angle_deg + meter.offset_deg))
    standard = seen * fresnel.reflectance(math.cos(meter.theta), 1.567)
    assert gloss(Lambert(0.8), meter, 550.0)[0] == pytest.approx(100.0 * flux / standard, rel=3e-3)


@pytest.mark.parametrize("meter", HAZES, ids=lambda m: f"{m.angle_deg:g}{m.offset_deg:+g}")
def test_haze_of_a_lobe_against_uniform_panels(meter: Glossmeter) -> None:
    model = HeTorrance(sigma0_um=0.05, tau_um=8.0, ior=1.5)
    omega_i, share = meter.source(6)
    omega_r, solid = meter.receiver(80)
    lobe = sum(
        w * float((solid * omega_r[:, 2]) @ model.brdf_vectors(np.broadcast_to(i, omega_r.shape), omega_r))
        for w, i in zip(share, omega_i, strict=True)
    )
    value, error = gloss(model, meter, 550.0)
    # 80 nodes a side resolve a lobe of a degree to 1e-4 of itself
    assert value == pytest.approx(100.0 * lobe / meter.standard, abs=3.0 * error, rel=1e-3)
    assert value > 0.1


def test_a_sum_has_the_sum_of_the_fluxes() -> None:
    glass, white = smooth(1.5), Lambert(0.9)
    both, _ = gloss(Sum((glass, 0.25), (white, 0.75)), GLOSSMETERS[1], 550.0)
    parts = [gloss(m, GLOSSMETERS[1], 550.0)[0] for m in (glass, white)]
    assert both == pytest.approx(0.25 * parts[0] + 0.75 * parts[1], rel=1e-12)  # rounding
