"""Last steps of a fit: inside bounds, and down a valley that large residuals bend."""

import numpy as np
import pytest
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.objective import alone
from gonio_analysis.fitting.observations import observations
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.search import refine
from gonio_analysis.fitting.settling import settle
from gonio_analysis.fitting.steps import last_step, newton

from gonio.models import GGX, Lambert, Sum
from gonio.typing import Floats
from tests.gonio_analysis.synthetic import measure

WIDE = np.array([-10.0, -10.0]), np.array([10.0, 10.0])


def test_where_one_parameter_comes_to_its_longest_step_the_other_goes_on() -> None:
    """The second is held at 0.1, and the first makes the rest smallest: x + y = 0.05 and y = 5."""
    jacobian, residual = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([-0.05, -5.0])
    moved = last_step(np.zeros(2), residual, jacobian, *WIDE)
    assert moved == pytest.approx([-0.05, 0.1], abs=1e-15)  # one rounding


def test_a_parameter_without_effect_stays_and_leads_no_other_astray() -> None:
    jacobian, residual = np.array([[1.0, 1e-13], [1.0, -1e-13]]), np.array([-0.04, -0.06])
    moved = last_step(np.zeros(2), residual, jacobian, *WIDE)
    assert moved == pytest.approx([0.05, 0.0], abs=1e-15)  # one rounding


def test_newton_takes_what_bends() -> None:
    """Of x^2 + (9 + x^2/2)^2, halved: slope x + x (9 + x^2/2), curvature 1 + 9 + 3 x^2/2; Gauss has 1 + x^2 alone."""
    x = 0.3
    residual, slopes = np.array([x, 9.0 + x**2 / 2]), np.array([[1.0], [x]])
    step = newton(slopes, residual, np.zeros(1), np.array([[residual[1]]]))
    slope, curvature = x + x * residual[1], 1.0 + x**2 + residual[1]
    assert step == pytest.approx([-slope / curvature], rel=1e-13)  # a few roundings


def test_a_rejected_model_is_settled_where_no_step_helps() -> None:
    """Begun beside the least, at a point that a search may end at: the slope of chi-square has gone."""
    data = observations(measure(Sum((GGX(0.2, 1.5), 1.0), (Lambert(0.3), 1.0)), noise=0.01, seed=1))
    problem, goal = pose(FitRequest("phong")), alone(data)
    start = refine(problem, data, goal, problem.vector({"k_d": 0.3, "k_s": 0.2, "exponent": 50.0}), quick=True)[0]

    def total(x: Floats) -> float:
        return float(np.sum(goal.residual(apparent(problem.model(x), data)) ** 2))

    ends = [settle(problem, data, goal, start + 0.02 * turned)[0] for turned in np.eye(3)]
    assert total(ends[0]) > 10 * len(data), "a model that the data reject"
    # a step that gains less than 1e-4 is the last one, and Newton's leaves far less than it gains
    assert [total(end) for end in ends] == pytest.approx([total(ends[0])] * 3, abs=1e-4)
