"""The problem of a fit whose wavelengths share the geometry of the surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from gonio.typing import Floats
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.forward import apparent, averaging, pointlike
from gonio_analysis.fitting.objective import Objective, alone, scaled_to, with_misfit
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.search import derivatives, one_sided
from gonio_analysis.fitting.value_covariance import independent

if TYPE_CHECKING:
    from gonio.instrument import Rules

TRIALS = 60
Rows = npt.NDArray[np.intp]
Evaluated = tuple[Floats, Floats]
"""Residuals (m,) and their derivatives (m, p)."""


@dataclass(frozen=True)
class _Block:
    """One wavelength of a task."""

    wavelength_nm: float
    problem: Problem
    data: Observations
    goal: Objective
    """Of the independent part of the covariance."""
    index: Rows
    """Where the parameters of `problem` stand among all."""
    common: Floats
    """d(residual)/d(cause), (n, causes)."""
    rules: list[Rules | None] | None = None

    def scaled(self, data: Observations, predicted: Floats) -> Objective:
        """Of values of this wavelength, with their common causes as they are at a prediction."""
        if self.goal.tau:
            return with_misfit(data, self.goal.tau, predicted)
        return scaled_to(data, predicted, self.goal.metric)

    def residual(self, x: Floats, data: Observations) -> Floats:
        """Of values of this wavelength, whitened."""
        model = self.problem.model(x)
        return self.scaled(data, apparent(model, data, quick=True)).residual(apparent(model, data))

    def evaluate(self, x: Floats, causes: Floats, *, quick: bool, full: bool = False) -> Evaluated:
        """Residuals and derivatives by its own parameters and the causes, in triangular form."""
        predicted = self.predicted(x, quick=quick)
        if full:
            columns = derivatives(self.problem, self.data, x, rules=self.rules)
        else:
            near = predicted if quick else apparent(self.problem.model(x), self.data, quick=True)
            columns = one_sided(self.problem, self.data, x, near)
            if not quick:
                with np.errstate(divide="ignore", invalid="ignore"):
                    columns = columns * np.nan_to_num(np.clip(predicted / near, 0.2, 5.0), nan=1.0)[:, None]
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
        asked = problem.asked
        assert asked is not None
        for number, (wave, data) in enumerate(taken.items()):
            index = np.zeros(len(free), dtype=np.intp)
            index[self._shared] = np.arange(len(self._shared))
            index[self._own] = len(self._shared) + number * len(self._own) + np.arange(len(self._own))
            none = np.zeros((len(data), 0))
            goal = alone(data, asked.metric)
            if taus is not None:
                goal = with_misfit(data, taus[number], data.brdf)
                assert goal.weights is not None
                goal = replace(goal, weights=independent(goal.weights.random))
            self.blocks.append(_Block(wave, problem, data, goal, index, none))
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
        out = _Task.__new__(_Task)
        out.__dict__.update(self.__dict__)
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
            rules = averaging(b.problem.model(x), b.data)
            out.blocks.append(replace(b, common=common, rules=rules))
        return out

    def begin(self, start: FitResult) -> tuple[Floats, float]:
        """Every wavelength's own parameters with the geometry of a fit, from its wavelength outward; and the sum."""
        near = dict.fromkeys((b.wavelength_nm for b in self.blocks), start.vector)
        out, total = np.empty(self._size), 0.0
        order = sorted(self.blocks, key=lambda b: abs(b.wavelength_nm - start.wavelength_nm))
        done: list[float] = []
        for b in order:
            x = near[min(done, key=lambda w: abs(w - b.wavelength_nm))].copy() if done else start.vector.copy()
            if self._own:
                x[self._own] = self._own_only(b, x)
            near[b.wavelength_nm] = x
            done.append(b.wavelength_nm)
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

        open_ends = np.full(self._causes, np.inf)
        lower, upper = np.append(self._lower, -open_ends), np.append(self._upper, open_ends)
        start = np.append(vector, np.zeros(self._causes))
        found = _least(evaluate, start, lower, upper, limit=TRIALS)
        self._found = found
        return found[: self._size]

    def _evaluate(self, x: Floats, *, quick: bool, full: bool = False) -> Evaluated:
        values, causes = x[: self._size], x[self._size :]
        residuals, jacobians = [], []
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
        names = list(b.problem.priors)
        if not names:
            return np.zeros(0), np.zeros((0, x.size))
        kept = [k for k, n in enumerate(names) if first or not b.problem.parameter(n).geometry]
        return b.problem.pulls(x)[kept], b.problem.pull_slopes(x)[kept]

    def settle(self, vector: Floats) -> tuple[Floats, Floats, float]:
        """One step with the full derivatives, if it helps: the point, the Jacobian, and the sum without priors."""
        quick = self.simple and self._causes == 0
        here = np.append(vector, self._found[self._size :])
        residual, jacobian = self._evaluate(here, quick=quick, full=True)
        margin = np.append(1e-6 * np.minimum(self._upper - self._lower, 1.0), np.zeros(self._causes))
        low = np.append(self._lower, np.full(self._causes, -np.inf))
        high = np.append(self._upper, np.full(self._causes, np.inf))
        inside = (here > low + margin) & (here < high - margin)
        step = np.zeros(here.size)
        if inside.any():
            size = np.maximum(np.linalg.norm(jacobian[:, inside], axis=0), 1e-300)
            step[inside] = np.linalg.lstsq(jacobian[:, inside] / size, -residual, rcond=1e-10)[0] / size
        step[: self._size] = np.clip(step[: self._size], -0.1, 0.1)
        moved = np.clip(here + step, low, high)
        moved = np.where(moved <= low + margin, low, np.where(moved >= high - margin, high, moved))
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
    from scipy.optimize import least_squares

    known: dict[bytes, Evaluated] = {}

    def at(x: Floats) -> Evaluated:
        key = x.tobytes()
        if key not in known:
            if len(known) > 1:
                known.pop(next(iter(known)))
            known[key] = evaluate(x)
        return known[key]

    margin = np.where(np.isfinite(upper - lower), 1e-9 * (upper - lower), 0.0)
    found = least_squares(
        lambda x: at(x)[0],
        np.clip(start, lower + margin, upper - margin),
        jac=lambda x: at(x)[1],
        bounds=(lower, upper),
        x_scale="jac",
        xtol=1e-8,
        ftol=1e-8,
        gtol=1e-12,
        max_nfev=limit,
    )
    return np.asarray(found.x)
