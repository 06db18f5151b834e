"""A cause whose size is known at each direction, and whose sign and shape over the directions are not.

A bound at each point is no correlation: one column of bounds would say that all of the error but one factor
is known. Such a cause is taken for a random function of the directions with the variance 1: a sum of waves, each a sine
and a cosine with an amplitude of its own, over what the light of an isotropic sample depends on. Its correlation
between two directions is the mean of the cosines of the waves' phases (Bochner), 1 at one place and falling with the
distance.
"""

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np

from gonio.geometry import Directions
from gonio.typing import Floats

WAVES = 64
"""How many; their sines and cosines are the causes."""
NARROWEST, WIDEST = 0.05, 1.0
"""Lengths over theta_h on which the function may change [rad], each decade as likely: the part of the light that was
reflected once falls from all to nothing across a lobe, whose width nobody knows beforehand."""
SLOWER = 0.3
"""The same over theta_d and over the difference of the cosines: Fresnel's formulas are smooth there."""
PLASTIC = 1.1673039782614187
"""x^5 = x + 1: its powers spread points evenly in four dimensions (Roberts' sequence)."""


def of_unknown_shape(points: Sequence[Directions]) -> Floats:
    """The function at some points for one standard deviation of each of its causes, shape (n, 2 `WAVES`).

    The squares of a point add up to 1.
    """
    if not points:
        return np.zeros((0, 2 * WAVES))
    d = Directions.stack(list(points))
    source, detector = d.vectors
    half = source + detector
    length = np.maximum(np.linalg.norm(half, axis=-1), 1e-9)
    theta_h = np.arccos(np.clip(half[..., 2] / length, -1.0, 1.0))
    theta_d = np.arccos(np.clip(0.5 * length, 0.0, 1.0))
    place = np.stack([theta_h, SLOWER * theta_d, SLOWER * (source[..., 2] - detector[..., 2])], axis=-1)
    phase = place @ _waves().T
    return np.concatenate([np.cos(phase), np.sin(phase)], axis=-1) / math.sqrt(WAVES)


def _waves() -> Floats:
    """Wave vectors [1/rad], shape (`WAVES`, 3): those of Gaussian correlations whose lengths are spread evenly."""
    even = (0.5 + np.outer(np.arange(1, WAVES + 1), PLASTIC ** -np.arange(1.0, 5.0))) % 1.0
    normal = np.vectorize(NormalDist().inv_cdf)(even[:, :3])
    return np.asarray(normal / (NARROWEST * (WIDEST / NARROWEST) ** even[:, 3:]))
