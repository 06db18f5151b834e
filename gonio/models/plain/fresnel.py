"""Reflection at a smooth surface, which three of the papers take from textbooks.

He1991 (eqs. 41, 44) and Cook1982 refer to Siegel1980 for F; Schlick1994 is what many published fits have instead.
"""

import numpy as np

from gonio.models.plain.vectors import Numbers


def amplitudes(theta: Numbers, n: Numbers) -> tuple[Numbers, Numbers]:
    """Siegel1980, amplitudes: the amplitudes (F_s, F_p) at an angle of incidence [rad], from the air side.

    `n` is the complex index n + ik, k >= 0, with fields exp(-i omega t). The sign of F_p is that which He1991's p
    vectors ask for: F_p = -F_s at normal incidence. Loses digits where n approaches 1: the numerators cancel.

    Compiled: gonio.models.fresnel.amplitudes
    """
    n = np.asarray(n, dtype=complex)
    cos = np.cos(theta)
    q = np.sqrt(n**2 - np.sin(theta) ** 2)  # the root with Im q >= 0, since Im n^2 >= 0
    F_s = (cos - q) / (cos + q)
    F_p = (n**2 * cos - q) / (n**2 * cos + q)
    return F_s, F_p


def reflectance(theta: Numbers, n: Numbers) -> Numbers:
    """Siegel1980, reflectance: |F|^2 = (|F_s|^2 + |F_p|^2)/2 of unpolarised light (He1991 eq. 75 at the angle theta).

    Compiled: gonio.models._facets.fresnel, gonio.models.fresnel.reflectance
    """
    F_s, F_p = amplitudes(theta, n)
    return (np.abs(F_s) ** 2 + np.abs(F_p) ** 2) / 2


def schlick(theta: Numbers, F_0: Numbers) -> Numbers:
    """Schlick1994, F: F_0 + (1 - F_0)(1 - cos theta)^5, F_0 being the reflectance at normal incidence.

    Compiled: gonio.models.cook_torrance.schlick
    """
    return F_0 + (1 - F_0) * (1 - np.cos(theta)) ** 5
