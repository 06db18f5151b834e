"""Choosing exposures: the brightest used pixel comes to a wanted fraction of full scale, and nothing used saturates.

With `acquisition.u_rel_target` the noise model says which exposures, and how many frames, reach a wanted uncertainty
(docs/acquisition.md, "Planned brackets").

Every decision is a function of the frames of its own step and of one predicted level, so that a repeated step decides
the same. The level is written as a fraction of full scale: 0 at the black level, 1 where the sensor saturates.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from gonio.errors import DeviceError
from gonio.geometry import solid_angle_of_cone
from gonio.lab.rig import Frame, Pose, light_and_camera
from gonio.lab.rig.description import RigDescription
from gonio.lab.rig.imaging import pixel_on_sample_mm
from gonio.lab.rig.kinematics import view
from gonio.lab.rig.light_and_camera import Camera
from gonio.typing import Floats, NDArray

Shot = Callable[[float], Frame]
Used = Callable[[NDArray[np.uint16]], NDArray[np.generic]]

SATURATED = 0.98
"""Levels above this are taken for saturated: a full pixel scatters around full scale by its noise."""
MAY_BE_FULL = 0.97
"""The same of what full pixels enter somewhat lower: means of frames, and levels without their dark signal."""
USABLE = 0.95
"""A frame whose brightest used pixel lies above this is not used for a rate at all: dropping single pixels, or frames
that are only nearly full, would keep the darker half of the noise."""
SHORTER = 4.0
"""The frame that ends every point is this many times shorter."""
STEP = 16.0
"""How far one metering frame may be from the next: from a saturated one down, from a dark one up."""
ENOUGH = 0.1
"""A level from which the final exposure can be computed: its noise then changes the result by less than a tenth."""
MOST_FRAMES = 12
MICROSECONDS = 6
FEWEST = 2
"""Frames of one exposure in a bracket: a hit of cosmic radiation shows against another one."""
MOST_IN_BRACKET = 64
EXPOSURE_TOLERANCE = 0.2
"""Of what was asked for: shutter speeds lie a third of a stop apart (half of that is 12 %), and their names are up to
7 % off (1/60 s is 1/64 s). The exposure that a frame says is the one that counts; drivers may be stricter."""
QUANTUM_S = 5e-5
"""Half of the step of a camera that counts its exposure in units of 100 us, as UVC does."""
BLACK_TOLERANCE = 0.05
"""Part of the range between black and white: metering is then off by less than a tenth."""
CLASSES = 8
"""Classes of brightness that the pixels of a region are sorted into where a bracket is planned."""
PILED = 32
"""Pixels of one level that are taken for full ones."""
BLOCKS = 256
"""Least number of blocks of a frame in which the brightest pixels are looked for."""
MANY = 4_000_000
"""Pixels from which on a part of them is looked at."""
STEEP = 3.0
"""How many times more pixels lie at the level where charge clips than just below it. Photon noise leaves fewer."""
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
    frame: Frame = field(compare=False)
    """The last metering frame."""


def full_scale_dn(camera: Camera, frame: Frame) -> float:
    """Range of a frame [DN] between its black level and saturation: by the converter, by the full well, or as seen."""
    stated = min(frame.white_level_dn - frame.black_level_dn, camera.full_well_e / camera.electrons_per_dn)
    return min(stated, clipped_dn(camera, frame) - frame.black_level_dn)


def clipped_dn(camera: Camera, frame: Frame) -> float:
    """The level [DN] that the pixels of a frame pile up at, where charge clips; infinite where none do.

    A rig file whose gain is wrong does not tell it. Light scatters by photon noise, and full pixels by read noise
    alone. So the brightest of a clipped frame lie within a few DN, with few below. A camera without photon noise, or
    whose read noise is no less than that, is not judged.
    """
    if not camera.photon_noise or camera.response:
        return math.inf
    mosaic, black = frame.mosaic.ravel(), frame.black_level_dn
    mosaic = np.ascontiguousarray(mosaic[:: 1 + 2 * (mosaic.size // MANY)])  # an odd step meets every colour
    width = 1 + math.ceil(5.0 * math.hypot(camera.read_noise_e, camera.dsnu_e) / camera.electrons_per_dn)
    # of blocks' brightest pixels: the brightest one of all, and one that `PILED` pixels reach
    peaks = np.maximum.reduceat(mosaic, np.arange(0, mosaic.size, max(mosaic.size // BLOCKS, 1)))
    highest = int(peaks.max())
    if 2.0 * width > math.sqrt(max(highest - black, 0.0) / camera.electrons_per_dn) or peaks.size < PILED:
        return math.inf
    reached = int(np.partition(peaks, -PILED)[-PILED])
    # from the top down, no further than needed; pixels that are hot, or were hit, lie above all
    seen = mosaic > max(reached - 5 * width, highest // 4)
    if reached == highest:  # the converter clips, most of a frame perhaps: these pixels are counted at once
        seen &= mosaic < highest
    counts = np.bincount(highest - mosaic[seen], minlength=highest + 1)
    if reached == highest:
        counts[0] = np.count_nonzero(mosaic == highest)
    top = int(np.searchsorted(np.cumsum(counts), PILED))
    if top == counts.size:
        return math.inf
    top += int(np.argmax(counts[top : top + 2 * width]))
    piled = int(counts[max(top - width, 0) : top + width].sum())
    below = int(counts[top + width : top + 3 * width].sum())
    return float(highest - top) if piled >= max(PILED, STEEP * below) else math.inf


def level(camera: Camera, frame: Frame, used: Used) -> float:
    """Level of the brightest used pixel of a frame."""
    return (float(used(frame.mosaic).max()) - frame.black_level_dn) / full_scale_dn(camera, frame)


def expected_level_per_s(description: RigDescription, pose: Pose, albedo: float) -> float:
    """Level for one second [1/s] that a matt surface should give at a pose, by the camera's data sheet alone."""
    camera = description.camera
    return camera.responsivity_e_per_s * albedo * cosine_of_incidence(pose) / camera.saturation_e


def expected_straight_level_per_s(description: RigDescription) -> float:
    """Level for one second [1/s] of a camera that looks into the lamp through `reference.attenuation`."""
    wider = math.radians(max(description.lamp.half_angle_deg, description.camera.lens_half_angle_deg))
    seen = math.pi / solid_angle_of_cone(wider)  # over a white at normal incidence
    return expected_level_per_s(description, Pose(), float(seen)) * (description.reference.attenuation or 1.0)


def contradiction(camera: Camera, frame: Frame) -> str:
    """What a frame says of itself that cannot be, or that the rig file contradicts; "" where there is nothing.

    A lower white level of as many bits is a maker's own (a converter that saturates early). A black level sets
    only the level of a frame in metering: the reduction measures dark signals.
    """
    if not (isinstance(frame.exposure_s, Real) and 0.0 < frame.exposure_s < math.inf):
        return f"has exposure_s = {frame.exposure_s!r}: seconds above 0 are needed"
    lowest = 2.0 ** (camera.bits - 1)
    if not lowest <= frame.white_level_dn <= camera.white_level_dn:
        return (
            f"has the white level {frame.white_level_dn:g} DN; the rig file says camera.bits = {camera.bits}, "
            f"{lowest:g} to {camera.white_level_dn:g} DN"
        )
    most = BLACK_TOLERANCE * (camera.white_level_dn - camera.black_level_dn)
    if not abs(frame.black_level_dn - camera.black_level_dn) <= most:
        return (
            f"has the black level {frame.black_level_dn:g} DN; the rig file says camera.black_level_dn = "
            f"{camera.black_level_dn:g}"
        )
    return ""


def require_asked(camera: Camera, frame: Frame, asked_s: float, source: str) -> None:
    """Raise `DeviceError` where a frame contradicts the rig file, or the exposure that was asked for.

    `source` begins the message: which camera it was.
    """
    why = contradiction(camera, frame)
    if not why and abs(frame.exposure_s - asked_s) > EXPOSURE_TOLERANCE * asked_s + QUANTUM_S:
        why = f"was exposed {frame.exposure_s:g} s where {asked_s:g} s were asked"
    if why:
        raise DeviceError(
            f"{source}: a frame {why}. Set the camera to manual exposure, and make the driver or the rig file say what "
            "the camera does"
        )


def cosine_of_incidence(pose: Pose) -> float:
    """cos(theta_i) at the sample's centre, kept above half a degree's worth so that it can divide."""
    return max(math.cos(pose.light) * math.cos(pose.tilt), 0.01)


def expected_exposure_s(description: RigDescription, pose: Pose, albedo: float) -> float:
    """The exposure [s] that `expected_level_per_s` leads to."""
    target = description.acquisition.exposure_target
    return _allowed(description, target / expected_level_per_s(description, pose, albedo))


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
                return Metered(exposure, seen / frame.exposure_s, saturated=True, frame=frame)
            exposure = darker
            continue
        wanted = _allowed(description, exposure * min(target / seen if seen > 0 else math.inf, STEP))
        if seen >= ENOUGH or wanted <= exposure:
            return Metered(wanted, seen / frame.exposure_s, saturated=False, frame=frame)
        dark, exposure = exposure, wanted if wanted < bright else _allowed(description, math.sqrt(exposure * bright))
    raise DeviceError(
        f"no exposure fits: {exposure:g} s is too dark or saturates from one frame to the next; check that the lamp is "
        "steady and that no other light reaches the sample"
    )


def require_in_scale(description: RigDescription, metered: Metered) -> None:
    """Raise `DeviceError` where the white reference is full at the shortest exposure: the run would have no value.

    Where frames are merged pixel by pixel a pixel may be full, and the others count.
    """
    if metered.saturated and not description.acquisition.by_pixels:
        raise DeviceError(
            f"the white reference is full at the shortest exposure, {metered.exposure_s:g} s "
            "(camera.exposure_limits_s), and without it nothing can be reduced: dim the lamp (devices.light.level), or "
            "close the aperture"
        )


def shorter(description: RigDescription, exposure_s: float) -> float:
    """The exposure [s] of the shorter frame that follows."""
    return _allowed(description, exposure_s / SHORTER)


def bracket(description: RigDescription, metered: Metered, used: Used, least: int = FEWEST) -> tuple[float, ...]:
    """The exposures [s] of all frames of a step in a band, in order, for `acquisition.u_rel_target`.

    They follow from the metering frame alone. A shorter frame ends them, as it ends every point.

    Parameters
    ----------
    description
        Noise of camera and lamp, limits of the exposure, target and time.
    metered
        What `meter` found.
    used
        The used pixels of a mosaic.
    least
        How many frames there are at least.
    """
    if metered.saturated:
        return (metered.exposure_s,) * least
    frame, camera = metered.frame, description.camera
    values = np.sort(used(frame.mosaic).astype(float)) - frame.black_level_dn
    parts = np.array_split(values * camera.electrons_per_dn / frame.exposure_s, min(CLASSES, values.size))
    rates, brightest = (
        np.maximum(np.array([take(part) for part in parts]) - camera.dark_current_e_per_s, 0.0)
        for take in (np.mean, np.max)
    )
    return _Planned(description, rates, brightest, values.size).exposures(metered.exposure_s, least)


def expected_bracket(description: RigDescription, pose: Pose, albedo: float) -> tuple[float, ...]:
    """What `bracket` leads to for a matt surface at a pose, by the rig file alone."""
    count = expected_pixels(description, pose)
    rate = description.camera.responsivity_e_per_s * albedo * cosine_of_incidence(pose)
    planned = _Planned(description, np.array([rate]), np.array([rate]), count)
    return planned.exposures(expected_exposure_s(description, pose, albedo), FEWEST)


def expected_pixels(description: RigDescription, pose: Pose) -> int:
    """How many pixels the region of interest has at a pose, about: 1 at least."""
    seen = view(description, pose)
    side = pixel_on_sample_mm(description, seen)
    slant = abs(float(seen.camera_mm[2])) / math.sqrt(sum(float(x) ** 2 for x in seen.camera_mm))
    return max(int(math.pi * description.acquisition.roi_radius_mm**2 / (slant * side**2)), 1)


def expected_weight(description: RigDescription, pose: Pose, pixels: float, reflectance: float, frames: int) -> float:
    """1 / (relative variance) of the mean over the region of interest, from all frames of a visit, by the rig file."""
    camera, acquisition = description.camera, description.acquisition
    if acquisition.u_rel_target is not None:
        exposures = expected_bracket(description, pose, reflectance)
    else:
        single = expected_exposure_s(description, pose, reflectance)
        exposures = (*(single,) * frames, single / SHORTER)
    rate = camera.responsivity_e_per_s * reflectance * cosine_of_incidence(pose)
    out = 0.0
    for t in exposures:
        noise = float(light_and_camera.variance(camera, (rate + camera.dark_current_e_per_s) * t))
        out += 1.0 / max(noise / (pixels * (rate * t) ** 2) + description.lamp.frame_noise**2, 1e-18)
    return out


class _Planned:
    """The choice of a bracket for a region of `count` pixels, of which equal parts have mean `rates` [e-/s], and are as
    bright as `brightest`.
    """

    def __init__(self, description: RigDescription, rates: Floats, brightest: Floats, count: int) -> None:
        self._description, self._rates, self._brightest, self._count = description, rates, brightest, count
        camera, acquisition = description.camera, description.acquisition
        target = acquisition.u_rel_target or math.inf
        # what responsivities leave is there whatever is exposed; noise is not brought far below it
        self._wanted = max(target**2 - camera.prnu**2 / count, 0.25 * target**2)
        self._full = camera.saturation_e
        least_s = FEWEST + 1.0 / SHORTER  # of two frames and the shorter one, in units of their exposure
        longest = min(camera.exposure_limits_s[1], acquisition.longest_point_s / least_s)
        if camera.dark_current_e_per_s > 0:
            longest = min(longest, 0.5 * self._full / camera.dark_current_e_per_s)
        self._longest = longest

    def exposures(self, metered_s: float, least: int) -> tuple[float, ...]:
        """Those that reach the target soonest; where the time does not allow that, those that come nearest to it.

        A shorter frame ends them.
        """
        first = self._allowed(metered_s)
        plans = []
        for shorter_by in range(12):
            exposure = self._allowed(first / 2.0**shorter_by)
            plans.append([exposure] * self._number([], exposure, least))
            if exposure <= self._description.camera.exposure_limits_s[0]:
                break
        # where bright pixels keep exposures short, longer ones are for the others
        for longer_by in range(1, 24):
            exposure = self._allowed(first * 2.0**longer_by)
            if exposure < first * 1.5 or self._weights(exposure).max() == 0.0:
                break
            plans.append([first] * FEWEST + [exposure] * self._number([first] * FEWEST, exposure, least - FEWEST))
            for number in (FEWEST, 2 * FEWEST, 4 * FEWEST):
                long = [exposure] * number
                plans.append([first] * self._number(long, first, least - number) + long)
        judged = [(self._variance(plan), self._time_s(plan), plan) for plan in plans]
        good = [entry for entry in judged if entry[0] <= self._wanted * (1.0 + 1e-9)]
        *_, best = min(good, key=lambda entry: entry[1]) if good else min(judged, key=lambda entry: entry[0])
        return (*best, shorter(self._description, max(best)))

    def _number(self, before: list[float], exposure_s: float, least: int) -> int:
        """How many more frames of an exposure reach the target, within the time and `MOST_IN_BRACKET`."""
        overhead = self._description.camera.beside_s
        room = self._description.acquisition.longest_point_s - self._time_s(before) - exposure_s / SHORTER
        most = max(min(int(room / max(exposure_s + overhead, 1e-9)), MOST_IN_BRACKET - len(before)), FEWEST)
        least = min(max(least, FEWEST), most)
        low, high = least, most  # the variance falls with every frame
        while low < high:
            middle = (low + high) // 2
            if self._variance(before + [exposure_s] * middle) <= self._wanted:
                high = middle
            else:
                low = middle + 1
        return low

    def _time_s(self, plan: list[float]) -> float:
        return sum(plan) + len(plan) * self._description.camera.beside_s

    def _variance(self, plan: list[float]) -> float:
        """Relative variance of the region's rate."""
        weights = sum(plan.count(exposure) * self._weights(exposure) for exposure in dict.fromkeys(plan))
        if np.min(weights) == 0.0 or not self._rates.any():
            return math.inf
        of_mean = float(np.mean(1.0 / weights)) / self._count
        return of_mean / float(self._rates.mean()) ** 2 + self._description.lamp.frame_noise**2 / len(plan)

    def _weights(self, exposure_s: float) -> Floats:
        """1 / variance [s^2/e-^2] of a pixel of each class in one frame; 0 where it may saturate."""
        camera, t = self._description.camera, exposure_s
        weights = t**2 / light_and_camera.variance(camera, (self._rates + camera.dark_current_e_per_s) * t)
        full = (self._brightest + camera.dark_current_e_per_s) * t
        spread = 6.0 * np.sqrt(full + camera.read_noise_e**2 + (camera.prnu * full) ** 2)
        return np.where((full + spread < SATURATED * self._full) | (t <= camera.exposure_limits_s[0]), weights, 0.0)

    def _allowed(self, exposure_s: float) -> float:
        return _allowed(self._description, min(exposure_s, self._longest))


def _allowed(description: RigDescription, exposure_s: float) -> float:
    """The nearest exposure that the camera has, in whole microseconds (an exact fraction in the raw file)."""
    shortest, longest = description.camera.exposure_limits_s
    return min(max(round(exposure_s, MICROSECONDS), shortest), longest)
