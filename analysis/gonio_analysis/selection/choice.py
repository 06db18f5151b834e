"""Which model describes a sample: from the simplest up, the first that the data do not reject.

Candidates stand in order of their free parameters. The data reject one where its whitened chi-square is too large for
noise (probability below 1 %), or where another describes the same values better by more than `DECISIVE` in AIC: the
total chi-square of hundreds of values hides a smooth misfit that a comparison sees. What is reported beside it (BIC,
run time) does not decide.

On a real sample all are rejected. Then the nearest is the one that best predicts values that were left out, as
logarithms; models whose difference in that lies within twice its own uncertainty cannot be told apart.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby

from gonio.checks.values import SIGNIFICANCE
from gonio.errors import ConfigError, DataError
from gonio.models.parameters import Ior, Values
from gonio.progress import Say, Stage, silent
from gonio.typing import Floats
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.fit import FitResult, fit
from gonio_analysis.fitting.observations import Observations
from gonio_analysis.fitting.problem import FitRequest, pose
from gonio_analysis.fitting.profile_likelihood import Interval, Profiles, profiles
from gonio_analysis.selection.judging import (
    DECISIVE,
    MANY,
    Candidate,
    Judged,
    _compared,
    _judged,
    _near,
    _reject,
    _tested,
    blocks,
    deviance,
    nearness,
)
from gonio_analysis.selection.parallel import Share, here
from gonio_analysis.selection.time_left import CURVES, FIGURES, Begun, after

COUNTED = 1.01
"""Factor on a misfit that counts the parameters: of 100 values one parameter more adds 0.5 %."""
PLAIN = {"sigma_deg": 0.0, "returned": 0.0}
"""What makes a base Lambert's."""
BEYOND = 2
"""Models with more parameters than this beyond the first that chi-square does not reject are not tried."""


@dataclass(frozen=True)
class ModelChoice:
    """What was tried, in order of complexity, and what the data say."""

    judged: list[Judged]
    named: Judged | None
    """The simplest that the data do not reject."""
    intervals: dict[str, Interval]
    """Profile-likelihood intervals of the named model's parameters."""
    words: str
    held_out_by: str
    left_out: dict[str, str] = field(default_factory=dict)
    """Candidates that were not fitted, and why."""
    near: dict[str, float] = field(default_factory=dict)
    """Where all are rejected, or nothing is stated: the models that cannot be told from the nearest one, it first, by
    label, with a weight of 1 and less."""

    @property
    def best(self) -> Judged | None:
        """The one that a report puts first, and that `words` begin with: a true one, or the nearest as far as told."""
        return _best(self.judged, self.named, self.near) if self.judged else None

    def shows(self, j: Judged) -> bool:
        """Whether a report of all models draws this one: the best one, and the best form of every single model."""
        if j is self.named or j is self.best:
            return True
        alike = [other for other in self.judged if other.candidate.model == j.candidate.model]
        return len(parameters.parts(j.candidate.model)) == 1 and j is min(alike, key=lambda other: other.aic)

    def linear(self, name: str) -> bool:
        """Whether the standard error of a parameter of the named model says the same as its interval."""
        assert self.named is not None
        e = self.named.fit.parameters[name]
        return self.intervals[name].linear(e.value, None if e.fixed else e.u)

    def summary(self) -> dict[str, object]:
        """Plain numbers and words."""
        named = self.named.candidate if self.named else None
        return {
            "named": named.label if named else None,
            "model": named.model if named else None,
            "words": self.words,
            "significance": SIGNIFICANCE,
            "decisive_aic": DECISIVE,
            "held_out_by": self.held_out_by,
            "candidates": self.judged,
            "intervals": {n: {**i.summary(), "linear": self.linear(n)} for n, i in self.intervals.items()},
            "left_out": self.left_out,
            "near": self.near,
        }


def candidates(models: Sequence[str], ior: Ior = None) -> list[Candidate]:
    """What to try: the models named, or with "all" every family and sums.

    Where nobody gave an index of refraction, n + ik are fitted. Models of other packages that declare what is fitted
    are among all families.

    A sum's Lambertian base is left out where the glossy model brings one of its own.

    Raises
    ------
    ConfigError
        "all" stands beside other names, or a name is unknown.
    """
    if "all" not in models:
        for name in models:
            parameters.family(name)
        return [Candidate(name) for name in models]
    if len(models) > 1:
        raise ConfigError("--models all names every model: nothing can stand beside it")
    single = [Candidate(name, asked=False) for name in parameters.declared()]
    several = [
        *(Candidate(name, asked=False) for name in parameters.sums()),
        Candidate("cook-torrance", slopes=2, asked=False),
    ]
    out = []
    for group in (single, several):
        out += group
        if ior is None:
            out += [replace(c, free=("k",)) for c in group if parameters.tells_index(c.model)]
    return out


def _fit(
    data: Observations,
    asked: FitRequest,
    starts: Sequence[Sequence[Values] | None],
    label: str,
    name: str,
    parts: Sequence[tuple[FitResult, Values]],
    say: Say,
) -> tuple[FitResult | str, float]:
    """The nearest of the fits from several starts, or why there is none; and how long it took [s].

    Where it ends above one of its `parts` one more begins at their values.
    """
    say(label)
    began = time.perf_counter()
    try:
        found = [fit(data, replace(asked, start=s), name=name) for s in starts]
        if above := [values for part, values in parts if _above(_nearest(found), part)]:
            found.append(fit(data, replace(asked, start=above), name=name))
        result: FitResult | str = _no_worse(_nearest(found), [part for part, _ in parts])
    except (DataError, ConfigError) as error:
        if isinstance(error, ConfigError) and not all(math.isnan(w) for w in data.wavelengths):
            raise
        result = str(error)
    say(label)
    return result, time.perf_counter() - began


def _fitted(
    data: Observations,
    requests: Mapping[Candidate, FitRequest],
    name: str,
    all_of_them: bool,
    progress: Say,
    share: Share,
) -> tuple[dict[Candidate, FitResult], dict[Candidate, float], dict[str, str]]:
    """Fits of candidates, few parameters first; how long each took [s]; and why others have none.

    Those of as many parameters are fitted side by side: none of them begins where another one ends.
    """
    fits: dict[Candidate, FitResult] = {}
    left_out: dict[str, str] = {}
    walls: dict[Candidate, float] = {}
    enough = math.inf
    sizes = {c: len(pose(asked).free) for c, asked in requests.items()}
    told = Begun(name, sizes, progress)
    for size, alike in groupby(sorted(sizes, key=sizes.__getitem__), key=sizes.__getitem__):  # stable
        jobs = {}
        for candidate in alike:
            why = "" if candidate.asked else _beyond_the_directions(candidate, data)
            if not why and size > enough and not all_of_them:
                why = "a model with fewer parameters is not rejected"
            if why:
                left_out[candidate.label] = why
                told.skip(candidate)
            else:
                starts, parts = _starts(candidate, fits), _contained(candidate, fits)
                jobs[candidate] = partial(_fit, data, requests[candidate], starts, candidate.label, name, parts)
        for candidate, (result, wall) in zip(jobs, share(list(jobs.values()), "", told), strict=True):
            if isinstance(result, str):
                left_out[candidate.label] = result
                continue
            fits[candidate], walls[candidate] = result, wall
            if result.p_value is not None and result.p_value >= SIGNIFICANCE:
                enough = min(enough, size + BEYOND)
    return fits, walls, left_out


def _none_fitted(left_out: Mapping[str, str], name: str) -> str:
    simplest, why = next(iter(left_out.items()))
    others = f" (nor {len(left_out) - 1} with more parameters)" if len(left_out) > 1 else ""
    return f"{simplest} could not be fitted{others}: {why.removeprefix(f'{name}: ')}"


def choose(
    data: Observations,
    tried: Sequence[Candidate],
    *,
    ior: Ior = None,
    wavelength_nm: float | None = None,
    metric: str | None = None,
    energy: bool = False,
    name: str = "the table",
    all_of_them: bool = False,
    progress: Say = silent,
    share: Share = here,
) -> ModelChoice:
    """Fit every candidate to the values at one wavelength, and say which is the simplest that the data do not reject.

    Parameters
    ----------
    data, name
        Usable values (`gonio_analysis.fitting.observations`), and what messages call them.
    tried
        See `candidates`; their order breaks ties between models with as many parameters.
    ior, wavelength_nm, metric, energy
        As in `FitRequest`; models are compared by what fits make small.
    all_of_them
        Fit every candidate; otherwise those are left out that have `BEYOND` more parameters than one that chi-square
        does not reject.
    progress, share
        Called with a line before each fit; who fits, and works out held-out errors and intervals.

    Raises
    ------
    DataError
        Not one candidate could be fitted, though there are enough values for the simplest.
    ConfigError
        See `gonio_analysis.fitting.fit.fit`; in a broad band candidates that need a wavelength are left out instead.
    """
    requests = {c: replace(c.request(ior, metric, energy), wavelength_nm=wavelength_nm) for c in tried}
    began = time.perf_counter()
    fits, walls, left_out = _fitted(data, requests, name, all_of_them, progress, share)
    if not fits:
        words = _none_fitted(left_out, name)
        if len(data.nearest(wavelength_nm)[0]) > min(len(pose(asked).free) for asked in requests.values()):
            raise DataError(f"{name}: {words}")
        return ModelChoice([], None, {}, f"{words}.", "", left_out)
    folds, by = blocks(next(iter(fits.values())).data)
    told = f"{name}: predicting values left out, models"
    later = Stage(progress, (CURVES + FIGURES) * after(time.perf_counter() - began, len(tried)))
    tested = share([partial(_tested, r, folds) for r in fits.values()], told, later)
    judged = _reject([_judged(c, r, t, walls[c]) for (c, r), t in zip(fits.items(), tested, strict=True)])
    named, intervals, lower = _walked(judged, share)
    if lower:  # valleys met while walking: begin again from there
        again = {
            j.candidate: fit(data, replace(requests[j.candidate], start=[j.fit.problem.values(vector)]), name=name)
            for j, vector in lower
        }
        better = {c: _judged(c, r, _tested(r, folds), walls[c]) for c, r in again.items()}
        judged = _reject([better.get(j.candidate, j) for j in judged])
        named, intervals, _ = _walked(judged, share)
    near = _near(judged)
    return ModelChoice(judged, named, intervals, _words(judged, named, near), by, left_out, near)


def _beyond_the_directions(candidate: Candidate, data: Observations) -> str:
    """Why a model that was not asked for by name cannot be told from others in these directions; "" where it can."""
    told = (parameters.kind(term).undetermined_by(data.directions) for term in parameters.parts(candidate.model))
    return next((why for why in told if why), "")


def _walked(
    judged: Sequence[Judged], share: Share
) -> tuple[Judged | None, dict[str, Interval], list[tuple[Judged, Floats]]]:
    """The simplest model that is not rejected, its parameters' intervals, and the lower valleys that were met.

    Where n was fitted with k = 0 and n + ik describes the data too, intervals hold for either: a level and an index
    that follow k would otherwise look better known than they are.
    """
    named = next((j for j in judged if not j.rejected), None)
    if named is None or len(named.fit.data) > MANY:
        return named, {}, []
    wider = next((j for j in judged if _follows(j, named)), None)
    both = [named] if wider is None else [named, wider]
    found = list(zip(both, share([partial(_profiles, j.fit) for j in both]), strict=True))
    intervals = dict(found[0][1].intervals)
    for name, interval in found[-1][1].intervals.items():
        alone = intervals.get(name, replace(interval, low=0.0, open_low=True))  # of k: what the named model takes
        intervals[name] = interval.extended(alone)
    return named, intervals, [(j, walked.better) for j, walked in found if walked.better is not None]


def _follows(j: Judged, named: Judged) -> bool:
    """Whether a candidate is the named one with k fitted beside n."""
    alone = "ior" in named.fit.free and not named.candidate.free
    return alone and not j.rejected and j.candidate == replace(named.candidate, free=("k",))


def _contained(candidate: Candidate, fits: Mapping[Candidate, FitResult]) -> list[tuple[FitResult, Values]]:
    """Simpler fits, and the values at which the candidate is the same as they are."""
    terms, slopes, out = parameters.parts(candidate.model), candidate.slopes, list[tuple[FitResult, Values]]()

    def take(simpler: Candidate, same: Callable[[Values], Values]) -> None:
        if (found := fits.get(simpler)) is not None:
            out.append((found, {**(known := _values(found)), **same(known)}))

    if candidate.free:
        take(replace(candidate, free=()), lambda known: {})
    if slopes == 2:
        take(replace(candidate, slopes=1), lambda known: {"m_1": known["m"], "m_2": known["m"], "w_1": 1.0})
    if len(terms) == 2:
        base = parameters.kind(terms[0]).declaration().base_starts
        take(replace(candidate, model=terms[1]), lambda v: {**base(_albedo(terms[1], v))[0], **PLAIN, "weight": 1.0})
        if terms[0] == "oren-nayar":
            take(replace(candidate, model=f"lambert+{terms[1]}"), lambda known: PLAIN)
    return out


def _starts(candidate: Candidate, fits: Mapping[Candidate, FitResult]) -> list[list[Values] | None]:
    """Where to begin: at simpler fits that the candidate contains; None: search."""
    simpler = fits.get(replace(candidate, free=()))
    if candidate.free and simpler is not None:
        known = _values(simpler)
        return [
            [
                *(values for _, values in _contained(candidate, fits)),
                *({**known, "ior": n, "k": k} for n, k in parameters.INDICES),
            ]
        ]
    terms = parameters.parts(candidate.model)
    if len(terms) == 1 or candidate.model == "lambert+he-torrance" or parameters.kind(terms[0]).hides_index:
        return [None]
    simpler = fits.get(Candidate("lambert+he-torrance" if terms[1] == "he-torrance" else terms[1]))
    if simpler is None:
        return [None]
    known = _values(simpler)
    albedo = _albedo(terms[1], known)
    return [None, [{**known, "albedo": albedo, "sigma_deg": sigma} for sigma in (5.0, 25.0)]]


def _albedo(gloss: str, known: Values) -> float:
    """The Lambertian part of a model that stands as a gloss in a sum, with the base's where it is one already."""
    albedo = known.get("albedo", known.get("k_d", known.get("diffuse_albedo", 0.0)))
    return albedo * (1.0 - known["s"]) if gloss == "cook-torrance" else albedo


def _values(result: FitResult) -> Values:
    return dict(result.problem.values(result.vector))


def _nearest(found: Sequence[FitResult]) -> FitResult:
    """The nearest of fits of one model to the same values; where all are rejected, with the least chi-square of all.

    Misfits may be equal where chi-squares are not: a search by stated uncertainties may end in a valley of its own.
    """
    best = min(found, key=_farness)
    if best.misfit is None or best.chi_square is None:
        return best
    return replace(best, chi_square=min(one.chi_square for one in found if one.chi_square is not None))


def _no_worse(result: FitResult, parts: Sequence[FitResult]) -> FitResult:
    """A rejected fit reaches the chi-square that parts of its model reach, wherever its own search for it has ended."""
    least = min((part.chi_square for part in parts if part.chi_square is not None), default=math.inf)
    if result.misfit is None or result.chi_square is None or result.chi_square <= least:
        return result
    return replace(result, chi_square=least)


def _above(result: FitResult, part: FitResult) -> bool:
    """Whether a fit is farther from the values than that of a part of its model."""
    (tau, total), (of_part, least) = _farness(result), _farness(part)
    return tau > COUNTED * of_part or (tau == 0.0 and total > least)


def _farness(result: FitResult) -> tuple[float, float]:
    """Of fits of one model to the same values the nearest has the least."""
    return 0.0 if result.misfit is None else result.misfit.tau, deviance(result)


def _profiles(result: FitResult, say: Say) -> Profiles:
    return profiles(result)


def _words(judged: Sequence[Judged], named: Judged | None, near: Mapping[str, float]) -> str:
    """The finding, in a sentence or two."""
    best = min(judged, key=lambda j: j.aic)
    if near:
        j = _best(judged, named, near)
        text = nearness(j.candidate.label, j.fit, j.fails, near, len(judged))
        if j.fit.chi_square is None:
            return f"{text} The table states no uncertainties, so nothing is accepted or rejected."
        return f"{text} The data reject every model that was tried ({len(judged)}{_assumed(j)})."
    if named is None:
        return (
            f"The data reject every model that was tried ({len(judged)}); {best.candidate.label} is the best of them"
            f" (reduced chi-square {best.fit.reduced_chi_square:.4g}{_assumed(best)})."
        )
    if named.fit.reduced_chi_square is None:
        return _compared(judged, named, best)
    text = f"{named.candidate.label} is the simplest model that the data do not reject"
    text += f" (reduced chi-square {named.fit.reduced_chi_square:.3g}{_assumed(named)})."
    simpler = [j for j in judged if len(j.fit.free) < len(named.fit.free)]
    others = [j for j in judged if j is not named]
    if others and all(j.rejected for j in others):
        text += " The other model is rejected." if len(others) == 1 else f" The {len(others)} others are rejected."
    elif simpler:
        text += f" {len(simpler)} simpler {'model is' if len(simpler) == 1 else 'models are'} rejected."
    equals = [j for j in judged if j is not named and not j.rejected and len(j.fit.free) == len(named.fit.free)]
    if equals:
        text += f" As many parameters and not rejected either: {', '.join(j.candidate.label for j in equals)}."
    if any(_follows(j, named) for j in judged):
        text += " It takes k as 0; n + ik is not rejected either, and the intervals let k follow."
    return text


def _assumed(j: Judged) -> str:
    assumed = j.fit.data.u_rel_assumed
    return "" if assumed is None else f", with the assumed uncertainty of {100 * assumed:g} %"


def _best(judged: Sequence[Judged], named: Judged | None, near: Mapping[str, float]) -> Judged:
    """The simplest that is near, or not rejected; else, and by a metric, the one of the lowest AIC."""
    lowest = min(judged, key=lambda j: j.aic)
    if near:
        return next(j for j in judged if j.candidate.label in near)
    return lowest if named is None or named.fit.reduced_chi_square is None else named
