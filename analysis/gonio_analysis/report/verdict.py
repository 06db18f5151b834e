"""What a report says of the nearest model: how far off, where, by which metric, and what else was tried.

How models compare in numbers goes from the simplest up.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from gonio.checks.symmetry import Pairs
from gonio.checks.values import SIGNIFICANCE
from gonio.shown import interval
from gonio_analysis.fitting.energy import too_much
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.objective import DESCRIPTIONS
from gonio_analysis.fitting.profile_likelihood import Interval
from gonio_analysis.fitting.unnoticed import SMOOTH
from gonio_analysis.report.blocks import Block, Notes, Paragraph, Text, table, term
from gonio_analysis.report.text import angle, difference, glued, number, percent, reasons, spoken_difference, with_u
from gonio_analysis.result_records import MisfitSummary, Reflectance
from gonio_analysis.selection.choice import ModelChoice
from gonio_analysis.selection.judging import DECISIVE, Judged, nearness
from gonio_analysis.selection.regions import WorstRegion, farthest, worst

if TYPE_CHECKING:
    from gonio_analysis.report.facts import DatasetSummary

NOT_SMALL = 0.5
"""Beyond this, what may go unnoticed is no small misfit, and nothing is said of it."""
CLEARLY = 1.05
"""A metric names another model where that one is better by this factor; less is no disagreement."""
JUDGES = ("log_ratio", "ngan", "cube_root")
"""Whose winners are compared with each other."""


def headline(d: DatasetSummary) -> list[str]:
    """The verdict in one or two sentences, and after it what else is to be said."""
    best = d.best
    if best is None:
        return [f"No model was fitted. {d.choice.words}"]
    f, tried = d.models[best], len(d.choice.judged)
    ratio, chi = f.metrics["log_ratio"], f.fit.reduced_chi_square
    typical = "" if ratio is None else f"; model and measurement differ typically by {spoken_difference(ratio)}"
    if f.fit.misfit is not None:
        told = [nearness(best, f.fit, f.missed, d.choice.near, tried)]
        if chi is None:
            told.append(
                "The table states no uncertainties, so nothing is accepted or rejected; --u-rel 0.03 judges the models"
                " with an assumed uncertainty of 3 % of each value."
            )
        elif f.fit.rejected:
            told.append(f"{best}: reduced chi-square {number(chi)}; {f.fit.by_chi_square}.")
    elif chi is not None:
        told = [of_true_model(best, f.fit, tried, named=d.choice.named is not None)]
        told.append(f"{typical[2:3].upper()}{typical[3:]}." if typical else "")
    else:
        others = f"the nearest of the {tried} models tried" if tried > 1 else "the only model tried"
        told = [f"{best} is {others}{typical}.", where(f.missed)]
        told.append(f"--metric {f.fit.goal.metric} takes no account of uncertainties: nothing is rejected.")
    warnings = [
        too_bright({name: other.rho_dh for name, other in d.models.items()}, best),
        f.fit.outside,
        direction_of_its_own(d.symmetries, d.models),
        disagreement({name: other.metrics for name, other in d.models.items()}, best),
    ]
    return [sentence for sentence in (*told, *warnings) if sentence]


def disagreement(metrics: Mapping[str, Mapping[str, float | None]], best: str) -> str:
    """Where metrics name different models, which, as a sentence; "" where one model is nearest by all of them.

    How far off `best`, the one that a page puts first, is by each stands beside it.
    """
    nearest: dict[str, list[str]] = {}
    alike = set(metrics)
    for name in JUDGES:
        known = {model: v for model, values in metrics.items() if (v := values.get(name)) is not None}
        if not known:
            continue
        first = min(known, key=known.__getitem__)
        alike &= {model for model, v in known.items() if v <= CLEARLY * known[first]}
        own = known.get(best)
        off = "" if own is None or best == first else f" ({best} is {own / max(known[first], 1e-300):.2g} times as far"
        nearest.setdefault(first, []).append(DESCRIPTIONS[name][0] + (off and f"{off} off by it)"))
    if alike or len(nearest) < 2:
        return ""
    said = "; ".join(f"{model} is nearest by {' and by '.join(labels)}" for model, labels in nearest.items())
    return f"The metrics disagree about the nearest: {said}."


def of_fit(result: FitResult) -> str:
    """What `gonio fit` says of one model: how far off it is and where, or what its chi-square is."""
    chi = result.reduced_chi_square
    if result.misfit is not None:
        by = "" if chi is None else f"; reduced chi-square {number(chi)}, {result.by_chi_square}"
        return f"{result.described}{worst(farthest(result))}{by}"
    return (result.verdict if chi is None else f"reduced chi-square {number(chi)}: {result.verdict}") + unnoticed(
        result
    )


def after_misfit(result: FitResult) -> str:
    """What `--residual` adds: how well the model with its misfit predicts values that are left out."""
    if result.misfit is None:
        return "The data do not reject the model: it has no misfit to keep, and it is saved as it is."
    left = percent(result.misfit.left_out)
    return f"With the smooth curve of its misfit the model predicts a left-out value to {left} (typically)."


def unnoticed(result: FitResult) -> str:
    """How far off a model may be that the data do not reject, as part of a sentence; "" where nothing says so."""
    if result.rejected or result.chi_square is None or result.tau is None or result.tau.interval[1] > NOT_SMALL:
        return ""
    return f"; a misfit of at most {percent(result.tau.interval[1])} {UNNOTICED}"


def of_true_model(best: str, fit: FitResult, tried: int, *, named: bool) -> str:
    """The verdict on a model whose chi-square says how good it is, in one or two sentences."""
    chi = f"reduced χ² {number(fit.reduced_chi_square, 3)}"
    if not named or fit.rejected:
        which = f"the best of the {tried} models tried" if tried > 1 else "the only model tried"
        return f"{best} is {which}, and does not describe the values within their uncertainties: {chi}, {fit.verdict}."
    which = f", the simplest of the {tried} models tried that does" if tried > 1 else ""
    said = f"{best} describes the values within their uncertainties{which} ({chi}, {fit.verdict})."
    open_ = unnoticed(fit).removeprefix("; ")
    return said + (f" {open_[:1].upper()}{open_[1:]}." if open_ else "")


def where(missed: WorstRegion | None) -> str:
    """The region that a model misses most, and the single value, as a sentence; "" where there is none."""
    if missed is None or not missed.off:
        return ""
    return f"It is worst {missed.off}" + (f"; {missed.single}." if missed.single else ".")


def too_bright(found: Mapping[str, Sequence[Reflectance]], best: str) -> str:
    """Which models reflect more than they receive, as sentences; "" where none does."""
    worst = {m: max(rs, key=lambda r: r.of_model[0] or 0.0) for m, rs in found.items() if too_much(rs)}
    if not worst:
        return ""
    said = [
        f"{m} (rho_dh = {with_u(*r.of_model)} at θi = {angle(r.theta_i_deg)})"
        for m, r in sorted(worst.items(), key=lambda item: item[0] != best)
    ]
    verb = "reflects more than it receives" if len(said) == 1 else "reflect more than they receive"
    return f"Against the conservation of energy {', '.join(said)} {verb}; --energy fits within the bound."


def reflectances(model: str, found: Sequence[Reflectance], given: str = "") -> str:
    """rho_dh of one model as a line, with a word on what is above 1; "" where there is none.

    `given` is what the model takes as exact: see `conditional`.
    """
    if not found:
        return ""
    line = ", ".join(f"{with_u(r.rho_dh, r.u)} at {angle(r.theta_i_deg)}" for r in found if r.rho_dh is not None)
    alone = conditional(model, found, given)
    exact = " at the measured level" if alone else f" (given {given})" if given else ""
    said = [f"rho_dh, by angle of incidence{exact}: {line}."] if line else []
    said += [*reasons(f"rho_dh of {model}", found), alone, too_bright({model: found}, model)]
    return " ".join(text for text in said if text)


def conditional(model: str, found: Sequence[Reflectance], given: str = "") -> str:
    """rho_dh that a model without a level of its own says by itself, as a sentence with its condition; "" for others.

    `given` is what it takes as exact, as "n, k".
    """
    alone = [f"{with_u(r.given, r.u_given)} at {angle(r.theta_i_deg)}" for r in found if r.u_given is not None]
    exact = f" (given {given})" if given else ""
    return f"By {model} alone{exact}: {', '.join(alone)}." if alone else ""


def direction_of_its_own(found: Sequence[Pairs], tried: Iterable[str] = ()) -> str:
    """The sentence for a sample that is not isotropic, with the model to try; "" where nothing shows it."""
    shown = next((s for s in found if s.kind == "azimuth of incidence" and s.broken), None)
    if shown is None:
        return ""
    other = (
        ""
        if any("anisotropic" in name for name in tried)
        else ("; --models anisotropic tries one that has a direction of its own")
    )
    return (
        f"The sample is anisotropic: at equal θi, θr and φr − φi values change with the azimuth of incidence, typically"
        f" by {difference(shown.typical)} ({shown.pairs} pairs). No isotropic model can describe that{other}."
    )


UNNOTICED = f"that is smooth over {math.degrees(SMOOTH):g}° would go unnoticed in half of the cases"
"""What is known of a misfit of a model that is not rejected."""
MISFIT = (
    "This is the model's misfit, relative, with its 95 % interval. Of a model that the data do not reject it is what"
    f" may be there: a misfit of that size {UNNOTICED}."
)
"""For tables that have such a column."""


def brief(choice: ModelChoice, label: str, fit: FitResult) -> str:
    """What the data say of a model, in a word or two."""
    if choice.near:
        return "nearest" if label == next(iter(choice.near)) else "as near" if label in choice.near else "farther off"
    why = next((c.rejected for c in choice.judged if c.candidate.label == label), "rejected" if fit.rejected else "")
    if fit.reduced_chi_square is None:
        return "farther off" if why else "as near as any"
    return "rejected" if why else "not rejected"


def tally(d: DatasetSummary) -> str:
    """The finding over all models, in a few words."""
    tried = len(d.choice.judged)
    if d.choice.near and tried > 1:
        others = len(d.choice.near) - 1
        told = f"{others} of {tried - 1} others cannot be told from the nearest"
        return told if others else f"one of {tried} is nearest, and told from the others"
    rejected = sum(bool(c.rejected) for c in d.choice.judged)
    if not tried or d.choice.judged[0].fit.reduced_chi_square is None:
        return "one model was tried" if tried == 1 else f"{tried} models were tried" if tried else "none"
    return f"{rejected} of {tried} {'is' if rejected == 1 else 'are'} rejected"


def which_model(d: DatasetSummary) -> list[Block]:
    """How the models compare in numbers; nothing where one model alone was tried."""
    choice, tried = d.choice, d.choice.judged
    if len(tried) < 2:
        return []
    alone_nm = d.wavelength_nm if any(f.fit.shared is not None for f in d.models.values()) else None
    stated = any(c.fit.reduced_chi_square is not None for c in tried)
    aic, bic = (min(xs) for xs in ([c.aic for c in tried], [c.bic for c in tried]))
    rows = [
        [
            c.candidate.label,
            "–" if alone_nm is None else misfit_words(c.fit.tau),
            # of one wavelength it stands among the metrics
            "–" if alone_nm is None and c.candidate.label in d.models else number(c.fit.reduced_chi_square),
            *map(number, (c.aic - aic, c.bic - bic, c.held_out)),
            _reason(c),
        ]
        for c in tried
    ]
    out: list[Block] = [Paragraph(glued(choice.words))]
    at = "" if alone_nm is None else f" at {alone_nm:g} nm alone"
    if alone_nm is not None:
        out.append(
            Paragraph(
                f"The choice is made at {alone_nm:g} nm alone, and so are the numbers of this table. The models above"
                " are fitted to all wavelengths together, with one geometry."
            )
        )
    unit = "in units of the uncertainty" if stated else "of logarithms"
    header: list[Text] = [
        "model",
        f"misfit{at}",
        f"reduced χ²{at}",
        term("ΔAIC", "Akaike's information criterion, less that of the best: -2 ln(likelihood) + 2 parameters."),
        term("ΔBIC", "Bayes's (Schwarz's) information criterion, less that of the best."),
        term("prediction error", f"Mean squared, {unit}, of values left out by {choice.held_out_by}."),
        "why",
    ]
    out.append(table(_rule(choice, stated), header, rows, right=(1, 2, 3, 4, 5)))
    return [*out, Notes(tuple(f"{m} was not tried: {why}." for m, why in choice.left_out.items()))]


def misfit_words(misfit: MisfitSummary | None) -> str:
    """As in "4.7 % (4 to 5.6)", or "< 0.3 %" where the data do not reject a model."""
    if misfit is None:
        return "–"
    return misfit.words if misfit.value > 0 else f"< {percent(misfit.interval[1])}"


def _reason(c: Judged) -> str:
    """Why a model is rejected, without the chi-square that stands beside it."""
    return re.sub(r"^reduced chi-square \S+ \((.*)\)$", r"\1", c.rejected)


def _rule(choice: ModelChoice, stated: bool) -> str:
    """By what models are judged, in sentences."""
    if choice.near:
        return (
            "The nearest model predicts best, as logarithms, what was left out; another one is as near where that"
            " difference, and that of the misfits, lie within twice their own uncertainties."
        )
    return (
        f"A model is {'rejected' if stated else 'behind'} where"
        + (f" the probability of its χ² is below {100 * SIGNIFICANCE:g} %, or where" * stated)
        + f" another is better by more than {DECISIVE:g} in AIC."
    )


def in_words(i: Interval, value: float | None) -> tuple[str, str]:
    """A parameter's value and its interval, both to the digits that the interval leaves."""
    low, high, middle = interval(i.low, i.high, i.low if value is None else value)
    ends = (low + " (bound)" * i.open_low, high + " (bound)" * i.open_high)
    return "–" if value is None else middle, " to ".join(ends)
