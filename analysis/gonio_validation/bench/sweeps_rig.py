"""A rig that measures points without frames: values, noise and times as the simulated rig `sim` has them.

A run of thousands of frames takes an hour of processor time, and `gonio bench sweeps` needs hundreds of runs. So the
camera is left out. A value is that of the true sample through the cones of lamp and lens, in the direction where the
axes truly stand: within a step of what their encoders read, with zeros that are wrong alike for a whole run. It has
the noise that the EMVA 1288 model of the camera and the lamp's own predict for the frames of the point, and a scale
that is wrong by the reference's and by the mean of its visits. `tests/gonio_validation/bench/test_sweeps.py` holds it
against runs of the simulated rig with its frames.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gonio_sweeps import expected
from gonio_sweeps.candidates import snake
from gonio_sweeps.online import GrowingValues

from gonio.acquisition.duration import Durations
from gonio.acquisition.plan import Point
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.instrument import apparent_brdf
from gonio.models import Model
from gonio.rig import Pose, Step, kinematics
from gonio.rig.bands import Band
from gonio.rig.description import RigDescription
from gonio.typing import Floats

BEYOND = math.radians(89.9)
"""Errors of an angle turn no direction below the horizon: theta ends here."""


@dataclass
class MeasuredSweep:
    """What a run has so far."""

    values: GrowingValues
    seconds: float
    """Rig time."""


class FrameFreeRig:
    """Measures points of one sample, in one run.

    Parameters
    ----------
    description
        A rig without errors of alignment.
    band
        The one band of the run.
    model
        The true sample.
    seed
        What is wrong in this run: zeros, and the scale.
    noise
        What its noise is, and where motors stop within an encoder's step.
    """

    def __init__(self, description: RigDescription, band: Band, model: Model, seed: Sequence[int], noise: int) -> None:
        self.description, self.band, self.model = description, band, model
        self.durations = Durations(description, (band,))
        systematic = np.random.default_rng([*seed, 0])
        self._rng = np.random.default_rng([*seed, 1, noise])
        axes = description.axes()
        self._zero = {name: math.radians(a.zero_u_deg) * systematic.standard_normal() for name, a in axes.items()}
        self._step = {name: math.radians(axis.encoder_step_deg) for name, axis in axes.items()}
        reference = description.reference
        of_visits = description.lamp.frame_noise / math.sqrt(reference.frames)
        self._u_scale = {"s_reference": reference.u_rel, "s_reference_noise": of_visits / math.sqrt(2.0)}
        drawn = {"s_reference": reference.error == "drawn", "s_reference_noise": True}
        errors = [u * systematic.standard_normal() * drawn[name] for name, u in self._u_scale.items()]
        self._scale = 1.0 + math.fsum(errors)

    def truth(self, d: Directions) -> Floats:
        """The sample through the cones of lamp and lens [1/sr]."""
        cones = [solid_angle_of_cone(math.radians(a)) for a in self._cones]
        theta_i, theta_r = np.minimum(d.theta_i, BEYOND), np.minimum(d.theta_r, BEYOND)
        return np.asarray(
            apparent_brdf(
                self.model, theta_i, d.phi_i, theta_r, d.phi_r, wavelength_nm=self.band.centre_nm,
                source_solid_angle_sr=float(cones[0]), receiver_solid_angle_sr=float(cones[1]), spike="exact",
            )
        )  # fmt: skip

    @property
    def _cones(self) -> tuple[float, float]:
        return self.description.lamp.half_angle_deg, self.description.camera.lens_half_angle_deg

    def measure(self, poses: Sequence[Pose], before: MeasuredSweep | None = None) -> MeasuredSweep:
        """Visit poses, with the visits to the reference that belong to them; all values so far."""
        read = [self._read(pose) for pose in poses]
        at = Directions.stack([kinematics.directions(self.description, pose) for pose in read])
        truly = Directions.stack([kinematics.directions(self.description, self._landed(pose)) for pose in read])
        true = self.truth(truly)
        seen = expected.Expected(self.durations, read).visits(true)
        u = np.where(np.isfinite(seen.u_rel), seen.u_rel, 1.0) * np.abs(true)
        values = true * self._scale + u * self._rng.standard_normal(u.size)
        here = Pose() if before is None else before.values.poses[-1]
        seconds = expected.batch_s(self.durations, read, [float(s) for s in seen.seconds], here)
        if before is None:
            seconds += self.description.lamp.warm_up_s + self.durations.frames_s(Step(0, "dark"))
        none = np.zeros(u.size)
        new = GrowingValues(
            rows=np.arange(u.size), directions=at, poses=tuple(read), brdf=values, u_noise=u,
            common={name: values * s for name, s in self._u_scale.items()}, time_s=none,
        )  # fmt: skip
        return (
            MeasuredSweep(new, seconds)
            if before is None
            else MeasuredSweep(joined(before.values, new), before.seconds + seconds)
        )

    def _read(self, pose: Pose) -> Pose:
        """What the encoders read where the motors stop."""
        return replace(
            pose, **{n: round(getattr(pose, n) / step) * step for n, step in self._step.items() if step > 0.0}
        )

    def _landed(self, pose: Pose) -> Pose:
        """Where the axes stand."""
        within = {n: (self._rng.random() - 0.5) * step + self._zero[n] for n, step in self._step.items()}
        return replace(pose, **{n: getattr(pose, n) + error for n, error in within.items()})


def joined(a: GrowingValues, b: GrowingValues) -> GrowingValues:
    """Values of one run, one after the other."""

    def both(x: Any, y: Any) -> Any:
        return np.concatenate([x, y])

    angles = [both(x, y) for x, y in zip(a.directions.angles, b.directions.angles, strict=True)]
    return GrowingValues(
        rows=np.arange(len(a) + len(b)), directions=Directions(*angles), poses=a.poses + b.poses,
        brdf=both(a.brdf, b.brdf), u_noise=both(a.u_noise, b.u_noise),
        common={name: both(a.common[name], b.common[name]) for name in a.common}, time_s=both(a.time_s, b.time_s),
    )  # fmt: skip


def in_order(points: Sequence[Point], poses: Sequence[Pose]) -> list[Pose]:
    """Poses of points in an order that saves travel."""
    return [poses[k] for k in snake(list(points))]
