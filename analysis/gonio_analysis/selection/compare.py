"""Several models on several measurements: what a comparison report is made from.

Everything that a report shows is computed here; `gonio_analysis.report` only draws and prints it.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, update_wrapper
from itertools import pairwise
from typing import TypeVar

import numpy as np

from gonio import geometry, shown
from gonio.checks.symmetry import Pairs, symmetries
from gonio.errors import ConfigError, DataError
from gonio.lost import kept
from gonio.measurement import is_simulated
from gonio.models.parameters import Ior
from gonio.progress import Pace, Say, Stage
from gonio.run_facts import RunFacts
from gonio.shown import finite
from gonio.typing import DataFrame, Floats
from gonio_analysis.curves.in_plane import NORM_WORDS, Curve, Line, Norm, Normalise, curves, labels, norm, selection
from gonio_analysis.fitting import energy, parameters
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.objective import metrics
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.spectrum import MOST_WAVELENGTHS, fit_shared, shares, thinned
from gonio_analysis.result_records import Reflectance
from gonio_analysis.selection import parallel
from gonio_analysis.selection.beyond_reflection import MuellerFacts, Transmitted, polarisation, transmitted
from gonio_analysis.selection.choice import ModelChoice, candidates, choose
from gonio_analysis.selection.judging import DECISIVE, Judged, deviance
from gonio_analysis.selection.parallel import Share
from gonio_analysis.selection.polarised import PolarisationRatios, ratios
from gonio_analysis.selection.regions import WorstRegion, farthest
from gonio_analysis.selection.time_left import FIGURES, after

MOST_ANGLES = 1000
"""Measured angles of one curve at which theory is evaluated too."""
MOST_SENT = 200_000
"""Values with which a fit is sent to another process: some 20 MB a model."""
JUMP = 3.0
"""Factor between neighbouring wavelengths that no geometry, and no index but at a resonance, changes by."""


T = TypeVar("T")
Instead = TypeVar("Instead")
D = TypeVar("D", bound="Dataset")


def worked_out(what: str, instead: Instead) -> Callable[[Callable[[D], T]], cached_property[T | Instead]]:
    """A property of a sample, worked out once; where that fails while a page is made, it is named (`gonio.lost`)."""

    def of(make: Callable[[D], T]) -> cached_property[T | Instead]:
        def once(d: D) -> T | Instead:
            part: Callable[[], T | Instead] = partial(make, d)
            return kept(f"{what} of {d.name}", part, lambda _: instead)

        return cached_property(update_wrapper(once, make))

    return of


@dataclass(frozen=True)
class DrawnCurve:
    """One in-plane curve with one model, ready to be drawn."""

    curve: Curve
    norm: Norm
    label: str
    theory_angle: Floats
    theory: Floats
    """[1/sr], as the instrument would see it."""
    residual: Floats
    tau: float = 0.0
    """The model's own misfit, relative; 0 where the data do not reject it."""

    def absolute(self) -> Line:
        """In 1/sr."""
        return self._over(1.0, 1.0)

    def normalised(self) -> Line:
        """Theory and measurement divided by what `norm` says."""
        return self._over(self.norm.theory, self.norm.measured)

    def _over(self, theory: float, measured: float) -> Line:
        c = self.curve
        values = (self.theory / theory, c.angle, c.brdf / measured, c.u / measured)
        return Line(self.label, self.theory_angle, *values, c.parameter, self.residual, self.tau)

    @property
    def peaks(self) -> tuple[float, float]:
        """Angles of the largest value of theory and of measurement [rad]."""
        c = self.curve
        return float(self.theory_angle[int(np.argmax(self.theory))]), float(c.angle[int(np.argmax(c.brdf))])

    def summary(self) -> dict[str, object]:
        """As `summary.json` holds it."""
        c, n, (theory_at, measured_at) = self.curve, self.norm, self.peaks
        return {
            "label": self.label,
            "scanned": c.scanned,
            "parameter_deg": math.degrees(c.parameter),
            "phi_i_deg": math.degrees(c.phi_i),
            "points": c.angle.size,
            "normalised_by": n.kind,
            "normalised_by_words": NORM_WORDS[n.kind],
            "normalised_at_deg": math.degrees(n.angle),
            "norm_measured": n.measured,
            "norm_theory": n.theory,
            "theory_peak_deg": math.degrees(theory_at),
            "theory_peak": self.theory.max(),
            "measured_peak_deg": math.degrees(measured_at),
            "measured_peak": c.brdf.max(),
        }


@dataclass(frozen=True)
class FittedModel:
    """One model on one measurement."""

    fit: FitResult
    metrics: dict[str, float | None]
    drawn: list[DrawnCurve]
    series: list[FitResult] = field(default_factory=list)
    """Fits at every wavelength of the table, where it has several."""
    missed: WorstRegion | None = None
    """The region of angles that it misses most, by the ratio to the measurement."""
    rho_dh: list[Reflectance] = field(default_factory=list)

    @property
    def notes(self) -> list[str]:
        """Of the fit, and of its series over wavelengths."""
        return [*self.fit.notes, *jumps(self.series)]

    @property
    def reflects_too_much(self) -> bool:
        """Whether it reflects more than it receives at an angle of incidence."""
        return energy.too_much(self.rho_dh)

    def summary(self) -> dict[str, object]:
        """As `summary.json` holds it."""
        return {
            **self.fit.summary(),
            "notes": self.notes,
            "metrics": self.metrics,
            "missed": self.missed,
            "rho_dh": self.rho_dh,
            "reflects_too_much": self.reflects_too_much,
            "curves": self.drawn,
            "series": [r.at_wavelength for r in self.series],
        }


@dataclass(frozen=True)
class Dataset:
    """One measured sample with every model that was fitted to it."""

    name: str
    source: str
    table: DataFrame
    data: Observations
    """The values at the wavelength of the report."""
    wavelengths_nm: list[float | None]
    wavelength_nm: float | None
    """The one of the report; None for a broad band."""
    every_curve: list[Curve]
    """All curves in the plane of incidence, drawn or not."""
    models: dict[str, FittedModel]
    skipped: dict[str, str]
    """Model -> why it was not fitted."""
    choice: ModelChoice
    """Which model the data ask for."""
    transmission: Transmitted | None
    """None where the table holds reflection alone."""
    run: RunFacts | None
    """What the run's own record says, for a table that a run made."""

    @property
    def fitted(self) -> dict[str, FittedModel]:
        """`models`, as earlier versions called them."""
        return self.models

    @property
    def every_state(self) -> Observations:
        """The values that curves and fits are of: `data`, and those of every state of polarised light."""
        return next((one.fit.data for one in self.models.values()), self.data)

    @cached_property
    def curves(self) -> list[Curve]:
        """The in-plane curves that are drawn."""
        return selection(self.every_curve)

    @property
    def without_mirror(self) -> list[tuple[float, str]]:
        """Angle [rad] and label of every in-plane curve whose mirror direction was not measured, drawn or not."""
        labelled = zip(self.every_curve, labels(self.every_curve), strict=True)
        return [(c.parameter, label) for c, label in labelled if c.mirror is None]

    @property
    def best(self) -> str | None:
        """The model to put first, as the choice among models says it; of those that are shown."""
        chosen = self.choice.best
        if chosen is not None and chosen.candidate.label in self.models:
            return chosen.candidate.label
        aic = {j.candidate.label: j.aic for j in self.choice.judged}
        return min(self.models, key=lambda name: aic.get(name, math.inf), default=None)

    @worked_out("rho_dh", list[Reflectance]())
    def rho_dh(self) -> list[Reflectance]:
        """Directional-hemispherical reflectances of the measurement itself."""
        return energy.of_table(self.data)

    @worked_out("rho_dh of models that are as near", dict[str, list[Reflectance]]())
    def rho_dh_near(self) -> dict[str, list[Reflectance]]:
        """rho_dh of the models that cannot be told from the nearest (`ModelChoice.near`), by label, shown or not."""
        fits = {j.candidate.label: j.fit for j in self.choice.judged}
        shown = {label: one.rho_dh for label, one in self.models.items()}
        return {label: shown.get(label) or energy.of_model(fits[label]) for label in self.choice.near}

    @worked_out("rho_dh with the misfit", list[Reflectance]())
    def rho_dh_combined(self) -> list[Reflectance]:
        """rho_dh of those models taken together; empty where one is true."""
        return energy.combined([(self.choice.near[label], found) for label, found in self.rho_dh_near.items()])

    @worked_out("symmetries", list[Pairs]())
    def symmetries(self) -> list[Pairs]:
        """What pairs of directions say of the sample, and of its alignment."""
        return symmetries(self.data.checked)

    @worked_out("Mueller matrices", None)
    def mueller(self) -> MuellerFacts | None:
        """The Mueller matrices that the table holds."""
        best = self.best
        return polarisation(self.table, self.data, self.curves, best, None if best is None else self.models[best].fit)

    @worked_out("ratios of polarised states", None)
    def ratios(self) -> PolarisationRatios | None:
        """Ratios of polarised states, beside the model that is put first."""
        best = self.best
        return None if best is None else ratios(self.models[best].fit.data, self.models[best].fit, best)

    @property
    def simulated(self) -> bool:
        """Whether a simulation made the table."""
        return is_simulated(self.table) or (self.run is not None and self.run.sample is not None)

    @property
    def title(self) -> str:
        """The name, with a mark where the values are simulated."""
        return shown.marked(self.name, self.simulated)

    def __repr__(self) -> str:
        return f"<{self.title}: {len(self.data)} values, {len(self.choice.judged)} models fitted; {self.choice.words}>"


def examine(
    table: DataFrame,
    models: Sequence[str],
    *,
    name: str,
    source: str = "",
    normalise: Normalise = "mirror",
    ior: Ior = None,
    wavelength_nm: float | None = None,
    metric: str | None = None,
    u_rel: float | None = None,
    bound_energy: bool = False,
    separate: bool = False,
    run: RunFacts | None = None,
    progress: Callable[[str], None] = lambda text: None,
    share: Share = parallel.here,
) -> Dataset:
    """Fit every model to one sample and prepare its curves.

    Parameters
    ----------
    table, models
        Of one sample; names on the command line, or "all": see `gonio_analysis.selection.choice.candidates`.
    normalise
        What polar curves are divided by; see `gonio_analysis.curves.in_plane.norm`.
    ior, metric, u_rel, bound_energy
        As in `FitRequest`: optical constants, what fits make small, the uncertainty to assume, `energy`.
    wavelength_nm
        The nearest wavelength of the table is reported (550 nm if none is given); in a broad band, the effective
        wavelength of the models that need one, which are left out without it.
    separate
        Fit each wavelength alone. Otherwise models that are shown share the geometry of the surface among wavelengths
        (`gonio_analysis.fitting.spectrum`); the choice among models is made at the one that is reported.
    progress, share
        Called with a line before each fit; who does what is independent, of at most `MOST_SENT` values.

    Raises
    ------
    DataError
        No usable value, or too few for every one of the models.
    """
    through = transmitted(table, name, wavelength_nm, u_rel)
    data = observations(table, name, u_rel, polarised=True)
    data = thinned(data) if data.of_channels else data
    every, share = "all" in models, share if len(data) <= MOST_SENT else parallel.here
    began = time.perf_counter()
    choice = choose(
        data, candidates(models, ior), ior=ior, wavelength_nm=wavelength_nm, metric=metric, energy=bound_energy,
        name=name, all_of_them=not every, progress=progress, share=share,
    )  # fmt: skip
    at, wavelength = data.nearest(wavelength_nm)
    found = curves(at)
    drawn = [j for j in choice.judged if not every or choice.shows(j)]
    jobs = [partial(_drawn_model, j, data, name, separate, selection(found), normalise) for j in drawn]
    stage = Stage(progress, FIGURES * after(time.perf_counter() - began, len(choice.judged)))
    done = share(jobs, f"{name}: curves of models", stage)
    fitted = {j.candidate.label: one for j, one in zip(drawn, done, strict=True)}
    skipped = {} if every else choice.left_out
    at = at if data.light is None else _described(table, name, u_rel, data).nearest(wavelength)[0]
    waves = [finite(w) for w in data.wavelengths]
    return Dataset(
        name, source, table, at, waves, finite(wavelength), found, fitted, skipped, choice, through, run
    )  # fmt: skip


def _described(table: DataFrame, name: str, u_rel: float | None, data: Observations) -> Observations:
    """What describes a sample that was measured in polarised light: unpolarised light, or the commonest state."""
    with suppress(DataError):
        return observations(table, name, u_rel)
    words, counts = np.unique(data.states.astype(str), return_counts=True)
    return data.take(data.states == words[int(np.argmax(counts))])


def check_models(models: Sequence[str]) -> None:
    """Raise `ConfigError` for a name that no fit knows, before anything is read."""
    if not models:
        raise ConfigError(f"--models names no model; known: {', '.join(parameters.known())}")
    candidates(models)
    twice = {m for m in models if list(models).count(m) > 1}
    if twice:
        raise ConfigError(f"--models names {', '.join(sorted(twice))} twice")


def _drawn_model(
    judged: Judged,
    data: Observations,
    name: str,
    separate: bool,
    shown: list[Curve],
    normalise: Normalise,
    progress: Say,
) -> FittedModel:
    """A model that is shown, at every wavelength (of one geometry, or each alone) and with its curves."""
    result = judged.fit
    if shares(replace(result.problem.asked, separate=separate), data) and not math.isnan(result.wavelength_nm):
        fits = fit_shared(data, result, name=name, label=judged.candidate.label, say=progress)
        if own := [f for f in fits if f.wavelength_nm == result.wavelength_nm]:
            series = fits if len(fits) > 1 and len(data.wavelengths) <= MOST_WAVELENGTHS else []
            return _fitted(own[0], shown, normalise, series)
    return _fitted(result, shown, normalise, _series(judged, data, name, progress))


def _fitted(result: FitResult, shown: list[Curve], normalise: Normalise, series: list[FitResult]) -> FittedModel:
    data = result.data
    white = result.whitened if result.goal.whitened and result.misfit is None else None
    if white is None and data.covariance is not None:
        white = data.covariance.whiten(result.predicted - data.brdf)
    u = None if data.covariance is None else data.u
    numbers = metrics(result.predicted, data.brdf, np.cos(data.directions.theta_i), u, white)
    drawn = []
    for curve, label in zip(shown, labels(shown), strict=True):
        angle = theory_angles(curve, data)
        if result.goal.whitened:
            residual = result.whitened[curve.rows]
        else:
            with np.errstate(divide="ignore"):  # beside a value of 0 a model is infinitely far off
                residual = result.predicted[curve.rows] / curve.brdf - 1.0
        drawn.append(
            DrawnCurve(
                curve=curve,
                norm=norm(curve, normalise, result.model, data),
                label=label,
                theory_angle=angle,
                theory=curve.theory(result.model, angle, data),
                residual=residual,
                tau=0.0 if result.misfit is None else result.misfit.tau,
            )
        )
    return FittedModel(result, numbers, drawn, series, farthest(result), energy.of_model(result))


def _series(judged: Judged, data: Observations, name: str, progress: Say) -> list[FitResult]:
    """The same fit at every wavelength, each started from its neighbour's solution.

    Where that ends in another valley (`jump`) a search of its own and the neighbours on either side are tried. A
    solution near its neighbours is kept unless another is better by more than `DECISIVE` in AIC.
    """
    result = judged.fit
    request = result.problem.asked
    waves = [w for w in data.wavelengths if not math.isnan(w)]
    if not 1 < len(waves) <= MOST_WAVELENGTHS:
        return []
    middle = waves.index(result.wavelength_nm)
    out = {middle: result}

    def at(k: int, near: FitResult | None) -> FitResult | None:
        start = None if near is None else [{n: e.value for n, e in near.parameters.items()}]
        try:
            asked = replace(request, wavelength_nm=None, start=start)
            return fit(data.at(waves[k]), asked, name=f"{name} at {waves[k]:g} nm")
        except DataError:
            return None  # too few usable values at this wavelength: the series has a gap there

    upward, downward = range(middle + 1, len(waves)), range(middle - 1, -1, -1)
    pace = Pace(f"{name}: {judged.candidate.label}, wavelengths", len(waves), progress)
    for k in [*upward, *downward]:
        pace.step(len(out))
        step = 1 if k > middle else -1
        near = out.get(k - step, result)
        found = [at(k, near)]
        if found[0] is not None and jump(near, found[0]):
            found += [at(k, None), *([at(k, out[k - 2 * step])] if k - 2 * step in out else [])]
        if (chosen := _nearest([f for f in found if f is not None], [near])) is not None:
            out[k] = chosen
    for k in [*reversed(upward), *reversed(downward)]:  # and back
        step = 1 if k > middle else -1
        if k in out and k + step in out and jump(out[k], out[k + step]):
            again = at(k, out[k + step])
            both = [out[k], *([again] if again is not None else [])]
            out[k] = _nearest(both, [out[j] for j in (k - step, k + step) if j in out]) or out[k]
    return [out[k] for k in sorted(out)]


def _nearest(found: Sequence[FitResult], neighbours: Sequence[FitResult]) -> FitResult | None:
    """Of fits to the same values that describe them alike, one that jumps least from its neighbours."""
    if not found:
        return None
    best = min(deviance(f) for f in found)
    alike = [f for f in found if deviance(f) <= best + DECISIVE]
    return min(alike, key=lambda f: (sum(bool(jump(f, n)) for n in neighbours), deviance(f)))


def jump(a: FitResult, b: FitResult) -> list[str]:
    """Parameters that differ by more than a factor of three, and their uncertainties, from one wavelength to the next.

    Only those with a scale (lengths, widths, exponents, indices); levels may follow the colour of a sample.
    """
    out = []
    for name in a.free:
        one, other = a.parameters[name], b.parameters[name]
        if a.problem.parameter(name).scale != "log" or min(one.value, other.value) <= 0:
            continue
        u = math.hypot(one.u or 0.0, other.u or 0.0)
        if abs(math.log(other.value / one.value)) > math.log(JUMP) and abs(other.value - one.value) > 3 * u:
            out.append(name)
    return out


def jumps(series: Sequence[FitResult]) -> list[str]:
    """Sentences on the jumps that are left in a series."""
    return [
        f"From {a.wavelength_nm:g} to {b.wavelength_nm:g} nm {n} jumps from {a.parameters[n].value:.3g} to"
        f" {b.parameters[n].value:.3g}: the fits lie in different valleys, and neighbours' starts did not join them."
        for a, b in pairwise(series)
        for n in jump(a, b)
    ]


def theory_angles(curve: Curve, data: Observations, *, dense: bool = True) -> Floats:
    """Signed angles [rad] of a theory curve: close where the instrument resolves a spike, up to
    `MOST_ANGLES` of the measured ones included.

    They end where a cone would touch the horizon. Those that are not `dense` are for curves that are one of many.
    """

    cones = geometry.half_angle_of_cone([data.source_solid_angle_sr, data.receiver_solid_angle_sr])
    width = float(np.sum(cones))
    end = np.pi / 2 - max(float(cones.max()), 1e-3) - 1e-6
    even = np.radians(np.arange(-89.0, 89.1, 1.0 if dense else 3.0))
    near = curve.parameter + np.radians(np.arange(-6.0, 6.01, 0.25 if dense else 1.0))
    spike = curve.parameter + 1.5 * width * np.linspace(-1, 1, 61 if dense else 13) if width > 0 else np.empty(0)
    n = curve.angle.size
    measured = curve.angle[np.unique(np.linspace(0, n - 1, min(n, MOST_ANGLES)).astype(np.intp))]
    angle = np.concatenate([even, near, spike, [-end, end, curve.parameter], measured])
    return np.unique(angle[np.abs(angle) <= end])
