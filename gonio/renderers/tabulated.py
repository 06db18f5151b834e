"""A measured table as a model: every direction, and every wavelength between those of the table."""

import copy
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from gonio import measurement
from gonio.errors import ConfigError
from gonio.models import ArrayModel
from gonio.models.parameters import Parameters
from gonio.renderers.channels import spectral
from gonio.renderers.interpolated import Interpolated
from gonio.renderers.measured import remarks
from gonio.typing import Bools, DataFrame, Floats


class Tabulated(ArrayModel):
    """The BRDF of a table, as `Interpolated` fills it in; straight lines between its wavelengths.

    Parameters
    ----------
    table
        A measurement table of one sample. One that tells no wavelength holds at all of them; samples named red, green
        and blue are at 610, 550 and 465 nm, and hold beyond.
    name
        Of the sample.

    Raises
    ------
    DataError
        As `gonio.renderers.channels.rows` and `Interpolated`.
    """

    name: ClassVar[str] = "table"

    def __init__(self, table: DataFrame, name: str) -> None:
        colours = "sample" in table.columns
        rows, self.wavelength_nm = spectral(table if colours else measurement.unpolarised(table), name)
        self.sample = name
        self.interpolated = Interpolated(rows)
        self.remarks = tuple(remarks(rows, self.interpolated))
        """What was not measured, a sentence each."""
        self._alone = False
        self._known: dict[tuple[bytes, bool], Floats] = {}
        self.within = (0.0, np.inf) if colours or not self.wavelength_nm.size else tuple(self.wavelength_nm[[0, -1]])
        """The first and the last wavelength [nm] that it holds at."""

    @property
    def parameters(self) -> Parameters:
        return {}

    @property
    def convention(self) -> str:
        return "A measured table, interpolated between its directions."

    @property
    def constant(self) -> bool:
        """Whether it is the same at all wavelengths."""
        return self.wavelength_nm.size <= 1

    def require(self, wavelength_nm: float) -> None:
        """Raise `ConfigError` for a wavelength that was not measured, and lies between none that were."""
        first, last = self.within
        if not first - SAME_NM <= wavelength_nm <= last + SAME_NM:
            measured = f"{first:g} to {last:g} nm" if last > first else f"{first:g} nm alone"
            raise ConfigError(
                f"{self.sample}: was measured at {measured}, not at {wavelength_nm:g} nm: change wavelength_nm"
            )

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        return np.asarray(self._values(omega_i, omega_r) @ self._weights([wavelength_nm])[:, 0])

    def _spectra(self, arguments: list[Floats], waves: list[float]) -> Floats:
        if len(arguments) != 2:
            return super()._spectra(arguments, waves)
        omega_i, omega_r = (a.reshape(-1, 3) for a in arguments)
        above = (omega_i[:, 2] >= 0.0) & (omega_r[:, 2] >= 0.0)
        out = np.zeros((len(waves), above.size))
        out[:, above] = (self._values(omega_i[above], omega_r[above]) @ self._weights(waves)).T
        return out

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        """As of every model, within about 1e-4 whatever the tolerance."""
        key = (theta.tobytes(), viewer)
        if key not in self._known:
            self._known = {key: self.interpolated.reflectance(theta, viewer=viewer, nodes=NODES)}
        return np.asarray(self._known[key] @ self._weights([wavelength_nm])[:, 0])

    def _weights(self, waves: list[float]) -> Floats:
        """What each channel counts for at some wavelengths, (channels, wavelengths)."""
        if self.constant:
            return np.ones((1, len(waves)))
        each = np.eye(self.wavelength_nm.size)
        return np.stack([np.interp(waves, self.wavelength_nm, one) for one in each])

    def _values(self, omega_i: Floats, omega_r: Floats) -> Floats:
        values = self.interpolated.brdf(omega_i, omega_r)
        return values * self.measured(omega_i, omega_r)[:, np.newaxis] if self._alone else values

    def measured_alone(self) -> Self:
        """The same table, with 0 wherever it would be extrapolated."""
        made = copy.copy(self)
        made._alone = True
        return made

    def measured(self, omega_i: Floats, omega_r: Floats) -> Bools:
        """Whether pairs of unit vectors (n, 3) lie among measured ones, or else are extrapolated."""
        return self.interpolated.measured(omega_i, omega_r)


SAME_NM = 0.5
"""Wavelengths this close are one [nm]."""
NODES = 160, 40
"""Half vectors of an integral over the hemisphere."""


def read(spec: str | Path) -> Tabulated:
    """The table in a file, a run, or FILE:SAMPLE, as a model.

    Raises
    ------
    ConfigError, DataError
        It is missing, or no table that can be filled in; the message names it.
    """
    path, sample = measurement.split(spec)
    table = measurement.read(path, sample=sample)
    return Tabulated(table, sample or table.attrs.get("sample") or Path(path).stem)
