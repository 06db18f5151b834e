"""How models are fitted to very many pixels (`gonio_maps.models.batch`): constants, levels, derivatives and starts."""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np

from gonio.models import _htsg_kernels, ggx
from gonio.models._compile import device, with_others
from gonio.models._facets import fresnel, index_constants
from gonio.models._htsg_kernels import surface_constants
from gonio.models.blinn import _BRDFS
from gonio.models.cook_torrance import _KERNELS as COOK_TORRANCE
from gonio.models.cook_torrance import beckmann_slope
from gonio.models.engine import Kernel
from gonio.models.ggx import lobe_constants
from gonio.models.oren_nayar import functional, functional_constants

FREE_LEVELS, FREE_BASE, FREE_LOBE = 1, 2, 3
"""What of a model's levels follows by linear least squares: both, that of the base, that of the lobe."""


# --- the models: parameters in the order of `names` -> constants of the kernel, and what is linear in them ------------


@device
def fresnel_reflectance(s2, p):  # type: ignore[no-untyped-def]
    """`fresnel` of |s|^2 = 4 cos^2(theta)."""
    up, down = fresnel(0.25 * s2, p[0], p[1], p[2])
    return up / down


@device
def cook_constants(t):  # type: ignore[no-untyped-def]
    """s, m, diffuse_albedo, ior, k; d = 1 - s."""
    base = ((1.0 - t[0]) * t[2] / pi,)
    return base + index_constants(t[3], t[4]) + beckmann_slope(t[1], t[0] / pi)


@device
def cook_affine(t, at):  # type: ignore[no-untyped-def]
    """d f / d s = f / s - diffuse_albedo / (pi s), d f / d diffuse_albedo = (1 - s) / pi."""
    if at == 0 and t[0] > 1e-3:
        return 1.0 / t[0], -t[2] / (pi * t[0]), True
    return 0.0, (1.0 - t[0]) / pi, at == 2


@device
def cook_bend(t, at):  # type: ignore[no-untyped-def]
    """d ln lobe / d m = 2 tan^2/m^3 - 2/m."""
    return (1.0 - t[0]) * t[2] / pi, (2.0 / (t[1] * t[1] * t[1]), 2.0 / t[1]), at == 1


@device
def beckmann_bend(tan2, s2, sz, g, p):  # type: ignore[no-untyped-def]
    return tan2 * p[0] - p[1]


@device
def cook_fold(tan2, s2, sz, g, p):  # type: ignore[no-untyped-def]
    return 4.0 * fresnel_reflectance(s2, p)


@device
def its_cosine(c2, contrast, real, imag):  # type: ignore[no-untyped-def]
    """Stands for `fresnel` where its reflectance stands for cos^2."""
    return c2, 1.0


@device
def cook_unit(t):  # type: ignore[no-untyped-def]
    t[0], t[2] = 1.0, 0.0
    return FREE_LEVELS


@device
def cook_levels(t, level, base):  # type: ignore[no-untyped-def]
    t[0] = min(level, 0.9)
    t[2] = min(base * pi / (1.0 - t[0]), 1.0)


@device
def ggx_constants(t):  # type: ignore[no-untyped-def]
    """alpha, diffuse_albedo, ior, k."""
    return lobe_constants(t[0], t[0], t[1], t[2], t[3]) + (t[0] * t[0],)  # noqa: RUF005 - numba adds tuples


@device
def ggx_bend(t, at):  # type: ignore[no-untyped-def]
    """d ln lobe / d alpha."""
    return t[1] / pi, (t[0] * t[0], 2.0 * t[0]), at == 0


@device
def smith_bend(sxy2, s2, lz, vz, p):  # type: ignore[no-untyped-def]
    """Of 1/(alpha^2 root^2 smith) in `ggx.lobe`, whose `root` is |s_xy|^2/alpha^2 + s_z^2."""
    a2, twice = p
    sz, lt2, vt2 = lz + vz, (1.0 - lz) * (1.0 + lz), (1.0 - vz) * (1.0 + vz)
    l_root, v_root = sqrt(lz * lz + a2 * lt2), sqrt(vz * vz + a2 * vt2)
    smith = vz * l_root + lz * v_root
    turn, below = 0.5 * (vz * lt2 * v_root + lz * vt2 * l_root), l_root * v_root * smith
    whole = sxy2 + sz * sz * a2
    return twice * ((sxy2 / a2 - sz * sz) * below - turn * whole) / (whole * below)


@device
def lobe_fold(variable, s2, third, fourth, p):  # type: ignore[no-untyped-def]
    """Of a lobe that has |s|^4 F."""
    return s2 * sqrt(fresnel_reflectance(s2, p))


@device
def whole(c2, contrast, real, imag):  # type: ignore[no-untyped-def]
    """Stands for `fresnel` where |s|^2 has it."""
    return 1.0, 1.0


@device
def base_affine(t, at):  # type: ignore[no-untyped-def]
    """d f / d (parameter 1) = 1 / pi."""
    return 0.0, 1.0 / pi, at == 1


@device
def base_unit(t):  # type: ignore[no-untyped-def]
    t[1] = 0.0
    return FREE_BASE


@device
def base_levels(t, level, base):  # type: ignore[no-untyped-def]
    t[1] = min(base * pi, 1.0)


@device
def blinn_constants(t):  # type: ignore[no-untyped-def]
    """k_s, k_d, c, ior, k."""
    return (t[1] / pi, t[0] / pi, t[2]) + index_constants(t[3], t[4])  # noqa: RUF005 - numba adds tuples


@device
def blinn_affine(t, at):  # type: ignore[no-untyped-def]
    """d f / d k_s = (f - k_d / pi) / k_s, d f / d k_d = 1 / pi."""
    if at == 0 and t[0] > 1e-6:
        return 1.0 / t[0], -t[1] / (pi * t[0]), True
    return 0.0, 1.0 / pi, at == 1


@device
def blinn_unit(t):  # type: ignore[no-untyped-def]
    t[0], t[1] = 1.0, 0.0
    return FREE_LEVELS


@device
def blinn_levels(t, level, base):  # type: ignore[no-untyped-def]
    t[0], t[1] = level, min(base * pi, 1.0)


@device
def grooves_constants(t):  # type: ignore[no-untyped-def]
    """albedo, sigma_deg."""
    return functional_constants(t[0], t[1] * (pi / 180.0), 1.0)


@device
def nothing_affine(t, at):  # type: ignore[no-untyped-def]
    return 0.0, 0.0, False


@device
def grooves_unit(t):  # type: ignore[no-untyped-def]
    """Light that goes twice as for an albedo of 0.5."""
    t[0] = 0.5
    return FREE_LOBE


@device
def grooves_levels(t, level, base):  # type: ignore[no-untyped-def]
    t[0] = min(0.5 * level, 1.0)


@device
def waves_constants(t):  # type: ignore[no-untyped-def]
    """sigma0_um, diffuse_albedo, tau_um, ior, k, then k0 [rad/um] and the tier of the series."""
    surface, index = surface_constants(t[5], t[0], t[2]), index_constants(t[3], t[4])
    return (t[1] / pi,) + surface + (0.0,) + index + (t[6], 0.0)  # noqa: RUF005 - numba adds tuples


@dataclass(frozen=True)
class Batched:
    """How one model is fitted to very many pixels."""

    names: tuple[str, ...]
    """Parameters, in the order in which the compiled functions have them."""
    kernel: Kernel
    size: int
    """Constants of the kernel."""
    constants: Callable[..., Any]
    affine: Callable[..., Any]
    """Parameters and which of them -> d f = factor f + flat, and whether that is so."""
    unit: Callable[..., Any]
    """Sets levels to 1 and 0, and tells what follows by linear least squares."""
    levels: Callable[..., Any]
    """Sets parameters from a level and a base [1/sr]."""
    grid: tuple[tuple[str, tuple[float, ...]], ...]
    """Starts: every combination; the last one is the width whose valleys are told apart."""
    every: int = 1
    """Step through the values that starts are found from: 4 takes every fourth."""
    own: Callable[[float], tuple[float, ...]] = lambda wavelength_nm: ()
    """Numbers behind the parameters, for a wavelength [nm]."""
    scaled: tuple[str, ...] = ()
    """The two parameters that change little where both are scaled (`_batch_scaled`). `own` begins with the factor that
    turns the first one into a number of `SCALES`."""
    bend: tuple[Callable[..., Any], Kernel, int] | None = None
    """Parameters and which of them -> base, constants, and whether the derivative is known; a kernel with that
    number of constants gives d ln(f - base). Others are taken by differences, which take a pixel 1.3 times as long."""
    fold: tuple[Callable[..., Any], Callable[..., Any]] | None = None
    """For a known index: what takes the place of the second column, of columns and Fresnel's constants, and what takes
    that of `fresnel` in the kernel then."""


def with_fresnel(kernel: Kernel, other: Callable[..., Any]) -> Kernel:
    """The same with another function in the place of `fresnel`; He-Torrance's has it inside."""
    return (
        with_others(kernel, f"{kernel.__name__}_{other.__name__}", {fresnel: other})
        if "columns" in vars(kernel)
        else kernel
    )


def _spread(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(np.geomspace(low, high, count).tolist())


ROUGH_TIER = 2.0
"""Tier of He-Torrance's series for starts: 1e-6."""
SIGMAS = (0.025, 0.05, 0.1, 0.2, 0.4, 0.9)
"""sigma0 [um]. Between those of rough surfaces `_batch_scaled` looks."""
SLOPES = (0.03, 0.047, 0.075, 0.12, 0.2, 0.33, 0.5, 0.65, 0.8, 1.0, 1.3)
"""2 sigma0 / tau."""
SCALES = (1.3, 1.75, 2.25, 2.75, 3.3, 4.0, 4.8, 5.7, 6.8, 8.5, 12.0, 30.0)
"""2 pi sigma0 / wavelength, where other valleys are looked for: below, chi-square has one valley."""
INDICES = ("ior", (1.5, 3.0, 20.0))
MODELS = {
    "cook-torrance": Batched(
        ("s", "m", "diffuse_albedo", "ior", "k"), COOK_TORRANCE["beckmann", "exact"], 6, cook_constants, cook_affine,
        cook_unit, cook_levels, (INDICES, ("m", _spread(0.02, 1.0, 12))),
        bend=(cook_bend, beckmann_bend, 2), fold=(cook_fold, its_cosine),
    ),
    "ggx": Batched(
        ("alpha", "diffuse_albedo", "ior", "k"), ggx.isotropic, 6, ggx_constants, base_affine, base_unit, base_levels,
        (("ior", (1.3, 1.6, 3.0, 20.0)), ("alpha", _spread(0.01, 0.9, 12))),
        bend=(ggx_bend, smith_bend, 2), fold=(lobe_fold, whole),
    ),
    "blinn": Batched(
        ("k_s", "k_d", "c", "ior", "k"), _BRDFS["trowbridge-reitz"], 6, blinn_constants, blinn_affine, blinn_unit,
        blinn_levels, (INDICES, ("c", _spread(0.02, 0.9, 12))),
        fold=(lobe_fold, whole),
    ),
    "oren-nayar": Batched(
        ("albedo", "sigma_deg"), functional, 4, grooves_constants, nothing_affine, grooves_unit, grooves_levels,
        (("sigma_deg", (2.0, 10.0, 20.0, 30.0, 45.0)),),
    ),
    "he-torrance": Batched(
        ("sigma0_um", "diffuse_albedo", "tau_um", "ior", "k"), _htsg_kernels.lobe_state, 11, waves_constants,
        base_affine, base_unit, base_levels, (INDICES, ("sigma0_um", SIGMAS), ("slope", SLOPES)),
        every=4, scaled=("sigma0_um", "tau_um"), own=lambda wavelength_nm: (2.0 * pi / (1e-3 * wavelength_nm), 1.0),
    ),
}  # fmt: skip
"""By the names of the command line."""
