"""What the values so far say of the model: its parameters, how well they are known, and whether it is the right one.

Two tests of the residuals, with a stated rate of false alarms, say whether it describes what was measured. Both use
whitened residuals, so that common causes of the run do not count as misfit. One is chi-square, which tells of values
that scatter more than they should. The other asks whether the residuals hang together: smooth functions of the
directions are fitted to them, and what chi-square falls by has a chi-square distribution of its own. A wrong model
shows there long before single values stand out.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.forward import apparent
from gonio_analysis.fitting.objective import alone, scaled_to
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.optical_constants import read_ior
from gonio_analysis.fitting.parameters import levels
from gonio_analysis.fitting.problem import FitRequest, Problem, pose
from gonio_analysis.fitting.search import refine
from gonio_analysis.fitting.value_covariance import Covariance
from pydantic import Field, field_validator

from gonio.config import Positive, Strict
from gonio.errors import DataError
from gonio.geometry import Directions
from gonio.lab.rig.description import RigDescription
from gonio.models.parameters import Values
from gonio.shown import with_u
from gonio.typing import DataFrame, Floats, JsonObject
from gonio_sweeps import expected
from gonio_sweeps.candidates import places
from gonio_sweeps.online import GrowingValues
from gonio_sweeps.sampler import short

FALSE_ALARMS = 0.01
"""Probability that a run with the right model is held to have a wrong one, over all looks together."""
DEGREE = 3
"""Degree of the smooth functions: Legendre polynomials of the place between its smallest and largest coordinates."""
SPARE = 4
"""Values beyond parameters and smooth functions that the second test needs."""


@dataclass(frozen=True)
class LackOfFit:
    """What the residuals say of a model."""

    chi_square: float
    degrees_of_freedom: int
    p_value: float
    """Of both tests together: twice the smaller p value."""

    def rejects(self, look: int) -> bool:
        """Whether the model is held to be wrong, at the look of this number (0 is the first).

        Each look spends 6 / (pi^2 (look + 1)^2) of `FALSE_ALARMS`, which adds up to it however many there are.
        """
        return self.p_value < FALSE_ALARMS * 6.0 / (math.pi * (look + 1)) ** 2


def judge(residual: Floats, jacobian: Floats, predicted: Floats, covariance: Covariance, at: Directions) -> LackOfFit:
    """Test a fit.

    Parameters
    ----------
    residual
        Measurement less model [1/sr], (n,).
    jacobian
        d(model)/d(parameter), (n, p); of the parameters that do not stand at a bound.
    predicted
        The model [1/sr], (n,).
    covariance
        Of the measurement.
    at
        Its directions.
    """
    from scipy.special import chdtrc

    white = covariance.whiten(residual)
    design = covariance.whiten(jacobian) if jacobian.shape[1] else np.zeros((white.size, 0))
    first, rank = _left(white, design)
    freedom = white.size - rank
    if freedom < 1:
        return LackOfFit(first, 0, 1.0)
    values = [float(chdtrc(freedom, first))]
    smooth = _smooth(at)[:, : max(freedom - SPARE, 0)]
    if smooth.shape[1]:
        more = covariance.whiten(smooth * predicted[:, None])
        second, with_more = _left(white, np.concatenate([design, more], axis=1))
        if with_more > rank:
            values.append(float(chdtrc(with_more - rank, max(first - second, 0.0))))
    return LackOfFit(first, freedom, min(1.0, len(values) * min(values)))


def _left(white: Floats, design: Floats) -> tuple[float, int]:
    """Sum of squares that is left when the columns have been fitted, and the rank of these."""
    if not design.shape[1]:
        return float(white @ white), 0
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    left, values, _ = np.linalg.svd(design / size, full_matrices=False)
    left = left[:, values > 1e-6 * values[0]]
    rest = white - left @ (left.T @ white)
    return float(rest @ rest), left.shape[1]


def _smooth(at: Directions) -> Floats:
    """Relative departures that change slowly with the directions: columns (n, m), the slowest first."""
    from numpy.polynomial import legendre

    here = places(at)
    low, high = here.min(axis=0), here.max(axis=0)
    scaled = 2.0 * (here - low) / np.where(high > low, high - low, 1.0) - 1.0
    along, across, incidence = (legendre.legvander(x, DEGREE) for x in scaled.T)
    columns = [along[:, i] * incidence[:, k] for i in range(DEGREE + 1) for k in range(2) if 0 < i + k <= DEGREE]
    if high[1] - low[1] > 0.1:
        columns += [across[:, 1], across[:, 2]]
    return np.stack(columns, axis=1)


SEARCHES, MANY = 6, 30
"""Short searches that a fit begins with; and before a model is found wrong. Chosen points lie in a few places, where
lobes of other widths may look alike."""
OTHER_MODES = 4
"""Starting points from which other solutions are looked for."""
ALLOWED = 12.0
"""Solutions whose chi-square is larger than the best one's by less than this are not ruled out."""
APART = 5.0
"""Standard uncertainties by which a parameter differs in solutions that count as different."""


class ParameterSettings(Strict):
    """The keys of `[adaptive]` with how = "parameters", beside `how` and `budget_h`."""

    model: str
    """As `gonio fit --model`."""
    ior: str | float | tuple[float, float] | None = None
    """A material, n, or [n, k]; or text, as in `gonio fit --ior 1.37+7.6j`."""
    fix: dict[str, str | float] = Field(default_factory=dict)
    free: tuple[str, ...] = ()
    slopes: int = 1
    wavelength_nm: Positive | None = None
    """Where the plan has several: the one that the model is fitted at; by default the nearest to 550 nm."""
    u: dict[str, Positive] = Field(default_factory=dict)
    """Standard uncertainty wanted of each parameter, in its own unit."""
    u_rel: dict[str, Positive] = Field(default_factory=dict)
    """The same, relative to its value."""
    theta_i_deg: Any = None
    theta_r_deg: Any = None
    dphi_deg: Any = None
    """The candidates, as in a `[[sweep]]`."""

    @field_validator("ior", mode="before")
    @classmethod
    def _index(cls, value: object) -> object:
        if isinstance(value, bool):
            raise ValueError('give a material as "Al", a number n, [n, k], or text as "1.37+7.6j"')
        return tuple(value) if isinstance(value, list) else value

    @property
    def index(self) -> complex | str | None:
        """What `ior` stands for."""
        if self.ior is None or isinstance(self.ior, str):
            return read_ior(self.ior)
        n, k = self.ior if isinstance(self.ior, tuple) else (self.ior, 0.0)
        return read_ior(f"{n:.17g}{k:+.17g}j")


@dataclass(frozen=True)
class Known:
    """What a fit to all values so far says."""

    result: FitResult
    data: Observations
    sights: expected.Sights
    rows: expected.PredictedRows
    modes: list[tuple[Floats, float]]
    """Solutions that are not ruled out, as points of the search scale, with their weights; the best one first."""
    test: LackOfFit
    worse: float = 1.0
    """The uncertainties of a full reduction and fit, over those of the quick one: targets are harder by this factor."""

    @property
    def tau(self) -> float:
        """The model's own misfit (docs/misfit.md); 0 where the values do not reject it."""
        return 0.0 if self.result.misfit is None else self.result.misfit.tau


class ModelFit:
    """Fits of the model that `[adaptive]` names, to the values of a run that grows.

    Raises
    ------
    ConfigError
        The settings name no model, or one of its parameters is wrong.
    """

    def __init__(self, settings: ParameterSettings, description: RigDescription, wavelength_nm: float) -> None:
        self.settings, self.wavelength_nm = settings, wavelength_nm
        self._description = description
        self.problem = pose(self._request)

    @property
    def _request(self) -> FitRequest:
        s = self.settings
        return FitRequest(s.model, ior=s.index, fix=s.fix, free=s.free, slopes=s.slopes)

    def fitted(self, values: GrowingValues, searches: int = SEARCHES) -> Known | None:
        """The fit to all values, with what errors of the angles do by the model itself; None where it is impossible."""
        if len(values) <= len(self.problem.free) + 1:
            return None
        names, wave = tuple(values.common), self.wavelength_nm
        common = np.stack([values.common[name] for name in names], axis=1)
        u = np.hypot(values.u_noise, 0.003 * np.abs(values.brdf))
        known = Covariance(np.maximum(u, 1e-12), common, names)
        data = expected.observed(self._description, values.directions, wave, values.brdf, known)
        try:
            result = fit(data, replace(self._request, searches=searches), name="the values so far")
        except DataError:
            return None
        sights = expected.Sights(data, values.poses, self._description)
        rows = sights.rows(self.problem, result.vector)
        u = np.maximum(np.hypot(values.u_noise, rows.u_landing), 1e-12)
        columns = np.concatenate([common, np.stack(list(rows.of_angles.values()), axis=1)], axis=1)
        data = replace(data, covariance=Covariance(u, columns, (*names, *rows.of_angles)))
        start = result.problem.values(result.vector)
        result = fit(data, replace(self._request, start=[start]), name="the values so far")
        assert data.covariance is not None
        lower, upper = self.problem.bounds
        inside = (result.vector > lower + 1e-6) & (result.vector < upper - 1e-6)
        test = judge(
            values.brdf - result.predicted,
            rows.parameters[:, inside],
            result.predicted,
            scaled_to(data, result.predicted, "weighted").weights or data.covariance,
            values.directions,
        )
        return Known(result, data, sights, rows, self._modes(result, data), test)

    def _modes(self, result: FitResult, data: Observations) -> list[tuple[Floats, float]]:
        """The fit's solution, and others that the values do not rule out."""
        problem, goal = self.problem, alone(data)
        starts = [problem.vector({"k": 1.0, **start}) for start in problem.family.starts(levels(data))]
        cost = [float((goal.residual(apparent(problem.model(x), data, quick=True)) ** 2).sum()) for x in starts]
        here, best = refine(problem, data, goal, result.vector, quick=True, limit=20)
        lower, upper = problem.bounds
        u = np.sqrt(np.diag(result.spread))
        apart = APART * np.clip(np.where(np.isfinite(u), u, np.inf), 1e-3 * (upper - lower), 0.2 * (upper - lower))
        found, out = [here], [(result.vector, 1.0)]
        for k in np.argsort(cost, kind="stable")[:OTHER_MODES]:
            vector, half = refine(problem, data, goal, starts[k], quick=True, limit=25)
            more = 2.0 * (half - best)
            if more < ALLOWED and all((np.abs(vector - other) > apart).any() for other in found):
                found.append(vector)
                out.append((vector, math.exp(-0.5 * max(more, 0.0))))
        return out

    def final(self, table: DataFrame, result: FitResult) -> FitResult:
        """What `gonio fit` will say of the run."""
        start = result.problem.values(result.vector)
        return fit(table, replace(self._request, start=[start], wavelength_nm=self.wavelength_nm))

    # ---- targets ----

    def wanted(self, values: Values) -> dict[str, float]:
        """The wanted standard uncertainties of parameters; of those alone for which one is stated."""
        s = self.settings
        return {n: u * abs(values[n]) for n, u in s.u_rel.items()} | s.u

    def targets(self, problem: Problem, vector: Floats) -> Floats:
        """The same on the search scale; NaN where none is stated."""
        wanted = self.wanted(problem.values(vector))
        slope = np.maximum(np.abs(problem.slope(vector)), 1e-300)
        return np.array([wanted.get(name, math.nan) for name in problem.free]) / slope

    def ratios(self, result: FitResult) -> Floats:
        """Uncertainty over target of every parameter; NaN without a target."""
        return np.sqrt(np.diag(result.spread)) / np.maximum(self.targets(result.problem, result.vector), 1e-300)

    def reached(self, ratios: Floats) -> bool:
        """Whether all targets are met; never where none is stated."""
        return bool(np.isfinite(ratios).any() and np.nanmax(ratios) <= 1.0)

    def progress(self, result: FitResult) -> str:
        """What is known of the parameters, for a person."""
        wanted = self.wanted({name: e.value for name, e in result.parameters.items()})
        known = ((n, result.parameters[n]) for n in result.free)
        asked = {n: f" (wanted {u:.2g})" for n, u in wanted.items()}
        return ", ".join(f"{n} = {with_u(e.value, e.u)}{asked.get(n, '')}" for n, e in known)

    def of_fit(self, known: Known) -> JsonObject:
        """What the journal keeps of a fit."""
        result, test = known.result, known.test
        return {
            "fit": {name: float(f"{result.parameters[name].value:.6g}") for name in result.free},
            "u": {name: short(result.parameters[name].u) for name in result.free},
            "modes": len(known.modes),
            "chi_square": short(test.chi_square),
            "degrees_of_freedom": test.degrees_of_freedom,
            "p_value": short(test.p_value),
        }
