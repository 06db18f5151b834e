"""The closed models as their specification in plain numpy has them (`gonio.models.plain`), by vectors."""

import numpy as np

from gonio import geometry
from gonio.models.plain import blinn as blinn_1977
from gonio.models.plain import cook_torrance as cook_torrance_1982
from gonio.models.plain import fresnel
from gonio.models.plain import oren_nayar as oren_nayar_1994
from gonio.models.plain.vectors import polar
from gonio.typing import Floats
from gonio_validation.bench.quantity import Parameters

_DISTRIBUTIONS = {"phong": blinn_1977.D_1, "gaussian": blinn_1977.D_2, "trowbridge-reitz": blinn_1977.D_3}


def cook_torrance(p: Parameters, omega_i: Floats, omega_r: Floats) -> Floats:
    """(F/pi) D G/((N.L)(N.V)) with Beckmann's distribution."""
    out: Floats = cook_torrance_1982.brdf(omega_i, omega_r, p["slopes"], complex(p["n"], p["k"]))
    return out


def blinn(p: Parameters, omega_i: Floats, omega_r: Floats) -> Floats:
    """(k_d + k_s D G F/((N.E)(N.L)))/pi."""
    half = blinn_1977.H(omega_i, omega_r)
    theta = geometry.angle_between(half, omega_r)
    d = _DISTRIBUTIONS[p["distribution"]](polar(half), p["c"])
    f = fresnel.reflectance(theta, complex(p["ior"]))
    s = blinn_1977.s(d, blinn_1977.G(omega_i, omega_r), f, omega_r)
    out: Floats = blinn_1977.brdf(s, omega_i, p["k_d"], p["k_s"])
    return out


def phong(p: Parameters, omega_i: Floats, omega_r: Floats) -> Floats:
    """(k_d + k_s (N.H)^c1/(N.L))/pi."""
    out: Floats = blinn_1977.brdf(blinn_1977.s_phong(omega_i, omega_r, p["exponent"]), omega_i, p["k_d"], p["k_s"])
    return out


def oren_nayar(p: Parameters, omega_i: Floats, omega_r: Floats) -> Floats:
    """Oren1994 eqs. 14 to 16 by angles."""
    dphi = np.arctan2(omega_r[..., 1], omega_r[..., 0]) - np.arctan2(omega_i[..., 1], omega_i[..., 0])
    at = (polar(omega_i), polar(omega_r), dphi, np.radians(p["sigma_deg"]), p["albedo"])
    out: Floats = oren_nayar_1994.f_r(oren_nayar_1994.L(oren_nayar_1994.L1(*at), oren_nayar_1994.L2(*at)), at[0])
    return out
