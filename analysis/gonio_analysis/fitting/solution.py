"""What a fit has found: parameters with their errors, how far the model is off, and what is said of both."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from gonio import materials, shown
from gonio.checks.values import SIGNIFICANCE
from gonio.errors import ArgumentError
from gonio.geometry import Directions
from gonio.models import Corrected
from gonio.models.corrected import folded
from gonio.models.examine import assumptions, outside
from gonio.models.parameters import OPTICAL
from gonio.typing import Bools, Floats
from gonio_analysis.fitting.forward import ByWavelength, apparent, known_wavelength
from gonio_analysis.fitting.misfit import Misfit
from gonio_analysis.fitting.objective import Objective, on_log_scale, smallest_of, with_misfit
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import Problem
from gonio_analysis.fitting.propagation import points_around
from gonio_analysis.fitting.search import STEP, derivatives
from gonio_analysis.fitting.unnoticed import unnoticed
from gonio_analysis.fitting.value_covariance import Covariance
from gonio_analysis.result_records import MisfitSummary, SharedGeometry, as_json

LOOSE = 0.3
"""Relative standard uncertainty above which slopes do not carry it any more: lobes are no straight functions."""
ROUNDING = 1e-24
"""Scatter (squared, in the residuals' units) that a fit without one is taken to have: that of its own arithmetic."""


@dataclass(frozen=True)
class Estimate:
    """One parameter of a fitted model."""

    value: float
    u: float | None
    """Standard error; 0 where the value was fixed, None where the data do not determine it."""
    fixed: bool
    unit: str = ""
    at_bound: str = ""
    """ "lower" or "upper" where the search ended on a bound."""
    material: str | None = None
    """Where the value is that of a named material at the fitted wavelength."""

    def summary(self) -> dict[str, object]:
        """Plain numbers and words."""
        told = {"at_bound": self.at_bound or None, "material": self.material}
        known = {key: word for key, word in told.items() if word is not None}
        return {"value": self.value, "u": self.u, "fixed": self.fixed, **known}

    @property
    def number(self) -> dict[str, float | None]:
        """The value and its standard error alone."""
        return {"value": self.value, "u": self.u}


@dataclass(frozen=True)
class Solution:
    """A fitted model, and everything that a report says about the fit."""

    name: str
    model: Any
    parameters: dict[str, Estimate]
    free: tuple[str, ...]
    covariance: Floats
    """Of the free parameters, in the order of `free`."""
    derived: dict[str, Estimate]
    data: Observations
    predicted: Floats
    """The model through the instrument, in the directions of `data` [1/sr]."""
    whitened: Floats
    """Residuals model - measurement, whitened by what `goal` says; logarithmic ones where no uncertainty is stated."""
    weighting: str
    chi_square: float | None
    """The smallest one that the model reaches with the stated uncertainties; that of a rejected model's reported
    parameters is larger."""
    wavelength_nm: float
    condition: float
    """Condition number of the whitened Jacobian with columns of unit length."""
    wall_s: float
    problem: Problem = field(repr=False)
    vector: Floats = field(repr=False)
    """The solution on the search scale (`problem.values` of it are the parameters)."""
    spread: Floats = field(repr=False)
    """Covariance of `vector`."""
    goal: Objective = field(repr=False)
    """What was made small."""
    notes: list[str] = field(default_factory=list)
    shared: SharedGeometry | None = None
    """What was fitted together with other wavelengths; None for a fit of its own."""
    misfit: Misfit | None = None
    """How far the model is from the data, where they reject it or state no uncertainties; None elsewhere."""
    noise: Floats | None = field(default=None, repr=False)
    """The part of `spread` that the stated uncertainties make, where there is a misfit."""

    @property
    def rejected(self) -> bool:
        """Whether chi-square rejects the model."""
        return self.p_value is not None and self.p_value < SIGNIFICANCE

    @property
    def degrees_of_freedom(self) -> int:
        """Values less fitted parameters."""
        return len(self.data) - len(self.free)

    @property
    def reduced_chi_square(self) -> float | None:
        """Chi-square a degree of freedom; None without uncertainties, or with no more values than parameters."""
        freedom = self.degrees_of_freedom
        return None if self.chi_square is None or freedom < 1 else self.chi_square / freedom

    @cached_property
    def p_value(self) -> float | None:
        """Probability of a larger chi-square, were the model and the stated uncertainties right."""
        if self.chi_square is None or self.degrees_of_freedom < 1:
            return None
        from scipy.special import chdtrc

        return float(chdtrc(self.degrees_of_freedom, self.chi_square))

    @cached_property
    def tau(self) -> MisfitSummary | None:
        """How far the model itself is off, with its interval."""
        known = self.misfit
        if known is not None:
            return MisfitSummary(known.tau, known.tau * known.u_log, known.interval)
        data, asked = self.data, self.problem.asked
        own_way = asked.metric is not None or asked.loss != "linear"
        if data.covariance is None or own_way or self.rejected or self.problem.each:
            return None
        most = unnoticed(self.problem, data, self.goal, self.vector, SIGNIFICANCE)
        return MisfitSummary(0.0, 0.5 * most, (0.0, most))

    @property
    def corrected(self) -> Any:
        """The model with the smooth curve of its misfit; the model itself where it has none."""
        if self.misfit is None or isinstance(self.model, ByWavelength):
            return self.model
        return Corrected(self.model, self.misfit.correction)

    def predict(self, at: Directions) -> tuple[Floats, Floats]:
        """What the sample's BRDF is in any directions, measured or not, without its spike.

        Parameters
        ----------
        at
            Directions, shape (n,).

        Returns
        -------
        brdf : (n,) array [1/sr]
            Of the model, or of the model with its misfit.
        u : (n,) array [1/sr]
            Standard uncertainty: from the parameters; of a model with a misfit from that, and from the parameters as
            far as values near by do not tell the misfit.

        Raises
        ------
        ArgumentError
            Several wavelengths were fitted together.
        """
        if isinstance(self.model, ByWavelength):
            raise ArgumentError("predict: of several wavelengths that are fitted together, fit one at a time")
        wave = known_wavelength(self.wavelength_nm)
        model = np.asarray(self.model.brdf(*at.angles, wavelength_nm=wave))
        if self.misfit is None:
            own = np.linalg.norm(self._straight_root(at, wave), axis=1)
            loose = own > LOOSE * np.abs(model)
            if loose.any():
                own[loose] = np.linalg.norm(self.parameter_root(at[loose], wave), axis=1)
            return model, own
        own = np.linalg.norm(self.parameter_root(at, wave), axis=1)
        known = self.misfit.correction
        at = folded(at, self.model)
        brdf, root = known.beside(at, model)
        return brdf, np.hypot(np.linalg.norm(root, axis=1), own * known.open(at))

    @cached_property
    def bounded_spread(self) -> Floats:
        """`spread`, where a parameter that the data do not determine lies between its bounds.

        So does one that stands at a bound: its formal error goes with no other's.
        """
        lower, upper = self.problem.bounds
        finite = np.isfinite(np.diag(self.spread))
        out = np.where(np.outer(finite, finite), self.spread, 0.0)
        alone = ~(out - np.diag(np.diag(out))).any(axis=0)
        widest = (upper - lower) ** 2 / 12.0
        limited = np.where(finite, np.minimum(np.diag(out), widest), widest)
        out[np.diag_indices_from(out)] = np.where(alone, limited, np.diag(out))
        return out

    @cached_property
    def around(self) -> Floats:
        """Points of the search scale that carry the parameters' uncertainty (`propagation.points_around`)."""
        goal = self.goal
        if goal.weights is None and self.misfit is not None:  # nothing is stated: the misfit takes everything
            goal = with_misfit(self.data, self.misfit.tau, self.predicted)
        return points_around(self.problem, self.data, goal, self.vector, self.bounded_spread)

    def parameter_root(self, at: Directions, wave: float) -> Floats:
        """root @ root.T is the covariance of the model's values (n, k) [1/sr] that its parameters make."""
        points = (self.vector, *self.around)
        values = np.array([self.problem.model(v).brdf(*at.angles, wavelength_nm=wave) for v in points])
        return np.asarray(values[1:] - values[0]).T / math.sqrt(2.0)

    def _straight_root(self, at: Directions, wave: float) -> Floats:
        """The same of a model that is a straight function of its parameters (n, p)."""

        def values(vector: Floats) -> Floats:
            return np.asarray(self.problem.model(vector).brdf(*at.angles, wavelength_nm=wave))

        slopes = self.problem.slopes(values, self.vector, STEP)
        felt = np.abs(slopes).max(axis=1) > 0  # a parameter that the values do not feel may be without an uncertainty
        sizes, axes = np.linalg.eigh(self.bounded_spread[np.ix_(felt, felt)])
        return np.asarray(slopes[felt].T @ (axes * np.sqrt(np.maximum(sizes, 0.0))))

    @property
    def _each(self) -> Mapping[float, Any]:
        """The model at each wavelength [nm] that was fitted together."""
        alone = {known_wavelength(self.wavelength_nm): self.model}
        return self.model.models if isinstance(self.model, ByWavelength) else alone

    @property
    def outside(self) -> str:
        """Where the model is used outside the conditions of its own derivation, in sentences; "" where it is not."""
        return " ".join(dict.fromkeys(said for at, one in self._each.items() if (said := outside(one, at))))

    @property
    def assumes(self) -> str:
        """What the model's derivation asks of the surface that no parameter tells, in sentences; "" for nothing."""
        return assumptions(next(iter(self._each.values())))

    @property
    def given(self) -> str:
        """What is taken as exact, in words: optical constants that were not fitted."""
        return "n, k" if self.problem.ior is not None and "ior" not in self.problem.free else ""

    @property
    def correlation(self) -> Floats:
        """Correlation matrix of the free parameters."""
        u = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore"):
            return np.asarray(self.covariance / np.outer(u, u))

    @property
    def verdict(self) -> str:
        """What chi-square says, in words."""
        if self.reduced_chi_square is None or self.p_value is None:
            if self.data.covariance is None:
                return "no verdict: the table states no uncertainties" + ("; " + self.described if self.misfit else "")
            return "no verdict: " + (
                "no value is left over for one"
                if self.goal.whitened
                else f"--metric {self.goal.metric} does not weigh by uncertainties"
            )
        return self.by_chi_square + (f"; it {self.described}" if self.misfit is not None else "")

    @property
    def by_chi_square(self) -> str:
        """Whether the uncertainties reject the model, in words."""
        assert self.reduced_chi_square is not None
        assert self.p_value is not None
        assumed = self.data.u_rel_assumed
        which = "stated uncertainties" if assumed is None else f"assumed uncertainty of {100 * assumed:g} %"
        given = "" if assumed is None else f", with the {which}"
        if not self.rejected:
            if self.p_value > 0.99:
                return f"not rejected; residuals are smaller than the {which}"
            return f"not rejected at the 1 % level{given}"
        factor = math.sqrt(self.reduced_chi_square)
        least = "" if self.misfit is None else "at least "
        return f"rejected: residuals are {least}{factor:.3g} times the {which}"

    @property
    def described(self) -> str:
        """How far off a model with a misfit is, in words."""
        assert self.tau is not None
        return self.tau.of("the values")

    def __repr__(self) -> str:
        found = ", ".join(
            f"{n} = {shown.value(e.value, e.u, e.unit)}" for n, e in self.parameters.items() if not e.fixed
        )
        at = "" if math.isnan(self.wavelength_nm) else f" at {self.wavelength_nm:g} nm"
        return f"<fit of {self.name} to {len(self.data)} values{at}: {found}; {self._conclusion}>"

    def _repr_html_(self) -> str:
        rows = []
        for n, e in [*self.parameters.items(), *self.derived.items()]:
            kind = "derived" if n in self.derived else "fixed" if e.fixed else "fitted"
            unknown = "" if e.u is not None else ", not determined"
            bound = f", at its {e.at_bound} bound" if e.at_bound else ""
            rows.append([n, shown.value(e.value, None if e.fixed else e.u, e.unit), kind + unknown + bound])
        at = "" if math.isnan(self.wavelength_nm) else f" at {self.wavelength_nm:g} nm"
        title = f"{self.name}, fitted to {len(self.data)} values{at}"
        return shown.html(title, ["parameter", "value", ""], rows, [self._conclusion, *self.notes])

    @property
    def _conclusion(self) -> str:
        chi = self.reduced_chi_square
        return self.verdict if chi is None else f"reduced chi-square {chi:.4g}: {self.verdict}"

    def known_to(self, spread: Floats) -> Self:
        """The same solution, its parameters known to a covariance on the search scale."""
        problem, vector = self.problem, self.vector
        slope = problem.slope(vector)
        return replace(
            self,
            spread=spread,
            covariance=spread * np.outer(slope, slope),
            parameters=estimates(problem, vector, spread, self.wavelength_nm),
            derived=derived(problem, vector, spread),
        )

    def to_json(self) -> dict[str, object]:
        """What `gonio fit --json` prints: plain numbers, strings and None."""
        return dict(as_json(self))

    def summary(self) -> dict[str, object]:
        """The same, of which parts may write themselves."""
        names, data = self.free, self.data
        related = zip(names, self.correlation, strict=True)
        return {
            "model": self.name,
            "parameters": self.parameters,
            "derived": self.derived,
            "correlation": {a: dict(zip(names, row, strict=True)) for a, row in related},
            "chi_square": self.chi_square,
            "reduced_chi_square": self.reduced_chi_square,
            "p_value": self.p_value,
            "misfit": self.tau,
            "verdict": self.verdict,
            "n_points": len(data),
            "n_free": len(names),
            "wavelength_nm": self.wavelength_nm,
            "weighting": self.weighting,
            "metric": self.goal.metric,
            "u_rel_assumed": data.u_rel_assumed,
            "condition": self.condition,
            "left_out": data.left_out,
            "source_solid_angle_sr": data.source_solid_angle_sr,
            "receiver_solid_angle_sr": data.receiver_solid_angle_sr,
            "convention": self.model.convention,
            "notes": self.notes,
            "wall_s": self.wall_s,
            "shared": self.shared,
        }

    @property
    def at_wavelength(self) -> dict[str, object]:
        """Its parameters as a line of a series over wavelengths."""
        return {
            "wavelength_nm": self.wavelength_nm,
            "n_points": len(self.data),
            "reduced_chi_square": self.reduced_chi_square,
            "parameters": {n: e.number for n, e in self.parameters.items()},
        }


def residuals_on_log_scale(
    problem: Problem, data: Observations, vector: Floats, predicted: Floats
) -> tuple[Floats, Floats, Covariance | None, Bools]:
    """What `estimated_tau` takes: residuals on the scale of logarithms, their derivatives by parameters inside their
    bounds, the covariance, and which values lie above e.

    `predicted` (n,) [1/sr] is the model of `vector`, averaged over the cones.
    """
    plain = Objective(data.brdf, None, smallest_of(data), metric="log")
    near = apparent(problem.model(vector), data, quick=True)
    lower, upper = problem.bounds
    inside = np.flatnonzero((vector > lower) & (vector < upper))
    columns = plain.jacobian(near, derivatives(problem, data, vector, here=near, only=inside))
    return plain.residual(predicted), columns, on_log_scale(data, plain.small, predicted), data.brdf > plain.small


def estimates(problem: Problem, vector: Floats, spread: Floats, wavelength_nm: float) -> dict[str, Estimate]:
    """Every parameter at a point of the search scale, with its standard error from `spread` there."""
    values, slope, error = problem.values(vector), problem.slope(vector), np.sqrt(np.diag(spread))
    lower, upper = problem.bounds
    close = 1e-2 * np.minimum(error, 1.0) + 1e-7
    moved: dict[str, tuple[float | None, str]] = {}
    for k, n in enumerate(problem.free):
        at_bound = "lower" if vector[k] - lower[k] <= close[k] else "upper" if upper[k] - vector[k] <= close[k] else ""
        moved[n] = (None if error[k] > upper[k] - lower[k] else float(error[k] * slope[k])), at_bound
    index = None
    if isinstance(problem.ior, str) and math.isfinite(wavelength_nm):
        index = complex(materials.ior(problem.ior)(wavelength_nm))
    out = {}
    for name, p in problem.family.parameters.items():
        found = [n for n in values if n.partition("@")[0] == name]
        for n in found:
            u, at_bound = moved.get(n, (0.0, ""))
            out[n] = Estimate(values[n], u, n not in moved, p.unit, at_bound)
        if not found and index is not None and name in OPTICAL:
            value = index.real if name == "ior" else index.imag
            out[name] = Estimate(value, 0.0, True, p.unit, material=str(problem.ior))
    return out


def derived(problem: Problem, vector: Floats, spread: Floats) -> dict[str, Estimate]:
    """Combinations of parameters that say more than they do."""
    if problem.each:
        return {}
    base = problem.family.derived(problem.values(vector))

    def values(v: Floats) -> Floats:
        return np.array(list(problem.family.derived(problem.values(v)).values()))

    slopes = slopes_of(values, vector, np.full(vector.size, STEP))
    out = {}
    for (n, value), g in zip(base.items(), slopes, strict=True):
        used = g != 0
        variance = g[used] @ spread[np.ix_(used, used)] @ g[used] if used.any() else 0.0
        out[n] = Estimate(value, math.sqrt(max(float(variance), 0.0)), not used.any())
    return out


def slopes_of(values: Callable[[Floats], Floats], at: Floats, steps: Floats) -> Floats:
    """What changes of each input do to each of several quantities, (quantities, inputs), by central differences."""
    columns = []
    for k, step in enumerate(steps):
        up, down = at.copy(), at.copy()
        up[k] += step
        down[k] -= step
        columns.append((values(up) - values(down)) / (2.0 * step))
    return np.array(columns).T
