"""The formulas of `gonio.models.plain` against the reference digits: the specification stands on its own."""

import math

import numpy as np
import pytest

from gonio.models.plain import blinn, cook_torrance, he_torrance, he_torrance_appendix_a, oren_nayar
from gonio.models.plain import fresnel as plain_fresnel
from gonio.models.plain.vectors import direction, dot, length
from tests.gonio.models.agreement import PI, agree, facet_loss, in_frame, lobe_loss
from tests.gonio.models.reference import cases


def test_cook_torrance_digits() -> None:
    """Formulas of scalars, so that N need not be z."""
    for case in cases("cook_torrance_colour"):
        i, out = case["in"], case["out"]
        n = cook_torrance.n(i["F0"])
        # 1 - sqrt(F_0) cancels; of F g - c, where n is near 1, and 1 - F where it is large
        agree(n, float(out["n_from_F0"]), 1.0 / (1.0 - i["F0"]))
        agree(cook_torrance.F(i["cos"], i["n"]), float(out["F_n"]), 2.0 * (i["n"] + 1.0 / abs(i["n"] - 1.0)))
        agree(cook_torrance.F_0(n), i["F0"], 1.0 / (n - 1.0) + n)
        F = cook_torrance.F(i["cos"], n)
        agree(F, float(out["F_theta"]), 2.0 * (n + 1.0 / (n - 1.0)))
        colours = cook_torrance.colour(np.array(i["col0"]), np.array(i["col90"]), F, i["F0"])
        agree(colours, [float(c) for c in out["colour"]], 20.0 / (1.0 - i["F0"]) + 20.0 / (n - 1.0))


def test_cook_torrance_facet_digits() -> None:
    tried = 0
    for case in cases("cook_torrance"):
        i, out = case["in"], case["out"]
        light, view = in_frame(i, "L", "V")
        if min(light[2], view[2]) <= 1e-6:  # below the surface models are 0; the turned N.L has lost its digits
            continue
        tried += 1
        _, loss = facet_loss(light, view)
        loss = loss + 1.0 / (light[2] * view[2]) + (case["cond"]["R_s"] or 0.0)
        slopes = tuple((i[f"m{j}"], i[f"w{j}"]) for j in range(1, 9) if f"m{j}" in i)
        ior = cook_torrance.n(i["F0"]) if "F0" in i else complex(i["n"], i.get("k", 0.0))
        D = cook_torrance.D_gaussian if "gauss" in case["tags"] else cook_torrance.D_beckmann
        got = cook_torrance.brdf(light, view, slopes, ior, distribution=D)
        agree(got, float(out["R_s"]), 4.0 * loss * (1.0 + 1.0 / min(m for m, _ in slopes)))
        agree(cook_torrance.G(light, view), float(out["G"]), 4.0 * loss)
    assert tried > 40


def test_fresnel_digits() -> None:
    for case in cases("fresnel_complex"):
        i, out = case["in"], case["out"]
        n = complex(i["n"], i["k"])
        theta = math.acos(i["cos"])
        F_s, F_p = plain_fresnel.amplitudes(theta, n)
        # numerators cancel to |n^2 - 1|; the angle is rounded, which counts near the critical angle
        loss = 2.0 * (1.0 + abs(n) ** 2) / abs(n**2 - 1.0) * (1.0 + 1.0 / abs(n**2 - math.sin(theta) ** 2))
        for got, key in ((F_s, "Fs"), (F_p, "Fp")):
            expected = complex(float(out[key + "_re"]), float(out[key + "_im"]))
            agree(got, expected, loss, scale=max(abs(expected), abs(n**2 - 1.0)))
        # F_p changes within cosines of 1/|n|
        agree(plain_fresnel.reflectance(theta, n), float(out["F2"]), loss + 4.0 * abs(n), scale=1.0)


def test_blinn_facet_digits() -> None:
    tried = 0
    for case in cases("blinn"):
        i, out = case["in"], case["out"]
        light, view = in_frame(i, "L", "E")
        if min(light[2], view[2]) <= 1e-6:  # below the surface models are 0; the turned N.L has lost its digits
            continue
        tried += 1
        alpha, loss = facet_loss(light, view)
        loss = loss + 1.0 / (light[2] * view[2]) + (case["cond"]["s"] or 0.0)
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


def test_blinn_texture_digits() -> None:
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


def test_oren_nayar_digits() -> None:
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
        agree(oren_nayar.f_r(oren_nayar.L_qualitative(*at, i["sigma"], i["rho"]), at[0]), float(out["qual_fr"]), loss)


def test_oren_nayar_groove_digits() -> None:
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


@pytest.mark.slow
def test_oren_nayar_integral_digits() -> None:
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


def test_he_torrance_digits() -> None:
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
            agree(he_torrance_appendix_a.sigma(at[0], at[2], sigma0, tau), float(out["sigma"]), 2.0 * (1.0 + tangents))


def test_he_torrance_parts_digits() -> None:
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


def test_he_torrance_polarised_digits() -> None:
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
        agree(he_torrance.J(k_i, k_r, n), parts, 2.0 / apart**2 / min(math.sin(at[0]), math.sin(at[2])), scale=1.0)
    assert tried > 30
