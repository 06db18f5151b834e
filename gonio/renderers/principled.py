"""Blender's Principled BSDF (4.0 and later, "v2"), with the distribution GGX: single scattering.

`Metal` has Base Color and the F82 tint of its edge. `Plastic` has IOR, Specular IOR Level, and a diffuse base that gets
what the surface's layer leaves: 1 - its albedo for the viewer. alpha = roughness^2; Smith's shadowing and masking are
correlated by height. The layer's albedo is integrated here; Cycles has it from a table. Coat, sheen, subsurface,
transmission and the multiple scattering of "Multiscatter GGX" are not fitted: they are off.
"""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from gonio.errors import ConfigError
from gonio.renderers.microfacet import Geometry, Material, colour, distribution, plain, width
from gonio.typing import Floats

_LEAST = 0.05
_LEVEL = 0.5
"""Specular IOR Level: at 0.5 the IOR alone says how much is reflected at the normal."""


def _lobe(given: Geometry, roughness: float) -> Floats:
    a2 = roughness**4
    root_i = given.cos_r * np.sqrt(a2 + (1 - a2) * given.cos_i**2)
    root_r = given.cos_i * np.sqrt(a2 + (1 - a2) * given.cos_r**2)
    return np.asarray(distribution(given.cos_h, roughness**2) / (2 * (root_i + root_r)))


def _dielectric(cosine: Floats, ior: float) -> Floats:
    """Fresnel's reflectance, unpolarised."""
    g = np.sqrt(ior**2 - 1 + cosine**2)
    first = (g - cosine) / (g + cosine)
    second = ((g + cosine) * cosine - 1) / ((g - cosine) * cosine + 1)
    return np.asarray(0.5 * first**2 * (1 + second**2))


@dataclass(frozen=True)
class Metal(Material):
    """Metallic 1."""

    base_color: Floats
    roughness: float
    tint: float

    @classmethod
    def bounds(cls, grey: bool) -> tuple[Floats, Floats]:
        count = width(grey)
        return np.array([_LEAST, 0.0, *[0.0] * count]), np.ones(2 + count)

    @classmethod
    def start(cls, level: Floats, roughness: float, grey: bool) -> Floats:
        return np.array([roughness, 0.9, *[0.5] * width(grey)])

    @classmethod
    def of(cls, vector: Floats, grey: bool) -> Self:
        return cls(colour(vector[2:]), float(vector[0]), float(vector[1]))

    def brdf(self, given: Geometry) -> Floats:
        # Kutz 2021: below Schlick's curve by b cos (1 - cos)^6, so that F(1/7) is the tint times Schlick's
        at, base = 1.0 / 7.0, self.base_color
        edge = base + (1 - base) * (1 - at) ** 5
        b = edge * (1 - self.tint) / (at * (1 - at) ** 6)
        c = given.cos_d[:, np.newaxis]
        fresnel = np.clip(base + (1 - base) * (1 - c) ** 5 - b * c * (1 - c) ** 6, 0.0, 1.0)
        return np.asarray(fresnel * _lobe(given, self.roughness)[:, np.newaxis])

    def shown(self) -> dict[str, Any]:
        return {
            "Base Color": [*plain(self.base_color), 1.0],
            "Metallic": 1.0,
            "Roughness": round(self.roughness, 6),
            "Specular Tint": [*[round(self.tint, 6)] * 3, 1.0],
        }


@dataclass(frozen=True)
class Plastic(Material):
    """Metallic 0."""

    base_color: Floats
    roughness: float
    ior: float
    level: float

    @classmethod
    def bounds(cls, grey: bool) -> tuple[Floats, Floats]:
        count = width(grey)
        return np.array([_LEAST, 1.01, 0.0, *[0.0] * count]), np.array([1.0, 3.0, 1.0, *[1.0] * count])

    @classmethod
    def start(cls, level: Floats, roughness: float, grey: bool) -> Floats:
        return np.array([roughness, 1.5, _LEVEL, *level[: width(grey)]])

    @classmethod
    def of(cls, vector: Floats, grey: bool) -> Self:
        return cls(colour(vector[3:]), float(vector[0]), float(vector[1]), float(vector[2]))

    def _fresnel(self, cosine: Floats) -> Floats:
        """Cycles' generalised Schlick: from F0, scaled by the level, to 1, along Fresnel's own curve."""
        normal = ((self.ior - 1) / (self.ior + 1)) ** 2
        way = np.clip((_dielectric(cosine, self.ior) - normal) / (1 - normal), 0.0, 1.0)
        scaled = min(2 * self.level * normal, 1.0)
        return np.asarray(scaled + (1 - scaled) * way)

    def brdf(self, given: Geometry) -> Floats:
        layer = self._fresnel(given.cos_d) * _lobe(given, self.roughness)
        cosines, pairs, share = _hemisphere()
        albedo = (
            (self._fresnel(pairs.cos_d) * _lobe(pairs, self.roughness) * share).reshape(cosines.size, -1).sum(axis=1)
        )
        below = (1 - np.interp(given.cos_r, cosines, np.minimum(albedo, 1.0)))[:, np.newaxis]
        return np.asarray(layer[:, np.newaxis] + below * self.base_color / np.pi)

    def shown(self) -> dict[str, Any]:
        return {
            "Base Color": [*plain(self.base_color), 1.0],
            "Metallic": 0.0,
            "Roughness": round(self.roughness, 6),
            "IOR": round(self.ior, 6),
            "Specular IOR Level": round(self.level, 6),
        }


@functools.cache
def _hemisphere() -> tuple[Floats, Geometry, Floats]:
    """Viewing cosines, half vectors over the hemisphere for each, and brdf's share in the albedo."""
    cosines = np.linspace(0.05, 1.0, 16)
    side, phi = (np.arange(60) + 0.5) / 60, np.pi * (np.arange(16) + 0.5) / 16
    theta_h, phi_h = np.meshgrid(np.pi / 2 * side**2, phi, indexing="ij")
    solid = np.pi * side[:, np.newaxis] / side.size * (2 * np.pi / phi.size) * np.sin(theta_h)
    view = cosines[:, np.newaxis, np.newaxis]
    sine = np.sqrt(1 - view**2)
    cos_d = view * np.cos(theta_h) + sine * np.sin(theta_h) * np.cos(phi_h)
    cos_r = 2 * cos_d * np.cos(theta_h) - view
    seen = (cos_d > 0) & (cos_r > 0)
    share = np.where(seen, 4 * cos_d * cos_r * solid, 0.0)
    parts = np.broadcast_arrays(view, np.where(seen, cos_r, 1.0), np.cos(theta_h), np.where(seen, cos_d, 1.0))
    return cosines, Geometry(*(np.asarray(p).ravel() for p in parts)), share.ravel()


KINDS: tuple[type[Material], ...] = (Plastic, Metal)

_SCRIPT = '''"""Makes the material "{name}" in Blender 4.0 or later: blender --python FILE."""

import json

import bpy

EXTRAS = json.loads({extras!r})  # what it was fitted to, and how far it is off
INPUTS = json.loads({inputs!r})

material = bpy.data.materials.new({title!r})
material.use_nodes = True
node = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
node.distribution = "GGX"
for key, value in INPUTS.items():
    node.inputs[key].default_value = value
material["gonio"] = json.dumps(EXTRAS)
'''


def check(path: Path) -> None:
    """`ConfigError` unless it is to be a JSON file or a script."""
    if path.suffix.lower() not in (".json", ".py"):
        raise ConfigError(f'{path}: Blender\'s material is written as ".json", or as a script ".py"')


def encoded(material: Material, name: str, extras: dict[str, Any], path: Path) -> bytes:
    """The parameters by the names of the node's inputs: JSON, or a script that makes the material."""
    if path.suffix.lower() == ".json":
        document = {
            "name": name,
            "node": "ShaderNodeBsdfPrincipled",
            "distribution": "GGX",
            "inputs": material.shown(),
            "extras": extras,
        }
        return (json.dumps(document, indent=1) + "\n").encode()
    title = " ".join(name.replace('"', "'").replace("\\", "/").split())
    said = _SCRIPT.format(name=title, extras=json.dumps(extras), inputs=json.dumps(material.shown()), title=name)
    return said.encode()
