"""What a visit to a point will tell and cost: noise and time of its frames, by the level that a model expects there."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from gonio.acquisition import exposure
from gonio.acquisition.duration import Durations
from gonio.acquisition.records import StepRecord
from gonio.acquisition.run import Run
from gonio.acquisition.schedule import reference_pose
from gonio.errors import ConfigError
from gonio.reduction import white_reference
from gonio.reduction.white_reference import Level
from gonio.rig import Pose, Step, sensor_noise
from gonio.rig.description import RigDescription
from gonio.typing import Floats

METERING = 1.25
"""Metering frames of a point, in units of its exposure, as `Durations` has them."""
NOTHING = 1e-9
"""The least reflectance factor that an exposure is planned for."""


@dataclass(frozen=True)
class ExpectedVisits:
    """Visits to points, in one band."""

    u_rel: Floats
    """Relative standard uncertainty by noise of camera and lamp; infinite where nothing is seen."""
    seconds: Floats
    """All frames of all bands, without the way there."""


class Expected:
    """What visits to some poses come to; exposures are those that metering would choose."""

    def __init__(self, durations: Durations, poses: Sequence[Pose]) -> None:
        self._durations, self.poses = durations, poses
        self._pixels = [exposure.expected_pixels(durations.description, pose) for pose in poses]

    def visits(self, brdf: Floats) -> ExpectedVisits:
        """Where the sample has a BRDF [1/sr], one value a pose.

        The noise is that of the EMVA 1288 model (docs/radiometry.md); the dark frames' own is left out.
        """
        factor = np.maximum(math.pi * brdf, NOTHING).tolist()
        seconds = [self._durations.frames_s(Step(0, "point", 0, p), f) for p, f in zip(self.poses, factor, strict=True)]
        each = zip(self.poses, self._pixels, factor, strict=True)
        description = self._durations.description
        weights = [_weight(description, p, pixels, f, description.acquisition.frames) for p, pixels, f in each]
        return ExpectedVisits(np.where(brdf > 0, 1.0 / np.sqrt(weights), np.inf), np.array(seconds))


def level(durations: Durations, steps: Sequence[Step], brdf: Mapping[int, float]) -> tuple[Level, dict[int, float]]:
    """What the visits to the reference among steps will tell of the lamp, a steady one; and when each point comes [s].

    `brdf` are the expected values [1/sr] by point.
    """
    description, here, now = durations.description, Pose(), 0.0
    visits, variances, times = list[float](), list[float](), dict[int, float]()
    for step in steps:
        factor = max(math.pi * brdf[step.point], NOTHING) if step.point is not None else None
        took = durations.step_s(here, step, factor)
        if step.point is not None:
            times[step.point] = now + took
        elif step.kind == "reference":
            pixels = exposure.expected_pixels(description, step.pose)
            visits.append(now + took)
            variances.append(1.0 / _weight(description, step.pose, pixels, 1.0, description.reference.frames))
        now, here = now + took, here if step.kind == "dark" else step.pose
    fitted = white_reference.fit(
        np.array(visits), np.ones(len(visits)), np.array(variances), np.array([*times.values()])
    )
    return fitted, times


def _weight(description: RigDescription, pose: Pose, pixels: float, reflectance: float, frames: int) -> float:
    """1 / (relative variance) of the mean over the region of interest, from all frames of a visit."""
    camera, acquisition = description.camera, description.acquisition
    if acquisition.u_rel_target is not None:
        exposures = exposure.expected_bracket(description, pose, reflectance)
    else:
        single = exposure.expected_exposure_s(description, pose, reflectance)
        exposures = (*(single,) * frames, single / exposure.SHORTER)
    rate = camera.responsivity_e_per_s * reflectance * exposure.cosine_of_incidence(pose)
    out = 0.0
    for t in exposures:
        noise = float(sensor_noise.variance(camera, (rate + camera.dark_current_e_per_s) * t))
        out += 1.0 / max(noise / (pixels * (rate * t) ** 2) + description.lamp.frame_noise**2, 1e-18)
    return out


def batch_s(durations: Durations, poses: Sequence[Pose], seconds: Sequence[float], here: Pose) -> float:
    """How long a batch takes [s] from a pose: visits of so many seconds, ways, and the visits to the reference."""
    description = durations.description
    at_reference = reference_pose(description)
    visit_s = durations.frames_s(Step(0, "reference", pose=at_reference))
    every, total = description.reference.every or len(poses), 0.0
    for k, (pose, own_s) in enumerate(zip(poses, seconds, strict=True)):
        total += durations.move_s(here, pose) + own_s
        here = pose
        if (k + 1) % every == 0 or k + 1 == len(poses):
            total += durations.move_s(here, at_reference) + visit_s
            here = at_reference
    return total


def require_budget(where: str, budget_s: float, durations: Durations, poses: Sequence[Pose]) -> None:
    """Raise `ConfigError` where a budget [s] does not hold what is measured before anything is known, at some poses."""
    seconds = [durations.frames_s(Step(0, "point", 0, pose)) for pose in poses]
    least = durations.description.lamp.warm_up_s + durations.frames_s(Step(0, "dark"))
    least += batch_s(durations, poses, seconds, Pose())
    if budget_s < least:
        raise ConfigError(
            f"{where} budget_h = {budget_s / 3600.0:g}: dark frames, a visit to the reference and the first "
            f"{len(poses)} points alone take about {least / 3600.0:.2g} h on this rig"
        )


def spent_s(durations: Durations, run: Run) -> float:
    """Rig time of the steps that are done [s]: the frames that were taken, their metering, and the ways.

    By exposures and not by a clock: pauses count for nothing, and a run that is gone on with has the same.
    """
    total, here = durations.description.lamp.warm_up_s, Pose()
    for record in run.steps():
        total += _frames_s(record, durations.description.camera.frame_overhead_s)
        if record.kind != "dark":
            total += durations.move_s(here, record.goal)
            here = record.goal
    return total


def _frames_s(record: StepRecord, overhead_s: float) -> float:
    seconds = sum(frame.exposure_s + overhead_s for frame in record.frames)
    if record.kind == "dark":
        return seconds
    metered = {frame.band: frame.exposure_s for frame in reversed(record.frames)}  # the first frame of each band
    return seconds + sum(METERING * t + overhead_s for t in metered.values())
