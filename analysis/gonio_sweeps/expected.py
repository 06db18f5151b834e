"""What a visit to a point will tell and cost: noise and time of its frames, and what it says of a model's parameters.

Noise and time follow from the level that a model expects there. What points tell of parameters is Fisher information
with nuisances: a value y_j = f_j(parameters) + sum_k n_jk z_k + noise_j has the parameters p of the model and the
common causes z of the run as unknowns. Causes are known beforehand to one standard deviation: scale of the reference,
drift, zeros of the angles. Then the information matrix of both together adds up over visits,

    M = diag(0 ... 0, 1 ... 1) + sum_j v_j v_j^T / u_j^2,    v_j = (df_j/dp, n_j),

and the covariance of the parameters, whatever the causes are, is the upper left block of its inverse [Fedorov1972].
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gonio_analysis.fitting.forward import EXTREME, HIGHEST, apparent
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import derivatives
from gonio_analysis.fitting.value_covariance import Covariance

from gonio.errors import ConfigError
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.lab.acquisition import exposure
from gonio.lab.acquisition.duration import Durations
from gonio.lab.acquisition.records import StepRecord
from gonio.lab.acquisition.run import Run
from gonio.lab.acquisition.schedule import reference_pose
from gonio.lab.reduction import white_reference
from gonio.lab.reduction.angle_errors import CAUSES, angle_axes, zero_uncertainties
from gonio.lab.reduction.white_reference import Level
from gonio.lab.rig import Pose, Step, kinematics
from gonio.lab.rig.description import RigDescription
from gonio.typing import Floats
from gonio_sweeps.candidates import half_angles, read

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
        weights = [
            exposure.expected_weight(description, p, pixels, f, description.acquisition.frames) for p, pixels, f in each
        ]
        return ExpectedVisits(np.where(brdf > 0, 1.0 / np.sqrt(weights), np.inf), np.array(seconds))


def level(durations: Durations, steps: Sequence[Step], brdf: Mapping[int, float]) -> tuple[Level, dict[int, float]]:
    """What the visits to the reference among steps will tell of the lamp, a steady one; and when each point comes [s].

    `brdf` are the expected values [1/sr] by point.
    """
    description, here, now = durations.description, Pose(), 0.0
    visits, variances, times = list[float](), list[float](), dict[int, float]()
    for step in steps:
        factor = max(math.pi * brdf[step.point], NOTHING) if step.point is not None else None
        took = durations.step(here, step, factor).total_s
        if step.point is not None:
            times[step.point] = now + took
        elif step.kind == "reference":
            pixels = exposure.expected_pixels(description, step.pose)
            visits.append(now + took)
            variances.append(
                1.0 / exposure.expected_weight(description, step.pose, pixels, 1.0, description.reference.frames)
            )
        now, here = now + took, here if step.kind == "dark" else step.pose
    fitted = white_reference.fit(
        np.array(visits), np.ones(len(visits)), np.array(variances), np.array([*times.values()])
    )
    return fitted, times


def batch_s(durations: Durations, poses: Sequence[Pose], seconds: Sequence[float], here: Pose) -> float:
    """How long a batch takes [s] from a pose: visits of so many seconds, ways, and the visits to the reference."""
    description = durations.description
    at_reference = reference_pose(description)
    visit_s = durations.frames_s(Step(0, "reference", pose=at_reference))
    every, total = description.reference.every or len(poses), 0.0
    for k, (pose, own_s) in enumerate(zip(poses, seconds, strict=True)):
        move_s = durations.move_s(here, pose)
        total += move_s + own_s - durations.beside_s(move_s)
        here = pose
        if (k + 1) % every == 0 or k + 1 == len(poses):
            move_s = durations.move_s(here, at_reference)
            total += move_s + visit_s - durations.beside_s(move_s)
            here = at_reference
    return total


def require_budget(where: str, budget_s: float, durations: Durations, poses: Sequence[Pose]) -> None:
    """Raise `ConfigError` where a budget [s] does not hold what is measured before anything is known, at some poses."""
    seconds = [durations.frames_s(Step(0, "point", 0, pose)) for pose in poses]
    least = durations.description.lamp.warm_up_s + durations.frames_s(Step(0, "dark"))
    least += batch_s(durations, poses, seconds, Pose())
    if budget_s < least:
        raise ConfigError(
            f"{where} budget_h = {budget_s / 3600.0:g}: dark frames, a measurement of the reference and the first "
            f"{len(poses)} points alone take about {least / 3600.0:.2g} h on this rig"
        )


def spent_s(durations: Durations, run: Run) -> float:
    """Rig time of the steps that are done [s]: the frames that were taken, their metering, and the ways.

    By exposures and not by a clock: pauses count for nothing, and a run that is gone on with has the same.
    """
    total, here = durations.description.lamp.warm_up_s, Pose()
    for record in run.steps():
        total += _frames_s(record, durations.description.camera.beside_s)
        if record.kind != "dark":
            move_s = durations.move_s(here, record.goal)
            total += move_s - durations.beside_s(move_s)
            here = record.goal
    return total


def _frames_s(record: StepRecord, overhead_s: float) -> float:
    seconds = sum(frame.exposure_s + overhead_s for frame in record.frames)
    if record.kind == "dark":
        return seconds
    metered = {frame.band: frame.exposure_s for frame in reversed(record.frames)}  # the first frame of each band
    return seconds + sum(METERING * t + overhead_s for t in metered.values())


EVEN = "even"
"""The cause that is what errors of the angles change evenly: on top of a peak they only lower a value, repeats too."""


@dataclass(frozen=True)
class PredictedRows:
    """Values at some directions, as a model has them at one set of parameters."""

    brdf: Floats
    """(n,) [1/sr]"""
    parameters: Floats
    """d(brdf)/d(parameter) on the search scale, (n, p)."""
    of_angles: dict[str, Floats]
    """By cause: the change of the values [1/sr] for one standard deviation of the zero of an axis, (n,); and `EVEN`."""
    u_landing: Floats
    """Standard uncertainty [1/sr] by the encoders' steps, (n,).

    Beside the edge of a spike the values of a point are not normally distributed: most visits see nothing of it, and a
    few see much. There it is the largest departure from what the slopes say.
    """


class Sights:
    """Values at the directions of `at`, which poses of a rig lead to, and what they are where an axis stands elsewhere.

    Both are the same for all parameters, and are made once.
    """

    def __init__(self, at: Observations, poses: Sequence[Pose], description: RigDescription) -> None:
        self.at = at
        self._moved: list[tuple[str, Observations, Observations, Floats, Floats]] = []
        self._extreme: list[tuple[Observations, Floats, list[tuple[int, float]]]] = []
        at_zero, far = zero_uncertainties(description), dict[str, tuple[float, int, float]]()
        for name, axis in angle_axes(description).items():
            count, noise = math.radians(axis.encoder_step_deg), math.radians(axis.encoder_noise_deg)
            u, u_zero = math.hypot(count / math.sqrt(12.0), noise), at_zero.get(name, 0.0)
            for step, cause in ((u, ""), (u_zero, CAUSES[name])):
                if step > 0.0:
                    if name in ("light", "camera"):
                        far[name] = 0.5 * count + EXTREME * math.hypot(noise, u_zero), len(self._moved), step
                    up, down = (self._turned(poses, description, {name: by}) for by in (step, -step))
                    self._moved.append((cause, up[0], down[0], up[1], down[1]))
        for signs in itertools.product((1.0, -1.0), repeat=len(far)):
            by = {name: sign * most for sign, (name, (most, _, _)) in zip(signs, far.items(), strict=True)}
            slopes = [(which, by[name] / step) for name, (_, which, step) in far.items()]
            self._extreme.append((*self._turned(poses, description, by), slopes))

    def _turned(
        self, poses: Sequence[Pose], description: RigDescription, by: Mapping[str, float]
    ) -> tuple[Observations, Floats]:
        """Where the values truly are if axes stand `by` [rad] beside what is read, and the ratio of the cosines."""
        moved = [replace(p, **{axis: getattr(p, axis) + off for axis, off in by.items()}) for p in poses]
        there = [kinematics.directions(description, pose) for pose in moved]
        theta_i, phi_i, theta_r, phi_r = Directions.stack(there).angles
        inside = Directions(np.minimum(theta_i, HIGHEST), phi_i, np.minimum(theta_r, HIGHEST), phi_r)
        return replace(self.at, directions=inside), np.cos(theta_i) / np.cos(self.at.directions.theta_i)

    def rows(self, problem: Problem, vector: Floats) -> PredictedRows:
        """What a model at a point of the search scale has there."""
        found = self.of_model(problem.model(vector))
        return replace(found, parameters=derivatives(problem, self.at, vector, quick=True))

    def of_model(self, model: Any) -> PredictedRows:
        """What a model has there, without parameters.

        A value stands for the angles that were read, cos(theta_i) of the truth over that of the reading
        (docs/radiometry.md, "The budget").
        """
        here = apparent(model, self.at, quick=True)
        landing, even, of_angles = np.zeros(len(self.at)), np.zeros(len(self.at)), {}
        odds = []
        for cause, at_up, at_down, by_up, by_down in self._moved:
            up, down = apparent(model, at_up, quick=True) * by_up, apparent(model, at_down, quick=True) * by_down
            even += 0.5 * (up + down) - here
            odds.append(0.5 * (up - down))
            if cause:
                of_angles[cause] = odds[-1]
            else:
                landing += odds[-1] ** 2
        most = np.zeros(len(self.at))
        for there, ratio, slopes in self._extreme:
            straight = sum((odds[which] * factor for which, factor in slopes), here)
            most = np.maximum(most, np.abs(apparent(model, there, quick=True) * ratio - straight))
        none = np.zeros((len(self.at), 0))
        return PredictedRows(here, none, of_angles | {EVEN: even}, np.hypot(np.sqrt(landing), most))


def sights_ahead(description: RigDescription, poses: Sequence[Pose], wavelength_nm: float) -> Sights:
    """Where poses lead that nobody has taken yet, as encoders will show them."""
    shown = read(description, poses)
    directions = Directions.stack([kinematics.directions(description, pose) for pose in shown])
    return sights_at(description, shown, directions, wavelength_nm)


def sights_at(
    description: RigDescription, poses: Sequence[Pose], directions: Directions, wavelength_nm: float
) -> Sights:
    """Where poses lead, in directions that are known."""
    none = np.zeros(len(poses))
    return Sights(observed(description, directions, wavelength_nm, none, None), poses, description)


def observed(
    description: RigDescription, at: Directions, wavelength_nm: float, brdf: Floats, covariance: Covariance | None
) -> Observations:
    """Values that a rig has in some directions, as fits take them."""
    source, receiver = (float(solid_angle_of_cone(half)) for half in half_angles(description))
    waves, rows = np.full(brdf.size, wavelength_nm), np.arange(brdf.size)
    return Observations(at, waves, brdf, covariance, rows, source, receiver)


@dataclass(frozen=True)
class KnownTogether:
    """What is known of parameters and causes together."""

    information: Floats
    """(p + k, p + k), parameters first."""
    count: int
    """p"""

    @classmethod
    def nothing(cls, ranges: Floats, causes: int) -> KnownTogether:
        """Before the first value: of each parameter its range on the search scale is known."""
        return cls(np.diag(np.concatenate([1.0 / ranges**2, np.ones(causes)])), ranges.size)

    def with_values(self, design: Floats, u: Floats, times: Floats | None = None) -> KnownTogether:
        """After values with the rows (n, p + k) and the independent standard uncertainties (n,); each so many times."""
        weights = (1.0 if times is None else times) / u**2
        return replace(self, information=self.information + (design * weights[:, None]).T @ design)

    @property
    def covariance(self) -> Floats:
        """Covariance of parameters and causes."""
        size = np.sqrt(np.diag(self.information))
        return np.asarray(np.linalg.inv(self.information / np.outer(size, size)) / np.outer(size, size))

    @property
    def u(self) -> Floats:
        """Standard uncertainty of every parameter, on the search scale."""
        return np.sqrt(np.diag(self.covariance)[: self.count])


def gains(covariance: Floats, count: int, design: Floats, u: Floats, weights: Floats | None) -> Floats:
    """What one more value of each row adds: by how much it lowers the logarithm of the mean uncertainty.

    Parameters
    ----------
    covariance
        Of parameters and causes, so far.
    count
        How many are parameters.
    design, u
        Rows (n, p + k), and the independent standard uncertainties (n,).
    weights
        1 / target^2 of every parameter (p,): then the mean is that of u^2 / target^2 (A-optimality of the scaled
        parameters); None: that of the logarithms, the determinant (D-optimality).
    """
    moved = design @ covariance  # (n, q)
    spread = np.einsum("nq,nq->n", moved, design) + u**2
    of_parameters = moved[:, :count]
    block = covariance[:count, :count]
    if weights is None:
        size = np.sqrt(np.diag(block))
        inverse = np.linalg.inv(block / np.outer(size, size)) / np.outer(size, size)
        share = np.einsum("np,pq,nq->n", of_parameters, inverse, of_parameters) / spread
        return np.asarray(-0.5 * np.log1p(-np.minimum(share, 1.0 - 1e-12)) / count)
    total = float(np.sum(np.diag(block) * weights))
    return np.asarray(-0.5 * np.log1p(-np.minimum((of_parameters**2 @ weights) / spread / total, 1.0 - 1e-12)))
