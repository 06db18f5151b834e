"""Numbers of a file that depend on the wavelength: parameters of samples and of materials of scenes, values of lights.

A spectrum is a table `{ wavelength_nm = [...], value = [...] }` in the place of a number. Three channels are one, too:
`{ red = ..., green = ..., blue = ... }`.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from gonio.config import Strict, parse
from gonio.errors import ArgumentError, ConfigError
from gonio.typing import Floats

WAVELENGTHS = (1e-6, 1e12)
"""What a wavelength may be [nm]: from gamma rays to radio, as for the models."""
Wavelength = Annotated[float, Field(ge=WAVELENGTHS[0], le=WAVELENGTHS[1])]
RGB_NM = {"red": 610.0, "green": 550.0, "blue": 465.0}
"""Nominal wavelengths [nm] of the channels of a file that has colours: where a model is evaluated for one."""
CHANNELS_NM = tuple(sorted(RGB_NM.values()))


class Spectrum(Strict):
    """Values at wavelengths, straight lines between them; nothing is said of wavelengths outside."""

    wavelength_nm: tuple[Wavelength, ...]
    value: tuple[float, ...]

    @model_validator(mode="after")
    def _sound(self) -> "Spectrum":
        if len(self.wavelength_nm) != len(self.value) or not self.value:
            raise ValueError(
                f"wavelength_nm has {len(self.wavelength_nm)} entries and value {len(self.value)}: "
                "they go together, and there must be one at least"
            )
        if any(b <= a for a, b in itertools.pairwise(self.wavelength_nm)):
            raise ValueError("wavelength_nm must grow from entry to entry")
        return self

    def at(self, wavelength_nm: float) -> float:
        """The value at a wavelength.

        Raises
        ------
        ArgumentError
            The wavelength lies outside the table.
        """
        first, last = self.wavelength_nm[0], self.wavelength_nm[-1]
        if not first <= wavelength_nm <= last:
            raise ArgumentError(
                f"a spectrum from {first:g} to {last:g} nm has no value at {wavelength_nm:g} nm: extend the table, or "
                "change wavelength_nm"
            )
        return float(np.interp(wavelength_nm, self.wavelength_nm, self.value))


class ChannelValues(Strict):
    """Values of the channels red, green and blue.

    They are broad bands: a value holds at the nominal wavelength of its channel (`RGB_NM`), between two of them lies a
    straight line, and beyond the last one its value goes on.
    """

    red: float
    green: float
    blue: float

    def at(self, wavelength_nm: float) -> float:
        """The value at a wavelength [nm]."""
        return float(np.interp(wavelength_nm, CHANNELS_NM, (self.blue, self.green, self.red)))


def is_spectrum(value: Any) -> bool:
    """Whether a value of a file is meant as a spectrum."""
    return isinstance(value, Mapping) and ("wavelength_nm" in value or not RGB_NM.keys().isdisjoint(value))


def spectra_in(parameters: Any, where: str = "") -> dict[str, Spectrum | ChannelValues]:
    """The spectra in nested tables and lists of parameters, by the path to each: `k_d`, `ior[0]`, `phong.k_s`.

    Raises
    ------
    ConfigError
        A table is none; the message names its path, the key and the value.
    """
    if is_spectrum(parameters):
        table = dict(parameters)
        return {
            where: parse(Spectrum, table, where) if "wavelength_nm" in table else parse(ChannelValues, table, where)
        }
    if isinstance(parameters, Mapping):
        inside = [(f"{where}.{key}" if where else str(key), value) for key, value in parameters.items()]
    elif isinstance(parameters, Sequence) and not isinstance(parameters, str):
        inside = [(f"{where}[{k}]", value) for k, value in enumerate(parameters)]
    else:
        return {}
    return {path: one for name, value in inside for path, one in spectra_in(value, name).items()}


def at_wavelength(parameters: Any, wavelength_nm: float, where: str = "") -> Any:
    """Nested tables and lists of parameters with the value at one wavelength [nm] in the place of every spectrum.

    Raises
    ------
    ConfigError
        As `spectra_in`; or a spectrum does not reach the wavelength.
    """
    if is_spectrum(parameters):
        try:
            return spectra_in(parameters, where)[where].at(wavelength_nm)
        except ConfigError as error:
            raise error if str(error).startswith(where) else type(error)(f"{where}: {error}") from None
    if isinstance(parameters, Mapping):
        return {k: at_wavelength(v, wavelength_nm, f"{where}.{k}" if where else str(k)) for k, v in parameters.items()}
    if isinstance(parameters, Sequence) and not isinstance(parameters, str):
        return [at_wavelength(v, wavelength_nm, f"{where}[{k}]") for k, v in enumerate(parameters)]
    return parameters


def nodes_nm(spectra: Sequence[Spectrum | ChannelValues]) -> Floats:
    """The wavelengths [nm] at which spectra state values, ascending, as far as all of them reach.

    Raises
    ------
    ConfigError
        No wavelength is within all of them.
    """
    tables = [one for one in spectra if isinstance(one, Spectrum)]
    low = max((one.wavelength_nm[0] for one in tables), default=CHANNELS_NM[0])
    high = min((one.wavelength_nm[-1] for one in tables), default=CHANNELS_NM[-1])
    stated = [w for one in tables for w in one.wavelength_nm]
    stated += CHANNELS_NM if len(tables) < len(spectra) else ()
    if low > high:
        raise ConfigError(f"one spectrum begins at {low:g} nm and another ends at {high:g} nm: let them overlap")
    return np.unique([w for w in stated if low <= w <= high])
