"""Reflectance models of the papers: one file a paper, on one compiled kernel layer (see docs/models.md)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gonio.models import fresnel, htsg
from gonio.models.base import Model, build_model
from gonio.models.blinn import Blinn, Phong
from gonio.models.cook_torrance import CookTorrance
from gonio.models.engine import Geometry, geometry
from gonio.models.he_torrance import HeTorrance
from gonio.models.lambert import Lambert
from gonio.models.oren_nayar import OrenNayar
from gonio.models.sum import Sum

__all__ = [
    "Blinn",
    "CookTorrance",
    "Geometry",
    "HeTorrance",
    "Lambert",
    "Model",
    "OrenNayar",
    "Phong",
    "Sum",
    "build",
    "fresnel",
    "geometry",
    "htsg",
]


def build(name: str, parameters: Mapping[str, Any]) -> Model:
    """A model by its command-line name, ours or a plugin's, from named parameters.

    Raises
    ------
    ConfigError
        There is no such model (with the nearest name).
    ArgumentError
        A parameter is unknown (with the nearest name) or outside its range.
    """
    from gonio import plugins

    return build_model(plugins.load("gonio.models", name), name, parameters)
