"""Reflectance models of the papers: one file a paper, on one kernel layer (docs/reference/models_and_parameters.md)."""

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from gonio.errors import ArgumentError
from gonio.models import fresnel, htsg
from gonio.models.abg import ABg
from gonio.models.anisotropic import AnisotropicFacets
from gonio.models.arrays import ArrayModel
from gonio.models.blinn import Blinn, Phong
from gonio.models.cook_torrance import CookTorrance
from gonio.models.corrected import Corrected, Correction
from gonio.models.engine import Geometry, geometry
from gonio.models.eon import EON
from gonio.models.examine import examine
from gonio.models.ggx import GGX, GGXMultiscatter
from gonio.models.hapke import Hapke
from gonio.models.he_torrance import HeTorrance
from gonio.models.k_correlation import KCorrelation
from gonio.models.lambert import DiffuseTransmitter, Lambert
from gonio.models.model import Model, build_model
from gonio.models.oren_nayar import OrenNayar
from gonio.models.parameters import Fitted, parameter
from gonio.models.retroreflecting import Retroreflecting
from gonio.models.rpv import RPV
from gonio.models.spectral import SpectralModel
from gonio.models.sum import Sum
from gonio.spectra import spectra_in

__all__ = [
    "EON",
    "GGX",
    "RPV",
    "ABg",
    "AnisotropicFacets",
    "ArrayModel",
    "Blinn",
    "CookTorrance",
    "Corrected",
    "Correction",
    "DiffuseTransmitter",
    "Fitted",
    "GGXMultiscatter",
    "Geometry",
    "Hapke",
    "HeTorrance",
    "KCorrelation",
    "Lambert",
    "Model",
    "OrenNayar",
    "Phong",
    "Retroreflecting",
    "SpectralModel",
    "Sum",
    "build",
    "examine",
    "fresnel",
    "geometry",
    "htsg",
    "parameter",
]

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """A model that is registered by its entry point alone."""
        from gonio import plugins

        for point in plugins.available("gonio.models").values():
            if point.attr == name and point.module != __name__:
                return plugins.load("gonio.models", point.name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def build(name: str, parameters: Mapping[str, Any]) -> Model:
    """A model by its command-line name, ours or a plugin's, from named parameters.

    "sum" takes what `Sum.parameters` returns: one table a term, under its model's name, with a `weight` (1 if it is
    left out) beside the model's own parameters. A number after the name tells terms of the same model apart, as in
    "cook-torrance 1" and "cook-torrance 2". "corrected" takes what `Corrected.parameters` returns: the table of a model
    under its name, and the table "misfit". A number may be a spectrum (`gonio.spectra`): that makes a `SpectralModel`.

    Raises
    ------
    ConfigError
        There is no such model (with the nearest name).
    ArgumentError
        A parameter is unknown (with the nearest name) or outside its range.

    Examples
    --------
    >>> from gonio.models import build
    >>> build("he-torrance", {"sigma0_um": 0.2, "tau_um": 2.0, "ior": "Al"}).name
    'he-torrance'
    """
    from gonio import plugins

    if spectra_in(parameters):
        return SpectralModel(name, dict(parameters), partial(build, name))
    if name == DiffuseTransmitter.name:  # as a sum no entry point: nothing is fitted with it
        return build_model(DiffuseTransmitter, name, parameters)
    if name == Sum.name:
        return Sum(*(_term(key, values) for key, values in parameters.items()))
    if name == Corrected.name:
        return _corrected(parameters)
    return build_model(plugins.load("gonio.models", name), name, parameters)


def _term(key: str, values: Any) -> tuple[Model, float]:
    """One term of a sum, from its table."""
    if not isinstance(values, Mapping):
        raise ArgumentError(f'the term "{key}" of a sum must be a table with the parameters of a model and its weight')
    kind = key.rstrip("0123456789").rstrip()
    return build(kind, {n: v for n, v in values.items() if n != "weight"}), values.get("weight", 1.0)


def _corrected(parameters: Mapping[str, Any]) -> Model:
    """A model and its misfit, each from its table."""
    names = [name for name in parameters if name != "misfit"]
    if len(names) != 1 or "misfit" not in parameters or not isinstance(parameters[names[0]], Mapping):
        raise ArgumentError(
            f'"{Corrected.name}" takes the table of one model under its name and the table "misfit"; it has'
            f" {', '.join(parameters) or 'none'}"
        )
    return Corrected.of(build(names[0], parameters[names[0]]), parameters["misfit"])
