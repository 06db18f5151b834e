"""Appendix A of He, Torrance, Sillion and Greenberg 1991: the derivation (He1991 eqs. 13 to 68), in its order.

Vectors, units and symbols are those of `gonio.models.plain.he_torrance`, which has the rest of the paper. Steps that
are averages over surfaces (eqs. 13, 16, 19, 21, 29 and 49) have no function: eqs. 52 and 58 are what becomes of them.
sigma0 is above 0: a smooth surface is the limit.
"""

import numpy as np
from scipy.special import erfc, gammaln

from gonio.models.plain import fresnel
from gonio.models.plain.vectors import N as Z
from gonio.models.plain.vectors import Numbers, Vectors, dot, length, unit

PI = np.pi


# --- A.1 Reflected intensities ------------------------------------------------------------------------------------


def s_hat(k: Vectors) -> Vectors:
    """He1991 eq. 14, eq. 35, eq. 85, eq. 86: k x z/|k x z|, across the plane of k and the normal; 0/0 along the normal.

    Compiled: gonio.models._htsg_kernels.jones
    """
    return unit(np.cross(k, Z))


def p_hat(k: Vectors) -> Vectors:
    """He1991 eq. 14, eq. 35, eq. 85, eq. 86: s x k, in the plane of k and the normal; 0/0 along the normal.

    Compiled: gonio.models._htsg_kernels.jones
    """
    return np.cross(s_hat(k), k)


def brackets(E: Vectors, curl_E: Vectors, n: Vectors, k_r: Vectors, k: float) -> tuple[Numbers, Numbers]:
    """He1991 eq. 17, eq. 30, eq. 31: the terms in braces, of a field E on the surface, its curl and the local normal n.

    The first is that of the s component of what is reflected along k_r, the second that of the p component.

    Compiled: none, a step of the derivation
    """
    s_r, p_r = s_hat(k_r), p_hat(k_r)
    s = 1j * k * dot(p_r, np.cross(E, n)) + dot(s_r, np.cross(curl_E, n))
    p = 1j * k * dot(s_r, np.cross(E, n)) - dot(p_r, np.cross(curl_E, n))
    return s, p


def dGamma(dA: Numbers, n: Vectors) -> Numbers:
    """He1991 eq. 18: an element of the surface over its projection dA.

    Compiled: none, a step of the derivation
    """
    return dA / dot(n, Z)


def v(k_i: Vectors, k_r: Vectors, lam: float) -> Vectors:
    """He1991 eq. 20, eq. 84: the change of the wave vector [1/length].

    Eq. 78 needs this one. Eq. 76 needs unit vectors, k_r - k_i: the print has one v for both.

    Compiled: gonio.models._htsg_kernels.lobe_state, s = L + V times the wave number of its constants
    """
    return 2 * PI / lam * (k_r - k_i)


def v_xy(k_i: Vectors, k_r: Vectors, lam: float) -> Numbers:
    """He1991 eq. 84: sqrt(v_x^2 + v_y^2) [1/length].

    Near the mirror direction it is the difference of nearly equal numbers: it loses (2 pi/lambda)/v_xy.

    Compiled: gonio.models._htsg_kernels.lobe_state
    """
    x, y = v(k_i, k_r, lam)[..., 0], v(k_i, k_r, lam)[..., 1]
    return np.sqrt(x**2 + y**2)


def S(theta_i: Numbers, theta_r: Numbers, sigma0: float, tau: float, printed: bool = False) -> Numbers:
    """He1991 eq. 23, eq. 77: the shadowing function, the fraction of the surface that is lit and seen.

    Compiled: gonio.models._htsg_kernels.shadowing
    """
    return S_1(theta_i, sigma0, tau, printed) * S_1(theta_r, sigma0, tau, printed)


def S_1(theta: Numbers, sigma0: float, tau: float, printed: bool = False) -> Numbers:
    """He1991 eq. 24: the shadowing of one direction, S_i or S_r; 0/0 at exactly grazing, where it is 0.

    Compiled: gonio.models.htsg.shadowing, gonio.models._htsg_kernels.shadowing
    """
    h = _cot(theta) * tau / (2 * sigma0)
    return (1 - erfc(h) / 2) / (Lambda(theta, sigma0, tau, printed) + 1)


def Lambda(theta: Numbers, sigma0: float, tau: float, printed: bool = False) -> Numbers:
    """He1991 eq. 25: Lambda, with the factor exp(-h^2) that the print lacks; h = tau cot(theta)/(2 sigma0).

    Smith1967 has the factor, and Monte-Carlo sums over Gaussian profiles agree with it. `printed` leaves it out. Loses
    digits for h above 5, where the two terms cancel and Lambda no longer counts beside 1.

    Compiled: gonio.models.htsg.shadowing, gonio.models._htsg_kernels.shadowing
    """
    h = _cot(theta) * tau / (2 * sigma0)
    factor = 1 if printed else np.exp(-(h**2))
    return (factor / (np.sqrt(PI) * h) - erfc(h)) / 2


# --- A.2 Tangent plane approximation ------------------------------------------------------------------------------


def p_state(k_i: Vectors, c_s: Numbers, c_p: Numbers) -> Vectors:
    """He1991 eq. 33, eq. 34, eq. 36: the incident field at phase 0, for coefficients |c_s|^2 + |c_p|^2 = 1.

    Compiled: none, gonio.models.HeTorrance.mueller has it for every polarisation
    """
    return np.asarray(c_s)[..., np.newaxis] * s_hat(k_i) + np.asarray(c_p)[..., np.newaxis] * p_hat(k_i)


def local_incident(k_i: Vectors, n: Vectors) -> tuple[Vectors, Vectors]:
    """He1991 eq. 37: the polarisation vectors (s, p) of the incident light for the local normal n; 0/0 along it.

    Compiled: none, a step of the derivation
    """
    s = unit(np.cross(k_i, n))
    return s, np.cross(s, k_i)


def T(k_i: Vectors, n: Vectors) -> Numbers:
    """He1991 eq. 38, eq. 39: from (s_i, p_i) to the local (s, p), an array (..., 2, 2).

    Compiled: none, a step of the derivation
    """
    s, p = local_incident(k_i, n)
    s_i, p_i = s_hat(k_i), p_hat(k_i)
    return np.stack([np.stack([dot(s, s_i), dot(s, p_i)], -1), np.stack([dot(p, s_i), dot(p, p_i)], -1)], -2)


def k_rn(k_i: Vectors, n: Vectors) -> Vectors:
    """He1991 eq. 43: the mirror direction of the local tangent plane.

    Compiled: none, a step of the derivation
    """
    return k_i - 2 * dot(k_i, n)[..., np.newaxis] * n


def local_reflected(k_i: Vectors, n: Vectors) -> tuple[Vectors, Vectors]:
    """He1991 eq. 42: the polarisation vectors (s, p) of what the tangent plane reflects.

    Compiled: none, a step of the derivation
    """
    s, _ = local_incident(k_i, n)
    return s, np.cross(s, k_rn(k_i, n))


def F_matrix(theta: Numbers, n: complex) -> Numbers:
    """He1991 eq. 41, eq. 44: the Fresnel matrix diag(F_s, F_p), an array (..., 2, 2).

    Compiled: gonio.models.fresnel.amplitudes
    """
    F_s, F_p = fresnel.amplitudes(theta, n)
    zero = np.zeros_like(F_s)
    return np.stack([np.stack([F_s, zero], -1), np.stack([zero, F_p], -1)], -2)


def E_s(k_i: Vectors, normal: Vectors, c_s: complex, c_p: complex, n: complex) -> Vectors:
    """He1991 eq. 40, eq. 45, eq. 46: the field that the tangent plane with a local normal reflects, at phase 0.

    Compiled: none, a step of the derivation
    """
    theta = np.arctan2(length(np.cross(k_i, normal)), -dot(k_i, normal))
    local = F_matrix(theta, n) @ T(k_i, normal) @ np.array([c_s, c_p])
    s, p = local_reflected(k_i, normal)
    return local[..., :1] * s + local[..., 1:] * p


# --- A.3 Representation of the surface ----------------------------------------------------------------------------


def p_joint(z1: Numbers, z2: Numbers, r: Numbers, sigma: float, tau: float) -> Numbers:
    """He1991 eq. 47: the joint distribution of the heights of two points at a distance r.

    Compiled: none, a step of the derivation
    """
    c = C(r, tau)
    exponent = -(z1**2 + z2**2 - 2 * c * z1 * z2) / (2 * sigma**2 * (1 - c**2))
    return np.exp(exponent) / (2 * PI * sigma**2 * np.sqrt(1 - c**2))


def C(r: Numbers, tau: float) -> Numbers:
    """He1991 eq. 48: the correlation of heights at a distance r; the rms slope is 2 sigma0/tau.

    Compiled: none, a step of the derivation
    """
    return np.exp(-(r**2) / tau**2)


# --- A.4 Analytic evaluation of the integrals ---------------------------------------------------------------------


def n_b(k_i: Vectors, k_r: Vectors) -> Vectors:
    """He1991 eq. 51: the unit vector that bisects the directions toward source and receiver, where F is evaluated.

    Compiled: gonio.models._htsg_kernels.jones, whose (hx, hy, hz) is k_r - k_i
    """
    return unit(k_r - k_i)


def bisecting_angle(k_i: Vectors, k_r: Vectors) -> Numbers:
    """He1991, after eqs. 65 and 86: acos(|k_r - k_i|/2), the angle of incidence on n_b.

    By the arc tangent of |k_r + k_i|/|k_r - k_i|, which is the same: an arc cosine loses half the digits near 0.

    Compiled: gonio.models._htsg_kernels.lobe_state and gonio.models._htsg_kernels.jones, by its cosine squared
    """
    return np.arctan2(length(k_r + k_i), length(k_r - k_i))


def characteristic(r: Numbers, g: Numbers, tau: float) -> Numbers:
    """He1991 eq. 52: the average of exp(-i v_z (z1 - z2)) at the distance r, with v_z^2 sigma^2 = g.

    Compiled: none, eq. 56 is its integral
    """
    return np.exp(-g * (1 - C(r, tau)))


def sigma(theta_i: Numbers, theta_r: Numbers, sigma0: float, tau: float) -> Numbers:
    """He1991 eq. 53, eq. 80: the effective roughness, of the parts of the surface that are lit and seen.

    Compiled: gonio.models.htsg.effective_roughness, gonio.models._htsg_kernels.spike_reflectivity
    """
    x = z0_over_sigma0(K(theta_i, sigma0, tau) + K(theta_r, sigma0, tau))
    return sigma0 / np.sqrt(1 + x**2)


def z0_over_sigma0(K: Numbers) -> Numbers:
    """He1991 eq. 54, eq. 81: the root x = z0/sigma0 of sqrt(pi/2) x = (K/4) exp(-x^2/2), K = K_i + K_r, by bisection.

    Eq. 54 has the factor 1/4 in its K, eq. 81 in front. For K up to 1e40.

    Compiled: gonio.models.htsg.effective_roughness, which has the closed form x^2 = W0(K^2/8 pi)
    """
    low, high = np.zeros_like(np.asarray(K, float)), K / 4 / np.sqrt(PI / 2)
    for _ in range(200):
        x = (low + high) / 2
        below = np.sqrt(PI / 2) * x < K / 4 * np.exp(-(x**2) / 2)
        low, high = np.where(below, x, low), np.where(below, high, x)
    return x


def K(theta: Numbers, sigma0: float, tau: float) -> Numbers:
    """He1991 eq. 55, eq. 82, eq. 83: tan(theta) erfc(tau cot(theta)/(2 sigma0)), K_i or K_r.

    Compiled: gonio.models._htsg_kernels.shadowing
    """
    return np.tan(theta) * erfc(tau / (2 * sigma0) * _cot(theta))


def script_N(vx: Numbers, vy: Numbers, g: Numbers, tau: float, Lx: float, Ly: float) -> Numbers:
    """He1991 eq. 56: the double integral over a patch of Lx by Ly, of area A = Lx Ly [length^2].

    Compiled: none, eq. 58 is what the models evaluate
    """
    A = Lx * Ly
    coherent = A * np.sinc(vx * Lx / PI) * np.sinc(vy * Ly / PI)  # numpy's sinc(x) is sin(pi x)/(pi x)
    return np.exp(-g) * coherent + PI * tau**2 * np.exp(log_series(g, (vx**2 + vy**2) * tau**2 / 4))


def coherent(theta_i: Numbers, domega_i: float, lam: float, Delta: Numbers = 1) -> Numbers:
    """He1991 eq. 57: the first term of eq. 56 for a cone of light: lambda^2 Delta/(domega_i cos theta_i) [length^2].

    The constant, hard to read in print, is lambda^2 = (2 pi/k)^2: only so eq. 66 leads to eq. 6.

    Compiled: gonio.instrument.apparent_spike
    """
    return lam**2 * Delta / (domega_i * np.cos(theta_i))


def script_N_cone(
    theta_i: Numbers, domega_i: float, Delta: Numbers, v_xy: Numbers, g: Numbers, tau: float, lam: float
) -> Numbers:
    """He1991 eq. 58: what eq. 56 becomes for a cone of light on a large patch [length^2].

    Compiled: gonio.models._htsg_kernels.spike_reflectivity and gonio.models._htsg_kernels.lobe_state, its two terms
    """
    return np.exp(-g) * coherent(theta_i, domega_i, lam, Delta) + PI * tau**2 * np.exp(
        log_series(g, v_xy**2 * tau**2 / 4)
    )


def F_s(k_i: Vectors, k_r: Vectors, c_s: complex, c_p: complex, n: complex, lam: float) -> Numbers:
    """He1991 eq. 59: the s component's part of eq. 68 [1/length^2].

    Compiled: gonio.models._htsg_kernels.mueller_matrix, |J c|^2 for every (c_s, c_p)
    """
    m = M(k_i, k_r, n)
    return delta(k_i, k_r, lam) * np.abs(c_s * m[..., 0, 0] + c_p * m[..., 0, 1]) ** 2


def F_p(k_i: Vectors, k_r: Vectors, c_s: complex, c_p: complex, n: complex, lam: float) -> Numbers:
    """He1991 eq. 60: the p component's part of eq. 68 [1/length^2].

    Compiled: gonio.models._htsg_kernels.mueller_matrix, |J c|^2 for every (c_s, c_p)
    """
    m = M(k_i, k_r, n)
    return delta(k_i, k_r, lam) * np.abs(c_s * m[..., 1, 0] + c_p * m[..., 1, 1]) ** 2


def M(k_i: Vectors, k_r: Vectors, n: complex) -> Numbers:
    """He1991 eqs. 61 to 64: [[M_ss, M_sp], [M_ps, M_pp]], an array (..., 2, 2), with a minus in M_ps.

    The print of eq. 64 lacks that minus: eqs. 37 to 46 on the plane of n_b give it, and without it a perfect conductor
    would not reflect all of elliptic light. Loses 1/|k_r x k_i|^2 near retro-reflection and forward grazing, and is
    0/0 there and along the normal.

    Compiled: gonio.models._htsg_kernels.jones, which has no singularity
    """
    Fs, Fp = fresnel.amplitudes(bisecting_angle(k_i, k_r), n)
    a_s, a_p = dot(s_hat(k_i), k_r), dot(p_hat(k_i), k_r)
    b_s, b_p = dot(s_hat(k_r), k_i), dot(p_hat(k_r), k_i)
    M_ss = Fs * a_p * b_p + Fp * a_s * b_s  # He1991 eq. 61
    M_sp = -(Fs * a_s * b_p - Fp * a_p * b_s)  # He1991 eq. 62
    M_pp = Fs * a_s * b_s + Fp * a_p * b_p  # He1991 eq. 63
    M_ps = -(Fs * a_p * b_s - Fp * a_s * b_p)  # He1991 eq. 64 with the minus that the print lacks
    return np.stack([np.stack([M_ss, M_sp], -1), np.stack([M_ps, M_pp], -1)], -2)


def delta(k_i: Vectors, k_r: Vectors, lam: float) -> Numbers:
    """He1991 eq. 65: delta [1/length^2], infinite where |k_r x k_i| = 0, and M is 0.

    Compiled: gonio.models._htsg_kernels.lobe_state, where its v.v/v_z is in G
    """
    vector = v(k_i, k_r, lam)
    return (dot(vector, vector) / vector[..., 2]) ** 2 / length(np.cross(k_r, k_i)) ** 4


def dI(theta_r: Numbers, E0_squared: Numbers, F: Numbers, S: Numbers, script_N: Numbers) -> Numbers:
    """He1991 eq. 26, eq. 27, eq. 50, eq. 66: the reflected intensity, of the s or p component by `F_s` or `F_p`.

    Compiled: none, eqs. 6 and 7 are what it leads to
    """
    return E0_squared / np.cos(theta_r) * S / (4 * PI) ** 2 * F * script_N


def E0_squared(I_i: Numbers, domega_i: Numbers) -> Numbers:
    """He1991 eq. 67: |E_0|^2 = I_i domega_i.

    Compiled: none, a definition
    """
    return I_i * domega_i


def F_total(k_i: Vectors, k_r: Vectors, c_s: complex, c_p: complex, n: complex, lam: float) -> Numbers:
    """He1991 eq. 32, eq. 68: F_s + F_p [1/length^2].

    Compiled: gonio.models._htsg_kernels.mueller_matrix, whose first row is the total
    """
    return F_s(k_i, k_r, c_s, c_p, n, lam) + F_p(k_i, k_r, c_s, c_p, n, lam)


def log_series(g: Numbers, c: Numbers) -> Numbers:
    """He1991 eq. 7, eq. 56, eq. 58, eq. 78: ln of the sum over m > 0 of g^m e^-g/(m! m) e^(-c/m), c = v_xy^2 tau^2/4.

    Term by term from m = 1. Beyond m = max(2 g, sqrt(2 c/ln 2)) each term is at most 2^-1/2 times the one before, and
    120 more are summed: 2^-58 of the sum is left out. The terms are taken by logarithms, over the largest of them,
    since exp(-g) may underflow and m! overflow. That loses g ln(g) and c/m, whichever is larger.

    Compiled: gonio.models.htsg.log_series, gonio.models._htsg_series.series
    """
    g, c = np.broadcast_arrays(np.asarray(g, float), np.asarray(c, float))
    last = int(max(2 * g.max(initial=0.0), np.sqrt(2 * c.max(initial=0.0) / np.log(2)))) + 120
    with np.errstate(divide="ignore", invalid="ignore"):  # ln 0 = -inf: the sum is 0 for g = 0

        def log_term(m: int) -> Numbers:
            return m * np.log(g) - g - gammaln(m + 1) - np.log(m) - c / m

        largest = np.full(g.shape, -np.inf)
        for m in range(1, last + 1):
            largest = np.maximum(largest, log_term(m))
        total = np.zeros(g.shape)
        for m in range(1, last + 1):
            total += np.exp(log_term(m) - largest)
        return np.where(g > 0, largest + np.log(total), -np.inf)[()]


def _cot(theta: Numbers) -> Numbers:
    with np.errstate(divide="ignore"):  # at normal incidence it is infinite, and nothing is shadowed
        return 1 / np.tan(theta)
