"""What points tell of a model's parameters: Fisher information with nuisances, and the visits that add most of it.

A value y_j = f_j(parameters) + sum_k n_jk z_k + noise_j has the parameters p of the model and the common causes z of the
run as unknowns. Causes are known beforehand to one standard deviation: scale of the reference, drift, zeros of the
angles. Then the information matrix of both together adds up over visits,

    M = diag(0 ... 0, 1 ... 1) + sum_j v_j v_j^T / u_j^2,    v_j = (df_j/dp, n_j),

and the covariance of the parameters, whatever the causes are, is the upper left block of its inverse [Fedorov1972].
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.geometry import Directions
from gonio.reduction.table import CAUSES, angle_axes, zero_uncertainties
from gonio.rig import Pose, kinematics
from gonio.rig.description import RigDescription
from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import derivatives

ANGLE_STEP = math.radians(0.05)
"""Of the differences that tell how a model changes with an axis: about an encoder's step."""

@dataclass(frozen=True)
class Rows:
    """Values at some directions, as a model has them at one set of parameters."""

    brdf: Floats
    """(n,) [1/sr]"""
    parameters: Floats
    """d(brdf)/d(parameter) on the search scale, (n, p)."""
    zeros: dict[str, Floats]
    """By cause: the change of the values [1/sr] for one standard deviation of the zero of an axis, (n,)."""
    u_landing: Floats
    """Standard uncertainty [1/sr] by the encoders' steps, (n,)."""


def rows(
    problem: Problem, vector: Floats, at: Observations, poses: Sequence[Pose], description: RigDescription
) -> Rows:
    """What a model at a point of the search scale has at the directions of `at`, which poses of the rig lead to.

    A value stands for the angles that were read, cos(theta_i) of the truth over that of the reading
    (docs/radiometry.md, "The budget").
    """
    model = problem.model(vector)
    here = apparent(model, at, quick=True)
    moved = {axis: _slope(model, at, poses, description, axis) for axis in angle_axes(description)}
    landing = np.zeros(len(at))
    for name, axis in angle_axes(description).items():
        u = math.hypot(math.radians(axis.encoder_step_deg) / math.sqrt(12.0), math.radians(axis.encoder_noise_deg))
        landing += (moved[name] * u) ** 2
    zeros = {CAUSES[name]: moved[name] * u for name, u in zero_uncertainties(description).items() if u > 0}
    return Rows(here, derivatives(problem, at, vector, quick=True), zeros, np.sqrt(landing))


def _slope(
    model: object, at: Observations, poses: Sequence[Pose], description: RigDescription, axis: str
) -> Floats:
    """d(value)/d(angle of an axis) [1/sr per rad]."""
    values, read = [], np.cos(at.directions.theta_i)
    for by in (ANGLE_STEP, -ANGLE_STEP):
        there = [
            kinematics.directions(description, replace(pose, **{axis: getattr(pose, axis) + by})) for pose in poses
        ]
        directions = Directions.stack(there)
        theta_i, phi_i, theta_r, phi_r = directions.angles
        most = 0.5 * math.pi - 1e-6
        inside = Directions(np.minimum(theta_i, most), phi_i, np.minimum(theta_r, most), phi_r)
        values.append(apparent(model, replace(at, directions=inside), quick=True) * np.cos(theta_i) / read)
    return (values[0] - values[1]) / (2.0 * ANGLE_STEP)


@dataclass(frozen=True)
class Known:
    """What is known of parameters and causes together."""

    information: Floats
    """(p + k, p + k), parameters first."""
    count: int
    """p"""

    @classmethod
    def nothing(cls, ranges: Floats, causes: int) -> Known:
        """Before the first value: of each parameter its range on the search scale is known."""
        return cls(np.diag(np.concatenate([1.0 / ranges**2, np.ones(causes)])), ranges.size)

    def with_values(self, design: Floats, u: Floats, times: Floats | None = None) -> Known:
        """After values with the rows (n, p + k) and the independent standard uncertainties (n,); each so many times."""
        weights = (1.0 if times is None else times) / u**2
        return replace(self, information=self.information + (design * weights[:, None]).T @ design)

    @property
    def covariance(self) -> Floats:
        """Of parameters and causes."""
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
        return -0.5 * np.log1p(-np.minimum(share, 1.0 - 1e-12)) / count
    total = float(np.sum(np.diag(block) * weights))
    return -0.5 * np.log1p(-np.minimum((of_parameters**2 @ weights) / spread / total, 1.0 - 1e-12))

