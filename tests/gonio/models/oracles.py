"""Directions and reflectances in 60 digits: slow, readable, and written without a look at the kernels.

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
