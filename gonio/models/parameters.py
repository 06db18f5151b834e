"""Models' parameters: numbers in their ranges, names among a few, and indices of refraction by name or wavelength."""

import cmath
import difflib
import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np

from gonio.errors import ArgumentError, refuse_masked
from gonio.typing import Floats, NDArray

Index = complex | str | Sequence[float] | Callable[[float], complex]
"""A complex refractive index n + ik, [n, k], a material's name, or a function of the wavelength in nm."""

Parameters = dict[str, Any]
"""A model's parameters by name, as a sample file or a report holds them; those of a sum are a table a term."""


@dataclass(frozen=True)
class Fitted:
    """What a fit may do with a number that a model's constructor takes (`Model.fitted`).

    Raises
    ------
    ArgumentError
        The bounds do not ascend, a logarithmic scale goes down to 0, or a start is outside.
    """

    lower: float
    upper: float
    scale: Literal["linear", "log"] = "linear"
    """On which the search moves; "log" for lengths, widths and indices."""
    unit: str = ""
    starts: tuple[float, ...] | Literal["diffuse", "peak"] = ()
    """Where to search from: every combination of all parameters' starts. "diffuse" is pi times the lower values that
    were measured, "peak" pi times the highest; without any, three values between the bounds."""
    fixed: float | None = None
    """Its value, unless the user frees it; None: it is fitted."""
    geometry: bool = False
    """Whether it belongs to the surface (a roughness, a slope), and so is the same at every wavelength."""

    def inside(self, value: float) -> float:
        """`value`, brought between the bounds."""
        return min(max(value, self.lower), self.upper)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise ArgumentError(f"bounds {self.lower:g} to {self.upper:g}: must be finite, and ascend")
        if self.scale not in ("linear", "log") or (self.scale == "log" and self.lower <= 0):
            raise ArgumentError(f'scale "{self.scale}" from {self.lower:g}: "linear", or "log" with bounds above 0')
        if isinstance(self.starts, str) and self.starts not in ("diffuse", "peak"):
            raise ArgumentError(f'starts = "{self.starts}": must be numbers, "diffuse" or "peak"')
        known = () if isinstance(self.starts, str) else self.starts
        for value in (*known, *(() if self.fixed is None else (self.fixed,))):
            if not self.lower <= value <= self.upper:
                raise ArgumentError(f"{value:g} is not between the bounds {self.lower:g} and {self.upper:g}")


def number(name: str, value: Any, low: float = -math.inf, high: float = math.inf, unit: str = "") -> float:
    """A real parameter in [low, high]; raises `ArgumentError` naming it otherwise."""
    refuse_masked(name, value)
    if type(value) is not float and (
        isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating))
    ):
        try:
            value = np.asarray(value).item() if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" else None
        except ValueError:
            value = None
        if value is None:
            raise ArgumentError(f"{name} must be one real number{unit and f' [{unit}]'}")
    try:
        result = float(value)
    except OverflowError:  # a whole number of hundreds of digits
        result = math.copysign(math.inf, value)
    if not low <= result <= high or math.isinf(result):
        allowed = f"at least {low:g}" if math.isinf(high) else f"in [{low:g}, {high:g}]"
        raise ArgumentError(
            f"{name} = {result:g}{unit and ' ' + unit}: must be "
            f"{'finite' if math.isinf(low) and math.isinf(high) else 'finite and ' + allowed}"
        )
    return result


def checked_wavelength(value: Any) -> float:
    """A wavelength [nm] in [1e-6, 1e12]: from gamma rays to radio; raises `ArgumentError` otherwise."""
    return number("wavelength_nm", value, 1e-6, 1e12, unit="nm")


def positive(name: str, value: Any, unit: str = "") -> float:
    """A real parameter above zero; raises `ArgumentError` naming it otherwise."""
    result = number(name, value, unit=unit)
    if result <= 0.0:
        raise ArgumentError(f"{name} = {result:g}{unit and ' ' + unit}: must be above 0")
    return result


def choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """One of a few names; raises `ArgumentError` with the nearest of them otherwise."""
    if isinstance(value, str) and value in allowed:
        return str(value)
    near = difflib.get_close_matches(str(value), allowed, n=1)
    listed = ", ".join(f'"{option}"' for option in allowed)
    raise ArgumentError(
        f"{name} = {value!r}: must be one of {listed}" + (f'; did you mean "{near[0]}"?' if near else "")
    )


@functools.lru_cache(maxsize=64)
def _material(name: str) -> Callable[[float], complex]:
    from gonio import materials

    return cast(Callable[[float], complex], materials.ior(name))


@functools.lru_cache(maxsize=1024)
def _material_at(name: str, wavelength_nm: float) -> complex:
    return complex(_material(name)(wavelength_nm))


def checked_index(ior: Any, name: str = "ior") -> Any:
    """An `Index` argument in its stored form: a complex number, a material's name, or a function."""
    if isinstance(ior, str):
        _material(ior)
        return ior
    if callable(ior):
        return ior
    if isinstance(ior, (list, tuple)) or (isinstance(ior, np.ndarray) and ior.ndim > 0):
        if len(ior) != 2:
            raise ArgumentError(f"{name} = {ior!r}: a list must be [n, k]")
        return _valid_index(complex(number(f"{name}[0]", ior[0]), number(f"{name}[1]", ior[1])), name)
    return _valid_index(ior, name)


def _valid_index(ior: Any, name: str) -> complex:
    try:
        if isinstance(ior, (bool, str)):  # complex() would take them
            raise TypeError
        value = complex(ior)
    except (TypeError, ValueError):
        raise ArgumentError(
            f"{name} = {ior!r}: must be a number n + ik, [n, k], a material's name, or a function of wavelength_nm"
        ) from None
    if not (cmath.isfinite(value) and 0.0 < value.real <= 1e8 and 0.0 <= value.imag <= 1e8):
        raise ArgumentError(f"{name} = {value}: n must be above 0 and k at least 0, both at most 1e8")
    return value


def index_at(ior: Any, wavelength_nm: float, name: str = "ior") -> complex:
    """The complex index n + ik of a checked `Index` at a wavelength [nm]."""
    if isinstance(ior, complex):
        return ior
    value = _material_at(ior, wavelength_nm) if isinstance(ior, str) else ior(wavelength_nm)
    return _valid_index(value, f"{name} at {wavelength_nm:g} nm")


def indices_at(ior: Any, wavelength_nm: Floats) -> NDArray[np.complex128]:
    """n + ik at wavelengths [nm] (n,), of a material's name, a function of wavelengths, one number or n of them."""
    index: Any = _material(ior) if isinstance(ior, str) else ior
    return np.broadcast_to(np.asarray(index(wavelength_nm) if callable(index) else index), wavelength_nm.shape)
