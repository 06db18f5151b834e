"""How candidates are judged: errors of values held out, rejection, and who comes near."""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from gonio import shown
from gonio.checks.values import SIGNIFICANCE, Rows
from gonio.geometry import Directions
from gonio.models.parameters import Ior
from gonio.progress import Say, silent
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.misfit import groupings
from gonio_analysis.fitting.objective import on_log_scale, smallest_of
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import FitRequest
from gonio_analysis.fitting.profile_likelihood import Near
from gonio_analysis.selection.regions import WorstRegion, farthest, incidences, worst

FOLDS = 5


def blocks(data: Observations) -> tuple[list[Rows], str]:
    """Blocks to leave out one after the other, and what they are; neighbours stay together, for they are alike.

    Angles of incidence where there are three or more, else ranges of the detector's angle.
    """
    groups = [rows for _, rows in incidences(data.directions.theta_i)]
    if len(groups) >= 3:
        if len(groups) > 2 * FOLDS:  # a dense set of incidences: neighbours go together
            groups = [np.concatenate(part) for part in _parts(groups, FOLDS)]
        return groups, "angle of incidence"
    order = np.argsort(data.directions.along)
    return [part for part in np.array_split(order, FOLDS) if part.size], "range of the detector's angle"


def _parts(groups: list[Rows], count: int) -> list[list[Rows]]:
    return [groups[a:b] for a, b in pairwise(np.linspace(0, len(groups), count + 1).round().astype(int)) if b > a]


TOLD_APART = 2.0
"""Standard uncertainties of the difference of two models' errors beyond which they are told apart."""
FEW = ("One angle", "Two angles", "Three angles", "Four angles")
"""So few say little of how well a model predicts another one: with four, "twice the uncertainty" is Student's 3.2."""
LEAST_KNOWN = 0.5
"""Standard uncertainty of ln tau from two independent residuals; no table tells less. So a model whose misfit is 4.2
times that of another is never as near: exp(2 sqrt(2) 0.5) = 4.1."""
COMPARABLE = 1.5
"""Misfits within this factor are alike, however well they are known: neither model is true, and the places measured
are one choice of many."""
DECISIVE = 10.0
"""Difference in AIC beyond which the worse model has essentially no support (Burnham and Anderson 2002, 2.6)."""
MANY = 20_000
"""Of more values than this, held-out errors use an even selection, and there are no profile intervals: standard errors
are as good then."""


@dataclass(frozen=True)
class Candidate:
    """A model with what of it is fitted."""

    model: str
    """As on the command line; sums as "oren-nayar+phong"."""
    free: tuple[str, ...] = ()
    slopes: int = 1
    asked: bool = field(default=True, compare=False)
    """Whether it was named, and not tried as one of all."""

    @property
    def label(self) -> str:
        """For reports."""
        return self.model + (", two slopes" if self.slopes == 2 else "") + (", n + ik" if "k" in self.free else "")

    def request(self, ior: Ior, metric: str | None = None, energy: bool = False) -> FitRequest:
        """Its fit, with the optical constants where it has any."""
        own = ior if parameters.needs_ior(self.model) else None
        return FitRequest(self.model, ior=own, free=self.free, slopes=self.slopes, metric=metric, energy=energy)


@dataclass(frozen=True)
class Judged:
    """A candidate after its fit."""

    candidate: Candidate
    fit: FitResult
    aic: float
    bic: float
    held_out: float | None
    """Mean squared whitened residual of values that the fit had not seen; of logarithms without uncertainties."""
    misses: Floats | None
    """Squared differences of logarithms of the same (n,), by the fits of which each value was left out."""
    fails: WorstRegion | None
    """Where the misfit is largest."""
    rejected: str = ""
    """Why the data reject it, in words; "" where they do not."""
    wall_s: float = 0.0

    def summary(self) -> dict[str, object]:
        """Plain numbers and words."""
        fit = self.fit
        return {
            "label": self.candidate.label,
            "model": self.candidate.model,
            "n_free": len(fit.free),
            "free": fit.free,
            "parameters": {n: e.number for n, e in fit.parameters.items()},
            "chi_square": fit.chi_square,
            "reduced_chi_square": fit.reduced_chi_square,
            "p_value": fit.p_value,
            "aic": self.aic,
            "bic": self.bic,
            "held_out": self.held_out,
            "wall_s": self.wall_s,
            "misfit": fit.tau,
            "rejected": self.rejected,
            "fails": self.fails,
        }


def deviance(result: FitResult) -> float:
    """-2 log L of a fit, up to a constant of its data; without uncertainties the scatter is fitted too."""
    n, total = len(result.data), float(result.whitened @ result.whitened)
    if result.chi_square is not None:
        return total if result.misfit is None else result.chi_square
    return n * math.log(max(total, 1e-300) / n)


Tested = tuple[float | None, Floats | None, float]
"""`Judged.held_out` and `Judged.misses`, and the time that they took [s]."""


def _tested(result: FitResult, folds: Sequence[Rows], say: Say = silent) -> Tested:
    began = time.perf_counter()
    error, misses = _held_out(result, folds)
    return error, misses, time.perf_counter() - began


def _judged(candidate: Candidate, result: FitResult, tested: Tested, wall_s: float) -> Judged:
    n, p = len(result.data), len(result.free)
    error, misses, took = tested
    return Judged(
        candidate,
        result,
        deviance(result) + 2 * p,
        deviance(result) + p * math.log(n),
        error,
        misses,
        farthest(result),
        wall_s=wall_s + took,
    )


def _held_out(result: FitResult, folds: Sequence[Rows]) -> tuple[float | None, Floats | None]:
    """`Judged.held_out` and `Judged.misses`; None where blocks are too few to leave one out."""
    if len(folds) < 2:
        return None, None
    everything = np.arange(0, len(result.data), -(-len(result.data) // MANY))
    free = np.arange(len(result.free))
    total, misses = 0.0, np.full(len(result.data), np.nan)
    scale = 2.0 * smallest_of(result.data)
    for fold in (np.intersect1d(everything, whole) for whole in folds):
        rest = np.setdiff1d(everything, fold)
        if rest.size <= free.size:
            return None, None
        vector, _ = Near(result, rest).refit(result.vector, free, limit=15)
        left = Near(result, fold)
        predicted, known = left.predicted(vector), left.data.covariance
        stated = known is not None and result.goal.whitened
        residual = known.whiten(predicted - left.data.brdf) if stated and known else left.goal.residual(predicted)
        total += float(residual @ residual)
        misses[fold] = (np.arcsinh(predicted / scale) - np.arcsinh(left.data.brdf / scale)) ** 2
    return total / everything.size, misses


def _near(judged: Sequence[Judged]) -> dict[str, float]:
    """`Choice.near`: the weight of a model falls with its excess over the nearest, in uncertainties of that excess.

    One whose values left out do not tell it from the nearest is as near only if its own misfit is: few blocks tell
    little, and a model that misses by a factor more is no nearer for that.
    """
    tested = [j for j in judged if j.misses is not None and j.fit.misfit is not None]
    if len(tested) < len(judged):  # one is not rejected, or a metric was asked for
        return {}
    told = _told(tested)
    alike = [j for j in tested if told[j.candidate.label] <= TOLD_APART]
    least = min(alike, key=_departure)
    near = [j for j in alike if not _farther(j, least)]
    if len(near) < len(alike):
        told = _told(near)
    labels = [j.candidate.label for j in sorted(near, key=_prediction)]
    return {label: math.exp(-0.5 * max(told[label], 0.0) ** 2) for label in labels}


def _told(tested: Sequence[Judged]) -> dict[str, float]:
    """By how much each model predicts worse what was left out than the one that does so best: see `_excess`."""
    best = min(tested, key=_prediction)
    out = {}
    for j in tested:
        assert j.misses is not None
        assert best.misses is not None
        kept = np.isfinite(j.misses)
        behind = _excess(j.misses[kept], best.misses[kept], j.fit.data.directions[kept])
        out[j.candidate.label] = 0.0 if j is best else behind
    return out


def _departure(j: Judged) -> float:
    """How far a model is typically off the values that it was fitted to, relative: its misfit, and noise beside it."""
    misfit, data = j.fit.misfit, j.fit.data
    assert misfit is not None
    stated = on_log_scale(data, misfit.small, j.fit.predicted)
    return math.hypot(misfit.tau, 0.0 if stated is None else float(np.median(stated.random)))


def _farther(j: Judged, least: Judged) -> bool:
    """Whether one model is farther off its own values than another, beyond doubt and by `COMPARABLE`.

    Were it as near, its residuals would be as many independent ones as the other's: each ln tau is known as well.
    """
    assert least.fit.misfit is not None
    u = math.sqrt(2.0) * min(least.fit.misfit.u_log, LEAST_KNOWN)
    behind = math.log(max(_departure(j), 1e-300) / max(_departure(least), 1e-300))
    return behind > max(TOLD_APART * u, math.log(COMPARABLE))


def _excess(worse: Floats, better: Floats, directions: Directions) -> float:
    """By how much one model predicts worse than another, in standard uncertainties of that.

    Blocks of directions count alike, each by the logarithm of the ratio of its mean squares: where both models fail in
    one place, that place alone does not decide.
    """
    means, variances = [], []
    for number in groupings(directions):
        ratio = np.log(np.maximum(np.bincount(number, worse), 1e-300) / np.maximum(np.bincount(number, better), 1e-300))
        means.append(float(ratio.mean()))
        variances.append(float(ratio.var(ddof=1)) / ratio.size if ratio.size > 1 else math.inf)
    return float(np.mean(means)) / max(math.sqrt(float(np.mean(variances))), 1e-12)


def _prediction(j: Judged) -> float:
    """Root mean square of the logarithms of what was left out, over its prediction."""
    return math.inf if j.misses is None else math.sqrt(float(np.nanmean(j.misses)))


def _reject(judged: Sequence[Judged]) -> list[Judged]:
    """Why the data reject each, where they do."""
    best, near = min(judged, key=lambda j: j.aic), _near(judged)
    nearest = next((j for j in judged if j.candidate.label == next(iter(near), None)), best)
    out = []
    for j in judged:
        p = j.fit.p_value
        why = ""
        if p is not None and p < SIGNIFICANCE:
            why = f"reduced chi-square {j.fit.reduced_chi_square:.4g} (p {'< 0.0001' if p < 1e-4 else f'= {p:.2g}'})"
        elif near:
            if j.candidate.label not in near:
                why = _behind(j, nearest)
        elif j.aic - best.aic > DECISIVE and (best.fit.p_value is None or best.fit.p_value >= SIGNIFICANCE):
            behind = j.aic - best.aic
            why = f"{best.candidate.label} describes the same values better by {behind:.{behind < 100:d}f} in AIC"
        out.append(replace(j, rejected=why))
    return out


def _behind(j: Judged, nearest: Judged) -> str:
    """Why a model is not as near as the nearest, in words."""
    label = nearest.candidate.label
    if _told([j, nearest])[j.candidate.label] > TOLD_APART:
        return f"{label} predicts values that were left out better"
    times = _departure(j) / max(_departure(nearest), 1e-300)
    return f"its misfit is {shown.number(times, 2)} times that of {label}"


def nearness(label: str, result: FitResult, fails: WorstRegion | None, near: Mapping[str, float], tried: int) -> str:
    """How far a model is from the sample, where it is farthest off, and what it cannot be told from, in sentences.

    Parameters
    ----------
    label, result
        The model that is put first, and its fit, which has a misfit.
    fails
        Where it is farthest off.
    near
        See `Choice.near`.
    tried
        Number of models.
    """
    assert result.tau is not None
    first = next(iter(near), label)
    if tried == 1:
        which = "the only model tried"
    elif first == label:
        which = f"the nearest of the {tried} models tried"
    else:
        which = f"the simplest of the models that cannot be told apart from the nearest, {first}"
    text = f"{label} is {which}: it {result.tau.of('this sample')}{worst(fails)}."
    others = [n for n in near if n not in (label, first)]
    if others:
        text += f" {_untold(result.data)} {'it' if first == label else 'either'} from {', '.join(others)}."
    elif first != label and few_incidences(result.data):
        text += f" {_untold(result.data)} the two apart."
    return text


def few_incidences(data: Observations) -> str:
    """As in "Three angles of incidence", where they are too few to say how well a model predicts another; else ""."""
    count = len(incidences(data.directions.theta_i))
    return f"{FEW[count - 1]} of incidence" if count <= len(FEW) else ""


def _untold(data: Observations) -> str:
    few = few_incidences(data)
    return f"{few} {'does' if few.startswith('One ') else 'do'} not tell" if few else "This plan cannot tell"


def _compared(judged: Sequence[Judged], named: Judged, best: Judged) -> str:
    """The finding where no chi-square says whether a model is good enough."""
    by = f"--metric {named.fit.goal.metric}"
    if len(judged) == 1:
        return f"{named.candidate.label} is the only model tried; nothing says whether it is good enough."
    if named is best:
        text = f"{named.candidate.label} comes nearest of the {len(judged)} models that were tried, by {by} and AIC."
    else:
        text = (
            f"{best.candidate.label} comes nearest of the {len(judged)} models that were tried, by {by} and AIC;"
            f" {named.candidate.label} is the simplest within {DECISIVE:g} of it."
        )
    why = "the table states no uncertainties" if named.fit.data.covariance is None else f"{by} takes no account of them"
    return f"{text} This compares models with each other: {why}, so nothing says whether any is good enough."
