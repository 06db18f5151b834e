"""He and Torrance's model: kernels, and reference digits, against `gonio.models.plain`."""

import itertools
import math
from typing import Any, cast

import numpy as np
import pytest

from gonio.instrument import apparent_spike
from gonio.models import HeTorrance, htsg
from gonio.models.plain import he_torrance, he_torrance_appendix_a
from gonio.models.plain.vectors import direction, length
from tests.gonio.models.agreement import (
    PI,
    SURFACES,
    Angles,
    agree,
    lobe_loss,
    pairs,
)
from tests.gonio.models.reference import cases


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
    polarised = 1.0 / (length(np.cross(k_r, k_i)) ** 2) / np.minimum(np.sin(at[0]), np.sin(at[2]))
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

        total = he_torrance.rho_s(theta_i, sigma0, tau, lam, n) + he_torrance.rho_dh(lobe_of, 64) + 0.1
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
