"""glTF 2.0 materials: appendix B's metallic-roughness BRDF, with KHR_materials_ior, _specular and _clearcoat.

`MetallicRoughness` is a metal, `Dielectric` has the extensions for its surface, `Coated` a second lobe over it. A
metallic between 0 and 1 is a mixture of two samples and is not fitted, nor is sheen, which stands for the fibres of
cloth. The file is one material and a sphere that shows it; the BRDF is the specification's (Khronos2021):

    alpha = roughness^2; D = GGX; V = G1(L) G1(V) / (4 NL NV), G1 = 2 NL / (NL + sqrt(alpha^2 + (1 - alpha^2) NL^2))
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from gonio.errors import ConfigError
from gonio.renderers.microfacet import Geometry, Material, colour, distribution, plain, schlick, width
from gonio.typing import Floats

_LEAST = 0.03
"""Roughness: below it lobes are narrower than screens show."""


def _lobe(given: Geometry, roughness: float) -> Floats:
    alpha = roughness**2
    visibility = np.ones_like(given.cos_h)
    for cosine in (given.cos_i, given.cos_r):
        visibility = visibility / (cosine + np.sqrt(alpha**2 + (1 - alpha**2) * cosine**2))
    return np.asarray(visibility * distribution(given.cos_h, alpha))


@dataclass(frozen=True)
class MetallicRoughness(Material):
    """metallicFactor 1."""

    base_color: Floats
    roughness: float

    @classmethod
    def bounds(cls, grey: bool) -> tuple[Floats, Floats]:
        count = width(grey)
        return np.array([_LEAST, *[0.0] * count]), np.ones(1 + count)

    @classmethod
    def start(cls, level: Floats, roughness: float, grey: bool) -> Floats:
        return np.array([roughness, *[0.5] * width(grey)])

    @classmethod
    def of(cls, vector: Floats, grey: bool) -> Self:
        return cls(colour(vector[1:]), float(vector[0]))

    def brdf(self, given: Geometry) -> Floats:
        fresnel = self.base_color + (1 - self.base_color) * schlick(given.cos_d)[:, np.newaxis]
        return np.asarray(fresnel * _lobe(given, self.roughness)[:, np.newaxis])

    def shown(self) -> dict[str, Any]:
        return {
            "baseColorFactor": [*plain(self.base_color), 1.0],
            "metallicFactor": 1.0,
            "roughnessFactor": round(self.roughness, 6),
        }


@dataclass(frozen=True)
class Dielectric(Material):
    """metallicFactor 0, with KHR_materials_ior and KHR_materials_specular."""

    base_color: Floats
    roughness: float
    ior: float
    specular: float

    @classmethod
    def bounds(cls, grey: bool) -> tuple[Floats, Floats]:
        count = width(grey)
        return np.array([_LEAST, 1.01, 0.0, *[0.0] * count]), np.array([1.0, 3.0, 1.0, *[1.0] * count])

    @classmethod
    def start(cls, level: Floats, roughness: float, grey: bool) -> Floats:
        return np.array([roughness, 1.5, 0.9, *level[: width(grey)]])

    @classmethod
    def of(cls, vector: Floats, grey: bool) -> Self:
        return cls(colour(vector[3:]), float(vector[0]), float(vector[1]), float(vector[2]))

    def brdf(self, given: Geometry) -> Floats:
        normal = ((1 - self.ior) / (1 + self.ior)) ** 2
        share = (self.specular * (normal + (1 - normal) * schlick(given.cos_d)))[:, np.newaxis]
        return np.asarray((1 - share) * self.base_color / np.pi + share * _lobe(given, self.roughness)[:, np.newaxis])

    def shown(self) -> dict[str, Any]:
        return {
            "baseColorFactor": [*plain(self.base_color), 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": round(self.roughness, 6),
            "KHR_materials_ior": {"ior": round(self.ior, 6)},
            "KHR_materials_specular": {"specularFactor": round(self.specular, 6)},
        }


@dataclass(frozen=True)
class Coated(Material):
    """A dielectric under KHR_materials_clearcoat, whose index is 1.5."""

    base: Dielectric
    clearcoat: float
    clearcoat_roughness: float

    @classmethod
    def bounds(cls, grey: bool) -> tuple[Floats, Floats]:
        lower, upper = Dielectric.bounds(grey)
        return np.array([0.0, _LEAST, *lower]), np.array([1.0, 1.0, *upper])

    @classmethod
    def start(cls, level: Floats, roughness: float, grey: bool) -> Floats:
        return np.array([0.5, roughness / 2, *Dielectric.start(level, min(2 * roughness, 0.9), grey)])

    @classmethod
    def of(cls, vector: Floats, grey: bool) -> Self:
        return cls(Dielectric.of(vector[2:], grey), float(vector[0]), float(vector[1]))

    def brdf(self, given: Geometry) -> Floats:
        share = (self.clearcoat * (0.04 + 0.96 * schlick(given.cos_r)))[:, np.newaxis]
        coat = _lobe(given, self.clearcoat_roughness)[:, np.newaxis]
        return np.asarray((1 - share) * self.base.brdf(given) + share * coat)

    def shown(self) -> dict[str, Any]:
        coat = {
            "clearcoatFactor": round(self.clearcoat, 6),
            "clearcoatRoughnessFactor": round(self.clearcoat_roughness, 6),
        }
        return {**self.base.shown(), "KHR_materials_clearcoat": coat}


KINDS: tuple[type[Material], ...] = (Dielectric, MetallicRoughness, Coated)


def check(path: Path) -> None:
    """`ConfigError` unless the ending is one of glTF's."""
    if path.suffix.lower() not in (".gltf", ".glb"):
        raise ConfigError(f'{path}: a glTF file ends in ".gltf" or ".glb"')


def encoded(material: Material, name: str, extras: dict[str, Any], path: Path) -> bytes:
    """The file: a material, and a sphere that it is on; binary for .glb."""
    shown = material.shown()
    extensions = {key: value for key, value in shown.items() if key.startswith("KHR_")}
    described: dict[str, Any] = {
        "name": name,
        "pbrMetallicRoughness": {key: value for key, value in shown.items() if key not in extensions},
        "extras": extras,
    }
    if extensions:
        described["extensions"] = extensions
    points, faces = _sphere()
    blob = points.astype("<f4").tobytes() + faces.astype("<u2").tobytes()
    blob += bytes(-len(blob) % 4)
    size = points.size * 4
    binary = path.suffix.lower() == ".glb"
    uri = {} if binary else {"uri": "data:application/octet-stream;base64," + base64.b64encode(blob).decode()}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": extras["generator"]},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 0}, "indices": 1, "material": 0}]}],
        "materials": [described],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": len(points),
                "type": "VEC3",
                "min": points.astype("<f4").min(axis=0).tolist(),
                "max": points.astype("<f4").max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": 5123, "count": faces.size, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": size, "target": 34962},
            {"buffer": 0, "byteOffset": size, "byteLength": faces.size * 2, "target": 34963},
        ],
        "buffers": [{"byteLength": len(blob), **uri}],
    }
    if extensions:
        document["extensionsUsed"] = sorted(extensions)
    if not binary:
        return (json.dumps(document, indent=1) + "\n").encode()
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(blob))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob


def _sphere(rings: int = 24, around: int = 48) -> tuple[Floats, Floats]:
    """Points (n, 3) of a unit sphere, which are its normals too, and triangles (m, 3) that are seen from outside."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, around + 1), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], axis=-1)
    k = (np.arange(rings)[:, np.newaxis] * (around + 1) + np.arange(around)).ravel()
    below = k + around + 1
    upper, lower = np.column_stack([k, below, k + 1]), np.column_stack([k + 1, below, below + 1])
    return points.reshape(-1, 3), np.concatenate([upper[around:], lower[:-around]])
