"""The frames of a point as one rate, with its variance."""

import math
from dataclasses import dataclass

import numpy as np

from gonio.reduction import merging
from gonio.reduction.dark_signal import Darks
from gonio.reduction.rates import Merged
from gonio.rig import Target, sensor_noise
from gonio.rig.description import RigDescription
from gonio.rig.regions import Roi
from gonio.rig.sensor_noise import rounding_of_mean
from gonio.typing import Bools, Floats

USABLE = 0.95
"""A frame whose brightest used pixel lies above this fraction of full scale is not used at all: dropping single pixels,
or frames that are only nearly full, would keep the darker half of the noise."""


@dataclass(frozen=True, slots=True)
class Region:
    """What the frames of one step and band are averaged over."""

    roi: Roi
    target: Target
    per_weight: Floats
    """What makes a used pixel's signal the region's: `gonio.rig.beam_size.per_weight`, over the pixels' responsivities
    where they are mapped."""
    lit: Roi
    """Those of its pixels that the beam falls on."""


@dataclass(frozen=True, slots=True)
class Shot:
    """One frame, reduced to its region."""

    rate: float
    """Electrons a second, over the known geometry."""
    exposure_s: float
    time_s: float
    peak: float
    """Brightest used pixel, as a fraction of full scale."""
    leverage: Floats
    """Of the dark frames: `Darks.leverage`."""
    by_camera: Floats
    """Derivatives of the rate by `camera_parameters`."""
    lamp: float
    """The reading of the lamp's monitor over its mean in the run; 1 without a monitor."""
    electrons: Floats | None = None
    """Signals of the used pixels [e-], where frames are merged by pixels."""
    levels: Floats | None = None
    """Their raw levels, as fractions of full scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pooled(Merged):
    """The merged frames of a step, with what the dark frames and the camera do to their rate."""

    time_s: float
    of_darks: Floats
    """Change of the rate for one standard deviation of the mean of the shorter and of the longer darks."""
    by_camera: Floats
    """Derivatives of the rate by `camera_parameters`."""


def pool(description: RigDescription, region: Region, shots: list[Shot], dark_exposures_s: Floats) -> Pooled:
    """The merged rate of a point's frames [e-/s], and what goes with it.

    Weights come from the pooled rate, not from each frame's own: a frame that is dark by chance gets no larger weight.
    """
    camera, of_lamp = description.camera, description.lamp.frame_noise
    exposure = np.array([shot.exposure_s for shot in shots])
    rates, times = np.array([shot.rate for shot in shots]), np.array([shot.time_s for shot in shots])
    count = region.per_weight.size
    mean_1, mean_2 = float(np.mean(region.per_weight)), float(np.mean(region.per_weight**2))
    dark = sensor_noise.variance(camera, camera.dark_current_e_per_s * exposure, rounding=False)
    pooled = float(np.sum(rates * exposure) / np.sum(exposure))
    for _ in range(3):
        signal = max(pooled, 0.0)
        shot_noise = signal * mean_1 / exposure if camera.photon_noise else 0.0
        rounding = rounding_of_mean(camera, signal * exposure / mean_1, count)
        single = dark * mean_2 / exposure**2 + shot_noise
        variances = single / count + rounding * mean_2 / exposure**2 + (of_lamp * signal) ** 2
        weights = (1.0 / variances) / np.sum(1.0 / variances)
        pooled = float(np.sum(weights * rates))
    # the dark frames are one and the same for all frames of the point
    charge = camera.dark_current_e_per_s * dark_exposures_s
    of_pixels = sensor_noise.variance(camera, charge, rounding=False) / count + rounding_of_mean(camera, charge, count)
    lines = np.array([shot.leverage for shot in shots])
    of_darks = np.zeros(2)
    of_darks[: charge.size] = -((weights / exposure) @ lines) * np.sqrt(of_pixels * mean_2)
    return Pooled(
        rate=pooled,
        variance=float(1.0 / np.sum(1.0 / variances)),
        time_s=float(np.sum(weights * times)),
        chi_square=float(np.sum((rates - pooled) ** 2 / variances)),
        of_darks=of_darks,
        by_camera=weights @ np.array([shot.by_camera for shot in shots]),
        frames=len(shots),
    )


def pool_pixels(description: RigDescription, region: Region, shots: list[Shot], darks: Darks) -> Pooled | None:
    """The frames of a point, merged pixel by pixel (`merging.merge`); None where pixels saturate in every frame.

    Where the noise of the camera is not known, frames that scatter more than photons say make the variance larger.
    """
    camera, acquired = description.camera, [shot for shot in shots if shot.electrons is not None]
    # a brighter lamp is as good as a longer exposure
    exposure = np.array([shot.exposure_s * shot.lamp for shot in acquired])
    rate = np.maximum(darks.rate(region.roi) * camera.electrons_per_dn, camera.dark_current_e_per_s)
    stack = merging.Stack(
        electrons=np.stack([shot.electrons for shot in acquired if shot.electrons is not None]),
        levels=np.stack([shot.levels for shot in acquired if shot.levels is not None]),
        exposures_s=exposure,
        mask=region.roi.mask,
        per_weight=region.per_weight,
        dark_rate=rate,
        hot=_hot(rate, float(exposure.max()), float(darks.exposures_s.max()), camera.saturation_e),
    )
    merged = merging.merge(description, stack)
    if merged is None:
        return None
    # the dark frames are one and the same for all frames of the point, and independent from pixel to pixel
    charge = camera.dark_current_e_per_s * darks.exposures_s
    count = region.per_weight.size
    noise = sensor_noise.variance(camera, charge, rounding=False) + count * rounding_of_mean(camera, charge, count)
    lines = np.array([shot.leverage for shot in acquired])
    of_darks = np.zeros(2)
    for k, variance in enumerate(noise):
        change = (lines[:, k] / exposure) @ merged.shares
        of_darks[k] = -math.copysign(math.sqrt(float(np.sum(change**2)) * variance), float(change.sum()))
    variance = merged.variance
    if not merging.noise_is_known(description) and merged.frames > 1:
        variance *= max(1.0, merged.chi_square / (merged.frames - 1))
    return Pooled(
        **merged.named() | {"variance": variance},
        time_s=float(merged.frame_weights @ [shot.time_s for shot in acquired]),
        of_darks=of_darks,
        by_camera=merged.frame_weights @ np.array([shot.by_camera for shot in acquired]),
    )


def _hot(rate: Floats, longest_s: float, dark_s: float, full: float) -> Bools:
    """Pixels with so many more dark electrons a second than others that they are not to be used.

    Their charge would be too large a part of full scale in the longest frame; or it filled the longer dark frames,
    which then do not tell the rate.
    """
    excess = rate - np.median(rate)
    return np.asarray((excess * longest_s > merging.HOT * full) | (excess * dark_s > USABLE * full))
