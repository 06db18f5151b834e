"""Fitting a reflectance model to a measurement table.

Weighted least squares with the table's whole covariance: residuals are whitened (`gonio_analysis.uncertainty`), the model
is evaluated through the cones of the instrument (`gonio_analysis.forward`), and the search starts from the best points of
a coarse grid, because the shapes of these models are multi-modal in their roughness. Parameters are searched on their
natural scale (logarithmic for lengths, widths and indices) inside bounds.

Standard errors are those of linearised least squares with the stated covariance, and are not scaled by the reduced
chi-square: where that is far from 1, the model or the stated uncertainties are wrong, and no scaling mends either.
Without stated uncertainties every point weighs by 1/(|f| + 5 % of the median |f|), errors come from the scatter of
the residuals, and there is no chi-square.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio import plugins
from gonio.errors import ArgumentError, ConfigError, DataError
from gonio_analysis import families
from gonio_analysis.families import Family, Ior, Values
from gonio_analysis.forward import apparent
from gonio_analysis.observations import Observations, observations
from gonio_analysis.uncertainty import Covariance, Floats, independent

if TYPE_CHECKING:
    import pandas as pd

GRID_POINTS = 250
"""Values that a start is judged by."""
STARTS = 4
COARSE_U = 0.15
"""Relative uncertainty added while the start is sought, so that a steep flank does not hide the right valley."""
STEP = 1e-4
"""Central differences, on the search scale: an error of 1e-8 relative, far above the rounding of the models."""


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


@dataclass(frozen=True)
class FitResult:
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
    """Residuals model - measurement, whitened; relative ones where no uncertainty is stated."""
    weighting: str
    chi_square: float | None
    wavelength_nm: float
    condition: float
    """Condition number of the whitened Jacobian with columns of unit length."""
    wall_s: float
    notes: list[str] = field(default_factory=list)

    @property
    def degrees_of_freedom(self) -> int:
        return len(self.data) - len(self.free)

    @property
    def reduced_chi_square(self) -> float | None:
        return (
            None
            if self.chi_square is None or self.degrees_of_freedom < 1
            else self.chi_square / self.degrees_of_freedom
        )

    @cached_property
    def p_value(self) -> float | None:
        """Probability of a larger chi-square, were the model and the stated uncertainties right."""
        if self.chi_square is None or self.degrees_of_freedom < 1:
            return None
        from scipy.stats import chi2

        return float(chi2.sf(self.chi_square, self.degrees_of_freedom))

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
            return "no verdict: the table states no uncertainties"
        if self.p_value >= 0.01:
            if self.p_value > 0.99:
                return "not rejected; residuals are smaller than the stated uncertainties"
            return "not rejected at the 1 % level"
        factor = math.sqrt(self.reduced_chi_square)
        if self.reduced_chi_square < 2:
            return f"formally rejected, but residuals are only {factor:.2f} times the stated uncertainties"
        return f"rejected: residuals are {factor:.3g} times the stated uncertainties"

    def to_json(self) -> dict[str, Any]:
        """What `gonio fit --json` prints: plain numbers, strings and None."""
        c = self.correlation
        names = self.free
        return {
            "model": self.name,
            "parameters": {k: _plain(v) for k, v in self.parameters.items()},
            "derived": {k: _plain(v) for k, v in self.derived.items()},
            "correlation": {a: {b: finite(c[i, j]) for j, b in enumerate(names)} for i, a in enumerate(names)},
            "chi_square": finite(self.chi_square),
            "reduced_chi_square": finite(self.reduced_chi_square),
            "p_value": finite(self.p_value),
            "verdict": self.verdict,
            "n_points": len(self.data),
            "n_free": len(names),
            "wavelength_nm": finite(self.wavelength_nm),
            "weighting": self.weighting,
            "condition": finite(self.condition),
            "left_out": self.data.left_out,
            "source_solid_angle_sr": self.data.source_solid_angle_sr,
            "receiver_solid_angle_sr": self.data.receiver_solid_angle_sr,
            "convention": self.model.convention,
            "notes": list(self.notes),
            "wall_s": self.wall_s,
        }


def finite(value: float | None) -> float | None:
    """A number as JSON has it: None for what is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def _plain(e: Estimate) -> dict[str, Any]:
    out: dict[str, Any] = {"value": finite(e.value), "u": finite(e.u), "fixed": e.fixed}
    if e.at_bound:
        out["at_bound"] = e.at_bound
    if e.material:
        out["material"] = e.material
    return out


def fit(
    table: pd.DataFrame | Observations,
    model: str,
    *,
    ior: Ior = None,
    fix: Mapping[str, float | str] | None = None,
    free: Sequence[str] = (),
    slopes: int = 1,
    wavelength_nm: float | None = None,
    start: Mapping[str, float] | None = None,
    name: str = "the table",
) -> FitResult:
    """Fit one model to the usable values of a table, at one wavelength.

    Parameters
    ----------
    table
        A measurement table of one sample, or what `observations` made of one.
    model
        Name on the command line: "lambert", "oren-nayar", "phong", "blinn", "cook-torrance", "he-torrance".
    ior
        Optical constants n + ik, or the name of a material: fixed, unless `free` names "ior" or "k".
    fix
        Values of parameters that are not to be fitted; a word (`form="exact"`) goes to the constructor as it is.
    free
        Parameters to fit beyond the usual ones.
    slopes
        Slopes of Cook-Torrance's facet distribution.
    wavelength_nm
        Where the table has several wavelengths, the nearest one is fitted (550 nm if none is given); in a broad band,
        the effective wavelength.
    start
        Values to start from instead of a search: the solution of a neighbour.
    name
        What messages call the table.

    Raises
    ------
    ConfigError
        Unknown model or parameter, or a model that needs a wavelength for a broad band.
    DataError
        Fewer values than free parameters, or no usable value.
    """
    began = time.perf_counter()
    problem = _problem(model, ior, dict(fix or {}), tuple(free), slopes)
    data = table if isinstance(table, Observations) else observations(table, name)
    data, wavelength, notes = _one_wavelength(data, wavelength_nm, problem.family, name)
    names = problem.free
    if len(data) <= len(names):
        raise DataError(
            f"{name}: {len(data)} usable values cannot determine the {len(names)} parameters {', '.join(names)}"
        )
    notes += problem.notes

    weights, weighting = _weights(data)
    # common causes come in once there is a model to scale them by: see Covariance.scaled
    alone = independent(weights.random)
    vector = (
        _search(problem, data, alone)
        if start is None
        else _refine(problem, data, alone, problem.vector(dict(start)), quick=True)[0]
    )
    if data.covariance is not None and weights.causes:
        weights = data.covariance.scaled(_ratio(apparent(problem.model(vector), data, quick=True), data))
    vector, jacobian = _settle(problem, data, weights, _refine(problem, data, weights, vector)[0])
    built = problem.model(vector)
    predicted = apparent(built, data)
    white = weights.whiten(predicted - data.brdf)
    cost = 0.5 * float(white @ white)
    covariance, condition = _covariance(jacobian)
    if data.covariance is None:
        covariance = covariance * (2 * cost / (len(data) - len(names)))
        notes.append("Standard errors come from the scatter of the residuals; there is no chi-square.")
    result = FitResult(
        name=model,
        model=built,
        parameters=_estimates(problem, vector, covariance, wavelength),
        free=names,
        covariance=covariance * np.outer(problem.slope(vector), problem.slope(vector)),
        derived=_derived(problem, vector, covariance),
        data=data,
        predicted=predicted,
        whitened=white,
        weighting=weighting,
        chi_square=None if data.covariance is None else 2 * cost,
        wavelength_nm=wavelength,
        condition=condition,
        wall_s=0.0,
    )
    notes += _identifiability(problem, result)
    return replace(result, notes=[*data.notes, *notes], wall_s=time.perf_counter() - began)


@dataclass(frozen=True)
class _Problem:
    """Which numbers move, on which scale, and the model that they make."""

    family: Family
    kind: Any
    """The model's class, looked up once: a search builds hundreds of models."""
    free: tuple[str, ...]
    fixed: Values
    words: dict[str, str]
    ior: Ior
    notes: list[str]

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        rows = [self.family.parameter(n) for n in self.free]
        lower = [math.log(p.lower) if p.scale == "log" else p.lower for p in rows]
        upper = [math.log(p.upper) if p.scale == "log" else p.upper for p in rows]
        return np.array(lower), np.array(upper)

    def values(self, vector: Floats) -> Values:
        """All parameters by name, for a point of the search."""
        out = dict(self.fixed)
        for n, x in zip(self.free, vector, strict=True):
            p = self.family.parameter(n)
            out[n] = p.inside(math.exp(x) if p.scale == "log" else float(x))
        return out

    def vector(self, values: Values) -> Floats:
        """The point of the search that has these values, brought inside the bounds."""
        rows = [(self.family.parameter(n), values[n]) for n in self.free]
        return np.array([math.log(p.inside(v)) if p.scale == "log" else p.inside(v) for p, v in rows])

    def slope(self, vector: Floats) -> Floats:
        """d(value)/d(search scale) of the free parameters."""
        values = self.values(vector)
        return np.array([values[n] if self.family.parameter(n).scale == "log" else 1.0 for n in self.free])

    def model(self, vector: Floats) -> Any:
        from gonio.models.base import build_model

        return build_model(self.kind, self.family.name, {**self.family.arguments(self.values(vector)), **self.words})


def _problem(model: str, ior: Ior, fix: dict[str, float | str], free: tuple[str, ...], slopes: int) -> _Problem:
    notes: list[str] = []
    if isinstance(fix.get("ior"), str) and ior is None:
        ior = str(fix.pop("ior"))
    if ior is not None and not families.needs_ior(model) and model in families.FAMILIES:
        ior = None
        notes.append(f"The optical constants are not used: {model} has none.")
    family = families.family(model, slopes=slopes, ior=ior)
    words = {k: v for k, v in fix.items() if isinstance(v, str)}
    numbers = {k: float(v) for k, v in fix.items() if not isinstance(v, str)}
    for n, value in numbers.items():
        p = family.parameter(n)
        if not p.lower <= value <= p.upper:
            raise ConfigError(f"--fix {n}={value:g}: {n} of {model} lies between {p.lower:g} and {p.upper:g}")
    for n in free:
        family.parameter(n)
        if n in numbers:
            raise ConfigError(f"{n} is given to --fix and to --free")
        if isinstance(ior, str) and n in ("ior", "k"):
            raise ConfigError(
                f"--free {n}: with --ior {ior} the material fixes n + ik; give numbers (as 1.5+2j) to start from"
            )
    names = tuple(p.name for p in family.parameters)
    moving = tuple(n for n in names if (n in family.free or n in free) and n not in numbers)
    if not moving:
        raise ConfigError(f"every parameter of {model} is fixed: there is nothing to fit")
    fixed = {**family.fixed, **numbers}
    if ior is None and "ior" in moving and families.needs_ior(model) and not fixed.get("k") and "k" not in moving:
        notes.append("No optical constants were given (--ior): a real refractive index n is fitted, with k = 0.")
    return _Problem(
        family,
        plugins.load("gonio.models", model),
        moving,
        {n: v for n, v in fixed.items() if n not in moving},
        words,
        ior,
        notes,
    )


def _one_wavelength(
    data: Observations, wavelength_nm: float | None, family: Family, name: str
) -> tuple[Observations, float, list[str]]:
    if wavelength_nm is not None and not (math.isfinite(wavelength_nm) and wavelength_nm > 0):
        raise ArgumentError(f"wavelength_nm = {wavelength_nm}: a wavelength is above 0 nm")
    several = [w for w in data.wavelengths if not math.isnan(w)]
    chosen, wavelength = data.nearest(wavelength_nm)
    if not math.isnan(wavelength):
        notes = []
        if len(several) > 1:
            asked = "the nearest to 550 nm" if wavelength_nm is None else f"the nearest to {wavelength_nm:g} nm"
            notes.append(f"The table has {len(several)} wavelengths; {wavelength:g} nm, {asked}, is fitted.")
        elif wavelength_nm is not None and abs(wavelength - wavelength_nm) > 1:
            notes.append(
                f"The table has one wavelength, {wavelength:g} nm; it is fitted instead of {wavelength_nm:g} nm."
            )
        return chosen, wavelength, notes
    if wavelength_nm is None:
        if family.needs_wavelength:
            raise ConfigError(
                f"{name} holds a broad band, and {family.name} needs a wavelength: give one with --wavelength-nm"
            )
        return chosen, wavelength, []
    filled = replace(chosen, wavelength_nm=np.full(len(chosen), float(wavelength_nm)))
    return filled, float(wavelength_nm), [f"The broad band is evaluated at {wavelength_nm:g} nm alone."]


def _weights(data: Observations) -> tuple[Covariance, str]:
    if data.covariance is not None:
        causes = ", ".join(data.covariance.causes)
        return data.covariance, "the table's covariance" + (f", with the common causes {causes}" if causes else "")
    size = np.abs(data.brdf)
    return independent(size + 0.05 * max(float(np.median(size)), 1e-300)), "relative: 1/(|f| + 5 % of the median |f|)"


def _ratio(predicted: Floats, data: Observations) -> Floats:
    """Fitted / measured where that ratio means something, for `Covariance.scaled`."""
    seen = data.brdf > 3 * data.u
    return np.clip(np.where(seen, predicted / np.where(seen, data.brdf, 1.0), 1.0), 0.5, 2.0)


def _search(problem: _Problem, data: Observations, weights: Covariance) -> Floats:
    """The best point of several searches with the quick forward model, the first part of each with softened weights."""
    rows = np.arange(len(data))
    few = data if len(data) <= GRID_POINTS else data.take(rows[:: -(-len(data) // GRID_POINTS)])
    soft = independent(np.hypot(_plain_u(few), COARSE_U * np.abs(few.brdf)))
    known = {n: v for n, v in problem.family.fixed.items() if n in problem.free and v}
    candidates: list[tuple[float, Floats]] = []
    for start in problem.family.starts(data):
        vector = problem.vector({"k": 1.0, **start, **known})
        residual = soft.whiten(apparent(problem.model(vector), few, quick=True) - few.brdf)
        # large residuals count by their logarithm: a lobe in the right place must win over one that is merely low
        candidates.append((float(np.log1p(np.minimum(residual**2, 1e12)).sum()), vector))
    candidates.sort(key=lambda c: c[0])
    coarse = [_refine(problem, few, soft, vector, quick=True, limit=25) for _, vector in candidates[:STARTS]]
    coarse.sort(key=lambda c: c[1])
    chosen = [coarse[0]] + [c for c in coarse[1:] if np.abs(c[0] - coarse[0][0]).max() > 0.05][:1]
    final = [_refine(problem, data, weights, vector, quick=True) for vector, _ in chosen]
    return min(final, key=lambda f: f[1])[0]


def _plain_u(data: Observations) -> Floats:
    size = np.abs(data.brdf)
    return data.u if data.covariance is not None else 0.05 * np.full(size.size, max(float(np.median(size)), 1e-300))


def _refine(
    problem: _Problem,
    data: Observations,
    weights: Covariance,
    start: Floats,
    *,
    quick: bool = False,
    limit: int = 60,
) -> tuple[Floats, float]:
    """Trust-region least squares from one start; the point and half its sum of squares.

    Derivatives are those of the quick forward model, scaled to the full one; `_settle` takes the last step with the
    derivatives of the full one.
    """
    from scipy.optimize import least_squares

    lower, upper = problem.bounds
    margin = 1e-9 * (upper - lower)
    latest = np.empty(len(data))

    def residual(x: Floats) -> Floats:
        latest[:] = apparent(problem.model(x), data, quick=quick)
        return weights.whiten(latest - data.brdf)

    def jacobian(x: Floats) -> Floats:
        columns = _jacobian(problem, data, x, quick=True)
        if not quick:
            near = apparent(problem.model(x), data, quick=True)
            with np.errstate(divide="ignore", invalid="ignore"):
                columns = columns * np.nan_to_num(np.clip(latest / near, 0.2, 5.0), nan=1.0)[:, None]
        return weights.whiten(columns)

    result = least_squares(
        residual,
        np.clip(start, lower + margin, upper - margin),
        jac=jacobian,
        bounds=(lower, upper),
        x_scale="jac",
        xtol=1e-9,
        ftol=1e-10 if quick else 1e-8,
        gtol=1e-12,
        max_nfev=limit,
    )
    return np.asarray(result.x), float(result.cost)


def _settle(problem: _Problem, data: Observations, weights: Covariance, vector: Floats) -> tuple[Floats, Floats]:
    """One Gauss-Newton step with the full derivatives, if it helps; the point and the whitened Jacobian there.

    A parameter whose last step stays at a bound is put onto it.
    """
    lower, upper = problem.bounds
    residual = weights.whiten(apparent(problem.model(vector), data) - data.brdf)
    jacobian = weights.whiten(_jacobian(problem, data, vector))
    margin = 1e-6 * np.minimum(upper - lower, 1.0)
    inside = (vector > lower + margin) & (vector < upper - margin)
    step = np.zeros(vector.size)
    if inside.any():
        size = np.maximum(np.linalg.norm(jacobian[:, inside], axis=0), 1e-300)
        step[inside] = np.linalg.lstsq(jacobian[:, inside] / size, -residual, rcond=1e-10)[0] / size
    moved = np.clip(vector + np.clip(step, -0.1, 0.1), lower, upper)
    moved = np.where(moved <= lower + margin, lower, np.where(moved >= upper - margin, upper, moved))
    after = weights.whiten(apparent(problem.model(moved), data) - data.brdf)
    # a bound that is put on exactly may cost the last digits of the sum
    return (moved, jacobian) if after @ after <= (residual @ residual) * (1 + 1e-9) else (vector, jacobian)


def _jacobian(problem: _Problem, data: Observations, vector: Floats, *, quick: bool = False) -> Floats:
    """d(model)/d(search scale), (n, p), by central differences (one-sided at a bound)."""
    lower, upper = problem.bounds
    columns = []
    for k in range(vector.size):
        up, down = vector.copy(), vector.copy()
        up[k] = min(vector[k] + STEP, upper[k])
        down[k] = max(vector[k] - STEP, lower[k])
        high, low = (apparent(problem.model(x), data, quick=quick) for x in (up, down))
        columns.append((high - low) / (up[k] - down[k]))
    return np.stack(columns, axis=1)


def _covariance(jacobian: Floats) -> tuple[Floats, float]:
    """(J^T J)^-1 on the search scale, and the condition number of J with columns of unit length.

    A column of zeros (a parameter without any effect) gets an infinite variance.
    """
    size = np.linalg.norm(jacobian, axis=0)
    seen = size > 0
    out = np.full((size.size, size.size), 0.0)
    out[~seen, ~seen] = np.inf
    if not seen.any():
        return out, math.inf
    _, values, right = np.linalg.svd(jacobian[:, seen] / size[seen], full_matrices=False)
    values = np.maximum(values, 1e-12 * values[0])
    inner = (right.T / values**2) @ right / np.outer(size[seen], size[seen])
    out[np.ix_(seen, seen)] = inner
    return out, float(values[0] / values[-1]) if seen.all() else math.inf


def _estimates(problem: _Problem, vector: Floats, covariance: Floats, wavelength_nm: float) -> dict[str, Estimate]:
    index = None
    if isinstance(problem.ior, str):
        from gonio import materials

        index = complex(materials.ior(problem.ior)(wavelength_nm))
    values, slope = problem.values(vector), problem.slope(vector)
    u = dict(zip(problem.free, np.sqrt(np.diag(covariance)) * slope, strict=True))
    lower, upper = problem.bounds
    close = 1e-2 * np.minimum(np.sqrt(np.diag(covariance)), 1.0) + 1e-7
    edge = {
        n: "lower" if x - low <= c else "upper" if high - x <= c else ""
        for n, x, low, high, c in zip(problem.free, vector, lower, upper, close, strict=True)
    }
    out = {}
    for p in problem.family.parameters:
        if p.name in values:
            error = float(u[p.name]) if p.name in u else 0.0
            out[p.name] = Estimate(values[p.name], error, p.name not in u, p.unit, edge.get(p.name, ""))
        elif isinstance(problem.ior, str) and index is not None:
            out[p.name] = Estimate(
                index.real if p.name == "ior" else index.imag, 0.0, True, p.unit, material=problem.ior
            )
    return out


def _derived(problem: _Problem, vector: Floats, covariance: Floats) -> dict[str, Estimate]:
    base = problem.family.derived(problem.values(vector))
    gradients: dict[str, list[float]] = {n: [] for n in base}
    for k in range(vector.size):
        up, down = vector.copy(), vector.copy()
        up[k] += STEP
        down[k] -= STEP
        high, low = (problem.family.derived(problem.values(v)) for v in (up, down))
        for n in base:
            gradients[n].append((high[n] - low[n]) / (2 * STEP))
    out = {}
    for n, value in base.items():
        g = np.array(gradients[n])
        used = g != 0
        variance = g[used] @ covariance[np.ix_(used, used)] @ g[used] if used.any() else 0.0
        out[n] = Estimate(value, math.sqrt(max(float(variance), 0.0)), not used.any())
    return out


def _identifiability(problem: _Problem, result: FitResult) -> list[str]:
    """What these data cannot tell, in words."""
    notes = []
    for n, e in result.parameters.items():
        if e.at_bound:
            notes.append(f"{n} ended on its {e.at_bound} bound ({e.value:g}): its standard error is formal.")
        elif not e.fixed and (e.u is None or not math.isfinite(e.u)):
            notes.append(f"{n} has no effect on these data: it is not determined.")
    c = result.correlation
    names = result.free
    pairs = [(a, b, c[i, j]) for i, a in enumerate(names) for j, b in enumerate(names) if i < j and abs(c[i, j]) > 0.98]
    for a, b, r in pairs:
        poor = any((result.parameters[n].u or 0.0) > 0.05 * abs(result.parameters[n].value) for n in (a, b))
        text = f"{a} and {b} " + ("can hardly be told apart by these data" if poor else "are strongly correlated")
        text += f" (correlation {r:+.4f})"
        m = result.derived.get("slope_m")
        if {a, b} == {"sigma0_um", "tau_um"} and m is not None and m.u is not None:
            known = "what they determine is" if poor else "better known than either is"
            text += f"; {known} the slope 2 sigma0/tau = {m.value:.4g} ± {m.u:.2g}"
        notes.append(text + ".")
    if not pairs and result.condition > 1e3:
        notes.append(f"The parameters are poorly determined together (condition number {result.condition:.2g}).")
    return notes
