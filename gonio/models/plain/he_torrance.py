"""He, Torrance, Sillion and Greenberg, "A Comprehensive Physical Model for Light Reflection" (He1991).

The paper's equations in their order, in its symbols (Table 1): the model of section 3 (eqs. 1 to 12), then the
equations for unpolarised light (appendix B, eqs. 69 to 86). The derivation (appendix A, eqs. 13 to 68) is
`gonio.models.plain.he_torrance_appendix_a`; what stands in both, as shadowing and effective roughness, is there.

Lengths (sigma0, tau, lambda) are in one unit, whichever; angles in radians. k_i and k_r are unit vectors (..., 3) in
which the light travels: k_i comes down to the surface, k_r leaves it. The azimuth of the paper's incident ray is that
of k_i, so its mirror direction has phi_r = phi_i; `directions` converts from the workbench's.

Where digits are lost, and by how much, the docstrings say.
"""

from collections.abc import Callable

import numpy as np

from gonio.models.plain import fresnel
from gonio.models.plain.he_torrance_appendix_a import (
    F_total,
    M,
    S,
    bisecting_angle,
    log_series,
    p_hat,
    s_hat,
    sigma,
    v_xy,
)
from gonio.models.plain.vectors import Numbers, Vectors, direction, dot, length, polar

PI = np.pi


def directions(theta_i: Numbers, phi_i: Numbers, theta_r: Numbers, phi_r: Numbers) -> tuple[Vectors, Vectors]:
    """He1991 Fig. 5: k_i and k_r from the workbench's angles, whose phi_i is the azimuth toward the source.

    Compiled: gonio.models._loops.vectors_of_angles, for L = -k_i and V = k_r
    """
    return -direction(theta_i, phi_i), direction(theta_r, phi_r)


def angles(k_i: Vectors, k_r: Vectors) -> tuple[Numbers, Numbers]:
    """He1991 Fig. 5: theta_i and theta_r of two directions.

    Compiled: none, models take angles or vectors as they come
    """
    return polar(-np.asarray(k_i)), polar(k_r)


# --- 2 Theory of light reflection ---------------------------------------------------------------------------------


def G_prime(R: Vectors, r: Vectors, k: float) -> Numbers:
    """He1991 eq. 2: the free-space Green's function of the Kirchhoff integral (eq. 1).

    Compiled: none, a step of the derivation
    """
    distance = length(R - r)
    return np.exp(1j * k * distance) / distance


def p(z: Numbers, sigma0: float) -> Numbers:
    """He1991 eq. 3: the distribution of heights z.

    Compiled: none, a step of the derivation
    """
    return 1 / (np.sqrt(2 * PI) * sigma0) * np.exp(-(z**2) / (2 * sigma0**2))


# --- 3.2 The improved light-reflection model ----------------------------------------------------------------------


def rho_bd(dI_r: Numbers, I_i: Numbers, theta_i: Numbers, domega_i: Numbers) -> Numbers:
    """He1991 eq. 4: the BRDF, reflected intensity over the energy incident per time and area [1/sr].

    Compiled: none, a definition
    """
    return dI_r / (I_i * np.cos(theta_i) * domega_i)


def rho_bd_parts(sp: Numbers, dd: Numbers, ud: Numbers) -> Numbers:
    """He1991 eq. 5, eq. 69: specular + directional diffuse + uniform diffuse.

    The workbench's `brdf` is the last two; `gonio.instrument` adds the spike.

    Compiled: gonio.models.HeTorrance.brdf, gonio.instrument.apparent_brdf
    """
    return sp + dd + ud


def rho_sp(rho_s: Numbers, theta_i: Numbers, domega_i: float, Delta: Numbers = 1) -> Numbers:
    """He1991 eq. 6, eq. 70: rho_s Delta/(cos theta_i domega_i) [1/sr], in the cone of specular reflection.

    Delta (eq. 74) is 1 in that cone and 0 outside.

    Compiled: gonio.instrument.apparent_brdf
    """
    return rho_s / (np.cos(theta_i) * domega_i) * Delta


def rho_dd_polarised(
    k_i: Vectors, k_r: Vectors, c_s: complex, c_p: complex, sigma0: float, tau: float, lam: float, n: complex
) -> Numbers:
    """He1991 eq. 7: the directional diffuse part for any polarisation (c_s, c_p) of the incident light [1/sr].

    0/0 at normal incidence and reflection and in retro-reflection, as `M` has it.

    Compiled: gonio.models.HeTorrance.mueller
    """
    theta_i, theta_r = angles(k_i, k_r)
    gg = g(theta_i, theta_r, sigma(theta_i, theta_r, sigma0, tau), lam)
    c = v_xy(k_i, k_r, lam) ** 2 * tau**2 / 4
    return (
        F_total(k_i, k_r, c_s, c_p, n, lam)
        / (np.cos(theta_i) * np.cos(theta_r))
        * S(theta_i, theta_r, sigma0, tau)
        / (16 * PI)
        * tau**2
        * np.exp(log_series(gg, c))
    )


def rho_ud(a: Numbers) -> Numbers:
    """He1991 eq. 8, eq. 72: the uniform diffuse part [1/sr], with a factor 1/pi that the print lacks.

    The paper's values of a (0.15, 0.28, 0.9) are albedos: its rho_dh = 0.195 for a = 0.15 (sec. 4) is less than
    0.15 pi, and a = 0.9 as a BRDF would reflect 283 %.

    Compiled: gonio.models.HeTorrance.brdf
    """
    return a / PI


def g(theta_i: Numbers, theta_r: Numbers, sigma: Numbers, lam: float) -> Numbers:
    """He1991 eq. 9, eq. 79: the surface roughness function, of the effective roughness sigma.

    Compiled: gonio.models._htsg_kernels.lobe_state, gonio.models._htsg_kernels.spike_reflectivity
    """
    return ((2 * PI * sigma / lam) * (np.cos(theta_i) + np.cos(theta_r))) ** 2


def rho_sp_smooth(theta_i: Numbers, domega_i: float, n: complex, Delta: Numbers = 1) -> Numbers:
    """He1991 eq. 10: what eq. 6 becomes for a smooth surface [1/sr].

    Compiled: gonio.instrument.apparent_brdf
    """
    return fresnel.reflectance(theta_i, n) / (np.cos(theta_i) * domega_i) * Delta


def normalised(rho: Callable[[Numbers], Numbers], theta_r: Numbers, theta_i: float) -> Numbers:
    """He1991 eq. 11: a BRDF in the plane of incidence over its value in the mirror direction; rho is of theta_r.

    Compiled: none, what the paper's figures show
    """
    return rho(theta_r) / rho(theta_i)


def I_r(
    I_mirror: Numbers,
    rho_s: Numbers,
    lights: list[tuple[Numbers, Numbers, Numbers, Numbers, Numbers]],
    rho_hd: Numbers,
    I_a: Numbers,
) -> Numbers:
    """He1991 eq. 12: the intensity of a traced ray, from its mirror ray, point lights and even ambient light.

    `lights`: (rho_dd, rho_ud, theta_i, domega_i, I_i) of each source.

    Compiled: none, for a renderer
    """
    direct = sum((dd + ud) * np.cos(theta_i) * domega_i * I_i for dd, ud, theta_i, domega_i, I_i in lights)
    return rho_s * I_mirror + direct + rho_hd * I_a


def rho_dh(brdf: Callable[[Numbers, Numbers], Numbers], nodes: int = 64) -> Numbers:
    """He1991 sec. 3.2.3: the directional-hemispherical reflectance, the integral of rho cos(theta) over the hemisphere.

    `brdf` is a function of theta and phi; of the other direction it gives rho_hd (eq. 12), by reciprocity. The rule is
    a product of Gauss and the midpoint rule with `nodes` by 2 `nodes`: for lobes wider than some pi/nodes.

    Compiled: gonio.models.HeTorrance.directional_hemispherical
    """
    x, w = np.polynomial.legendre.leggauss(nodes)
    theta = PI / 4 * (1 + x)[:, np.newaxis]
    phi = PI / nodes * (np.arange(2 * nodes) + 0.5)
    over_phi = np.sum(brdf(theta, phi), axis=1) * PI / nodes
    return np.sum(over_phi * np.cos(theta[:, 0]) * np.sin(theta[:, 0]) * w) * PI / 4


# --- B Governing equations for unpolarised light ------------------------------------------------------------------
#
# In appendix A, or above: eq. 69 `rho_bd_parts`, 70 `rho_sp`, 72 `rho_ud`, 77 `S`, 79 `g`, 80 `sigma`, 81
# `z0_over_sigma0`, 82 and 83 `K`, 84 `v` and `v_xy`, 85 and 86 `s_hat` and `p_hat`.


def rho_dd(
    theta_i: Numbers,
    phi_i: Numbers,
    theta_r: Numbers,
    phi_r: Numbers,
    sigma0: float,
    tau: float,
    lam: float,
    n: complex,
    printed: bool = False,
) -> Numbers:
    """He1991 eq. 71: the directional diffuse part for unpolarised light [1/sr], azimuths as the workbench's.

    `printed`: eq. 25 as printed. Loses tan(theta) near grazing.

    Compiled: gonio.models._htsg_kernels.lobe_state
    """
    k_i, k_r = directions(theta_i, phi_i, theta_r, phi_r)
    F2 = F_squared(k_i, k_r, n)
    SS = S(theta_i, theta_r, sigma0, tau, printed)
    DD = D(k_i, k_r, sigma(theta_i, theta_r, sigma0, tau), tau, lam)
    return F2 / PI * G_reduced(k_i, k_r) * SS * DD / (np.cos(theta_i) * np.cos(theta_r))


def rho_s(theta_i: Numbers, sigma0: float, tau: float, lam: float, n: complex, printed: bool = False) -> Numbers:
    """He1991 eq. 73: the specular reflectivity |F|^2 exp(-g) S, all of them at theta_r = theta_i.

    Compiled: gonio.models._htsg_kernels.spike_reflectivity
    """
    gg = g(theta_i, theta_i, sigma(theta_i, theta_i, sigma0, tau), lam)
    return fresnel.reflectance(theta_i, n) * np.exp(-gg) * S(theta_i, theta_i, sigma0, tau, printed)


def Delta(k_r: Vectors, mirror: Vectors, domega_i: float) -> Numbers:
    """He1991 eq. 74: 1 in the cone of specular reflection, of solid angle domega_i about the mirror direction, else 0.

    Compiled: gonio.instrument.apparent_brdf
    """
    half_angle = np.arccos(1 - domega_i / (2 * PI))
    return np.where(2 * np.arcsin(length(k_r - mirror) / 2) <= half_angle, 1.0, 0.0)


def F_squared(k_i: Vectors, k_r: Vectors, n: complex) -> Numbers:
    """He1991 eq. 75: (F_s^2 + F_p^2)/2, of their magnitudes, at the bisecting angle.

    Compiled: gonio.models._facets.fresnel
    """
    return fresnel.reflectance(bisecting_angle(k_i, k_r), n)


def G(k_i: Vectors, k_r: Vectors) -> Numbers:
    """He1991 eq. 76: the geometrical factor, with v = k_r - k_i of unit vectors; the v of eq. 20 would give it a unit,
    and is not what is meant, though the print has one v for both.

    0/0 along the normal and in retro-reflection; loses 1/|k_r x k_i|^2 beside them.

    Compiled: gonio.models._htsg_kernels.lobe_state
    """
    vector = k_r - k_i
    s_i, p_i, s_r, p_r = s_hat(k_i), p_hat(k_i), s_hat(k_r), p_hat(k_r)
    return (
        (dot(vector, vector) / vector[..., 2]) ** 2
        / length(np.cross(k_r, k_i)) ** 4
        * (dot(s_r, k_i) ** 2 + dot(p_r, k_i) ** 2)
        * (dot(s_i, k_r) ** 2 + dot(p_i, k_r) ** 2)
    )


def G_reduced(k_i: Vectors, k_r: Vectors) -> Numbers:
    """He1991 eq. 76: the same as (v.v/v_z)^2, since each of its brackets is |k_r x k_i|^2; no singularity is left.

    Compiled: gonio.models._htsg_kernels.lobe_state
    """
    vector = k_r - k_i
    return (dot(vector, vector) / vector[..., 2]) ** 2


def D(k_i: Vectors, k_r: Vectors, sigma: Numbers, tau: float, lam: float) -> Numbers:
    """He1991 eq. 78: the distribution function; its v_xy is that of the wave vector of eq. 20 [1/length].

    Compiled: gonio.models._htsg_kernels.lobe_state, gonio.models._htsg_series.series
    """
    theta_i, theta_r = angles(k_i, k_r)
    c = v_xy(k_i, k_r, lam) ** 2 * tau**2 / 4
    return PI**2 * tau**2 / (4 * lam**2) * np.exp(log_series(g(theta_i, theta_r, sigma, lam), c))


# --- what the workbench makes of it: matrices, in the paper's terms -------------------------------------------------


def J(k_i: Vectors, k_r: Vectors, n: complex) -> Numbers:
    """He1991, after eq. 65: M/|k_r x k_i|^2, the Jones matrix of the facet with the normal n_b: E_r = J (c_s, c_p).

    Compiled: gonio.models.HeTorrance.jones, gonio.models._htsg_kernels.jones
    """
    return M(k_i, k_r, n) / length(np.cross(k_r, k_i))[..., np.newaxis, np.newaxis] ** 2


def mueller(
    theta_i: Numbers,
    phi_i: Numbers,
    theta_r: Numbers,
    phi_r: Numbers,
    sigma0: float,
    tau: float,
    lam: float,
    n: complex,
    a: float = 0.0,
    printed: bool = False,
) -> Numbers:
    """He1991, after eq. 72: the Mueller matrix of eqs. 7 and 59 to 68, and of eq. 72 [1/sr], an array (..., 4, 4).

    Stokes vectors are I, Q = |E_s|^2 +- |E_p|^2, U = 2 Re E_s E_p*, V = i (E_s E_p* - E_p E_s*). The uniform diffuse
    part is unpolarised.

    Compiled: gonio.models.HeTorrance.mueller, gonio.models._htsg_kernels.mueller_matrix
    """
    k_i, k_r = directions(theta_i, phi_i, theta_r, phi_r)
    SS = S(theta_i, theta_r, sigma0, tau, printed)
    DD = D(k_i, k_r, sigma(theta_i, theta_r, sigma0, tau), tau, lam)
    factor = G_reduced(k_i, k_r) * SS * DD / (PI * np.cos(theta_i) * np.cos(theta_r))
    jones = J(k_i, k_r, n)
    # coherency vectors (E_s E_s*, E_s E_p*, E_p E_s*, E_p E_p*) are multiplied by J (x) J*, then made (I, Q, U, V)
    both = np.einsum("...ij,...kl->...ikjl", jones, jones.conj()).reshape(*jones.shape[:-2], 4, 4)
    stokes = np.array([[1, 0, 0, 1], [1, 0, 0, -1], [0, 1, 1, 0], [0, 1j, -1j, 0]])
    out = np.real(factor[..., np.newaxis, np.newaxis] * (stokes @ both @ np.linalg.inv(stokes)))
    out[..., 0, 0] += rho_ud(a)
    return out
