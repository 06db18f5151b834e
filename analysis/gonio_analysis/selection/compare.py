"""Several models on several measurements: what a comparison report is made from.

Everything that a report shows is computed here; `gonio_analysis.report` only draws and prints it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from gonio.errors import ConfigError, DataError
from gonio.typing import Floats
from gonio_analysis import shown
from gonio_analysis.curves.in_plane import Curve, Norm, Normalise, curves, labels, norm, selection
from gonio_analysis.curves.line import Line
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.metrics import metrics
from gonio_analysis.fitting.observations import Observations, observations
from gonio_analysis.fitting.parameters import Ior
from gonio_analysis.pace import Pace
from gonio_analysis.result_records import RunFacts
from gonio_analysis.selection.choice import Choice, Judged, candidates, choose

if TYPE_CHECKING:
    import pandas as pd

MOST_ANGLES = 1000
"""Measured angles of one curve at which theory is evaluated too."""
MOST_WAVELENGTHS = 40
"""Parameters are tabulated over the wavelengths of a table that has at most this many."""


@dataclass(frozen=True)
class Drawn:
    """One in-plane curve with one model, ready to be drawn."""

    curve: Curve
    norm: Norm
    label: str
    theory_angle: Floats
    theory: Floats
    """[1/sr], as the instrument would see it."""
    residual: Floats

    def absolute(self) -> Line:
        """In 1/sr."""
        c = self.curve
        return Line(self.label, self.theory_angle, self.theory, c.angle, c.brdf, c.u, c.parameter, self.residual)

    def normalised(self) -> Line:
        """Theory and measurement divided by what `norm` says."""
        c, n = self.curve, self.norm
        return Line(
            self.label,
            self.theory_angle,
            self.theory / n.theory,
            c.angle,
            c.brdf / n.measured,
            c.u / n.measured,
            c.parameter,
            self.residual,
        )


@dataclass(frozen=True)
class Fitted:
    """One model on one measurement."""

    fit: FitResult
    metrics: dict[str, float | None]
    drawn: list[Drawn]
    series: list[FitResult] = field(default_factory=list)
    """Fits at every wavelength of the table, where it has several."""


@dataclass(frozen=True)
class Dataset:
    """One measured sample with every model that was fitted to it."""

    name: str
    source: str
    table: pd.DataFrame
    data: Observations
    """At the wavelength of the report."""
    wavelengths: list[float]
    wavelength_nm: float
    curves: list[Curve]
    """The in-plane curves that are drawn."""
    curves_known: int
    """How many in-plane curves the data have."""
    fitted: dict[str, Fitted]
    skipped: dict[str, str]
    """Model -> why it was not fitted."""
    choice: Choice
    """Which model the data ask for."""
    run: RunFacts | None = None
    """What the run's own record says, for a table that a run made."""

    def __repr__(self) -> str:
        return f"<{self.name}: {len(self.data)} values, {len(self.choice.judged)} models fitted; {self.choice.words}>"

    def _repr_html_(self) -> str:
        rows = []
        for j in self.choice.judged:
            chi = j.fit.reduced_chi_square
            found = ", ".join(
                f"{n} = {shown.value(e.value, e.u, e.unit)}" for n, e in j.fit.parameters.items() if not e.fixed
            )
            rows.append([j.candidate.label, found, "–" if chi is None else f"{chi:.4g}", f"{j.aic:.1f}", j.rejected])
        header = ["model", "fitted parameters", "reduced χ²", "AIC", "rejected because of"]
        return shown.html(self.name, header, rows, [self.choice.words])


def examine(
    table: pd.DataFrame,
    models: Sequence[str],
    *,
    name: str,
    source: str = "",
    normalise: Normalise = "mirror",
    ior: Ior = None,
    wavelength_nm: float | None = None,
    run: RunFacts | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Dataset:
    """Fit every model to one sample and prepare its curves.

    Parameters
    ----------
    table
        A measurement table of one sample.
    models
        Names on the command line, or "all": see `gonio_analysis.selection.choice.candidates`.
    normalise
        What polar curves are divided by; see `gonio_analysis.curves.in_plane.norm`.
    ior
        Optical constants n + ik or a material, for the models that have any.
    wavelength_nm
        The nearest wavelength of the table is reported (550 nm if none is given); in a broad band, the effective
        wavelength of the models that need one, which are left out without it.
    progress
        Called with a line before each fit.

    Raises
    ------
    DataError
        No usable value, or too few for every one of the models.
    """
    data = observations(table, name)
    known = data.wavelengths
    at, wavelength = data.nearest(wavelength_nm)
    found = curves(at)
    shown = selection(found)
    every = "all" in models
    choice = choose(
        data,
        candidates(models, ior),
        ior=ior,
        wavelength_nm=wavelength_nm,
        name=name,
        all_of_them=not every,
        progress=progress,
    )
    fitted = {
        j.candidate.label: _fitted(j.fit, shown, normalise, _series(j, data, known, ior, name, progress))
        for j in choice.judged
        if not every or choice.shows(j)
    }
    skipped = {} if every else choice.left_out
    return Dataset(name, source, table, at, known, wavelength, shown, len(found), fitted, skipped, choice, run)


def check_models(models: Sequence[str]) -> None:
    """Raise `ConfigError` for a name that no fit knows, before anything is read."""
    if not models:
        raise ConfigError(
            f"--models names no model; known: {', '.join([*parameters.FAMILIES, *parameters.strangers()])}"
        )
    candidates(models)
    twice = {m for m in models if list(models).count(m) > 1}
    if twice:
        raise ConfigError(f"--models names {', '.join(sorted(twice))} twice")


def _fitted(result: FitResult, shown: list[Curve], normalise: Normalise, series: list[FitResult]) -> Fitted:
    data = result.data
    stated = data.covariance is not None
    numbers = metrics(
        result.predicted,
        data.brdf,
        np.cos(data.directions.theta_i),
        data.u if stated else None,
        result.whitened if stated else None,
    )
    drawn = []
    for curve, label in zip(shown, labels(shown), strict=True):
        angle = theory_angles(curve, data)
        residual = result.whitened[curve.rows] if stated else result.predicted[curve.rows] / curve.brdf - 1.0
        drawn.append(
            Drawn(
                curve=curve,
                norm=norm(curve, normalise, result.model, data),
                label=label,
                theory_angle=angle,
                theory=curve.theory(result.model, angle, data),
                residual=residual,
            )
        )
    return Fitted(result, numbers, drawn, series)


def _series(
    judged: Judged, data: Observations, known: list[float], ior: Ior, name: str, progress: Callable[[str], None]
) -> list[FitResult]:
    """The same fit at every wavelength, each started from its neighbour's solution."""
    result, candidate = judged.fit, judged.candidate
    waves = [w for w in known if not math.isnan(w)]
    if not 1 < len(waves) <= MOST_WAVELENGTHS:
        return []
    middle = waves.index(result.wavelength_nm)
    out = {middle: result}
    pace = Pace(f"{name}: {candidate.label}, wavelengths", len(waves), progress)
    for k in [*range(middle + 1, len(waves)), *range(middle - 1, -1, -1)]:
        pace.step(len(out))
        near = out.get(k - 1 if k > middle else k + 1, result)
        start = {n: e.value for n, e in near.parameters.items()}
        try:
            asked = replace(candidate.request(ior), start=[start])
            out[k] = fit(data.at(waves[k]), asked, name=f"{name} at {waves[k]:g} nm")
        except DataError:
            continue  # too few usable values at this wavelength: the series has a gap there
    return [out[k] for k in sorted(out)]


def theory_angles(curve: Curve, data: Observations, *, dense: bool = True) -> Floats:
    """Signed angles [rad] of a theory curve: close where the instrument resolves a spike, up to
    `MOST_ANGLES` of the measured ones included.

    They end where a cone would touch the horizon. Those that are not `dense` are for curves that are one of many.
    """
    from gonio import geometry

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
