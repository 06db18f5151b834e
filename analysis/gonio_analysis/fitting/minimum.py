"""The least sum of a fit: ends of a search with the quick model, refined through the cones of the instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gonio.models.parameters import Values
from gonio.progress import Say
from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent, by_model, pointlike
from gonio_analysis.fitting.objective import Objective, scaled_to
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem, acceptable
from gonio_analysis.fitting.search import refine, search, search_from
from gonio_analysis.fitting.settling import settle

BOUND_FIRST = 30.0
"""Factor by which the bound is softer at first, for a search along a steep wall takes many short steps."""
OTHERS, ALIKE = 2, 1.01
"""Ends of a search that are tried through the cones, beside the one that is best at their centres; of those whose sums
are within the factor, last steps tell which is the least."""
CONES = 2.0
"""Factor by which the cones lower a sum, at most, of a start that is looked at through them."""


def minimised(
    problem: Problem, data: Observations, start: Sequence[Values] | None, say: Say
) -> tuple[Observations, Objective, Floats, Floats]:
    """The values with scales by a model near the least, what is made small, the least, and the Jacobian there.

    From given starts it ends no higher than any of them, so that a sum never ends above its part.
    """
    ends = search(problem, data, say) if start is None else search_from(problem.softer(BOUND_FIRST), data, start, say)
    found = [_through_cones(problem, data, *ends[0], say)]
    weighted = problem.asked.metric is None and data.covariance is not None and not pointlike(data)
    if weighted and 2.0 * found[0][3] > acceptable(len(data) - len(problem.free)):
        off = abs(found[0][3] - ends[0][1])  # what the cones change: ends that differ by less are in no order
        others = [end for end in ends[1:] if end[1] - ends[0][1] < off][:OTHERS]
        found += [_through_cones(problem, data, *end, say) for end in others]
    below = starts_below(problem, *found[0][:2], start or (), min(cost for *_, cost in found))
    found += [_through_cones(problem, data, *end, say) for end in below]
    least = min(cost for *_, cost in found)
    settled = [
        (data, goal, *settle(problem, data, goal, as_stated(problem, vector)))
        for data, goal, vector, cost in found
        if len(found) == 1 or cost <= ALIKE * least
    ]
    if len(settled) == 1:
        return settled[0]
    return min(settled, key=lambda one: one[1].total(one[1].residual(apparent(problem.model(one[2]), one[0]))))


def starts_below(
    problem: Problem,
    data: Observations,
    goal: Objective,
    starts: Sequence[Values],
    least: float,
    *,
    quick: bool = False,
) -> list[tuple[Floats, float]]:
    """Starts whose half sums are below what searches from them have come to, and these."""

    def cost(vector: Floats, quick: bool) -> float:
        residual = goal.residual(apparent(problem.model(vector), data, quick=quick))
        return 0.5 * goal.total(np.concatenate([residual, problem.pulls(vector)]))

    close = [vector for vector in map(problem.vector, starts) if cost(vector, True) < CONES * least]
    return [(vector, found) for vector in close if (found := cost(vector, quick)) < least]


def _through_cones(
    problem: Problem, data: Observations, vector: Floats, cost: float, say: Say
) -> tuple[Observations, Objective, Floats, float]:
    """From the end of a search with the quick model to that with the full one, as `minimised`; and half its sum."""
    asked, found = problem.asked, apparent(problem.model(vector), data, quick=True)
    data = by_model(data, problem.model(vector), found)
    goal = replace(scaled_to(data, found, asked.metric), loss=asked.loss)
    done = asked.metric is None and problem.bound is None  # the search has made the same sum small, without more ado
    if done and pointlike(data) and (goal.weights is None or not goal.weights.causes):
        return data, goal, vector, cost
    return data, goal, *refine(problem, data, goal, vector, say=say)


def as_stated(problem: Problem, vector: Floats) -> Floats:
    """The same model by the values that state it, where nothing holds one of them."""
    values = problem.values(vector)
    stated = problem.family.stated(values)
    moved = {name for name in stated if stated[name] != values[name]}
    other, (lower, upper) = problem.vector(stated), problem.bounds
    free = moved <= set(problem.free) and not problem.priors
    return other if moved and free and bool(np.all((lower <= other) & (other <= upper))) else vector
