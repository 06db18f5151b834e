"""What a report's headline says of the nearest model: how far off, where, and by which metric."""

import math
from collections.abc import Iterable, Mapping, Sequence

from gonio.checks.symmetry import Pairs
from gonio_analysis.fitting.energy import too_much
from gonio_analysis.fitting.fit import FitResult
from gonio_analysis.fitting.metrics import DESCRIPTIONS
from gonio_analysis.report.text import angle, difference, number, percent, with_u
from gonio_analysis.result_records import Reflectance
from gonio_analysis.selection.misfit_regions import Region, farthest

NOT_SMALL = 0.5
"""Beyond this, what may go unnoticed is no small misfit, and nothing is said of it."""
FEATURE = 2.0
"""A ratio beyond this factor is said as a factor, and not in percent."""
SINGLE = 1.5
"""A single value is named beside the region where it is farther off by this factor."""
CLEARLY = 1.05
"""A metric names another model where that one is better by this factor; less is no disagreement."""
JUDGES = ("log_ratio", "ngan", "cube_root")
"""Whose winners are compared with that of the fit's own metric."""


def disagreement(metrics: Mapping[str, Mapping[str, float | None]], best: str) -> str:
    """Which metrics name another model than `best`, as a sentence; "" where none does."""
    others: dict[str, list[str]] = {}
    for name in JUDGES:
        known = {model: v for model, values in metrics.items() if (v := values.get(name)) is not None}
        first, own = min(known, key=known.__getitem__, default=best), known.get(best)
        if first != best and (own is None or own > CLEARLY * known[first]):
            off = "" if own is None else f" ({best} is {own / max(known[first], 1e-300):.2g} times as far off by it)"
            others.setdefault(first, []).append(DESCRIPTIONS[name][0] + off)
    said = "; ".join(f"{model} is nearest by {' and by '.join(labels)}" for model, labels in others.items())
    return f"The metrics disagree about the nearest: {said}." if said else ""


def of_fit(result: FitResult) -> str:
    """What `gonio fit` says of one model: how far off it is and where, or what its chi-square is."""
    chi, found = result.reduced_chi_square, farthest(result) if result.misfit is not None else None
    if found is not None and found.off:
        by = "" if chi is None else f"; reduced chi-square {number(chi)}, {result.by_chi_square}"
        return f"{result.described}, worst {found.off}{by}"
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
    return f"; a misfit of at most {percent(result.tau.interval[1])} would go unnoticed"


def where(missed: Region | None) -> str:
    """The region that a model misses most, and the single value, as sentences; "" where there is none."""
    if missed is None or missed.ratio is None:
        return ""
    said = (
        f"Of all regions it is farthest off at {missed.words} ({missed.values} values): it is"
        f" {times(missed.ratio)} there, by the median."
    )
    single = missed.single_ratio
    if single is not None and abs(math.log(single)) > abs(math.log(missed.ratio)) + math.log(SINGLE):
        said += f" The value that it misses most lies at {missed.single_words}: there it is {times(single)}."
    return said


def times(ratio: float) -> str:
    """How a model stands to a measurement: in percent near it, as a factor far from it."""
    if 1 / FEATURE < ratio < FEATURE:
        return f"{number(100 * abs(ratio - 1), 2)} % {'above' if ratio > 1 else 'below'} the measurement"
    return f"{number(ratio, 2)} {'times' if ratio > 1 else 'of'} the measurement"


def too_bright(found: Mapping[str, Sequence[Reflectance]], best: str) -> str:
    """Which models reflect more than they receive, as sentences; "" where none does."""
    worst = {m: max(rs, key=lambda r: r.rho_dh or 0.0) for m, rs in found.items() if too_much(rs)}
    if not worst:
        return ""
    said = [
        f"{m} (rho_dh = {with_u(r.rho_dh, r.u)} at θi = {angle(r.theta_i_deg)})"
        for m, r in sorted(worst.items(), key=lambda item: item[0] != best)
    ]
    verb = "reflects more than it receives" if len(said) == 1 else "reflect more than they receive"
    return f"Against the conservation of energy {', '.join(said)} {verb}; --energy fits within the bound."


def reflectances(model: str, found: Sequence[Reflectance], given: str = "") -> str:
    """rho_dh of one model as a line, with a word on what is above 1; "" where there is none.

    `given` is what its uncertainty takes as exact.
    """
    if not found:
        return ""
    line = ", ".join(f"{with_u(r.rho_dh, r.u)} at {angle(r.theta_i_deg)}" for r in found)
    exact = f" (given {given})" if given else ""
    return f"rho_dh, by angle of incidence{exact}: {line}. {too_bright({model: found}, model)}".rstrip()


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
