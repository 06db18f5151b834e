"""What models say of several samples: those that describe every one about as well as the nearest to it, and no others.

A model that is far from one of the samples has other parameters there because it is far. Of a sample that the data
reject every model of, `ModelChoice.near` says which are about as near; of any other those count that are not rejected.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from gonio.shown import number, with_u
from gonio_analysis.fitting import parameters
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.selection.choice import ModelChoice
from gonio_analysis.selection.compare import Dataset

TOLD_APART = 3.0
"""Standard uncertainties by which parameters of two samples differ for a sentence to name them."""
MOST_APART, MOST_MODELS = 3, 2
"""Parameters of a model, and models, that sentences name."""
METAL_N, METAL_K = 3.0, 1.0
"""A fitted n above the first without k, or a fitted k above the second, is that of a metal: at normal incidence it
reflects a quarter and more."""
ELEMENTS = {"aluminium": "Al", "aluminum": "Al", "copper": "Cu", "gold": "Au", "silver": "Ag", "chromium": "Cr",
            "chrome": "Cr", "iron": "Fe", "nickel": "Ni", "brass": "brass", "stainless": "stainless"}  # fmt: skip
"""Words in a sample's name, and the material that they mean."""


@dataclass(frozen=True)
class Apart:
    """A parameter of one model in two samples, where it differs most for its uncertainty."""

    name: str
    unit: str
    low: str
    """The sample that has the lower value."""
    value_low: float
    u_low: float
    high: str
    value_high: float
    u_high: float
    uncertainties: float
    """The difference in its standard uncertainties."""


@dataclass(frozen=True)
class SharedModel:
    """A model that describes every sample about as well as the nearest to it."""

    label: str
    not_true: list[str]
    """Samples whose data reject it all the same."""
    apart: list[Apart]
    """Parameters that differ by more than `TOLD_APART`, the clearest first."""
    compared: int
    """Parameters that were fitted in every sample, with an uncertainty."""


@dataclass(frozen=True)
class Remedy:
    """What would mend a fit, for a sample."""

    sample: str
    words: str


@dataclass(frozen=True)
class AcrossModels:
    """What models say of several samples."""

    shared: list[SharedModel]
    nearest: dict[str, list[str]]
    """The models that count as near, by sample, the first one first."""
    remedies: list[Remedy]
    words: list[str]


def across_models(datasets: Sequence[Dataset]) -> AcrossModels:
    """Compare the parameters of those models that all samples have in common."""
    near = {d.title: [label for label in alike(d.choice) if label in d.models] for d in datasets}
    common = [label for label in datasets[0].models if all(label in labels for labels in near.values())]
    common.sort(key=lambda label: (sum(labels.index(label) for labels in near.values()), label))
    shared = [_shared(label, datasets) for label in common]
    remedies = [one for d in datasets if (one := remedy(d)) is not None]
    return AcrossModels(shared, near, remedies, _words(shared, near))


def alike(choice: ModelChoice) -> list[str]:
    """The models that describe a sample about as well as its nearest one, by label; that one is the first."""
    if choice.near:
        return list(choice.near)
    kept = sorted((j for j in choice.judged if not j.rejected), key=lambda j: j is not choice.named)
    return [j.candidate.label for j in kept]


def _shared(label: str, datasets: Sequence[Dataset]) -> SharedModel:
    fits = [(d.title, d.models[label].fit) for d in datasets]
    found, compared = list[Apart](), 0
    for name in fits[0][1].parameters:
        known = [(title, p) for title, fit in fits if (p := fit.parameters.get(name)) is not None and not p.fixed]
        if len(known) < len(fits) or any(p.u is None or not math.isfinite(p.u) or p.u <= 0.0 for _, p in known):
            continue
        compared += 1
        (low, a), *_, (high, b) = sorted(known, key=lambda one: one[1].value)
        u_low, u_high = a.u or 0.0, b.u or 0.0
        far = (b.value - a.value) / math.hypot(u_low, u_high)
        if far > TOLD_APART:
            found.append(Apart(name, a.unit, low, a.value, u_low, high, b.value, u_high, far))
    found.sort(key=lambda one: -one.uncertainties)
    return SharedModel(label, [title for title, fit in fits if fit.rejected], found, compared)


def _words(shared: Sequence[SharedModel], near: dict[str, list[str]]) -> list[str]:
    """Sentences: which models hold for all, and by which of their parameters the samples differ."""
    if not shared:
        listed = "; ".join(f"{title}: {', '.join(labels[:3]) or 'none'}" for title, labels in near.items())
        which = "both samples" if len(near) == 2 else "all samples"
        return [f"No model describes {which} about as well as the nearest to each ({listed}): none compares them."]
    which = "both" if len(near) == 2 else f"all {len(near)}"
    out = []
    for one in shared[:MOST_MODELS]:
        false = f", though the data of {' and '.join(one.not_true)} reject it" if one.not_true else ""
        head = f"By {one.label}, which describes {which} about as well as the nearest model does{false},"
        if one.apart:
            said = "; ".join(map(_apart, one.apart[:MOST_APART]))
            out.append(f"{head} they differ in {said}.")
        elif one.compared:
            out.append(f"{head} no parameter differs by more than {TOLD_APART:g} standard uncertainties.")
        else:
            out.append(f"{head} no parameter is known with an uncertainty in {which}.")
    if rest := [one.label for one in shared[MOST_MODELS:]]:
        out.append(f"As near to {which}: {', '.join(rest)}.")
    return out


def _apart(x: Apart) -> str:
    unit = {"": "", "1": "", "um": " µm", "deg": "°"}.get(x.unit, f" {x.unit}")
    ends = (f"{with_u(value, u)}{unit} ({who})" for value, u, who in (
        (x.value_low, x.u_low, x.low), (x.value_high, x.u_high, x.high)))  # fmt: skip
    return f"{x.name}: {' to '.join(ends)}"


def remedy(d: Dataset) -> Remedy | None:
    """What --ior would mend: a metal's index that was fitted freely, or a real index that the data reject."""
    best = d.choice.best
    if best is None or best.candidate.label not in d.models:
        return None
    fit = d.models[best.candidate.label].fit
    if fit.problem.ior is not None or not parameters.needs_ior(best.candidate.model) or "ior" not in fit.free:
        return None
    index, k = fit.parameters["ior"].value, _value(fit, "k")
    u = fit.parameters["ior"].u or 0.0
    if k > METAL_K:
        found = f"the fitted n + ik = {number(index)} + {number(k)}i is a metal's"
    elif index > METAL_N and k == 0.0:
        rejected = ", and the data reject the model" if fit.rejected else ""
        sure = "reflects as a metal does" if index - 2.0 * u > METAL_N else "may stand for a metal's n + ik"
        found = f"the fitted n = {with_u(index, u)} with k = 0 {sure}{rejected}"
    else:
        return None
    return Remedy(d.title, f"{d.title}: {found}; {_name_it(d)}.")


def _value(fit: FitResult, name: str) -> float:
    one = fit.parameters.get(name)
    return 0.0 if one is None else one.value


def _name_it(d: Dataset) -> str:
    words = set(re.findall(r"[a-z]+", d.name.lower()))
    known = [material for word, material in ELEMENTS.items() if word in words]
    known += [m for m in ELEMENTS.values() if m.lower() in words]
    if known:
        return f"--ior {d.source}={known[0]} takes the index of {known[0]} as it is measured"
    return "if it is one, --ior NAME takes the index of that material (Al, Au, Cu, ...) and leaves fewer to be fitted"
