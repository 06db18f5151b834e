"""Very many small fits at once: one model, the same few parameters, values of each fit in directions of its own.

A fit is a pixel of a map or a table of a list. All of it happens in compiled code, over the same kernels that evaluate
the models: directions become the kernel's columns, a coarse grid gives starts whose levels follow by linear least
squares, and damped Gauss-Newton steps (Levenberg and Marquardt) end where a step is below a ten-thousandth of the
standard errors. Common causes act through Woodbury's formula. Where the data reject the model it gets a misfit of its
own, as in docs/misfit.md. docs/maps.md has the formulas and what differs from a fit of one table.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import pi
from typing import Any

import numpy as np
import numpy.typing as npt

from gonio.errors import ConfigError
from gonio.models import _htsg_kernels, _loops, engine, ggx
from gonio.models._compile import device, jit, loop, with_others
from gonio.models._facets import fresnel, fresnel_real
from gonio.models._math import _LOG2_E
from gonio.models.blinn import _BRDFS
from gonio.models.cook_torrance import _KERNELS as COOK_TORRANCE
from gonio.models.engine import Kernel
from gonio.models.oren_nayar import functional
from gonio.typing import Floats

SIGNIFICANCE = 0.01
"""Probability of chi-square below which a model counts as rejected (as in `gonio fit`)."""
FREE_LEVELS, FREE_BASE, NO_LEVELS = 1, 2, 0
"""What of a model's levels follows by linear least squares: both, the base alone, none."""
WORTH = 64
"""Pixels that are worth a thread of their own."""


# --- the models: parameters in the order of `names` -> constants of the kernel, and what is linear in them ------------


@device
def fresnel_terms(n, k):  # type: ignore[no-untyped-def]
    """`_facets.fresnel_constants`."""
    contrast = ((n - 1.0) * (n - 1.0) + k * k) * ((n + 1.0) * (n + 1.0) + k * k)
    return contrast, (n - 1.0) * (n + 1.0) - k * k, n * k


@device
def cook_constants(t):  # type: ignore[no-untyped-def]
    """s, m, diffuse_albedo, ior, k; d = 1 - s."""
    contrast, real, imag = fresnel_terms(t[3], t[4])
    return (1.0 - t[0]) * t[2] / pi, contrast, real, imag, -_LOG2_E / (t[1] * t[1]), t[0] / (pi * t[1] * t[1])


@device
def cook_affine(t, at):  # type: ignore[no-untyped-def]
    """d f / d s = f / s - diffuse_albedo / (pi s), d f / d diffuse_albedo = (1 - s) / pi."""
    if at == 0 and t[0] > 1e-3:
        return 1.0 / t[0], -t[2] / (pi * t[0]), True
    return 0.0, (1.0 - t[0]) / pi, at == 2


@device
def cook_unit(t):  # type: ignore[no-untyped-def]
    t[0], t[2] = 1.0, 0.0
    return FREE_LEVELS


@device
def cook_levels(t, level, base):  # type: ignore[no-untyped-def]
    t[0] = min(level, 1.0 - 1e-6)
    t[2] = min(base * pi / (1.0 - t[0]), 1.0)


@device
def ggx_constants(t):  # type: ignore[no-untyped-def]
    """alpha, diffuse_albedo, ior, k."""
    contrast, real, imag = fresnel_terms(t[2], t[3])
    a2 = t[0] * t[0]
    return t[1] / pi, 0.5 / (pi * a2), contrast, real, imag, a2


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
    contrast, real, imag = fresnel_terms(t[3], t[4])
    return t[1] / pi, t[0] / pi, t[2], contrast, real, imag


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
    sigma = t[1] * (pi / 180.0)
    s2, once = sigma * sigma, t[0] / pi
    narrow = s2 / (s2 + 0.09)
    return (
        once * (1.0 - 0.5 * s2 / (s2 + 0.33)),
        once * 0.45 * narrow,
        once * 0.125 * narrow,
        0.17 * t[0] * once * s2 / (s2 + 0.13),
    )


@device
def nothing_affine(t, at):  # type: ignore[no-untyped-def]
    return 0.0, 0.0, False


@device
def grooves_unit(t):  # type: ignore[no-untyped-def]
    return NO_LEVELS


@device
def grooves_levels(t, level, base):  # type: ignore[no-untyped-def]
    return


@device
def waves_constants(t):  # type: ignore[no-untyped-def]
    """sigma0_um, diffuse_albedo, tau_um, ior, k, then k0 [rad/um] and the tier of the series."""
    phase, width = (t[5] * t[0]) * (t[5] * t[0]), (t[5] * t[2]) * (t[5] * t[2])
    contrast, real, imag = fresnel_terms(t[3], t[4])
    return (
        t[1] / pi,
        phase * width / (16.0 * pi),
        phase,
        0.25 * width,
        t[2] / (2.0 * t[0]),
        0.0,
        contrast,
        real,
        imag,
        t[6],
        0.0,
    )


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
    own: Callable[[float], tuple[float, ...]] = lambda wavelength_nm: ()
    """Numbers behind the parameters, for a wavelength [nm]."""


def without_absorption(kernel: Kernel) -> Kernel:
    """The same for k = 0, with a root less; He-Torrance's has it inside."""
    return (
        with_others(kernel, f"{kernel.__name__}_k0", {fresnel: fresnel_real}) if "columns" in vars(kernel) else kernel
    )


def _spread(low: float, high: float, count: int) -> tuple[float, ...]:
    return tuple(np.geomspace(low, high, count).tolist())


ROUGH_TIER = 2.0
"""Of He-Torrance's series, for starts: 1e-6."""
SLOPES = (0.02, 0.05, 0.1, 0.17, 0.25, 0.35, 0.5, 0.8, 1.3)
"""2 sigma0 / tau."""
INDICES = ("ior", (1.5, 3.0, 20.0))
MODELS = {
    "cook-torrance": Batched(
        ("s", "m", "diffuse_albedo", "ior", "k"), COOK_TORRANCE["beckmann", "exact"], 6, cook_constants, cook_affine,
        cook_unit, cook_levels, (INDICES, ("m", _spread(0.02, 1.0, 12))),
    ),
    "ggx": Batched(
        ("alpha", "diffuse_albedo", "ior", "k"), ggx.isotropic, 6, ggx_constants, base_affine, base_unit, base_levels,
        (("ior", (1.3, 1.6, 3.0, 20.0)), ("alpha", _spread(0.01, 0.9, 12))),
    ),
    "blinn": Batched(
        ("k_s", "k_d", "c", "ior", "k"), _BRDFS["trowbridge-reitz"], 6, blinn_constants, blinn_affine, blinn_unit,
        blinn_levels, (INDICES, ("c", _spread(0.02, 0.9, 12))),
    ),
    "oren-nayar": Batched(
        ("albedo", "sigma_deg"), functional, 4, grooves_constants, nothing_affine, grooves_unit, grooves_levels,
        (("albedo", (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 0.95)), ("sigma_deg", (2.0, 10.0, 20.0, 30.0, 45.0))),
    ),
    "he-torrance": Batched(
        ("sigma0_um", "diffuse_albedo", "tau_um", "ior", "k"), _htsg_kernels.lobe_state, 11, waves_constants,
        base_affine, base_unit, base_levels, (INDICES, ("sigma0_um", (0.04, 0.15, 0.4, 1.5)), ("slope", SLOPES)),
        lambda wavelength_nm: (2.0 * pi / (1e-3 * wavelength_nm), 1.0),
    ),
}  # fmt: skip
"""By the names of the command line."""


@dataclass(frozen=True)
class Fits:
    """Fits of P pixels with k free parameters."""

    names: tuple[str, ...]
    free: tuple[str, ...]
    values: Floats
    """Shape (P, parameters), in the order of `names`; NaN where there are not more values than free parameters."""
    covariance: Floats
    """Of the free parameters, shape (P, k, k), in their order; a row of zeros where one ended at a bound."""
    chi_square: Floats
    """With the stated uncertainties (P,)."""
    tau: Floats
    """Relative misfit of a model that is rejected (P,); 0 elsewhere."""
    used: npt.NDArray[np.int64]
    """Values of each fit."""

    @property
    def u(self) -> Floats:
        """Standard uncertainties of the free parameters, shape (P, k)."""
        return np.asarray(np.sqrt(np.einsum("paa->pa", self.covariance)))


def require(name: str) -> Batched:
    """How a model is fitted; raises `ConfigError` where it cannot be fitted to maps."""
    if name not in MODELS:
        raise ConfigError(f'"{name}": maps are fitted with one of {", ".join(MODELS)}')
    return MODELS[name]


def fit(
    name: str,
    x_mm: Floats,
    y_mm: Floats,
    source_mm: Floats,
    camera_mm: Floats,
    values: Floats,
    u: Floats,
    *,
    common: Floats | None = None,
    fixed: dict[str, float] | None = None,
    blocks: npt.NDArray[np.int64] | None = None,
    wavelength_nm: float = 550.0,
) -> Fits:
    """Fit a model to every pixel.

    Parameters
    ----------
    name
        A key of `MODELS`.
    x_mm, y_mm : (P,) array
        Places of the pixels on the sample [mm]; neighbours with the same place share their directions.
    source_mm, camera_mm : (n, 3) array
        Source and camera for each value, in the sample's frame [mm].
    values, u : (P, n) array
        BRDF [1/sr] and standard uncertainties of the values' own; what has no u above 0 is left out.
    common : (r, n) array
        Relative changes of the values for one standard deviation of causes that they share.
    fixed
        Parameters that are not fitted, with their values; k is 0 unless it is given.
    blocks : (ways, n) array
        Ways to cut the values into blocks, by number, for the errors of a model that is rejected
        (`gonio_analysis.fitting.misfit.groupings`); by default every value is one.

    Raises
    ------
    ConfigError
        The model or a parameter is unknown.
    """
    from gonio import plugins

    model, known = require(name), {"k": 0.0, **(fixed or {})}
    declared = plugins.load("gonio.models", name).declaration().parameters
    for one in fixed or {}:
        if one not in model.names:
            raise ConfigError(f'{name} has no parameter "{one}"; it has: {", ".join(model.names)}')
    free = tuple(one for one in model.names if one not in known)
    own = model.own(wavelength_nm)
    lower = np.array([declared[one].lower for one in model.names] + list(own))
    upper = np.array([declared[one].upper for one in model.names] + list(own))
    grid, widths = _grid(model, known, own)
    pixels, n = values.shape
    r = np.ascontiguousarray(np.zeros((0, n)) if common is None else common, float)
    cuts = np.arange(n, dtype=np.int64)[None] if blocks is None else np.ascontiguousarray(blocks, np.int64)
    out = Fits(
        model.names, free, np.empty((pixels, lower.size)), np.empty((pixels, len(free), len(free))), np.empty(pixels),
        np.empty(pixels), np.empty(pixels, np.int64),
    )  # fmt: skip
    given = [np.ascontiguousarray(a, float) for a in (x_mm, y_mm, source_mm, camera_mm, values, u)]
    from gonio.models import _batch_loops

    parts, run = _compiled(name, "k" in free or known["k"] > 0.0), _batch_loops.engine()
    which = np.array([model.names.index(one) for one in free])
    engine.in_parts(
        lambda start, stop: run(
            *parts, *given, r, which, lower, upper, grid, widths, cuts, _critical(n, len(free)),
            out.values, out.covariance, out.chi_square, out.tau, out.used, start, stop,
        ),
        pixels,
        WORTH,
    )  # fmt: skip
    return Fits(out.names, free, out.values[:, : len(model.names)], out.covariance, out.chi_square, out.tau, out.used)


def _grid(model: Batched, known: dict[str, float], own: Sequence[float]) -> tuple[Floats, int]:
    """Rows of parameters to start from, the width fastest, and how many widths there are."""
    axes = [(one, (known[one],) if one in known else values) for one, values in model.grid]
    rows = []
    for chosen in product(*(values for _, values in axes)):
        start = {one: 1.0 for one in model.names} | known | dict(zip((one for one, _ in axes), chosen, strict=True))
        if "slope" in start:
            start["tau_um"] = known.get("tau_um", 2.0 * start["sigma0_um"] / start["slope"])
        rows.append([start[one] for one in model.names] + list(own[:-1]) + [ROUGH_TIER] * bool(own))
    return np.array(rows), len(axes[-1][1])


@functools.lru_cache(maxsize=16)
def _critical(n: int, free: int) -> Floats:
    """Chi-square beyond which a model is rejected, by the number of values."""
    from scipy.stats import chi2

    freedom = np.arange(n + 1) - free
    return np.where(freedom > 0, chi2.isf(SIGNIFICANCE, np.maximum(freedom, 1)), np.inf)


@functools.cache
def _compiled(name: str, absorbs: bool) -> tuple[Any, ...]:
    """The five functions of a model that `_batch_loops.fit_pixels` calls, and how many columns its kernel has."""
    from gonio.compiled import njit
    from gonio.models import _batch_loops as loops

    model, size = MODELS[name], MODELS[name].size
    kernel = model.kernel if absorbs else without_absorption(model.kernel)
    constants, affine_of, unit_of, levels_of = map(jit, (model.constants, model.affine, model.unit, model.levels))
    columns = int(kernel.__dict__.get("count", 6))
    if "columns" in kernel.__dict__:
        over, at = loop(_loops.over_columns, kernel.__dict__["columns"], 0), loop(_loops.AT[columns], kernel, size)

        def take(omega_i, omega_r, out):  # type: ignore[no-untyped-def]
            return over(omega_i, omega_r, columns, out)

        def shade(found, theta, out):  # type: ignore[no-untyped-def]
            return at(found, constants(theta), out, 0, out.size)
    else:
        whole = loop(_loops.over_vectors, kernel, size)

        def take(omega_i, omega_r, out):  # type: ignore[no-untyped-def]
            pairs = omega_i.size // 3
            out.reshape((6, pairs))[:3] = omega_i.reshape((pairs, 3)).T
            out.reshape((6, pairs))[3:] = omega_r.reshape((pairs, 3)).T
            return 0

        def shade(found, theta, out):  # type: ignore[no-untyped-def]
            vectors = found.reshape((6, out.size))
            omega_i, omega_r = vectors[:3].T.copy().reshape(-1), vectors[3:].T.copy().reshape(-1)
            return whole(omega_i, 1, omega_r, 1, constants(theta), out, 0, out.size)

    def affine(theta, at, out):  # type: ignore[no-untyped-def]
        out[0], out[1], known = affine_of(theta, at)
        return 1 if known else 0

    def unit(theta):  # type: ignore[no-untyped-def]
        return unit_of(theta)

    def levels(theta, level, base):  # type: ignore[no-untyped-def]
        levels_of(theta, level, base)
        return 0

    made, suffix = [], f"{name.replace('-', '_')}_{'nk' if absorbs else 'n'}"
    for function, signature in (
        (take, loops.TAKE), (shade, loops.SHADE), (affine, loops.AFFINE), (unit, loops.UNIT), (levels, loops.LEVELS)
    ):  # fmt: skip
        function.__name__ = function.__qualname__ = f"{function.__name__}_{suffix}"
        made.append(njit(*signature.args, nogil=True, error_model="numpy")(function))
    return (*made, columns)
