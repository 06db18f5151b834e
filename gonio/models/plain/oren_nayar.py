"""Oren and Nayar, "Generalization of Lambert's Reflectance Model" (Oren1994), eqs. 1 to 18 in their order.

The mean surface has the normal n = z. s goes to the source, v to the viewer, a is a facet's normal, at the polar angle
theta_a and the azimuth phi_a: unit vectors (..., 3). rho is the facets' albedo, E0 the irradiance of a facet that faces
the source. Angles, sigma included, are in radians. Radiances L are those of the paper; a BRDF is L/(E0 cos theta_i).
"""

from collections.abc import Callable

import numpy as np

from gonio.models.plain.vectors import N as n
from gonio.models.plain.vectors import Numbers, Vectors, direction, dot

PI = np.pi


# --- 2 Surface roughness model --------------------------------------------------------------------------------------


def P_of_numbers(facets: Numbers, da: float, theta_a: Numbers) -> Numbers:
    """Oren1994 eq. 1: the slope-area distribution P, of the number of facets per area of surface, each of area da.

    Compiled: none, a definition
    """
    return facets * da * np.cos(theta_a)


# --- 3 Reflectance model --------------------------------------------------------------------------------------------


def L_rp_of_flux(dPhi: Numbers, da: float, theta_a: Numbers, theta_r: Numbers, domega_r: float) -> Numbers:
    """Oren1994 eq. 2: the projected radiance of a facet that sends the flux dPhi into domega_r.

    Compiled: none, a definition
    """
    return dPhi / (da * np.cos(theta_a) * np.cos(theta_r) * domega_r)


def L_r(
    P: Callable[[Numbers, Numbers], Numbers], L_rp: Callable[[Numbers, Numbers], Numbers], nodes: int = 200
) -> Numbers:
    """Oren1994 eq. 3: the radiance of the surface, the integral of P L_rp sin(theta_a) over phi_a and theta_a.

    P and L_rp are functions of (theta_a, phi_a). Gauss's rule in theta_a and the midpoint rule in phi_a, `nodes` by 4
    `nodes`; L_rp has kinks, which leave errors of the order of 1/nodes^2.

    Compiled: none, eq. 13 is what becomes of it where P knows no azimuth
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    theta_a = PI / 4 * (1 + x)[:, np.newaxis]
    phi_a = PI / (2 * nodes) * (np.arange(4 * nodes) + 0.5)
    over_phi = np.sum(P(theta_a, phi_a) * L_rp(theta_a, phi_a), axis=1) * PI / (2 * nodes)
    return np.sum(over_phi * np.sin(theta_a[:, 0]) * w) * PI / 4


# --- 3.1 Model for uni-directional single-slope distribution --------------------------------------------------------


def L_rp(s: Vectors, v: Vectors, a: Vectors, rho: float, E0: float = 1) -> Numbers:
    """Oren1994 eq. 4: the projected radiance of a facet that is wholly lit and seen.

    Compiled: gonio.models._groove_integral.groove_point, with eq. 5
    """
    return rho / PI * E0 * dot(s, a) * dot(v, a) / (dot(a, n) * dot(v, n))


def GAF(s: Vectors, v: Vectors, a: Vectors) -> Numbers:
    """Oren1994 eq. 5: the geometrical attenuation factor, the share of a facet that is lit and seen.

    Two separate max(): shadow and mask both begin at the bottom of the groove. It is 0 for a facet that is turned away
    from the source or the viewer.

    Compiled: gonio.models._groove_integral.groove_point
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        lit = np.maximum(0, 2 * dot(s, n) * dot(a, n) / dot(s, a))
        seen = np.maximum(0, 2 * dot(v, n) * dot(a, n) / dot(v, a))
    faces = (dot(s, a) > 0) & (dot(v, a) > 0)
    return np.where(faces, np.minimum(1, np.minimum(lit, seen)), 0.0)


def L1_rp(s: Vectors, v: Vectors, a: Vectors, rho: float, E0: float = 1) -> Numbers:
    """Oren1994 eq. 6: the projected radiance by light that comes straight from the source, eq. 4 times eq. 5.

    Compiled: gonio.models._groove_integral.groove_point
    """
    return L_rp(s, v, a, rho, E0) * GAF(s, v, a)


def L2_at(
    x: float, L1: Callable[[Numbers], Numbers], theta_a: float, rho: float, dark: float, w: float, nodes: int = 60
) -> Numbers:
    """Oren1994 eq. 7: the radiance at x by light from the opposite facet, of width w and radiance L1(y).

    y runs from where the facet's shadow ends, at `dark`, to w.

    Compiled: gonio.models._groove_integral.mean_exchange, integrated as eq. 11
    """
    t, weight = np.polynomial.legendre.leggauss(nodes)
    y = dark + (w - dark) * (1 + t) / 2
    return rho / PI * np.sum(K_prime(x, y, theta_a) * L1(y) * weight) * (w - dark) / 2


def K_prime(x: Numbers, y: Numbers, theta_a: Numbers) -> Numbers:
    """Oren1994 eq. 8: the kernel of a groove; x and y are distances from its bottom on its two facets.

    Compiled: gonio.models._groove_integral.mean_exchange
    """
    return PI * np.sin(2 * theta_a) ** 2 / 2 * x * y / (x**2 + 2 * x * y * np.cos(2 * theta_a) + y**2) ** 1.5


def L2_rp_of_width(
    v: Vectors, a: Vectors, L2: Callable[[Numbers], Numbers], hidden: float, w: float, nodes: int = 60
) -> Numbers:
    """Oren1994 eq. 9: the projected radiance by interreflection of a facet of width w, masked at x < hidden.

    Compiled: gonio.models._groove_integral.mean_exchange, integrated as eq. 11
    """
    t, weight = np.polynomial.legendre.leggauss(nodes)
    x = hidden + (w - hidden) * (1 + t) / 2
    radiance = np.sum(np.array([L2(at) for at in x]) * weight) * (w - hidden) / 2
    return dot(v, a) / (w * dot(a, n) * dot(v, n)) * radiance


def m_v(v: Vectors, a: Vectors) -> Numbers:
    """Oren1994, before eq. 9: the share of the facet a that the viewer sees, if it faces the viewer.

    Compiled: gonio.models._groove_integral.groove_point
    """
    with np.errstate(divide="ignore"):
        return np.minimum(1, 2 * dot(v, n) * dot(a, n) / dot(v, a))


def m_s(s: Vectors, a_opposite: Vectors) -> Numbers:
    """Oren1994, before eq. 9: the share of the opposite facet that is lit, if it faces the source.

    Compiled: gonio.models._groove_integral.groove_point
    """
    return m_v(s, a_opposite)


def L2_rp(s: Vectors, v: Vectors, theta_a: Numbers, phi_a: Numbers, rho: float, E0: float = 1) -> Numbers:
    """Oren1994 eq. 10: the projected radiance by light that goes twice; the opposite facet is at phi_a + pi.

    0 where the facet is turned away from the viewer, or the opposite one from the source.

    Compiled: gonio.models._groove_integral.groove_point
    """
    a, opposite = direction(theta_a, phi_a), direction(theta_a, phi_a + PI)
    seen, lit = dot(v, a) > 0, dot(s, opposite) > 0
    both = IF(np.where(seen, m_v(v, a), 1), np.where(lit, m_s(s, opposite), 1), theta_a)
    value = (rho / PI) ** 2 * E0 * dot(s, opposite) * dot(v, a) / (dot(a, n) * dot(v, n)) * both
    return np.where(seen & lit, value, 0.0)


def IF(m_v: Numbers, m_s: Numbers, theta_a: Numbers) -> Numbers:
    """Oren1994 eq. 11: the interreflection factor, the double integral of K' over 1 - m_v < t < 1 and 1 - m_s < r < 1.

    The arguments of d are the hidden shares of the two facets. Differences of nearly equal numbers: it loses
    1/(m_v m_s).

    Compiled: gonio.models._groove_integral.mean_exchange
    """

    def d(x: Numbers, y: Numbers) -> Numbers:
        return np.sqrt(x**2 + 2 * x * y * np.cos(2 * theta_a) + y**2)

    return PI / 2 * (d(1, 1 - m_v) + d(1, 1 - m_s) - d(1 - m_s, 1 - m_v) - d(1, 1))


def L_uni_directional(
    s: Vectors, v: Vectors, theta_a: float, phi_a: float, rho: float, interreflections: bool = True
) -> Numbers:
    """Oren1994 sec. 3.1: parallel grooves of one slope, the mean of their two facets, L^1 + L^2.

    Compiled: gonio.models._groove_integral.parallel_grooves
    """
    return (
        _facet(s, v, theta_a, phi_a, rho, interreflections) + _facet(s, v, theta_a, phi_a + PI, rho, interreflections)
    ) / 2


# --- 3.2 Model for isotropic single-slope distribution --------------------------------------------------------------


def L_isotropic(
    s: Vectors, v: Vectors, theta_a: Numbers, rho: float, interreflections: bool = True, nodes: int = 720
) -> Numbers:
    """Oren1994 eq. 12: grooves of one slope in every direction, the mean over phi_a, by the midpoint rule.

    Its kinks leave errors of the order of 1/nodes^2. s and v are single vectors, theta_a may be an array.

    Compiled: gonio.models._groove_integral.isotropic_grooves
    """
    phi_a = 2 * PI / nodes * (np.arange(nodes) + 0.5)
    return np.mean(_facet(s, v, np.asarray(theta_a)[..., np.newaxis], phi_a, rho, interreflections), axis=-1)


# --- 3.3 Model for Gaussian slope-area distribution -----------------------------------------------------------------


def P(theta_a: Numbers, sigma: float, mu: float = 0, nodes: int = 200) -> Numbers:
    """Oren1994 sec. 3.3: P = c exp(-(theta_a - mu)^2/(2 sigma^2)), with c so that the integral of P sin(theta_a) is 1.

    Compiled: gonio.models._groove_integral.gaussian_grooves, gonio.models._groove_slopes.mean_slope_grooves
    """
    theta, w = _slopes(nodes)
    c = 1 / np.sum(np.exp(-((theta - mu) ** 2) / (2 * sigma**2)) * np.sin(theta) * w)
    return c * np.exp(-((theta_a - mu) ** 2) / (2 * sigma**2))


def L_gaussian(
    s: Vectors, v: Vectors, sigma: float, rho: float, interreflections: bool = True, nodes: int = 200, mu: float = 0
) -> Numbers:
    """Oren1994 eq. 13: the exact model, the integral of P L_rp(theta_a) sin(theta_a), by Gauss's rule over eq. 12.

    Good to some 1e-4 with 200 nodes for sigma above 5 degrees: L_rp has kinks, and a narrow P falls between nodes.

    Compiled: gonio.models._groove_integral.gaussian_grooves, gonio.models._groove_slopes.mean_slope_grooves
    """
    theta_a, w = _slopes(nodes)
    around = L_isotropic(s, v, theta_a, rho, interreflections)
    return np.sum(P(theta_a, sigma, mu, nodes) * around * np.sin(theta_a) * w)


# --- 3.4 Functional approximation -----------------------------------------------------------------------------------


def C_1(sigma: Numbers) -> Numbers:
    """Oren1994 eq. 14: C_1, with 0.33. The 0.57 that is often seen is a later fit without interreflection.

    Compiled: gonio.models.oren_nayar.functional
    """
    return 1 - 0.5 * sigma**2 / (sigma**2 + 0.33)


def C_2(alpha: Numbers, beta: Numbers, dphi: Numbers, sigma: Numbers) -> Numbers:
    """Oren1994 eq. 14: C_2, which differs on the two sides of cos(phi_r - phi_i) = 0.

    Compiled: gonio.models.oren_nayar.angular_terms, gonio.models.oren_nayar.functional
    """
    mirror_side = np.where(np.cos(dphi) >= 0, 0, (2 * beta / PI) ** 3)
    return 0.45 * sigma**2 / (sigma**2 + 0.09) * (np.sin(alpha) - mirror_side)


def C_3(alpha: Numbers, beta: Numbers, sigma: Numbers) -> Numbers:
    """Oren1994 eq. 14: C_3.

    Compiled: gonio.models.oren_nayar.angular_terms, gonio.models.oren_nayar.functional
    """
    return 0.125 * sigma**2 / (sigma**2 + 0.09) * (4 * alpha * beta / PI**2) ** 2


def L1(theta_i: Numbers, theta_r: Numbers, dphi: Numbers, sigma: float, rho: float, E0: float = 1) -> Numbers:
    """Oren1994 eq. 14: the radiance by light from the source, alpha = max(theta_r, theta_i), beta = min(...).

    Negative near forward grazing for sigma above some 42 degrees. Loses tan(beta) near grazing.

    Compiled: gonio.models.oren_nayar.functional
    """
    alpha, beta = np.maximum(theta_r, theta_i), np.minimum(theta_r, theta_i)
    braces = (
        C_1(sigma)
        + np.cos(dphi) * C_2(alpha, beta, dphi, sigma) * np.tan(beta)
        + (1 - np.abs(np.cos(dphi))) * C_3(alpha, beta, sigma) * np.tan((alpha + beta) / 2)
    )
    return rho / PI * E0 * np.cos(theta_i) * braces


def L2(theta_i: Numbers, theta_r: Numbers, dphi: Numbers, sigma: float, rho: float, E0: float = 1) -> Numbers:
    """Oren1994 eq. 15: the radiance by interreflection.

    Compiled: gonio.models.oren_nayar.angular_terms, gonio.models.oren_nayar.functional
    """
    beta = np.minimum(theta_r, theta_i)
    braces = 1 - np.cos(dphi) * (2 * beta / PI) ** 2
    return 0.17 * rho**2 / PI * E0 * np.cos(theta_i) * sigma**2 / (sigma**2 + 0.13) * braces


def L(L1: Numbers, L2: Numbers) -> Numbers:
    """Oren1994 eq. 16: L^1 + L^2.

    Compiled: gonio.models.oren_nayar.functional
    """
    return L1 + L2


def f_r(L: Numbers, theta_i: Numbers, E0: float = 1) -> Numbers:
    """Oren1994, after eq. 16: the BRDF L/(E0 cos theta_i) [1/sr].

    Compiled: gonio.models.OrenNayar.brdf
    """
    return L / (E0 * np.cos(theta_i))


def L_qualitative(
    theta_i: Numbers, theta_r: Numbers, dphi: Numbers, sigma: float, rho: float, E0: float = 1
) -> Numbers:
    """Oren1994 eq. 17: (rho/pi) E0 cos(theta_i) (A + B max(0, cos dphi) sin(alpha) tan(beta)), without C_3 and L^2.

    Compiled: gonio.models.oren_nayar.qualitative
    """
    alpha, beta = np.maximum(theta_r, theta_i), np.minimum(theta_r, theta_i)
    A = 1 - 0.5 * sigma**2 / (sigma**2 + 0.33)
    B = 0.45 * sigma**2 / (sigma**2 + 0.09)
    return rho / PI * E0 * np.cos(theta_i) * (A + B * np.maximum(0, np.cos(dphi)) * np.sin(alpha) * np.tan(beta))


# --- 4 Experimental verification ------------------------------------------------------------------------------------


def L_with_surface(k_b: float, L_b: Numbers, k_s: float, L_s: Numbers) -> Numbers:
    """Oren1994 eq. 18: body reflection L^b plus surface reflection L^s, the latter Torrance and Sparrow's.

    Compiled: gonio.models.Sum.brdf
    """
    return k_b * L_b + k_s * L_s


def _facet(s: Vectors, v: Vectors, theta_a: Numbers, phi_a: Numbers, rho: float, interreflections: bool) -> Numbers:
    """The projected radiance of one facet, straight light and, if asked for, light that goes twice; E0 = 1."""
    once = L1_rp(s, v, direction(theta_a, phi_a), rho)
    return once + L2_rp(s, v, theta_a, phi_a, rho) if interreflections else once


def _slopes(nodes: int) -> tuple[Numbers, Numbers]:
    """Gauss's nodes and weights over theta_a in [0, pi/2]."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    return PI / 4 * (1 + x), PI / 4 * w
