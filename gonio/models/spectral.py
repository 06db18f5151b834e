"""A model whose parameters depend on the wavelength, as those of a sample that was fitted at several."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from gonio.errors import ConfigError
from gonio.models.engine import Geometry
from gonio.models.model import Model
from gonio.models.parameters import Parameters, checked_wavelength
from gonio.models.polarised import Light
from gonio.spectra import ChannelValues, at_wavelength, nodes_nm, spectra_in
from gonio.typing import ArrayLike, Floats


class SpectralModel(Model):
    """At each wavelength the model that has the values which its parameters have there.

    Parameters
    ----------
    kind
        The name of that model.
    parameters
        Its parameters in nested tables and lists, with a spectrum (`gonio.spectra`) in the place of a number.
    make
        Plain parameters -> the model, as `gonio.models.build` does for a name.

    Raises
    ------
    ConfigError
        A spectrum is none, or the model does not take the values at a wavelength.
    """

    name: ClassVar[str] = "spectral"

    def __init__(self, kind: str, parameters: Parameters, make: Callable[[Parameters], Model]) -> None:
        self.kind = kind
        self._parameters = parameters
        self._make = make
        self._made: dict[float, Model] = {}
        spectra = list(spectra_in(parameters).values())
        self.nodes_nm: Floats = nodes_nm(spectra)
        """The wavelengths [nm] at which its spectra state values, ascending."""
        self.of_channels = all(isinstance(one, ChannelValues) for one in spectra)
        """Whether its spectra are those of the channels red, green and blue."""
        for wave in self.nodes_nm:
            try:
                self.plain(float(wave))
            except ConfigError as error:
                raise type(error)(f"at {wave:g} nm, where a spectrum states a value: {error}") from None

    def plain(self, wavelength_nm: float) -> Model:
        """The model at a wavelength [nm]: its parameters are numbers.

        Raises
        ------
        ConfigError
            A spectrum does not reach the wavelength.
        """
        wave = checked_wavelength(wavelength_nm)
        if wave not in self._made:
            self._made[wave] = self._make(at_wavelength(self._parameters, wave))
        return self._made[wave]

    @property
    def middle(self) -> Model:
        """The model at the middle one of its wavelengths: what is the same at all of them is asked there."""
        return self.plain(float(self.nodes_nm[self.nodes_nm.size // 2]))

    @property
    def parameters(self) -> Parameters:
        return self._parameters

    def __repr__(self) -> str:
        ends = f"{self.nodes_nm[0]:g} to {self.nodes_nm[-1]:g} nm"
        return f"<{self.middle!r} of its kind, with parameters that change from {ends}>"

    @property
    def convention(self) -> str:
        return f"{self.middle.convention} With parameters that depend on the wavelength."

    @property
    def parameter_notes(self) -> Mapping[str, str]:
        return self.middle.parameter_notes

    @property
    def depends_on_azimuth(self) -> bool:
        return any(self.plain(float(wave)).depends_on_azimuth for wave in self.nodes_nm)

    @property
    def has_spike(self) -> bool:
        """Whether it has a specular spike."""
        return self.middle.has_spike

    def outside(self, wavelength_nm: float) -> str:
        return self.plain(wavelength_nm).outside(wavelength_nm)

    def in_light(self, light: Light, evaluate: Callable[[Model], Floats], wavelength_nm: float) -> Floats:
        return self.plain(wavelength_nm).in_light(light, evaluate, wavelength_nm)

    def btdf(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: float = 550.0,
    ) -> Floats:
        return self.plain(wavelength_nm).btdf(theta_i, phi_i, theta_r, phi_r, wavelength_nm=wavelength_nm)

    def brdf(
        self,
        theta_i: ArrayLike,
        phi_i: ArrayLike,
        theta_r: ArrayLike,
        phi_r: ArrayLike,
        *,
        wavelength_nm: ArrayLike = 550.0,
        out: Any = None,
    ) -> Any:
        if np.ndim(wavelength_nm) > 0:
            return super().brdf(theta_i, phi_i, theta_r, phi_r, wavelength_nm=wavelength_nm, out=out)
        wave = float(np.asarray(wavelength_nm))
        return self.plain(wave).brdf(theta_i, phi_i, theta_r, phi_r, wavelength_nm=wave, out=out)

    def brdf_vectors(
        self, omega_i: ArrayLike, omega_r: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None
    ) -> Any:
        if np.ndim(wavelength_nm) > 0:
            return super().brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm, out=out)
        wave = float(np.asarray(wavelength_nm))
        return self.plain(wave).brdf_vectors(omega_i, omega_r, wavelength_nm=wave, out=out)

    def at(self, geometry: Geometry, *, wavelength_nm: float = 550.0, out: Any = None) -> Any:
        return self.plain(wavelength_nm).at(geometry, wavelength_nm=wavelength_nm, out=out)

    def _spike(self, theta: Floats, wavelength_nm: float) -> Floats:
        return np.asarray(self.plain(wavelength_nm).specular_reflectivity(theta, wavelength_nm=wavelength_nm))

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        return self.plain(wavelength_nm)._hemispherical(theta, phi, wavelength_nm, viewer, tolerance)
