"""The information of visits is that of least squares with the whole covariance, and gains are what it grows by."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.value_covariance import Covariance, independent
from gonio_sweeps.expected import KnownTogether, Sights, gains

from gonio import models
from gonio.geometry import Directions, solid_angle_of_cone
from gonio.lab.acquisition.measure import find_rig
from gonio.lab.rig import Pose, kinematics

RNG = np.random.default_rng(3)
JACOBIAN = RNG.normal(size=(40, 2))
COMMON = RNG.normal(size=(40, 3))
U = RNG.uniform(0.5, 2.0, 40)
WIDE = np.full(2, 1e6)
"""Ranges of the parameters: so wide that they tell nothing."""


def known() -> KnownTogether:
    return KnownTogether.nothing(WIDE, 3).with_values(np.concatenate([JACOBIAN, COMMON], axis=1), U)


def test_common_causes_count_as_in_a_fit_with_their_covariance() -> None:
    white = Covariance(U, COMMON, ("a", "b", "c")).whiten(JACOBIAN)
    # 1e-8: the ranges' own information is 1e-12 of the data's, and double precision loses less
    assert known().covariance[:2, :2] == pytest.approx(np.linalg.inv(white.T @ white), rel=1e-8)


@pytest.mark.parametrize("weights", [None, np.array([1.0, 25.0])])
def test_a_gain_is_what_one_more_value_lowers_the_log_uncertainty_by(weights: np.ndarray | None) -> None:
    design = RNG.normal(size=(5, 5))
    u = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
    before = known()
    found = gains(before.covariance, 2, design, u, weights)
    for k in range(5):
        after = before.with_values(design[k : k + 1], u[k : k + 1])

        def size(state: KnownTogether) -> float:
            block = state.covariance[:2, :2]
            if weights is None:
                return 0.25 * float(np.linalg.slogdet(block)[1])  # of two parameters, and of u and not of its square
            return 0.5 * float(np.log(np.diag(block) @ weights))

        # 1e-9: both are sums of a few products in double precision
        assert found[k] == pytest.approx(size(before) - size(after), rel=1e-9, abs=1e-9)


def test_repeats_do_not_beat_a_common_scale() -> None:
    """A level that is known to 1 % stays at 1 %, however often it is measured."""
    level = np.ones((1, 1))
    design = np.concatenate([level, 0.01 * level], axis=1)  # search scale: logarithm of the level
    state = KnownTogether.nothing(np.array([1e3]), 1).with_values(design, np.array([0.005]), np.array([1e6]))
    assert state.u[0] == pytest.approx(0.01, rel=1e-3)  # the million values leave 0.0005 %


def test_landings_beside_the_edge_of_a_spike_are_no_surprise() -> None:
    """Most visits there see nothing of the spike; the few that do are within what is stated."""
    description = find_rig("sim").description
    cone = float(solid_angle_of_cone(math.radians(description.lamp.half_angle_deg)))

    def at(poses: list[Pose]) -> Observations:
        directions, one = Directions.stack([kinematics.directions(description, p) for p in poses]), np.ones(len(poses))
        return Observations(directions, 500.0 * one, one, independent(one), np.arange(one.size), cone, cone)

    away_deg = np.array([-3.0, -1.07, -1.0, 0.0, 1.0, 1.07, 1.12, 3.0])  # the spike ends one degree away
    poses = [Pose(light=math.radians(-75.0), camera=math.radians(75.0 + x)) for x in away_deg]
    problem = pose(FitRequest("he-torrance", ior="Al"))
    vector = problem.vector({"sigma0_um": 0.28, "tau_um": 1.77, "diffuse_albedo": 0.0})
    rows = Sights(at(poses), poses, description).rows(problem, vector)
    truth = models.HeTorrance(sigma0_um=0.28, tau_um=1.77, ior="Al", diffuse_albedo=0.0)
    rng, step = np.random.default_rng(1), math.radians(0.088)
    drawn = []
    for _ in range(400):
        light, camera = step * (rng.random(2) - 0.5) + math.radians(0.02) * rng.normal(size=2)
        drawn.append(apparent(truth, at([Pose(light=p.light + light, camera=p.camera + camera) for p in poses])))
    off = (np.array(drawn) - rows.brdf) / rows.brdf
    by_zero = np.hypot(*(rows.of_angles[name] for name in ("s_theta_i_zero", "s_theta_r_zero")))
    u = np.sqrt(rows.u_landing**2 + by_zero**2 + rows.of_angles["even"] ** 2) / rows.brdf
    # noise of a visit is about 0.5 %; 3.5 standard deviations are one in 2000 if they are normally distributed
    assert np.all(np.abs(off) < 3.5 * np.hypot(u, 0.005))
    assert np.all(u[[0, 7]] < 0.01), "away from the spike nothing is as uncertain"
    assert np.abs(off[:, 5]).max() > 0.05, "and some visits do see it"
