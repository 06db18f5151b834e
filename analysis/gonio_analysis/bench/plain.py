"""The closed models as plain numpy, formula by formula: what most people would write."""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio_analysis.uncertainty import Floats


def _cosines(omega_i: Floats, omega_r: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    h = omega_i + omega_r
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    return omega_i[..., 2], omega_r[..., 2], h[..., 2], np.sum(h * omega_r, axis=-1)


def _attenuation(nl: Floats, nv: Floats, nh: Floats, vh: Floats) -> Floats:
    least: Floats = np.minimum(1.0, np.minimum(2 * nh * nv / vh, 2 * nh * nl / vh))
    return least


def _fresnel(c: Floats, ior: complex) -> Floats:
    n = np.complex128(ior)
    q = np.sqrt(n * n - 1 + c * c)
    s, p = (c - q) / (c + q), (n * n * c - q) / (n * n * c + q)
    both: Floats = 0.5 * (np.abs(s) ** 2 + np.abs(p) ** 2)
    return both


def cook_torrance(p: dict[str, Any], omega_i: Floats, omega_r: Floats) -> Floats:
    """(F/pi) D G/((N.L)(N.V)) with Beckmann's distribution."""
    nl, nv, nh, vh = _cosines(omega_i, omega_r)
    tan2 = (1 - nh * nh) / (nh * nh)
    d = sum(w * np.exp(-tan2 / m**2) / (m**2 * nh**4) for m, w in p["slopes"])
    out: Floats = _fresnel(vh, complex(p["n"], p["k"])) / np.pi * d * _attenuation(nl, nv, nh, vh) / (nl * nv)
    return out


def blinn(p: dict[str, Any], omega_i: Floats, omega_r: Floats) -> Floats:
    """(k_d + k_s D G F/((N.E)(N.L)))/pi."""
    nl, ne, nh, eh = _cosines(omega_i, omega_r)
    c = p["c"]
    if p["distribution"] == "phong":
        d = nh**c
    elif p["distribution"] == "gaussian":
        d = np.exp(-((np.arccos(nh) * c) ** 2))
    else:
        d = (c**2 / (nh**2 * (c**2 - 1) + 1)) ** 2
    s = d * _attenuation(nl, ne, nh, eh) * _fresnel(eh, complex(p["ior"])) / ne
    out: Floats = (p["k_d"] + p["k_s"] * s / nl) / np.pi
    return out


def phong(p: dict[str, Any], omega_i: Floats, omega_r: Floats) -> Floats:
    """(k_d + k_s (N.H)^c1/(N.L))/pi."""
    nl, _, nh, _ = _cosines(omega_i, omega_r)
    out: Floats = (p["k_d"] + p["k_s"] * nh ** p["exponent"] / nl) / np.pi
    return out


def oren_nayar(p: dict[str, Any], omega_i: Floats, omega_r: Floats) -> Floats:
    """Eqs. 14 to 16 by angles."""
    theta_i, theta_r = np.arccos(omega_i[..., 2]), np.arccos(omega_r[..., 2])
    cosine = np.cos(np.arctan2(omega_r[..., 1], omega_r[..., 0]) - np.arctan2(omega_i[..., 1], omega_i[..., 0]))
    s2 = np.radians(p["sigma_deg"]) ** 2
    a, b = np.maximum(theta_i, theta_r), np.minimum(theta_i, theta_r)
    c1 = 1 - 0.5 * s2 / (s2 + 0.33)
    c2 = 0.45 * s2 / (s2 + 0.09) * np.where(cosine >= 0, np.sin(a), np.sin(a) - (2 * b / np.pi) ** 3)
    c3 = 0.125 * s2 / (s2 + 0.09) * (4 * a * b / np.pi**2) ** 2
    one = c1 + cosine * c2 * np.tan(b) + (1 - np.abs(cosine)) * c3 * np.tan((a + b) / 2)
    two = 0.17 * p["albedo"] * s2 / (s2 + 0.13) * (1 - cosine * (2 * b / np.pi) ** 2)
    out: Floats = p["albedo"] / np.pi * (one + two)
    return out
