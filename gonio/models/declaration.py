"""What a fit may move of a model, and where it begins: one declaration a model, ours as a third party's.

`Model.declaration` makes it. A class that says no more than `fitted` gets the plain one (`plain`); ours say more where
parameters hang together: optical constants that are known, shares that add up to 1, starts on a coarse grid.
"""

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TypeAlias

from gonio.errors import ConfigError
from gonio.models.parameters import Fitted

Values = dict[str, float]
Arguments: TypeAlias = "dict[str, float | complex | str | tuple[tuple[float, float], ...] | Arguments]"
"""Of a model's constructor; of a sum, those of its parts by their names."""
Ior = complex | str | None
"""A constant n + ik, the name of a material, or None: not given."""

ALBEDO = Fitted(1e-6, 1.0)
DIFFUSE = Fitted(0.0, 1.0)
OPTICAL = {"ior": Fitted(1.001, 200.0, "log"), "k": Fitted(0.0, 100.0)}
METALLIC_N = Fitted(0.02, 200.0, "log")
"""n where k is fitted too: good conductors have n < 1, which without absorption means total reflection."""


@dataclass(frozen=True)
class Levels:
    """What starts are made of: albedos that Lambertian reflectors of these values would have, and the wavelength."""

    diffuse: float
    """Of the lower values."""
    median: float
    peak: float
    """Of the highest."""
    wavelength_um: float


@dataclass(frozen=True)
class Declaration:
    """A model as a fit sees it."""

    name: str
    parameters: Mapping[str, Fitted]
    """All that can be fitted."""
    free: tuple[str, ...]
    """Those that are fitted unless the user says otherwise."""
    fixed: Values
    """Values of those that are not fitted unless the user frees them."""
    arguments: Callable[[Values], Arguments]
    """Parameter values -> arguments of the model's constructor."""
    starts: Callable[[Levels], list[Values]]
    """Coarse grid over the parameters that the model depends on strongly (values for those only)."""
    needs_wavelength: bool = False
    derived: Callable[[Values], Values] = lambda values: {}
    """Combinations that say more than the parameters do."""
    flat: Callable[[Values], Values] = lambda values: {}
    """d(model)/d(parameter) [1/sr] of the parameters whose effect is the same in every direction."""
    base_starts: Callable[[float], list[Values]] = lambda albedo: [{"albedo": albedo}]
    """The same where it is the base of a sum, from the albedo of the lower values."""

    def parameter(self, name: str) -> Fitted:
        """The parameter of that name.

        Raises
        ------
        ConfigError
            The model has none (with the nearest name).
        """
        if name not in self.parameters:
            near = difflib.get_close_matches(name, self.parameters, n=1)
            hint = f'did you mean "{near[0]}"?' if near else f"it has: {', '.join(self.parameters)}"
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
    return Declaration(name, {**rows, **OPTICAL}, free, fixed, arguments, starts, needs, derived, flat)


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
