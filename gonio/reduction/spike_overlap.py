"""What a point sees of a specular spike: the overlap of the lamp's mirror image with the lens.

The overlap is a part of the spike's amplitude. It is averaged over the patch that is read, and over what the errors of
the angles make of the directions.
"""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from gonio.geometry import Directions, mirrored
from gonio.typing import ArrayLike, Floats

QUANTILES = np.array([NormalDist().inv_cdf((k + 0.5) / 41) for k in range(41)])
QUANTILES /= QUANTILES.std()
"""Equally probable values of a standard normal number."""
FAR = 4.0
"""Standard deviations of the angles' errors beyond which a point sees nothing of a spike."""


def overlap(offset: ArrayLike, half_angle_1: float, half_angle_2: float) -> Floats:
    """Common solid angle of two caps whose axes are `offset` apart, over that of the smaller one.

    All angles in radians. Two caps without extent, or one, overlap fully inside the other and not at all outside.
    """
    d = np.abs(np.asarray(offset, dtype=float))
    small, large = sorted((half_angle_1, half_angle_2))
    if small <= 0:
        return np.where(d <= large, 1.0, 0.0)
    # two sectors less the two triangles between axes and corners, by half-angle formulas
    h = 0.5 * (small + large + d)
    s0, sa, sb, sd = (np.sin(np.clip(v, 0.0, math.pi)) for v in (h, h - small, h - large, h - d))
    with np.errstate(divide="ignore", invalid="ignore"):
        at_a = 2.0 * np.arctan2(np.sqrt(sa * sd), np.sqrt(s0 * sb))
        at_b = 2.0 * np.arctan2(np.sqrt(sb * sd), np.sqrt(s0 * sa))
        corner = 2.0 * np.arctan2(np.sqrt(sa * sb), np.sqrt(s0 * sd))
    tangents = math.tan(0.5 * small) * math.tan(0.5 * large)
    excess = 2.0 * np.arctan2(tangents * np.sin(corner), 1.0 + tangents * np.cos(corner))
    full = math.sin(0.5 * small) ** 2
    lens = at_a * full + at_b * math.sin(0.5 * large) ** 2 - 0.5 * excess
    return np.where(d <= large - small, 1.0, np.where(d >= large + small, 0.0, lens / (math.pi * full)))


def over_patch(d: Directions, radius_mm: float, light_mm: float, camera_mm: float) -> Floats:
    """What `Directions.from_mirror` changes by at 24 places spread evenly over a round patch, shape (24, 3).

    A spot x sees source and camera turned by -(x - (x . w) w) / distance, to first order.
    """
    turn = (np.arange(24) + 0.5) * math.pi * (3.0 - math.sqrt(5.0))  # Vogel's spiral
    radius = radius_mm * np.sqrt((np.arange(24) + 0.5) / 24)
    x = np.stack([radius * np.cos(turn), radius * np.sin(turn), np.zeros(24)], axis=1)
    source, detector = d.vectors
    to_source = -(x - (x @ source)[:, None] * source) / light_mm
    return (-(x - (x @ detector)[:, None] * detector) / camera_mm) - mirrored(to_source)


@dataclass(frozen=True, slots=True)
class OverlapFraction:
    """What one point sees of a spike, as parts of its amplitude."""

    at_read: float = 0.0
    """At the directions that were read."""
    mean: float = 0.0
    """Over the patch, and over the errors of the angles."""
    variance: float = 0.0
    """Over the errors of the angles."""
    most: float = 0.0
    """For the largest errors of the angles, of `FAR` standard deviations."""
    least: float = 0.0
    """Likewise."""

    @property
    def with_rare(self) -> float:
        """The variance, but no less than what the largest errors take away, over `FAR`, squared.

        A top that is flat for small errors falls for rare ones, of which the mean square knows nothing.
        """
        return max(self.variance, ((self.mean - self.least) / FAR) ** 2)


def blurred_overlap(
    read: Directions,
    moved: Directions,
    half_angles: tuple[float, float],
    patch: Floats | None = None,
    pixels: Floats | None = None,
) -> OverlapFraction:
    """The overlap, averaged over a patch, at directions whose true place is uncertain.

    Parameters
    ----------
    read
        The directions that were read.
    moved
        Those for one standard deviation of each independent error; together they are taken for normal.
    half_angles
        Of the lamp and of the lens [rad].
    patch
        What `Directions.from_mirror` changes by at a few places of the patch, shape (n, 3); none for a point.
    pixels
        The same at every pixel. Errors of the angles are averaged over the few places, which need not be exact; what
        the patch itself takes from a spike at the directions read is averaged over all pixels.
    """
    centre = read.from_mirror
    shifts = moved.from_mirror - centre
    values, vectors = np.linalg.eigh(shifts.T @ shifts)
    first, second = (math.sqrt(max(values[k], 0.0)) * vectors[:, k] for k in (2, 1))
    spots = np.zeros((1, 3)) if patch is None else patch

    def of(place: Floats) -> Floats:
        return overlap(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(place, axis=-1), 1.0)), *half_angles)

    at_read = float(of(centre))
    fixed = float(np.mean(of(centre + (spots if pixels is None else pixels))))
    mean, variance = fixed, 0.0
    if first.any():
        place = centre + QUANTILES[:, None, None] * first + QUANTILES[None, :, None] * second
        share = np.mean([of(place + spot) for spot in spots], axis=0)
        mean, variance = float(share.mean()), float(share.var())
        if pixels is not None:
            mean = max(mean + fixed - float(np.mean(of(centre + spots))), 0.0)
    least, most = mean, max(mean, at_read)
    if first.any():
        turn = np.linspace(0.0, 2.0 * math.pi, 16, endpoint=False)[:, None]
        around = centre + FAR * (np.cos(turn) * first + np.sin(turn) * second)
        far = np.mean([of(around + spot) for spot in spots], axis=0)
        least, most = min(mean, float(np.min(far))), max(most, float(np.max(far)))
    return OverlapFraction(at_read, mean, variance, most, least)
