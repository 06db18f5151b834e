"""A fit's neighbourhood: the model near a solution, cheap enough for hundreds of small fits.

Near the solution the model through the instrument's cones is the quick model (the lobe at the cones' centre, and the
spike) times a ratio that hardly changes. The ratio is taken from the solution.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.search import one_sided
from gonio_analysis.fitting.solution import Solution

Rows = npt.NDArray[np.intp]


class Near:
    """The model of a fit for values of its parameters near the fitted ones, over all or some of its data."""

    def __init__(self, result: Solution, rows: Rows | None = None) -> None:
        self.problem = result.problem
        self.data = result.data if rows is None else result.data.take(rows)
        goal = result.goal
        if rows is not None:
            goal = goal.take(rows)
        self.goal = goal
        centre = apparent(result.model, self.data, quick=True)
        predicted = result.predicted if rows is None else result.predicted[rows]
        with np.errstate(divide="ignore", invalid="ignore"):
            self._ratio = np.nan_to_num(np.clip(predicted / centre, 0.2, 5.0), nan=1.0)

    def predicted(self, vector: Floats) -> Floats:
        """The model [1/sr] at a point of the search scale."""
        return apparent(self.problem.model(vector), self.data, quick=True) * self._ratio

    def cost(self, vector: Floats) -> float:
        """What `refit` makes small: the sum of squares (or of the losses), priors included."""
        white = self.goal.residual(self.predicted(vector))
        return self.goal.total(np.concatenate([white, self.problem.pulls(vector)]))

    def refit(self, start: Floats, free: Rows, *, limit: int = 30) -> tuple[Floats, float]:
        """The best point with only the parameters `free` moving, and its sum of squares."""
        from scipy.optimize import least_squares

        def whole(part: Floats) -> Floats:
            x = start.copy()
            x[free] = part
            return x

        latest: dict[bytes, Floats] = {}

        def residual(part: Floats) -> Floats:
            x = whole(part)
            centre = apparent(self.problem.model(x), self.data, quick=True)
            latest.clear()
            latest[part.tobytes()] = centre
            return np.concatenate([self.goal.residual(centre * self._ratio), self.problem.pulls(x)])

        def jacobian(part: Floats) -> Floats:
            x = whole(part)
            centre = latest.get(part.tobytes())
            if centre is None:
                centre = apparent(self.problem.model(x), self.data, quick=True)
            columns = one_sided(self.problem, self.data, x, centre, only=free) * self._ratio[:, None]
            rows = self.goal.jacobian(centre * self._ratio, columns)
            return np.concatenate([rows, self.problem.pull_slopes(x)[:, free]])

        if free.size == 0:
            return start, self.cost(start)
        lower, upper = (bound[free] for bound in self.problem.bounds)
        margin = 1e-9 * (upper - lower)
        found = least_squares(
            residual,
            np.clip(start[free], lower + margin, upper - margin),
            jac=jacobian,
            bounds=(lower, upper),
            x_scale="jac",
            loss=self.goal.loss,
            xtol=1e-6,
            ftol=1e-6,
            gtol=1e-10,
            max_nfev=limit,
        )
        return whole(found.x), 2.0 * float(found.cost)
