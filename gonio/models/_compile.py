"""How a plain Python function becomes machine code: marked here, compiled at its first evaluation, kept on disk.

A *kernel* is an ordinary function of floats, marked with `device`. Nothing is compiled when a module is imported, and
numba itself is imported by the first call of `jit`. Functions that a kernel calls are compiled with it and inlined,
so that a loop over it vectorises.
"""

from __future__ import annotations

import functools
import hashlib
import threading
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, Final, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

# Contraction, reciprocals and the sign of zero change no digit that matters. Reassociation would fold two-part
# constants and compensated sums; "nnan" and "ninf" would break the limits at grazing.
FASTMATH: Final = frozenset({"contract", "arcp", "nsz"})

_lock = threading.RLock()
_ready: dict[tuple[Callable[..., Any], Callable[..., Any], int], Any] = {}


def device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function of floats that kernels may call and that `jit` compiles; globals it uses must be plain names."""
    function.__dict__["__device__"] = True
    return function


def table(function: Callable[[], Any]) -> Any:
    """Mark a function without arguments whose value, an array, takes its place in kernels when they are compiled."""
    cached = functools.cache(function)
    cached.__dict__["__table__"] = True
    return cached


def _clone(function: Callable[..., Any], names: dict[str, Any]) -> Any:
    """The same code with the marked functions that it calls replaced by compiled ones."""
    assert isinstance(function, FunctionType)
    called = {}
    for name in function.__code__.co_names:
        value: Any = names.get(name, function.__globals__.get(name))
        if getattr(value, "__device__", False):
            called[name] = jit(value)
        elif getattr(value, "__table__", False):
            called[name] = value()
        elif name in names:
            called[name] = value
    clone = FunctionType(
        function.__code__, {**function.__globals__, **called}, function.__name__, function.__defaults__
    )
    clone.__qualname__ = function.__qualname__
    clone.__module__ = function.__module__
    return clone


@functools.cache
def _sources(kernel_file: str) -> str:
    """A fingerprint of the models' and the kernel's source files: numba's cache watches only the file of the loop."""
    digest = hashlib.sha256()
    for path in sorted({*Path(__file__).parent.rglob("*.py"), Path(kernel_file)}):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


@functools.cache
def _jit(function: Callable[..., Any]) -> Any:
    import numba

    from gonio.models._wide import Wide

    options = {"fastmath": set(FASTMATH), "error_model": "numpy", "pipeline_class": Wide}
    return numba.njit(forceinline=True, **options)(_clone(function, {}))


def jit(function: Callable[..., Any]) -> Any:
    """A marked function compiled for use inside other compiled code; safe to call from several threads."""
    with _lock:
        return _jit(function)


def template(layout: str) -> Callable[[F], F]:
    """Mark a loop over a kernel, with the kinds of its arguments in order.

    ``r1``, ``r2``: arrays of 1 or 2 axes that are read (they may be read-only); ``w1``, ``w2``: arrays that are
    written; ``i``: an integer; ``p``: the tuple of the kernel's constants. All arrays are float64 and contiguous.
    """

    def mark(function: F) -> F:
        function.__dict__["__layout__"] = layout.split()
        return function

    return mark


def _loop(function: Callable[..., Any], kernel: Callable[..., Any], size: int) -> Any:
    from numba import types

    from gonio.compiled import njit
    from gonio.models._wide import Wide

    def kind(code: str) -> Any:
        if code == "i":
            return types.int64
        if code == "p":
            return types.UniTuple(types.float64, size)
        return types.Array(types.float64, int(code[1]), "C", readonly=code[0] == "r")

    function = kernel.__dict__.get(function.__name__, function)  # a kernel of several passes brings its own loops
    signature = tuple(kind(code) for code in function.__dict__["__layout__"])
    plain = _clone(function, {"kernel": kernel})
    sources = _sources(kernel.__code__.co_filename)
    plain.__name__ = f"{function.__name__}_{kernel.__module__.rsplit('.', 1)[-1]}_{kernel.__name__}_{sources}"
    plain.__qualname__ = plain.__name__
    options = {"fastmath": set(FASTMATH), "error_model": "numpy", "pipeline_class": Wide}
    return njit(*signature, nogil=True, **options)(plain)


def loop(function: Callable[..., Any], kernel: Callable[..., Any], size: int) -> Any:
    """A loop written once for every kernel, compiled for this one, cached on disk, and running without the GIL.

    Parameters
    ----------
    function
        A function marked by `template` that calls the global name ``kernel``.
    kernel
        The marked function that takes its place.
    size
        How many constants the kernel takes.
    """
    found = _ready.get((function, kernel, size))
    if found is None:
        with _lock:
            found = _ready[function, kernel, size] = _loop(function, kernel, size)
    return found
