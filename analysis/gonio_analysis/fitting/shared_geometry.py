"""The problem of a fit whose wavelengths share the geometry of the surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from gonio.checks.values import Rows
from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import Averaging, apparent, averaging, pointlike
from gonio_analysis.fitting.objective import Objective, alone, scaled_to, with_misfit
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import LONG, derivatives, least, to_full
from gonio_analysis.fitting.steps import last_step
from gonio_analysis.fitting.value_covariance import independent

Evaluated = tuple[Floats, Floats]
"""Residuals (m,) and their derivatives (m, p)."""


@dataclass(frozen=True)
class _Block:
    """One wavelength of a task."""

    wavelength_nm: float
    problem: Problem
    data: Observations
    goal: Objective
    """The objective with the independent part of the covariance."""
    index: Rows
    """Where the parameters of `problem` stand among all."""
    common: Floats
    """d(residual)/d(cause), (n, causes)."""
    rules: Averaging = None

    def scaled(self, data: Observations, predicted: Floats) -> Objective:
        """Values of this wavelength, scaled with their common causes as they are at a prediction."""
        if self.goal.tau:
            return with_misfit(data, self.goal.tau, predicted)
        return scaled_to(data, predicted, self.goal.metric)

    def residual(self, x: Floats, data: Observations) -> Floats:
        """Whitened residuals of values of this wavelength."""
        model = self.problem.model(x)
        return self.scaled(data, apparent(model, data, quick=True)).residual(apparent(model, data))

    def evaluate(self, x: Floats, causes: Floats, *, quick: bool, full: bool = False) -> Evaluated:
        """Residuals and derivatives by its own parameters and the causes, in triangular form."""
        predicted = self.predicted(x, quick=quick)
        if full:
            columns = derivatives(self.problem, self.data, x, rules=self.rules)
        else:
            near = predicted if quick else apparent(self.problem.model(x), self.data, quick=True)
            columns = derivatives(self.problem, self.data, x, here=near)
            if not quick:
                columns = columns * to_full(predicted, near)[:, None]
        residual = self.goal.residual(predicted) + self.common @ causes
        rows = np.column_stack([self.goal.jacobian(predicted, columns), self.common, residual])
        if rows.shape[0] > rows.shape[1]:
            rows = np.asarray(np.linalg.qr(rows, mode="r"))
        return rows[:, -1], rows[:, :-1]

    def predicted(self, x: Floats, *, quick: bool) -> Floats:
        """The model [1/sr]."""
        return apparent(self.problem.model(x), self.data, quick=quick, rules=self.rules)


class _Task:
    """Least squares over all wavelengths: the shared parameters first, then each wavelength's own, then the causes."""

    def __init__(
        self,
        problem: Problem,
        common: Sequence[str],
        taken: dict[float, Observations],
        taus: Sequence[float] | None = None,
    ) -> None:
        self.problem = problem
        free = problem.free
        self._shared = [k for k, n in enumerate(free) if n in common]
        self._own = [k for k, n in enumerate(free) if n not in common]
        self.blocks: list[_Block] = []
        for number, (wave, data) in enumerate(taken.items()):
            index = np.zeros(len(free), dtype=np.intp)
            index[self._shared] = np.arange(len(self._shared))
            index[self._own] = len(self._shared) + number * len(self._own) + np.arange(len(self._own))
            goal = alone(data, problem.asked.metric) if taus is None else with_misfit(data, taus[number], data.brdf)
            if goal.weights is not None:
                goal = replace(goal, weights=independent(goal.weights.random))
            self.blocks.append(_Block(wave, problem, data, goal, index, np.zeros((len(data), 0))))
        self._size = len(self._shared) + len(self._own) * len(self.blocks)
        lower, upper = problem.bounds
        self._lower, self._upper = np.empty(self._size), np.empty(self._size)
        for block in self.blocks:
            self._lower[block.index], self._upper[block.index] = lower, upper
        self._causes = 0

    @property
    def simple(self) -> bool:
        """Whether the quick model is the whole one, and no cause is common to values."""
        weights = [b.goal.weights is not None and bool(_causes(b.data)) for b in self.blocks]
        return all(pointlike(b.data) for b in self.blocks) and not any(weights)

    def through_cones(self, vector: Floats) -> _Task:
        """The same with averages over the cones, and with the common causes, scaled to the model at `vector`."""
        out = copy(self)
        names = list(dict.fromkeys(c for b in self.blocks for c in _causes(b.data) if b.goal.weights is not None))
        out._causes = len(names)
        out.blocks = []
        for b in self.blocks:
            x = vector[b.index]
            common = np.zeros((len(b.data), len(names)))
            if b.goal.weights is not None:
                goal = b.scaled(b.data, b.predicted(x, quick=True))
                assert goal.weights is not None
                columns = [names.index(c) for c in goal.weights.causes]
                common[:, columns] = goal.weights.common / goal.weights.random[:, None]
            out.blocks.append(replace(b, common=common, rules=averaging(b.problem.model(x), b.data)))
        return out

    def begin(self, start: FitResult) -> tuple[Floats, float]:
        """Every wavelength's own parameters with the geometry of a fit, from its wavelength outward; and the sum."""
        done: dict[float, Floats] = {}
        out, total = np.empty(self._size), 0.0
        for b in sorted(self.blocks, key=lambda b: abs(b.wavelength_nm - start.wavelength_nm)):
            nearest = min(done, key=lambda w: abs(w - b.wavelength_nm), default=None)
            x = (start.vector if nearest is None else done[nearest]).copy()
            if self._own:
                x[self._own] = self._own_only(b, x)
            done[b.wavelength_nm] = x
            residual = b.goal.residual(b.predicted(x, quick=True))
            total += float(residual @ residual)
            out[b.index] = x
        return out, total

    def _own_only(self, b: _Block, x: Floats) -> Floats:
        lower, upper = (bound[self._own] for bound in b.problem.bounds)

        def evaluate(part: Floats) -> Evaluated:
            moved = x.copy()
            moved[self._own] = part
            residual, jacobian = b.evaluate(moved, np.zeros(0), quick=True)
            return residual, jacobian[:, self._own]

        return _least(evaluate, x[self._own], lower, upper, limit=10)

    def solve(self, vector: Floats, *, quick: bool, step: Callable[[int], None]) -> Floats:
        """The best point from a start, without the causes."""
        count = 0

        def evaluate(x: Floats) -> Evaluated:
            nonlocal count
            step(count)
            count += 1
            return self._evaluate(x, quick=quick)

        self._found = _least(evaluate, np.append(vector, np.zeros(self._causes)), *self._bounds, limit=LONG)
        return self._found[: self._size]

    @property
    def _bounds(self) -> tuple[Floats, Floats]:
        """Bounds of all parameters, and of the causes, which may be anything."""
        anything = np.full(self._causes, np.inf)
        return np.append(self._lower, -anything), np.append(self._upper, anything)

    def _evaluate(self, x: Floats, *, quick: bool, full: bool = False) -> Evaluated:
        values, causes = x[: self._size], x[self._size :]
        residuals, jacobians = list[Floats](), list[Floats]()
        at_causes = np.arange(self._size, x.size)
        for number, b in enumerate(self.blocks):
            f, j = b.evaluate(values[b.index], causes, quick=quick, full=full)
            pulls, slopes = self._pulls(b, values[b.index], first=number == 0)
            f, own = np.append(f, pulls), np.append(j[:, : b.index.size], slopes, axis=0)
            wide = np.zeros((f.size, x.size))
            wide[:, b.index] = own
            wide[: len(j), at_causes] = j[:, b.index.size :]
            residuals.append(f)
            jacobians.append(wide)
        if causes.size:
            residuals.append(causes)
            jacobians.append(np.eye(x.size)[self._size :])
        return np.concatenate(residuals), np.concatenate(jacobians)

    def _pulls(self, b: _Block, x: Floats, *, first: bool) -> Evaluated:
        """Priors: those of shared parameters count once."""
        kept = [k for k, n in enumerate(b.problem.priors) if first or not b.problem.parameter(n).geometry]
        return b.problem.pulls(x)[kept], b.problem.pull_slopes(x)[kept]

    def settle(self, vector: Floats) -> tuple[Floats, Floats, float]:
        """One step with the full derivatives, if it helps: the point, the Jacobian, and the sum without priors."""
        quick = self.simple and self._causes == 0
        here = np.append(vector, self._found[self._size :])
        residual, jacobian = self._evaluate(here, quick=quick, full=True)
        moved = last_step(here, residual, jacobian, *self._bounds)
        before, after = self._total(here), self._total(moved)
        best, total = (moved, after) if after <= before * (1 + 1e-9) else (here, before)
        return best[: self._size], jacobian, total

    def _total(self, x: Floats) -> float:
        """The sum of squares, that of the causes included and that of the priors left out."""
        causes = x[self._size :]
        total = float(causes @ causes)
        for b in self.blocks:
            part = b.goal.residual(b.predicted(x[b.index], quick=False)) + b.common @ causes
            total += float(part @ part)
        return total


def _causes(data: Observations) -> tuple[str, ...]:
    return data.covariance.causes if data.covariance is not None else ()


def _least(
    evaluate: Callable[[Floats], Evaluated], start: Floats, lower: Floats, upper: Floats, *, limit: int
) -> Floats:
    """Trust-region least squares; residuals and derivatives come together, for both are turned alike."""
    known: dict[bytes, Evaluated] = {}

    def at(x: Floats) -> Evaluated:
        key = x.tobytes()
        if key not in known:
            if len(known) > 1:
                known.pop(next(iter(known)))
            known[key] = evaluate(x)
        return known[key]

    accuracy = (1e-8, 1e-8, 1e-12)
    found = least(lambda x: at(x)[0], lambda x: at(x)[1], start, (lower, upper), accuracy, limit=limit)
    return np.asarray(found.x)
