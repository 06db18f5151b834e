"""The specification in itself: what the papers derive from one another holds, and every equation has its place.

Tolerances of 1e-12 and below are roundings times what a formula magnifies; the others are those of a quadrature.
"""

import ast
import importlib
import importlib.util
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from gonio.models import plain
from gonio.models.plain import blinn, cook_torrance, fresnel, he_torrance, oren_nayar
from gonio.models.plain import he_torrance_appendix_a as appendix
from gonio.models.plain.vectors import direction, dot, length, polar
from tests.command_line import some
from tests.places import ROOT

PI = math.pi
N_AL = 0.77 + 6.08j
K_I, K_R = he_torrance.directions(*np.random.default_rng(11).uniform(0.1, 1.4, (4, 50)))


def test_the_specification_shares_nothing_with_the_kernels() -> None:
    for path in Path(plain.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert re.match(
                    r"(__future__|typing|collections\.abc|numpy|scipy\.special|gonio\.models\.plain)\b", name
                )


# --- where equations stand ------------------------------------------------------------------------------------------


def _tool() -> Any:
    spec = some(importlib.util.spec_from_file_location("equations", ROOT / "tools" / "equations.py"))
    module = importlib.util.module_from_spec(spec)
    some(spec.loader).exec_module(module)
    return module


def _exists(name: str) -> bool:
    """Whether a dotted name leads to a module, or to something in one."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:end]))
        except ModuleNotFoundError:
            continue
        for part in parts[end:]:
            if not hasattr(found, part):
                return False
            found = getattr(found, part)
        return True
    return False


def test_the_page_of_equations_says_what_the_docstrings_say() -> None:
    tool = _tool()
    assert tool.OUT.read_text(encoding="utf-8") == tool.page(), "run: python tools/equations.py"


def test_every_equation_has_a_place_and_every_compiled_form_exists() -> None:
    tool = _tool()
    stated: dict[str, set[int]] = {}
    for module in (plain.he_torrance, plain.he_torrance_appendix_a, plain.oren_nayar, plain.cook_torrance, plain.blinn,
                   plain.fresnel):  # fmt: skip
        source = Path(str(module.__file__)).read_text(encoding="utf-8")
        for formula in tool.formulas(module):
            stated.setdefault(formula.paper, set()).update(formula.numbers)
            for number in formula.numbers:  # a search for it finds it
                assert re.search(rf"eq\. {number}\b", source), f"{module.__name__}: eq. {number}"
            for name in formula.compiled:
                assert _exists(name), f'{module.__name__}.{formula.name} says "Compiled: {name}", which does not exist'
    assert stated["He1991"] | set(tool.STEPS) == set(range(1, 87))
    assert not stated["He1991"] & set(tool.STEPS)
    assert stated["Oren1994"] == set(range(1, 19))
    assert not _exists("gonio.models.htsg.no_such_name")  # the check itself can fail
    assert not _exists("gonio.no_such_module")


# --- He1991 -----------------------------------------------------------------------------------------------------------


def test_he1991_the_tangent_plane_gives_the_fresnel_matrices_with_a_minus_in_eq_64() -> None:
    """Eqs. 37 to 46 on the plane of n_b, put into eqs. 17 and 18, are eqs. 59 to 65."""
    k, lam = 2.0 * PI / 0.5, 0.5
    n_b = appendix.n_b(K_I, K_R)
    np.testing.assert_allclose(appendix.k_rn(K_I, n_b), K_R, atol=1e-13)  # the plane's mirror direction is k_r
    for c_s, c_p in ((1, 0), (0, 1), (0.6, 0.8), (0.6, 0.8j), (0.5**0.5, -(0.5**0.5))):
        E = appendix.E_s(K_I, n_b, c_s, c_p, N_AL)
        s, p = appendix.brackets(E, 1j * k * np.cross(K_R, E), n_b, K_R, k)
        tilt = appendix.dGamma(1.0, n_b)
        scale = appendix.F_total(K_I, K_R, c_s, c_p, N_AL, lam)
        np.testing.assert_array_less(
            np.abs(np.abs(s * tilt) ** 2 - appendix.F_s(K_I, K_R, c_s, c_p, N_AL, lam)), 1e-10 * scale
        )
        np.testing.assert_array_less(
            np.abs(np.abs(p * tilt) ** 2 - appendix.F_p(K_I, K_R, c_s, c_p, N_AL, lam)), 1e-10 * scale
        )


def test_he1991_eq_71_is_eq_7_for_unpolarised_light() -> None:
    theta_i, theta_r = he_torrance.angles(K_I, K_R)
    phi_i, phi_r = np.arctan2(-K_I[:, 1], -K_I[:, 0]), np.arctan2(K_R[:, 1], K_R[:, 0])
    s, p = (he_torrance.rho_dd_polarised(K_I, K_R, c, 1 - c, 0.28, 1.77, 0.5, N_AL) for c in (1, 0))
    np.testing.assert_allclose(
        (s + p) / 2, he_torrance.rho_dd(theta_i, phi_i, theta_r, phi_r, 0.28, 1.77, 0.5, N_AL), rtol=1e-10
    )


def test_he1991_eqs_58_and_66_lead_to_eqs_6_and_7() -> None:
    theta_i, phi_r, lam, sigma0, tau, domega = 0.7, 0.0, 0.5, 0.1, 2.0, 1e-4
    k_i, k_r = he_torrance.directions(theta_i, PI, theta_i, phi_r)
    g = he_torrance.g(theta_i, theta_i, appendix.sigma(theta_i, theta_i, sigma0, tau), lam)
    script_N = appendix.script_N_cone(theta_i, domega, 1, appendix.v_xy(k_i, k_r, lam), g, tau, lam)
    S = appendix.S(theta_i, theta_i, sigma0, tau)
    for c_s, c_p in ((1, 0), (0, 1)):
        parts = [f(k_i, k_r, c_s, c_p, N_AL, lam) for f in (appendix.F_s, appendix.F_p)]
        dI = sum(appendix.dI(theta_i, appendix.E0_squared(3.0, domega), F, S, script_N) for F in parts)
        F_s, F_p = fresnel.amplitudes(theta_i, N_AL)
        rho_s = abs(c_s * F_s + c_p * F_p) ** 2 * np.exp(-g) * S
        expected = he_torrance.rho_bd_parts(
            he_torrance.rho_sp(rho_s, theta_i, domega),
            he_torrance.rho_dd_polarised(k_i, k_r, c_s, c_p, sigma0, tau, lam, N_AL),
            0.0,
        )
        assert he_torrance.rho_bd(dI, 3.0, theta_i, domega) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("g", [0.3, 3.0, 20.0])
def test_he1991_eq_56_is_the_integral_of_eq_52(g: float) -> None:
    tau, v_xy = 1.5, 2.0

    def ring(r: float) -> float:
        return 2.0 * PI * r * j0(v_xy * r) * (appendix.characteristic(r, g, tau) - np.exp(-g))

    incoherent, _ = quad(ring, 0.0, 12.0, epsabs=1e-11, epsrel=1e-11, limit=200)
    coherent = np.exp(-g) * 3.0 * 4.0 * (math.sin(v_xy * 3.0) / (v_xy * 3.0))
    got = appendix.script_N(v_xy, 0.0, g, tau, 3.0, 4.0)
    assert got == pytest.approx(incoherent + coherent, rel=1e-8)  # the quadrature's


def test_he1991_eq_52_is_the_average_over_eq_47_whose_margin_is_eq_3() -> None:
    sigma, tau, r, v_z = 0.3, 1.5, 0.7, 2.5
    x, w = np.polynomial.legendre.leggauss(120)
    z, w = 8.0 * sigma * x, 8.0 * sigma * w
    joint = appendix.p_joint(z[:, None], z, r, sigma, tau)
    np.testing.assert_allclose(joint @ w, he_torrance.p(z, sigma), atol=1e-12)
    average = w @ (joint * np.exp(-1j * v_z * (z[:, None] - z))) @ w
    assert average == pytest.approx(appendix.characteristic(r, (v_z * sigma) ** 2, tau), abs=1e-12)


def test_he1991_smooth_surface() -> None:
    nearly = he_torrance.rho_s(0.7, 1e-9, 1.0, 0.5, N_AL)
    assert he_torrance.rho_sp(nearly, 0.7, 1e-3) == pytest.approx(he_torrance.rho_sp_smooth(0.7, 1e-3, N_AL), rel=1e-14)
    k_i, k_r = he_torrance.directions(0.7, PI, 0.7, 0.0)
    assert he_torrance.Delta(k_r, direction(0.7, 0.0), 1e-3) == 1
    assert he_torrance.Delta(direction(0.73, 0.0), direction(0.7, 0.0), 1e-3) == 0  # the cone is 0.018 rad wide
    apart = length(k_r - k_i)
    assert he_torrance.G_prime(k_r, k_i, 3.0) == pytest.approx(np.exp(3j * apart) / apart, rel=1e-14)  # roundings


def test_he1991_eqs_11_and_12() -> None:
    assert he_torrance.normalised(np.cos, 0.3, 0.3) == 1
    lights = [(0.2, 0.1, 0.5, 1e-3, 7.0), (0.0, 0.1, 1.0, 1e-2, 2.0)]
    by_hand = 0.4 * 5 + 0.3 * math.cos(0.5) * 7e-3 + 0.1 * math.cos(1.0) * 2e-2 + 0.3 * 0.1
    assert he_torrance.I_r(5.0, 0.4, lights, 0.3, 0.1) == pytest.approx(by_hand, rel=1e-15)
    assert he_torrance.rho_dh(lambda theta, phi: he_torrance.rho_ud(0.28) + 0 * theta * phi) == pytest.approx(
        0.28, rel=1e-13
    )


# --- Cook1982 and Blinn1977 -------------------------------------------------------------------------------------------

L, V = -K_I, K_R


def test_cook1982_fresnel_is_the_complex_one_and_blinn1977s() -> None:
    theta = np.linspace(0.01, 1.5, 30)
    for n in (1.3, 1.8, 200.0):
        exact = fresnel.reflectance(theta, n)
        np.testing.assert_allclose(cook_torrance.F(np.cos(theta), n), exact, rtol=1e-11)
        np.testing.assert_allclose(blinn.F(theta, n), exact, rtol=1e-9)  # sin(phi - theta) cancels near the normal
        np.testing.assert_allclose(blinn.F_shortcut(np.cos(theta), n), exact, rtol=1e-11)
        np.testing.assert_allclose(blinn.F_shortcut(np.cos(theta), n, printed=True), 2 * exact, rtol=1e-11)
    beyond = cook_torrance.F(math.cos(1.2), 0.7)
    assert beyond == 1 == pytest.approx(fresnel.reflectance(1.2, 0.7), rel=1e-14)  # total reflection


def test_cook1982_intensities() -> None:
    light, domega = L[0], 2e-4
    R = cook_torrance.R(0.1, 0.7, 0.9, 0.2)
    assert pytest.approx(0.25, rel=1e-15) == R
    I_r = cook_torrance.I_r_of_one_light(R, 5.0, light, domega)
    assert cook_torrance.R_of_intensities(I_r, cook_torrance.E_i(5.0, light, domega)) == pytest.approx(R, rel=1e-15)
    total = cook_torrance.I_r(0.05, 0.6, [(5.0, light, domega, R), (5.0, light, domega, R)])
    assert total == pytest.approx(cook_torrance.I_ra(0.6, 0.05) + 2 * I_r, rel=1e-15)


def test_cook1982_a_white_mirror_keeps_the_lights_colour() -> None:
    light, matching = np.array([1.0, 2.0, 3.0]), np.eye(3)
    XYZ = cook_torrance.XYZ(cook_torrance.spectral_energy(light, 0.5), matching, 10.0)
    np.testing.assert_allclose(cook_torrance.RGB(XYZ, 2 * np.eye(3)), 10.0 * light, rtol=1e-15)


def test_blinn1977_grooves() -> None:
    np.testing.assert_allclose(blinn.G(L, V), cook_torrance.G(L, V), rtol=1e-13)
    np.testing.assert_allclose(blinn.G_over_NE(L, V), blinn.G(L, V) / V[:, 2], rtol=1e-13)
    # Fig. 4: E in the plane of N and H, beyond H; the groove's side is steep enough to be masked
    theta_e, a = 1.3, 0.6
    E, h = direction(theta_e, 0.0), direction(a, 0.0)
    G_b = blinn.G_b(2 * dot(h, E) * h - E, E)
    assert blinn.triangle(theta_e - a, a) == pytest.approx(G_b, rel=1e-13)
    assert 0 < G_b < 1


def test_blinn1977_distributions_are_one_half_at_beta() -> None:
    beta = np.array([0.05, 0.4, 1.2])
    for D, c in ((blinn.D_1, blinn.c_1), (blinn.D_2, blinn.c_2), (blinn.D_3, blinn.c_3)):
        np.testing.assert_allclose(D(beta, c(beta)), 0.5, rtol=1e-11)  # 1 - cos^2(beta)
        np.testing.assert_allclose(D(0.0, c(beta)), 1.0, rtol=1e-11)
    np.testing.assert_allclose(blinn.D_3_fast(beta, 0.35), blinn.D_3(beta, 0.35), rtol=1e-13)
    np.testing.assert_allclose(blinn.D_3_textured(beta, 0.35, 0.0), blinn.D_3(beta, 0.35), rtol=1e-13)
    np.testing.assert_allclose(blinn.alpha(L, V), polar(L + V), rtol=1e-14)


def test_blinn1977_intensity() -> None:
    d, s = blinn.d(L), blinn.s_phong(L, V, 50.0)
    assert blinn.d(-L[0]) == 0
    i = blinn.i(0.0, d, 0.6, s, 0.4)
    np.testing.assert_allclose(blinn.brdf(s, L, 0.6, 0.4) * PI * d, i, rtol=1e-14)


# --- Oren1994 -------------------------------------------------------------------------------------------------------


def test_oren1994_eq_11_is_the_integral_of_eqs_7_to_9() -> None:
    s, v = direction(1.2, 0.0), direction(1.1, 2.9)
    theta_a, phi_a, rho, w = 0.9, 2.8, 0.8, 2.0
    a, opposite = direction(theta_a, phi_a), direction(theta_a, phi_a + PI)
    m_s, m_v = oren_nayar.m_s(s, opposite), oren_nayar.m_v(v, a)
    assert m_s < 1
    assert m_v < 1

    def L1(y: Any) -> Any:  # the lit part of the opposite facet, as a Lambertian of its irradiance
        return rho / PI * dot(s, opposite) + 0 * y

    def L2(x: float) -> Any:
        return oren_nayar.L2_at(x, L1, theta_a, rho, (1 - m_s) * w, w)

    got = oren_nayar.L2_rp_of_width(v, a, L2, (1 - m_v) * w, w)
    assert got == pytest.approx(oren_nayar.L2_rp(s, v, theta_a, phi_a, rho), rel=1e-12)
    # and K' itself, without widths
    x, weight = np.polynomial.legendre.leggauss(60)
    t, r = 1 - m_v / 2 + m_v / 2 * x, 1 - m_s / 2 + m_s / 2 * x
    double = weight @ oren_nayar.K_prime(t[:, None], r, theta_a) @ weight * m_v * m_s / 4
    assert double == pytest.approx(oren_nayar.IF(m_v, m_s, theta_a), rel=1e-12)
    whole = oren_nayar.IF(1.0, 1.0, theta_a)
    assert whole == pytest.approx(PI * (1 - math.cos(theta_a)), rel=1e-14)  # the groove's form factor


def test_oren1994_eq_3_is_eq_13_for_a_distribution_that_knows_no_azimuth() -> None:
    s, v = direction(0.6, 0.0), direction(0.9, 2.0)

    def P(theta_a: Any, phi_a: Any) -> Any:
        return oren_nayar.P(theta_a, 0.5) / (2 * PI) + 0 * phi_a

    def L_rp(theta_a: Any, phi_a: Any) -> Any:
        return oren_nayar.L1_rp(s, v, direction(theta_a, phi_a), 0.8) + oren_nayar.L2_rp(s, v, theta_a, phi_a, 0.8)

    # two rules over kinks, 200 by 800 and 200 by 720
    assert oren_nayar.L_r(P, L_rp) == pytest.approx(oren_nayar.L_gaussian(s, v, 0.5, 0.8), rel=2e-5)


def test_oren1994_flat_facets_are_lambertian() -> None:
    s, v = direction(0.6, 0.0), direction(0.9, 2.0)
    lambert = 0.8 / PI * math.cos(0.6)
    assert oren_nayar.L_uni_directional(s, v, 0.0, 0.3, 0.8) == pytest.approx(lambert, rel=1e-14)
    at = (0.6, 0.9, 2.0, 0.0, 0.8)
    assert oren_nayar.L(oren_nayar.L1(*at), oren_nayar.L2(*at)) == pytest.approx(lambert, rel=1e-14)
    assert oren_nayar.L_qualitative(*at) == pytest.approx(lambert, rel=1e-14)
    assert oren_nayar.f_r(lambert, 0.6) == pytest.approx(0.8 / PI, rel=1e-14)
    assert oren_nayar.L_with_surface(0.5, 2.0, 0.25, 4.0) == 2.0


def test_oren1994_a_facets_flux_is_its_projected_radiance() -> None:
    """Eqs. 1 and 2 lead to eq. 4: radiance rho/pi E0 (s.a), seen under da (v.a) domega_r."""
    s, v, a = direction(0.4, 0.0), direction(0.5, 1.0), direction(0.3, 0.7)
    got = oren_nayar.L_rp_of_flux(0.8 / PI * dot(s, a) * dot(v, a) * 1e-3 * 1e-4, 1e-3, 0.3, 0.5, 1e-4)
    assert got == pytest.approx(oren_nayar.L_rp(s, v, a, 0.8), rel=1e-13)
    assert oren_nayar.P_of_numbers(1e3, 1e-3, 0.3) == pytest.approx(math.cos(0.3), rel=1e-14)
