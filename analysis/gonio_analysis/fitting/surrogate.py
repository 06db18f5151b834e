"""A fit's neighbourhood: the model near a solution, cheap enough for hundreds of small fits.

Near the solution the model through the instrument's cones is the quick model (the lobe at the cones' centre, and the
spike) times a ratio that hardly changes. The ratio is taken from the solution.
"""

import numpy as np

from gonio.checks.values import Rows
from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.search import refine, to_full
from gonio_analysis.fitting.solution import Solution


class Near:
    """The model of a fit for values of its parameters near the fitted ones, over all or some of its data."""

    def __init__(self, result: Solution, rows: Rows | None = None) -> None:
        self.problem, self.data, self.goal = result.problem, result.data, result.goal
        predicted = result.predicted
        if rows is not None:
            self.data, self.goal, predicted = self.data.take(rows), self.goal.take(rows), predicted[rows]
        self._ratio = to_full(predicted, apparent(result.model, self.data, quick=True))

    def predicted(self, vector: Floats) -> Floats:
        """The model [1/sr] at a point of the search scale."""
        return apparent(self.problem.model(vector), self.data, quick=True) * self._ratio

    def cost(self, vector: Floats) -> float:
        """What `refit` makes small: the sum of squares (or of the losses), priors included."""
        white = self.goal.residual(self.predicted(vector))
        return self.goal.total(np.concatenate([white, self.problem.pulls(vector)]))

    def refit(self, start: Floats, free: Rows, *, limit: int = 30) -> tuple[Floats, float]:
        """The best point with only the parameters `free` moving, and its sum of squares."""
        if free.size == 0:
            return start, self.cost(start)
        x, half = refine(
            self.problem, self.data, self.goal, start, quick=True, limit=limit, free=free, ratio=self._ratio
        )
        return x, 2.0 * half
