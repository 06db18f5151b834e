"""Evaluating one compiled kernel over arrays: arguments, broadcasting, threads and results; the loops are `_loops`.

Arguments are checked in the same pass that evaluates them, into a private array that is thrown away when a check
fails.
"""

import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from math import prod
from typing import Any, Final

import numpy as np

from gonio import platform
from gonio.errors import ArgumentError, refuse_masked
from gonio.geometry import ANGLES
from gonio.models import _loops
from gonio.models._compile import loop
from gonio.models._loops import BLOCK, NORM_TOLERANCE, PHI_LIMIT
from gonio.models._math import HALF_PI
from gonio.models.parameters import checked_wavelength
from gonio.typing import ArrayLike, Floats, NDArray

Kernel = Callable[..., Any]
Constants = tuple[float, ...]

SPLIT: Final = 65536  # pairs a thread must have to be worth waking: a wake costs some 20 us


# --- threads: our own, over serial compiled code, so that no numba threading layer is involved -------------------

_pool: ThreadPoolExecutor | None = None
_pool_lock = threading.Lock()


def _forget_pool() -> None:
    """After a fork the child has none of the parent's threads."""
    global _pool, _pool_lock
    _pool, _pool_lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


_here = threading.local()


def threads() -> int:
    """How many threads large arrays are split over: the processors that this process may use, or one (`alone`)."""
    return 1 if getattr(_here, "alone", False) else platform.processors()


@contextmanager
def alone() -> Iterator[None]:
    """Within it this thread splits no work over other threads: for one of many that run side by side."""
    before, _here.alone = getattr(_here, "alone", False), True
    try:
        yield
    finally:
        _here.alone = before


def in_parts(work: Callable[[int, int], int | None], count: int, split: int = SPLIT, most: int | None = None) -> int:
    """Run ``work(start, stop)`` over [0, count), split over threads of at least `split` each; the largest result.

    `most` is how many threads there may be, `threads()` unless it is given.

    `work` must release the GIL. Safe from several Python threads at once.
    """
    parts = 1 if count < 2 * split else min(threads() if most is None else most, count // split)
    if parts <= 1:
        return work(0, count) or 0
    global _pool
    with _pool_lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(threads(), thread_name_prefix="gonio-models")
        pool = _pool
    edges = [count * part // parts for part in range(parts + 1)]
    waiting = [pool.submit(work, edges[part], edges[part + 1]) for part in range(1, parts)]
    worst = work(edges[0], edges[1])
    return max(result or 0 for result in [worst, *(future.result() for future in waiting)])


# --- arguments ----------------------------------------------------------------------------------------------------


def real_array(name: str, value: ArrayLike, real: type[np.floating[Any]] = np.float64) -> NDArray[Any]:
    """An argument as a float64 array; raises `ArgumentError` naming it when it is not made of real numbers."""
    if type(value) is float:
        return np.array(value, real)
    refuse_masked(name, value)
    try:
        array = np.asarray(value)
    except ValueError as error:
        raise ArgumentError(f"{name} is not an array of numbers: {error}") from error
    if array.dtype.kind not in "fiu":
        raise ArgumentError(f"{name} must hold real numbers, not {array.dtype}")
    return array.astype(real, copy=False)


def flat(array: Floats, shape: tuple[int, ...], count: int, core: tuple[int, ...] = ()) -> tuple[Floats, int]:
    """A contiguous 1-D array and 1, or a block of one repeated value (or vector, `core` = (3,)) and 0."""
    if not array.ndim and count == 1:
        return array.reshape(1), 1
    if count != 1 and array.size == prod(core):
        return np.full((min(BLOCK, count), array.size), array.reshape(-1), array.dtype).reshape(-1), 0
    if array.shape != (*shape, *core):
        array = np.broadcast_to(array, (*shape, *core))
    out = np.ascontiguousarray(array).reshape(-1)
    return (out if out.flags.aligned else out.copy()), 1


def common_shape(names: tuple[str, ...], shapes: list[tuple[int, ...]]) -> tuple[int, ...]:
    """The shape that arguments broadcast to; raises `ArgumentError` naming them when they do not."""
    if shapes.count(shapes[0]) == len(shapes):
        return shapes[0]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        given = ", ".join(f"{name} {shape}" for name, shape in zip(names, shapes, strict=True))
        raise ArgumentError(f"the shapes do not broadcast together: {given}") from None


VECTORS: Final = ("omega_i", "omega_r")


def _in_range(name: str, array: Floats) -> NDArray[np.bool_]:
    """Which values of an angle, or which vectors, may be evaluated."""
    if name.startswith("omega"):
        return np.asarray(np.abs(np.einsum("...k,...k->...", array, array) - 1.0) <= 2.0 * NORM_TOLERANCE)
    low, high = (0.0, HALF_PI) if name.startswith("theta") else (-PHI_LIMIT, PHI_LIMIT)
    return np.asarray((array >= low) & (array <= high))


def explain(arrays: list[Floats]) -> ArgumentError:
    """What is wrong with four angles or two arrays of vectors, of which a check failed."""
    for name, array in zip(ANGLES if len(arrays) == 4 else VECTORS, arrays, strict=True):
        good = _in_range(name, array)
        if good.all():
            continue
        first = np.unravel_index(np.flatnonzero(~good)[0], good.shape)
        where = f" at index {tuple(int(i) for i in first)}" if good.ndim else ""
        if name in VECTORS:
            rest = f"is not a unit vector: its length must be 1 to {NORM_TOLERANCE:g}"
            return ArgumentError(f"{name} = {array[first].tolist()}{where} {rest}")
        allowed = "[0, pi/2]" if name.startswith("theta") else f"[-{PHI_LIMIT:g}, {PHI_LIMIT:g}]"
        return ArgumentError(f"{name} = {array[first]:.17g} rad{where}: must lie in {allowed} rad")
    raise AssertionError("a check failed that no argument explains")


def angle_arrays(
    theta_i: ArrayLike, phi_i: ArrayLike, theta_r: ArrayLike, phi_r: ArrayLike
) -> tuple[list[Floats], tuple[int, ...]]:
    """The four angles as float64 arrays and the shape that they broadcast to; their ranges are not yet checked."""
    arrays = [real_array(name, value) for name, value in zip(ANGLES, (theta_i, phi_i, theta_r, phi_r), strict=True)]
    return arrays, common_shape(ANGLES, [array.shape for array in arrays])


def vector_arrays(
    omega_i: ArrayLike, omega_r: ArrayLike, real: type[np.floating[Any]] = np.float64
) -> tuple[list[NDArray[Any]], tuple[int, ...]]:
    """Two arrays of vectors (..., 3) as float64 and the shape that they broadcast to; their lengths are not checked."""
    arrays = [real_array(name, value, real) for name, value in zip(VECTORS, (omega_i, omega_r), strict=True)]
    for name, array in zip(VECTORS, arrays, strict=True):
        if array.ndim == 0 or array.shape[-1] != 3:
            raise ArgumentError(f"{name} has shape {array.shape}: its last axis must have the 3 components of a vector")
    return arrays, common_shape(VECTORS, [array.shape[:-1] for array in arrays])


def check_angles(arrays: list[Floats]) -> None:
    """Raise `ArgumentError` for a polar angle outside [0, pi/2], an azimuth that is not finite, or NaN."""
    if not all(_in_range(name, array).all() for name, array in zip(ANGLES, arrays, strict=True)):
        raise explain(arrays)


# --- results ------------------------------------------------------------------------------------------------------


def checked_out(out: Any, shape: tuple[int, ...], real: type[np.floating[Any]] = np.float64) -> None:
    """Raise `ArgumentError` unless `out` is None, or a writable array of a shape and type."""
    if out is None:
        return
    if not isinstance(out, np.ndarray):
        raise ArgumentError(f"out must be an array, not {type(out).__name__}")
    if out.dtype != real or out.shape != shape:
        raise ArgumentError(f"out is {out.dtype} {out.shape}: must be {np.dtype(real)} {shape}")
    if not out.flags.writeable:
        raise ArgumentError("out is read-only")
    if any(stride == 0 and size > 1 for stride, size in zip(out.strides, out.shape, strict=True)):
        raise ArgumentError("out repeats one element along an axis (stride 0): every result needs a place of its own")


def delivered(out: Any, values: Any) -> Any:
    """`values`, or `out` filled with them; raises `ArgumentError` where it has another shape or type."""
    if out is None:
        return values if getattr(values, "ndim", 0) else values[()]
    if out is not values:
        checked_out(out, np.shape(values), values.dtype.type)
        out[...] = values
    return out


# --- evaluation ---------------------------------------------------------------------------------------------------


def over_angles(
    kernel: Kernel,
    constants: Constants,
    theta_i: ArrayLike,
    phi_i: ArrayLike,
    theta_r: ArrayLike,
    phi_r: ArrayLike,
    *,
    absolute: bool = False,
    split: int = SPLIT,
    out: Any = None,
) -> Any:
    """A kernel over broadcast angles [rad]; `absolute` when it depends on both azimuths and not on their difference.

    Into `out` nothing is written before all arguments are checked.
    """
    arrays, shape = angle_arrays(theta_i, phi_i, theta_r, phi_r)
    count = prod(shape)
    checked_out(out, shape)
    values = np.empty(shape)
    if count == 0:
        check_angles(arrays)
    else:
        run = loop(_loops.over_absolute_angles if absolute else _loops.over_angles, kernel, len(constants))
        (a, sa), (b, sb), (c, sc), (d, sd) = (flat(array, shape, count) for array in arrays)
        target = values.reshape(-1)
        if in_parts(lambda i, j: run(a, sa, b, sb, c, sc, d, sd, constants, target, i, j), count, split):
            raise explain(arrays)
    return delivered(out, values)


def over_wavelengths(
    evaluations: Sequence[tuple[Kernel, Constants]], arrays: list[Floats], *, absolute: bool, split: int = SPLIT
) -> Floats:
    """Kernels marked by `of_columns`, each over the same four arrays of checked angles of one shape.

    Shape (evaluations, pairs). What the kernels make of the directions alone is made once.
    """
    count = arrays[0].size
    kept: dict[Kernel, Floats] = {}
    out = np.empty((len(evaluations), count))
    for (kernel, constants), target in zip(evaluations, out, strict=True):
        take, width = kernel.__dict__["columns"], kernel.__dict__["count"]
        columns = kept.get(take)
        if columns is None:
            columns = kept[take] = np.empty(width * count)
            make = loop(_loops.over_absolute_angle_columns if absolute else _loops.over_angle_columns, take, 0)
            flats = (number for array in arrays for number in flat(array, array.shape, count))
            make(*flats, width, columns)
        shade = loop(_loops.AT[width], kernel, len(constants))
        in_parts(partial(shade, columns, constants, target), count, split)
    return out


def over_vectors(
    kernel: Kernel, constants: Constants, omega_i: ArrayLike, omega_r: ArrayLike, *, split: int = SPLIT, out: Any = None
) -> Any:
    """A kernel over broadcast unit vectors (..., 3); 0 where either lies below the surface.

    Two float32 arrays give a float32 result: by float32 arithmetic where kernel and constants allow it, else by
    float64. Into `out` nothing is written before all arguments are checked.
    """

    def rounded() -> Any:
        double = over_vectors(kernel, constants, *vector_arrays(omega_i, omega_r)[0], split=split)
        with np.errstate(over="ignore", under="ignore"):  # beyond float32: infinite, as the formula's own poles are
            return delivered(out, np.asarray(double).astype(np.float32))

    single = all_single(omega_i, omega_r)
    if single and not _in_single(kernel, constants):
        return rounded()
    real: type[np.floating[Any]] = np.float32 if single else np.float64
    arrays, shape = vector_arrays(omega_i, omega_r, real)
    count = prod(shape)
    checked_out(out, shape, real)
    values = np.empty(shape, real)
    if count == 0:
        check_vectors(arrays)
    else:
        run = loop(_loops.over_vectors, kernel, len(constants), in_single=single)
        (l, sl), (v, sv) = (flat(array, shape, count, (3,)) for array in arrays)  # noqa: E741
        target, numbers = values.reshape(-1), tuple(real(constant) for constant in constants) if single else constants
        if in_parts(lambda i, j: run(l, sl, v, sv, numbers, target, i, j), count, split):
            if single:  # the lengths in float64 decide
                return rounded()
            raise explain(arrays)
    return delivered(out, values)


def check_vectors(arrays: list[NDArray[Any]]) -> None:
    """Raise `ArgumentError` for a vector that is not of unit length, or holds NaN."""
    for array in arrays:
        run = loop(_loops.over_lengths, _loops.off_unit, 0)
        all_ = np.ascontiguousarray(array, np.float64).reshape(-1)
        if all_.size and in_parts(lambda i, j, run=run, v=all_: run(v, i, j), all_.size // 3):  # type: ignore[misc]
            raise explain(arrays)


def all_single(*arguments: Any) -> bool:
    """Whether every argument that has an axis is a float32 array, and there is one."""
    arrays = [x for x in arguments if not isinstance(x, (int, float)) and getattr(x, "ndim", None) != 0]
    return bool(arrays) and all(getattr(x, "dtype", None) == np.float32 for x in arrays)


def _in_single(kernel: Kernel, constants: Constants) -> bool:
    """Whether a kernel has float32 arithmetic, and that holds all that it makes of these constants."""
    low, high = kernel.__dict__.get("single_range", (math.inf, 0.0))
    return all(constant == 0.0 or low <= abs(constant) <= high for constant in constants)


@dataclass(frozen=True)
class Geometry:
    """Pairs of directions, checked and turned into vectors once: what a fit evaluates many parameter sets at.

    What the models make of the directions alone is kept with them from the first evaluation on: up to 32 bytes a pair
    for each family of models.

    Attributes
    ----------
    omega_i, omega_r
        Components of the unit vectors toward the source and toward the detector, three after three.
    shape
        The shape of the result.
    """

    omega_i: Floats
    omega_r: Floats
    shape: tuple[int, ...]
    _kept: dict[Kernel, Floats] = field(default_factory=dict, repr=False, compare=False)

    def columns(self, kernel: Kernel) -> Floats:
        """What a kernel marked by `of_columns` needs of the directions, column after column."""
        take, count = kernel.__dict__["columns"], kernel.__dict__["count"]
        found = self._kept.get(take)
        if found is None:
            found = np.empty(count * (self.omega_i.size // 3))
            loop(_loops.COLUMNS[count], take, 0)(self.omega_i, self.omega_r, found)
            self._kept[take] = found
        return found


def geometry(theta_i: ArrayLike, phi_i: ArrayLike, theta_r: ArrayLike, phi_r: ArrayLike) -> Geometry:
    """Check angles [rad] once for many evaluations (`Model.at`); raises `ArgumentError` as `Model.brdf` does."""
    arrays, shape = angle_arrays(theta_i, phi_i, theta_r, phi_r)
    check_angles(arrays)

    def vectors(theta: Floats, phi: Floats) -> Floats:
        cosine = np.where(theta < HALF_PI, np.cos(theta), 0.0)
        parts = np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), cosine)
        return np.ascontiguousarray(np.broadcast_to(np.stack(parts, axis=-1), (*shape, 3))).reshape(-1)

    return Geometry(vectors(arrays[0], arrays[1]), vectors(arrays[2], arrays[3]), shape)


def at_geometry(kernel: Kernel, constants: Constants, where: Geometry, *, split: int = SPLIT, out: Any = None) -> Any:
    """A kernel at a checked `Geometry`."""
    checked_out(out, where.shape)
    values = np.empty(where.shape)
    target = values.reshape(-1)
    if target.size and "columns" in kernel.__dict__:
        columns = where.columns(kernel)
        shade = loop(_loops.AT[kernel.__dict__["count"]], kernel, len(constants))
        in_parts(lambda i, j: shade(columns, constants, target, i, j), target.size, split)
    elif target.size:
        run = loop(_loops.over_vectors, kernel, len(constants))
        in_parts(lambda i, j: run(where.omega_i, 1, where.omega_r, 1, constants, target, i, j), target.size, split)
    return delivered(out, values)


# --- wavelengths ---------------------------------------------------------------------------------------------------


def over_thetas(evaluate: Callable[[Floats, float], Floats], theta_i: ArrayLike, wavelength_nm: ArrayLike) -> Any:
    """``evaluate(flat theta_i, wavelength) -> flat`` over checked arguments that broadcast."""
    theta = real_array("theta_i", theta_i)
    if not _in_range("theta_i", theta).all():
        raise explain([theta, *[np.zeros(1)] * 3])
    waves = real_array("wavelength_nm", wavelength_nm)
    if not waves.ndim:
        flat_ = np.ascontiguousarray(theta).reshape(-1)
        return evaluate(flat_, checked_wavelength(waves.item())).reshape(theta.shape)[()]
    shape = common_shape(("theta_i", "wavelength_nm"), [theta.shape, waves.shape])
    theta, waves = np.broadcast_to(theta, shape).ravel(), np.broadcast_to(waves, shape).ravel()
    out = np.empty(theta.shape)
    for wave in np.unique(waves):
        here = waves == wave
        out[here] = evaluate(np.ascontiguousarray(theta[here]), checked_wavelength(wave))
    return out.reshape(shape)[()]


def by_wavelength(
    evaluate: Callable[[list[Any], list[float]], Floats],
    wavelength_nm: ArrayLike,
    arrays: list[Any],
    shape: tuple[int, ...],
    core: tuple[int, ...],
) -> Any:
    """``evaluate(arguments, wavelengths) -> (wavelengths, pairs)`` over arguments that broadcast with wavelengths.

    Where wavelengths and directions lie on axes of their own, all wavelengths share one evaluation of the directions;
    else the pairs of each wavelength are picked out. `core` is what an argument's shape has beyond that of the pairs.
    """
    waves = real_array("wavelength_nm", wavelength_nm)
    whole = common_shape(("the directions", "wavelength_nm"), [shape, waves.shape])
    if 0 in whole:
        return np.empty(whole)
    unique, place = np.unique(waves, return_inverse=True)
    numbers = [checked_wavelength(wave) for wave in unique]
    long = (1,) * (len(whole) - len(shape)) + shape
    wide = (1,) * (len(whole) - waves.ndim) + waves.shape
    if all(n == 1 or w == 1 for n, w in zip(long, wide, strict=True)):
        table = evaluate([np.broadcast_to(array, (*shape, *core)) for array in arrays], numbers)[place.reshape(-1)]
        apart = table.reshape(wide + long)
        axes = [
            axis for pair in zip(range(len(whole)), range(len(whole), 2 * len(whole)), strict=True) for axis in pair
        ]
        return apart.transpose(axes).reshape(whole)
    place = np.broadcast_to(place.reshape(waves.shape), whole)
    parts = [np.broadcast_to(array, (*whole, *core)) for array in arrays]
    out = np.empty(whole)
    for k, number_ in enumerate(numbers):
        here = place == k
        out[here] = evaluate([part[here] for part in parts], [number_])[0]
    return out
