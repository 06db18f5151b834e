"""Numbers of a scene file that may depend on the wavelength: a number, or a table of wavelengths and values."""

import itertools
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator, model_validator

from gonio.config import Strict
from gonio.errors import ConfigError
from gonio.typing import Floats

WAVELENGTHS = (1e-6, 1e12)
"""What a wavelength may be [nm]: from gamma rays to radio, as for the models."""
Wavelength = Annotated[float, Field(ge=WAVELENGTHS[0], le=WAVELENGTHS[1])]
MAX_WAVELENGTHS = 1000


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
        ConfigError
            The wavelength lies outside the table.
        """
        first, last = self.wavelength_nm[0], self.wavelength_nm[-1]
        if not first <= wavelength_nm <= last:
            raise ConfigError(
                f"a spectrum from {first:g} to {last:g} nm has no value at {wavelength_nm:g} nm: extend the table, or "
                "change wavelength_nm"
            )
        return float(np.interp(wavelength_nm, self.wavelength_nm, self.value))


class NonNegativeSpectrum(Spectrum):
    """A spectrum without a value below 0: of a light, or of a reflectance."""

    @model_validator(mode="after")
    def _not_negative(self) -> "NonNegativeSpectrum":
        if min(self.value) < 0:
            raise ValueError(f"value holds {min(self.value):g}: must be at least 0")
        return self


def table_or(table: type[Strict], otherwise: str) -> WrapValidator:
    """For a key that holds a table or something else (`otherwise`, in words): errors name the key that is wrong."""

    def check(value: Any, handler: ValidatorFunctionWrapHandler) -> Any:
        if not isinstance(value, dict):
            try:
                return handler(value)
            except ValidationError:
                raise ValueError(f"must be {otherwise}, or a table with {' and '.join(table.model_fields)}") from None
        try:
            return table.model_validate(value)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"])
            message = first["msg"].removeprefix("Value error, ")
            raise ValueError(f"{key + ': ' if key else ''}{message[:1].lower()}{message[1:]}") from None

    return WrapValidator(check)


Spectral = Annotated[
    Annotated[float, Field(ge=0)] | NonNegativeSpectrum, table_or(NonNegativeSpectrum, "a number of at least 0")
]
"""A number at least 0, the same at every wavelength, or a table."""


class Range(Strict):
    """Wavelengths from `start` to `stop`, both included where the step fits [nm]."""

    start: Wavelength
    stop: Wavelength
    step: Annotated[float, Field(gt=0)]

    @model_validator(mode="after")
    def _sound(self) -> "Range":
        if self.stop < self.start:
            raise ValueError("needs start <= stop")
        if (self.stop - self.start) / self.step >= MAX_WAVELENGTHS:
            raise ValueError(f"has more than {MAX_WAVELENGTHS} wavelengths; take a larger step")
        return self

    def all(self) -> tuple[float, ...]:
        """Every wavelength [nm]."""
        count = int((self.stop - self.start) / self.step + 1.0 + 1e-9)
        return tuple(self.start + k * self.step for k in range(count))


def values(spectral: float | Spectrum, wavelength_nm: Floats) -> Floats:
    """A spectral number at wavelengths, of their shape."""
    if isinstance(spectral, Spectrum):
        return np.array([spectral.at(wave) for wave in wavelength_nm])
    return np.full(wavelength_nm.shape, float(spectral))


def is_table(value: Any) -> bool:
    """Whether a parameter of a model is meant as a spectrum."""
    return isinstance(value, dict) and set(value) == {"wavelength_nm", "value"}
