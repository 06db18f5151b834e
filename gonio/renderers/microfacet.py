"""What the materials of glTF and of Blender are made of: GGX, Schlick, and the angles that they take."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from gonio import geometry
from gonio.typing import Floats


@dataclass(frozen=True)
class Geometry:
    """Cosines of n pairs of directions."""

    cos_i: Floats
    cos_r: Floats
    cos_h: Floats
    """Between the half vector and the normal."""
    cos_d: Floats
    """Between the half vector and either direction."""

    @classmethod
    def of(cls, theta_i: Floats, theta_r: Floats, dphi: Floats) -> Geometry:
        """From angles [rad], (n,) each."""
        half = geometry.direction(theta_i, 0.0 * dphi) + geometry.direction(theta_r, dphi)
        length = np.linalg.norm(half, axis=1)
        return cls(np.cos(theta_i), np.cos(theta_r), np.minimum(half[:, 2] / length, 1.0), np.minimum(length / 2, 1.0))


class Material(ABC):
    """Parameters of another program's material, to be fitted, and its BRDF."""

    @classmethod
    @abstractmethod
    def bounds(cls, grey: bool) -> tuple[Floats, Floats]:
        """Of the fitted numbers; where all is grey a colour is one number."""

    @classmethod
    @abstractmethod
    def start(cls, level: Floats, roughness: float, grey: bool) -> Floats:
        """Fitted numbers to begin from, by the albedo (3,) of a diffuse floor."""

    @classmethod
    @abstractmethod
    def of(cls, vector: Floats, grey: bool) -> Self:
        """The material of fitted numbers."""

    @abstractmethod
    def brdf(self, given: Geometry) -> Floats:
        """(n, 3) [1/sr]."""

    @abstractmethod
    def shown(self) -> dict[str, Any]:
        """Its parameters by the program's names, as plain numbers."""


def width(grey: bool) -> int:
    """How many numbers a colour is fitted with."""
    return 1 if grey else 3


def colour(numbers: Floats) -> Floats:
    """(3,) of one number or three."""
    return np.array(np.broadcast_to(numbers, 3))


def distribution(cos_h: Floats, alpha: float) -> Floats:
    """GGX's normals [1/sr] (Walter 2007 eq. 33)."""
    a2 = alpha * alpha
    return np.asarray(a2 / (np.pi * (cos_h**2 * (a2 - 1) + 1) ** 2))


def schlick(cosine: Floats) -> Floats:
    """(1 - cos)^5: how far reflection has gone from its normal value to its grazing one (Schlick 1994)."""
    return np.asarray((1 - cosine) ** 5)


def plain(numbers: Floats) -> list[float]:
    """As files have a colour."""
    return [float(round(x, 6)) for x in numbers]
