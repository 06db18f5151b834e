"""Models that are written in numpy: what somebody's own model needs no compiled kernel for."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from gonio.errors import ArgumentError
from gonio.models import engine
from gonio.models.engine import Geometry
from gonio.models.model import Model
from gonio.models.parameters import Parameters, checked_wavelength
from gonio.typing import ArrayLike, Floats

GRAZING = 1e-12
"""Least cosine of formulas that divide by it."""


class ArrayModel(Model):
    """A model by one function of arrays of unit vectors, as somebody's own is: `evaluate`.

    A model whose BRDF depends on both azimuths, and not on their difference alone, says so by `depends_on_azimuth`.
    """

    @abstractmethod
    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        """BRDF [1/sr], (n,), at unit vectors (n, 3) toward source and detector.

        The vectors are in the sample's frame, x along its own direction and z its normal. Both z are at least 0: where
        one is below the surface the BRDF is 0, and nobody asks.
        """

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
        where = engine.geometry(theta_i, phi_i, theta_r, phi_r)
        return self.at(where, wavelength_nm=float(np.asarray(wavelength_nm)), out=out)

    def brdf_vectors(
        self, omega_i: ArrayLike, omega_r: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None
    ) -> Any:
        if np.ndim(wavelength_nm) > 0:
            return super().brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm, out=out)
        vectors, shape = engine.vector_arrays(omega_i, omega_r)
        engine.check_vectors(vectors)
        source, detector = (np.broadcast_to(v, (*shape, 3)).reshape(-1, 3) for v in vectors)
        values = self._checked(source, detector, checked_wavelength(wavelength_nm)).reshape(shape)
        single = engine.all_single(omega_i, omega_r)
        return engine.delivered(out, values.astype(np.float32) if single else values)

    def at(self, geometry: Geometry, *, wavelength_nm: float = 550.0, out: Any = None) -> Any:
        wave = checked_wavelength(wavelength_nm)
        values = self._checked(geometry.omega_i.reshape(-1, 3), geometry.omega_r.reshape(-1, 3), wave)
        return engine.delivered(out, values.reshape(geometry.shape))

    def _checked(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        above = (omega_i[:, 2] >= 0.0) & (omega_r[:, 2] >= 0.0)
        out = np.zeros(above.size)
        values = np.asarray(self.evaluate(omega_i[above], omega_r[above], wavelength_nm), dtype=np.float64)
        if values.shape not in ((), (int(above.sum()),)):
            raise ArgumentError(f"{self.name}: evaluate gave the shape {values.shape} for {int(above.sum())} pairs")
        out[above] = values
        return out


class Exchanged(ArrayModel):
    """A model with source and detector exchanged: itself where it is reciprocal."""

    name: ClassVar[str] = "exchanged"

    def __init__(self, model: Model) -> None:
        self.model = model

    @property
    def parameters(self) -> Parameters:
        return self.model.parameters

    @property
    def convention(self) -> str:
        return f"{self.model.convention} With source and detector exchanged."

    def evaluate(self, omega_i: Floats, omega_r: Floats, wavelength_nm: float) -> Floats:
        return np.asarray(self.model.brdf_vectors(omega_r, omega_i, wavelength_nm=wavelength_nm))
