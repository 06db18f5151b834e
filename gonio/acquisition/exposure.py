"""Choosing exposures: the brightest used pixel comes to a wanted fraction of full scale, and nothing used saturates.

Every decision is a function of the frames of its own step and of one predicted level, so that a repeated step decides
the same. The level is written as a fraction of full scale: 0 at the black level, 1 where the sensor saturates.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gonio.errors import DeviceError
from gonio.geometry import solid_angle_of_cone
from gonio.rig import Frame, Pose
from gonio.rig.description import Camera, RigDescription

Shot = Callable[[float], Frame]
Used = Callable[[npt.NDArray[np.uint16]], npt.NDArray[np.generic]]

SATURATED = 0.98
"""Levels above this are taken for saturated: a full pixel scatters around full scale by its noise."""
SHORTER = 4.0
"""The frame that ends every point is this many times shorter."""
STEP = 16.0
"""How far one metering frame may be from the next: from a saturated one down, from a dark one up."""
ENOUGH = 0.1
"""A level from which the final exposure can be computed: its noise then changes the result by less than a tenth."""
MOST_FRAMES = 12
MICROSECONDS = 6
DARKEST = 100.0
"""The longest dark frame lasts this many times the exposure of a white sample; beyond, the dark rate is scaled."""


@dataclass(frozen=True, slots=True)
class Metered:
    """What a metering frame, or a short search, has found."""

    exposure_s: float
    """The exposure to measure with."""
    level_per_s: float
    """Level of the brightest used pixel for one second [1/s]; a lower bound where `saturated`."""
    saturated: bool
    """A used pixel saturates at the shortest exposure that the camera has."""


def full_scale_dn(camera: Camera, frame: Frame) -> float:
    """Range of a frame [DN] between its black level and saturation, by the converter or by the full well."""
    return min(frame.white_level_dn - frame.black_level_dn, camera.full_well_e / camera.electrons_per_dn)


def level(camera: Camera, frame: Frame, used: Used) -> float:
    """Level of the brightest used pixel of a frame."""
    return (float(np.max(used(frame.mosaic))) - frame.black_level_dn) / full_scale_dn(camera, frame)


def expected_level_per_s(description: RigDescription, pose: Pose, albedo: float) -> float:
    """Level for one second [1/s] that a matt surface should give at a pose, by the camera's data sheet alone."""
    camera = description.camera
    full_well = min(camera.full_well_e, (camera.white_level_dn - camera.black_level_dn) * camera.electrons_per_dn)
    return camera.responsivity_e_per_s * albedo * cosine_of_incidence(pose) / full_well


def expected_straight_level_per_s(description: RigDescription) -> float:
    """Level for one second [1/s] of a camera that looks into the lamp through `reference.attenuation`."""
    wider = math.radians(max(description.lamp.half_angle_deg, description.camera.lens_half_angle_deg))
    seen = math.pi / solid_angle_of_cone(wider)  # over a white at normal incidence
    return expected_level_per_s(description, Pose(), float(seen)) * (description.reference.attenuation or 1.0)


def cosine_of_incidence(pose: Pose) -> float:
    """cos(theta_i) at the sample's centre, kept above half a degree's worth so that it can divide."""
    return max(math.cos(pose.light) * math.cos(pose.tilt), 0.01)


def expected_exposure_s(description: RigDescription, pose: Pose, albedo: float) -> float:
    """The exposure [s] that `expected_level_per_s` leads to."""
    return _allowed(
        description, description.acquisition.exposure_target / expected_level_per_s(description, pose, albedo)
    )


def dark_exposures_s(description: RigDescription) -> tuple[float, float]:
    """The shortest and the longest useful exposure [s]: dark frames at both give each pixel's bias and dark rate.

    The longest stays below what would fill half of the well with dark charge.
    """
    camera = description.camera
    longest = DARKEST * expected_exposure_s(description, Pose(), 1.0)
    if camera.dark_current_e_per_s > 0:
        longest = min(longest, 0.5 * camera.full_well_e / camera.dark_current_e_per_s)
    return _allowed(description, camera.exposure_limits_s[0]), _allowed(description, longest)


def meter(description: RigDescription, shot: Shot, used: Used, level_per_s: float) -> Metered:
    """Find the exposure that brings the brightest used pixel to `acquisition.exposure_target`.

    Starts where a level of `level_per_s` [1/s] would lead, and searches down from saturation and up from darkness,
    within the camera's limits; one or two frames as a rule.

    Parameters
    ----------
    description : RigDescription
        Target, limits, and the sensor's full well.
    shot : callable
        Takes one frame of a given exposure [s].
    used : callable
        The used pixels of a mosaic.
    level_per_s : float
        The expected level [1/s].

    Raises
    ------
    DeviceError
        The light jumps from frame to frame, so that no exposure fits.
    """
    target, camera = description.acquisition.exposure_target, description.camera
    exposure = _allowed(description, target / level_per_s)
    dark, bright = 0.0, math.inf  # the longest exposure found too dark to compute from, the shortest that saturates
    for _ in range(MOST_FRAMES):
        frame = shot(exposure)
        seen = level(camera, frame, used)
        if seen >= SATURATED:
            bright = exposure
            darker = _allowed(description, math.sqrt(dark * bright) if dark else exposure / STEP)
            if darker >= exposure:
                return Metered(exposure, seen / frame.exposure_s, saturated=True)
            exposure = darker
            continue
        wanted = _allowed(description, exposure * min(target / seen if seen > 0 else math.inf, STEP))
        if seen >= ENOUGH or wanted <= exposure:
            return Metered(wanted, seen / frame.exposure_s, saturated=False)
        dark, exposure = exposure, wanted if wanted < bright else _allowed(description, math.sqrt(exposure * bright))
    raise DeviceError(
        f"no exposure fits: {exposure:g} s is too dark or saturates from one frame to the next; check that the lamp is "
        "steady and that no other light reaches the sample"
    )


def shorter(description: RigDescription, exposure_s: float) -> float:
    """The exposure [s] of the shorter frame that follows."""
    return _allowed(description, exposure_s / SHORTER)


def _allowed(description: RigDescription, exposure_s: float) -> float:
    """The nearest exposure that the camera has, in whole microseconds (an exact fraction in the raw file)."""
    shortest, longest = description.camera.exposure_limits_s
    return min(max(round(exposure_s, MICROSECONDS), shortest), longest)
