"""Weighted sums of models, as a rough diffuse base under a highlight (Oren and Nayar 1994, eq. 18)."""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from gonio.errors import ArgumentError
from gonio.models.engine import Geometry, delivered
from gonio.models.model import Model
from gonio.models.parameters import Parameters, number
from gonio.models.polarised import Light
from gonio.typing import ArrayLike, Floats


class Sum(Model):
    """A weighted sum of models: brdf = sum of weight times brdf [1/sr].

    Its specular spike is the weighted sum of those of its terms.

    Parameters
    ----------
    terms
        Pairs (model, weight), weights at least 0.

    Raises
    ------
    ArgumentError
        There is no term, or a term is not a model with a weight.
    """

    name: ClassVar[str] = "sum"

    def __init__(self, *terms: tuple[Model, float]) -> None:
        if not terms:
            raise ArgumentError("terms: a sum needs at least one pair (model, weight)")
        checked = []
        for j, term in enumerate(terms):
            if not (isinstance(term, (tuple, list)) and len(term) == 2 and isinstance(term[0], Model)):
                raise ArgumentError(f"terms[{j}] = {term!r}: must be a pair (model, weight)")
            checked.append((term[0], number(f"terms[{j}] weight", term[1], 0.0)))
        self.terms: tuple[tuple[Model, float], ...] = tuple(checked)
        """The pairs (model, weight)."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sum) and self.terms == other.terms

    def __hash__(self) -> int:
        return hash(self.terms)

    def __repr__(self) -> str:
        return f"Sum({', '.join(f'({model!r}, {weight!r})' for model, weight in self.terms)})"

    @property
    def parameters(self) -> Parameters:
        return {
            f"{model.name} {j + 1}": {"weight": weight, **model.parameters}
            for j, (model, weight) in enumerate(self.terms)
        }

    @property
    def convention(self) -> str:
        return "Sum of: " + " ".join(f"{weight:g} times {model.convention}" for model, weight in self.terms)

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
        return self._total(lambda m: m.brdf(theta_i, phi_i, theta_r, phi_r, wavelength_nm=wavelength_nm), out)

    def brdf_vectors(
        self, omega_i: ArrayLike, omega_r: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None
    ) -> Any:
        return self._total(lambda m: m.brdf_vectors(omega_i, omega_r, wavelength_nm=wavelength_nm), out)

    def at(self, geometry: Geometry, *, wavelength_nm: float = 550.0, out: Any = None) -> Any:
        return self._total(lambda m: m.at(geometry, wavelength_nm=wavelength_nm), out)

    def in_light(self, light: Light, evaluate: Callable[[Model], Floats], wavelength_nm: float) -> Floats:
        parts = (weight * m.in_light(light, evaluate, wavelength_nm) for m, weight in self.terms if weight > 0.0)
        return np.asarray(sum(parts, np.zeros(len(light.depolarised))))

    @property
    def depends_on_azimuth(self) -> bool:
        return any(model.depends_on_azimuth for model, _ in self.terms)

    @property
    def has_spike(self) -> bool:
        """Whether one of the terms has a specular spike."""
        return any(model.has_spike for model, _ in self.terms)

    def specular_reflectivity(self, theta_i: ArrayLike, *, wavelength_nm: ArrayLike = 550.0, out: Any = None) -> Any:
        return self._total(lambda m: m.specular_reflectivity(theta_i, wavelength_nm=wavelength_nm), out)

    def _hemispherical(
        self, theta: Floats, phi: Floats, wavelength_nm: float, viewer: bool, tolerance: float
    ) -> Floats:
        return np.asarray(self._total(lambda m: m._hemispherical(theta, phi, wavelength_nm, viewer, tolerance), None))

    def _total(self, evaluate: Callable[[Model], Any], out: Any) -> Any:
        # nothing is left of a term of weight 0, even where it is infinite
        values = ((weight, evaluate(model)) for model, weight in self.terms)
        total = sum(weight * value if weight > 0.0 else np.zeros_like(value) for weight, value in values)
        return total if out is None else delivered(out, total)
