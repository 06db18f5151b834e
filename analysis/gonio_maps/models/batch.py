"""Very many small fits at once: one model, the same few parameters, values of each fit in directions of its own.

A fit is a pixel of a map or a table of a list. All of it happens in compiled code, over the same kernels that evaluate
the models: directions become the kernel's columns, a coarse grid gives starts whose levels follow by linear least
squares, and damped Gauss-Newton steps (Levenberg and Marquardt) end where a step is below a ten-thousandth of the
standard errors. Common causes act through Woodbury's formula. Where the data reject the model it gets a misfit of its
own, as in docs/misfit.md. docs/maps.md has the formulas and what differs from a fit of one table.

Starts are a grid of twelve widths and a few indices (Oren-Nayar: five sigmas; He-Torrance: eleven slopes and six
sigma0). Of f = level g(width, n) + base level and base follow by linear least squares. The lowest valley of chi-square
over the width is the start. One of four values tells it with He-Torrance, and all of them where the grid alone comes
near an acceptable fit. Others are tried where their own chi-square on the grid is below 1000, or below ten times the
lowest so far and 20 more; of one valley also where it is at most 50 above an acceptable one. Where chi-square so far
rejects the model (1 %) the 1000 grows as that exceeds an acceptable one. A fit that comes to a minimum that is known
stops.

Rough surfaces reflect by their slope alone, so He-Torrance has valleys beside each other along sigma0 at one slope:
there the model is taken at up to twelve sigma0, and valleys between them are fitted (`_batch_scaled`). A parameter
that ended on a bound is sought again from the grid's values inside: few directions on a narrow lobe let an index run
away. A model that is still rejected is fitted to logarithms, and from there once more to the values.

Derivatives are differences of the model's own kernel, but that by the width of Cook-Torrance and GGX, where a formula
saves a quarter of the time; the model is linear in its levels, so theirs follow from its value. A last step, shorter
than those ten-thousandths, is taken without a look, so that the end does not depend on the way there.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from gonio_analysis.fitting.problem import acceptable

from gonio.errors import ConfigError
from gonio.models import _loops
from gonio.models._compile import fingerprint, jit, loop
from gonio.models._facets import fresnel_real, index_constants
from gonio.models.engine import Kernel, in_parts
from gonio.typing import Floats
from gonio_maps.models._batch_models import MODELS, ROUGH_TIER, SCALES, Batched, with_fresnel

WORTH = 64
"""Pixels that are worth a thread of their own."""


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
    """Chi-square with the stated uncertainties (P,)."""
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
    threads: int | None = None,
) -> Fits:
    """Fit a model to every pixel.

    Parameters
    ----------
    name
        A key of `_batch_models.MODELS`.
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
    threads
        How many share the work; None: one a processor, or one within `engine.alone`. Results are equal to the bit.

    Raises
    ------
    ConfigError
        The model or a parameter is unknown.
    """
    posed = pose(name, x_mm, y_mm, source_mm, camera_mm, values, u, common, fixed, blocks, wavelength_nm)
    grid, widths, *of_starts = _starts(posed)
    pixels, n = values.shape
    out = Fits(
        posed.model.names, posed.free, np.empty((pixels, posed.lower.size)),
        np.empty((pixels, len(posed.free), len(posed.free))), np.empty(pixels), np.empty(pixels),
        np.empty(pixels, np.int64),
    )  # fmt: skip
    run = _engine()
    in_parts(
        lambda start, stop: run(
            *posed.compiled, *posed.given, posed.common, posed.which, posed.lower, posed.upper, grid, widths,
            posed.blocks, _critical(n, len(posed.free)), posed.model.every, *of_starts, out.values, out.covariance,
            out.chi_square, out.tau, out.used, start, stop,
        ),
        pixels, WORTH, threads,
    )  # fmt: skip
    return replace(out, values=out.values[:, : len(out.names)])


def _engine() -> Callable[..., Any]:
    """`_batch_loops.engine`: numba is imported with it."""
    from gonio_maps.models import _batch_loops

    return _batch_loops.engine()  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Posed:
    """What the compiled engines take of a fit."""

    model: Batched
    known: dict[str, float]
    own: tuple[float, ...]
    """Numbers behind the parameters, which are known."""
    free: tuple[str, ...]
    which: npt.NDArray[np.int64]
    """Where `free` stand among all numbers."""
    lower: Floats
    """Bounds of all numbers; both are the value of what is known."""
    upper: Floats
    compiled: tuple[Any, ...]
    """`_compiled`."""
    given: tuple[Floats, ...]
    """Places, source, camera, values, uncertainties."""
    common: Floats
    blocks: npt.NDArray[np.int64]


def pose(
    name: str, x_mm: Floats, y_mm: Floats, source_mm: Floats, camera_mm: Floats, values: Floats, u: Floats,
    common: Floats | None, fixed: dict[str, float] | None, blocks: npt.NDArray[np.int64] | None, wavelength_nm: float,
) -> Posed:  # fmt: skip
    """The arguments of `fit` for compiled code; raises `ConfigError` where the model or a parameter is unknown."""
    model, known, n = require(name), {"k": 0.0, **(fixed or {})}, values.shape[1]
    own = model.own(wavelength_nm)
    lower, upper = _bounds(name, model, known, fixed or {}, own)
    free = tuple(one for one in model.names if one not in known)
    absorbs, folded = "k" in free or known["k"] > 0.0, "ior" in known and "k" in known
    return Posed(
        model, known, own, free, np.array([model.names.index(one) for one in free]), lower, upper,
        _compiled(name, absorbs and not folded, folded),
        tuple(np.require(a, float, ["C", "W"]) for a in (x_mm, y_mm, source_mm.T, camera_mm.T, values, u)),
        np.ascontiguousarray(np.zeros((0, n)) if common is None else common, float),
        np.arange(n, dtype=np.int64)[None] if blocks is None else np.ascontiguousarray(blocks, np.int64),
    )  # fmt: skip


def _bounds(
    name: str, model: Batched, known: dict[str, float], fixed: dict[str, float], own: Sequence[float]
) -> tuple[Floats, Floats]:
    """Lower and upper bounds of all numbers; both are the value of what is known."""
    from gonio import plugins

    for one in fixed:
        if one not in model.names:
            raise ConfigError(f'{name} has no parameter "{one}"; it has: {", ".join(model.names)}')
    declared = plugins.load("gonio.models", name).declaration().parameters
    ends = [(known.get(one, declared[one].lower), known.get(one, declared[one].upper)) for one in model.names]
    lower, upper = (np.array([*end, *own]) for end in zip(*ends, strict=True))
    return lower, upper


Starts = tuple[Floats, int, int, Floats, npt.NDArray[np.int64]]


def _starts(posed: Posed) -> Starts:
    """Rows of parameters to start from, the width fastest; how many widths there are; which parameter the width is, or
    -1 where it is known or none; and the scales and the pair of parameters for `_batch_scaled`."""
    return _grid(posed.model, tuple(posed.known.items()), posed.own, posed.free)


@functools.lru_cache(maxsize=16)
def _grid(
    model: Batched, given: tuple[tuple[str, float], ...], own: tuple[float, ...], free: tuple[str, ...]
) -> Starts:
    """`_starts`, of what is known."""
    known = dict(given)
    axes = [(one, (known[one],) if one in known else values) for one, values in model.grid]
    rows = []
    for chosen in product(*(values for _, values in axes)):
        start = {one: 1.0 for one in model.names} | known | dict(zip((one for one, _ in axes), chosen, strict=True))
        if "slope" in start:
            start["tau_um"] = known.get("tau_um", 2.0 * start["sigma0_um"] / start["slope"])
        rows.append([start[one] for one in model.names] + list(own[:-1]) + [ROUGH_TIER] * bool(own))
    name, widths = axes[-1]
    pair = np.array([model.names.index(one) for one in model.scaled], np.int64)
    scales = np.array(SCALES) / own[0] if pair.size and set(model.scaled) <= set(free) else np.empty(0)
    return np.array(rows), len(widths), model.names.index(name) if name in free else -1, scales, pair


@functools.lru_cache(maxsize=16)
def _critical(n: int, free: int) -> Floats:
    """`acceptable`, by the number of values."""
    return np.asarray(acceptable(np.arange(n + 1) - free))


def _over_columns(model: Batched, kernel: Kernel, folded: bool) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """What makes a kernel's columns, and what evaluates it at them."""
    constants = jit(model.constants)
    if "columns" not in kernel.__dict__:
        whole, size = loop(kernel.__dict__["over_sets"], kernel, model.size), model.size

        def take_directions(omega_i, omega_r, theta, out):  # type: ignore[no-untyped-def]
            out[: omega_i.size] = omega_i
            out[omega_i.size :] = omega_r
            return 0

        def shade_directions(found, thetas, sets, out):  # type: ignore[no-untyped-def]
            half, m, made = found.size // 2, thetas.size // sets, np.empty((sets, size))
            for row in range(sets):
                one = constants(thetas[row * m : row * m + m])
                for c in range(size):
                    made[row, c] = one[c]
            return whole(found[:half], found[half:], made, out)

        return take_directions, shade_directions
    count = int(kernel.__dict__["count"])
    over, at = loop(_loops.COLUMNS[count], kernel.__dict__["columns"], 0), loop(_loops.AT[count], kernel, model.size)

    def take(omega_i, omega_r, theta, out):  # type: ignore[no-untyped-def]
        return over(omega_i, omega_r, out)

    def shade(found, thetas, sets, out):  # type: ignore[no-untyped-def]
        n, m = out.size // sets, thetas.size // sets
        for row in range(sets):
            at(found, constants(thetas[row * m : row * m + m]), out[row * n : row * n + n], 0, n)
        return 0

    if not folded or model.fold is None:
        return take, shade
    fold, index, terms = loop(_loops.AT[count], model.fold[0], 3), model.names.index("ior"), jit(index_constants)

    def take_folded(omega_i, omega_r, theta, out):  # type: ignore[no-untyped-def]
        over(omega_i, omega_r, out)
        second = np.empty(out.size // count)
        fold(out, terms(theta[index], theta[index + 1]), second, 0, second.size)
        out[second.size : 2 * second.size] = second
        return 0

    return take_folded, shade


def _derivative(model: Batched, count: int) -> Callable[..., Any]:
    """The derivative by one parameter where a formula gives it, from the model's values; 0 where none does."""
    affine_of = jit(model.affine)

    def affine(found, theta, which, f, out):  # type: ignore[no-untyped-def]
        factor, flat, known = affine_of(theta, which)
        if known:
            for j in range(out.size):
                out[j] = factor * f[j] + flat
            return 1
        return 0

    if model.bend is None:
        return affine
    bend_of, at = jit(model.bend[0]), loop(_loops.AT[count], *model.bend[1:])

    def derive(found, theta, which, f, out):  # type: ignore[no-untyped-def]
        factor, flat, known = affine_of(theta, which)
        if known:
            for j in range(out.size):
                out[j] = factor * f[j] + flat
            return 1
        base, constants, known = bend_of(theta, which)
        if not known:
            return 0
        at(found, constants, out, 0, out.size)
        for j in range(out.size):
            out[j] *= f[j] - base
        return 1

    return derive


@functools.cache
def _compiled(name: str, absorbs: bool, folded: bool) -> tuple[Any, ...]:
    """The five functions of a model that `_batch_loops.fit_pixels` calls, and how many columns its kernel has."""
    from gonio.compiled import counting, njit
    from gonio_maps.models import _batch_steps as types

    model = MODELS[name]
    kernel = model.kernel if absorbs else with_fresnel(model.kernel, fresnel_real)
    if folded and model.fold is not None:
        kernel = with_fresnel(model.kernel, model.fold[1])
    count = int(kernel.__dict__.get("count", 6))
    unit_of, levels_of = jit(model.unit), jit(model.levels)
    take, shade = _over_columns(model, kernel, folded)

    def unit(theta):  # type: ignore[no-untyped-def]
        return unit_of(theta)

    def levels(theta, level, base):  # type: ignore[no-untyped-def]
        levels_of(theta, level, base)
        return 0

    made, suffix = [], f"{name.replace('-', '_')}_{'nk' if absorbs else 'n'}{folded:d}"
    for function, signature in (
        (take, types.TAKE), (shade, types.SHADE), (_derivative(model, count), types.DERIVE), (unit, types.UNIT),
        (levels, types.LEVELS),
    ):  # fmt: skip
        function.__name__ = function.__qualname__ = f"{function.__name__}_{suffix}_{fingerprint(function)}"
        lean = function is not take and "columns" in kernel.__dict__  # what makes no arrays
        made.append(njit(*signature.args, nogil=True, error_model="numpy", **counting(not lean))(function))
    return (*made, count)
