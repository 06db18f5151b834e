"""What the options of the analysis' commands stand for."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gonio.models.declaration import Ior


def read_ior(text: str | None) -> Ior:
    """Optical constants from a command line: a complex number, a material's name, or None.

    Raises
    ------
    ConfigError
        Neither a number nor a known material, or a number that no material has.
    """
    if text is None:
        return None
    from gonio import materials
    from gonio.errors import ConfigError

    try:
        value = complex(text.replace(" ", "").replace("i", "j"))
    except ValueError:
        materials.ior(text)
        return text
    if not (0 < value.real < 1e4 and 0 <= value.imag < 1e4):
        raise ConfigError(f"--ior {text}: n is above 0 and k at least 0 (n + ik absorbs with k > 0)")
    return value


def read_fixed(text: str) -> tuple[str, float | str]:
    """NAME=VALUE from a command line; a value that is no number stays a word.

    Raises
    ------
    ConfigError
        There is no "=", or a side of it is empty, or the number is not finite.
    """

    from gonio.errors import ConfigError

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
    from gonio.errors import ConfigError

    name, _, numbers = text.partition("=")
    first, _, second = numbers.partition(between)
    try:
        return name.strip(), (float(first), float(second))
    except ValueError:
        raise ConfigError(f"{option} {text}: {form} is needed, as in {option} {example}") from None
