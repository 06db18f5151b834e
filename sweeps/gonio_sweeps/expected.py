"""What a visit to a point will tell and cost: noise and time of its frames, by the level that a model expects there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.acquisition import exposure
from gonio.acquisition.records import StepRecord
from gonio.acquisition.run import Run
from gonio.acquisition.schedule import reference_pose
from gonio.rig import Pose
from gonio.rig.description import RigDescription
from gonio.rig.imaging import pixel_on_sample_mm
from gonio.rig.kinematics import view
from gonio.typing import Floats

METERING = 1.25
"""Metering frames of a point, in units of its exposure."""
SETTLE_S = 0.2
"""Arms stand still so long after they have arrived, about."""


@dataclass(frozen=True)
class Visits:
    """Visits to points, one band each."""

    u_rel: Floats
    """Relative standard uncertainty by noise of camera and lamp; infinite where nothing is seen."""
    seconds: Floats
    """All frames, without the way there."""


def visits(description: RigDescription, poses: Sequence[Pose], brdf: Floats) -> Visits:
    """What visits to poses come to where the sample has a BRDF [1/sr].

    The exposures are those that metering would choose, the noise that of the EMVA 1288 model (docs/radiometry.md); the
    dark frames' own noise is left out.
    """
    camera, acquisition = description.camera, description.acquisition
    cosine = np.array([exposure.cosine_of_incidence(pose) for pose in poses])
    signal = camera.responsivity_e_per_s * math.pi * np.maximum(brdf, 0.0) * cosine
    full = min(camera.full_well_e, (camera.white_level_dn - camera.black_level_dn) * camera.electrons_per_dn)
    shortest, longest = camera.exposure_limits_s
    with np.errstate(divide="ignore"):
        single = np.clip(acquisition.exposure_target * full / signal, shortest, longest)
    count = np.array([_pixels(description, pose) for pose in poses])
    overhead = camera.frame_overhead_s
    if acquisition.u_rel_target is not None:
        brackets = [
            exposure.expected_bracket(description, pose, math.pi * max(float(f), 1e-12))
            for pose, f in zip(poses, brdf, strict=True)
        ]
        seconds = np.array([sum(b) + (len(b) + 1) * overhead for b in brackets]) + METERING * single
        weights = sum_weights(description, signal, brackets, count)
    else:
        usual = [(float(t),) * acquisition.frames + (float(t) / exposure.SHORTER,) for t in single]
        seconds = np.array([sum(b) for b in usual]) + METERING * single + (acquisition.frames + 2) * overhead
        weights = sum_weights(description, signal, usual, count)
    with np.errstate(divide="ignore"):
        u_rel = np.where((signal > 0) & (weights > 0), 1.0 / np.sqrt(np.maximum(weights, 1e-300)), np.inf)
    return Visits(u_rel, seconds)


def sum_weights(
    description: RigDescription, signal: Floats, brackets: Sequence[Sequence[float]], count: Floats
) -> Floats:
    """1 / (relative variance) of the mean over a region, added over the frames of each visit."""
    camera, lamp = description.camera, description.lamp.frame_noise
    out = np.zeros(signal.size)
    for k, (rate, pixels) in enumerate(zip(signal.tolist(), count.tolist(), strict=True)):
        if rate <= 0.0:
            continue
        for t in brackets[k]:
            noise = camera.read_noise_e**2 + camera.electrons_per_dn**2 / 12.0
            if camera.photon_noise:
                noise += (rate + camera.dark_current_e_per_s) * t
            variance = noise / (pixels * (rate * t) ** 2) + lamp**2
            out[k] += 1.0 / max(variance, 1e-18)
    return out


def _pixels(description: RigDescription, pose: Pose) -> float:
    seen = view(description, pose)
    slant = abs(float(seen.camera_mm[2])) / math.sqrt(sum(float(x) ** 2 for x in seen.camera_mm))
    area = math.pi * description.acquisition.roi_radius_mm**2 / pixel_on_sample_mm(description, seen) ** 2
    return max(area * slant, 1.0)


def way_s(start: Pose, goal: Pose, description: RigDescription) -> float:
    """How long arms and holder take from pose to pose [s], approaches included."""
    approach = {name: 2.0 * abs(value) for name, value in description.approach_deg().items()}
    times = [
        (math.degrees(abs(getattr(goal, name) - getattr(start, name))) + approach[name]) / axis.speed_deg_per_s
        for name, axis in description.axes().items()
    ]
    return max(times, default=0.0) + SETTLE_S


def reference_s(description: RigDescription) -> float:
    """A visit to the white reference [s], without the way there."""
    seconds = exposure.expected_exposure_s(description, reference_pose(description), 1.0)
    return (description.reference.frames + 1) * (seconds + description.camera.frame_overhead_s)


def darks_s(description: RigDescription) -> float:
    """The dark frames of a run [s]."""
    overhead = description.camera.frame_overhead_s
    return sum(description.acquisition.dark_frames * (t + overhead) for t in exposure.dark_exposures_s(description))


def spent_s(run: Run) -> float:
    """Rig time of the steps that are done [s]: frames, metering and ways by the rig file, and its warm-up.

    By the exposures that were taken, and not by a clock: pauses count for nothing.
    """
    description = run.description
    total, here = description.lamp.warm_up_s, Pose()
    for record in run.steps():
        total += _frames_s(record, description)
        if record.kind != "dark":
            total += way_s(here, record.goal, description)
            here = record.goal
    return total


def _frames_s(record: StepRecord, description: RigDescription) -> float:
    overhead = description.camera.frame_overhead_s
    seconds = sum(frame.exposure_s + overhead for frame in record.frames)
    if record.kind == "dark":
        return seconds
    metered = {frame.band: frame.exposure_s for frame in reversed(record.frames)}
    return seconds + sum(METERING * t * (record.kind == "point") + overhead for t in metered.values())
