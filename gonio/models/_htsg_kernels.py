"""Kernels of He, Torrance, Sillion and Greenberg (1991): geometry, Fresnel and shadowing of every pair, spike, Jones.

Pairs are worked through in blocks: what is the same for all of them here, then their series (`_htsg_series`).
"""

# mypy: allow-untyped-defs, allow-untyped-calls

import math

import numpy as np

from gonio.models._compile import device, template
from gonio.models._facets import SINGLE_RANGE, fresnel
from gonio.models._htsg_expansion import TERMS, scaled_erfcx
from gonio.models._htsg_series import BLOCK, EXPANDED, LANES, exp2_over, lambert_w, narrow, series
from gonio.models._loops import part, unit_vectors, vector_part, vectors_of_angles
from gonio.models._math import _LOG2_E, exp, sincos, sincos_polar

_SQRT_PI = math.sqrt(math.pi)
_ROWS = max(TERMS) + 1

# The constants of a model at a wavelength, in order: a/pi, k0^4 sigma0^2 tau^2/(16 pi), (k0 sigma0)^2, (k0 tau)^2/4,
# tau/(2 sigma0), 1 for eq. 25 as printed, |n~^2 - 1|^2, n^2 - k^2 - 1, n k, the tier of the series, 1 without Fresnel.
DIFFUSE = 0
TIER, ROUGHEST = 9, 2


@device
def surface_constants(k0, sigma0, tau):
    """Constants 1 to 4 of a surface, at a wave number in 1/um, of lengths in um; the last one is at most 1e100."""
    phase, width = (k0 * sigma0) * (k0 * sigma0), (k0 * tau) * (k0 * tau)
    return phase * width / (16.0 * math.pi), phase, 0.25 * width, min(tau / (2.0 * max(sigma0, 1e-200)), 1e100)


@device
def shadowing(z_i, s_i, z_r, s_r, a, printed):
    """(lit_i, all_i, lit_r, all_r, K_i + K_r) with S_1/cos(theta) = lit/all.

    For cosines z, sines s and a = tau/(2 sigma0). S_1 = 1 / (1 + exp(-h^2) / (sqrt(pi) h erfc(-h))), h = a z/s:
    He1991 eqs. 24 and 25 with the factor exp(-h^2) that the print lacks (`printed` = 1: as the print has it); K is
    eq. 82. Regular at grazing and at normal incidence. One division serves both directions.
    """
    # h = a cot(theta)
    sin_i, sin_r = max(s_i, 1e-140), max(s_r, 1e-140)
    per_sines = 1.0 / (sin_i * sin_r)
    h_i, h_r = a * z_i * (sin_r * per_sines), a * z_r * (sin_i * per_sines)
    x_i, x_r = min(h_i, 6.5), min(h_r, 6.5)  # beyond, erfc(h) and exp(-h^2) are below 4e-20
    exp_i, exp_r = exp2_over(x_i * x_i, _LOG2_E, False), exp2_over(x_r * x_r, _LOG2_E, False)
    exp_i, exp_r = exp_i if h_i <= 6.5 else 0.0, exp_r if h_r <= 6.5 else 0.0  # exp(-h^2)
    # erfc(x) = exp(-x^2) scaled_erfcx((x - 3)/(x + 3)) / (1 + 2 x)
    t_i, t_r, u_i, u_r = x_i + 3.0, x_r + 3.0, 1.0 + 2.0 * x_i, 1.0 + 2.0 * x_r
    per_all = 1.0 / (t_i * u_i * (t_r * u_r))
    erfc_i = exp_i * scaled_erfcx((x_i - 3.0) * (u_i * per_all * (t_r * u_r))) * (t_i * per_all * (t_r * u_r))
    erfc_r = exp_r * scaled_erfcx((x_r - 3.0) * (u_r * per_all * (t_i * u_i))) * (t_r * per_all * (t_i * u_i))
    # He1991 eqs. 24 and 25, with erfc(-h) = 2 - erfc(h)
    lit_i, lit_r = _SQRT_PI * a * (2.0 - erfc_i), _SQRT_PI * a * (2.0 - erfc_r)
    dark_i, dark_r = s_i * (printed + (1.0 - printed) * exp_i), s_r * (printed + (1.0 - printed) * exp_r)
    # He1991 eq. 82: K = tan(theta) erfc(h), for both directions
    cos_i, cos_r = max(z_i, 1e-140), max(z_r, 1e-140)
    k = (s_i * erfc_i * cos_r + s_r * erfc_r * cos_i) / (cos_i * cos_r)
    return lit_i, z_i * lit_i + dark_i, lit_r, z_r * lit_r + dark_r, min(k, 1e139)


@device
def lobe_state(lx, ly, lz, vx, vy, vz, constants):
    """(factor, K, c, g_0) of a pair: its lobe is factor * N * T(N g_0, c), with N = (sigma/sigma0)^2 and T = S(g, c)/g.

    He1991 eq. 71 with G = |L+V|^4/(L+V)_z^2 (eq. 76 without its singularities), where g cancels (L+V)_z^2: with both
    directions grazing the product stays finite. `constants` is what `HeTorrance` puts together; more may follow.
    """
    _, scale, phase, width, slope, printed, contrast, real, imag, _, bare = constants[:11]
    sx, sy, sz = lx + vx, ly + vy, lz + vz
    sxy2 = sx * sx + sy * sy
    s2 = sxy2 + sz * sz
    s_i, s_r = math.sqrt(lx * lx + ly * ly), math.sqrt(vx * vx + vy * vy)
    lit_i, all_i, lit_r, all_r, k = shadowing(lz, s_i, vz, s_r, slope, printed)
    f_up, f_down = fresnel(min(0.25 * s2, 1.0), contrast, real, imag)
    f_up, f_down = f_up if bare == 0.0 else 1.0, f_down if bare == 0.0 else 1.0
    factor = scale * (s2 * s2) * (f_up * lit_i * lit_r) / (f_down * all_i * all_r)
    # He1991 eq. 78: c = v_xy^2 tau^2/4; eq. 79 with sigma0 for sigma: g_0 = (k0 sigma0 (cos theta_i + cos theta_r))^2
    return (factor if lz > 0.0 and vz > 0.0 else 0.0), k, width * sxy2, phase * sz * sz


@device
def vector_states(count, l, v, constants, factor, k, c, g):  # noqa: E741
    """`lobe_state` of a block of pairs of vectors, one column each; 1 where a vector is not of unit length."""
    wrong = 0
    for j in range(count):
        lx, ly, lz, vx, vy, vz, off = unit_vectors(
            l[3 * j], l[3 * j + 1], l[3 * j + 2], v[3 * j], v[3 * j + 1], v[3 * j + 2]
        )
        wrong |= off
        factor[j], k[j], c[j], g[j] = lobe_state(lx, ly, max(lz, 0.0), vx, vy, max(vz, 0.0), constants)
    return wrong


# --- the loops of _loops.py, with a second pass -------------------------------------------------------------------


@device
def scratch(pairs):
    """Room for a block of `pairs`: their state, their order by class and their classes, and what `series` works in.

    No more than they fill: small room stays with the process, and larger one goes back to the system each time.
    """
    pairs = min(pairs, BLOCK)
    state, work, powers = np.empty((6, pairs)), np.empty((8, EXPANDED)), np.empty((_ROWS, LANES))
    return state, np.empty(pairs, np.int64), np.empty(pairs, np.int64), work, powers


@template("r1 i r1 i p w1 i i")
def over_vectors(omega_i, step_i, omega_r, step_r, constants, out, start, stop):
    # a state of float32 is not worth more than the series for 1e-6, which are float64
    diffuse, tier = constants[DIFFUSE], ROUGHEST if out.itemsize == 4 else int(constants[TIER])
    wrong = 0
    state, order, kind_of, work, powers = scratch(stop - start)
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        l, v = vector_part(omega_i, first, count, step_i), vector_part(omega_r, first, count, step_r)  # noqa: E741
        o = out[first : first + count]
        wrong |= vector_states(count, l, v, constants, state[0], state[1], state[2], state[3])
        narrow(count, state)
        series(count, tier, state, o, order, kind_of, work, powers)
        for j in range(count):
            o[j] += diffuse if l[3 * j + 2] >= 0.0 and v[3 * j + 2] >= 0.0 else 0.0
    return wrong


@device
def of_equal_slope(sets, row, first):
    """The nearest set before a row, not before `first`, that differs in sigma0 and tau alone, at one slope; else -1."""
    c = sets[row]
    for other in range(row - 1, first - 1, -1):
        o = sets[other]
        equal = o[1] > 0.0 and o[2] > 0.0 and o[3] > 0.0 and abs(o[4] - c[4]) <= 1e-15 * c[4]  # it is tau/(2 sigma0)
        for k in range(5, 11):
            equal = equal and o[k] == c[k]
        if equal:
            return other
    return -1


@template("r1 r1 r2 w1")
def over_sets(omega_i, omega_r, sets, out):
    """BRDF of unit vectors for many sets of constants of one tier, set after set.

    All go through the series together, so that its classes are full: a class takes its time even for a single pair.
    """
    n = omega_i.size // 3
    state, order, kind_of, work, powers = scratch(out.size)
    for first in range(0, out.size, BLOCK):
        stop = min(first + BLOCK, out.size)
        for row in range(first // n, (stop + n - 1) // n):
            c = sets[row]
            constants = (c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9], c[10])
            begin, end = max(first, row * n), min(stop, row * n + n)
            a, b, j = begin - first, end - first, begin - row * n
            other = of_equal_slope(sets, row, (first + n - 1) // n)
            if j == 0 and other >= 0:  # Fresnel and shadowing are the same
                o, back = sets[other], (row - other) * n
                scale, width, phase = c[1] / o[1], c[3] / o[3], c[2] / o[2]
                for i in range(a, b):
                    state[0, i], state[1, i] = scale * state[0, i - back], state[1, i - back]
                    state[2, i], state[3, i] = width * state[2, i - back], phase * state[3, i - back]
                continue
            l, v = vector_part(omega_i, j, b - a, 1), vector_part(omega_r, j, b - a, 1)  # noqa: E741
            vector_states(b - a, l, v, constants, state[0, a:b], state[1, a:b], state[2, a:b], state[3, a:b])
        narrow(stop - first, state)
        series(stop - first, int(sets[0, TIER]), state, out[first:stop], order, kind_of, work, powers)
    for row in range(len(sets)):
        for j in range(n):
            lit = omega_i[3 * j + 2] >= 0.0 and omega_r[3 * j + 2] >= 0.0
            out[row * n + j] += sets[row, DIFFUSE] if lit else 0.0
    return 0


@template("r1 i r1 i r1 i r1 i p w1 i i")
def over_angles(theta_i, step_ti, phi_i, step_pi, theta_r, step_tr, phi_r, step_pr, constants, out, start, stop):
    diffuse, tier = constants[DIFFUSE], int(constants[TIER])
    wrong = 0
    state, order, kind_of, work, powers = scratch(stop - start)
    factor, k, c, g = state[0], state[1], state[2], state[3]
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        ti, pi_ = part(theta_i, first, count, step_ti), part(phi_i, first, count, step_pi)
        tr, pr = part(theta_r, first, count, step_tr), part(phi_r, first, count, step_pr)
        o = out[first : first + count]
        for j in range(count):
            lx, ly, lz, vx, vy, vz, off = vectors_of_angles(ti[j], pi_[j], tr[j], pr[j])
            wrong |= off
            factor[j], k[j], c[j], g[j] = kernel(lx, ly, lz, vx, vy, vz, constants)  # type: ignore[name-defined]  # noqa: F821
        narrow(count, state)
        series(count, tier, state, o, order, kind_of, work, powers)
        for j in range(count):
            o[j] += diffuse
    return wrong


# --- many wavelengths: geometry, shadowing and the effective roughness are the same for all of them -----------------


@device
def pair_state(lx, ly, lz, vx, vy, vz, slope, printed):
    """(shape, K, V.H^2, |s_xy|^2, s_z^2) of a pair, s = L + V: what of `lobe_state` no wavelength enters."""
    sx, sy, sz = lx + vx, ly + vy, lz + vz
    sxy2 = sx * sx + sy * sy
    s2 = sxy2 + sz * sz
    s_i, s_r = math.sqrt(lx * lx + ly * ly), math.sqrt(vx * vx + vy * vy)
    lit_i, all_i, lit_r, all_r, k = shadowing(lz, s_i, vz, s_r, slope, printed)
    shape = (s2 * s2) * (lit_i * lit_r) / (all_i * all_r)
    return (shape if lz > 0.0 and vz > 0.0 else 0.0), k, min(0.25 * s2, 1.0), sxy2, sz * sz


@device
def spectrum(count, first, pairs, tier, waves, state, shared, out, order, kind_of, work, powers):
    """The lobe of a block of pairs at every wavelength, from its `pair_state`, into one row of `out` a wavelength.

    `waves` has six numbers a wavelength: k0^4 sigma0^2 tau^2/(16 pi), (k0 sigma0)^2, (k0 tau)^2/4, and three of F.
    """
    narrow(count, state)
    shape, c2, sxy2, sz2, base = shared[0], shared[1], shared[2], shared[3], shared[4]
    factor, c, g = state[0], state[2], state[3]
    for j in range(count):
        shape[j], sz2[j] = factor[j], g[j]
    for w in range(waves.size // 6):
        scale, phase, width = waves[6 * w], waves[6 * w + 1], waves[6 * w + 2]
        contrast, real, imag = waves[6 * w + 3], waves[6 * w + 4], waves[6 * w + 5]
        o = out[w * pairs + first : w * pairs + first + count]
        for j in range(count):
            f_up, f_down = fresnel(c2[j], contrast, real, imag)
            factor[j] = scale * shape[j] * f_up / f_down
            c[j], g[j] = width * sxy2[j], phase * sz2[j]
        series(count, tier, state, o, order, kind_of, work, powers)
        for j in range(count):
            o[j] += base[j]


@template("r1 i r1 i i p r1 w1 i i")
def spectrum_over_vectors(omega_i, step_i, omega_r, step_r, pairs, constants, waves, out, start, stop):
    diffuse, slope, printed, tier = constants[0], constants[1], constants[2], int(constants[3])
    wrong = 0
    shared = np.empty((5, BLOCK))
    state, order, kind_of, work, powers = scratch(stop - start)
    factor, k, g, c2, sxy2, base = state[0], state[1], state[3], shared[1], shared[2], shared[4]
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        l, v = vector_part(omega_i, first, count, step_i), vector_part(omega_r, first, count, step_r)  # noqa: E741
        for j in range(count):
            up_i, up_r = l[3 * j + 2], v[3 * j + 2]
            lx, ly, lz, vx, vy, vz, off = unit_vectors(l[3 * j], l[3 * j + 1], up_i, v[3 * j], v[3 * j + 1], up_r)
            wrong |= off
            factor[j], k[j], c2[j], sxy2[j], g[j] = kernel(  # type: ignore[name-defined]  # noqa: F821
                lx, ly, max(lz, 0.0), vx, vy, max(vz, 0.0), slope, printed
            )
            base[j] = diffuse if up_i >= 0.0 and up_r >= 0.0 else 0.0
        spectrum(count, first, pairs, tier, waves, state, shared, out, order, kind_of, work, powers)
    return wrong


@template("r1 i r1 i r1 i r1 i i p r1 w1 i i")
def spectrum_over_angles(
    theta_i, step_ti, phi_i, step_pi, theta_r, step_tr, phi_r, step_pr, pairs, constants, waves, out, start, stop
):
    diffuse, slope, printed, tier = constants[0], constants[1], constants[2], int(constants[3])
    wrong = 0
    shared = np.empty((5, BLOCK))
    state, order, kind_of, work, powers = scratch(stop - start)
    factor, k, g, c2, sxy2, base = state[0], state[1], state[3], shared[1], shared[2], shared[4]
    for first in range(start, stop, BLOCK):
        count = min(BLOCK, stop - first)
        ti, pi_ = part(theta_i, first, count, step_ti), part(phi_i, first, count, step_pi)
        tr, pr = part(theta_r, first, count, step_tr), part(phi_r, first, count, step_pr)
        for j in range(count):
            lx, ly, lz, vx, vy, vz, off = vectors_of_angles(ti[j], pi_[j], tr[j], pr[j])
            wrong |= off
            factor[j], k[j], c2[j], sxy2[j], g[j] = kernel(  # type: ignore[name-defined]  # noqa: F821
                lx, ly, lz, vx, vy, vz, slope, printed
            )
            base[j] = diffuse
        spectrum(count, first, pairs, tier, waves, state, shared, out, order, kind_of, work, powers)
    return wrong


lobe_state.__dict__.update(
    over_vectors=over_vectors, over_angles=over_angles, over_sets=over_sets, single_range=SINGLE_RANGE
)


# --- the specular spike and the Jones matrix ---------------------------------------------------------------------


@device
def spike_reflectivity(theta, constants):
    """rho_s = |F|^2 exp(-g) S at the mirror direction (He1991 eq. 73)."""
    _, _, phase, _, slope, printed, contrast, real, imag, _, _ = constants
    sine, cosine = sincos_polar(theta)
    lit, whole, _, _, k = shadowing(cosine, sine, cosine, sine, slope, printed)
    _, narrowing, _ = lambert_w(k * k * (0.125 / math.pi))  # He1991 eqs. 80-83: (sigma/sigma0)^2
    f_up, f_down = fresnel(cosine * cosine, contrast, real, imag)
    f2 = f_up / f_down if f_down > 0.0 else 0.0  # n = 1 at grazing
    s_1 = cosine * lit / whole if phase > 0.0 else 1.0  # eq. 24
    return f2 * exp(-4.0 * phase * narrowing * cosine * cosine) * s_1 * s_1  # eq. 79: g = (2 k0 sigma cos(theta))^2


@template("r1 p w1 i i")
def over_thetas(theta, constants, out, start, stop):
    for j in range(start, stop):
        out[j] = kernel(theta[j], constants)  # type: ignore[name-defined]  # noqa: F821
    return 0


@device
def jones(sin_i, cos_i, sin_r, cos_r, sin_d, cos_d, rise, loss):
    """(J_ss, J_sp, J_ps, J_pp), J[e_r][e_i] as real and imaginary parts, in the frame of the source's azimuth.

    J = -F_s {e_r.e_i + (n^2 - 1)/(2c (n^2 c + q)) (e_r.k_i)(e_i.k_r)}: He1991 eqs. 61-65, with the sign that the
    print of eq. 64 lacks, and without their division by |k_r x k_i|^2: regular at retro and at normal incidence,
    where s is taken at the given azimuth. `rise` = Re n^2 - 1, `loss` = Im n^2.
    """
    hx, hy, hz = sin_i + sin_r * cos_d, sin_r * sin_d, cos_i + cos_r
    c2 = min(0.25 * (hx * hx + hy * hy + hz * hz), 1.0)
    c = max(math.sqrt(c2), 1e-100)
    re = rise + c2
    large = max(math.sqrt(0.5 * (math.sqrt(re * re + loss * loss) + abs(re))), 1e-100)
    small = 0.5 * loss / large
    q_re = large if re >= 0.0 else small
    q_im = small if re >= 0.0 else large
    # f = -F_s = (n^2 - 1)/(c + q)^2
    a, b = c + q_re, q_im
    d_re, d_im = a * a - b * b, 2.0 * a * b
    d = d_re * d_re + d_im * d_im
    f_re, f_im = (rise * d_re + loss * d_im) / d, (loss * d_re - rise * d_im) / d
    # t = f (n^2 - 1)/(2 c (n^2 c + q))
    d_re, d_im = 2.0 * c * ((1.0 + rise) * c + q_re), 2.0 * c * (loss * c + q_im)
    d = d_re * d_re + d_im * d_im
    w_re, w_im = (rise * d_re + loss * d_im) / d, (loss * d_re - rise * d_im) / d
    t_re, t_im = f_re * w_re - f_im * w_im, f_re * w_im + f_im * w_re
    # bases s = k x z/|k x z|, p = s x k: s_i = (0, 1, 0), p_i = (-cos_i, 0, sin_i), s_r = (sin_d, -cos_d, 0),
    # p_r = (-cos_r cos_d, -cos_r sin_d, sin_r); k_i = (-sin_i, 0, -cos_i), k_r = (sin_r cos_d, sin_r sin_d, cos_r)
    s_kr = sin_r * sin_d
    p_kr = sin_i * cos_r - cos_i * sin_r * cos_d
    s_ki = -sin_i * sin_d
    p_ki = sin_i * cos_r * cos_d - cos_i * sin_r
    ss, sp = -cos_d, -cos_i * sin_d
    ps, pp = -cos_r * sin_d, cos_i * cos_r * cos_d + sin_i * sin_r
    return (
        (f_re * ss + t_re * s_ki * s_kr, f_im * ss + t_im * s_ki * s_kr),
        (f_re * sp + t_re * s_ki * p_kr, f_im * sp + t_im * s_ki * p_kr),
        (f_re * ps + t_re * p_ki * s_kr, f_im * ps + t_im * p_ki * s_kr),
        (f_re * pp + t_re * p_ki * p_kr, f_im * pp + t_im * p_ki * p_kr),
    )


@device
def mueller_matrix(a, b, c, d, factor):
    """Sixteen numbers from J = [[a, b], [c, d]], for I, Q = |Es|^2 +- |Ep|^2, U = 2 Re Es Ep*, V = -2 Im Es Ep*."""
    half = 0.5 * factor
    aa, bb = half * (a[0] * a[0] + a[1] * a[1]), half * (b[0] * b[0] + b[1] * b[1])
    cc, dd = half * (c[0] * c[0] + c[1] * c[1]), half * (d[0] * d[0] + d[1] * d[1])
    ab_re, ab_im = factor * (a[0] * b[0] + a[1] * b[1]), factor * (a[1] * b[0] - a[0] * b[1])
    cd_re, cd_im = factor * (c[0] * d[0] + c[1] * d[1]), factor * (c[1] * d[0] - c[0] * d[1])
    ac_re, ac_im = factor * (a[0] * c[0] + a[1] * c[1]), factor * (a[1] * c[0] - a[0] * c[1])
    bd_re, bd_im = factor * (b[0] * d[0] + b[1] * d[1]), factor * (b[1] * d[0] - b[0] * d[1])
    ad_re, ad_im = factor * (a[0] * d[0] + a[1] * d[1]), factor * (a[1] * d[0] - a[0] * d[1])
    bc_re, bc_im = factor * (b[0] * c[0] + b[1] * c[1]), factor * (b[1] * c[0] - b[0] * c[1])
    return (
        (aa + bb + cc + dd, aa - bb + cc - dd, ab_re + cd_re, ab_im + cd_im),
        (aa + bb - cc - dd, aa - bb - cc + dd, ab_re - cd_re, ab_im - cd_im),
        (ac_re + bd_re, ac_re - bd_re, ad_re + bc_re, ad_im - bc_im),
        (-ac_im - bd_im, bd_im - ac_im, -ad_im - bc_im, ad_re - bc_re),
    )


MATRICES = 64  # Mueller matrices made at a time, column by column, before they are laid out one after another


@template("r1 i r1 i r1 i r1 i p r1 w1 i i")
def mueller_over_angles(
    theta_i, step_ti, phi_i, step_pi, theta_r, step_tr, phi_r, step_pr, constants, lobe, out, start, stop
):
    diffuse, _, _, _, _, _, _, rise, n_k, _, _ = constants
    loss = 2.0 * n_k
    columns = np.empty((16, MATRICES))
    m0, m1, m2, m3 = columns[0], columns[1], columns[2], columns[3]
    m4, m5, m6, m7 = columns[4], columns[5], columns[6], columns[7]
    m8, m9, m10, m11 = columns[8], columns[9], columns[10], columns[11]
    m12, m13, m14, m15 = columns[12], columns[13], columns[14], columns[15]
    for first in range(start, stop, MATRICES):
        count = min(MATRICES, stop - first)
        ti, pi_ = part(theta_i, first, count, step_ti), part(phi_i, first, count, step_pi)
        tr, pr = part(theta_r, first, count, step_tr), part(phi_r, first, count, step_pr)
        factor = lobe[first : first + count]
        for j in range(count):
            sin_i, cos_i = sincos_polar(ti[j])
            sin_r, cos_r = sincos_polar(tr[j])
            sin_d, cos_d = sincos(pr[j] - pi_[j])
            a, b, c, d = kernel(sin_i, cos_i, sin_r, cos_r, sin_d, cos_d, rise, loss)  # type: ignore[name-defined]  # noqa: F821
            r0, r1, r2, r3 = mueller_matrix(a, b, c, d, factor[j])
            m0[j], m1[j], m2[j], m3[j] = r0[0] + diffuse, r0[1], r0[2], r0[3]
            m4[j], m5[j], m6[j], m7[j] = r1[0], r1[1], r1[2], r1[3]
            m8[j], m9[j], m10[j], m11[j] = r2[0], r2[1], r2[2], r2[3]
            m12[j], m13[j], m14[j], m15[j] = r3[0], r3[1], r3[2], r3[3]
        rows = out[16 * first : 16 * (first + count)]
        for j in range(count):
            for k in range(16):
                rows[16 * j + k] = columns[k, j]
    return 0


@template("r1 r1 r1 p w1 i i")
def jones_over_angles(theta_i, theta_r, dphi, constants, out, start, stop):
    _, _, _, _, _, _, _, rise, n_k, _, _ = constants
    loss = 2.0 * n_k
    for j in range(start, stop):
        sin_i, cos_i = sincos_polar(theta_i[j])
        sin_r, cos_r = sincos_polar(theta_r[j])
        sin_d, cos_d = sincos(dphi[j])
        a, b, c, d = kernel(sin_i, cos_i, sin_r, cos_r, sin_d, cos_d, rise, loss)  # type: ignore[name-defined]  # noqa: F821
        row = out[8 * j : 8 * j + 8]
        row[0], row[1], row[2], row[3] = a[0], a[1], b[0], b[1]
        row[4], row[5], row[6], row[7] = c[0], c[1], d[0], d[1]
    return 0
