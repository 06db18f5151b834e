"""What the options of the analysis' commands stand for."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from gonio.errors import ConfigError

if TYPE_CHECKING:
    from gonio_analysis.fitting.problem import FitRequest

T = TypeVar("T")


def read_radius(text: str) -> float | None:
    """Radius of the rim of polar plots from a command line; None is "auto": each by what it shows.

    Raises
    ------
    ConfigError
        Neither "auto" nor a number above 0.
    """
    if text == "auto":
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise ConfigError(f"--radius {text}: a number above 0, or: auto")
    return value


def with_u_ior(asked: FitRequest, text: str, wavelength_nm: float) -> FitRequest:
    """The fit with optical constants that are known no better than --u-ior says: they move, and priors hold them.

    Raises
    ------
    ConfigError
        There are no constants, or it is neither a number between 0 and 1 nor "sources".
    """
    from gonio import materials

    ior = asked.ior
    if not isinstance(ior, str | complex) or asked.each is not None:
        raise ConfigError(f"--u-ior {text}: goes with --ior NAME or n+kj, and with one wavelength (no --joint)")
    index = complex(materials.ior(ior)(wavelength_nm)) if isinstance(ior, str) else ior
    if text == "sources":
        if not isinstance(ior, str):
            raise ConfigError("--u-ior sources: goes with a material's name; give a relative uncertainty, as 0.02")
        u_n, u_k = materials.spread(ior, wavelength_nm)
    else:
        try:
            relative = float(text)
        except ValueError:
            relative = math.nan
        if not 0.0 < relative < 1.0:
            raise ConfigError(f"--u-ior {text}: a relative standard uncertainty between 0 and 1, or: sources")
        u_n, u_k = relative * index.real, relative * index.imag
    moved = {"ior": (index.real, u_n), **({"k": (index.imag, u_k)} if index.imag > 0 and u_k > 0 else {})}
    twice = set(moved) & {*(asked.fix or {}), *asked.free, *(asked.priors or {})}
    if twice:
        raise ConfigError(f"--u-ior {text}: {min(twice)} is given to --fix, --free or --prior as well; leave one out")
    fix = asked.fix if "k" in moved else {**(asked.fix or {}), "k": index.imag}
    return replace(
        asked, ior=index, fix=fix, free=(*asked.free, *moved), priors={**(asked.priors or {}), **moved}, separate=True
    )


def names_of(models: str) -> list[str]:
    """The models that --models lists."""

    names = [name.strip() for name in models.split(",")]
    if not all(names):
        raise ConfigError(f'--models "{models}": a name is missing; they are separated by single commas')
    return names


def once(option: str, pairs: list[tuple[str, T]]) -> dict[str, T]:
    """What an option says of each name; `ConfigError` where it says two things of one."""

    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{option} {name}=...: is given {names.count(name)} times; say it once")
    return dict(pairs)


def read_fixed(text: str) -> tuple[str, float | str]:
    """NAME=VALUE from a command line; a value that is no number stays a word.

    Raises
    ------
    ConfigError
        There is no "=", or a side of it is empty, or the number is not finite.
    """

    name, _, value = (part.strip() for part in text.partition("="))
    if not name or not value:
        raise ConfigError(f"--fix {text}: NAME=VALUE is needed, as in --fix tau_um=1.77")
    try:
        number = float(value)
    except ValueError:
        return name, value
    if not math.isfinite(number):
        raise ConfigError(f"--fix {text}: the value has to be finite")
    return name, number


def read_bound(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=LOW:HIGH from a command line.

    Raises
    ------
    ConfigError
        It is written otherwise, or a number is none.
    """
    return _read_two(text, "--bound", ":", "NAME=LOW:HIGH", "tau_um=0.5:5")


def read_prior(text: str) -> tuple[str, tuple[float, float]]:
    """NAME=VALUE+-U from a command line; "±" is taken too.

    Raises
    ------
    ConfigError
        It is written otherwise, or a number is none.
    """
    return _read_two(text.replace("±", "+-"), "--prior", "+-", "NAME=VALUE+-U", "tau_um=1.77+-0.05")


def _read_two(text: str, option: str, between: str, form: str, example: str) -> tuple[str, tuple[float, float]]:

    name, _, numbers = text.partition("=")
    first, _, second = numbers.partition(between)
    try:
        return name.strip(), (float(first), float(second))
    except ValueError:
        raise ConfigError(f"{option} {text}: {form} is needed, as in {option} {example}") from None
