"""Models' parameters: numbers in their ranges, names among a few, indices of refraction; and what a fit may move.

The table of a model's file is its fields: each is a `parameter` with its default, allowed range, text, unit and search.
The constructor's checks, bounds of fits, docstrings, reports and docs/models_and_parameters.md come from it.
`Model.declaration` says what a fit may move. A class that says no more gets the plain one (`plain`); ours say more
where parameters hang together: optical constants that are known, shares that add up to 1, starts on a coarse grid.
"""

import cmath
import functools
import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal, TypeAlias, cast

import numpy as np

from gonio.errors import ArgumentError, ConfigError, did_you_mean, refuse_masked
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
    """Scale on which the search moves; "log" for lengths, widths and indices."""
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


def number(
    name: str, value: Any, low: float = -math.inf, high: float = math.inf, unit: str = "", allowed: str = ""
) -> float:
    """A real parameter in [low, high], a range that `allowed` may word; raises `ArgumentError` naming it otherwise."""
    if type(value) is float and low <= value <= high and math.isfinite(value):  # as most: fits make very many models
        return value
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
        allowed = allowed or (f"at least {low:g}" if math.isinf(high) else f"in [{low:g}, {high:g}]")
        raise ArgumentError(
            f"{name} = {result:g}{unit and ' ' + unit}: must be "
            f"{'finite' if math.isinf(low) and math.isinf(high) else 'finite and ' + allowed}"
        )
    return result


def checked_wavelength(value: Any) -> float:
    """A wavelength [nm] in [1e-6, 1e12]: from gamma rays to radio; raises `ArgumentError` otherwise."""
    return number("wavelength_nm", value, 1e-6, 1e12, unit="nm")


def choice(name: str, value: Any, allowed: Sequence[str]) -> str:
    """One of a few names; raises `ArgumentError` with the nearest of them otherwise."""
    if isinstance(value, str) and value in allowed:
        return str(value)
    listed, hint = ", ".join(f'"{option}"' for option in allowed), did_you_mean(str(value), allowed)
    raise ArgumentError(f"{name} = {value!r}: must be one of {listed}" + (hint and f"; {hint}"))


def flag(name: str, value: Any) -> bool:
    """True or False; raises `ArgumentError` otherwise."""
    if not isinstance(value, (bool, np.bool_)):
        raise ArgumentError(f"{name} = {value!r}: must be true or false")
    return bool(value)


@functools.lru_cache(maxsize=64)
def _material(name: str) -> Callable[[float], complex]:
    from gonio import materials

    return cast(Callable[[float], complex], materials.ior(name))


@functools.lru_cache(maxsize=1024)
def _material_at(name: str, wavelength_nm: float) -> complex:
    return complex(_material(name)(wavelength_nm))


def checked_index(ior: Any) -> Any:
    """An `Index` argument in its stored form: a complex number, a material's name, or a function."""
    if isinstance(ior, str):
        _material(ior)
        return ior
    if callable(ior):
        return ior
    if isinstance(ior, (list, tuple)) or (isinstance(ior, np.ndarray) and ior.ndim > 0):
        if len(ior) != 2:
            raise ArgumentError(f"ior = {ior!r}: a list must be [n, k]")
        return _valid_index(complex(number("ior[0]", ior[0]), number("ior[1]", ior[1])), "ior")
    return _valid_index(ior, "ior")


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


def index_at(ior: Any, wavelength_nm: float) -> complex:
    """The complex index n + ik of a checked `Index` at a wavelength [nm]."""
    if isinstance(ior, complex):
        return ior
    value = _material_at(ior, wavelength_nm) if isinstance(ior, str) else ior(wavelength_nm)
    return _valid_index(value, f"ior at {wavelength_nm:g} nm")


def indices_at(ior: Any, wavelength_nm: Floats) -> NDArray[np.complex128]:
    """n + ik at wavelengths [nm] (n,), of a material's name, a function of wavelengths, one number or n of them."""
    index: Any = _material(ior) if isinstance(ior, str) else ior
    return np.broadcast_to(np.asarray(index(wavelength_nm) if callable(index) else index), wavelength_nm.shape)


# --- the table of a model's file ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Parameter:
    """A row of the table (`row`)."""

    default: Any
    text: str
    unit: str
    range: str
    """What the constructor takes, in words; "" for what only `text` can say."""
    checked: Callable[[str, Any], Any]
    """(name, value) -> the value as the model holds it; raises `ArgumentError` naming it."""
    fitted: Fitted | None
    """What a fit may do with it; None: nothing."""

    @property
    def told(self) -> str:
        """Text, range and unit as sentences."""
        return f"{self.text} {self.range[:1].upper()}{self.range[1:]}." if self.range else self.text


def row(
    default: Any,
    allowed: str | tuple[str, ...] | Callable[[str, Any], Any],
    text: str,
    unit: str = "",
    *,
    scale: Literal["linear", "log"] | None = None,
    bounds: tuple[float, float] | None = None,
    starts: tuple[float, ...] | Literal["diffuse", "peak"] = (),
    geometry: bool = False,
) -> Parameter:
    """All that is said anywhere of one argument of a model's constructor.

    Parameters
    ----------
    default
        As of any field. Where it is None, None is taken too. `MISSING` where an `__init__` of the class's own has it.
    allowed
        Of a number its range, as "[0, 1]", "(0, inf)" or "[0, 90)"; of a word those that there are; else
        what checks it: (name, value) -> value.
    text
        What it is, in sentences; without range and unit.
    unit
        Of a number.
    scale
        On which a fit's search moves it, as in `Fitted`; None: a fit leaves it alone.
    bounds
        Of a fit, where they are narrower than the range.
    starts, geometry
        As in `Fitted`.
    """
    if not isinstance(allowed, str):
        words = "one of " + ", ".join(f'"{one}"' for one in allowed) if isinstance(allowed, tuple) else ""
        check = functools.partial(choice, allowed=allowed) if isinstance(allowed, tuple) else allowed
        return Parameter(default, text, unit, words, check, None)
    low, high = (float(end) for end in allowed[1:-1].split(","))
    words = f"in {allowed}" if math.isfinite(high) else f"{'above' if allowed[0] == '(' else 'at least'} {low:g}"
    least = math.nextafter(low, high) if allowed[0] == "(" else low
    most = math.nextafter(high, low) if allowed[-1] == ")" and math.isfinite(high) else high
    checked = functools.partial(number, low=least, high=most, unit=unit, allowed=words)
    fitted = scale and Fitted(*(bounds or (least, most)), scale, unit, starts, geometry=geometry)
    return Parameter(default, text, unit, f"{words} {unit}".strip(), checked, fitted or None)


def parameter(default: Any, *of: Any, **search: Any) -> Any:
    """A field of a model's class with its row of the table; arguments as `row`.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from gonio.models import ArrayModel, parameter
    >>> @dataclass(frozen=True)
    ... class Own(ArrayModel):
    ...     level: float = parameter(0.1, "[0, 1]", "How bright it is.", scale="linear", starts="diffuse")
    >>> Own.fitted["level"].upper
    1.0
    """
    return field(default=default, metadata={"parameter": row(default, *of, **search)})


INDEX = (
    lambda name, value: checked_index(value),  # a model has one, and it is `ior`
    "Index n + ik: a complex number, [n, k], a material's name, or a function of wavelength_nm.",
)
"""What is allowed of an `Index`, and its text."""
FURTHER = {
    "k": "Imaginary part of the index n + ik: absorption.",
    "weight": "Weight of the glossy model in the sum.",
    "m_1": "Rms slope of the first kind of facets.",
    "m_2": "Rms slope of the second kind of facets.",
    "w_1": "Share of the facets of slope m_1, in [0, 1].",
    "w_2": "Share of the facets of slope m_2: 1 - w_1.",
    "slope_m": "Rms slope of the surface, 2 sigma0 / tau.",
}
"""What fits name and constructors do not take, or under another name."""
_NAMES = re.compile(r"(\w+(?:, \w+)*)(?: : .*)?")


def described(*kinds: type) -> dict[str, str]:
    """What each parameter of models is, in a line, as "Parameters" in the docstrings of their classes say it.

    Of two that have a parameter of one name the first is told.
    """
    found: dict[str, str] = {}
    for doc in (one.__doc__ for kind in kinds for one in kind.__mro__ if "__doc__" in vars(one)):
        names: list[str] = []
        own: dict[str, str] = {}
        for line in re.split(r"\n\n(?=\S)", _parameters(doc or ""))[0].split("\n"):
            if line[:1].strip() and (match := _NAMES.fullmatch(line)):
                names = match[1].split(", ")
            for name in names:
                own[name] = f"{own[name]} {line.strip()}".strip() if line[:1] == " " else own.get(name, "")
        found = own | found
    return {name: text.replace("`", "") for name, text in (FURTHER | found).items()}


def _parameters(doc: str) -> str:
    _, _, rest = inspect.cleandoc(doc).partition("\nParameters\n----------\n")
    return re.split(r"\n\n\w+\n-+\n", rest)[0]


# --- what a fit may move of a model, and where it begins: one declaration a model, ours as a third party's --------


Values = dict[str, float]
Arguments: TypeAlias = "dict[str, float | complex | str | tuple[tuple[float, float], ...] | Arguments]"
"""Of a model's constructor; of a sum, those of its parts by their names."""
Ior = complex | str | None
"""A constant n + ik, the name of a material, or None: not given."""

ALBEDO = (1e-6, 1.0)
"""Bounds of a fit of an albedo: at 0 no other parameter would count."""
OPTICAL = {"ior": Fitted(1.001, 200.0, "log"), "k": Fitted(0.0, 100.0)}
METALLIC_N = Fitted(0.02, 200.0, "log")
"""n where k is fitted too: good conductors have n < 1, which without absorption means total reflection."""


@dataclass(frozen=True)
class Levels:
    """What starts are made of: albedos that Lambertian reflectors of these values would have, and the wavelength."""

    diffuse: float
    """Albedo of the lower values."""
    median: float
    peak: float
    """Albedo of the highest values."""
    wavelength_um: float


@dataclass(frozen=True)
class Declaration:
    """A model as a fit sees it."""

    name: str
    parameters: Mapping[str, Fitted]
    """All that can be fitted."""
    free: tuple[str, ...]
    """Parameters that are fitted unless the user says otherwise."""
    fixed: Values
    """Values of those that are not fitted unless the user frees them."""
    arguments: Callable[[Values], Arguments]
    """Parameter values -> arguments of the model's constructor."""
    starts: Callable[[Levels], list[Values]]
    """Coarse grid over the parameters that the model depends on strongly (values for those only)."""
    needs_wavelength: bool = False
    derived: Callable[[Values], Values] = lambda values: {}
    """Combinations of parameters that are easier to interpret than these."""
    flat: Callable[[Values], Values] = lambda values: {}
    """d(model)/d(parameter) [1/sr] of the parameters whose effect is the same in every direction."""
    base_starts: Callable[[float], list[Values]] = lambda albedo: [{"albedo": albedo}]
    """The same where it is the base of a sum, from the albedo of the lower values."""
    stated: Callable[[Values], Values] = lambda values: values
    """Of the values that make one and the same model, those by which it is stated."""

    def parameter(self, name: str) -> Fitted:
        """The parameter of that name.

        Raises
        ------
        ConfigError
            The model has none (with the nearest name).
        """
        if name not in self.parameters:
            hint = did_you_mean(name, self.parameters, f"it has: {', '.join(self.parameters)}")
            raise ConfigError(f'{self.name} has no parameter "{name}" that can be fitted or fixed; {hint}')
        return self.parameters[name]


def plain(name: str, rows: Mapping[str, Fitted], needs_wavelength: bool = False) -> Declaration:
    """Of a model whose parameters are its constructor's arguments, each with bounds and starts of its own.

    Raises
    ------
    ConfigError
        It declares nothing, or something else than `Fitted`.
    """
    if not rows:
        raise ConfigError(
            f'the model "{name}" does not say what of it is fitted: its class needs `fitted`, bounds and scales by'
            " the names of its parameters"
        )
    for key, row in rows.items():
        if not isinstance(row, Fitted):
            raise ConfigError(f'the model "{name}": fitted["{key}"] has to be a gonio.models.Fitted, not {row!r}')
    free = tuple(key for key, row in rows.items() if row.fixed is None)

    def starts(levels: Levels) -> list[Values]:
        grid = [[rows[key].inside(x) for x in _starts(rows[key], levels)] for key in free]
        return [dict(zip(free, values, strict=True)) for values in product(*grid)]

    fixed = {key: row.fixed for key, row in rows.items() if row.fixed is not None}
    return Declaration(name, rows, free, fixed, lambda v: {n: v[n] for n in rows if n in v}, starts, needs_wavelength)


def optical(
    name: str,
    rows: Mapping[str, Fitted],
    ior: Ior,
    starts: Callable[[Levels], list[Values]],
    *,
    only_freed: tuple[str, ...] = (),
    needs_wavelength: bool = False,
    flat: Callable[[Values], Values] = lambda values: {},
    derived: Callable[[Values], Values] = lambda values: {},
    stated: Callable[[Values], Values] = lambda values: values,
) -> Declaration:
    """Of a model whose parameters are its constructor's arguments, and which has optical constants besides.

    `only_freed` names rows that the constructor does without: they are fitted where the user frees them.
    """
    free, fixed = tuple(n for n in rows if n not in only_freed), dict[str, float]()
    if ior is None:
        free, fixed = (*free, "ior"), {"k": 0.0}
    elif not isinstance(ior, str):
        fixed = {"ior": ior.real, "k": ior.imag}

    def arguments(values: Values) -> Arguments:
        return {**{n: x for n, x in values.items() if n in rows}, "ior": optical_argument(values, ior)}

    needs = needs_wavelength or isinstance(ior, str)
    declared = {**rows, **OPTICAL}
    return Declaration(name, declared, free, fixed, arguments, starts, needs, derived, flat, stated=stated)


def _starts(row: Fitted, levels: Levels) -> list[float]:
    if row.starts == "diffuse":
        return [levels.diffuse]
    if row.starts == "peak":
        return [part * levels.peak for part in (0.03, 0.3, 1.0)]
    if row.starts:
        return [float(x) for x in row.starts]
    low, high = row.lower, row.upper
    return [low ** (1 - q) * high**q if row.scale == "log" else low + (high - low) * q for q in (0.2, 0.5, 0.8)]


def optical_argument(values: Values, ior: Ior) -> float | complex | str:
    """`ior` of the constructor."""
    if isinstance(ior, str):
        return ior
    return complex(values["ior"], values["k"]) if values["k"] else values["ior"]
