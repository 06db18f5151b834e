"""How a plain Python function becomes machine code: marked here, compiled at its first evaluation, kept on disk.

A *kernel* is an ordinary function of floats, marked with `device`. Nothing is compiled when a module is imported, and
numba itself is imported by the first call of `jit`. Functions that a kernel calls are compiled with it and inlined,
so that a loop over it vectorises.
"""

import functools
import hashlib
import math
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final, TypeVar, cast

import numpy as np

F = TypeVar("F", bound=Callable[..., Any])
Others = tuple[tuple[Callable[..., Any], Callable[..., Any]], ...]

# Contraction, reciprocals and the sign of zero change no digit that matters. Reassociation would fold two-part
# constants and compensated sums; "nnan" and "ninf" would break the limits at grazing.
FASTMATH: Final = frozenset({"contract", "arcp", "nsz"})

_BEYOND: Final = {1e-75: 1e-9}
"""What stands in float32 for a bound whose products would leave its range."""

_lock = threading.RLock()
_ready: dict[tuple[Callable[..., Any], Callable[..., Any], int, bool], Any] = {}


def device(function: Callable[..., Any]) -> Callable[..., Any]:
    """Mark a function of floats that kernels may call and that `jit` compiles; globals it uses must be plain names."""
    function.__dict__["__device__"] = True
    return function


def in_double(function: F) -> F:
    """Mark a function whose arithmetic is float64 in a kernel of float32, too."""
    function.__dict__.update(__device__=True, __double__=True)
    return function


def instead_of(double: Callable[..., Any]) -> Callable[[F], F]:
    """Mark what takes the place of a function where a kernel's arithmetic is float32."""

    def mark(function: F) -> F:
        function.__dict__["__device__"] = True
        double.__dict__["single"] = function
        return function

    return mark


def of_columns(
    columns: Callable[..., Any], count: int, *, single_range: tuple[float, float] = (0.0, 1e10)
) -> Callable[[F], F]:
    """Mark a kernel as a function of `count` numbers that `columns` makes of two directions, and of its constants.

    The numbers are the same for all parameter sets: `Model.at` keeps them with the directions. Where all constants
    but those that are 0 have sizes in `single_range`, nothing that the kernel makes of them leaves float32.
    """

    def mark(kernel: F) -> F:
        kernel.__dict__.update(__device__=True, columns=columns, count=count, single_range=single_range)
        return kernel

    return mark


def with_others(kernel: F, name: str, others: Mapping[Callable[..., Any], Callable[..., Any]]) -> F:
    """A kernel or a loop once more, in which other marked functions take the place of some, at any depth."""
    assert isinstance(kernel, FunctionType)
    copy = _copy(kernel, {})
    copy.__dict__.update(kernel.__dict__, others=tuple(others.items()))
    copy.__name__ = name
    return cast(F, copy)


def _of_directions(lx, ly, lz, vx, vy, vz, p):  # type: ignore[no-untyped-def]
    """A kernel of columns as one of directions: `take` and `shade` are put in by `_loop`."""
    return shade(*take(lx, ly, lz, vx, vy, vz), p)  # type: ignore[name-defined]  # noqa: F821


def table(function: Callable[[], Any]) -> Any:
    """Mark a function without arguments whose value, an array, takes its place in kernels when they are compiled."""
    cached = functools.cache(function)
    cached.__dict__["__table__"] = True
    return cached


def in_float32(value: Any) -> Any:
    """A constant in float32, so that float32 arguments stay what they are; what is no float as it is.

    A bound far outside its range becomes 1e-18 or 1e18, whose squares are within it.
    """
    if type(value) is not float:
        return value
    size = abs(value)
    size = _BEYOND.get(size, 1e-18 if 0.0 < size < 1e-37 else 1e18 if 1e37 < size < math.inf else size)
    return np.float32(math.copysign(size, value))


def _copy(function: FunctionType, names: Mapping[str, Any], in_single: bool = False) -> Any:
    code = function.__code__
    if in_single:
        code = code.replace(co_consts=tuple(map(in_float32, code.co_consts)))
    clone = FunctionType(code, {**function.__globals__, **names}, function.__name__, function.__defaults__)
    clone.__qualname__ = function.__qualname__
    clone.__module__ = function.__module__
    return clone


def _clone(
    function: Callable[..., Any], names: Mapping[str, object], others: Others = (), in_single: bool = False
) -> Any:
    """The same code with the marked functions that it calls, or `others` in their place, replaced by compiled ones."""
    assert isinstance(function, FunctionType)
    called = {}
    for name in function.__code__.co_names:
        value: Any = names.get(name, function.__globals__.get(name))
        value = next((other for one, other in others if one is value), value)
        value = value.__dict__.get("single", value) if in_single and hasattr(value, "__dict__") else value
        if getattr(value, "__device__", False):
            single = in_single and "__double__" not in value.__dict__
            called[name] = _jit(value, value.__dict__.get("others", others), single)
        elif getattr(value, "__table__", False):
            called[name] = value()
        elif name in names:
            called[name] = value
        elif in_single and type(value) is float:
            called[name] = in_float32(value)
    return _copy(function, called, in_single)


def fingerprint(*parts: Any) -> str:
    """Of functions and of all that their code refers to, for numba's cache watches only the file of the outermost one.

    Lines, comments and docstrings do not count. What cannot be told by itself counts with all files of this folder.
    """
    digest = hashlib.sha256()
    seen: dict[int, tuple[int, Any]] = {}

    def add(part: Any) -> None:
        digest.update(f"{type(part).__name__} ".encode())
        if id(part) in seen:
            digest.update(str(seen[id(part)][0]).encode())
        elif isinstance(part, (FunctionType, CodeType)) or hasattr(part, "py_func"):
            seen[id(part)] = len(seen), part  # held, so that no other one gets its number
            of_code(part)
        elif getattr(part, "__table__", False):
            add(part())
        elif isinstance(part, np.ndarray):
            digest.update(f"{part.dtype}{part.shape}".encode() + part.tobytes())
        elif isinstance(part, (tuple, list)):
            for each in (len(part), *part):
                add(each)
        elif isinstance(part, (set, frozenset)):
            add(sorted(map(str, part)))
        elif isinstance(part, (int, float, complex, str, bytes, np.generic, type(None))):
            digest.update(repr(part).encode())
        elif (isinstance(part, ModuleType) and not part.__name__.startswith("gonio")) or _of_numpy(part):
            digest.update(getattr(part, "__name__", str(part)).encode())
        else:
            for path in sorted(Path(__file__).parent.glob("*.py")):
                digest.update(path.read_bytes())

    def of_code(part: Any) -> None:
        if hasattr(part, "py_func"):
            for name, value in sorted(part.targetoptions.items()):
                add((name, value if isinstance(value, set) else str(value)))
            add(part.py_func)
        elif isinstance(part, FunctionType):
            code = part.__code__
            told = code.co_consts[1:] if code.co_consts[:1] == (part.__doc__,) else code.co_consts
            add((code.co_code, told, part.__defaults__, [cell.cell_contents for cell in part.__closure__ or ()]))
            for name in _names(code):
                add((name, part.__globals__.get(name)))
        else:
            add((part.co_code, part.co_consts, part.co_names))

    for part in (*_made_by(), *parts):
        add(part)
    return digest.hexdigest()[:16]


@functools.cache
def _made_by() -> tuple[bytes, ...]:
    """What makes machine code of functions."""
    here = Path(__file__)
    return tuple(path.read_bytes() for path in (here, here.parents[1] / "compiled.py"))


def _names(code: CodeType) -> list[str]:
    """Names that code looks up, that within it included."""
    inner = [name for part in code.co_consts if isinstance(part, CodeType) for name in _names(part)]
    return [*code.co_names, *inner]


def _of_numpy(part: Any) -> bool:
    """Whether it belongs to Python, numpy or numba, and is told by its name."""
    of = getattr(part, "__module__", None) or type(part).__module__
    return of.partition(".")[0] in ("builtins", "math", "numpy", "numba")


def options() -> dict[str, object]:
    """How numba compiles a function."""
    return {"fastmath": set(FASTMATH), "error_model": "numpy"}


@functools.cache
def _jit(function: Callable[..., Any], others: Others = (), in_single: bool = False) -> Any:
    import numba

    return numba.njit(forceinline=True, **options())(_clone(function, {}, others, in_single))


def jit(function: Callable[..., Any]) -> Any:
    """A marked function compiled for use inside other compiled code; safe to call from several threads."""
    with _lock:
        return _jit(function)


def template(layout: str, *, columns: bool = False) -> Callable[[F], F]:
    """Mark a loop over a kernel, with the kinds of its arguments in order.

    ``r1``, ``r2``: arrays of 1 or 2 axes that are read (they may be read-only); ``w1``, ``w2``: arrays that are
    written; ``i``: an integer; ``p``: the tuple of the kernel's constants. All arrays are contiguous, of float64
    or, in a loop compiled for it, float32.
    `columns`: whether the loop hands its kernel the columns that it works on (see `of_columns`), and not directions.
    """

    def mark(function: F) -> F:
        function.__dict__.update(__layout__=layout.split(), __columns__=columns)
        return function

    return mark


def _loop(function: Callable[..., Any], kernel: Callable[..., Any], size: int, in_single: bool = False) -> Any:
    import numba

    from gonio.compiled import counting, njit

    types = numba.types
    real = types.float32 if in_single else types.float64

    def kind(code: str) -> Any:
        if code == "i":
            return types.int64
        if code == "p":
            return types.UniTuple(real, size)
        return types.Array(real, int(code[1]), "C", readonly=code[0] == "r")

    function = kernel.__dict__.get(function.__name__, function)  # a kernel of several passes brings its own loops
    signature = tuple(kind(code) for code in function.__dict__["__layout__"])
    chosen = options() | counting(not function.__dict__["__columns__"])  # those make no arrays
    names: dict[str, object] = {"kernel": kernel}
    if "columns" in kernel.__dict__ and not function.__dict__["__columns__"]:
        parts = {"shade": kernel, "take": kernel.__dict__["columns"]}
        whole = _clone(_of_directions, parts, kernel.__dict__.get("others", ()), in_single)
        names = {"kernel": numba.njit(forceinline=True, **chosen)(whole)}
    plain = _clone(function, names, function.__dict__.get("others", ()), in_single)
    made_of = fingerprint(plain)
    plain.__name__ = f"{function.__name__}_{real}_{kernel.__module__.rsplit('.', 1)[-1]}_{kernel.__name__}_{made_of}"
    plain.__qualname__ = plain.__name__
    return njit(*signature, nogil=True, **chosen)(plain)


def loop(function: Callable[..., Any], kernel: Callable[..., Any], size: int, *, in_single: bool = False) -> Any:
    """A loop written once for every kernel, compiled for this one, cached on disk, and running without the GIL.

    Parameters
    ----------
    function
        A function marked by `template` that calls the global name ``kernel``.
    kernel
        The marked function that takes its place.
    size
        How many constants the kernel takes.
    in_single
        Whether arrays, constants and arithmetic are float32.
    """
    found = _ready.get((function, kernel, size, in_single))
    if found is None:
        with _lock:
            found = _ready[function, kernel, size, in_single] = _loop(function, kernel, size, in_single)
    return found
