"""What to fit: a user's request, and the numbers, scales and bounds of the problem that it poses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from gonio.checks.values import SIGNIFICANCE
from gonio.errors import ConfigError
from gonio.models.parameters import METALLIC_N, Declaration, Fitted, Ior, Values
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.forward import ByWavelength, rho_dh
from gonio_analysis.fitting.objective import LOSSES, METRICS
from gonio_analysis.fitting.observations import check_u_rel

STARTS = 4
MARGIN = 1e-4
"""The bound on rho_dh lies so far below 1, for it gives a little."""
BOUND_STEP = 1e-3
"""Step for the derivatives of rho_dh, whose integral is right to 1e-5."""


def acceptable(freedom: Any) -> Any:
    """Chi-square of so many degrees of freedom, or of arrays of them, beyond which a model is rejected; of 0, none."""
    from scipy.special import chdtri

    return np.where(freedom > 0, chdtri(np.maximum(freedom, 1), SIGNIFICANCE), np.inf)


def check_metric(metric: str | None) -> None:
    """Raise `ConfigError` for a metric that is none."""
    if metric is not None and metric not in METRICS:
        raise ConfigError(f"--metric {metric}: there is no such metric; known: {', '.join(METRICS)}")


@dataclass(frozen=True)
class FitRequest:
    """What is to be fitted, and how.

    Raises
    ------
    ConfigError
        Unknown loss, or no search.
    """

    model: str
    """Name on the command line: "lambert", "oren-nayar", "phong", "blinn", "cook-torrance", "he-torrance", ..."""
    ior: Ior = None
    """Optical constants n + ik, or the name of a material: fixed, unless `free` names "ior" or "k"."""
    fix: Mapping[str, float | str] | None = None
    """Values of parameters that are not to be fitted; a word (`form="exact"`) goes to the constructor as it is."""
    free: Sequence[str] = ()
    """Parameters to fit beyond the usual ones."""
    slopes: int = 1
    """Slopes of Cook-Torrance's facet distribution."""
    wavelength_nm: float | None = None
    """Where the table has several wavelengths, the nearest one is fitted (550 nm if none is given); in a broad band,
    the effective wavelength."""
    each: Sequence[str] | None = None
    """Fit all wavelengths together, with a value at each wavelength for the parameters named and one for all others."""
    bounds: Mapping[str, tuple[float, float]] | None = None
    """Parameter -> lowest and highest value, inside the model's own bounds."""
    priors: Mapping[str, tuple[float, float]] | None = None
    """Parameter -> value and standard uncertainty known beforehand: a normal distribution that counts like one more
    measurement."""
    loss: str = "linear"
    """How large whitened residuals count: "linear" (their square), or one that outliers pull less: "soft_l1", "huber",
    "cauchy", "arctan" (as in `scipy.optimize.least_squares`, with a scale of one standard uncertainty)."""
    metric: str | None = None
    """What is made small: a name of `gonio_analysis.fitting.objective.METRICS`; by default "weighted" where
    uncertainties are stated, "log" elsewhere."""
    u_rel: float | None = None
    """Relative standard uncertainty to assume, where the table states none."""
    energy: bool = False
    """Bind rho_dh to 1 at the angles of incidence of the table."""
    start: Sequence[Values] | None = None
    """Sets of values to start from instead of a search: solutions of neighbours."""
    searches: int = STARTS
    """How many points of the coarse grid are searched from."""
    separate: bool = False
    """Fit one wavelength alone, where others of the table would share the geometry of its surface."""

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            raise ConfigError(f"--loss {self.loss}: there is no such loss; known: {', '.join(LOSSES)}")
        check_metric(self.metric)
        check_u_rel(self.u_rel)
        if self.searches < 1:
            raise ConfigError(f"searches = {self.searches}: at least one search is needed")


@dataclass(frozen=True)
class Bound:
    """rho_dh <= 1: what lies above counts like a measurement of 1 with the standard uncertainty `width`."""

    theta_i: tuple[float, ...]
    """[rad]"""
    phi_i: float
    wavelength_nm: float
    width: float

    def rho_dh(self, model: Any) -> Floats:
        """Directional-hemispherical reflectance of a model, at each angle of incidence."""
        return rho_dh(model, np.array(self.theta_i), self.phi_i, self.wavelength_nm, 1e-5)


@dataclass(frozen=True)
class Problem:
    """Which numbers move, on which scale, and the model that they make."""

    family: Declaration
    make: Callable[[Mapping[str, Any]], Any]
    """Constructor's arguments -> model."""
    free: tuple[str, ...]
    fixed: Values
    words: dict[str, str]
    ior: Ior
    notes: list[str]
    asked: FitRequest
    """What it was made from."""
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Parameter -> what is known of it beforehand: value and standard uncertainty."""
    waves: tuple[float, ...] = ()
    """Wavelengths [nm] that are fitted together; none for a fit at one."""
    each: tuple[str, ...] = ()
    """Parameters with a value of their own at each of `waves`: "albedo" is then fitted as "albedo@450", ..."""
    bound: Bound | None = None
    """Where the model may not reflect more than it receives."""

    def __reduce__(self) -> tuple[Any, ...]:
        # the functions of a family do not pickle: another process makes the problem again
        return _posed, (self.asked, self.waves, self.each, self.bound)

    def parameter(self, name: str) -> Fitted:
        """The parameter of a name in `free`."""
        return self.family.parameter(name.partition("@")[0])

    @cached_property
    def _moving(self) -> list[tuple[str, Fitted]]:
        """The parameters of `free`, by name."""
        return [(n, self.parameter(n)) for n in self.free]

    def at(self, values: Values, wavelength_nm: float) -> Values:
        """The values that hold at one of `waves`."""
        own = {n: values[f"{n}@{wavelength_nm:g}"] for n in self.each}
        return {n: x for n, x in values.items() if "@" not in n} | own

    def own_wavelength(self, k: int) -> float | None:
        """The one of `waves` that the k-th free parameter counts at; None where it counts at all."""
        _, between, at = self.free[k].partition("@")
        return next(w for w in self.waves if f"{w:g}" == at) if between else None

    def moved_together(self, among: Iterable[int]) -> list[list[int]]:
        """Free parameters in groups whose effects do not overlap: those of one name at different wavelengths."""
        out: dict[str, list[int]] = {}
        for k in among:
            out.setdefault(self.free[k].partition("@")[0], []).append(k)
        return list(out.values())

    def pulls(self, vector: Floats) -> Floats:
        """Residuals of the priors, one each."""
        values = self.values(vector)
        pulls = np.array([(values[n] - value) / u for n, (value, u) in self.priors.items()])
        return pulls if self.bound is None else np.concatenate([pulls, self._excess(vector)])

    def softer(self, factor: float) -> Problem:
        """The same with a softer bound, where it has any."""
        return self if self.bound is None else replace(self, bound=replace(self.bound, width=factor * self.bound.width))

    def _excess(self, vector: Floats, *, signed: bool = False) -> Floats:
        """What rho_dh exceeds 1 by, in units of the bound's width; below 1 it is 0, or negative if it is `signed`."""
        assert self.bound is not None
        over: Floats = (self.bound.rho_dh(self.model(vector)) - (1.0 - MARGIN)) / self.bound.width
        return over if signed else np.maximum(over, 0.0)

    def pull_slopes(self, vector: Floats) -> Floats:
        """d(pulls)/d(search scale), (priors, p)."""
        slope = self.slope(vector)
        rows = [np.where([m == n for m in self.free], slope / u, 0.0) for n, (_, u) in self.priors.items()]
        pulls = np.array(rows).reshape(len(rows), vector.size)
        if self.bound is None:
            return pulls
        _, upper = self.bounds
        here = self._excess(vector)
        columns = np.zeros((here.size, vector.size))
        for k in range(vector.size) if here.any() else ():
            moved = vector.copy()
            moved[k] += BOUND_STEP if vector[k] + BOUND_STEP <= upper[k] else -BOUND_STEP
            columns[:, k] = np.where(here > 0, (self._excess(moved, signed=True) - here) / (moved[k] - vector[k]), 0.0)
        return np.concatenate([pulls, columns])

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds on the search scale."""
        ends = [(_searched(p, p.lower), _searched(p, p.upper)) for _, p in self._moving]
        return np.array([low for low, _ in ends]), np.array([high for _, high in ends])

    def values(self, vector: Floats) -> Values:
        """All parameters by name, for a point of the search."""
        moving = zip(self._moving, vector.tolist(), strict=True)
        return self.fixed | {n: p.inside(math.exp(x) if p.scale == "log" else x) for (n, p), x in moving}

    def vector(self, values: Values) -> Floats:
        """The point of the search that has these values, brought inside the bounds."""
        return np.array([_searched(p, p.inside(values[n])) for n, p in self._moving])

    def slope(self, vector: Floats) -> Floats:
        """d(value)/d(search scale) of the free parameters."""
        values = self.values(vector)
        return np.array([values[n] if p.scale == "log" else 1.0 for n, p in self._moving])

    def slopes(self, of: Callable[[Floats], Floats], vector: Floats, step: float) -> Floats:
        """d(quantities)/d(search scale), (p, quantities), by central differences that stay inside the bounds.

        Parameters
        ----------
        of
            The quantities at a point of the search.
        vector
            Where.
        step
            Of the differences; 0 is the slope by a parameter that cannot move.
        """
        lower, upper = self.bounds
        rows = []
        for k in range(vector.size):
            up, down = vector.copy(), vector.copy()
            up[k], down[k] = min(vector[k] + step, upper[k]), max(vector[k] - step, lower[k])
            rows.append((of(up) - of(down)) / max(up[k] - down[k], 1e-300))
        return np.array(rows)

    def known_slopes(self, vector: Floats) -> Values:
        """d(model)/d(search scale) [1/sr] of the parameters for which it is the same in every direction."""
        if self.each:
            return {}
        values = self.values(vector)
        flat = self.family.flat(values)
        return {n: flat[n] * (values[n] if p.scale == "log" else 1.0) for n, p in self._moving if n in flat}

    def model(self, vector: Floats) -> Any:
        """The model at a point of the search."""
        values = self.values(vector)
        if self.waves:
            return ByWavelength({w: self._made(self.at(values, w)) for w in self.waves})
        return self._made(values)

    def _made(self, values: Values) -> Any:
        return self.make({**self.family.arguments(values), **self.words})


def _searched(p: Fitted, value: float) -> float:
    """A value on the search scale."""
    return math.log(value) if p.scale == "log" else value


def pose(asked: FitRequest) -> Problem:
    """The problem that a request poses.

    Raises
    ------
    ConfigError
        Unknown model, parameter or option, or nothing is left to fit.
    """
    model, ior, fix, free = asked.model, asked.ior, asked.fix or {}, asked.free
    notes: list[str] = []
    if ior is not None and not parameters.needs_ior(model):
        ior = None
        notes.append(f"The optical constants are not used: {model} has none.")
    family = parameters.family(model, slopes=asked.slopes, ior=ior)
    words = {k: v for k, v in fix.items() if isinstance(v, str)}
    if words and len(parameters.parts(model)) > 1:
        raise ConfigError(f"--fix {next(iter(words))}=...: words go to a single model's constructor, not to a sum")
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
    moving = tuple(n for n in family.parameters if (n in family.free or n in free) and n not in numbers)
    if not moving:
        raise ConfigError(f"every parameter of {model} is fixed: there is nothing to fit")
    if "k" in moving and "ior" in moving:
        family = replace(family, parameters={**family.parameters, "ior": METALLIC_N})
    family = _bounded(family, asked.bounds or {}, moving)
    fixed = {**family.fixed, **numbers}
    if ior is None and "ior" in moving and parameters.needs_ior(model) and not fixed.get("k") and "k" not in moving:
        notes.append("No optical constants were given (--ior): a real refractive index n is fitted, with k = 0.")
    return Problem(
        family,
        parameters.maker(model),
        moving,
        {n: v for n, v in fixed.items() if n not in moving},
        words,
        ior,
        notes,
        replace(asked, start=None),
        _checked_priors(asked.priors or {}, model, moving),
    )


def _posed(asked: FitRequest, waves: tuple[float, ...], each: tuple[str, ...], bound: Bound | None) -> Problem:
    problem = pose(asked)
    return replace(together(problem, waves, each) if waves else problem, bound=bound)


def together(problem: Problem, waves: Sequence[float], each: Sequence[str]) -> Problem:
    """The same fit at several wavelengths together: parameters are shared but for those that `each` names.

    Raises
    ------
    ConfigError
        `each` names a parameter that is not fitted, or one with a prior.
    """
    for n in each:
        if n not in problem.free:
            raise ConfigError(f"--each {n}: {n} is not fitted; fitted are {', '.join(problem.free)}")
        if n in problem.priors:
            raise ConfigError(f"--each {n}: a prior of {n} would hold at every wavelength; give one or the other")
    shared = tuple(n for n in problem.free if n not in each)
    apart = tuple(n for n in problem.free if n in each)
    own = tuple(f"{n}@{w:g}" for n in apart for w in waves)
    return replace(problem, free=shared + own, waves=tuple(waves), each=apart)


def _bounded(family: Declaration, bounds: Mapping[str, tuple[float, float]], moving: Sequence[str]) -> Declaration:
    """The family with narrower bounds."""
    for n, (low, high) in bounds.items():
        p = family.parameter(n)
        if not p.lower <= low < high <= p.upper:
            raise ConfigError(
                f"--bound {n}={low:g}:{high:g}: bounds of {n} ascend, between {p.lower:g} and {p.upper:g}"
            )
        if n not in moving:
            raise ConfigError(f"--bound {n}={low:g}:{high:g}: {n} is not fitted; --free {n} would fit it")
    narrower = {n: replace(family.parameter(n), lower=low, upper=high) for n, (low, high) in bounds.items()}
    return replace(family, parameters={**family.parameters, **narrower})


def _checked_priors(
    priors: Mapping[str, tuple[float, float]], model: str, moving: Sequence[str]
) -> Mapping[str, tuple[float, float]]:
    for n, (value, u) in priors.items():
        if n not in moving:
            raise ConfigError(f"--prior {n}={value:g}: {n} of {model} is not fitted; it fits {', '.join(moving)}")
        if not (math.isfinite(value) and math.isfinite(u) and u > 0):
            raise ConfigError(
                f"--prior {n}: a value and its standard uncertainty above 0 are needed, as in {n}=1.77+-0.05"
            )
    return priors
