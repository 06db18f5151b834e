"""Oren and Nayar's model: kernels, and reference digits, against `gonio.models.plain`."""

import itertools
import math

import numpy as np
import pytest

from gonio.models import OrenNayar
from gonio.models.plain import oren_nayar
from gonio.models.plain.vectors import direction
from tests.gonio.models.agreement import (
    PI,
    agree,
    pairs,
)
from tests.gonio.models.reference import cases


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
