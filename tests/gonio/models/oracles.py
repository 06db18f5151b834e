"""The papers' formulas as they stand, in 60 digits: slow, readable, and written without a look at the kernels.

Angles and vectors are taken as the exact values of their doubles. `conditioning` says how much a relative error of
the arguments is magnified, so that tolerances can be stated as c eps (1 + conditioning).
"""

from collections.abc import Callable, Sequence
from typing import Any

import mpmath as mp

mp.mp.dps = 60


def direction(theta: Any, phi: Any) -> list[Any]:
    return [mp.sin(theta) * mp.cos(phi), mp.sin(theta) * mp.sin(phi), mp.cos(theta)]


def halfway(theta_i: Any, phi_i: Any, theta_r: Any, phi_r: Any) -> tuple[Any, Any, Any, Any]:
    """N.L, N.V, N.H, V.H."""
    light, view = direction(theta_i, phi_i), direction(theta_r, phi_r)
    s = [a + b for a, b in zip(light, view, strict=True)]
    length = mp.sqrt(sum(c * c for c in s))
    return light[2], view[2], s[2] / length, length / 2


def fresnel_amplitudes(c: Any, ior: complex) -> tuple[Any, Any]:
    n = mp.mpc(ior)
    q = mp.sqrt(n * n - 1 + c * c)
    q = -q if q.imag < 0 else q
    return (c - q) / (c + q), (n * n * c - q) / (n * n * c + q)


def fresnel(c: Any, ior: complex) -> Any:
    f_s, f_p = fresnel_amplitudes(c, ior)
    return (abs(f_s) ** 2 + abs(f_p) ** 2) / 2


def attenuation(nl: Any, nv: Any, nh: Any, vh: Any) -> Any:
    return min(mp.mpf(1), 2 * nh * nv / vh, 2 * nh * nl / vh)


def cook_torrance(
    theta_i: Any,
    phi_i: Any,
    theta_r: Any,
    phi_r: Any,
    slopes: Sequence[tuple[float, float]],
    ior: complex,
    distribution: str,
) -> Any:
    """R_s as printed: (F/pi) D G/((N.L)(N.V))."""
    nl, nv, nh, vh = halfway(theta_i, phi_i, theta_r, phi_r)
    alpha = mp.acos(min(nh, mp.mpf(1)))
    d = mp.mpf(0)
    for m, w in slopes:
        m = mp.mpf(m)
        if distribution == "beckmann":
            d += w * mp.exp(-((mp.tan(alpha) / m) ** 2)) / (m**2 * mp.cos(alpha) ** 4)
        else:
            d += w * mp.exp(-((alpha / m) ** 2))
    return fresnel(vh, ior) / mp.pi * d * attenuation(nl, nv, nh, vh) / (nl * nv)


def blinn(
    theta_i: Any,
    phi_i: Any,
    theta_r: Any,
    phi_r: Any,
    c: float,
    ior: complex,
    distribution: str,
    k_d: float = 0.0,
    k_s: float = 1.0,
) -> Any:
    """The BRDF (k_d + k_s s/(N.L))/pi with s = D G F/(N.E)."""
    nl, ne, nh, eh = halfway(theta_i, phi_i, theta_r, phi_r)
    c = mp.mpf(c)
    alpha = mp.acos(min(nh, mp.mpf(1)))
    d = {
        "phong": lambda: nh**c,
        "gaussian": lambda: mp.exp(-((alpha * c) ** 2)),
        "trowbridge-reitz": lambda: (c**2 / (nh**2 * (c**2 - 1) + 1)) ** 2,
    }[distribution]()
    s = d * attenuation(nl, ne, nh, eh) * fresnel(eh, ior) / ne
    return (k_d + k_s * s / nl) / mp.pi


def oren_nayar(theta_i: Any, phi_i: Any, theta_r: Any, phi_r: Any, albedo: float, sigma: Any) -> Any:
    """Eqs. 14 to 16 over E0 cos(theta_i)."""
    theta_i, theta_r, rho = mp.mpf(theta_i), mp.mpf(theta_r), mp.mpf(albedo)
    s2 = mp.mpf(sigma) ** 2
    alpha, beta = max(theta_i, theta_r), min(theta_i, theta_r)
    cosine = mp.cos(mp.mpf(phi_r) - mp.mpf(phi_i))
    c1 = 1 - s2 / (2 * (s2 + mp.mpf("0.33")))
    c2 = mp.mpf("0.45") * s2 / (s2 + mp.mpf("0.09"))
    c2 *= mp.sin(alpha) - (0 if cosine >= 0 else (2 * beta / mp.pi) ** 3)
    c3 = mp.mpf("0.125") * s2 / (s2 + mp.mpf("0.09")) * (4 * alpha * beta / mp.pi**2) ** 2
    one = c1 + cosine * c2 * mp.tan(beta) + (1 - abs(cosine)) * c3 * mp.tan((alpha + beta) / 2)
    two = mp.mpf("0.17") * rho * s2 / (s2 + mp.mpf("0.13")) * (1 - cosine * (2 * beta / mp.pi) ** 2)
    return rho / mp.pi * (one + two)


def conditioning(formula: Callable[..., Any], angles: Sequence[float]) -> float:
    """Sum over the angles of |d ln f / d ln angle|, by a relative step of 1e-20 either way (the larger: formulas have
    kinks).
    """
    value = formula(*[mp.mpf(a) for a in angles])
    if value == 0:
        return 0.0
    total = mp.mpf(0)
    for k, angle in enumerate(angles):
        steps = []
        for sign in (1, -1):
            moved = [mp.mpf(a) for a in angles]
            moved[k] = mp.mpf(angle) * (1 + sign * mp.mpf("1e-20"))
            steps.append(abs(formula(*moved) / value - 1) / mp.mpf("1e-20"))
        total += max(steps)
    return float(total)
